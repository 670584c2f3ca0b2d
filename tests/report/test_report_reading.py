import errno
import hashlib
import json
import re
from pathlib import Path

import numpy as np
import pytest
from fake_campaign import campaign_of, reduction_of, reseal

from lrbc_cli.errors import DataError
from lrbc_cli.report.old import outdate, outdated
from lrbc_cli.report.reading import read_results
from lrbc_cli.report.sections.top import NO_RESULT, UNREADABLE
from lrbc_cli.report.summary import summary_text
from lrbc_cli.report.write import missing_jobs, write_report
from lrbc_cli.results.job import FailedJob
from lrbc_cli.results.store import read_job
from lrbc_cli.results.tables import read_frf


def spoil(file: Path, *keys: str | int, value: object) -> None:
    document = json.loads(file.read_text(encoding="utf-8"))
    place = document
    for key in keys[:-1]:
        place = place[key]
    if value is KeyError:
        del place[keys[-1]]
    else:
        place[keys[-1]] = value
    file.write_text(json.dumps(document), encoding="utf-8") if keys == ("digest",) else reseal(file, document)


def test_everything_is_read(finished):
    campaign = campaign_of(finished)
    assert campaign.campaign == "soundbox-left-edge"
    assert campaign.jobs == ("bolts-00", "bolts-04", "bolts-15", "bolts-20")
    assert campaign.response("mic01").used
    assert not campaign.response("unheard-of").used
    job = read_job(finished, "bolts-04")
    assert job.removed == ("B08", "B09", "B10", "B11")
    assert job.names("loose") == ["B08", "B09", "B10", "B11"]
    edge = job.parameters["left_edge"]
    assert len(edge.log10_effective) == 31
    assert edge.damping_factor == pytest.approx(10**edge.damping_exponent)
    frf = read_frf(finished / "bolts-04" / "frf.csv")
    assert list(frf.responses) == ["mic01", "mic02"]
    assert frf.frequency_hz[[0, -1]] == pytest.approx([20, 400])
    assert set(frf.responses["mic02"]) == {
        "measured_db", "measured_phase_deg", "initial_db", "initial_phase_deg", "updated_db", "updated_phase_deg", "coherence",
    }  # fmt: skip
    reduction = reduction_of(finished)
    assert reduction.trace[0].measured_error is None
    assert reduction.seconds["full_line"] == 0.61
    failed = read_job(finished, "bolts-20")
    assert isinstance(failed, FailedJob)
    assert "mic03" in failed.reason


def test_missing_reduction_is_no_error(output):
    (output / "reduction.json").unlink()
    assert reduction_of(output) is None


@pytest.mark.parametrize(
    ("keys", "value", "expected"),
    [
        (("status",), "finished", "converged, stopped or unexplained"),
        (("status",), KeyError, "a value"),
        (("format",), "other", "lrbc-result"),
        (("job",), "../bolts-00", "bolts-04"),
        (("version",), 2, "1"),
        (("cost",), KeyError, "a value"),
        (("cost", "final"), "low", "a number"),
        (("cost", "final"), True, "a number"),
        (("removed",), "B08", "a list"),
        (("parameters", "left_edge", "log10"), [1.0, [2.0]], "number"),
        (("parameters", "left_edge", "initial"), [4.0], "31 values"),
        (("parameters", "left_edge", "positions"), [[0, 0]] * 31, "3 values"),
        (("bolts",), {}, "a list"),
        (("bolts", 3, "verdict"), "gone", "tight, loose, undecided or outside"),
        (("bolts", 3, "position"), [0.0], "3 values"),
        (("misfit_db", "responses", "mic01"), 3.0, "an object"),
        (("history", 0, "cost"), "x", "a number"),
    ],
)
def test_a_wrong_value_is_named(output, keys, value, expected):
    file = output / "bolts-04" / "result.json"
    spoil(file, *keys, value=value)
    with pytest.raises(DataError) as caught:
        read_job(output, "bolts-04")
    assert caught.value.file == str(file)
    assert expected in str(caught.value.expected)
    assert str(keys[-1]) in caught.value.place
    assert "lrbc update" in caught.value.hint


