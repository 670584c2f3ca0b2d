"""Nuisance parameters of a job: as unknowns with priors, and as results.

``DRIFTS`` defines all of them: a further one needs a function here, its setting in ``NuisanceConfig`` and a line in the guide. Results, the
page and ``lrbc plan`` follow from its class (``updating.misfit.nuisances``), ``lrbc rehearse`` draws every global factor.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from lrbc_cli.arrays import Integers
from lrbc_cli.campaign.identification.gains import Gains
from lrbc_cli.campaign.reading.inputs import Inputs
from lrbc_cli.model.factors import SOUND_SPEED
from lrbc_cli.updating.misfit.nuisances import Gain, ModelFactor, Nuisance, Shift, estimates
from lrbc_cli.updating.posterior.fit import Posterior

KELVIN = 273.15


def _reach(inputs: Inputs, std: float) -> float:
    return inputs.statistics.values.nuisance_reach * std


def _sound_speed(inputs: Inputs, _: Integers) -> tuple[Nuisance, ...]:
    """Speed of sound, which follows the square root of the temperature of the air."""
    settings = inputs.method.nuisances
    also, std = dict[str, float](), settings.sound_speed
    if settings.temperature is not None:
        also["temperature_kelvin"] = 2.0 * (settings.room + KELVIN)
        std = settings.temperature / also["temperature_kelvin"]
    if std is None or SOUND_SPEED not in inputs.recipe.names:
        return ()
    return (ModelFactor(name=SOUND_SPEED, words="speed of sound", std=std, reach=_reach(inputs, std), also=also),)


def _gains(inputs: Inputs, responses: Integers) -> tuple[Nuisance, ...]:
    """Gain of each of the responses [dB]."""
    std = inputs.method.nuisances.gain
    if std is None:
        return ()
    return tuple(Gain(name=inputs.responses[i].name, index=i, std=std, reach=_reach(inputs, std)) for i in responses.tolist())


def hits_of(inputs: Inputs, _: Integers | None = None) -> tuple[Shift, ...]:
    """Two offsets of each excitation point across its normal [m]: the only nuisance parameters that the reference job has, too."""
    std = inputs.method.nuisances.hammer
    if std is None or inputs.shifts is None:
        return ()
    return tuple(
        Shift(name=f"{name} {axis}", load=load, direction=direction, std=std, reach=_reach(inputs, std))
        for load, (name, (_, normal)) in enumerate(zip(inputs.excitations, inputs.excitation_points, strict=True))
        for direction, axis in enumerate([axis for i, axis in enumerate("xyz", 1) if i != normal][:2])
    )


#: Functions of the inputs and of indices of responses that give the nuisance parameters; none if they are not set.
DRIFTS: tuple[Callable[[Inputs, Integers], tuple[Nuisance, ...]], ...] = (_sound_speed, _gains, hits_of)


def nuisances_of(inputs: Inputs, responses: Integers | None = None) -> tuple[Nuisance, ...]:
    """Nuisance parameters of the settings, with gains of the given responses (None: those used)."""
    chosen = inputs.used if responses is None else responses
    return tuple(nuisance for drift in DRIFTS for nuisance in drift(inputs, chosen))


def not_in_model(inputs: Inputs) -> list[str]:
    """Keys of nuisance parameters that are set but that the inputs, as they were read, cannot represent."""
    settings, names = inputs.method.nuisances, inputs.recipe.names
    lacking = {"hammer": inputs.shifts is None, "temperature": SOUND_SPEED not in names, "sound_speed": SOUND_SPEED not in names}
    return [key for key in settings.given if lacking.get(key, False)]


def gain_tree(inputs: Inputs, gains: Gains) -> dict[str, Any]:
    """Gains of the responses that have one, and their standard deviations [dB]; ``std`` is null for a response that is not used."""
    stds = dict(zip(inputs.used.tolist(), gains.stds.tolist(), strict=True))
    having = range(len(inputs.responses)) if gains.shared is None else gains.shared.responses
    values = gains.over(inputs)
    return {inputs.responses[at].name: {"value": float(values[at]), "std": stds.get(at)} for at in having}


def nuisance_tree(inputs: Inputs, knowledge: Posterior, gains: Gains | None = None) -> dict[str, Any]:
    """Estimates of the nuisance parameters and gains with standard deviations: the key ``nuisances`` of ``result.json``."""
    tree = estimates(knowledge.nuisances, knowledge.values, knowledge.std[knowledge.z.size :])
    if gains is not None and gains.shared is not None and gains.shared.kind == "all":
        tree["common_gain_db"] = dict(zip(("value", "std"), gains.mean, strict=True))
    elif gains is not None:
        tree["gain_db"] = gain_tree(inputs, gains)
    return tree
