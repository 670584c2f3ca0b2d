"""Checks that points lie at the model, and that coordinates and matrices are in the stated units."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import scipy.sparse as sp

from lrbc_cli.arrays import Bools, Floats, Integers
from lrbc_cli.campaign.reading.doubts.materials import material_cause
from lrbc_cli.config import Campaign
from lrbc_cli.config.structure import DofSource, ProportionalDamping
from lrbc_cli.errors import DataError, listing
from lrbc_cli.model.dofs import DofTable
from lrbc_cli.model.selection import pitch
from lrbc_cli.model.units import SI, USUAL_SYSTEMS, parse_system

#: Largest possible wave speed in a mesh, ``sqrt(K_ii / M_ii)`` times the node spacing [m/s]: in diamond it is 18 km/s, and the estimate is
#: a few times that of the material. A thousand times the speed in air, or in a thin plate, is above.
FASTEST = 2e5

#: Least wave speed [m/s], and bounds of the mass of a node over the cube of the node spacing [kg/m³]: from thin sheets in coarse meshes to
#: lead in fine ones.
SLOWEST, LIGHTEST, HEAVIEST = 10.0, 0.3, 3e6

#: Usual speed, density (geometric means of the bounds) and size of a structure [m], to rank possible causes.
USUAL = np.array([(SLOWEST * FASTEST) ** 0.5, (LIGHTEST * HEAVIEST) ** 0.5, 1.0])

MILLIMETRES = 1e-3

#: Largest distance of a point from a node at which it lies, as a share of the node spacing.
AT_NODE = 0.05

#: Ratio of distances below which one is clearly nearer.
CLEARLY_NEARER = 0.5

#: Remedy for bolts with a radius and an angle in place of x and y.
POLAR = "these are probably polar coordinates: with x as radius and y as angle in degrees they lie at their springs. Give x, y and z"

#: Exchanged axes, and the order of the columns.
EXCHANGES = {"x and y": [1, 0, 2], "x and z": [2, 1, 0], "y and z": [0, 2, 1]}

#: Distance from the model, in its sizes, beyond which only a wrong unit is likely.
EVIDENT = 20.0

#: Powers of ten between usual units of stiffness and of mass.
POWERS = (-12, -9, -6, -3, 3, 6, 9, 12)

#: Gravity [m/s², in/s²]: factor of a weight density that was entered as mass density.
GRAVITIES = (9.80665, 386.0886)

#: Largest deviation of speed, density and size from the usual values [decades].
MOST_OFF = 1.8

#: Causes are named together if their deviations (sum of speed and density) differ by less than this [decades].
ALIKE = 0.7


def coordinates_file(campaign: Campaign) -> Path | None:
    """The file of the coordinates of the nodes."""
    source = campaign.model.dofs
    return source.nodes if isinstance(source, DofSource) else source


def components_place(campaign: Campaign) -> str:
    """Name of the file of the component of each row, or the key that states it."""
    source = campaign.model.dofs
    if isinstance(source, DofSource):
        return "model.dofs.components" if source.components else (source.map or campaign.model.stiffness.path).name
    return "model.dofs" if source is None else source.name


def extents(xyz: Floats, unit: float = 1.0, name: str = "m") -> str:
    """Bounding box of points [m] in words, in a unit of length with its name."""
    ends = np.stack([xyz.min(axis=0), xyz.max(axis=0)], axis=1) / unit
    of_axis = (list(dict.fromkeys(f"{value:.4g}" for value in own)) for own in ends.tolist())
    return ", ".join(f"{axis} {' to '.join(own)}" for axis, own in zip("xyz", of_axis, strict=True)) + f" {name}"


def require_near(
    points: Floats,
    names: Sequence[tuple[str, str]],
    model: Floats,
    *,
    file: Path,
    place: Callable[[Sequence[int]], str] | None = None,
    known: bool = True,
    own: Floats | None = None,
    unit: float = 1.0,
) -> None:
    """Refuse points farther from the model's bounding box than the size of that box.

    Parameters
    ----------
    points : (m, 3) float array
    names : (m,) sequence of (str, str)
        Kind, such as ``bolt`` or ``response``, and name of each.
    model : (n, 3) float array
        Points of the model [m]; no check without an extent.
    file : Path
    place : callable or None
        From indices of points to their keys in the file.
    known : bool
        Whether ``model`` is the whole model. If not, points may be far away, and are refused only if all are and would fit in millimetres.
    own : (m, 3) float array or None
        Where the springs of each point are, NaN if unknown: a likely cause must bring the points to their own.
    unit : float
        Length unit of the file [m].

    Raises
    ------
    DataError
        One for all points, with the likely cause.
    """
    low, high = model.min(axis=0), model.max(axis=0)
    size = float(np.linalg.norm(high - low))
    if size == 0.0 or not points.size:
        return

    def away(some: Floats) -> Floats:
        return np.asarray(np.linalg.norm(np.maximum(np.maximum(low - some, some - high), 0.0), axis=1))

    distance = away(points)
    far = np.flatnonzero(distance > size)
    if not far.size or (not known and (far.size < points.shape[0] or bool(np.any(away(points * MILLIMETRES) > size)))):
        return
    worst = int(far[np.argmax(distance[far])])
    one = far.size == 1
    raise DataError(
        f"{counted(names, far.tolist())} {'lies' if one else 'lie'} outside the model by more than its size",
        file=file,
        place=None if place is None else place(far.tolist()),
        expected=f"coordinates in metres; the model spans {size:.3g} m ({extents(model)})",
        found=("" if one else f"{names[worst][1]} at ")
        + f"({', '.join(f'{value:g}' for value in points[worst])}), {distance[worst]:.3g} m away from it",
        hint=_likely(points, far, distance[worst] > EVIDENT * size, lambda some: bool(away(some).max() <= size), own, unit),
    )


def _likely(points: Floats, far: Integers, evident: bool, fits: Callable[[Floats], bool], own: Floats | None, unit: float) -> str:
    """Likely cause of points ``far`` from the model, with its remedy.

    Points in millimetres are hundreds of sizes away (``evident``); nearer points would fit after division as well, by chance.
    """
    polar = of_polar(points, unit)
    if own is not None and _at_own(polar, own) and fits(polar):
        return POLAR
    if evident and fits(points[far] * MILLIMETRES) and _at_own(points * MILLIMETRES, own):
        return "these are probably millimetres: divided by 1000 they fit the model. Give coordinates in metres"
    if fits(points / MILLIMETRES) and _at_own(points / MILLIMETRES, own):
        return "the coordinates of the DOF table are probably millimetres: these points times 1000 fit them. Give coordinates in metres"
    return "correct the coordinates (order and direction of the axes, origin)"


def of_polar(points: Floats, unit: float) -> Floats:
    """Points whose first two columns were a radius and an angle in degrees (``unit``: length unit of the file [m])."""
    angle = np.deg2rad(points[:, 1] / unit)
    return np.column_stack([points[:, 0] * np.cos(angle), points[:, 0] * np.sin(angle), points[:, 2]])


def _at_own(points: Floats, own: Floats | None) -> bool:
    """Whether each point is nearer to its own place than to those of the others, or no place is known."""
    known = np.zeros(0, dtype=bool) if own is None else np.isfinite(own).all(axis=1)
    if own is None or not known.any():
        return True
    away = np.linalg.norm(points[known][:, None] - own[known], axis=2)
    return bool(np.all(np.diag(away) <= away.min(axis=1)))


def counted(names: Sequence[tuple[str, str]], some: Sequence[int]) -> str:
    """Some of many points in words, kind by kind: ``excitation hammer and all 10 responses``.

    Parameters
    ----------
    names : sequence of (str, str)
        Kind and name of all.
    some : sequence of int
    """
    told = []
    for kind in dict.fromkeys(kind for kind, _ in names):
        count, own = sum(each == kind for each, _ in names), [names[k][1] for k in some if names[k][0] == kind]
        if len(own) == 1:
            told.append(f"{kind} {own[0]}")
        elif own:
            every = "both" if count == 2 else f"all {count}"
            told.append(f"{every} {kind}s" if len(own) == count else f"{len(own)} of {count} {kind}s ({listing(own, 6)})")
    return " and ".join(told)


def require_metres(K: sp.csc_array, M: sp.csc_array, dofs: DofTable, campaign: Campaign) -> str | None:
    """Refuse coordinates with which the wave speed would be impossible.

    Returns
    -------
    str or None
        Warning if the speed is possible, but the density is not.

    Raises
    ------
    DataError
        If the node spacing does not fit stiffness and mass, as with millimetres, or matrices in t, mm and s.
    """
    translations = np.isin(dofs.component, ("UX", "UY", "UZ"))
    file = coordinates_file(campaign)
    for field, what in ((dofs.is_acoustic, "air"), (translations, "structure")):
        found = _speed_and_density(K, M, dofs, field)
        if found is not None and found[0] > FASTEST:
            likely = likely_mistake(campaign, dofs, *found[:2]) if what == "structure" else None
            raise DataError(
                f"the coordinates do not fit the matrices: waves in the {what} would travel at about {found[0]:.1g} m/s",
                file=file,
                expected=f"coordinates in metres, matrices in SI: below {FASTEST:.0e} m/s",
                found=f"nodes {found[2]:.3g} apart, model {extents(dofs.xyz)}",
                hint=likely
                or "check whether the coordinates are in millimetres and the matrices in SI, and convert them; if all are in one system of "
                "units, write `units: mm-N-t` in the campaign file",
            )
    found = _speed_and_density(K, M, dofs, translations)
    if found is None or LIGHTEST < found[1] < HEAVIEST or (cause := likely_mistake(campaign, dofs, *found[:2])) is None:
        return None
    return f"nodes {found[2]:.3g} m apart have {found[1]:.1g} kg per cube of that length, which no structure has; probably {cause}"


def frequencies_doubt(K: sp.csc_array, M: sp.csc_array, dofs: DofTable, campaign: Campaign) -> str | None:
    """Likely mistake in a model whose frequencies are far too low; None if its wave speed and density are possible."""
    found = _speed_and_density(K, M, dofs, np.isin(dofs.component, ("UX", "UY", "UZ")))
    if found is None or (found[0] > SLOWEST and LIGHTEST < found[1] < HEAVIEST):
        return None
    return likely_mistake(campaign, dofs, *found[:2])


def likely_units(K: sp.csc_array, M: sp.csc_array, dofs: DofTable) -> list[str]:
    """Systems of units in which wave speed and density of an exported model are possible; only SI if they are possible in SI."""
    found = _speed_and_density(K, M, dofs, np.isin(dofs.component, ("UX", "UY", "UZ")))
    if found is None or (SLOWEST < found[0] < FASTEST and LIGHTEST < found[1] < HEAVIEST):
        return ["SI"]
    fit, (speed, density, _) = list[str](), found
    for text in USUAL_SYSTEMS:
        unit = parse_system(text)
        if SLOWEST < speed * unit.length / unit.time < FASTEST and LIGHTEST < density * unit.mass / unit.length**3 < HEAVIEST:
            fit.append(text)
    return fit


def _speed_and_density(K: sp.csc_array, M: sp.csc_array, dofs: DofTable, field: Bools) -> tuple[float, float, float] | None:
    """Approximate wave speed [m/s], mass of a node over the cube of the node spacing [kg/m³], and that spacing [m]; None if unknown."""
    stiffness, mass = np.abs(K.diagonal())[field], np.real(M.diagonal())[field]
    apart = pitch(dofs.xyz[field])
    if not np.isfinite(apart) or mass.mean() <= 0.0:
        return None
    # The mean mass and the median stiffness are insensitive to massless nodes and to penalties.
    return apart * float(np.sqrt(np.median(stiffness) / mass.mean())), float(mass.mean()) / apart**3, apart


def mistake_text(campaign: Campaign, matrix: str, factor: float) -> str:
    """Text on a matrix that is too large by a factor, with its remedy.

    Parameters
    ----------
    campaign : Campaign
    matrix : str
        ``stiffness``, ``mass`` or ``damping``.
    factor : float
    """
    model = campaign.model
    reference = {"stiffness": model.stiffness, "mass": model.mass, "damping": model.damping}[matrix]
    size = f"{factor:.4g} times too large" if factor > 1.0 else f"{1.0 / factor:.4g} times too small"
    if reference is None or isinstance(reference, ProportionalDamping):
        return f"the {matrix} of the model is {size}: correct alpha, beta and loss_factor of model.{matrix}"
    cause = material_cause(campaign.unit_system, matrix, factor)
    if matrix == "mass" and factor in GRAVITIES:
        cause = "a weight density, force per volume, but the units require mass per volume"
    given = reference.scale if isinstance(reference.scale, float) else 1.0
    group = f", group: {reference.group}" if reference.group else ""
    return (
        f"the {matrix} matrix is {size}{f' ({cause})' if cause else ''}: correct it in the FE model and export again, or write "
        f"model.{matrix}: {{file: {campaign.relative(reference.path)}{group}, scale: {given / factor:.6g}}}"
    )


def likely_mistake(campaign: Campaign, dofs: DofTable, speed: float, density: float) -> str | None:
    """Likely mistakes (units, or a factor on a matrix) that give a model possible wave speed, density and size, with remedies.

    Parameters
    ----------
    campaign : Campaign
    dofs : DofTable
    speed, density : float
        As the campaign states the model [m/s, kg/m³].

    Returns
    -------
    str or None
        None if no known mistake explains all three.
    """
    found: list[tuple[float, str]] = []
    stated, size = campaign.unit_system, float(np.linalg.norm(np.ptp(dofs.xyz, axis=0)))

    def add(text: str, *values: float, handicap: float = 0.0) -> None:
        off = np.abs(np.log10(np.array(values) / USUAL))
        if off.max() <= MOST_OFF:
            found.append((float(off[:2].sum()) + handicap, text))

    for unit in (SI, *map(parse_system, USUAL_SYSTEMS)):
        length, mass, time = unit.length / stated.length, unit.mass / stated.mass, unit.time / stated.time
        if unit != stated:
            text = f"the model is in other units: write `units: {unit.text}`"
            add(text, speed * length / time, density * mass / length**3, size * length)
    text = "the coordinates of the DOF table are in millimetres, the matrices in metres: convert them, or export all in one system of units"
    add(text, speed * MILLIMETRES, density / MILLIMETRES**3, size * MILLIMETRES)
    for factor in (10.0**power for power in POWERS):
        # If no units are stated, wrong units of the whole model are more likely.
        handicap = ALIKE if stated == SI else 0.0
        for matrix, change in (("mass", (factor**0.5, 1.0 / factor)), ("stiffness", (factor**-0.5, 1.0))):
            text = mistake_text(campaign, matrix, factor)
            add(text, speed * change[0], density * change[1], size, handicap=handicap)
    if not found:
        return None
    least = min(found)[0]
    return "; or ".join(text for off, text in sorted(found) if off <= least + ALIKE)
