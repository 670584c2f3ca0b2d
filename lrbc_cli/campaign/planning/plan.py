"""What the planned microphones and hammer points can see, from the model alone: nothing has to be measured for it."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lrbc_cli.campaign.identification.unknowns import parameterise, stored_theta
from lrbc_cli.campaign.jobs.results import calibration_tree
from lrbc_cli.campaign.planning.rehearsal import DRAWS, Draw, Rehearsal, Setting, assumptions, reference_measurement, rehearse, threshold
from lrbc_cli.campaign.planning.worth import Target, judged
from lrbc_cli.campaign.reading.drift import drift_extras
from lrbc_cli.campaign.reading.inputs import Inputs
from lrbc_cli.campaign.reduced.stage import FrfSource, affine_model, cheaper_formula, obtain_reduction
from lrbc_cli.campaign.simulate import job_values, parse_lines
from lrbc_cli.config.settings import EveryLine, ListedLines
from lrbc_cli.errors import ConfigError
from lrbc_cli.model.terms import Parameterisation
from lrbc_cli.results.job import Job, JobRecord
from lrbc_cli.results.plan import PlanRecord
from lrbc_cli.results.store import read_job, versions, write
from lrbc_cli.results.tables import write_csv
from lrbc_cli.updating.extended import ExtendedFrf, Extra
from lrbc_cli.updating.information import BLIND, FACTOR, LOOSENING, SEEN, SIGMA_DB, distance_for, experiment
from lrbc_cli.updating.lines import resonance_lines
from lrbc_cli.updating.misfit import Sensitive, penalty_rows
from lrbc_cli.updating.noise import Noise
from lrbc_cli.updating.shapes import Shapes, bolt_shapes, joints_of, node_shapes
from lrbc_cli.updating.verdicts import Edge, foot

Floats = NDArray[np.float64]

STATES = ("initial", "clamped", "free")

#: Lines of 1 Hz, but not fewer nor more than these over the band.
LINES = (200, 2000)


@dataclass(frozen=True)
class Request:
    """What the command line asks for.

    Attributes
    ----------
    state : str or None
        ``initial``, ``clamped``, ``free`` or ``job:NAME``; None: the reference job's result where there is one, else the start values.
    noise : float or None
        Standard deviation of a line [dB].
    by : str
        ``auto``, ``bolts`` or ``values``.
    draws : int
        Rehearsals of each bolt; 0: linearised figures only.
    """

    state: str | None = None
    noise: float | None = None
    by: str = "auto"
    draws: int = DRAWS


def make_plan(
    inputs: Inputs, folder: Path, request: Request, *, accept: bool = False, progress: Callable[[str], None] = lambda _: None
) -> PlanRecord:
    """Say what the responses of a campaign can tell of its bolts.

    Parameters
    ----------
    inputs : Inputs
    folder : Path
        Of the cache.
    request : Request
    accept : bool
        Accept a reduced model that misses its tolerance.
    progress : callable

    Returns
    -------
    PlanRecord
        The content of ``plan.json``.

    Raises
    ------
    ConfigError, DataError
        Where the state or the lines cannot be had, or nothing can be loosened.
    """
    begin = time.perf_counter()
    stage = obtain_reduction(inputs, folder, accept=accept, progress=progress)
    ready = time.perf_counter()
    source = FrfSource(inputs, stage, cheaper_formula(inputs, stage), progress)
    update = inputs.campaign.update
    grid = _grid(inputs)
    s = 2j * np.pi * grid
    parameters, _ = parameterise(inputs, source, s)
    state, theta, noise, origin = _state(inputs, parameters, request)
    shapes, by = _shapes(inputs, parameters, request.by)
    targets = _targets(inputs, parameters, shapes, by)
    selected = _lines(inputs, grid, source.model(s, parameters, responses=inputs.used).frf(theta))
    every = np.arange(len(inputs.responses))
    extras = drift_extras(inputs, update.nuisances, every)
    model: Sensitive
    if extras:
        model = ExtendedFrf(affine_model(inputs, stage), s[selected], parameters, extras, every)
    else:
        model = source.model(s, parameters, selected)
    T, prior, bounds = _unknowns(inputs, parameters, shapes, extras, by)
    change = LOOSENING if state == "free" else -LOOSENING
    found = experiment(
        model,
        np.concatenate([theta, np.zeros(len(extras))]),
        T,
        prior,
        np.array([target.column for target in targets], dtype=np.int64),
        bounds,
        change=change,
        variance=noise.variance,
        options=inputs.method.residual,
        quantity=[response.quantity for response in inputs.responses],
        planned=inputs.used,
    )
    wanted = [(n, target.column) for n, target in enumerate(targets) if found.change[n]]
    draws: dict[int, list[Draw]] = {}
    if by == "bolts" and change < 0 and request.draws > 0 and wanted:
        measured = reference_measurement(inputs)
        lines = grid if measured is None else measured.frequency_hz
        rehearsal = Rehearsal(inputs, source, lines, Setting(theta, noise, shapes, change, measured))
        draws = rehearse(rehearsal, wanted, request.draws, progress)
        assumes = [f"tight state: {_words(state)}", *assumptions(rehearsal, request.draws, origin)]
    else:
        assumes = [f"state: {_words(state)}", *_linearised(inputs, by, change, request.draws)]
    tree = {
        "campaign": inputs.campaign.name,
        "state": state,
        "noise": {"sigma_db": noise.sigma, "correlation_factor": noise.factor, "source": origin},
        "change": change,
        "unknowns": by,
        "prior_std": inputs.statistics.values.std,
        "confidence": update.confidence,
        "loose_change": threshold(inputs),
        "method": "rehearsed" if draws else "linearised",
        "draws": request.draws if draws else 0,
        "assumes": assumes,
        "identification": inputs.resolved(True).tree(),
        "limits": {
            word: {"probability": value, "d_prime": distance_for(value, update.confidence)}
            for word, value in (("seen", SEEN), ("blind", BLIND))
        },
        "lines": {"count": int(selected.size), "frequency_hz": grid[selected]},
        "nuisances": [{"kind": e.kind, "name": e.name, "std": e.std} for e in extras],
        **judged(inputs, found, targets, draws),
        "notes": _notes(by),
        "seconds": {"reduction": ready - begin, "plan": time.perf_counter() - ready},
        "provenance": {
            "versions": versions(),
            "inputs": inputs.hashes,
            "configuration": inputs.campaign.resolved(),
            "calibration": calibration_tree(inputs),
            "certificate": {"key": stage.decision.key, "size": stage.reduction.model.size, "worst": stage.reduction.worst},
        },
    }
    return PlanRecord.checked(tree)


def _grid(inputs: Inputs) -> Floats:
    """Lines of the band, as they would be measured: 1 Hz apart, or those that the settings list."""
    lines, band = inputs.campaign.update.lines, inputs.campaign.reduction.band
    if isinstance(lines, ListedLines):
        listed = np.unique(np.array(lines.frequencies, dtype=float))
        outside = (listed < band[0] * (1 - 1e-9)) | (listed > band[1] * (1 + 1e-9))
        if outside.any():
            raise inputs.campaign.error(
                "a listed line lies outside the band of the reduced model",
                "update",
                "lines",
                "list",
                expected=f"{band[0]:g} to {band[1]:g} Hz",
                found=", ".join(f"{f:g} Hz" for f in listed[outside][:5]),
            )
        return listed
    width = band[1] - band[0]
    if LINES[0] <= width <= LINES[1]:
        return parse_lines(None, band)
    return np.linspace(*band, int(np.clip(width, *LINES)))


def _lines(inputs: Inputs, grid: Floats, y: NDArray[np.complexfloating[Any, Any]]) -> NDArray[np.int64]:
    """Those of the grid that an identification would use; resonances are the model's own."""
    lines = inputs.campaign.update.lines
    if isinstance(lines, EveryLine):
        return np.arange(0, grid.size, lines.every)
    return (
        np.arange(grid.size) if isinstance(lines, ListedLines) or lines == "all" else resonance_lines(grid, y, inputs.statistics.resonances)
    )


