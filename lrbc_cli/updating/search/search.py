"""Global search over changes at bolts by tables, since no gradient shows a resonance that jumps past its neighbours.

Stepwise selection with a beam of states: each step is a table of every bolt at several levels (loosened, restored or exchanged). A change
affects few terms, so a table costs little more than one evaluation with all terms. Its best states are starts of descents (``levels``).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from lrbc_cli.arrays import Complexes, Floats
from lrbc_cli.reduction.threads import side_by_side
from lrbc_cli.updating.misfit.cost import Misfit
from lrbc_cli.updating.misfit.frf import FrfModel, Nearby, one_by_one
from lrbc_cli.updating.search.starts import LEVELS
from lrbc_cli.updating.unknowns.shapes import Shapes

#: Changes that are not zero, as pairs of column and change [decades].
Changes = tuple[tuple[int, float], ...]


@dataclass(frozen=True, order=True)
class Combination:
    """A state with changes at some bolts, and its misfit.

    Attributes
    ----------
    misfit_db : float
        Mean absolute difference [dB]: a few lines on a peak that has jumped do not decide, as they would in a sum of squares.
    changes : tuple of (int, float)
        Columns of the shapes, and changes [decades].
    """

    misfit_db: float
    changes: Changes = field(compare=False)


class Search:
    """Misfits of states with changes at some bolts, computed in tables and remembered.

    Parameters
    ----------
    misfit : Misfit
        Its prior is the state without changes.
    shapes : Shapes
    bounds : (size, 2) float array
        Of theta.
    levels : sequence of float
        Changes that are tried [decades], from a slight loss to a nearly free bolt.

    Attributes
    ----------
    columns : list of int
        Columns of the bolts.
    evaluations : int
    """

    def __init__(self, misfit: Misfit, shapes: Shapes, bounds: Floats, levels: Sequence[float]) -> None:
        self._misfit, self._T, self._bounds, self._levels = misfit, shapes.T, bounds, levels
        self.columns = [int(column) for column in np.unique(shapes.bolts[shapes.bolts >= 0])]
        self.evaluations = 0
        self._known: dict[Changes, Combination] = {}
        self._tight: Nearby | None = None

    def theta(self, changes: Changes) -> Floats:
        """(size,) theta of a state, clipped to its bounds."""
        z = np.zeros(self._T.shape[1])
        for column, change in changes:
            z[column] = change
        return np.clip(self._misfit.prior + self._T @ z, *self._bounds.T)

    def _scores(self, frf: Callable[[Floats], Complexes], groups: Iterable[Sequence[Changes]]) -> list[Combination]:
        """Combinations of groups of states; the states of a group differ at the same bolts and are evaluated together."""
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

    def _near(self, changes: Changes) -> Callable[[Floats], Complexes]:
        """Function for the FRFs of states that differ from one with ``changes`` at a further bolt or pair of bolts."""
        model = self._misfit.model
        if not isinstance(model, FrfModel):
            return one_by_one(model.frf)
        if self._tight is None:
            self._tight = model.nearby(self.theta(()))
        return self._tight.at(self.theta(changes)) if changes else self._tight

    def start(self) -> Combination:
        """The state without changes."""
        return self._scores(one_by_one(self._misfit.model.frf), [[()]])[0]

    def table(self, state: Combination, pairs: Sequence[tuple[int, int]] = ()) -> list[Combination]:
        """States that differ from ``state`` at one bolt, or at a pair of bolts alike: each at all levels, and unchanged."""
        moved, levels = [*((column,) for column in self.columns), *pairs], (0.0, *self._levels)
        frf, own = self._near(state.changes), dict(state.changes)
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
    """States with loosened bolts that are nearest to a measurement by their mean misfit, as starts of descents.

    Parameters
    ----------
    misfit : Misfit
    shapes : Shapes
    bounds : (size, 2) float array
    neighbours : sequence of (int, int)
        Pairs of columns of neighbouring bolts; the first table also changes these together.
    names, levels : sequences of str and float
        Names of the bolts, None for numbers; changes that are tried [decades].
    width, kept : int
        Number of states in the beam, and of states returned. None for 8 among joints (by trial on virtual rigs: with misfits from 7 dB
        the two best were wrong) and 2 along edges, where descents can move a change from hat to hat.
    gain, exchanged : float, int
        Least relative decrease of the misfit by a step; largest number of changes for which exchanges of bolts are tried.

    Returns
    -------
    dict of str to (size,) float array
        The best states by description, best first.
    int
        Number of evaluations.
    """
    table = Search(misfit, shapes, bounds, levels)
    width = width or (8 if shapes.joints_only else 2)
    if not table.columns:
        return {}, 0

    def exchange(nearest: Sequence[Combination]) -> Iterator[Combination]:
        # Exchanges: each changed bolt is restored once, with a table about that state. If many changed, descents move changes between them.
        few = nearest[0].changes if 1 < len(nearest[0].changes) <= exchanged else ()
        without = [Combination(np.inf, tuple(c for c in nearest[0].changes if c != one)) for one in few]
        return (state for parent in without for state in table.table(parent))

    ends = _climb(table, neighbours, exchange, width, gain)
    called = {int(column): f"bolt {i + 1}" if names is None else names[i] for i, column in enumerate(shapes.bolts)}
    return {_describe(state, called): table.theta(state.changes) for state in ends[:kept]}, table.evaluations


def _changed(own: dict[int, float], other: dict[int, float]) -> Changes:
    return tuple(sorted((column, value) for column, value in (own | other).items() if value))


def _climb(
    table: Search, pairs: Sequence[tuple[int, int]], last: Callable[[Sequence[Combination]], Iterator[Combination]], width: int, gain: float
) -> list[Combination]:
    """Beam of the nearest states, best first, when neither single changes nor those of ``last`` lower the misfit by more than ``gain``.

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
