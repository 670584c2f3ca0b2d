"""Makes the content of all result files of a job from its identification and judgement; ``results`` writes them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from lrbc_cli.arrays import Complexes, Floats, Integers
from lrbc_cli.campaign.digests import origin, program
from lrbc_cli.campaign.identification.correlate import FDAC_COLUMNS, correlation_of, correlation_tree, fdac_rows, mean_of
from lrbc_cli.campaign.identification.found import Identification
from lrbc_cli.campaign.identification.nuisances import nuisance_tree
from lrbc_cli.campaign.identification.records import Measurement
from lrbc_cli.campaign.jobs.evidence import bands, copied_baseline, effective, evidence_of
from lrbc_cli.campaign.jobs.identity import Identity
from lrbc_cli.campaign.jobs.judging import ComparedWith, with_judgement
from lrbc_cli.campaign.jobs.standing import rests_on
from lrbc_cli.campaign.reading.inputs import Inputs, TermGroup
from lrbc_cli.campaign.reduced.stage import ReductionStage
from lrbc_cli.campaign.updated.modes import modes_tree
from lrbc_cli.campaign.updated.shapes import shapes_of
from lrbc_cli.model.terms import ParameterGroup
from lrbc_cli.results.job import JobRecord
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
    name : str
    tree : dict
        Content of ``result.json`` without the hashes of the other files.
    tables : dict
        Header and rows of each CSV file, by file name.
    evidence : Evidence
    shapes : ShapesRecord or None
    """

    name: str
    tree: dict[str, Any] = field(repr=False)
    tables: dict[str, Table] = field(repr=False)
    evidence: Evidence = field(repr=False)
    shapes: ShapesRecord | None = field(repr=False)


def finish(
    inputs: Inputs,
    stage: ReductionStage | None,
    result: Identification,
    tight: ComparedWith,
    identities: tuple[Identity, Identity],
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
    """
    evidence, identified = evidence_of(inputs, result), identified_tree(inputs, stage, result)
    copied = copied_baseline(inputs, result.name, result.measurement)
    tree = with_judgement(inputs.campaign, inputs.method.rule, identified, evidence.beside(copied), tight)
    correlation = correlation_of(inputs, result)
    tree["correlation"] = correlation_tree(inputs, correlation)
    own, judgement = identities
    tree["provenance"] |= {
        **own.tree(),
        "origin": origin_of(inputs),
        "program": program(),
        "judgement": judgement.tree() | {"copied": copied},
        "rests_on": rests_on(tight),
    }
    tables = {
        "profile.csv": profile_rows(tree),
        "frf.csv": frf_rows(inputs, result.measurement, result.selected, result.initial, result.updated),
        "fdac.csv": (FDAC_COLUMNS, fdac_rows(result, correlation)),
    }
    return Finished(name=result.name, tree=tree, tables=tables, evidence=evidence, shapes=shapes_of(inputs, stage, result))


def result_record(
    inputs: Inputs, stage: ReductionStage | None, result: Identification, evidence: Evidence, baselines: Mapping[str, JobRecord]
) -> JobRecord:
    """Judged record of an identification that is not written to files, without correlation and digests."""
    tight = ComparedWith(result.reference, baselines)
    return JobRecord.checked(with_judgement(inputs.campaign, inputs.method.rule, identified_tree(inputs, stage, result), evidence, tight))


def identified_tree(inputs: Inputs, stage: ReductionStage | None, result: Identification) -> dict[str, Any]:
    """The part of ``result.json`` that the identification gives, without judgement."""
    campaign, solution, knowledge = inputs.campaign, result.solution, result.posterior
    return {
        "parameters": parameter_trees(inputs, result),
        "covariance": knowledge.boundary,
        "cost": {"initial": solution.history[0].cost, "final": solution.evaluation.cost},
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
        "nuisances": nuisance_tree(inputs, knowledge, result.gains),
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


def parameter_trees(inputs: Inputs, result: Identification) -> dict[str, Any]:
    """The key ``parameters`` of ``result.json``: values, intervals and bounds of each group, as log10."""
    theta, variance = result.solution.theta, np.diag(result.posterior.boundary)
    confidence, out = bands(result), {}
    for terms, (group, values, at) in zip(inputs.groups, result.parameters.placed, strict=True):
        p, length, band = theta[values], tributary(group), confidence[group.name]
        before = None if result.reference is None else result.reference.parameters.get(group.name)
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
    """The key ``misfit_db`` of a result, from (R,) mean misfits before and after the identification [dB]."""
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
    """Key, size and measured error of the reduced model, as in ``result.json``."""
    reduction = stage.reduction
    return {
        "key": stage.decision.key,
        "size": reduction.model.size,
        "tolerance": reduction.options.tolerance,
        "worst": reduction.worst,
        "reached": reduction.reached,
    }


def _owners(inputs: Inputs, group: ParameterGroup) -> list[str | None] | None:
    """Name of the bolt that owns each value of a group; None if bolts own none."""
    if group.bolt is None or inputs.bolts is None:
        return None
    return [inputs.bolts.name[bolt] if bolt >= 0 else None for bolt in group.bolt.tolist()]


def origin_of(inputs: Inputs) -> str | None:
    """See ``digests.origin``; None if the campaign file does not state everything (``Inputs.by_hand``)."""
    return origin(inputs.campaign, inputs.read_with) if inputs.read_with and not inputs.by_hand else None


def calibration_tree(inputs: Inputs) -> dict[str, Any] | None:
    """Key and factors of the calibration in the model; None for the model as exported."""
    use = inputs.calibration
    return {"key": use.key, "factors": use.factors} if use is not None and use.used else None


def curve_tree(curve: LCurve) -> dict[str, Any]:
    """L-curve as in ``result.json``; ``at`` is the corner, interpolated between the weights tried."""
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
    """Limits as in ``result.json``: None where an interval is open."""
    return [float(value) if np.isfinite(value) else None for value in limits]


def _typical(stds: Floats) -> float | None:
    """Median of the finite standard deviations of the prior [decades]; None if there are none."""
    finite = stds[np.isfinite(stds)]
    return float(np.median(finite)) if finite.size else None


#: Columns of ``profile.csv`` after group, term and position, and the key of ``parameters`` that each holds.
PROFILE = {
    "arc_length_m": "arc_length",
    "log10_initial": "initial_effective",
    "log10": "log10",
    "log10_effective": "log10_effective",
    "log10_per_metre": "log10_per_metre",
    "log10_reference": "reference_log10_effective",
    "bolt": "bolts",
}


def profile_rows(tree: Mapping[str, Any]) -> Table:
    """Header and rows of ``profile.csv``."""
    rows = []
    for name, group in tree["parameters"].items():
        places, columns = group["positions"], [group[key] for key in PROFILE.values()]
        for k in range(len(group["log10"])):
            position = [None] * 3 if places is None else list(places[k])
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


def unit_of(inputs: Inputs, group: TermGroup) -> str:
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
