"""Makes sure that Ctrl-C stops a run.

Python raises KeyboardInterrupt wherever it happens to be. In a finaliser or a callback from compiled code the interpreter prints it
as ignored and goes on, so a run of hours would not stop. It is recorded here and raised again at the next step.
"""

from __future__ import annotations

import signal
import sys
import threading
from types import FrameType

import click

from lrbc_cli.errors import LrbcError


class _Interruption:
    asked = False

    def note(self, number: int, frame: FrameType | None) -> None:
        self.asked = True
        signal.default_int_handler(number, frame)


_state = _Interruption()


def _quiet() -> None:
    """Suppress Python's message on an interruption that it cannot raise, since it is raised again later."""
    before = sys.unraisablehook

    def hook(told: sys.UnraisableHookArgs) -> None:
        if not (_state.asked and issubclass(told.exc_type, KeyboardInterrupt)):
            before(told)

    sys.unraisablehook = hook


def listen() -> None:
    """Record interruptions from now on; if they are ignored (``nohup``, background job of a shell), they stay ignored."""
    _state.asked = False
    if threading.current_thread() is threading.main_thread() and signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, _state.note)
        _quiet()


def stop_if_asked() -> None:
    """Raise a recorded interruption; called between two steps.

    Raises
    ------
    KeyboardInterrupt
        If an interruption came since :func:`listen`.
    """
    if _state.asked:
        raise KeyboardInterrupt


def cause_of(error: BaseException) -> BaseException:
    """The error, or KeyboardInterrupt if an interruption came before: interrupted code, such as a lock, may fail with another error."""
    if not _state.asked or isinstance(error, LrbcError | KeyboardInterrupt | click.ClickException | click.Abort):
        return error
    found = KeyboardInterrupt()
    found.__context__ = error
    return found
