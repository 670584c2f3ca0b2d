"""Rough calibration and coarse fit of loosened bolts for ``lrbc check``, so that mistakes in measurements show before identification."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from lrbc_cli.arrays import Bools, Complexes, Floats, spaced
from lrbc_cli.campaign.calibrate import first_problem
from lrbc_cli.campaign.identification.compared.likeness import CLEARLY, LEAST_DIFFERENCE, MOST_LEFT, apart, levels
from lrbc_cli.campaign.identification.records import Measurement
from lrbc_cli.campaign.identification.weights import correction
from lrbc_cli.campaign.looking.states import Looking, Seen
from lrbc_cli.campaign.looking.trials import NEAR
from lrbc_cli.campaign.reading.inputs import Inputs
from lrbc_cli.campaign.reduced.stage import affine_model
from lrbc_cli.errors import LrbcError
from lrbc_cli.model.factors import with_factors
from lrbc_cli.model.terms import ParameterGroup, Parameterisation
from lrbc_cli.reduction.reduced.affine import AffineModel
from lrbc_cli.updating.calibration.calibrate import FactorProblem, descents, moves_resonances
from lrbc_cli.updating.comparison.correlation import measured_values
from lrbc_cli.updating.comparison.scale import LEAST_LINES
from lrbc_cli.updating.misfit.cost import Misfit
from lrbc_cli.updating.search.descent import descend
from lrbc_cli.updating.search.search import search
from lrbc_cli.updating.statistics.residuals import ResidualOptions
from lrbc_cli.updating.unknowns.shapes import Shapes, bolt_shapes, joints_of, neighbouring_columns

#: Standard deviation of the gain of a response, large because levels are compared up to a constant [dB].
ANY_LEVEL_DB = 20.0


def fitted_theta(seen: Seen, *, lines: int = 100, iterations: int = 6, kept: int = 2) -> Floats | None:
    """Theta of the state of the bolts that fits a measurement best; None without a tight state, or if no bolt has values.

    Mean levels of responses do not count, and large differences count by their magnitude instead of their square, so that an exchanged
    sensor does not bias the bolts.

    Parameters
    ----------
    seen : Seen
    lines : int
        Approximate number of lines fitted.
    iterations : int
        Iterations of each descent.
    kept : int
        Number of states of the table from which descents start.

    Returns
    -------
    (size,) float array or None
    """
    inputs, source, parameters, s = seen.inputs, seen.source, seen.parameters, seen.s
    statistics, bolts = inputs.statistics, inputs.bolts
    if bolts is None or seen.tight is None:
        return None
    shapes = bolt_shapes(parameters, bolts.xyz, statistics.values, statistics.bolts)
    if not (shapes.bolts >= 0).any():
        return None
    prior, few = parameters.initial, np.arange(0, s.size, max(1, s.size // lines))
    factor = _factor(inputs, source.model(s, parameters, few).frf(prior), seen.tight[few])
    misfit = Misfit(
        source.model(s, parameters, few, inputs.used),
        (seen.measured[few] * factor)[:, inputs.used],
        prior,
        statistics.values.first_variance,
        shapes.penalty(),
        options=ResidualOptions(loss_scale=LEAST_DIFFERENCE),
        errors=statistics.errors,
        gains=ANY_LEVEL_DB * np.eye(inputs.used.size),
    )
    pairs = neighbouring_columns(parameters, bolts.xyz, shapes)
    found, _ = search(misfit, shapes, parameters.bounds, pairs, names=bolts.name, kept=kept)
    ends = [descend(misfit, theta, parameters.bounds, shapes.T, max_iterations=iterations) for theta in (prior, *found.values())]
    theta = min(ends, key=lambda end: end.evaluation.total).theta
    # The first fit of a job is that of its records as stated.
    source.fits.setdefault(seen.job, (parameters, theta))
    source.changes.setdefault(seen.job, _changes(shapes, theta - prior))
    return theta


def fitted_frf(seen: Seen) -> Complexes | None:
    """(F, R) FRFs expected in the state of the bolts that fits best; None without tight state, or if no bolt has values."""
    with seen.source.threads():
        theta = fitted_theta(seen)
    return None if theta is None else expected_frf(seen, theta)


def carefully_fitted(seen: Seen) -> Floats | None:
    """As ``fitted_theta``, in seconds instead of half a second."""
    with seen.source.threads():
        return fitted_theta(seen, lines=400, iterations=20, kept=8)


def closely_fitted(source: Looking, measurements: Mapping[str, Measurement], name: str) -> Floats:
    """(R,) level misfits of a job with the state that a careful fit finds [dB]; of a job that was compared before."""
    seen = Seen.of(source, name, measurements[name], measurements[source.inputs.campaign.update.reference or ""])
    theta = carefully_fitted(seen)
    return {**source.near, **source.away}[name] if theta is None else apart(seen.measured, expected_frf(seen, theta))


def fitted_exchanged(seen: Seen, exchanged: Complexes, *, further: float = 1.1) -> Complexes | None:
    """As ``fitted_frf``, for exchanged records (F, R); None if these are ``further`` times as far from the tight state as the stated ones.

    This saves a fit of half a second: right records are 1.3 to 5 times nearer than exchanged ones, unless most bolts are loose.
    """
    assert seen.tight is not None
    moved, tight = np.flatnonzero((exchanged != seen.measured).any(axis=0)), seen.tight
    as_stated, now = (float(np.median(apart(values[:, moved], tight[:, moved]))) for values in (seen.measured, exchanged))
    return fitted_frf(seen.reading(exchanged)) if now <= further * as_stated else None


def widely_fitted(
    seen: Seen, *, reach: float = 4.0, starts: Sequence[float] = (0.0, -2.0, -1.0, 1.0, 2.0, 3.0), lines: int = 100, iterations: int = 30
) -> tuple[float, Floats] | None:
    """Misfit [dB] and changes of the joints [decades] in the state that fits best, far beyond the bounds; None if joints own no values.

    Parameters
    ----------
    seen : Seen
    reach : float
        Largest change of a joint [decades]; there is no prior.
    starts : sequence of float
        Changes of all joints from which descents start [decades].
    lines, iterations : int
        See ``fitted_theta``.
    """
    inputs, source, s, bolts = seen.inputs, seen.source, seen.s, seen.inputs.bolts
    if bolts is None:
        return None

    def wide(group: ParameterGroup) -> ParameterGroup:
        low, high = np.minimum(group.bounds[:, 0], group.initial - reach), np.maximum(group.bounds[:, 1], group.initial + reach)
        return replace(group, bounds=np.stack([low, high], axis=1)) if group.kind == "stiffness" else group

    parameters = Parameterisation(tuple(map(wide, seen.parameters.groups)))
    shapes = bolt_shapes(parameters, bolts.xyz, inputs.statistics.values, inputs.statistics.bolts)
    if not any(joints_of(parameters, len(bolts.name))):
        return None
    few = np.arange(0, s.size, max(1, s.size // lines))
    misfit = Misfit(
        source.model(s, parameters, few, inputs.used),
        seen.measured[few][:, inputs.used],
        parameters.initial,
        inputs.statistics.values.first_variance,
        np.zeros_like(shapes.penalty()),
        options=ResidualOptions(loss_scale=LEAST_DIFFERENCE),
        errors=inputs.statistics.errors,
        gains=ANY_LEVEL_DB * np.eye(inputs.used.size),
    )
    stiff = np.zeros(parameters.size)
    for group, where, _ in parameters.placed:
        stiff[where] = group.kind == "stiffness"
    model, found = source.model(s, parameters), list[tuple[float, Floats]]()
    with source.threads():
        for start in starts:
            theta = descend(misfit, parameters.initial + start * stiff, parameters.bounds, shapes.T, max_iterations=iterations).theta
            found.append((float(np.median(apart(seen.measured, model.frf(theta)))), _changes(shapes, theta - parameters.initial)))
    return min(found, key=lambda each: each[0])


def _changes(shapes: Shapes, change: Floats) -> Floats:
    """Change of each bolt [decades] in a change of theta; NaN for bolts without values."""
    unknowns = np.linalg.pinv(shapes.T) @ change
    return np.where(shapes.bolts >= 0, unknowns[shapes.bolts], np.nan)


def expected_frf(seen: Seen, theta: Floats) -> Complexes:
    """(F, R) FRFs expected in state theta: the measured tight state times the change that the model predicts from its start values."""
    assert seen.tight is not None
    model = seen.source.model(seen.s, seen.parameters)
    return np.asarray(model.frf(theta) / _factor(seen.inputs, model.frf(seen.parameters.initial), seen.tight))


def expected_on_all_lines(source: Looking, job: str, tight: Measurement) -> Complexes | None:
    """As ``expected_frf``, in the state fitted to a job and on all lines of the reference job; None if none was fitted."""
    if job not in source.fits:
        return None
    parameters, theta = source.fits[job]
    model = source.model(2j * np.pi * tight.frequency_hz, parameters)
    return np.asarray(model.frf(theta) / _factor(source.inputs, model.frf(parameters.initial), tight.values))


def expected_frfs(seen: Seen, states: Floats) -> Complexes:
    """(S, F, R) as ``expected_frf`` of states (S, size) that differ from the start values in few stiffnesses."""
    assert seen.tight is not None
    model, prior = seen.source.model(seen.s, seen.parameters), seen.parameters.initial
    return np.asarray(model.nearby(prior)(states) / _factor(seen.inputs, model.frf(prior), seen.tight))


def _factor(inputs: Inputs, model: Complexes, tight: Complexes) -> Complexes:
    """(F, R) model over measurement in the tight state, limited in magnitude; 1 where that was not measured."""
    found = correction(model, tight, inputs.statistics.errors.most_correction_db)
    return np.where(measured_values(found), found, 1.0)


def strike_text(seen: Seen, expected: Complexes, *, least: int = 3, apart_db: float = 1.0) -> str:
    """Warning if the levels of all FRFs of one hammer point are above or below those of all others; else empty.

    Errors of the model change levels of single responses, but do not separate those of one hammer point from all others.

    Parameters
    ----------
    seen : Seen
    expected : (F, R) complex array
        FRFs in the state of the bolts that fits best.
    least : int
        Least number of responses of that point, and of the others.
    apart_db : float
        Least gap between the levels of that point and of the others [dB].
    """
    inputs, measured, job = seen.inputs, seen.measured, seen.job
    if float(np.median(apart(measured, expected))) > MOST_LEFT:
        return ""
    away = levels(measured) - levels(expected)
    known = np.isfinite(away).sum(axis=0) >= LEAST_LINES
    above = np.zeros(known.size)
    above[known] = np.nanmedian(away[:, known], axis=0)
    parts = [known & (inputs.input_of == number) for number in range(len(inputs.excitations))]
    middle = [float(np.abs(np.median(above[own]))) if own.any() else 0.0 for own in parts]
    for number, name in enumerate(inputs.excitations):
        # Of two excitations, the one whose level has changed more since the reference job.
        if len(parts) == 2 and middle[number] < middle[1 - number]:
            continue
        own = parts[number]
        others = known & ~own
        if min(own.sum(), others.sum()) < least:
            continue
        gap = max(above[own].min() - above[others].max(), above[others].min() - above[own].max())
        if gap < apart_db:
            continue
        change = float(np.median(above[own]) - np.median(above[others]))
        names, stated = [inputs.responses[i].name for i in np.flatnonzero(own)], inputs.campaign.jobs[job].factor
        scale = ", ".join(f"{response}: {10.0 ** (-change / 20.0) * stated(response):.3g}" for response in names)
        return (
            f"all FRFs of {name} are {abs(change):.1f} dB {'above' if change > 0 else 'below'} the level expected from those of the other "
            "excitations. Check whether the hammer was overloaded there, or another range, tip or sensitivity was set. Measure "
            f"{name} again, or correct it by jobs.{job}.scale: {{{scale}}}"
        )
    return ""


def _rough_theta(problem: FactorProblem, *, lines: int = 150, size: int = 120, least: int = 40, iterations: int = 20) -> Floats:
    """Theta after one descent on some of the lines, with a soft loss, so that single wrong responses count less.

    The work of ``lines`` lines with ``size`` DOFs is not exceeded with larger reduced models, if ``least`` lines are enough for that.
    """
    work = (size / problem.model.base.size) ** 3
    at = spaced(problem.selected.size, int(np.clip(lines * work, least, lines)))
    few = replace(problem, selected=problem.selected[at], sigma=None if problem.sigma is None else problem.sigma[at], few=None)
    return descents(few, few.start, far=True, limit=iterations, soft=True)[0].theta


def roughly_calibrated(
    source: Looking, measurement: Measurement, *, beside: Mapping[str, float] | None = None, uneven: float = 1.5
) -> Looking | None:
    """Model with the factors and boundary values of a rough calibration.

    Parameters
    ----------
    source : Looking
        FRFs of the model as exported.
    measurement : Measurement
        Of the calibration job.
    beside : mapping of str to float or None
        Factors from which to start instead of the model as exported; those of the result are relative to them.
    uneven : float
        If the misfits of two excitations differ by this factor, or one is not fitted, the model is calibrated from some of them, and the
        best fit counts: the place of another excitation may be wrong.

    Returns
    -------
    Looking or None
        None if the campaign does not calibrate or is calibrated already, if the model fits without, or if no factors bring it near the
        measurement, since they would then hide the fault.
    """
    settings = source.inputs.campaign.calibration
    if settings is None or source.fitted_to is not None or source.stage is None:
        return None
    # Asked for by the job of the calibration, and again by what concerns all jobs.
    content = measurement.frequency_hz.tobytes() + measurement.values.tobytes() + repr((beside, uneven)).encode()
    key = b"rough" + hashlib.sha256(content).digest()
    if key not in source.known:
        source.known[key] = _roughly_calibrated(source, measurement, settings.job, beside, uneven)
    found: Looking | None = source.known[key]
    return found


def _roughly_calibrated(
    source: Looking, measurement: Measurement, job: str, beside: Mapping[str, float] | None, uneven: float
) -> Looking | None:
    """See ``roughly_calibrated``; ``job``: the calibration job."""
    inputs = source.inputs
    assert source.stage is not None
    before = Seen.of_model(source, job, measurement).misfit
    if before <= NEAR:
        return None
    try:
        if beside is not None:
            source = multiplied(source, affine_model(inputs, source.stage), beside)
        problem, _ = first_problem(source, measurement)
        with source.threads():
            found = _calibrated_by(source, problem, _rough_theta(problem))
            medians = Seen.of_model(found, job, measurement).by_excitation
            least = min(medians.values())
            if len(medians) > 1 and max(medians.values()) > min(uneven * least, LEAST_DIFFERENCE):
                tried = list[tuple[float, Looking]]()
                for some in _without_worst(medians):
                    one = _calibrated_by(source, problem, _rough_theta(_of_excitations(inputs, problem, some)))
                    left = Seen.of_model(one, job, measurement).by_excitation
                    tried.append((float(np.median([left[at] for at in some])), one))
                least, found = min(tried, key=lambda each: each[0])
            if least > LEAST_DIFFERENCE:
                # A sensitivity ten times off outweighs the resonances in a descent that begins far away.
                found = _calibrated_by(source, problem, _rough_theta(_levelled(source, problem, measurement)))
                least = Seen.of_model(found, job, measurement).misfit
    except LrbcError:
        return None
    after = Seen.of_model(found, job, measurement).misfit
    named = ", ".join(f"{name} {value:.3g}" for name, value in found.factors.items())
    note = f"compared with a rough calibration from {job}, not stored ({named}): level misfit {after:.1f} dB, {before:.1f} before"
    return replace(found, note=note) if least <= LEAST_DIFFERENCE else None


def calibrated_from_another(source: Looking, measurements: Mapping[str, Measurement]) -> Looking:
    """Model after a rough calibration from a job that is not the reference job; unchanged if there is none, or if it would not help.

    Both are said to be tight: with the model fitted to one, the other shows whether it is.
    """
    calibration, reference = source.inputs.campaign.calibration, source.inputs.campaign.update.reference
    if calibration is None or calibration.job == reference or calibration.job not in measurements:
        return source
    found = roughly_calibrated(source, measurements[calibration.job])
    if found is None:
        return source
    far = {name: Seen.of_model(found, name, whole).misfit for name, whole in measurements.items() if name != calibration.job}
    own = far.pop(reference or "", 0.0)
    # If no other job is near it either, the job of the calibration may be the one that is not tight.
    return found if own <= LEAST_DIFFERENCE or any(other < CLEARLY * own for other in far.values()) else source


def calibrated_from(source: Looking, measurement: Measurement, own: Bools) -> Looking | None:
    """Model after a rough calibration from some of the responses, by a mask (R,); None if there is none, or if it fails."""
    if source.inputs.campaign.calibration is None or source.stage is None:
        return None
    try:
        problem, _ = first_problem(source, measurement)
        if not own[problem.responses].any():
            return None
        with source.threads():
            return _calibrated_by(source, problem, _rough_theta(_of_responses(problem, own)))
    except LrbcError:
        return None


def calibrated_by_rounds(
    source: Looking, measurement: Measurement, names: tuple[str, ...], rounds: int
) -> tuple[Looking, dict[str, float]]:
    """Model after rough calibrations of the factors ``names``, each from the end of the one before, and the factors found.

    Raises
    ------
    LrbcError
        If one fails.
    """
    assert source.stage is not None
    now, affine, found = dict.fromkeys(names, 1.0), affine_model(source.inputs, source.stage), source
    for _ in range(rounds):
        begun = multiplied(source, affine, now)
        problem = replace(first_problem(begun, measurement)[0], names=names)
        with source.threads():
            found = _calibrated_by(begun, problem, _rough_theta(problem))
        now = {name: value * found.factors[name] for name, value in now.items()}
    return found, now


def _levelled(source: Looking, problem: FactorProblem, measurement: Measurement) -> FactorProblem:
    """The calibration problem with the median level of each response moved to that of the model."""
    s = 2j * np.pi * measurement.frequency_hz
    above = levels(problem.measured) - levels(source.model(s, problem.parameters, None, problem.responses).frf(problem.parameters.initial))
    known = np.isfinite(above).any(axis=0)
    change = np.zeros(known.size)
    change[known] = np.nanmedian(above[:, known], axis=0)
    return replace(problem, measured=problem.measured * 10.0 ** (-change / 20.0))


def _without_worst(medians: Mapping[int, float], *, few: int = 3) -> list[list[int]]:
    """Excitations from which to calibrate: each alone if there are ``few``, else the half with the least misfits."""
    best = sorted(medians, key=medians.__getitem__)
    return [[at] for at in best] if len(best) <= few else [best[: len(best) // 2]]


def _of_excitations(inputs: Inputs, problem: FactorProblem, some: Sequence[int]) -> FactorProblem:
    """The calibration problem with the responses of some excitations only."""
    return _of_responses(problem, np.isin(inputs.input_of, some))


def _of_responses(problem: FactorProblem, some: Bools) -> FactorProblem:
    """The calibration problem with some of the responses only, by a mask (R,)."""
    own = np.flatnonzero(some[problem.responses])
    sigma = None if problem.sigma is None else problem.sigma[:, own]
    return replace(problem, measured=problem.measured[:, own], responses=problem.responses[own], sigma=sigma)


def _calibrated_by(source: Looking, problem: FactorProblem, theta: Floats, *, slack: float = 1e-3) -> Looking:
    """The model with the factors and boundary values that theta holds."""
    parameters = problem.parameters
    factors = {name: float(np.exp(value)) for name, value in zip(problem.names, theta[parameters.size :], strict=False)}
    low, high = np.exp(problem.bounds[parameters.size :].T)
    near = {
        name: factors[name]
        for name, least, most in zip(problem.names, low, high, strict=False)
        if moves_resonances(problem.model.recipe, name) and not least * (1.0 + slack) < factors[name] < most * (1.0 - slack)
    }
    known = multiplied(source, problem.model, factors)
    return replace(known, start=parameters.by_group(theta), factors=factors, at_bounds=near)


def multiplied(source: Looking, model: AffineModel, factors: Mapping[str, float]) -> Looking:
    """FRFs with these factors of the model."""
    assert source.stage is not None
    inputs = source.inputs
    whole, recipe = with_factors(inputs.model, inputs.recipe, factors)
    stage = replace(source.stage, reduction=replace(source.stage.reduction, model=model.at(factors)))
    return Looking(inputs=replace(inputs, model=whole, recipe=recipe), stage=stage, kind="port")


def undone(source: Looking, factors: Mapping[str, float]) -> Looking:
    """FRFs of the model without these factors, which it has, at the same start values."""
    assert source.stage is not None
    back = {name: 1.0 / value for name, value in factors.items()}
    return replace(multiplied(source, affine_model(source.inputs, source.stage), back), start=source.start)


def as_exported(source: Looking) -> Looking | None:
    """The model without the factors and values of the stored calibration; None if none is used."""
    use = source.inputs.calibration
    if use is None or not use.used or source.stage is None:
        return None
    return undone(Looking(inputs=replace(source.inputs, calibration=None), stage=source.stage, kind=source.kind), use.factors)
