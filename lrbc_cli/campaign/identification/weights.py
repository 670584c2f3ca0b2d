"""Weights of lines and responses in the cost: noise of each line, correction by the reference job, and the ratio of validation channels."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from lrbc_cli.arrays import Bools, Complexes, Floats, Integers
from lrbc_cli.campaign.identification.compared.copies import proportional
from lrbc_cli.campaign.identification.correlate import mean_of
from lrbc_cli.campaign.identification.records import Measurement, unlike
from lrbc_cli.campaign.reading.inputs import Inputs
from lrbc_cli.config.settings import JobConfig
from lrbc_cli.method.resolve import noise_source
from lrbc_cli.updating.comparison.correlation import measured_values
from lrbc_cli.updating.knots import evenly
from lrbc_cli.updating.robust import medians
from lrbc_cli.updating.statistics.decibels import coherence_sigma, decibel, noise_weights, stated_coherence
from lrbc_cli.updating.statistics.lines import Unclear, neighbour_sigma, resolved, too_wide
from lrbc_cli.updating.statistics.model import ValidationChannels
from lrbc_cli.updating.statistics.noise import validation_ratio


def measured_sigma(inputs: Inputs, measurement: Measurement, job: JobConfig, selected: Integers) -> tuple[str, Floats | None]:
    """Source of the noise estimate, and (F, R) standard deviations of all measured magnitudes [dB], NaN where unknown; None without any."""
    coherent = bool((measurement.coherence[np.ix_(selected, inputs.used)] > 0.0).any()) and job.averages * measurement.files > 1
    kind = noise_source(inputs.method, coherent=coherent, repeated=measurement.sigma_db is not None)
    if kind == "coherence":
        return kind, coherence_sigma(stated_coherence(measurement.coherence), job.averages * measurement.files, inputs.statistics.errors)
    return kind, measurement.sigma_db if kind == "scatter" else None


def mostly_noise(inputs: Inputs, measurement: Measurement, job: JobConfig, *, known: bool) -> Bools:
    """(F, R) measured values with a noise above ``most_noise_db``, which say nothing about the model.

    Parameters
    ----------
    inputs : Inputs
    measurement : Measurement
    job : JobConfig
    known : bool
        Noise that coherence or repeats give counts, too. A cost weights such values already; a mean misfit does not. Without either, the
        scatter of neighbouring lines gives the noise, if the lines are evenly spaced and resolve the peaks; noise has peaks that would
        count as resonances.
    """
    axis, errors, values = measurement.frequency_hz, inputs.statistics.errors, measurement.values
    kind, sigma = measured_sigma(inputs, measurement, job, np.arange(axis.size))
    if kind != "none" and not known:
        sigma = None
    elif kind == "none" and inputs.method.weighted and axis.size > errors.noise_window + 4 and evenly(axis):
        whole = resolved(axis, values[:, inputs.used], inputs.statistics.resolution)
        sigma = neighbour_sigma(values, errors.noise_window) if whole else sigma
    noisy: Bools = np.zeros(values.shape, dtype=bool) if sigma is None else sigma > errors.most_noise_db
    # If most lines of a response are noise, this is a fault, which must show in the misfit.
    return np.asarray(noisy & (2 * noisy.sum(axis=0) < axis.size))


def without_noise(
    inputs: Inputs, name: str, measurement: Measurement, reference: Measurement | None = None, *, known: bool = False
) -> Complexes:
    """(F, R) measured values of a job, NaN where they are ``mostly_noise``.

    The noise of the ``reference`` job decides, if it is given and has the same lines: where a loosened bolt lets a response drown in
    noise, that is evidence.
    """
    jobs = inputs.campaign.jobs
    if reference is None:
        return np.where(mostly_noise(inputs, measurement, jobs[name], known=known), np.nan, measurement.values)
    if unlike(measurement.frequency_hz, reference.frequency_hz):
        return measurement.values
    noisy = mostly_noise(inputs, reference, jobs[str(inputs.campaign.update.reference)], known=known)
    return np.where(noisy & np.isfinite(reference.values), np.nan, measurement.values)


def weighted_down(
    inputs: Inputs, name: str, measurement: Measurement, reference: Measurement | None = None, *, louder: float = 2.0
) -> Complexes:
    """As ``without_noise``, also without noise of the job that its coherence or repeats give: such values have little weight in its cost.

    If the ``reference`` job is given, it must have that noise, too: where the job's is ``louder`` than its by this factor at most. It may
    be mostly noise at other lines, as its dips lie elsewhere.
    """
    jobs, values = inputs.campaign.jobs, without_noise(inputs, name, measurement, reference)
    noisy = _known_noise(inputs, measurement, jobs[name])
    if reference is not None:
        if unlike(measurement.frequency_hz, reference.frequency_hz):
            return values
        beside = jobs[str(inputs.campaign.update.reference)]
        level, usual = _noise_magnitude(inputs, measurement, jobs[name]), _noise_magnitude(inputs, reference, beside)
        window = inputs.statistics.errors.noise_window
        around = np.pad(usual, ((window // 2, window // 2), (0, 0)), mode="edge")
        near = medians(np.lib.stride_tricks.sliding_window_view(around, 2 * (window // 2) + 1, axis=0))[..., 0]
        noisy &= level <= louder * near
    return np.where(noisy, np.nan, values)


def _noise_magnitude(inputs: Inputs, measurement: Measurement, job: JobConfig) -> Floats:
    """(F, R) magnitude of the noise that coherence or repeats give, up to a factor; NaN where they give none."""
    sigma = measured_sigma(inputs, measurement, job, np.arange(measurement.frequency_hz.size))[1]
    if sigma is None:
        return np.full(measurement.values.shape, np.nan)
    return np.where(np.isfinite(measurement.values), np.abs(measurement.values) * sigma, np.nan)


def _known_noise(inputs: Inputs, measurement: Measurement, job: JobConfig) -> Bools:
    """(F, R) as ``mostly_noise``, by coherence or repeats alone."""
    if measured_sigma(inputs, measurement, job, np.arange(measurement.frequency_hz.size))[0] == "none":
        return np.zeros(measurement.values.shape, dtype=bool)
    return mostly_noise(inputs, measurement, job, known=True)


def beside_noise(inputs: Inputs, measured: Sequence[tuple[Floats, Complexes]], quiet: Sequence[tuple[Floats, Complexes]]) -> Unclear | None:
    """As ``too_wide`` of what was ``measured``; noise counts only as far as it is in ``quiet``, the same without values of little weight.

    A coherence that leakage lowers at the peaks must not hide that the lines do not resolve them, nor a quiet job the noise of another.
    """
    rule = inputs.statistics.resolution
    found = too_wide(*measured, rule=rule)
    if found is None or not found.noise:
        return found
    return next((left for some in (quiet, *([each] for each in quiet)) if (left := too_wide(*some, rule=rule)) is not None), None)


def lines_doubt(inputs: Inputs, *jobs: tuple[str, Measurement, Measurement | None]) -> Unclear | None:
    """Why peaks of the responses used are unreliable in some jobs together, by their names, measurements and reference job; else None."""
    measured, quiet = (
        [(own.frequency_hz, values(inputs, name, own, tight)[:, inputs.used]) for name, own, tight in jobs]
        for values in (without_noise, weighted_down)
    )
    return beside_noise(inputs, measured, quiet)


def left_out(inputs: Inputs, measurement: Measurement, told: Complexes, noise_of: str | None = None) -> list[str]:
    """Note on values of the responses used that are left out as noise, if any.

    Parameters
    ----------
    inputs : Inputs
    measurement : Measurement
    told : (F, R) complex array
        See ``without_noise``.
    noise_of : str or None
        Job whose noise decided, if it is another one.
    """
    lost = (np.isfinite(measurement.values) & ~np.isfinite(told))[:, inputs.used]
    if not lost.any():
        return []
    named = [f"{inputs.responses[i].name} ({int(count)})" for i, count in zip(inputs.used, lost.sum(axis=0), strict=True) if count]
    band, where = measurement.frequency_hz[lost.any(axis=1)], "" if noise_of is None else f" in {noise_of}"
    return [
        f"values that are mostly noise{where}, by the scatter of neighbouring lines, are not compared: {band[0]:g} to {band[-1]:g} Hz, "
        f"lines of {', '.join(named)}; coherence in the file, or a narrower reduction.band, is more reliable"
    ]


def line_sigma(inputs: Inputs, measurement: Measurement, job: JobConfig, selected: Integers) -> tuple[Floats | None, tuple[str, ...]]:
    """Standard deviation of the measured magnitudes on the selected lines of the responses used.

    Returns
    -------
    (m, U) float array or None
        [dB], NaN where unknown; None if lines are not weighted by it.
    tuple of str
        Note on lines that have weight 1 because their noise is unknown.
    """
    kind, sigma = measured_sigma(inputs, measurement, job, selected)
    if sigma is None:
        return None, ()
    chosen = sigma[np.ix_(selected, inputs.used)]
    valid = np.isfinite(measurement.values[np.ix_(selected, inputs.used)])
    unknown = [(inputs.responses[i].name, int(n)) for i, n in zip(inputs.used, (np.isnan(chosen) & valid).sum(axis=0), strict=True) if n]
    notes: tuple[str, ...] = ()
    if unknown:
        what = "coherence" if kind == "coherence" else "second measurement"
        named = ", ".join(f"{name} ({count} lines)" for name, count in unknown)
        notes = (f"weights: weight 1, as there is no {what}, for {named}",)
    return chosen, notes


def validation_channels(values: Complexes, used: Integers, unused: Integers, limits: ValidationChannels) -> tuple[Integers, str]:
    """Responses that can validate an identification in which they were not used, and the reason if there is none.

    Parameters
    ----------
    values : (F, R) complex array
        As measured; NaN where there is no value.
    used, unused : int arrays
    limits : ValidationChannels

    Returns
    -------
    int array, str
        Unused responses with values on most lines that are no copy of a response used; an empty text if there are some.
    """
    if not unused.size:
        return unused, "there are no validation channels"
    # A channel that was off has zeros throughout.
    finite = np.isfinite(values) & measured_values(values).any(axis=0)
    share = finite[:, unused].mean(axis=0)
    if not share.any():
        return unused[:0], "the validation channels have no values"
    told = unused[share >= limits.least_lines]
    if not told.size:
        return told, f"the validation channels have values on {share.max():.0%} of the lines only"

    def copied(i: int, j: int) -> bool:
        both = finite[:, i] & measured_values(values[:, j])
        return bool(both.any()) and proportional(values[both, i], values[both, j], limits)

    own = np.array([i for i in told if not any(copied(int(i), int(j)) for j in used)], dtype=np.int64)
    return own, "" if own.size else "the validation channels are copies of records that were fitted"


def weighted_misfits(
    inputs: Inputs, measurement: Measurement, job: JobConfig, selected: Integers, updated: Complexes
) -> tuple[Floats, Integers]:
    """Misfit of each value, each line weighted by its noise as in the fit, and the validation channels.

    Parameters
    ----------
    inputs : Inputs
    measurement : Measurement
    job : JobConfig
    selected : int array
        Lines that entered the cost.
    updated : (F, R) complex array
        FRFs of the model on all measured lines.

    Returns
    -------
    (F, R) float array, int array
        [dB], NaN where there is no value.
    """
    values, used = measurement.values, inputs.used
    channels, _ = validation_channels(values, used, inputs.validation, inputs.statistics.validation)
    valid = measured_values(values)
    left = np.where(valid, np.abs(decibel(updated) - decibel(np.where(valid, values, 1.0))), np.nan)
    _, sigma = measured_sigma(inputs, measurement, job, selected)
    level = mean_of(left[:, used])
    return left * noise_weights(sigma, level) if sigma is not None and level else left, channels


def ratio_of(inputs: Inputs, measurement: Measurement, job: JobConfig, selected: Integers, updated: Complexes) -> float:
    """Misfit of the validation channels over that of the channels used, at least 1, see ``noise.validation_ratio``.

    Weighted by noise (see ``weighted_misfits``), so that a noisier validation channel does not count as an error of the model.
    """
    left, channels = weighted_misfits(inputs, measurement, job, selected, updated)
    return validation_ratio(mean_of(left[:, channels]), mean_of(left[:, inputs.used]))


def worst_channel(
    inputs: Inputs,
    measurement: Measurement,
    job: JobConfig,
    selected: Integers,
    updated: Complexes,
    *,
    much: float = 2.0,
    least_db: float = 1.0,
) -> list[str]:
    """Warning that names the worst validation channel if ``ratio_of`` is at least ``much``; not if its misfit is below ``least_db``."""
    left, channels = weighted_misfits(inputs, measurement, job, selected, updated)
    fitted, own = mean_of(left[:, inputs.used]), {int(i): mean_of(left[:, i]) or 0.0 for i in channels}
    ratio, worst = validation_ratio(mean_of(left[:, channels]), fitted), max(own, key=own.__getitem__, default=0)
    if ratio < much or own[worst] < least_db:
        return []
    name = inputs.responses[worst].name

    def times(ratio: float) -> str:
        return f"{ratio:.1f} times" if ratio < 100.0 else "over 100 times"

    which = f" ({name}: {times(validation_ratio(own[worst], fitted))})" if len(own) > 1 else f" ({name})"
    return [
        f"the model explains the validation channels {times(ratio)} worse than the channels used{which}; the errors of all changes are "
        f"taken as so much larger, and fewer bolts can be judged. fix: check position, direction and sensitivity of {name}"
    ]


def joint_sigma(*parts: Floats | None) -> Floats | None:
    """(F, R) root of the sum of squares of several standard deviations [dB], unknown ones left out; NaN if all are unknown."""
    known = [part for part in parts if part is not None]
    if not known:
        return None
    unknown = np.all([np.isnan(part) for part in known], axis=0)
    return np.where(unknown, np.nan, np.sqrt(sum(np.nan_to_num(part, posinf=np.inf) ** 2 for part in known)))


def correction(model: Complexes, measured: Complexes, most_db: float) -> Complexes:
    """(F, R) factor ``model / measured`` that removes the model discrepancy of the reference state from another measurement.

    Parameters
    ----------
    model, measured : (F, R) complex arrays
        FRFs of the reference state.
    most_db : float
        Limit of the factor's magnitude (``most_correction_db``): beyond it, model and measurement have different resonances there.
    """
    valid = measured_values(measured)
    ratio = np.where(valid, model / np.where(valid, measured, 1.0), np.nan)
    level = decibel(ratio)
    return np.asarray(ratio * 10.0 ** ((np.clip(level, -most_db, most_db) - level) / 20.0))
