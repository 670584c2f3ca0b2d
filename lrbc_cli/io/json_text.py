"""Reads JSON result files within limits of size and depth, so that a damaged file gives a ValueError and not a crash."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path
from typing import Any

from lrbc_cli.io.common import regular_bytes

#: Most bytes of a document: about those of a result with 2000 unknowns, whose covariance takes 26 bytes a number.
MOST_BYTES = 128 * 2**20

#: Most levels of nesting. A result has fewer than ten; the campaign file that it quotes may have 32.
DEEPEST = 100

#: Most digits of an integer: one of 64 bits has 19. A longer one is no count, and may exceed what float() and str() convert.
MOST_DIGITS = 19

#: Escape of a surrogate, perhaps half of a pair only: that is not Unicode and cannot be written.
_SURROGATE = re.compile(r"\\u[dD][89a-fA-F]")

_NESTED = frozenset({list, dict})
_WITH_TEXTS = _NESTED | {str}


def read_json_text(path: Path) -> str:
    """Text of a JSON file.

    Raises
    ------
    OSError
        If it cannot be read or is no regular file.
    ValueError
        If it is longer than ``MOST_BYTES``, or not UTF-8 (then a UnicodeDecodeError).
    """
    content = regular_bytes(path, MOST_BYTES + 1)
    if len(content) > MOST_BYTES:
        raise ValueError(f"it is longer than {MOST_BYTES // 2**20} MiB")
    return content.decode("utf-8")


def parse_json(text: str) -> Any:
    """Value of a JSON text.

    Raises
    ------
    ValueError
        If it is not JSON (a JSONDecodeError, with the place), nested too deeply, or has a number out of range or text that is not Unicode.
    """
    try:
        value = json.loads(text, parse_constant=_refuse, parse_int=_integer)
    except RecursionError:
        raise ValueError("it is nested too deeply") from None
    _check(value, bool(_SURROGATE.search(text)))
    return value


def _refuse(name: str) -> Any:
    raise ValueError(f"{name} is not JSON")


def _integer(text: str) -> int:
    if len(text.lstrip("-")) > MOST_DIGITS:
        raise ValueError(f"an integer of {len(text.lstrip('-'))} digits")
    return int(text)


def _check(value: Any, texts: bool) -> None:
    """Check texts, numbers and depth, level by level: recursion would fail on a deep document."""
    level: list[Any] = [[value]]
    for _ in range(DEEPEST + 2):
        below: list[Any] = []
        for item in level:
            if isinstance(item, str):
                try:
                    item.encode("utf-8")
                except UnicodeEncodeError:
                    raise ValueError("a text that is not Unicode") from None
                continue
            inside = [*item.values(), *item] if isinstance(item, dict) else item
            if math.inf in inside or -math.inf in inside:
                raise ValueError("a number is beyond the range of numbers")
            # Rows of numbers make up most of a document; their items need no check of their own.
            kinds = _WITH_TEXTS if texts else _NESTED
            below += [part for part in inside if type(part) in kinds]
        if not below:
            return
        level = below
    raise ValueError("it is nested too deeply")
