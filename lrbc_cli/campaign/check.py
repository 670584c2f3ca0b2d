"""``lrbc check``: examines model, settings and measurements of a campaign, and predicts what ``lrbc update`` will do and cost."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from lrbc_cli.arrays import Complexes
from lrbc_cli.campaign.beside import passed_over, taken_twice, unnamed
from lrbc_cli.campaign.findings import Effect, Finding, Kind, Left, kinds_of, once
from lrbc_cli.campaign.identification.compared.copies import Earlier, Levels, pasted
from lrbc_cli.campaign.identification.compared.likeness import LEAST_DIFFERENCE
from lrbc_cli.campaign.identification.records import Measurement, read_measurement
from lrbc_cli.campaign.identification.unknowns import select_lines
from lrbc_cli.campaign.jobs.plans import JobPlan, choose_jobs, plan
from lrbc_cli.campaign.looking.axes import other_lines, without_coherence
from lrbc_cli.campaign.looking.causes.damped import uncalibrated_text, windowed_text
from lrbc_cli.campaign.looking.exchanges import exchanged_files, foreign_titles, mistitled
from lrbc_cli.campaign.looking.first_look import FirstLook, first_look
from lrbc_cli.campaign.looking.fitted import expected_on_all_lines
from lrbc_cli.campaign.looking.measured import of_file, other_chains, other_runs, unclear, without_phases
from lrbc_cli.campaign.looking.odd.jobs import own_air_text
from lrbc_cli.campaign.looking.states import Looking
from lrbc_cli.campaign.looking.trials import NEAR
from lrbc_cli.campaign.reading.doubts.idle import partly_held
from lrbc_cli.campaign.reading.inputs import Inputs
from lrbc_cli.campaign.reading.model_doubts import loss_factor, undamped_text
from lrbc_cli.campaign.reading.places import extents
from lrbc_cli.campaign.reduced import cache
from lrbc_cli.campaign.reduced.memory import GB, limit_of, reduction_cost
from lrbc_cli.config.settings import EveryLine
from lrbc_cli.errors import LrbcError, NumericalError, listing
from lrbc_cli.model.coupling import asymmetry, coupling_of
from lrbc_cli.model.dofs import COMPONENTS, DofTable
from lrbc_cli.model.units import UnitSystem
from lrbc_cli.reduction.solve import pardiso
from lrbc_cli.updating.calibration.far import far_factors, without_air
from lrbc_cli.updating.statistics.lines import few_resonances, interpolated, missed, normalised


@dataclass(kw_only=True)
class Findings:
    """Findings as sections of text, and the same as a tree for programs.

    Attributes
    ----------
    sections : dict of lists of str
    found : list of Finding
        What is warned of, in the order in which it is told.
    errors : dict
        Error of each job with an unusable measurement.
    jobs : list of JobPlan
    tree : dict
    predicted : dict or None
        Memory [bytes] and time [s] of the reduction, if it has to be done.
    compared : bool
        Whether measured and computed FRFs were compared.
    left : Left
    """

    sections: dict[str, list[str]] = field(default_factory=dict)
    found: list[Finding] = field(default_factory=list)
    errors: dict[str, LrbcError] = field(default_factory=dict)
    jobs: list[JobPlan] = field(default_factory=list)
    tree: dict[str, Any] = field(default_factory=dict)
    predicted: dict[str, Any] | None = None
    compared: bool = False
    left: Left = field(default_factory=Left)

    def warn(self, *texts: str) -> None:
        """Add findings that no other place shares."""
        self.found += [Finding(text=text) for text in texts]

    @property
    def warnings(self) -> list[str]:
        """One line for each cause."""
        return once(self.found)


def check(
    inputs: Inputs,
    folder: Path,
    detailed: bool = False,
    pictured: bool = False,
    progress: Callable[[str], None] = lambda _: None,
    section: Callable[[str, list[str]], None] = lambda *_: None,
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
    section : callable
        Receives title and lines of each section once it is known: a comparison of measurements and model may take minutes.

    Returns
    -------
    Findings
        Unusable measurements are errors by job; all other errors were raised when the inputs were read.
    """
    out = Findings()

    def add(title: str, lines: list[str]) -> None:
        out.sections[title] = lines
        section(title, lines)

    add("files", list(inputs.notes))
    # Measurements show which matrix is wrong by a factor; a guess from the mesh is then not needed.
    out.found += [Finding(text=text, kind=Kind.GUESSED if text == inputs.units_doubt else None) for text in inputs.warnings]
    out.warn(*passed_over(inputs.campaign), *unnamed(inputs.campaign), *_unwritable(inputs.campaign.output))
    out.warn(*filter(None, [undamped_text(inputs.model, inputs.groups)]))
    add("model", _model(inputs))
    parts = cache.key_parts(inputs)
    decision = cache.look_up(folder, parts)
    add("reduced model", _reduction(inputs, decision, out))
    use = inputs.calibration
    if use is not None and use.stale:
        out.warn(f"calibration: {use.text}")
    if use is not None and (use.used or not use.stale):
        add("calibration", [use.text, *(f"{name} = {value:.6g}" for name, value in use.factors.items())])
    add("method", inputs.method.choices)
    out.warn(*inputs.method.warnings, *_unvalidated(inputs), *filter(None, ["" if use is None else use.coarse]))
    add("jobs", _jobs(inputs, folder, parts, out, detailed, progress))
    add("more", _more(inputs, pictured))
    out.tree = _tree(inputs, out, decision)
    return out