def _state(inputs: Inputs, parameters: Parameterisation, request: Request) -> tuple[str, Floats, Noise, str]:
    """Name and theta of the state about which is asked; the noise, and where it is from."""
    campaign = inputs.campaign
    reference = campaign.update.reference
    job = request.state.removeprefix("job:") if request.state is not None and request.state.startswith("job:") else None
    theta = parameters.initial
    bounds = parameters.bounds
    record: Job | None = None
    if job is not None:
        theta = job_values(inputs, job, parameters)
        record = read_job(campaign.output, job)
        state = f"job:{job}"
    elif request.state is None or request.state in STATES:
        record = read_job(campaign.output, reference) if reference is not None else None
        known = stored_theta(parameters, record if isinstance(record, JobRecord) else None)
        record = None if known is None else record
        state = request.state or ("initial" if known is None else f"job:{reference}")
        if request.state is None and known is not None:
            theta = known
        job = reference
    else:
        raise ConfigError(
            "no such state", place=f"--state {request.state}", expected="initial, clamped, free or job:NAME", found=request.state
        )
    if state in ("clamped", "free"):
        for group, (values, _) in zip(parameters.groups, parameters.slices, strict=True):
            if group.kind == "stiffness":
                theta[values] = bounds[values, 1 if state == "clamped" else 0]
    theta = np.clip(theta, bounds[:, 0], bounds[:, 1])
    if record is not None and reference is not None and job != reference:
        # A job that is compared states what its changes leave, which is far less than the model discrepancy.
        job, record = reference, read_job(campaign.output, reference)
    noise, origin = Noise(SIGMA_DB, FACTOR), "assumed"
    if isinstance(record, JobRecord) and record.noise.sigma_db and record.noise.correlation_factor:
        noise, origin = Noise(record.noise.sigma_db, record.noise.correlation_factor), f"job {job}"
    if request.noise is not None and not (np.isfinite(request.noise) and request.noise > 0):
        raise ConfigError("no noise", place="--noise", expected="a standard deviation above 0, in dB", found=f"{request.noise:g}")
    if request.noise is not None:
        noise, origin = Noise(request.noise, noise.factor), "--noise"
    return state, theta, noise, origin


