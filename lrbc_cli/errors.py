"""Errors that a user can act on: what is wrong, where, what was expected and found, and how to mend it."""

from __future__ import annotations

from pathlib import Path


class LrbcError(Exception):
    """Base of all errors with a message meant for the user.

    Parameters
    ----------
    problem
        One sentence that says what is wrong.
    file
        The file concerned.
    place
        Where in the file: key path and line, record number, entry.
    expected, found
        What should have stood there, and what did.
    hint
        How to mend it.
    """

    exit_code = 1

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
        """The whole message, on a few short lines."""
        where = ", ".join(part for part in (self.file, self.place) if part)
        lines = [f"{where}: {self.problem}" if where else self.problem]
        if self.expected is not None:
            lines.append(f"  expected: {self.expected}")
        if self.found is not None:
            lines.append(f"  found:    {self.found}")
        if self.hint:
            lines.append(f"  to mend:  {self.hint}")
        return "\n".join(lines)

    def __str__(self) -> str:
        return self.message


class ConfigError(LrbcError):
    """The command line or the campaign file is wrong (exit code 2)."""

    exit_code = 2


class DataError(LrbcError):
    """An input file is missing, damaged or inconsistent (exit code 3)."""

    exit_code = 3


class NumericalError(LrbcError):
    """A computation failed or did not reach its tolerance (exit code 4)."""

    exit_code = 4
