"""Nothing is an all-clear that was not earned: jobs without a file, files that were replaced, models and measurements in doubt."""

from __future__ import annotations

import re
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from campaigns import Folder, measure_again, with_a_tight_job, with_job

from lrbc_cli.campaign.digests import about_measurement
from lrbc_cli.campaign.identification.compared.complete import shares
from lrbc_cli.campaign.identification.records import Measurement
from lrbc_cli.campaign.jobs.identity import identification
from lrbc_cli.campaign.jobs.judging import missed
from lrbc_cli.campaign.reduced import cache
from lrbc_cli.config import load_campaign
from lrbc_cli.results.job import Certificate
from lrbc_cli.results.store import read_job
from lrbc_cli.updating.judging.clearance import BoltFinding, JobFinding
from lrbc_cli.watch.verdict import verdict_of


@pytest.fixture
def tight(frame: Folder) -> Folder:
    """The tight state, and measured again: all clear."""
    return with_a_tight_job(frame)


def head_of(folder: Folder) -> str:
    page = (folder.out / "report.html").read_text(encoding="utf-8")
    return re.sub(r"<[^>]+>", " ", page[page.index("<header") : page.index("</header")])


def test_a_job_without_a_file_is_no_all_clear_of_watch(tight: Folder) -> None:
    once = ("watch", "--once", "--fail-on-loose", "--interval", "0.1")
    assert tight.run(*once).code == 0
    with_job(tight, "later")
    told = tight.run(*once)
    assert told.code == 7
    assert "no all-clear: later is not measured" in told.stderr


def test_a_hook_hears_the_exit_code_of_update(tight: Folder) -> None:
    """A baseline with a bolt that is probably loose, or a reference job that is not validated: `update --job` is no all-clear either."""
    assert tight.run("update").code == 0
    record = read_job(tight.out, "again")
    assert record is not None
    bolts = (BoltFinding(name="B1", verdict="tight"),)
    reference = JobFinding(status="converged", bolts=bolts, assumed="reference")
    told = [
        verdict_of(record, {"tight": known}, ("tight",))
        for known in (reference, replace(reference, doubtful=("B1",)), replace(reference, validated=False))
    ]
    assert [verdict.exit_code for verdict in told] == [0, 7, 7]
    # A sentence on this job alone would read as one.
    assert "no all-clear" not in told[0].sentence
    assert told[1].sentence.endswith("; no all-clear: tight: B1 taken as tight, but far looser than the other bolts there")
    assert told[2].sentence.endswith(
        "; no all-clear: tight: not validated: no validation channel shows whether the model explains the measurement"
    )
    last = verdict_of(record, {"tight": reference}, ("tight",), unseen=True)
    assert (last.exit_code, last.sentence.partition("; no all-clear: ")[2]) == (7, "a measurement belongs to no job")


def test_a_result_of_a_file_that_was_replaced_is_told_on_the_page(tight: Folder) -> None:
    """`run --job` writes the page of all jobs; the others are not looked at again."""
    assert tight.run("run", "--fail-on-loose").code == 0
    assert "earlier" not in head_of(tight)
    shutil.copy(tight.data / "frf" / "loose-2.csv", tight.data / "frf" / "again.csv")
    with_job(tight, "loose-all")
    assert tight.run("run", "--job", "loose-all").code == 0
    head = head_of(tight)
    assert "results of earlier measurements or settings: 1" in head
    assert "no loose bolt found: 6 tight (result of an earlier measurement or of earlier settings, see below)" in head
    told = tight.run("report").stdout
    assert "again: again.csv is not the file that was identified; the result is that of an earlier measurement (`lrbc update`)\n" in told
    assert tight.run("run").code == 0
    assert "earlier" not in head_of(tight)


