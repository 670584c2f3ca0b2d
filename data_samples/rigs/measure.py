"""Measure a rig in some configurations of its bolts."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from lrbc_cli.virtual.chain import Chain
from lrbc_cli.virtual.drift import Scatter
from rigs.design import Array, Design
from rigs.reduced import Basis
from rigs.truth import Air, Perturbations, Plate, Rig
from rigs.uff import Header, write_uff

# Lines of the measurement [Hz]: a little wider than the band that is used.
FREQUENCIES: Array = np.arange(10.0, 411.0)


class Laboratory:
    """The rigs of a design, one a seed.

    Parameters
    ----------
    design : Design
    exact : bool
        Modes of every rig and configuration by themselves, instead of within a basis that all of them share: slower, see the README.
    """

    def __init__(self, design: Design, *, exact: bool = False) -> None:
        self.design = design
        self.air = Air(design)
        self.plate = Plate(design, self.air)
        if not exact:
            basis = Basis(self.plate, self.air)
            self.air, self.plate = basis.air, basis.plate

    def campaign(
        self,
        seed: int,
        jobs: Mapping[str, Sequence[str]],
        folder: Path,
        record: Path,
        *,
        retorque: float | None = None,
        scatter: Scatter | None = None,
    ) -> dict[str, float]:
        """Draw a rig and measure it.

        Parameters
        ----------
        seed : int
            Draws the rig, how its bolts settle, the noise, and what drifts; apart from each other.
        jobs : mapping of str to names of bolts
            What is removed.
        folder : Path
            For the measurements, ``JOB.uff``.
        record : Path
            What was drawn, as JSON.
        retorque : float or None
            Standard deviation of the logarithm of the tight bolts' patches from job to job; None: that of the design's rigs.
        scatter : Scatter or None
            Drift between jobs; None: none.

        Returns
        -------
        dict
            Mean coherence of each job.
        """
        folder.mkdir(parents=True, exist_ok=True)
        rng_rig, rng_settling, rng_noise, rng_drift = (np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(4))
        perturbations = Perturbations.draw(self.design, rng_rig)
        if retorque is not None:
            perturbations = replace(perturbations, settling=retorque)
        rig = Rig(self.plate, self.air, perturbations)
        chain = Chain()
        documents: dict[str, object] = {}
        coherences = {}
        for job, removed in jobs.items():
            factors = rig.factors(list(removed), rng_settling)
            drift = (scatter or Scatter()).draw(list(self.design.microphones), rng_drift)
            frfs = rig.frfs(factors, drift, FREQUENCIES)
            estimate, coherence = chain.measure(frfs, FREQUENCIES, rng_noise)
            header = Header(f"{self.design.title} {job}", chain.hits, dict.fromkeys(self.design.microphones, "hammer"))
            write_uff(folder / f"{job}.uff", header, FREQUENCIES, estimate, coherence)
            documents[job] = {"removed": list(removed), "patch_factors": {name: round(value, 4) for name, value in factors.items()}}
            if scatter is not None:
                documents[job] |= {"drift": drift.as_dict()}
            coherences[job] = float(coherence.mean())
        text = json.dumps({"seed": seed, "perturbations": perturbations.as_dict(), "jobs": documents}, indent=1)
        record.write_text(text + "\n", encoding="utf-8", newline="\n")
        return coherences
