"""Tests whether the structure has what the model lacks: a motor or a foot that was left out of the export, or a heavy sensor."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse as sp

from lrbc_cli.arrays import Floats, Integers
from lrbc_cli.campaign.identification.compared.likeness import CLEARLY, apart
from lrbc_cli.campaign.identification.compared.sensors import sensors_of
from lrbc_cli.campaign.identification.records import Measurement
from lrbc_cli.campaign.looking.fitted import calibrated_by_rounds
from lrbc_cli.campaign.looking.states import Looking, Seen, coarsely_reduced
from lrbc_cli.campaign.looking.trials import (
    EXPLAINED,
    FEWEST,
    LINES,
    NEAR,
    NEARER,
    UNLIKE,
    Cause,
    affordable,
    at_values,
    gradually,
    picking,
    with_ports,
)
from lrbc_cli.campaign.reading.factors import recipe_of
from lrbc_cli.campaign.reading.inputs import Inputs
from lrbc_cli.campaign.structure import thinned
from lrbc_cli.errors import LrbcError, listing
from lrbc_cli.model.dofs import COMPONENTS
from lrbc_cli.model.selection import spacing
from lrbc_cli.reduction.problem.full import full_frfs
from lrbc_cli.reduction.reduced.many import ports_of


@dataclass(frozen=True, kw_only=True)
class _Added:
    """A mass [kg], or a support [N/m] in each direction, and the nodes that have equal shares of it.

    Attributes
    ----------
    matrix : str
        ``mass`` or ``stiffness``.
    size : float
    nodes : tuple of int
    at : int array
        DOFs there.
    place : str
        In words.
    left : float
        Level misfit with it [dB].
    """

    matrix: str
    size: float
    nodes: tuple[int, ...]
    at: Integers
    place: str
    left: float

    @property
    def where(self) -> str:
        """Nodes and place in words."""
        return f"node{'s' if len(self.nodes) > 1 else ''} {', '.join(map(str, self.nodes))} at {self.place}"


def added_text(seen: Seen, before: float) -> str:
    """Warning that names the node where with a further mass the model explains the tight state; empty if there is none.

    Parameters
    ----------
    seen : Seen
    before : float
        Level misfit of the model, constants removed, median over the responses [dB].
    """
    found = None if before <= UNLIKE else _nearest(seen, before)
    return "" if found is None else _text(seen.inputs, found, before)


def left_on_text(seen: Seen, before: float) -> str:
    """Clause on a job that a further mass explains, with all bolts tight; empty if there is none.

    Parameters
    ----------
    seen : Seen
        A job that no state of the bolts explains.
    before : float
        Level misfit that a fit of the bolts leaves [dB].
    """
    found = _nearest(seen, before)
    if found is None or found.left > min(EXPLAINED, CLEARLY * before, NEARER * seen.misfit):
        return ""
    return (
        f"With about {found.size:.2g} kg more near {found.where} the level misfit is {found.left:.1f} dB, with all bolts tight: something "
        "was probably left on the structure, such as a tool, a stand or a further sensor. Remove it, and measure this job again"
    )


def missing_cause(seen: Seen, whole: Measurement, calibrated: float, *, least: float, passes: int = 2, rounds: int = 2) -> Cause:
    """As ``added_text``, also for a support, and for a model that a rough calibration brings near: either is calibrated beside the factors.

    Joints and factors make up for a part of it, so it is looked for without a calibration, and counts only if one with it leaves less
    than half of the misfit of one without.

    Parameters
    ----------
    seen : Seen
        The reference job, with the model as it is.
    whole : Measurement
        The same on all its lines.
    calibrated : float
        Level misfit after a rough calibration [dB].
    least : float
        From which one is looked for [dB].
    passes, rounds : int
        Number of reduced models, each with the size found before, and of calibrations with each: one reaches a factor of 1.35.
    """
    source, settings, name = seen.source, seen.inputs.campaign.calibration, "added there"
    free = settings is not None and settings.job == seen.job and not seen.inputs.model.extras and source.stage is not None
    found = _nearest(seen.few(FEWEST), seen.misfit, supports=True) if free and calibrated > least else None
    if found is None or settings is None:
        return Cause()
    plain, lump, size, left = seen.inputs.model, picking(found.at, seen.inputs.model.size), found.size, np.inf
    with suppress(LrbcError):
        for _ in range(passes):
            own = sp.csc_array(size / len(found.nodes) * (lump.T @ lump))
            changed = {"M": sp.csc_array(plain.M + own)} if found.matrix == "mass" else {"K": sp.csc_array(plain.K + own)}
            model = replace(plain, **changed, extras={name: {found.matrix: own}})
            inputs = replace(seen.inputs, model=model, recipe=recipe_of(seen.inputs.campaign, model))
            assert source.stage is not None
            beside = Looking(inputs=inputs, stage=replace(source.stage, reduction=coarsely_reduced(inputs)), kind="port")
            after, factors = calibrated_by_rounds(beside, whole, (*settings.names, name), rounds)
            size *= factors[name]
            left = Seen.of_model(after, seen.job, whole).misfit
    if left > min(EXPLAINED, CLEARLY * calibrated):
        return Cause()
    return Cause(_text(seen.inputs, replace(found, size=size, left=left), calibrated, with_calibration=True), left)


def _text(inputs: Inputs, found: _Added, before: float, *, with_calibration: bool = False) -> str:
    sizes = f"the level misfit falls from {before:.1f} to {found.left:.1f} dB"
    if with_calibration:
        sizes = f"a rough calibration leaves {found.left:.1f} dB, without it {before:.1f} dB"
    removed = "(mean level of each response removed)"
    much = ""
    if found.left > EXPLAINED:
        much = ". Of the causes that were tried this one leaves least, but much: check material and thickness of each part as well"
    sensors = _sensors_at(inputs, found) if found.matrix == "mass" else []
    if sensors:
        return (
            f"with about {found.size:.2g} kg more near {found.where} {sizes} {removed}: {listing(sensors, 3)} was measured there, so this "
            "is probably the mass of the sensor, with its magnet and cable, or of a part beside it. Add it in the FE model and export it "
            f"again, or use a lighter sensor{much}"
        )
    if found.matrix == "mass":
        return (
            f"with about {found.size:.2g} kg more near {found.where} {sizes} {removed}: probably a part that was on the test bench is "
            "missing in the model, such as a motor or a fixture. Compare the mass sum with the weight of the structure; add the part in "
            f"the FE model and export it again, or measure without it{much}"
        )
    return (
        f"with a support of about {found.size:.2g} N/m to the ground in each direction near {found.where} {sizes} {removed}: probably a "
        "foot or a support that was on the test bench is missing in the model. Add it in the FE model and export it again, or measure "
        f"without it{much}"
    )


def _sensors_at(inputs: Inputs, found: _Added) -> list[str]:
    """Names of the sensors, no microphones, at the place of ``found`` or at a neighbouring node."""
    dofs, names = inputs.dofs, list[str]()
    if dofs is None:
        return names
    place, pitch = dofs.xyz[found.at].mean(axis=0), spacing(dofs, int(found.at[0]))
    for own in sensors_of(inputs):
        response = inputs.responses[own[0]]
        there = dofs.xyz[dofs.node == response.node][:1]
        if response.quantity != "pressure" and there.size and np.linalg.norm(there - place) <= pitch:
            names.append(response.name)
    return names


def _nearest(
    seen: Seen,
    before: float,
    *,
    supports: bool = False,
    most: int = 60,
    shares: tuple[float, ...] = (0.03, 0.06, 0.1, 0.2, 0.4),
    most_ports: int = 600,
    rough: float = 1.3,
) -> _Added | None:
    """The mass or support with which the model is nearest to a measurement; None if it remains far from it.

    Parameters
    ----------
    seen : Seen
    before : float
        Level misfit of the model [dB].
    supports : bool
        Whether supports are tried, too: on few lines another stiffness of the whole may look like one.
    most : int
        Largest number of nodes that are tried, spread over the structure.
    shares : tuple of float
        Shares of the mass of the model that are tried at each. Supports are tried as stiff as a tenth to ten times of these are
        inert in the middle of the band.
    most_ports : int
        Largest number of translations of these nodes and of terms: 0.2 GB of FRFs between them.
    rough : float
        Factor of the limit up to which nodes next to the nearest one are tried, too.
    """
    dofs, model = seen.inputs.dofs, seen.inputs.model
    # Each node has three loads of its own, beside those of the terms.
    ports = 3 * most + model.terms.size
    times = 1.0 + 3.0 * most / (1.0 + model.terms.size)
    if dofs is None or not affordable(seen, times) or ports > most_ports:
        return None
    moving = np.isin(dofs.component, COMPONENTS[:3]) & ~model.is_acoustic
    nodes, first = np.unique(dofs.node[moving], return_index=True)
    if not nodes.size:
        return None
    xyz, limit = dofs.xyz[moving][first], min(UNLIKE, NEARER * before)
    whole = max(float(model.M[at][:, at].sum().real) for at in _along(seen))
    masses = [share * whole for share in shares]
    stiff = [power * each * float(np.abs(seen.s[0] * seen.s[-1])) for power in (0.1, 1.0, 10.0) for each in masses]
    found, spread = None, thinned(xyz, most)[1]
    for few, wider in gradually(seen):
        feet = _feet(xyz[spread])
        # A foot stands on one node.
        ways = [("mass", foot, masses) for foot in feet] + [("stiffness", foot, stiff) for foot in feet if supports and len(foot) == 1]
        found = _best(few, nodes[spread], xyz[spread], ways)
        if found is None or found.left > wider * rough * limit:
            return None
    assert found is not None
    if not affordable(seen, 2.0 * times):
        return found if found.left <= limit else None
    # It may stand between the nodes that were tried.
    about = np.argsort(np.linalg.norm(xyz - xyz[np.isin(nodes, found.nodes)].mean(axis=0), axis=1), kind="stable")[:most]
    sizes = [found.size * step for step in np.geomspace(1.0 / 3.0, 3.0, 5)]
    closer = _best(seen.few(LINES), nodes[about], xyz[about], [(found.matrix, (k,), sizes) for k in range(about.size)])
    found = closer if closer is not None and closer.left < found.left else found
    return found if found.left <= limit else None


def _best(seen: Seen, nodes: Integers, xyz: Floats, ways: Sequence[tuple[str, tuple[int, ...], Sequence[float]]]) -> _Added | None:
    """The best of some ways, each with the sizes that are tried, then with the best size at it; None if a model cannot be solved.

    Parameters
    ----------
    seen : Seen
    nodes, xyz : (n,) int and (n, 3) float array
        Numbers and places of the nodes that are tried.
    ways : sequence of (str, tuple of int, sequence of float)
        Matrix, indices of the nodes that have equal shares, and sizes.
    """
    dofs, units = seen.inputs.dofs, seen.inputs.campaign.unit_system
    assert dofs is not None
    moving = np.isin(dofs.component, COMPONENTS[:3]) & ~seen.inputs.model.is_acoustic
    places = [np.flatnonzero(moving & (dofs.node == node)) for node in nodes]
    with suppress(LrbcError):
        misfits = _misfits(seen, places)
        matrix, foot, sizes = min(ways, key=lambda way: min(misfits(way[0], way[1], each) for each in way[2]))
        # Resonances allow less than the factor of two to three between those.
        size = float(min(np.geomspace(sizes[0], sizes[-1], 25), key=lambda each: misfits(matrix, foot, each)))
        place = f"({', '.join(f'{value:.4g}' for value in xyz[list(foot)].mean(axis=0) / units.length)}) {units.length_name}"
        own, at = tuple(int(nodes[k]) for k in foot), np.concatenate([places[k] for k in foot])
        return _Added(matrix=matrix, size=size, nodes=own, at=at, place=place, left=misfits(matrix, foot, size))
    return None


def _feet(xyz: Floats, *, beside: int = 6) -> list[tuple[int, ...]]:
    """Sets of places (n, 3) on which a mass may stand: each alone, it and one of those ``beside`` it, and the four about their middle."""
    count = len(xyz)
    near = np.argsort(np.linalg.norm(xyz[:, None] - xyz, axis=2), axis=1, kind="stable")[:, : beside + 1]
    pairs = sorted({(min(k, other), max(k, other)) for k, own in enumerate(near.tolist()) for other in own if other != k})
    about = [np.argsort(np.linalg.norm(xyz - xyz[[a, b]].mean(axis=0), axis=1), kind="stable")[:4] for a, b in pairs if count > 3]
    fours = sorted({tuple(sorted(own.tolist())) for own in about})
    return [*((k,) for k in range(count)), *pairs, *fours]


def loaded_text(seen: Seen, *, least: float = 0.005, most: float = 0.5, steps: int = 13, falls: float = 0.15, others: float = 0.33) -> str:
    """Warning that names the sensor with whose mass the model explains the tight state; empty if there is none.

    A light structure carries each sensor as a mass that the model lacks. Only its inertia along the measured direction is tried.

    Parameters
    ----------
    seen : Seen
        The reference job, with the model as it is or roughly calibrated.
    least, most : float
        Masses tried [kg].
    steps : int
        Number of them, a factor of 1.5 apart.
    falls : float
        Least share by which the misfit must fall, to ``NEAR`` at most. A calibration has taken up a part of it.
    others : float
        Largest share of this fall that a mass at another sensor may reach.
    """
    before, stage, L = seen.misfit, seen.source.stage, seen.inputs.model.L.tocsr()
    single = np.flatnonzero((np.diff(L.indptr) == 1) & (np.array(seen.quantities) == "acceleration"))
    _, first = np.unique(L.indices[L.indptr[single]], return_index=True)
    sensors = single[first]
    if stage is None or not sensors.size:
        return ""
    reduced, terms = stage.reduction.model, seen.inputs.model.terms.size
    # The mass of a sensor is one more term, zero in the state compared.
    ends = (reduced.L[sensors] / L.data[L.indptr[sensors]][:, None]).T
    beside = replace(
        reduced,
        left=np.hstack([reduced.left, ends]),
        right=np.hstack([reduced.right, ends]),
        reference=np.vstack([reduced.reference, np.zeros((sensors.size, 3))]),
    )
    D = np.hstack([seen.dynamic, np.zeros((seen.s.size, sensors.size))])
    ports, masses = ports_of(beside, seen.s).about(D), np.geomspace(least, most, steps)
    found = list[tuple[float, float, int]]()
    for k, sensor in enumerate(sensors.tolist()):
        with_mass = np.tile(D, (steps, 1, 1))
        with_mass[:, :, terms + k] = masses[:, None] * seen.s**2
        away = np.median(apart(seen.measured, ports.evaluate(with_mass)), axis=1)
        found += [(float(own), float(mass), sensor) for own, mass in zip(away, masses, strict=True)]
    left, mass, sensor = min(found)
    fall, rest = before - left, before - min((one for one, _, other in found if other != sensor), default=before)
    if left > NEAR or fall < falls * before or rest > others * fall or not least < mass < most:
        return ""
    name, grams = seen.inputs.responses[sensor].name, float(f"{1e3 * mass:.2g}")
    return (
        f"with about {grams:g} g more at the sensor of {name} the level misfit falls from {before:.1f} to {left:.1f} dB (mean level of "
        "each response removed), and with a mass at any other sensor it does not: the structure probably carries a heavy sensor, its block "
        "or its cable, which the model lacks. Add its mass in the FE model and export it again, or measure with a lighter sensor"
    )


def _along(seen: Seen) -> list[Integers]:
    """DOFs of each translation that the model has."""
    dofs = seen.inputs.dofs
    assert dofs is not None
    every = (np.flatnonzero(dofs.component == component) for component in COMPONENTS[:3])
    return [at for at in every if at.size]


def _misfits(seen: Seen, places: Sequence[Integers]) -> Callable[[str, Sequence[int], float], float]:
    """Level misfit [dB] with a mass or a support in all translations of places, by the matrix, their numbers, and its size on all of them.

    One full solve a line for all of them.
    """
    inputs, settings = seen.inputs, seen.inputs.campaign.reduction
    model = inputs.model
    H, D_ref = full_frfs(with_ports(model, np.concatenate(places)), seen.s, settings.band, backend=settings.backend, refine=0)
    # The terms at their start values.
    G, loads, outputs = at_values(H, seen.dynamic - D_ref), model.B.shape[1], model.L.shape[0]
    quantity, each = seen.s[:, None] ** model.output_power, np.arange(outputs)
    begin = np.cumsum([0, *(place.size for place in places)])

    def misfit(matrix: str, feet: Sequence[int], size: float) -> float:
        own = np.concatenate([np.arange(begin[k], begin[k + 1]) for k in feet])
        driven = G[:, outputs + own][:, :, :loads]
        flexible = (
            np.eye(own.size) / (size / len(feet) * seen.s[:, None, None] ** (2 if matrix == "mass" else 0))
            + G[:, outputs + own][:, :, loads + own]
        )
        # Inertia or support at each place, for each of its translations.
        force = np.linalg.solve(flexible, driven)[:, :, inputs.input_of]
        values = G[:, each, inputs.input_of] - np.einsum("frc,fcr->fr", G[:, :outputs][:, :, loads + own], force)
        return float(np.median(apart(seen.measured, values * quantity)))

    return misfit
