"""Measure the SoundBox: FRFs of seven bolt configurations as UFF files, one file each.

    python data_samples/soundbox/generate/measurements.py [--seed N] [--out DIR]

Each seed is another rig of the same geometry (materials, bolts, sensor positions) and other noise. ``truth.json`` beside the
files says what was drawn; the identification never reads it.
"""

from __future__ import annotations

import argparse
import logging
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from rigs.designs import SOUNDBOX
from rigs.measure import Laboratory

SEED = 2018


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument("--out", type=Path, default=Path(__file__).resolve().parents[1] / "frf")
    arguments = parser.parse_args()
    logging.getLogger("skfem").setLevel(logging.ERROR)
    jobs = {job: SOUNDBOX.removed(job) for job in SOUNDBOX.jobs}
    out: Path = arguments.out
    coherences = Laboratory(SOUNDBOX, exact=True).campaign(arguments.seed, jobs, out, out / "truth.json")
    for job, coherence in coherences.items():
        print(f"{job}: {len(jobs[job])} removed, mean coherence {coherence:.3f}")


if __name__ == "__main__":
    main()
