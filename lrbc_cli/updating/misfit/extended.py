"""FRFs as a function of boundary and nuisance parameters: global factors of the model, gains of responses, offset of the hammer point.

It replaces ``FrfModel`` in calibrations and in jobs with nuisance parameters; both fulfil the protocol ``Sensitive``.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy

import numpy as np

from lrbc_cli.arrays import Complexes, Floats, Integers
from lrbc_cli.model.terms import Parameterisation
from lrbc_cli.reduction.reduced.affine import AffineModel
from lrbc_cli.updating.misfit.nuisances import Effects, Nuisance
from lrbc_cli.updating.statistics.decibels import DB


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

    def __init__(
        self, model: AffineModel, s: Complexes, parameters: Parameterisation, nuisances: Sequence[Nuisance], responses: Integers
    ) -> None:
        self.model, self.s, self.parameters, self.nuisances = model.restricted(responses), s, parameters, tuple(nuisances)
        self.responses = responses

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

    def effects(self, theta: Floats) -> Effects[float]:
        """What the nuisance parameters change at theta."""
        effects = Effects[float]()
        for nuisance, value in zip(self.nuisances, theta[self.parameters.size :].tolist(), strict=True):
            table, at = nuisance.place(effects)
            table[at] = nuisance.effect(value)
        return effects

    def offset(self, theta: Floats) -> Floats | None:
        """(n_in, 2) offsets of the loads at theta [m]; None if no offset is identified or the model has no derivatives to it."""
        offsets = self.effects(theta).offsets
        if not offsets or self.model.shifts is None:
            return None
        offset = np.zeros(self.model.shifts.shape)
        offset[tuple(zip(*offsets, strict=True))] = list(offsets.values())
        return offset

    def derivatives(self, theta: Floats) -> tuple[Complexes, Complexes]:
        """FRFs y (F, R) and dy/dtheta (F, R, size), both complex."""
        P, s, effects = self.parameters, self.s, self.effects(theta)
        own = theta[: P.size]
        found = self.model.linearise(s, P.dynamic(own, s), effects.factors, list(effects.factors), self.offset(theta))
        y, J = found.y, np.zeros((*found.y.shape, self.size), dtype=complex)
        J[:, :, : P.size] = P.slopes(own, s).of(found.terms)
        factors, shifts = found.factors, found.shifts
        if effects.gains:
            gain = 10.0 ** (np.array([effects.gains.get(i, 0.0) for i in self.responses.tolist()]) / 20.0)
            y, J, factors, shifts = y * gain, J * gain[:, None], factors * gain[:, None], shifts * gain[:, None]
        loads = self.model.base.input_of
        slopes = Effects(
            dict(zip(effects.factors, np.moveaxis(factors, 2, 0), strict=True)),
            {i: np.where(self.responses == i, y / DB, 0.0) for i in effects.gains},
            {(load, k): np.where(loads == load, shifts[:, :, k], 0.0) for load, k in effects.offsets},
        )
        for column, nuisance in enumerate(self.nuisances, P.size):
            table, at = nuisance.place(slopes)
            J[:, :, column] = table[at]
        return y, J

    def frf(self, theta: Floats) -> Complexes:
        """(F, R) FRFs at theta."""
        return self.derivatives(theta)[0]

    def near(self, theta: Floats) -> ExtendedFrf:
        """The model itself: each state is solved for by itself."""
        return self

    def weakened(self, terms: Integers, decades: float) -> ExtendedFrf:
        """The same model with some terms changed, see ``Parameterisation.weakened``."""
        other = copy(self)
        other.parameters = self.parameters.weakened(terms, decades)
        return other

    def sensitivities(self, theta: Floats, phase: bool = False) -> tuple[Complexes, Floats | Complexes]:
        """(F, R) FRFs and the (F, R, size) derivatives of their dB values, or of ``20/ln10 ln(H)``, as ``FrfModel.sensitivities``."""
        y, dy = self.derivatives(theta)
        relative = dy * (DB / y)[:, :, None]
        return y, relative if phase else relative.real