def test_null_is_not_a_number(output):
    file = output / "bolts-04" / "result.json"
    spoil(file, "parameters", "left_edge", "log10_effective", value=[None] * 31)
    assert np.isnan(read_job(output, "bolts-04").parameters["left_edge"].log10_effective).all()


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b'{"format": "lrbc-result", ', "line 1"),
        (b"[]", "lrbc-result"),
        (b"\xff\xfe\x00", "UTF-8"),
        (b"[" * 100_000, "nested"),
        (b"", "not JSON"),
        (b'{"format": "lrbc-result", "iterations": ' + b"1" * 400 + b"}", "400 digits"),
        (b'{"format": "lrbc-result", "iterations": ' + b"1" * 5000 + b"}", "5000 digits"),
        (b'{"format": "lrbc-result", "iterations": 1e999}', "beyond the range"),
        (b"[" * 200_000 + b"]" * 200_000, "nested"),
        (b'{"deep": ' + b"[" * 900 + b"]" * 900 + b"}", "nested"),
    ],
)
def test_a_damaged_document_is_named(output, content, words):
    file = output / "bolts-04" / "result.json"
    file.write_bytes(content)
    found = read_results(output)
    assert [job.job for job in found.jobs] == ["bolts-00"]
    error = found.unreadable["bolts-04"]
    assert re.search(words, error.message)
    assert error.file == str(file)
    # Nothing else is to be shown.
    with pytest.raises(DataError, match=words):
        write_report(output, jobs=["bolts-04"])
    assert not (output / "report.html").exists()


def test_no_results_at_all(tmp_path):
    with pytest.raises(DataError, match="lrbc update"):
        write_report(tmp_path)


@pytest.mark.parametrize("name", ["..", "../bolts-00", "a/b", "a\\b", "", "C:x"])
def test_job_names_stay_inside_the_output(output, name):
    spoil(output / "campaign.json", "jobs", value=[name])
    with pytest.raises(DataError, match="names that folders may have"):
        campaign_of(output)


@pytest.mark.parametrize(
    ("text", "place"),
    [
        ("frequency_hz,mic01_measured_db\n20,1\n21\n", "line 3"),
        ("frequency_hz,mic01_measured_db\n20,loud\n", "line 2"),
        ("frequency_hz,frequency_hz\n20,1\n", "line 1"),
        ("", None),
        ("frequency_hz,mic01_measured_db\n", None),
        ("f,mic01_measured_db\n20,1\n", None),
    ],
)
def test_a_damaged_table_is_named(output, text, place):
    file = output / "bolts-04" / "frf.csv"
    file.write_text(text, encoding="utf-8")
    with pytest.raises(DataError, match="damaged") as caught:
        read_frf(output / "bolts-04" / "frf.csv")
    assert caught.value.file == str(file)
    if place:
        assert caught.value.place == place


def hashed(output, job):
    files = {name: hashlib.sha256((output / job / name).read_bytes()).hexdigest() for name in ("frf.csv",)}
    file = output / job / "result.json"
    spoil(file, "provenance", "files", value=files)


def test_a_page_that_cannot_be_written_anew_says_that_it_is_old(output, monkeypatch):
    page = write_report(output, workers=1, draw=False)
    before, content = page.stat(), page.read_bytes()
    assert outdated(page) == ""

    def full(*args, **options):
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr("lrbc_cli.report.files.atomic_write", full)
        with pytest.raises(DataError, match="No space left") as caught:
            write_report(output, workers=1, draw=False)
    assert caught.value.hint.startswith("make room on this disk, then run the command again")
    now = page.stat()
    assert (now.st_size, now.st_mtime_ns, now.st_ino) == (before.st_size, before.st_mtime_ns, before.st_ino)
    assert "This page is out of date (" in outdated(page)
    assert "No space left on device; make room on this disk" in outdated(page)
    # Whatever is said fits, whole characters of it.
    outdate(page, "<&>€" * 500)
    assert outdated(page).endswith("…")
    assert page.stat().st_size == before.st_size
    start = content.index(b'<p id="old"')
    assert page.read_bytes()[:start] == content[:start]
    assert page.read_bytes().partition(b"</p>")[2] == content.partition(b"</p>")[2]
    write_report(output, workers=1, draw=False)
    assert outdated(page) == ""
    # Pages of earlier versions have no room for it.
    page.write_text("<p>an earlier version</p>")
    outdate(page, "why")
    outdate(output / "none.html", "why")
    assert page.read_text() == "<p>an earlier version</p>"
    assert outdated(output / "none.html") == ""


