"""Recognises the files of a folder by their content, with the readers that will read them later."""

from __future__ import annotations

import re
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from lrbc_cli.campaign.protect import IN_JOB, IN_OUTPUT
from lrbc_cli.errors import ConfigError, LrbcError
from lrbc_cli.io.common import head
from lrbc_cli.io.encoding import decode
from lrbc_cli.io.frf import read_coherence, read_frf
from lrbc_cli.io.hdf5.layouts import ArrayNames, compressed_groups, is_exodus
from lrbc_cli.io.matrices.read import matrix_names, read_vectors
from lrbc_cli.io.meshes.nodes import read_nodes
from lrbc_cli.io.text.dof_maps import read_dof_map
from lrbc_cli.model.dofs import DofLabels
from lrbc_cli.model.frf import FrfSet

#: Largest number of files, so that no whole disk is searched.
MOST_FILES = 2000

#: Endings of files that are no inputs.
OTHERS = {".md", ".py", ".png", ".jpg", ".svg", ".pdf", ".yaml", ".yml", ".json", ".html", ".ipynb", ".log", ".sh", ".bat", ".m", ".docx"}

#: Kinds of tables with their required and optional columns; the first that fits counts.
TABLES: tuple[tuple[str, set[str], set[str]], ...] = (
    ("dofs", {"dof", "node", "component", "x", "y", "z"}, set()),
    ("map", {"dof", "node", "component"}, set()),
    ("bushings", {"bolt", "node_a", "component", "stiffness"}, {"node_b", "x_x", "x_y", "x_z", "y_x", "y_y", "y_z"}),
    ("named", {"name", "x", "y", "z"}, set()),
    ("points", {"name", "x", "y", "z", "component"}, {"quantity"}),
    ("nodes", {"node", "x", "y", "z"}, set()),
    ("terms", {"dof"}, {"parameter", "bolt", "x", "y", "z"}),
    ("positions", {"x", "y", "z"}, {"parameter", "bolt"}),
)


@dataclass(frozen=True)
class MatrixFound:
    """A matrix with its file, its name in the file if any, its DOF labels, and the names of its arrays if they are not the usual ones."""

    path: Path
    group: str | None
    matrix: Any
    labels: DofLabels | None
    arrays: ArrayNames | None = None

    @property
    def name(self) -> str:
        """Name in the file, else the file name without endings."""
        return self.group or self.path.name.split(".")[0]


@dataclass(kw_only=True)
class FilesFound:
    """Recognised files of a folder, in the order of the paths.

    Attributes
    ----------
    folder : Path
    matrices : list of MatrixFound
    tables : dict of lists of Path
        By the kinds of ``TABLES``; ``nodes`` also contains input files and meshes, ``map`` other DOF maps.
    measurements : dict of FrfSet
    coherences : list of Path
    rest : dict
        Reason why a file was not read, by path.
    """

    folder: Path
    matrices: list[MatrixFound] = field(default_factory=list)
    tables: dict[str, list[Path]] = field(default_factory=dict)
    measurements: dict[Path, FrfSet] = field(default_factory=dict)
    coherences: list[Path] = field(default_factory=list)
    rest: dict[Path, str] = field(default_factory=dict)

    def of(self, kind: str) -> list[Path]:
        """Tables of a kind."""
        return self.tables.get(kind, [])

    def called(self, path: Path) -> str:
        """Path of a file relative to the folder."""
        return path.relative_to(self.folder).as_posix()

    @property
    def size(self) -> int:
        """Number of rows of the model: the most frequent size of square matrices, 0 if there are none."""
        sizes = [found.matrix.shape[0] for found in self.matrices if found.matrix.shape[0] == found.matrix.shape[1] > 1]
        return max(sizes, key=lambda n: (sizes.count(n), n), default=0)


def recognise(folder: Path) -> FilesFound:
    """Recognise every file of a folder and its subfolders.

    Raises
    ------
    ConfigError
        If there is no such folder, or it contains too many files.
    """
    if not folder.is_dir():
        there = folder.exists()
        raise ConfigError(
            "a file, not a folder" if there else "no such folder",
            file=folder,
            place="--from",
            expected="the folder with the files of model and measurements",
            hint=f"--from {folder.parent}" if there else None,
        )
    found, count = FilesFound(folder=folder), 0
    for path in sorted(folder.rglob("*")):
        hidden = any(part.startswith(".") for part in path.relative_to(folder).parts)
        if hidden or _is_result(path) or not path.is_file() or path.suffix.lower() in OTHERS:
            continue
        count += 1
        if count > MOST_FILES:
            raise ConfigError(
                f"more than {MOST_FILES} files",
                file=folder,
                place="--from",
                hint="give the folder that contains model and measurements only",
            )
        _look_at(path, found)
    for path in list(found.rest) if found.size else ():
        # A DOF map is recognised by its number of rows only.
        if can(partial(read_dof_map, path, found.size)):
            del found.rest[path]
            found.tables.setdefault("map", []).append(path)
    return found


