"""An interruption from the keyboard that nothing swallows.

Python raises KeyboardInterrupt wherever it is; in a finaliser or a callback from compiled code the interpreter prints it
as ignored and goes on, so that a run of hours would not stop. It is noted here, and raised again at the next step.
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
    """Let Python say nothing of an interruption that it cannot raise: it is raised again."""
    before = sys.unraisablehook

    def hook(told: sys.UnraisableHookArgs) -> None:
        if not (_state.asked and issubclass(told.exc_type, KeyboardInterrupt)):
            before(told)

    sys.unraisablehook = hook


def listen() -> None:
    """Note interruptions from now on; where they are ignored (``nohup``, a shell's background job) they stay so."""
    _state.asked = False
    if threading.current_thread() is threading.main_thread() and signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, _state.note)
        _quiet()


def stop_if_asked() -> None:
    """Stop at a place between two steps.

    Raises
    ------
    KeyboardInterrupt
        If an interruption came since :func:`listen`.
    """
    if _state.asked:
        raise KeyboardInterrupt


def cause_of(error: BaseException) -> BaseException:
    """The error, or the interruption that came before it: code that it breaks into, such as a lock of threads, may fail in its own way."""
    if not _state.asked or isinstance(error, LrbcError | KeyboardInterrupt | click.ClickException | click.Abort):
        return error
    found = KeyboardInterrupt()
    found.__context__ = error
    return found
