"""Tests by rigid motions, which must cause no forces: coordinates of another model, permuted components, rounding, half structures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import permutations
from pathlib import Path

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from lrbc_cli.arrays import Bools, Floats, spaced
from lrbc_cli.campaign.reading.dof_source import FEW, LEAST_DOFS, MANY, MOST_FILLED
from lrbc_cli.campaign.reading.places import EXCHANGES
from lrbc_cli.errors import DataError
from lrbc_cli.model.dofs import ACOUSTIC_COMPONENT, COMPONENTS, DofTable

#: Entries below this share of their row are rounding errors, as rotated element matrices leave them.
ROUNDING = 1e-9


def digits_doubt(K: sp.csc_array, values: NDArray[np.number], component: NDArray[np.str_], *, most: int = 5, kinds: int = 20) -> str | None:
    """Warning if rounding to few digits leaves forces under a rigid translation; else None.

    Parameters
    ----------
    K : (n, n) csc_array
    values : (k,) array
        Entries as stored in the file.
    component : (n,) array of str
    most : int
        Largest number of digits for a warning.
    kinds : int
        Least number of different values; simple models, such as chains, have few digits without rounding.
    """
    size = np.abs(values[values != 0]).astype(float)
    digits = next((count for count in range(1, most + 1) if _has_digits(size, count)), 0)
    if not digits or np.unique(size).size < kinds or K.shape[0] < LEAST_DOFS:
        return None
    # At springs and supports forces are larger, elsewhere zero; up to half a unit of the last digit they are rounding errors.
    rounded = np.zeros(K.shape[0], dtype=bool)
    for label in COMPONENTS[:3]:
        moved = (component == label).astype(float)
        force, most_force = np.abs(K.real @ moved), np.abs(K) @ moved
        rounded |= (force > ROUNDING * most_force) & (force <= 0.5 * 10.0 ** (1 - digits) * most_force)
    if rounded.mean() <= FEW:
        return None
    return (
        f"the numbers of the stiffness matrix have {most} digits or fewer: rounding leaves forces where a rigid translation should cause "
        "none. Motions much softer than single entries are lost, and with them the lowest frequencies. Export the matrices with all digits "
        "(12 or more)"
    )


def _has_digits(size: Floats, digits: int) -> bool:
    """Whether positive numbers have at most ``digits`` significant digits."""
    scaled = size / 10.0 ** (np.floor(np.log10(size)) + 1.0 - digits)
    return size.size > 0 and bool(np.all(np.abs(scaled - np.round(scaled)) <= 1e-6))


def places_doubt(K: sp.csc_array, dofs: DofTable, table: str, labels: str = "", *, most: float = 0.1, mostly: float = 0.5) -> str | None:
    """Warning if a rigid rotation causes forces at DOFs where a translation causes none, so the coordinates are wrong; else None.

    A stretched, mirrored or exchanged axis makes the rotation a uniform strain, with forces on surfaces only. Only translational rows are
    tested, as FE programs stabilise the rotation about a shell's normal in different ways. DOFs in local axes are loaded by a translation,
    and next to DOFs of unknown kind a rotation is not defined; both are left out.

    Parameters
    ----------
    K : (n, n) csc_array
    dofs : DofTable
        Of n rows.
    table, labels : str
        Name of the file of the coordinates and, if another, the place of the components.
    most : float
        Largest share of loaded DOFs in a correct model, at springs and constraints.
    mostly : float
        Share of the DOFs of a small model that rotations about each axis load if its coordinates are in disorder.
    """
    if dofs.size < LEAST_DOFS or K.nnz > MOST_FILLED * dofs.size**2:
        return None
    strange = ~np.isin(dofs.component, (*COMPONENTS, ACOUSTIC_COMPONENT))
    rows = _resting(K, dofs.component) & np.isin(dofs.component, COMPONENTS[:3]) & (np.abs(K) @ strange.astype(float) == 0.0)
    if not rows.any():
        return None
    shares = _turned(K, dofs, dofs.xyz, rows)
    # Of a small model, springs across a gap may be loaded by rotations about two axes; those about all three load what is in disorder.
    if rows.sum() < LEAST_DOFS and (len(shares) < 3 or min(shares.values()) <= mostly):
        return None
    axis = max(shares, key=lambda name: shares[name], default="")
    if not axis or shares[axis] <= most:
        return None
    ways = {f"{name} mirrored": dofs.xyz * np.where(np.arange(3) == k, -1.0, 1.0) for k, name in enumerate("xyz")}
    ways |= {f"{axes} exchanged": dofs.xyz[:, order] for axes, order in EXCHANGES.items()}
    for k, name in enumerate("xyz"):
        ahead, behind = (k + 1) % 3, (k + 2) % 3
        for way, sign in (("", 1.0), ("-", -1.0)):
            xyz = dofs.xyz.copy()
            xyz[:, ahead], xyz[:, behind] = -sign * dofs.xyz[:, behind], sign * dofs.xyz[:, ahead]
            ways[f"all rotated by {way}90 degrees about {name}"] = xyz
    for unit, turn in (("degrees", np.pi / 180.0), ("radians", 1.0)):
        radius, angle = dofs.xyz[:, 0], turn * dofs.xyz[:, 1]
        plane = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), dofs.xyz[:, 2]])
        ways[f"x and y read as radius and angle in {unit} (cylindrical coordinates; Cartesian ones are expected)"] = plane
    fit = next((way for way, xyz in ways.items() if max(_turned(K, dofs, xyz, rows).values()) <= most), None)
    forces = f"a rigid rotation about {axis} causes forces at {shares[axis]:.0%} of the DOFs where a translation causes none"
    if fit is None and (text := _relabelled(K, dofs, labels or table, most)):
        return text
    return f"the coordinates of the nodes are probably not those of the stiffness matrix: {forces}" + (
        f"; with {fit} it does not. Correct the coordinates in {table}, or the components if these are wrong"
        if fit
        else f". Give in {table} the nodes of the model that was exported, in its axes"
    )


def components_doubt(K: sp.csc_array, dofs: DofTable, labels: str, *, most: float = 0.1) -> str | None:
    """Warning if what the table calls a translation causes forces nearly everywhere, and does not with the components permuted; else None.

    Parameters
    ----------
    K : (n, n) csc_array
    dofs : DofTable
        Of n rows.
    labels : str
        Place of the components.
    most : float
        See ``places_doubt``.
    """
    if dofs.size < LEAST_DOFS or K.nnz > MOST_FILLED * dofs.size**2:
        return None
    if all(share >= FEW for _, share in _motions(K, dofs, COMPONENTS[:3]).values()):
        return None
    return _relabelled(K, dofs, labels, most)


def _motions(K: sp.csc_array, dofs: DofTable, labels: Sequence[str], *, share: float = 1e-6) -> dict[str, tuple[Bools, float]]:
    """For each component: (n,) rows at rest when all DOFs of that name move by 1, and their share of these DOFs.

    Rotations load their own rows; other rows they load at the borders of a regular mesh only.
    """
    found, sizes = {}, np.abs(K)
    for label in labels:
        own = dofs.component == label
        force, size = np.abs(K.real @ own.astype(float)), sizes @ own.astype(float)
        rest = force <= share * size
        if size[own].any():
            found[label] = rest, float(rest[own & (size > 0.0)].mean())
    return found


def _relabelled(K: sp.csc_array, dofs: DofTable, table: str, most: float, *, some: int = 2000) -> str | None:
    """Text on the permutation of the components with which rigid motions cause no forces, of several the smallest; None without one.

    A sample of ``some`` rows suffices.
    """
    motions = _motions(K, dofs, COMPONENTS)
    names = [str(label) for label in dict.fromkeys(dofs.component.tolist()) if label in motions]
    shifts = [label for label in names if label in COMPONENTS[:3]]
    for way in sorted(permutations(names), key=lambda way: sum(map(str.__ne__, way, names)))[1:]:
        # By the table's names: the components that would be translations.
        moved = [name for name, new in zip(names, way, strict=True) if new in shifts]
        if any(motions[name][1] <= MANY for name in moved):
            continue
        rows = np.flatnonzero(np.all([motions[name][0] for name in moved], axis=0) & np.isin(dofs.component, moved))
        if rows.size < LEAST_DOFS / 10:
            continue
        anew = dict(zip(names, way, strict=True))
        other = replace(dofs, component=np.array([anew.get(label, label) for label in dofs.component.tolist()]))
        sample = np.isin(np.arange(dofs.size), rows[spaced(rows.size, some)])
        if max(_turned(K, other, dofs.xyz, sample).values(), default=1.0) > most:
            continue
        old, new = ([each for each, other in zip(one, two, strict=True) if each != other] for one, two in ((names, way), (way, names)))
        order, both = f"{', '.join(new)} in place of {', '.join(old)}", " and ".join(sorted(old))
        so, fix = (order, f"Write {order}") if len(old) > 2 else (f"{both} exchanged", f"Exchange {both}")
        return (
            f"the components in {table} are probably exchanged: rigid motions cause forces where they should cause none; with {so} they do "
            f"not. {fix} in {table}"
        )
    return None


def require_single_diagonal(K: sp.csc_array, component: NDArray[np.str_], file: Path, place: str | None) -> None:
    """Refuse a stiffness matrix whose diagonal counts twice, as in U + U^T of a triangle U.

    Away from supports a rigid translation, or a constant pressure, causes no force; with a doubled diagonal it causes the true diagonal.

    Parameters
    ----------
    K : (n, n) csc_array
    component : (n,) array of str
        Component of each row.
    file, place : Path, str or None
        File of the matrix, and place in it.

    Raises
    ------
    DataError
        If this holds for at least half of the rows.
    """
    twice, known = 0, 0
    diagonal = K.diagonal().real
    for label in (*COMPONENTS[:3], ACOUSTIC_COMPONENT):
        moved = (component == label).astype(float)
        rows = (moved > 0.0) & (diagonal > 0.0)
        force, size = K.real @ moved, np.abs(K) @ moved
        twice += int((np.abs(force - 0.5 * diagonal) <= 1e-6 * size)[rows].sum())
        known += int(rows.sum())
    if known < LEAST_DOFS / 10 or 2 * twice < known:
        return
    raise DataError(
        "the diagonal of the stiffness matrix probably counts twice",
        file=file,
        place=place,
        expected="a rigid translation that causes no force away from supports",
        found=f"at {twice} of {known} rows the force is half of the diagonal, as in U + U^T of a triangle U",
        hint="subtract the diagonal once (U + U.T - diag(U)), or give the triangle as it was exported, with `symmetric: true`. Do the same "
        "for the mass and the damping matrix if they were made this way",
    )


def _resting(K: sp.csc_array, component: NDArray[np.str_], *, share: float = 1e-6) -> Bools:
    """(n,) structural rows at which rigid translations cause forces of at most this share of the sum of magnitudes in the row."""
    rest: Bools = np.isin(component, COMPONENTS)
    for label in COMPONENTS[:3]:
        moved = (component == label).astype(float)
        rest &= np.abs(K.real @ moved) <= share * (np.abs(K) @ moved)
    return rest


def _turned(K: sp.csc_array, dofs: DofTable, xyz: Floats, rows: Bools, *, share: float = 1e-3) -> dict[str, float]:
    """Share of the rows that a rigid rotation about each axis loads by more than ``share`` of the sum of magnitudes, by axis.

    Coordinates in files have at least five digits, of which four remain within an element.
    """
    entries, found = K.real.tocsr()[np.flatnonzero(rows)].tocoo(), {}
    away = xyz[entries.col] - xyz[rows][entries.row]
    label = dofs.component[entries.col]
    for axis, name in enumerate("xyz"):
        turned = np.cross(np.eye(3)[axis], away)
        motion = (label == COMPONENTS[3 + axis]).astype(float)
        for k, shift in enumerate(COMPONENTS[:3]):
            motion += np.where(label == shift, turned[:, k], 0.0)
        force, size = (
            np.bincount(entries.row, each, minlength=int(rows.sum())) for each in (entries.data * motion, np.abs(entries.data * motion))
        )
        # Rows with rounding errors of rotated element matrices only are not counted.
        whole = np.bincount(entries.row, np.abs(entries.data), minlength=int(rows.sum()))
        loaded = size > ROUNDING * np.ptp(xyz, axis=0).max(initial=0.0) * whole
        if loaded.any():
            found[name] = float((np.abs(force[loaded]) > share * size[loaded]).mean())
    return found


def symmetry_doubt(K: sp.csc_array, dofs: DofTable, *, most: float = 0.8, least: int = 3, flat: float = 1e-6) -> str | None:
    """Warning if the nodes of an outer plane are fixed as on a plane of symmetry, so that half of the structure is missing; else None.

    A plane of symmetry with normal x fixes UX, ROTY and ROTZ, and leaves UY, UZ and ROTX free; clamped or pinned borders fix others.

    Parameters
    ----------
    K : (n, n) csc_array
    dofs : DofTable
        Of n rows.
    most : float
        Least share of the nodes of the plane that are fixed so; corners may have further constraints.
    least : int
        Least number of such nodes.
    flat : float
        Tolerance of the plane relative to the extent.
    """
    own = np.isin(dofs.component, COMPONENTS) & (K.diagonal() != 0.0)
    there = set(dofs.component[own].tolist())
    node, first, which = np.unique(dofs.node[own], return_index=True, return_inverse=True)
    xyz = dofs.xyz[own][first]
    held = {label: np.ones(node.size, dtype=bool) for label in there}
    for label in there:
        held[label][which[dofs.component[own] == label]] = False
    extent = np.ptp(xyz, axis=0) if node.size else np.zeros(3)
    for k, axis in enumerate("xyz"):
        across = {f"U{axis.upper()}", *(f"ROT{other.upper()}" for other in "xyz" if other != axis)} & there
        along = there - across
        if not across or not along or extent[k] <= flat * extent.max():
            continue
        alike = np.all([held[label] for label in across] + [~held[label] for label in along], axis=0)
        for end in (float(xyz[:, k].min()), float(xyz[:, k].max())):
            plane = np.abs(xyz[:, k] - end) <= flat * extent[k]
            if alike[plane].sum() >= max(least, most * plane.sum()):
                lacking = f"only {' and '.join(sorted(across))}" + (" is" if len(across) == 1 else " are")
                return (
                    f"probably half of a structure: at the nodes of an outer plane, {axis} = {end:.6g} m, {lacking} held, as on a plane "
                    "of symmetry. Such a model lacks the modes in which two halves move against each other, and the bolts of the other "
                    "half. Export the whole structure, without the symmetry condition. If the real structure is guided there, ignore this "
                    "warning"
                )
    return None
