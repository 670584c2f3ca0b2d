"""Nuisance parameters of a job: as unknowns with priors, and as results."""

from __future__ import annotations

from typing import Any

import numpy as np

from lrbc_cli.arrays import Floats, Integers
from lrbc_cli.campaign.identification.found import Fit
from lrbc_cli.campaign.reading.drift import KELVIN, speed_std
from lrbc_cli.campaign.reading.inputs import Inputs
from lrbc_cli.config.settings import NuisanceConfig
from lrbc_cli.model.factors import SOUND_SPEED
from lrbc_cli.updating.misfit.cost import Misfit
from lrbc_cli.updating.misfit.extended import Nuisance
from lrbc_cli.updating.posterior.fit import Posterior, noise_of, posterior
from lrbc_cli.updating.search.descent import descend
from lrbc_cli.updating.search.optimise import Solution

#: Share of a gain that the lines that are not compared have to show.
SHOWN = 0.5


def nuisances_of(inputs: Inputs, nuisances: NuisanceConfig, responses: Integers | None = None) -> tuple[Nuisance, ...]:
    """The nuisance parameters that the settings ask for, for these responses (those used where None)."""
    found: list[Nuisance] = []
    speed = speed_std(nuisances)
    if speed is not None and SOUND_SPEED in inputs.recipe.names:
        found.append(_nuisance(inputs, "factor", SOUND_SPEED, 0, speed))
    if nuisances.gain is not None:
        chosen = (inputs.used if responses is None else responses).tolist()
        found += [_nuisance(inputs, "gain", inputs.responses[i].name, i, nuisances.gain) for i in chosen]
    return (*found, *hits_of(inputs, nuisances))


def hits_of(inputs: Inputs, nuisances: NuisanceConfig) -> tuple[Nuisance, ...]:
    """Those of them that say where the hammer hit."""
    found: list[Nuisance] = []
    if nuisances.hammer is not None and inputs.shifts is not None:
        for load, (name, (_, normal)) in enumerate(zip(inputs.excitations, inputs.excitation_points, strict=True)):
            along = [axis for i, axis in enumerate("xyz") if i + 1 != normal]
            found += [_nuisance(inputs, "shift", f"{name} {along[k]}", 2 * load + k, nuisances.hammer) for k in range(2)]
    return tuple(found)


def _nuisance(inputs: Inputs, kind: str, name: str, index: int, std: float) -> Nuisance:
    bound = inputs.statistics.values.nuisance_reach * std
    return Nuisance(kind=kind, name=name, index=index, mean=0.0, std=std, bounds=(-bound, bound))


def nuisance_tree(nuisances: NuisanceConfig, knowledge: Posterior, gain: tuple[float, float] | None = None) -> dict[str, Any]:
    """What drifted, with standard deviations, as in ``result.json``; ``gain`` is what all responses share [dB]."""
    tree: dict[str, Any] = {} if gain is None else {"common_gain_db": {"value": gain[0], "std": gain[1]}}
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


def common_gain(inputs: Inputs) -> Floats | None:
    """(U, 1) gain that all responses used share, of one standard deviation [dB]; None where the settings name gains of their own."""
    if inputs.campaign.update.nuisances.gain is not None:
        return None
    return np.full((inputs.used.size, 1), inputs.statistics.errors.gain_db)


def gain_of(inputs: Inputs, misfit: Misfit, solution: Solution, knowledge: Posterior) -> tuple[float, float] | None:
    """The gain that all responses share at an optimum, and its standard deviation [dB]; None where the cost allows for none.

    Parameters
    ----------
    inputs : Inputs
    misfit : Misfit
    solution : Solution
        The Jacobian of its evaluation is to the unknowns.
    knowledge : Posterior
    """
    rows = solution.evaluation.jacobian[: misfit.valid.sum() * (2 if inputs.method.residual.kind != "db" else 1)]
    found = misfit.gains(solution.theta, rows, knowledge.covariance, knowledge.noise.variance)
    if found is None:
        return None
    reach = inputs.statistics.values.nuisance_reach * inputs.statistics.errors.gain_db
    return min(max(float(found[0][0]), -reach), reach), float(found[1][0])


def seen_gain(inputs: Inputs, gain: tuple[float, float] | None) -> bool:
    """Whether a gain lies, with its 95 % interval, beyond what a measuring chain is calibrated to."""
    return gain is not None and abs(gain[0]) - 2.0 * gain[1] > inputs.statistics.errors.least_gain_db


def off_gain(inputs: Inputs, fit: Fit, prior: Floats, selected: Integers, gains: Floats) -> tuple[bool, int]:
    """Whether the measurement has another gain than the reference job, and evaluations.

    Bolts make up for a gain in part: it is sought from the end of the fit without it, and from the reference state.

    Parameters
    ----------
    inputs : Inputs
    fit : Fit
        Without a gain.
    prior : (size,) float array
        Theta of the reference state.
    selected : int array
        Lines that are compared.
    gains : (U, 1) float array
        See ``common_gain``.
    """
    misfit, shapes = fit.misfit.with_gains(gains), fit.knowledge.shapes
    bounds, method = misfit.model.parameters.bounds, inputs.method
    stop: dict[str, Any] = {"tolerance": method.tolerance, "max_iterations": method.max_iterations}
    ends = [descend(misfit, theta, bounds, shapes.T, **stop) for theta in (fit.solution.theta, prior)]
    best = min(ends, key=lambda end: end.evaluation.total)
    knowledge = posterior(misfit, best, shapes, (), noise_of(misfit, best.evaluation, selected), prior)
    return seen_gain(inputs, gain_of(inputs, misfit, best, knowledge)), sum(end.evaluations for end in ends)


def no_gain(inputs: Inputs, elsewhere: Floats) -> bool:
    """Whether the lines that are not compared lie so near to the model that no gain could show there, see ``shown_gain``."""
    return bool(elsewhere.size) and abs(float(np.median(elsewhere))) < SHOWN * inputs.statistics.errors.least_gain_db


def shown_gain(left: tuple[float, float], gain: float, elsewhere: Floats) -> bool:
    """Whether a gain brings a fit nearer to the measurement, and shows on lines where damping would not.

    Where bolts change much, errors of the predicted changes and a gain are told apart by little: one that leaves more than was left
    without it is none. Damping moves levels about resonances as a gain does, and hardly others.

    Parameters
    ----------
    left : (float, float)
        Misfit without the gain, and with it [dB].
    gain : float
        [dB]
    elsewhere : (m,) float array
        By how much levels lie above what the second fit expects, against the reference job where it is compared with it, on lines that
        are not compared [dB].
    """
    return left[1] < left[0] and (not elsewhere.size or abs(float(np.median(elsewhere)) - gain) < SHOWN * abs(gain))
