"""What holds for every test process: one BLAS thread, interruptions, and one folder for what is dear to make and only read."""

from __future__ import annotations

import logging
import os
import shutil
import signal
import tempfile

import pytest
from hypothesis import HealthCheck, settings
from threadpoolctl import threadpool_limits

# The test processes share the cores: more threads only wait for each other. Here before NumPy is loaded, and inherited by every
# child process, pytest-xdist's workers among them; a library that a plugin has loaded already is told by its own interface.
for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS"):
    os.environ[_variable] = "1"
threadpool_limits(1)

# A shell's background jobs ignore Ctrl+C, and so would every command that the tests interrupt.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# No test is timed, and a slow machine is no fault of what is tested. One commit, one result: what a random search finds is for whoever runs
# the tests by hand.
settings.register_profile("untimed", deadline=None, suppress_health_check=[HealthCheck.too_slow], derandomize=bool(os.environ.get("CI")))
settings.load_profile("untimed")

SHARED = "LRBC_TESTS_SHARED"


def pytest_configure(config: pytest.Config) -> None:
    """Make the shared folder, once a run: workers inherit its name."""
    if not hasattr(config, "workerinput"):
        os.environ[SHARED] = tempfile.mkdtemp(prefix="lrbc-tests-")


def pytest_unconfigure(config: pytest.Config) -> None:
    """Remove it."""
    if not hasattr(config, "workerinput"):
        shutil.rmtree(os.environ.pop(SHARED), ignore_errors=True)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Slow tests first: at the end of a run only short ones are left to share."""
    items.sort(key=lambda item: item.get_closest_marker("slow") is None)


@pytest.fixture(autouse=True)
def _audible() -> None:
    """A command that another test ran with -q leaves the log quiet."""
    logging.getLogger("lrbc_cli").setLevel(logging.NOTSET)
