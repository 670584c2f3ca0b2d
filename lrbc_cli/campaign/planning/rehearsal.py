"""What `lrbc update` would say of each bolt if it alone were loose: measurements are drawn, identified and judged by its own functions.

A linearised figure promises what no identification keeps where resonances jump past each other, neighbours imitate each other or the prior
of tight and loose bolts is no Gaussian. Here nothing is linearised but the errors that are drawn, and these are the errors that an
identification allows for: see ``Rehearsal.loosened``.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.optimize import brentq

from lrbc_cli.arrays import Complexes, Floats
from lrbc_cli.campaign.identification.identify import identify
from lrbc_cli.campaign.identification.nuisances import nuisances_of
from lrbc_cli.campaign.identification.records import Measurement, read_measurement, with_job
from lrbc_cli.campaign.identification.unknowns import parameterise
from lrbc_cli.campaign.jobs.evidence import evidence_of
from lrbc_cli.campaign.jobs.judging import role_of, scatter_of_records
from lrbc_cli.campaign.jobs.results import result_record
from lrbc_cli.campaign.reading.inputs import Inputs
from lrbc_cli.campaign.reduced.stage import FrfSource, affine_model
from lrbc_cli.config import JobConfig
from lrbc_cli.errors import DataError, NumericalError
from lrbc_cli.model.terms import Parameterisation
from lrbc_cli.results.job import JobRecord
from lrbc_cli.results.store import read_job
from lrbc_cli.updating.decide import judge
from lrbc_cli.updating.extended import ExtendedFrf
from lrbc_cli.updating.lines import resonance_lines
from lrbc_cli.updating.misfit import SLOPE_STEP, ChangeError, reduced_model
from lrbc_cli.updating.noise import Noise
from lrbc_cli.updating.residuals import DB, coherence_sigma, decibel
from lrbc_cli.updating.shapes import Shapes

#: Draws a bolt: with three, all right is an estimate of 0.875 and none 0.125 (see ``promised``), so that both words can be had.
DRAWS = 3

#: Noise of a response where no coherence tells, over its root mean square along the band: that of the measuring chain of the virtual rigs.
NOISE_SHARE = 0.004

#: Largest share by which frequencies are taken to be off, beyond which no model is updated, and how exactly it is sought.
MOST_DETUNED, LEAST_DETUNED = 0.05, 1e-5

#: Rehearsals at a time: more threads than this fight for the interpreter.
MOST_WORKERS = 4

#: Names of the two jobs of a rehearsal, and the seed: a plan does not change when it is made again.
TIGHT, LOOSENED, SEED = "tight (rehearsed)", "loosened (rehearsed)", 0


@dataclass(frozen=True)
class Draw:
    """What one rehearsal said.

    Attributes
    ----------
    verdict : str
        Of the loosened bolt.
    change : float
        Found there [decades]; NaN where nothing was found.
    probability : float
        Of being loose, as stated; NaN where the model did not explain the measurement.
    others : tuple of str
        Tight bolts that were called loose.
    """

    verdict: str
    change: float
    probability: float
    others: tuple[str, ...]

    @property
    def right(self) -> bool:
        """The loosened bolt is called loose, and no other."""
        return self.verdict == "loose" and not self.others

    @property
    def wrong(self) -> bool:
        """The loosened bolt is called tight, or a tight one loose."""
        return self.verdict == "tight" or bool(self.others)


def promised(draws: Sequence[Draw]) -> float:
    """Probability of a right verdict: the mean of its posterior after these draws, with Jeffreys' prior."""
    return (sum(draw.right for draw in draws) + 0.5) / (len(draws) + 1.0)


@dataclass(frozen=True)
class Setting:
    """What is rehearsed.

    Attributes
    ----------
    theta : (size,) float array
        The tight state.
    noise : Noise
        What the model lacks in that state: its resonances lie beside the true ones, see ``Rehearsal.detuned``.
    shapes : Shapes
        Of the bolts.
    change : float
        Of the loosened bolt [decades].
    measured : Measurement or None
        That of the reference job, which tells how noisy the lines are.
    """

    theta: Floats
    noise: Noise
    shapes: Shapes
    change: float
    measured: Measurement | None = field(default=None, repr=False)


@dataclass(frozen=True)
class TightState:
    """A rehearsal of the reference job: its campaign, by which share frequencies are off, its measurement and its result."""

    inputs: Inputs
    detuned: float
    measurement: Measurement
    record: JobRecord


