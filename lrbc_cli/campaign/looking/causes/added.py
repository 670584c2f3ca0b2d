"""Tests whether the structure has what the model lacks: a motor or a foot that was left out of the export, or a heavy sensor."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace

import numpy as np
import scipy.sparse as sp

from lrbc_cli.arrays import Complexes, Floats, Integers
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

#: Name of the factor of what is added to a model.
EXTRA = "added there"


@dataclass(frozen=True, kw_only=True)
class Added:
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
    of : array or None
        Stiffness of the supports that the model has at these DOFs, of which ``size`` times as much is added; None: equal shares.
    """

    matrix: str
    size: float
    nodes: tuple[int, ...]
    at: Integers
    place: str
    left: float
    of: Floats | Complexes | None = None

    @property
    def where(self) -> str:
        """Nodes and place in words."""
        return f"node{'s' if len(self.nodes) > 1 else ''} {', '.join(map(str, self.nodes))} at {self.place}"


@dataclass(frozen=True, kw_only=True)
class Tried:
    """Nodes of the structure at which something may be added.

    Attributes
    ----------
    nodes, xyz : (n,) int and (n, 3) float array
        Numbers and places.
    spread : (k,) int array
        Indices of some, spread over the structure.
    mass : float
        Mass of the model along the direction in which it has most [kg].
    """

    nodes: Integers
    xyz: Floats
    spread: Integers
    mass: float

    @classmethod
    def of(cls, seen: Seen, most: int) -> Tried | None:
        """``most`` nodes spread over the structure; None without a DOF table, or if it has no translations."""
        dofs, model = seen.inputs.dofs, seen.inputs.model
        if dofs is None:
            return None
        moving = np.isin(dofs.component, COMPONENTS[:3]) & ~model.is_acoustic
        nodes, first = np.unique(dofs.node[moving], return_index=True)
        if not nodes.size:
            return None
        xyz, along = dofs.xyz[moving][first], (np.flatnonzero(dofs.component == component) for component in COMPONENTS[:3])
        mass = max(float(model.M[at][:, at].sum().real) for at in along if at.size)
        return cls(nodes=nodes, xyz=xyz, spread=thinned(xyz, most)[1], mass=mass)

    def about(self, place: Floats, most: int) -> Integers:
        """Indices of the ``most`` nodes nearest to a place (3,)."""
        return np.argsort(np.linalg.norm(self.xyz - place, axis=1), kind="stable")[:most]


@dataclass(frozen=True, kw_only=True)
class Solved:
    """FRFs of the model between its loads, outputs, terms and some places, by one full solve a line.

    Attributes
    ----------
    seen : Seen
        The job, on the lines solved.
    begin : (n + 1,) int array
        First DOF of each place.
    share : (N,) array
        Of what is added to a place, by DOF.
    H : (F, R + N + m, E + N + m) complex array
        N: DOFs of all places; terms at the start values.
    """

    seen: Seen
    begin: Integers
    share: Floats | Complexes
    H: Complexes = field(repr=False)

    @classmethod
    def of(cls, seen: Seen, places: Sequence[Integers], share: Floats | Complexes | None = None) -> Solved:
        """By the DOFs of each place; ``share``: None for equal shares.

        Raises
        ------
        LrbcError
        """
        model, settings = seen.inputs.model, seen.inputs.campaign.reduction
        H, D_ref = full_frfs(with_ports(model, np.concatenate(places)), seen.s, settings.band, backend=settings.backend, refine=0)
        begin = np.cumsum([0, *(place.size for place in places)])
        share = np.ones(begin[-1]) if share is None else share
        return cls(seen=seen, begin=begin, share=share, H=at_values(H, seen.dynamic - D_ref, terms=True))

    def misfits(self, theta: Floats | None = None) -> Callable[[str, Sequence[int], float], float]:
        """Level misfit [dB] with a mass or a support in all translations of places, in state ``theta``, if given.

        It is asked by the matrix, the indices of the places, and its size on all of them.
        """
        seen, model, input_of = self.seen, self.seen.inputs.model, self.seen.inputs.input_of
        D = seen.dynamic if theta is None else seen.parameters.dynamic(theta, seen.s)
        G, loads, outputs = at_values(self.H, D - seen.dynamic), model.B.shape[1], model.L.shape[0]
        quantity, each = seen.s[:, None] ** model.output_power, np.arange(outputs)

        def misfit(matrix: str, feet: Sequence[int], size: float) -> float:
            own = np.concatenate([np.arange(self.begin[k], self.begin[k + 1]) for k in feet])
            driven = G[:, outputs + own][:, :, :loads]
            # Inertia or support at each place, for each of its DOFs.
            dynamic = size / len(feet) * self.share[own] * seen.s[:, None, None] ** (2 if matrix == "mass" else 0)
            flexible = np.eye(own.size) / dynamic + G[:, outputs + own][:, :, loads + own]
            force = np.linalg.solve(flexible, driven)[:, :, input_of]
            values = G[:, each, input_of] - np.einsum("frc,fcr->fr", G[:, :outputs][:, :, loads + own], force)
            return float(np.median(apart(seen.measured, values * quantity)))

        return misfit


