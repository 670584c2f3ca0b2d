"""What a result says of bolts that no term reaches, and of jobs that nothing validates: in JSON, CSV and on the page."""

from __future__ import annotations

import csv
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from campaigns import Folder, box, finished

from lrbc_cli.campaign.identification.weights import validation_channels
from lrbc_cli.io.frf import read_frf, write_frf
from lrbc_cli.model.frf import FrfRecord, FrfSet
from lrbc_cli.updating.statistics.model import ValidationChannels

BEYOND = ("B0", "B7")
NUMBERS = ("log10_stiffness", "change", "change_std", "threshold", "probability_loose", "probability_changed")


def table(folder: Folder) -> dict[str, dict[str, str]]:
    with (folder.out / "campaign.csv").open(newline="") as file:
        return {row["job"]: row for row in csv.DictReader(file)}


def page(folder: Folder) -> str:
    assert folder.run("report").code == 0
    return (folder.out / "report.html").read_text(encoding="utf-8")


@pytest.fixture
def longer(tmp_path: Path) -> Folder:
    """The box with a bolt beyond each end of its edge, a baseline, and a measurement that its model does not explain."""
    folder = box(tmp_path / "box")
    path = folder.data / "bolts.csv"
    path.write_text(path.read_text() + "B0,-0.6,0.01,0\nB7,1.95,0.01,0\n")
    records = read_frf(folder.data / "loose.uff").records
    write_frf(
        folder.data / "wrong.uff", FrfSet(source="wrong", records=tuple(replace(r, values=3.0 * np.roll(r.values, 9)) for r in records))
    )
    (folder.data / "again.uff").write_bytes((folder.data / "tight.uff").read_bytes())
    tree = folder.tree()
    tree["jobs"] |= {name: {"frf": f"data/{name}.uff"} for name in ("wrong", "again")}
    tree["update"] |= {"baselines": ["again"], "regularisation": "auto"}
    folder.write(tree)
    return folder


def outside(tree: Any) -> None:
    """Two bolts are outside and have no number, the others are not."""
    for bolt in tree["bolts"]:
        assert (bolt["verdict"] == "outside") == (bolt["name"] in BEYOND), (tree["job"], bolt)
        if bolt["name"] in BEYOND:
            assert [bolt[key] for key in NUMBERS] == [None] * len(NUMBERS)
            assert "no term within half a pitch" in bolt["note"]


@pytest.mark.slow
def test_bolts_that_no_term_reaches(longer: Folder) -> None:
    """Reference job, baseline, job with loose bolts and unexplained job alike."""
    outcome = longer.run("update")
    assert outcome.code == 0, outcome.stderr
    results, rows = longer.results(), table(longer)
    assert results["wrong"]["status"] == "unexplained"
    for name, tree in results.items():
        outside(tree)
        assert rows[name]["outside"].split() == ["B0", "B7"]
        assert not set(rows[name]["undecided"].split()) & set(BEYOND)
    assert {b["name"] for b in results["loose"]["bolts"] if b["verdict"] == "loose"} == {"B3", "B4"}
    assert {b["verdict"] for b in results["again"]["bolts"] if b["name"] not in BEYOND} == {"tight"}
    text = page(longer)
    titles = [title for pair in re.findall(r'title="([^"]*)"|<title>([^<]*)</title>', text) for title in pair]
    said = [title for title in titles if re.search(r"\bB[07]: ", title)]
    assert len(said) >= 2 * len(results)
    for words in said:
        assert "outside, not observable" in words
        assert "%" not in words
        assert "decades" not in words
    assert "2 of 6 judged loose, 2 outside" in text


def test_without_a_reference(longer: Folder) -> None:
    """By contrast with the other bolts, of which those outside are none."""
    tree = longer.tree()
    del tree["update"]["reference"], tree["update"]["baselines"]
    tree["jobs"] = {"loose": tree["jobs"]["loose"]}
    longer.write(tree)
    assert longer.run("update").code == 0
    outside(longer.result("loose"))
    assert {b["name"] for b in longer.result("loose")["bolts"] if b["verdict"] == "loose"} == {"B3", "B4"}


