"""Write the SoundBox on a mesh of another size, with any number of terms, as a campaign on the measurements of the sample.

    python data_samples/soundbox/generate/refined.py --dofs 100000 --terms 60 --edges left,right --out runs/box-100k
    lrbc reduce runs/box-100k/campaign.yaml

The mesh has nearly as many DOFs as wanted: every line of the sample's mesh is divided into more or fewer cells. The terms are
rotations at the nodes of the edges named, which are pinned; the other edges are clamped. Into the folder go model.h5, dofs.csv,
bolts.csv, the load hammer.mtx, the terms campaign-EDGE.csv and campaign.yaml.
"""

from __future__ import annotations

import argparse
import logging
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from rigs.design import EDGES
from rigs.designs import SOUNDBOX
from rigs.refine import Terms, refined, write_model, write_refined


def edges(text: str) -> tuple[str, ...]:
    """Names of edges, comma-separated, or ``all``."""
    names = EDGES if text == "all" else tuple(text.split(","))
    if not set(names) <= set(EDGES) or len(set(names)) < len(names):
        raise argparse.ArgumentTypeError(f"'{text}' is not 'all' or some of {', '.join(EDGES)}")
    return names


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--dofs", type=int, required=True, metavar="N", help="about so many DOFs")
    parser.add_argument("--terms", type=int, default=31, metavar="M", help="rotations of all edges together (31)")
    parser.add_argument("--edges", type=edges, default=("left",), metavar="EDGES", help="'all' or some of left,right,bottom,top (left)")
    parser.add_argument("--out", type=Path, required=True)
    arguments = parser.parse_args()
    logging.getLogger("skfem").setLevel(logging.ERROR)
    start = time.perf_counter()
    terms = Terms(arguments.edges, arguments.terms)
    try:
        design = terms.support(refined(SOUNDBOX, arguments.dofs))
        model = write_model(design, arguments.out)
        jobs = {job: SOUNDBOX.removed(job) for job in SOUNDBOX.jobs}
        path = write_refined(design, model, terms, arguments.out, Path(__file__).resolve().parents[1] / "frf", jobs, "campaign")
    except ValueError as error:
        parser.error(str(error))
    n, plate = model.mass.shape[0], model.structure_size
    print(f"{path}: n {n}, plate {plate}, nnz K {model.stiffness.nnz}, terms {terms.count}, {time.perf_counter() - start:.0f} s")


if __name__ == "__main__":
    main()
