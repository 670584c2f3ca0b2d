"""``lrbc plan``: predicts from the model which bolts the planned sensors and hammer points can detect; no measurement is needed.

Rehearsals (``rehearsal``) give the verdicts, linearised figures (``updating/posterior/information``) the contribution of each response.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np

from lrbc_cli.arrays import Complexes, Floats, Integers
from lrbc_cli.campaign.identification.nuisances import nuisances_of
from lrbc_cli.campaign.identification.unknowns import parameterise, theta_of
from lrbc_cli.campaign.jobs.finished import calibration_record
from lrbc_cli.campaign.planning.draws import Rehearsed, draws_for
from lrbc_cli.campaign.planning.patches import Structure
from lrbc_cli.campaign.planning.rehearsal import Rehearsal, assumptions, rehearse, threshold
from lrbc_cli.campaign.planning.worth import Prospect, Target, judged, tightened
from lrbc_cli.campaign.reading.inputs import Inputs
from lrbc_cli.campaign.reduced.stage import FrfSource, ReductionStage, frf_source, obtain_reduction
from lrbc_cli.campaign.simulate import job_values
from lrbc_cli.config.settings import EveryLine, ListedLines
from lrbc_cli.errors import ConfigError
from lrbc_cli.model.terms import Parameterisation
from lrbc_cli.reduction.steps.grid import band_lines
from lrbc_cli.results.job import Certificate, Job, JobRecord, Lines, Provenance
from lrbc_cli.results.plan import PlannedNoise, PlannedNuisance, PlanRecord, PlanSeconds, VisibilityLimits
from lrbc_cli.results.store import read_job, versions
from lrbc_cli.updating.checked import Checked, CountOrNone, Positive
from lrbc_cli.updating.misfit.cost import penalty_rows
from lrbc_cli.updating.misfit.frf import Sensitive
from lrbc_cli.updating.misfit.nuisances import Nuisance
from lrbc_cli.updating.posterior.information import DETECTABLE, FACTOR, HIDDEN, LOSS, LOSSES, SIGMA_DB, Experiment, Unknowns, experiment
from lrbc_cli.updating.statistics.lines import resonance_lines
from lrbc_cli.updating.statistics.noise import Noise
from lrbc_cli.updating.statistics.thinning import thinned
from lrbc_cli.updating.unknowns.places import foot
from lrbc_cli.updating.unknowns.shapes import Shapes, bolt_shapes, joints_of, node_shapes

#: Least and largest number of lines over the band; 1 Hz apart within these limits.
LINES = (200, 2000)


@dataclass(frozen=True)
class PlanState:
    """State about which is planned: ``initial``, ``clamped``, ``free``, or the result of a job."""

    kind: Literal["initial", "clamped", "free", "job"]
    job: str | None = None

    @classmethod
    def parse(cls, text: str) -> PlanState:
        """State from the text on the command line; ``job:NAME`` for a job.

        Raises
        ------
        ConfigError
            If there is no such state.
        """
        for kind in ("initial", "clamped", "free"):
            if text == kind:
                return cls(kind)
        name, colon, job = text.partition(":")
        if name != "job" or not colon:
            raise ConfigError("no such state", place=f"--state {text}", expected="initial, clamped, free or job:NAME", found=text)
        return cls("job", job)

    @property
    def text(self) -> str:
        """The state as on the command line."""
        return self.kind if self.job is None else f"job:{self.job}"

    @property
    def words(self) -> str:
        """The state in words."""
        known = {"initial": "the start values of the campaign", "clamped": "the upper bounds", "free": "the lower bounds"}
        return known[self.kind] if self.job is None else f"the result of job {self.job}"


@dataclass(frozen=True, kw_only=True)
class About:
    """State about which is planned: theta, noise of a line and its source; why nothing would be judged, or validated."""

    state: PlanState
    theta: Floats
    noise: Noise
    origin: str
    doubt: str = ""
    unvalidated: str = ""

    @property
    def tightened(self) -> bool:
        """Whether the bolts of a free structure are tightened, instead of tight ones loosened."""
        return self.state.kind == "free"


@dataclass(frozen=True, kw_only=True)
class Request(Checked):
    """Options of the command line.

    Attributes
    ----------
    state : str or None
        ``initial``, ``clamped``, ``free`` or ``job:NAME``; None: the reference job's result if there is one, else the start values.
    noise_db : float or None
        Standard deviation of a line [dB].
    by : str
        ``auto``, ``bolts`` or ``values``.
    draws : int or None
        Rehearsals of each bolt and loss; None: see ``draws_for``; 0: linearised figures only.
    seed : int
        Of the random numbers.
    """

    state: str | None = None
    noise_db: Positive | None = None
    by: Literal["auto", "bolts", "values"] = "auto"
    draws: CountOrNone | None = None
    seed: CountOrNone = 0


def make_plan(
    inputs: Inputs, folder: Path, request: Request, *, accept: bool = False, progress: Callable[[str], None] = lambda _: None
) -> PlanRecord:
    """Plan of a campaign: detectability of its bolts, and contributions of its responses.

    Parameters
    ----------
    inputs : Inputs
    folder : Path
        Folder of the cache of reduced models.
    request : Request
    accept : bool
        Accept a reduced model that misses its tolerance.
    progress : callable

    Returns
    -------
    PlanRecord
        Content of ``plan.json``.

    Raises
    ------
    ConfigError, DataError
        If the state or the lines do not exist, or nothing can be loosened.
    """
    begin = time.perf_counter()
    stage = obtain_reduction(inputs, folder, accept=accept, progress=progress)
    ready = time.perf_counter()
    source, grid = frf_source(inputs, stage, progress), _grid(inputs)
    parameters, _ = parameterise(inputs, source, 2j * np.pi * grid)
    about = _about(inputs, parameters, request)
    shapes, by = _shapes(inputs, parameters, request.by)
    question = _Question(
        source=source, parameters=parameters, grid=grid, about=about, shapes=shapes, targets=tuple(_targets(inputs, parameters, shapes, by))
    )
    asked = [question.experiment(loss if about.tightened else -loss) for loss in LOSSES]
    felt = [(loss, np.flatnonzero(found.change).tolist()) for loss, found in zip(LOSSES, asked, strict=True)]
    cases = [(n, loss) for loss, places in felt for n in places if by == "bolts" and not about.tightened]
    draws = draws_for(len(cases), request.draws) if cases else 0
    said = Rehearsed()
    if draws:
        rehearsal = question.rehearsal(request.seed)
        said = rehearse(rehearsal, cases, draws, progress)
        assumes = [f"tight state: {about.state.words}", *assumptions(rehearsal, draws, about.origin)]
    else:
        assumes = [f"state: {about.state.words}", *_linearised(inputs, by, about.tightened, request.draws, joints=shapes.joints_only)]
    every = range(len(question.targets))
    prospects = [
        Prospect(loss, found, [said.loosened.get((n, loss), []) for n in every]) for loss, found in zip(LOSSES, asked, strict=True)
    ]
    judges = by == "bolts" and not about.tightened
    found = judged(inputs, prospects, question.targets, about.doubt, joints=shapes.joints_only if judges else None)
    found["tight"] = tightened(said.tight)
    seconds = PlanSeconds(reduction=ready - begin, plan=time.perf_counter() - ready)
    return _record(question, stage, found, by, draws, assumes, seconds)


@dataclass(frozen=True, kw_only=True)
class _Question:
    """The planned measurement about one state: lines, unknowns, targets, and their linearised or rehearsed detection."""

    source: FrfSource
    parameters: Parameterisation
    grid: Floats
    about: About
    shapes: Shapes
    targets: tuple[Target, ...]

    @cached_property
    def selected(self) -> Integers:
        """Indices of the lines that an identification would use."""
        inputs = self.source.inputs
        model = self.source.model(2j * np.pi * self.grid, self.parameters, responses=inputs.used)
        return _lines(inputs, self.grid, model.frf(self.about.theta))

    @cached_property
    def structure(self) -> Structure:
        """Structure to be measured, in this state."""
        return Structure.of(self.source.inputs, self.parameters, self.about.theta, self.shapes.by_bolt)

    @cached_property
    def nuisances(self) -> tuple[Nuisance, ...]:
        """Nuisance parameters, with gains of all responses."""
        return nuisances_of(self.source.inputs, np.arange(len(self.source.inputs.responses)))

    def experiment(self, change: float) -> Experiment:
        """Linearised experiment with each target changed by ``change`` decades."""
        inputs, s = self.source.inputs, 2j * np.pi * self.grid
        model: Sensitive = self.source.model(s, self.parameters, self.selected)
        if self.nuisances:
            model = self.source.drifting(s[self.selected], self.parameters, self.nuisances)
        structure = self.source.model(s, self.structure.parameters, self.selected)

        def changed(bolt: int) -> tuple[Complexes, float]:
            there, by = self.structure.changed(bolt, change)
            with np.errstate(divide="ignore", invalid="ignore"):
                return structure.frf(there), by

        return experiment(
            model,
            np.concatenate([self.about.theta, np.zeros(len(self.nuisances))]),
            self._unknowns(),
            changed,
            variance=self.about.noise.variance,
            options=inputs.method.residual,
            quantity=[response.quantity for response in inputs.responses],
        )

    def rehearsal(self, seed: int) -> Rehearsal:
        """Rehearsals about this state."""
        return Rehearsal(self.source, self.structure, self.about.noise, self.shapes.joint, self.grid, seed)

    def _unknowns(self) -> Unknowns:
        parameters, shapes, nuisances = self.parameters, self.shapes, self.nuisances
        size, m, k = parameters.size, shapes.T.shape[1], len(nuisances)
        T = np.zeros((size + k, m + k))
        T[:size, :m], T[size:, m:] = shapes.T, np.eye(k)
        prior = np.zeros((m + k, m + k))
        if shapes.by_bolt:
            prior[:m, :m] = np.diag(1.0 / shapes.std**2)
        else:
            rows = penalty_rows(parameters) / self.source.inputs.statistics.values.std
            prior[:m, :m] = rows.T @ rows
        prior[m:, m:] = np.diag([1.0 / nuisance.std**2 for nuisance in nuisances])
        return Unknowns(T, prior, np.array([target.column for target in self.targets], dtype=np.int64))


def _record(
    question: _Question, stage: ReductionStage, found: Mapping[str, Any], by: str, draws: int, assumes: list[str], seconds: PlanSeconds
) -> PlanRecord:
    """Content of ``plan.json``, with the fields that ``judged`` has found."""
    inputs, about = question.source.inputs, question.about
    return PlanRecord(
        format="lrbc-plan",
        version=1,
        campaign=inputs.campaign.name,
        state=about.state.text,
        state_job=about.state.job,
        noise=PlannedNoise(
            sigma_db=about.noise.sigma, correlation_factor=about.noise.factor, coarsening=about.noise.coarsening, source=about.origin
        ),
        losses=LOSSES,
        loss=LOSS,
        tightened=about.tightened,
        unknowns=by,
        prior_std=inputs.statistics.values.std,
        confidence=inputs.method.rule.confidence,
        loose_change=threshold(inputs, question.shapes.joints_only),
        method="rehearsed" if draws else "linearised",
        draws=draws,
        assumes=tuple(assumes),
        identification=inputs.resolved(True).tree(),
        limits=VisibilityLimits(detectable=DETECTABLE, not_detectable=HIDDEN),
        lines=Lines(frequency_hz=question.grid[question.selected], count=question.selected.size),
        nuisances=tuple(PlannedNuisance.like(nuisance) for nuisance in question.nuisances),
        notes=(
            *(["no bolts: every value along the edges stands for itself"] if by == "values" else []),
            *filter(None, [about.doubt, about.unvalidated]),
        ),
        seconds=seconds,
        provenance=Provenance(
            versions=versions(),
            inputs=inputs.hashes,
            configuration=inputs.campaign.resolved(),
            calibration=calibration_record(inputs),
            certificate=Certificate(key=stage.decision.key, size=stage.reduction.model.size, worst=stage.reduction.worst),
        ),
        **found,
    )


def _grid(inputs: Inputs) -> Floats:
    """Lines that would be measured [Hz]: over the band 1 Hz apart within the limits ``LINES``, or those that the settings list."""
    lines, band = inputs.method.lines, inputs.campaign.reduction.band
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
        return band_lines(band)
    return np.linspace(*band, int(np.clip(width, *LINES)))


def _lines(inputs: Inputs, grid: Floats, y: Complexes) -> Integers:
    """Indices of the lines of the grid that an identification would use, by the resonances of the model's FRFs y."""
    lines = inputs.method.lines
    if isinstance(lines, EveryLine):
        return np.arange(0, grid.size, lines.every)
    if isinstance(lines, ListedLines) or lines == "all":
        return np.arange(grid.size)
    rule = inputs.statistics.resonances
    return thinned(grid, y, resonance_lines(grid, y, rule), rule)


