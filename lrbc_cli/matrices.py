"""The public face for bare matrices: a certified reduced model, its FRFs and their derivatives, without a campaign file."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike, NDArray

from lrbc_cli.errors import ConfigError
from lrbc_cli.model.fem import FeModel
from lrbc_cli.model.frf import QUANTITIES
from lrbc_cli.model.terms import KIND_POWER, LowRankTerms, ParameterGroup, Parameterisation
from lrbc_cli.reduction.build import Reduction, ReductionOptions, reduce_model
from lrbc_cli.updating.misfit import port_model

Floats = NDArray[np.float64]
Complexes = NDArray[np.complexfloating[Any, Any]]


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

    def frf(self, hz: ArrayLike, values: ArrayLike) -> Complexes:
        """(F, R) FRFs.

        Parameters
        ----------
        hz : (F,) array
            Lines in the band [Hz].
        values : (nt,) array
            Linear value of each term; ``inf`` clamps.
        """
        s = np.asarray(2j * np.pi * np.atleast_1d(np.asarray(hz, dtype=float)))
        kappa = np.broadcast_to(np.asarray(values, dtype=float), (self.model.terms.size,))
        with np.errstate(invalid="ignore"):
            D = np.where(np.isfinite(kappa), np.where(np.isfinite(kappa), kappa, 0.0) * s[:, None] ** self.model.terms.power, np.inf)
        return self.reduction.model.ports(s).evaluate(D)

    def sensitivities(self, hz: ArrayLike, log10: ArrayLike) -> tuple[Complexes, Floats]:
        """FRFs and the derivative of their levels to the log10 values.

        Returns
        -------
        y : (F, R) complex array
        J : (F, R, nt) float array
            dB per decade, eq. (35).
        """
        s = np.asarray(2j * np.pi * np.atleast_1d(np.asarray(hz, dtype=float)))
        terms = self.model.terms
        p = np.broadcast_to(np.asarray(log10, dtype=float), (terms.size,))
        groups = []
        for kind, power in KIND_POWER.items():
            own = np.flatnonzero(terms.power == power)
            if own.size:
                bounds = np.tile([-np.inf, np.inf], (own.size, 1))
                groups.append(ParameterGroup(kind, kind, own, np.arange(own.size), p[own], bounds, np.eye(own.size)))
        order = np.concatenate([group.terms for group in groups])
        y, J = port_model(self.reduction.model.ports(s), Parameterisation(tuple(groups))).sensitivities(p[order])
        return y, np.asarray(J.real[:, :, np.argsort(order)])


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
    kind: str = "stiffness",
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
    kind : str
        ``stiffness``, ``damping`` or ``mass``.
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
    for name, value, known in (("kind", kind, KIND_POWER), ("quantity", quantity, QUANTITIES)):
        if value not in known:
            raise ConfigError(f"no such {name}", expected=", ".join(known), found=value)
    stiffness, left = sp.csc_array(K), sp.csc_array(terms)
    n, nt = stiffness.shape[0], left.shape[1]
    mask = np.zeros(n, dtype=bool) if acoustic is None else np.asarray(acoustic, dtype=bool)
    damping = sp.csc_array((n, n)) if C is None else sp.csc_array(C)
    low_rank = LowRankTerms(
        left=left, right=left if right is None else sp.csc_array(right), power=np.full(nt, KIND_POWER[kind]), baseline=np.zeros(nt)
    )
    L = sp.csc_array(outputs)
    model = FeModel(
        K=stiffness,
        C=damping,
        M=sp.csc_array(M),
        B=sp.csc_array(loads),
        L=L,
        output_power=np.full(L.shape[0], QUANTITIES[quantity]),
        is_acoustic=mask,
        terms=low_rank,
    )
    return TermModel(model, reduce_model(model, np.zeros(L.shape[0], dtype=np.int64), ReductionOptions(band_hz, tolerance)))


__all__ = ["TermModel", "reduce"]
