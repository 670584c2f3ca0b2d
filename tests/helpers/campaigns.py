"""Small campaigns in a folder of their own, and the command line run on them."""

from __future__ import annotations

import contextlib
import csv
import io
import json
import os
import shutil
import subprocess
import sys
import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any

import h5py
import numpy as np
import pytest
import scipy.io
import scipy.sparse as sp
import yaml
from shared import shared
from systems import chain, csc, direct_frf, duct, fe_model, unit

from lrbc_cli.campaign.reading.inputs import Inputs, read_as_exported
from lrbc_cli.cli.main import main
from lrbc_cli.config import load_campaign
from lrbc_cli.io.frf import write_frf
from lrbc_cli.model.frf import FrfRecord, FrfSet

ROOT = Path(__file__).parents[2]


@dataclass(frozen=True)
class Result:
    """What a command left: exit code and both streams."""

    code: int
    stdout: str
    stderr: str

    @property
    def json(self) -> Any:
        """The one JSON document on stdout."""
        return json.loads(self.stdout, parse_constant=lambda name: pytest.fail(f"{name} is no JSON"))


def lrbc(*args: str | Path) -> Result:
    """Run a command inside this process."""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err), pytest.raises(SystemExit) as caught:
        main.main([str(arg) for arg in args])
    # pytest shows it where the test fails.
    sys.stderr.write(err.getvalue())
    return Result(int(caught.value.code or 0), out.getvalue(), err.getvalue())


def command() -> list[str]:
    """The installed command, else the module that it calls."""
    script = Path(sys.executable).with_name("lrbc.exe" if os.name == "nt" else "lrbc")
    return [str(script)] if script.is_file() else [sys.executable, "-c", "from lrbc_cli.cli.main import main; main()"]


def environment() -> dict[str, str]:
    """One BLAS thread, as tests may run beside each other."""
    return os.environ | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}


@dataclass(frozen=True)
class Folder:
    """A campaign with all its files, which a test may spoil.

    ``campaign.yaml``, ``data/``, ``out/`` and ``cache/`` lie in ``path``.
    """

    path: Path

    @property
    def config(self) -> Path:
        """The campaign file."""
        return self.path / "campaign.yaml"

    @property
    def data(self) -> Path:
        """Input files."""
        return self.path / "data"

    @property
    def out(self) -> Path:
        """Output folder."""
        return self.path / "out"

    @property
    def cache(self) -> Path:
        """Cache folder."""
        return self.path / "cache"

    def run(self, name: str, *args: str | Path) -> Result:
        """Run a command on this campaign."""
        return lrbc(name, self.config, "--cache", self.cache, *args)

    def start(self, name: str, *args: str, **options: Any) -> subprocess.Popen[str]:
        """Start a command on this campaign in a process of its own."""
        line = [*command(), name, str(self.config), "--cache", str(self.cache), *args]
        pipe = subprocess.PIPE
        return subprocess.Popen(line, stdout=pipe, stderr=pipe, text=True, env=environment(), **options)

    def inputs(self, *overrides: str) -> Inputs:
        """Read model and campaign file."""
        return read_as_exported(load_campaign(self.config, overrides))

    def tree(self) -> Any:
        """The campaign file as plain values."""
        return yaml.safe_load(self.config.read_text())

    def write(self, tree: Any) -> None:
        """Replace the campaign file."""
        self.config.write_text(yaml.safe_dump(tree, sort_keys=False))

    def replace(self, old: str, new: str) -> None:
        """Change the text of the campaign file."""
        text = self.config.read_text()
        assert text.count(old) == 1, old
        self.config.write_text(text.replace(old, new))

    def result(self, job: str) -> Any:
        """A job's result.json."""
        return json.loads((self.out / job / "result.json").read_text())

    def results(self) -> dict[str, Any]:
        """What the identification found in every job, seconds and paths left out."""
        found = {}
        for path in sorted(self.out.glob("*/result.json")):
            tree = json.loads(path.read_text())
            tree.pop("seconds", None)
            tree.pop("digest", None)
            tree["provenance"].pop("configuration", None)
            tree["provenance"]["inputs"] = {Path(name).name: digest for name, digest in tree["provenance"]["inputs"].items()}
            found[path.parent.name] = tree
        return found

    def listing(self) -> dict[str, tuple[int, int]]:
        """Every file and folder with size and time of change."""
        return {
            str(p.relative_to(self.path)): (p.stat().st_size if p.is_file() else -1, p.stat().st_mtime_ns) for p in self.path.rglob("*")
        }

    def leftovers(self) -> list[str]:
        """Temporary files under output and cache."""
        return [str(p) for folder in (self.out, self.cache) for p in folder.rglob("*") if p.name.startswith(".")]

    def assert_whole(self) -> None:
        """Every file under output and cache can be read."""
        for path in [*self.out.rglob("*"), *self.cache.rglob("*")]:
            if path.name.startswith(".") or path.is_dir():
                continue
            assert path.suffix in (".json", ".csv", ".h5"), path
            if path.suffix == ".json":
                json.loads(path.read_text())
            elif path.suffix == ".csv":
                with path.open(newline="") as file:
                    assert len({len(row) for row in csv.reader(file)}) == 1, path
            else:
                with h5py.File(path) as image:
                    assert len(image)

    def copy(self, path: Path) -> Folder:
        """The same somewhere else; unchanged inputs stay finished."""
        shutil.copytree(self.path, path, dirs_exist_ok=True)
        return Folder(path)


