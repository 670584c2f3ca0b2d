"""Nuisance parameters of a job (speed of sound, gains, offset of the hammer point): as unknowns with priors, and as results."""

from __future__ import annotations

from typing import Any

import numpy as np

from lrbc_cli.arrays import Integers
from lrbc_cli.campaign.identification.gains import Gains
from lrbc_cli.campaign.reading.drift import KELVIN, speed_std
from lrbc_cli.campaign.reading.inputs import Inputs
from lrbc_cli.config.settings import NuisanceConfig
from lrbc_cli.model.factors import SOUND_SPEED
from lrbc_cli.updating.misfit.extended import Nuisance
from lrbc_cli.updating.posterior.fit import Posterior


def nuisances_of(inputs: Inputs, nuisances: NuisanceConfig, responses: Integers | None = None) -> tuple[Nuisance, ...]:
    """Nuisance parameters of the settings, with gains of the given responses (None: those used)."""
    found: list[Nuisance] = []
    speed = speed_std(nuisances)
    if speed is not None and SOUND_SPEED in inputs.recipe.names:
        found.append(_nuisance(inputs, "factor", SOUND_SPEED, 0, speed))
    if nuisances.gain is not None:
        chosen = (inputs.used if responses is None else responses).tolist()
        found += [_nuisance(inputs, "gain", inputs.responses[i].name, i, nuisances.gain) for i in chosen]
    return (*found, *hits_of(inputs, nuisances))


def hits_of(inputs: Inputs, nuisances: NuisanceConfig) -> tuple[Nuisance, ...]:
    """Nuisance parameters of the hammer: two offsets of each excitation point across its normal [m]."""
    found: list[Nuisance] = []
    if nuisances.hammer is not None and inputs.shifts is not None:
        for load, (name, (_, normal)) in enumerate(zip(inputs.excitations, inputs.excitation_points, strict=True)):
            along = [axis for i, axis in enumerate("xyz") if i + 1 != normal]
            found += [_nuisance(inputs, "shift", f"{name} {along[k]}", 2 * load + k, nuisances.hammer) for k in range(2)]
    return tuple(found)


def _nuisance(inputs: Inputs, kind: str, name: str, index: int, std: float) -> Nuisance:
    bound = inputs.statistics.values.nuisance_reach * std
    return Nuisance(kind=kind, name=name, index=index, mean=0.0, std=std, bounds=(-bound, bound))


def gain_tree(inputs: Inputs, gains: Gains) -> dict[str, Any]:
    """Gains of all responses and their standard deviations [dB]; ``std`` is null for a response that is not used."""
    stds = dict(zip(inputs.used.tolist(), gains.stds.tolist(), strict=True))
    both = zip(inputs.responses, gains.over(inputs).tolist(), strict=True)
    return {response.name: {"value": value, "std": stds.get(at)} for at, (response, value) in enumerate(both)}


def nuisance_tree(inputs: Inputs, knowledge: Posterior, gains: Gains | None = None) -> dict[str, Any]:
    """Estimates of the nuisance parameters and gains with standard deviations: the key ``nuisances`` of ``result.json``."""
    nuisances, tree = inputs.campaign.update.nuisances, dict[str, Any]()
    if gains is not None and gains.shared:
        tree["common_gain_db"] = dict(zip(("value", "std"), gains.mean, strict=True))
    elif gains is not None:
        tree["gain_db"] = gain_tree(inputs, gains)
    stds = knowledge.std[knowledge.z.size :]
    for nuisance, value, std in zip(knowledge.nuisances, knowledge.values, stds, strict=True):
        if nuisance.kind == "gain":
            tree.setdefault("gain_db", {})[nuisance.name] = {"value": float(value), "std": float(std)}
        elif nuisance.kind == "shift":
            tree.setdefault("hammer_offset_mm", {})[nuisance.name] = {"value": 1e3 * float(value), "std": 1e3 * float(std)}
        else:
            tree["sound_speed_percent"] = {"value": 100.0 * float(np.expm1(value)), "std": 100.0 * float(std)}
            if nuisances.temperature is not None:
                kelvin = 2.0 * (nuisances.room + KELVIN)
                tree["temperature_kelvin"] = {"value": kelvin * float(value), "std": kelvin * float(std)}
    return tree
