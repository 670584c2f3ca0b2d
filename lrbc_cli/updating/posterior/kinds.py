"""Log evidence of the kinds of bolts (tight or loose) for a linear problem, and its gain by flips of kinds, in closed form.

Given the kinds, everything is Gaussian about a linearisation and the changes are integrated out; see ``mixture``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lrbc_cli.arrays import Bools, Floats
from lrbc_cli.updating.statistics.priors import BoltPrior


def along_edges(pairs: Sequence[tuple[int, int]], joint: Bools) -> list[tuple[int, int]]:
    """Those pairs of neighbours whose hats overlap: pairs without a joint."""
    return [(i, j) for i, j in pairs if not (joint[i] or joint[j])]


def adjacency(pairs: Sequence[tuple[int, int]], joint: Bools) -> NDArray[np.int64]:
    """(b, b) matrix with ones for pairs of neighbours along an edge."""
    found = np.zeros((joint.size, joint.size), dtype=np.int64)
    for i, j in along_edges(pairs, joint):
        found[i, j] = found[j, i] = 1
    return found


class _Moves:
    """Sets of bolts that are flipped together, and the bolts whose priors a flip changes; padded to one size, to evaluate all at once."""

    def __init__(self, flips: Sequence[tuple[int, ...]], beside: NDArray[np.int64]) -> None:
        touched = [[*own, *(int(j) for i in own for j in np.flatnonzero(beside[i]) if j not in own)] for own in flips]
        touched = [list(dict.fromkeys(row)) for row in touched]
        width = max((len(row) for row in touched), default=0)
        self.flips = flips
        self.at = np.array([row + [row[0]] * (width - len(row)) for row in touched], dtype=np.int64).reshape(len(flips), width)
        self.real = np.array([[k < len(row) for k in range(width)] for row in touched], dtype=bool).reshape(self.at.shape)
        self.own = np.array([[k < len(own) for k in range(width)] for own in flips], dtype=bool).reshape(self.at.shape)
        # Which flipped bolt of a set is a neighbour of which touched bolt.
        most = max((len(own) for own in flips), default=0)
        self.first = np.array([list(own) + [own[0]] * (most - len(own)) for own in flips], dtype=np.int64).reshape(len(flips), most)
        counts = np.array([[k < len(own) for k in range(most)] for own in flips], dtype=bool).reshape(self.first.shape)
        self.beside = beside[self.at[:, :, None], self.first[:, None, :]] * counts[:, None, :]


@dataclass(frozen=True)
class _Outcome:
    """For each set of flips the gain in log evidence, and mean and standard deviation of the change of its first bolt afterwards."""

    gain: Floats
    mean: Floats
    std: Floats


class KindScore:
    """Log evidence of kinds for the linear problem ``zᵀAz/2 - bᵀz``, and its gain by flips of kinds.

    Parameters
    ----------
    A, b : (b, b) and (b,) float arrays
        Curvature and slope of half the data's sum of squares over the variance, other unknowns marginalised.
    prior : BoltPrior
    loose : (b,) bool array
        First kinds.
    neighbours : sequence of (int, int)
    joint : (b,) bool array
    further : (b,) float array or None
        Log evidence for loose in addition to that of the linear problem, see ``sampling.Beyond``.

    Attributes
    ----------
    loose : (b,) bool array
        Present kinds; all results are given these.
    """

    def __init__(
        self,
        A: Floats,
        b: Floats,
        prior: BoltPrior,
        loose: Bools,
        neighbours: Sequence[tuple[int, int]],
        joint: Bools,
        further: Floats | None = None,
    ) -> None:
        self._A, self._b, self._prior, self._joint = A, b, prior, joint
        self._odds = np.full(b.size, prior.log_odds) + (0.0 if further is None else further)
        self._beside = adjacency(neighbours, joint)
        self._singles = _Moves([(i,) for i in range(b.size)], self._beside)
        self._pairs = _Moves(list(neighbours), self._beside)
        self._precision, self._mean = prior.tables(joint)
        self.loose = loose.copy()
        self._moments: tuple[Floats, Floats] | None = None
        # A chain returns to few sets of kinds again and again.
        self._flips: dict[bytes, tuple[Floats, Floats, Floats]] = {}
        self._swaps: dict[bytes, Floats] = {}

    @property
    def covariance(self) -> Floats:
        """(b, b) covariance of the changes given the kinds."""
        return self._given_kinds()[0]

    @property
    def mean(self) -> Floats:
        """(b,) means of the changes given the kinds [decades]."""
        return self._given_kinds()[1]

    def _given_kinds(self) -> tuple[Floats, Floats]:
        if self._moments is None:
            precision, mean = self._prior.of(self.loose, self._beside, self._joint)
            covariance = np.asarray(np.linalg.inv(self._A + np.diag(precision)))
            self._moments = covariance, covariance @ (self._b + precision * mean)
        return self._moments

    def _outcomes(self, moves: _Moves) -> _Outcome:
        """Low-rank updates: D is the change of the touched bolts' prior precisions, e that of precision times mean."""
        at, kind = moves.at, self.loose.astype(np.int64)
        count = self._beside @ kind
        step = 1 - 2 * kind[moves.first]
        now, after = kind[at], np.where(moves.own, 1 - kind[at], kind[at])
        gap, gap_after = (count[at] > 0).astype(np.int64), (count[at] + (moves.beside * step[:, None, :]).sum(axis=2) > 0).astype(np.int64)
        old, new = self._precision[at, now, gap], self._precision[at, after, gap_after]
        first, last = self._mean[at, now, gap], self._mean[at, after, gap_after]
        D = np.where(moves.real, new - old, 0.0)
        e = np.where(moves.real, new * last - old * first, 0.0)
        offset = 0.5 * (np.log(new / old) - new * last**2 + old * first**2) + (after - now) * self._odds[at]
        covariance, mean = self._given_kinds()
        C = covariance[at[:, :, None], at[:, None, :]]
        grown = np.eye(at.shape[1]) + D[:, :, None] * C
        M = np.linalg.solve(grown, D[:, :, None] * np.eye(at.shape[1]))
        m, moved = mean[at], np.einsum("cij,cj->ci", C, e)
        Mu = np.einsum("cij,cj->ci", M, m + moved)
        gain = np.where(moves.real, offset, 0.0).sum(axis=1) - 0.5 * np.log(np.linalg.det(grown))
        gain += (e * (m + 0.5 * moved) - 0.5 * (m + moved) * Mu).sum(axis=1)
        row = C[:, 0]
        variance = row[:, 0] - np.einsum("ci,cij,cj->c", row, M, row)
        return _Outcome(gain, m[:, 0] + (row * (e - Mu)).sum(axis=1), np.sqrt(np.maximum(variance, 0.0)))

    def flips(self) -> tuple[Floats, Floats, Floats]:
        """(b,) gain in log evidence by each single flip, and (b, 2) mean and standard deviation of each change, if tight and if loose."""
        if (key := self.loose.tobytes()) not in self._flips:
            other, (covariance, mean), loose = self._outcomes(self._singles), self._given_kinds(), self.loose
            std = np.sqrt(np.diag(covariance))
            means = np.column_stack([np.where(loose, other.mean, mean), np.where(loose, mean, other.mean)])
            self._flips[key] = other.gain, means, np.column_stack([np.where(loose, other.std, std), np.where(loose, std, other.std)])
        return self._flips[key]

    def swaps(self) -> Floats:
        """(p,) gain in log evidence by flipping both bolts of each of the p pairs of neighbours."""
        if (key := self.loose.tobytes()) not in self._swaps:
            self._swaps[key] = self._outcomes(self._pairs).gain if self._pairs.flips else np.zeros(0)
        return self._swaps[key]

    def flip(self, *bolts: int) -> None:
        """Change the kind of these bolts."""
        for i in bolts:
            self.loose[i] = not self.loose[i]
        self._moments = None


def improve(score: KindScore, neighbours: Sequence[tuple[int, int]], moves: int, least_gain: float = 0.01) -> None:
    """Greedy search: flip a bolt, or swap neighbours of different kinds, up to ``moves`` times, while the gain exceeds ``least_gain``."""
    for _ in range(moves):
        gains = score.flips()[0]
        best: tuple[float, tuple[int, ...]] = (float(gains.max()), (int(gains.argmax()),))
        for (i, j), gain in zip(neighbours, score.swaps().tolist(), strict=True):
            if score.loose[i] != score.loose[j]:
                best = max(best, (gain, (i, j)))
        if best[0] <= least_gain:
            return
        score.flip(*best[1])
