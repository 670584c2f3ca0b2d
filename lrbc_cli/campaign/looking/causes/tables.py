"""Tests whether stiffnesses in tables of springs are in another unit, or the model is of another material than assumed."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from lrbc_cli.arrays import Bools, Floats, Integers
from lrbc_cli.campaign.findings import Finding, Kind
from lrbc_cli.campaign.identification.compared.likeness import CLEARLY, LEAST_DIFFERENCE, MOST_LEFT, apart, levels, spread
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


def joints_text(seen: Seen, *, most: float = EXPLAINED, least: float = 0.8, others: float = 0.5, alike: float = 0.3) -> str:
    """Warning that names joints whose springs are a decade or more too soft or too stiff, if that explains the tight state; else empty.

    Parameters
    ----------
    seen : Seen
        The reference job.
    most : float
        Largest level misfit with these joints [dB].
    least, others : float
        Least change of these joints, a decade up to their scatter, and largest change of all others [decades].
    alike : float
        Largest deviation of a joint from a factor that these joints share [decades].
    """
    before, bolts = seen.misfit, seen.inputs.bolts
    fit = widely_fitted(seen) if before > LEAST_DIFFERENCE else None
    if fit is None or bolts is None or fit[0] > min(most, CLEARLY * before):
        return ""
    left, change = fit
    far = np.flatnonzero(np.abs(change) >= least)
    if not far.size or bool((np.delete(np.abs(change), far) > others).any()):
        return ""
    names, middle, every = [bolts.name[b] for b in far], float(np.median(change[far])), far.size == change.size > 1
    if bool((np.abs(change[far] - middle) <= alike).all()):
        what = f"{listing(names, 12)} about {10.0**middle:.2g} times as stiff"
    else:
        what = listing([f"{name} {10.0**own:.2g} times" for name, own in zip(names, change[far].tolist(), strict=True)], 12) + " as stiff"
    files = dict.fromkeys(file.name for group in seen.inputs.groups if (file := group.config.select.bushings) is not None)
    loose = f", and whether {'it was' if far.size == 1 else 'they were'} loose in {seen.job}" if middle < 0.0 else ""
    return (
        f"the springs of {'all' if every else 'some'} joints are probably wrong: with those of {what}"
        f"{'' if every else ', and the others nearly as stated'}, the level misfit falls from {before:.1f} to {left:.1f} dB (mean level of "
        f"each response removed). Check their stiffnesses and units in {' and '.join(files) or 'the parameters'} and in the FE model{loose}"
    )


def other_tables(seen: Seen) -> list[Finding]:
    """Finding if a factor of a unit on one or all tables of springs, or another material, explains the tight state; else empty."""
    before = seen.misfit
    if before <= LEAST_DIFFERENCE:
        return []
    # Factors between units are tried, too: springs that are practically free or clamped fit equally well with them.
    powers = np.array([-2, -1, 1, 2, *POWERS])
    unit, ways = np.isin(powers, POWERS), list[tuple[float, int, _Table]]()
    for whole in _tables(seen):
        table, left = whole, _changed(seen, whole, powers)
        # Stiff translations hide how stiff they are: the factor may be that of the rotations alone.
        for part in _kinds(whole):
            own = _changed(seen, part, powers)
            if own[unit].min() < _NEARER * left[unit].min():
                table, left = part, own
        # Beyond the factor that frees or clamps, all fit equally well: take the smallest.
        close = np.flatnonzero(unit & (left <= _ALIKE * left.min()))
        best = int(close[np.argmin(np.abs(powers[close]))]) if close.size else int(left.argmin())
        if unit[best] and left[best] < min(MOST_LEFT, CLEARLY * before, _NEARER * left[~unit].min()):
            ways.append((float(left[best]), int(powers[best]), table))
    if ways:
        # Prefer a single table: a further gain by others may be chance.
        nearest = min(left for left, *_ in ways)
        return [_of_unit(seen, *next(way for way in ways if way[0] <= _ALIKE * nearest), before)]
    return _material(seen, before)


@dataclass(frozen=True, kw_only=True)
class _Table:
    """A table of springs, its rotations or translations alone, or several tables.

    Attributes
    ----------
    terms : (k,) int array
    signs : (k,) int array
        Of the power of ten by which each is multiplied.
    turning : (k,) bool array
        Whether the spring acts on rotations only.
    files : str
    groups : tuple of str
    """

    terms: Integers
    signs: Integers
    turning: Bools
    files: str
    groups: tuple[str, ...]


def _tables(seen: Seen) -> Iterator[_Table]:
    """Each table of springs, and all together, also with translations and rotations that are wrong by inverse factors."""
    inputs, every = seen.inputs, list[_Table]()
    for group in inputs.groups:
        file = group.config.select.bushings
        if file is not None and group.config.kind == "stiffness":
            ones, turning = np.ones(group.terms.size, dtype=np.int64), _turning(seen, group.terms)
            every.append(_Table(terms=group.terms, signs=ones, turning=turning, files=file.name, groups=(group.name,)))
    yield from every
    if not every:
        return
    files = " and ".join(dict.fromkeys(table.files for table in every))
    joined = {name: np.concatenate([getattr(table, name) for table in every]) for name in ("terms", "signs", "turning")}
    together = _Table(**joined, files=files, groups=tuple(name for table in every for name in table.groups))
    if len(every) > 1:
        yield together
    if together.turning.any() and not together.turning.all():
        # N/mm and N mm/rad.
        yield replace(together, signs=np.where(together.turning, -1, 1))


def _kinds(table: _Table) -> Iterator[_Table]:
    """Rotations and translations alone, if the springs of a table act on both and are multiplied by the same power."""
    if table.turning.all() or not table.turning.any() or np.ptp(table.signs):
        return
    for what, own in (("rotations", table.turning), ("translations", ~table.turning)):
        files = f"the {what} in {table.files}"
        yield replace(table, terms=table.terms[own], signs=table.signs[own], turning=table.turning[own], files=files)


def _turning(seen: Seen, terms: Integers) -> Bools:
    """(k,) True for springs that act on rotations only."""
    dofs, left = seen.inputs.dofs, seen.inputs.model.terms.left
    if dofs is None:
        return np.zeros(terms.size, dtype=bool)
    rotation = np.char.startswith(dofs.component.astype(str), "ROT")
    return np.array([rotation[left[:, [term]].nonzero()[0]].all() for term in terms.tolist()])


def _changed(seen: Seen, table: _Table, powers: Integers) -> Floats:
    """Level misfit with the springs of a table multiplied by each of the ``powers`` of ten, constants removed [dB]."""
    ports, start, found = seen.source.table(seen.s), seen.dynamic, list[float]()
    for power in powers.tolist():
        dynamic = start.copy()
        dynamic[:, table.terms] *= 10.0 ** (power * table.signs)
        found.append(float(np.median(apart(seen.measured, ports.evaluate(dynamic)))))
    return np.array(found)


def _of_unit(seen: Seen, after: float, power: int, table: _Table, before: float) -> Finding:
    """Finding of a table that is wrong by a power of ten, with the level misfits with and without that factor [dB]."""
    factors, stated = [f"{10.0 ** (power * table.signs[0]):g}"], seen.inputs.campaign.unit_system.text
    if np.ptp(table.signs):
        factors = [f"{10.0 ** (power * table.signs[table.turning == turns][0]):g}" for turns in (False, True)]
    times, by = (", those of rotations ".join([factors[0], *(f"{word} {factor}" for factor in factors[1:])]) for word in ("times", "by"))
    found = f"with all stiffnesses of {table.files} times {times}, the level misfit falls from {before:.1f} to {after:.1f} dB"
    wrong = f"stiffnesses probably in another unit than `units: {stated}` says"
    fix = f"Multiply the stiffnesses there by {by}"
    initial = [seen.parameters.initial[where] for group, where, _ in seen.parameters.placed if group.name in table.groups]
    # A part of a table shares the start values of all of it.
    whole = sum(one.terms.size for one in seen.inputs.groups if one.name in table.groups) == table.terms.size
    if whole and not np.ptp(table.signs) and np.abs(np.concatenate(initial) + power).max() < 1.0:
        keys = ", ".join(f"parameters.{name}.initial: 0" for name in table.groups)
        wrong, fix = "wrong start value, the table is right", f"Write {keys}"
    return Finding(text=f"{wrong}: {found} (mean level of each response removed). {fix}", kind=Kind.TABLE)


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
