"""Outcomes of rehearsals, and the probabilities that are counted from them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.special import betaincinv

from lrbc_cli.arrays import Floats

#: Number of rehearsals in all, and limits of the number for each bolt and loss.
REHEARSALS, DRAWS = 150, (1, 5)


@dataclass(frozen=True, kw_only=True)
class Draw:
    """Outcome of one rehearsal.

    Attributes
    ----------
    verdict : str
        Verdict on the loosened bolt.
    change : float
        Its identified change [decades]; NaN if there is none.
    probability : float
        Its stated probability of being loose; NaN if there is none.
    alarms : tuple of str
        Tight bolts that were called loose.
    judged : int
        Number of tight bolts that were called tight or loose.
    """

    verdict: str
    change: float
    probability: float
    alarms: tuple[str, ...]
    judged: int


@dataclass(frozen=True)
class TightDraw:
    """Outcome of a rehearsal in which all bolts are tight.

    Attributes
    ----------
    verdicts : mapping
        The verdict on each bolt that can be judged.
    validated, clear : bool
        Whether the job is validated, and whether it is an all-clear.
    """

    verdicts: Mapping[str, str]
    validated: bool = False
    clear: bool = False


@dataclass(frozen=True)
class Rehearsed:
    """Outcomes of rehearsals: by bolt and loss [decades], and with all bolts tight."""

    loosened: Mapping[tuple[int, float], Sequence[Draw]] = field(default_factory=dict)
    tight: Sequence[TightDraw] = ()


def draws_for(cases: int, wanted: int | None) -> int:
    """Number of rehearsals for each of ``cases`` pairs of bolt and loss: as wanted, else by ``REHEARSALS``."""
    return int(np.clip(REHEARSALS // max(cases, 1), *DRAWS)) if wanted is None else wanted


def estimates(hits: Sequence[int], draws: Sequence[int]) -> tuple[Floats, Floats]:
    """Probability of an outcome for each of N bolts, and its 95 % interval.

    Parameters
    ----------
    hits, draws : sequences of int
        Number of draws with that outcome, and of all draws, for each bolt.

    Returns
    -------
    (N,) float array
        Share of the draws, with the share of the other bolts as one further draw, since few draws alone would often give 0 or 1.
    (N, 2) float array
        95 % interval from the draws of this bolt alone (Jeffreys' prior).
    """
    k, n = np.array(hits, dtype=float), np.array(draws, dtype=float)
    others = (k.sum() - k + 0.5) / (n.sum() - n + 1.0)
    interval = betaincinv((k + 0.5)[:, None], (n - k + 0.5)[:, None], np.array([0.025, 0.975]))
    return (k + others) / (n + 1.0), np.where(np.column_stack([k == 0, k == n]), [0.0, 1.0], interval)
