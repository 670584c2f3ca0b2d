"""What measurements can tell of the changes at bolts before there are any: Fisher information, and how clearly a loosened bolt shows.

Every response contributes a sum of its own, so that a set of responses is judged by adding what its members contribute.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from lrbc_cli.arrays import Complexes, Floats, Integers
from lrbc_cli.errors import DataError
from lrbc_cli.updating.misfit.frf import Sensitive
from lrbc_cli.updating.statistics.residuals import DataResidual, ResidualOptions

#: Losses of stiffness that are asked of every bolt [decades]: two thirds, nine tenths and all but a hundredth of it; the one on which the
#: word for a bolt rests, and what responses are worth.
LOSSES, LOSS = (0.5, 1.0, 2.0), 1.0

#: Standard deviation of a line where none is known [dB], noise and model error of a calibrated model, and its correlation factor: see
#: ``Noise``. Identifications of the virtual rigs have factors from 1.5 to 2.4.
SIGMA_DB, FACTOR = 1.0, 2.0

#: Values this far below the strongest of their quantity drown in the noise of the measuring chain [dB].
RANGE_DB = 80.0

#: A bolt is detectable where the probability of a right verdict is at least the first, and not detectable where it is below the second.
DETECTABLE, HIDDEN = 0.8, 0.2

#: Changes smaller than this are none [decades]: the value stands at its bound.
LEAST_CHANGE = 1e-6


@dataclass(frozen=True, kw_only=True)
class Experiment:
    """What each of R responses contributes, of K unknowns and N bolts.

    Attributes
    ----------
    prior : (K, K) float array
        Precision of the unknowns before the measurement.
    columns : (N,) int array
        Unknown of each bolt; -1 where none feels it.
    change : (N,) float array
        Its finite change [decades]; 0 where the bounds allow none.
    tangent : (R, K, K) float array
        Fisher information ``JᵀJ/s²`` about the state.
    secant : (R, K, K) float array
        The same with the columns of the bolts replaced by slopes over their finite changes: about a saturated state a tangent hides
        what neighbours can imitate.
    product : (N, R, K) float array
        ``Jᵀd/s²`` with the secant J and the differences d that the finite change makes.
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
        """Their number R."""
        return int(self.square.shape[1])


def fading(y: NDArray[np.complexfloating], quantity: Sequence[str]) -> Floats:
    """Weights of lines that come near the noise of the measuring chain.

    A floor ``f`` of noise power adds its share to the variance of the level, so that a line counts by ``1/sqrt(1 + f/|y|²)``.

    Parameters
    ----------
    y : (F, R) complex array
    quantity : sequence of str
        Of each response; the floor lies ``RANGE_DB`` below the strongest value of a quantity.

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
    """What measurements are to tell, of K unknowns and N bolts.

    Attributes
    ----------
    T : (size, K) float array
        ``theta + T u`` for the unknowns u, nuisances among them.
    prior : (K, K) float array
        Their precision.
    columns : (N,) int array
        See ``Experiment``.
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
    """Evaluate the model about the state and about the state with each bolt changed.

    Parameters
    ----------
    model : Sensitive
        FRFs of all responses at the lines that are to be compared.
    theta : (size,) float array
    unknowns : Unknowns
    changed : callable
        FRFs with one of the bolts changed, and by how much [decades]: as far as its bounds let it.
    variance : float
        ``s²`` of a residual, correlation included [dB²].
    options : ResidualOptions
        How differences are formed.
    quantity : sequence of str
        Of each response.
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
    """Residuals against FRFs y, and their Jacobian to the unknowns, in standard deviations and one response each."""

    def __init__(self, y: NDArray[np.complexfloating], weights: Floats, T: Floats, options: ResidualOptions) -> None:
        self._residuals, self._weights, self._T = [_data(y[:, [r]], options) for r in range(y.shape[1])], weights, T

    def __call__(self, values: NDArray[np.complexfloating], slopes: Floats) -> list[tuple[Floats, Floats]]:
        """Of other FRFs with their slopes to theta."""
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
    # A response that is silent at a line has no level there: such lines do not count.
    with np.errstate(divide="ignore", invalid="ignore"):
        y, J = model.sensitivities(theta, options.phase)
    return y, np.where(np.isfinite(J), J, 0.0)


def _data(y: NDArray[np.complexfloating], options: ResidualOptions) -> DataResidual | None:
    try:
        return DataResidual(y, options)
    except DataError:
        return None


@dataclass(frozen=True)
class Outlook:
    """What a set of responses can tell of N bolts.

    Attributes
    ----------
    std : (N,) float array
        Standard deviation of the change at a bolt after the measurement, about the state, prior included [decades].
    removed : (N,) float array
        Share of the prior variance that the measurement removes, 0 to 1.
    distance : (N,) float array
        d': how many standard deviations a changed bolt lies from the state, after the other unknowns have explained what they can.
    correct : (N,) float array
        Probability of a verdict that is correct, the other probabilities being of a wrong one or of none: see ``chance``.
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
    """Probability of a correct verdict by the likelihood ratio of changed against unchanged.

    The logarithm of the ratio is normal with mean ``±d'²/2`` and variance ``d'²``; a verdict is given where it says either with at least
    this confidence, both being equally likely beforehand: ``Phi(d'/2 - ln(c/(1-c))/d')``, the same whether the bolt is changed or not.
    """
    away = np.maximum(distance, 1e-12)
    return np.asarray(ndtr(0.5 * away - np.log(confidence / (1.0 - confidence)) / away))


