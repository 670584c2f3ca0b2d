"""Prediction before a measurement (``lrbc plan``): Fisher information on the changes at bolts, and how detectable a loosened bolt is.

Each response adds its own terms to the sums, so a set of responses is judged by adding the contributions of its members.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from lrbc_cli.arrays import Complexes, Floats, Integers
from lrbc_cli.errors import DataError
from lrbc_cli.updating.misfit.frf import Sensitive
from lrbc_cli.updating.statistics.residuals import DataResidual, ResidualOptions

#: Losses of stiffness that are examined for every bolt [decades]: two thirds, nine tenths and 99 %. The second constant is the loss that
#: decides whether a bolt is detectable, and by which responses are ranked.
LOSSES, LOSS = (0.5, 1.0, 2.0), 1.0

#: Standard deviation of a line if none is known [dB], for noise and model error of a calibrated model, and its correlation factor, see
#: ``Noise``. Identifications of virtual rigs have factors from 1.5 to 2.4.
SIGMA_DB, FACTOR = 1.0, 2.0

#: Distance of the noise of the measuring chain from the strongest value of a physical quantity [dB].
RANGE_DB = 80.0

#: A bolt is detectable if the probability of a correct verdict is at least the first, and not detectable if it is below the second.
DETECTABLE, HIDDEN = 0.8, 0.2

#: Smaller changes count as none, because the value is at its bound [decades].
LEAST_CHANGE = 1e-6


@dataclass(frozen=True, kw_only=True)
class Experiment:
    """Contributions of each of R responses to the information on K unknowns, N of which may be changes at bolts.

    Attributes
    ----------
    prior : (K, K) float array
        Precision of the unknowns before the measurement.
    columns : (N,) int array
        Unknown of each bolt; -1 if no term reaches it.
    change : (N,) float array
        Finite change of each bolt [decades]; 0 if the bounds allow none.
    tangent : (R, K, K) float array
        Fisher information ``JᵀJ/s²`` at the state.
    secant : (R, K, K) float array
        The same with the columns of the bolts replaced by difference quotients over their finite changes: at a saturated state the
        tangents do not show how far neighbours can imitate a change.
    product : (N, R, K) float array
        ``Jᵀd/s²`` with the secant J and the differences d caused by the finite change of a bolt.
    square : (N, R) float array
        ``dᵀd/s²``.
    """

    prior: Floats
    columns: Integers
    change: Floats
    tangent: Floats
    secant: Floats
    product: Floats
    square: Floats

    @property
    def responses(self) -> int:
        """Number of responses R."""
        return int(self.square.shape[1])


def fading(y: NDArray[np.complexfloating], quantity: Sequence[str]) -> Floats:
    """Weights of lines near the noise floor of the measuring chain: ``1/sqrt(1 + f/|y|²)`` with the noise power f.

    Parameters
    ----------
    y : (F, R) complex array
    quantity : sequence of str
        Physical quantity of each response; f is ``RANGE_DB`` below the strongest value of a quantity.

    Returns
    -------
    (F, R) float array
        0 where y is.
    """
    power = np.abs(y) ** 2
    kinds = np.array(quantity)
    floor = np.zeros(power.shape[1])
    for kind in dict.fromkeys(quantity):
        floor[kinds == kind] = power[:, kinds == kind].max() * 10.0 ** (-RANGE_DB / 10.0)
    return np.asarray(np.sqrt(np.divide(power, power + floor, out=np.zeros_like(power), where=power > 0)))


@dataclass(frozen=True)
class Unknowns:
    """The K unknowns u of a planned measurement, ``theta + T u``.

    Attributes
    ----------
    T : (size, K) float array
        Nuisance parameters included.
    prior : (K, K) float array
        Prior precision of u.
    columns : (N,) int array
        Unknown of each of N bolts, see ``Experiment``.
    """

    T: Floats
    prior: Floats
    columns: Integers


def experiment(
    model: Sensitive,
    theta: Floats,
    unknowns: Unknowns,
    changed: Callable[[int], tuple[Complexes, float]],
    *,
    variance: float,
    options: ResidualOptions,
    quantity: Sequence[str],
) -> Experiment:
    """Contributions of all responses, from the model at the state theta and with each bolt changed.

    Parameters
    ----------
    model : Sensitive
        FRFs of all responses at the lines to be compared.
    theta : (size,) float array
    unknowns : Unknowns
    changed : callable
        From the index of a bolt to the FRFs (F, R) with this bolt changed, and its change as far as its bounds allow [decades].
    variance : float
        ``s²`` of a residual, correlation included [dB²].
    options : ResidualOptions
        How differences are formed.
    quantity : sequence of str
        Physical quantity of each response.

    Returns
    -------
    Experiment
    """
    N, K = unknowns.columns.size, unknowns.T.shape[1]
    y, J = _evaluate(model, theta, options)
    scaled = _Scaled(y, fading(y, quantity) / np.sqrt(variance), unknowns.T, options)
    tight = [rows for _, rows in scaled(y, J)]
    chords = [rows.copy() for rows in tight]
    square, moved = np.zeros((N, len(tight))), np.zeros(N)
    differences: dict[int, list[Floats]] = {}
    for n in np.flatnonzero(unknowns.columns >= 0).tolist():
        there, by = changed(n)
        if abs(by) < LEAST_CHANGE:
            continue
        differences[n] = [d for d, _ in scaled(there, J)]
        moved[n], square[n] = by, [d @ d for d in differences[n]]
        for rows, d in zip(chords, differences[n], strict=True):
            rows[:, unknowns.columns[n]] = d / by
    product = np.zeros((N, len(tight), K))
    for n, parts in differences.items():
        product[n] = [rows.T @ d for rows, d in zip(chords, parts, strict=True)]
    return Experiment(
        prior=unknowns.prior,
        columns=unknowns.columns,
        change=moved,
        tangent=np.array([rows.T @ rows for rows in tight]),
        secant=np.array([rows.T @ rows for rows in chords]),
        product=product,
        square=square,
    )


class _Scaled:
    """Residuals relative to FRFs y and their Jacobian to the unknowns, in standard deviations, for each response separately."""

    def __init__(self, y: NDArray[np.complexfloating], weights: Floats, T: Floats, options: ResidualOptions) -> None:
        self._residuals, self._weights, self._T = [_data(y[:, [r]], options) for r in range(y.shape[1])], weights, T

    def __call__(self, values: NDArray[np.complexfloating], slopes: Floats) -> list[tuple[Floats, Floats]]:
        """Residual (m,) and Jacobian (m, K) of each response, for FRFs ``values`` (F, R) with derivatives ``slopes`` (F, R, size)."""
        found = []
        for r, residual in enumerate(self._residuals):
            if residual is None:
                found.append((np.zeros(0), np.zeros((0, self._T.shape[1]))))
                continue
            own, rows, _ = residual(values[:, [r]], slopes[:, [r]])
            weight = np.tile(self._weights[:, [r]][residual.valid], own.size // int(residual.valid.sum()))
            found.append((weight * own, weight[:, None] * rows @ self._T))
        return found


def _evaluate(model: Sensitive, theta: Floats, options: ResidualOptions) -> tuple[NDArray[np.complexfloating], Floats]:
    # A response that is zero at a line has no level there: its derivatives are set to zero.
    with np.errstate(divide="ignore", invalid="ignore"):
        y, J = model.sensitivities(theta, options.phase)
    return y, np.where(np.isfinite(J), J, 0.0)


def _data(y: NDArray[np.complexfloating], options: ResidualOptions) -> DataResidual | None:
    try:
        return DataResidual(y, options)
    except DataError:
        return None


@dataclass(frozen=True, kw_only=True)
class Outlook:
    """Information of a set of responses on N bolts.

    Attributes
    ----------
    std : (N,) float array
        Posterior standard deviation of the change at a bolt about the state [decades].
    removed : (N,) float array
        Share of the prior variance that the measurement removes, 0 to 1.
    distance : (N,) float array
        d': effect of a bolt's finite change on the FRFs, in standard deviations, after the other unknowns have imitated what they can.
    correct : (N,) float array
        Probability of a correct verdict, see ``chance``; the rest is that of a wrong one or of none.
    """

    std: Floats
    removed: Floats
    distance: Floats
    correct: Floats

    @property
    def bits(self) -> float:
        """See ``bits_of``."""
        return bits_of(self.distance)


def chance(distance: Floats, confidence: float) -> Floats:
    """Probability of a correct verdict by the likelihood ratio of changed to unchanged, ``Phi(d'/2 - ln(c/(1-c))/d')``.

    The logarithm of the ratio is normal with mean ``±d'²/2`` and variance ``d'²``. A verdict is given if either hypothesis has at least
    the posterior probability c (``confidence``), with equal prior probabilities. The result holds for changed and unchanged bolts alike.
    """
    away = np.maximum(distance, 1e-12)
    return np.asarray(ndtr(0.5 * away - np.log(confidence / (1.0 - confidence)) / away))


def bits_of(distance: Floats) -> float:
    """Information of a measurement in bits, ``sum ½ log2(1 + d'²)``, if the prior standard deviation of a change is its finite change."""
    return float(0.5 * np.sum(np.log2(1.0 + distance**2)))


def distances(of: Experiment, responses: Sequence[int] | Integers) -> Floats:
    """(N,) d' of every bolt for a set of responses, see ``Outlook.distance``."""
    at = np.asarray(responses, dtype=np.int64)
    whole = of.prior + of.secant[at].sum(axis=0)
    found = np.zeros(of.columns.size)
    for n in np.flatnonzero(of.change):
        others = np.arange(whole.shape[0]) != of.columns[n]
        b = of.product[n, at].sum(axis=0)[others]
        # Least sum of squares when the other unknowns imitate the change of this bolt, at the cost of their prior.
        left = of.square[n, at].sum() - b @ _inverse(whole[np.ix_(others, others)]) @ b
        found[n] = np.sqrt(max(float(left), 0.0))
    return found


def outlook(of: Experiment, responses: Sequence[int] | Integers, confidence: float) -> Outlook:
    """Information of a set of responses on all bolts.

    Parameters
    ----------
    of : Experiment
    responses : sequence of int
        Those that are measured; an empty sequence gives the prior.
    confidence : float
        Posterior probability that a verdict needs.

    Returns
    -------
    Outlook
        For bolts without an unknown the standard deviation is NaN and all else zero.
    """
    at = np.asarray(responses, dtype=np.int64)
    before, after = _inverse(of.prior), _inverse(of.prior + of.tangent[at].sum(axis=0))
    std, removed = np.full(of.columns.size, np.nan), np.zeros(of.columns.size)
    felt = of.columns >= 0
    c = of.columns[felt]
    std[felt] = np.sqrt(np.maximum(after[c, c], 0.0))
    removed[felt] = np.clip(1.0 - after[c, c] / before[c, c], 0.0, 1.0)
    distance = distances(of, at)
    return Outlook(std=std, removed=removed, distance=distance, correct=chance(distance, confidence))


def _inverse(precision: Floats) -> Floats:
    # Unknowns without data and prior have no finite variance: a precision far below the largest one keeps the matrix regular.
    if not precision.size:
        return precision
    floor = 1e-12 * max(float(np.diag(precision).max()), np.finfo(float).tiny)
    return np.asarray(np.linalg.inv(precision + floor * np.eye(precision.shape[0])))


def verdict(right: float) -> Literal["detectable", "marginal", "not detectable"]:
    """``detectable``, ``marginal`` or ``not detectable``, by the probability of a correct verdict."""
    return "detectable" if right >= DETECTABLE else "marginal" if right >= HIDDEN else "not detectable"


def greedy(of: Experiment, most: int = 24) -> list[tuple[int, Floats]]:
    """Responses in the order in which each adds the most bits to those before it (greedy selection).

    Parameters
    ----------
    of : Experiment
    most : int
        Largest number of responses.

    Returns
    -------
    list of (response, d' of every bolt with it and those before it)
    """
    left, found = list(range(of.responses)), list[tuple[int, Floats]]()
    while left and len(found) < most:
        before = [r for r, _ in found]
        trials = [(r, distances(of, [*before, r])) for r in left]
        found.append(max(trials, key=lambda trial: bits_of(trial[1])))
        left.remove(found[-1][0])
    return found