def test_nothing_validates_channels_that_were_fitted(tmp_path: Path) -> None:
    folder = finished("box").copy(tmp_path / "box")
    for tree in folder.results().values():
        valid, misfit = tree["validity"], tree["misfit_db"]
        assert (valid["passed"], valid["compared"], valid["held_out_db"]) == (None, "channels used", None)
        assert valid["misfit_db"] == pytest.approx(misfit["final"])
        assert valid["reason"].startswith("not validated: there are no validation channels; mean misfit of the channels used 0.00 dB")
        assert valid["reason"] in tree["notes"]
        # Judged all the same.
        assert tree["status"] == "converged"
    assert {b["name"] for b in folder.result("loose")["bolts"] if b["verdict"] == "loose"} == {"B3", "B4"}
    text = page(folder)
    assert "tight, loose: not validated: the verdicts stand, but are no all-clear" in text
    assert ">passed<" not in text


def test_fitted_channels_can_only_speak_against_the_model(longer: Folder) -> None:
    assert longer.run("update", "--job", "wrong").code == 0
    tree = longer.result("wrong")
    assert tree["status"] == "unexplained"
    assert (tree["validity"]["passed"], tree["validity"]["held_out_db"]) == (False, None)
    assert "mean misfit of the channels used" in tree["reason"]
    assert "above the limit of " in tree["reason"]


def test_validation_channels(tmp_path: Path) -> None:
    folder = box(tmp_path / "box")
    tree = folder.tree()
    tree["update"]["responses"] = ["mic1", "mic2", "acc1"]
    folder.write(tree)
    assert folder.run("update").code == 0
    for result in folder.results().values():
        valid = result["validity"]
        assert (valid["passed"], valid["compared"]) == (True, "validation channels")
        assert valid["held_out_db"] == valid["misfit_db"] == pytest.approx(result["misfit_db"]["responses"]["mic3"]["final"])
        assert "validation channels" in valid["reason"]
    assert "not validated" not in page(folder)


def test_a_validation_channel_that_is_explained_less_widens_the_intervals(tmp_path: Path) -> None:
    """Residuals of what was fitted tell less than what the model lacks where nothing was fitted."""
    widths, ratios = [], []
    for gain in (1.0, 1.3):
        folder = box(tmp_path / f"box-{gain}")
        tree = folder.tree()
        tree["update"]["responses"] = ["mic1", "mic2", "acc1"]
        tree["responses"]["mic3"]["scale"] = gain
        folder.write(tree)
        assert folder.run("update").code == 0
        result = folder.result("loose")
        misfit = result["misfit_db"]
        ratios.append(result["noise"]["validation_ratio"])
        assert ratios[-1] == pytest.approx(max(misfit["held_out_final"] / misfit["final"], 1.0))
        (group,) = result["parameters"].values()
        widths.append((np.mean(group["std"]), np.mean([b["change_std"] for b in result["bolts"]])))
        told = [w for w in result["warnings"] if "sensitivity of mic3" in w]
        assert len(told) == (gain > 1.0)
        assert all("over 100 times worse than the channels used (mic3)" in w for w in told)
    assert ratios[1] > 2.0 * ratios[0]
    assert widths[1][0] > widths[0][0]
    assert widths[1][1] > widths[0][1]


def test_what_can_validate() -> None:
    """Values on most lines, and a sensor of its own: the rest of the unused responses test nothing."""
    rng = np.random.default_rng(0)
    values = rng.normal(size=(50, 4)) + 1j * rng.normal(size=(50, 4))
    used, unused, limits = np.array([0, 1]), np.array([2, 3]), ValidationChannels()
    assert validation_channels(values, used, unused, limits) == (pytest.approx([2, 3]), "")
    values[2:, 3] = np.nan
    assert validation_channels(values, used, unused, ValidationChannels(least_lines=0.03)) == (pytest.approx([2, 3]), "")
    assert validation_channels(values, used, unused, limits) == (pytest.approx([2]), "")
    # The record of the first response in other units, and noise of a millionth's tenth.
    values[:, 2] = -9.81 * values[:, 0] * (1 + 1e-8 * rng.normal(size=50))
    found, why = validation_channels(values, used, unused, limits)
    assert found.size == 0
    assert why == "the validation channels are copies of records that were fitted"
    assert validation_channels(values, used, unused, ValidationChannels(copied=1e-9))[0] == pytest.approx([2])
    assert validation_channels(values, used, unused[1:], limits)[1] == "the validation channels have values on 4% of the lines only"
    assert validation_channels(values, used, unused[:0], limits)[1] == "there are no validation channels"


