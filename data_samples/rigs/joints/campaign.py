"""A campaign of a design: its file, what is measured, and what was drawn for it."""

from __future__ import annotations

import json
import os
from dataclasses import asdict
from pathlib import Path

import numpy as np

from lrbc_cli.virtual.chain import Chain
from lrbc_cli.virtual.drift import Scatter
from rigs.campaign import nuisances_text
from rigs.joints.design import JointDesign, Place
from rigs.joints.nominal import groups
from rigs.joints.truth import Rig, State, draw_state
from rigs.uff import ACCELERATION, Header, write_uff

REFERENCE, BASELINE = "tight", "tight-2"


def jobs_of(design: JointDesign) -> dict[str, int]:
    """How many joints are loose in each job; no name tells."""
    return {REFERENCE: 0, BASELINE: 0} | {f"state-{k + 1}": count for k, count in enumerate(design.loosened)}


def chain_of(design: JointDesign) -> Chain:
    """A hammer tip whose pulse reaches the end of the band."""
    return Chain(duration=1.1 / design.band[1])


def measure_campaign(design: JointDesign, seed: int, folder: Path, *, retorque: float, scatter: Scatter) -> dict[str, State]:
    """Draw a rig and measure it: ``frf/JOB.uff`` and ``truth.json``.

    Parameters
    ----------
    design : JointDesign
    seed : int
        Draws the specimen, the states, the noise and what drifts; apart from each other.
    folder : Path
    retorque : float
        Standard deviation of the log stiffness of every joint from job to job.
    scatter : Scatter
        Drift between jobs.

    Returns
    -------
    dict
        The states by job.
    """
    (folder / "frf").mkdir(parents=True, exist_ok=True)
    rng_rig, rng_state, rng_noise, rng_drift = (np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(4))
    specimen = design.draw(rng_rig)
    rig, chain, responses = Rig(design, specimen), chain_of(design), design.responses
    states: dict[str, State] = {}
    documents: dict[str, object] = {}
    for job, count in jobs_of(design).items():
        states[job] = state = draw_state(design, specimen, count, retorque, rng_state)
        drift = scatter.draw(list(design.sensors), rng_drift)
        frfs = rig.frfs(state, drift, design.frequencies) * drift.gains(list(design.sensors))
        measured = [chain.measure(frfs[:, k], design.frequencies, rng_noise) for k in range(len(design.hammers))]
        estimate, coherence = (np.concatenate(parts, axis=1) for parts in zip(*measured, strict=True))
        header = Header(f"{design.title} {job}", chain.hits, {name: hammer for name, (hammer, _) in responses.items()}, ACCELERATION)
        write_uff(folder / "frf" / f"{job}.uff", header, design.frequencies, estimate, coherence)
        before = states[REFERENCE].log10
        documents[job] = {
            "loose": list(state.loss),
            "lost": dict(state.loss),
            "change": {name: round(value - before[name], 4) for name, value in state.log10.items()},
            "components": dict(state.spread),
            "drift": drift.as_dict(),
        }
    text = json.dumps({"seed": seed, "design": design.name, "specimen": asdict(specimen), "jobs": documents}, indent=1)
    (folder / "truth.json").write_text(text + "\n", encoding="utf-8", newline="\n")
    return states


def _group_lines(design: JointDesign, model: str, group: str) -> list[str]:
    return [
        f"  {group}:                                # log10 of the stiffness over that of the table",
        "    kind: stiffness",
        f"    select: {{bushings: {model}/bushings-{group}.csv}}",
        "    initial: 0.0",
        "    bounds: [-4.0, 1.5]",
        f"    damping: {{initial: 0.0, bounds: [-3.0, 4.0], beta: {design.proportional[1]:.4g}}}",
    ]


def campaign_text(design: JointDesign, name: str, model: str, scatter: Scatter) -> str:
    """The campaign file; `model` is the model's folder relative to it."""
    system = design.system(None)

    def point(place: Place) -> str:
        dof = int(np.flatnonzero(design.row(system, place, true=False))[0])
        return f"near: [{', '.join(f'{round(float(v), 7) + 0.0:g}' for v in system.xyz[dof])}], component: {place.component}"

    alpha, beta = design.proportional
    used = [name for name, (_, sensor) in design.responses.items() if sensor not in design.held_out]
    nuisances = nuisances_text(Scatter(kelvin=0.0, hammer=scatter.hammer, gain=scatter.gain))
    several = design.parts > 1
    factors = ["stiffness.structure", "mass.structure", "alpha.structure", "beta.structure"]
    lines = [
        f"# {design.title}: a virtual rig, measured. What was drawn for it stands in truth.json, which is not read.",
        "",
        f"campaign: {name}",
        "output: output",
        "",
        "model:",
        f"  stiffness: {model}/model.h5#K",
        f"  mass: {model}/model.h5#M",
        f"  damping: {{structure: {{alpha: {alpha:.4g}, beta: {beta:.4g}}}}}",
        f"  dofs: {model}/dofs.csv",
        "",
        "excitation:",
        *(f"  {hammer}: {{{point(place)}}}" for hammer, place in design.hammers.items()),
        "",
        "responses:",
        *(
            f"  {response}: {{{point(design.sensors[sensor])}, quantity: acceleration, excitation: {hammer}}}"
            for response, (hammer, sensor) in design.responses.items()
        ),
        "",
        "parameters:",
        *(line for group in groups(design) for line in _group_lines(design, model, group)),
        "",
        f"bolts: {model}/bolts.csv",
        "",
        f"reduction: {{band: [{design.band[0]:g}, {design.band[1]:g}], tolerance: 1.0e-3}}",
        "",
        "update:",
        f"  reference: {REFERENCE}",
        f"  baselines: [{BASELINE}]",
        f"  responses: [{', '.join(used)}]",
        "  lines: resonances",
        "  loss: soft",
        "  loss_scale: 1.0",
        *([f"  nuisances: {{{nuisances}}}"] if nuisances else []),
        "",
        "calibration:",
        f"  job: {REFERENCE}",
        f"  factors: [{', '.join(factors)}]",
        *(["  groups:"] if several else []),
        *(f"    part_{part + 1}: {{stiffness: {model}/model.h5#K_{part + 1}}}" for part in range(1, design.parts)),
        "",
        "jobs:",
        *(f"  {job}: {{frf: frf/{job}.uff}}" for job in jobs_of(design)),
    ]
    return "\n".join(lines) + "\n"


def write_campaign(design: JointDesign, folder: Path, model: Path, scatter: Scatter) -> None:
    """Write ``campaign.yaml`` into a folder."""
    try:
        where = Path(os.path.relpath(model.resolve(), folder.resolve())).as_posix()
    except ValueError:  # another drive
        where = model.resolve().as_posix()
    text = campaign_text(design, f"{design.name}-{folder.resolve().name}", where, scatter)
    (folder / "campaign.yaml").write_text(text, encoding="utf-8", newline="\n")
