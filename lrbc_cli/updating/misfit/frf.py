"""FRFs of the model at fixed lines as a function of the boundary parameters theta, with their derivatives.

This module joins the reduction (H or the reduced matrices) to the cost: ``theta -> D_j(s) -> y(theta)``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from lrbc_cli.arrays import Complexes, Floats, Integers
from lrbc_cli.model.terms import Parameterisation, Slopes
from lrbc_cli.reduction.reduced.model import ReducedModel
from lrbc_cli.reduction.reduced.ports import PortFrf
from lrbc_cli.remembered import Remembered
from lrbc_cli.updating.statistics.decibels import DB


class Sensitive(Protocol):
    """Protocol of a model that gives FRFs at fixed lines and their derivatives to theta."""

    @property
    def s(self) -> Complexes:
        """(F,) s of the lines: i omega, or sigma + i omega of smoothed spectra [rad/s]."""

    @property
    def parameters(self) -> Parameterisation:
        """Boundary parameters; they come first in theta, before any nuisance parameters."""

    def frf(self, theta: Floats) -> Complexes:
        """(F, R) FRFs."""

    def sensitivities(self, theta: Floats, phase: bool = False) -> tuple[Complexes, Floats | Complexes]:
        """See ``FrfModel.sensitivities``."""

    def near(self, theta: Floats) -> Sensitive:
        """The same model, faster at states that differ from theta in few stiffnesses."""

    def weakened(self, terms: Integers, decades: float) -> Sensitive:
        """The same model with some terms changed, see ``Parameterisation.weakened``."""


@dataclass(frozen=True)
class Scaled:
    """A model whose FRFs are multiplied by ``factor`` (F, R), which leaves the derivatives of ln(H) as they are."""

    model: Sensitive
    factor: Complexes = field(repr=False)

    @property
    def s(self) -> Complexes:
        """See ``Sensitive``."""
        return self.model.s

    @property
    def parameters(self) -> Parameterisation:
        """See ``Sensitive``."""
        return self.model.parameters

    def frf(self, theta: Floats) -> Complexes:
        """(F, R) FRFs."""
        return np.asarray(self.model.frf(theta) * self.factor)

    def sensitivities(self, theta: Floats, phase: bool = False) -> tuple[Complexes, Floats | Complexes]:
        """See ``FrfModel.sensitivities``."""
        y, J = self.model.sensitivities(theta, phase)
        return np.asarray(y * self.factor), J

    def near(self, theta: Floats) -> Scaled:
        """See ``Sensitive``."""
        return Scaled(self.model.near(theta), self.factor)

    def weakened(self, terms: Integers, decades: float) -> Scaled:
        """See ``Sensitive``."""
        return Scaled(self.model.weakened(terms, decades), self.factor)


def changed(model: Sensitive, terms: Integers, decades: float, factor: Complexes | None = None) -> Sensitive:
    """The model ``weakened``, times a factor (F, R) of its FRFs if one is given."""
    other = model.weakened(terms, decades)
    return other if factor is None else Scaled(other, factor)


def level_factor(model: Sensitive, terms: Integers, decades: float, theta: Floats) -> Complexes:
    """(F, R) factor that leaves the FRFs at theta as they are although some terms are at another level there, with ``model`` near theta.

    In a comparison with the measurement in that state the terms then had this level before a change, too.
    """
    return np.asarray(model.frf(theta) / model.weakened(terms, decades).frf(theta))


def one_by_one(frf: Callable[[Floats], Complexes]) -> Callable[[Floats], Complexes]:
    """Extend a function ``theta -> (F, R)`` to several states: (k, size) arrays give (k, F, R)."""
    return lambda theta: frf(theta) if theta.ndim == 1 else np.stack([frf(each) for each in theta])


#: Results are cached up to this number of lines times parameters: their derivatives then take a few MB per state.
MOST_KEPT = 100_000


@dataclass(frozen=True, kw_only=True)
class FrfModel:
    """FRFs of the model at fixed lines as a function of theta, by one of two equivalent formulas (interface FRFs or reduced matrices).

    Attributes
    ----------
    s : (F,) complex array
        s of the lines: i omega, or sigma + i omega of smoothed spectra [rad/s].
    parameters : Parameterisation
    values, linearised : callables
        From the dynamic values D (F, nt) of the terms to the FRFs y (F, R); from D and its slopes to y and dy/dtheta (F, R, size). New
        arrays: they are modified or cached.
    ports : PortFrf or None
        Given with the port formula, which makes a change of few terms far cheaper than a full evaluation, see ``nearby``.
    """

    s: Complexes
    parameters: Parameterisation
    values: Callable[[Complexes], Complexes]
    linearised: Callable[[Complexes, Slopes], tuple[Complexes, Complexes]]
    ports: PortFrf | None = None
    # A descent begins where another stopped, and weights are computed there: a tenth of all evaluations repeat one of the last states.
    _last: Remembered[tuple[Any, ...]] = field(default_factory=lambda: Remembered(16), repr=False, compare=False)

    def frf(self, theta: Floats) -> Complexes:
        """(F, R) FRFs at theta; the array is read-only because it is cached."""
        y: Complexes = self._kept("frf", theta, lambda: (self.values(self.parameters.dynamic(theta, self.s)),))[0]
        return y

    def _kept(self, kind: object, theta: Floats, make: Callable[[], tuple[Any, ...]]) -> tuple[Any, ...]:
        small = self.s.size * self.parameters.size <= MOST_KEPT
        found = self._last.of(theta.tobytes(), make, kind) if small else make()
        for array in found:
            array.flags.writeable = False
        return found

    def near(self, theta: Floats) -> FrfModel:
        """The same model with the interface FRFs about theta, if it has any: only stiffnesses that differ from there are solved for."""
        return self if self.ports is None else port_model(self.ports.about(self.parameters.dynamic(theta, self.s)), self.parameters)

    def weakened(self, terms: Integers, decades: float) -> FrfModel:
        """The same model with some terms changed, see ``Parameterisation.weakened``; fast near the state that this one is near."""
        changed = self.parameters.weakened(terms, decades)
        return FrfModel(s=self.s, parameters=changed, values=self.values, linearised=self.linearised, ports=self.ports)

    def nearby(self, theta: Floats) -> Nearby:
        """FRFs at states that differ from theta in few stiffnesses, of several at once; see ``Nearby``."""
        return Nearby(self.near(theta), theta)

    def speeds(self, theta: Floats, states: Floats, along: Floats) -> Floats:
        """Norm of ``|dH| / sqrt(|H|² + h²)`` along given directions: how fast the FRFs move when some stiffnesses change.

        h is the median of |H| over the lines. With this measure all resonances that move by one bandwidth count alike, whatever their
        frequency and damping, and antiresonances, however sharp, hardly count. It is the integrand of L(z) of the guide's statistics page.

        Parameters
        ----------
        theta : (size,) float array
        states, along : (k, size) float arrays
            States, which differ from theta in some stiffnesses only, and a direction at each, without damping exponents.

        Returns
        -------
        (k,) float array
            Root of the sum of squares over all lines and responses [per unit of the direction].
        """

        def speed(y: Complexes, change: Complexes) -> float:
            return float(np.sqrt((np.abs(change) ** 2 / (np.abs(y) ** 2 + np.median(np.abs(y), axis=0) ** 2)).sum()))

        found = []
        if self.ports is None:
            for x, d in zip(states, along, strict=True):
                y, J = self.sensitivities(x, phase=True)
                found.append(speed(y, y / DB * (J @ d)))
            return np.array(found)
        P, D = self.parameters, self.parameters.dynamic(theta, self.s)
        kappa, c = P.scales(theta), P.spectra(theta, self.s)
        slopes = np.array([P.scale_jacobian(x) @ d for x, d in zip(states, along, strict=True)])
        terms = np.flatnonzero((slopes != 0.0).any(axis=0))
        there, D, c = self.ports.about(D).among(terms), D[:, terms], c[:, terms]
        for x, slope in zip(states, slopes[:, terms], strict=True):
            y, dy = there.linearise(D + c * (P.scales(x) - kappa)[terms])
            found.append(speed(y, (dy @ (c * slope)[:, :, None])[:, :, 0]))
        return np.array(found)

    def sensitivities(self, theta: Floats, phase: bool = False) -> tuple[Complexes, Floats | Complexes]:
        """FRFs and the derivative of their dB values to theta; with ``phase`` the derivative of ``20/ln10 ln(H)``.

        ``d|H|dB/dtheta = 20/ln10 Re(conj(H) dH/dtheta)/|H|²`` with the chain rule through ``D_j = c_j(s) kappa_j``, eqs. (35), (36), (A.4).

        Returns
        -------
        y : (F, R) complex array
        J : (F, R, size) float array, complex with ``phase``
            [dB per decade]; in the imaginary part a radian of phase counts as 8.69 dB. Both arrays are read-only.
        """
        y, J = self._kept(phase, theta, lambda: self._sensitivities(theta, phase))
        self._kept("frf", theta, lambda: (y,))
        return y, J

    def _sensitivities(self, theta: Floats, phase: bool) -> tuple[Complexes, Floats | Complexes]:
        P = self.parameters
        y, J = self.linearised(P.dynamic(theta, self.s), P.slopes(theta, self.s))
        # Re(conj(H) dH)/|H|² = Re(dH/H). At a zero of an undamped model H is rounding error only: the derivative is set to zero there.
        size = np.abs(y)
        J *= np.where(size > np.finfo(float).eps * size.max(axis=0, initial=0.0), DB / y, 0.0)[:, :, None]
        return y, J if phase else np.ascontiguousarray(J.real, dtype=np.float64)


@dataclass(frozen=True)
class Nearby:
    """FRFs at states that differ from theta in few stiffnesses: only the terms that differ are solved for.

    Attributes
    ----------
    model : FrfModel
        With the interface FRFs about theta; if it has none, each state is evaluated by itself.
    theta : (size,) float array
    """

    model: FrfModel
    theta: Floats

    def __call__(self, others: Floats) -> Complexes:
        """FRFs (F, R) at one state (size,), or (k, F, R) at several (k, size); best together if they differ in the same terms.

        Damping exponents must equal those of theta.
        """
        if self.model.ports is None:
            return one_by_one(self.model.frf)(others)
        P, s = self.model.parameters, self.model.s
        kappa, now = P.scales(self.theta), np.apply_along_axis(P.scales, -1, others)
        terms = np.flatnonzero((now != kappa).reshape(-1, kappa.size).any(axis=0))
        D, c = self.model.ports.D_ref[:, terms], P.spectra(self.theta, s)[:, terms]
        return self.model.ports.among(terms).evaluate(D + c * (now - kappa)[..., None, terms])

    def at(self, theta: Floats) -> Nearby:
        """The same about a state that differs from this one in few stiffnesses."""
        return self.model.nearby(theta)


def port_model(ports: PortFrf, parameters: Parameterisation) -> FrfModel:
    """FRFs by the port formula (14)-(18): an evaluation costs the same for any number of DOFs, full or reduced."""
    return FrfModel(s=ports.s, parameters=parameters, values=ports.evaluate, linearised=ports.linearise, ports=ports)


def reduced_model(model: ReducedModel, s: Complexes, parameters: Parameterisation, responses: NDArray[np.int64]) -> FrfModel:
    """FRFs of some responses by the reduced dynamic stiffness (28), (32): cheaper if there are more terms than reduced DOFs."""

    def linearise(D: Complexes, slopes: Slopes) -> tuple[Complexes, Complexes]:
        y, dy = model.linearise(s, D)
        return y[:, responses], slopes.of(dy[:, responses])

    return FrfModel(s=s, parameters=parameters, values=lambda D: model.evaluate(s, D)[:, responses], linearised=linearise)