def frame(path: Path) -> Folder:
    """The frame sample: 414 DOFs, ten general vectors, accelerances in CSV, three jobs."""
    shutil.copytree(ROOT / "data_samples" / "frame" / "model", path / "data" / "model")
    (path / "data" / "frf").mkdir()
    for file in (ROOT / "data_samples" / "frame" / "frf").glob("*.csv"):
        shutil.copy(file, path / "data" / "frf")
    text = (ROOT / "configs" / "frame.yaml").read_text().replace("../data_samples/frame", "data").replace("../runs/frame", "out")
    (path / "campaign.yaml").write_text(text)
    return Folder(path)


def plate(path: Path) -> Folder:
    """The plate sample: six bolts as bushings, a model in mm, N and t from CalculiX, universal files."""
    shutil.copytree(ROOT / "data_samples" / "plate", path / "data")
    text = (ROOT / "configs" / "plate.yaml").read_text().replace("../data_samples/plate", "data").replace("../runs/plate", "out")
    (path / "campaign.yaml").write_text(text)
    return Folder(path)


def two_jobs(path: Path) -> Folder:
    """The frame without its dearest job."""
    folder = frame(path)
    tree = folder.tree()
    del tree["jobs"]["loose-all"]
    folder.write(tree)
    return folder


#: log10 stiffness of the springs under the masses in the two measurements of ``box``.
BOX_TRUTH = {"tight": np.array([4.6, 4.4, 4.5, 4.7, 4.5, 4.6]), "loose": np.array([4.6, 4.4, 2.6, 2.8, 4.5, 4.6])}
BOX_BAND = (20.0, 400.0)
BOX_BETA = 2e-5


