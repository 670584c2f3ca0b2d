"""Identification of jobs by the workers of a Dask scheduler, also on other machines.

Reduced model and measurements are sent to the workers, and identifications come back. Files are read and written on this machine only, so
workers need no campaign files and no shared folder.
"""

from __future__ import annotations

import asyncio
import logging
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from threading import Lock
from typing import Any

from lrbc_cli.campaign.digests import code
from lrbc_cli.campaign.identification.found import Identification
from lrbc_cli.campaign.identification.records import Measurement, read_measurement
from lrbc_cli.campaign.reading.inputs import Inputs
from lrbc_cli.campaign.reduced.stage import FrfSource
from lrbc_cli.errors import ConfigError, DataError, LrbcError, on_one_line
from lrbc_cli.io.reader_process import START_SECONDS
from lrbc_cli.reduction.threads import at_most
from lrbc_cli.updating.judging.reference import ReferenceState
from lrbc_cli.version import __version__

log = logging.getLogger(__name__)


def version() -> str:
    """Version of the identification on the machine where this is called; workers must have the same."""
    return f"lrbc {__version__}, identification {code('identification')[:16]}"


class Cluster:
    """Workers that identify jobs.

    Parameters
    ----------
    client : distributed.Client
    slots : int
        Number of jobs at a time.
    """

    def __init__(self, client: Any, slots: int) -> None:
        self.slots = slots
        self._client, self._lock, self._here = client, Lock(), Lock()
        self._sent: tuple[FrfSource, Any] | None = None
        self._closed = False

    def close(self) -> None:
        """Abandon jobs that have not come back; the workers keep running."""
        self._closed = True
        self._client.close()

    def identify(self, inputs: Inputs, source: FrfSource, name: str, reference: ReferenceState | None) -> Identification:
        """Identify a job by a worker (see ``identify``); on this machine if the worker is lost.

        Raises
        ------
        LrbcError
            As ``identify`` does.
        """
        measured = _measured(inputs, name)
        try:
            found = self._client.submit(_identified, self._there(source), name, reference, measured, pure=False).result()
        except LrbcError:
            raise
        except Exception as error:
            if self._closed:
                raise
            log.warning("job %s: the worker was lost, identified on this machine (%s)", name, on_one_line(error))
            with self._here:
                return _identified(source, name, reference, measured)
        assert isinstance(found, Identification)
        return found

    def _there(self, source: FrfSource) -> Any:
        """Handle of the model, which is sent to all workers once."""
        with self._lock:
            if self._sent is None or self._sent[0] is not source:
                self._sent = source, self._client.scatter(source, broadcast=True, hash=False)
            return self._sent[1]


def _identified(source: FrfSource, name: str, reference: ReferenceState | None, measured: dict[str, Measurement]) -> Identification:
    # Imported here because judging anew does not need it.
    from lrbc_cli.campaign.identification.identify import identify

    # A machine has a worker for every two cores (guide, machines).
    with at_most(2):
        return identify(source.inputs, source, name, reference, measured)


def _measured(inputs: Inputs, name: str) -> dict[str, Measurement]:
    """Measurement of the job, and of the reference job if it can be read; without it the comparison is not corrected."""
    jobs, reference = inputs.campaign.jobs, inputs.campaign.update.reference
    found = {name: read_measurement(inputs, jobs[name], name)}
    if reference in jobs and reference not in found:
        try:
            found[reference] = read_measurement(inputs, jobs[reference], reference)
        except DataError as error:
            log.debug("the reference job: %s", error)
    return found


@contextmanager
def cluster(address: str, *, seconds: float = 10.0, start: float = START_SECONDS) -> Iterator[Cluster]:
    """Connection to the workers of a Dask scheduler.

    Parameters
    ----------
    address : str
        Such as ``tcp://host:8786``.
    seconds : float
        Time to wait for an answer of the scheduler [s].
    start : float
        Time to wait for the first answers of the workers, which may have to load this program [s].

    Raises
    ------
    ConfigError
        If Dask is not installed, scheduler or worker do not answer, there are no workers, or one has another version of this program.
    """
    try:
        from distributed import Client
        from distributed.comm import parse_address, parse_host_port
    except ImportError as error:
        raise ConfigError(
            "--scheduler needs Dask, which is not installed", found=str(error), hint="pip install 'lrbc[cluster]', on every worker too"
        ) from error
    # Silence Dask: lost workers are reported by ``Cluster.identify``.
    for name in [name for name in logging.root.manager.loggerDict if name.partition(".")[0] == "distributed"]:
        logging.getLogger(name).setLevel(logging.CRITICAL)
    try:
        # With an address that names no machine or no port, the client itself would end with a traceback.
        scheme, host = parse_address(address)
        if scheme in {"tcp", "tls"}:
            socket.getaddrinfo(*parse_host_port(host))
        client = Client(address, timeout=seconds, set_as_default=False)
    except (OSError, ValueError, TypeError) as error:
        raise ConfigError(
            "no Dask scheduler answers at the address of --scheduler",
            expected="an address such as tcp://host:8786, as `dask scheduler` prints it",
            found=f"{address} ({error or type(error).__name__})",
            hint="start it with `dask scheduler`, and workers with `dask worker ADDRESS --nthreads 1`",
        ) from error
    found = Cluster(client, 0)
    try:
        found.slots = _slots(client, address, seconds, start)
        yield found
    finally:
        found.close()


def _slots(client: Any, address: str, seconds: float, start: float) -> int:
    """Number of jobs that the workers can do at a time; raises a ConfigError without workers, or if one is lost or of another version."""
    try:
        threads = client.sync(client.nthreads, callback_timeout=seconds)
    except OSError as error:
        raise _silent(f"scheduler {address}", seconds, error) from error
    if not threads:
        hint = f"start one on each machine: `dask worker {address} --nthreads 1`"
        raise ConfigError("the scheduler has no workers", found=address, hint=hint)

    async def ask(worker: str) -> Any:
        # Without a limit of time, a worker that was stopped or lies behind a broken line is waited for without end.
        try:
            return (await asyncio.wait_for(client.run(version, workers=[worker], on_error="return"), start))[worker]
        except OSError as error:
            return error

    async def ask_all() -> list[Any]:
        return await asyncio.gather(*map(ask, threads))

    for worker, own in zip(threads, client.sync(ask_all), strict=True):
        if isinstance(own, OSError):
            raise _silent(f"worker {worker}", start, own)
        if own != version():
            raise ConfigError(
                f"the worker {worker} does not have the version of this machine",
                expected=f"{version()}, installed there",
                found=f"{type(own).__name__}: {own}" if isinstance(own, Exception) else own,
                hint="install this version of lrbc with the extra [cluster] on every worker, then restart it",
            )
    return sum(map(int, threads.values()))


def _silent(who: str, seconds: float, error: OSError) -> ConfigError:
    return ConfigError(
        f"the {who} does not answer",
        expected=f"an answer within {seconds:g} s",
        found=str(error) or type(error).__name__,
        hint="check that it runs and can be reached, or end it and start it again",
    )
