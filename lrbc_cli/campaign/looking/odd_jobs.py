"""Jobs that no state of the bolts explains, although others are: by other air, or a hammer at another place."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from lrbc_cli.arrays import Floats
from lrbc_cli.campaign.findings import Finding, Kind
from lrbc_cli.campaign.identification.compared.likeness import CLEARLY, LEAST_DIFFERENCE, apart
from lrbc_cli.campaign.identification.nuisances import KELVIN
from lrbc_cli.campaign.identification.records import Measurement
from lrbc_cli.campaign.looking.causes.moved import hammer_text
from lrbc_cli.campaign.looking.fitted import fitted_frf, multiplied
from lrbc_cli.campaign.looking.states import Looking, Seen
from lrbc_cli.campaign.reduced.stage import affine_model
from lrbc_cli.model.factors import SOUND_SPEED


def odd_jobs(
    source: Looking,
    measurements: Mapping[str, Measurement],
    names: Sequence[str],
    closer: Callable[[str], Floats],
    *,
    times: float = 2.5,
) -> dict[str, Finding]:
    """Finding of each job that is far from the state fitted to it, unlike the best explained one, and that another cause explains.

    Without one nothing is said: with half of the joints loosened, right jobs are up to 2.9 times as far.

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
        Least misfit over that of the best explained job. With the first fit it was 3.1 at most on right campaigns.
    """
    reference = source.inputs.campaign.update.reference or ""
    far = {name: float(np.median(own)) for name, own in source.away.items()}
    found, tried = dict[str, Finding](), list[float]()
    for name in (name for name in far if name in names):
        usual = min((left for other, left in source.left.items() if other not in (name, reference)), default=np.inf)
        limit = max(LEAST_DIFFERENCE, times * usual)
        if far[name] <= limit or (left := float(np.median(closer(name)))) <= limit:
            continue
        seen = Seen.of(source, name, measurements[name], measurements[reference])
        if (cause := _cause(seen, left, usual, far[name], tried)) is not None:
            found[name] = cause
    return found


def _cause(seen: Seen, left: float, usual: float, coarse: float, tried: list[float]) -> Finding | None:
    """Finding of a job with the level misfit ``left`` beside one with ``usual`` [dB]; None without a cause, or if ``update`` identifies it.

    ``coarse``: the misfit after a first, coarse fit; ``tried``: see ``_warmer``.
    """
    much = f"no state of the bolts explains it: {left:.1f} dB are left (mean level of each response removed), {usual:.1f} dB of another job"
    nuisances = seen.inputs.method.nuisances
    if (step := _warmer(seen, coarse, tried)) is not None:
        change, misfit = step
        if nuisances.temperature is not None or nuisances.sound_speed is not None:
            return None
        kelvin = 2.0 * abs(change) * (nuisances.room + KELVIN)
        text = (
            f"{much}. With a speed of sound about {abs(change):.1%} {'above' if change > 0 else 'below'} that of the reference job a "
            f"coarse fit leaves {misfit:.1f} instead of {coarse:.1f} dB: the air was probably about {kelvin:.0f} K "
            f"{'warmer' if change > 0 else 'colder'}. Measure again at the temperature of the reference job, or let `lrbc update` identify "
            f"it: update.nuisances: {{temperature: {max(kelvin, 1.0):.0f}}} (standard deviation in K)"
        )
        return Finding(text=text, kind=Kind.FOREIGN)
    if moved := hammer_text(seen, apart(seen.measured, seen.states)):
        return Finding(text=f"{much}; {moved}", kind=Kind.HAMMER)
    return None


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
        Changes tried, and the factor by which two more lie about the best of them.
    """
    source, inputs = seen.source, seen.inputs
    if SOUND_SPEED not in inputs.recipe.names or source.stage is None or seen.tight is None:
        return None
    model, prior = affine_model(inputs, source.stage), seen.parameters.initial
    measured, here = seen.tight, source.model(seen.s, seen.parameters).frf(prior)

    def with_speed(step: float) -> tuple[float, float]:
        other = multiplied(source, model, {SOUND_SPEED: 1.0 + step})
        # The tight state as it would be with this speed.
        tight = measured * other.model(seen.s, seen.parameters).frf(prior) / here
        fitted = fitted_frf(replace(seen, source=other, tight=tight))
        return (np.inf if fitted is None else float(np.median(apart(seen.measured, fitted)))), step

    for each in filter(None, (tried, steps)):
        left, step = min(map(with_speed, each))
        if each is steps:
            left, step = min((left, step), *map(with_speed, (near * step, step / near)))
        if left <= CLEARLY * before:
            tried[:] = [step]
            return step, left
    return None
