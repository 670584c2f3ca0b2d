"""Model of the section ``watch``: a folder of measurements in which each file is a job, and its files."""

from __future__ import annotations

import os
from collections.abc import Collection, Iterator
from fnmatch import fnmatch
from pathlib import Path
from typing import Annotated

from pydantic import AfterValidator, Field, Tag

from lrbc_cli.config.fields import FilePath, Name, Strict, check_unique, problem, shown, told_apart, unspeakable

#: Endings of measurement files that analysers write.
MEASURED = {
    *(".uff", ".unv", ".bunv", ".ufb", ".uf58", ".u58", ".58", ".csv", ".txt", ".asc", ".ascii", ".dat", ".frf", ".h5", ".hdf5", ".mat"),
    *(".npz", ".tdms", ".lvm", ".xls", ".xlsx", ".npy"),
}

#: Beginnings of the names of hidden files and of lock files of editors and office programs.
HIDDEN = (".", "~$")


def _check_pattern(value: str) -> str:
    if "/" in value or "\\" in value or not value.strip():
        raise problem("this is not a pattern of file names", expected="such as '*.uff', without a folder", found=f"'{value}'")
    return value


Pattern = Annotated[str, AfterValidator(_check_pattern)]


class WatchConfig(Strict):
    """A folder of measurements: each file in it is a job with the name of the file."""

    folder: FilePath = Field(description="Folder into which FRF files are written, relative to the campaign file.")
    pattern: Annotated[
        Annotated[Pattern, Tag("form:one")]
        | Annotated[tuple[Pattern, ...], Field(min_length=1), AfterValidator(check_unique), Tag("form:list")],
        told_apart(str, "one", "list"),
    ] = Field(
        default=("*.uff", "*.unv", "*.csv", "*.txt", "*.h5", "*.hdf5", "*.mat", "*.npz"),
        description="Files in it that are measurements: one pattern or several. Upper and lower case are the same.",
    )
    like: Name | None = Field(
        default=None,
        description="Job whose format, records, scale and averages apply to the files of the folder. If omitted: the reference job.",
    )

    @property
    def patterns(self) -> tuple[str, ...]:
        """The patterns of file names as a tuple."""
        return (self.pattern,) if isinstance(self.pattern, str) else self.pattern

    @property
    def in_reach(self) -> bool:
        """Whether the folder can be read."""
        try:
            next(self.folder.iterdir(), None)
        except OSError:
            return False
        return True

    def files(self) -> Iterator[Path]:
        """Files that match a pattern, by name, without hidden, temporary and ``unspeakable`` ones; none if the folder cannot be read."""
        try:
            found = sorted(path for path in self.folder.iterdir() if not path.name.startswith((".", "~")) and not unspeakable(path))
        except OSError:
            return
        yield from filter(self._matches, found)

    def _matches(self, path: Path) -> bool:
        return any(fnmatch(path.name.lower(), pattern.lower()) for pattern in self.patterns)

    def passed_over(self, named: Collection[Path], output: Path) -> Iterator[str]:
        """Messages on files in the folder and below that look like measurements but belong to no job.

        Parameters
        ----------
        named : collection of Path
            Files named in the campaign file.
        output : Path
            Folder of the results, which is not searched.
        """
        # Links and their targets are one file.
        mine = set(map(os.path.realpath, (*named, *self.files())))
        try:
            found = sorted(self.folder.iterdir()) if self.in_reach else []
        except OSError:
            return
        for path in found:
            if os.path.realpath(path) in mine or path.name.startswith(HIDDEN):
                continue
            if unspeakable(path):
                yield f"{shown(path)} in {self.folder} is not judged: its name is not UTF-8. Rename it"
                continue
            if path.is_dir():
                below = (file for file in _below(path, output) if file.suffix.lower() in MEASURED or self._matches(file))
                first = next((file for file in below if os.path.realpath(file) not in mine), None)
                if first is not None and not unspeakable(first):
                    yield (
                        f"{first.relative_to(self.folder)} in {self.folder} lies in a sub-folder: it is not judged, nor is anything else "
                        "there. Move measurements up into the watched folder, or list them under `jobs`; move everything else out of it"
                    )
            elif path.name.startswith("~") and (path.suffix.lower() in MEASURED or self._matches(path)):
                yield (
                    f"{path.name} in {self.folder} begins with '~' like a temporary file and is not judged: rename it if it is a "
                    "measurement, else remove it"
                )
            elif path.suffix.lower() in MEASURED:
                yield (
                    f"{path.name} in {self.folder} matches no pattern of watch.pattern ({', '.join(self.patterns)}) and is not judged: "
                    f"add '*{path.suffix}' there if it is a measurement, else move it out of the folder"
                )


def _below(folder: Path, output: Path) -> Iterator[Path]:
    """Files of a folder and its sub-folders, sorted by name, without hidden ones and results."""
    for at, folders, names in os.walk(folder):
        if Path(at) == output:
            folders.clear()
            continue
        folders[:] = sorted(name for name in folders if not name.startswith(HIDDEN))
        yield from (Path(at, name) for name in sorted(names) if not name.startswith(HIDDEN))
