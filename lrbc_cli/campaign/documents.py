"""Documents under the output folder: JSON and CSV, written whole or not at all."""

from __future__ import annotations

import csv
import hashlib
import importlib.metadata
import io
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
from lrbc_cli.io.json_text import parse_json, read_json_text

RESULT_FORMAT, EVIDENCE_FORMAT, RESULT_VERSION = "lrbc-result", "lrbc-evidence", 1
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


def write_json(path: Path, tree: Mapping[str, Any]) -> str:
    """Write one JSON document atomically.

    Returns
    -------
    str
        SHA-256 of its bytes.

    Raises
    ------
    ConfigError
        Where the output folder cannot be written.
    """
    text = json.dumps(plain(tree), indent=1, ensure_ascii=False, allow_nan=False) + "\n"
    return _write(path, text.encode("utf-8"))


def _write(path: Path, content: bytes) -> str:
    """Write bytes atomically; the SHA-256 of those written, as another process may replace the file at once."""
    try:
        with atomic_write(path, "wb") as file:
            file.write(content)
    except OSError as error:
        raise _unwritable(path, error) from error
    return hashlib.sha256(content).hexdigest()


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
        text = read_json_text(path)
    except OSError as error:
        problem = f"the results cannot be read ({error.strerror or error})"
        raise ConfigError(problem, file=path, hint="choose another folder in `output`") from error
    except UnicodeDecodeError as error:
        raise DataError("this result file is damaged: it is not UTF-8 text", file=path, hint=_HINT) from error
    except ValueError as error:
        raise DataError(f"this result file is damaged: {error}", file=path, hint=_HINT) from error
    try:
        tree = parse_json(text)
    except ValueError as error:
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
        failed = tree.get("status") == "failed"
        wrong = _difference(tree, _FAILED if failed else _RESULT) or (None if failed else _uneven(tree))
        if wrong is not None:
            place, form, found = wrong
            raise DataError("this result file is damaged", file=path, place=place, expected=form, found=found, hint=_HINT)
    return tree


_HINT = "run lrbc update --force"
_NUMBER, _TEXT, _MAYBE = (int, float), (str,), (int, float, type(None))
STATUSES = frozenset(("converged", "stopped", "unexplained", "failed"))
VERDICTS = frozenset(("tight", "loose", "undecided", "outside"))
_FAILED: dict[str, Any] = {"job": _TEXT, "status": STATUSES, "reason": _TEXT, "provenance": {"identity?": _TEXT}}
#: What is read back of a result: types, or words, by key; a list holds things of its one form, a dictionary under ``*`` likewise. A key
#: that ends in ``?`` may be absent or null.
_RESULT: dict[str, Any] = _FAILED | {
    "parameters": {
        "*": {
            "log10": [_NUMBER],
            "log10_effective": [_MAYBE],
            "std?": [_MAYBE],
            "damping_exponent?": _NUMBER,
            "damping_factor?": _NUMBER,
        }
    },
    "covariance?": [[_MAYBE]],
    "bolts": [{"name": _TEXT, "verdict": VERDICTS, "change?": _NUMBER, "change_std?": _NUMBER, "probability_loose?": _NUMBER}],
    "misfit_db": {"initial": _MAYBE, "final": _NUMBER, "held_out_final": _MAYBE},
    "validity?": {"passed?": (bool,)},
    "cost": {"initial": _MAYBE, "final": _MAYBE},
    "noise": {"sigma_db": _NUMBER, "correlation_factor": _NUMBER},
    "nuisances?": {"hammer_offset_mm?": {"*": {"value": _NUMBER}}},
    "correlation?": {"frac_initial?": _NUMBER, "frac_final?": _NUMBER},
    "taken_as_tight?": {"as": _TEXT, "doubtful": [_TEXT]},
    "iterations": _NUMBER,
    "evaluations": _NUMBER,
    "line_evaluations": _NUMBER,
    "seconds": {"total": _NUMBER},
    "removed?": [_TEXT],
    "warnings?": [_TEXT],
    "provenance": {
        "identity?": _TEXT,
        "certificate?": {"key?": _TEXT},
        "files?": {"*": _TEXT},
        "rests_on?": {"reference?": _TEXT, "baselines": {"*": _TEXT}},
    },
}


def _difference(value: Any, form: Any, place: str = "") -> tuple[str, str, str] | None:
    """Key path, what was expected and what was found, where a value first differs from its form."""
    if isinstance(form, tuple):
        if isinstance(value, form) and (not isinstance(value, bool) or bool in form):
            return None
        return place, " or ".join("null" if t is type(None) else t.__name__ for t in form), repr(value)
    if isinstance(form, frozenset):
        known = isinstance(value, str) and value in form
        return None if known else (place, " or ".join(sorted(form)), value if isinstance(value, str) else repr(value))
    if not isinstance(value, type(form)):
        return place, "an object" if isinstance(form, dict) else "a list", repr(value)
    if isinstance(form, list):
        parts = [(f"{place}[{i}]", item, form[0]) for i, item in enumerate(value)]
    elif "*" in form:
        parts = [(f"{place}.{key}", item, form["*"]) for key, item in value.items()]
    else:
        parts = []
        for key, below in form.items():
            name = key.removesuffix("?")
            if name == key and key not in value:
                return f"{place}.{key}".lstrip("."), "a value", "no such key"
            if name == key or value.get(name) is not None:
                parts.append((f"{place}.{name}".lstrip("."), value[name], below))
    return next((found for at, item, below in parts if (found := _difference(item, below, at)) is not None), None)


def _uneven(tree: Mapping[str, Any]) -> tuple[str, str, str] | None:
    """The same where values that belong together do not come together, or not in equal number."""
    for name, group in tree["parameters"].items():
        for key in ("damping_exponent", "damping_factor"):
            if ("damping_exponent" in group or "damping_factor" in group) and group.get(key) is None:
                return f"parameters.{name}.{key}", "a number", "none"
        for key in ("log10_effective", "std"):
            found = group.get(key)
            if found is not None and len(found) != len(group["log10"]):
                return f"parameters.{name}.{key}", f"{len(group['log10'])} values", f"{len(found)} values"
    rows = tree.get("covariance") or []
    wrong = [i for i, row in enumerate(rows) if len(row) != len(rows)]
    return (f"covariance[{wrong[0]}]", f"{len(rows)} values", f"{len(rows[wrong[0]])} values") if wrong else None


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


def write_csv(path: Path, header: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    """Write a table atomically; NaN and None become empty cells.

    Returns
    -------
    str
        SHA-256 of its bytes.

    Raises
    ------
    ConfigError
        Where the output folder cannot be written.
    """

    def cell(value: Any) -> Any:
        if value is None or (isinstance(value, float | np.floating) and not math.isfinite(value)):
            return ""
        return f"{value:.9g}" if isinstance(value, float | np.floating) else value

    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(header)
    writer.writerows([cell(value) for value in row] for row in rows)
    return _write(path, text.getvalue().encode("utf-8"))
