"""Jobs that are taken as tight, and look as if bolts were free."""

from __future__ import annotations

import numpy as np

from lrbc_cli.arrays import Complexes, Integers
from lrbc_cli.campaign.identification.compared.likeness import CLEARLY, LEAST_DIFFERENCE, apart
from lrbc_cli.campaign.reading.inputs import Inputs
from lrbc_cli.model.terms import Parameterisation

#: From so much on, in the median over the responses used, the tight state is no model's with small errors [dB].
UNLIKE = 6.0


def taken_as_tight(inputs: Inputs) -> set[str]:
    """Jobs other than the reference job in which all bolts are taken as tight."""
    campaign = inputs.campaign
    return {*campaign.update.baselines, *([campaign.calibration.job] if campaign.calibration is not None else [])}


def not_tight(inputs: Inputs, name: str, own: Complexes, states: Complexes, loosened: list[Integers], parameters: Parameterisation) -> str:
    """What to say of a job that is taken as tight and lies far from the reference job, by the keys that take it so; empty where it is near.

    Tight states put together anew lie nearer to each other than models and measurements do, whatever it is that is another there.
    """
    before = float(np.median(apart(own, states[0])))
    freed = looser(inputs, own, states, loosened, parameters, before) if before > LEAST_DIFFERENCE else ""
    if not freed and before <= UNLIKE:
        return ""
    campaign, fixes = inputs.campaign, list[str]()
    if name in campaign.update.baselines:
        fixes.append("take it out of update.baselines")
    if campaign.calibration is not None and campaign.calibration.job == name:
        fixes.append("name a tight job under calibration.job")
    fix = " and ".join(fixes)
    return (
        f"it is taken as tight, but lies {before:.1f} dB from {campaign.update.reference}{freed or ': was all tight there?'} "
        f"{fix[:1].upper()}{fix[1:]}, or measure it again"
    )


def looser(
    inputs: Inputs, measured: Complexes, states: Complexes, loosened: list[Integers], parameters: Parameterisation, typical: float
) -> str:
    """What the tight state looks like where some values are free, in a clause; empty where that is not clearly nearer."""
    distances = np.median(apart(measured, states[: len(loosened)]), axis=1)
    best = int(np.argmin(distances))
    if distances[best] > CLEARLY * typical or not loosened[best].size:
        return ""
    for group, where, _ in parameters.placed:
        if where.start <= loosened[best][0] < where.stop:
            at = loosened[best] - where.start
            owners = [] if group.bolt is None or inputs.bolts is None else [inputs.bolts.name[b] for b in group.bolt[at] if b >= 0]
            named = ", ".join(dict.fromkeys(owners)) or f"values {at[0] + 1} to {at[-1] + 1} of parameters.{group.name}"
            return f". With {named} free they are {distances[best]:.1f} dB apart: was all tight there?"
    return ""
