"""Bolts whose names go another way round in one file than in the other."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from samples import ROOT, sample

from lrbc_cli.campaign.reading.doubts.astray import (
    beside_their_springs,
    misnamed_springs,
    misnamed_text,
    renumbered_text,
    reversed_order,
    stray_springs,
)
from lrbc_cli.campaign.reading.doubts.names import missing_springs, odd_springs
from lrbc_cli.campaign.reading.doubts.points import NearPoint, beside_nodes, exchanged_axes, shared_places
from lrbc_cli.campaign.reading.inputs import read_as_exported
from lrbc_cli.campaign.reading.places import EXCHANGES, require_near
from lrbc_cli.config import load_campaign
from lrbc_cli.errors import DataError
from lrbc_cli.io.text.bushings import BushingTable
from lrbc_cli.model.dofs import DofTable, PointTable
from lrbc_cli.model.selection import nearest, spacing

RING = np.array([[np.cos(t), np.sin(t), 0.0] for t in 2.0 * np.pi * np.arange(12) / 12])
ROW = np.column_stack([np.arange(7.0), np.zeros((7, 2))])


def told(places: np.ndarray, order: list[int]) -> str:
    names = [f"B{k + 1:02}" for k in range(len(order))]
    return str(beside_their_springs(PointTable(tuple(names), places[order]), places, names, 1.0))


def test_a_ring_that_is_numbered_clockwise() -> None:
    text = told(RING, [0, *range(11, 0, -1)])
    assert "(B02 at the springs of B12, B03 at the springs of B11, B04 at the springs of B10, B05 at the springs of B09 ...)" in text
    assert "numbers them in reverse order. In the bolts file write the names in the order B01, B12, B11, B10 ... B02" in text


def test_a_row_from_its_other_end() -> None:
    assert "in the order B07, B06, B05, B04 ... B01" in told(ROW, list(range(6, -1, -1)))


def test_two_that_are_exchanged_are_no_direction() -> None:
    text = told(RING, [0, 2, 1, *range(3, 12)])
    assert "the places are those of other bolts (B02 at the springs of B03, B03 at the springs of B02): exchange the names there" in text
    assert told(RING, list(range(12))) == "None"


def test_bolts_measured_from_the_other_edge_are_not_numbered_in_reverse() -> None:
    """Mirrored, each lies near the springs of another bolt of a nearly regular pattern, but not at them."""
    border = np.array([[0.02, 0.02], [0.18, 0.02], [0.30, 0.02], [0.50, 0.02], [0.50, 0.36], [0.38, 0.36], [0.20, 0.36], [0.02, 0.36]])
    springs, names = np.column_stack([border, np.zeros(8)]), tuple(f"S{k}" for k in range(1, 9))
    for axis, name, total in ((0, "x", 0.52), (1, "y", 0.41)):
        seen = springs.copy()
        seen[:, axis] = total - seen[:, axis]
        text = str(beside_their_springs(PointTable(names, seen), springs, names, 1.0))
        assert text.endswith(f"; {name} is probably counted from the other side: write {total:g} - {name} for {name}")
    # Names in reverse order fit exactly.
    assert "numbers them in reverse order" in str(beside_their_springs(PointTable(names, springs[::-1]), springs, names, 1.0))


def test_a_square_about_another_origin() -> None:
    """No bolt is nearer to the springs of another one than half as far as to its own."""
    corners = np.array([[0.0, 0.0, 0.0], [1.2, 0.0, 0.0], [1.2, 0.8, 0.0], [0.0, 0.8, 0.0]])
    names = ("F1", "F2", "F3", "F4")

    def beside(shift: np.ndarray) -> str:
        return str(beside_their_springs(PointTable(names, corners + shift), corners, names, 1.0))

    assert beside(np.array([-0.6, -0.4, 0.0])) == (
        "all bolts lie 0.721 m from their springs, by the same vector; the places are probably given from another origin: add "
        "(0.6, 0.4, 0) to all of them"
    )
    # Heads above the sheet; and each off by itself.
    assert beside(np.array([0.0, 0.0, 0.02])) == "None"
    assert beside(0.5 * np.array([[1.0, 1.0, 0.0], [-1.0, 1.0, 0.0], [-1.0, -1.0, 0.0], [1.0, -1.0, 0.0]])) == "None"


@pytest.mark.parametrize(
    ("order", "backwards"), [([3, 2, 1, 0], True), ([1, 0, 3, 2], True), ([0, 3, 2, 1], False), ([1, 2, 3, 0], False), ([2, 1, 0], False)]
)
def test_orders(order: list[int], backwards: bool) -> None:
    """Of four, two that are exchanged could be either; of three, any two."""
    assert reversed_order(order) is backwards


def springs_of(*nodes: int) -> str:
    """What is said of a spring to ground at each of these nodes, of bolts in a row at the nodes 10, 20 and so on."""
    xyz = np.column_stack([np.arange(1, 81) / 10.0, np.zeros((80, 2))])
    dofs = DofTable(np.arange(1, 81), np.array(["UZ"] * 80), xyz)
    bolts = PointTable(tuple(f"B{k}" for k in range(1, 8)), xyz[9:79:10])
    at, count = np.array(nodes), len(nodes)
    table = BushingTable(
        path=Path("bushings.csv"),
        lines=tuple(range(2, 2 + count)),
        bolt=bolts.name[:count],
        node_a=at,
        node_b=(None,) * count,
        component=("UZ",) * count,
        stiffness=np.ones(count),
        axes=np.broadcast_to(np.eye(3), (count, 3, 3)),
    )
    return stray_springs(table, xyz[at - 1], bolts, dofs, 1.0)


def test_a_spring_at_a_mistyped_node() -> None:
    text = springs_of(10, 20, 3, 40, 50, 60, 70)
    assert text.startswith("line 4: node 3 lies 2.7 m from B3, whose nearest node is 30; the other springs are at most 0 m from ")


@pytest.mark.parametrize(("others", "advice"), [(0, "whose nearest node is 131"), (2, "whose other springs have node 131 in this column")])
def test_a_mistyped_node_of_a_spring_between_two_nodes(others: int, advice: str) -> None:
    """The end that is far off is named, not that at the bolt; and the node of the other springs of the bolt, else the nearest."""
    line = np.column_stack([0.1 * np.arange(80), np.zeros(80), np.zeros(80)])
    xyz = np.vstack([line, line + np.array([0.0, 0.0, 0.01])])
    nodes = np.arange(1, 81)
    dofs = DofTable(node=np.concatenate([nodes, nodes + 100]), component=np.full(160, "UZ"), xyz=xyz)
    at = [11, 21, 31, 41, 51, 61, 71]
    bolts = PointTable(tuple(f"B{k}" for k in range(1, 8)), line[[node - 1 for node in at]])
    pairs = [(f"B{k + 1}", node, node + 100) for k, node in enumerate(at)]
    pairs[2] = ("B3", 31, 171)
    pairs += [("B3", 31, 131)] * others
    table = BushingTable(
        path=Path("bushings.csv"),
        lines=tuple(range(2, 2 + len(pairs))),
        bolt=tuple(pair[0] for pair in pairs),
        node_a=np.array([pair[1] for pair in pairs]),
        node_b=tuple(pair[2] for pair in pairs),
        component=("UZ",) * len(pairs),
        stiffness=np.ones(len(pairs)),
        axes=np.broadcast_to(np.eye(3), (len(pairs), 3, 3)),
    )
    node_at = {int(node): place for node, place in zip(dofs.node, xyz, strict=True)}
    places = np.array([0.5 * (node_at[a] + node_at[b]) for _, a, b in pairs])
    text = stray_springs(table, places, bolts, dofs, 1.0)
    assert text.startswith(f"line 4: node 171 lies 4 m from B3, {advice}; ")


def test_springs_beside_their_bolts_are_no_mistyped_nodes() -> None:
    """All at the next node or the one after it, one as far as the others; nor where half of the table is elsewhere."""
    assert springs_of(11, 21, 32, 41, 51, 61, 71) == ""
    assert springs_of(10, 20, 30, 42, 50, 60, 70) == ""
    assert springs_of(10, 20, 30, 3, 4, 5, 70) == ""


def named(*names: str) -> tuple[dict[int, str], str]:
    """Springs found under another name, of one UZ spring at each of seven bolts of a row, whose lines have these names."""
    bolts = PointTable(tuple(f"B{k}" for k in range(1, 8)), ROW)
    table = BushingTable(
        path=Path("bushings.csv"),
        lines=tuple(range(2, 9)),
        bolt=names,
        node_a=np.arange(1, 8),
        node_b=(None,) * 7,
        component=("UZ",) * 7,
        stiffness=np.ones(7),
        axes=np.broadcast_to(np.eye(3), (7, 3, 3)),
    )
    found = misnamed_springs(table, ROW, bolts)
    return found, misnamed_text(table, found)


def test_a_name_copied_down_is_told_apart_from_a_mistyped_node() -> None:
    assert named("B1", "B2", "B3", "B3", "B5", "B6", "B7") == (
        {3: "B4"},
        "line 5: a spring of B3 at B4, which has none: write B4 there (the name was probably copied down)",
    )
    # Two names exchanged, and bolts without another line of their own, are other mistakes.
    assert named("B1", "B2", "B4", "B3", "B5", "B6", "B7")[0] == {}
    assert named("B1", "B2", "B3", "A4", "B5", "B6", "B7")[0] == {}


#: A box of beams in three different sizes, with bolts along it.
BOX = np.array([[x, y, z] for x in (0.0, 0.3, 0.6) for y in (0.0, 0.25) for z in (0.0, 0.1, 0.2, 0.9)])


@pytest.mark.parametrize("axes", list(EXCHANGES))
def test_exchanged_axes_of_a_table_or_of_the_points(axes: str) -> None:
    dofs = DofTable(node=np.arange(BOX.shape[0]), component=np.full(BOX.shape[0], "UX"), xyz=BOX[:, EXCHANGES[axes]])
    right = DofTable(node=dofs.node, component=dofs.component, xyz=BOX)

    def points(table: DofTable, offset: float) -> list[NearPoint]:
        found = []
        for place in BOX[[3, 10, 14, 23]] + offset:
            dof, distance = nearest(table, place, "UX") or (0, np.inf)
            found.append(
                NearPoint(key="a", place=place, component="UX", node=int(table.node[dof]), distance=distance, size=spacing(table, dof))
            )
        return found

    assert exchanged_axes(dofs, points(dofs, 0.0)) == axes
    # Sensors that do not lie at nodes, and a table that is right.
    assert exchanged_axes(dofs, points(dofs, 0.01)) == axes
    assert exchanged_axes(right, points(right, 0.0)) == ""
    assert exchanged_axes(right, points(right, 0.01)) == ""
    assert exchanged_axes(dofs, points(dofs, 0.0)[:1]) == ""


def test_points_beside_nodes_from_another_origin_or_counted_backwards() -> None:
    """Most points, but not all; with no offset at all they were told to lie at nodes."""
    dofs = DofTable(node=np.arange(BOX.shape[0]), component=np.full(BOX.shape[0], "UX"), xyz=BOX)

    def told(move: Callable[[np.ndarray], np.ndarray]) -> tuple[list[str], bool]:
        found = []
        for number, place in enumerate(BOX[[3, 10, 13, 22, 1]]):
            moved = place if number == 4 else move(place)
            dof, distance = nearest(dofs, moved, "UX") or (0, np.inf)
            size = spacing(dofs, dof)
            key = f"responses.a{number}"
            found.append(NearPoint(key=key, place=moved, component="UX", node=dof, distance=distance, size=size))
        return beside_nodes(dofs, found, 1.0)

    turned = np.array([1.0, 1.0, -1.0])
    assert told(lambda place: place) == ([], False)
    (text,), moved = told(lambda place: place * turned + [0.0, 0.0, 0.9])
    assert moved
    assert "with z counted from the other side they lie at nodes. Write 0.9 - z for z in `near`" in text
    (text,), moved = told(lambda place: place - [0.3, 0.125, 0.0])
    assert moved
    assert "with (0.3, 0.125, 0) added to each" in text
    (text,), moved = told(lambda place: place + 0.02)
    assert not moved
    assert text.startswith("4 points of hammer and sensors lie beside the nodes: responses.a0 34.6 mm, ")


@pytest.mark.parametrize(("depth", "told"), [(0.3, True), (0.15, False)])
def test_a_microphone_outside_the_air_of_the_model(depth: float, told: bool) -> None:
    """A cavity that is deeper than modelled; beside a node inside, a microphone is no such sign, nor is a sensor of the structure."""
    air = np.array([[x, y, z] for x in (0.0, 0.1, 0.2) for y in (0.0, 0.1, 0.2) for z in (0.0, -0.1, -0.2)])
    plate = air[air[:, 2] == 0.0]
    component = np.array(["PRES"] * len(air) + ["UZ"] * len(plate))
    dofs = DofTable(node=np.arange(len(component)), component=component, xyz=np.vstack([air, plate]))
    found = []
    for key, kind, place in (("m1", "PRES", [0.1, 0.1, -depth + 0.07]), ("a1", "UZ", [0.1, 0.1, 0.06]), ("a2", "UZ", [0.1, 0.2, 0.0])):
        dof, distance = nearest(dofs, place, kind) or (0, np.inf)
        found.append(
            NearPoint(key=f"responses.{key}", place=np.array(place), component=kind, node=dof, distance=distance, size=spacing(dofs, dof))
        )
    texts, _ = beside_nodes(dofs, found, 1.0)
    assert any("microphones lie outside the air of the model" in text for text in texts) is told
    (first, *_) = texts
    if told:
        assert "x 0 to 0.2, y 0 to 0.2, z -0.2 to 0 m: responses.m1 30.0 mm from its nearest node" in first
    assert sum("responses.m1" in text for text in texts) == 1
    # On a curved wall, of which a mesh has facets.
    facet = NearPoint(key="responses.m2", place=np.array([0.1, 0.1, 0.003]), component="PRES", node=4, distance=0.02, size=0.01)
    (text, *_), _ = beside_nodes(dofs, [facet, found[2]], 1.0)
    assert "outside the air" not in text


@pytest.mark.parametrize(("regular", "away", "told"), [(False, 1.55, True), (True, 1.55, False), (False, 0.7, True), (False, 0.2, False)])
def test_points_beside_nodes_by_one_coordinate_counted_from_elsewhere(regular: bool, away: float, told: bool) -> None:
    """The lines of an irregular mesh leave one shift only; in a regular one the points may as well lie between its nodes.

    Of 0.2 nothing is said, because all points are nearest to their nodes in any case.
    """
    rows = np.arange(12.0) if regular else np.cumsum([0.0, 1.0, 1.3, 0.9, 1.7, 1.1, 0.8, 1.4, 1.2, 0.7, 1.6, 1.0])
    xyz = np.array([[x, y, 0.0] for y in rows for x in range(8)])
    dofs = DofTable(node=np.arange(len(xyz)), component=np.full(len(xyz), "PRES"), xyz=xyz)
    found = []
    for number, (column, row) in enumerate([(0, 2), (3, 4), (5, 7), (6, 10), (2, 5)]):
        place = np.array([column, rows[row] - away, 0.0])
        dof, distance = nearest(dofs, place.tolist(), "PRES") or (0, np.inf)
        key, size = f"responses.m{number}", spacing(dofs, dof)
        found.append(NearPoint(key=key, place=place, component="PRES", node=dof, distance=distance, size=size))
    (text,), moved = beside_nodes(dofs, found, 1.0)
    assert moved is told
    assert (f"with (0, {away:g}, 0) added to each of them they lie at nodes" in text) is told


@pytest.mark.parametrize("step", [-1, 1])
def test_node_numbers_that_are_all_off_by_one(step: int) -> None:
    """Bolts at every third of a row of nodes; springs of a table whose nodes are one beside."""
    nodes = np.arange(1, 30)
    xyz = np.column_stack([0.1 * nodes, np.zeros((29, 2))])
    dofs = DofTable(node=nodes, component=np.full(29, "UZ"), xyz=xyz)
    own = np.array([4, 10, 13, 22])
    bolts = PointTable(tuple("ABCD"), xyz[own - 1] + [0.002, 0.0, 0.0])

    def told(node: np.ndarray) -> str:
        table = BushingTable(
            path=Path("b.csv"),
            lines=(2, 3, 4, 5),
            bolt=tuple("ABCD"),
            node_a=node,
            node_b=(None,) * 4,
            component=("UZ",) * 4,
            stiffness=np.ones(4),
            axes=np.broadcast_to(np.eye(3), (4, 3, 3)),
        )
        return renumbered_text(table, xyz[node - 1], bolts, dofs, 1.0)

    text = told(own - step)
    assert f"with every node number one {'higher' if step > 0 else 'lower'} 0.002 m at most" in text
    assert ("add 1 to every node_a" if step > 0 else "subtract 1 from every node_a") in text
    assert told(own) == ""
    # One mistyped node is no numbering.
    assert told(own - [step, 0, 0, 0]) == ""


def test_bolts_in_polar_coordinates_are_no_millimetres() -> None:
    """Springs at the bolts decide: divided by 1000 the places fit the model, too."""
    angles = np.arange(0.0, 360.0, 30.0)
    ring = 0.21 * np.column_stack([np.cos(np.deg2rad(angles)), np.sin(np.deg2rad(angles)), np.zeros(12)])
    model, names = np.array([[-0.25, -0.25, 0.0], [0.25, 0.25, 0.01]]), [("bolt", f"B{k}") for k in range(12)]
    polar = np.column_stack([np.full(12, 0.21), angles, np.zeros(12)])

    def told(points: np.ndarray, own: np.ndarray | None, unit: float = 1.0) -> str:
        with pytest.raises(DataError) as refused:
            require_near(points, names, model, file=Path("bolts.csv"), own=own, unit=unit)
        return str(refused.value.hint)

    assert "with x as radius and y as angle in degrees they lie at their springs" in told(polar, ring)
    assert "probably millimetres" in told(1000.0 * ring, ring)
    assert told(1000.0 * ring[::-1], ring).startswith("correct the coordinates")
    assert "probably millimetres" in told(1000.0 * ring, None)


def test_a_stray_spring_puts_the_springs_in_doubt(tmp_path: Path) -> None:
    """Then what loosened bolts do not explain in other jobs is not told as exchanged sensors."""
    own = (ROOT / "data_samples/plate/bushings.csv").read_text()
    (tmp_path / "bushings.csv").write_text(own.replace("B2,135,,UZ", "B2,393,,UZ"))
    campaign = load_campaign(
        ROOT / "configs/plate.yaml", [f"parameters.bolts.select.bushings={tmp_path / 'bushings.csv'}", "parameters.bolts.baseline=0"]
    )
    inputs = read_as_exported(campaign)
    assert any("node 393 lies" in text and "from B2" in text for text in inputs.warnings)
    assert inputs.springs_doubt
    assert not sample("plate").springs_doubt


def springs(file: str, bolts: Sequence[str], components: Sequence[str], size: float = 600.0, *, odd: str = "") -> BushingTable:
    """Springs to ground of bolts named after their nodes; those of the bolt ``odd`` are ten times as stiff."""
    lines = [(bolt, component) for bolt in bolts for component in components]
    return BushingTable(
        path=Path(file),
        lines=tuple(range(2, 2 + len(lines))),
        bolt=tuple(bolt for bolt, _ in lines),
        node_a=np.array([int(bolt[1:]) for bolt, _ in lines]),
        node_b=(None,) * len(lines),
        component=tuple(component for _, component in lines),
        stiffness=np.array([10.0 * size if bolt == odd else size for bolt, _ in lines]),
        axes=np.tile(np.eye(3), (len(lines), 1, 1)),
    )


TEN = [f"B{k}" for k in range(1, 11)]
TURNING = DofTable(node=np.repeat(np.arange(1, 11), 3), component=np.array(["UZ", "ROTX", "ROTY"] * 10), xyz=np.zeros((30, 3)))


def test_a_spring_with_a_digit_too_many() -> None:
    """A power of ten beside equal ones; springs that differ by design are not equal."""
    axial = springs("axial.csv", TEN, ["UZ"], 4e6, odd="B4")
    assert list(odd_springs([axial, axial])) == [
        (
            "B4",
            "axial.csv, line 5: UZ of B4 is 10 times the 4e+06 of the others. Check whether a digit is wrong; if it is right, nothing "
            "needs to be done",
        )
    ]
    assert list(odd_springs([springs("axial.csv", TEN, ["UZ"])])) == []
    graded = replace(axial, stiffness=4e6 * np.linspace(0.5, 2.0, 10))
    assert list(odd_springs([graded])) == []
    assert list(odd_springs([springs("axial.csv", TEN[:3], ["UZ"], odd="B2")])) == []


def test_a_bolt_forgotten_in_one_of_two_tables() -> None:
    axial, short = springs("axial.csv", TEN, ["UZ"], 4e6), [name for name in TEN if name != "B7"]
    assert list(missing_springs([axial, springs("rocking.csv", short, ["ROTX", "ROTY"])], TURNING)) == [
        "rocking.csv: no ROTX, ROTY spring of B7, although all 9 other bolts of its kind have one there; B7 has UZ in axial.csv. Check "
        "whether its lines were forgotten. If so, add them: B7,7,,ROTX,600; B7,7,,ROTY,600 (bolt,node_a,node_b,component,stiffness)"
    ]
    # One component of it, also where each group takes one component of one file.
    part = [springs("all.csv", TEN, ["UZ"], 4e6), springs("all.csv", TEN, ["ROTX"]), springs("all.csv", short, ["ROTY"])]
    (text,) = missing_springs(part, TURNING)
    assert "all.csv: no ROTY spring of B7" in text
    assert text.endswith("add it: B7,7,,ROTY,600 (bolt,node_a,node_b,component,stiffness)")


def test_tables_that_serve_some_bolts_only() -> None:
    """Half of them, few in all, another kind of bolt, no DOF for the spring, and names that other warnings tell."""
    axial, short = springs("axial.csv", TEN, ["UZ"], 4e6), [name for name in TEN if name != "B7"]
    rocking = springs("rocking.csv", short, ["ROTX", "ROTY"])
    assert not list(missing_springs([axial, springs("rocking.csv", TEN[:6], ["ROTX"])], TURNING))
    assert not list(missing_springs([axial, springs("rocking.csv", TEN[:1], ["ROTX"])], TURNING))
    assert not list(missing_springs([springs("axial.csv", TEN[:4], ["UZ"]), springs("rocking.csv", TEN[:3], ["ROTX"])], TURNING))
    assert not list(missing_springs([springs("axial.csv", TEN, ["UZ"], 4e6, odd="B7"), rocking], TURNING))
    assert not list(missing_springs([axial, rocking, springs("other.csv", ["B7"], ["ROTY"])], TURNING))
    kept = (TURNING.node != 7) | (TURNING.component == "UZ")
    assert not list(missing_springs([axial, rocking], DofTable(TURNING.node[kept], TURNING.component[kept], TURNING.xyz[kept])))
    assert not list(missing_springs([axial, rocking], TURNING, ["B7"]))
    assert not list(missing_springs([], TURNING))


def test_points_where_nodes_of_two_parts_coincide_are_told_once() -> None:
    """A casing of two halves: nine lines told five places."""
    place: Any = {"place": np.zeros(3), "component": "UZ", "distance": 0.0, "size": 0.01}
    points = [
        NearPoint(key="excitation.H2", node=7, others=(20,), **place),
        NearPoint(key="responses.F1-H1", node=8, others=(21,), **place),
        NearPoint(key="responses.F1-H2", node=8, others=(21,), **place),
        NearPoint(key="responses.F2-H1", node=9, **place),
    ]
    assert shared_places(points) == [
        "several nodes lie at one place, and `near` takes the first (excitation.H2: nodes 7, 20; responses.F1-H1, responses.F1-H2: nodes "
        "8, 21). If they belong to several parts, write {node:, component:} for the part that is meant"
    ]
    assert shared_places(points[3:]) == []
