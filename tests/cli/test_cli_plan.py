"""The plan of a measurement, from campaigns without any: files, choices, refusals, and the samples' blind bolts."""

from __future__ import annotations

import csv
import html
import itertools
import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from campaigns import ROOT, Folder, lrbc
from samples import reduced_cache

import lrbc_cli

WORDS = ("detectable", "marginal", "not detectable")
LOSSES = [0.5, 1.0, 2.0]
FILES = {"plan.json", "plan.csv", "plan.png"}


@pytest.fixture
def bare(box: Folder) -> Folder:
    """The tiny u-p campaign before anything was measured."""
    tree = box.tree()
    tree["jobs"] = {}
    del tree["update"]["reference"]
    tree["update"]["responses"] = ["mic1", "mic2"]
    box.write(tree)
    for file in box.data.glob("*.uff"):
        file.unlink()
    return Folder(box.path)


def few_bolts(folder: Folder) -> Folder:
    """B2 and B3 alone: every bolt is rehearsed."""
    path = folder.data / "bolts.csv"
    header, _, *rows = path.read_text().splitlines()
    path.write_text("\n".join([header, *rows[:2]]) + "\n")
    return folder


def planned(folder: Folder, *args: str, draws: int = 0) -> Any:
    """The plan; what needs no rehearsal does without."""
    outcome = folder.run("plan", "--json", "--draws", str(draws), *args)
    assert outcome.code == 0, outcome.stderr
    return outcome.json


def rows(tree: Any) -> dict[str, Any]:
    return {bolt["name"]: bolt for bolt in tree["bolts"]}


def at(bolt: Any, decades: float = 1.0) -> Any:
    return next(loss for loss in bolt["losses"] if loss["decades"] == decades)


def counted(tree: Any) -> dict[str, int]:
    return {word: tree["planned"][word.replace(" ", "_")] for word in WORDS}


def test_without_jobs(bare: Folder) -> None:
    tree = planned(bare, "--override", "output=new")
    out = bare.path / "new"
    assert {file.name for file in out.iterdir()} == FILES
    written = json.loads((out / "plan.json").read_text())
    assert len(written.pop("digest")) == 64
    assert written == tree
    assert tree["state"] == "initial"
    assert tree["noise"] == {"sigma_db": 1.0, "correlation_factor": 2.0, "coarsening": 1.0, "source": "assumed"}
    assert list(rows(tree)) == [f"B{i}" for i in range(1, 7)]
    assert {entry["name"]: entry["planned"] for entry in tree["responses"]} == {"mic1": True, "mic2": True, "mic3": False, "acc1": False}
    assert sum(counted(tree).values()) == 6
    assert tree["losses"] == LOSSES
    for bolt in tree["bolts"]:
        assert [loss["change"] for loss in bolt["losses"]] == pytest.approx([-loss for loss in LOSSES])
        assert at(bolt)["d_prime"] <= bolt["all_responses"]["d_prime"] * (1 + 1e-9)
        assert bolt["std"] >= bolt["all_responses"]["std"] * (1 - 1e-9)
        assert 0 < bolt["std"] <= 0.35 * (1 + 1e-9)
        assert bolt["variance_removed"] == pytest.approx(1 - (bolt["std"] / 0.35) ** 2)
    with (out / "plan.csv").open() as file:
        table = list(csv.DictReader(file))
    assert [(row["name"], row["verdict"]) for row in table] == [(bolt["name"], bolt["verdict"]) for bolt in tree["bolts"] for _ in LOSSES]
    for key in ("d_prime", "right"):
        wanted = [loss[key] for bolt in tree["bolts"] for loss in bolt["losses"]]
        np.testing.assert_allclose([float(row[key]) for row in table], wanted, rtol=1e-6)


