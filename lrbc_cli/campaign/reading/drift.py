"""Nuisance parameters of the campaign file: checks that they can be identified, and what the model needs for them."""

from __future__ import annotations

from lrbc_cli.arrays import Floats
from lrbc_cli.config import Campaign
from lrbc_cli.method.resolve import approach_of
from lrbc_cli.model.dofs import DofTable
from lrbc_cli.model.shifts import load_shifts


def check_drift(campaign: Campaign, acoustic: bool) -> None:
    """Raise a ConfigError if nuisance parameters are given without a reference job, or for the speed of sound in a model without air."""
    drift = campaign.update.nuisances.given
    if drift and approach_of(campaign) == "paper":
        raise campaign.error(
            "drift is given, but results are not compared with a reference job",
            "update",
            "nuisances",
            drift[0],
            expected="update.reference: the job with all bolts tight, and approach: bolts",
            hint="give it, or remove `nuisances`",
        )
    for key in ("temperature", "sound_speed"):
        if getattr(campaign.update.nuisances, key) is not None and not acoustic:
            raise campaign.error(
                "the model has no air whose speed of sound could vary",
                "update",
                "nuisances",
                key,
                expected="DOFs of component PRES",
                hint="remove it",
            )


def load_shift(campaign: Campaign, dofs: DofTable | None, dof: int, name: str) -> Floats:
    """(n, 2) derivatives of a unit load with respect to its offset along the surface [1/m]; ``dof`` is negative for a vector.

    Raises
    ------
    ConfigError
        If they are unknown.
    """
    found = load_shifts(dofs, dof) if dofs is not None and dof >= 0 else None
    if found is None:
        raise campaign.error(
            f"the effect of a shift of excitation {name} away from its node is unknown",
            "update",
            "nuisances",
            "hammer",
            expected="model.dofs, and an excitation by near: or node: on UX, UY or UZ",
            hint="remove nuisances.hammer, or excite at a node",
        )
    return found[0]
