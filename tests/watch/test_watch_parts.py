"""What a watch is made of: files that settle, the jobs of a folder, one watcher a campaign, words and codes of a verdict."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from lrbc_cli.campaign.beside import passed_over, unseen
from lrbc_cli.config import JobConfig, load_campaign
from lrbc_cli.errors import ConfigError, DataError
from lrbc_cli.io.common import require_file
from lrbc_cli.watch.arrivals import Arrivals
from lrbc_cli.watch.lock import AT_WORK, GONE, NAME, Lock, at_work
from lrbc_cli.watch.loop import Wake
from lrbc_cli.watch.pulse import Pulse
from lrbc_cli.watch.verdict import Hook, unusable

FULL = Path("/dev/full")
CAMPAIGN = Path(__file__).parents[2] / "configs" / "frame.yaml"


def folder_of(path: Path, *names: str) -> str:
    """An override that watches a folder with these files."""
    path.mkdir(exist_ok=True)
    for name in names:
        (path / name).write_text("x")
    return f"watch.folder={json.dumps(str(path))}"


def test_a_job_is_ready_when_its_files_stay_as_they_are(tmp_path: Path) -> None:
    frf, coherence = tmp_path / "a.uff", tmp_path / "a-coherence.uff"
    files = {"a": [frf, coherence]}
    arrivals = Arrivals(settle=1.0)
    assert arrivals.look(files, 0.0) == []
    frf.write_bytes(b"12")
    assert arrivals.look(files, 5.0) == []
    assert not arrivals.there("a")
    coherence.write_bytes(b"1")
    assert arrivals.look(files, 6.0) == []
    assert arrivals.next == 7.0
    frf.write_bytes(b"123")
    assert arrivals.look(files, 6.9) == []
    assert arrivals.look(files, 7.8) == []
    assert arrivals.look(files, 7.9) == ["a"]
    arrivals.done("a")
    assert arrivals.look(files, 99.0) == []
    assert arrivals.next is None
    # The same size, another time: measured again.
    os.utime(coherence, (1.0, 1.0))
    assert arrivals.look(files, 100.0) == []
    assert arrivals.look(files, 101.0) == ["a"]
    assert arrivals.later("a", 101.0, 20.0)
    assert not arrivals.later("a", 101.0, 20.0)
    assert arrivals.look(files, 120.9) == []
    assert arrivals.look(files, 121.0) == ["a"]
    arrivals.done("a")
    # What was renamed is no measurement of this job any more; what comes back is one again.
    moved = frf.rename(tmp_path / "b.uff")
    assert arrivals.look(files, 122.0) == []
    assert not arrivals.there("a")
    moved.rename(frf)
    arrivals.look(files, 123.0)
    assert arrivals.look(files, 124.0) == ["a"]
    assert arrivals.look({}, 125.0) == []
    assert arrivals.next is None


def test_those_that_wait_longest_come_first(tmp_path: Path) -> None:
    arrivals = Arrivals(settle=1.0)
    files = {}
    for i, name in enumerate("cab"):
        files[name] = [tmp_path / name]
        (tmp_path / name).write_bytes(b"1")
        arrivals.look(files, float(i))
    assert arrivals.look(files, 10.0) == ["c", "a", "b"]


def test_files_of_a_folder_are_jobs(tmp_path: Path) -> None:
    names = (
        "new-1.csv",
        "New-2.CSV",
        ".hidden.csv",
        "~open.csv",
        "new-3.csv.part",
        "two words.csv",
        "calibration.csv",
        "loose-2.csv",
        "con.csv",
    )
    watch = folder_of(tmp_path / "frf", *names, "new-1.txt")
    campaign = load_campaign(CAMPAIGN, [watch, "watch.pattern=['*.csv', '*.txt']"])
    # The sample has a file for `loose-2`; where it is missing, this one is it.
    assert list(campaign.jobs) == [
        *("tight", "loose-2", "loose-all"),
        *("New-2", "calibration-csv", "con-csv", "loose-2-csv", "new-1", "new-1-txt", "two-words"),
    ]
    assert campaign.jobs["new-1"] == JobConfig.model_validate({"frf": str(tmp_path / "frf" / "new-1.csv")})
    missing = load_campaign(CAMPAIGN, [watch, "jobs.loose-2.frf=nowhere.csv"])
    assert missing.jobs["loose-2"].frf == tmp_path / "frf" / "loose-2.csv"
    assert missing.jobs["loose-2"].removed == ("B3", "B4")
    assert load_campaign(CAMPAIGN, [f"watch.folder={json.dumps(str(tmp_path / 'nowhere'))}"]).jobs == load_campaign(CAMPAIGN).jobs


def test_measurements_that_nobody_sees(tmp_path: Path) -> None:
    """Those in sub-folders, and those named like temporary files; locks of editors, results and inputs are none."""
    folder = tmp_path / "frf"
    watch = folder_of(folder, "~measured.csv", "~$open.csv", ".~lock.a.csv#", "~WRL0001.tmp", "other.uff")
    for name in ("later", "later/deep", "model", "notes", "output", ".trash"):
        folder_of(folder / name)
    for name in ("later/deep/b.csv", "later/deep/c.csv", "model/bolts.csv", "notes/read.me", "output/frf.csv", ".trash/a.csv"):
        (folder / name).write_text("x")
    own = [f"output={json.dumps(str(folder / 'output'))}", f"bolts={json.dumps(str(folder / 'model' / 'bolts.csv'))}"]
    campaign = load_campaign(CAMPAIGN, [watch, "watch.pattern='*.csv'", *own])
    assert list(campaign.jobs) == ["tight", "loose-2", "loose-all"]
    told = passed_over(campaign)
    named = [str(Path("later", "deep", "b.csv")), "other.uff", "~measured.csv"]
    assert [text.partition(" in ")[0] for text in told] == named
    assert unseen(campaign) == "; ".join(told)
    assert passed_over(load_campaign(CAMPAIGN)) == []


@pytest.mark.skipif(sys.platform != "linux", reason="links need no rights there")
def test_a_link_and_its_target_are_one_measurement(tmp_path: Path) -> None:
    folder = tmp_path / "frf"
    watch = folder_of(folder)
    (folder / "raw").mkdir()
    (folder / "raw" / "third.csv").write_text("x")
    (folder / "third.csv").symlink_to(folder / "raw" / "third.csv")
    campaign = load_campaign(CAMPAIGN, [watch, "watch.pattern='*.csv'"])
    assert list(campaign.jobs) == ["tight", "loose-2", "loose-all", "third"]
    assert passed_over(campaign) == []
    (folder / "raw" / "fourth.csv").write_text("x")
    assert [text.partition(" in ")[0] for text in passed_over(campaign)] == [str(Path("raw", "fourth.csv"))]


@pytest.mark.skipif(sys.platform != "linux", reason="names of files are text there")
def test_names_that_are_no_text_and_links_to_themselves(tmp_path: Path) -> None:
    """Each ended every command with an internal error."""
    folder = tmp_path / "frf"
    watch = folder_of(folder)
    (folder / os.fsdecode(b"t\xfcr.csv")).write_text("x")
    (folder / "loop.csv").symlink_to("loop.csv")
    campaign = load_campaign(CAMPAIGN, [watch, "watch.pattern='*.csv'"])
    assert list(campaign.jobs) == ["tight", "loose-2", "loose-all", "loop"]
    assert passed_over(campaign) == [f"t?r.csv in {folder} is not judged: its name is not UTF-8. Rename it"]
    with pytest.raises(ConfigError, match="not UTF-8"):
        load_campaign(tmp_path / os.fsdecode(b"t\xfcr") / "campaign.yaml")
    with pytest.raises(DataError) as raised:
        require_file(folder / "loop.csv")
    assert "did you mean" not in raised.value.message


def test_settings_of_the_reference_job_hold_for_new_files(tmp_path: Path) -> None:
    own = ["jobs.tight.scale={acc1: 2.0}", "jobs.tight.averages=9", "jobs.tight.format={decimal: ','}", "jobs.tight.removed=[B1]"]
    watch = folder_of(tmp_path / "frf", "new.csv")
    new = load_campaign(CAMPAIGN, [watch, *own]).jobs["new"]
    assert (new.scale, new.averages, new.removed) == ({"acc1": 2.0}, 9, ())
    assert new.format is not None
    assert new.format.decimal == ","
    alone = ["jobs.tight.frf={file: ../data_samples/frame/frf/tight.csv, format: {unit: g/N}}"]
    layout = load_campaign(CAMPAIGN, [watch, *own, *alone]).jobs["new"].format
    assert layout is not None
    assert (layout.decimal, layout.unit) == (",", "g/N")
    other = load_campaign(CAMPAIGN, [watch, *own, "watch.like=loose-2"]).jobs["new"]
    assert (other.scale, other.averages, other.format) == ({}, 5, None)
    with pytest.raises(ConfigError, match=r"watch\.like"):
        load_campaign(CAMPAIGN, [watch, "watch.like=nobody"])


def test_tight_states_may_come_later(tmp_path: Path) -> None:
    watch = folder_of(tmp_path / "frf")
    campaign = load_campaign(CAMPAIGN, [watch, "watch.pattern='*.uff'", "jobs={}"])
    assert {name: job.frf for name, job in campaign.jobs.items()} == {"tight": tmp_path / "frf" / "tight.uff"}


def test_one_watcher_a_campaign(tmp_path: Path) -> None:
    first, second = Lock(tmp_path / "out"), Lock(tmp_path / "out")
    first.take()
    with pytest.raises(ConfigError, match=f"process {os.getpid()}"):
        second.take()
    second.release()
    first.beat()
    first.release()
    assert list((tmp_path / "out").iterdir()) == []
    # Of a process that has gone.
    gone = subprocess.Popen([sys.executable, "-c", ""])
    gone.wait()
    path = tmp_path / "out" / NAME
    second.take()
    path.write_text(json.dumps(json.loads(path.read_text()) | {"pid": gone.pid}))
    first.take()
    with pytest.raises(ConfigError, match="took over"):
        second.beat()
    # On another machine, by its signs of life.
    path.write_text(json.dumps({"token": "?", "pid": 1, "host": "another"}))
    with pytest.raises(ConfigError, match="one on another"):
        second.take()
    long_ago = time.time() - 2 * GONE
    os.utime(path, (long_ago, long_ago))
    second.take()
    second.release()


def test_a_lock_of_a_process_whose_number_is_used_again_blocks_nobody(tmp_path: Path) -> None:
    """In a container every watcher has the same number: after a kill its successor was refused by itself."""
    lock, path = Lock(tmp_path / "out"), tmp_path / "out" / NAME
    lock.take()
    owner = json.loads(path.read_text())
    for other in ({"started": owner["started"] - 1000.0}, {"started": owner["started"] + 1000.0}, {"started": None}):
        path.write_text(json.dumps(owner | other | {"token": "?"}))
        Lock(tmp_path / "out").take()
    path.write_text(json.dumps(owner | {"token": "?"}))
    with pytest.raises(ConfigError, match="already watches"):
        Lock(tmp_path / "out").take()
    # Of another machine, with a clock that is a day ahead.
    path.write_text(json.dumps(owner | {"token": "?", "host": "another"}))
    ahead = time.time() + 86400.0
    os.utime(path, (ahead, ahead))
    Lock(tmp_path / "out").take()


@pytest.mark.skipif(not FULL.exists(), reason="no device that is always full")
def test_a_lock_that_was_not_written_whole_blocks_nobody(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    lock = Lock(tmp_path / "out")
    lock.path.parent.mkdir()
    # One that begins at this moment has not said yet who it is.
    lock.path.write_text("")
    with pytest.raises(ConfigError, match="already watches"):
        lock.take()
    long_ago = time.time() - 60.0
    os.utime(lock.path, (long_ago, long_ago))
    lock.take()
    lock.release()

    real = Path.open

    def full(self: Path, *args: Any, **options: Any) -> Any:
        real(self, *args, **options).close()
        return real(FULL, "w")

    with monkeypatch.context() as patch:
        patch.setattr(Path, "open", full)
        with pytest.raises(ConfigError, match="make room on this disk"):
            lock.take()
    assert list(lock.path.parent.iterdir()) == []
    lock.take()
    lock.release()


def test_events_wake(tmp_path: Path) -> None:
    wake = Wake()
    wake.watch([tmp_path, tmp_path / "not there yet"])
    try:
        for _ in range(100):
            # The first may come before anyone listens.
            (tmp_path / "new.csv").write_text("x")
            start = time.monotonic()
            wake.wait(1.0)
            if time.monotonic() - start < 0.9:
                return
        pytest.fail("no event woke it")
    finally:
        wake.stop()


def test_open_pages_see_that_the_watcher_lives(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The sign changes all the time, also without a page, and is taken away at the end."""
    monkeypatch.setattr("lrbc_cli.watch.pulse.EVERY", 0.01)
    pulse = Pulse(tmp_path)
    pulse.start()
    seen: set[str] = set()
    until = time.monotonic() + 10.0
    while len(seen) < 3 and time.monotonic() < until:
        if pulse.path.is_file():
            seen.add(pulse.path.read_text(encoding="utf-8"))
    pulse.stop()
    assert len(seen) >= 3
    assert 'width="1"' in max(seen)
    assert not pulse.path.exists()


