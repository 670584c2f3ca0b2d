"""Reading result files: JSON documents and CSV tables in which every slip becomes one clear message."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lrbc_cli.errors import DataError
from lrbc_cli.io.json_text import parse_json, read_json_text

HINT = "run `lrbc update` to write the results anew (`--force` for finished jobs)"

FloatArray = NDArray[np.float64]


def read_text(file: Path, *, json_text: bool = False) -> str:
    """Read a UTF-8 file; JSON no longer than any of ours.

    Raises
    ------
    DataError
        Where it is missing, unreadable, not text or too long.
    """
    try:
        return read_json_text(file) if json_text else file.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise DataError("this result file is missing", file=file, hint=HINT) from None
    except UnicodeDecodeError as error:
        raise DataError("this result file is damaged: it is not UTF-8 text", file=file, place=f"byte {error.start}", hint=HINT) from None
    except ValueError as error:
        raise DataError(f"this result file is damaged: {error}", file=file, hint=HINT) from None
    except OSError as error:
        raise DataError(f"this result file cannot be read: {error.strerror}", file=file, hint=HINT) from None


class Node:
    """One JSON object of a result file; every access checks type and names the key path in its message.

    Parameters
    ----------
    value
        The object, already parsed.
    file
        For messages.
    path
        Dotted key path of this object in the file; empty for the document itself.
    """

    def __init__(self, value: object, file: Path, path: str = "") -> None:
        self.file = file
        self.path = path
        if not isinstance(value, dict):
            raise self.wrong("", "an object", value)
        self._value: dict[str, Any] = value

    def wrong(self, key: str, expected: object, found: object) -> DataError:
        """Return the error that says what stands under a key in place of what was expected."""
        place = ".".join(part for part in (self.path, key) if part) or "document"
        text = repr(found)
        return DataError(
            "this result file is damaged",
            file=self.file,
            place=place,
            expected=expected,
            found=text if len(text) < 80 else text[:77] + "...",
            hint=HINT,
        )

    def _get(self, key: str, expected: str) -> Any:
        if key not in self._value:
            raise self.wrong(key, expected, "no such key")
        return self._value[key]

    def has(self, key: str) -> bool:
        """Tell whether the key exists with a value other than null."""
        return self._value.get(key) is not None

    def raw(self, key: str) -> Any:
        """Return whatever stands under the key, or None; for values that are only shown."""
        return self._value.get(key)

    def text(self, key: str) -> str:
        """Return a string."""
        value = self._get(key, "text")
        if not isinstance(value, str):
            raise self.wrong(key, "text", value)
        return value

    def choice(self, key: str, allowed: tuple[str, ...]) -> str:
        """Return one of the allowed strings."""
        value = self.text(key)
        if value not in allowed:
            raise self.wrong(key, " | ".join(allowed), value)
        return value

    def flag(self, key: str) -> bool:
        """Return a boolean."""
        value = self._get(key, "true or false")
        if not isinstance(value, bool):
            raise self.wrong(key, "true or false", value)
        return value

    def number(self, key: str) -> float:
        """Return a number; null stands for NaN."""
        value = self._get(key, "a number")
        if value is None:
            return float("nan")
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise self.wrong(key, "a number", value)
        return float(value)

    def maybe_text(self, key: str) -> str | None:
        """Return a string, or None where it is absent or null."""
        return self.text(key) if self.has(key) else None

    def maybe_flag(self, key: str) -> bool | None:
        """Return a boolean, or None where it is absent or null."""
        return self.flag(key) if self.has(key) else None

    def maybe_number(self, key: str) -> float | None:
        """Return a number, or None where it is absent or null."""
        return self.number(key) if self.has(key) else None

    def array(self, key: str, *, size: int | None = None, width: int | None = None) -> FloatArray:
        """Return an array of numbers, null as NaN.

        Parameters
        ----------
        key
            Its key.
        size
            The number of entries (rows) that it must have.
        width
            The number of columns of a two-dimensional array; None for a plain list.
        """
        expected = f"{'any number of' if size is None else size} {'numbers' if width is None else f'rows of {width} numbers'}"
        value = self._get(key, expected)
        try:
            array = np.array(value, dtype=float)
        except (TypeError, ValueError):
            raise self.wrong(key, expected, value) from None
        if width is not None and array.size == 0:
            array = array.reshape(0, width)
        if array.ndim != (1 if width is None else 2) or (width is not None and array.shape[1] != width):
            raise self.wrong(key, expected, value)
        if size is not None and len(array) != size:
            raise self.wrong(key, expected, f"{len(array)} entries")
        return array

    def maybe_array(self, key: str, *, size: int | None = None, width: int | None = None) -> FloatArray | None:
        """Return an array as `array` does, or None where it is absent or null."""
        return self.array(key, size=size, width=width) if self.has(key) else None

    def texts(self, key: str) -> tuple[str, ...]:
        """Return a list of strings."""
        value = self._get(key, "a list of names")
        if not isinstance(value, list) or not all(isinstance(entry, str) for entry in value):
            raise self.wrong(key, "a list of names", value)
        return tuple(value)

    def node(self, key: str) -> Node:
        """Return an object."""
        return Node(self._get(key, "an object"), self.file, self._below(key))

    def maybe_node(self, key: str) -> Node:
        """Return an object; an empty one where it is absent or null."""
        return self.node(key) if self.has(key) else Node({}, self.file, self._below(key))

    def nodes(self, key: str) -> Iterator[Node]:
        """Iterate over a list of objects; nothing where it is absent or null."""
        if not self.has(key):
            return
        value = self._value[key]
        if not isinstance(value, list):
            raise self.wrong(key, "a list of objects", value)
        for index, entry in enumerate(value):
            yield Node(entry, self.file, f"{self._below(key)}[{index}]")

    def items(self) -> Iterator[tuple[str, Node]]:
        """Iterate over the members, each of which must be an object."""
        for key in self._value:
            yield key, self.node(key)

    def _below(self, key: str) -> str:
        return f"{self.path}.{key}" if self.path else key


def mapping_of(value: Any) -> dict[str, Any]:
    """Return an object that is only shown; an empty one for anything else."""
    return value if isinstance(value, dict) else {}


def numbers_of(value: Any) -> dict[str, float]:
    """Return the members of an object that are numbers."""
    return {key: float(entry) for key, entry in mapping_of(value).items() if isinstance(entry, int | float)}


def read_document(file: Path, form: str, version: int = 1) -> Node:
    """Read a JSON result file and check what it says that it is.

    Parameters
    ----------
    file
        The file.
    form
        What its key ``format`` must say.
    version
        The newest version that this program knows.

    Raises
    ------
    DataError
        Where it is missing, no JSON, another format, or of a later version.
    """
    try:
        value = parse_json(read_text(file, json_text=True))
    except json.JSONDecodeError as error:
        place = f"line {error.lineno}, column {error.colno}"
        raise DataError("this result file is damaged: it is not JSON", file=file, place=place, found=error.msg, hint=HINT) from None
    except ValueError as error:
        raise DataError(f"this result file is damaged: {error}", file=file, hint=HINT) from None
    node = Node(value, file)
    node.choice("format", (form,))
    found = node.number("version")
    if not 1 <= found <= version:
        raise DataError(
            "this result file was written by another version of the program",
            file=file,
            place="version",
            expected=f"1 to {version}",
            found=f"{found:g}",
            hint="update the program, or " + HINT,
        )
    return node


def require_files(folder: Path, hashes: object) -> None:
    """Refuse tables that are not those which were written with the result beside them: two runs would be shown as one.

    Parameters
    ----------
    folder
        Of the job.
    hashes
        SHA-256 by file name, as the result has them.

    Raises
    ------
    DataError
        Where a file is missing, or another.
    """
    hint = "two runs are mixed, or the file was changed: run `lrbc update`, which identifies this job again"
    for name, digest in mapping_of(hashes).items():
        file = folder / name
        if Path(name).name != name or name in ("", ".", ".."):
            raise DataError("this result file is damaged", file=folder / "result.json", place="provenance.files", found=name, hint=HINT)
        try:
            found = hashlib.sha256(file.read_bytes()).hexdigest()
        except FileNotFoundError:
            raise DataError("this result file is missing", file=file, hint=HINT) from None
        except OSError as error:
            raise DataError(f"this result file cannot be read: {error.strerror}", file=file, hint=HINT) from None
        if found != digest:
            problem = "this file was not written with the result.json beside it"
            raise DataError(problem, file=file, expected=f"SHA-256 {digest}", found=f"SHA-256 {found}", hint=hint)


def read_table(file: Path) -> dict[str, FloatArray]:
    """Read a CSV file of numbers with a header line; empty cells become NaN.

    Returns
    -------
    dict
        Column name to its values, all of one length.

    Raises
    ------
    DataError
        Where it is missing or a row does not fit the header.
    """
    lines = read_text(file).splitlines()
    header = [name.strip() for name in lines[0].split(",")] if lines else []
    if len(set(header)) != len(header) or not all(header):
        raise DataError("this result file is damaged", file=file, place="line 1", expected="distinct column names", hint=HINT)
    rows = []
    for count, line in enumerate(lines[1:], start=2):
        if not line.strip():
            continue
        cells = line.split(",")
        if len(cells) != len(header):
            raise DataError(
                "this result file is damaged",
                file=file,
                place=f"line {count}",
                expected=f"{len(header)} cells",
                found=len(cells),
                hint=HINT,
            )
        try:
            rows.append([float(cell) if cell.strip() else np.nan for cell in cells])
        except ValueError as error:
            raise DataError(
                "this result file is damaged", file=file, place=f"line {count}", expected="numbers", found=str(error)[:80], hint=HINT
            ) from None
    values = np.array(rows, dtype=float).reshape(len(rows), len(header))
    return {name: np.ascontiguousarray(values[:, column]) for column, name in enumerate(header)}