def _is_result(path: Path) -> bool:
    """Whether a file lies where ``update`` and ``calibrate`` write: in a folder with ``reduction.json``, or one below it."""
    known = path.name in IN_OUTPUT or path.name in IN_JOB
    return known and any((folder / "reduction.json").is_file() for folder in (path.parent, path.parent.parent))


def _look_at(path: Path, found: FilesFound) -> None:
    kind = _table_kind(path)
    if kind is not None:
        found.tables.setdefault(kind, []).append(path)
        return
    if re.search("coh|koh", path.stem.lower()) and can(lambda: read_coherence(path)):
        found.coherences.append(path)
        return
    why: dict[Callable[[Path, FilesFound], bool], str] = {}
    for take in (_nodes,) if _is_mesh(path) else (_frfs, _matrices, _nodes, _text_frfs):
        try:
            if take(path, found):
                return
        except LrbcError as error:
            why[take] = f"{error.problem}" + (f"; {error.hint}" if error.hint else "")
    if can(lambda: read_coherence(path)):
        found.coherences.append(path)
    else:
        # Report the error of the reader that fits the file's ending.
        promised = PROMISED.get(path.suffix.lower())
        found.rest[path] = (why.get(promised) if promised else None) or next(iter(why.values()), "")


def _table_kind(path: Path) -> str | None:
    """Kind of a table by its header; None if it has no known header."""
    try:
        start = head(path, 1 << 14)
        lines = [] if b"\0" in start else decode(start).splitlines()
    except (OSError, LrbcError, UnicodeError):
        return None
    header = next((line for line in lines if line.strip() and not line.lstrip().startswith("#")), "")
    cells = [cell.strip(" \"'").lower() for cell in header.split(max(",;\t", key=header.count))]
    for kind, needed, further in TABLES:
        if needed <= set(cells) <= needed | further:
            return kind
    return None


def _frfs(path: Path, found: FilesFound) -> bool:
    """Take universal, HDF5, MATLAB and NumPy files with FRFs; text files are tried last (``_text_frfs``)."""
    start = head(path, 4096)
    if b"\0" not in start and not start.lstrip().startswith(b"-1"):
        return False
    return _text_frfs(path, found)


def _text_frfs(path: Path, found: FilesFound) -> bool:
    frf = read_frf(path)
    if frf.records:
        found.measurements[path] = frf
    return bool(frf.records)


def _matrices(path: Path, found: FilesFound) -> bool:
    names = matrix_names(path)
    read = {name: read_vectors(path, name) for name in names}
    found.matrices += [MatrixFound(path, name, one.matrix, one.labels) for name, one in read.items() if min(one.matrix.shape) > 0]
    compressed = 0
    for group, arrays in compressed_groups(path).items():
        # Three arrays of these sizes may be something else.
        with suppress(LrbcError):
            one = read_vectors(path, group, "hdf5", arrays)
            found.matrices.append(MatrixFound(path, group, one.matrix, one.labels, arrays))
            compressed += 1
    return bool(names) or compressed > 0


def _is_mesh(path: Path) -> bool:
    """Whether a file is an exodus mesh (netCDF); its coordinates are no matrix."""
    try:
        return head(path, 4).startswith(b"CDF") or is_exodus(path)
    except LrbcError:
        return False


def _nodes(path: Path, found: FilesFound) -> bool:
    read_nodes(path)
    found.tables.setdefault("nodes", []).append(path)
    return True


#: Reader of files with a given ending.
PROMISED = {
    **dict.fromkeys((".csv", ".txt", ".asc"), _text_frfs),
    **dict.fromkeys((".mtx", ".gz", ".full", ".op4", ".pch", ".mph", ".wbpz"), _matrices),
}


def can(read: Callable[[], object]) -> bool:
    """Whether a reader succeeds."""
    try:
        read()
    except LrbcError:
        return False
    return True
