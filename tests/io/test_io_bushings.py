"""Tables of springs between nodes: what is read, and that nothing else is."""

from __future__ import annotations

import contextlib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from lrbc_cli.errors import DataError
from lrbc_cli.io.text.bushings import AXES, read_bushings
from lrbc_cli.model.dofs import COMPONENTS

HEADER = "bolt,node_a,node_b,component,stiffness"


def write(path: Path, text: str) -> Path:
    file = path / "bushings.csv"
    file.write_text(text)
    return file


def test_ground_and_two_nodes(tmp_path: Path) -> None:
    found = read_bushings(write(tmp_path, f"{HEADER}\nB1,5,,uz,1e6\nB1,5,8,ROTX,2.5\n# a comment\nB2,7,9,UZ,3\n"))
    assert found.bolt == ("B1", "B1", "B2")
    assert found.node_a.tolist() == [5, 5, 7]
    assert found.node_b == (None, 8, 9)
    assert found.component == ("UZ", "ROTX", "UZ")
    assert found.stiffness.tolist() == [1e6, 2.5, 3.0]
    assert found.lines == (2, 3, 5)
    np.testing.assert_array_equal(found.axes, np.tile(np.eye(3), (3, 1, 1)))
    assert found.only("UZ").bolt == ("B1", "B2")
    assert read_bushings(write(tmp_path, "bolt,node_a,component,stiffness\nB1,5,UZ,1\n")).node_b == (None,)


def test_local_axes_are_orthonormal_and_right_handed(tmp_path: Path) -> None:
    """Local y lies in the plane of the two vectors, whatever their length."""
    turn = Rotation.from_euler("xyz", [0.3, -0.7, 1.9]).as_matrix()
    given_ = [*(5.0 * turn[:, 0]), *(0.2 * turn[:, 1] + 3.0 * turn[:, 0])]
    row = ",".join(repr(float(v)) for v in given_)
    found = read_bushings(write(tmp_path, f"{HEADER},{','.join(AXES)}\nB1,5,,UX,1,{row}\n"))
    np.testing.assert_allclose(found.axes[0], turn.T, atol=1e-12)


X = "1,0,0,0,1,0"


@pytest.mark.parametrize(
    ("rows", "line", "problem"),
    [
        ("B1,5,,UQ,1", 2, "expected: one of UX, UY, UZ, ROTX, ROTY, ROTZ\n  found:    'UQ'"),
        ("B1,5,5,UX,1", 2, "the spring connects a node to itself"),
        ("B1,5,,UX,0", 2, "a number above 0\n  found:    '0'\n  fix:      write the stiffness of the spring without the sign"),
        ("B1,5,,UX,-3", 2, "without the sign, or remove the line"),
        ("B1,5,,UX,inf", 2, "a finite number"),
        ("B1,5,,UX,nan", 2, "a finite number"),
        ("B1,5.5,,UX,1", 2, "a whole number"),
        ("B1,5,x,UX,1", 2, "a whole number"),
        (",5,,UX,1", 2, "a name or number in every line"),
        ("B1,5,,UX,1\nB1,5,8,UX,1\nB2,8,5,UX,2", 4, "a spring is given twice in the table(.|\n)*line 3 already contains it"),
        ("B1,5,,UX,1\nB1,5,,UX,1", 3, "line 2 already contains it; remove one of the two"),
        ("B1,5,,UX,1\nB2,5,,UX,1", 3, "line 2 already contains it, for bolt B1; this line is for B2: correct the nodes or the bolt"),
        ("B1,5,,UX,1\nB1,5,,UX,2", 3, "line 2 already contains it, with stiffness 1; this line has 2: correct the nodes or component"),
        ("B9,5,,UX,1", 2, "this bolt is unknown\n  expected: one of B1, B2\n  found:    'B9'"),
    ],
)
def test_what_cannot_be_meant_is_refused(tmp_path: Path, rows: str, line: int, problem: str) -> None:
    with pytest.raises(DataError, match=f"bushings.csv, line {line}(.|\n)*{problem}"):
        read_bushings(write(tmp_path, f"{HEADER}\n{rows}\n"), ("B1", "B2"))


@pytest.mark.parametrize(
    ("header", "row", "problem"),
    [
        (f"{HEADER},x_x,x_y", "B1,5,,UX,1,1,0", "local axes need six columns(.|\n)*found:    x_x, x_y"),
        (f"{HEADER},{','.join(AXES)}", "B1,5,,UX,1,0,0,0,0,1,0", "line 2(.|\n)*a local axis has no length"),
        (f"{HEADER},{','.join(AXES)}", "B1,5,,UX,1,1,2,3,-2,-4,-6", "line 2(.|\n)*parallel"),
        (f"{HEADER},torque", "B1,5,,UX,1,3", "unknown column"),
        ("bolt,node_a,stiffness", "B1,5,1", "component is missing"),
    ],
)
def test_columns(tmp_path: Path, header: str, row: str, problem: str) -> None:
    with pytest.raises(DataError, match=problem):
        read_bushings(write(tmp_path, f"{header}\n{row}\n"))


def test_one_direction_in_two_frames_is_one_spring(tmp_path: Path) -> None:
    """Local x of a turned frame is the model's y."""
    rows = "B1,5,,UY,1,1,0,0,0,1,0\nB1,5,,UX,1,0,1,0,-1,0,0"
    with pytest.raises(DataError, match=r"line 3(.|\n)*twice"):
        read_bushings(write(tmp_path, f"{HEADER},{','.join(AXES)}\n{rows}\n"))


names = st.text(st.characters(min_codepoint=48, max_codepoint=122, categories=("Lu", "Ll", "Nd")), min_size=1, max_size=6)
springs = st.tuples(
    names,
    st.integers(0, 10**6),
    st.one_of(st.none(), st.integers(0, 10**6)),
    st.sampled_from(COMPONENTS),
    st.floats(1e-12, 1e15),
)


@given(
    st.lists(springs, min_size=1, max_size=8, unique_by=lambda row: (frozenset((row[1], row[2])), row[3])).filter(
        lambda rows: all(row[1] != row[2] for row in rows)
    )
)
def test_what_is_written_is_read(tmp_path_factory: pytest.TempPathFactory, rows: list) -> None:
    lines = [",".join(["" if cell is None else repr(cell) if isinstance(cell, float) else str(cell) for cell in row]) for row in rows]
    found = read_bushings(write(tmp_path_factory.mktemp("springs"), "\n".join([HEADER, *lines]) + "\n"))
    assert [*zip(found.bolt, found.node_a.tolist(), found.node_b, found.component, found.stiffness.tolist(), strict=True)] == rows


@given(st.text(max_size=60))
def test_any_text_is_read_or_refused(tmp_path_factory: pytest.TempPathFactory, text: str) -> None:
    file = tmp_path_factory.mktemp("springs") / "bushings.csv"
    file.write_bytes(f"{HEADER}\nB1,5,,UX,1\n{text}\n".encode())
    with contextlib.suppress(DataError):
        found = read_bushings(file)
        assert (found.stiffness > 0).all()
        assert len(found.bolt) == found.node_a.size
