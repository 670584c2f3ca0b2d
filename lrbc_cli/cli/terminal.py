"""What a person sees on a terminal: colours of verdicts and messages, and a line of progress that never spoils a result."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import sys
from typing import IO, Any

import click

#: Words of a finding and their colours; what begins with ``plain`` only looks like a verdict.
_WORDS = re.compile(
    r"(?P<plain>no loose bolts? found|none is judged tight|loose bolts\b|taken as tight|all bolts tight)"
    r"|(?P<yellow>(?<![\w-])(?:(?:probably|likely)(?: loose)?|inconclusive|undecided|no verdict|unexplained|not validated)(?![\w-]))"
    r"|(?P<red>(?<![\w-])(?:loose|failed)(?![\w-]))"
    r"|(?P<green>(?<![\w-])(?:tight|all clear)(?![\w-]))"
)


def coloured(stream: IO[Any]) -> bool:
    """Whether a stream takes colours: NO_COLOR forbids them, FORCE_COLOR wants them, else terminals have them."""
    if os.environ.get("NO_COLOR"):
        return False
    forced = os.environ.get("FORCE_COLOR")
    if forced:
        return forced != "0"
    return stream.isatty() and os.environ.get("TERM") != "dumb"


def painted(text: str) -> str:
    """Text with the verdicts in it coloured: loose red, undecided amber, tight green; the first word of a line is a name."""

    def colour(found: re.Match[str]) -> str:
        kind = found.lastgroup
        return found[0] if kind in (None, "plain") else click.style(found[0], fg=kind)

    lines = []
    for line in text.split("\n"):
        name, blank, rest = line.partition(" ")
        lines.append(name + blank + _WORDS.sub(colour, rest))
    return "\n".join(lines)


def typed(*words: object) -> str:
    """A command line as it is typed, in quotes where a word holds blanks."""
    parts = [str(word) for word in words]
    if sys.platform != "win32":
        return shlex.join(parts)
    # Loaded there only: commands start quickly.
    from subprocess import list2cmdline

    return list2cmdline(parts)


def say(text: object, *, finding: bool = False) -> None:
    """A result, on stdout; verdicts in it are coloured where it is a finding."""
    line.clear()
    colours = coloured(sys.stdout)
    click.echo(painted(str(text)) if finding and colours else text, color=colours)


def complain(message: str) -> None:
    """An error, on stderr."""
    line.clear()
    colours = coloured(sys.stderr)
    first, new, rest = message.partition("\n")
    click.echo((click.style(first, fg="red") if colours else first) + new + rest, err=True, color=colours)


def remark(text: str, *, kind: str = "") -> None:
    """A line beside the results, on stderr; its kind, such as a warning, stands before it."""
    line.clear()
    colours = coloured(sys.stderr)
    label = f"{kind}: " if kind else ""
    click.echo(
        (click.style(label, fg="red" if kind in ("error", "critical") else "yellow") if colours and label else label) + text,
        err=True,
        color=colours,
    )


class _Line:
    """The one line of stderr that changes while a command runs."""

    shown = False

    def show(self, text: str) -> None:
        """Replace it."""
        width = self._width()
        click.echo("\r" + text[:width].ljust(width), err=True, nl=False)
        self.shown = True

    def clear(self) -> None:
        """Make room for a line that stays."""
        if self.shown:
            self.shown = False
            click.echo("\r" + " " * self._width() + "\r", err=True, nl=False)

    @staticmethod
    def _width() -> int:
        # Of stderr, as stdout may be a file. Terminals begin a new line after their last column; windows are resized.
        try:
            columns = os.get_terminal_size(sys.stderr.fileno()).columns
        except (OSError, ValueError):
            columns = 0
        return max((columns or shutil.get_terminal_size().columns) - 1, 1)


line = _Line()
