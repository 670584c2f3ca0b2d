"""Documents under the output folder: JSON and CSV, written whole or not at all."""

from __future__ import annotations

import csv
import importlib.metadata
import json
import math
import platform
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from lrbc_cli import __version__
from lrbc_cli.errors import ConfigError, DataError
from lrbc_cli.io.atomic import atomic_write

RESULT_FORMAT, RESULT_VERSION = "lrbc-result", 1


def versions() -> dict[str, str]:
    """Versions of the tool and of what it computes with."""
    out = {"lrbc": __version__, "python": platform.python_version()}
    for package in ("numpy", "scipy", "h5py", "pymetis", "mkl"):
        try:
            out[package] = importlib.metadata.version(package)
        except importlib.metadata.PackageNotFoundError:
            continue
    return out


def plain(value: Any) -> Any:
    """JSON-able copy; numbers that are not finite become null."""
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, np.generic):
        return plain(value.item())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Path):
        return value.as_posix()
    return value


def write_json(path: Path, tree: Mapping[str, Any]) -> None:
    """Write one JSON document atomically.

    Raises
    ------
    ConfigError
        Where the output folder cannot be written.
    """
    try:
        with atomic_write(path) as file:
            json.dump(plain(tree), file, indent=1, ensure_ascii=False, allow_nan=False)
            file.write("\n")
    except OSError as error:
        raise _unwritable(path, error) from error


def _unwritable(path: Path, error: OSError) -> ConfigError:
    return ConfigError(f"the results cannot be written ({error.strerror or error})", file=path, hint="choose another folder in `output`")


def read_json(path: Path, expected: str) -> dict[str, Any] | None:
    """Read a document of ours; None where it is missing.

    Raises
    ------
    DataError
        Where it is damaged or something else.
    """
    if not path.is_file():
        return None
    try:
        tree = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise DataError(f"this result file is damaged ({error})", file=path, hint="run lrbc update --force") from error
    if not isinstance(tree, dict) or tree.get("format") != expected:
        raise DataError("this is not a result file of this tool", file=path, expected=expected, hint="run lrbc update --force")
    return tree


def write_csv(path: Path, header: Sequence[str], rows: Iterable[Sequence[Any]]) -> None:
    """Write a table atomically; NaN and None become empty cells."""

    def cell(value: Any) -> Any:
        if value is None or (isinstance(value, float | np.floating) and not math.isfinite(value)):
            return ""
        return f"{value:.9g}" if isinstance(value, float | np.floating) else value

    try:
        with atomic_write(path) as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(header)
            writer.writerows([cell(value) for value in row] for row in rows)
    except OSError as error:
        raise _unwritable(path, error) from error
