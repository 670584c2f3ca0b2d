"""What bolts or the damping of a rod do is not told as a fault of the measurement."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from rods import rod

from lrbc_cli import load
from lrbc_cli.campaign.jobs import evidence as evidence_module
from lrbc_cli.campaign.jobs.evidence import _chain, evidence_of
from lrbc_cli.campaign.looking.axes import other_lines, without_coherence
from lrbc_cli.updating.judging.evidence import Evidence
from lrbc_cli.updating.statistics.chain.modal import ChainFault

#: Jobs: changes of bolts in decades, and a factor on the damping.
Jobs = dict[str, tuple[dict[str, float], float]]


def evidence(folder: Path, jobs: Jobs, loss_factor: float) -> list[Evidence]:
    study = load(rod(folder, jobs, loss_factor), cache=folder / "cache")
    reference = study.identify("tight")
    return [evidence_of(study.inputs, study.identify(job, reference=reference).identification) for job in jobs]


def test_an_end_bolt_that_was_tightened_is_no_second_blow(tmp_path: Path) -> None:
    """Modes of a rod lie evenly along the frequency, and its levels rise and fall as beside a second blow."""
    (found,) = evidence(tmp_path, {"up": ({"E2": 0.4}, 1.0)}, 0.008)
    (doubt,) = found.doubts
    assert (doubt.kind, doubt.explained) == ("chain", True)
    assert "the hammer probably hit a second time" in doubt.text


BLOW, CLOCK = ChainFault("blow", "hit twice"), ChainFault("clock", "another clock")


@pytest.mark.parametrize(
    ("told", "beside", "found"),
    [
        (BLOW, None, ("hit twice", True)),
        (BLOW, BLOW, ("hit twice", False)),
        (CLOCK, BLOW, ("another clock", False)),
        # A lid with a loose screw: beside its change alone the second blow at one point shows.
        (None, BLOW, ("hit twice", False)),
        # What is left of a change that is hardly known may look like another clock.
        (None, CLOCK, None),
        (None, None, None),
    ],
)
def test_a_second_blow_that_a_loose_bolt_hides(
    monkeypatch: pytest.MonkeyPatch, told: ChainFault | None, beside: ChainFault | None, found: tuple[str, bool] | None
) -> None:
    tight: Any = SimpleNamespace(values="measured")
    result: Any = SimpleNamespace(name="one", expected="expected")
    monkeypatch.setattr(evidence_module, "chain_doubt", lambda _, own, other, *a, **k: told if other.values == "measured" else beside)
    monkeypatch.setattr(evidence_module, "replace", lambda _, values: SimpleNamespace(values=values))
    inputs: Any = SimpleNamespace()
    doubt = _chain(inputs, tight, tight, result, "tight")
    assert (None if doubt is None else (doubt.text, doubt.explained)) == found
    # Without an identified change nothing else is compared.
    result.expected = None
    alone = _chain(inputs, tight, tight, result, "tight")
    assert (None if alone is None else (alone.text, alone.explained)) == (None if told is None else (told.text, False))


def test_pieces_that_came_apart_are_no_sensors_that_are_off(tmp_path: Path) -> None:
    (found,) = evidence(tmp_path, {"apart": ({"MID": -3.3}, 1.0)}, 0.008)
    # A level beyond the model looks like a factor, which counts only if no bolt is judged loose.
    assert all(doubt.explained for doubt in found.doubts)
    assert {doubt.kind for doubt in found.doubts} <= {"factor"}
    assert "the sensor or its cable was off" not in found.setting


@pytest.mark.parametrize("times", [0.7])
def test_another_damping_is_no_second_blow(tmp_path: Path, times: float) -> None:
    (found,) = evidence(tmp_path, {"other": ({}, times)}, 0.3)
    assert not found.doubts


def test_a_job_without_coherence_beside_others_with_it() -> None:
    """Its noise was said to be known from coherence, as that of the others."""
    known, unknown = SimpleNamespace(coherence=np.full((5, 2), 0.99)), SimpleNamespace(coherence=np.full((5, 2), np.nan))
    jobs: dict[str, Any] = {"tight": known, "one": unknown, "two": known}
    (told,) = without_coherence(jobs)
    assert told.startswith("job one: no coherence in its file, but the other jobs have it")
    assert without_coherence({"tight": known, "two": known} | {"one": known}) == []
    assert without_coherence({"tight": unknown, "two": unknown}) == []


def test_a_file_that_was_counted_from_another_line() -> None:
    """By whole lines: those in the band are the same, only more of one side are left out."""
    hz = np.arange(10.0, 451.0)

    def job(below: int, above: int) -> Any:
        return SimpleNamespace(frequency_hz=hz, left_out=(below, above))

    (told,) = other_lines("tight", {"tight": job(5, 5), "one": job(4, 6), "two": job(5, 5)})
    assert told.startswith("job one: its file begins 1 Hz higher than that of tight, with as many lines")
    assert told.endswith("correct its frequencies")
    (told,) = other_lines("tight", {"tight": job(5, 5), "one": job(4, 6), "two": job(5, 5), "three": job(4, 6)})
    assert told.startswith("job one: its file begins 1 Hz higher")
    assert told.endswith("; also found in three")
    # Another range is no mistake.
    assert other_lines("tight", {"tight": job(5, 5), "shorter": job(4, 5), "whole": job(5, 150)}) == []
