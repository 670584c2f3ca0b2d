"""Write the nominal model of the SoundBox: ``model.h5``, ``dofs.csv`` and ``bolts.csv``.

    python data_samples/soundbox/generate/nominal.py [--out DIR]

See the README beside the data.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from rigs.designs import SOUNDBOX
from rigs.nominal import build, write


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path(__file__).resolve().parents[1])
    out = parser.parse_args().out
    model = build(SOUNDBOX)
    write(SOUNDBOX, model, out)
    distance = np.linalg.norm(model.xyz[model.component == "UZ"] - SOUNDBOX.hammer_point, axis=1).min()
    print(f"n {model.mass.shape[0]}, plate {model.structure_size}, nnz K {model.stiffness.nnz}, nnz M {model.mass.nnz}")
    print(f"nearest node to the hammer point: {distance:.1e} m")


if __name__ == "__main__":
    main()
