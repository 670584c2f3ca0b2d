"""Tests whether one part of an assembly has another material or thickness, or the model holds a mass that the structure does not."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import chain

import numpy as np
import scipy.sparse as sp

from lrbc_cli.arrays import Bools, Floats
from lrbc_cli.campaign.identification.compared.likeness import CLEARLY, LEAST_DIFFERENCE, apart
from lrbc_cli.campaign.identification.records import Measurement
from lrbc_cli.campaign.looking.causes.held import free_of_supports
from lrbc_cli.campaign.looking.causes.rescaled import explains
from lrbc_cli.campaign.looking.fitted import calibrated_by_rounds, multiplied
from lrbc_cli.campaign.looking.states import Looking, Seen, coarsely_reduced
from lrbc_cli.campaign.looking.trials import EXPLAINED, FEWEST, MOST_WORK, NEARER, UNLIKE, Cause, left_of, ported, resonances
from lrbc_cli.campaign.reading.factors import recipe_of
from lrbc_cli.campaign.reading.places import extents
from lrbc_cli.campaign.reading.reach import parts_of
from lrbc_cli.campaign.reduced.memory import reduction_cost
from lrbc_cli.campaign.reduced.stage import affine_model
from lrbc_cli.errors import LrbcError, listing
from lrbc_cli.model.fem import FeModel
from lrbc_cli.model.mesh_parts import MeshPart, mesh_parts

#: What of a part is multiplied, and what is then to be checked.
_WRONG = {
    "mass": ("mass", "density"),
    "stiffness": ("stiffness", "modulus"),
    "material": ("stiffness and mass", "material, or thickness,"),
}


@dataclass(frozen=True)
class _Alike:
    """Parts of the same size and mass, such as two stringers of one section, which are wrong together; and the sums of their shares."""

    parts: tuple[MeshPart, ...]
    K: sp.csc_array
    M: sp.csc_array

    @classmethod
    def of(cls, parts: Sequence[MeshPart]) -> _Alike:
        return cls(tuple(parts), sp.csc_array(sum(part.K for part in parts)), sp.csc_array(sum(part.M for part in parts)))

    def times(self, stiffness: float, mass: float) -> _Alike:
        return _Alike(self.parts, stiffness * self.K, mass * self.M)


def part_text(seen: Seen, before: float, *, ratio: float = 2.9, moduli: float = 3.0) -> str:
    """Warning that names a part, of those that only springs join, or a structure beside air, with the material of another; else empty.

    Parameters
    ----------
    seen : Seen
    before : float
        Level misfit of the model, constants removed, median over the responses [dB].
    ratio, moduli : float
        Of the densities (7850 and 2700 kg/m3), and of the moduli (210 and 70 GPa), of steel and aluminium.
    """
    bodies, model, found = _bodies(seen), seen.inputs.model, list[tuple[float, float, int, float, float]]()
    ways = [(stiff**sign, heavy**sign) for sign in (1, -1) for stiff, heavy in ((1.0, ratio), (moduli, 1.0), (moduli, ratio))]
    if not bodies and model.is_acoustic.any() and before > UNLIKE:
        # One structure beside air, whose mass is right: large models, so one case only. More resonances than computed: it is too light.
        more = resonances(seen.measured) >= resonances(seen.model)
        bodies, ways = [_body(model, ~model.is_acoustic)], [(1.0, ratio if more else 1.0 / ratio)]
    few = seen.few(FEWEST)
    if before <= LEAST_DIFFERENCE or len(bodies) * len(ways) * seen.work(few.s.size) > MOST_WORK:
        return ""
    for k, part in enumerate(bodies):
        for stiff, heavy in ways:
            K = model.K if stiff == 1.0 else sp.csc_array(model.K + (stiff - 1.0) * part.K)
            M = model.M if heavy == 1.0 else sp.csc_array(model.M + (heavy - 1.0) * part.M)
            with suppress(LrbcError):
                found.append((*_misfit(few, replace(model, K=K, M=M)), k, stiff, heavy))
    if not found or not explains(*min(found)[:2], before, 1.5):
        return ""
    left, _, best, stiff, heavy = min(found)
    kind = "mass" if stiff == 1.0 else "stiffness" if heavy == 1.0 else "material"
    what, check = _WRONG[kind]
    where = "structure" if len(bodies) == 1 else _where(seen, bodies[best], "part")
    size = "small" if max(stiff, heavy) > 1.0 else "large"
    return (
        f"the {what} of the {where} {'are' if kind == 'material' else 'is'} probably about {ratio:g} times too {size}, as of aluminium and "
        f"steel exchanged: corrected, the level misfit falls from {before:.1f} to {left:.1f} dB (mean level of each response removed). "
        f"Check the {check} there in the FE model, and export it again"
    )


def lump_text(seen: Seen, before: float, *, times: float = 20.0, most: int = 8) -> str:
    """Warning that names masses at single nodes without which the model explains a measurement; empty if there are none.

    Parameters
    ----------
    seen : Seen
    before : float
        Level misfit of the model, constants removed, median over the responses [dB].
    times : float
        Least ratio of such a mass to the median of the nodes. On right models the largest ratio was 2.8.
    most : int
        Largest number of such nodes.
    """
    inputs, model, few = seen.inputs, seen.inputs.model, seen.few(FEWEST)
    if inputs.dofs is None or before <= LEAST_DIFFERENCE or seen.work(few.s.size) > MOST_WORK:
        return ""
    diagonal = np.where(np.char.startswith(inputs.dofs.component.astype(str), "U"), np.real(model.M.diagonal()), 0.0)
    typical = float(np.median(diagonal[diagonal > 0.0])) if (diagonal > 0.0).any() else np.inf
    excess = np.where(diagonal > times * typical, diagonal - typical, 0.0)
    nodes = np.unique(inputs.dofs.node[excess > 0.0])
    if not 0 < nodes.size <= most:
        return ""
    with suppress(LrbcError):
        left, off = _misfit(few, replace(model, M=sp.csc_array(model.M - sp.diags_array(excess))))
        if explains(left, off, before, 1.5):
            held = listing([f"{excess[inputs.dofs.node == node].max():.3g} kg at node {node}" for node in nodes], 4)
            return (
                f"the mass matrix holds {held} in addition to the mass of the structure; without it the level misfit falls from "
                f"{before:.1f} to {left:.1f} dB (mean level of each response removed). Check whether that mass was on the test bench; if "
                "not, remove it in the FE model, and export it again"
            )
    return ""


def part_cause(
    seen: Seen,
    whole: Measurement,
    *,
    calibrated: float = np.inf,
    most: float = EXPLAINED,
    passes: int = 2,
    rounds: int = 2,
    exact: float = 1.0,
) -> Cause:
    """A part whose stiffness or mass is wrong by any factor.

    Rough calibrations find factors of the stiffness and of the mass of each part, and full solves confirm them. Parts that only springs
    join come first, then those that share nodes (``model.mesh_parts``).

    Parameters
    ----------
    seen : Seen
    whole : Measurement
        The same on all its lines.
    calibrated : float
        Level misfit after a rough calibration of the whole model, if there is one [dB].
    most : float
        Largest level misfit that may be left [dB].
    passes, rounds : int
        Number of reduced models, each of the matrices found with the one before, and of calibrations with each: a calibration reaches a
        factor of 1.35.
    exact : float
        Largest error of the reduced model at the factors found [dB].
    """
    source, settings, inputs = seen.source, seen.inputs.campaign.calibration, seen.inputs
    free = settings is not None and settings.job == seen.job and not inputs.model.extras and source.stage is not None
    if not free or seen.misfit <= LEAST_DIFFERENCE or reduction_cost(inputs)[0].work > MOST_WORK:
        return Cause()
    dofs, limits, bodies = inputs.dofs, (min(seen.misfit, calibrated), most), _bodies(seen)
    meshed = [] if dofs is None else mesh_parts(free_of_supports(seen), dofs)
    # Of two alike that only springs join, one may be wrong: the parts of a lap joint, for example.
    kinds = [
        each for each in ([_Alike.of([one]) for one in bodies], _grouped(meshed if len(meshed) > len(bodies) else [])) if len(each) > 1
    ]
    causes = (_of_parts(seen, whole, parts, limits, passes, rounds, exact=exact) for parts in kinds)
    return next((cause for cause in causes if cause.text), Cause())


def _grouped(parts: Sequence[MeshPart], *, near: float = 1e-6) -> list[_Alike]:
    """The parts, those with as many DOFs and the same mass, to a share ``near``, together."""
    found = list[tuple[int, float, list[MeshPart]]]()
    for part in parts:
        count, mass = int(part.own.sum()), float(np.abs(part.M.diagonal()).sum())
        same = next((own for size, weight, own in found if size == count and abs(weight - mass) <= near * mass), None)
        if same is None:
            found.append((count, mass, [part]))
        else:
            same.append(part)
    return [_Alike.of(own) for _, _, own in found]


def _of_parts(
    seen: Seen,
    whole: Measurement,
    parts: Sequence[_Alike],
    limits: tuple[float, float],
    passes: int,
    rounds: int,
    *,
    least: float = 1.2,
    count: int = 6,
    exact: float = 1.0,
    falling: float = 0.8,
) -> Cause:
    """See ``part_cause``, for parts of one kind.

    ``limits``: level misfit without, and the largest that may be left [dB]; ``falling``: what each pass may leave of the first; ``least``:
    least factor of that part; of more than ``count`` parts those are calibrated that alone bring the model nearest.

    Small parts take up what is left, and their factors mean nothing. So the factors of one part alone must explain the measurement, and
    clearly better than those of any other do.
    """
    before, most = limits
    source, settings = seen.source, seen.inputs.campaign.calibration
    assert settings is not None
    keys = [(f"stiffness {k}", f"mass {k}") for k in range(len(parts))]
    others = tuple(name for name in settings.names if name not in ("stiffness.structure", "mass.structure"))
    try:
        found, begun, nearest = _begun(source, seen, keys, parts)
        if not begun:
            # No factor of a single part brings the model nearer.
            return Cause()
        kept = sorted(nearest[:count])
        keys, parts = [keys[k] for k in kept], [parts[k] for k in kept]
        names = (*others, *chain(*keys))
        factors = dict.fromkeys(names, 1.0) | begun
        for _ in range(passes):
            now = [part.times(factors[k], factors[m]) for part, (k, m) in zip(parts, keys, strict=True)]
            found, further = calibrated_by_rounds(_with_parts(found, keys, now), whole, names, rounds)
            factors, after = {name: value * further[name] for name, value in factors.items()}, Seen.of_model(found, seen.job, whole)
            if after.misfit > falling * before:
                return Cause()
        few = after.few(FEWEST)
        full = ported(few, found.inputs.model).evaluate(few.dynamic)
    except LrbcError:
        return Cause()
    # The basis is that of the model before the last calibrations.
    if float(np.median(apart(full, few.model))) > exact or after.misfit > min(most, CLEARLY * before):
        return Cause()
    plain = dict.fromkeys(chain(*keys), 1.0)
    alone = [_left_with(found, after, whole, factors, plain | {name: factors[name] for name in own}) for own in keys]
    worst = int(np.argmin(alone))
    logs = np.log([factors[name] for name in keys[worst]])
    if alone[worst] > min(EXPLAINED, NEARER * before, NEARER * min(np.delete(alone, worst))) or np.linalg.norm(logs) < np.log(least):
        return Cause()
    # A factor on the whole structure is told elsewhere.
    every = {name: factors[own] for key in keys for name, own in zip(key, keys[worst], strict=True)}
    if _left_with(found, after, whole, factors, every) < alone[worst]:
        return Cause()
    return Cause(_part_text(seen, parts[worst], worst, logs, alone[worst]), alone[worst])


def _left_with(found: Looking, after: Seen, whole: Measurement, factors: Mapping[str, float], others: Mapping[str, float]) -> float:
    """Level misfit [dB] of the calibrated model with ``others`` instead of the factors found."""
    assert found.stage is not None
    one = multiplied(found, affine_model(found.inputs, found.stage), {name: value / factors[name] for name, value in others.items()})
    return Seen.of_model(replace(one, start=found.start), after.job, whole).misfit


def _part_text(seen: Seen, part: _Alike, number: int, logs: Floats, left: float) -> str:
    """Warning about one part, with the logarithms of the factors of its stiffness and mass, and the misfit left [dB]."""
    stiffness, mass = logs.tolist()
    where = " and the ".join(_where(seen, each, f"part {number + 1}") for each in part.parts)
    whose = "its" if len(part.parts) == 1 else "their"
    return (
        f"with the stiffness of the {where} times {np.exp(stiffness):.2g}, and {whose} mass times {np.exp(mass):.2g}, a rough calibration "
        f"leaves a level misfit of {left:.1f} dB, of {seen.misfit:.1f} dB (mean level of each response removed). "
        f"{_cause(stiffness, mass)}. Correct it in the FE model, and export it again"
    )


def _where(seen: Seen, part: MeshPart, unknown: str) -> str:
    """A part by its nodes and extents, its border among them; ``unknown`` without coordinates."""
    dofs, units = seen.inputs.dofs, seen.inputs.campaign.unit_system
    if dofs is None:
        return unknown
    there = part.own | (part.K.diagonal() != 0.0)
    # Parts one on the other have the same extents.
    return f"part of {np.unique(dofs.node[there]).size} nodes at {extents(dofs.xyz[there], units.length, units.length_name)}"


def _begun(
    source: Looking,
    seen: Seen,
    keys: Sequence[tuple[str, str]],
    parts: Sequence[_Alike],
    *,
    sizes: tuple[float, ...] = (0.7, 0.83, 1.2, 1.4),
    lines: int = 60,
) -> tuple[Looking, dict[str, float], list[int]]:
    """The model, as it is or with stiffness and mass of one part multiplied, that is nearest to the measurement; and these factors.

    Third, the numbers of the parts in the order in which they alone bring the model near.

    A calibration finds the nearest valley only, and resonances that cross others lead into another one. ``sizes`` are the factors tried on
    a thickness, on about ``lines`` lines.
    """
    whole, few = _with_parts(source, keys, parts), seen.few(lines)
    assert whole.stage is not None
    affine = affine_model(whole.inputs, whole.stage)
    found, alone = list[tuple[float, int, dict[str, float]]](), dict[int, float]()
    # Another thickness, another modulus, another density.
    ways = [way for size in sizes for way in ((size**3, size), (size**3, 1.0), (1.0, size**2))]
    # Steel for aluminium, and its density alone.
    ways += [(stiff**power, heavy**power) for stiff, heavy in ((3.0, 2.9), (1.0, 2.9)) for power in (1.0, -1.0)]
    for k, factors in [(-1, dict[str, float]()), *((k, dict(zip(own, way, strict=True))) for k, own in enumerate(keys) for way in ways)]:
        stage = replace(whole.stage, reduction=replace(whole.stage.reduction, model=affine.at(factors)))
        # A source of its own: FRFs computed before are kept in it.
        one = Looking(inputs=whole.inputs, stage=stage, kind="port")
        values = one.model(few.s, few.parameters).frf(few.parameters.initial)
        left = float(np.median(apart(few.measured, values)))
        found.append((left, len(found), factors))
        alone[k] = min(left, alone.get(k, np.inf))
    begun = min(found)[2]
    return multiplied(whole, affine, begun), begun, sorted(range(len(keys)), key=alone.__getitem__)


def _cause(stiffness: float, mass: float) -> str:
    """The likeliest mistake that multiplies stiffness and mass of a part by the exponentials of these numbers."""

    def wrong(size: float) -> str:
        return f"{np.exp(-size):.2g} times too large" if size < 0.0 else f"{np.exp(size):.2g} times too small"

    # Distances from what each mistake leaves, and its size. A thickness stiffens plates by its third power.
    thin, both = (3.0 * stiffness + mass) / 10.0, (stiffness + mass) / 2.0
    lacking = "missing in the model" if mass > 0.0 else "not on the structure"
    ways = [
        (abs(stiffness - 3.0 * mass) / 10.0**0.5, f"The thickness of plates, or the height of beams, is probably {wrong(thin)}"),
        (abs(stiffness - mass) / 2.0**0.5, f"Modulus and density are probably both {wrong(both)} (aluminium for steel: 2.9)"),
        (abs(mass), f"The modulus is probably {wrong(stiffness)}"),
        (abs(stiffness), f"The density is probably {wrong(mass)}, or a mass there is {lacking}"),
    ]
    return min(ways)[1]


def _with_parts(source: Looking, keys: Sequence[tuple[str, str]], parts: Sequence[_Alike]) -> Looking:
    """The model with a factor of the stiffness, and one of the mass, of each part, named by ``keys``."""
    inputs, model = source.inputs, source.inputs.model
    groups = dict[str, dict[str, sp.csc_array]]()
    for (stiffness, mass), part in zip(keys, parts, strict=True):
        groups |= {stiffness: {"stiffness": part.K}, mass: {"mass": part.M}}
    model = replace(model, extras=groups)
    inputs = replace(inputs, model=model, recipe=recipe_of(inputs.campaign, model))
    assert source.stage is not None
    return Looking(inputs=inputs, stage=replace(source.stage, reduction=coarsely_reduced(inputs)), kind="port")


def _misfit(seen: Seen, model: FeModel) -> tuple[float, float]:
    """See ``left_of``, for another model."""
    return left_of(seen, ported(seen, model).evaluate(seen.dynamic))


def _bodies(seen: Seen, *, least: float = 0.02) -> list[MeshPart]:
    """The structural parts that only terms join, each with a share of ``least`` of the DOFs; empty if there is one."""
    model = free_of_supports(seen)
    structural = ~model.is_acoustic
    # Air joins parts, too; without it, each of its DOFs is a part of its own.
    own = sp.diags_array(structural.astype(float))
    alone = {name: sp.csc_array(own @ getattr(model, name) @ own) for name in ("K", "C", "M")}
    labels = parts_of(replace(model, **alone), joined=False)
    large = np.flatnonzero(np.bincount(labels[structural], minlength=1) >= max(least * structural.sum(), 1.0))
    return [_body(model, labels == label) for label in large] if large.size > 1 else []


def _body(model: FeModel, mask: Bools) -> MeshPart:
    """The part with these DOFs; the coupling of structure and air is no share of it."""
    own = sp.diags_array(mask.astype(float))
    return MeshPart(mask, sp.csc_array(own @ model.K @ own), sp.csc_array(own @ model.M @ own))


def at_bounds_text(calibrated: Looking, left: float) -> str:
    """Warning that names factors that a rough calibration moves to their bounds, with the level misfit ``left`` [dB]; else empty."""
    if not calibrated.at_bounds:
        return ""
    named = ", ".join(f"{name} to {value:.3g}" for name, value in calibrated.at_bounds.items())
    return (
        f"a rough calibration moves {named}, the most that it allows, and {left:.1f} dB are left (level misfit, mean of each response "
        "removed): the model errs by more than a calibration corrects. Check material, thickness and mass of that part in the FE model"
    )
