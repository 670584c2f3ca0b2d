"""Factors of a calibration that are so far from 1 that the FE model is probably wrong there, however well a calibrated one fits."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from lrbc_cli.model.factors import SOUND_SPEED, Recipe
from lrbc_cli.updating.calibration.calibrate import moves_resonances
from lrbc_cli.updating.statistics.priors import CALIBRATION_PRIOR, CalibrationPrior

#: Factors of whole fields, of whose stiffness and mass the FRFs mostly tell the quotient only.
_STIFFNESS, _MASS, _AIR, _COMPLIANCE = "stiffness.structure", "mass.structure", "stiffness.acoustic", "mass.acoustic"


def far_factors(
    factors: Mapping[str, float],
    recipe: Recipe,
    prior: CalibrationPrior = CALIBRATION_PRIOR,
    *,
    stiff: float = 3.0,
    damping: float = 2.0,
    speed: float = 0.03,
) -> list[str]:
    """Warnings on factors far from 1.

    Parameters
    ----------
    factors : mapping of str to float
        By name. Only a sum of alpha and beta is determined, so they are not asked.
    recipe : Recipe
        Tells which of them scale stiffness or mass.
    prior : CalibrationPrior
    stiff, damping : float
        Largest deviation of factors of stiffness or mass, and of loss factors, in standard deviations of their prior. A choice.
    speed : float
        See ``far_sound``.
    """
    found, most = list[str](), stiff * prior.stiff_std
    if sound := far_sound(factors, speed=speed):
        found.append(_sound_text(sound))
    quotient = factors.get(_STIFFNESS, 1.0) / factors.get(_MASS, 1.0)
    if {_STIFFNESS, _MASS} <= factors.keys() and abs(np.log(quotient)) > most:
        found.append(_material_text(f"the quotient of stiffness and mass of the structure by {quotient:.3g}"))
    for name, value in factors.items():
        kind, _, of = name.partition(".")
        if kind == "loss_factor" and abs(np.log(value)) > damping * prior.damping_factor_std:
            wrong = f"{max(value, 1 / value):.2g} times too {'small' if value > 1.0 else 'large'}"
            where = "in model.damping, or in the FE model, it is probably"
            found.append(f"the calibration multiplies the loss factor of {of} by {value:.2g}: {where} {wrong}")
        together = name in (_AIR, _COMPLIANCE, SOUND_SPEED) or {name} < {_STIFFNESS, _MASS} <= factors.keys()
        if not together and moves_resonances(recipe, name) and abs(np.log(value)) > most:
            found.append(_material_text(f"{f'the {kind} of the {of}' if of else name} by {value:.3g}"))
    return found


def far_sound(factors: Mapping[str, float], *, speed: float = 0.03) -> float:
    """Factor of the speed of sound by all ``factors`` of the air, if it is far from 1; else zero.

    ``speed``: largest relative deviation that is not far: a room 18 K warmer or colder. A choice.
    """
    sound = factors.get(SOUND_SPEED, 1.0) * (factors.get(_AIR, 1.0) / factors.get(_COMPLIANCE, 1.0)) ** 0.5
    return sound if abs(np.log(sound)) > speed else 0.0


def without_air(factors: Mapping[str, float]) -> dict[str, float]:
    """Factors without those of the air's stiffness, mass and speed of sound."""
    return {name: value for name, value in factors.items() if name not in (SOUND_SPEED, _AIR, _COMPLIANCE)}


def kelvin_of(sound: float, room: float = 293.0) -> float:
    """Change of the temperature of the air [K] by which its speed of sound changes by the factor ``sound``."""
    return room * (sound**2 - 1.0)


def _material_text(what: str) -> str:
    return (
        f"the calibration multiplies {what}, more than materials scatter: the FE model is probably wrong there. Check modulus, density and "
        "thickness, and whether a stiffener, another part, a mass or a cut-out is missing"
    )


def _sound_text(sound: float, *, most: float = 40.0) -> str:
    """``most``: largest change of the temperature that air may have [K]."""
    kelvin = kelvin_of(sound)
    as_of = f", as of air {abs(kelvin):.0f} K {'warmer' if kelvin > 0.0 else 'colder'}" if abs(kelvin) <= most else ""
    return (
        f"the calibration multiplies the speed of sound by {sound:.3g}{as_of}: check the speed of sound (or bulk modulus and density) of "
        "the air in the FE model, its units and its temperature"
    )
