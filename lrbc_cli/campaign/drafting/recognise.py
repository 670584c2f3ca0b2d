"""What the files of a folder are, by their content, with the readers that read them later."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from lrbc_cli.errors import ConfigError, LrbcError
from lrbc_cli.io.common import head
from lrbc_cli.io.encoding import decode
from lrbc_cli.io.frf import read_coherence, read_frf
from lrbc_cli.io.matrices.read import matrix_names, read_vectors
from lrbc_cli.io.text.dof_maps import read_dof_map
from lrbc_cli.io.text.nodes import read_nodes
from lrbc_cli.model.dofs import DofLabels
from lrbc_cli.model.frf import FrfSet

#: Files looked at, at most: a folder of measurements, no disk.
MOST_FILES = 2000

#: What is no input, whatever it holds.
OTHERS = {".md", ".py", ".png", ".jpg", ".svg", ".pdf", ".yaml", ".yml", ".json", ".html", ".ipynb", ".log", ".sh", ".bat", ".m", ".docx"}

#: Columns that a table must have, and may have beside them, to be of a kind; the first that fits.
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
    """A matrix, and what it is called: its group, else its file."""

    path: Path
    group: str | None
    matrix: Any
    labels: DofLabels | None

    @property
    def name(self) -> str:
        """Without endings."""
        return self.group or self.path.name.split(".")[0]


@dataclass(kw_only=True)
class FilesFound:
    """What was recognised, in the order of the paths.

    Attributes
    ----------
    folder : Path
        Where it lies.
    matrices : list of MatrixFound
    tables : dict of lists of Path
        By the kinds of ``TABLES``; ``nodes`` holds input files and meshes too, ``map`` other DOF maps.
    measurements : dict of FrfSet
    coherences : list of Path
    rest : dict
        Why a file is none of these.
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
        """A file with its folder below that of all."""
        return path.relative_to(self.folder).as_posix()

    @property
    def size(self) -> int:
        """Rows of the model: of most square matrices, 0 where there is none."""
        sizes = [found.matrix.shape[0] for found in self.matrices if found.matrix.shape[0] == found.matrix.shape[1] > 1]
        return max(sizes, key=lambda n: (sizes.count(n), n), default=0)


def recognise(folder: Path) -> FilesFound:
    """Look at every file of a folder and of those in it.

    Raises
    ------
    ConfigError
        Where there is no such folder, or it holds too many files.
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
        if hidden or not path.is_file() or path.suffix.lower() in OTHERS:
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
        # A map can only be told by the number of rows.
        if can(partial(read_dof_map, path, found.size)):
            del found.rest[path]
            found.tables.setdefault("map", []).append(path)
    return found


def _look_at(path: Path, found: FilesFound) -> None:
    kind = _table_kind(path)
    if kind is not None:
        found.tables.setdefault(kind, []).append(path)
        return
    if re.search("coh|koh", path.stem.lower()) and can(lambda: read_coherence(path)):
        found.coherences.append(path)
        return
    why: dict[Callable[[Path, FilesFound], bool], str] = {}
    for take in (_frfs, _matrices, _nodes, _text_frfs):
        try:
            if take(path, found):
                return
        except LrbcError as error:
            why[take] = f"{error.problem}" + (f"; {error.hint}" if error.hint else "")
    if can(lambda: read_coherence(path)):
        found.coherences.append(path)
    else:
        # Of all readers the one that its ending promises.
        promised = PROMISED.get(path.suffix.lower())
        found.rest[path] = (why.get(promised) if promised else None) or next(iter(why.values()), "")


def _table_kind(path: Path) -> str | None:
    """By the header of a table; None for what has none."""
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
    """Universal files, and HDF5 and MATLAB files that hold FRFs; text is taken for them last."""
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
    for name in names:
        read = read_vectors(path, name)
        if min(read.matrix.shape) > 0:
            found.matrices.append(MatrixFound(path, name, read.matrix, read.labels))
    return bool(names)


def _nodes(path: Path, found: FilesFound) -> bool:
    read_nodes(path)
    found.tables.setdefault("nodes", []).append(path)
    return True


#: What reads files with an ending, where it says so.
PROMISED = {
    **dict.fromkeys((".csv", ".txt", ".asc"), _text_frfs),
    **dict.fromkeys((".mtx", ".gz", ".full", ".op4", ".pch"), _matrices),
}


def can(read: Callable[[], object]) -> bool:
    """Whether a file can be read so."""
    try:
        read()
    except LrbcError:
        return False
    return True
