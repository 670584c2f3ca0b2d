"""Matrices that are too large or too small by the factor of a unit: which of the two, by how much, and what to write."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from lrbc_cli.config import Campaign
from lrbc_cli.config.structure import ModelConfig
from lrbc_cli.model.units import SI, USUAL_SYSTEMS, parse_system

#: Powers of ten that lie between usual units of stiffness and of mass.
POWERS = (-12, -9, -6, -3, 3, 6, 9, 12)

#: Weight densities typed as mass densities leave the acceleration of gravity [m/s², in/s²].
GRAVITIES = (9.80665, 386.0886)

#: Decades within which speed and density of structures and meshes lie about their usual size.
MOST_OFF = 1.8

#: Causes that come nearest to the usual by so many decades, of speed and density together, are told side by side.
ALIKE = 0.7

#: What a matrix is then taken for: too large by the factor.
_CAUSES = {
    ("mass", 1e12): "density in kg/m³ where the units want t/mm³",
    ("mass", 1e-12): "density in t/mm³ where the units want kg/m³",
    ("mass", 1e9): "density in kg/m³ where the units want kg/mm³",
    ("mass", 1e-9): "density in kg/mm³ where the units want kg/m³",
    ("mass", 1e3): "density in kg/m³ where the units want g/cm³ or t/m³, or kg for t",
    ("mass", 1e-3): "density in g/cm³ or t/m³ where the units want kg/m³, or t for kg",
    ("stiffness", 1e6): "a modulus in Pa where the units want MPa",
    ("stiffness", 1e-6): "a modulus in MPa where the units want Pa",
    ("stiffness", 1e3): "a modulus in MPa where the units want GPa, or N/m for N/mm",
    ("stiffness", 1e-3): "a modulus in GPa where the units want MPa, or N/mm for N/m",
    ("stiffness", 1e9): "a modulus in Pa where the units want GPa",
    ("stiffness", 1e-9): "a modulus in GPa where the units want Pa",
    **{("mass", gravity): "a weight density, force per volume, where the units want mass per volume" for gravity in GRAVITIES},
}


def mistake_text(model: ModelConfig, matrix: str, factor: float, folder: Path) -> str:
    """A matrix that is too large by a factor, in words, and what to write.

    Parameters
    ----------
    model : ModelConfig
    matrix : str
        ``stiffness`` or ``mass``.
    factor : float
    folder : Path
        Of the campaign file: paths are relative to it.
    """
    reference = model.stiffness if matrix == "stiffness" else model.mass
    size = f"{factor:.4g} times too large" if factor > 1.0 else f"too small by {factor:.4g}"
    cause = _CAUSES.get((matrix, factor))
    given = reference.scale if isinstance(reference.scale, float) else 1.0
    group = f", group: {reference.group}" if reference.group else ""
    return (
        f"the {matrix} matrix is {size}{f' ({cause})' if cause else ''}: correct it in the FE model and export again, or write "
        f"model.{matrix}: {{file: {Path(os.path.relpath(reference.path, folder)).as_posix()}{group}, scale: {given / factor:.6g}}}"
    )


def likely_mistake(campaign: Campaign, speed: float, density: float, usual: tuple[float, float]) -> str | None:
    """What makes speed of waves and density of a model that is not possible as it stands those of a structure, and what to write.

    Parameters
    ----------
    campaign : Campaign
    speed, density : float
        As the campaign has them [m/s, kg/m³].
    usual : pair of float
        Their usual sizes: those come nearest that are named.

    Returns
    -------
    str or None
        None where nothing known comes within a decade and a half of both.
    """
    found: list[tuple[float, str]] = []

    def add(text: str, speed: float, density: float) -> None:
        off = np.abs(np.log10([speed / usual[0], density / usual[1]]))
        if off.max() <= MOST_OFF:
            found.append((float(off.sum()), text))

    if campaign.unit_system == SI:
        for name in USUAL_SYSTEMS:
            unit = parse_system(name)
            add(f"the model is in other units: write units: {name}", speed * unit.length / unit.time, density * unit.mass / unit.length**3)
    for power in POWERS:
        factor = 10.0**power
        for matrix, change in (("mass", (factor**0.5, 1.0 / factor)), ("stiffness", (factor**-0.5, 1.0))):
            text = mistake_text(campaign.model, matrix, factor, campaign.path.parent)
            add(text, speed * change[0], density * change[1])
    if not found:
        return None
    least = min(found)[0]
    return "; or ".join(text for off, text in sorted(found) if off <= least + ALIKE)