def box(
    path: Path,
    further: Mapping[str, tuple[np.ndarray, float]] = MappingProxyType({}),
    changed: Mapping[str, Mapping[str, float]] = MappingProxyType({}),
) -> Folder:
    """A tiny u-p model: masses, six of eight on springs, on the flank of a duct with 24 pressures; universal files without errors.

    ``further``: log10 stiffness of the springs and relative speed of sound in other jobs. ``changed``: in some of these, times of the
    damping of the ``air``, true over stated frequencies (``clock``), mass added at the fourth mass (``mass``), and by how many nodes
    mic2 was ``moved``.
    """
    ns, na = 8, 24
    K, M, acoustic = duct(ns, na, kappa=1.0, coupling=1.0)
    (path / "data").mkdir(parents=True)
    for name, matrix in (("K", K), ("M", M)):
        scipy.io.mmwrite(path / "data" / f"{name}.mtx", matrix, symmetry="general", precision=17)
    rows = ["dof,node,component,x,y,z"]
    rows += [f"{i},{i + 1},UZ,{0.3 * i:.6f},0,0" for i in range(ns)]
    rows += [f"{ns + i},{101 + i},PRES,{2.0 * i / (na - 1):.6f},0,0.1" for i in range(na)]
    (path / "data" / "dofs.csv").write_text("\n".join(rows) + "\n")
    bolts = [f"B{i + 1},{0.3 * i:.6f},0.01,0" for i in range(BOX_TRUTH["tight"].size)]
    (path / "data" / "bolts.csv").write_text("name,x,y,z\n" + "\n".join(bolts) + "\n")
    tree = {
        "campaign": "box",
        "output": "out",
        "model": {
            "stiffness": "data/K.mtx",
            "mass": "data/M.mtx",
            "damping": {"structure": {"alpha": 200.0, "beta": BOX_BETA}, "acoustic": {"alpha": 60.0, "beta": 1e-6}},
            "dofs": "data/dofs.csv",
        },
        "excitation": {"hammer": {"node": 8, "component": "UZ"}},
        "responses": {
            "mic1": {"node": 103, "component": "PRES"},
            "mic2": {"node": 112, "component": "PRES"},
            "mic3": {"near": [2.0, 0.0, 0.1], "component": "PRES"},
            "acc1": {"node": 7, "component": "UZ", "quantity": "acceleration"},
        },
        "parameters": {"springs": {"select": {"component": "UZ", "box": [[0, 1.5], [0, 0], [0, 0]]}, "initial": 4.5, "bounds": [1.0, 7.0]}},
        "bolts": "data/bolts.csv",
        "reduction": {"band": list(BOX_BAND), "tolerance": 1e-6},
        "update": {"reference": "tight", "lines": "all", "regularisation": 0.0},
        "jobs": {
            "tight": {"frf": "data/tight.uff"},
            "loose": {"frf": "data/loose.uff", "removed": ["B3", "B4"]},
            **{name: {"frf": f"data/{name}.uff"} for name in further},
        },
    }
    folder = Folder(path)
    folder.write(tree)
    model = fe_model(
        K,
        M,
        loads=unit(ns + na, 7),
        outputs=unit(ns + na, ns + 2, ns + 11, ns + na - 1, 6),
        left=unit(ns + na, *range(6)),
        damping=(200.0, BOX_BETA),
        acoustic_damping=(60.0, 1e-6),
        is_acoustic=acoustic,
        output_power=[0, 0, 0, 2],
    )
    frequency = np.arange(BOX_BAND[0], BOX_BAND[1] + 1, 2.0)
    s = 2j * np.pi * frequency
    for job, (truth, speed) in {**{name: (truth, 1.0) for name, truth in BOX_TRUTH.items()}, **further}.items():
        other, added = {"air": 1.0, "clock": 1.0, "mass": 0.0, "moved": 0} | dict(changed.get(job, {})), np.zeros(ns + na)
        warm, damped = (np.where(np.outer(acoustic, acoustic), times, 1.0) for times in (speed**2, other["air"]))
        added[3] = other["mass"]
        there = replace(
            model,
            K=csc(model.K.toarray() * warm),
            C=csc(model.C.toarray() * damped),
            M=csc(model.M.toarray() + np.diag(added)),
            L=csc(unit(ns + na, ns + 2, ns + 11 + int(other["moved"]), ns + na - 1, 6).T),
        )
        y = direct_frf(there, other["clock"] * s, np.tile(10.0**truth + 0j, (s.size, 1)))
        points = [("mic1", 103, 0), ("mic2", 112, 0), ("mic3", 124, 0), ("acc1", 7, 3)]
        records = tuple(
            FrfRecord(
                name=name,
                frequency_hz=frequency,
                values=y[:, i],
                quantity="acceleration" if name == "acc1" else "pressure",
                response_node=node,
                response_direction=direction,
                reference_node=8,
                reference_direction=3,
            )
            for i, (name, node, direction) in enumerate(points)
        )
        write_frf(path / "data" / f"{job}.uff", FrfSet(source=job, records=records))
    return folder


