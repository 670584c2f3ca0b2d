"""Names of the springs of a joint that it can lose."""

from __future__ import annotations

from typing import NamedTuple


class SpringsOf(NamedTuple):
    """Which springs of a joint: those of a group, or only its translations or rotations (``kind``)."""

    group: str
    kind: str = ""

    def __str__(self) -> str:
        return f"{self.group} ({self.kind})" if self.kind else self.group
