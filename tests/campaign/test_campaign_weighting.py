"""Levels that follow the A-weighting of the analyser."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from campaigns import box

from lrbc_cli.arrays import Complexes, Floats
from lrbc_cli.campaign.check import check
from lrbc_cli.campaign.identification.compared.likeness import _unweighted, other_reading
from lrbc_cli.io.frf import read_frf, write_frf
from lrbc_cli.model.frf import FrfRecord

HZ = np.arange(20.0, 400.0, 2.0)

#: IEC 61672-1, Table 3: A-weighting at nominal frequencies [dB].
TABLE = {20.0: -50.5, 31.5: -39.4, 50.0: -30.2, 100.0: -19.1, 200.0: -10.9, 400.0: -4.8}


def weighting(hz: Floats) -> Floats:
    """From the table, in between along the logarithm of the frequency."""
    return np.asarray(np.interp(np.log(hz), np.log(list(TABLE)), list(TABLE.values())))


def frfs(seed: int) -> Complexes:
    """Two responses with a dozen resonances; another seed is a model that is off by per cents."""
    rng, s = np.random.default_rng(seed), 2j * np.pi * HZ[:, None]
    shapes = np.random.default_rng(0).normal(size=(12, 2))
    found = np.zeros((HZ.size, 2), dtype=complex)
    for shape, f in zip(shapes, np.linspace(30.0, 390.0, 12), strict=True):
        omega = 2 * np.pi * f * (1.0 + 0.004 * rng.normal())
        found += shape * omega**2 / (omega**2 + 0.04 * omega * s + s**2)
    return found


def test_the_curve_of_the_standard_is_recognised_for_pressures_alone() -> None:
    measured, model = frfs(1), frfs(2)[None]
    weighted = measured * 10.0 ** (weighting(HZ) / 20.0)[:, None]
    assert other_reading(["pressure"] * 2, HZ, measured, model, "tight") is None
    told = other_reading(["pressure"] * 2, HZ, weighted, model, "tight")
    assert told is not None
    assert "A-weighting" in told.text
    assert told.after < 0.4 * told.before
    other = other_reading(["acceleration"] * 2, HZ, weighted, model, "tight")
    assert other is None or "A-weighting" not in other.text


def test_a_slope_is_no_weighting() -> None:
    """Six decibels an octave: an integral, which is told by other names."""
    told = other_reading(["pressure"] * 2, HZ, frfs(1) * HZ[:, None], frfs(2)[None], "tight")
    assert told is None or "A-weighting" not in told.text


def test_magnitudes_and_angles_under_titles_of_real_and_imaginary_parts() -> None:
    """The numbers alone say it, however far the state of the bolts is from the model; they are no decibels, which vary by more."""
    measured = frfs(1)
    wrong = 1e-3 * np.abs(measured) + 1j * np.rad2deg(np.angle(measured))
    for other in (frfs(2)[None], frfs(2)[None, ::-1]):
        told = other_reading(["acceleration"] * 2, HZ, wrong, other, "loose")
        assert told is not None
        assert "set jobs.loose.format: {representation: magnitude-phase}" in told.text
    # A real part that changes its sign, as of any FRF over a resonance.
    assert other_reading(["acceleration"] * 2, HZ, measured, frfs(2)[None, ::-1], "loose") is None


@pytest.mark.parametrize("hz", [31.5, 100.0, 200.0])
def test_levels_are_those_of_the_table(hz: float) -> None:
    """Beside 400 Hz."""
    found = _unweighted(np.array([hz, 400.0]), np.ones((2, 1), dtype=complex))
    assert -20.0 * np.log10(abs(found[0, 0] / found[1, 0])) == pytest.approx(TABLE[hz] - TABLE[400.0], abs=0.2)


def of_the_reference_job(path: Path, wrong: Callable[[FrfRecord], Complexes]) -> str:
    """First warning on the reference job if the pressures of all jobs have other values; the calibration has factors of both fields."""
    folder = box(path)
    tree = yaml.safe_load(folder.config.read_text())
    tree["calibration"] = {"job": "tight", "factors": ["stiffness.acoustic", "alpha.structure"]}
    folder.write(tree)
    for job in tree["jobs"]:
        found = read_frf(file := path / "data" / f"{job}.uff")
        records = tuple(one if one.name == "acc1" else replace(one, values=wrong(one)) for one in found.records)
        write_frf(file, replace(found, records=records))
    return next(line for line in check(folder.inputs(), path / "cache").warnings if line.startswith("job tight"))


def test_pressures_with_the_weighting_beside_motions_without_it(tmp_path: Path) -> None:
    """Three microphones and one accelerometer: a calibration from the motion alone shows that only the pressures are wrong."""
    text = of_the_reference_job(tmp_path, lambda one: one.values * 10.0 ** (weighting(one.frequency_hz) / 20.0))
    assert "pressures alone: levels probably follow the A-weighting: switch the weighting of the microphones off" in text


def test_pressures_in_decibels_beside_motions_in_their_unit(tmp_path: Path) -> None:
    """Of 20 uPa/N, in a file whose heading says Pa/N: their smooth levels looked like a wrong sensitivity."""
    text = of_the_reference_job(tmp_path, lambda one: 20.0 * np.log10(np.abs(one.values) / 2e-5) * np.exp(1j * np.angle(one.values)))
    assert "pressures alone: levels in decibels probably read as magnitudes" in text
    assert "A key for a whole file would spoil its other records" in text


def test_what_only_one_field_says_is_told(tmp_path: Path) -> None:
    """Pressures of another duct: nothing names the cause, but the motion fits."""
    text = of_the_reference_job(tmp_path, lambda one: one.values[::-1].conj())
    assert re.search(r"from the motion of the structure alone, these FRFs are near \([0-2]\.\d dB\), but not those of the pressures", text)
    assert "weighting, places, coupling and walls of the air in the model). Otherwise check first the mass sum" in text
