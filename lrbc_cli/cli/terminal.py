"""Output to a terminal: colours of verdicts and messages, and a progress line that is cleared before any other output."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import sys
from typing import IO, Any

import click

#: Words of a finding by colour; the group ``plain`` matches phrases that look like a verdict but are none.
_WORDS = re.compile(
    r"(?P<plain>no loose bolts? found|none is judged tight|loose bolts\b|taken as tight|all bolts tight)"
    r"|(?P<yellow>(?<![\w-])(?:(?:probably|likely)(?: loose)?|inconclusive|undecided|no verdict|unexplained|not validated)(?![\w-]))"
    r"|(?P<red>(?<![\w-])(?:loose|failed)(?![\w-]))"
    r"|(?P<green>(?<![\w-])(?:tight|all clear)(?![\w-]))"
)


def coloured(stream: IO[Any]) -> bool:
    """Whether to write colours to a stream: not with NO_COLOR, as FORCE_COLOR states, otherwise to terminals only."""
    if os.environ.get("NO_COLOR"):
        return False
    forced = os.environ.get("FORCE_COLOR")
    if forced:
        return forced != "0"
    return stream.isatty() and os.environ.get("TERM") != "dumb"


def painted(text: str) -> str:
    """Text with coloured verdicts: loose red, undecided amber, tight green; the first word of a line, a name, is left as it is."""

    def colour(found: re.Match[str]) -> str:
        kind = found.lastgroup
        return found[0] if kind in (None, "plain") else click.style(found[0], fg=kind)

    lines = []
    for line in text.split("\n"):
        name, blank, rest = line.partition(" ")
        lines.append(name + blank + _WORDS.sub(colour, rest))
    return "\n".join(lines)


def typed(*words: object) -> str:
    """Command line to type, with quotes around words that contain blanks."""
    parts = [str(word) for word in words]
    if sys.platform != "win32":
        return shlex.join(parts)
    # Imported here, so that commands start fast.
    from subprocess import list2cmdline

    return list2cmdline(parts)


def say(text: object, *, finding: bool = False) -> None:
    """Print a result to stdout; the verdicts of a finding are coloured."""
    line.clear()
    colours = coloured(sys.stdout)
    click.echo(painted(str(text)) if finding and colours else text, color=colours)


def complain(message: str) -> None:
    """Print an error to stderr."""
    line.clear()
    colours = coloured(sys.stderr)
    first, new, rest = message.partition("\n")
    click.echo((click.style(first, fg="red") if colours else first) + new + rest, err=True, color=colours)


def remark(text: str, *, kind: str = "") -> None:
    """Print a message to stderr, preceded by its kind, such as ``warning``."""
    line.clear()
    colours = coloured(sys.stderr)
    label = f"{kind}: " if kind else ""
    click.echo(
        (click.style(label, fg="red" if kind in ("error", "critical") else "yellow") if colours and label else label) + text,
        err=True,
        color=colours,
    )


class _Line:
    """The progress line on stderr, which is overwritten while a command runs."""

    shown = False

    def show(self, text: str) -> None:
        """Replace the text of the line."""
        width = self._width()
        click.echo("\r" + text[:width].ljust(width), err=True, nl=False)
        self.shown = True

    def clear(self) -> None:
        """Remove the line before a message that stays."""
        if self.shown:
            self.shown = False
            click.echo("\r" + " " * self._width() + "\r", err=True, nl=False)

    @staticmethod
    def _width() -> int:
        # Of stderr, since stdout may be a file; asked anew each time, since windows are resized. A full last column would wrap the line.
        try:
            columns = os.get_terminal_size(sys.stderr.fileno()).columns
        except (OSError, ValueError):
            columns = 0
        return max((columns or shutil.get_terminal_size().columns) - 1, 1)


line = _Line()
