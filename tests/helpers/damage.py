"""Damage of valid files, drawn by Hypothesis, and what a reader may still give for them."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from hypothesis import strategies as st

from lrbc_cli.model.frf import FrfRecord

BYTES = st.integers(0, 255)


def damaged(data: st.DataObject, valid: bytes, written: st.SearchStrategy[int] = BYTES, most: int = 4) -> bytes:
    """A file with some bytes overwritten, and perhaps truncated."""
    content = bytearray(valid)
    for _ in range(data.draw(st.integers(0, most))):
        content[data.draw(st.integers(0, len(content) - 1))] = data.draw(written)
    return bytes(content[: data.draw(st.integers(0, len(content)))] if data.draw(st.booleans()) else content)


def require_sound(records: Iterable[FrfRecord]) -> None:
    for found in records:
        assert np.all(np.isfinite(found.values))
        assert np.all(np.diff(found.frequency_hz) > 0)