def reference_measurement(inputs: Inputs) -> Measurement | None:
    """That of the reference job; None where there is none that can be read."""
    name = inputs.campaign.update.reference
    job = None if name is None else inputs.campaign.jobs.get(name)
    if name is None or job is None:
        return None
    try:
        return read_measurement(inputs, job, name)
    except DataError:
        return None


class Rehearsal:
    """Measurements drawn about one state, and what an identification says of them.

    Parameters
    ----------
    inputs : Inputs
        Of the campaign; its responses, settings and bolts hold.
    source : FrfSource
    grid : (F,) float array
        Lines [Hz].
    setting : Setting
    """

    def __init__(self, inputs: Inputs, source: FrfSource, grid: Floats, setting: Setting) -> None:
        self.inputs, self.source, self.setting, self.frequency = inputs, source, setting, grid
        self.s = 2j * np.pi * grid
        self.parameters: Parameterisation = parameterise(inputs, source, self.s)[0]
        self.model = source.model(self.s, self.parameters)
        self.theta = np.clip(setting.theta, *self.parameters.bounds.T)
        self.scatter = _scatter(inputs)
        step = SLOPE_STEP * float(grid[-1])
        nearby = source.model(self.s + 2j * np.pi * step, self.parameters)
        # How wrong it may be is known with the result of the tight state.
        self._error = ChangeError(
            most=0.0,
            here=self.model.frf,
            nearby=nearby.frf,
            frequency_hz=grid,
            step_hz=step,
            size=self.parameters.size,
            errors=inputs.statistics.errors,
        )
        self.nuisances = nuisances_of(inputs, inputs.campaign.update.nuisances, np.arange(len(inputs.responses)))
        self._tight = self.model.frf(self.theta)
        self._floor = self._noise_floor()
        self.detuned = self._detuning()

    def _noise_floor(self) -> Floats:
        """(F, R) standard deviation of the noise of the complex FRFs: what the coherence tells, else the same share of every response."""
        known = np.where(np.isfinite(self._tight), np.abs(self._tight), 0.0)
        assumed = NOISE_SHARE * np.sqrt(np.mean(known**2, axis=0))
        measured, name = self.setting.measured, self.inputs.campaign.update.reference
        if measured is None or name is None:
            return np.broadcast_to(assumed, known.shape)
        told = np.where(measured.coherence > 0.0, measured.coherence, np.nan)
        averages = self.inputs.campaign.jobs[name].averages * measured.files
        sigma = coherence_sigma(told, averages, self.inputs.statistics.errors) if measured.sigma_db is None else measured.sigma_db
        # Half of a complex deviation lies along the FRF.
        floor = np.sqrt(2.0) * sigma / DB * np.abs(measured.values)
        return np.asarray(np.where(np.isfinite(floor), floor, assumed))

    def _true(self, theta: Floats, detuned: float, drift: Floats | None = None) -> Complexes:
        """(F, R) FRFs of a structure whose frequencies are the model's times ``1 + detuned``."""
        assert self.source.stage is not None
        s = self.s / (1.0 + detuned)
        every = np.arange(len(self.inputs.responses))
        if drift is None:
            return reduced_model(self.source.stage.reduction.model, s, self.parameters, every).frf(theta)
        affine = affine_model(self.inputs, self.source.stage)
        return ExtendedFrf(affine, s, self.parameters, self.nuisances, every).frf(np.concatenate([theta, drift]))

    def _detuning(self) -> float:
        """Share by which the structure's frequencies differ from the model's so that the FRFs about resonances differ by the noise (rms).

        Such an error moves with the resonances, so that no correction by the tight state takes it out of the others; one that stays at its
        lines would be forgiven altogether, and rehearsals on models that are off by 0.5 to 2 % in stiffness say that it is not.
        """
        used = self.inputs.used
        lines = resonance_lines(self.frequency, self._tight[:, used], self.inputs.statistics.resonances)

        def lacks(share: float) -> float:
            with np.errstate(divide="ignore", invalid="ignore"):
                apart = decibel(self._true(self.theta, share)[:, used][lines]) - decibel(self._tight[:, used][lines])
            known = np.square(apart[np.isfinite(apart)])
            return float(np.sqrt(known.mean())) - self.setting.noise.sigma if known.size else -np.inf

        return MOST_DETUNED if lacks(MOST_DETUNED) <= 0.0 else float(brentq(lacks, 0.0, MOST_DETUNED, xtol=LEAST_DETUNED))

    def _measure(self, y: Complexes, rng: np.random.Generator) -> Measurement:
        """With the noise of the measuring chain, which the coherence tells."""
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
        """Measure and identify the tight state."""
        rng = np.random.default_rng([SEED, draw])
        # Higher and lower by turns.
        detuned = self.detuned * (-1.0) ** draw
        measurement = self._measure(self._true(self.theta, detuned), rng)
        campaign = self.inputs.campaign
        update = campaign.update.model_copy(update={"reference": TIGHT, "baselines": ()})
        inputs = with_job(replace(self.inputs, campaign=campaign.model_copy(update={"jobs": {}, "update": update})), TIGHT)
        result = identify(inputs, self.source, TIGHT, measurements={TIGHT: measurement})
        return TightState(inputs, detuned, measurement, result_record(inputs, self.source.stage, result, None))

    def loosened(self, column: int, bolt: int, draw: int, tight: TightState) -> Draw:
        """Loosen one bolt, measure, identify and judge.

        The other bolts scatter as tight ones do, what may drift is drawn from its prior, the frequencies are off as in the tight state, and
        the change is another than the model predicts by errors as of ``ChangeError``, whose levels neighbouring lines share.
        """
        inputs, reference = with_job(tight.inputs, LOOSENED), tight.record
        rng = np.random.default_rng([SEED, draw, bolt + 1])
        shapes = self.setting.shapes
        z = np.zeros(shapes.T.shape[1])
        bolts, first = np.unique(shapes.bolts, return_index=True)
        felt, prior = bolts >= 0, inputs.statistics.bolts
        spread = np.where(shapes.joint[first[felt]], prior.joint_tight_std, prior.tight_std)
        z[bolts[felt]] = spread * rng.standard_normal(spread.size)
        z[column] = self.setting.change
        theta = np.clip(self.theta + shapes.T @ z, *self.parameters.bounds.T)
        drift = np.array([nuisance.std * rng.standard_normal() for nuisance in self.nuisances]) if self.nuisances else None
        y = self._true(theta, tight.detuned, drift)
        # The reference job explains itself so well: a change can be no more wrong than two states are.
        most = np.sqrt(2.0) * max(reference.noise.sigma_db, reference.misfit_db.final)
        change, patterns = replace(self._error, most=most)(self.theta, theta)
        wrong = inputs.statistics.errors.change_error * np.abs(change)
        wrong = np.divide(wrong * most, np.hypot(wrong, most), out=np.zeros_like(wrong), where=wrong > 0)
        error = wrong * _along(rng, wrong.shape, inputs.statistics.errors.coarsening) + patterns @ rng.standard_normal(patterns.shape[2])
        measured = {TIGHT: tight.measurement, LOOSENED: self._measure(y * np.exp(error / DB), rng)}
        try:
            result = identify(inputs, self.source, LOOSENED, reference, measured)
        except NumericalError:
            return Draw("undecided", float("nan"), float("nan"), ())
        update = inputs.campaign.update
        evidence = evidence_of(inputs, result, reference)
        found = judge(evidence, inputs.method.rule, role_of(update, LOOSENED), self.scatter).bolts
        assert inputs.bolts is not None
        own = found[bolt]
        return Draw(
            own.verdict,
            float("nan") if own.change is None else own.change,
            float("nan") if own.probability_loose is None else own.probability_loose,
            tuple(name for i, name in enumerate(inputs.bolts.name) if i != bolt and found[i].verdict == "loose"),
        )


