"""Compression of a rich basis to the principal directions of its own solutions: a smaller model of nearly the same accuracy."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.linalg as la

from lrbc_cli.arrays import Floats, Integers
from lrbc_cli.reduction.problem.basis import Projection
from lrbc_cli.reduction.problem.problem import Problem
from lrbc_cli.reduction.reduced.sweep import ReducedSolver
from lrbc_cli.reduction.steps.estimate import Estimator, Sweep
from lrbc_cli.reduction.steps.unseen import distance
from lrbc_cli.reduction.threads import in_chunks

#: A smaller basis is compared with the rich one at this many lines spread over the band, and as many with the largest estimates.
CHECKS = 11

#: Factor by which the difference may be larger at the other lines of the grid.
ELSEWHERE = 2.0

#: Factor between successive trial shares of what is left out.
STRIDE = 3.0


@dataclass(frozen=True)
class SweepModes:
    """Principal directions of the reduced solutions in one field.

    Attributes
    ----------
    vectors : (r, r) float array
        Directions as columns, the one with the largest share first.
    tail : (r + 1,) float array
        Element k: share of all solutions (root of the sum of squares) that the first k columns leave out.
    """

    vectors: Floats
    tail: Floats

    @classmethod
    def of(cls, spread: Floats) -> SweepModes:
        """From the (r, r) sum of x xᵀ over normalised solutions x."""
        values, vectors = la.eigh(spread)
        values, vectors = np.maximum(values[::-1], 0.0), vectors[:, ::-1]
        left = np.concatenate([np.cumsum(values[::-1])[::-1], [0.0]])
        return cls(vectors, np.sqrt(left / left[0]) if left[0] > 0 else left)

    def count(self, share: float) -> int:
        """Smallest number of columns that leave out at most this share."""
        return int(np.argmax(self.tail <= share))


class Compressor:
    """Searches the smallest part of a rich basis that keeps y, compared with the rich model only (no full solves).

    Parameters
    ----------
    problem : Problem
    basis : Projection
        The rich basis.
    sweep : Sweep
        Of the rich basis; gives the parameter vectors for the comparison.
    estimator : Estimator
        The estimator that made the sweep.
    limit : float
        Largest relative difference of y.
    """

    def __init__(self, problem: Problem, basis: Projection, sweep: Sweep, estimator: Estimator, limit: float) -> None:
        self._problem, self._limit = problem, limit
        self.modes = [SweepModes.of(spread) for spread in sweep.spread]
        T = la.block_diag(*[modes.vectors for modes in self.modes])
        self._starts = np.cumsum([0, *basis.sizes[:-1]])
        self._structure = problem.structure_of(basis) > 0
        self._turned = [T.T @ A @ T for A in basis.operators]
        self._inputs, self._outputs = T.T @ basis.inputs, basis.outputs @ T
        count = sweep.ports.lines
        checks = max(CHECKS * 100 // max(problem.model.terms.size, 100), 3)
        worst = np.argsort(sweep.estimate, kind="stable")[-checks:]
        at = np.union1d(np.linspace(0, count - 1, min(checks, count)).round().astype(int), worst)
        self._at, self._ports, self._vectors, self._local = at, sweep.ports, sweep.vectors, estimator.local

    def turns(self, counts: Sequence[int]) -> list[Floats]:
        """The (r_f, k_f) matrix of the first ``counts`` principal directions of each field."""
        return [modes.vectors[:, :count] for modes, count in zip(self.modes, counts, strict=True)]

    def error(self, counts: Sequence[int], at: Integers | None = None) -> float:
        """Largest relative difference of y to the rich model with ``counts`` columns in the fields, at grid lines ``at`` (None: all)."""
        problem = self._problem
        # In principal directions the operators of the smaller basis are the leading blocks.
        keep = np.concatenate([start + np.arange(count) for start, count in zip(self._starts, counts, strict=True)])
        K, C, M = (A[np.ix_(keep, keep)] for A in self._turned)
        structure = counts[0] if self._structure else 0
        none = np.zeros((keep.size, 0))
        solver = ReducedSolver((K, C, M), structure, self._inputs[keep], none, symmetric=problem.Z.symmetric)
        at = np.arange(self._ports.lines) if at is None else at
        outputs, s = self._outputs[:, keep] @ solver.turn, self._ports.s[at]
        H = np.empty((s.size, outputs.shape[0], solver.columns), dtype=complex)

        def work(part: slice) -> None:
            H[part] = outputs @ solver.solve(s[part])[0]

        in_chunks(s.size, work, chunk=solver.chunk(s.size))
        rich = self._ports.select(at, np.arange(problem.responses))
        return float(distance(rich, problem.ports(H, s), [D[at] for D in self._vectors], problem.quantities, self._local).max(initial=0.0))

    def search(self, start: float) -> list[int]:
        """Number of columns of each field for the largest share left out that keeps the difference within the limit.

        Parameters
        ----------
        start : float
            First trial share.
        """

        def counts_at(shares: Sequence[float]) -> list[int]:
            return [max(modes.count(share), 1) for modes, share in zip(self.modes, shares, strict=True)]

        def holds(shares: Sequence[float]) -> bool:
            return self.error(counts_at(shares), self._at) <= self._limit

        shares = [start] * len(self.modes)
        if holds(shares):
            while shares[0] < 0.1 and holds([STRIDE * share for share in shares]):
                shares = [STRIDE * share for share in shares]
        else:
            while not holds(shares):
                shares = [share / STRIDE for share in shares]
                if shares[0] < np.finfo(float).eps:
                    return [modes.vectors.shape[1] for modes in self.modes]
        # One field may need fewer columns than the other.
        if len(shares) > 1:
            for field in range(len(shares)):
                coarser = [share * (STRIDE if f == field else 1.0) for f, share in enumerate(shares)]
                if holds(coarser):
                    shares = coarser
        # Check all lines: a resonance between the compared lines may need more columns.
        while shares[0] > np.finfo(float).eps and self.error(counts_at(shares)) > ELSEWHERE * self._limit:
            shares = [share / STRIDE for share in shares]
        return counts_at(shares)

    def within(self, limit: int) -> list[int]:
        """Number of columns of each field, at most ``limit`` together, such that the fields leave out equal shares."""
        shares = np.unique(np.concatenate([modes.tail for modes in self.modes]))
        for share in shares:
            counts = [modes.count(share) for modes in self.modes]
            if sum(counts) <= limit:
                break
        return counts
