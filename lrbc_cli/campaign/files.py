"""Reads every file of a campaign by itself, to report all unusable files at once if the model cannot be read."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

from lrbc_cli.campaign.identification.matching import layout_of
from lrbc_cli.config import Campaign, MatrixRef
from lrbc_cli.config.settings import JobConfig, files_of
from lrbc_cli.config.structure import DofSource
from lrbc_cli.errors import LrbcError
from lrbc_cli.io.common import require_file
from lrbc_cli.io.frf import read_coherence, read_frf
from lrbc_cli.io.hdf5.matrices import ArrayNames
from lrbc_cli.io.matrices.read import read_matrix, read_vectors
from lrbc_cli.io.meshes.nodes import read_nodes
from lrbc_cli.io.text.bushings import read_bushings
from lrbc_cli.io.text.tables import is_dof_table, read_dof_list, read_dof_table, read_points, read_positions

Reading = tuple[str, Callable[[], object]]


def unusable_files(campaign: Campaign) -> dict[str, list[LrbcError]]:
    """Errors of the files that cannot be read, by key of the campaign file or by job; each message once.

    Parameters
    ----------
    campaign : Campaign
    """
    found: dict[str, list[LrbcError]] = {}
    said: set[str] = set()
    for key, read in (*_of_model(campaign), *_of_jobs(campaign)):
        try:
            read()
        except LrbcError as error:
            if error.message not in said:
                said.add(error.message)
                found.setdefault(key, []).append(error)
    return found


def _of_model(campaign: Campaign) -> Iterator[Reading]:
    model = campaign.model
    for name in ("stiffness", "mass", "damping"):
        ref = getattr(model, name)
        if isinstance(ref, MatrixRef):
            yield f"model.{name}", _matrix(read_matrix, ref, model.format)
    if isinstance(model.dofs, DofSource):
        yield "model.dofs", partial(read_nodes, model.dofs.nodes)
        yield from (("model.dofs", partial(require_file, file)) for file in (model.dofs.map, model.dofs.order) if file)
    elif model.dofs is not None:
        yield "model.dofs", partial(read_dof_table if _is_table(campaign) else read_nodes, model.dofs)
    for section, points in (("excitation", campaign.excitation), ("responses", campaign.responses)):
        for name, point in points.items():
            ref = point.vector or getattr(point, "matrix", None)
            if ref is not None:
                yield f"{section}.{name}", _matrix(read_vectors, ref)
    if campaign.bolts is not None:
        yield "bolts", partial(read_points, campaign.bolts)
    readers = {"dofs": read_dof_list, "positions": read_positions, "bushings": read_bushings}
    for name, group in campaign.parameters.items():
        for key in ("vectors", "left", "right"):
            if (ref := getattr(group.select, key)) is not None:
                yield f"parameters.{name}", _matrix(read_vectors, ref)
        for key, reader in readers.items():
            if (file := getattr(group.select, key)) is not None:
                yield f"parameters.{name}", partial(reader, file)
    for name, share in campaign.calibration.groups.items() if campaign.calibration is not None else ():
        for key in ("stiffness", "mass", "damping"):
            if (ref := getattr(share, key)) is not None:
                yield f"calibration.groups.{name}", _matrix(read_matrix, ref, model.format)


def _of_jobs(campaign: Campaign) -> Iterator[Reading]:
    for name, job in campaign.jobs.items():
        yield from ((name, partial(_frf, job, file)) for files in job.measurements for file in files)
        yield from ((name, partial(_coherence, job, file)) for file in files_of(job.coherence))


def _frf(job: JobConfig, file: Path) -> object:
    return read_frf(file, layout_of(job, file))


def _coherence(job: JobConfig, file: Path) -> object:
    return read_coherence(file, layout_of(job, file, of_coherence=True))


def _matrix(read: Callable[..., object], ref: Any, format: str | None = None) -> Callable[[], object]:
    arrays = None if ref.arrays is None else ArrayNames(**ref.arrays.model_dump())
    return partial(read, ref.path, ref.group, ref.format or format, arrays)


def _is_table(campaign: Campaign) -> bool:
    try:
        return is_dof_table(campaign.model.dofs)  # type: ignore[arg-type]
    except LrbcError:
        return True  # the reader says what is wrong
