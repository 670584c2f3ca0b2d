"""What is drawn of a structure: nodes, sides of its elements, and what the campaign places on them."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from campaigns import box, chain_folder
from campaigns import frame as new_frame
from grillage import grillage

from lrbc_cli.campaign.structure import neighbours, structure_of, thinned, without_chords
from lrbc_cli.errors import DataError
from lrbc_cli.results.store import read, write_sealed
from lrbc_cli.results.structure import StructureRecord


def test_the_frame(tmp_path: Path) -> None:
    record = structure_of(new_frame(tmp_path / "frame").inputs())
    assert record.reason is None
    assert record.notes == ()
    (plate,) = record.fields
    assert (plate.field, plate.count, len(plate.xyz)) == ("structure", 108, 108)
    # The grid of 12 by 9 nodes, without the diagonals of its elements.
    pairs = np.array(plate.lines).reshape(-1, 2)
    assert len(pairs) == 8 * 12 + 11 * 9
    steps = np.abs(plate.xyz[pairs[:, 0]] - plate.xyz[pairs[:, 1]])
    np.testing.assert_allclose(np.sort(steps, axis=1), np.tile([0.0, 0.0, 0.04], (len(pairs), 1)), atol=1e-6)
    (hammer,) = record.excitations
    np.testing.assert_allclose([hammer.position, hammer.direction], [[0.16, 0.12, 0.0], [0, 0, 1]], atol=1e-6)
    assert [point.used for point in record.responses] == [True, True, True, False]
    # A row between nodes: inside its element.
    np.testing.assert_allclose(record.responses[2].position, [0.21, 0.33, 0.0], atol=0.006)
    assert [bolt.name for bolt in record.bolts] == [f"B{k}" for k in range(1, 7)]
    (edge,) = record.terms
    assert (edge.name, edge.kind, edge.along_edge, len(edge.positions), len(edge.springs)) == ("left_edge", "stiffness", True, 10, 0)
    # What is read is what was written.
    record = write_sealed(tmp_path / "structure.json", record)
    assert (again := read(tmp_path / "structure.json", StructureRecord)) is not None
    assert again.tree() == record.tree()


def test_air_is_apart_and_without_lines(tmp_path: Path) -> None:
    fields = {field.field: field for field in structure_of(box(tmp_path / "box").inputs()).fields}
    assert (fields["structure"].count, fields["acoustic"].count) == (8, 24)
    assert len(fields["structure"].lines) == 14
    assert fields["acoustic"].lines == ()


def test_springs_join_their_nodes(tmp_path: Path) -> None:
    folder = grillage(tmp_path / "joints", ())
    (folder.data / "two.csv").write_text("bolt,node_a,node_b,component,stiffness\nB1,1,11,UZ,4e5\nB5,21,,UZ,4e5\n")
    tree = folder.tree()
    tree["parameters"] = {"springs": {"select": {"bushings": "data/two.csv"}}}
    tree.pop("bolts", None)
    folder.write(tree)
    record = structure_of(folder.inputs())
    (terms,) = record.terms
    np.testing.assert_allclose(terms.springs, [[0, 0, 0], [0.1, 0, 0]], atol=1e-6)
    assert not terms.along_edge
    np.testing.assert_allclose(terms.positions, [[0.05, 0, 0], [0.2, 0, 0]], atol=1e-6)
    assert [bolt.name for bolt in record.bolts] == ["B1", "B5"]


def test_without_coordinates_there_is_a_reason(tmp_path: Path) -> None:
    record = structure_of(chain_folder(tmp_path / "chain").inputs())
    assert "no coordinates" in str(record.reason)
    assert record.fields == ()


@pytest.mark.parametrize("seed", [0, 1])
def test_many_nodes_are_thinned_and_keep_the_outline(seed: int) -> None:
    x, y = np.meshgrid(np.linspace(0.0, 1.2, 61), np.linspace(0.0, 0.8, 41))
    xyz = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, 0.3)])
    xyz = np.random.default_rng(seed).permutation(xyz + seed * 1e-4 * np.random.default_rng(3).normal(size=xyz.shape) * [1, 1, 0])
    group, kept = thinned(xyz, 300)
    assert 100 <= kept.size <= 300
    np.testing.assert_allclose([np.ptp(xyz[kept], axis=0)], [np.ptp(xyz, axis=0)], atol=0.001)
    # Each node stands for those about it.
    assert np.array_equal(group[kept], np.arange(kept.size))
    assert np.linalg.norm(xyz - xyz[kept[group]], axis=1).max() < 0.08
    assert np.array_equal(thinned(xyz, 5000)[0], np.arange(xyz.shape[0]))


def test_neighbours_are_those_without_a_nearer_third_one() -> None:
    xyz = np.random.default_rng(5).normal(size=(30, 3))
    a, b = np.triu_indices(30, 1)
    found = {tuple(pair) for pair in neighbours(xyz, np.column_stack([a, b])).tolist()}
    apart = np.linalg.norm(xyz[:, None] - xyz, axis=2)
    expected = {(i, j) for i, j in zip(a.tolist(), b.tolist(), strict=True) if not np.any(np.maximum(apart[i], apart[j]) < apart[i, j])}
    assert found == expected
    assert 29 <= len(found) < 100


def test_a_record_with_lines_to_nowhere_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "structure.json"
    write_sealed(file, structure_of(new_frame(tmp_path / "frame").inputs()))
    tree = json.loads(file.read_text())
    tree["fields"][0]["lines"][5] = 108
    file.write_text(json.dumps(tree))
    with pytest.raises(DataError, match=r"fields\[0\].lines(.|\n)*pairs of numbers from 0 to 107"):
        read(tmp_path / "structure.json", StructureRecord)


@pytest.mark.parametrize("curved", [0.0, 0.05])
def test_quadratic_elements_have_no_stubs_at_the_rim(curved: float) -> None:
    """3 by 2 long elements with eight nodes: every side in two halves, nothing else; linear elements keep all sides."""
    at = {(i, j): None for i in range(7) for j in range(5) if i % 2 == 0 or j % 2 == 0}
    number = {place: k for k, place in enumerate(at)}
    xyz = np.array([[2.2 * i, j + curved * np.sin(i), 0.0] for i, j in at])
    pairs = set()
    for i in range(0, 6, 2):
        for j in range(0, 4, 2):
            own = sorted(number[i + di, j + dj] for di in range(3) for dj in range(3) if (di, dj) != (1, 1))
            pairs |= {(a, b) for a in own for b in own if a < b}
    coupled = np.array(sorted(pairs))
    all_lines = neighbours(xyz, coupled)
    lines = without_chords(xyz, all_lines, coupled)
    sides = {frozenset((number[a], number[b])) for a in at for b in at if abs(a[0] - b[0]) + abs(a[1] - b[1]) == 1}
    assert {frozenset(pair) for pair in lines.tolist()} == sides
    assert len(all_lines) > len(lines)
    grid = np.array([[i, j, 0.0] for i in range(4) for j in range(3)])
    linear = np.array([(a, b) for a in range(12) for b in range(a + 1, 12) if np.abs(grid[a] - grid[b]).max() <= 1.0])
    own = neighbours(grid, linear)
    assert len(own) == len(without_chords(grid, own, linear)) == 3 * 3 + 4 * 2
