"""What a model that lacks something costs: beams on springs, with two small masses and a thickness that the model does not know.

    python tests/benchmarks/beams.py 100-129 [--key PATH=VALUE]... [--out DIR]

Each seed is a beam of 1.2 m on three to seven springs to ground, with a mesh of its own, 1 to 3 % thicker or thinner than its model, two
masses of 5 to 30 g (of about 1 kg), 15 % more damping, all of it, springs included, hysteretic; springs off by 0.1 decades, re-torqued by
0.05. Four sensors, the last one for validation, 1 Hz lines, 0.3 % noise. Jobs: two tight ones, four with one spring that lost 0.6 to 3
decades, one with all springs less one decade. Calibrated with stiffness and loss factor of the structure, then run as a user would.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import scipy.io
import scipy.linalg
import yaml
from numpy.typing import NDArray

Floats = NDArray[np.float64]

LENGTH, WIDTH, HEIGHT, YOUNG, DENSITY = 1.2, 0.04, 0.008, 70e9, 2700.0
MODEL, TRUE = 40, 67
PITCH = LENGTH / MODEL
BAND = 20.0, 700.0
NOISE, NOMINAL, RETORQUE, MORE_LOSS = 0.003, 0.1, 0.05, 1.15

#: Losses from which a spring counts as loose, and up to which as tight; a decade or more has to be found [decades].
LOOSE, TIGHT, LARGE = 0.45, 0.25, 0.95


def row(x: float, elements: int) -> Floats:
    """Deflection at x over deflections and ROTY (minus the slope) of all nodes."""
    h = LENGTH / elements
    e = min(int(x / h + 1e-9), elements - 1)
    t = x / h - e
    found = np.zeros(2 * (elements + 1))
    found[2 * e : 2 * e + 4] = 1 - 3 * t**2 + 2 * t**3, -h * (t - 2 * t**2 + t**3), 3 * t**2 - 2 * t**3, -h * (t**3 - t**2)
    return found


def matrices(elements: int, height: float) -> tuple[Floats, Floats]:
    """K and M of the free beam."""
    h, area = LENGTH / elements, WIDTH * height
    bend = [[12, -6 * h, -12, -6 * h], [-6 * h, 4 * h**2, 6 * h, 2 * h**2], [-12, 6 * h, 12, 6 * h], [-6 * h, 2 * h**2, 6 * h, 4 * h**2]]
    mass = [
        [156, -22 * h, 54, 13 * h],
        [-22 * h, 4 * h**2, -13 * h, -3 * h**2],
        [54, -13 * h, 156, 22 * h],
        [13 * h, -3 * h**2, 22 * h, 4 * h**2],
    ]
    K, M = (np.zeros((2 * (elements + 1), 2 * (elements + 1))) for _ in range(2))
    for e in range(elements):
        at = slice(2 * e, 2 * e + 4)
        K[at, at] += YOUNG * area * height**2 / 12 / h**3 * np.array(bend)
        M[at, at] += DENSITY * area * h / 420 * np.array(mass)
    return K, M


@dataclass
class Beam:
    """One seed: what was drawn, and its measurements."""

    seed: int
    levels: dict[str, dict[str, float]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        rng = np.random.default_rng(500 + self.seed)
        count, at = int(rng.integers(3, 8)), np.arange(1, MODEL)
        places = np.sort(rng.choice(at, count, replace=False)) * PITCH
        self.bolts = {f"B{i + 1}": float(x) for i, x in enumerate(places)}
        self.stiffness = float(10 ** rng.uniform(4.3, 6))
        pool = list(at * PITCH)
        self.sensors = {f"s{i + 1}": float(x) for i, x in enumerate(rng.choice(pool, 4, replace=False))}
        self.hammer = float(rng.choice([x for x in pool if x not in self.sensors.values()]))
        self.thickness = float(1 + float(rng.choice([-1, 1])) * rng.uniform(0.01, 0.03))
        self.masses = [(float(rng.uniform(0, LENGTH)), float(rng.uniform(0.005, 0.03))) for _ in range(2)]
        self.loss = float(rng.choice([0.005, 0.01, 0.02, 0.03]))
        self.losses: dict[str, dict[str, float]] = {"tight-1": {}, "tight-2": {}}
        for i in range(4):
            name, lost = f"B{rng.integers(1, count + 1)}", float(rng.choice([0.6, 1, 1.5, 2, 3]))
            self.losses[f"j{i}-{name}-{lost}"] = {name: lost}
        self.losses["all-1"] = dict.fromkeys(self.bolts, 1.0)
        self._rng = np.random.default_rng(self.seed)
        self._base = {name: float(self._rng.normal(0, NOMINAL)) for name in self.bolts}
        self.frequency = np.arange(BAND[0], BAND[1] + 0.5)

    def measured(self, job: str) -> NDArray[np.complex128]:
        """(F, 4) accelerances; to be called in the order of the jobs."""
        K, M = matrices(TRUE, HEIGHT * self.thickness)
        for x, mass in self.masses:
            M += mass * np.outer(row(x, TRUE), row(x, TRUE))
        self.levels[job] = {}
        for name, x in self.bolts.items():
            level = self._base[name] + float(self._rng.normal(0, RETORQUE)) - self.losses[job].get(name, 0.0)
            self.levels[job][name] = level
            K += self.stiffness * 10**level * np.outer(row(x, TRUE), row(x, TRUE))
        squares, modes = scipy.linalg.eigh(K, M)
        omega = 2 * np.pi * self.frequency
        at = np.array([row(x, TRUE) for x in self.sensors.values()]) @ modes
        y = (row(self.hammer, TRUE) @ modes) / (squares * (1 + 1j * MORE_LOSS * self.loss) - omega[:, None] ** 2) @ at.T
        y *= -(omega[:, None] ** 2)
        rms = np.sqrt((np.abs(y) ** 2).mean(axis=0))
        noise = self._rng.normal(size=y.shape) + 1j * self._rng.normal(size=y.shape)
        return np.asarray(y + NOISE * (0.5 * rms + 0.5 * np.abs(y)) * noise)

    def write(self, folder: Path, keys: list[str]) -> Path:
        """The campaign file, with keys set as ``a.b=value``."""
        folder.mkdir(parents=True, exist_ok=True)
        for name, matrix in zip(("K", "M"), matrices(MODEL, HEIGHT), strict=True):
            scipy.io.mmwrite(folder / f"{name}.mtx", matrix, symmetry="general", precision=17)
        lines = [f"{2 * i + k},{i + 1},{label},{i * PITCH:.6f},0,0" for i in range(MODEL + 1) for k, label in enumerate(("UZ", "ROTY"))]
        (folder / "dofs.csv").write_text("dof,node,component,x,y,z\n" + "\n".join(lines) + "\n", encoding="utf-8")
        lines = [f"{name},{_node(x)},,UZ,{self.stiffness!r}" for name, x in self.bolts.items()]
        (folder / "bushings.csv").write_text("bolt,node_a,node_b,component,stiffness\n" + "\n".join(lines) + "\n", encoding="utf-8")
        header = "frequency_hz," + ",".join(f"{name}_real,{name}_imag" for name in self.sensors)
        for job in self.losses:
            y = self.measured(job)
            table = np.column_stack([self.frequency, np.stack([y.real, y.imag], axis=2).reshape(self.frequency.size, -1)])
            np.savetxt(folder / f"{job}.csv", table, fmt="%.7g", delimiter=",", header=header, comments="")
        tree: dict[str, Any] = {
            "campaign": f"beam-{self.seed}",
            "output": "out",
            "model": {
                "stiffness": "K.mtx",
                "mass": "M.mtx",
                "dofs": "dofs.csv",
                "damping": {"structure": {"loss_factor": self.loss}},
            },
            "excitation": {"hammer": {"node": _node(self.hammer), "component": "UZ"}},
            "responses": {name: {"node": _node(x), "component": "UZ", "quantity": "acceleration"} for name, x in self.sensors.items()},
            "parameters": {"bolts": {"select": {"bushings": "bushings.csv"}, "initial": 0.0, "bounds": [-3.0, 1.0]}},
            "reduction": {"band": list(BAND), "tolerance": 1e-3},
            "calibration": {"job": "tight-1", "factors": ["stiffness.structure", "loss_factor.structure"]},
            "update": {"reference": "tight-1", "responses": list(self.sensors)[:-1]},
            "jobs": {job: {"frf": f"{job}.csv"} for job in self.losses},
        }
        for key in keys:
            path, _, value = key.partition("=")
            *parts, last = path.split(".")
            at = tree
            for part in parts:
                at = at[part]
            at[last] = yaml.safe_load(value)
        config = folder / "campaign.yaml"
        config.write_text(yaml.safe_dump(tree, sort_keys=False), encoding="utf-8")
        return config


def _node(x: float) -> int:
    return round(x / PITCH) + 1


def run(beam: Beam, folder: Path, keys: list[str]) -> Counter[str]:
    """Calibrate and update by the command; what came of it."""
    config = beam.write(folder, keys)
    command = [sys.executable, "-m", "lrbc_cli"]
    for words in (["calibrate"], ["update", "--fail-on-loose"]):
        subprocess.run([*command, *words, str(config)], capture_output=True, check=False)
    found, told = Counter[str](), list[str]()
    tight = beam.levels["tight-1"]
    reference = json.loads((folder / "out" / "tight-1" / "result.json").read_text(encoding="utf-8"))
    for job, levels in beam.levels.items():
        if job == "tight-1":
            continue
        result = json.loads((folder / "out" / job / "result.json").read_text(encoding="utf-8"))
        found["jobs"] += 1
        if result["status"] == "unexplained":
            found["unexplained"] += 1
            continue
        clear, lost_one = result["validity"]["passed"] is True, False
        for bolt in result["bolts"]:
            lost, verdict = tight[bolt["name"]] - levels[bolt["name"]], bolt["verdict"]
            clear &= verdict == "tight"
            wrong = None
            if lost > LOOSE:
                lost_one = True
                found["loose"] += 1
                wrong = "loose called tight" if verdict == "tight" else None
            if lost > LARGE:
                found["lost a decade"] += 1
                found["found of these"] += verdict == "loose"
            if lost < TIGHT:
                found["tight"] += 1
                wrong = "tight called loose" if verdict == "loose" else wrong
            if wrong:
                found[wrong] += 1
                told.append(f"{job} {bolt['name']} lost {lost:.2f}, found {-bolt['change']:.2f}")
        if clear and lost_one:
            found["all-clears not earned"] += 1
            told.append(f"{job} ALL CLEAR")
    misfit = reference["misfit_db"]
    print(
        f"{beam.seed}: reference {reference['status']} {misfit['final']:.2f}/{misfit['held_out_final']:.2f} dB; {'; '.join(told)}",
        flush=True,
    )
    return found


def main() -> None:
    """Run the seeds and print what they come to."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("seeds", help="FIRST-LAST")
    parser.add_argument("--key", action="append", default=[], help="of the campaign file, for instance parameters.bolts.damping=none")
    parser.add_argument("--out", type=Path, default=Path("beams"))
    given = parser.parse_args()
    first, last = (int(part) for part in given.seeds.split("-"))
    total = Counter[str]()
    for seed in range(first, last + 1):
        total.update(run(Beam(seed), given.out / str(seed), given.key))
    print(dict(total))


if __name__ == "__main__":
    main()
