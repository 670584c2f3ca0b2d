"""Detects a sensor, or a hammer point, whose FRFs alone fit worse than in the reference job: it was moved, turned or came loose."""

from __future__ import annotations

import numpy as np

from lrbc_cli.arrays import Integers
from lrbc_cli.campaign.identification.compared.sensors import ends_of, standing_out
from lrbc_cli.campaign.identification.found import Identification
from lrbc_cli.campaign.reading.inputs import Inputs
from lrbc_cli.errors import listing
from lrbc_cli.updating.misfit.cost import mean_misfit


def astray(inputs: Inputs, result: Identification) -> tuple[str, str]:
    """That the FRFs of one sensor or hammer point do not fit, as a clause, and what to check; empty texts if all do.

    A bolt changes the FRFs of all sensors, and a robust cost leaves out what does not fit, so the others may fit well beside a sensor that
    was turned. It stands out by its excess over the misfit in the reference job, by ``ErrorModel.astray_db``, see ``sensors.standing_out``.
    """
    if result.expected is None:
        return "", ""
    # The expected FRFs over the model's are the measured ones of the reference job over the model's: its error there.
    before, after = mean_misfit(result.updated, result.expected), mean_misfit(result.updated, result.measurement.values)
    excess, ends = after - before, list(ends_of(inputs))
    found = standing_out(excess, [own for _, own in ends], inputs.statistics.errors.astray_db)
    if found is None:
        return "", ""
    known, kind = np.flatnonzero(np.isfinite(excess)), ends[found][0]
    at, rest = known[np.isin(known, ends[found][1])], known[~np.isin(known, ends[found][1])]
    there = inputs.campaign.update.reference

    def sizes(which: Integers) -> str:
        return f"{np.median(after[which]):.1f} dB, in {there} {np.median(before[which]):.1f} dB"

    if kind == "sensor":
        who, fault = (
            f"one sensor ({listing([inputs.responses[i].name for i in at], 4)})",
            "it was moved, turned or exchanged, or came loose",
        )
    else:
        who = f"hammer point {inputs.excitations[inputs.responses[int(at[0])].input]}"
        fault = "the hammer hit elsewhere, in another direction or twice"
    told = f"the FRFs of {who} do not fit: misfit {sizes(at)}"
    beside = ", except perhaps one that is loose right beside it" if kind == "sensor" else ""
    return told, f"{told}; the others fit ({sizes(rest)}), so no bolt explains it{beside}. Check whether {fault}, and measure again"
