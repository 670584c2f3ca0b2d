"""A deterministic campaign of invented results, in the layout of the result files; shaped like a SoundBox, without its physics."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from lrbc_cli.results.fields import Record, SealedRecord, StoredRecord
from lrbc_cli.results.job import FailedJob, JobRecord
from lrbc_cli.results.model import CalibrationRecord, CampaignRecord, ReductionRecord
from lrbc_cli.results.store import digest_of, read, sealed, write

NODES, Y = 31, np.linspace(0.2, 0.7, 31)
BOLTS = 17
BOLT_Y = np.linspace(0.18, 0.72, BOLTS)
ORDER = [8, 9, 10, 11, 7, 12, 5, 6, 13, 14, 4, 15, 3, 2, 16, 1, 17]
COUNTS = (0, 4, 6, 10, 12, 15, 17)
MODES = np.array([47.0, 62.0, 88.0, 121.0, 139.0, 163.0, 171.0, 204.0, 228.0, 251.0, 287.0, 302.0, 341.0, 366.0, 389.0])


def _write(file: Path, kind: type[StoredRecord], document: dict) -> None:
    record = kind.checked(document)
    write(file, sealed(record) if isinstance(record, SealedRecord) else record)


def reseal(file: Path, document: dict) -> None:
    """Write a changed document, with the digest that it has now."""
    digest = {"digest": digest_of(document)} if "digest" in document else {}
    file.write_text(json.dumps(document | digest), encoding="utf-8")


def changed(record: Record, **values) -> Record:
    """A copy of a record with other values."""
    return record.model_copy(update=values)


def campaign_of(folder: Path) -> CampaignRecord:
    return read(folder / "campaign.json", CampaignRecord)


def reduction_of(folder: Path) -> ReductionRecord | None:
    return read(folder / "reduction.json", ReductionRecord)


def _frf(frequency, shift, loss, seed):
    omega, modes = 2 * np.pi * frequency[:, None], 2 * np.pi * MODES * (1 + shift)
    amplitude = np.random.default_rng(seed).normal(size=len(MODES)) * 4e3
    return (amplitude / (modes**2 - omega**2 + 1j * loss * modes * omega)).sum(axis=1) * 8


def _columns(name, state, values):
    return {
        f"{name}_{state}_db": 20 * np.log10(np.abs(values)),
        f"{name}_{state}_phase_deg": np.degrees(np.angle(values)),
    }


def write_frf(file: Path, removed: int, responses: Sequence[str], lines: int, coherence: bool) -> np.ndarray:
    frequency = np.linspace(20.0, 400.0, lines)
    table = {"frequency_hz": frequency}
    sag = -0.06 * removed / 17 * np.linspace(1, 0.3, len(MODES))
    for index, name in enumerate(responses):
        noise = np.random.default_rng(1000 + index + 31 * removed).normal(size=(2, lines)) @ np.eye(lines)
        measured = _frf(frequency, sag, 0.006 + 0.0006 * removed, index)
        measured = measured * (1 + 0.02 * noise[0] + 0.02j * noise[1]) + 2e-4 * (noise[1] + 1j * noise[0])
        table |= _columns(name, "measured", measured)
        table |= _columns(name, "initial", _frf(frequency, 0.012, 0.004, index))
        table |= _columns(name, "updated", _frf(frequency, sag + 0.001, 0.0065 + 0.0006 * removed, index))
        if coherence:
            table[f"{name}_coherence"] = np.clip(1 - 4e-3 / (np.abs(measured) + 1e-3), 0, 1)
    file.parent.mkdir(parents=True, exist_ok=True)
    rows = [",".join(table)] + [",".join(f"{value:.6g}" for value in row) for row in np.column_stack(list(table.values()))]
    file.write_text("\n".join(rows) + "\n", encoding="utf-8")
    return frequency


def write_reduction(output: Path) -> None:
    rng = np.random.default_rng(7)
    kinds = {"free": 0.3, "initial": 0.15, "loose": 0.2, "clamped": 0.1, "beyond": 0.12, "random": 1.0}
    held_out = [
        {"frequency_hz": f, "errors": {kind: float(4e-4 * scale * 10 ** -rng.uniform(0, 1.5)) for kind, scale in kinds.items()}}
        for f in (33.3, 97.1, 151.7, 202.9, 266.6, 318.2, 377.7)
    ]
    band = np.linspace(20, 400, 77)
    taken, trace = [210.0], []
    for step, place in enumerate((60.0, 350.0, 130.0, 285.0, 395.0, 20.0, 170.0), start=1):
        near = np.min(np.abs(band[:, None] - np.array(taken)[None, :]), axis=1)
        estimate = 10 ** (-6.5 + 5.2 * np.tanh(near / 45)) * (1 + 0.5 * np.sin(band / 3))
        trace.append(
            {
                "step": step,
                "size": 30 * step,
                "factorised_hz": taken[-1],
                "measured_error": None if step == 1 else float(estimate.max()) / 2,
                "frequency_hz": band.tolist(),
                "estimate": estimate.tolist(),
            }
        )
        taken.append(place)
    _write(
        output / "reduction.json",
        ReductionRecord,
        {
            "size": 210, "size_structure": 105, "size_acoustic": 105, "full_size": 23041, "terms": 31,
            "inputs": 1,
            "outputs": 10, "band_hz": [20, 400], "tolerance": 1e-3, "reached": True, "backend": "pardiso",
            "expansion_points": [{"frequency_hz": f, "order": 1, "added": 30} for f in taken[:-1]],
            "certificate": {"held_out": held_out, "worst": max(max(h["errors"].values()) for h in held_out), "vectors": 24, "unseen": 8e-4,
                            "unseen_share": 0.95, "unseen_confidence": 0.95},
            "trace": trace,
            "seconds": {
                "full_line": 0.61, "reduced_line": 0.0019, "port_line": 4.4e-5, "basis": 5.91, "projection": 0.42, "certificate": 2.2,
                "total": 8.66, "full_lines_worth": 14.2,
            },
            "machine": {"platform": "Linux-6.1-x86_64", "processor": "x86_64", "cores": 2},
            "date": "2026-11-21T09:14:03Z",
            "cache": {"key": "9f2c11ab", "hit": False, "reason": "no reduced model with this key"},
            "versions": {"lrbc": "0.1.0", "numpy": "2.0.0", "scipy": "1.14.0"},
        },
    )  # fmt: skip


def write_job(
    output: Path,
    job: str,
    removed: int,
    *,
    responses: Sequence[str],
    used: Sequence[str],
    status: str = "converged",
    truth: bool = True,
    bolts: bool = True,
    reference: bool = True,
    damping: bool = True,
    groups: Sequence[str] = ("left_edge",),
    band: bool = False,
    coherence: bool = False,
    evidence: bool = False,
    lines: int = 381,
) -> None:
    names = [f"B{number:02d}" for number in ORDER[:removed]]
    rng = np.random.default_rng(100 + removed)
    frequency = write_frf(output / job / "frf.csv", removed, responses, lines, coherence)
    tight = 4.6 + 0.25 * np.sin(9 * Y) + 0.1 * np.random.default_rng(3).normal(size=NODES)
    effective = tight + 0.12 * rng.normal(size=NODES)
    for number in ORDER[:removed]:
        effective -= 1.3 * np.exp(-(((Y - BOLT_Y[number - 1]) / 0.024) ** 2))
    parameters = {}
    for index, group in enumerate(groups):
        entry = {
            "kind": "stiffness", "unit": "N m/rad", "log10": (effective + 0.1).tolist(),
            "log10_effective": (effective - 0.4 * index).tolist(),
            "initial": [4.0] * NODES, "initial_effective": [4.0] * NODES,
            "reference_log10_effective": tight.tolist() if reference else None, "bounds": [-1.0, 7.0],
            "positions": [[0.1 + 0.8 * index, float(y), -0.035] for y in Y], "arc_length": (Y - Y[0]).tolist(),
        }  # fmt: skip
        if band:
            entry |= {"std": [0.2] * NODES, "lower95": (effective - 0.4).tolist(), "upper95": (effective + 0.5).tolist()}
        if evidence:
            # Tight nodes have no upper limit, one free node no lower one.
            open_above = effective > tight - 0.3
            entry |= {
                "std": [0.2] * NODES,
                "lower95": [None if removed and k == 15 else float(v) - 0.3 for k, v in enumerate(effective)],
                "upper95": [None if above else float(v) + 0.4 for v, above in zip(effective, open_above, strict=True)],
            }
        if damping:
            exponent = -0.3 + 0.19 * removed
            entry |= {
                "damping_exponent": exponent,
                "damping_factor": 10**exponent,
                "damping_exponent_std": 0.1,
                "damping_bounds": [-0.4, 4.0],
            }
        parameters[group] = entry
    found = []
    for number in range(1, BOLTS + 1) if bolts else ():
        name = f"B{number:02d}"
        change = float(np.interp(BOLT_Y[number - 1], Y, effective - tight))
        if not Y[0] <= BOLT_Y[number - 1] <= Y[-1]:
            found.append(
                {
                    "name": name, "position": [0.09, float(BOLT_Y[number - 1]), -0.035], "log10_stiffness": None, "change": None,
                    "change_std": None, "threshold": None, "probability_loose": None, "probability_changed": None, "verdict": "outside",
                    "removed": name in names if truth else None,
                    "note": "no term within half a pitch; the nearest is 20 mm away along the edge",
                }
            )  # fmt: skip
            continue
        found.append(
            {
                "name": name, "position": [0.09, float(BOLT_Y[number - 1]), -0.035],
                "log10_stiffness": float(np.interp(BOLT_Y[number - 1], Y, effective)), "change": change if reference else None,
                "verdict": "loose" if change < -0.9 else "undecided" if change < -0.6 else "tight",
                "removed": name in names if truth else None, "note": None,
            }
        )  # fmt: skip
        if evidence:
            # One that the data do not decide.
            probability = 0.4 if removed and number == 3 else float(1 / (1 + np.exp((change + 0.75) / 0.09)))
            verdict = "undecided" if 0.05 < probability < 0.95 else "loose" if probability >= 0.95 else "tight"
            found[-1] |= {"probability_loose": probability, "verdict": verdict, "change_std": 0.15, "threshold": -0.75}
            found[-1]["probability_changed"] = float(1 / (1 + np.exp((change + 0.4) / 0.09)))
    evaluations = 14 + removed
    start, end = 5.1 + 0.05 * removed, 3.7 + 0.01 * removed
    history = [
        {"evaluation": k, "cost": end + (start - end) * np.exp(-k / 3), "misfit_db": 1.0 + (2.2 + 0.2 * removed) * np.exp(-k / 3)}
        for k in range(evaluations)
    ]
    per = {
        name: {"initial": 3.0 + 0.2 * removed + 0.1 * i, "final": 1.0 + 0.07 * i, "used": name in used} for i, name in enumerate(responses)
    }
    mean = {state: float(np.mean([per[name][state] for name in responses if name in used])) for state in ("initial", "final")}
    more = _evidence(status, responses, set(responses) <= set(used)) if evidence else {}
    if evidence:
        write_fdac(output / job / "fdac.csv")
    selected = frequency[(np.abs(frequency[:, None] - MODES[None, :]) < 4).any(axis=1)]
    _write(
        output / job / "result.json",
        JobRecord,
        {
            "job": job, "status": status,
            "reason": "gradient below 1e-4" if status == "converged" else "limit of iterations",
            "removed": names if truth else None, "parameters": parameters, "cost": {"initial": start, "final": end},
            "misfit_db": {**mean, "held_out_initial": None, "held_out_final": None, "responses": per},
            "noise": {"sigma_db": 1.3, "correlation_factor": 5.5}, "bolts": found, "iterations": 12 + removed, "evaluations": evaluations,
            "line_evaluations": evaluations * len(selected), "history": history,
            "lines": {"frequency_hz": selected.tolist(), "count": len(selected)},
            "optimiser": {
                "method": "gauss-newton", "regularisation": 0.04, "regularisation_per_residual": 0.001,
                "starts": [{"description": f"start {k}", "cost": end, "total": end, "kept": k == 0} for k in range(5 if removed else 2)],
            },
            "seconds": {"read": 0.11, "port": 0.4, "optimise": 0.05 * evaluations, "total": 0.6 + 0.05 * evaluations},
            "provenance": {
                "versions": {"lrbc": "0.1.0", "numpy": "2.0.0"}, "inputs": {f"frf/{job}.uff": f"{removed:064x}", "model.h5": "ab" * 32},
                "configuration": {"campaign": "soundbox-left-edge", "update": {"method": "gauss-newton", "regularisation": 0.04}},
                "certificate": {"key": "9f2c11ab", "size": 210, "worst": 4e-4, "tolerance": 1e-3},
            },
            **more,
        },
    )  # fmt: skip


def _evidence(status: str, responses: Sequence[str], fitted: bool) -> dict:
    """What tells how far to trust a result; ``fitted``: no response was left out."""
    passed = False if status == "unexplained" else None if fitted else True
    misfit = 4.7 if passed is False else 1.6
    peaks = [{"measured_hz": float(f), "initial_hz": None if f > 350 else float(f * 1.013), "final_hz": float(f * 1.002)} for f in MODES]
    return {
        "notes": ["left_edge: 3 of 31 values at the lower and 0 at the upper bound", "mic02: values on 300 of 381 lines only"],
        "validity": {
            "passed": passed, "compared": "channels used" if fitted else "validation channels", "misfit_db": misfit,
            "held_out_db": None if fitted else misfit, "limit_db": 3.0, "reason": f"misfit of these channels {misfit} dB",
        },
        "nuisances": {
            "sound_speed_percent": {"value": -0.21, "std": 0.03},
            "temperature_kelvin": {"value": 0.9, "std": None},
            "gain_db": {name: {"value": 0.1 * k, "std": 0.05} for k, name in enumerate(responses)},
            "hammer_offset_mm": {"x": {"value": 1.2}, "y": {"value": -0.4, "std": None}},
        },
        "correlation": {
            "frac_initial": 0.42, "frac_final": 0.83, "peak_shift_percent_initial": 1.3, "peak_shift_percent_final": 0.2,
            "frac_held_out_initial": None, "frac_held_out_final": None, "fdac_diagonal_initial": 0.5, "fdac_diagonal_final": 0.9,
            "mean_spectrum": {"peaks": peaks},
            "responses": {
                name: {"frac_initial": 0.4, "frac_final": None if k == 1 else 0.8, "peaks": peaks[k:]} for k, name in enumerate(responses)
            },
        },
    }  # fmt: skip


def write_fdac(file: Path, size: int = 24) -> None:
    frequency = np.linspace(20.0, 400.0, size)
    table = {"measured_hz": np.repeat(frequency, size), "model_hz": np.tile(frequency, size)}
    for name, shift in (("initial", 12.0), ("updated", 0.0)):
        distance = frequency[:, None] - frequency[None, :] + shift
        cosine = np.cos(distance / 30) * np.exp(-((distance / 90) ** 2))
        cosine[size // 5 + 1] = np.nan
        table[name] = cosine.ravel()
    rows = [",".join(table)] + [",".join("" if np.isnan(v) else f"{v:.6g}" for v in row) for row in zip(*table.values(), strict=True)]
    file.write_text("\n".join(rows) + "\n", encoding="utf-8")


def write_calibration(output: Path, *, used: bool = True, lines: int = 200) -> None:
    rounds = [
        {"misfit_db": 2.5 * 0.55**k + 0.8, "factors": {"stiffness.structure": 1 + 0.004 * k}, "error": 6e-4 / (k + 1), "size": 231}
        for k in range(4)
    ]
    factors = {
        "stiffness.structure": {"value": 1.0121, "std": 0.0008, "lower95": 1.0105, "upper95": 1.0137, "initial": 1.0},
        "mass.acoustic": {"value": 0.9931, "std": 0.0004, "lower95": 0.9923, "upper95": 0.9939, "initial": 1.0},
        "alpha.structure": {"value": 5.61, "std": 0.4, "lower95": 4.8, "upper95": 6.4, "initial": 1.0},
        "beta.structure": {"value": 0.029, "std": 0.019, "lower95": None, "upper95": 0.067, "initial": 1.0},
        "beta.acoustic": {"value": 0.081, "std": None, "lower95": None, "upper95": None, "initial": 1.0},
    }
    write_frf(output / "calibration" / "frf.csv", 0, ("mic01", "mic02"), lines, False)
    _write(
        output / "calibration.json",
        CalibrationRecord,
        {
            "job": "bolts-00", "factors": factors, "parts": {}, "status": "converged", "reason": "small steps", "boundary_held": False,
            "misfit_db": {"initial": 3.31, "final": 0.93, "held_out_initial": 3.02, "held_out_final": 1.11, "responses": {}},
            "noise": {"sigma_db": 1.0, "correlation_factor": 2.0}, "stages": [], "lines": {"frequency_hz": [], "count": 0},
            "seconds_by_stage": {"total": 31.2}, "provenance": {},
            "used": used, "key": "5e1b70aa", "rounds": rounds,
            "reduction": {"worst": 4.1e-4, "tolerance": 1e-3, "size": 231, "held_out": []}, "seconds": 31.2, "frf": "calibration/frf.csv",
        },
    )  # fmt: skip


def write_failed_job(output: Path, job: str, reason: str) -> None:
    _write(
        output / job / "result.json",
        FailedJob,
        {"job": job, "status": "failed", "reason": reason, "provenance": {"versions": {"lrbc": "0.1.0"}}},
    )


def write_campaign(
    output: Path,
    counts: Sequence[int] = COUNTS,
    *,
    responses: Sequence[str] = tuple(f"mic{k:02d}" for k in range(1, 11)),
    used: Sequence[str] = ("mic01", "mic03", "mic04", "mic05", "mic09", "mic10"),
    failed: Sequence[str] = (),
    reduction: bool = True,
    bolts: bool = True,
    reference: bool = True,
    name: str = "soundbox-left-edge",
    unexplained: Sequence[int] = (),
    calibration: bool = False,
    said: Mapping[str, str] | None = None,
    **job_options,
) -> list[str]:
    """Write a whole campaign; returns the names of its jobs in order."""
    jobs = [f"bolts-{count:02d}" for count in counts]
    if len(set(jobs)) != len(jobs):
        jobs = [f"job-{index:03d}" for index in range(len(counts))]
    for job, count in zip(jobs, counts, strict=True):
        options = {**job_options, "status": "unexplained"} if count in unexplained else job_options
        write_job(output, job, count, responses=responses, used=used, bolts=bolts, reference=reference, **options)
    for job in failed:
        write_failed_job(output, job, "the record mic03 holds no line inside the band 20 to 400 Hz")
    places = [{"name": f"B{k + 1:02d}", "position": [0.09, float(BOLT_Y[k]), -0.035]} for k in range(BOLTS)] if bolts else []
    _write(
        output / "campaign.json",
        CampaignRecord,
        {
            "campaign": name, "reference": jobs[0] if jobs and reference else None,
            "jobs": [*jobs, *failed], "bolts": places,
            "responses": [{"name": entry, "quantity": "pressure", "unit": "Pa/N", "used": entry in used} for entry in responses],
            "tool": {"name": "lrbc", "version": "0.1.0"},
            **(said or {}),
        },
    )  # fmt: skip
    if reduction:
        write_reduction(output)
    if calibration:
        write_calibration(output)
    return [*jobs, *failed]
