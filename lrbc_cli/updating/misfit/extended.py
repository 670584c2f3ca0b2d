"""FRFs as a function of boundary and nuisance parameters: global factors of the model, gains of responses, offset of the hammer point.

It replaces ``FrfModel`` in calibrations and in jobs with nuisance parameters; both fulfil the protocol ``Sensitive``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lrbc_cli.arrays import Complexes, Floats, Integers
from lrbc_cli.model.terms import Parameterisation
from lrbc_cli.reduction.reduced.affine import AffineModel
from lrbc_cli.updating.statistics.decibels import DB


@dataclass(frozen=True, kw_only=True)
class Nuisance:
    """A nuisance parameter: a scalar unknown beside the boundary parameters, with a Gaussian prior.

    Attributes
    ----------
    kind : str
        ``factor``: natural logarithm of a global factor of the model; ``gain``: gain of a response [dB]; ``shift``: offset of a load [m].
    name : str
        Name of the factor, response or load.
    index : int
        For a gain the index of the response among all, for a shift ``2 load + direction``, for a factor 0.
    mean, std : float
        Of the prior, in the unit of the kind.
    bounds : (float, float)
    """

    kind: str
    name: str
    index: int
    mean: float
    std: float
    bounds: tuple[float, float]


class ExtendedFrf:
    """FRFs and derivatives for theta = [boundary parameters, nuisance parameters] by the reduced dynamic stiffness (28).

    Parameters
    ----------
    model : AffineModel
        Reduced model whose matrices depend on the global factors.
    s : (F,) complex array
        s of the lines, see ``FrfModel``.
    parameters : Parameterisation
    nuisances : sequence of Nuisance
    responses : (R,) int array
        Indices of the responses to compare.
    """

    name = "reduced"

    def __init__(
        self, model: AffineModel, s: Complexes, parameters: Parameterisation, nuisances: Sequence[Nuisance], responses: Integers
    ) -> None:
        self.model, self.s, self.parameters, self.nuisances = model.restricted(responses), s, parameters, tuple(nuisances)
        self._factors = [(parameters.size + i, e.name) for i, e in enumerate(nuisances) if e.kind == "factor"]
        at = responses.tolist()
        self._gains = [(parameters.size + i, at.index(e.index)) for i, e in enumerate(nuisances) if e.kind == "gain"]
        self._shifts = [(parameters.size + i, e.index) for i, e in enumerate(nuisances) if e.kind == "shift"]

    @property
    def size(self) -> int:
        """Number of unknowns."""
        return self.parameters.size + len(self.nuisances)

    @property
    def initial(self) -> Floats:
        """(size,) start values: those of the boundary parameters, then the prior means of the nuisance parameters."""
        return np.concatenate([self.parameters.initial, [e.mean for e in self.nuisances]])

    @property
    def bounds(self) -> Floats:
        """(size, 2) lower and upper bounds."""
        return np.vstack([self.parameters.bounds, np.array([e.bounds for e in self.nuisances]).reshape(-1, 2)])

    def factors(self, theta: Floats) -> dict[str, float]:
        """Global factors at theta by name, ``exp`` of their unknowns."""
        return {name: float(np.exp(theta[at])) for at, name in self._factors}

    def offset(self, theta: Floats) -> Floats | None:
        """(n_in, 2) offsets of the loads at theta [m]; None if no offset is identified or the model has no derivatives to it."""
        if not self._shifts or self.model.shifts is None:
            return None
        offset = np.zeros(self.model.shifts.shape)
        for at, index in self._shifts:
            offset[divmod(index, 2)] = theta[at]
        return offset

    def derivatives(self, theta: Floats) -> tuple[Complexes, Complexes]:
        """FRFs y (F, R) and dy/dtheta (F, R, size), both complex."""
        P, s = self.parameters, self.s
        own = theta[: P.size]
        found = self.model.linearise(s, P.dynamic(own, s), self.factors(theta), [n for _, n in self._factors], self.offset(theta))
        J = np.zeros((*found.y.shape, self.size), dtype=complex)
        J[:, :, : P.size] = (found.terms * P.spectra(own, s)[:, None, :]) @ P.scale_jacobian(own)
        kappa = P.scales(own)
        for at, terms, slope in P.damping_spectra(own, s):
            J[:, :, at] = (found.terms[:, :, terms] @ kappa[terms]) * slope[:, None]
        for i, (at, _) in enumerate(self._factors):
            J[:, :, at] = found.factors[:, :, i]
        for at, index in self._shifts:
            load, direction = divmod(index, 2)
            J[:, :, at] = np.where(self.model.base.input_of == load, found.shifts[:, :, direction], 0.0)
        y = found.y
        if self._gains:
            gain = np.zeros(y.shape[1])
            gain[[r for _, r in self._gains]] = theta[[at for at, _ in self._gains]]
            factor = 10.0 ** (gain / 20.0)
            y = y * factor
            J = J * factor[:, None]
            for at, r in self._gains:
                J[:, r, at] = y[:, r] / DB
        return y, J

    def frf(self, theta: Floats) -> Complexes:
        """(F, R) FRFs at theta."""
        return self.derivatives(theta)[0]

    def sensitivities(self, theta: Floats, phase: bool = False) -> tuple[Complexes, Floats | Complexes]:
        """(F, R) FRFs and the (F, R, size) derivatives of their dB values, or of ``20/ln10 ln(H)``, as ``FrfModel.sensitivities``."""
        y, dy = self.derivatives(theta)
        relative = dy * (DB / y)[:, :, None]
        return y, relative if phase else relative.real
