"""Likely mistakes in material data: the unit that explains a wrong factor on a matrix, and a missing density."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np
from scipy.sparse.csgraph import connected_components

from lrbc_cli.errors import listing
from lrbc_cli.model.dofs import COMPONENTS, DofTable
from lrbc_cli.model.fem import FeModel
from lrbc_cli.model.units import UnitSystem

#: Usual units of densities, masses, moduli and stiffnesses, in SI [kg/m³, kg, Pa, N/m].
DENSITIES = {
    "kg/m³": 1.0,
    "g/cm³ or t/m³": 1e3,
    "kg/cm³": 1e6,
    "kg/mm³": 1e9,
    "t/mm³": 1e12,
    "lbm/in³": 27679.905,
    "lbf s²/in⁴": 1.0686896e7,
}
MASSES = {"kg": 1.0, "g": 1e-3, "t": 1e3, "lbm": 0.45359237, "lbf s²/in": 175.126836}
MODULI = {"Pa": 1.0, "MPa": 1e6, "GPa": 1e9, "psi": 6894.7573}
STIFFNESSES = {"N/m": 1.0, "N/mm": 1e3}

#: Density and modulus of steel [kg/m³, Pa], as familiar examples.
STEEL = {"mass": 7850.0, "stiffness": 2.1e11}


def material_cause(unit: UnitSystem, matrix: str, factor: float) -> str | None:
    """Text on the unit in which material data were probably given, and the unit required, with the value of steel.

    Parameters
    ----------
    unit : UnitSystem
        Stated by the campaign.
    matrix : str
        ``stiffness``, ``mass`` or ``damping``.
    factor : float
        Factor by which the matrix is too large.

    Returns
    -------
    str or None
        None for damping.
    """
    if matrix == "mass":
        what, known, own = "density", DENSITIES, unit.mass / unit.length**3
        whole, pieces, piece = "masses", MASSES, unit.mass
    elif matrix == "stiffness":
        what, known, own = "modulus", MODULI, unit.force / unit.length**2
        whole, pieces, piece = "springs", STIFFNESSES, unit.force / unit.length
    else:
        return None
    # A value that is too large by a factor was given in a unit smaller by that factor.
    wanted = _name(known, own) or f"{own:.4g} {next(iter(known))}"
    stated, steel = unit.text if unit.text == "SI" else f"`units: {unit.text}`", f"{STEEL[matrix] / own:.4g} for steel"
    first, second = _name(known, own / factor), _name(pieces, piece / factor)
    if first is None and second is None:
        return f"{what}: {stated} requires {wanted}, {steel}"
    other = f"{whole} in {second}, but {'it' if first else stated} requires {_name(pieces, piece) or f'{piece:.4g} {next(iter(pieces))}'}"
    if first is None:
        return f"{other}; it requires the {what} in {wanted}, {steel}"
    return f"{what} in {first}, but {stated} requires {wanted}, {steel}" + (f"; or {other}" if second else "")


def _name(known: Mapping[str, float], size: float) -> str | None:
    return next((name for name, own in known.items() if np.isclose(size, own, rtol=1e-3, atol=0.0)), None)


def too_heavy(
    model: FeModel, dofs: DofTable | None, unit: UnitSystem, *, flat: bool = True, most: float = 2.26e4, thin: float = 0.05
) -> Iterator[str]:
    """Warning if the mass sum exceeds that of the smallest box about the structure, were it full of the densest material.

    Parameters
    ----------
    model : FeModel
    dofs : DofTable or None
    unit : UnitSystem
        Stated by the campaign.
    flat : bool
        Whether flat structures are asked for, too: of these the FRFs may tell more, such as the factor.
    most : float
        Density of osmium [kg/m³].
    thin : float
        Least ratio of the shortest to the longest side of the box: shells extend beyond their nodes by half a thickness. Of beams along a
        line nothing is told.
    """
    if dofs is None:
        return
    moves = np.isin(dofs.component, COMPONENTS[:3]) & ~dofs.is_acoustic
    sides = np.ptp(dofs.xyz[moves], axis=0) if moves.any() else np.zeros(3)
    least = thin * float(sides.max())
    thick = float(sides.min()) > least
    if not thick and not (flat and float(np.sort(sides)[1]) > least):
        return
    row = {label: np.real(model.M @ (dofs.component == label).astype(float))[dofs.component == label] for label in COMPONENTS[:3]}
    # One node may hold a large mass that only fixes a motion.
    sums = [float(own.sum() - np.abs(own).max()) for own in row.values() if own.size]
    mass = max(sums)
    # Of one component, or of unlike sums, rotations may be among them under a wrong name.
    if not thick and (len(sums) < 2 or mass > 2.0 * min(sums)):
        return
    sides = np.maximum(sides, least)
    density = mass / float(np.prod(sides))
    if density > most:
        box = " x ".join(f"{side / unit.length:.4g}" for side in sides)
        required = unit.mass / unit.length**3
        yield (
            f"model.mass: the masses add up to {mass:.3g} kg in a box of {box} {unit.length_name}: {density:.2g} kg/m³ on average, more "
            f"than any material. Check the unit of the density: {unit.text if unit.text == 'SI' else f'`units: {unit.text}`'} requires "
            f"{_name(DENSITIES, required) or f'{required:.4g} kg/m³'}, {STEEL['mass'] / required:.4g} for steel; and that of coordinates "
            "and masses. Correct it in the FE model, and export the mass matrix again, or write model.mass: {file: ..., scale: ...}"
        )


def massless_part(model: FeModel, dofs: DofTable | None, *, least: float = 0.1) -> Iterator[str]:
    """Warning if parts without mass have at least the share ``least`` of the nodes.

    Of a part, at least one node is surrounded by others without mass: rigid links and springs have massless nodes too, but single ones.
    """
    if dofs is None:
        return
    moves = np.isin(dofs.component, COMPONENTS[:3])
    nodes = np.unique(dofs.node[moves])
    bare = np.setdiff1d(nodes, dofs.node[moves & (abs(model.M).sum(axis=0) > 0.0)])
    light = np.isin(dofs.node, bare)
    own, joined = np.flatnonzero(light), abs(model.K.tocsr()[light])
    beside = np.unique(dofs.node[own[joined @ np.where(light, 0.0, 1.0) > 0.0]])
    _, part = connected_components(joined[:, own], directed=False)
    bare = np.unique(dofs.node[own[np.isin(part, part[~np.isin(dofs.node[own], beside)])]])
    if bare.size and bare.size >= least * nodes.size:
        yield (
            f"model.mass: {bare.size} of {nodes.size} nodes have no mass in any direction ({listing([str(node) for node in bare], 4)}): "
            "check whether the density of a part is missing. Give it in the FE model, and export the mass matrix again"
        )