def test_a_result_that_rests_on_an_earlier_reference_job_is_told_on_the_page(tight: Folder) -> None:
    assert tight.run("run").code == 0
    measure_again(tight.data / "frf" / "again.csv", tight.data / "frf" / "tight.csv")
    with_job(tight, "loose-all")
    assert tight.run("run", "--job", "loose-all").code == 0
    head = head_of(tight)
    assert "results of earlier measurements or settings: 1" in head
    assert "again: it rests on a result of tight that is no longer there; the result is that of earlier tight states" in head


def test_a_result_of_other_settings_is_told_on_the_page(tight: Folder) -> None:
    """Only if these settings matter, and no longer once the jobs were identified or judged again."""
    assert tight.run("run").code == 0
    assert "earlier" not in tight.run("report", "--override", "description=other words").stdout
    for override, why in (("update.confidence=0.9", "changed: the decision rule"), ("reduction.band=[30, 400]", "changed: ")):
        told = tight.run("report", "--override", override).stdout
        assert f"again: {why}" in told, told
        assert "; the result is that of earlier settings (`lrbc update`)" in told
        assert "results of earlier measurements or settings: 2" in head_of(tight)
        tight.run("run", "--override", override)
        assert "earlier" not in head_of(tight)
    (tight.data / "model" / "mass.mtx.gz").unlink()
    assert "the model cannot be read now" in tight.run("report").stdout


def test_copies_are_known_by_the_present_files(tight: Folder) -> None:
    """Also of a job that was never identified; and no longer once its file was replaced by the right one."""
    later = tight.data / "frf" / "later.csv"
    shutil.copy(tight.data / "frf" / "again.csv", later)
    with_job(tight, "later")
    one = ("update", "--fail-on-loose", "--job", "again")
    told = tight.run(*one)
    assert told.code == 7
    assert "again: not validated: it has the numbers of the measurement of later: check whether another file was meant)" in told.stdout
    assert tight.run("update", "--fail-on-loose").code == 7
    measure_again(tight.data / "frf" / "tight.csv", later)
    assert tight.run(*one).code in (0, 7)
    assert "the measurement of later" not in tight.run(*one).stdout


def test_the_page_and_the_table_tell_of_a_copy(tight: Folder) -> None:
    shutil.copy(tight.data / "frf" / "again.csv", tight.data / "frf" / "later.csv")
    with_job(tight, "later")
    assert tight.run("run", "--fail-on-loose").code == 7
    head = head_of(tight)
    assert "with the measurement of another job: 2" in head
    assert "the same measurement as again: check whether another file was meant" in head
    assert "the same measurement as later" in (tight.out / "campaign.csv").read_text()


def test_node_numbers_are_part_of_what_a_result_rests_on(tight: Folder) -> None:
    """Records of universal files are found by them."""
    inputs = tight.inputs()
    model = cache.key_parts(inputs)
    renumbered = replace(inputs, responses=(replace(inputs.responses[0], node=4711), *inputs.responses[1:]))
    hit = replace(inputs, excitation_points=((4711, 3), *inputs.excitation_points[1:]))
    own, *others = [identification(each, model, "again").parts for each in (inputs, renumbered, hit)]
    for other in others:
        assert {name for name in own if own[name] != other[name]} == {"responses", "reference"}


def test_names_of_files_count_where_they_name_a_response(tight: Folder) -> None:
    (tight.data / "coh").mkdir()
    tree = tight.tree()

    def about(*names: str) -> dict[str, object]:
        tree["jobs"]["again"]["coherence"] = [f"data/coh/{name}.csv" for name in names]
        tight.write(tree)
        campaign = load_campaign(tight.config)
        return about_measurement(campaign.resolved(), campaign.jobs["again"], "again")

    assert about("u", "v") == about("x", "y")
    assert about("acc1", "acc2") != about("u", "v")
    assert about("acc1", "acc2") != about("acc2", "acc1")


