"""Mistakes that have consequences elsewhere: their cause is told once, with its fix, and what follows from it is not."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from campaigns import Folder, lrbc
from campaigns import frame as make_frame
from campaigns import plate as make_plate
from samples import reduced_cache


def told(folder: Folder, sample: str) -> list[str]:
    """Warnings of check, a line each."""
    result = lrbc("check", folder.config, "--cache", reduced_cache(sample))
    assert result.code == 0, result.stderr
    return [line.strip() for line in result.stdout.partition("\nwarnings\n")[2].splitlines()]


def test_springs_that_count_twice(tmp_path: Path) -> None:
    folder = make_plate(tmp_path)
    folder.replace("    baseline: 1.0 ", "    # baseline ")
    (only,) = told(folder, "plate")
    assert only.endswith(", so they count twice. Write parameters.bolts.baseline: 1.0")


def test_springs_in_another_unit_beside_a_baseline(tmp_path: Path) -> None:
    folder = make_plate(tmp_path)
    table = folder.data / "bushings.csv"
    table.write_text(table.read_text().replace("000\n", "000000\n"))
    (only,) = told(folder, "plate")
    assert "translational springs are probably in N/m, not in N/mm: divide them by 1000" in only


def test_factors_for_logarithms(tmp_path: Path) -> None:
    folder = make_plate(tmp_path)
    folder.replace("initial: 0.0", "initial: 1.0")
    folder.replace("bounds: [-3.0, 1.0]", "bounds: [0.001, 10]")
    (only,) = told(folder, "plate")
    assert "parameters.bolts.bounds: [0.001, 10] around 1 are probably factors" in only
    assert "write initial: 0, bounds: [-3, 1]" in only


def test_damping_coefficients_in_each_others_place(tmp_path: Path) -> None:
    folder = make_plate(tmp_path)
    folder.replace("{alpha: 0.0, beta: 0.0, loss_factor: 0.01}", "{alpha: 4.0e-6, beta: 5.0, loss_factor: 0.01}")
    (only,) = told(folder, "plate")
    assert "they are probably exchanged: write alpha: 5, beta: 4e-06" in only


def test_a_file_that_was_copied_in_part(tmp_path: Path) -> None:
    folder = make_frame(tmp_path)
    table = folder.data / "frf/loose-2.csv"
    table.write_text("".join(table.read_text().splitlines(keepends=True)[:187]))
    (only,) = told(folder, "frame")
    assert "loose-2.csv: the lines from 30 to 215 Hz cover 39% of the band" in only


def test_a_digit_of_the_band_is_lost(tmp_path: Path) -> None:
    folder = make_frame(tmp_path)
    folder.replace("band: [30.0, 500.0]", "band: [30.0, 50.0]")
    first, *others = told(folder, "frame")
    assert "Widen reduction.band (the file contains 30 to 500 Hz)" in first
    assert not [text for text in others if "units: acc" in text or "sign: acc" in text]


@pytest.mark.slow
def test_a_loosened_state_among_the_baselines(tmp_path: Path) -> None:
    """The key that holds it is named, and no other."""
    folder = make_plate(tmp_path)
    folder.replace("baselines: [tight-2]", "baselines: [tight-2, b3-half-b4-loose]")
    (only,) = told(folder, "plate")
    assert "job b3-half-b4-loose: it is taken as tight, but differs" in only
    assert only.endswith("Remove it from update.baselines, or measure it again")


@pytest.mark.parametrize(("heading", "doubted"), [("[rad]", True), ("[deg]", False)])
def test_phases_in_degrees_under_radians(tmp_path: Path, heading: str, doubted: bool) -> None:
    folder = make_frame(tmp_path)
    for name in ("tight", "loose-2", "loose-all"):
        path = folder.data / f"frf/{name}.csv"
        rows = np.loadtxt(path, delimiter=",", skiprows=1)
        H = rows[:, 1::2] + 1j * rows[:, 2::2]
        columns = np.stack([np.abs(H), np.degrees(np.angle(H))], axis=2).reshape(rows.shape[0], -1)
        names = ",".join(f"acc{i}_magnitude,acc{i}_phase {heading}" for i in (1, 2, 3, 4))
        np.savetxt(path, np.column_stack([rows[:, 0], columns]), "%.7g", ",", header=f"frequency_hz,{names}", comments="")
    found = told(folder, "frame")
    assert len(found) == doubted
    said = "check whether they are degrees; if so, set 'format: {phase: deg}' of the job; also found in loose-2.csv, loose-all.csv"
    assert all(said in text for text in found)


@pytest.mark.slow
def test_a_model_that_is_far_too_stiff(tmp_path: Path) -> None:
    """Farther than rates are taken for one another: the model it is."""
    folder = make_frame(tmp_path)
    for name, times in (("stiffness.mtx", 2.6), ("damping.mtx.gz", 1.6)):
        folder.replace(f"data/model/{name}", f"{{file: data/model/{name}, scale: {times}}}")
    (only,) = told(folder, "frame")
    assert "times the frequencies of the model" in only
    assert "The model is too stiff or too light (modulus, thickness, density)" in only
    assert "sampling rate" not in only


def test_places_in_metres_beside_a_model_in_millimetres(tmp_path: Path) -> None:
    folder = make_plate(tmp_path)
    for old, new in (
        ("[63.333, 60, 4]", "[0.063333, 0.06, 0.004]"),
        ("[20, 100, 4]", "[0.02, 0.1, 0.004]"),
        ("[106.667, 180, 4]", "[0.106667, 0.18, 0.004]"),
        ("[193.333, 60, 4]", "[0.193333, 0.06, 0.004]"),
        ("[236.667, 140, 4]", "[0.236667, 0.14, 0.004]"),
        ("[280, 100, 4]", "[0.28, 0.1, 0.004]"),
    ):
        folder.replace(old, new)
    result = lrbc("check", folder.config, "--cache", reduced_cache("plate"))
    assert result.code == 3
    assert "all 6 points of hammer and sensors fall on one node" in result.stderr
    assert "multiply each `near` of excitation and responses by 1000" in result.stderr


def test_a_mass_in_kilograms_beside_millimetres_and_newtons(tmp_path: Path) -> None:
    folder = make_plate(tmp_path)
    folder.replace("units: mm-N-t", "units: mm-N-kg")
    result = lrbc("check", folder.config, "--cache", reduced_cache("plate"))
    assert result.code == 2
    assert "write units: mm-N-t\n" in result.stderr


@pytest.mark.slow
def test_sensors_exchanged_in_a_job_with_loose_bolts(tmp_path: Path) -> None:
    folder = make_plate(tmp_path)
    file = "data/frf/b3-half-b4-loose.uff"
    folder.replace(f"{{frf: {file}}}", f"{{frf: {file}, records: {{acc1: acc4, acc4: acc1}}}}")
    # The first two are that the file states other nodes.
    *stated, only = told(folder, "plate")
    assert len(stated) == 2
    assert "job b3-half-b4-loose: acc1 and acc4 are probably exchanged" in only
    # All jobs do not have it so: what is wrong is this one's.
    assert "each fits the model's FRF of the other. Write jobs.b3-half-b4-loose.records: {acc4: acc1, acc1: acc4}, or, if all" in only


@pytest.mark.slow
def test_a_file_of_another_structure(tmp_path: Path) -> None:
    folder = make_plate(tmp_path)
    (folder.data / "frf/b5-loose.uff").unlink()
    folder.replace("data/frf/b5-loose.uff", "data/frf/other.csv")
    hz = np.arange(150.0, 851.0, 1.25)
    poles = np.array([61.0, 83.0, 170.0, 211.0, 342.0, 505.0, 596.0, 777.0, 930.0, 1100.0])
    shapes = np.random.default_rng(2).normal(size=(poles.size, 5))
    values = (-(hz[:, None] ** 2) / (poles**2 - hz[:, None] ** 2 + 0.02j * poles * hz[:, None])) @ shapes
    rows = [",".join(["frequency_hz", *(f"acc{k + 1}_{part}" for k in range(5) for part in ("real", "imag"))])]
    rows += [",".join(f"{x:.6g}" for x in (f, *row.view(float))) for f, row in zip(hz, values, strict=True)]
    (folder.data / "frf/other.csv").write_text("\n".join(rows) + "\n")
    last = told(folder, "plate")[-1]
    assert "job b5-loose: no state of the bolts explains it: " in last
    assert "the file of another state or another structure" in last
