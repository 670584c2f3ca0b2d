"""Measure the rig: FRFs of seven bolt configurations as UFF files, one file each.

    python data_samples/soundbox/generate/measurements.py [--seed N] [--out DIR]

Each seed is another rig of the same geometry (materials, bolts, sensor positions) and other noise. ``truth.json`` beside the
files says what was drawn; the identification never reads it.
"""

from __future__ import annotations

import argparse
import json
import logging
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyuff
import truth
from coupled import pressure_frfs
from geometry import MICROPHONES, Array
from numpy.typing import NDArray

ComplexArray = NDArray[np.complex128]

SEED = 2018
# Lines of the measurement [Hz]: a little wider than the band that is used.
FIRST, LAST, STEP = 10.0, 410.0, 1.0
HITS = 5
# First and last removed bolt of each configuration.
REMOVED: dict[str, tuple[int, int] | None] = {
    "bolts-00": None,
    "bolts-04": (8, 11),
    "bolts-06": (7, 12),
    "bolts-10": (5, 14),
    "bolts-12": (4, 15),
    "bolts-15": (2, 16),
    "bolts-17": (1, 17),
}
HAMMER_NODE, FIRST_MICROPHONE_NODE = 1, 101


@dataclass(frozen=True)
class Chain:
    """Hammer, sensors and noise.

    Attributes
    ----------
    peak : float
        Mean peak force [N].
    duration : float
        Mean duration of the half-sine pulse [s]; its spectrum has lost about 10 dB at 1 / duration.
    force_noise : float
        Noise of a force line relative to the largest force line.
    pressure_noise : float
        Noise of a pressure line relative to the microphone's root mean square over the lines, rising below `corner`.
    corner : float
        [Hz]
    """

    peak: float = 80.0
    duration: float = 0.0025
    force_noise: float = 0.002
    pressure_noise: float = 0.004
    corner: float = 25.0

    def force(self, frequencies: Array, rng: np.random.Generator) -> ComplexArray:
        """Spectrum of one hit [N s]: a half-sine pulse of random strength, duration and delay."""
        duration = self.duration * np.exp(rng.normal(0.0, 0.05))
        peak = self.peak * np.exp(rng.normal(0.0, 0.25))
        x = 2 * frequencies * duration
        # cos(pi x / 2) / (1 - x^2), regular at x = 1.
        shape = np.pi / 4 * (np.sinc((x - 1) / 2) + np.sinc((x + 1) / 2))
        delay = rng.uniform(0.01, 0.02) + duration / 2
        return np.asarray(2 * peak * duration / np.pi * shape * np.exp(-2j * np.pi * frequencies * delay))

    def measure(self, frfs: ComplexArray, frequencies: Array, rng: np.random.Generator) -> tuple[ComplexArray, Array]:
        """H1 estimate and coherence over `HITS` hits.

        Parameters
        ----------
        frfs : (f, r) complex array
            True FRFs [Pa/N].
        frequencies : (f,) array
            Lines [Hz].
        rng : numpy.random.Generator

        Returns
        -------
        estimate : (f, r) complex array
        coherence : (f, r) array
        """

        def noise(*shape: int) -> ComplexArray:
            return (rng.standard_normal(shape) + 1j * rng.standard_normal(shape)) / np.sqrt(2)

        cross = np.zeros(frfs.shape, dtype=complex)
        force_power = np.zeros(frequencies.size)
        pressure_power = np.zeros(frfs.shape)
        colour = np.sqrt(1 + (self.corner / frequencies) ** 4)
        typical = self.force(frequencies, np.random.default_rng(0))
        level = self.pressure_noise * np.sqrt(np.mean(np.abs(frfs * typical[:, None]) ** 2, axis=0))
        for _ in range(HITS):
            true_force = self.force(frequencies, rng)
            force = true_force + self.force_noise * np.abs(typical).max() * noise(frequencies.size)
            pressure = frfs * true_force[:, None] + level * colour[:, None] * noise(*frfs.shape)
            cross += pressure * force.conj()[:, None]
            force_power += np.abs(force) ** 2
            pressure_power += np.abs(pressure) ** 2
        estimate = cross / force_power[:, None]
        return estimate, np.abs(cross) ** 2 / (force_power[:, None] * pressure_power)