def _more(inputs: Inputs, pictured: bool) -> list[str]:
    """What else shows faults or bolts."""
    use = inputs.calibration
    before = inputs.campaign.calibration is not None and not (use is not None and use.used)
    return [
        *(["lrbc check once more after lrbc calibrate: with the calibrated model smaller faults show"] if before else []),
        *([] if pictured else ["lrbc check --picture draws the structure with bolts, sensors and updated terms"]),
        "lrbc plan shows, from the model alone, which bolts these responses can detect, and ranks the responses",
    ]


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
        "far_db": out.left.far_db,
        "unexplained": out.left.text,
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
        lines += _partly_held(inputs.dofs, inputs.campaign.unit_system)
    symmetric = "same left and right vectors" if m.terms.symmetric else "left and right vectors differ"
    lines.append(
        f"{m.terms.size} rank-one terms ({symmetric}), {m.B.shape[1]} excitation(s), {m.L.shape[0]} response(s), {inputs.used.size} used"
    )
    return lines


def _partly_held(dofs: DofTable, units: UnitSystem) -> list[str]:
    """Components that the model holds at some nodes: a line each."""
    return [
        f"partly held: {len(xyz)} node{'' if len(xyz) == 1 else 's'} without {component}, {extents(xyz, units.length, units.length_name)}"
        for component, xyz in partly_held(dofs).items()
    ]


