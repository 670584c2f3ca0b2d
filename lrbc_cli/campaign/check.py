"""``lrbc check``: examines model, settings and measurements of a campaign, and predicts what ``lrbc update`` will do and cost."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from lrbc_cli.arrays import Complexes, Floats
from lrbc_cli.campaign.beside import passed_over, taken_twice, unnamed
from lrbc_cli.campaign.identification.compared.chains import chain_doubt, coherence_doubt, noise_doubt, soft_tip
from lrbc_cli.campaign.identification.compared.copies import Earlier, pasted
from lrbc_cli.campaign.identification.records import Measurement, read_measurement
from lrbc_cli.campaign.identification.unknowns import select_lines
from lrbc_cli.campaign.jobs.plans import JobPlan, choose_jobs, plan
from lrbc_cli.campaign.looking.axes import other_lines, without_coherence
from lrbc_cli.campaign.looking.exchanges import exchanged_files, mistitled
from lrbc_cli.campaign.looking.first_look import FirstLook, first_look
from lrbc_cli.campaign.reading.inputs import Inputs
from lrbc_cli.campaign.reading.model_doubts import loss_factor, undamped_text
from lrbc_cli.campaign.reduced import cache
from lrbc_cli.campaign.reduced.memory import GB, limit_of, reduction_cost
from lrbc_cli.config.settings import EveryLine
from lrbc_cli.errors import LrbcError, NumericalError
from lrbc_cli.model.coupling import asymmetry, coupling_of
from lrbc_cli.model.dofs import COMPONENTS
from lrbc_cli.reduction.solve import pardiso
from lrbc_cli.updating.statistics.lines import (
    covers,
    few_digits,
    few_resonances,
    interpolated,
    missed,
    normalised,
    phaseless,
    too_wide,
    unresolved,
)


@dataclass(kw_only=True)
class Findings:
    """Findings as sections of text, and the same as a tree for programs.

    Attributes
    ----------
    sections : dict of lists of str
    warnings : list of str
    errors : dict
        Error of each job with an unusable measurement.
    jobs : list of JobPlan
    tree : dict
    predicted : dict or None
        Memory [bytes] and time [s] of the reduction, if it has to be done.
    """

    sections: dict[str, list[str]] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)
    errors: dict[str, LrbcError] = field(default_factory=dict)
    jobs: list[JobPlan] = field(default_factory=list)
    tree: dict[str, Any] = field(default_factory=dict)
    predicted: dict[str, Any] | None = None


def check(
    inputs: Inputs, folder: Path, detailed: bool = False, pictured: bool = False, progress: Callable[[str], None] = lambda _: None
) -> Findings:
    """Examine the inputs of a campaign; changes no files.

    Parameters
    ----------
    inputs : Inputs
    folder : Path
        Folder of the cache of reduced models.
    detailed : bool
        List the record of each response for every job.
    pictured : bool
        The structure is drawn, so the hint on how to draw it is omitted.
    progress : callable
        Receives one line of text per step.

    Returns
    -------
    Findings
        Unusable measurements are errors by job; all other errors were raised when the inputs were read.
    """
    out = Findings()
    out.sections["files"] = list(inputs.notes)
    out.warnings += inputs.warnings
    out.warnings += [*passed_over(inputs.campaign), *unnamed(inputs.campaign)]
    out.warnings += _unwritable(inputs.campaign.output)
    out.warnings += filter(None, [undamped_text(inputs.model, inputs.groups)])
    out.sections["model"] = _model(inputs)
    parts = cache.key_parts(inputs)
    decision = cache.look_up(folder, parts)
    out.sections["reduced model"] = _reduction(inputs, decision, out)
    use = inputs.calibration
    if use is not None and use.stale:
        out.warnings.append(f"calibration: {use.text}")
    if use is not None and (use.used or not use.stale):
        out.sections["calibration"] = [use.text, *(f"{name} = {value:.6g}" for name, value in use.factors.items())]
    out.sections["method"] = inputs.method.choices
    out.warnings += [*inputs.method.warnings, *_unvalidated(inputs)]
    out.sections["jobs"] = _jobs(inputs, folder, parts, out, detailed, progress)
    out.sections["more"] = [
        *([] if pictured else ["lrbc check --picture draws the structure with bolts, sensors and updated terms"]),
        "lrbc plan shows, from the model alone, which bolts these responses can detect, and ranks the responses",
    ]
    out.tree = _tree(inputs, out, decision)
    return out


def _tree(inputs: Inputs, out: Findings, decision: cache.CacheDecision) -> dict[str, Any]:
    """The findings as a tree for programs."""
    use, model = inputs.calibration, inputs.model
    return {
        "campaign": inputs.campaign.name,
        "dofs": model.size,
        "acoustic_dofs": int(model.is_acoustic.sum()),
        "terms": model.terms.size,
        "parameters": {group.name: group.count for group in inputs.groups},
        "responses": [r.name for r in inputs.responses],
        "cache": {"hit": decision.hit, "reason": decision.reason, "key": decision.key},
        "reduction": out.predicted,
        "method": inputs.method.tree(),
        "decision_rule": asdict(inputs.method.rule),
        "calibration": None if use is None else {"used": use.used, "text": use.text, "factors": use.factors},
        "jobs": {p.name: {"run": p.run, "judge": p.judge, "reason": p.reason} for p in out.jobs},
        "errors": {name: error.message for name, error in out.errors.items()},
        "warnings": out.warnings,
        "text": out.sections,
    }


def _model(inputs: Inputs) -> list[str]:
    m = inputs.model
    acoustic = int(m.is_acoustic.sum())
    lines = [f"{m.size} DOFs: {m.size - acoustic} structural, {acoustic} acoustic"]
    coupling = coupling_of(m.K, m.C, m.M, m.is_acoustic)
    lines.append(f"symmetry: {coupling.text}")
    for name, matrix in (("stiffness", m.K), ("mass", m.M), ("damping", m.C)):
        defect = asymmetry(matrix)
        if not acoustic and defect > 0 and not coupling.symmetric:
            lines.append(f"{name}: relative asymmetry {defect:.1e}")
    if np.iscomplexobj(m.K.data):
        lines.append(f"stiffness is complex (hysteretic damping), loss factor about {loss_factor(m):.3g}")
    massless = int((np.abs(m.M).sum(axis=0) == 0).sum())
    if massless:
        lines.append(f"{massless} massless DOFs (singular mass matrix): allowed")
    if inputs.dofs is not None:
        masses = []
        for component in COMPONENTS[:3]:
            index = np.flatnonzero(inputs.dofs.component == component)
            if index.size:
                masses.append(f"{component} {float(m.M[index][:, index].sum()):.4g} kg")
        if masses:
            lines.append("mass sum over translations: " + ", ".join(masses) + " (free DOFs only; compare with the weight of the structure)")
    symmetric = "same left and right vectors" if m.terms.symmetric else "left and right vectors differ"
    lines.append(
        f"{m.terms.size} rank-one terms ({symmetric}), {m.B.shape[1]} excitation(s), {m.L.shape[0]} response(s), {inputs.used.size} used"
    )
    return lines


def _reduction(inputs: Inputs, decision: cache.CacheDecision, out: Findings) -> list[str]:
    r = inputs.campaign.reduction
    lines = [f"band {r.band[0]:g} to {r.band[1]:g} Hz, tolerance {r.tolerance:g}, back end {pardiso.resolved(r.backend)}"]
    if decision.hit:
        lines.append(f"cache: hit ({decision.reason})")
        if decision.missed:
            out.warnings.append(f"the reduced model in the cache: {decision.missed}; --accept-tolerance uses it")
    else:
        lines.append(f"cache: miss ({decision.reason})")
        try:
            cost, peak = reduction_cost(inputs)
        except NumericalError as error:
            out.warnings.append(error.problem)
            return lines
        limit, source = limit_of(inputs)
        lines.append(
            f"estimate: about {_rounded(cost.seconds)} s, a peak of {peak / GB:.2f} GB ({cost.memory['factors'] / GB:.2f} GB of it for "
            f"{cost.nonzeros / 1e6:.2f} million entries of the factors) of {limit / GB:.1f} GB {source}"
        )
        if peak > limit:
            out.warnings.append(f"not enough memory for the reduction: {peak / GB:.2f} GB of {limit / GB:.2f} GB {source}")
        out.predicted = {
            "peak_bytes": round(peak),
            "available_bytes": round(limit) if np.isfinite(limit) else None,
            "seconds": cost.seconds,
            "factor_nonzeros": cost.nonzeros,
            "parts_bytes": {part: round(size) for part, size in cost.memory.items()},
        }
    return lines


def _rounded(seconds: float) -> str:
    return f"{seconds:.0f}" if seconds >= 9.5 else f"{seconds:.1g}"


def _jobs(inputs: Inputs, folder: Path, parts: dict[str, str], out: Findings, detailed: bool, progress: Callable[[str], None]) -> list[str]:
    if not inputs.campaign.jobs:
        return ["none"]
    lines: dict[str, list[str]] = {}
    readable: dict[str, Measurement] = {}
    held: dict[tuple[str, ...], str] = {}
    chosen_lines, sparse = inputs.method.lines, list[str]()
    earlier, names = Earlier(inputs.statistics.validation), [response.name for response in inputs.responses]
    for name, job in inputs.campaign.jobs.items():
        progress(f"reading the measurement of {name}")
        try:
            measurement = read_measurement(inputs, job, name)
            selected = select_lines(inputs, measurement, name)
        except LrbcError as error:
            out.errors[name] = error
            lines[name] = [f"{name}: unusable, see its error"]
            continue
        first = held.setdefault(tuple(measurement.hashes.values()), name)
        if first != name:
            out.warnings += taken_twice(inputs.campaign, first, name)
        elif copied := earlier.copied(measurement, names):
            out.warnings.append(f"job {name}: {copied}. Write its own file under jobs.{name}.frf")
        earlier.add(name, measurement)
        readable[name] = measurement
        records = sum(bool(np.isfinite(measurement.values[:, i]).any()) for i in range(len(inputs.responses)))
        notes = (*_packed(measurement.notes), *(measurement.records if detailed else ()))
        matched = f"{records} of {len(inputs.responses)} responses matched"
        lines[name] = [f"{name}: {measurement.lines}, {selected.size} selected, {matched}", *(f"  {note}" for note in notes)]
        out.warnings += [*measurement.warnings, *_poor(inputs, name, measurement)]
        out.warnings += [f"job {name}: {text}" for text in pasted(measurement, names, inputs.statistics.validation)]
        empty, count = missed(measurement.frequency_hz, measurement.values[:, inputs.used], selected)
        # Listed lines were chosen individually, so they are not checked.
        if 2 * empty > count and isinstance(chosen_lines, EveryLine):
            sparse.append(f"{name} ({empty} of {count})")
        if straight := interpolated(measurement.values, inputs.statistics.resolution):
            out.warnings.append(f"job {name}: {straight}")
    out.warnings += _unclear(inputs, readable)
    if sparse and isinstance(chosen_lines, EveryLine):
        out.warnings.append(
            f"update.lines: {{every: {chosen_lines.every}}} selects no line at most of the resonances, where "
            f"changes show most: {', '.join(sparse)}. Write lines: resonances"
        )
    out.warnings += [*other_lines(inputs.campaign.update.reference, readable), *without_coherence(readable)]
    out.warnings = _once(out.warnings)
    note = _compared(inputs, folder, readable, out, progress)
    try:
        out.jobs = [p for p in plan(inputs, parts, choose_jobs(inputs.campaign, ())) if p.name in readable]
    except OSError:
        out.jobs = []
    for planned in out.jobs:
        lines[planned.name][0] += f"; {planned.verb} ({planned.reason})"
    return [*(line for own in lines.values() for line in own), *([note] if note else [])]


def _unclear(inputs: Inputs, readable: Mapping[str, Measurement]) -> list[str]:
    """Warnings about jobs whose lines do not resolve the peaks, or whose coherence is low from some frequency on; one per cause."""
    rule, causes, told = inputs.statistics.resolution, dict[str, list[str]](), list[str]()
    if soft := {name: edge for name, found in readable.items() if (edge := soft_tip(found)) is not None}:
        ends, worst = [hz for hz, _ in soft.values()], max(own for _, own in soft.values())
        told.append(
            f"job{'s' if len(soft) > 1 else ''} {', '.join(soft)}: the coherence is {worst:.2f} or less from {min(ends):.4g} Hz on: "
            "the force of the hammer probably does not reach that far. Measure with a harder tip, or let reduction.band end there"
        )
    peaks = {name: (found.frequency_hz, found.values[:, inputs.used]) for name, found in readable.items() if name not in soft}
    for name, own in peaks.items():
        # If the lines cover part of the band only, another warning says so, and consequences (as of rad/s for Hz) are omitted.
        if covers(own[0], inputs.campaign.reduction.band) and (unclear := too_wide(own, rule=rule)):
            causes.setdefault(unclear.cause, []).append(name)
    for names in causes.values():
        those = [peaks[name] for name in names]
        if together := too_wide(*those, rule=rule):
            which, text = f"job{'s' if len(names) > 1 else ''} {', '.join(names)}", together.text
            if few := _few(inputs, those):
                text = f"probably noise of {few}: {together.fall}, most of them there; check the channel, and measure it again"
            told.append(f"{which}: {text}, or expect wide intervals, other local minima of the cost, and no all-clear")
    return told


def _few(inputs: Inputs, those: Sequence[tuple[Floats, Complexes]]) -> str:
    """Names of the responses (at most a third) without which the peaks of the others are resolved; empty if there are none."""
    rule = inputs.statistics.resolution
    sharp = np.sum([[unresolved(hz, own[:, [r]], rule).sharp.size for r in range(inputs.used.size)] for hz, own in those], axis=0)
    order = np.argsort(-sharp, kind="stable")
    for count in range(1, order.size // 3 + 1):
        if (
            2 * sharp[order[:count]].sum() > sharp.sum()
            and too_wide(*((hz, own[:, order[count:]]) for hz, own in those), rule=rule) is None
        ):
            return ", ".join(inputs.responses[inputs.used[r]].name for r in sorted(order[:count]))
    return ""


def _compared(inputs: Inputs, folder: Path, readable: dict[str, Measurement], out: Findings, progress: Callable[[str], None]) -> str:
    """Add warnings from comparing measurements with each other and with the model; returns why they were not compared, if so."""
    out.warnings += _phaseless(inputs, readable)
    usable = {name: found for name, found in readable.items() if not normalised(found.values)}
    look = _looks(inputs, folder, usable, progress)
    compared = {name: found for name, found in usable.items() if name not in look.doubted}
    out.warnings += _other_chains(inputs, compared)
    out.warnings += mistitled(inputs, readable) or [text for text in (exchanged_files(inputs, compared),) if text]
    if look.rescaled and inputs.units_doubt in out.warnings:
        out.warnings.remove(inputs.units_doubt)
    out.warnings += look.warnings
    return look.note


def _looks(inputs: Inputs, folder: Path, readable: dict[str, Measurement], progress: Callable[[str], None]) -> FirstLook:
    """Comparison of measurements with the model, unless places are in doubt, or the band is a part of the file with few resonances."""
    if inputs.places_doubt:
        return FirstLook(note="measured and computed FRFs are compared once the places in the warnings are corrected")
    tight = readable.get(inputs.campaign.update.reference or "")
    if (
        tight is not None
        and sum(tight.left_out) > tight.frequency_hz.size
        and few_resonances(tight.frequency_hz, tight.values[:, inputs.used], inputs.statistics.resonances) is not None
    ):
        return FirstLook(note="measured and computed FRFs are compared only if the band contains more resonances")
    return first_look(inputs, folder, readable, progress)


def _poor(inputs: Inputs, name: str, measurement: Measurement) -> Iterator[str]:
    """Warnings about few resonances in the band (reference job only), few digits, normalised FRFs, and single blows."""
    few = few_resonances(measurement.frequency_hz, measurement.values[:, inputs.used], inputs.statistics.resonances)
    if few is not None and name == inputs.campaign.update.reference and covers(measurement.frequency_hz, inputs.campaign.reduction.band):
        yield f"job {name}: {_few_text(inputs, measurement, few)}"
    if rounded := few_digits(measurement.values):
        which = ", ".join(f"{inputs.responses[i].name} ({error:.1f} dB)" for i, error in rounded.items())
        yield (
            f"{inputs.campaign.jobs[name].first.name}: numbers with too few digits; errors of the levels: {which}. Export it again in "
            "exponential format with five digits of each number, also of small ones (1.2345e-03)"
        )
    if top := normalised(measurement.values):
        yield (
            f"{inputs.campaign.jobs[name].first.name}: every record has its largest magnitude at {top:.6g}: each was normalised to its "
            "own peak, so the levels between sensors are lost. Export the FRFs as response over force, without normalisation"
        )
    yield from _single(inputs, name, measurement)


def _single(inputs: Inputs, name: str, measurement: Measurement) -> Iterator[str]:
    """Warning about a coherence of 1 at every line, as of a single blow, whatever the noise."""
    table, told = measurement.coherence, np.isfinite(measurement.coherence)
    ones = np.flatnonzero(told.any(axis=0) & (~told | (table == 1.0)).all(axis=0))
    if ones.size and inputs.campaign.jobs[name].averages > 1:
        yield (
            f"{inputs.campaign.jobs[name].first.name}: the coherence of {', '.join(inputs.responses[i].name for i in ones)} is 1 at every "
            "line, as for a single blow, and says nothing about the noise. Average three blows or more, or remove the coherence from the "
            f"file; for one blow write jobs.{name}.averages: 1"
        )


def _few_text(inputs: Inputs, measurement: Measurement, count: int) -> str:
    """Text that the band is too narrow for verdicts, with the range of the file; ``count`` is the number of resonances."""
    axis, (low, high) = measurement.frequency_hz, inputs.campaign.reduction.band
    step = float(np.median(np.diff(axis))) if axis.size > 1 else 0.0
    ends = axis[0] - step * measurement.left_out[0], axis[-1] + step * measurement.left_out[1]
    wider = f"the file contains {ends[0]:.6g} to {ends[1]:.6g} Hz" if sum(measurement.left_out) else "measure a wider band"
    return (
        f"{count or 'no'} resonance{'' if count == 1 else 's'} in the band from {low:g} to {high:g} Hz, at least three are needed: a "
        f"loosened bolt shifts each one differently, and so few do not show which bolt it was. Widen reduction.band ({wider})"
    )


def _phaseless(inputs: Inputs, readable: dict[str, Measurement]) -> list[str]:
    """Warning about jobs whose FRFs have no phases; else empty."""
    bare = {name: found for name, own in readable.items() if (found := phaseless(own.values))}
    if not bare:
        return []
    names = [inputs.responses[i].name for i in sorted({i for found in bare.values() for i in found})]
    files = [inputs.campaign.jobs[name].first.name for name in bare]
    return [
        f"{', '.join(files)}: no phases: every value of {', '.join(names)} is real and positive. Export complex FRFs (real and imaginary "
        "parts, or magnitudes with phases): without phases, reversed or exchanged sensors, delays and windows are not found"
    ]


def _other_chains(inputs: Inputs, readable: dict[str, Measurement]) -> list[str]:
    """Warnings about jobs measured with another chain than the reference job, or with more noise, without knowledge of the bolts."""
    reference = inputs.campaign.update.reference or ""
    tight, found = readable.get(reference), []
    for name, own in readable.items():
        if tight is None or name == reference:
            continue
        if text := chain_doubt(inputs, own, tight, reference):
            found.append(f"job {name}: {text} (the result repeats this unless the identified bolts explain it)")
        if text := noise_doubt(own, tight, reference):
            found.append(f"job {name}: {text}")
        if text := coherence_doubt(inputs, own, tight, reference):
            found.append(f"job {name}: {text}")
    return found


def _unvalidated(inputs: Inputs) -> list[str]:
    """Warning if all responses enter the cost, so that there are no validation channels, or if only a few do."""
    update, used = inputs.campaign.update, inputs.used.size
    if update.reference is not None and update.responses is not None and 0 < 2 * used < inputs.validation.size:
        return [
            f"update.responses: {used} of {len(inputs.responses)} responses {'is' if used == 1 else 'are'} used, {inputs.validation.size} "
            "are left to validate. The key lists the responses that are used: check whether those to be left out were meant, and list the "
            "others"
        ]
    if update.reference is None or inputs.validation.size or len(inputs.responses) < 2:
        return []
    names = [response.name for response in inputs.responses]
    wrong = "all responses are used" if update.responses is None else "it lists all responses"
    return [
        f"update.responses: {wrong}, and none is left to test the result: no job is validated, and nothing is an all-clear. Leave one out: "
        f"update.responses: [{', '.join(names[:-1])}]"
    ]


def _unwritable(output: Path) -> list[str]:
    """Warning if results cannot be written; else empty."""
    there = next(path for path in (output, *output.parents) if path.exists())
    if there.is_dir() and os.access(there, os.W_OK | os.X_OK):
        return []
    what = "cannot be written to" if there.is_dir() else "is a file"
    return [f"output: {there} {what}, so no result can be kept: choose another folder in `output`"]


def _once(texts: Sequence[str]) -> list[str]:
    """Merge equal warnings about several files (each begins with the file name) into one with all names."""
    files: dict[str, list[str]] = {}
    for text in texts:
        name, colon, rest = text.partition(": ")
        alone = not colon or " " in name
        files.setdefault(text if alone else rest, []).append("" if alone else name)
    return [
        rest if not names[0] else f"{names[0]}: {rest}" + (f"; the same in {', '.join(names[1:])}" if len(names) > 1 else "")
        for rest, names in files.items()
    ]


def _packed(notes: Sequence[str], width: int = 120) -> list[str]:
    """Short notes joined into lines of at most ``width`` characters."""
    lines: list[str] = []
    for note in notes:
        if lines and len(lines[-1]) + len(note) + 2 <= width:
            lines[-1] += f"; {note}"
        else:
            lines.append(note)
    return lines