def _shapes(inputs: Inputs, parameters: Parameterisation, by: str) -> tuple[Shapes, str]:
    values = inputs.statistics.values
    if by != "values" and inputs.bolts is not None:
        found = bolt_shapes(parameters, inputs.bolts.xyz, values, inputs.statistics.bolts)
        if (found.bolts >= 0).any():
            return found, "bolts"
    if by == "bolts":
        raise ConfigError(
            "there are no bolts that own terms or lie along an edge",
            file=inputs.campaign.path,
            place="--by bolts",
            expected="bolts: file, and a stiffness group with positions, or a column `bolt` beside its terms",
            hint="use --by values",
        )
    return node_shapes(parameters, values.std), "values"


def _targets(inputs: Inputs, parameters: Parameterisation, shapes: Shapes, by: str) -> list[Target]:
    groups = [(g, at) for g, (at, _) in zip(parameters.groups, parameters.slices, strict=True) if g.kind == "stiffness"]
    if by == "values":
        targets = [
            Target(
                f"{group.name}[{k}]",
                None if group.xyz is None else group.xyz[k],
                group.name,
                None if group.arc_length is None else float(group.arc_length[k]),
                values.start + k,
            )
            for group, values in groups
            for k in range(group.count)
        ]
        if not targets:
            raise inputs.campaign.error("no stiffness that could be loosened", "parameters", expected="a group of kind stiffness")
        return targets
    assert inputs.bolts is not None
    targets = []
    own = joints_of(parameters, len(inputs.bolts.name))
    for name, xyz, column, parts in zip(inputs.bolts.name, inputs.bolts.xyz, shapes.bolts, own, strict=True):
        if parts:
            targets.append(Target(name, xyz, ", ".join(parameters.groups[i].name for i in parts), None, int(column)))
            continue
        feet = [
            (*foot(Edge(group.xyz, group.arc_length, np.zeros(group.count), np.inf, None), xyz), group.name)
            for group, _ in groups
            if group.xyz is not None and group.arc_length is not None
        ]
        at, _, owner = min(feet, key=lambda entry: entry[1], default=(None, 0.0, ""))
        targets.append(Target(name, xyz, owner, at, int(column)))
    return targets