def _reduction(inputs: Inputs, decision: cache.CacheDecision, out: Findings) -> list[str]:
    r = inputs.campaign.reduction
    lines = [f"band {r.band[0]:g} to {r.band[1]:g} Hz, tolerance {r.tolerance:g}, back end {pardiso.resolved(r.backend)}"]
    if decision.hit:
        lines.append(f"cache: hit ({decision.reason})")
        if decision.missed:
            out.warn(f"the reduced model in the cache: {decision.missed}; --accept-tolerance uses it")
    else:
        lines.append(f"cache: miss ({decision.reason}); `lrbc reduce` stores the model, and check is faster then")
        try:
            cost, peak = reduction_cost(inputs)
        except NumericalError as error:
            out.warn(error.problem)
            return lines
        limit, source = limit_of(inputs)
        lines.append(
            f"estimate: about {_rounded(cost.seconds)} s, a peak of {peak / GB:.2f} GB ({cost.memory['factors'] / GB:.2f} GB of it for "
            f"{cost.nonzeros / 1e6:.2f} million entries of the factors) of {limit / GB:.1f} GB {source}"
        )
        if peak > limit:
            out.warn(f"not enough memory for the reduction: {peak / GB:.2f} GB of {limit / GB:.2f} GB {source}")
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
    lines, noted = dict[str, list[str]](), dict[str, list[str]]()
    readable: dict[str, Measurement] = {}
    held: dict[tuple[str, ...], str] = {}
    chosen_lines, sparse = inputs.method.lines, list[str]()
    earlier, names = Earlier(inputs.statistics.validation, readable.__getitem__), [response.name for response in inputs.responses]
    for name, job in inputs.campaign.jobs.items():
        progress(f"reading the measurement of {name}")
        try:
            measurement = read_measurement(inputs, job, name)
            selected, _ = select_lines(inputs, measurement, name)
        except LrbcError as error:
            out.errors[name] = error
            lines[name] = [f"{name}: unusable, see its error"]
            continue
        first = held.setdefault(tuple(measurement.hashes.values()), name)
        own = list[str]()
        if first != name:
            out.warn(*taken_twice(inputs.campaign, first, name))
        elif copied := earlier.copied(measurement, names)[1]:
            own.append(f"{copied}. Give each of the two jobs its own file under jobs.JOB.frf")
        earlier.add(name, Levels.of(measurement))
        readable[name] = measurement
        records = sum(bool(np.isfinite(measurement.values[:, i]).any()) for i in range(len(inputs.responses)))
        notes = (*_packed(measurement.notes), *(measurement.records if detailed else ()))
        matched = f"{records} of {len(inputs.responses)} responses matched"
        lines[name] = [f"{name}: {measurement.lines}, {selected.size} selected, {matched}"]
        for note in dict.fromkeys(notes):
            noted.setdefault(note, []).append(name)
        out.found += [*measurement.warnings, *of_file(inputs, name, measurement)]
        own += pasted(measurement, names, inputs.statistics.validation)
        empty, count = missed(measurement.frequency_hz, measurement.values[:, inputs.used], selected, inputs.statistics.resonances)
        # Listed lines were chosen individually, so they are not checked.
        if 2 * empty > count and isinstance(chosen_lines, EveryLine):
            sparse.append(f"{name} ({empty} of {count})")
        if straight := interpolated(measurement.values, inputs.statistics.resolution):
            own.append(straight)
        out.found += [Finding(job=name, text=text) for text in own]
    if sparse and isinstance(chosen_lines, EveryLine):
        out.warn(
            f"update.lines: {{every: {chosen_lines.every}}} selects no line at most of the resonances, where "
            f"changes show most: {', '.join(sparse)}. Write lines: resonances"
        )
    out.warn(*other_lines(inputs.campaign.update.reference, readable), *without_coherence(readable))
    note = _compared(inputs, folder, readable, out, progress)
    try:
        out.jobs = [p for p in plan(inputs, parts, choose_jobs(inputs.campaign, ())) if p.name in readable]
    except OSError:
        out.jobs = []
    for planned in out.jobs:
        lines[planned.name][0] += f"; {planned.verb} ({planned.reason})"
    return [*_noted(lines, noted), *([note] if note else [])]


def _noted(lines: Mapping[str, list[str]], noted: Mapping[str, list[str]], *, most: int = 8) -> list[str]:
    """Lines of all jobs, each followed by the notes on it alone; then the notes that several jobs share, once each."""
    own = {name: [text for text, jobs in noted.items() if jobs == [name]] for name in lines}
    shared = {text: "all jobs" if len(jobs) == len(lines) else listing(jobs, most) for text, jobs in noted.items() if len(jobs) > 1}
    told = [line for name, each in lines.items() for line in (*each, *(f"  {text}" for text in own[name]))]
    return [*told, *(f"{jobs}: {text}" for text, jobs in shared.items())]


