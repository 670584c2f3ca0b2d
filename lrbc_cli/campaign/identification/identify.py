"""Entry to the identification of one job: fit (``job``), posterior of the changes (``sampling``), result to be judged and written."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from lrbc_cli.campaign.identification.found import Fit, Identification
from lrbc_cli.campaign.identification.job import Job
from lrbc_cli.campaign.identification.records import Measurement, unlike
from lrbc_cli.campaign.identification.sampling import beyond_of, changes_of, opens_of
from lrbc_cli.campaign.identification.unknowns import stored_covariance
from lrbc_cli.campaign.identification.weights import ratio_of
from lrbc_cli.campaign.reading.inputs import Inputs
from lrbc_cli.campaign.reduced.stage import FrfSource
from lrbc_cli.updating.judging.reference import ReferenceState
from lrbc_cli.updating.misfit.cost import mean_misfit
from lrbc_cli.updating.search.ends import other_ends
from lrbc_cli.updating.search.lcurve import curve_notes


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


def _identified(job: Job) -> Identification:
    ports = time.perf_counter()
    inputs, reference = job.inputs, job.reference
    fit = job.about_reference(job.best())
    told, compared = (job.told(job.name, job.measurement, known=known) for known in (False, True))
    initial, updated = job.frf(job.start), job.frf(fit.solution.theta, fit.knowledge)
    gains = job.gains_of(fit)
    updated = updated * job.lifted * (1.0 if gains is None else gains.factors(inputs))
    before, after = mean_misfit(initial, compared), mean_misfit(updated, compared)
    ratio = ratio_of(inputs, replace(job.measurement, values=told), inputs.campaign.jobs[job.name], job.selected, updated)
    solution, knowledge = fit.solution, fit.knowledge.wider(ratio)
    if fit.curve is not None:
        job.notes += curve_notes(fit.curve)
    state = None if fit.relative else stored_covariance(job.parameters, reference)
    ends = other_ends(job.parameters, solution.starts)
    changes = changes_of(inputs, fit.plain, knowledge, solution.evaluation.jacobian, state, job.error, ends)
    beyond = beyond_of(job.model, fit, changes)
    opens = opens_of(inputs, replace(fit, knowledge=knowledge), job.model.nearby(fit.solution.theta), job.error)
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
