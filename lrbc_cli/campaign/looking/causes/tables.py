"""Tests whether stiffnesses in tables of springs are in another unit, or the model is of another material than assumed."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from lrbc_cli.arrays import Bools, Floats, Integers
from lrbc_cli.campaign.findings import Finding, Kind
from lrbc_cli.campaign.identification.compared.likeness import CLEARLY, LEAST_DIFFERENCE, MOST_LEFT, levels, spread
from lrbc_cli.campaign.looking.fitted import widely_fitted
from lrbc_cli.campaign.looking.states import Seen
from lrbc_cli.campaign.looking.trials import EXPLAINED, NEARER
from lrbc_cli.campaign.reading.places import POWERS
from lrbc_cli.errors import listing
from lrbc_cli.model.terms import ParameterGroup

#: Changes of all springs relative to the model [decades]: wider than the ratios of materials, in small steps.
_SOFTER = np.linspace(-1.5, 1.5, 31)

#: A factor of a unit must leave less than this share of the misfit of factors between units, and at most this multiple of the least misfit.
_NEARER, _ALIKE = 0.7, 1.5

#: Least difference of level if the whole model is of another material, and largest disagreement of level and springs on its factor [dB].
_LEAST_LEVEL, _OFF_LEVEL = 4.0, 2.0


def joints_text(seen: Seen, *, least: float = 1.0, others: float = 0.5, alike: float = 0.3) -> str:
    """Warning that names the joints whose springs are a decade or more too soft or too stiff, if that explains the tight state; else empty.

    Parameters
    ----------
    seen : Seen
        The reference job.
    least, others : float
        Least change of these joints, and largest change of all others [decades].
    alike : float
        Largest deviation of a joint from a factor that these joints share [decades].
    """
    before, bolts = seen.misfit, seen.inputs.bolts
    fit = widely_fitted(seen) if before > LEAST_DIFFERENCE else None
    if fit is None or bolts is None or fit[0] > min(EXPLAINED, CLEARLY * before):
        return ""
    left, change = fit
    far = np.flatnonzero(np.abs(change) >= least)
    if not far.size or bool((np.delete(np.abs(change), far) > others).any()):
        return ""
    names, middle = [bolts.name[b] for b in far], float(np.median(change[far]))
    if bool((np.abs(change[far] - middle) <= alike).all()):
        what = f"{listing(names, 12)} about {10.0**middle:.2g} times as stiff"
    else:
        what = listing([f"{name} {10.0**own:.2g} times" for name, own in zip(names, change[far].tolist(), strict=True)], 12) + " as stiff"
    files = dict.fromkeys(file.name for group in seen.inputs.groups if (file := group.config.select.bushings) is not None)
    loose = f", and whether {'it was' if far.size == 1 else 'they were'} loose in {seen.job}" if middle < 0.0 else ""
    return (
        f"the springs of some joints are probably wrong: with those of {what}, and the others nearly as stated, the level misfit falls "
        f"from {before:.1f} to {left:.1f} dB (mean level of each response removed). Check their stiffnesses and units in "
        f"{' and '.join(files) or 'the parameters'} and in the FE model{loose}"
    )


def other_tables(seen: Seen) -> list[Finding]:
    """Finding if a factor of a unit on one or all tables of springs, or another material, explains the tight state; else empty."""
    before = seen.misfit
    if before <= LEAST_DIFFERENCE:
        return []
    # Factors between units are tried, too: springs that are practically free or clamped fit equally well with them.
    powers = np.array([-2, -1, 1, 2, *POWERS])
    unit, ways = np.isin(powers, POWERS), []
    for where, signs, files, names in _tables(seen):
        left, _ = _moved(seen, where, powers[:, None] * signs)
        # Beyond the factor that frees or clamps, all fit equally well: take the smallest.
        close = np.flatnonzero(unit & (left <= _ALIKE * left.min()))
        best = int(close[np.argmin(np.abs(powers[close]))]) if close.size else int(left.argmin())
        if unit[best] and left[best] < min(MOST_LEFT, CLEARLY * before, _NEARER * left[~unit].min()):
            ways.append((float(left[best]), powers[best] * signs, where, files, names))
    if ways:
        # Prefer a single table: a further gain by others may be chance.
        nearest = min(left for left, *_ in ways)
        after, moved, where, files, names = next(way for way in ways if way[0] <= _ALIKE * nearest)
        factors, stated = [f"{10.0 ** moved[0]:g}"], seen.inputs.campaign.unit_system.text
        if (moved < 0).any() and (moved > 0).any():
            factors = [f"{10.0 ** moved[_turning(seen)[where] == turns][0]:g}" for turns in (False, True)]
        times, by = (
            ", those of rotations ".join([factors[0], *(f"{word} {factor}" for factor in factors[1:])]) for word in ("times", "by")
        )
        found = f"with all stiffnesses of {files} times {times}, the level misfit falls from {before:.1f} to {after:.1f} dB"
        wrong = f"stiffnesses probably in another unit than `units: {stated}` says"
        fix = f"Multiply the stiffnesses there by {by}"
        if np.abs(seen.parameters.initial[where] + moved).max() < 1.0:
            keys = ", ".join(f"parameters.{name}.initial: 0" for name in names)
            wrong, fix = "wrong start value, the table is right", f"Write {keys}"
        return [Finding(text=f"{wrong}: {found} (mean level of each response removed). {fix}", kind=Kind.TABLE)]
    return _material(seen, before)


def _tables(seen: Seen) -> Iterator[tuple[Integers, Integers, str, list[str]]]:
    """Indices in theta of each table of springs, and of all, the sign of the power of ten for each, and names of files and groups."""
    every = []
    for group, where, _ in seen.parameters.placed:
        file = next(g.config.select.bushings for g in seen.inputs.groups if g.name == group.name)
        if file is not None:
            every.append((np.arange(where.start, where.stop), file.name, [group.name]))
    for at, name, groups in every:
        yield at, np.ones(at.size, dtype=np.int64), name, groups
    if not every:
        return
    at, files = np.concatenate([at for at, _, _ in every]), " and ".join(dict.fromkeys(file for _, file, _ in every))
    names, turning = [name for *_, names in every for name in names], _turning(seen)[at]
    if len(every) > 1:
        yield at, np.ones(at.size, dtype=np.int64), files, names
    if turning.any() and not turning.all():
        # N/mm and N mm/rad: translations and rotations are wrong by inverse factors.
        yield at, np.where(turning, -1, 1), files, names


def _turning(seen: Seen) -> Bools:
    """(size,) True for values of springs that act on rotations only."""
    inputs, parameters = seen.inputs, seen.parameters
    found = np.zeros(parameters.size, dtype=bool)
    if inputs.dofs is None:
        return found
    left, rotation = inputs.model.terms.left, np.char.startswith(inputs.dofs.component.astype(str), "ROT")
    for group, where, _ in parameters.placed:
        for term, parameter in zip(group.terms.tolist(), group.parameter.tolist(), strict=True):
            found[where.start + parameter] = rotation[left[:, [term]].nonzero()[0]].all()
    return found


def _moved(seen: Seen, where: Integers, powers: Floats) -> tuple[Floats, Floats]:
    """Level misfit without constants, and the constants [dB], for each row of ``powers``, the changes of theta at ``where`` [decades]."""
    initial = seen.parameters.initial
    values = np.tile(initial, (powers.shape[0], 1))
    values[:, where] += powers
    difference = levels(seen.measured) - levels(seen.source.model(seen.s, seen.parameters).nearby(initial)(values))
    return np.median(spread(difference, 1), axis=1), np.nanmedian(difference, axis=(1, 2))


def _material(seen: Seen, before: float) -> list[Finding]:
    """Finding if stiffness and mass of the model are wrong by the same factor; else empty.

    Then the springs and the level of the FRFs deviate relative to the model by the inverse of that factor.
    """
    where = [np.arange(at.start, at.stop) for group, at, _ in seen.parameters.placed if group.kind == "stiffness"]
    if not where:
        return []
    left, level = _moved(seen, np.concatenate(where), _SOFTER[:, None])
    best = int(np.argmin(left))
    off = float(level[best])
    if left[best] > min(MOST_LEFT, CLEARLY * before) or abs(off) < _LEAST_LEVEL or abs(20.0 * _SOFTER[best] - off) > _OFF_LEVEL:
        return []
    factor, size = 10.0 ** (abs(off) / 20.0), "large" if off > 0.0 else "small"
    text = (
        f"stiffness and mass of the model are probably both about {factor:.2g} times too {size}: measured FRFs are {abs(off):.1f} dB "
        f"{'above' if off > 0.0 else 'below'} the model's, and correcting both reduces the level misfit from {before:.1f} to "
        f"{left[best]:.1f} dB (mean level of each response removed). Possible causes: another material (2.9 and 3 are steel for "
        "aluminium), another thickness. Correct modulus and density in the FE model (compare the mass sum with the weight of the "
        "structure), and export it again"
    )
    return [Finding(text=text, kind=Kind.MATERIAL)]


def unit_text(seen: Seen, before: float, *, powers: tuple[int, ...] = (-6, -3, 3, 6)) -> str:
    """Warning that names a table of springs with which in another unit the model explains the tight state; else empty.

    ``before`` is the level misfit of the tight state [dB].
    """
    found = list[tuple[float, int, ParameterGroup]]()
    for group, where, _ in seen.parameters.placed:
        if group.kind == "stiffness" and seen.inputs.campaign.parameters[group.name].select.bushings is not None:
            misfits, _ = _moved(seen, np.arange(where.start, where.stop), np.array(powers, dtype=float)[:, None])
            found += [(misfit, power, group) for misfit, power in zip(misfits.tolist(), powers, strict=True)]
    if not found:
        return ""
    left, power, group = min(found, key=lambda each: each[0])
    if left > NEARER * before:
        return ""
    falls = f"{before:.1f} to {left:.1f} dB (mean level of each response removed)"
    return f"with all springs of {group.name} times {10.0**power:.0e} the level misfit falls from {falls}. {_unit_fix(seen, group, power)}"


def _unit_fix(seen: Seen, group: ParameterGroup, power: int) -> str:
    """What to check and to write if the springs of a table are wrong by a power of ten."""
    table = seen.inputs.campaign.parameters[group.name].select.bushings
    assert table is not None
    return (
        "Check their unit: stiffnesses are in N/m and N m/rad, or in the units of `units` (1 N/mm = 1e3 N/m, 1 N mm/rad = 1e-3 N m/rad). "
        f"If it is another one, multiply the column stiffness of {table.name} by {10.0**power:.0e}"
    )


def of_other_unit_text(before: Seen, after: Seen, *, least: float = 1.5, alike: float = 0.5, close: float = 0.1, share: float = 0.5) -> str:
    """Warning that names a table of springs that a rough calibration changes by a power of ten as a whole; empty if there is none.

    Parameters
    ----------
    before, after : Seen
        The reference job with the model as exported, and with the roughly calibrated one.
    least, alike : float
        Least change of the median of a table, and largest scatter of its springs about it (median) [decades].
    close, share : float
        Share of the springs of a table within ``close`` [decades] of one bound that counts as a change beyond it. On right campaigns no
        table had one spring there.
    """
    for group, where, _ in before.parameters.placed:
        table = before.inputs.campaign.parameters[group.name].select.bushings
        moved = (after.parameters.initial - before.parameters.initial)[where]
        by = float(np.median(moved))
        bound = after.parameters.bounds[where][:, int(by > 0.0)]
        beyond = float(np.mean(np.abs(after.parameters.initial[where] - bound) <= close)) >= share and by != 0.0
        if table is None or not (beyond or abs(by) >= least) or float(np.median(np.abs(moved - by))) > alike:
            continue
        # A bound short of the unit of millimetres hides how far the springs would go.
        power = int(np.copysign(max(round(abs(by)), 3), by)) if beyond else round(by)
        size = f"by {10.0**by:.2g}, to their bounds" if beyond else f"by about {10.0**power:.0e}"
        return f"a rough calibration from this job multiplies all springs of {group.name} {size}. {_unit_fix(before, group, power)}"
    return ""
