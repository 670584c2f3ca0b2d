"""Rigid motions of models that are right meet no forces, of whatever elements; coordinates of another model, and rounded numbers, do."""

from __future__ import annotations

import itertools
from pathlib import Path

import grillage
import numpy as np
import pytest
import scipy.io
import scipy.sparse as sp

from lrbc_cli.campaign.reading.doubts.rigid import components_doubt, digits_doubt, places_doubt
from lrbc_cli.model.dofs import COMPONENTS, DofTable

SHAPE = (5, 4, 3)
STEEL = 210e9


def places(seed: int = 0) -> np.ndarray:
    """Nodes of a block, moved a little, as a file with six digits has them."""
    rng = np.random.default_rng(seed)
    xyz = np.array(list(itertools.product(*(np.arange(n) for n in SHAPE)))) * [0.03, 0.02, 0.025]
    return np.round(xyz + rng.uniform(-0.003, 0.003, xyz.shape) + [0.4, 0.1, -0.2], 6)


def number(*at: int) -> int:
    return int(np.ravel_multi_index(at, SHAPE))


def table(xyz: np.ndarray, labels: tuple[str, ...]) -> DofTable:
    n = len(xyz)
    return DofTable(np.repeat(np.arange(1, n + 1), len(labels)), np.tile(labels, n), np.repeat(xyz, len(labels), axis=0))


def block(xyz: np.ndarray) -> sp.csc_array:
    """Trilinear bricks."""
    n, nu = len(xyz), 0.3
    lame, shear = STEEL * nu / ((1 + nu) * (1 - 2 * nu)), STEEL / (2 * (1 + nu))
    D = np.diag([2 * shear] * 3 + [shear] * 3)
    D[:3, :3] += lame
    K = np.zeros((3 * n, 3 * n))
    signs = np.array(list(itertools.product((-1, 1), repeat=3)))
    for cell in itertools.product(*(range(k - 1) for k in SHAPE)):
        nodes = [number(*(c + (s > 0) for c, s in zip(cell, sign, strict=True))) for sign in signs]
        at = np.concatenate([[3 * k, 3 * k + 1, 3 * k + 2] for k in nodes])
        for point in signs / np.sqrt(3.0):
            terms = 1 + signs * point
            slope = np.stack([signs[:, k] * np.delete(terms, k, axis=1).prod(axis=1) for k in range(3)]) / 8
            jacobian = slope @ xyz[nodes]
            g = np.linalg.solve(jacobian, slope)
            B = np.zeros((6, 24))
            for k in range(3):
                B[k, k::3] = g[k]
            for row, (a, b) in enumerate(((0, 1), (1, 2), (0, 2)), start=3):
                B[row, a::3], B[row, b::3] = g[b], g[a]
            K[np.ix_(at, at)] += B.T @ D @ B * np.linalg.det(jacobian)
    return sp.csc_array(K)


def frame(xyz: np.ndarray) -> sp.csc_array:
    """Beams in space along the edges of the cells."""
    K = np.zeros((6 * len(xyz),) * 2)
    EA, EI, GJ = 1e7, (2e3, 5e3), 1e3
    for at in itertools.product(*(range(k) for k in SHAPE)):
        for axis in range(3):
            end = [c + (k == axis) for k, c in enumerate(at)]
            if end[axis] >= SHAPE[axis]:
                continue
            a, b = number(*at), number(*end)
            x = xyz[b] - xyz[a]
            length = float(np.linalg.norm(x))
            x /= length
            y = np.cross([0.3, 0.5, 0.8], x)
            y /= np.linalg.norm(y)
            R = np.kron(np.eye(4), np.array([x, y, np.cross(x, y)]))
            k = np.zeros((12, 12))
            for i, j, value in ((0, 6, EA / length), (3, 9, GJ / length)):
                k[np.ix_((i, j), (i, j))] += value * np.array([[1, -1], [-1, 1]])
            for stiff, at_dofs, sign in ((EI[0], (1, 5, 7, 11), 1), (EI[1], (2, 4, 8, 10), -1)):
                h = sign * length
                bend = np.array(
                    [
                        [12, 6 * h, -12, 6 * h],
                        [6 * h, 4 * h**2, -6 * h, 2 * h**2],
                        [-12, -6 * h, 12, -6 * h],
                        [6 * h, 2 * h**2, -6 * h, 4 * h**2],
                    ]
                )
                k[np.ix_(at_dofs, at_dofs)] += stiff / length**3 * bend
            rows = [*range(6 * a, 6 * a + 6), *range(6 * b, 6 * b + 6)]
            K[np.ix_(rows, rows)] += R.T @ k @ R
    return sp.csc_array(K)


MODELS = {"bricks": (block, COMPONENTS[:3]), "beams": (frame, COMPONENTS[:6])}


