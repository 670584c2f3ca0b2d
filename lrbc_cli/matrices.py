"""The public face for bare matrices: a certified reduced model, its FRFs and their derivatives, without a campaign file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike

from lrbc_cli.arrays import Complexes, Floats
from lrbc_cli.errors import ConfigError
from lrbc_cli.model.fem import FeModel
from lrbc_cli.model.frf import QUANTITIES
from lrbc_cli.model.terms import KIND_POWER, LowRankTerms, ParameterGroup, Parameterisation
from lrbc_cli.reduction.build import Reduction, ReductionOptions, reduce_model
from lrbc_cli.reduction.reduced.ports import PortFrf
from lrbc_cli.reduction.steps.grid import require_in_band
from lrbc_cli.updating.misfit.frf import port_model


@dataclass(frozen=True)
class TermModel:
    """A certified reduced model of bare matrices: FRFs and derivatives for any values of its low-rank terms.

    Attributes
    ----------
    model : FeModel
    reduction : Reduction
        With its certificate: ``worst``, ``held_out``, ``unseen``.
    """

    model: FeModel
    reduction: Reduction
    _tables: dict[bytes, PortFrf] = field(default_factory=dict, repr=False, init=False)

    def frf(self, hz: ArrayLike, values: ArrayLike) -> Complexes:
        """(F, R) FRFs.

        Parameters
        ----------
        hz : (F,) array
            Lines in the band [Hz].
        values : (nt,) array
            Linear value of each term; ``inf`` clamps.
        """
        s = self._lines(hz)
        kappa = np.broadcast_to(np.asarray(values, dtype=float), (self.model.terms.size,))
        with np.errstate(invalid="ignore"):
            D = np.where(np.isfinite(kappa), np.where(np.isfinite(kappa), kappa, 0.0) * s[:, None] ** self.model.terms.power, np.inf)
        return self._table(s).evaluate(D)

    def sensitivities(self, hz: ArrayLike, log10: ArrayLike) -> tuple[Complexes, Floats]:
        """FRFs and the derivative of their levels to the log10 values.

        Returns
        -------
        y : (F, R) complex array
        J : (F, R, nt) float array
            dB per decade, eq. (35).
        """
        s = self._lines(hz)
        terms = self.model.terms
        p = np.broadcast_to(np.asarray(log10, dtype=float), (terms.size,))
        groups = []
        for kind, power in KIND_POWER.items():
            own = np.flatnonzero(terms.power == power)
            if own.size:
                bounds = np.tile([-np.inf, np.inf], (own.size, 1))
                groups.append(
                    ParameterGroup(
                        name=kind,
                        kind=kind,
                        terms=own,
                        parameter=np.arange(own.size),
                        initial=p[own],
                        bounds=bounds,
                        smoothing=np.eye(own.size),
                    )
                )
        order = np.concatenate([group.terms for group in groups])
        y, J = port_model(self._table(s), Parameterisation(tuple(groups))).sensitivities(p[order])
        return y, np.asarray(J.real[:, :, np.argsort(order)])

    def _table(self, s: Complexes) -> PortFrf:
        """FRFs between ports on the lines s; those of the last lines are kept for whoever optimises."""
        key = s.tobytes()
        if key not in self._tables:
            self._tables.clear()
            self._tables[key] = self.reduction.model.ports(s)
        return self._tables[key]

    def _lines(self, hz: ArrayLike) -> Complexes:
        lines = np.atleast_1d(np.asarray(hz, dtype=float))
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
) -> TermModel:
    """Reduce bare matrices with low-rank terms, eqs. (3)-(5): no parameter is sampled, every value of the terms is served.

    Parameters
    ----------
    K, M, C : (n, n) arrays, sparse or dense
        Stiffness and mass without the terms; damping, none where None.
    loads : (n, n_in) array
    outputs : (n_out, n) array
    terms : (n, nt) array
        Left vectors b of ``value * b cᵀ``.
    band_hz : (float, float)
    right : (n, nt) array or None
        Right vectors c; the left ones where None.
    kind : str or sequence of str
        ``stiffness``, ``damping`` or ``mass``: of all terms, or of each.
    load_of : (n_out,) int array or None
        Column of ``loads`` that each output belongs to; None where there is one load.
    quantity : str
        Of all outputs: ``displacement``, ``velocity``, ``acceleration`` or ``pressure``.
    acoustic : (n,) bool array or None
        Which DOFs are pressures.
    tolerance : float
        Measured relative error of the responses, per line and quantity.

    Returns
    -------
    TermModel

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
    stiffness, left, B, L = sp.csc_array(K), sp.csc_array(terms), sp.csc_array(loads), sp.csc_array(outputs)
    n, nt = stiffness.shape[0], left.shape[1]
    kinds = [kind] * nt if isinstance(kind, str) else list(kind)
    _require_known("kind", kinds, KIND_POWER)
    _require_known("quantity", [quantity], QUANTITIES)
    expected, given = (L.shape[0],), np.zeros(L.shape[0], dtype=np.int64) if load_of is None else np.asarray(load_of, dtype=np.int64)
    if len(kinds) != nt or given.shape != expected or np.any((given < 0) | (given >= B.shape[1])) or (load_of is None and B.shape[1] != 1):
        raise ConfigError(
            "kinds or loads do not fit",
            expected=f"a kind for each of {nt} terms, and in load_of a column from 0 to {B.shape[1] - 1} for each of {L.shape[0]} outputs",
        )
    mask = np.zeros(n, dtype=bool) if acoustic is None else np.asarray(acoustic, dtype=bool)
    damping = sp.csc_array((n, n)) if C is None else sp.csc_array(C)
    low_rank = LowRankTerms(
        left=left,
        right=left if right is None else sp.csc_array(right),
        power=np.array([KIND_POWER[k] for k in kinds], dtype=np.int64),
        baseline=np.zeros(nt),
    )
    model = FeModel(
        K=stiffness,
        C=damping,
        M=sp.csc_array(M),
        B=B,
        L=L,
        output_power=np.full(L.shape[0], QUANTITIES[quantity]),
        is_acoustic=mask,
        terms=low_rank,
    )
    return TermModel(model, reduce_model(model, given, ReductionOptions(band_hz, tolerance)))


def _require_known(name: str, values: Sequence[str], known: Mapping[str, int]) -> None:
    if wrong := [value for value in values if value not in known]:
        raise ConfigError(f"no such {name}", expected=", ".join(known), found=wrong[0])


__all__ = ["TermModel", "reduce"]
