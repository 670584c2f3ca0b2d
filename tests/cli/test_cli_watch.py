"""Measurements that arrive while the campaign is watched, through the command as it is installed."""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import psutil
import pytest
from campaigns import Folder, command, environment, frame, lrbc, measure_again

from lrbc_cli.report.old import outdated
from lrbc_cli.watch.loop import Pace, Watch
from lrbc_cli.watch.session import Session, WatchSettings

LIMIT = 120.0

HOOK = """import json, os, sys
told = {name: os.environ[name] for name in ("LRBC_JOB", "LRBC_VERDICT", "LRBC_EXIT_CODE", "LRBC_SENTENCE", "LRBC_REPORT")}
with open(sys.argv[1], "a", encoding="utf-8") as file:
    print(json.dumps([sys.argv[2:], told]), file=file)
"""


@pytest.fixture(scope="module")
def begun(tmp_path_factory: pytest.TempPathFactory) -> Folder:
    """The frame with a folder instead of jobs; its tight state is judged, the other measurements wait."""
    folder = frame(tmp_path_factory.mktemp("watch") / "frame")
    (folder.data / "frf").rename(folder.path / "waiting")
    (folder.data / "frf").mkdir()
    tree = folder.tree()
    del tree["calibration"]
    del tree["jobs"]
    tree["watch"] = {"folder": "data/frf", "pattern": "*.csv"}
    folder.write(tree)

    shutil.copy(folder.path / "waiting" / "loose-2.csv", folder.data / "frf")
    early = folder.run("watch", "--once", "--fail-on-loose", "--interval", "0.1")
    assert early.code == 7
    assert "loose-2: waiting for tight" in early.stderr
    assert not (folder.out / "loose-2").exists()
    (folder.data / "frf" / "loose-2.csv").unlink()

    shutil.copy(folder.path / "waiting" / "tight.csv", folder.data / "frf")
    tight = folder.run("watch", "--once", "--fail-on-loose", "--interval", "0.1", "--json")
    # The tight state alone shows nothing.
    assert tight.code == 7
    assert tight.json == {"job": "tight", "verdict": "reference", "exit_code": 7, "sentence": "tight: the reference job, taken as tight"}
    assert (folder.out / "tight" / "profile.png").is_file()
    return folder


class Watching:
    """A watch that runs, and what it says."""

    def __init__(self, folder: Folder, *args: str) -> None:
        self.folder, self.out, self.err = folder, folder.path / "stdout", folder.path / "stderr"
        line = [*command(), "watch", str(folder.config), "--cache", str(folder.cache), "--interval", "0.2", *args]
        with self.out.open("w") as out, self.err.open("w") as err:
            new = {"creationflags": subprocess.CREATE_NEW_PROCESS_GROUP} if sys.platform == "win32" else {}
            self.process = subprocess.Popen(line, stdout=out, stderr=err, env=environment(), **new)

    def until(self, what: Callable[[], object]) -> None:
        end = time.monotonic() + LIMIT
        while not what():
            said = f"{self.out.read_text()}\n{self.err.read_text()}"
            assert self.process.poll() is None, said
            assert time.monotonic() < end, said
            time.sleep(0.05)

    def tells(self, text: str) -> None:
        self.until(lambda: text in self.out.read_text(encoding="utf-8"))

    def says(self, text: str) -> None:
        self.until(lambda: text in self.err.read_text(encoding="utf-8"))

    @property
    def live(self) -> bool:
        """Whether the page refreshes itself."""
        return "location.reload" in (self.folder.out / "report.html").read_text(encoding="utf-8")


@contextmanager
def watching(folder: Folder, *args: str) -> Iterator[Watching]:
    run = Watching(folder, *args)
    try:
        yield run
    finally:
        run.process.kill()
        run.process.wait()


NAMES = ("tight", "loose-2", "touch-x-after", "third", "moved")


