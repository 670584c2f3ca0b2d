"""Meshes of the cavity: a block grid whose lines pass through the edges of the aperture and, if wanted, the microphones."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import permutations

import numpy as np
from numpy.typing import NDArray

from rigs.design import Array, Design

IntArray = NDArray[np.int64]


@dataclass(frozen=True)
class Grid:
    """A conforming grid of hexahedra.

    Attributes
    ----------
    points : (n, 3) float array
        Vertices [m].
    lattice : (n, 3) int array
        Their indices in the block grid.
    cells : (m, 2, 2, 2) int array
        Vertex numbers of the cells, by steps along x, y and z.
    """

    points: Array
    lattice: IntArray
    cells: IntArray


def _lines(stops: list[float], counts: list[int]) -> Array:
    parts = [np.linspace(a, b, c + 1)[:-1] for a, b, c in zip(stops[:-1], stops[1:], counts, strict=True)]
    return np.concatenate([*parts, np.array(stops[-1:])])


def _through(lines: Array, fixed: list[float], targets: list[float]) -> Array:
    """Shift the lines nearest to `targets` onto them, and the others with them; `fixed` lines stay."""
    old, new = list(fixed), list(fixed)
    for target in targets:
        old.append(float(lines[np.argmin(np.abs(lines - target))]))
        new.append(target)
    order = np.argsort(old)
    return np.interp(lines, np.array(old)[order], np.array(new)[order])


def block_grid(
    design: Design,
    aperture: tuple[int, int],
    sides: tuple[int, int, int, int],
    depths: tuple[int, ...],
    neck: int,
    snap: bool,
) -> Grid:
    """Grid of neck and cavity.

    Parameters
    ----------
    design : Design
    aperture : (int, int)
        Cells across the aperture along x and y.
    sides : (int, int, int, int)
        Cells left of, right of, below and above the aperture.
    depths : tuple of int
        Cells along z between z = 0, the depths of the microphones inside, and the back wall.
    neck : int
        Cells along z in the neck.
    snap : bool
        Whether vertices lie on the microphones.
    """
    (x0, y0, plate_z), (x1, y1), (width, height) = design.plate_origin, design.plate_end, design.front[2]
    microphones = design.microphones
    xs = _lines([0.0, x0, x1, width], [sides[0], aperture[0], sides[1]])
    ys = _lines([0.0, y0, y1, height], [sides[2], aperture[1], sides[3]])
    levels = sorted({z for _, _, z in microphones.values()} - {design.depth})
    stops = [0.0, *levels, design.depth]
    zs = np.concatenate([np.linspace(plate_z, 0.0, neck + 1)[:-1], _lines(stops, list(depths))])
    line_x = np.tile(xs, (len(stops), 1))
    line_y = np.tile(ys, (len(stops), 1))
    if snap:
        for k, level in enumerate(stops):
            at = [design.front_coordinates(*m) for m in microphones.values() if m[2] == level and level < design.depth]
            if at:
                line_x[k] = _through(xs, [0.0, width], [p[0] for p in at])
                line_y[k] = _through(ys, [0.0, height], [float(np.mean([p[1] for p in at]))])
    along_x = np.stack([np.interp(zs, stops, line_x[:, i]) for i in range(xs.size)], axis=1)
    along_y = np.stack([np.interp(zs, stops, line_y[:, j]) for j in range(ys.size)], axis=1)

    shape = (xs.size, ys.size, zs.size)
    lattice = np.indices(shape).reshape(3, -1).T
    z = zs[lattice[:, 2]]
    x, y = design.cross_section(along_x[lattice[:, 2], lattice[:, 0]], along_y[lattice[:, 2], lattice[:, 1]], z)
    points = np.stack([x, y, z], axis=1)
    if snap:
        for microphone in microphones.values():
            points[np.argmin(np.linalg.norm(points - microphone, axis=1))] = microphone

    number = np.arange(len(lattice)).reshape(shape)
    corners = [[[number[a : shape[0] - 1 + a, b : shape[1] - 1 + b, c : shape[2] - 1 + c] for c in (0, 1)] for b in (0, 1)] for a in (0, 1)]
    cells = np.moveaxis(np.array(corners), (0, 1, 2), (3, 4, 5))
    keep = np.ones(cells.shape[:3], dtype=bool)
    keep[:, :, :neck] = False
    keep[sides[0] : sides[0] + aperture[0], sides[2] : sides[2] + aperture[1], :neck] = True
    cells = cells[keep]
    used, inverse = np.unique(cells, return_inverse=True)
    return Grid(points[used], lattice[used], inverse.reshape(cells.shape))


def tetrahedra(grid: Grid) -> IntArray:
    """Split each cell into six tetrahedra along the same diagonals (Kuhn), which is conforming; (6 m, 4) vertex numbers."""
    parts = []
    for path in permutations(range(3)):
        corner = [0, 0, 0]
        chain = [grid.cells[:, 0, 0, 0]]
        for axis in path:
            corner[axis] = 1
            chain.append(grid.cells[:, corner[0], corner[1], corner[2]])
        parts.append(np.stack(chain, axis=1))
    return np.stack(parts, axis=1).reshape(-1, 4)