@pytest.mark.slow
def test_figures_are_counted_in_rehearsals(bare: Folder) -> None:
    few_bolts(bare)
    tree = planned(bare, draws=2)
    assert (tree["method"], tree["draws"]) == ("rehearsed", 2)
    for k, decades in enumerate(LOSSES):
        said = [bolt["losses"][k] for bolt in tree["bolts"]]
        loose = [one["rehearsal"]["loose"] for one in said]
        for one, own, other in zip(said, loose, loose[::-1], strict=True):
            rehearsed = one["rehearsal"]
            assert one["decades"] == decades
            assert rehearsed["loose"] + rehearsed["undecided"] + rehearsed["tight"] == rehearsed["draws"] == 2
            # The other bolt counts as one more draw: never a certainty from so few.
            assert one["right"] == pytest.approx((own + (other + 0.5) / 3) / 3)
            assert one["right95"][0] <= own / 2 <= one["right95"][1]
            assert one["linearised"] != one["right"]
        assert tree["by_loss"][k]["draws"] == 4
        assert tree["by_loss"][k]["right"] == pytest.approx(np.mean([one["right"] for one in said]))
    for bolt in tree["bolts"]:
        right = at(bolt)["right"]
        assert bolt["verdict"] == ("detectable" if right >= 0.8 else "marginal" if right >= 0.2 else "not detectable")
    words = [bolt["verdict"] for bolt in tree["bolts"]]
    assert counted(tree) == {word: words.count(word) for word in WORDS}
    # All bolts tight, twice after each of the five reference jobs: what is not tight or loose is inconclusive, by its name.
    again = tree["tight"]
    assert (again["draws"], again["verdicts"]) == (10, 20)
    assert again["tight"] + again["loose"] + sum(again["undecided"].values()) == again["verdicts"]
    assert set(again["undecided"]) <= {"B2", "B3"}
    assert again["clear"] <= min(again["validated"], again["tight"] // 2)
    line = f"all bolts tightened again: an all-clear in {again['clear']} of 10 draws; of 20 verdicts {again['tight']} tight"
    assert line in bare.run("plan", "--draws", "2").stdout
    assert "tight" not in planned(bare)
    # The same again, as part of more: a draw does not depend on the others.
    for one, two in zip(planned(bare, draws=1)["bolts"], tree["bolts"], strict=True):
        for less, more in zip(one["losses"], two["losses"], strict=True):
            assert less["rehearsal"]["probability_loose"] == more["rehearsal"]["probability_loose"][:1]
    linearised = planned(bare)
    assert (linearised["method"], linearised["draws"]) == ("linearised", 0)
    assert all("rehearsal" not in loss for bolt in linearised["bolts"] for loss in bolt["losses"])
    assert at(rows(linearised)["B3"])["right"] == at(rows(tree)["B3"])["linearised"]


def said(tree: Any, words: str) -> bool:
    return any(words in text for text in tree["assumes"])


@pytest.mark.parametrize(
    ("words", "loose_change"),
    [
        ((), -0.35),
        pytest.param(("update.loose_change=-0.6",), -0.6, marks=pytest.mark.slow),
        pytest.param(("update.approach=paper",), -0.5, marks=pytest.mark.slow),
    ],
)
def test_the_threshold_is_that_of_update(box: Folder, words: tuple[str, ...], loose_change: float) -> None:
    """Of a bolt far from the loosened ones."""
    options = [part for word in ("update.regularisation=auto", *words) for part in ("--override", word)]
    assert box.run("update", *options).code == 0
    assert planned(box, *options)["loose_change"] == loose_change
    assert max(bolt["threshold"] for bolt in box.result("loose")["bolts"]) == loose_change


@pytest.mark.slow
def test_the_plan_says_what_it_assumes(bare: Folder) -> None:
    few_bolts(bare)
    auto = ("--override", "update.regularisation=auto")
    outcome = bare.run("plan", "--draws", "1", *auto, "--override", "update.nuisances={gain: 0.3}")
    tree = json.loads((bare.out / "plan.json").read_text())
    for text in tree["assumes"]:
        assert f"- {text}" in outcome.stdout
    for words in (
        "the start values",
        "model discrepancy 1 dB",
        "12 % of the shift",
        "gains of the responses",
        "0.5, 1 or 2 decades",
        "a reference job",
    ):
        assert said(tree, words), words
    assert said(tree, "each bolt tight or loose (mixture); loose below -0.35 decades")
    bare.run("plan", "--draws", "1", "--noise", "0.5", *auto, "--override", "update.approach=paper")
    tree = json.loads((bare.out / "plan.json").read_text())
    assert said(tree, "model discrepancy 0.5 dB per line (--noise)")
    assert said(tree, "no drift between the jobs")
    assert said(tree, "normal, 0.35 decades; loose below -0.5 decades")
    linearised = planned(bare)
    assert said(linearised, "not rehearsed (--draws 0)")
    assert said(planned(bare, "--by", "values", draws=1), "not rehearsed (values")
    assert said(planned(bare, "--state", "free", draws=1), "not rehearsed (bolts that are tightened are not judged)")
    assert bare.run("plan", "--draws", "-1").code == 2


def test_the_table_says_what_the_file_says(bare: Folder) -> None:
    outcome = bare.run("plan", "--draws", "0")
    assert outcome.code == 0
    assert outcome.stdout.isascii()
    # What the columns are.
    for word in ("d': distance of the changed FRFs", "std: standard deviation", "bits: information about the bolts", "alone: by itself"):
        assert word in outcome.stdout
    tree = json.loads((bare.out / "plan.json").read_text())
    for bolt in tree["bolts"]:
        line = next(line for line in outcome.stdout.splitlines() if line.startswith(f"{bolt['name']} "))
        assert f" {bolt['verdict']} " in line
        assert f"{at(bolt)['d_prime']:.1f}" in line
        assert all(f" {loss['right']:.2f} " in line for loss in bolt["losses"])
    for entry in tree["responses"]:
        line = next(line for line in outcome.stdout.splitlines() if line.startswith(f"{entry['name']} "))
        assert ("loses" if entry["planned"] else "adds") in line
        assert f"{entry['gain_bits']:.2f}" in line


def test_gains_are_differences_of_plans(bare: Folder) -> None:
    now = planned(bare)
    gain = {entry["name"]: entry["gain_bits"] for entry in now["responses"]}
    lines = f"update.lines={{list: {now['lines']['frequency_hz']}}}"
    more = planned(bare, "--override", lines, "--override", "update.responses=[mic1, mic2, acc1]")
    less = planned(bare, "--override", lines, "--override", "update.responses=[mic1]")
    assert gain["acc1"] == pytest.approx(more["planned"]["bits"] - now["planned"]["bits"], rel=1e-3)
    assert gain["mic2"] == pytest.approx(now["planned"]["bits"] - less["planned"]["bits"], rel=1e-3)
    assert now["all_responses"]["bits"] == pytest.approx(now["order"][-1]["bits"])
    assert now["all_responses"]["bits"] >= more["planned"]["bits"] >= now["planned"]["bits"] >= less["planned"]["bits"]


def test_noise_hides_bolts(bare: Folder) -> None:
    found = [planned(bare, "--noise", level) for level in ("0.2", "2", "20")]
    for quiet, loud in itertools.pairwise(found):
        assert loud["noise"]["source"] == "--noise"
        for name, bolt in rows(loud).items():
            assert at(bolt)["d_prime"] < at(rows(quiet)[name])["d_prime"]
            assert bolt["std"] >= rows(quiet)[name]["std"]
    assert found[0]["planned"]["detectable"] > found[2]["planned"]["detectable"]


def test_states(bare: Folder) -> None:
    wide = "parameters.springs.bounds=[3.5, 14.0]"
    clamped, free = (planned(bare, "--state", state, "--override", wide) for state in ("clamped", "free"))
    assert (clamped["tightened"], free["tightened"]) == (False, True)
    assert all(at(bolt)["change"] < 0 for bolt in clamped["bolts"])
    assert all(at(bolt)["change"] > 0 for bolt in free["bolts"])
    assert any(bolt["verdict"] == "detectable" for bolt in free["bolts"])
    # Springs at such an upper bound are rigid, and so they are a decade below it.
    assert all(bolt["verdict"] == "not detectable" and at(bolt)["d_prime"] < 0.01 for bolt in clamped["bolts"])


def test_a_finished_job_is_a_state(box: Folder) -> None:
    tree = planned(box)
    result = box.result("tight")
    assert tree["state"] == "job:tight"
    assert tree["noise"]["sigma_db"] == result["noise"]["sigma_db"]
    assert tree["noise"]["source"] == "job tight"
    other = planned(box, "--state", "job:loose", "--noise", "0.5")
    assert other["state"] == "job:loose"
    assert other["noise"] == {
        "sigma_db": 0.5,
        # What changes leave in a job that is compared is not the model discrepancy.
        "correlation_factor": result["noise"]["correlation_factor"],
        "coarsening": 1.0,
        "source": "--noise",
    }
    assert planned(box, "--state", "initial")["state"] == "initial"


def test_nothing_is_detectable_beside_a_reference_job_that_is_unexplained(box: Folder) -> None:
    assert any(bolt["verdict"] == "detectable" for bolt in planned(box)["bolts"])
    tree = box.tree()
    tree["update"]["largest_misfit"] = 1e-20
    box.write(tree)
    said = box.run("update", "-v", "--force").stderr
    assert box.result("tight")["status"] == "unexplained"
    # Before the other jobs are identified, which may take minutes.
    told = "warning: the reference job tight is unexplained (misfit"
    assert said.count(told) == 1
    assert said.index(told) < said.index("loose: identifying")
    found = planned(box)
    assert counted(found) == {"detectable": 0, "marginal": 0, "not detectable": len(found["bolts"])}
    why = "the reference job tight is unexplained: nothing is judged"
    assert why in found["notes"]
    assert {bolt["note"] for bolt in found["bolts"]} >= {why}
    assert why in box.run("plan", "--draws", "0").stdout


def test_it_says_that_no_job_will_be_validated(box: Folder) -> None:
    box.run("update", "--job", "tight")
    misfit = box.result("tight")["misfit_db"]
    most = max(misfit["final"], misfit["held_out_final"] or 0.0)
    found = {}
    for name, share in (("coarse", 1.4), ("fine", 1.5)):
        study = lrbc_cli.load(box.config, cache=box.cache)
        study = study.with_method(rule=replace(study.inputs.method.rule, validated_misfit=share * most))
        found[name] = [note for note in study.plan(draws=0).notes if note.startswith("no job will be validated, so none is an all-clear")]
    assert len(found["coarse"]) == 1
    assert found["fine"] == []


@pytest.mark.slow
def test_a_plan_of_more_rehearsals_is_kept(bare: Folder) -> None:
    rehearsed = planned(few_bolts(bare), draws=2)
    done = bare.run("plan", "--draws", "0")
    assert "note: the earlier plan, of more rehearsals, is kept in" in done.stderr
    kept = json.loads((bare.out / "plan.previous.json").read_text())
    assert (kept["draws"], kept["bolts"]) == (2, rehearsed["bolts"])
    assert (bare.out / "plan.previous.csv").is_file()
    assert json.loads((bare.out / "plan.json").read_text())["draws"] == 0
    assert "earlier plan" not in bare.run("plan", "--draws", "0").stderr
    assert json.loads((bare.out / "plan.previous.json").read_text())["draws"] == 2


def test_values_where_there_are_no_bolts(bare: Folder) -> None:
    by_bolt = planned(bare)
    by_value = planned(bare, "--by", "values")
    assert by_value["unknowns"] == "values"
    assert list(rows(by_value)) == [f"springs[{k}]" for k in range(6)]
    # One spring stands at each bolt: both ask the same.
    np.testing.assert_allclose([at(b)["d_prime"] for b in by_value["bolts"]], [at(b)["d_prime"] for b in by_bolt["bolts"]], rtol=1e-6)
    tree = bare.tree()
    del tree["bolts"]
    bare.write(tree)
    assert planned(bare)["unknowns"] == "values"
    outcome = bare.run("plan", "--by", "bolts")
    assert outcome.code == 2
    assert "--by values" in outcome.stderr


def test_drift_costs_information(bare: Folder) -> None:
    auto = ("--override", "update.regularisation=auto")
    held = planned(bare, *auto)
    drifting = planned(bare, *auto, "--override", "update.nuisances={temperature: 3.0, gain: 3.0}")
    kinds = [entry["kind"] for entry in drifting["nuisances"]]
    assert kinds.count("gain") == 4
    assert kinds.count("factor") == 1
    for name, bolt in rows(drifting).items():
        assert bolt["std"] >= rows(held)[name]["std"] * (1 - 1e-6)
        assert at(bolt)["d_prime"] <= at(rows(held)[name])["d_prime"] * (1 + 1e-6)
    assert drifting["planned"]["bits"] < held["planned"]["bits"] - 0.01


def test_hammer_points(bare: Folder) -> None:
    tree = bare.tree()
    tree["excitation"]["second"] = {"node": 3, "component": "UZ"}
    for name, response in tree["responses"].items():
        response["excitation"] = "hammer" if name != "mic2" else "second"
    bare.write(tree)
    found = planned(bare)
    points = {entry["name"]: entry for entry in found["excitations"]}
    assert points["hammer"]["responses"] == ["mic1"]
    assert points["second"]["responses"] == ["mic2"]
    gain = {entry["name"]: entry for entry in found["responses"]}
    assert points["second"]["gain_bits"] == pytest.approx(gain["mic2"]["gain_bits"])
    assert points["second"]["alone_bits"] == pytest.approx(gain["mic2"]["alone_bits"])
    assert "excitation" in bare.run("plan", "--draws", "0").stdout


@pytest.mark.parametrize(
    ("args", "code", "words"),
    [
        (("--state", "loose"), 2, ("--state loose", "initial, clamped, free or job:NAME")),
        (("--state", "job:none"), 2, ("none",)),
        (("--noise", "0"), 2, ("noise",)),
        (("--noise", "nan"), 2, ("noise",)),
        (("--by", "nuts"), 2, ("nuts",)),
        (("--override", "update.lines={list: [900.0]}"), 2, ("update.lines", "20 to 400 Hz")),
        (("--override", "parameters.springs.kind=mass"), 2, ("stiffness",)),
    ],
)
def test_refusals(bare: Folder, args: tuple[str, ...], code: int, words: tuple[str, ...]) -> None:
    outcome = bare.run("plan", *args)
    assert outcome.code == code, outcome.stderr
    assert "Traceback" not in outcome.stderr
    for word in words:
        assert word in outcome.stderr
    assert outcome.stdout == ""


def test_a_job_without_result_is_no_state(bare: Folder, box: Folder) -> None:
    tree = bare.tree()
    tree["jobs"] = {"later": {"frf": "data/later.uff"}}
    bare.write(tree)
    outcome = bare.run("plan", "--state", "job:later")
    assert outcome.code == 3
    assert "later" in outcome.stderr


def test_check_points_to_it(bare: Folder) -> None:
    assert "lrbc plan" in bare.run("check").stdout


@pytest.mark.slow
def test_the_report_shows_it(box: Folder) -> None:
    tree = planned(box, draws=1)
    picture = box.out / "plan.png"
    picture.unlink()
    outcome = box.run("report")
    assert outcome.code == 0, outcome.stderr
    assert picture.read_bytes().startswith(b"\x89PNG")
    page = (box.out / "report.html").read_text()
    assert 'id="plan"' in page
    assert "Information from each response" in page
    assert "These figures assume" in page
    assert all(html.escape(text) in page for text in tree["assumes"])
    (box.out / "plan.json").write_text('{"format": "lrbc-plan", "version": 1}')
    broken = box.run("report")
    assert broken.code == 3
    assert "plan.json" in broken.stderr


@pytest.mark.slow
def test_bolts_at_the_corners_of_the_soundbox_are_blind(tmp_path: Any) -> None:
    """Those beyond the ends of the edge and beside its clamped corners; the middle is seen. So it turned out in the seven jobs."""
    out = tmp_path / "out"
    # The fits below are of squares.
    words = ("--override", f"output={out}", "--override", "update.loss=squares", "--draws", "0")
    outcome = lrbc("plan", ROOT / "configs" / "soundbox.yaml", "--json", "--cache", reduced_cache("soundbox"), *words)
    assert outcome.code == 0, outcome.stderr
    found = rows(outcome.json)
    assert all(found[name]["verdict"] == "not detectable" for name in ("B01", "B02", "B03", "B15", "B16", "B17"))
    assert all("beyond the ends" in found[name]["note"] for name in ("B01", "B02", "B16", "B17"))
    assert all(at(found[f"B{k:02d}"], 2.0)["right"] > 0.8 for k in range(6, 13))
    # What fits of every other bolt, not linearised, leave of these losses: 3.5, 3.3 and 3.3 standard deviations.
    np.testing.assert_allclose([at(found[name])["d_prime"] for name in ("B06", "B08", "B12")], [3.51, 3.31, 3.28], rtol=0.25)
    assert outcome.json["seconds"]["plan"] > 0