def _compared(inputs: Inputs, folder: Path, readable: dict[str, Measurement], out: Findings, progress: Callable[[str], None]) -> str:
    """Add findings from comparing measurements with each other and with the model; returns why they were not compared, if so."""
    usable = {name: found for name, found in readable.items() if not normalised(found.values)}
    look = _looks(inputs, folder, usable, progress)
    reference = inputs.campaign.update.reference or ""
    lefts = {} if look.source is None else look.source.left
    far = {name: left for name, left in lefts.items() if left > (NEAR if name == reference else LEAST_DIFFERENCE)}
    out.compared, out.left = look.compared, Left(reference=reference, far_db=far)
    of_tight = kinds_of(each for each in look.found if reference and each.job == reference)
    # Peaks of an inverse FRF are the zeros of the FRF, and phases read as imaginary parts jump.
    misread = {each.job for each in look.found if each.kind is Kind.READ}
    noisy = [] if reference in misread else [each for each in unclear(inputs, readable) if each.job not in misread]
    out.found += [*noisy, *without_phases(inputs, readable)]
    compared = {name: found for name, found in usable.items() if name not in look.doubted}
    # Beside a reference job that is not tight, the others differ by its loose bolts.
    other_quantity = {each.job for each in look.found if each.kind is Kind.UNITS and each.detail}
    turned = {each.job for each in look.found if each.kind is Kind.REVERSED}
    unlike = {name: kinds_of(each for each in look.found if each.job == name) for name in usable.keys() & look.doubted}
    # What differs from the state that fits best may differ by a window or a second blow, which show without a model.
    apart = {name for name, kinds in unlike.items() if kinds <= {Kind.HAMMER, Kind.ALONE}}
    asked = {name: found for name, found in usable.items() if name in compared.keys() | apart}
    tight, source = usable.get(reference), look.source

    def expected(name: str) -> Complexes | None:
        return None if tight is None or source is None else expected_on_all_lines(source, name, tight)

    chains = [] if Kind.NOT_TIGHT in of_tight else other_chains(inputs, asked, other_quantity, turned, expected)
    chains = [each for each in chains if each.job not in apart or each.detail in ("window", "blow")]
    out.found += chains
    struck = {each.job for each in chains if each.job in apart}
    out.found += other_runs(inputs, usable)
    out.warn(*foreign_titles(inputs, readable))
    pairs = mistitled(inputs, readable)
    titled = list(pairs.values())
    # Beside another state in place of the reference job, jobs that are tight seem not to be.
    told = [
        each for each in look.found if not (titled and each.kind is Kind.REMOVED) and not (each.kind is Kind.HAMMER and each.job in struck)
    ]
    if any(reference in pair for pair in pairs):
        told = [each for each in told if not each.has(Effect.NOT_TIGHT)]
    if not titled and Kind.REMOVED not in kinds_of(told) and (text := exchanged_files(inputs, compared)):
        titled = [text]
    out.warn(*titled)
    if look.source is not None and not any(each.job == reference for each in told):
        # Beside another finding they may be its consequence.
        out.warn(*_far(look.source, compared))
    if Kind.RESCALED in kinds_of(look.found):
        out.found = [each for each in out.found if each.kind is not Kind.GUESSED]
    out.found += told
    # Exchanged files concern any job.
    out.left.explained |= {each.job or reference for each in (*told, *chains) if _moves_levels(each)}
    out.left.explained |= {reference} if titled else set()
    if reference in compared and not of_tight & {Kind.DAMPING, Kind.READ} and (damped := uncalibrated_text(inputs, compared[reference])):
        # Beside it, other jobs seem to be unlike any state of the bolts.
        out.found = [*(each for each in out.found if each.kind is not Kind.FOREIGN), Finding(job=reference, text=damped)]
        out.left.explained.add(reference)
    return look.note


def _far(source: Looking, measurements: Mapping[str, Measurement]) -> list[str]:
    """Warnings on factors of the calibration that are far from 1, on other air in its job alone, or on a window in all jobs."""
    inputs, use, told = source.inputs, source.inputs.calibration, list[str]()
    factors, reference = use.factors if use is not None and use.used else source.factors, inputs.campaign.update.reference or ""
    if alone := own_air_text(source, measurements, factors, source.fitted_to or ""):
        told, factors = [alone], without_air(factors)
    if reference in measurements and (window := windowed_text(source, reference, measurements[reference], factors)):
        return [*told, window]
    return [*told, *far_factors(factors, inputs.recipe)]


def _moves_levels(finding: Finding) -> bool:
    """Whether a finding may explain a level misfit, of which the mean levels are removed, median over the responses."""
    if finding.has(Effect.IS_OFFSET):
        return finding.kind is Kind.UNITS and bool(finding.detail)
    return finding.kind not in {Kind.ALONE, Kind.PLACES, Kind.NOISE}


def _looks(inputs: Inputs, folder: Path, readable: dict[str, Measurement], progress: Callable[[str], None]) -> FirstLook:
    """Comparison of measurements with the model, unless places are in doubt, or the band is a part of the file with few resonances."""
    if inputs.places_doubt:
        return FirstLook(note="measured and computed FRFs are compared once the places in the warnings are corrected", compared=False)
    tight = readable.get(inputs.campaign.update.reference or "")
    if (
        tight is not None
        and sum(tight.left_out) > tight.frequency_hz.size
        and few_resonances(tight.frequency_hz, tight.values[:, inputs.used], inputs.statistics.resonances) is not None
    ):
        return FirstLook(note="measured and computed FRFs are compared only if the band contains more resonances", compared=False)
    return first_look(inputs, folder, readable, progress)


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


def _packed(notes: Sequence[str], width: int = 120) -> list[str]:
    """Short notes joined into lines of at most ``width`` characters."""
    lines: list[str] = []
    for note in notes:
        if lines and len(lines[-1]) + len(note) + 2 <= width:
            lines[-1] += f"; {note}"
        else:
            lines.append(note)
    return lines
