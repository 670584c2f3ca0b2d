"""Result files under the output folder: written whole, ``result.json`` last, so that it vouches for the others."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from lrbc_cli import __version__
from lrbc_cli.arrays import Complexes, Floats, Integers
from lrbc_cli.campaign.identification.correlate import FDAC_COLUMNS, correlation_of, correlation_tree, fdac_rows, mean_of
from lrbc_cli.campaign.identification.found import Identification
from lrbc_cli.campaign.identification.nuisances import nuisance_tree
from lrbc_cli.campaign.identification.records import Measurement
from lrbc_cli.campaign.jobs.evidence import bands, beside_baselines, effective, evidence_of, write_evidence
from lrbc_cli.campaign.jobs.identity import Identity
from lrbc_cli.campaign.jobs.judging import judged
from lrbc_cli.campaign.jobs.modes import modes_tree
from lrbc_cli.campaign.jobs.shapes import shapes_of
from lrbc_cli.campaign.jobs.standing import rests_on
from lrbc_cli.campaign.reading.inputs import Inputs, TermGroup
from lrbc_cli.campaign.reduced.stage import ReductionStage
from lrbc_cli.errors import DataError
from lrbc_cli.model.terms import ParameterGroup
from lrbc_cli.reduction.unseen import CONFIDENCE, SHARE
from lrbc_cli.results.job import FailedJob, JobRecord, RestsOn
from lrbc_cli.results.model import CampaignRecord, ReductionRecord
from lrbc_cli.results.store import read_job, versions, write, write_sealed
from lrbc_cli.results.tables import write_csv
from lrbc_cli.updating.evidence import Evidence
from lrbc_cli.updating.lcurve import LCurve
from lrbc_cli.updating.residuals import decibel

#: What of a result judging writes.
JUDGED = ("status", "reason", "removed", "bolts", "alternatives", "taken_as_tight", "validity", "decision_rule", "warnings", "notes")


def unit_of(inputs: Inputs, group: TermGroup) -> str:
    """Unit of the identified values, where the component tells; those of bushings are ratios to the nominal ones."""
    if group.config.select.bushings is not None:
        return "× nominal"
    component = group.config.select.component or ""
    base = {"stiffness": ("N m/rad", "N/m"), "damping": ("N m s/rad", "N s/m"), "mass": ("kg m²", "kg")}[group.config.kind]
    if component.startswith("ROT"):
        return base[0]
    return base[1] if component.startswith("U") else ""


def tributary(group: ParameterGroup) -> Floats | None:
    """(k,) length of edge that belongs to each parameter [m]; None without positions."""
    if group.arc_length is None or group.count < 2:
        return None
    a = group.arc_length
    middle = 0.5 * (a[1:] + a[:-1])
    # The ends carry as much as their only neighbour leaves them on the other side.
    edges = np.concatenate([[2 * a[0] - middle[0]], middle, [2 * a[-1] - middle[-1]]])
    return np.diff(edges)


def write_result(
    output: Path,
    inputs: Inputs,
    stage: ReductionStage | None,
    result: Identification,
    reference: JobRecord | None,
    baselines: Mapping[str, JobRecord],
    identities: tuple[Identity, Identity],
) -> JobRecord:
    """Judge what was identified and write the tables, evidence.json, shapes.json, and result.json with hashes of these.

    Parameters
    ----------
    reference : JobRecord or None
        Stored result of the reference job.
    baselines : mapping
        Stored results of the baselines, by name.
    identities : pair of Identity
        Of the identification, and of its judgement.

    Returns
    -------
    JobRecord
        What result.json holds.
    """
    folder = output / result.name
    evidence = evidence_of(inputs, result, reference)
    identified = identified_tree(inputs, stage, result, reference)
    tree = with_judgement(inputs, identified, beside_baselines(inputs, evidence, result.measurement), baselines)
    correlation = correlation_of(inputs, result)
    tree["correlation"] = correlation_tree(inputs, correlation)
    files = {
        "profile.csv": write_csv(folder / "profile.csv", *profile_rows(tree)),
        "frf.csv": write_csv(folder / "frf.csv", *frf_rows(inputs, result)),
        "fdac.csv": write_csv(folder / "fdac.csv", FDAC_COLUMNS, fdac_rows(result, correlation)),
        "evidence.json": write_evidence(folder, evidence),
    }
    shapes = shapes_of(inputs, stage, result)
    if shapes is not None:
        files["shapes.json"] = write(folder / "shapes.json", shapes, compact=True)
    own, judgement = identities
    tree["provenance"] |= {**own.tree(), "judgement": judgement.tree(), "rests_on": rests_on(reference, baselines), "files": files}
    return _written(folder, tree)


def write_judgement(
    output: Path,
    inputs: Inputs,
    stored: JobRecord,
    evidence: Evidence,
    baselines: Mapping[str, JobRecord],
    judgement: Identity,
    rests: RestsOn,
) -> JobRecord:
    """Judge a stored identification anew and write its result.json; the other files stay as they are."""
    identified = {key: value for key, value in stored.tree().items() if key not in JUDGED}
    tree = with_judgement(inputs, identified, beside_baselines(inputs, evidence), baselines)
    tree["provenance"] = {**tree["provenance"], "judgement": judgement.tree(), "rests_on": rests}
    return _written(output / evidence.job, tree)


def _written(folder: Path, tree: Mapping[str, Any]) -> JobRecord:
    return write_sealed(folder / "result.json", JobRecord.checked(tree))


def with_judgement(inputs: Inputs, identified: Mapping[str, Any], evidence: Evidence, baselines: Mapping[str, JobRecord]) -> dict[str, Any]:
    """The content of ``result.json``: what was identified, and what that says of the bolts."""
    said = judged(inputs, evidence, baselines)
    prior = {**identified["prior"], "scatter": said.pop("scatter")}
    provenance = {**identified["provenance"], "configuration": inputs.campaign.resolved()}
    return {"job": evidence.job, **said, **identified, "prior": prior, "provenance": provenance}


def result_record(inputs: Inputs, stage: ReductionStage | None, result: Identification, reference: JobRecord | None) -> JobRecord:
    """The same of an identification that is not written."""
    identified = identified_tree(inputs, stage, result, reference)
    return JobRecord.checked(with_judgement(inputs, identified, evidence_of(inputs, result, reference), {}))


def identified_tree(inputs: Inputs, stage: ReductionStage | None, result: Identification, reference: JobRecord | None) -> dict[str, Any]:
    """What of ``result.json`` identification writes."""
    campaign, solution, knowledge = inputs.campaign, result.solution, result.posterior
    return {
        "parameters": parameter_trees(inputs, result, reference),
        "covariance": knowledge.boundary,
        "cost": {"initial": result.cost_initial, "final": solution.evaluation.cost},
        "misfit_db": misfit_tree(inputs, result.misfit_initial, result.misfit_final),
        "noise": {
            "sigma_db": knowledge.noise.sigma,
            "correlation_factor": knowledge.noise.factor,
            "validation_ratio": knowledge.noise.ratio,
        },
        "prior": {
            "of": campaign.update.reference if result.against_reference else "initial",
            "unknowns": "bolts" if knowledge.shapes.by_bolt else "values",
            "std": _typical(knowledge.prior_std[: len(knowledge.z)]),
            "shape": "normal" if result.changes is None else "mixture",
            "comparison": "relative" if result.relative else "direct",
        },
        "modes": modes_tree(inputs, stage, result),
        "method": inputs.method.tree(),
        "nuisances": nuisance_tree(campaign.update.nuisances, knowledge),
        "iterations": solution.iterations,
        "evaluations": solution.evaluations,
        "line_evaluations": result.line_evaluations,
        "history": [
            {"evaluation": entry.evaluation, "cost": entry.cost, "misfit_db": entry.misfit_db, "accepted": entry.accepted}
            for entry in solution.history
        ],
        "lines": {"frequency_hz": result.measurement.frequency_hz[result.selected], "count": int(result.selected.size)},
        "optimiser": {
            "method": inputs.method.optimiser,
            "regularisation": result.regularisation,
            "regularisation_per_residual": result.regularisation / max(int(result.selected.size) * inputs.used.size, 1),
            "starts": [{"description": s.description, "cost": s.cost, "total": s.total, "kept": s.kept} for s in solution.starts],
        },
        "l_curve": None if result.l_curve is None else curve_tree(result.l_curve),
        "seconds": result.seconds,
        "provenance": {
            "versions": versions(),
            "inputs": inputs.hashes | result.measurement.hashes,
            "measured_db": result.measurement.means,
            "calibration": calibration_tree(inputs),
            **({} if stage is None else {"certificate": certificate_tree(stage)}),
        },
    }


def parameter_trees(inputs: Inputs, result: Identification, reference: JobRecord | None) -> dict[str, Any]:
    """``parameters`` of ``result.json``."""
    theta, variance = result.solution.theta, np.diag(result.posterior.boundary)
    confidence, out = bands(result), {}
    for group, terms, (values, at) in zip(result.parameters.groups, inputs.groups, result.parameters.slices, strict=True):
        p, length, band = theta[values], tributary(group), confidence[group.name]
        before = None if reference is None else reference.parameters.get(group.name)
        entry: dict[str, Any] = {
            "kind": group.kind,
            "unit": unit_of(inputs, terms),
            "log10": p,
            "log10_effective": effective(group, p),
            "log10_per_metre": None if length is None else effective(group, p) - np.log10(length),
            "std": band.std,
            "lower95": _open(band.lower),
            "upper95": _open(band.upper),
            "initial": group.initial,
            "initial_effective": effective(group, group.initial),
            "reference_log10_effective": None if before is None else before.log10_effective,
            "bounds": group.bounds[0],
            "positions": group.xyz,
            "arc_length": group.arc_length,
            "bolts": _owners(inputs, group),
        }
        if group.name in result.saturations:
            limits = result.saturations[group.name]
            entry["saturation"] = {"free": limits.lower, "start": limits.start, "clamped": limits.upper}
        if at is not None and group.damping is not None:
            entry |= {
                "damping_exponent": theta[at],
                "damping_exponent_std": float(np.sqrt(max(variance[at], 0.0))),
                "damping_factor": 10.0 ** theta[at],
                "damping_beta": group.damping.beta,
                "damping_loss_factor": group.damping.loss_factor,
                "damping_bounds": group.damping.bounds,
            }
        out[group.name] = entry
    return out


def misfit_tree(inputs: Inputs, before: Floats, after: Floats) -> dict[str, Any]:
    """``misfit_db`` of a result: from the mean misfits of all responses before and after [dB]."""
    used, validation = inputs.used, inputs.validation
    return {
        "initial": mean_of(before[used]),
        "final": mean_of(after[used]),
        "held_out_initial": mean_of(before[validation]),
        "held_out_final": mean_of(after[validation]),
        "responses": {
            response.name: {"initial": before[i], "final": after[i], "used": bool(i in used)} for i, response in enumerate(inputs.responses)
        },
    }


def certificate_tree(stage: ReductionStage) -> dict[str, Any]:
    """What a result says of the reduced model it rests on."""
    reduction = stage.reduction
    return {
        "key": stage.decision.key,
        "size": reduction.model.size,
        "tolerance": reduction.options.tolerance,
        "worst": reduction.worst,
        "reached": reduction.reached,
    }


def _owners(inputs: Inputs, group: ParameterGroup) -> list[str | None] | None:
    """Name of the bolt that owns each value; None where no bolt owns any."""
    if group.bolt is None or inputs.bolts is None:
        return None
    return [inputs.bolts.name[bolt] if bolt >= 0 else None for bolt in group.bolt.tolist()]


def calibration_tree(inputs: Inputs) -> dict[str, Any] | None:
    """Key and factors of the calibration in the model; None for the model as exported."""
    use = inputs.calibration
    return {"key": use.key, "factors": use.factors} if use is not None and use.used else None


def curve_tree(curve: LCurve) -> dict[str, Any]:
    """L-curve as in ``result.json``; ``at`` is its corner between the weights tried."""
    corner = curve.corner
    return {
        "eta": curve.eta,
        "data": curve.data,
        "penalty": curve.penalty,
        "corner": None if corner is None else corner.index,
        "at": None if corner is None else {"data": corner.data, "penalty": corner.penalty},
        "chosen": curve.chosen,
        "evaluations": curve.evaluations,
    }


def _open(limits: Floats) -> list[float | None]:
    """Limits; None where an interval is open."""
    return [float(value) if np.isfinite(value) else None for value in limits]


def _typical(stds: Floats) -> float | None:
    """Median of the standard deviations that the prior has, in decades."""
    finite = stds[np.isfinite(stds)]
    return float(np.median(finite)) if finite.size else None


#: Columns of ``profile.csv`` beside group, term and position, and what of a parameter group they hold.
PROFILE = {
    "arc_length_m": "arc_length",
    "log10_initial": "initial_effective",
    "log10": "log10",
    "log10_effective": "log10_effective",
    "log10_per_metre": "log10_per_metre",
    "log10_reference": "reference_log10_effective",
    "bolt": "bolts",
}


def profile_rows(tree: Mapping[str, Any]) -> tuple[list[str], list[list[Any]]]:
    """Header and rows of ``profile.csv``."""
    rows = []
    for name, group in tree["parameters"].items():
        places, columns = group["positions"], [group[key] for key in PROFILE.values()]
        for k in range(len(group["log10"])):
            position = [None] * 3 if places is None else list(places[k])
            rows.append([name, k, *position, *(None if column is None else column[k] for column in columns)])
    return ["group", "term", "x", "y", "z", *PROFILE], rows


class Compared(Protocol):
    """A measurement with the FRFs of two states of the model on its lines."""

    @property
    def measurement(self) -> Measurement:
        """What was measured."""

    @property
    def selected(self) -> Integers:
        """Lines that entered the cost."""

    @property
    def initial(self) -> Complexes:
        """(F, R) FRFs before."""

    @property
    def updated(self) -> Complexes:
        """(F, R) FRFs after."""


def frf_rows(inputs: Inputs, result: Compared) -> tuple[list[str], list[list[Any]]]:
    """Header and rows of ``frf.csv``: dB re 1 unit/N and phase in degrees."""
    header = ["frequency_hz"]
    columns: list[Floats] = [result.measurement.frequency_hz]
    measured = result.measurement.values
    valid = np.isfinite(measured) & (np.abs(measured) > 0)
    for i, response in enumerate(inputs.responses):
        for label, values in (("measured", measured), ("initial", result.initial), ("updated", result.updated)):
            shown = np.where(valid[:, i], values[:, i], np.nan) if label == "measured" else values[:, i]
            header += [f"{response.name}_{label}_db", f"{response.name}_{label}_phase_deg"]
            with np.errstate(divide="ignore", invalid="ignore"):
                columns += [decibel(shown), np.asarray(np.degrees(np.angle(shown)))]
        header.append(f"{response.name}_coherence")
        columns.append(result.measurement.coherence[:, i])
    chosen = np.zeros(measured.shape[0], dtype=int)
    chosen[result.selected] = 1
    header.append("selected")
    rows = [[*(float(column[line]) for column in columns), int(chosen[line])] for line in range(measured.shape[0])]
    return header, rows


def write_failure(output: Path, inputs: Inputs, name: str, reason: str, identity: str | None) -> None:
    """Record a job that failed; an earlier success is kept as ``result.previous.json``, its tables and figures stay."""
    path = output / name / "result.json"
    try:
        before = read_job(output, name)
    except DataError:
        before = None
    if isinstance(before, JobRecord):
        path.replace(path.with_name("result.previous.json"))
    tree = {
        "job": name,
        "status": "failed",
        "reason": reason,
        "provenance": {"identity": identity, "versions": versions(), "inputs": inputs.hashes, "configuration": inputs.campaign.resolved()},
    }
    write_sealed(path, FailedJob.checked(tree))


def write_campaign(output: Path, inputs: Inputs) -> None:
    """Write ``campaign.json``: what the report needs to know of the campaign."""
    campaign = inputs.campaign
    bolts = [] if inputs.bolts is None else [{"name": n, "position": p} for n, p in zip(inputs.bolts.name, inputs.bolts.xyz, strict=True)]
    record = CampaignRecord.checked(
        {
            "campaign": campaign.name,
            "description": campaign.description,
            "test_article": campaign.test_article,
            "operator": campaign.operator,
            "compare_with": campaign.compare_with,
            "reference": campaign.update.reference,
            "reference_guessed": campaign.update.reference is not None and campaign.update.reference_guessed,
            "jobs": list(campaign.jobs),
            "bolts": bolts,
            "responses": [
                {"name": r.name, "quantity": r.quantity, "unit": r.unit, "used": bool(i in inputs.used)}
                for i, r in enumerate(inputs.responses)
            ],
            # Empty: the jobs rest on the model as exported although there is a calibration.
            "calibration": None if inputs.calibration is None else (inputs.calibration.key if inputs.calibration.used else ""),
            "tool": {"name": "lrbc", "version": __version__},
        }
    )
    write_sealed(output / "campaign.json", record)


def write_reduction(output: Path, inputs: Inputs, stage: ReductionStage) -> ReductionRecord:
    """Write ``reduction.json``: certificate, trace and costs of the reduced model."""
    r = stage.reduction
    seconds = dict(r.seconds)
    seconds["full_lines_worth"] = seconds["total"] / seconds["full_line"]
    tree = {
        "size": r.model.size,
        "size_structure": r.model.structure,
        "size_acoustic": r.model.size - r.model.structure,
        "full_size": r.full_size,
        "terms": r.model.terms,
        "inputs": int(r.model.B.shape[1]),
        "outputs": int(r.model.L.shape[0]),
        "band_hz": r.options.band_hz,
        "tolerance": r.options.tolerance,
        "reached": r.reached,
        "backend": r.backend,
        "symmetry": r.coupling,
        "expansion_points": [{"frequency_hz": t.frequency_hz, "order": t.order, "added": t.added} for t in r.trace if t.order],
        "certificate": {
            "held_out": [{"frequency_hz": line.frequency_hz, "errors": line.errors} for line in r.held_out],
            "worst": r.worst,
            "vectors": r.vectors,
            "unseen": r.unseen if np.isfinite(r.unseen) else None,
            "unseen_share": SHARE,
            "unseen_confidence": CONFIDENCE,
        },
        "trace": [
            {
                "step": i + 1,
                "size": t.size,
                "factorised_hz": t.frequency_hz if np.isfinite(t.frequency_hz) else None,
                "measured_error": t.measured_error,
                "frequency_hz": t.grid_hz if np.all(np.isfinite(t.estimate)) else [],
                "estimate": t.estimate if np.all(np.isfinite(t.estimate)) else [],
            }
            for i, t in enumerate(r.trace)
        ],
        "seconds": seconds,
        "machine": r.machine,
        "date": r.date,
        "calibration": calibration_tree(inputs),
        "cache": {"key": stage.decision.key, "hit": stage.decision.hit, "reason": stage.decision.reason},
        "versions": versions(),
    }
    record = ReductionRecord.checked(tree)
    return write_sealed(output / "reduction.json", record)