def write_uff(path: Path, job: str, frequencies: Array, estimate: ComplexArray, coherence: Array) -> None:
    """Write units (164), then FRFs and coherences (58, ASCII, single precision, even spacing)."""
    units = {
        "type": 164,
        "units_code": 1,
        "units_description": "SI",
        "temp_mode": 1,
        "length": 1.0,
        "force": 1.0,
        "temp": 1.0,
        "temp_offset": 273.15,
    }
    sets = [units]
    for function, title, values in ((4, "Frequency Response Function", estimate), (6, "Coherence", coherence)):
        for k, name in enumerate(MICROPHONES):
            sets.append(
                {
                    "type": 58,
                    "binary": 0,
                    "id1": f"SoundBox {job}",
                    "id2": f"{title} {name}, {HITS} hits",
                    "id3": "NONE",
                    "id4": "NONE",
                    "id5": "NONE",
                    "func_type": function,
                    "ver_num": 1,
                    "load_case_id": 0,
                    "rsp_ent_name": name,
                    "rsp_node": FIRST_MICROPHONE_NODE + k,
                    "rsp_dir": 0,
                    "ref_ent_name": "hammer",
                    "ref_node": HAMMER_NODE,
                    "ref_dir": 3,
                    "ord_data_type": 5 if function == 4 else 2,
                    "num_pts": frequencies.size,
                    "abscissa_spacing": 1,
                    "abscissa_min": FIRST,
                    "abscissa_inc": STEP,
                    "z_axis_value": 0.0,
                    "abscissa_spec_data_type": 18,
                    "abscissa_len_unit_exp": 0,
                    "abscissa_force_unit_exp": 0,
                    "abscissa_temp_unit_exp": 0,
                    "abscissa_axis_lab": "Frequency",
                    "abscissa_axis_units_lab": "Hz",
                    # A coherence is the ratio of two powers: type 0 (unknown) has no unit.
                    "ordinate_spec_data_type": 15 if function == 4 else 0,
                    "ordinate_len_unit_exp": 0,
                    "ordinate_force_unit_exp": 0,
                    "ordinate_temp_unit_exp": 0,
                    "ordinate_axis_lab": "Pressure" if function == 4 else "Coherence",
                    "ordinate_axis_units_lab": "Pa" if function == 4 else "NONE",
                    "orddenom_spec_data_type": 13 if function == 4 else 0,
                    "orddenom_len_unit_exp": 0,
                    "orddenom_force_unit_exp": 0,
                    "orddenom_temp_unit_exp": 0,
                    "orddenom_axis_lab": "Force" if function == 4 else "NONE",
                    "orddenom_axis_units_lab": "N" if function == 4 else "NONE",
                    "z_axis_spec_data_type": 0,
                    "z_axis_len_unit_exp": 0,
                    "z_axis_force_unit_exp": 0,
                    "z_axis_temp_unit_exp": 0,
                    "z_axis_axis_lab": "NONE",
                    "z_axis_axis_units_lab": "NONE",
                    "x": frequencies,
                    "data": values[:, k],
                }
            )
    path.unlink(missing_ok=True)
    pyuff.UFF(str(path)).write_sets(sets, mode="add", force_double=False)


def removed_bolts(job: str) -> list[str]:
    """Names of the removed bolts of a configuration."""
    limits = REMOVED[job]
    return [] if limits is None else [f"B{i:02d}" for i in range(limits[0], limits[1] + 1)]


def campaign(seed: int, out: Path) -> None:
    """Draw a rig and measure it in all configurations."""
    out.mkdir(parents=True, exist_ok=True)
    rng_rig, rng_settling, rng_noise = (np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(3))
    perturbations = truth.Perturbations.draw(rng_rig)
    rig = truth.Rig(perturbations)
    frequencies = FIRST + STEP * np.arange(round((LAST - FIRST) / STEP) + 1)
    chain = Chain()
    jobs = {}
    for job in REMOVED:
        removed = removed_bolts(job)
        plate, factors = rig.configuration(removed, rng_settling)
        frfs = pressure_frfs(plate, rig.cavity, *rig.air_damping(), rig.outputs, frequencies)
        estimate, coherence = chain.measure(frfs, frequencies, rng_noise)
        write_uff(out / f"{job}.uff", job, frequencies, estimate, coherence)
        jobs[job] = {"removed": removed, "patch_factors": {name: round(value, 4) for name, value in factors.items()}}
        print(f"{job}: {len(removed)} removed, mean coherence {coherence.mean():.3f}")
    record = {"seed": seed, "perturbations": perturbations.as_dict(), "jobs": jobs}
    text = json.dumps(record, indent=1)
    (out / "truth.json").write_text(text + "\n", encoding="utf-8", newline="\n")


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument("--out", type=Path, default=Path(__file__).resolve().parents[1] / "frf")
    arguments = parser.parse_args()
    logging.getLogger("skfem").setLevel(logging.ERROR)
    campaign(arguments.seed, arguments.out)


if __name__ == "__main__":
    main()
