"""Tables in CSV."""

from __future__ import annotations

import contextlib

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from lrbc_cli.errors import DataError
from lrbc_cli.io.text.tables import read_dof_list, read_dof_table, read_points, read_positions

REUSE_FOLDER = [HealthCheck.function_scoped_fixture, HealthCheck.too_slow]
DOFS = "dof,node,component,x,y,z\n0,11,UX,0.1,0.2,0.3\n1,11,roty,0.1,0.2,0.3\n2,12,PRES,1,2,3\n"


def write(tmp_path, text):
    path = tmp_path / "table.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


@pytest.mark.parametrize(
    "text",
    [
        DOFS,
        DOFS.replace("\n", "\r\n"),
        DOFS.replace(",", ";"),
        DOFS.replace(",", "\t"),
        DOFS.replace(",", " , "),
        "\ufeff" + DOFS.upper(),
        "# a comment\n\n" + DOFS + "\n# the end\n",
        "z,component,dof,x,y,node\n3,PRES,2,1,2,12\n0.3,UX,0,0.1,0.2,11\n.3,ROTY,1,1e-1,2E-1,11\n",
        'dof,node,component,x,y,z,,\n0,11,"UX",0.1,0.2,0.3,,\n1,11,ROTY,0.1,0.2,0.3\n2,12.0,PRES,1,2,3,\n',
    ],
)
def test_dof_table(tmp_path, text):
    table = read_dof_table(write(tmp_path, text))
    assert table.component.tolist() == ["UX", "ROTY", "PRES"]
    assert table.node.tolist() == [11, 11, 12]
    np.testing.assert_array_equal(table.xyz, [[0.1, 0.2, 0.3], [0.1, 0.2, 0.3], [1, 2, 3]])
    assert table.is_acoustic.tolist() == [False, False, True]


@settings(max_examples=30, deadline=None, suppress_health_check=REUSE_FOLDER)
@given(order=st.permutations(range(7)), columns=st.permutations(["dof", "node", "component", "x", "y", "z"]))
def test_any_order_of_lines_and_columns(tmp_path, order, columns):
    rows = [{"dof": i, "node": 100 + i, "component": "UZ", "x": i / 7, "y": -i, "z": 1e-9 * i} for i in order]
    text = "\n".join([",".join(columns), *(",".join(repr(row[c]) if c != "component" else "UZ" for c in columns) for row in rows)])
    table = read_dof_table(write(tmp_path, text))
    assert table.node.tolist() == list(range(100, 107))
    np.testing.assert_array_equal(table.xyz[:, 0], np.arange(7) / 7)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("\n\n", "the table is empty"),
        ("dof,node\n", "component, x, y, z are missing"),
        ("dof,node,component,x,y\n0,1,UX,0,0\n", "the column z is missing"),
        (
            DOFS.replace("z\n", "z,cs\n").replace("3\n", "3,0\n"),
            "line 1: unknown column 'cs'(.|\n)*dof, node, component, x, y, z",
        ),
        (DOFS.replace("roty", "ux"), "line 3, column 'component': two DOFs have one node and component(.|\n)*UX at node 11(.|\n)*line 2"),
        (DOFS.replace("roty,0.1", "roty,0.11"), "line 3, column 'node': one node lies at two places(.|\n)*line 2 says"),
        ("dof,dof,node,component,x,y,z\n", "is given twice in the header"),
        ("dof,node,component,x,y,z\n", "no lines"),
        (DOFS.replace("0.2", "0,2", 1), "line 2: the line does not fit the header"),
        (DOFS.replace(",PRES", ""), "line 4: the line does not fit"),
        (DOFS.replace("2,12,", "2.5,12,"), "line 4, column 'dof'"),
        (DOFS.replace("2,12,", "2,abc,"), "line 4, column 'node'"),
        (DOFS.replace("2,12,", "2,1e99,"), "line 4, column 'node'"),
        (DOFS.replace("2,12,", "2,nan,"), "line 4, column 'node'"),
        (DOFS.replace("PRES,1,", "PRES,one,"), "line 4, column 'x'"),
        (DOFS.replace("PRES,1,", "PRES,nan,"), "line 4, column 'x'(.|\n)*finite"),
        (DOFS.replace("PRES", ""), "line 4, column 'component'"),
        (
            DOFS.replace("2,12,", "1,12,"),
            "line 4, column 'dof'(.|\n)*twice(.|\n)*lines 3 and 4 are both dof 1 but differ \\(node 11 and 12, ",
        ),
        (DOFS.replace("2,12,", "7,12,"), "line 4, column 'dof'(.|\n)*out of range"),
        (DOFS.replace("2,12,", "3,12,").replace("1,11", "2,11").replace("0,11", "1,11"), "counts from 1"),
        (DOFS + '3,"13,UX,0,0,0\n', "line 5: the line cannot be split"),
        (b"\0\1\2\3", "not a text file"),
        (b"", "is empty"),
    ],
)
def test_bad_dof_tables(tmp_path, text, message):
    path = write(tmp_path, text)
    with pytest.raises(DataError, match=message) as caught:
        read_dof_table(path)
    assert str(path) in str(caught.value)


