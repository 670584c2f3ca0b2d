"""A disk that is full: one OSError, nothing half written, what was there before stays."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="no limit of the size of a file")

#: A limit of the size of files does what a full disk does, without one. In a process of its own, which may die.
LIMITED = """
import resource, sys
from pathlib import Path
import numpy as np
from lrbc_cli.io.hdf5.frf import write_frf_hdf5
from lrbc_cli.io.hdf5.store import write_store
from lrbc_cli.model.frf import FrfRecord, FrfSet
what, path = sys.argv[1], Path(sys.argv[2])
frequency = np.arange(1.0, 5001.0)
def write(size):
    x = np.random.default_rng(0).standard_normal(size)
    if what == "store":
        write_store(path, {"a": x, "b": {"c": [x, "text"], "d": np.eye(3)}})
    else:
        record = FrfRecord(name="a", frequency_hz=frequency[:size], values=x + 0j, quantity="pressure")
        write_frf_hdf5(path, FrfSet(source="s", records=(record,)))
write(10)
before = path.read_bytes()
resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 20_000))
try:
    write(5000)
except OSError as error:
    assert path.read_bytes() == before
    assert list(path.parent.iterdir()) == [path]
    print("OSError")
"""


@pytest.mark.parametrize("what", ["store", "frf"])
def test_a_full_disk_is_an_oserror(tmp_path: Path, what: str) -> None:
    done = subprocess.run([sys.executable, "-c", LIMITED, what, str(tmp_path / "x.h5")], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, "OSError\n", "")
