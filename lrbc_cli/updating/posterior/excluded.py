"""Whether the data exclude that a tight joint lost all its springs, or some of them, whatever the errors of the model.

The posterior of the kinds rests on a model that is nearly right. Here each loss is compared with none as two models that are both wrong:
a likelihood ratio counts no more than its significance, and the level of the joint in the reference state may be in error.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.special import logsumexp

from lrbc_cli.arrays import Floats, Integers
from lrbc_cli.reduction.threads import side_by_side
from lrbc_cli.updating.normal import NORMAL_95
from lrbc_cli.updating.posterior.mixture import MixtureProblem, SpringLoss, Springs, State, priors_of
from lrbc_cli.updating.posterior.samples import LossRatio
from lrbc_cli.updating.statistics.priors import BoltPrior


def loss_ratios(problem: MixtureProblem, prior: BoltPrior, state: State) -> list[LossRatio]:
    """For springs of each tight joint the log likelihood ratio of a typical loss of them against none.

    The springs change by the mean of loose joints, with one linear step of everything else, and the prior of the rest is as without. Some
    springs alone may also have lost no more than the upper quartile, a decade, which changes far less: the larger ratio counts, so that a
    loss that is not excluded is not hidden by another one that is. A ratio is limited by its significance, see ``limited``. The effect of a
    loss grows with the level of these springs in the reference state, which fits a measurement in spite of errors of the model and so takes
    up some of them: the loss also counts from the lower end of the 95 % interval of this level. Of both levels the ratio nearer to zero
    counts, none if they differ in sign; of the covariances at both ends the mean.
    """
    asked = [one for one in problem.springs if not state.kinds[one.joint]]
    if not asked or problem.losses is None or problem.cells is None:
        return []
    compare, cells = problem.losses(state.z), problem.cells
    precision, mean = priors_of(problem, prior, state.kinds)
    slope = precision * (state.z - mean)
    levels = dict.fromkeys((0.0, -NORMAL_95 * problem.level_error))

    def ratios(one: Springs) -> LossRatio:
        change, found = problem.loosened(one.joint, prior), []
        changes = dict.fromkeys((change, max(change, prior.joint_slight_loss)) if one.of else (change,))
        for level in levels:
            of_changes = []
            for each in changes:
                losses = compare(one.terms, each, level)
                seen = [limited(loss, problem.variance, (precision, slope), cells) for loss in losses]
                shown = [limited(as_shown(loss), problem.variance, (precision, 0.0 * slope), cells) for loss in losses]
                of_changes.append(logsumexp([seen, shown], axis=1) - np.log(len(losses)))
            found.append(np.max(of_changes, axis=0))
        seen, shown = np.minimum(np.max(found, axis=0), 0.0) + np.maximum(np.min(found, axis=0), 0.0)
        return LossRatio(one.joint, one.of, float(seen), float(shown))

    return side_by_side(ratios, asked)


def as_shown(loss: SpringLoss) -> SpringLoss:
    """The same if the FRFs were those of the state without the loss."""
    return replace(loss, without=np.zeros_like(loss.without), lost=loss.lost - loss.without)


def limited(loss: SpringLoss, variance: float, prior: tuple[Floats, Floats], cells: Integers) -> float:
    """Log likelihood ratio of a loss against none, limited by its significance.

    Parameters
    ----------
    loss : SpringLoss
    variance : float
        Of the residuals [dB²].
    prior : two (m,) float arrays
        Precision of the unknowns, and the gradient of half the prior's sum of squares in this state.
    cells : (n,) int array
        The parts: response and band of lines of each residual, within which errors of the model are common.

    Returns
    -------
    float
    """
    J, (precision, slope), r = loss.jacobian, prior, np.column_stack([loss.without, loss.lost])
    own = J.T @ r / variance + slope[:, None]
    step = np.linalg.solve(J.T @ J / variance + np.diag(precision), own)
    before, after = 0.5 * ((own * step).sum(axis=0) - (r**2).sum(axis=0) / variance)
    none, lost = (r - J @ step).T
    return _counted(after - before, none**2 - lost**2, variance, cells)


def between(problem: MixtureProblem, before: State, after: State, odds: float) -> float:
    """Log evidence for one state against another that the data add to the prior ``odds`` of their kinds, limited by its significance.

    Both are ends of descents with the covariance of ``problem``.
    """
    ratio = after.evidence - before.evidence - odds
    if problem.cells is None:
        return ratio
    return _counted(ratio, problem.data(before.z)[0] ** 2 - problem.data(after.z)[0] ** 2, problem.variance, problem.cells)


def _counted(ratio: float, apart: Floats, variance: float, cells: Integers) -> float:
    """What counts of a log likelihood ratio; ``apart`` (n,): by how much the squares of the residuals differ [dB²]."""
    parts = np.bincount(np.unique(cells, return_inverse=True)[1], apart / (2.0 * variance)).astype(float)
    most = significant(parts if ratio >= 0.0 else -parts)
    return float(np.clip(ratio, -most, most))


def significant(parts: Floats) -> float:
    """How much of a positive sum of log likelihood ratios (n,) counts.

    Of two models that are both wrong the ratio says which is nearer to the data, and its scatter over parts of the data how sure that is
    (Vuong, Econometrica 57, 1989): with n parts d, z = sum d / sqrt(sum d²), it counts at most z²/2, the exponent of the probability of
    such a sum if either sign were as probable (Efron, J. Am. Stat. Assoc. 64, 1969), and so never more than n/2. A few lines about an
    antiresonance that the model has elsewhere exclude nothing. But one part that says the same as all others, only far louder, raises the
    scatter more than the sum; so the parts may be capped at any size, and the size at which most counts is taken.
    """
    ordered = parts[np.argsort(np.abs(parts))]
    cap, beyond = np.abs(ordered), np.arange(parts.size - 1, -1, -1)
    # With the parts capped at each of their sizes: those below it as they are, those beyond it by their signs.
    total = np.cumsum(ordered) + cap * (np.sign(ordered).sum() - np.cumsum(np.sign(ordered)))
    squares = np.cumsum(ordered**2) + beyond * cap**2
    up = total > 0.0
    # The smaller one of the sum and z²/2.
    return float((0.5 * total[up] ** 2 / np.maximum(squares[up], 0.5 * total[up])).max(initial=0.0))