def test_points(tmp_path):
    points = read_points(write(tmp_path, "name,x,y,z\nB01,0,0.5,1\n7,1,2,3\n"))
    assert points.name == ("B01", "7")
    np.testing.assert_array_equal(points.xyz, [[0, 0.5, 1], [1, 2, 3]])
    with pytest.raises(
        DataError, match=r"line 3, column 'name'(.|\n)*lines 2 and 3 are both B01 but lie at different places \(x 0 and 1, "
    ):
        read_points(write(tmp_path, "name,x,y,z\nB01,0,0.5,1\nB01,1,2,3\n"))
    with pytest.raises(DataError, match=r"line 3, column 'name'(.|\n)*lines 2 and 3 are identical: remove one"):
        read_points(write(tmp_path, "name,x,y,z\nB01,0,0.5,1\nB01,0.0,0.50,1\n"))
    with pytest.raises(DataError, match="line 2, column 'name'"):
        read_points(write(tmp_path, "name,x,y,z\n,0,0.5,1\n"))


@pytest.mark.parametrize("offset", [0.0, 1e-8])
def test_two_points_at_one_place(tmp_path, offset):
    text = f"name,x,y,z\nB1,0,0.5,1\nB2,1,2,3\nB3,{offset!r},0.5,1\n"
    with pytest.raises(DataError, match=r"line 4, column 'name': two points lie at one place(.|\n)*line 2 already puts B1"):
        read_points(write(tmp_path, text))
    assert len(read_points(write(tmp_path, text.replace(f"B3,{offset!r}", "B3,1e-3"))).name) == 3


def test_fields_may_be_numbered_apart(tmp_path):
    table = read_dof_table(write(tmp_path, DOFS.replace("2,12,", "2,11,")))
    assert table.node.tolist() == [11, 11, 11]
    # Rounding of an exporter is no other place.
    assert read_dof_table(write(tmp_path, DOFS.replace("roty,0.1", "roty,0.1000001"))).size == 3


@pytest.mark.parametrize(
    ("reader", "text", "known"),
    [
        (read_points, "name,x,y,z,torque\nB1,0,0,0,1\n", "name, x, y, z"),
        (read_dof_list, "name,dof\na,5\nb,3\n", "dof, parameter, bolt, x, y, z"),
        (read_positions, "x,y,z,,parameter\n0,0,0,1,a\n", "x, y, z, parameter, bolt"),
        (read_positions, "x,y,z,Parameters\n0,0,0,a\n", "x, y, z, parameter, bolt"),
    ],
)
def test_columns_that_would_not_be_used_are_refused(tmp_path, reader, text, known):
    with pytest.raises(DataError, match=f"unknown column(.|\n)*expected: {known}\n"):
        reader(write(tmp_path, text))


def test_dof_list(tmp_path):
    found = read_dof_list(write(tmp_path, "dof\n5\n3\n"))
    assert (found.dof.tolist(), found.parameter, found.xyz) == ([5, 3], None, None)
    found = read_dof_list(write(tmp_path, "parameter,dof,x,y,z\na,5,1,2,3\na,3,4,5,6\n"))
    assert (found.dof.tolist(), found.parameter, found.xyz.tolist()) == ([5, 3], ("a", "a"), [[1, 2, 3], [4, 5, 6]])
    for text, message in (("dof,x,y\n1,2,3\n", "three columns"), ("dof,parameter\n1,a\n2,\n", "line 3, column 'parameter'")):
        with pytest.raises(DataError, match=message):
            read_dof_list(write(tmp_path, text))
    for text, message in (("dof\n-1\n", "line 2"), ("dof\n1\n1\n", "line 3"), ("node\n1\n", "'node'")):
        with pytest.raises(DataError, match=message):
            read_dof_list(write(tmp_path, text))


def test_positions(tmp_path):
    positions = read_positions(write(tmp_path, "x,y,z\n1,2,3\n4,5,6\n"))
    assert positions.parameter is None
    assert positions.xyz.shape == (2, 3)
    assert read_positions(write(tmp_path, "parameter,x,y,z\n1,1,2,3\nleft,4,5,6\n")).parameter == ("1", "left")
    with pytest.raises(DataError, match="line 3, column 'parameter'"):
        read_positions(write(tmp_path, "parameter,x,y,z\n1,1,2,3\n,4,5,6\n"))


@settings(max_examples=60, deadline=None, suppress_health_check=REUSE_FOLDER)
@given(data=st.data())
def test_damage_gives_a_data_error_or_a_table(tmp_path, data):
    content = bytearray(DOFS.encode())
    for _ in range(data.draw(st.integers(0, 4))):
        content[data.draw(st.integers(0, len(content) - 1))] = data.draw(st.sampled_from(b'0123456789,;"\n\r\0\xff') | st.integers(0, 255))
    path = write(tmp_path, bytes(content[: data.draw(st.integers(0, len(content)))]))
    for reader in (read_dof_table, read_points, read_dof_list, read_positions):
        with contextlib.suppress(DataError):
            reader(path)


def test_empty_cells_and_empty_columns_are_told_as_such(tmp_path):
    with pytest.raises(DataError, match="the column 'z' is empty") as caught:
        read_positions(write(tmp_path, "x,y,z\n0,1,\n0,2,\n"))
    assert caught.value.place == "lines 2 to 3"
    assert "if all points lie in one plane, write the same number" in caught.value.hint
    with pytest.raises(DataError, match="the column 'dof' is empty") as caught:
        read_dof_list(write(tmp_path, "dof,x,y,z\n,1,2,3\n"))
    assert (caught.value.place, caught.value.hint) == ("line 2", "fill it in")
    with pytest.raises(DataError, match="a cell is empty") as caught:
        read_points(write(tmp_path, "name,x,y,z\nB1,0,1,2\nB2,0,,2\n"))
    assert caught.value.place == "line 3, column 'y'"
    assert caught.value.hint == "write the number that belongs there, or remove the line"