def bits_of(distance: Floats) -> float:
    """``sum ½ log2(1 + d'²)``: by how much the variances of the bolts' changes fall, each expected to be as large as its finite change."""
    return float(0.5 * np.sum(np.log2(1.0 + distance**2)))


def distances(of: Experiment, responses: Sequence[int] | Integers) -> Floats:
    """Give d' of every bolt for a set of responses: ``Outlook.distance``."""
    at = np.asarray(responses, dtype=np.int64)
    whole = of.prior + of.secant[at].sum(axis=0)
    found = np.zeros(of.columns.size)
    for n in np.flatnonzero(of.change):
        others = np.arange(whole.shape[0]) != of.columns[n]
        b = of.product[n, at].sum(axis=0)[others]
        # Least sum of squares where the bolt stays and the others give way, as far as their prior lets them.
        left = of.square[n, at].sum() - b @ _inverse(whole[np.ix_(others, others)]) @ b
        found[n] = np.sqrt(max(float(left), 0.0))
    return found


def outlook(of: Experiment, responses: Sequence[int] | Integers, confidence: float) -> Outlook:
    """Judge a set of responses.

    Parameters
    ----------
    of : Experiment
    responses : sequence of int
        Which of them are measured; none says what the prior says.
    confidence : float
        Probability that a verdict needs.

    Returns
    -------
    Outlook
        Bolts that no unknown feels: no information at all, standard deviation NaN.
    """
    at = np.asarray(responses, dtype=np.int64)
    before, after = _inverse(of.prior), _inverse(of.prior + of.tangent[at].sum(axis=0))
    std, removed = np.full(of.columns.size, np.nan), np.zeros(of.columns.size)
    felt = of.columns >= 0
    c = of.columns[felt]
    std[felt] = np.sqrt(np.maximum(after[c, c], 0.0))
    removed[felt] = np.clip(1.0 - after[c, c] / before[c, c], 0.0, 1.0)
    distance = distances(of, at)
    return Outlook(std, removed, distance, chance(distance, confidence))


def _inverse(precision: Floats) -> Floats:
    # Unknowns that neither data nor prior hold have no finite variance: a share of round-off stands for none.
    if not precision.size:
        return precision
    floor = 1e-12 * max(float(np.diag(precision).max()), np.finfo(float).tiny)
    return np.asarray(np.linalg.inv(precision + floor * np.eye(precision.shape[0])))


def verdict(right: float) -> str:
    """``detectable``, ``marginal`` or ``not detectable``, by the probability of a right verdict."""
    return "detectable" if right >= DETECTABLE else "marginal" if right >= HIDDEN else "not detectable"


def greedy(of: Experiment, most: int = 24) -> list[tuple[int, Floats]]:
    """Responses in the order in which each adds most bits to those before it.

    Parameters
    ----------
    of : Experiment
    most : int
        How many at the most.

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
