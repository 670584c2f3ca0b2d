"""Jobs that no state of the bolts explains, although others are: by other air or damping, a wrong clock, or a hammer at another place."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace

import numpy as np

from lrbc_cli.arrays import Bools, Complexes, Floats
from lrbc_cli.campaign.findings import Finding, Kind, said
from lrbc_cli.campaign.identification.compared.likeness import CLEARLY, LEAST_DIFFERENCE, apart, levels, spread
from lrbc_cli.campaign.identification.nuisances import KELVIN
from lrbc_cli.campaign.identification.records import Measurement
from lrbc_cli.campaign.looking.causes.moved import hammer_text
from lrbc_cli.campaign.looking.fitted import fitted_frf, multiplied, undone
from lrbc_cli.campaign.looking.odd.left_on import left_on_text
from lrbc_cli.campaign.looking.states import Looking, Seen
from lrbc_cli.campaign.looking.trials import NEAR, NEARER
from lrbc_cli.campaign.reduced.stage import affine_model
from lrbc_cli.errors import LrbcError
from lrbc_cli.model.factors import SOUND_SPEED
from lrbc_cli.updating.calibration.far import far_sound, kelvin_of, without_air
from lrbc_cli.updating.comparison.scale import LEAST_LINES

#: What to check of a job that bolts do not explain.
MORE = (
    "Check whether more changed than the bolts: something added, removed or in contact, other supports, another temperature, another "
    "hammer point, or the file of another state or another structure. Until that is corrected, `lrbc update` may not explain this job. A "
    "loose bolt that rattles may do the same: `lrbc update` then names the bolt to check first"
)


def odd_jobs(
    source: Looking,
    measurements: Mapping[str, Measurement],
    names: Sequence[str],
    closer: Callable[[str], Floats],
    *,
    times: float = 2.5,
    clearly: float = 3.3,
    aside: float = 2.0,
) -> dict[str, Finding]:
    """Finding of each job that is far from the state fitted to it, unlike the best explained one.

    Parameters
    ----------
    source : Looking
        With the distances ``away`` and ``left`` of all jobs.
    measurements : mapping
        By job.
    names : sequence of str
        Jobs without other findings, which are examined.
    closer : callable
        Level misfits (R,) of a job after a careful fit [dB]. The first one is coarse: nothing is said without a better one.
    times : float
        Least misfit over that of the best explained job from which causes are tried. With the first fit it was 3.1 at most on right
        campaigns, 2.9 after a careful one with half of the joints loosened.
    clearly : float
        The same from which a job is told without a known cause.
    aside : float
        Least ratio of the misfit of the pressures to their median in the other jobs from which these are told alone, while the motion of
        the structure is explained: no bolt does that. On right campaigns it was 1.3 at most.
    """
    inputs, reference = source.inputs, source.inputs.campaign.update.reference or ""
    air = np.array([response.quantity == "pressure" for response in inputs.responses])
    far = {name: float(np.median(own)) for name, own in source.away.items()}
    found, tried = dict[str, Finding](), list[float]()
    for name in (name for name in far if name in names):
        usual = min((left for other, left in source.left.items() if other not in (name, reference)), default=np.inf)
        limit = max(NEAR, times * usual)
        if far[name] <= limit and not _airborne(source, name, source.away[name], air, aside):
            continue
        away = closer(name)
        left, airborne = float(np.median(away)), _airborne(source, name, away, air, aside)
        if left <= limit and not airborne:
            continue
        seen = Seen.of(source, name, measurements[name], measurements[reference])
        much = f"no state of the bolts explains it: {left:.1f} dB are left (mean level of each response removed), {usual:.1f} dB of another"
        further = airborne or (f"{much} job. {MORE}{_of_model(source, reference)}" if left > clearly * usual else "")
        own = air if airborne else np.full(air.size, fill_value=True)
        before = float(min(np.median(away[own]), np.median(source.away[name][own])))
        odd = _Odd(seen=seen, whole=measurements[name], before=before, usual=min(usual, before), own=own)
        if cause := _told(odd, f"{much} job", tried, further):
            found[name] = cause[0]
    return found


def own_air_text(source: Looking, measurements: Mapping[str, Measurement], factors: Mapping[str, float], job: str) -> str:
    """Warning that the air of the calibration job ``job`` is unlike that of all other jobs, if their pressures say so; else empty.

    A wrong speed of sound in the FE model is wrong in every job. So where a calibration with ``factors`` changes it much, and the pressures
    of all other jobs are nearer to the model without that, it is the job that was measured in other air.

    Parameters
    ----------
    source : Looking
        FRFs of the model with these factors.
    measurements : mapping
        By job.
    factors : mapping of str to float
    job : str
    """
    sound, air = far_sound(factors), np.array([response.quantity == "pressure" for response in source.inputs.responses])
    if not sound or source.stage is None:
        return ""
    plain = undone(source, {name: value for name, value in factors.items() if name not in without_air(factors)})
    left = dict[str, tuple[float, float]]()
    for name in (name for name in measurements if name != job):
        both = [Seen.of_model(one, name, measurements[name]) for one in (source, plain)]
        there = air & _measured(both[0].measured)
        if there.any():
            with_it, without = (float(np.median(apart(seen.measured, seen.model)[there])) for seen in both)
            left[name] = without, with_it
    if not left or any(without >= with_it for without, with_it in left.values()):
        return ""
    clear, (without, with_it) = min(left.items(), key=lambda each: each[1][0] / each[1][1])
    if without > NEARER * with_it:
        return ""
    kelvin = kelvin_of(sound)
    every = f"all {len(left)} other jobs are" if len(left) > 1 else f"{clear}, the other job, are"
    return (
        f"job {job}: probably measured in air about {abs(kelvin):.0f} K {'warmer' if kelvin > 0.0 else 'colder'} than the other jobs: its "
        f"calibration multiplies the speed of sound by {sound:.3g}, but the pressures of {every} nearer to the model without that "
        f"({clear}: {without:.1f} instead of {with_it:.1f} dB). Measure {job} again at the temperature of the others, or calibrate and "
        "compare with another tight job (calibration.job, update.reference)"
    )


def _of_model(source: Looking, reference: str) -> str:
    """Sentence that an error of the model may be the reason, if the reference job is not explained well either; else empty."""
    left = source.left.get(reference, 0.0)
    if left <= LEAST_DIFFERENCE:
        return ""
    return (
        f". But {reference} itself is {left:.1f} dB from the model: look first for an error of the model, such as springs at a wrong place "
        "or a wrong damping"
    )


@dataclass(frozen=True, kw_only=True)
class _Odd:
    """A job that no state of the bolts explains.

    Attributes
    ----------
    seen : Seen
    whole : Measurement
        The job on all its lines.
    before : float
        Level misfit that a fit of the bolts leaves, median over the responses ``own`` [dB].
    usual : float
        The same of the best explained job [dB].
    own : (R,) bool array
        Responses that a cause must explain.
    """

    seen: Seen
    whole: Measurement
    before: float
    usual: float
    own: Bools = field(repr=False)

    @property
    def which(self) -> str:
        """Of which responses, if not of all, in words."""
        return "" if self.own.all() else " of the pressures"

    def left(self, seen: Seen) -> float:
        """Level misfit that a coarse fit leaves [dB]; infinite without a fit."""
        with suppress(LrbcError):
            fitted = fitted_frf(seen)
            away = np.zeros(0) if fitted is None else apart(seen.measured, fitted)[self.own & _measured(seen.measured)]
            return float(np.median(away)) if away.size else np.inf
        return np.inf


def _measured(values: Complexes) -> Bools:
    """(R,) which responses have enough values (F, R) for a misfit."""
    return np.asarray(np.isfinite(levels(values)).sum(axis=0) >= 2 * LEAST_LINES)


def _told(odd: _Odd, much: str, tried: list[float], further: str) -> list[Finding]:
    """Finding of a job that differs by ``much``; none without a cause or ``further`` text, or if ``update`` identifies the cause.

    ``tried``: see ``_warmer``.
    """
    seen, most = odd.seen, CLEARLY * odd.before
    step, nuisances = _warmer(odd, tried), seen.inputs.method.nuisances
    clock, text = _clock(odd)
    if step is not None and clock > CLEARLY * step[1] and (nuisances.temperature is not None or nuisances.sound_speed is not None):
        return []
    if step is not None:
        # Bolts and a clock together may look like another temperature, and the other way round.
        told = [_warmer_text(odd, step), *([text] if clock <= min(most, step[1]) else [])]
        first, *rest = told[::-1] if clock <= CLEARLY * step[1] or _of_structure_too(odd, step[0]) else told
        return said(Kind.FOREIGN, ". Or: w".join([f"{much}. {first}", *(other.removeprefix("W") for other in rest)]))
    damped = _damped(odd)
    if min(damped[0], clock) <= most:
        return said(Kind.FOREIGN, f"{much}. {min(damped, (clock, text))[1]}")
    if moved := hammer_text(seen, apart(seen.measured, seen.states)):
        return said(Kind.HAMMER, f"{much}; {moved}")
    if odd.own.all() and (standing := left_on_text(seen, odd.before, odd.usual)):
        return said(Kind.FOREIGN, f"{much}. {standing}")
    return said(Kind.FOREIGN, further)


def _of_structure_too(odd: _Odd, change: float) -> bool:
    """Whether a factor on the frequencies explains all responses clearly better than a ``change`` of the speed of sound does."""
    if odd.own.all():
        return False
    every = replace(odd, own=np.ones_like(odd.own))
    return _clock(every)[0] <= NEARER * _left_with(every, {SOUND_SPEED: 1.0 + change})


def _airborne(source: Looking, name: str, away: Floats, air: Bools, aside: float) -> str:
    """Warning if the pressures ``air`` (R,) of a job are far from the state that fits best and the structure is near; else empty.

    ``away``: its level misfits (R,), zero for what was not measured [dB].
    """
    there = away > 0.0
    others = [own for other, own in source.left.items() if other not in (name, source.inputs.campaign.update.reference)]
    if not (air & there).any() or not (~air & there).any() or not others:
        return ""
    own, rest = float(np.median(away[air & there])), float(np.median(away[~air & there]))
    # Jobs that a state of the table explains are not fitted.
    known = {other: every[air & (every > 0.0)] for other, every in source.away.items() if other != name}
    usual = float(np.median([np.median(each) if each.size else others[0] for each in known.values()] or others))
    if own <= max(LEAST_DIFFERENCE, aside * usual) or rest >= min(LEAST_DIFFERENCE, NEARER * own):
        return ""
    return (
        f"no state of the bolts explains its pressures: {own:.1f} dB are left (mean level of each response removed), {usual:.1f} dB in "
        f"other jobs, while the motion of the structure is explained to {rest:.1f} dB. Check what else changed in the air of this job: an "
        "opening, absorbing material, the temperature, places of the microphones. Measure again as in the reference job"
    )


def _warmer_text(odd: _Odd, step: tuple[float, float]) -> str:
    """Clause on a job that a ``step`` of the speed of sound explains."""
    change, misfit = step
    kelvin = 2.0 * abs(change) * (odd.seen.inputs.method.nuisances.room + KELVIN)
    return (
        f"With a speed of sound about {abs(change):.1%} {'above' if change > 0 else 'below'} that of the reference job a "
        f"coarse fit leaves {misfit:.1f} instead of {odd.before:.1f} dB{odd.which}: the air was probably about {kelvin:.0f} K "
        f"{'warmer' if change > 0 else 'colder'}. Measure again at the temperature of the reference job, or let `lrbc update` identify "
        f"it: update.nuisances: {{temperature: {max(kelvin, 1.0):.0f}}} (standard deviation in K)"
    )


def _left_with(odd: _Odd, factors: Mapping[str, float]) -> float:
    """Level misfit of a coarse fit with other factors of the model in this job [dB]; infinite without a fit."""
    seen, source, prior = odd.seen, odd.seen.source, odd.seen.parameters.initial
    assert source.stage is not None
    assert seen.tight is not None
    other = multiplied(source, affine_model(seen.inputs, source.stage), factors)
    # The tight state as it would be with these factors.
    there, here = (one.model(seen.s, seen.parameters).frf(prior) for one in (other, source))
    return odd.left(replace(seen, source=other, tight=seen.tight * there / here))


def _warmer(
    odd: _Odd, tried: list[float], *, steps: tuple[float, ...] = (-0.04, -0.02, -0.01, 0.01, 0.02, 0.04), near: float = 1.4
) -> tuple[float, float] | None:
    """Relative change of the speed of sound that explains a job, and the level misfit with it [dB]; None if there is none.

    Parameters
    ----------
    odd : _Odd
    tried : list of float
        Change found in another job, which is tried alone first; the one found here is written to it.
    steps, near : float
        Changes tried, and the factor by which two more lie about the best of them; then by its root.
    """
    seen = odd.seen
    if SOUND_SPEED not in seen.inputs.recipe.names or seen.source.stage is None or seen.tight is None:
        return None

    def with_speed(step: float) -> tuple[float, float]:
        return _left_with(odd, {SOUND_SPEED: 1.0 + step}), step

    for each in filter(None, (tried, steps)):
        left, step = min(map(with_speed, each))
        for nearer in (near, near**0.5) if each is steps else ():
            left, step = min((left, step), *map(with_speed, (nearer * step, step / nearer)))
        if left <= CLEARLY * odd.before:
            tried[:] = [step]
            return step, left
    return None


def _damped(odd: _Odd, *, times: tuple[float, ...] = (0.1, 10.0, 100.0)) -> tuple[float, str]:
    """Least misfit of a job with another damping of one field, by ``times`` [dB], and a clause on it."""
    seen = odd.seen
    if seen.source.stage is None or seen.tight is None:
        return np.inf, ""
    kinds = {"acoustic": "air", "structure": "structure"}
    found = []
    for name, what in kinds.items():
        own = [each for each in seen.inputs.recipe.names if each in {f"{kind}.{name}" for kind in ("alpha", "beta", "loss_factor")}]
        found += [(_left_with(odd, dict.fromkeys(own, factor)), factor, what) for factor in times if own]
    left, factor, what = min(found, default=(np.inf, 1.0, ""))
    more = "absorbing material, or an opening," if what == "air" else "a damping layer, a hand or a cable"
    change = f"{factor:g} times that" if factor > 1.0 else "a tenth of that"
    reason = f"check whether {more} was {'there' if factor > 1.0 else 'there in the reference job'}"
    return left, (
        f"With a damping of the {what} of about {change} of the reference job a coarse fit leaves {left:.1f} instead of "
        f"{odd.before:.1f} dB{odd.which}: {reason}. Measure again as in the reference job"
    )


def _clock(odd: _Odd, *, most: float = 1.1, steps: int = 40, few: int = 60) -> tuple[float, str]:
    """Misfit of a job with a factor on its frequencies [dB], and a clause on it.

    Parameters
    ----------
    odd : _Odd
    most, steps : float, int
        Factors from ``1 / most`` to ``most`` are compared with all states of one loosened bolt, ``steps`` on each side of 1; then the bolts
        are fitted with the best one and four beside it.
    few : int
        Number of lines of that comparison.
    """
    seen, hz, grid = odd.seen, odd.whole.frequency_hz, most ** (1.0 / steps)
    table = seen.few(few)
    states = levels(table.states)

    def read(job: Seen, factor: float) -> Complexes:
        found = np.full(job.measured.shape, np.nan, dtype=complex)
        for k, own in enumerate(odd.whole.values.T):
            known = np.isfinite(own)
            if known.sum() >= 2 * LEAST_LINES:
                at, parts = job.measurement.frequency_hz / factor, (own[known].real, own[known].imag)
                real, imaginary = (np.interp(at, hz[known], part, np.nan, np.nan) for part in parts)
                found[:, k] = real + 1j * imaginary
        return found

    def far(power: int) -> float:
        moved = read(table, grid**power)
        # Nothing is near by what has left the band.
        enough = odd.own & (2 * np.isfinite(moved).sum(axis=0) > len(moved))
        if 2 * enough.sum() <= odd.own.sum():
            return np.inf
        return float(np.median(spread(levels(moved[:, enough]) - states[:, :, enough], 1), axis=1).min())

    def left(power: int) -> float:
        return odd.left(seen.reading(read(seen, grid**power))) if power else np.inf

    best = min(range(-steps, steps + 1), key=far)
    if not np.isfinite(far(best)):
        return np.inf, ""
    misfit, power = min((left(one), one) for one in range(best - 2, best + 3))
    return misfit, (
        f"With all its frequencies times about {grid**power:.3f} a coarse fit leaves {misfit:.1f} instead of {odd.before:.1f} dB"
        f"{odd.which}. Check whether another sampling rate was entered or set, or the axis was typed. If so, multiply the frequencies of "
        "this job by the ratio of the true rate to the entered one"
    )
