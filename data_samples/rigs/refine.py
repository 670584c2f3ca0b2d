"""A design on a finer or coarser mesh, and as many rotations along its edges as are wanted: nominal models of any size."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import scipy.io

from rigs.campaign import campaign_text
from rigs.cavity import IntArray
from rigs.design import EDGES, Design, Mesh
from rigs.nominal import COMPONENTS, Model, build, edge_nodes, free_plate_dofs, point_load, write

#: Meshes that are tried, as factors on the number of cells along each line, and how much more or less than along x and y there are along z.
FACTORS = np.arange(0.4, 4.0, 0.01)
DEPTH_FACTORS = np.arange(0.9, 1.11, 0.02)
#: Elements along either side of the plate are at least as many: the terms along an edge are its nodes.
PLATE_CELLS = 32


def scaled(design: Design, factor: float, depth: float = 1.0) -> Design:
    """The same design with `factor` times as many cells along every line of its nominal mesh, along z times `depth` besides."""
    old = design.nominal

    def times(count: int, least: int = 1, more: float = 1.0) -> int:
        return max(round(factor * more * count), least)

    aperture = tuple(times(n, 2) for n in old.aperture)
    plate = max(old.plate, -(-PLATE_CELLS // min(aperture)))
    cells = tuple(n * plate for n in aperture)
    left, right, below, above = (times(n) for n in old.sides)
    return replace(
        design,
        nominal=Mesh(
            (aperture[0], aperture[1]),
            (left, right, below, above),
            tuple(times(n, more=depth) for n in old.depths),
            plate,
            times(old.neck, more=depth),
        ),
        plate_cells=(cells[0], cells[1]),
        plate_step=tuple(h * a / b for h, a, b in zip(design.plate_step, design.plate_cells, cells, strict=True)),
    )


def size(design: Design) -> int:
    """DOFs of the nominal model, without assembling it."""
    mesh = design.nominal
    (ax, ay), (left, right, below, above), along_z = mesh.aperture, mesh.sides, sum(mesh.depths)
    # Split along its diagonals, a cell has nodes on all points of the lattice of half its size.
    box = (2 * (left + ax + right) + 1) * (2 * (below + ay + above) + 1) * (2 * along_z + 1)
    return free_plate_dofs(design).size + box + (2 * ax + 1) * (2 * ay + 1) * 2 * mesh.neck


def refined(design: Design, dofs: int) -> Design:
    """The design on the mesh whose number of DOFs is nearest to the wanted one.

    Parameters
    ----------
    design : Design
    dofs : int

    Raises
    ------
    ValueError
        Where no mesh comes within a tenth of it.
    """
    # Evenly refined meshes first.
    depths = sorted(DEPTH_FACTORS, key=lambda depth: abs(np.log(depth)))
    found = {s.nominal: s for s in (scaled(design, f, depth) for depth in depths for f in FACTORS)}
    best = min(found.values(), key=lambda s: max(abs(size(s) / dofs - 1), 0.01))
    if abs(size(best) - dofs) > 0.1 * dofs:
        sizes = sorted(map(size, found.values()))
        raise ValueError(f"{design.name} has no mesh of about {dofs} DOFs: {sizes[0]} to {sizes[-1]}")
    return best


@dataclass(frozen=True)
class Terms:
    """Rotations along edges of the plate.

    Attributes
    ----------
    edges : tuple of str
    count : int
        Of all edges together, spread evenly. Where the nodes of the edges have no more rotations across them, those along them come too,
        then both rotations of the nodes on the next line inside, and so on.
    """

    edges: tuple[str, ...] = ("left",)
    count: int = 31

    def support(self, design: Design) -> Design:
        """The design with these edges pinned, held at their nodes only where rotations along them are wanted."""
        across = sum(edge_nodes(design, edge)[0].size for edge in self.edges)
        return replace(design, pinned=self.edges, held_at_nodes=design.held_at_nodes or self.count > across)

    def select(self, design: Design, model: Model) -> dict[str, IntArray]:
        """DOFs of the terms by edge, in order along it.

        Raises
        ------
        ValueError
            Where the plate has fewer rotations.
        """
        number = {(int(n), str(c)): k for k, (n, c) in enumerate(zip(model.node, model.component, strict=True)) if c in COMPONENTS}
        found: list[tuple[int, int]] = []
        seen: set[int] = set()
        row = 0
        while len(found) < self.count:
            before = len(found)
            for across in (True, False):
                for edge in self.edges:
                    component = "ROTY" if (edge in ("left", "right")) == across else "ROTX"
                    i, j = edge_nodes(design, edge, row)
                    for node in (i * (design.plate_cells[1] + 1) + j + 1).tolist():
                        dof = number.get((node, component))
                        if dof is not None and dof not in seen:
                            seen.add(dof)
                            found.append((EDGES.index(edge), dof))
                if len(found) >= self.count:
                    break
            if len(found) == before:
                raise ValueError(f"the plate has {before} rotations, not {self.count}")
            row += 1
        at = ((np.arange(self.count) + 0.5) * len(found) / self.count).astype(int)
        chosen = np.array(found)[at]
        return {edge: chosen[chosen[:, 0] == EDGES.index(edge), 1] for edge in self.edges if EDGES.index(edge) in chosen[:, 0]}


def write_model(design: Design, folder: Path) -> Model:
    """Write ``model.h5``, ``dofs.csv``, ``bolts.csv`` and the load ``hammer.mtx``: a mesh need not have a node at the hammer."""
    model = build(design)
    write(design, model, folder)
    load = point_load(design, *design.hammer)
    load.resize(model.mass.shape[0], 1)
    scipy.io.mmwrite(folder / "hammer.mtx", load, symmetry="general")
    return model


def write_refined(
    design: Design,
    model: Model,
    terms: Terms,
    folder: Path,
    frf: Path,
    jobs: Mapping[str, Sequence[str]],
    name: str,
) -> Path:
    """Write a campaign file with these terms beside the model, for measurements of the same rig; returns the file.

    Parameters
    ----------
    design : Design
        As `model` was built from it.
    model : Model
    terms : Terms
    folder : Path
        Of the model.
    frf : Path
        Folder of the measurements.
    jobs : mapping of str to names of bolts
        As for ``campaign_text``.
    name : str
        Of the campaign and its file.
    """
    groups = {}
    for edge, dofs in terms.select(design, model).items():
        file = f"{name}-{edge}.csv"
        (folder / file).write_text("dof\n" + "\n".join(map(str, dofs.tolist())) + "\n", encoding="utf-8", newline="\n")
        groups[f"{edge}_edge"] = f"{{dofs: {file}}}"
    try:
        where = Path(os.path.relpath(frf.resolve(), folder.resolve())).as_posix()
    except ValueError:  # another drive
        where = frf.resolve().as_posix()
    text = campaign_text(design, name, ".", jobs, frf=where, hammer="{vector: hammer.mtx}", groups=groups)
    path = folder / f"{name}.yaml"
    path.write_text(text, encoding="utf-8", newline="\n")
    return path
