"""Discrete bolts from a table of springs to verdicts, by the command."""

from __future__ import annotations

import csv
import json
import subprocess
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from campaigns import Folder, command, environment
from grillage import BOLTS, JOBS, grillage, node, write_job
from shared import shared

from lrbc_cli import load
from lrbc_cli.arrays import Floats
from lrbc_cli.campaign.identification import job as job_module
from lrbc_cli.campaign.identification.sampling import springs_apart
from lrbc_cli.updating.misfit.cost import Misfit
from lrbc_cli.updating.search.descent import descend
from lrbc_cli.updating.search.optimise import Solution
from lrbc_cli.updating.statistics.error_model import ERRORS

#: Fast tests of plate and rigs take the same way.
pytestmark = pytest.mark.slow

GROUPS = {
    "axial": {"select": {"bushings": "data/bushings.csv", "component": "UZ"}},
    "rocking": {"select": {"bushings": "data/rocking.csv"}},
}


def _make(path: Path) -> None:
    folder = grillage(path)
    rows = (folder.data / "bushings.csv").read_text().splitlines()
    (folder.data / "rocking.csv").write_text("\n".join(row for row in rows if ",UZ," not in row) + "\n")
    folder.write({**folder.tree(), "parameters": GROUPS})
    line = [*command(), "update", str(folder.config), "--cache", str(folder.cache)]
    done = subprocess.run(line, env=environment(), capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


@pytest.fixture(scope="module")
def folder() -> Folder:
    return Folder(shared("joints", partial(_make)))


@pytest.mark.parametrize("job", ["ring", "single"])
def test_one_loosened_joint_is_found_and_the_others_are_tight(folder: Folder, job: str) -> None:
    found = folder.result(job)
    assert found["status"] == "converged"
    assert {bolt["name"]: bolt["verdict"] for bolt in found["bolts"]} == {name: "loose" if name in JOBS[job] else "tight" for name in BOLTS}
    for bolt in found["bolts"]:
        # Tight bolts of both states scatter by 0.05 decades.
        assert bolt["change"] == pytest.approx(JOBS[job].get(bolt["name"], 0.0), abs=0.3)
        i, j = BOLTS[bolt["name"]]
        assert bolt["position"] == pytest.approx([0.1 * i, 0.09 * j, 0.0])


@pytest.mark.parametrize("job", ["ring", "single"])
def test_joints_are_sought_on_the_lines_and_over_smoothed_spectra(folder: Folder, job: str) -> None:
    """Where all joints scatter, a loose one shows over smoothed spectra; where the model errs, on the lines alone.

    A beam with two small masses that the model lacks: smoothed, damping explained what a free bolt did, and it came out tight.
    """
    starts = [start["description"] for start in folder.result(job)["optimiser"]["starts"]]
    tables = [text for text in starts if text.startswith("table of changes")]
    assert any(text.endswith("over smoothed spectra") for text in tables)
    assert any(not text.endswith("over smoothed spectra") for text in tables)


@pytest.mark.parametrize("job", ["ring", "single"])
def test_changes_have_limits_and_values_no_narrower_ones(folder: Folder, job: str) -> None:
    found, tight = folder.result(job), folder.result("tight")
    for bolt in found["bolts"]:
        (low, high), change, std = bolt["change_interval95"], bolt["change"], bolt["change_std"]
        assert high == pytest.approx(change + 1.96 * std, abs=1e-3)
        assert low is None or low <= change - 1.96 * std + 1e-3
        truth = JOBS[job].get(bolt["name"], 0.0)
        assert (-9.0 if low is None else low) < truth < high
        for name, group in found["parameters"].items():
            before = tight["parameters"][name]["log10_effective"]
            for k in (k for k, owner in enumerate(group["bolts"]) if owner == bolt["name"]):
                value, lower, upper = group["log10_effective"][k], group["lower95"][k], group["upper95"][k]
                # Scatter of tight states is part of a change, and not of a value.
                assert upper is None or max(value, before[k] + change) < upper
                assert lower is None or (lower < value and low is not None)
                # Nor narrower than errors of the model leave it.
                assert all(side is None or abs(side - value) >= 1.96 * ERRORS.level_error - 1e-3 for side in (lower, upper))
    assert all((bolt["change_interval95"] is None) == (bolt["change_std"] is None) for bolt in tight["bolts"])


@pytest.mark.parametrize("wrong", ["B3", "B7"])
def test_a_fit_goes_on_from_the_most_probable_state(folder: Folder, monkeypatch: pytest.MonkeyPatch, wrong: str) -> None:
    """A search that ends with another joint loosened: the joint that was is found, and the fit ends where it would have."""
    study = load(folder.config, cache=folder.cache)
    tight = study.identify("tight")
    right = study.identify("single", reference=tight)

    def search(misfit: Misfit, begin: Floats, bounds: Floats, **known: Any) -> Solution:
        start = begin - 1.5 * known["span"][:, known["joints"][list(BOLTS).index(wrong)]]
        return descend(misfit, np.clip(start, *bounds.T), bounds, known["span"], max_iterations=5)

    monkeypatch.setattr(job_module, "gauss_newton_by_levels", search)
    found = study.identify("single", reference=tight)
    assert found.verdicts == right.verdicts
    np.testing.assert_allclose(found.identification.solution.theta, right.identification.solution.theta, atol=0.02)
    assert found.misfit_db == pytest.approx(right.misfit_db, rel=0.01)
    assert [start.description for start in found.record.optimiser.starts if start.kept] == ["the most probable state of the bolts"]
    # The descents before that come first, and the cost is told from where they began.
    history = found.record.history
    assert [entry.evaluation for entry in history] == list(range(len(history)))
    assert found.record.cost.initial == history[0].cost > found.record.cost.final


def test_values_name_their_bolts(folder: Folder) -> None:
    for group in folder.result("single")["parameters"].values():
        assert group["bolts"] == list(BOLTS)
        assert group["arc_length"] is None
        assert group["initial"] == [0.0] * 9
        assert group["unit"] == "× nominal"
    rows = list(csv.DictReader((folder.out / "single" / "profile.csv").read_text().splitlines()))
    assert [(row["group"], row["bolt"]) for row in rows] == [(group, name) for group in GROUPS for name in BOLTS]


def test_the_reference_state_is_about_nominal(folder: Folder) -> None:
    for group in folder.result("tight")["parameters"].values():
        assert max(abs(value) for value in group["log10"]) < 0.3


def test_springs_that_no_response_feels_are_named(folder: Folder, tmp_path: Path) -> None:
    """Tight bolts are judged by those that are felt; losing the others would change nothing."""
    weak = folder.copy(tmp_path / "weak")
    rows = ["bolt,node_a,node_b,component,stiffness", *(f"{name},{node(*at)},,ROTX,1e-4" for name, at in BOLTS.items())]
    (weak.data / "seat.csv").write_text("\n".join(rows) + "\n")
    weak.write({**weak.tree(), "parameters": {**GROUPS, "seat": {"select": {"bushings": "data/seat.csv"}}}})
    study = load(weak.config, cache=weak.cache)
    tight = study.identify("tight")
    record = study.identify("ring", reference=tight).record
    assert record.sentence.endswith("(as a whole: springs of seat alone may be loose)")
    for bolt in record.bolts:
        expected = (
            None if bolt.name in JOBS["ring"] else "tight as a whole; the data do not exclude that its springs of seat alone are loose"
        )
        assert (bolt.verdict, bolt.note) == ("loose" if expected is None else "tight", expected)


def test_check_tells_the_joints_and_their_prior(folder: Folder) -> None:
    text = folder.run("check").stdout
    assert "joints: 9 bolts, 2 groups (axial, rocking), to ground" in text
    assert "parameters rocking: springs of several components share one value for each bolt" in text
    assert "parameters axial: springs of several" not in text
    assert "prior_std: 1 for joints, 0.35 along edges (nothing beside a joint" in text


def test_the_report_draws_joints(folder: Folder, tmp_path: Path) -> None:
    copy = folder.copy(tmp_path / "copy")
    assert copy.run("report").code == 0
    for name in ("profile.png", "map.png"):
        assert (copy.out / "single" / name).stat().st_size > 10_000
    page = (copy.out / "report.html").read_text(encoding="utf-8")
    assert "Stiffness of the joints" in page
    assert "Map of the bolts" in page
    assert "along the edge" not in page


def test_plan_and_rehearse_know_joints(folder: Folder, tmp_path: Path) -> None:
    copy = folder.copy(tmp_path / "copy")
    assert copy.run("plan", "--draws", "0").code == 0
    plan = json.loads((copy.out / "plan.json").read_text())
    assert {bolt["name"]: bolt["group"] for bolt in plan["bolts"]} == dict.fromkeys(BOLTS, "axial, rocking")
    assert plan["loose_change"] == max(bolt["threshold"] for bolt in folder.result("single")["bolts"]) == -0.5
    done = copy.run("rehearse", "--out", str(tmp_path / "rehearsed"), "--loose", "B9", "--depth", "1")
    assert done.code == 0, done.stderr
    drawn = json.loads((tmp_path / "rehearsed" / "rehearsal.json").read_text())
    job = next(job for job in drawn["jobs"].values() if job["removed"] == ["B9"])
    assert job["decades"]["B9"] == -1.0
    assert len(job["decades"]) == 9


def test_the_python_face_plots_joints(folder: Folder) -> None:
    study = load(folder.config, cache=folder.cache)
    found = study.identify("tight")
    axes = study.plot_profile(found).axes
    assert [[label.get_text() for label in one.get_xticklabels()] for one in axes] == [list(BOLTS)] * 2


def test_rotations_that_a_joint_lost_alone_are_no_all_clear(tmp_path: Path) -> None:
    """One value holds its translation and its rotations together, and 97 % of the latter are gone: it came out tight without a word."""
    folder = grillage(tmp_path / "one value", ("tight",))
    tree = {**folder.tree(), "parameters": {"joints": {"select": {"bushings": "data/bushings.csv"}}}}
    for job, changes in {"again": {}, "turned": {"B9.ROTX": -1.5, "B9.ROTY": -1.5}}.items():
        write_job(folder.data, job, changes, 300)
        tree["jobs"][job] = {"frf": f"data/{job}.uff"}
    folder.write(tree)
    study = load(folder.config, cache=folder.cache)
    tight = study.identify("tight")
    again, turned = (study.identify(job, reference=tight).record for job in ("again", "turned"))
    assert [(bolt.verdict, bolt.open_groups) for bolt in again.bolts] == [("tight", ())] * len(BOLTS)
    found = {bolt.name: bolt for bolt in turned.bolts}
    assert "loose" not in [bolt.verdict for bolt in turned.bolts]
    assert (found["B9"].verdict, found["B9"].lost_groups) == ("undecided", ("joints (rotation)",))
    assert str(found["B9"].note).startswith("the data say that springs of it alone are loose: joints (rotation) (log likelihood ratio ")
    assert "B9 probably loose)" in turned.sentence.split("inconclusive (some springs of ")[1]
    # The whole joint has not changed.
    assert abs(found["B9"].change) < 0.2


def test_each_group_is_asked_for_and_of_mixed_ones_both_kinds(tmp_path: Path) -> None:
    """A rail's fasteners lost the whole of a group with translations and rotations, which was not among what was asked for."""
    folder = grillage(tmp_path / "mixed", ("tight",))
    head, *rows = (folder.data / "bushings.csv").read_text().splitlines()
    for name, own in {"mixed": [row for row in rows if ",ROTY," not in row], "rest": [row for row in rows if ",ROTY," in row]}.items():
        (folder.data / f"{name}.csv").write_text("\n".join([head, *own]) + "\n")
    folder.write({**folder.tree(), "parameters": {name: {"select": {"bushings": f"data/{name}.csv"}} for name in ("mixed", "rest")}})
    study = load(folder.config, cache=folder.cache)
    found = springs_apart(study.inputs, study.parameters())
    asked = {bolt: {str(one.of or ""): one.terms.tolist() for one in found if one.joint == bolt} for bolt in range(len(BOLTS))}
    for parts in asked.values():
        assert list(parts) == ["", "mixed", "mixed (translation)", "mixed (rotation)", "rest"]
        assert parts[""] == [*parts["mixed"], *parts["rest"]]
        assert parts["mixed"] == [*parts["mixed (translation)"], *parts["mixed (rotation)"]]
    assert sorted(term for parts in asked.values() for name in ("mixed", "rest") for term in parts[name]) == list(range(3 * len(BOLTS)))
