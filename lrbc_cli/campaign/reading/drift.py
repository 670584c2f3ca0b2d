"""What may drift between the reference job and another: as unknowns with priors, and as results."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from lrbc_cli.arrays import Floats, Integers
from lrbc_cli.config import Campaign
from lrbc_cli.config.settings import NuisanceConfig
from lrbc_cli.method import Facts, resolve
from lrbc_cli.model.dofs import DofTable
from lrbc_cli.model.factors import SOUND_SPEED
from lrbc_cli.model.shifts import load_shifts
from lrbc_cli.results.job import JobRecord
from lrbc_cli.updating.extended import Nuisance
from lrbc_cli.updating.fit import Posterior

if TYPE_CHECKING:
    from lrbc_cli.campaign.reading.inputs import Inputs


KELVIN = 273.15


def speed_std(nuisances: NuisanceConfig) -> float | None:
    """Relative standard deviation of the speed of sound; None where it is held."""
    if nuisances.temperature is not None:
        return 0.5 * nuisances.temperature / (nuisances.room + KELVIN)
    return nuisances.sound_speed


def check_drift(campaign: Campaign, acoustic: bool) -> None:
    """Raise a ConfigError where nothing can drift: without a reference job, or the speed of sound in a model without air."""
    drift = [key for key, value in campaign.update.nuisances if value is not None and key != "room"]
    # Before anything is measured there is no reference job to name, and the plan counts with the drift already.
    reference = campaign.update.reference is not None or not campaign.jobs
    if drift and resolve(campaign.update, Facts(reference, True)).approach == "paper":
        raise campaign.error(
            "drift since a reference job that results are not compared with",
            "update",
            "nuisances",
            drift[0],
            expected="update.reference: the job with all bolts tight, and approach: bolts",
            hint="name it, or remove `nuisances`",
        )
    for key in ("temperature", "sound_speed"):
        if getattr(campaign.update.nuisances, key) is not None and not acoustic:
            raise campaign.error(
                "no air in this model whose speed of sound could vary",
                "update",
                "nuisances",
                key,
                expected="DOFs of component PRES",
                hint="remove it",
            )


def nuisances_of(inputs: Inputs, nuisances: NuisanceConfig, responses: Integers | None = None) -> tuple[Nuisance, ...]:
    """The nuisance parameters that the settings ask for, for these responses (those used where None)."""
    found: list[Nuisance] = []
    reach = inputs.statistics.values.nuisance_reach

    def add(kind: str, name: str, index: int, std: float) -> None:
        found.append(Nuisance(kind, name, index, 0.0, std, (-reach * std, reach * std)))

    speed = speed_std(nuisances)
    if speed is not None and SOUND_SPEED in inputs.recipe.names:
        add("factor", SOUND_SPEED, 0, speed)
    if nuisances.gain is not None:
        for i, response in enumerate(inputs.used if responses is None else responses):
            add("gain", inputs.responses[response].name, i, nuisances.gain)
    if nuisances.hammer is not None and inputs.shifts is not None:
        for load, (name, (_, normal)) in enumerate(zip(inputs.excitations, inputs.excitation_points, strict=True)):
            along = [axis for i, axis in enumerate("xyz") if i + 1 != normal]
            for direction in range(2):
                add("shift", f"{name} {along[direction]}", 2 * load + direction, nuisances.hammer)
    return tuple(found)


def load_shift(campaign: Campaign, dofs: DofTable | None, dof: int, name: str) -> Floats:
    """(n, 2) derivatives of an excitation to a shift along the surface; dof is negative where it is a vector.

    Raises
    ------
    ConfigError
        Where they are unknown.
    """
    found = load_shifts(dofs, dof) if dofs is not None and dof >= 0 else None
    if found is None:
        raise campaign.error(
            f"what excitation {name} becomes beside its node is unknown",
            "update",
            "nuisances",
            "hammer",
            expected="model.dofs, and an excitation by near: or node: on UX, UY or UZ",
            hint="remove nuisances.hammer, or excite at a node",
        )
    return found[0]


def stored_offsets(record: JobRecord | None) -> dict[str, float]:
    """Where the hammer hit in a stored result [m], by excitation and direction."""
    return {} if record is None else {name: 1e-3 * entry.value for name, entry in record.nuisances.hammer_offset_mm.items()}


def drift_tree(nuisances: NuisanceConfig, knowledge: Posterior) -> dict[str, Any]:
    """What drifted, with standard deviations, as in ``result.json``."""
    tree: dict[str, Any] = {}
    stds = knowledge.std[knowledge.z.size :]
    for nuisance, value, std in zip(knowledge.extras, knowledge.values, stds, strict=True):
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