def test_the_hook_is_told_the_sentence_on_one_line(tmp_path: Path) -> None:
    """Also that of a file which cannot be used, whose message has several lines on the terminal."""
    verdict = unusable("third", DataError("no table of numbers was found", file="third.csv", expected="lines", hint="describe the layout"))
    assert len(verdict.sentence.splitlines()) == 3
    script, told = tmp_path / "hook.py", tmp_path / "told"
    script.write_text("import os, sys\nopen(sys.argv[1], 'w').write(os.environ['LRBC_SENTENCE'])\n")
    assert Hook(f'"{sys.executable}" "{script}" "{told}"').run(verdict, tmp_path / "report.html") is None
    words = "third: no verdict; measure again or fix the file: third.csv: no table of numbers was found"
    assert told.read_text() == f"{words}; expected: lines; fix: describe the layout"


def test_two_processes_at_work_on_one_campaign(tmp_path: Path) -> None:
    """Each result is written whole, but half of the work is for nothing."""
    told = list[str]()
    other = Lock(tmp_path / "out", AT_WORK)
    other.take()
    with at_work(tmp_path / "out", told.append):
        assert (tmp_path / "out" / AT_WORK).is_file()
    assert len(told) == 1
    assert f"another lrbc (process {os.getpid()}) is at work on these results" in told[0]
    # It is the other one's still.
    assert (tmp_path / "out" / AT_WORK).is_file()
    other.release()
    with at_work(tmp_path / "out", told.append):
        pass
    assert len(told) == 1
    assert not (tmp_path / "out" / AT_WORK).exists()
    watcher = Lock(tmp_path / "out")
    watcher.take()
    with at_work(tmp_path / "out", told.append):
        pass
    assert told[1].startswith(f"lrbc watch (process {os.getpid()}) is at work on these results")
    watcher.release()