def rehearse(
    rehearsal: Rehearsal, wanted: Sequence[tuple[int, int]], draws: int, progress: Callable[[str], None] = lambda _: None
) -> dict[int, list[Draw]]:
    """Rehearse every bolt so many times.

    Parameters
    ----------
    rehearsal : Rehearsal
    wanted : sequence of (int, int)
        Bolts, and their columns among the unknowns.
    draws : int
    progress : callable

    Returns
    -------
    dict
        Draws by bolt.
    """
    found: dict[int, list[Draw]] = {bolt: [] for bolt, _ in wanted}
    tasks = [(draw, bolt, column) for draw in range(draws) for bolt, column in wanted]
    # As ``run_jobs`` does. Every draw has numbers of its own, so that their order does not matter.
    pool = ThreadPoolExecutor(min(MOST_WORKERS, os.cpu_count() or 1))
    try:
        tight = list(pool.map(rehearsal.tight, range(draws)))
        ends = pool.map(lambda task: rehearsal.loosened(task[2], task[1], task[0], tight[task[0]]), tasks)
        for done, ((_, bolt, _), end) in enumerate(zip(tasks, ends, strict=True)):
            found[bolt].append(end)
            progress(f"rehearsal {done + 1} of {len(tasks)}")
    finally:
        pool.shutdown(cancel_futures=True)
    return found