def added_text(seen: Seen, before: float) -> str:
    """Warning that names the node where with a further mass the model explains the tight state; empty if there is none.

    Parameters
    ----------
    seen : Seen
    before : float
        Level misfit of the model, constants removed, median over the responses [dB].
    """
    found = None if before <= UNLIKE else nearest_added(seen, before)
    return "" if found is None else _text(seen.inputs, found, before)


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
    settings = seen.inputs.campaign.calibration
    free = settings is not None and settings.job == seen.job and not seen.inputs.model.extras and seen.source.stage is not None
    found = nearest_added(seen.few(FEWEST), seen.misfit, supports=True) if free and calibrated > least else None
    if found is None or settings is None:
        return Cause()
    size, left = found.size, np.inf
    with suppress(LrbcError):
        for _ in range(passes):
            beside = with_added(seen, replace(found, size=size))
            after, factors = calibrated_by_rounds(beside, whole, (*settings.names, EXTRA), rounds)
            size *= factors[EXTRA]
            left = Seen.of_model(after, seen.job, whole).misfit
    if left > min(EXPLAINED, CLEARLY * calibrated):
        return Cause()
    return Cause(_text(seen.inputs, replace(found, size=size, left=left), calibrated, with_calibration=True), left)


def with_added(seen: Seen, found: Added) -> Looking:
    """FRFs of the model with a mass or a support, whose factor is ``EXTRA``, from a coarse reduced model of its own.

    Raises
    ------
    LrbcError
    """
    plain, lump, stage = seen.inputs.model, picking(found.at, seen.inputs.model.size), seen.source.stage
    assert stage is not None
    share = np.full(found.at.size, 1.0 / len(found.nodes)) if found.of is None else found.of
    own = sp.csc_array(found.size * (lump.T @ sp.diags_array(share) @ lump))
    changed = {"M": sp.csc_array(plain.M + own)} if found.matrix == "mass" else {"K": sp.csc_array(plain.K + own)}
    model = replace(plain, **changed, extras={EXTRA: {found.matrix: own}})
    inputs = replace(seen.inputs, model=model, recipe=recipe_of(seen.inputs.campaign, model))
    return Looking(inputs=inputs, stage=replace(stage, reduction=coarsely_reduced(inputs)), kind="port")


def _text(inputs: Inputs, found: Added, before: float, *, with_calibration: bool = False, heaviest: float = 0.5) -> str:
    """Warning about what was found; ``heaviest``: largest mass of a sensor with its magnet and cable [kg]."""
    sizes = f"the level misfit falls from {before:.1f} to {found.left:.1f} dB"
    if with_calibration:
        sizes = f"a rough calibration leaves {found.left:.1f} dB, without it {before:.1f} dB"
    removed = "(mean level of each response removed)"
    much = ""
    if found.left > EXPLAINED:
        much = ". Of the causes that were tried this one leaves least, but much: check material and thickness of each part as well"
    sensors = _sensors_at(inputs, found) if found.matrix == "mass" and found.size <= heaviest else []
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