def _about(inputs: Inputs, parameters: Parameterisation, request: Request) -> About:
    """State and noise about which is planned; by default the reference job's result if there is one, else the start values."""
    campaign, bounds = inputs.campaign, parameters.bounds
    reference = campaign.update.reference
    state = None if request.state is None else PlanState.parse(request.state)
    theta = parameters.initial
    record: Job | None = None
    if state is not None and state.job is not None:
        inputs.campaign.require_job(state.job, f"--state {request.state}")
        theta = job_values(inputs, state.job, parameters)
        record, source = read_job(campaign.output, state.job), state.job
    elif reference is not None:
        record, source = read_job(campaign.output, reference), reference
        known = theta_of(parameters, record.parameters) if isinstance(record, JobRecord) else None
        if known is None:
            record = None
        elif state is None:
            state, theta = PlanState("job", reference), known
    state = state or PlanState("initial")
    if state.kind in ("clamped", "free"):
        for group, values, _ in parameters.placed:
            if group.kind == "stiffness":
                theta[values] = bounds[values, 1 if state.kind == "clamped" else 0]
    theta = np.clip(theta, bounds[:, 0], bounds[:, 1])
    if record is not None and reference is not None and source != reference:
        # The noise of a relative comparison is far less than the model discrepancy, so it is taken from the reference job.
        record, source = read_job(campaign.output, reference), reference
    noise, origin = Noise(sigma=SIGMA_DB, factor=FACTOR), "assumed"
    if isinstance(record, JobRecord) and record.noise.sigma_db and record.noise.correlation_factor:
        # A fit absorbs part of the model discrepancy; the validation channels show all of it.
        sigma = record.noise.sigma_db * record.noise.validation_ratio
        noise, origin = Noise(sigma=sigma, factor=record.noise.correlation_factor), f"job {source}"
    if request.noise_db is not None and not (np.isfinite(request.noise_db) and request.noise_db > 0):
        raise ConfigError("no noise", place="--noise", expected="a standard deviation above 0, in dB", found=f"{request.noise_db:g}")
    if request.noise_db is not None:
        noise, origin = noise.at(request.noise_db), "--noise"
    noise = replace(noise, coarsening=inputs.statistics.errors.coarsening_of(parameters.of_joints))
    doubt = coarse = ""
    if isinstance(record, JobRecord):
        misfit = record.misfit_db
        if record.status == "unexplained":
            doubt = f"the reference job {source} is unexplained: nothing is judged"
        else:
            coarse = inputs.method.rule.none_validated(misfit.final, misfit.held_out_final)
    return About(state=state, theta=theta, noise=noise, origin=origin, doubt=doubt, unvalidated=coarse)


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
    groups = [(g, at) for g, at, _ in parameters.placed if g.kind == "stiffness"]
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
            (*foot(group.xyz, group.arc_length, xyz), group.name)
            for group, _ in groups
            if group.xyz is not None and group.arc_length is not None
        ]
        at, _, owner = min(feet, key=lambda entry: entry[1], default=(None, 0.0, ""))
        targets.append(Target(name, xyz, owner, at, int(column)))
    return targets


def _linearised(inputs: Inputs, by: str, tightened: bool, draws: int | None, *, joints: bool) -> list[str]:
    """Assumptions of linearised figures, in words."""
    values = inputs.statistics.values
    std, confidence = values.joint_std if joints else values.std, inputs.method.rule.confidence
    if by == "values":
        why = "values along the edges are not judged as bolts"
    elif tightened:
        why = "bolts that are tightened are not judged"
    else:
        why = "--draws 0" if draws == 0 else "no bolt can be loosened"
    return [
        f"linearised, not rehearsed ({why}): `lrbc update` may find less",
        f"normal prior of {std:g} decades; loose below {threshold(inputs, joints):.2g} decades, with {100 * confidence:g} %",
        "no error of the model except the noise, and no drift except what update.nuisances lists",
    ]
