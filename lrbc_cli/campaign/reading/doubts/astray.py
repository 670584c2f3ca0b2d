"""Detects bolts far from their own springs, and terms far from their DOFs: wrong units, axes, origin or order of a table."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

import numpy as np
import scipy.sparse as sp
from scipy.spatial import cKDTree

from lrbc_cli.arrays import Bools, Floats
from lrbc_cli.campaign.reading.places import CLEARLY_NEARER, EXCHANGES, MILLIMETRES, POLAR, of_polar
from lrbc_cli.errors import listing
from lrbc_cli.io.text.bushings import BushingTable
from lrbc_cli.io.text.tables import ROUNDING
from lrbc_cli.model.dofs import DofTable, PointTable
from lrbc_cli.model.units import length_name

#: Largest number of examples in a message.
_MOST = 4


def beside_their_springs(bolts: PointTable, springs: Floats, owner: Sequence[str], unit: float) -> str | None:
    """Warning if bolts are nearer to the springs of other bolts than to their own, or all shifted by one vector; else None.

    Parameters
    ----------
    bolts : PointTable
    springs : (m, 3) float array
        Positions of the springs [m].
    owner : (m,) sequence of str
        Bolt of each spring.
    unit : float
        Length unit of the file [m].
    """
    names = [name for name in bolts.name if name in owner]
    xyz = bolts.xyz[[bolts.name.index(name) for name in names]]
    if len(names) < 2:
        return None
    own = np.array(owner)[None, :] == np.array(names)[:, None]

    def astray(points: Floats, share: float) -> Bools:
        away = np.linalg.norm(points[:, None] - springs[None], axis=2)
        mine, other = (np.where(mask, away, np.inf).min(axis=1) for mask in (own, ~own))
        found: Bools = other < share * mine
        return found

    lost = np.flatnonzero(astray(xyz, CLEARLY_NEARER))
    middles = np.array([springs[mask].mean(axis=0) for mask in own])
    # Rounded to a nanometre; further digits are rounding errors.
    shift = np.median(middles - xyz, axis=0).round(9)
    added = ", ".join(f"{value / unit:.6g}" for value in shift + 0.0)
    # Whether one shift puts every bolt much nearer to its springs.
    length = float(np.linalg.norm(shift))
    moved = np.linalg.norm(middles - xyz - shift, axis=1).max() < CLEARLY_NEARER * length
    origin = f"the places are probably given from another origin: add ({added}) to all of them"
    if not lost.size:
        # In a regular pattern a common shift need not bring bolts nearer to other springs.
        far = moved and length > CLEARLY_NEARER * float(cKDTree(middles).query(middles, 2)[0][:, 1].min())
        return f"all bolts lie {length / unit:.3g} {length_name(unit)} from their springs, by the same vector; {origin}" if far else None
    ways = {
        "the places are probably in metres: multiply them by 1000": xyz / MILLIMETRES,
        "the places are probably in millimetres: divide them by 1000": xyz * MILLIMETRES,
        POLAR: of_polar(xyz, unit),
        **{f"{axes} are probably exchanged: exchange these columns": xyz[:, order] for axes, order in EXCHANGES.items()},
    }
    # Or the names of the bolts are permuted.
    ways |= {origin: xyz + shift} if moved else {}
    nearest_to = [names.index(owner[int(np.argmin(np.linalg.norm(springs - point, axis=1)))]) for point in xyz]
    if sorted(nearest_to) == list(range(len(names))):
        ways[_exchange_text(names, nearest_to, lost.tolist())] = xyz[np.argsort(nearest_to)]
    ways |= _mirrored(xyz, middles, unit)
    others = [name for name in bolts.name if name not in owner]
    beside = f"; {', '.join(others[:_MOST])} of it have no springs: check whether it is the list of this structure" if others else ""
    # Mirrored places in a nearly regular pattern lie near the springs of other bolts, too. Of two that fit equally, the first is told.
    left = {way: np.linalg.norm(points - middles, axis=1).max() for way, points in ways.items() if not astray(points, 1.0).any()}
    least = min(left.values(), default=0.0) + ROUNDING * float(np.linalg.norm(np.ptp(middles, axis=0)))
    fix = next((way for way, away in left.items() if away <= least), f"correct the places there, or the nodes of the springs{beside}")
    which = listing([names[k] for k in lost], 8)
    lie, its = ("lies", "its") if lost.size == 1 else ("lie", "their")
    return f"{which} {lie} nearer to the springs of other bolts than to {its} own; {fix}"


def _mirrored(xyz: Floats, middles: Floats, unit: float) -> dict[str, Floats]:
    """Texts and places (b, 3) with one coordinate counted from the other side [m]."""
    found = dict[str, Floats]()
    for axis, name in enumerate("xyz"):
        total, turned = float(np.median(xyz[:, axis] + middles[:, axis])), xyz.copy()
        turned[:, axis] = total - xyz[:, axis]
        if np.ptp(xyz[:, axis]) > 0.0:
            found[f"{name} is probably counted from the other side: write {total / unit:.6g} - {name} for {name}"] = turned
    return found


def renumbered_text(table: BushingTable, places: Floats, bolts: PointTable, dofs: DofTable, unit: float) -> str:
    """Warning if all springs lie at their bolts once every node number is one higher or lower, as they do not as stated; else empty.

    Parameters
    ----------
    table : BushingTable
    places : (m, 3) float array
        Positions of the springs [m].
    bolts : PointTable
    dofs : DofTable
    unit : float
        Length unit of the file [m].
    """
    known = [k for k, bolt in enumerate(table.bolt) if bolt in bolts.name]
    if len({table.bolt[k] for k in known}) < 3:
        return ""
    own = bolts.xyz[[bolts.name.index(table.bolt[k]) for k in known]]
    away = np.linalg.norm(places[known] - own, axis=1)
    at = {int(node): dofs.xyz[k] for k, node in enumerate(dofs.node.tolist()) if not dofs.is_acoustic[k]}
    for step, fix in ((-1, "subtract 1 from"), (1, "add 1 to")):
        ends = [[at.get(node + step) for node in (int(table.node_a[k]), table.node_b[k]) if node is not None] for k in known]
        if any(place is None for pair in ends for place in pair):
            continue
        now = np.linalg.norm(np.array([np.mean(np.array(pair), axis=0) for pair in ends]) - own, axis=1)
        if now.max() < CLEARLY_NEARER * float(np.median(away)) and np.all(now <= away + ROUNDING * away.max()):
            side = "lower" if step < 0 else "higher"
            name = length_name(unit)
            return (
                f"springs lie up to {away.max() / unit:.3g} {name} from their bolts, with every node number one {side} "
                f"{now.max() / unit:.3g} {name} at most: the numbers are probably those of another version of the mesh, or counted from "
                f"another first number; {fix} every node_a and node_b"
            )
    return ""


def misnamed_springs(table: BushingTable, places: Floats, bolts: PointTable) -> dict[int, str]:
    """Springs that bear the name of a bolt with another such spring, but lie at a bolt that the table does not have.

    Parameters
    ----------
    table : BushingTable
    places : (m, 3) float array
        Positions of the springs [m].
    bolts : PointTable

    Returns
    -------
    dict of int to str
        The bolt at which each of these springs lies.
    """
    away = np.linalg.norm(places[:, None] - bolts.xyz[None], axis=2)
    nearest = [bolts.name[b] for b in np.argmin(away, axis=1).tolist()]
    springs = list(zip(table.bolt, table.component, nearest, strict=True))
    right = {(bolt, component) for bolt, component, at in springs if bolt == at}
    most = max((float(away[k].min()) for k, (bolt, _, at) in enumerate(springs) if bolt == at), default=0.0)
    return {
        k: at
        for k, (bolt, component, at) in enumerate(springs)
        if at not in table.bolt and (bolt, component) in right and away[k].min() <= most * (1 + ROUNDING)
    }


def misnamed_text(table: BushingTable, found: Mapping[int, str]) -> str:
    """Warning about springs with the name of another bolt (``found``: of ``misnamed_springs``); empty if there are none."""
    at = "; ".join(
        f"line{'s' if len(springs) > 1 else ''} {listing([str(table.lines[k]) for k in springs], 6)}: "
        f"{'springs' if len(springs) > 1 else 'a spring'} of {table.bolt[springs[0]]} at {name}, which has none: write {name} there"
        for name in dict.fromkeys(found.values())
        for springs in [[k for k, other in found.items() if other == name]]
    )
    return f"{at} (the name was probably copied down)" if at else ""


def stray_springs(
    table: BushingTable,
    places: Floats,
    bolts: PointTable,
    dofs: DofTable,
    unit: float,
    *,
    misnamed: Collection[int] = (),
    times: float = 3.0,
) -> str:
    """Warning about a few springs far from their bolts while all others are at theirs; empty if there are none.

    Parameters
    ----------
    table : BushingTable
    places : (m, 3) float array
        Positions of the springs [m].
    bolts : PointTable
    dofs : DofTable
    unit : float
        Length unit of the file [m].
    misnamed : collection of int
        Springs that are left out, because they bear the name of another bolt.
    times : float
        A spring is far if its distance exceeds this multiple of the largest among the others, and a quarter of that to the next bolt.
    """
    known = [k for k, bolt in enumerate(table.bolt) if bolt in bolts.name and k not in misnamed]
    if len(bolts.name) < 3 or len(known) < 4:
        return ""
    own = bolts.xyz[[bolts.name.index(table.bolt[k]) for k in known]]
    away, next_bolt = np.linalg.norm(places[known] - own, axis=1), cKDTree(bolts.xyz).query(own, 2)[0][:, 1]
    order = np.argsort(away)
    # At most a quarter of the springs: if more are far off, the bolts file or the whole table is wrong.
    near = order[: len(known) - len(known) // 4]
    far = [k for k in order[len(near) :].tolist() if away[k] > max(times * away[near].max(), 0.25 * next_bolt[k])]
    if not far:
        return ""
    said = [_far_end(table, known[k], own[k], dofs, unit) for k in sorted(far)[:_MOST]]
    more = f" and {len(far) - _MOST} more" if len(far) > _MOST else ""
    others = f"the other springs are at most {away[near].max() / unit:.3g} {length_name(unit)} from their bolts"
    return f"{'; '.join(said)}{more}; {others}. Check whether a node is mistyped"


def _far_end(table: BushingTable, spring: int, bolt: Floats, dofs: DofTable, unit: float) -> str:
    """Text on the end of a spring that is farther from its bolt, and the node that the other springs of the bolt or the mesh have there."""
    ends = [node for node in (int(table.node_a[spring]), table.node_b[spring]) if node is not None]
    where = [dofs.xyz[np.flatnonzero(dofs.node == node)[0]] for node in ends]
    away = np.linalg.norm(np.array(where) - bolt, axis=1)
    end = int(np.argmax(away))
    column: Sequence[int | None] = table.node_b if end else table.node_a.tolist()
    same = {column[k] for k, name in enumerate(table.bolt) if name == table.bolt[spring] and k != spring} - {None}
    text = f"line {table.lines[spring]}: node {ends[end]} lies {away[end] / unit:.4g} {length_name(unit)} from {table.bolt[spring]}, "
    if len(same) == 1 and same != {ends[end]}:
        return f"{text}whose other springs have node {same.pop()} in this column"
    free = np.flatnonzero(~dofs.is_acoustic & ~np.isin(dofs.node, ends))
    nearest = int(dofs.node[free[np.argmin(np.linalg.norm(dofs.xyz[free] - bolt, axis=1))]])
    return f"{text}whose nearest node is {nearest}"


def _exchange_text(names: Sequence[str], nearest_to: Sequence[int], lost: Sequence[int]) -> str:
    """Text that positions are those of other bolts (``nearest_to``: index of the bolt with the nearest springs), with the remedy."""
    backwards = reversed_order(nearest_to)
    turned = ", ".join(f"{names[k]} at the springs of {names[nearest_to[k]]}" for k in lost[: _MOST if backwards else 8])
    if not backwards:
        return f"the places are those of other bolts ({turned}): exchange the names there, or in the table of springs"
    first, last = ", ".join(names[k] for k in nearest_to[:4]), names[nearest_to[-1]]
    return (
        f"the places are those of other bolts ({turned}{' ...' if len(lost) > _MOST else ''}): probably one of the files numbers them in "
        f"reverse order. In the bolts file write the names in the order {first} ... {last}, or correct those in the table of springs"
    )


def reversed_order(order: Sequence[int]) -> bool:
    """Whether a row or ring of four or more is numbered in reverse, with any starting point."""
    count, first = len(order), order[0]
    turned = [(first - k) % count for k in range(count)]
    return sum(k != other for k, other in enumerate(order)) > 2 and list(order) == turned


def beside_their_dofs(places: Floats, vectors: sp.csc_array, model: Floats) -> str | None:
    """Warning if most terms are not at the DOFs on which their vectors act; else None.

    That is, DOFs of other terms are nearer, or the distances exceed the extent of the terms.

    Parameters
    ----------
    places : (m, 3) float array
        Positions of the terms [m].
    vectors : (n, m) csc_array
    model : (n, 3) float array
        Positions of the DOFs [m].
    """
    acted = [vectors.indices[start:end] for start, end in zip(vectors.indptr[:-1], vectors.indptr[1:], strict=True)]
    trees = [cKDTree(model[at]) for at in acted]
    every, length = cKDTree(model[np.unique(vectors.indices)]), float(np.linalg.norm(np.ptp(places, axis=0)))

    def away(points: Floats) -> Floats | None:
        own = np.array([tree.query(point)[0] for tree, point in zip(trees, points, strict=True)])
        nearer = own > every.query(points)[0] + ROUNDING * length
        return own if 2 * nearer.sum() > len(own) or float(np.median(own)) > length > 0.0 else None

    distance = away(places)
    if distance is None:
        return None
    fixes = {f"with {axes} exchanged they fit; exchange these columns": places[:, order] for axes, order in EXCHANGES.items()}
    fixes["in reverse order they fit; reverse the rows or, if the DOF table is mirrored, correct its coordinates"] = places[::-1]
    fix = next((text for text, points in fixes.items() if away(points) is None), "correct the coordinates, or the order of the rows")
    return f"up to {1e3 * distance.max():.3g} mm from the DOFs that their vectors act on: {fix}"