def test_a_guessed_reference_job_is_said_at_the_top(output):
    text = "Reference job not confirmed: `lrbc init --from` guessed bolts-00 from names"
    assert text not in write_report(output, workers=1, draw=False).read_text(encoding="utf-8")
    spoil(output / "campaign.json", "reference_guessed", value=True)
    assert text in write_report(output, workers=1, draw=False).read_text(encoding="utf-8").partition("</header>")[0]


def test_tables_of_another_run_are_not_shown(output, caplog):
    for job in ("bolts-00", "bolts-04"):
        hashed(output, job)
    write_report(output, workers=1)
    assert not caplog.records
    file = output / "bolts-04" / "frf.csv"
    file.write_bytes((output / "bolts-00" / "frf.csv").read_bytes())
    error = read_results(output).unreadable["bolts-04"]
    assert "not written with the result" in error.problem
    assert error.file == str(file)
    assert error.hint is not None
    assert "lrbc update" in error.hint
    page = write_report(output, workers=1).read_text(encoding="utf-8")
    head, rest = page.split("</header>")
    assert f"<li>bolts-04: {UNREADABLE}</li>" in head
    assert "No loose bolt found in 1 of 2 tested jobs. Jobs without result: 1" in head
    assert "bolts-04: bolts-04/frf.csv: this file was not written with the result.json beside it" in head
    assert "bolts-04" not in rest
    assert "bolts-04" not in summary_text(output)
    assert missing_jobs(output, None, ["bolts-04"]) == []
    # Not part of what is asked for.
    assert UNREADABLE not in write_report(output, jobs=["bolts-00"], workers=1).read_text(encoding="utf-8")
    file.unlink()
    assert "missing" in read_results(output).unreadable["bolts-04"].problem


@pytest.mark.parametrize("name", ["campaign.json", "reduction.json"])
def test_sealed_records_that_were_edited_are_refused(output, name):
    # Another layout is no edit.
    file = output / name
    file.write_text(json.dumps(json.loads(file.read_text(encoding="utf-8")), indent=4), encoding="utf-8")
    write_report(output, workers=1, draw=False)
    digest = json.loads(file.read_text(encoding="utf-8"))["digest"]
    spoil(file, "reference_guessed" if name == "campaign.json" else "full_size", value=True if name == "campaign.json" else 7)
    for wrong in (digest, KeyError):
        spoil(file, "digest", value=wrong)
        with pytest.raises(DataError, match="changed after it was written") as caught:
            write_report(output, workers=1, draw=False)
    assert caught.value.file == str(file)
    assert "lrbc " in caught.value.hint


@pytest.mark.parametrize("name", ["../bolts-00/frf.csv", "..", ""])
def test_hashes_are_of_files_in_the_folder(output, name):
    spoil(output / "bolts-04" / "result.json", "provenance", "files", value={name: "0"})
    assert "damaged" in read_results(output).unreadable["bolts-04"].problem


def test_empty_cells_are_absent_values(output):
    (output / "bolts-04" / "frf.csv").write_text("frequency_hz,mic_1_measured_db,mic_1_updated_db\n20,1,\n21,,2\n", encoding="utf-8")
    columns = read_frf(output / "bolts-04" / "frf.csv").responses["mic_1"]
    np.testing.assert_equal(columns["measured_db"], [1, np.nan])
    np.testing.assert_equal(columns["updated_db"], [np.nan, 2])


def test_jobs_of_the_campaign_without_a_result_are_counted_and_named(output: Path) -> None:
    """Neither a result that is gone nor an older record of the campaign makes the others look like all."""
    whole = write_report(output, draw=False).read_text()
    assert "bolts-04" in whole
    assert NO_RESULT not in whole
    page = write_report(output, expected=["bolts-00", "bolts-04", "bolts-09"], draw=False).read_text()
    assert f"<li>bolts-09: {NO_RESULT}</li>" in page
    assert "in 1 of 3 tested jobs" in page
    assert "Jobs without result: 1" in page
    (output / "bolts-04" / "result.json").unlink()
    page = write_report(output, draw=False).read_text()
    assert f"<li>bolts-04: {NO_RESULT}</li>" in page
    assert "No loose bolt found in 1 of 2 tested jobs. Jobs without result: 1" in page
    assert missing_jobs(output, None, ["bolts-09"]) == ["bolts-04", "bolts-09"]
    assert missing_jobs(output, ["bolts-00"], ["bolts-09"]) == []
