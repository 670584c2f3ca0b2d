"""Entry to the identification of one job: fit (``job``), posterior of the changes (``sampling``), result to be judged and written."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from lrbc_cli.arrays import Complexes, Floats, Integers
from lrbc_cli.campaign.identification.found import Fit, Identification
from lrbc_cli.campaign.identification.gains import Gains
from lrbc_cli.campaign.identification.job import Job
from lrbc_cli.campaign.identification.records import Measurement, unlike
from lrbc_cli.campaign.identification.sampling import beyond_of, changes_of, opens_of
from lrbc_cli.campaign.identification.unknowns import stored_covariance
from lrbc_cli.campaign.identification.weights import ratio_of, worst_channel
from lrbc_cli.campaign.reading.inputs import Inputs
from lrbc_cli.campaign.reduced.stage import FrfSource
from lrbc_cli.config.settings import JobConfig
from lrbc_cli.updating.judging.reference import ReferenceState
from lrbc_cli.updating.misfit.cost import mean_misfit
from lrbc_cli.updating.posterior.samples import ChangeSamples
from lrbc_cli.updating.search.ends import other_ends
from lrbc_cli.updating.search.lcurve import curve_notes
from lrbc_cli.updating.search.optimise import Start, numbered
from lrbc_cli.updating.search.valleys import worth


def fit(inputs: Inputs, source: FrfSource, name: str, reference: ReferenceState | None, measurements: Mapping[str, Measurement]) -> Fit:
    """Minimum of the cost of one job, with the final weights, without posterior samples. Parameters as in ``identify``."""
    with source.threads():
        return Job(inputs, source, name, reference, measurements).best()


def identify(
    inputs: Inputs,
    source: FrfSource,
    name: str,
    reference: ReferenceState | None = None,
    measurements: Mapping[str, Measurement] | None = None,
) -> Identification:
    """Identify the parameters of one job, with their posterior.

    Parameters
    ----------
    inputs : Inputs
    source : FrfSource
        Interface FRFs of the reduced (or full) model.
    name : str
        Job of the campaign.
    reference : ReferenceState or None
        Result of the reference job; None for an identification that does not start from one.
    measurements : mapping or None
        Measurements by job that were read already; the files of other jobs are read.

    Returns
    -------
    Identification

    Raises
    ------
    DataError
        If the measurement is unusable.
    NumericalError
        If the optimisation fails.
    """
    with source.threads():
        return _identified(Job(inputs, source, name, reference, measurements or {}))


def _resumed(job: Job, fit: Fit, z: Floats) -> Fit | None:
    """The fit continued from another state; None unless its cost there is lower by what the data resolve, and its misfit lower.

    By the last weights, which did not guide the search, a state may be nearer to the measurement than any of its ends.
    """
    T, bounds = job.shapes.T, job.parameters.bounds.T
    first = job.cost(*job.compared)
    misfit = first.with_eta(fit.plain.eta).weighted_as(fit.plain)
    here, there = (job.descend(misfit, np.clip(place, *bounds)) for place in (fit.solution.theta, job.prior + T @ z[: T.shape[1]]))
    resolved = here.evaluation.total - worth(misfit, here.evaluation)
    if there.status == "failed" or not there.evaluation.total < resolved or there.evaluation.misfit_db >= here.evaluation.misfit_db:
        return None
    at = first(there.theta)
    start = Start(description="the most probable state of the bolts", cost=at.cost, total=at.total, kept=True, theta=there.theta)
    starts = (*(replace(one, kept=False) for one in fit.solution.starts), start)
    history = (*fit.solution.history, *numbered(there.history, len(fit.solution.history)))
    again = job.weighted(misfit, replace(there, starts=starts, history=history), job.compared, (job.prior,))
    return job.drifted(again.after(fit.evaluations + here.evaluations))


def _heard(job: Job, updated: Complexes) -> tuple[Inputs, Measurement, JobConfig, Integers, Complexes]:
    """What ``weights.weighted_misfits`` compares: the measurement without what is mostly noise, and the (F, R) FRFs of the model."""
    told = replace(job.measurement, values=job.told(job.name, job.measurement))
    return job.inputs, told, job.inputs.campaign.jobs[job.name], job.selected, updated


def _with_posterior(job: Job, best: Fit, *others: Floats) -> tuple[Fit, Gains | None, Complexes, ChangeSamples | None]:
    """A fit with the posterior that verdicts rest on: its gains, the (F, R) FRFs of the model with them, and changes at bolts.

    The search of the most probable state also begins at ``others``, theta of further ends.
    """
    inputs, fit = job.inputs, job.about_reference(best)
    gains = job.gains_of(fit)
    updated = job.frf(fit.solution.theta, fit.knowledge) * job.lifted * (1.0 if gains is None else gains.factors(inputs))
    fit = replace(fit, knowledge=fit.knowledge.wider(ratio_of(*_heard(job, updated))))
    state = None if fit.relative else stored_covariance(job.parameters, job.reference)
    ends = [*others, *other_ends(job.parameters, fit.solution.starts)]
    changes = changes_of(inputs, fit.plain, fit.knowledge, fit.solution.evaluation.jacobian, state, job.error, ends)
    return fit, gains, updated, changes


def _identified(job: Job) -> Identification:
    ports = time.perf_counter()
    inputs, reference, best = job.inputs, job.reference, job.best()
    fit, gains, updated, changes = _with_posterior(job, best)
    if changes is not None and (again := _resumed(job, best, changes.z)) is not None:
        fit, gains, updated, changes = _with_posterior(job, again, best.solution.theta)
    initial, compared = job.frf(job.start), job.told(job.name, job.measurement, known=True)
    before, after = mean_misfit(initial, compared), mean_misfit(updated, compared)
    solution, knowledge = fit.solution, fit.knowledge
    if fit.curve is not None:
        job.notes += curve_notes(fit.curve)
    job.warnings += worst_channel(*_heard(job, updated))
    beyond = beyond_of(job.model, fit, changes)
    opens = opens_of(inputs, fit, job.error)
    tight, expected = job.of_reference(), None
    if tight is not None and job.against_reference and not unlike(job.measurement.frequency_hz, tight.frequency_hz):
        with np.errstate(divide="ignore", invalid="ignore"):
            expected = tight.values * updated / (job.frf(job.prior) * job.lifted)
    optimised = time.perf_counter()
    return Identification(
        name=job.name,
        solution=solution,
        parameters=job.parameters,
        saturations=job.limits,
        measurement=job.measurement,
        selected=job.selected,
        initial=initial,
        updated=updated,
        misfit_initial=before,
        misfit_final=after,
        notes=tuple(job.notes),
        posterior=knowledge,
        opens=opens,
        prior=job.prior,
        against_reference=job.against_reference,
        relative=fit.relative,
        line_evaluations=fit.evaluations * fit.misfit.lines,
        seconds={
            "read": job.seconds_read,
            "port": ports - job.begin - job.seconds_read,
            "optimise": optimised - ports,
            "total": time.perf_counter() - job.begin,
        },
        regularisation=fit.plain.eta,
        l_curve=fit.curve,
        changes=changes,
        beyond=beyond,
        warnings=tuple(job.warnings),
        reference=reference,
        tight=tight,
        expected=expected,
        gains=gains,
    )
