"""Global search over changes at bolts: a resonance that jumps past its neighbours is seen by no gradient, but by a table of changes.

Forward, backward and exchange steps over single changes (stepwise selection, kept as a beam), each step a table over every bolt at
several levels. A change touches few terms, so that a table costs little more than one evaluation with all of them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from lrbc_cli.arrays import Complexes, Floats
from lrbc_cli.reduction.threads import side_by_side
from lrbc_cli.updating.misfit.cost import Misfit
from lrbc_cli.updating.misfit.frf import FrfModel, one_by_one
from lrbc_cli.updating.search.starts import LEVELS
from lrbc_cli.updating.unknowns.shapes import Shapes

#: A change of each column that is not zero [decades].
Changes = tuple[tuple[int, float], ...]


@dataclass(frozen=True, order=True)
class Combination:
    """Changes at some bolts, and what is left of the measurement there.

    Attributes
    ----------
    misfit_db : float
        Mean absolute difference: a line on a peak that has jumped does not decide, as it does in a sum of squares.
    changes : tuple of (int, float)
        Column of the shapes, and change [decades].
    """

    misfit_db: float
    changes: Changes = field(compare=False)


class Search:
    """Tables of changes about states, and the best of what was seen.

    Parameters
    ----------
    misfit : Misfit
        Its prior is the state from which changes count.
    shapes : Shapes
    bounds : (size, 2) float array
        Of theta.
    levels : sequence of float
        Changes that are tried [decades], from a slight loss to a bolt that is all but free.

    Attributes
    ----------
    columns : list of int
        Of the bolts that are searched.
    evaluations : int
    """

    def __init__(self, misfit: Misfit, shapes: Shapes, bounds: Floats, levels: Sequence[float]) -> None:
        self._misfit, self._T, self._bounds, self._levels = misfit, shapes.T, bounds, levels
        self.columns = [int(column) for column in np.unique(shapes.bolts[shapes.bolts >= 0])]
        self.evaluations = 0
        self._known: dict[Changes, Combination] = {}
        self._tight: Callable[[Floats], Complexes] | None = None

    def theta(self, changes: Changes) -> Floats:
        """Theta there, inside its bounds."""
        z = np.zeros(self._T.shape[1])
        for column, change in changes:
            z[column] = change
        return np.clip(self._misfit.prior + self._T @ z, *self._bounds.T)

    def _scores(self, frf: Callable[[Floats], Complexes], groups: Iterable[Sequence[Changes]]) -> list[Combination]:
        """Those of groups of states, each of which differ at the same bolts."""
        wanted, seen, new = [list(states) for states in groups], set(self._known), list[list[Changes]]()
        for states in wanted:
            unknown = [changes for changes in dict.fromkeys(states) if changes not in seen]
            seen.update(unknown)
            new += [unknown] if unknown else []

        def values(states: list[Changes]) -> list[float]:
            return [self._misfit.mean_db(y) for y in frf(np.stack([self.theta(changes) for changes in states]))]

        for states, found in zip(new, side_by_side(values, new), strict=True):
            for changes, value in zip(states, found, strict=True):
                self._known[changes] = Combination(value if np.isfinite(value) else np.inf, changes)
        self.evaluations += sum(map(len, new))
        return [self._known[changes] for states in wanted for changes in states]

    def _near(self, changes: Changes, states: int) -> Callable[[Floats], Complexes]:
        """FRFs of so many states that differ at a further bolt, or a pair of them, from one with changes.

        Terms are solved for that differ from a state whose inverse is known. States of few changes differ little from the tight one, whose
        inverse serves all tables; to work out another costs as much as four solutions with all terms.
        """
        model = self._misfit.model
        if not isinstance(model, FrfModel):
            return one_by_one(model.frf)
        own = int(np.count_nonzero(self._T[:, self.columns], axis=0).max())
        # Small systems cost about the square of their size.
        more = ((len(changes) + 1) * own) ** 2 - own**2
        if states * more > 4 * self._T.shape[0] ** 2:
            return model.nearby(self.theta(changes))
        if self._tight is None:
            self._tight = model.nearby(self.theta(()))
        return self._tight

    def start(self) -> Combination:
        """No change at all."""
        return self._scores(one_by_one(self._misfit.model.frf), [[()]])[0]

    def table(self, state: Combination, pairs: Sequence[tuple[int, int]] = ()) -> list[Combination]:
        """States that differ at one bolt, or at a pair in the same way: loosened, put back, or at another level."""
        moved, levels = [*((column,) for column in self.columns), *pairs], (0.0, *self._levels)
        frf, own = self._near(state.changes, len(moved) * len(levels)), dict(state.changes)
        return self._scores(frf, ([_changed(own, dict.fromkeys(columns, level)) for level in levels] for columns in moved))


def search(
    misfit: Misfit,
    shapes: Shapes,
    bounds: Floats,
    neighbours: Sequence[tuple[int, int]] = (),
    *,
    names: Sequence[str] | None = None,
    levels: Sequence[float] = LEVELS,
    width: int | None = None,
    kept: int = 3,
    gain: float = 0.03,
    exchanged: int = 4,
) -> tuple[dict[str, Floats], int]:
    """States of loosened bolts that come nearest to a measurement, as starts of a descent.

    Parameters
    ----------
    misfit : Misfit
    shapes : Shapes
    bounds : (size, 2) float array
    neighbours : sequence of (int, int)
        Columns of bolts that may have loosened together.
    names, levels : sequences of str and float
        Of the bolts, None: numbers; changes that are tried [decades].
    width, kept : int
        Lines of descent side by side, and best states returned. 8 among joints (by trial on virtual rigs: from 7 dB on the two best
        led astray), 2 along edges, where descents pass a change on from hat to hat.
    gain, exchanged : float, int
        Share by which a further change has to lower the misfit; changes up to which one bolt is tried for another.

    Returns
    -------
    dict of str to (size,) float array
        The best states, described, the best one first.
    int
        Evaluations.
    """
    table = Search(misfit, shapes, bounds, levels)
    width = width or (8 if shapes.joints_only else 2)
    if not table.columns:
        return {}, 0

    def exchange(nearest: Sequence[Combination]) -> Iterator[Combination]:
        # One bolt for another: each put back once, and all tables without it. Of many, descents move what is left between them.
        few = nearest[0].changes if 1 < len(nearest[0].changes) <= exchanged else ()
        without = [Combination(np.inf, tuple(c for c in nearest[0].changes if c != one)) for one in few]
        return (state for parent in without for state in table.table(parent))

    ends = _climb(table, neighbours, exchange, width, gain)
    called = {int(column): f"bolt {i + 1}" if names is None else names[i] for i, column in enumerate(shapes.bolts)}
    return {_describe(state, called): table.theta(state.changes) for state in ends[:kept]}, table.evaluations


def _changed(own: dict[int, float], other: dict[int, float]) -> Changes:
    return tuple(sorted((column, value) for column, value in (own | other).items() if value))


def _climb(
    table: Search,
    pairs: Sequence[tuple[int, int]],
    last: Callable[[Sequence[Combination]], Iterator[Combination]],
    width: int,
    gain: float,
) -> list[Combination]:
    """Nearest states, the best first, when neither single changes nor those of ``last`` lower the misfit by more than ``gain``.

    The first table also moves ``pairs`` together.
    """
    best = table.start()
    beam = [best]
    while True:
        found = {state.changes: state for parent in beam for state in table.table(parent, pairs)}
        nearest = sorted([*found.values(), *(state for state in beam if state.changes not in found)])[:width]
        pairs = ()
        if not nearest[0].misfit_db < (1.0 - gain) * best.misfit_db:
            nearest = sorted({state.changes: state for state in [*nearest, *last(nearest)]}.values())[:width]
            if not nearest[0].misfit_db < (1.0 - gain) * best.misfit_db:
                return nearest
        best, beam = nearest[0], nearest


def _describe(state: Combination, called: dict[int, str]) -> str:
    parts = [f"{called[column]} by {change:g}" for column, change in state.changes]
    return f"table of changes: {', '.join(parts) or 'none'}"
