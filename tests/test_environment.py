"""What the tests run with: one BLAS thread a process, and lowest versions that agree with the project's."""

from __future__ import annotations

import json
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import scipy.linalg as la
from packaging.requirements import Requirement
from packaging.version import Version
from threadpoolctl import threadpool_info

ROOT = Path(__file__).parents[1]


def test_one_blas_thread_a_process():
    """With and without pytest-xdist, whatever the environment said, and in child processes."""
    # Both libraries, NumPy's and SciPy's, are loaded and used.
    assert la.solve(np.eye(2), np.linalg.inv(np.eye(2))).shape == (2, 2)
    code = "import json, numpy, scipy.linalg, threadpoolctl; print(json.dumps(threadpoolctl.threadpool_info()))"
    child = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    for pools in (threadpool_info(), json.loads(child.stdout)):
        # SciPy's reader of Matrix Market files, which counts threads of its own, is listed too once it is loaded.
        assert {pool["num_threads"] for pool in pools if pool["user_api"] == "blas"} == {1}


def test_lowest_versions_are_those_of_the_project():
    """The file that ``.ci/run`` installs names the lower bound of every dependency, those of the tests included."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    named = [Requirement(line) for line in project["dependencies"] + project["optional-dependencies"]["test"]]
    lowest = {r.name: Version(s.version) for r in named for s in r.specifier if s.operator == ">="}
    assert set(lowest) == {r.name for r in named}
    lines = (ROOT / ".ci" / "lowest.txt").read_text(encoding="utf-8").splitlines()
    pins = dict(line.split("==") for line in lines if line and not line.startswith("#"))
    assert {name: Version(pins.get(name, "0")) for name in lowest} == lowest


def test_the_lowest_python_is_tested():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    lowest = project["requires-python"].removeprefix(">=")
    assert f"python_of {lowest})" in (ROOT / ".ci" / "run").read_text(encoding="utf-8")
