"""Tests whether one part of an assembly has another material or thickness, or the model holds a mass that the structure does not."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import chain

import numpy as np
import scipy.sparse as sp

from lrbc_cli.arrays import Bools, Floats
from lrbc_cli.campaign.identification.compared.likeness import CLEARLY, LEAST_DIFFERENCE, apart
from lrbc_cli.campaign.identification.records import Measurement
from lrbc_cli.campaign.looking.causes.rescaled import explains
from lrbc_cli.campaign.looking.fitted import calibrated_by_rounds, multiplied
from lrbc_cli.campaign.looking.states import Looking, Seen, coarsely_reduced
from lrbc_cli.campaign.looking.trials import EXPLAINED, FEWEST, MOST_WORK, UNLIKE, left_of, ported, resonances
from lrbc_cli.campaign.reading.factors import recipe_of
from lrbc_cli.campaign.reading.places import extents
from lrbc_cli.campaign.reading.reach import parts_of
from lrbc_cli.campaign.reduced.memory import reduction_cost
from lrbc_cli.campaign.reduced.stage import affine_model
from lrbc_cli.errors import LrbcError, listing
from lrbc_cli.model.fem import FeModel

#: What of a part is multiplied, and what is then to be checked.
_WRONG = {
    "mass": ("mass", "density"),
    "stiffness": ("stiffness", "modulus"),
    "material": ("stiffness and mass", "material, or thickness,"),
}


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
    cases = [(part, factor, kind) for part in _parts(seen) for factor in (ratio, 1.0 / ratio) for kind in _WRONG]
    if not cases and seen.inputs.model.is_acoustic.any() and before > UNLIKE:
        # One structure beside air, whose mass is right: large models, so one case only. More resonances than computed: it is too light.
        more = resonances(seen.measured) >= resonances(seen.model)
        cases = [(~seen.inputs.model.is_acoustic, ratio if more else 1.0 / ratio, "mass")]
    few, inputs = seen.few(FEWEST), seen.inputs
    if before <= LEAST_DIFFERENCE or not cases or len(cases) * seen.work(few.s.size) > MOST_WORK:
        return ""
    model, found = inputs.model, list[tuple[float, float, int]]()
    for number, (part, factor, kind) in enumerate(cases):
        # The coupling of structure and air stays.
        own, stiff = sp.diags_array(part.astype(float)), moduli if factor > 1.0 else 1.0 / moduli
        K = model.K if kind == "mass" else sp.csc_array(model.K + (stiff - 1.0) * (own @ model.K @ own))
        M = model.M if kind == "stiffness" else sp.csc_array(model.M + (factor - 1.0) * (own @ model.M @ own))
        with suppress(LrbcError):
            found.append((*_misfit(few, replace(model, K=K, M=M)), number))
    if not found or not explains(*min(found)[:2], before, 1.5):
        return ""
    left, _, best = min(found)
    part, factor, kind = cases[best]
    what, check = _WRONG[kind]
    dofs = inputs.dofs
    where = "structure" if len(cases) == 1 else "part" if dofs is None else f"part at {extents(dofs.xyz[part])}"
    size = "small" if factor > 1.0 else "large"
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


def by_parts_text(
    seen: Seen,
    whole: Measurement,
    *,
    passes: int = 2,
    rounds: int = 2,
    least: float = 1.2,
    clear: float = 0.5,
    most: int = 6,
    exact: float = 1.0,
) -> str:
    """Warning that names the part, of those that only springs join, whose stiffness or mass is wrong by any factor; else empty.

    Rough calibrations find factors of the stiffness and of the mass of each part, and full solves confirm them.

    Parameters
    ----------
    seen : Seen
    whole : Measurement
        The same on all its lines.
    passes, rounds : int
        Number of reduced models, each of the matrices found with the one before, and of calibrations with each: a calibration reaches a
        factor of 1.35.
    least, clear : float
        Least factor of that part, and largest share of its logarithm that those of any other part may have.
    most : int
        Largest number of parts.
    exact : float
        Largest error of the reduced model at the factors found [dB].
    """
    source, before, parts = seen.source, seen.misfit, list(_parts(seen))
    settings, inputs = source.inputs.campaign.calibration, source.inputs
    free = settings is not None and settings.job == seen.job and not inputs.model.extras and source.stage is not None
    if not free or not 2 <= len(parts) <= most or before <= LEAST_DIFFERENCE or reduction_cost(inputs)[0].work > MOST_WORK:
        return ""
    assert settings is not None
    keys = [(f"stiffness {k}", f"mass {k}") for k in range(len(parts))]
    others = tuple(name for name in settings.names if name not in ("stiffness.structure", "mass.structure"))
    names = (*others, *chain(*keys))
    try:
        found, begun = _begun(source, seen, keys, parts)
        factors = dict.fromkeys(names, 1.0) | begun
        for _ in range(passes):
            found, further = calibrated_by_rounds(_with_parts(found, keys, parts), whole, names, rounds)
            factors = {name: value * further[name] for name, value in factors.items()}
        after = Seen.of(found, seen.job, whole)
        few = after.few(FEWEST)
        full = ported(few, found.inputs.model).evaluate(few.dynamic)
    except LrbcError:
        return ""
    logs = np.log([[factors[name] for name in own] for own in keys])
    sizes = np.linalg.norm(logs, axis=1)
    worst = int(np.argmax(sizes))
    second = float(np.delete(sizes, worst).max())
    # The basis is that of the model before the last calibrations.
    errs = float(np.median(apart(full, few.model))) > exact
    if errs or after.misfit > min(EXPLAINED, CLEARLY * before) or max(np.log(least), second / clear) > sizes[worst]:
        return ""
    return _part_text(seen, parts[worst], worst, logs[worst], after.misfit)


def _part_text(seen: Seen, part: Bools, number: int, logs: Floats, left: float) -> str:
    """Warning about one part, with the logarithms of the factors of its stiffness and mass, and the misfit left [dB]."""
    dofs, (stiffness, mass) = seen.inputs.dofs, logs.tolist()
    where = f"part {number + 1}" if dofs is None else f"part at {extents(dofs.xyz[part])}"
    return (
        f"with the stiffness of the {where} times {np.exp(stiffness):.2g}, and its mass times {np.exp(mass):.2g}, a rough calibration "
        f"leaves a level misfit of {left:.1f} dB, of {seen.misfit:.1f} dB (mean level of each response removed). "
        f"{_cause(stiffness, mass)}. Correct it in the FE model, and export it again"
    )


def _begun(
    source: Looking,
    seen: Seen,
    keys: Sequence[tuple[str, str]],
    parts: Sequence[Bools],
    *,
    sizes: tuple[float, ...] = (0.7, 0.83, 1.2, 1.4),
    lines: int = 60,
) -> tuple[Looking, dict[str, float]]:
    """The model, as it is or with stiffness and mass of one part multiplied, that is nearest to the measurement, and these factors.

    A calibration finds the nearest valley only, and resonances that cross others lead into another one. ``sizes`` are the factors tried on
    a thickness, on about ``lines`` lines.
    """
    whole, few = _with_parts(source, keys, parts), seen.few(lines)
    assert whole.stage is not None
    affine = affine_model(whole.inputs, whole.stage)
    found = list[tuple[float, int, Looking, dict[str, float]]]()
    # Another thickness, another modulus, another density.
    ways = [way for size in sizes for way in ((size**3, size), (size**3, 1.0), (1.0, size**2))]
    for factors in [{}, *(dict(zip(own, way, strict=True)) for own in keys for way in ways)]:
        one = multiplied(whole, affine, factors)
        values = one.model(few.s, few.parameters).frf(few.parameters.initial)
        found.append((float(np.median(apart(few.measured, values))), len(found), one, factors))
    return min(found)[2:]


def _cause(stiffness: float, mass: float) -> str:
    """The likeliest mistake that multiplies stiffness and mass of a part by the exponentials of these numbers."""

    def wrong(size: float) -> str:
        return f"{np.exp(-size):.2g} times too large" if size < 0.0 else f"{np.exp(size):.2g} times too small"

    # Distances from what each mistake leaves, and its size. A thickness stiffens plates by its third power.
    thin, both = (3.0 * stiffness + mass) / 10.0, (stiffness + mass) / 2.0
    lacking = "missing in the model" if mass > 0.0 else "not on the structure"
    ways = [
        (abs(stiffness - 3.0 * mass) / 10.0**0.5, f"The thickness of its plates, or the height of its beams, is probably {wrong(thin)}"),
        (abs(stiffness - mass) / 2.0**0.5, f"Its modulus and density are probably both {wrong(both)} (aluminium for steel: 2.9)"),
        (abs(mass), f"Its modulus is probably {wrong(stiffness)}"),
        (abs(stiffness), f"Its density is probably {wrong(mass)}, or a mass on it is {lacking}"),
    ]
    return min(ways)[1]


def _with_parts(source: Looking, keys: Sequence[tuple[str, str]], parts: Sequence[Bools]) -> Looking:
    """The model with a factor of the stiffness, and one of the mass, of each part, named by ``keys``."""
    inputs, model = source.inputs, source.inputs.model
    groups = dict[str, dict[str, sp.csc_array]]()
    for (stiffness, mass), part in zip(keys, parts, strict=True):
        # The coupling of structure and air stays.
        own = sp.diags_array(part.astype(float))
        groups |= {stiffness: {"stiffness": sp.csc_array(own @ model.K @ own)}, mass: {"mass": sp.csc_array(own @ model.M @ own)}}
    model = replace(model, extras=groups)
    inputs = replace(inputs, model=model, recipe=recipe_of(inputs.campaign, model))
    assert source.stage is not None
    return Looking(inputs=inputs, stage=replace(source.stage, reduction=coarsely_reduced(inputs)), kind="port")


def _misfit(seen: Seen, model: FeModel) -> tuple[float, float]:
    """See ``left_of``, for another model."""
    return left_of(seen, ported(seen, model).evaluate(seen.dynamic))


def _parts(seen: Seen, *, least: float = 0.02) -> Iterator[Bools]:
    """(n,) masks of the structural parts that only terms join, each with a share of ``least`` of the DOFs; nothing if there is one."""
    model = seen.inputs.model
    structural = ~model.is_acoustic
    # Air joins parts, too; without it, each of its DOFs is a part of its own.
    own = sp.diags_array(structural.astype(float))
    alone = {name: sp.csc_array(own @ getattr(model, name) @ own) for name in ("K", "C", "M")}
    labels = parts_of(replace(model, **alone), joined=False)
    large = np.flatnonzero(np.bincount(labels[structural], minlength=1) >= max(least * structural.sum(), 1.0))
    if large.size > 1:
        yield from (labels == label for label in large)
