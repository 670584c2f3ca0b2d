"""Makes the content of all result files of a job from its identification and judgement; ``results`` writes them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from lrbc_cli.arrays import Complexes, Floats, Integers
from lrbc_cli.campaign.digests import origin
from lrbc_cli.campaign.identification.correlate import FDAC_COLUMNS, correlation_of, correlation_record, fdac_rows, mean_or_gap
from lrbc_cli.campaign.identification.found import Identification
from lrbc_cli.campaign.identification.nuisances import nuisance_tree
from lrbc_cli.campaign.identification.records import Measurement
from lrbc_cli.campaign.jobs.evidence import bands, effective, evidence_of
from lrbc_cli.campaign.jobs.identity import Copied, Identity
from lrbc_cli.campaign.jobs.judging import ComparedWith, judged
from lrbc_cli.campaign.jobs.standing import rests_on
from lrbc_cli.campaign.reading.inputs import Inputs, TermGroup
from lrbc_cli.campaign.reduced.stage import ReductionStage
from lrbc_cli.campaign.updated.modes import modes_record
from lrbc_cli.campaign.updated.shapes import shapes_of
from lrbc_cli.model.terms import ParameterGroup
from lrbc_cli.results import job
from lrbc_cli.results.agreement import CorrelationRecord
from lrbc_cli.results.nuisances import Nuisances
from lrbc_cli.results.shapes import ShapesRecord
from lrbc_cli.results.store import versions
from lrbc_cli.updating.comparison.correlation import measured_values
from lrbc_cli.updating.judging.evidence import Evidence
from lrbc_cli.updating.search.lcurve import LCurve
from lrbc_cli.updating.statistics.decibels import decibel

#: Header and rows of a table.
Table = tuple[list[str], list[list[Any]]]


@dataclass(frozen=True)
class Finished:
    """Content of the result files of a job.

    Attributes
    ----------
    record : job.JobRecord
        Content of ``result.json`` without the hashes of the other files.
    tables : dict
        Header and rows of each CSV file, by file name.
    evidence : Evidence
    shapes : ShapesRecord or None
    """

    record: job.JobRecord
    tables: dict[str, Table] = field(repr=False)
    evidence: Evidence = field(repr=False)
    shapes: ShapesRecord | None = field(repr=False)


def finish(
    inputs: Inputs,
    stage: ReductionStage | None,
    result: Identification,
    tight: ComparedWith,
    identities: tuple[Identity, Identity],
    copied: Copied | None = None,
) -> Finished:
    """Judge an identification, and make the content of its result files.

    Parameters
    ----------
    inputs : Inputs
    stage : ReductionStage or None
        None for full-order evaluation.
    result : Identification
    tight : ComparedWith
        Reference state of the identification, and results of the baselines.
    identities : pair of Identity
        Digests of what identification and judgement depend on.
    copied : Copied or None
        If its measurement is a copy of that of another job.
    """
    evidence, correlation = evidence_of(inputs, result), correlation_of(inputs, result)
    own, judgement = identities
    provenance = provenance_of(
        inputs,
        stage,
        result,
        identity=own.digest,
        parts=own.parts,
        origin=origin_of(inputs),
        judgement=judgement.record(copied),
        rests_on=rests_on(tight),
    )
    record = _judged(
        inputs,
        stage,
        result,
        evidence.beside(None if copied is None else copied.copied),
        tight,
        provenance,
        correlation_record(inputs, correlation),
    )
    tables = {
        "profile.csv": profile_rows(record.parameters),
        "frf.csv": frf_rows(inputs, result.measurement, result.selected, result.initial, result.updated),
        "fdac.csv": (FDAC_COLUMNS, fdac_rows(result, correlation)),
    }
    return Finished(record, tables, evidence, shapes_of(inputs, stage, result))


def result_record(
    inputs: Inputs, stage: ReductionStage | None, result: Identification, evidence: Evidence, baselines: Mapping[str, job.JobRecord]
) -> job.JobRecord:
    """Judged record of an identification that is not written to files, without correlation and digests."""
    tight = ComparedWith(result.reference, baselines)
    return _judged(inputs, stage, result, evidence, tight, provenance_of(inputs, stage, result))


def _judged(
    inputs: Inputs,
    stage: ReductionStage | None,
    result: Identification,
    evidence: Evidence,
    tight: ComparedWith,
    provenance: job.Provenance,
    correlation: CorrelationRecord | None = None,
) -> job.JobRecord:
    """Content of ``result.json``: identified values and judgement."""
    campaign, solution, knowledge, lines = inputs.campaign, result.solution, result.posterior, int(result.selected.size)
    reference = campaign.update.reference if result.against_reference else None
    return job.JobRecord(
        format="lrbc-result",
        version=1,
        job=result.name,
        parameters=parameter_records(inputs, result),
        covariance=knowledge.boundary,
        cost=job.BeforeAfter(initial=solution.history[0].cost, final=solution.evaluation.cost),
        misfit_db=misfit_record(inputs, result.misfit_initial, result.misfit_final),
        noise=job.NoiseRecord(
            sigma_db=knowledge.noise.sigma, correlation_factor=knowledge.noise.factor, validation_ratio=knowledge.noise.ratio
        ),
        prior=job.Prior(
            of=reference or "initial",
            unknowns="bolts" if knowledge.shapes.by_bolt else "values",
            std=_typical(knowledge.prior_std[: len(knowledge.z)]),
            shape="normal" if result.changes is None else "mixture",
            comparison="relative" if result.relative else "direct",
            scatter=tight.scatter.rms,
        ),
        nuisances=Nuisances(**nuisance_tree(inputs, knowledge, result.gains)),
        method=inputs.method.tree(),
        iterations=solution.iterations,
        evaluations=solution.evaluations,
        line_evaluations=result.line_evaluations,
        history=tuple(job.EvaluationRecord.like(entry) for entry in solution.history),
        lines=job.Lines(frequency_hz=result.measurement.frequency_hz[result.selected], count=lines),
        optimiser=job.Optimiser(
            method=inputs.method.optimiser,
            regularisation=result.regularisation,
            regularisation_per_residual=result.regularisation / max(lines * inputs.used.size, 1),
            starts=tuple(job.StartRecord.like(start) for start in solution.starts),
        ),
        l_curve=None if result.l_curve is None else curve_record(result.l_curve),
        seconds=result.seconds,
        provenance=provenance,
        correlation=correlation,
        modes=modes_record(inputs, stage, result),
        **judged(campaign, inputs.method.rule, evidence, tight, provenance.certificate),
    )


def provenance_of(inputs: Inputs, stage: ReductionStage | None, result: Identification, **digests: Any) -> job.Provenance:
    """What a result rests on, with further fields of the record."""
    return job.Provenance(
        versions=versions(),
        inputs=inputs.hashes | result.measurement.hashes,
        configuration=inputs.campaign.resolved(),
        calibration=calibration_record(inputs),
        certificate=None
        if stage is None
        else job.Certificate.like(
            stage.reduction, key=stage.decision.key, size=stage.reduction.model.size, tolerance=stage.reduction.options.tolerance
        ),
        measured_db=result.measurement.means,
        coherence_db=result.measurement.noise_means(),
        **digests,
    )


def parameter_records(inputs: Inputs, result: Identification) -> dict[str, job.Parameter]:
    """Values, intervals and bounds of each group, as log10."""
    theta, variance = result.solution.theta, np.diag(result.posterior.boundary)
    confidence, out = bands(result, inputs.statistics.errors.level_error), {}
    for terms, (group, values, at) in zip(inputs.groups, result.parameters.placed, strict=True):
        p, length, band = theta[values], tributary(group), confidence[group.name]
        before = None if result.reference is None else result.reference.parameters.get(group.name)
        limits = result.saturations.get(group.name)
        damping: dict[str, Any] = {}
        if at is not None and group.damping is not None:
            damping = {
                "damping_exponent": theta[at],
                "damping_exponent_std": np.sqrt(max(variance[at], 0.0)),
                "damping_factor": 10.0 ** theta[at],
                "damping_beta": group.damping.beta,
                "damping_loss_factor": group.damping.loss_factor,
                "damping_bounds": group.damping.bounds,
            }
        out[group.name] = job.Parameter(
            kind=group.kind,
            unit=unit_of(terms),
            log10=p,
            log10_effective=effective(group, p),
            log10_per_metre=None if length is None else effective(group, p) - np.log10(length),
            std=band.std,
            lower95=band.lower,
            upper95=band.upper,
            initial=group.initial,
            initial_effective=effective(group, group.initial),
            reference_log10_effective=None if before is None else before.log10_effective,
            bounds=np.array(group.bounds[0]),
            positions=group.xyz,
            arc_length=group.arc_length,
            bolts=_owners(inputs, group),
            saturation=None if limits is None else job.SaturationRecord(free=limits.lower, start=limits.start, clamped=limits.upper),
            **damping,
        )
    return out


def misfit_record(inputs: Inputs, before: Floats, after: Floats) -> job.MisfitRecord:
    """The misfits of a result, from (R,) mean misfits before and after the identification [dB]."""
    used, validation = inputs.used, inputs.validation
    return job.MisfitRecord(
        initial=mean_or_gap(before[used]),
        final=mean_or_gap(after[used]),
        held_out_initial=mean_or_gap(before[validation]),
        held_out_final=mean_or_gap(after[validation]),
        responses={
            response.name: job.ResponseMisfit(initial=before[i], final=after[i], used=bool(i in used))
            for i, response in enumerate(inputs.responses)
        },
    )


def _owners(inputs: Inputs, group: ParameterGroup) -> tuple[str | None, ...] | None:
    """Name of the bolt that owns each value of a group; None if bolts own none."""
    if group.bolt is None or inputs.bolts is None:
        return None
    return tuple(inputs.bolts.name[bolt] if bolt >= 0 else None for bolt in group.bolt.tolist())


def origin_of(inputs: Inputs) -> str | None:
    """See ``digests.origin``; None if the campaign file does not state everything (``Inputs.by_hand``)."""
    return origin(inputs.campaign, inputs.read_with) if inputs.read_with and not inputs.by_hand else None


def calibration_record(inputs: Inputs) -> job.CalibrationInUse | None:
    """Key and factors of the calibration in the model; None for the model as exported."""
    use = inputs.calibration
    return job.CalibrationInUse.like(use) if use is not None and use.used else None


def curve_record(curve: LCurve) -> job.LCurveRecord:
    """L-curve as in ``result.json``; ``at`` is the corner, interpolated between the weights tried."""
    corner = curve.corner
    at = None if corner is None else job.CornerRecord.like(corner)
    return job.LCurveRecord.like(curve, corner=None if corner is None else corner.index, at=at)


def _typical(stds: Floats) -> float | None:
    """Median of the finite standard deviations of the prior [decades]; None if there are none."""
    finite = stds[np.isfinite(stds)]
    return float(np.median(finite)) if finite.size else None


#: Columns of ``profile.csv`` after group, term and position, and the field of ``Parameter`` that each holds.
PROFILE = {
    "arc_length_m": "arc_length",
    "log10_initial": "initial_effective",
    "log10": "log10",
    "log10_effective": "log10_effective",
    "log10_per_metre": "log10_per_metre",
    "log10_reference": "reference_log10_effective",
    "bolt": "bolts",
}


def profile_rows(parameters: Mapping[str, job.Parameter]) -> Table:
    """Header and rows of ``profile.csv``."""
    rows = []
    for name, group in parameters.items():
        columns = [getattr(group, key) for key in PROFILE.values()]
        for k in range(len(group.log10)):
            position = [None] * 3 if group.positions is None else list(group.positions[k])
            rows.append([name, k, *position, *(None if column is None else column[k] for column in columns)])
    return ["group", "term", "x", "y", "z", *PROFILE], rows


def frf_rows(inputs: Inputs, measurement: Measurement, selected: Integers, initial: Complexes, updated: Complexes) -> Table:
    """Header and rows of ``frf.csv``: dB re 1 unit/N and phase in degrees, of (F, R) FRFs before and after."""
    header = ["frequency_hz"]
    columns: list[Floats] = [measurement.frequency_hz]
    measured = measurement.values
    valid = measured_values(measured)
    for i, response in enumerate(inputs.responses):
        for label, values in (("measured", measured), ("initial", initial), ("updated", updated)):
            shown = np.where(valid[:, i], values[:, i], np.nan) if label == "measured" else values[:, i]
            header += [f"{response.name}_{label}_db", f"{response.name}_{label}_phase_deg"]
            with np.errstate(divide="ignore", invalid="ignore"):
                columns += [decibel(shown), np.asarray(np.degrees(np.angle(shown)))]
        header.append(f"{response.name}_coherence")
        columns.append(measurement.coherence[:, i])
    chosen = np.zeros(measured.shape[0], dtype=int)
    chosen[selected] = 1
    header.append("selected")
    rows = [[*(float(column[line]) for column in columns), int(chosen[line])] for line in range(measured.shape[0])]
    return header, rows


def unit_of(group: TermGroup) -> str:
    """Unit of the identified values by kind and component, empty if unknown; values of bushings are ratios to nominal ones."""
    if group.config.select.bushings is not None:
        return "× nominal"
    component = group.config.select.component or ""
    base = {"stiffness": ("N m/rad", "N/m"), "damping": ("N m s/rad", "N s/m"), "mass": ("kg m²", "kg")}[group.config.kind]
    if component.startswith("ROT"):
        return base[0]
    return base[1] if component.startswith("U") else ""


def tributary(group: ParameterGroup) -> Floats | None:
    """(k,) length of edge that belongs to each value [m]; None without positions, or with a single value."""
    if group.arc_length is None or group.count < 2:
        return None
    a = group.arc_length
    middle = 0.5 * (a[1:] + a[:-1])
    # The cell of an end value extends as far outwards as towards its neighbour.
    edges = np.concatenate([[2 * a[0] - middle[0]], middle, [2 * a[-1] - middle[-1]]])
    return np.diff(edges)
