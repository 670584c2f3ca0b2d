"""A second blow of the hammer: a ripple over the frequency that all responses of a job have and those of the reference job have not."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lrbc_cli.arrays import Complexes, Floats
from lrbc_cli.updating.statistics.residuals import DB, decibel


@dataclass(frozen=True, kw_only=True)
class EchoRule:
    """From when on a ripple is taken for a second blow.

    Attributes
    ----------
    least_db : float
        Of its amplitude: a second blow of an eighth of the first [dB].
    above : float
        Over the median amplitude at other periods nearby. A choice: of Gaussian values one of 10^6 lies there.
    alike : float
        Sum over the responses of the ripple with its phase, over the sum without. A choice: what bolts change differs from response to
        response.
    periods : int
        Least number of periods in the band. A choice: fewer are slopes that bolts have, too.
    """

    least_db: float = 1.0
    above: float = 6.0
    alike: float = 0.9
    periods: int = 4


#: The default, for those who call a part alone.
ECHO = EchoRule()


def second_blow(frequency_hz: Floats, own: Complexes, tight: Complexes, reference: str, rule: EchoRule = ECHO) -> str | None:
    """What to say of a job whose levels have a ripple beside those of the reference job; None where they have none.

    A blow a after the time T and another one together are ``1 + a exp(-i omega T)`` times the force of the first. Where the window of the
    force ends between the two, the FRFs hold that factor: in decibels a cosine with the period 1/T.

    Parameters
    ----------
    frequency_hz : (F,) float array
        Evenly spaced, or nothing is compared.
    own, tight : (F, R) complex arrays
        NaN where a response was not measured.
    reference : str
        Name of the reference job.
    rule : EchoRule
    """
    steps = np.diff(frequency_hz)
    held = (np.isfinite(own) & np.isfinite(tight) & (own != 0) & (tight != 0)).all(axis=0)
    if steps.size < 8 * rule.periods or held.sum() < 2 or not np.allclose(steps, steps.mean(), rtol=1e-3):
        return None
    change = decibel(own[:, held]) - decibel(tight[:, held])
    window = np.hanning(change.shape[0])
    ripple = np.fft.rfft((change - change.mean(axis=0)) * window[:, None], axis=0) * (2.0 / window.sum())
    size, mean = np.abs(ripple).mean(axis=1), np.abs(ripple.mean(axis=1))
    at = rule.periods + int(np.argmax(mean[rule.periods :]))
    beside = np.r_[max(at - 12, 1) : max(at - 2, 1), min(at + 3, mean.size) : min(at + 13, mean.size)]
    if not beside.size or mean[at] < max(rule.least_db, rule.above * float(np.median(mean[beside]))) or mean[at] < rule.alike * size[at]:
        return None
    period = change.shape[0] * float(steps.mean()) / at
    return (
        f"beside {reference} the levels of all responses rise and fall by {mean[at]:.1f} dB every {period:.3g} Hz, which bolts do not do: "
        f"as if the hammer had hit a second time, {1e3 / period:.3g} ms later and {mean[at] / DB:.0%} as hard, and a window had cut that "
        "blow from the force; expected: one blow in each record. Look at the force over time, and measure this job again (or "
        f"{reference}, where all jobs say this)"
    )