@pytest.mark.parametrize("kind", MODELS)
def test_models_that_are_right_are_not_doubted(kind):
    build, labels = MODELS[kind]
    xyz = places()
    K, dofs = build(xyz), table(xyz, labels)
    assert components_doubt(K, dofs, "dofs.csv") is None
    assert places_doubt(K, dofs, "dofs.csv") is None
    assert digits_doubt(K, K.data, dofs.component) is None
    # Nor where some nodes are held, by springs in all directions, or fixed.
    held = sp.csc_array(sp.diags_array(np.where(np.arange(dofs.size) < 40, K.diagonal().max(), 0.0)))
    assert places_doubt(sp.csc_array(K + held), dofs, "dofs.csv") is None
    kept = np.arange(30, dofs.size)
    assert places_doubt(K[:, kept][kept], table(xyz[30 // len(labels) :], labels), "dofs.csv") is None


def test_coordinates_of_a_small_model_in_another_order(monkeypatch):
    """27 nodes, joined to coordinates that were sorted as text: 1, 10, 11 ... 2, 20 ..."""
    monkeypatch.setitem(globals(), "SHAPE", (3, 3, 3))
    xyz, labels = places(), COMPONENTS[:6]
    K = frame(xyz)
    assert places_doubt(K, table(xyz, labels), "dofs.csv") is None
    held = sp.csc_array(sp.diags_array(np.where(np.arange(6 * len(xyz)) < 18, K.diagonal().max(), 0.0)))
    assert places_doubt(sp.csc_array(K + held), table(xyz, labels), "dofs.csv") is None
    order = sorted(range(1, len(xyz) + 1), key=str)
    text = places_doubt(K, table(xyz[np.argsort(order)], labels), "dofs.csv")
    assert text is not None
    assert text.startswith("the coordinates of the nodes are probably not those of the stiffness matrix")


def test_rounding_of_rotated_elements_is_no_stiffness():
    """Two rows of beams that bend and twist; what they lack in their plane an FE program may keep as rounding, and a rotation loads it."""
    xyz = np.array([[0.1 * k, y, 0.0] for y in (0.0, 0.2) for k in range(60)])
    labels, h = COMPONENTS[:6], 0.1
    K = np.zeros((6 * len(xyz),) * 2)
    bend = np.array(
        [[12, -6 * h, -12, -6 * h], [-6 * h, 4 * h**2, 6 * h, 2 * h**2], [-12, 6 * h, 12, 6 * h], [-6 * h, 2 * h**2, 6 * h, 4 * h**2]]
    )
    for a in (k for k in range(len(xyz) - 1) if k != 59):
        uz, rotx, roty = (6 * np.array([a, a + 1]) + c for c in (2, 3, 4))
        K[np.ix_(rotx, rotx)] += 1e3 * np.array([[1, -1], [-1, 1]])
        at = [uz[0], roty[0], uz[1], roty[1]]
        K[np.ix_(at, at)] += 1e6 * bend
    assert places_doubt(sp.csc_array(K), table(xyz, labels), "dofs.csv") is None
    uz, rotz = (np.arange(c, len(K), 6) for c in (2, 5))
    K[uz, rotz] = K[rotz, uz] = 1e-16 * K.max() * np.random.default_rng(0).standard_normal(uz.size)
    assert places_doubt(sp.csc_array(K), table(xyz, labels), "dofs.csv") is None


@pytest.mark.parametrize(("one", "other"), [("ROTX", "ROTY"), ("ROTX", "ROTZ"), ("ROTY", "ROTZ")])
def test_exchanged_rotations_are_told(one, other):
    xyz, labels = places(), [{one: other, other: one}.get(label, label) for label in COMPONENTS[:6]]
    text = places_doubt(frame(xyz), table(xyz, labels), "dofs.csv")
    assert text is not None
    assert "the components in dofs.csv are probably exchanged" in text
    assert text.endswith(f"Exchange {one} and {other} in dofs.csv")


@pytest.mark.parametrize(
    ("said", "so"),
    [
        ("ROTX ROTY ROTZ UX UY UZ", "UX, UY, UZ, ROTX, ROTY, ROTZ in place of ROTX, ROTY, ROTZ, UX, UY, UZ"),
        ("UX ROTX UY ROTY UZ ROTZ", "UY, UZ, ROTX, ROTY in place of ROTX, UY, ROTY, UZ"),
        ("UX UY UZ ROTY ROTZ ROTX", "ROTX, ROTY, ROTZ in place of ROTY, ROTZ, ROTX"),
        ("UY UX UZ ROTX ROTY ROTZ", ""),
    ],
)
def test_components_in_another_order_are_told(said, so):
    """Other orders of the six components within each node."""
    K, dofs = frame(places()), table(places(), tuple(said.split()))
    text = components_doubt(K, dofs, "dofs.csv") or places_doubt(K, dofs, "dofs.csv")
    assert text is not None
    assert text.endswith(f"Write {so} in dofs.csv" if so else "Exchange UX and UY in dofs.csv")


@pytest.mark.parametrize("said", ["UZ ROTX ROTY", "ROTX UZ ROTY", "ROTY ROTX UZ", "ROTX ROTY UZ", "ROTY UZ ROTX"])
def test_components_of_a_grillage_in_another_order_are_told(said):
    right, names = ("UZ", "ROTX", "ROTY"), said.split()
    x, y = grillage.DX * np.arange(grillage.NX), grillage.DY * np.arange(grillage.NY)
    xyz = np.array([(a, b, 0.0) for b in y for a in x])
    text = components_doubt(sp.csc_array(grillage.matrices()[0]), table(xyz, tuple(names)), "dofs.csv")
    old = [name for name, other in zip(names, right, strict=True) if name != other]
    new = [other for name, other in zip(names, right, strict=True) if name != other]
    fix = f"Exchange {' and '.join(sorted(old))}" if len(old) == 2 else f"Write {', '.join(new)} in place of {', '.join(old)}"
    assert (text or "").endswith(f"{fix} in dofs.csv" if old else "")
    assert (text is None) is (not old)


def test_components_are_tested_in_the_units_of_the_files(tmp_path: Path):
    """In other units than SI a row taken for a rotation is converted as one; other units of the model are no explanation, then."""
    folder = grillage.grillage(tmp_path, ())
    shift = np.tile([True, False, False], grillage.NX * grillage.NY)
    scales = sp.diags_array(np.where(shift, 1e-3**0.5, 1e3**0.5))
    for name in ("K", "M"):
        matrix = scales @ sp.csc_array(scipy.io.mmread(folder.data / f"{name}.mtx")) @ scales
        scipy.io.mmwrite(folder.data / f"{name}.mtx", matrix, symmetry="general", precision=17)
    head, *rows = [line.split(",") for line in (folder.data / "dofs.csv").read_text().splitlines()]
    names = {"UZ": "ROTX", "ROTX": "ROTY", "ROTY": "UZ"}
    rows = [[*row[:2], names[row[2]], *(f"{1e3 * float(value):g}" for value in row[3:])] for row in rows]
    (folder.data / "dofs.csv").write_text("\n".join(",".join(row) for row in (head, *rows)) + "\n")
    folder.write(folder.tree() | {"units": "mm-N-t"})
    told = folder.inputs().warnings
    assert any(text.endswith("Write UZ, ROTX, ROTY in place of ROTX, ROTY, UZ in dofs.csv") for text in told)
    assert not any("units" in text for text in told)


def test_springs_at_every_node_are_no_other_order():
    """A bed of springs holds every node in z, so that the only translation without forces is another one."""
    K, dofs = frame(places()), table(places(), COMPONENTS[:6])
    bed = sp.diags_array(np.where(dofs.component == "UZ", K.diagonal().max(), 0.0))
    assert components_doubt(sp.csc_array(K + bed), dofs, "dofs.csv") is None


def cylindrical(xyz: np.ndarray, unit: float) -> np.ndarray:
    """Radius, angle over ``unit`` [rad] and z of places, with the digits of a file."""
    x, y, z = xyz.T
    return np.stack([np.round(np.hypot(x, y), 8), np.round(unit * np.arctan2(y, x), 6), z], axis=1)


@pytest.mark.parametrize("kind", MODELS)
def test_coordinates_of_another_model_are_told(kind):
    build, labels = MODELS[kind]
    xyz = places()
    K = build(xyz)
    for other, says in (
        (xyz * [1.0, 1.1, 1.0], "Give in dofs.csv the nodes"),
        (xyz * [1.0, -1.0, 1.0], "with y mirrored"),
        (xyz[:, [1, 0, 2]], "with x and y exchanged"),
        (cylindrical(xyz, 180.0 / np.pi), "with x and y read as radius and angle in degrees (cylindrical coordinates"),
        (cylindrical(xyz, 1.0), "with x and y read as radius and angle in radians (cylindrical coordinates"),
        (places(1), "Give in dofs.csv the nodes"),
        (np.roll(xyz, 1, axis=0), "Give in dofs.csv the nodes"),
    ):
        text = places_doubt(K, table(other, labels), "dofs.csv")
        assert text is not None
        assert says in text


def test_axes_of_each_node_tell_nothing():
    """In cylindrical ones a translation of all nodes is no rigid motion."""
    xyz = places()
    K, dofs = block(xyz), table(xyz, COMPONENTS[:3])
    angle = np.arctan2(xyz[:, 1], xyz[:, 0])
    turns = [np.array([[np.cos(a), np.sin(a), 0.0], [-np.sin(a), np.cos(a), 0.0], [0.0, 0.0, 1.0]]) for a in angle]
    R = sp.block_diag(turns, format="csc")
    assert places_doubt(sp.csc_array(R @ K @ R.T), dofs, "dofs.csv") is None


def test_rounded_numbers_are_told_and_simple_ones_are_not():
    xyz = places()
    K, dofs = block(xyz), table(xyz, COMPONENTS[:3])
    coarse = K.copy()
    coarse.data = np.array([float(f"{value:.3e}") for value in K.data])
    assert "5 digits or fewer" in (digits_doubt(coarse, coarse.data, dofs.component) or "")
    chain = sp.csc_array(sp.diags_array([np.full(299, -1e5), np.full(300, 2e5), np.full(299, -1e5)], offsets=[-1, 0, 1]))
    assert digits_doubt(chain, chain.data, np.full(300, "UX")) is None