def test_measurements_arrive(begun: Folder, tmp_path: Path) -> None:
    """Half copied, renamed, under a name that a shell would run; a second watcher; the end by Ctrl+C."""
    folder = begun.copy(tmp_path / "it's #1")
    frf, waiting, told = folder.data / "frf", folder.path / "waiting", tmp_path / "told"
    hook = tmp_path / "hook.py"
    hook.write_text(HOOK)
    measure_again(waiting / "loose-2.csv", waiting / "again.csv")
    with watching(folder, "--bell", "--hook", f'"{sys.executable}" "{hook}" "{told}"') as run:
        run.until(lambda: run.live)
        # What is finished is kept, and no news.
        assert run.out.read_text() == ""
        second = folder.run("watch", "--once")
        assert second.code == 2
        assert f"process {run.process.pid}" in second.stderr

        content = (waiting / "loose-2.csv").read_bytes()
        with (frf / "loose-2.csv").open("wb") as file:
            file.write(content[: len(content) // 2])
            file.flush()
            time.sleep(1.5)
            assert not (folder.out / "loose-2").exists()
            assert run.out.read_text() == ""
            file.write(content[len(content) // 2 :])
        run.tells("loose-2: B3, B4 loose")
        assert "loose-2" in (folder.out / "report.html").read_text(encoding="utf-8")

        shutil.copy(waiting / "again.csv", frf / "third.csv.part")
        shutil.copy(waiting / "again.csv", frf / "$(touch x); after.csv")
        # What was not judged could be loose: no name keeps a file from it.
        run.tells("touch-x-after: B3, B4 loose")
        assert not (folder.out / "third").exists()
        (frf / "third.csv.part").rename(frf / "third.csv")
        run.tells("third: B3, B4 loose")
        (frf / "loose-2.csv").rename(frf / "moved.csv")
        run.tells("moved: B3, B4 loose")
        # A copy is told as one, what was renamed is not.
        run.says("third: the same measurement as touch-x-after")
        assert "the measurement of loose-2" not in run.err.read_text()
        assert run.live
        assert run.err.read_text().count("\a") == 4
        if sys.platform != "win32":
            run.process.send_signal(signal.SIGINT)
            assert run.process.wait(LIMIT) == 130
            assert not run.live
            assert folder.leftovers() == []

    hooks = [json.loads(line) for line in told.read_text(encoding="utf-8").splitlines()]
    assert [arguments for arguments, _ in hooks] == [[name, "loose", "6"] for name in NAMES[1:]]
    sentences = run.out.read_text(encoding="utf-8").splitlines()
    page = str(folder.out / "report.html")
    for sentence, (arguments, told_of) in zip(sentences, hooks, strict=True):
        assert list(told_of.values()) == [*arguments, sentence, page]

    # The same jobs exist for every command, and nothing is left to do.
    plans = folder.run("update", "--dry-run", "--json").json["jobs"]
    assert {name: plan["run"] or plan["judge"] for name, plan in plans.items()} == dict.fromkeys(
        ("tight", "moved", "touch-x-after", "third"), False
    )


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="limits of another process")
def test_a_full_disk_loses_nothing(begun: Folder, tmp_path: Path) -> None:
    """No file may become larger than some bytes, until there is room again."""
    folder = begun.copy(tmp_path / "frame")
    with watching(folder) as run:
        run.until(lambda: run.live)
        process = psutil.Process(run.process.pid)
        free = process.rlimit(psutil.RLIMIT_FSIZE)
        page = (folder.out / "report.html").read_bytes()
        process.rlimit(psutil.RLIMIT_FSIZE, (30_000, free[1]))
        shutil.copy(folder.path / "waiting" / "loose-2.csv", folder.data / "frf")
        run.says("loose-2: the disk is full; make room on the disk of ")
        assert run.out.read_text() == ""
        told = "loose-2 is measured but not judged, the disk is full: make room on the disk of "
        run.until(lambda: told in outdated(folder.out / "report.html"))
        # Whole, and of the same size.
        assert len((folder.out / "report.html").read_bytes()) == len(page)
        assert (folder.out / "report.html").read_bytes().endswith(page[-100_000:])
        assert told in folder.run("status", "--json").json["report"]["trouble"]
        assert folder.result("tight")["status"] == "converged"
        process.rlimit(psutil.RLIMIT_FSIZE, free)
        run.tells("loose-2: B3, B4 loose")
        run.until(lambda: b"loose-2: " in (folder.out / "report.html").read_bytes() and not outdated(folder.out / "report.html"))


@pytest.mark.slow
def test_what_cannot_be_used_is_on_the_page_until_it_is_fixed(begun: Folder, tmp_path: Path) -> None:
    folder = begun.copy(tmp_path / "frame")
    frf, waiting, said = folder.data / "frf", folder.path / "waiting", list[str]()
    watch = Watch(
        session=Session(WatchSettings(config=folder.config, overrides=(), cache=folder.cache)),
        tell=lambda verdict: None,
        say=said.append,
        pace=Pace(settle=0.05),
    )

    def page() -> str:
        watch.run(once=True)
        return (folder.out / "report.html").read_text(encoding="utf-8").partition("</header>")[0]

    def status() -> dict[str, object]:
        found = folder.run("status", "--json").json
        return {name: (job["state"], job["reason"]) for name, job in found["jobs"].items()} | {"beside": found["passed_over"]}

    assert "Files that were not judged" not in page()
    half = (waiting / "loose-2.csv").read_bytes()[:19]
    for name in ("loose-2.csv", "third.csv"):
        (frf / name).write_bytes(half)
    (frf / "other.dat").write_text("measured by somebody else\n")
    head = page()
    assert watch.failed == {"loose-2", "third"}
    for text in ("loose-2: no verdict: its files cannot be used", "matches no pattern of watch.pattern", "No verdict in 2 tested jobs."):
        assert text in head
    assert re.search(r"<li>third: [^<]*third.csv[^<]*</li>", head)
    assert str(folder.config.parent) not in head
    found = status()
    assert found["third"][0] == found["loose-2"][0] == "unusable"
    assert "third.csv" in found["third"][1]
    assert "other.dat" in found["beside"][0]
    assert "other.dat" in folder.run("status").stdout
    # One is fixed, one taken away, and so is the other file.
    shutil.copy(waiting / "loose-2.csv", frf)
    (frf / "third.csv").unlink()
    (frf / "other.dat").unlink()
    head = page()
    assert "Files that were not judged" not in head
    assert "cannot be used" not in head
    assert watch.failed == set()
    # Damaged anew: its result is that of an earlier measurement.
    (frf / "loose-2.csv").write_bytes(half)
    head = page()
    assert "(result of an earlier measurement; the present files cannot be used)" in head
    assert "with files that cannot be used: 1" in head
    assert "earlier measurement" in status()["loose-2"][1]
    # As it was: nothing is identified anew, and the page knows.
    shutil.copy(waiting / "loose-2.csv", frf)
    assert "cannot be used" not in page()


@pytest.mark.slow
def test_files_that_stay_unusable_are_told(begun: Folder, tmp_path: Path) -> None:
    """They leave no failure behind, and those that can be used are judged; a campaign's job takes the file of its name."""
    folder = begun.copy(tmp_path / "frame")
    waiting, new = folder.path / "waiting", tmp_path / "elsewhere"
    new.mkdir()
    for name in ("tight", "loose-all"):
        shutil.copy(waiting / f"{name}.csv", new)
    (new / "half.csv").write_bytes((waiting / "tight.csv").read_bytes()[:19])
    tree = folder.tree()
    del tree["watch"]
    tree["jobs"] = {name: {"frf": f"nowhere/{name}.csv", "removed": removed} for name, removed in (("tight", []), ("loose-all", ["B1"]))}
    folder.write(tree)
    (new / "second.dat").write_text("measured by somebody else\n")
    found = folder.run("watch", "--once", "--interval", "0.1", "--folder", new, "--pattern", "*.CSV", "--pattern", "*.uff")
    assert found.stderr.count("second.dat") == 1
    assert "add '*.dat' there" in found.stderr
    assert found.code == 5
    assert "half: no verdict; measure again or fix the file" in found.stdout
    assert "loose-all: B1 to B6 loose" in found.stdout
    assert folder.result("loose-all")["removed"] == ["B1"]
    assert not (folder.out / "half").exists()
    assert "other commands do not know this folder; enter it in the campaign file" in found.stderr


@pytest.mark.slow
def test_a_folder_out_of_reach_is_no_all_clear(begun: Folder, tmp_path: Path) -> None:
    folder = begun.copy(tmp_path / "new")
    measure_again(folder.path / "waiting" / "tight.csv", folder.data / "frf" / "again.csv")
    assert folder.run("watch", "--once", "--fail-on-loose").code == 0
    tree = folder.tree()
    tree["jobs"] = {name: {"frf": f"kept/{name}.csv"} for name in ("tight", "again")}
    folder.write(tree)
    (folder.data / "frf").rename(folder.path / "kept")
    assert folder.run("watch", "--once", "--fail-on-loose").code == 7


@pytest.mark.slow
def test_a_result_that_no_page_shows_is_told(begun: Folder, tmp_path: Path) -> None:
    """As one that was found by a watch that was killed before it said so."""
    folder = begun.copy(tmp_path / "killed")
    shutil.copy(folder.path / "waiting" / "loose-2.csv", folder.data / "frf")
    assert folder.run("watch", "--once").stdout.startswith("loose-2: B3, B4 loose")
    assert folder.run("watch", "--once").stdout == ""
    before = (folder.out / "loose-2" / "result.json").stat().st_mtime - 0.5
    os.utime(folder.out / "report.html", (before, before))
    again = folder.run("watch", "--once", "--json")
    assert again.json["job"] == "loose-2"
    assert again.json["exit_code"] == 6
    assert folder.run("watch", "--once").stdout == ""


@pytest.mark.slow
def test_a_result_that_cannot_be_read_is_told(begun: Folder, tmp_path: Path) -> None:
    """The page shows the other jobs."""
    folder = begun.copy(tmp_path / "damaged")
    tree = folder.tree()
    tree["jobs"] = {"gone": {"frf": "data/frf/gone.csv"}}
    folder.write(tree)
    (folder.out / "gone").mkdir()
    (folder.out / "gone" / "result.json").write_text("{}")
    assert folder.run("watch", "--once").stderr.count("job gone is not shown") == 1
    assert "gone: no verdict: its result cannot be read" in (folder.out / "report.html").read_text(encoding="utf-8")


def test_wrong_calls(begun: Folder) -> None:
    assert "needs --once" in begun.run("watch", "--fail-on-loose").stderr
    none = begun.run("watch", "--hook", "no-such-program-anywhere --flag")
    assert none.code == 2
    assert "--hook" in none.stderr
    pattern = begun.run("watch", "--once", "--pattern", "frf/*.uff")
    assert pattern.code == 2
    assert "watch.pattern" in pattern.stderr
    among = begun.run("watch", "--once", "--folder", begun.out)
    assert among.code == 2
    assert "measurements would arrive among the results" in among.stderr
    assert "choose another `output`" in among.stderr


def test_the_help_says_that_documents_come_a_line_each() -> None:
    assert "each verdict is one JSON document on a line of its own" in " ".join(lrbc("watch", "--help").stdout.split())


@pytest.mark.slow
def test_a_folder_that_is_not_there_is_told(tmp_path: Path) -> None:
    """A path with a slip was watched without a word."""
    folder = frame(tmp_path)
    tree = folder.tree()
    folder.write(tree | {"jobs": {"tight": tree["jobs"]["tight"]}})
    nowhere = tmp_path / "nowhere"
    told = folder.run("watch", "--once", "--interval", "0.1", "--folder", nowhere).stderr
    assert f"the watched folder {nowhere} cannot be read: check the path" in told
