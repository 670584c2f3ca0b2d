"""``lrbc calibrate``: identifies global factors of the model from one job, and reduces again at these factors if the error is too large."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from lrbc_cli.arrays import Complexes, Floats, Integers
from lrbc_cli.campaign.calibration import fitting, key_parts, measured
from lrbc_cli.campaign.digests import CALIBRATION_FILE as FILE
from lrbc_cli.campaign.digests import key_of
from lrbc_cli.campaign.identification.compared.doubts import calibration_doubts, refuse_units
from lrbc_cli.campaign.identification.gains import Gains, columns_of, gains_of, kept, none_shown
from lrbc_cli.campaign.identification.nuisances import gain_tree, hits_of
from lrbc_cli.campaign.identification.records import Measurement, read_measurement
from lrbc_cli.campaign.identification.unknowns import parameterise, select_lines
from lrbc_cli.campaign.identification.weights import left_out, line_sigma, ratio_of, without_noise
from lrbc_cli.campaign.jobs.finished import frf_rows, misfit_record
from lrbc_cli.campaign.jobs.results import write_campaign
from lrbc_cli.campaign.reading.inputs import Inputs
from lrbc_cli.campaign.reduced.stage import FrfSource, ReductionStage, affine_model, frf_source, obtain_reduction
from lrbc_cli.errors import NumericalError
from lrbc_cli.io.atomic import changed_meanwhile, together
from lrbc_cli.model.factors import with_factors
from lrbc_cli.reduction.outcome import HeldOut
from lrbc_cli.reduction.steps.certify import lines_between, measured_errors
from lrbc_cli.reduction.threads import single_threaded
from lrbc_cli.results.job import Lines, NoiseRecord, Provenance
from lrbc_cli.results.model import Boundary, CalibrationRecord, Factor, FactorCertificate, HeldOutRecord, RoundRecord, StageRecord
from lrbc_cli.results.store import unwritable, versions, write_sealed
from lrbc_cli.results.tables import write_csv
from lrbc_cli.updating.calibration.calibrate import FactorFit, FactorProblem, fit_factors
from lrbc_cli.updating.calibration.far import far_factors
from lrbc_cli.updating.misfit.cost import mean_misfit
from lrbc_cli.updating.statistics.decibels import decibel

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Round:
    """One reduced model, and the factors identified with it.

    Attributes
    ----------
    misfit_db : float
        Mean misfit over all lines of the responses used [dB].
    factors : dict
    held_out : tuple of HeldOut
        Errors of the reduced model at these factors.
    size : int
    """

    misfit_db: float
    factors: dict[str, float]
    held_out: tuple[HeldOut, ...]
    size: int

    @property
    def error(self) -> float:
        """Largest relative error of the reduced model at these factors."""
        return max(line.worst for line in self.held_out)


@dataclass(frozen=True, kw_only=True)
class CalibrationOutcome:
    """Result of a calibration.

    Attributes
    ----------
    fit : FactorFit
    rounds : tuple of Round
    measurement : Measurement
    compared : (F, R) complex array
        Measured values without those that are mostly noise.
    selected : int array
        Lines that entered the cost.
    initial, updated : (F, R) complex arrays
        FRFs of the model before and after, on all measured lines.
    reached : bool
        Whether the error at the factors is within the tolerance.
    notes : tuple of str
    seconds : dict
    warnings : tuple of str
        Notes that the user has to act on.
    """

    fit: FactorFit
    rounds: tuple[Round, ...]
    measurement: Measurement = field(repr=False)
    compared: Complexes = field(repr=False)
    selected: Integers = field(repr=False)
    initial: Complexes = field(repr=False)
    updated: Complexes = field(repr=False)
    reached: bool
    notes: tuple[str, ...]
    seconds: dict[str, float]
    warnings: tuple[str, ...] = ()


def run_calibration(
    inputs: Inputs, folder: Path, *, force: bool = False, accept: bool = False, progress: Callable[[str], None] = lambda _: None
) -> tuple[CalibrationRecord, bool]:
    """Calibrate, or keep a stored calibration that is up to date; writes ``calibration.json`` and ``calibration/frf.csv``.

    Parameters
    ----------
    inputs : Inputs
        With the model as exported, without an earlier calibration.
    folder : Path
        Folder of the cache of reduced models.
    force : bool
        Calibrate again even if nothing changed.
    accept : bool
        Accept a reduced model that misses its tolerance.
    progress : callable

    Returns
    -------
    CalibrationRecord
        Content of ``calibration.json``.
    bool
        Whether a stored calibration was kept.

    Raises
    ------
    ConfigError
        If the campaign has no calibration.
    DataError
        If the measurement is unusable, or changed during the run.
    NumericalError
        If the optimisation fails; an earlier calibration stays.
    """
    settings = require_calibration(inputs)
    stored = fitting(inputs).record
    output = inputs.campaign.output
    if stored is not None and not force and (output / "calibration" / "frf.csv").is_file():
        return stored, True
    parts = key_parts(inputs)
    outcome = calibrate(inputs, folder, accept=accept, progress=progress)
    if measured(inputs, lambda file: outcome.measurement.hashes.get(file.as_posix())) != parts["measurement"]:
        raise changed_meanwhile(inputs.campaign.jobs[settings.job].first)
    table = frf_rows(inputs, outcome.measurement, outcome.selected, outcome.initial, outcome.updated)
    try:
        with together():
            write_csv(output / "calibration" / "frf.csv", *table)
            record = write_sealed(output / FILE, calibration_record(inputs, outcome, parts, settings.job))
    except OSError as error:
        raise unwritable(output / FILE, error) from error
    # Results of jobs stay as they are, but the report needs the record of the campaign.
    if not (output / "campaign.json").is_file():
        write_campaign(output, inputs)
    return record, False


def require_calibration(inputs: Inputs) -> Any:
    """The section ``calibration`` of the campaign file.

    Raises
    ------
    ConfigError
        If there is none.
    """
    settings = inputs.campaign.calibration
    if settings is None:
        raise inputs.campaign.error(
            "this campaign has no block 'calibration'",
            expected="calibration: {job: NAME, factors: [...]}",
            hint="`lrbc init` writes a commented example; `lrbc guide calibration` lists the names of factors",
        )
    return settings


def calibrate(
    inputs: Inputs, folder: Path, *, accept: bool = False, progress: Callable[[str], None] = lambda _: None, most: int = 4
) -> CalibrationOutcome:
    """Identify the factors, measure the error of the reduced model at them, and repeat with a new reduced model if it is too large.

    Each reduced model is built at the factors of the round before, in at most ``most`` rounds. Parameters as of ``run_calibration``.
    """
    settings, tolerance = require_calibration(inputs), inputs.campaign.reduction.tolerance
    measurement = read_measurement(inputs, inputs.campaign.jobs[settings.job], settings.job)
    for warning in measurement.warnings:
        log.warning("job %s: %s", settings.job, warning)
    compared = without_noise(inputs, settings.job, measurement, known=True)
    watch = _Watch()
    stage = obtain_reduction(inputs, folder, accept=accept, progress=progress)
    watch.lap("reduction")
    problem, notes = first_problem(frf_source(inputs, stage, progress), measurement)
    s, everything = 2j * np.pi * measurement.frequency_hz, np.arange(len(inputs.responses))
    initial = problem.frf(s, everything).frf(problem.start)
    refuse_units(inputs, measurement, initial, settings.job)
    theta: Floats | None = None
    rounds: list[Round] = []
    now = inputs

    def tell(text: str) -> None:
        progress(f"calibration from {settings.job}: fitting the factors, round {len(rounds) + 1}: {text}")

    problem = replace(problem, progress=tell)
    while True:
        tell("begins")
        fit = _fitted(inputs, problem, theta)
        watch.lap("fit")
        problem, gains = fit.problem, _gains(inputs, fit)
        plain = problem.frf(s, everything).frf(fit.solution.theta)
        updated = plain * (1.0 if gains is None else gains.factors(inputs))
        model, recipe = with_factors(inputs.model, inputs.recipe, fit.factors)
        relative = problem.frf(s).effects(fit.solution.theta).factors
        held_out = _errors(replace(now, model=model), stage, problem.model.at(relative), progress)
        rounds.append(Round(_misfit(inputs, compared, updated), fit.factors, held_out, stage.reduction.model.size))
        watch.lap("certificate")
        told = f"misfit {rounds[-1].misfit_db:.2f} dB, error of the reduced model at these factors {rounds[-1].error:.1e}"
        progress(f"round {len(rounds)}: {told}")
        if rounds[-1].error <= tolerance or len(rounds) == most or (len(rounds) > 1 and rounds[-1].error >= rounds[-2].error):
            break
        now = replace(inputs, model=model, recipe=recipe)
        stage = obtain_reduction(now, folder, accept=accept, progress=progress)
        watch.lap("reduction")
        problem = replace(problem, model=affine_model(now, stage), base=fit.factors, nuisances=hits_of(now))
        theta = fit.moved(problem)
    heard = replace(measurement, values=without_noise(inputs, settings.job, measurement))
    fit = fit.wider(ratio_of(inputs, heard, inputs.campaign.jobs[settings.job], problem.selected, updated))
    misfits = (_misfit(inputs, compared, initial), rounds[-1].misfit_db)
    doubted = calibration_doubts(inputs, measurement, (initial, plain), settings.job, misfits, gains)
    doubted += far_factors(fit.factors, inputs.recipe)
    for doubt in doubted:
        log.warning("calibration from %s: %s", settings.job, doubt)
    return CalibrationOutcome(
        fit=fit,
        rounds=tuple(rounds),
        measurement=measurement,
        compared=compared,
        selected=problem.selected,
        initial=initial,
        updated=updated,
        reached=rounds[-1].error <= tolerance,
        notes=(*map(str, measurement.warnings), *doubted, *notes, *fit.notes),
        seconds=watch.seconds | {"total": sum(watch.seconds.values())},
        warnings=tuple(doubted),
    )


def _gains(inputs: Inputs, fit: FactorFit) -> Gains | None:
    """Gains at the end of a fit; None if its cost has none."""
    return None if fit.problem.gains is None else gains_of(inputs, *fit.gains(), shared=None)


def _fitted(inputs: Inputs, problem: FactorProblem, theta: Floats | None) -> FactorFit:
    """Fit from theta (None: the start values), with gains of the responses if they are accepted."""
    # BLAS threads slow down algebra on matrices of a hundred rows.
    with single_threaded():
        return _lifted(inputs, fit_factors(problem, theta, max_iterations=inputs.method.max_iterations))


def _lifted(inputs: Inputs, fit: FactorFit) -> FactorFit:
    """The fit with gains of the responses if they are accepted, which the first round decides for all.

    Damping and stiffness of a boundary partly compensate for gains, so these are identified from the end of the fit without them.

    Raises
    ------
    NumericalError
        If the fit without gains failed.
    """
    problem = fit.problem
    if fit.solution.status == "failed":
        raise NumericalError(f"the calibration from job {require_calibration(inputs).job} failed: {fit.solution.reason}")
    if problem.gains is not None:
        return fit
    rest = np.setdiff1d(np.arange(problem.frequency_hz.size), problem.selected)
    model = problem.frf(2j * np.pi * problem.frequency_hz[rest]) if rest.size else None

    def above(theta: Floats) -> Floats:
        if model is None:
            return np.zeros((0, inputs.used.size))
        with np.errstate(divide="ignore", invalid="ignore"):
            return decibel(problem.measured[rest] / model.frf(theta))

    if none_shown(inputs, above(fit.solution.theta)):
        return fit
    allowed = replace(problem, gains=columns_of(inputs, None))
    again = fit_factors(allowed, fit.solution.theta, max_iterations=inputs.method.max_iterations)
    if again.solution.status == "failed":
        return fit
    left = fit.solution.evaluation.misfit_db, again.solution.evaluation.misfit_db
    return again if kept(inputs, _gains(inputs, again), left, above(again.solution.theta)) else fit


class _Watch:
    """Time spent in each stage [s]."""

    def __init__(self) -> None:
        self.seconds = {"reduction": 0.0, "fit": 0.0, "certificate": 0.0}
        self._clock = time.perf_counter()

    def lap(self, stage: str) -> None:
        """Add the time since the last call to this stage."""
        now = time.perf_counter()
        self.seconds[stage] += now - self._clock
        self._clock = now


def first_problem(source: FrfSource, measurement: Measurement) -> tuple[FactorProblem, tuple[str, ...]]:
    """Problem of the first round, on the reduced model of the exported matrices, and notes."""
    inputs, stage = source.inputs, source.stage
    assert stage is not None
    settings, used = require_calibration(inputs), inputs.used
    parameters, _ = parameterise(inputs, source, 2j * np.pi * measurement.frequency_hz)
    values = without_noise(inputs, settings.job, measurement)
    few, selected = select_lines(inputs, replace(measurement, values=values), settings.job)
    sigma, notes = line_sigma(inputs, measurement, inputs.campaign.jobs[settings.job], selected)
    problem = FactorProblem(
        model=affine_model(inputs, stage),
        base={},
        names=settings.names,
        parameters=parameters,
        hold=settings.boundary == "held",
        frequency_hz=measurement.frequency_hz,
        measured=values[:, used],
        responses=used,
        selected=selected,
        few=np.flatnonzero(np.isin(selected, few)) if few.size < selected.size else None,
        options=inputs.method.residual,
        sigma=sigma,
        nuisances=hits_of(inputs),
        statistics=inputs.statistics,
    )
    return problem, (*notes, *left_out(inputs, measurement, values))


def _misfit(inputs: Inputs, measured: Complexes, y: Complexes) -> float:
    """Mean misfit of FRFs y (F, R) over the responses used [dB]."""
    return float(np.nanmean(mean_misfit(y, measured)[inputs.used]))


def _errors(inputs: Inputs, stage: ReductionStage, reduced: Any, progress: Callable[[str], None]) -> tuple[HeldOut, ...]:
    settings = inputs.campaign.reduction
    points = [step.frequency_hz for step in stage.reduction.trace if step.order]
    lines = lines_between(settings.band, points, settings.held_out)

    def tell(done: int, count: int) -> None:
        progress(f"error at the factors found: full line {done} of {count}")

    return measured_errors(inputs.model, inputs.input_of, reduced, settings.band, lines, backend=settings.backend, progress=tell)


def calibration_record(inputs: Inputs, outcome: CalibrationOutcome, parts: dict[str, str], job: str) -> CalibrationRecord:
    """Content of ``calibration.json``."""
    fit, last = outcome.fit, outcome.rounds[-1]
    status, reason = fit.solution.status, fit.solution.reason
    if not outcome.reached:
        status, reason = "stopped", f"the reduced model does not reach its tolerance at these factors ({last.error:.1e})"
    problem, gains = fit.problem, _gains(inputs, fit)
    return CalibrationRecord(
        format="lrbc-calibration",
        version=1,
        job=job,
        key=key_of(parts),
        parts=parts,
        used=True,
        status=status,
        reason=reason,
        factors={name: _factor(fit, name) for name in fit.factors},
        gain_db={} if gains is None else gain_tree(inputs, gains),
        hammer_offset_mm=fit.nuisances.get("hammer_offset_mm", {}),
        boundary={
            group.name: Boundary(log10=fit.solution.theta[values], damping_exponent=None if at is None else fit.solution.theta[at])
            for group, values, at in problem.parameters.placed
        },
        boundary_held=problem.hold,
        misfit_db=misfit_record(inputs, *(mean_misfit(y, outcome.compared) for y in (outcome.initial, outcome.updated))),
        noise=NoiseRecord(sigma_db=fit.noise.sigma, correlation_factor=fit.noise.factor, validation_ratio=fit.noise.ratio),
        rounds=tuple(RoundRecord.like(found) for found in outcome.rounds),
        stages=tuple(StageRecord.like(stage) for stage in fit.stages),
        reduction=FactorCertificate(
            worst=last.error,
            tolerance=inputs.campaign.reduction.tolerance,
            size=last.size,
            held_out=tuple(HeldOutRecord.like(line) for line in last.held_out),
        ),
        lines=Lines(frequency_hz=outcome.measurement.frequency_hz[outcome.selected], count=outcome.selected.size),
        frf="calibration/frf.csv",
        seconds=outcome.seconds["total"],
        seconds_by_stage=outcome.seconds,
        warnings=outcome.warnings,
        notes=outcome.notes,
        provenance=Provenance(
            versions=versions(), inputs=inputs.hashes | outcome.measurement.hashes, configuration=inputs.campaign.resolved()
        ),
    )


def _factor(fit: FactorFit, name: str) -> Factor:
    value, (low, high) = fit.factors[name], fit.interval(name)
    return Factor(value=value, std=value * fit.spread[name], lower95=low, upper95=high, initial=1.0)
