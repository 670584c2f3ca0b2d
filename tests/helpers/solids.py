"""A plate with a wall and a block on it, of 8-node solid elements that share nodes, for tests."""

from __future__ import annotations

import itertools
from collections.abc import Mapping

import numpy as np
import scipy.sparse as sp

#: Lines of nodes [m].
X, Y, Z = np.linspace(0.0, 0.3, 11), np.linspace(0.0, 0.18, 7), np.array([0.0, 0.01, 0.025, 0.04, 0.055])
_CORNERS = np.array(list(itertools.product((-1.0, 1.0), repeat=3)))
ALUMINIUM = (70e9, 2700.0)


def part_of(x: float, y: float, z: float) -> str:
    """Part that holds the element about a point; empty if there is none."""
    if z < 0.01:
        return "plate"
    if 0.06 < x < 0.24 and 0.12 < y < 0.15:
        return "wall"
    return "block" if x > 0.21 and y < 0.09 and z < 0.04 else ""


def _element(size: np.ndarray, nu: float = 0.3) -> tuple[np.ndarray, np.ndarray]:
    """Stiffness for a modulus of 1 and mass for a density of 1, with 2 x 2 x 2 points of integration."""
    lame, shear = nu / (1 + nu) / (1 - 2 * nu), 0.5 / (1 + nu)
    D = np.diag([shear * 2.0] * 3 + [shear] * 3)
    D[:3, :3] += lame
    K, M, volume = np.zeros((24, 24)), np.zeros((24, 24)), float(np.prod(size)) / 8.0
    for point in _CORNERS / np.sqrt(3.0):
        factors = 0.5 * (1.0 + _CORNERS * point)
        shapes = factors.prod(axis=1)
        slopes = np.stack([_CORNERS[:, k] / size[k] * np.delete(factors, k, axis=1).prod(axis=1) for k in range(3)], axis=1)
        B, N = np.zeros((6, 24)), np.zeros((3, 24))
        for k in range(3):
            N[k, k::3], B[k, k::3] = shapes, slopes[:, k]
        for row, (a, b) in enumerate(((1, 2), (0, 2), (0, 1)), start=3):
            B[row, a::3], B[row, b::3] = slopes[:, b], slopes[:, a]
        K, M = K + volume * B.T @ D @ B, M + volume * N.T @ N
    return K, M


def assembled(materials: Mapping[str, tuple[float, float]] | None = None) -> tuple[sp.csc_array, sp.csc_array, np.ndarray]:
    """K, M (three translations a node) and the places of the nodes (n, 3); modulus [Pa] and density [kg/m3] by part."""
    used, entries = dict[tuple[int, int, int], int](), list[tuple[np.ndarray, np.ndarray, np.ndarray]]()
    for cell in itertools.product(*(range(line.size - 1) for line in (X, Y, Z))):
        low, high = (np.array([line[k + step] for line, k in zip((X, Y, Z), cell, strict=True)]) for step in (0, 1))
        if part := part_of(*(0.5 * (low + high))):
            modulus, density = (materials or {}).get(part, ALUMINIUM)
            corners = [tuple(k + int(c > 0) for k, c in zip(cell, corner, strict=True)) for corner in _CORNERS]
            nodes = np.array([used.setdefault(corner, len(used)) for corner in corners])
            K, M = _element(high - low)
            entries.append((np.repeat(3 * nodes, 3) + np.tile(np.arange(3), 8), modulus * K, density * M))
    at, n = [dofs for dofs, *_ in entries], 3 * len(used)
    rows, columns = (
        np.concatenate([each.ravel() for each in grid]) for grid in zip(*(np.meshgrid(d, d, indexing="ij") for d in at), strict=True)
    )
    K, M = (sp.csc_array((np.concatenate([each[k].ravel() for each in entries]), (rows, columns)), shape=(n, n)) for k in (1, 2))
    xyz = np.array([[X[i], Y[j], Z[k]] for i, j, k in used])
    return K, M, xyz
