"""Jobs on the workers of a Dask scheduler: the same results, no file needed there, and nothing lost where they are."""

from __future__ import annotations

import os
import pickle
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest
from campaigns import Folder
from distributed import LocalCluster

import lrbc_cli as lrbc
from lrbc_cli.campaign.jobs import remote
from lrbc_cli.campaign.jobs.remote import Cluster, cluster
from lrbc_cli.errors import ConfigError

pytestmark = pytest.mark.filterwarnings("default")


def started(workers: int) -> LocalCluster:
    return LocalCluster(n_workers=workers, threads_per_worker=1, processes=True, host="127.0.0.1", dashboard_address=":0")


@pytest.fixture(scope="module")
def address() -> Iterator[str]:
    with started(1) as found:
        yield found.scheduler_address


@pytest.fixture(scope="module")
def workers(address: str) -> Iterator[Cluster]:
    with cluster(address) as found:
        yield found


@contextmanager
def frozen(process: int) -> Iterator[None]:
    """A process that runs but does nothing, as on a machine that swaps or behind a broken line."""
    os.kill(process, signal.SIGSTOP)
    try:
        yield
    finally:
        os.kill(process, signal.SIGCONT)


def numbers(folder: Folder, job: str) -> Any:
    tree = folder.result(job)
    return {key: tree[key] for key in ("parameters", "bolts", "cost", "misfit_db", "evaluations")}


def test_the_same_results(frame: Folder, address: str) -> None:
    before = {job: numbers(frame, job) for job in ("tight", "loose-2")}
    outcome = frame.run("update", "--force", "--job", "tight", "--job", "loose-2", "--scheduler", address)
    assert outcome.code == 0, outcome.stderr
    assert {job: numbers(frame, job) for job in before} == before
    assert "warning" not in outcome.stderr


@pytest.mark.parametrize("address", ["foo", "no-such-host.invalid:8786"])
def test_an_address_of_no_machine_is_told_at_once(address: str) -> None:
    with pytest.raises(ConfigError, match="no Dask scheduler answers") as caught, cluster(address):
        pass
    assert caught.value.found is not None
    assert address in caught.value.found
    assert caught.value.hint is not None


def test_a_worker_needs_no_file(frame: Folder) -> None:
    study = lrbc.load(frame.config, cache=frame.cache)
    measured = {job: study.read(job) for job in ("tight", "loose-2")}
    expected = study.identify("tight").identification.solution.theta
    sent = pickle.dumps((study.source, measured))
    shutil.rmtree(frame.path)
    source, there = pickle.loads(sent)
    found = remote._identified(source, "tight", None, there)
    np.testing.assert_allclose(found.solution.theta, expected, rtol=0, atol=1e-9)
    assert not frame.path.exists()


def test_what_cannot_be_read_is_told_as_without(frame: Folder, address: str) -> None:
    (frame.data / "frf" / "loose-2.csv").write_text("frequency_hz\n")
    here = frame.run("update", "--force", "--job", "loose-2")
    there = frame.run("update", "--force", "--job", "loose-2", "--scheduler", address)
    assert here.code == there.code == 5
    assert there.stderr == here.stderr


@pytest.mark.slow
def test_a_lost_scheduler_costs_time_only(frame: Folder, caplog: pytest.LogCaptureFixture) -> None:
    study = lrbc.load(frame.config, cache=frame.cache)
    expected = study.identify("tight").identification.solution.theta
    with started(1) as workers, cluster(workers.scheduler_address, seconds=1.0) as found:
        workers.close()
        result = found.identify(study.inputs, study.source, "tight", None)
    np.testing.assert_array_equal(result.solution.theta, expected)
    assert "job tight: the worker was lost, identified on this machine" in caplog.text


def test_jobs_of_a_campaign(frame: Folder, workers: Cluster) -> None:
    """As many at a time as the workers have threads; the model is sent once."""
    study = lrbc.load(frame.config, cache=frame.cache)
    assert workers.slots == 1
    assert workers._there(study.source) is workers._there(study.source)
    found = workers.identify(study.inputs, study.source, "tight", None)
    np.testing.assert_array_equal(found.solution.theta, study.identify("tight").identification.solution.theta)


def test_what_is_given_up_is_not_begun_here(frame: Folder, address: str) -> None:
    study = lrbc.load(frame.config, cache=frame.cache)
    with cluster(address) as found:
        found.close()
        with pytest.raises(Exception, match=r"(?i)clos|cancel"):
            found.identify(study.inputs, study.source, "tight", None)


class TestRefused:
    def test_no_scheduler(self) -> None:
        unused = "tcp://127.0.0.1:1"
        with pytest.raises(ConfigError, match="no Dask scheduler answers") as told, cluster(unused, seconds=0.5):
            pass
        assert unused in told.value.message
        assert "dask scheduler" in told.value.message

    @pytest.mark.parametrize("text", ["", "nowhere", "http://127.0.0.1:1", "tcp://:::"])
    def test_no_address(self, text: str) -> None:
        with pytest.raises(ConfigError, match="no Dask scheduler answers"), cluster(text, seconds=0.5):
            pass

    def test_no_workers(self) -> None:
        with started(0) as found, pytest.raises(ConfigError, match="the scheduler has no workers"), cluster(found.scheduler_address):
            pass

    def test_another_version(self, address: str, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(remote, "code", lambda stage: "another")
        with pytest.raises(ConfigError, match="does not have the version of this machine") as told, cluster(address):
            pass
        assert "identification another" in told.value.message

    def test_a_worker_that_is_frozen(self) -> None:
        with started(1) as found:
            (nanny,) = found.workers.values()
            with (
                frozen(nanny.pid),
                pytest.raises(ConfigError, match=r"the worker .* does not answer") as told,
                cluster(found.scheduler_address, start=1.0),
            ):
                pass
        assert "within 1 s" in told.value.message

    def test_a_worker_that_has_just_gone(self, address: str, monkeypatch: pytest.MonkeyPatch) -> None:
        gone = "tcp://127.0.0.1:1"
        monkeypatch.setattr(remote, "version", lambda: OSError(f"cannot connect to {gone}"))
        with pytest.raises(ConfigError, match=r"the worker .* does not answer"), cluster(address):
            pass

    @pytest.mark.parametrize("what", ["frozen", "killed"])
    def test_a_scheduler_that_is_lost_after_its_greeting(self, monkeypatch: pytest.MonkeyPatch, what: str) -> None:
        line = [sys.executable, "-m", "distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard"]
        with subprocess.Popen(line, stderr=subprocess.PIPE, text=True) as scheduler:
            assert scheduler.stderr is not None
            address = next(found[0] for text in scheduler.stderr if (found := re.search(r"tcp://\S+", text)))

            def lost(*args: Any, original: Any = remote._slots) -> Any:
                os.kill(scheduler.pid, signal.SIGSTOP if what == "frozen" else signal.SIGKILL)
                return original(*args)

            monkeypatch.setattr(remote, "_slots", lost)
            with pytest.raises(ConfigError, match=f"the scheduler {address} does not answer"), cluster(address, seconds=1.0):
                pass
            scheduler.kill()

    def test_workers_of_this_machine_beside_it(self, frame: Folder, address: str) -> None:
        outcome = frame.run("update", "--workers", "2", "--scheduler", address)
        assert outcome.code == 2
        assert "--workers" in outcome.stderr
