"""Errors with a message for the user: what is wrong, where, what was expected and found, and how to fix it.

Every module raises one of these three classes (usage, data, numerical); ``cli/main.py`` turns the class into the exit code.
"""

from __future__ import annotations

import errno
import os
from collections.abc import Sequence
from pathlib import Path

#: Most characters of one part of a message, and of its advice; what was found may be a whole file.
LONGEST, LONGEST_ADVICE = 500, 1500


def _shortened(value: object, most: int = LONGEST) -> str:
    """The text, or its beginning up to the last whole word."""
    text = str(value)
    if len(text) <= most:
        return text
    start = text[: most - 4]
    # Without blanks, as in a list of numbers or a path, it is cut anywhere.
    word = start if text[most - 4].isspace() else start.rpartition(" ")[0]
    return (word.rstrip() if len(word) > most // 2 else start) + " ..."


def listing(names: Sequence[object], limit: int = 20, join: str = ", ") -> str:
    """Names for a message, cut after `limit` of them."""
    shown = join.join(map(str, names[:limit]))
    return f"{shown}{join}... ({len(names)} in all)" if len(names) > limit else shown or "nothing"


def on_one_line(error: Exception | str) -> str:
    """Message joined to a single line."""
    return "; ".join(" ".join(line.split()) for line in str(error).splitlines())


def from_folder(text: str, folder: Path) -> str:
    """A text with the paths of files below a folder as seen from there."""
    return text.replace(f"{folder}{os.sep}", "")


def unwritten(error: BaseException | None) -> OSError | None:
    """OSError in the chain of causes of an error, which waiting or free space may fix; None if there is none."""
    while error is not None and not isinstance(error, OSError):
        error = error.__cause__ or error.__context__
    return error


def disk_is_full(error: OSError) -> bool:
    """Whether an error is due to a full disk, an exhausted quota or a file-size limit."""
    return error.errno in {errno.ENOSPC, getattr(errno, "EDQUOT", errno.ENOSPC), errno.EFBIG}


def room_or(error: OSError, hint: str) -> str:
    """Advice for a file that cannot be written: make room if the disk is full, otherwise `hint`."""
    return "make room on this disk, then run the command again (finished results are kept)" if disk_is_full(error) else hint


class LrbcError(Exception):
    """Base of all errors with a message meant for the user.

    Parameters
    ----------
    problem
        One sentence that says what is wrong.
    file
        The file concerned.
    place
        Place in the file: key path and line, record number, entry.
    expected, found
        What should be at this place, and what is.
    hint
        How to fix it.
    """

    exit_code, kind = 1, "internal"
    #: Further errors found in the same pass.
    others: tuple[LrbcError, ...] = ()

    def __init__(
        self,
        problem: str,
        *,
        file: Path | str | None = None,
        place: str | None = None,
        expected: object = None,
        found: object = None,
        hint: str | None = None,
    ) -> None:
        self.problem = problem
        self.file = None if file is None else str(file)
        self.place = place
        self.expected = expected
        self.found = found
        self.hint = hint
        super().__init__(self.message)

    @property
    def message(self) -> str:
        """The whole message, one line for each part."""
        where = ", ".join(_shortened(part) for part in (self.file, self.place) if part)
        problem = _shortened(self.problem)
        lines = [f"{where}: {problem}" if where else problem]
        if self.expected is not None:
            lines.append(f"  expected: {_shortened(self.expected)}")
        if self.found is not None:
            lines.append(f"  found:    {_shortened(self.found)}")
        if self.hint:
            lines.append(f"  fix:      {_shortened(self.hint, LONGEST_ADVICE)}")
        return "\n".join(lines)

    def tree(self) -> dict[str, str | None]:
        """Parts of the message by name, for ``--json``."""
        parts = {
            "kind": self.kind,
            "problem": self.problem,
            "file": self.file,
            "place": self.place,
            "expected": self.expected,
            "found": self.found,
        }
        tree = {name: None if part is None else _shortened(part) for name, part in parts.items()}
        return tree | {"fix": None if self.hint is None else _shortened(self.hint, LONGEST_ADVICE)}

    def __str__(self) -> str:
        return self.message


class ConfigError(LrbcError):
    """The command line or the campaign file is wrong (exit code 2)."""

    exit_code, kind = 2, "usage"


class DataError(LrbcError):
    """An input file is missing, damaged or inconsistent (exit code 3)."""

    exit_code, kind = 3, "data"


class NumericalError(LrbcError):
    """A computation failed or did not reach its tolerance (exit code 4)."""

    exit_code, kind = 4, "numerical"
