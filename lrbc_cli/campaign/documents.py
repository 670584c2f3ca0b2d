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
from lrbc_cli.config import Campaign
from lrbc_cli.errors import ConfigError, DataError
from lrbc_cli.io.atomic import atomic_write

RESULT_FORMAT, RESULT_VERSION = "lrbc-result", 1
CAMPAIGN_FORMAT = "lrbc-campaign"


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
        Where it is damaged, of another version, or something else.
    ConfigError
        Where the output folder cannot be read at all.
    """
    try:
        if not path.is_file():
            return None
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        problem = f"the results cannot be read ({error.strerror or error})"
        raise ConfigError(problem, file=path, hint="choose another folder in `output`") from error
    except ValueError as error:
        raise DataError("this result file is damaged: it is not UTF-8 text", file=path, hint=_HINT) from error
    try:
        tree = json.loads(text, parse_constant=_refuse)
    except (ValueError, RecursionError) as error:
        raise DataError(f"this result file is damaged: {str(error)[:100]}", file=path, hint=_HINT) from error
    if not isinstance(tree, dict) or tree.get("format") != expected:
        raise DataError("this is not a result file of this tool", file=path, expected=expected, hint=_HINT)
    if type(tree.get("version")) is not int or tree["version"] != RESULT_VERSION:
        raise DataError(
            "this result file is of another version",
            file=path,
            place="version",
            expected=RESULT_VERSION,
            found=tree.get("version", "none"),
            hint=_HINT,
        )
    if expected == RESULT_FORMAT:
        wrong = _difference(tree, _FAILED if tree.get("status") == "failed" else _RESULT)
        if wrong is not None:
            place, form, found = wrong
            raise DataError("this result file is damaged", file=path, place=place, expected=form, found=found, hint=_HINT)
    return tree


def _refuse(name: str) -> Any:
    raise ValueError(f"{name} is no JSON")


_HINT = "run lrbc update --force"
_NUMBER, _TEXT, _MAYBE = (int, float), (str,), (int, float, type(None))
_FAILED: dict[str, Any] = {"job": _TEXT, "status": _TEXT, "reason": _TEXT, "provenance": {}}
#: What is read back of a result: types by key; a list holds things of its one form, a dictionary under ``*`` likewise.
_RESULT: dict[str, Any] = _FAILED | {
    "parameters": {"*": {"log10": [_NUMBER], "log10_effective": [_MAYBE]}},
    "bolts": [{"name": _TEXT, "verdict": _TEXT}],
    "misfit_db": {"initial": _MAYBE, "final": _MAYBE, "held_out_final": _MAYBE},
    "cost": {"initial": _MAYBE, "final": _MAYBE},
    "iterations": _NUMBER,
    "evaluations": _NUMBER,
    "line_evaluations": _NUMBER,
    "seconds": {"total": _NUMBER},
    "removed": (list, type(None)),
}


def _difference(value: Any, form: Any, place: str = "") -> tuple[str, str, str] | None:
    """Key path, what was expected and what was found, where a value first differs from its form."""
    if isinstance(form, tuple):
        if isinstance(value, form) and not isinstance(value, bool):
            return None
        return place, " or ".join("null" if t is type(None) else t.__name__ for t in form), repr(value)
    if not isinstance(value, type(form)):
        return place, "an object" if isinstance(form, dict) else "a list", repr(value)
    if isinstance(form, list):
        parts = [(f"{place}[{i}]", item, form[0]) for i, item in enumerate(value)]
    elif "*" in form:
        parts = [(f"{place}.{key}", item, form["*"]) for key, item in value.items()]
    else:
        for key in form:
            if key not in value:
                return f"{place}.{key}".lstrip("."), "a value", "no such key"
        parts = [(f"{place}.{key}".lstrip("."), value[key], below) for key, below in form.items()]
    return next((found for at, item, below in parts if (found := _difference(item, below, at)) is not None), None)


def require_own_output(campaign: Campaign) -> None:
    """Refuse an output folder with the results of another campaign: jobs of one name would pass for each other.

    Raises
    ------
    ConfigError
    """
    path = campaign.output / "campaign.json"
    try:
        tree = read_json(path, CAMPAIGN_FORMAT)
    except DataError:
        return  # damaged: it is written anew, or the report says so
    other = None if tree is None else tree.get("campaign")
    if isinstance(other, str) and other != campaign.name:
        raise campaign.error(
            "the output folder holds the results of another campaign",
            "output",
            expected=f"results of '{campaign.name}' in {campaign.output}",
            found=f"those of '{other}'",
            hint="choose another `output`, or remove the folder; if the campaign was only renamed, remove its campaign.json",
        )


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