def _unknowns(
    inputs: Inputs, parameters: Parameterisation, shapes: Shapes, extras: tuple[Extra, ...], by: str
) -> tuple[Floats, Floats, Floats]:
    """Map from the unknowns to theta, their precision beforehand, and the bounds of theta."""
    size, m, k = parameters.size, shapes.T.shape[1], len(extras)
    T = np.zeros((size + k, m + k))
    T[:size, :m], T[size:, m:] = shapes.T, np.eye(k)
    prior = np.zeros((m + k, m + k))
    if by == "bolts":
        prior[:m, :m] = np.diag(1.0 / shapes.std**2)
    else:
        rows = penalty_rows(parameters) / inputs.statistics.values.std
        prior[:m, :m] = rows.T @ rows
    prior[m:, m:] = np.diag([1.0 / extra.std**2 for extra in extras])
    return T, prior, np.vstack([parameters.bounds, np.array([extra.bounds for extra in extras]).reshape(-1, 2)])


def _words(state: str) -> str:
    known = {"initial": "the start values of the campaign", "clamped": "the upper bounds", "free": "the lower bounds"}
    return known.get(state, f"the result of job {state.removeprefix('job:')}")


def _linearised(inputs: Inputs, by: str, change: float, draws: int) -> list[str]:
    """What figures assume that no rehearsal stands behind."""
    update, std = inputs.campaign.update, inputs.statistics.values.std
    if by == "values":
        why = "values along the edges are not bolts that it judges"
    elif change > 0:
        why = "it judges no bolts that are tightened"
    else:
        why = "--draws 0" if draws < 1 else "no bolt can be loosened"
    return [
        f"linearised, not rehearsed ({why}): `lrbc update` may find less",
        f"normal prior of {std:g} decades; loose below {threshold(inputs):g} decades, with {100 * update.confidence:g} %",
        "the model is right but for the noise, and nothing drifts but what update.nuisances names",
    ]


def _notes(by: str) -> list[str]:
    notes = []
    if by == "values":
        notes.append("no bolts: every value along the edges stands for itself")
    return notes


COLUMNS = (
    "name",
    "group",
    "x",
    "y",
    "z",
    "arc_length_m",
    "verdict",
    "d_prime",
    "probability_correct",
    "std",
    "lower95",
    "upper95",
    "variance_removed",
    "change",
    "expected_change",
    "expected_probability_loose",
    "d_prime_all_responses",
    "note",
)


def write_plan(output: Path, record: PlanRecord) -> None:
    """Write ``plan.csv`` and ``plan.json``.

    Raises
    ------
    ConfigError
        Where the output folder cannot be written.
    """
    rows = []
    for bolt in record.bolts:
        position = [None] * 3 if bolt.position is None else list(bolt.position)
        plain = [getattr(bolt, key) for key in COLUMNS[6:16]]
        rows.append([bolt.name, bolt.group, *position, bolt.arc_length, *plain, bolt.all_responses.d_prime, bolt.note])
    write_csv(output / "plan.csv", COLUMNS, rows)
    write(output / "plan.json", record)