@pytest.mark.parametrize("reached", [True, None])
def test_a_model_within_its_tolerance_is_no_reason(reached: bool | None) -> None:
    assert missed(None) == ""
    assert missed(Certificate(key="", size=9, tolerance=1e-3, worst=1e-4, reached=reached)) == ""


def test_a_model_that_misses_its_tolerance_validates_nothing(tight: Folder) -> None:
    """Neither with the flag that accepts it, nor later, when the result is kept."""
    words = ("update", "--fail-on-loose", "--no-calibration", "--override", "reduction.max_size=12")
    assert tight.run(*words).code == 4
    for further in (("--accept-tolerance",), ()):
        told = tight.run(*words, *further)
        assert told.code in (6, 7)
        assert all(tight.result(job)["provenance"]["certificate"]["reached"] is False for job in ("tight", "again"))
        validity = tight.result("tight")["validity"]
        assert validity["passed"] is not True
        if validity["passed"] is None:
            assert "the reduced model has an error of " in validity["unvalidated"]


def measurement(axis: np.ndarray, values: np.ndarray) -> Measurement:
    nothing = np.full(values.shape, np.nan)
    return Measurement(frequency_hz=axis, values=values, coherence=nothing, notes=(), warnings=(), records=(), hashes={})


@pytest.mark.parametrize(
    ("lines", "share"),
    [
        (np.arange(20.0, 401.0), 1.0),
        # Each third line, lines between, a logarithmic axis, single lines missing.
        (np.arange(20.0, 401.0, 3.0), 1.0),
        (np.arange(20.25, 400.5, 0.5), 1.0),
        (np.geomspace(20.0, 400.0, 150), 1.0),
        (np.setdiff1d(np.arange(20.0, 401.0), [50.0, 51.0, 100.0, 101.0]), 1.0),
        # Notches about mains frequencies, finer steps about resonances.
        (np.setdiff1d(np.arange(20.0, 401.0), np.add.outer(np.arange(50.0, 401.0, 50.0), [-1.0, 0.0, 1.0])), 1.0),
        (np.union1d(np.arange(20.0, 401.0, 5.0), np.add.outer([55.0, 130.0, 310.0], np.arange(-4.0, 4.0, 0.25))), 1.0),
        # The file ends too early, or a part is missing.
        (np.arange(20.0, 211.0), 0.5),
        (np.concatenate([np.arange(20.0, 60.0), np.arange(350.0, 401.0)]), 0.24),
    ],
)
def test_how_much_of_the_lines_a_response_has(lines: np.ndarray, share: float) -> None:
    axis = np.arange(20.0, 401.0)
    whole, none = np.ones((axis.size, 2), dtype=complex), np.full((lines.size, 1), np.nan + 0j)
    own = measurement(lines, np.hstack([np.ones((lines.size, 1)), none]))
    found = shares(own, measurement(axis, whole), 0.02)
    assert found[0] == pytest.approx(share, abs=0.01)
    # A response that is missing altogether is told as such.
    assert np.isnan(found[1])


def test_a_bolt_that_is_stated_as_removed_and_comes_out_tight_is_no_all_clear(tight: Folder) -> None:
    tree = tight.tree()
    tree["jobs"]["again"]["removed"] = ["B3"]
    tight.write(tree)
    told = tight.run("update", "--fail-on-loose")
    assert told.code == 7
    assert "not validated: bolts are stated to be missing, but judged tight" in told.stdout


def test_a_sub_folder_of_measurements_of_any_kind_is_no_all_clear(tight: Folder) -> None:
    folder = Path(tight.path / "measured")
    (folder / "later").mkdir(parents=True)
    tight.write(tight.tree() | {"watch": {"folder": "measured", "pattern": "*.csv"}})
    assert tight.run("update", "--fail-on-loose").code == 0
    shutil.copy(tight.data / "frf" / "loose-2.csv", folder / "later" / "b5.unv")
    told = tight.run("update", "--fail-on-loose")
    assert told.code == 7
    assert "lies in a sub-folder" in told.stdout