def _sensors_at(inputs: Inputs, found: Added) -> list[str]:
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


def nearest_added(
    seen: Seen,
    before: float,
    *,
    supports: bool = False,
    most: int = 60,
    shares: tuple[float, ...] = (0.03, 0.06, 0.1, 0.2, 0.4),
    most_ports: int = 600,
    rough: float = 1.3,
) -> Added | None:
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
    # Each node has three loads of its own, beside those of the terms.
    count, limit = seen.inputs.model.terms.size, min(UNLIKE, NEARER * before)
    times = 1.0 + 3.0 * most / (1.0 + count)
    tried = Tried.of(seen, most) if affordable(seen, times) and 3 * most + count <= most_ports else None
    if tried is None:
        return None
    masses = [share * tried.mass for share in shares]
    stiff = [power * each * float(np.abs(seen.s[0] * seen.s[-1])) for power in (0.1, 1.0, 10.0) for each in masses]
    found = None
    for few, wider in gradually(seen):
        feet = _feet(tried.xyz[tried.spread])
        # A foot stands on one node.
        ways = [("mass", foot, masses) for foot in feet] + [("stiffness", foot, stiff) for foot in feet if supports and len(foot) == 1]
        found = best_added(few, tried, tried.spread, ways)
        if found is None or found.left > wider * rough * limit:
            return None
    assert found is not None
    if not affordable(seen, 2.0 * times):
        return found if found.left <= limit else None
    # It may stand between the nodes that were tried.
    about = tried.about(tried.xyz[np.isin(tried.nodes, found.nodes)].mean(axis=0), most)
    sizes = [found.size * step for step in np.geomspace(1.0 / 3.0, 3.0, 5)]
    closer = best_added(seen.few(LINES), tried, about, [(found.matrix, (k,), sizes) for k in range(about.size)])
    found = closer if closer is not None and closer.left < found.left else found
    return found if found.left <= limit else None


def best_added(
    seen: Seen, tried: Tried, some: Integers, ways: Sequence[tuple[str, tuple[int, ...], Sequence[float]]], theta: Floats | None = None
) -> Added | None:
    """The best of some ways, each with the sizes that are tried, then with the best size at it; None if a model cannot be solved.

    Parameters
    ----------
    seen : Seen
    tried : Tried
    some : (n,) int array
        Indices of the nodes that are tried.
    ways : sequence of (str, tuple of int, sequence of float)
        Matrix, places in ``some`` of the nodes that have equal shares, and sizes.
    theta : (size,) float array or None
        State of the bolts; None: the start values.
    """
    units = seen.inputs.campaign.unit_system
    with suppress(LrbcError):
        misfits = Solved.of(seen, translations(seen, tried.nodes[some])).misfits(theta)
        matrix, foot, sizes = min(ways, key=lambda way: min(misfits(way[0], way[1], each) for each in way[2]))
        # Resonances allow less than the factor of two to three between those.
        size = float(min(np.geomspace(sizes[0], sizes[-1], 25), key=lambda each: misfits(matrix, foot, each)))
        own = some[list(foot)]
        place = f"({', '.join(f'{value:.4g}' for value in tried.xyz[own].mean(axis=0) / units.length)}) {units.length_name}"
        nodes = tuple(tried.nodes[own].tolist())
        at = np.concatenate(translations(seen, tried.nodes[own]))
        return Added(matrix=matrix, size=size, nodes=nodes, at=at, place=place, left=misfits(matrix, foot, size))
    return None


def translations(seen: Seen, nodes: Integers) -> list[Integers]:
    """DOFs of the translations of each node of the structure."""
    dofs = seen.inputs.dofs
    assert dofs is not None
    moving = np.isin(dofs.component, COMPONENTS[:3]) & ~seen.inputs.model.is_acoustic
    return [np.flatnonzero(moving & (dofs.node == node)) for node in nodes.tolist()]


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
