"""Which of two tight jobs is not."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from lrbc_cli.campaign.looking import tightness


def job(spread_db: float, seed: int) -> Any:
    """FRFs whose levels are apart from a model of ones by so much in the mean."""
    levels = np.random.default_rng(seed).normal(size=(400, 3))
    levels *= spread_db / np.abs(levels - np.median(levels, axis=0)).mean(axis=0)
    return SimpleNamespace(frequency_hz=np.arange(400.0), values=10.0 ** (levels / 20.0) + 0j)


def campaign(*baselines: str) -> Any:
    update = SimpleNamespace(baselines=baselines, reference="tight")
    return SimpleNamespace(campaign=SimpleNamespace(update=update, calibration=None))


def tighter(monkeypatch: pytest.MonkeyPatch, other_db: float, *baselines: str) -> str:
    monkeypatch.setattr(tightness, "few_lines", lambda found: found)
    monkeypatch.setattr(tightness, "parameterise", lambda *_: (None, {}))
    monkeypatch.setattr(tightness, "states_of", lambda *_: (np.ones((1, 400, 3), dtype=complex), []))
    jobs = {"tight": job(8.3, 1), "tight-2": job(other_db, 2)}
    return tightness.tighter_text(campaign(*baselines), None, jobs, "tight")  # type: ignore[arg-type]


def test_a_baseline_that_is_nearer_to_the_tight_model_names_a_loose_bolt_in_the_reference_job(monkeypatch: pytest.MonkeyPatch) -> None:
    text = tighter(monkeypatch, 4.8, "tight-2")
    assert text.startswith("tight-2 (4.8 dB) fits the tight model far better than tight (8.3 dB)")
    assert "was a bolt loose there" in text


def test_a_job_that_nobody_called_tight_has_to_be_far_nearer(monkeypatch: pytest.MonkeyPatch) -> None:
    assert tighter(monkeypatch, 4.8) == ""
    assert tighter(monkeypatch, 3.5).startswith("tight-2 (3.5 dB)")


def test_two_tight_jobs_as_far_from_the_model_are_no_finding(monkeypatch: pytest.MonkeyPatch) -> None:
    assert tighter(monkeypatch, 5.9, "tight-2") == ""


def test_of_two_jobs_far_apart_the_one_nearer_to_the_tight_model_is_tight() -> None:
    states, own = np.ones((1, 400, 3), dtype=complex), job(8.0, 3).values
    fixes = campaign("tight-2")
    parameters: Any = SimpleNamespace(placed=())
    fits = {"tight": 6.5, "tight-2": 3.9}
    text = tightness.not_tight(fixes, fits, own, states, [np.zeros(0, dtype=np.int64)], parameters)
    assert "was a bolt loose in tight? Correct jobs.tight.frf" in text
    fits = {"tight": 4.0, "tight-2": 3.9}
    text = tightness.not_tight(fixes, fits, own, states, [np.zeros(0, dtype=np.int64)], parameters)
    assert "was all tight there? Take it out of update.baselines" in text


def test_a_baseline_near_the_reference_job_is_weighed_by_the_tight_model_too() -> None:
    """A loosened reference job need not lie 6 dB from a tight one."""
    states, own = np.ones((1, 400, 3), dtype=complex), job(4.2, 3).values
    parameters: Any = SimpleNamespace(placed=())

    def text(**fits: float) -> str:
        found = {"tight": fits["tight"], "tight-2": fits["other"]}
        return tightness.not_tight(campaign("tight-2"), found, own, states, [np.zeros(0, dtype=np.int64)], parameters)

    assert "nearer to the tight model (2.1 dB) than that (4.3 dB): was a bolt loose in tight?" in text(tight=4.3, other=2.1)
    assert text(tight=2.6, other=2.1) == ""
