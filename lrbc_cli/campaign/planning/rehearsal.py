"""Rehearsals: measurements with single loose bolts are simulated with random errors, then identified and judged as by `lrbc update`.

Linearised figures are too optimistic if resonances move past each other, neighbours have similar effects, or the mixture prior differs from
a Gaussian. Here only the errors that are drawn are linearised; they are those that the error model assumes, see ``Rehearsal._identified``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import brentq
from scipy.special import ndtr, ndtri

from lrbc_cli.arrays import Bools, Complexes, Floats
from lrbc_cli.campaign.identification.handed import with_job
from lrbc_cli.campaign.identification.identify import identify
from lrbc_cli.campaign.identification.nuisances import nuisances_of
from lrbc_cli.campaign.identification.records import Measurement, read_measurement
from lrbc_cli.campaign.jobs.evidence import evidence_of
from lrbc_cli.campaign.jobs.finished import result_record
from lrbc_cli.campaign.jobs.judging import scatter_of_records
from lrbc_cli.campaign.planning.draws import Draw, Rehearsed, TightDraw
from lrbc_cli.campaign.planning.patches import Structure
from lrbc_cli.campaign.reading.inputs import Inputs
from lrbc_cli.campaign.reduced.stage import FrfSource
from lrbc_cli.config import JobConfig
from lrbc_cli.errors import DataError, NumericalError
from lrbc_cli.reduction.threads import cores, sharing
from lrbc_cli.results.job import JobRecord
from lrbc_cli.results.store import read_job
from lrbc_cli.updating.judging.bolt import BASELINE, JOB, Threshold
from lrbc_cli.updating.judging.clearance import BoltFinding, JobFinding, open_points
from lrbc_cli.updating.judging.decide import judge, scatter_of
from lrbc_cli.updating.judging.evidence import Evidence
from lrbc_cli.updating.judging.reference import ReferenceState
from lrbc_cli.updating.judging.rule import LOOSE, NO_SCATTER, TIGHT, TightScatter
from lrbc_cli.updating.misfit.cost import SLOPE_STEP, ChangeError
from lrbc_cli.updating.misfit.frf import reduced_model
from lrbc_cli.updating.posterior.information import LOSSES
from lrbc_cli.updating.statistics.decibels import DB, coherence_sigma, decibel, stated_coherence
from lrbc_cli.updating.statistics.lines import resonance_lines
from lrbc_cli.updating.statistics.noise import Noise
from lrbc_cli.updating.statistics.shared import band_means

#: Noise over rms of a response along the band if the noise is unknown: that of the measuring chain of the virtual rigs.
NOISE_SHARE = 0.004

#: Largest relative error of frequencies, beyond which no model is updated, and accuracy with which it is sought.
MOST_DETUNED, LEAST_DETUNED = 0.05, 1e-5

#: Number of rehearsals at a time: more threads would compete for the interpreter lock.
MOST_WORKERS = 4

#: Number of rehearsed reference jobs; bolts and draws use them in turn, because errors of one affect all jobs compared with it.
REFERENCES = 5

#: Names of the two jobs of a rehearsal.
TIGHT_JOB, LOOSENED_JOB = "tight (rehearsed)", "loosened (rehearsed)"


@dataclass(frozen=True)
class TightState:
    """A rehearsed reference job: inputs, relative error of frequencies, measurement, identified state; scatter of baselines [decades]."""

    inputs: Inputs
    detuned: float
    measurement: Measurement
    reference: ReferenceState
    scatter: TightScatter = NO_SCATTER


def _reference_measurement(inputs: Inputs) -> Measurement | None:
    """Measurement of the reference job; None if there is none that can be read."""
    name = inputs.campaign.update.reference
    job = None if name is None else inputs.campaign.jobs.get(name)
    if name is None or job is None:
        return None
    try:
        return read_measurement(inputs, job, name)
    except DataError:
        return None


class Rehearsal:
    """Simulated measurements about one state, and their identification.

    Parameters
    ----------
    source : FrfSource
        Model, with responses, settings and bolts of its inputs.
    structure : Structure
        Structure to be measured, in the tight state.
    noise : Noise
        Model discrepancy in that state, simulated by shifted frequencies, see ``_detuning``.
    joint : (n,) bool array
        Bolts that own their terms.
    grid : (F,) float array
        Lines [Hz], if no reference job was measured that gives lines and noise.
    seed : int
    """

    def __init__(self, source: FrfSource, structure: Structure, noise: Noise, joint: Bools, grid: Floats, seed: int) -> None:
        inputs = self.inputs = source.inputs
        self.source, self.structure, self.noise, self.joint, self.seed = source, structure, noise, joint, seed
        self.measured = _reference_measurement(inputs)
        grid = self.frequency = grid if self.measured is None else self.measured.frequency_hz
        self.s = 2j * np.pi * grid
        self.parameters, self.theta = structure.parameters, structure.theta
        self.model = source.model(self.s, self.parameters)
        self.scatter = _scatter(inputs)
        step = SLOPE_STEP * float(grid[-1])
        self._error = ChangeError(
            most=0.0,
            here=self.model,
            above=source.model(self.s + 2j * np.pi * step, self.parameters),
            frequency_hz=grid,
            step_hz=step,
            size=self.parameters.size,
            errors=inputs.statistics.errors,
        )
        self.nuisances = nuisances_of(inputs, np.arange(len(inputs.responses)))
        self._tight = self.model.frf(self.theta)
        self._floor = self._noise_floor()
        self.detuned = self._detuning()

    def _noise_floor(self) -> Floats:
        """(F, R) standard deviation of the noise of complex FRFs: from coherence or repeats, else the share ``NOISE_SHARE``."""
        known = np.where(np.isfinite(self._tight), np.abs(self._tight), 0.0)
        assumed = NOISE_SHARE * np.sqrt(np.mean(known**2, axis=0))
        measured, name = self.measured, self.inputs.campaign.update.reference
        if measured is None or name is None:
            return np.broadcast_to(assumed, known.shape)
        told = stated_coherence(measured.coherence)
        averages = self.inputs.campaign.jobs[name].averages * measured.files
        sigma = coherence_sigma(told, averages, self.inputs.statistics.errors) if measured.sigma_db is None else measured.sigma_db
        # Half of the variance of a complex deviation is along the FRF.
        floor = np.sqrt(2.0) * sigma / DB * np.abs(measured.values)
        return np.asarray(np.where(np.isfinite(floor), floor, assumed))

    def _true(self, theta: Floats, detuned: float, drift: Floats | None = None) -> Complexes:
        """(F, R) FRFs of a structure whose frequencies are those of the model times ``1 + detuned``, with nuisance values ``drift``."""
        assert self.source.stage is not None
        s = self.s / (1.0 + detuned)
        if drift is None:
            return reduced_model(self.source.stage.reduction.model, s, self.parameters, np.arange(len(self.inputs.responses))).frf(theta)
        return self.source.drifting(s, self.parameters, self.nuisances).frf(np.concatenate([theta, drift]))

    def _detuning(self) -> float:
        """Relative error of frequencies for which the FRFs about resonances differ by the model discrepancy (rms).

        Such an error moves with the resonances, so the correction by the tight state does not remove it from other states. An error fixed
        to its lines would be removed entirely, which rehearsals on models with wrong stiffness (0.5 to 2 %) contradict.
        """
        used = self.inputs.used
        lines = resonance_lines(self.frequency, self._tight[:, used], self.inputs.statistics.resonances)

        def missing(share: float) -> float:
            with np.errstate(divide="ignore", invalid="ignore"):
                apart = decibel(self._true(self.theta, share)[:, used][lines]) - decibel(self._tight[:, used][lines])
            known = np.square(apart[np.isfinite(apart)])
            return float(np.sqrt(known.mean())) - self.noise.sigma if known.size else -np.inf

        return MOST_DETUNED if missing(MOST_DETUNED) <= 0.0 else float(brentq(missing, 0.0, MOST_DETUNED, xtol=LEAST_DETUNED))

    def _measure(self, y: Complexes, rng: np.random.Generator) -> Measurement:
        """Measurement of FRFs y (F, R) with the noise of the measuring chain, and the matching coherence."""
        draw = (rng.standard_normal(y.shape) + 1j * rng.standard_normal(y.shape)) / np.sqrt(2.0)
        values = y + self._floor * draw
        averages = JobConfig.model_fields["averages"].default
        with np.errstate(divide="ignore", invalid="ignore"):
            relative = np.square(self._floor / np.abs(y))
            # The inverse of ``coherence_sigma``.
            coherence = 1.0 / (1.0 + averages * relative)
        sigma = DB * np.sqrt(0.5 * relative)
        return Measurement(
            frequency_hz=self.frequency, values=values, coherence=coherence, notes=(), warnings=(), records=(), hashes={}, sigma_db=sigma
        )

    def tight(self, draw: int) -> TightState:
        """Simulate and identify the tight state, and baselines if their scatter is needed."""
        rng = np.random.default_rng([self.seed, draw])
        # Frequencies are too high and too low in turn.
        detuned = self.detuned * (-1.0) ** draw
        measurement = self._measure(self._true(self.theta, detuned), rng)
        campaign = self.inputs.campaign
        update = campaign.update.model_copy(update={"reference": TIGHT_JOB, "baselines": ()})
        inputs = with_job(replace(self.inputs, campaign=campaign.model_copy(update={"jobs": {}, "update": update})), TIGHT_JOB)
        result = identify(inputs, self.source, TIGHT_JOB, measurements={TIGHT_JOB: measurement})
        record = result_record(inputs, self.source.stage, result, evidence_of(inputs, result), {})
        tight = TightState(inputs, detuned, measurement, record.state)
        if self.scatter is not None:
            return replace(tight, scatter=self.scatter)
        # Seeds of their own: numbers that end with zeros are those without them.
        again = [self._identified(tight, {}, [self.seed, draw, self.joint.size + 2, k]) for k in range(len(campaign.update.baselines))]
        judged = [
            judge(evidence, inputs.method.rule, BASELINE, reference=tight.reference).bolts for evidence in again if evidence is not None
        ]
        return replace(tight, scatter=scatter_of(judged))

    def loosened(self, bolt: int, loss: float, draw: int, tight: TightState) -> Draw:
        """Loosen one bolt by ``loss`` decades, simulate its measurement, identify and judge it."""
        # The seed does not depend on the loss, so that all losses have the same random numbers.
        evidence = self._identified(tight, {bolt: -loss}, [self.seed, draw, bolt + 1])
        if evidence is None:
            return Draw(verdict="undecided", change=float("nan"), probability=float("nan"), alarms=(), judged=0)
        found = judge(evidence, tight.inputs.method.rule, JOB, tight.scatter, tight.reference).bolts
        own, others = found[bolt], [one for i, one in enumerate(found) if i != bolt]
        return Draw(
            verdict=own.verdict,
            change=float("nan") if own.change is None else own.change,
            probability=float("nan") if own.probability_loose is None else own.probability_loose,
            alarms=tuple(one.name for one in others if one.verdict == LOOSE),
            judged=sum(one.verdict in (LOOSE, TIGHT) for one in others),
        )

    def tightened(self, draw: int, tight: TightState) -> TightDraw:
        """Tighten all bolts again, simulate the measurement, identify and judge it."""
        # A number that no bolt has in the seeds of ``loosened``.
        evidence = self._identified(tight, {}, [self.seed, draw, self.joint.size + 1])
        if evidence is None:
            return TightDraw({})
        rule = tight.inputs.method.rule
        found = judge(evidence, rule, JOB, tight.scatter, tight.reference)
        bolts = [BoltFinding(name=one.name, verdict=one.verdict, probability=one.probability_loose) for one in found.bolts]
        job = JobFinding(status="converged", bolts=bolts, validated=found.validity.passed is True, confidence=rule.confidence)
        return TightDraw({one.name: one.verdict for one in job.seen}, job.validated, not open_points(job))

    def _identified(self, tight: TightState, changes: Mapping[int, float], seed: Sequence[int]) -> Evidence | None:
        """Simulate and identify a state with these changes [decades] by bolt; None if the identification fails.

        The other bolts scatter as tight ones do, nuisance parameters are drawn from their priors, and the frequencies are wrong as in the
        tight state. The change differs from the predicted one by errors as in ``ChangeError``, with errors of levels correlated over lines.
        """
        inputs = with_job(tight.inputs, LOOSENED_JOB)
        rng = np.random.default_rng(seed)
        joint, prior = self.joint, inputs.statistics.bolts
        change = np.where(joint, prior.joint_tight_std, prior.tight_std) * rng.standard_normal(joint.size)
        change[list(changes)] = list(changes.values())
        theta = np.clip(self.theta + self.structure.loosened @ change, *self.parameters.bounds.T)
        drift = np.array([nuisance.std * rng.standard_normal() for nuisance in self.nuisances]) if self.nuisances else None
        y = self._true(theta, tight.detuned, drift)
        apart, patterns, band = self._error(self.theta, theta)
        wrong = inputs.statistics.errors.change_error * apart
        mean = band_means(wrong, band)
        error = wrong * _along(rng, wrong.shape, inputs.statistics.errors.coarsening) + patterns @ rng.standard_normal(patterns.shape[2])
        error = error + mean * rng.standard_normal((band.max() + 1, wrong.shape[1]))[band]
        # The error of a change is at most that of two states.
        most, std = np.sqrt(2.0) * self.noise.sigma, np.sqrt(wrong**2 + mean**2 + np.sum(np.abs(patterns) ** 2, axis=2))
        error = error * most / np.maximum(np.hypot(std, most), np.finfo(float).tiny)
        measured = {TIGHT_JOB: tight.measurement, LOOSENED_JOB: self._measure(y * np.exp(error / DB), rng)}
        try:
            return evidence_of(inputs, identify(inputs, self.source, LOOSENED_JOB, tight.reference, measured))
        except NumericalError:
            return None


def rehearse(
    rehearsal: Rehearsal, wanted: Sequence[tuple[int, float]], draws: int, progress: Callable[[str], None] = lambda _: None
) -> Rehearsed:
    """Rehearse every bolt and loss ``draws`` times, and as often, after each reference job, the structure with all bolts tightened again.

    Parameters
    ----------
    rehearsal : Rehearsal
    wanted : sequence of (int, float)
        Index of a bolt, and loss [decades].
    draws : int
    progress : callable
    """
    found: dict[tuple[int, float], list[Draw]] = {case: [] for case in wanted}
    tasks = [(draw, *case) for draw in range(draws) for case in wanted]
    after = range(draws * REFERENCES)
    again: list[TightDraw] = []
    # Threads as in ``run_jobs``. Every draw has its own seed, so the order does not matter.
    pool = sharing(min(MOST_WORKERS, cores()))
    try:
        states = list(pool.map(rehearsal.tight, range(REFERENCES)))
        ends = pool.map(lambda task: rehearsal.loosened(task[1], task[2], task[0], states[(task[0] + task[1]) % REFERENCES]), tasks)
        others = pool.map(lambda draw: rehearsal.tightened(draw, states[draw % REFERENCES]), after)
        for done, ((_, bolt, loss), end) in enumerate(zip(tasks, ends, strict=True)):
            found[bolt, loss].append(end)
            progress(f"rehearsal {done + 1} of {len(tasks) + len(after)}")
        for outcome in others:
            again.append(outcome)
            progress(f"rehearsal {len(tasks) + len(again)} of {len(tasks) + len(after)}")
    finally:
        pool.shutdown(cancel_futures=True)
    return Rehearsed(found, again)


def assumptions(rehearsal: Rehearsal, draws: int, origin: str) -> list[str]:
    """Assumptions of the figures of a rehearsal, in words.

    Parameters
    ----------
    rehearsal : Rehearsal
    draws : int
    origin : str
        Source of the noise.
    """
    measured, update = rehearsal.measured, rehearsal.inputs.campaign.update
    errors, prior = rehearsal.inputs.statistics.errors, rehearsal.inputs.statistics.bolts
    joints = bool(rehearsal.joint[rehearsal.structure.loosened.any(axis=0)].all())
    losses = ", ".join(f"{loss:g}" for loss in LOSSES[:-1]) + f" or {LOSSES[-1]:g}"
    through = "" if joints else " of the stiffness along half a pitch on both sides"
    told = measured is not None and bool((measured.coherence > 0.0).any() or measured.sigma_db is not None)
    chain = f"as in the measurement of {update.reference}" if told else f"{100 * NOISE_SHARE:g} % of the rms of each response (assumed)"
    drifts = ", ".join(dict.fromkeys(nuisance.words or nuisance.name for nuisance in rehearsal.nuisances))
    values, mixture = rehearsal.inputs.statistics.values, mixes(rehearsal.inputs)
    std, scatter = (values.joint_std, prior.joint_tight_std) if joints else (values.std, prior.tight_std)
    lower = ["beside a bolt that is loose"] if mixture and not joints else []
    lower += ["by the scatter of the baselines"] if update.baselines else []
    beside = f" (lower {' and '.join(lower)})" if lower else ""
    reference = [] if update.reference else ["a reference job with all bolts tight is also measured, although update.reference gives none"]
    return [
        *reference,
        f"judged by rehearsal: measurements are drawn, identified and judged as `lrbc update` does, {draws} for each bolt and loss",
        f"prior of the verdicts: {'each bolt tight or loose (mixture)' if mixture else f'normal, {std:g} decades'}; loose "
        f"below {threshold(rehearsal.inputs, joints):.2g} decades{beside}, with "
        f"{100 * update.confidence:g} %",
        f"a single bolt loses {losses} decades{through}; tight bolts scatter by {scatter:g}",
        f"model discrepancy {rehearsal.noise.sigma:.2g} dB per line ({origin}), as of a structure whose frequencies differ by "
        f"{100 * rehearsal.detuned:.2g} % from those of the model",
        f"errors of the changes that the model predicts: {100 * errors.shift_error:g} % of the shift of a resonance, "
        f"{100 * errors.change_error:g} % of the change of a level, at most about {np.sqrt(2.0) * rehearsal.noise.sigma:.2g} dB",
        f"noise of the measurement: {chain}",
        f"drift between the jobs, as update.nuisances allows: {drifts}"
        if drifts
        else "no drift between the jobs: update.nuisances lists none; gains or hammer points that vary nevertheless cost verdicts",
    ]


def mixes(inputs: Inputs) -> bool:
    """Whether `lrbc update` uses the mixture prior of tight and loose bolts, given a reference job."""
    return inputs.resolved(True).mixture


def threshold(inputs: Inputs, joints: bool) -> float:
    """Change below which `lrbc update` calls a bolt loose, before the scatter of baselines and loose neighbours lower it [decades]."""
    return _threshold(inputs, None, joints).limit


def _threshold(inputs: Inputs, measured: TightScatter | None, joints: bool) -> Threshold:
    """With the scatter of the baselines, or None: of as many that do not scatter."""
    scatter = measured or TightScatter(0.0, len(inputs.campaign.update.baselines))
    return Threshold.of(inputs.method.rule, scatter, joint=joints, mixture=mixes(inputs))


def by_rule(inputs: Inputs, change: Floats, std: Floats, *, joints: bool) -> Floats:
    """(n,) probability that the rule of `lrbc update` calls a bolt loose whose true change is ``change`` [decades].

    The estimate is normal about the true change, with the standard deviation ``std`` of a small change and, for joints, the error of a
    predicted shift. It must lie below the threshold by so much that the posterior probability, widened by the scatter of tight joints,
    reaches ``confidence``.
    """
    rule, errors = inputs.method.rule, inputs.statistics.errors
    threshold = _threshold(inputs, _scatter(inputs), joints)
    own = np.hypot(std, errors.shift_error * np.abs(change) * joints)
    told = np.hypot(own, threshold.spread)
    return np.asarray(ndtr((threshold.limit - ndtri(rule.confidence) * told - change) / np.maximum(own, 1e-12)))


def _scatter(inputs: Inputs) -> TightScatter | None:
    """Scatter of the baselines with a result, as in ``lrbc update``; None if there are baselines without any result (to be rehearsed)."""
    found = []
    for name in inputs.campaign.update.baselines:
        try:
            record = read_job(inputs.campaign.output, name)
        except DataError:
            continue
        found += [record] if isinstance(record, JobRecord) else []
    return scatter_of_records(found) if found or not inputs.campaign.update.baselines else None


def _along(rng: np.random.Generator, shape: tuple[int, ...], factor: float) -> Floats:
    """Standard normal numbers, first-order autoregressive along the lines, so that ``factor`` of them count as one independent number."""
    # The sum of all correlations (1 + r)/(1 - r) is the factor.
    r = (max(factor, 1.0) - 1.0) / (max(factor, 1.0) + 1.0)
    draw = rng.standard_normal(shape)
    for line in range(1, shape[0]):
        draw[line] = r * draw[line - 1] + np.sqrt(1.0 - r**2) * draw[line]
    return draw