Matrices = dict[str, np.ndarray]


def spoil(folder: Folder, change: Callable[[Matrices], object]) -> None:
    """Change K and M as dense arrays."""
    matrices = {name: scipy.io.mmread(folder.data / f"{name}.mtx", spmatrix=False).toarray() for name in "KM"}
    change(matrices)
    for name, matrix in matrices.items():
        scipy.io.mmwrite(folder.data / f"{name}.mtx", sp.coo_array(matrix), symmetry="general", precision=17)


def chain_folder(path: Path, n: int = 12) -> Folder:
    """A chain of masses without any DOF table, one job in CSV: the smallest campaign."""
    K, M = chain(n)
    (path / "data").mkdir(parents=True)
    for name, matrix in (("K", K), ("M", M)):
        scipy.io.mmwrite(path / "data" / f"{name}.mtx", csc(matrix), symmetry="general", precision=17)
    (path / "data" / "terms.csv").write_text("dof\n0\n1\n2\n3\n")
    folder = Folder(path)
    folder.write(
        {
            "campaign": "chain",
            "output": "out",
            "model": {"stiffness": "data/K.mtx", "mass": "data/M.mtx", "damping": {"structure": {"alpha": 10.0, "beta": 2e-5}}},
            "excitation": {"hammer": {"dof": n - 1}},
            "responses": {"a": {"dof": n - 2}, "b": {"dof": n // 2}},
            "parameters": {"springs": {"select": {"dofs": "data/terms.csv"}, "initial": 4.0, "bounds": [1.0, 8.0]}},
            "reduction": {"band": [20.0, 500.0]},
            "update": {"lines": "all", "regularisation": 0.0},
            "jobs": {"one": {"frf": "data/one.csv"}},
        }
    )
    return folder


def _make(kind: str, path: Path) -> None:
    make, commands = {
        "frame": (frame, ["update"]),
        "box": (box, ["update"]),
        "calibrated": (two_jobs, ["calibrate"]),
        "two jobs": (two_jobs, ["update"]),
    }[kind]
    folder = make(path)
    for command in commands:
        outcome = folder.run(command)
        assert outcome.code == 0, outcome.stderr


def finished(kind: str) -> Folder:
    """``frame``, its ``two jobs`` or ``box``, all jobs done, or ``calibrated``, its two jobs to do; made once a run, read only."""
    return Folder(shared(kind, partial(_make, kind)))


def measure_again(path: Path, to: Path) -> None:
    """The same state once more, in a CSV file: another hammer blow gives FRFs that differ by their noise."""
    header, *rows = path.read_text().splitlines()
    cells = np.array([row.split(",") for row in rows], dtype=float)
    cells[:, 1:] *= 1.0 + 0.005 * np.random.default_rng(zlib.crc32(to.name.encode())).normal(size=cells[:, 1:].shape)
    to.write_text("\n".join([header, *(",".join(map(repr, row)) for row in cells.tolist())]) + "\n")


def with_a_tight_job(folder: Folder) -> Folder:
    """Instead of the loose ones: the tight state measured again."""
    measure_again(folder.data / "frf" / "tight.csv", folder.data / "frf" / "again.csv")
    tree = folder.tree()
    tree["jobs"] = {"tight": tree["jobs"]["tight"]}
    folder.write(tree)
    with_job(folder, "again")
    return folder


def with_job(folder: Folder, name: str) -> None:
    """A further job, which reads the CSV file of its name."""
    tree = folder.tree()
    tree["jobs"][name] = {"frf": f"data/frf/{name}.csv"}
    folder.write(tree)
