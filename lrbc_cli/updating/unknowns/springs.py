"""Names of the springs of a joint that it can lose.

Annotations are evaluated here: pydantic 2.9 does not find the classes that fields of a NamedTuple name as text.
"""

from typing import NamedTuple


class SpringsOf(NamedTuple):
    """Which springs of a joint: those of a group, or only its translations or rotations (``kind``)."""

    group: str
    kind: str = ""

    def __str__(self) -> str:
        return f"{self.group} ({self.kind})" if self.kind else self.group


class LossAlone(NamedTuple):
    """Log likelihood ratio of a typical loss of some springs of a joint alone against none.

    ``shown``: what it would be if the FRFs were those of the tight joint: near zero where the loss does not show.
    """

    of: SpringsOf
    ratio: float
    shown: float = 0.0