def assumptions(rehearsal: Rehearsal, draws: int, origin: str) -> list[str]:
    """What the figures of a rehearsal assume, for those who read them.

    Parameters
    ----------
    rehearsal : Rehearsal
    draws : int
    origin : str
        Where the noise is from.
    """
    setting, update = rehearsal.setting, rehearsal.inputs.campaign.update
    errors, prior = rehearsal.inputs.statistics.errors, rehearsal.inputs.statistics.bolts
    joints = setting.shapes.joints_only
    through = "" if joints else " through its own shape, which reaches to its neighbours along the edge"
    told = setting.measured is not None and bool((setting.measured.coherence > 0.0).any() or setting.measured.sigma_db is not None)
    chain = f"as in the measurement of {update.reference}" if told else f"{100 * NOISE_SHARE:g} % of the rms of each response (assumed)"
    kinds = {"factor": "speed of sound", "gain": "gains of the responses", "shift": "point of the hammer"}
    drifts = ", ".join(dict.fromkeys(kinds[nuisance.kind] for nuisance in rehearsal.nuisances))
    values, mixture = rehearsal.inputs.statistics.values, mixes(rehearsal.inputs)
    std, scatter = (values.joint_std, prior.joint_tight_std) if joints else (values.std, prior.tight_std)
    reference = [] if update.reference else ["a reference job with all bolts tight is measured too, though update.reference names none"]
    return [
        *reference,
        f"judged by rehearsal: measurements are drawn, identified and judged as `lrbc update` does, {draws} for each bolt",
        f"prior of the verdicts: {'each bolt tight or loose (mixture)' if mixture else f'normal, {std:g} decades'}; loose "
        f"below {threshold(rehearsal.inputs):g} decades{' (lower beside a bolt that is loose)' if mixture else ''}, with "
        f"{100 * update.confidence:g} %",
        f"a bolt alone loses {abs(setting.change):g} decades{through}; tight ones scatter by {scatter:g}",
        f"model discrepancy {setting.noise.sigma:.2g} dB a line ({origin}), as of a structure whose frequencies lie "
        f"{100 * rehearsal.detuned:.2g} % beside the model's",
        f"errors of the changes that the model predicts: {100 * errors.shift_error:g} % of the shift of a resonance, "
        f"{100 * errors.change_error:g} % of the change of a level",
        f"noise of the measurement: {chain}",
        f"drift between the jobs, as update.nuisances allows: {drifts}"
        if drifts
        else "no drift between the jobs: update.nuisances names none; gains or hammer points that vary all the same cost verdicts",
    ]


def mixes(inputs: Inputs) -> bool:
    """Whether `lrbc update` judges bolts by a mixture of tight and loose ones, given a reference job."""
    return inputs.resolved(True).mixture


def threshold(inputs: Inputs) -> float:
    """Change below which `lrbc update` calls a bolt loose, before the scatter of tight states and loose neighbours lower it [decades]."""
    rule = inputs.method.rule
    return rule.mixture_change if mixes(inputs) else rule.loose_change


def _scatter(inputs: Inputs) -> float:
    """That of the baselines that have a result, as ``lrbc update`` takes it."""
    found = []
    for name in inputs.campaign.update.baselines:
        try:
            record = read_job(inputs.campaign.output, name)
        except DataError:
            continue
        found += [record] if isinstance(record, JobRecord) else []
    return scatter_of_records(found)


def _along(rng: np.random.Generator, shape: tuple[int, ...], factor: float) -> Floats:
    """Standard normal numbers, first-order autoregressive along the lines so that ``factor`` of them tell as much as one."""
    # The sum of all correlations (1 + r)/(1 - r) is the factor.
    r = (max(factor, 1.0) - 1.0) / (max(factor, 1.0) + 1.0)
    draw = rng.standard_normal(shape)
    for line in range(1, shape[0]):
        draw[line] = r * draw[line - 1] + np.sqrt(1.0 - r**2) * draw[line]
    return draw
