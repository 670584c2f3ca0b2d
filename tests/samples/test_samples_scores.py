"""Figures of the blind benchmark on results made up for it."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

sys.path.append(str(Path(__file__).parents[1] / "benchmarks"))

from joints import figures as joint_figures
from joints import score_state
from scores import Figure, JobScore, figures, locate, roc_auc, score_job

#: A bolt every 40 mm beside an edge from 0 to 400 mm with a term every 20 mm between the clamped ends.
PITCH, COUNT = 0.04, 11
TERMS = [0.02 * (k + 1) for k in range(19)]


def result(job: str, changes: dict[int, float], *, status: str = "converged") -> dict[str, Any]:
    """A ``result.json`` with these changes at the bolts; others change by nothing."""
    found = {i: changes.get(i, 0.0) for i in range(COUNT)}
    word = {i: "loose" if c <= -0.8 else "tight" if c >= -0.3 else "undecided" for i, c in found.items()}
    return {
        "job": job,
        "status": status,
        "parameters": {
            "edge": {
                "kind": "stiffness",
                "positions": [[0.0, y, 0.0] for y in TERMS],
                "arc_length": [y - TERMS[0] for y in TERMS],
                "log10_effective": [3.0 + found[round(y / PITCH)] for y in TERMS],
            }
        },
        "bolts": [
            {
                "name": f"B{i:02d}",
                "position": [-0.01, PITCH * i, 0.0],
                "change": found[i],
                "change_std": 0.2,
                "probability_loose": min(max(-found[i], 0.0), 1.0),
                "verdict": word[i],
            }
            for i in range(COUNT)
        ],
        "misfit_db": {"initial": 3.0, "final": 0.8, "held_out_final": 1.1},
        "evaluations": 10,
        "seconds": {"total": 1.0},
    }


def job(name: str, changes: dict[int, float], removed: list[int], campaign: str = "a") -> JobScore:
    return score_job(campaign, result(name, changes), result("tight", {}), [f"B{i:02d}" for i in removed], "judged")


def by_key(jobs: list[JobScore]) -> dict[str, Figure]:
    return {figure.key: figure for figure in figures(jobs)}


def test_places_by_the_edge() -> None:
    bolts = job("x", {}, []).bolts
    # The outermost bolts stand on the clamped ends, half a pitch from the next term; the next ones a pitch from the ends.
    assert [b.bolt for b in bolts if not b.interior] == ["B00", "B01", "B09", "B10"]
    assert all(b.near for b in bolts)


def test_ranking_counts_ties_as_half() -> None:
    found = job("x", {3: -1.0, 4: -0.2}, [3, 4])
    assert roc_auc(found.bolts, "change") == (1.0, 2, 9)
    found = job("x", {3: -1.0, 5: -1.0}, [3])
    assert roc_auc(found.bolts, "change") == (pytest.approx(0.95), 1, 10)
    assert roc_auc(job("x", {}, []).bolts, "change")[0] is None


def test_wrong_and_undecided_verdicts() -> None:
    one, two = job("x", {3: -1.0, 5: -0.9}, [3]), job("y", {3: -0.5, 4: -1.2}, [3, 4, 6])
    keyed = by_key([one, two])
    # B05 is tight and judged loose, B06 is gone and judged tight; B03 of y is not judged.
    assert keyed["wrong"].counts == {"wrong": 2, "verdicts": 21, "bolts": 22}
    assert keyed["decided"].counts == {"decided": 13, "bolts": 14}
    assert keyed["caught"].counts == {"loose": 2, "bolts": 4}
    assert keyed["wrong"].holds is False
    assert keyed["decided"].holds is True
    assert keyed["alarms"].value is None
    assert keyed["contrast"].value == pytest.approx(min(one.contrast or 0, two.contrast or 0))


def test_alarms_only_where_nothing_was_ever_removed() -> None:
    calm = [job("t1", {4: -1.0}, [], "calm"), job("t2", {}, [], "calm")]
    loud = [job("t1", {4: -1.0}, [], "loud"), job("x", {5: -1.0}, [5], "loud")]
    alarms = by_key(calm + loud)["alarms"]
    assert alarms.value == 1.0
    assert alarms.counts == {"campaigns": 1, "jobs": 2, "bolts": 22}
    assert by_key([replace(j, role="baseline") for j in calm])["alarms"].value is None


def test_places_of_single_bolts() -> None:
    (hit,) = locate(job("x", {4: -0.9, 5: -0.2}, [5]), "change")
    assert hit.located
    assert hit.found == "B04"
    (miss,) = locate(job("x", {2: -0.9, 5: -0.4}, [5]), "change")
    assert not miss.located
    assert miss.distance == pytest.approx(0.12)
    # The flank of one peak is not a second one.
    pair = locate(job("x", {2: -0.9, 3: -0.6, 8: -0.3}, [2, 8]), "change")
    assert [place.found for place in pair] == ["B02", "B08"]
    # Bolts that stand together are not single.
    assert locate(job("x", {4: -0.9}, [4, 6]), "change") == []
    assert len(locate(job("x", {4: -0.9}, [4, 7]), "change")) == 2


def test_a_failed_job_is_undecided_not_left_out() -> None:
    failed = score_job("a", {"job": "x", "status": "failed", "reason": "no"}, result("tight", {}), ["B05"], "judged")
    keyed = by_key([failed])
    assert keyed["decided"].value == 0.0
    assert keyed["lost"].value == 1.0
    assert keyed["auc_near_probability"].value == 0.5
    assert not locate(failed, "probability")[0].located


def test_joints_are_scored_by_what_they_lost() -> None:
    words = {"a": "loose", "b": "tight", "c": "loose", "d": "tight", "e": "undecided"}
    found = [{"name": n, "change": -1.0, "change_std": 0.1, "probability_loose": 0.5, "verdict": w} for n, w in words.items()]
    tree = {
        "job": "x",
        "status": "converged",
        "bolts": found,
        "misfit_db": {"final": 1.0, "held_out_final": 1.2},
        "cost": {"initial": 3.0, "final": 2.0},
        "evaluations": 9,
        "seconds": {"total": 0.5},
    }
    truth = {"lost": {"a": 1.1, "b": 0.6, "d": 0.4, "e": 2.0}, "change": {"a": -1.1, "b": -0.9, "c": 0.0, "d": -0.5, "e": -2.0}}
    state = score_state("cover-7", tree, tree, truth, "judged", {"e": False})
    assert state.design == "cover"
    # Half a decade called tight and a tight joint called loose are wrong, 0.4 decades may be either.
    assert [j.joint for j in state.joints if j.wrong] == ["b", "c"]
    assert [j.joint for j in state.joints if j.covered] == ["a", "b"]
    keyed = {figure.key: figure for figure in joint_figures([state])}
    assert keyed["caught"].counts == {"loose": 1, "undecided": 0, "tight": 0}
    assert keyed["caught_any"].counts == {"loose": 1, "undecided": 1, "tight": 0}
    assert keyed["wrong"].value == 0.5
    assert keyed["unexplained"].value == 0.0
    assert keyed["coverage"].value == 0.4
    # A reference that is not explained excuses what is compared with it.
    assert {f.key: f for f in joint_figures([replace(state, reference_db=2.5)])}["unexplained"].value is None
    assert {f.key: f for f in joint_figures([replace(state, status="unexplained")])}["unexplained"].holds is False
