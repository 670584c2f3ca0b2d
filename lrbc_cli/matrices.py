"""The Python interface for matrices without a campaign file: a certified reduced model, its FRFs and their derivatives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike, NDArray

from lrbc_cli import given
from lrbc_cli.arrays import Complexes, Floats
from lrbc_cli.errors import ConfigError, NumericalError
from lrbc_cli.model.fem import FeModel
from lrbc_cli.model.frf import QUANTITIES
from lrbc_cli.model.terms import KIND_POWER, LowRankTerms
from lrbc_cli.reduction.build import Reduction, ReductionOptions, reduce_model
from lrbc_cli.reduction.reduced.many import ports_of
from lrbc_cli.reduction.reduced.ports import PortFrf
from lrbc_cli.reduction.steps.grid import require_in_band
from lrbc_cli.remembered import Remembered


@dataclass(frozen=True, repr=False)
class TermModel:
    """A certified reduced model made by ``reduce``: FRFs and derivatives for any values of its low-rank terms.

    Attributes
    ----------
    model : FeModel
        The full-order model.
    reduction : Reduction
        The reduced model with its certificate: ``worst``, ``held_out``, ``unseen``.
    """

    model: FeModel
    reduction: Reduction
    _tables: Remembered[PortFrf] = field(default_factory=lambda: Remembered(4), repr=False, init=False)

    def __repr__(self) -> str:
        model, low, high = self.model, *self.reduction.options.band_hz
        sizes = f"{model.size} DOFs by {self.reduction.model.size}, {model.terms.size} terms"
        return f"TermModel({sizes}, {model.B.shape[1]} loads, {model.L.shape[0]} outputs, {low:g} to {high:g} Hz)"

    def frf(self, hz: ArrayLike, values: ArrayLike) -> Complexes:
        """(F, R) FRFs at given values of the terms.

        Parameters
        ----------
        hz : (F,) array
            Lines in the band [Hz].
        values : float or (nt,) array
            Linear value (not log10), one for all terms or one for each; ``inf`` clamps, 0 frees.

        Raises
        ------
        ConfigError
            If a line lies outside the band, or a value is not as above.
        """
        s = self._lines(hz)
        kappa = given.one_or_each("values", values, self.model.terms.size, finite=False)
        if np.any(kappa == -np.inf):
            raise ConfigError("values: a linear value of minus infinity", expected="numbers, or inf, which clamps; 0 frees", found="-inf")
        clamped = np.isposinf(kappa)
        D = np.where(clamped, np.inf, np.where(clamped, 0.0, kappa) * s[:, None] ** self.model.terms.power)
        return self._table(s).evaluate(D)

    def sensitivities(self, hz: ArrayLike, log10: ArrayLike) -> tuple[Complexes, Floats]:
        """FRFs, and the derivatives of their levels [dB] with respect to the log10 values of the terms.

        Parameters
        ----------
        hz : (F,) array
            Lines in the band [Hz].
        log10 : float or (nt,) array
            Finite log10 values, one for all terms or one for each.

        Returns
        -------
        y : (F, R) complex array
        J : (F, R, nt) float array
            Jacobian in dB per decade, eq. (35).
        """
        s = self._lines(hz)
        terms = self.model.terms
        p = given.one_or_each("log10", log10, terms.size)
        D = 10.0**p * s[:, None] ** terms.power
        y, dy = self._table(s).linearise(D)
        return y, np.asarray(20.0 * (dy * D[:, None, :] / y[:, :, None]).real)

    def _table(self, s: Complexes) -> PortFrf:
        """Port FRFs at the lines s; those of the last four sets of lines are kept, since an optimiser asks for the same lines again."""
        return self._tables.of(s.tobytes(), lambda: ports_of(self.reduction.model, s))

    def _lines(self, hz: ArrayLike) -> Complexes:
        lines = given.lines(hz)
        require_in_band(lines, self.reduction.options.band_hz)
        return np.asarray(2j * np.pi * lines)


def reduce(
    K: Any,
    M: Any,
    C: Any = None,
    *,
    loads: Any,
    outputs: Any,
    terms: Any,
    band_hz: tuple[float, float],
    right: Any = None,
    kind: str | Sequence[str] = "stiffness",
    load_of: ArrayLike | None = None,
    quantity: str = "displacement",
    acoustic: ArrayLike | None = None,
    tolerance: float = 1e-3,
    accept: bool = False,
) -> TermModel:
    """Reduce matrices with low-rank terms, eqs. (3)-(5), to a model that is valid for all values of the terms.

    Parameters
    ----------
    K, M, C : (n, n) arrays, sparse or dense
        Stiffness, mass and damping without the terms; ``C=None``: no damping.
    loads : (n, n_in) array
    outputs : (n_out, n) array
    terms : (n, nt) array
        Left vectors b of the terms ``value * b cᵀ``.
    band_hz : (float, float)
        Ends of the band in which the reduced model is to hold [Hz].
    right : (n, nt) array or None
        Right vectors c; None: equal to the left ones.
    kind : str or sequence of str
        ``stiffness``, ``damping`` or ``mass``, one for all terms or one for each.
    load_of : (n_out,) int array or None
        Column of ``loads`` that each output is divided by; may be None if there is one load.
    quantity : str
        Of all outputs: ``displacement``, ``velocity``, ``acceleration`` or ``pressure``.
    acoustic : (n,) bool array or None
        Which DOFs are pressures; None: no DOF.
    tolerance : float
        Largest measured relative error of the responses, for each line and quantity.
    accept : bool
        Accept a model that does not reach its tolerance.

    Returns
    -------
    TermModel

    Raises
    ------
    ConfigError
        If an argument is not as above.
    NumericalError
        If the tolerance is not reached and this is not accepted, or if a factorisation fails.

    Examples
    --------
    >>> import numpy as np
    >>> K = np.diag(np.full(40, 2e6)) - 1e6 * (np.eye(40, k=1) + np.eye(40, k=-1))
    >>> M, unit = np.eye(40), np.eye(40)
    >>> chain = reduce(K, M, 1e-5 * K, loads=unit[:, :1], outputs=unit[[9]], terms=unit[:, [39]], band_hz=(5.0, 200.0))
    >>> y, J = chain.sensitivities([50.0, 60.0], log10=[5.0])
    >>> y.shape, J.shape, bool(chain.reduction.worst < 1e-3)
    ((2, 1), (2, 1, 1), True)
    """
    stiffness = given.matrix("K", K, None, None)
    n = stiffness.shape[0]
    mass, damping = (given.matrix(name, value, n, n) for name, value in (("M", M), ("C", sp.csc_array((n, n)) if C is None else C)))
    left, B, L = given.matrix("terms", terms, n, None), given.matrix("loads", loads, n, None), given.matrix("outputs", outputs, None, n)
    nt, kinds = left.shape[1], [kind] * left.shape[1] if isinstance(kind, str) else list(kind)
    for each in kinds:
        given.known("kind", each, KIND_POWER)
    given.known("quantity", quantity, QUANTITIES)
    if stiffness.shape[1] != n:
        raise given.refuse("K", "a square matrix", f"{n} rows and {stiffness.shape[1]} columns")
    if len(kinds) != nt:
        raise given.refuse("kind", f"one for all, or one for each of {nt} terms", f"{len(kinds)}")
    mask = np.zeros(n, dtype=bool) if acoustic is None else given.numbers("acoustic", acoustic, (n,)).astype(bool)
    if quantity == "pressure" and not mask.any():
        raise given.refuse("acoustic", "which DOFs are pressures, since the outputs are", acoustic)
    of = _loads_of(load_of, L.shape[0], B.shape[1])
    low_rank = LowRankTerms(
        left=left,
        right=left if right is None else given.matrix("right", right, n, nt),
        power=np.array([KIND_POWER[k] for k in kinds], dtype=np.int64),
        baseline=np.zeros(nt),
    )
    model = FeModel(
        K=stiffness,
        C=damping,
        M=mass,
        B=B,
        L=L,
        output_power=np.full(L.shape[0], QUANTITIES[quantity]),
        is_acoustic=mask,
        terms=low_rank,
    )
    options = ReductionOptions(band_hz=given.band(band_hz), tolerance=given.between("tolerance", tolerance, 0.0, 1.0))
    found = reduce_model(model, of, options)
    if not found.reached and not accept:
        raise NumericalError(
            "the reduced model does not reach its tolerance",
            expected=f"{options.tolerance:.1e}",
            found=f"{found.worst:.1e}" + (f" (stopped by: {found.stopped})" if found.stopped else ""),
            hint="a larger tolerance, or accept=True",
        )
    return TermModel(model, found)


def _loads_of(load_of: ArrayLike | None, outputs: int, loads: int) -> NDArray[np.int64]:
    """(n_out,) column of the loads that each output belongs to, checked."""
    if load_of is None and loads == 1:
        return np.zeros(outputs, dtype=np.int64)
    expected = f"a column from 0 to {loads - 1} of loads for each of {outputs} outputs"
    if load_of is None:
        raise given.refuse("load_of", expected, "none")
    found = given.numbers("load_of", load_of, (outputs,))
    if np.any((found < 0) | (found >= loads) | (found != np.round(found))):
        raise given.refuse("load_of", expected, np.array2string(found, threshold=10))
    return found.astype(np.int64)


__all__ = ["TermModel", "reduce"]