def test_the_reference_file_once_more_clears_nothing(tmp_path: Path) -> None:
    """The classic slip of a campaign: the file of the next state is the last one's."""
    folder = box(tmp_path / "box")
    (folder.data / "loose.uff").write_bytes((folder.data / "tight.uff").read_bytes())
    done = folder.run("update", "--fail-on-loose")
    assert done.code == 7, done.stderr
    validity = folder.result("loose")["validity"]
    assert validity["passed"] is None
    again = "not validated: loose.uff contains the measurement of tight again; check whether another file was meant"
    assert validity["reason"].startswith(f"{again};")
    assert any("contains the measurement of tight again" in note for note in folder.result("loose")["notes"])
    # This is a box without validation channels: all reasons are told.
    # The job states removed bolts, too.
    stated = "bolts are stated to be missing, but judged tight"
    assert f"({again}; there are no validation channels; {stated})" in done.stdout


def test_loose_bolts_of_the_reference_job_are_seen_there(tmp_path: Path) -> None:
    """What is as loose in both comes out tight: only the other bolts of the reference job tell."""
    folder = box(tmp_path / "box")
    noise = np.random.default_rng(5).standard_normal
    records = read_frf(folder.data / "loose.uff").records
    write_frf(
        folder.data / "tight.uff",
        FrfSet(source="tight", records=tuple(replace(r, values=r.values * (1 + 0.003 * noise(r.values.size))) for r in records)),
    )
    done = folder.run("update", "--fail-on-loose")
    assert done.code == 7, done.stderr
    reference = folder.result("tight")
    assert reference["taken_as_tight"]["doubtful"] == ["B3", "B4"]
    assert "probably not all tight (far below the other bolts: B3 (" in done.stderr
    assert "taken as tight; but B3, B4 far looser than the other bolts there" in done.stdout
    assert "B3, B4 far looser than the other bolts in the reference job" in folder.result("loose")["validity"]["unvalidated"]
    assert "B4 far looser than the other bolts there" in folder.run("status").stdout


def test_what_is_stated_as_removed_and_comes_out_tight_is_told(tmp_path: Path) -> None:
    folder = box(tmp_path / "box")
    tree = folder.tree()
    tree["jobs"]["loose"]["removed"] = ["B1", "B3"]
    folder.write(tree)
    done = folder.run("update")
    assert "jobs.loose.removed: B1 is stated to be missing, but judged tight against tight. " in done.stderr
    assert "loose instead: check whether the bolts are numbered differently at the rig" in done.stderr
    assert "correct the names in bolts.csv. Otherwise check whether the files of the two jobs" in done.stderr


def rewritten(change: Callable[[FrfRecord], FrfRecord]) -> Callable[[Folder], None]:
    """The measurement of the tight state in another file."""

    def put(folder: Folder) -> None:
        found = read_frf(folder.data / "tight.uff")
        write_frf(folder.data / "loose.uff", replace(found, records=tuple(map(change, found.records))))

    return put


def one_cut(record: FrfRecord) -> FrfRecord:
    """The first response ends early; all others, and with them the axis of the job, are whole."""
    whole = replace(record, values=record.values * (1.0 + 0.005 * np.random.default_rng(7).normal(size=record.values.size)), coherence=None)
    return cut(record) if record.name == "mic1" else whole


def cut(record: FrfRecord) -> FrfRecord:
    n = int(0.9 * record.frequency_hz.size)
    noise = 1.0 + 0.005 * np.random.default_rng(n).normal(size=n)
    return replace(record, frequency_hz=record.frequency_hz[:n], values=record.values[:n] * noise, coherence=None)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda record: replace(record, values=record.values * (1 + 1e-9)), "it has the numbers of the measurement of tight"),
        (cut, "its lines reach from 20 to 360 Hz, those of tight from 20 to 400 Hz; check whether it is complete"),
        (one_cut, "mic1 lacks a part of the lines of tight; check whether the files are complete"),
    ],
)
def test_what_is_no_measurement_of_its_own_or_not_whole_clears_nothing(
    change: Callable[[FrfRecord], FrfRecord], said: str, tmp_path: Path
) -> None:
    folder = box(tmp_path / "box")
    rewritten(change)(folder)
    done = folder.run("update", "--fail-on-loose")
    assert done.code == 7, done.stdout
    validity = folder.result("loose")["validity"]
    assert validity["passed"] is None
    assert validity["unvalidated"].startswith(said)
    assert f"(not validated: {said}" in done.stdout
