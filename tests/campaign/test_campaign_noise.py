"""Noise that the coherence gives is weighted down: its peaks are no doubt of a measurement."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from samples import sample

from lrbc_cli.campaign.identification.records import Measurement, read_measurement
from lrbc_cli.campaign.identification.weights import weighted_down
from lrbc_cli.campaign.jobs.evidence import _doubts
from lrbc_cli.campaign.looking.measured import unclear
from lrbc_cli.campaign.reading.inputs import Inputs

JOBS = ("tight", "loose-2")


def noisy(inputs: Inputs, level: float, *, known: bool) -> dict[str, Measurement]:
    """Two jobs with noise of each response at ``level`` times its effective value, and its coherence if it is ``known``."""
    rng, found = np.random.default_rng(1), dict[str, Measurement]()
    for name in JOBS:
        job = inputs.campaign.jobs[name]
        right = read_measurement(inputs, job, name)
        floor = level * np.sqrt(np.mean(np.abs(right.values) ** 2, axis=0))
        noise = rng.normal(size=right.values.shape) + 1j * rng.normal(size=right.values.shape)
        power = np.abs(right.values) ** 2
        coherence = power / (power + job.averages * floor**2)
        found[name] = replace(
            right, values=right.values + floor * noise / np.sqrt(2.0), coherence=coherence if known else np.full(coherence.shape, np.nan)
        )
    return found


def doubted(inputs: Inputs, measurements: dict[str, Measurement]) -> set[str]:
    """Kinds of doubts of the second job."""
    own, tight = measurements["loose-2"], measurements["tight"]
    reference = SimpleNamespace(job="tight", inputs={})
    result: Any = SimpleNamespace(reference=reference, measurement=own, tight=tight, name="loose-2", expected=None)
    return {doubt.kind for doubt in _doubts(inputs, result)}


@pytest.mark.parametrize(("level", "known", "doubt"), [(0.12, False, True), (0.12, True, False), (0.02, False, False)])
def test_noise_is_a_doubt_unless_the_coherence_gives_it(level: float, known: bool, doubt: bool) -> None:
    inputs = sample("frame")
    measurements = noisy(inputs, level, known=known)
    assert ("resolution" in doubted(inputs, measurements)) == doubt
    assert any("probably noise" in each.text for each in unclear(inputs, measurements)) == doubt


def test_a_coherence_that_does_not_give_the_noise_clears_nothing() -> None:
    inputs = sample("frame")
    wrong = {name: replace(own, coherence=np.full(own.values.shape, 0.999)) for name, own in noisy(inputs, 0.12, known=True).items()}
    assert "resolution" in doubted(inputs, wrong)
    assert any("probably noise" in each.text for each in unclear(inputs, wrong))


def test_noise_of_one_job_alone_remains_a_doubt() -> None:
    """The reference job says where a response is noise: a job that is noisier was measured worse."""
    inputs = sample("frame")
    right, worse = noisy(inputs, 0.01, known=True), noisy(inputs, 0.12, known=True)
    one = {"tight": right["tight"], "loose-2": worse["loose-2"]}
    assert doubted(inputs, one) & {"noise", "resolution"}
    assert not doubted(inputs, right) & {"noise", "resolution"}


def test_noise_in_dips_that_the_reference_job_has_elsewhere_is_no_doubt() -> None:
    """A loosened bolt moves the dips of its FRFs; the same noise then shows at other lines. A louder one is that of the job."""
    inputs = sample("frame")
    right, job = read_measurement(inputs, inputs.campaign.jobs["tight"], "tight"), inputs.campaign.jobs["tight"]
    own = noisy(inputs, 0.12, known=True)["loose-2"]
    floor = 0.12 * np.sqrt(np.mean(np.abs(right.values) ** 2, axis=0))
    # Without dips.
    values = right.values + 4j * floor * np.sign(right.values.imag)
    shares = []
    for level in (floor, 0.1 * floor):
        coherence = np.abs(values) ** 2 / (np.abs(values) ** 2 + job.averages * level**2)
        shares.append(np.isnan(weighted_down(inputs, "loose-2", own, replace(right, values=values, coherence=coherence))).mean())
    assert shares[0] > 0.1
    assert shares[1] == 0.0


@pytest.mark.parametrize("which", [slice(200, 290), slice(0, None, 7)], ids=["a part of the band", "scattered lines"])
def test_loud_noise_at_some_lines_of_a_job_is_its_own(which: slice) -> None:
    """With its coherence in the file; over all lines the median of the noise is that of the reference job."""
    inputs = sample("frame")
    both = noisy(inputs, 0.01, known=True)
    own, job, rng = both["loose-2"], inputs.campaign.jobs["loose-2"], np.random.default_rng(2)
    level = 0.01 * np.ones(own.values.shape)
    level[which] = 1.3
    floor = level * np.sqrt(np.mean(np.abs(own.values) ** 2, axis=0))
    values = own.values + floor * (rng.normal(size=floor.shape) + 1j * rng.normal(size=floor.shape)) / np.sqrt(2.0)
    coherence = np.abs(values) ** 2 / (np.abs(values) ** 2 + job.averages * floor**2)
    loud = replace(own, values=values, coherence=coherence)
    excused = np.isnan(weighted_down(inputs, "loose-2", loud, both["tight"]))
    assert not excused[which].any()
    told = [each.text for each in unclear(inputs, {"tight": both["tight"], "loose-2": loud})]
    assert any("peaks fall by more than 6 dB to both neighbouring lines" in text for text in told)


def test_a_coherence_of_the_reference_job_alone_excuses_no_noise_of_another() -> None:
    """Nothing weights the noise of that job down."""
    inputs = sample("frame")
    known, bare = noisy(inputs, 0.12, known=True), noisy(inputs, 0.12, known=False)
    assert "resolution" in doubted(inputs, {"tight": known["tight"], "loose-2": bare["loose-2"]})
    found = unclear(inputs, {"tight": known["tight"], "loose-2": bare["loose-2"]})
    assert [each.place for each in found if "probably noise" in each.text] == ["job loose-2"]


def test_lines_too_far_apart_are_not_hidden_by_a_coherence_that_is_low_at_the_peaks() -> None:
    """As leakage makes it."""
    inputs = sample("frame")
    wide = dict[str, Measurement]()
    for name in JOBS:
        right = read_measurement(inputs, inputs.campaign.jobs[name], name)
        values = right.values[::9]
        level = np.abs(values)
        top = np.zeros(level.shape, dtype=bool)
        top[1:-1] = (level[1:-1] > level[:-2]) & (level[1:-1] > level[2:])
        wide[name] = replace(right, frequency_hz=right.frequency_hz[::9], values=values, coherence=np.where(top, 0.2, 0.999))
    assert any("lines too far apart" in each.text for each in unclear(inputs, wide))
    assert "resolution" in doubted(inputs, wide)
