"""JSON documents of ours, read back with bounds: a damaged one is a ValueError, never a flood of memory or of calls."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path
from typing import Any

#: Bytes at most of a document: about that of a result with 2000 unknowns, whose covariance takes 26 bytes a number.
MOST_BYTES = 128 * 2**20

#: Levels of nesting at most. A result has fewer than ten; a campaign file, which it quotes, may have 32.
DEEPEST = 100

#: Digits of an integer at most: those of 64 bits have 19. What is longer is no count, and neither a float nor always a text.
MOST_DIGITS = 19

#: Half of a surrogate pair, possibly: no text, and not writable.
_SURROGATE = re.compile(r"\\u[dD][89a-fA-F]")

_NESTED = frozenset({list, dict})
_WITH_TEXTS = _NESTED | {str}


def read_json_text(path: Path) -> str:
    """Text of a document.

    Raises
    ------
    OSError
        Where it cannot be read.
    ValueError
        Where it is longer than any of ours, or not UTF-8 (then a UnicodeDecodeError).
    """
    with path.open("rb") as stream:
        content = stream.read(MOST_BYTES + 1)
    if len(content) > MOST_BYTES:
        raise ValueError(f"it is longer than {MOST_BYTES // 2**20} MiB")
    return content.decode("utf-8")


def parse_json(text: str) -> Any:
    """The value of a document.

    Raises
    ------
    ValueError
        Where it is no JSON (a JSONDecodeError, which knows the place), nested too deeply, or holds a number or a text that no result has.
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
    """Walk through all levels without recursion, which a deep document would exhaust later."""
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
            # Rows of numbers, most of a document, need no look at each.
            kinds = _WITH_TEXTS if texts else _NESTED
            below += [part for part in inside if type(part) in kinds]
        if not below:
            return
        level = below
    raise ValueError("it is nested too deeply")
