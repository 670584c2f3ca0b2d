"""Jobs that no state of the bolts explains, although others are: by other air or damping, a wrong clock, or a hammer at another place."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from lrbc_cli.arrays import Complexes, Floats
from lrbc_cli.campaign.findings import Finding, Kind, said
from lrbc_cli.campaign.identification.compared.likeness import CLEARLY, LEAST_DIFFERENCE, apart, levels, spread
from lrbc_cli.campaign.identification.nuisances import KELVIN
from lrbc_cli.campaign.identification.records import Measurement
from lrbc_cli.campaign.looking.causes.moved import hammer_text
from lrbc_cli.campaign.looking.fitted import fitted_frf, multiplied
from lrbc_cli.campaign.looking.states import Looking, Seen
from lrbc_cli.campaign.looking.trials import NEARER
from lrbc_cli.campaign.reduced.stage import affine_model
from lrbc_cli.model.factors import SOUND_SPEED

#: What to check of a job that bolts do not explain.
MORE = (
    "Check whether more changed than the bolts: something added, removed or in contact, other supports, another temperature, another "
    "hammer point, or the file of another state. Until it is corrected, `lrbc update` may not explain this job either"
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
    reference = source.inputs.campaign.update.reference or ""
    far = {name: float(np.median(own)) for name, own in source.away.items()}
    found, tried = dict[str, Finding](), list[float]()
    for name in (name for name in far if name in names):
        usual = min((left for other, left in source.left.items() if other not in (name, reference)), default=np.inf)
        limit = max(LEAST_DIFFERENCE, times * usual)
        airborne = _airborne(source, name, source.away[name], aside) is not None
        if far[name] <= limit and not airborne:
            continue
        away = closer(name)
        left, air = float(np.median(away)), _airborne(source, name, away, aside)
        if left <= limit and air is None:
            continue
        seen = Seen.of(source, name, measurements[name], measurements[reference])
        much = f"no state of the bolts explains it: {left:.1f} dB are left (mean level of each response removed), {usual:.1f} dB of another"
        further = air or (f"{much} job. {MORE}" if left > clearly * usual else "")
        if cause := _told(seen, measurements[name], f"{much} job", far[name], tried, further):
            found[name] = cause[0]
    return found


def _told(seen: Seen, whole: Measurement, much: str, coarse: float, tried: list[float], further: str) -> list[Finding]:
    """Finding of a job that differs by ``much``; none without a cause or ``further`` text, or if ``update`` identifies the cause.

    ``whole``: the job on all its lines; ``coarse``: the misfit after a first, coarse fit; ``tried``: see ``_warmer``.
    """
    step, nuisances = _warmer(seen, coarse, tried), seen.inputs.method.nuisances
    if step is not None and (nuisances.temperature is not None or nuisances.sound_speed is not None):
        return []
    least, text = min(_damped(seen, coarse), _clock(seen, whole, coarse))
    # Another temperature is more usual than the others: these must be clearly nearer, and the temperature must not be enough.
    if step is not None and (step[1] <= CLEARLY * LEAST_DIFFERENCE or least > CLEARLY * step[1]):
        least, text = step[1], _warmer_text(seen, step, coarse)
    if least <= CLEARLY * coarse:
        return said(Kind.FOREIGN, f"{much}. {text}")
    if moved := hammer_text(seen, apart(seen.measured, seen.states)):
        return said(Kind.HAMMER, f"{much}; {moved}")
    return said(Kind.FOREIGN, further)


def _airborne(source: Looking, name: str, away: Floats, aside: float) -> str | None:
    """Warning if the pressures of a job are far from the state that fits best (``away`` (R,) [dB]) and the structure is near; else None."""
    inputs = source.inputs
    air = np.array([response.quantity == "pressure" for response in inputs.responses])
    others = [own for other, own in source.away.items() if other != name]
    if air.all() or not air.any() or not others:
        return None
    own, rest = float(np.median(away[air])), float(np.median(away[~air]))
    usual = float(np.median([np.median(every[air]) for every in others]))
    if own <= max(LEAST_DIFFERENCE, aside * usual) or rest >= min(LEAST_DIFFERENCE, NEARER * own):
        return None
    return (
        f"no state of the bolts explains its pressures: {own:.1f} dB are left (mean level of each response removed), {usual:.1f} dB in the "
        f"other jobs, while the motion of the structure is explained to {rest:.1f} dB. Check what else changed in the air of this job: an "
        "opening, absorbing material, the temperature, places of the microphones. Measure again as in the reference job"
    )


def _warmer_text(seen: Seen, step: tuple[float, float], coarse: float) -> str:
    """Clause on a job of which a ``step`` of the speed of sound explains the ``coarse`` misfit [dB]."""
    change, misfit = step
    kelvin = 2.0 * abs(change) * (seen.inputs.method.nuisances.room + KELVIN)
    return (
        f"With a speed of sound about {abs(change):.1%} {'above' if change > 0 else 'below'} that of the reference job a "
        f"coarse fit leaves {misfit:.1f} instead of {coarse:.1f} dB: the air was probably about {kelvin:.0f} K "
        f"{'warmer' if change > 0 else 'colder'}. Measure again at the temperature of the reference job, or let `lrbc update` identify "
        f"it: update.nuisances: {{temperature: {max(kelvin, 1.0):.0f}}} (standard deviation in K)"
    )


def _left_with(seen: Seen, factors: Mapping[str, float]) -> float:
    """Level misfit of a coarse fit with other factors of the model in this job [dB]; infinite without a fit."""
    source, prior = seen.source, seen.parameters.initial
    assert source.stage is not None
    assert seen.tight is not None
    other = multiplied(source, affine_model(seen.inputs, source.stage), factors)
    # The tight state as it would be with these factors.
    there, here = (one.model(seen.s, seen.parameters).frf(prior) for one in (other, source))
    fitted = fitted_frf(replace(seen, source=other, tight=seen.tight * there / here))
    return np.inf if fitted is None else float(np.median(apart(seen.measured, fitted)))


def _warmer(
    seen: Seen, before: float, tried: list[float], *, steps: tuple[float, ...] = (-0.04, -0.02, -0.01, 0.01, 0.02, 0.04), near: float = 1.4
) -> tuple[float, float] | None:
    """Relative change of the speed of sound that explains a job, and the level misfit with it [dB]; None if there is none.

    Parameters
    ----------
    seen : Seen
    before : float
        Level misfit with the speed of the reference job [dB].
    tried : list of float
        Change found in another job, which is tried alone first; the one found here is written to it.
    steps, near : float
        Changes tried, and the factor by which two more lie about the best of them; then by its root.
    """
    if SOUND_SPEED not in seen.inputs.recipe.names or seen.source.stage is None or seen.tight is None:
        return None

    def with_speed(step: float) -> tuple[float, float]:
        return _left_with(seen, {SOUND_SPEED: 1.0 + step}), step

    for each in filter(None, (tried, steps)):
        left, step = min(map(with_speed, each))
        for nearer in (near, near**0.5) if each is steps else ():
            left, step = min((left, step), *map(with_speed, (nearer * step, step / nearer)))
        if left <= CLEARLY * before:
            tried[:] = [step]
            return step, left
    return None


def _damped(seen: Seen, before: float, *, times: tuple[float, ...] = (0.1, 10.0, 100.0)) -> tuple[float, str]:
    """Least misfit of a job with another damping of one field, by ``times``, and a clause on it; ``before``: without [dB]."""
    if seen.source.stage is None or seen.tight is None:
        return np.inf, ""
    kinds = {"acoustic": "air", "structure": "structure"}
    found = []
    for field, what in kinds.items():
        own = [name for name in seen.inputs.recipe.names if name in {f"{kind}.{field}" for kind in ("alpha", "beta", "loss_factor")}]
        found += [(_left_with(seen, dict.fromkeys(own, factor)), factor, what) for factor in times if own]
    left, factor, what = min(found, default=(np.inf, 1.0, ""))
    more = "absorbing material, or an opening," if what == "air" else "a damping layer, a hand or a cable"
    change = f"{factor:g} times that" if factor > 1.0 else "a tenth of that"
    reason = f"check whether {more} was {'there' if factor > 1.0 else 'there in the reference job'}"
    return left, (
        f"With a damping of the {what} of about {change} of the reference job a coarse fit leaves {left:.1f} instead of {before:.1f} dB: "
        f"{reason}. Measure again as in the reference job"
    )


def _clock(seen: Seen, whole: Measurement, before: float, *, most: float = 1.1, steps: int = 40) -> tuple[float, str]:
    """Misfit of a job with a factor on its frequencies, and a clause on it; ``before``: without [dB].

    Factors from ``1 / most`` to ``most`` are compared with all states of one loosened bolt, ``steps`` on each side of 1; the bolts are
    fitted with the best one.
    """
    hz, factors = whole.frequency_hz, most ** (np.arange(-steps, steps + 1) / steps)
    lines, states = seen.measurement.frequency_hz, levels(seen.states)

    def read(factor: float) -> Complexes:
        parts = [np.interp(lines / factor, hz, part, np.nan, np.nan) for own in whole.values.T for part in (own.real, own.imag)]
        return np.asarray(parts[0::2]).T + 1j * np.asarray(parts[1::2]).T

    far = [float(np.median(spread(levels(read(factor)) - states, 1), axis=1).min()) for factor in factors]
    best = float(factors[int(np.argmin(far))])
    moved = seen.reading(read(best))
    fitted = None if best == 1.0 else fitted_frf(moved)
    left = np.inf if fitted is None else float(np.median(apart(moved.measured, fitted)))
    return left, (
        f"With all its frequencies times {best:.3f} a coarse fit leaves {left:.1f} instead of {before:.1f} dB. Check whether another "
        f"sampling rate was entered or set, or the axis was typed. If so, multiply the frequencies of this job by {best:.4g}"
    )
