"""Parts of a mesh that share nodes, and their shares of assembled matrices."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp
import solids
from scipy.sparse.linalg import eigsh

from lrbc_cli.model.dofs import DofTable
from lrbc_cli.model.mesh_parts import MeshPart, mesh_parts

#: Springs to the ground at the corners of the plate [N/m].
HELD = 2e6


def table(xyz: np.ndarray) -> DofTable:
    return DofTable(node=np.repeat(np.arange(len(xyz)), 3), component=np.tile(["UX", "UY", "UZ"], len(xyz)), xyz=np.repeat(xyz, 3, axis=0))


def model(K: Any, M: Any) -> Any:
    return SimpleNamespace(K=sp.csc_array(K), M=sp.csc_array(M), is_acoustic=np.zeros(K.shape[0], dtype=bool), size=K.shape[0])


def frequencies(K: Any, M: Any, xyz: np.ndarray) -> np.ndarray:
    """The lowest 15 natural frequencies [Hz], held at the corners of the plate."""
    corner = (xyz[:, 2] == 0.0) & np.isin(xyz[:, 0], solids.X[[0, -1]]) & np.isin(xyz[:, 1], solids.Y[[0, -1]])
    held = sp.diags_array(np.repeat(HELD * corner, 3), format="csc")
    values = eigsh(K + held, 15, M, sigma=0.0, return_eigenvectors=False)
    return np.asarray(np.sqrt(np.sort(values)) / (2.0 * np.pi))


def named(pieces: list[MeshPart], xyz: np.ndarray) -> dict[str, MeshPart]:
    """The parts by the names of ``solids``."""
    found = {}
    for piece in pieces:
        own = xyz[np.unique(np.flatnonzero(piece.own) // 3)]
        found["plate" if own[:, 2].min() == 0.0 else "wall" if own[:, 1].min() > 0.1 else "block"] = piece
    return found


def test_parts_end_where_the_section_jumps() -> None:
    K, M, xyz = solids.assembled()
    pieces = mesh_parts(model(K, M), table(xyz))
    by_name = named(pieces, xyz)
    assert len(pieces) == len(by_name) == 3
    for name, piece in by_name.items():
        own = xyz[np.unique(np.flatnonzero(piece.own) // 3)]
        assert (own[:, 2] > 0.01).all() if name != "plate" else (own[:, 2] <= 0.01).all(), name
    np.testing.assert_array_equal(sum(piece.own.astype(int) for piece in pieces), 1)
    for whole, shares in ((K, [piece.K for piece in pieces]), (M, [piece.M for piece in pieces])):
        assert abs(sum(shares[1:], shares[0]) - whole).max() < 1e-9 * abs(whole).max()
    mass = {"plate": 0.3 * 0.18 * 0.01, "wall": 0.18 * 0.03 * 0.045, "block": 0.09 * 0.09 * 0.03}
    for name, volume in mass.items():
        assert by_name[name].M.sum() / 3.0 == pytest.approx(2700.0 * volume, rel=0.03), name


def test_a_rigid_motion_strains_no_part() -> None:
    K, M, xyz = solids.assembled()
    x, y, z = xyz.T
    o, one = np.zeros(len(xyz)), np.ones(len(xyz))
    turns = [(o, -z, y), (z, o, -x), (-y, x, o)]
    motions = np.stack([np.stack(each, axis=1).ravel() for each in ((one, o, o), (o, one, o), (o, o, one), *turns)], axis=1)
    for piece in mesh_parts(model(K, M), table(xyz)):
        assert np.abs(piece.K @ motions).max() < 1e-9 * np.abs(K).max()


@pytest.mark.parametrize("name", ["plate", "wall", "block"])
@pytest.mark.parametrize(("factors", "rtol"), [((3.0, 2.9), 0.03), ((1.0, 2.5), 2e-3), ((0.58, 0.84), 0.01)])
def test_frequencies_with_one_part_of_another_material(name: str, factors: tuple[float, float], rtol: float) -> None:
    """Against a model assembled with that material: steel, another density, a thinner sheet. They move by 2.5 to 32 %."""
    K, M, xyz = solids.assembled()
    piece = named(mesh_parts(model(K, M), table(xyz)), xyz)[name]
    stiff, heavy = factors
    modulus, density = solids.ALUMINIUM
    other, weight, _ = solids.assembled({name: (stiff * modulus, heavy * density)})
    expected = frequencies(other, weight, xyz)
    found = frequencies(K + (stiff - 1.0) * piece.K, M + (heavy - 1.0) * piece.M, xyz)
    assert np.abs(expected / frequencies(K, M, xyz) - 1.0).max() > 0.02
    np.testing.assert_allclose(found, expected, rtol=rtol)


def test_a_loss_factor_belongs_to_each_share() -> None:
    K, M, xyz = solids.assembled()
    pieces = mesh_parts(model(K * (1.0 + 0.02j), M), table(xyz))
    for piece in pieces:
        np.testing.assert_allclose(piece.K.imag.toarray(), 0.02 * piece.K.real.toarray(), rtol=1e-9, atol=1e-9 * abs(K).max())


def test_a_plain_plate_is_one_part_and_separate_bodies_are_parts() -> None:
    K, M, xyz = solids.assembled()
    plate = np.flatnonzero(np.repeat(xyz[:, 2] <= 0.01, 3))
    K, M, xyz = K[plate][:, plate], M[plate][:, plate], xyz[xyz[:, 2] <= 0.01]
    assert mesh_parts(model(K, M), table(xyz)) == []
    # Twice, one above the other; a rounding error joins nothing.
    two, weight = sp.lil_array(sp.block_diag([K, K])), sp.block_diag([M, M])
    two[0, K.shape[0]] = two[K.shape[0], 0] = 1e-9
    both = mesh_parts(model(two, weight), table(np.concatenate([xyz, xyz + np.array([0.0, 0.0, 0.1])])))
    assert [int(piece.own.sum()) for piece in both] == [plate.size, plate.size]
    assert abs(both[0].K[: plate.size, : plate.size] - K).max() == 0.0
