"""Jobs that were measured with another chain than the reference job, or with more noise."""

from __future__ import annotations

from lrbc_cli.campaign.identification.compared.doubts import FAR_ABOVE_NOISE
from lrbc_cli.campaign.identification.records import Measurement, unlike
from lrbc_cli.campaign.reading.inputs import Inputs
from lrbc_cli.model.factors import SOUND_SPEED
from lrbc_cli.updating.statistics.chain.echo import second_blow
from lrbc_cli.updating.statistics.chain.modal import other_chain
from lrbc_cli.updating.statistics.lines import line_noise


def noise_doubt(own: Measurement, tight: Measurement, reference: str, *, least: float = 0.1) -> str | None:
    """What to say of a job whose single lines scatter far more than those of the reference job; None where they do not.

    Parameters
    ----------
    own, tight : Measurement
        On the same lines, or nothing is compared.
    reference : str
        Name of the reference job.
    least : float
        Noise over size from which it counts: half a decibel in the mean, of the one that a fit is wanted to leave.
    """
    if own.values.shape != tight.values.shape or unlike(own.frequency_hz, tight.frequency_hz):
        return None
    noise, other = line_noise(own.values), line_noise(tight.values)
    if not noise > max(least, FAR_ABOVE_NOISE * other):
        return None
    return (
        f"noise of {noise:.0%} of the size of each line, in the median over all lines, {other:.1%} in {reference}: too few averages, a "
        "weak or a double blow, or noise of the surroundings; expected: what is measured in the other jobs. Measure it again with more "
        "averages, each blow looked at"
    )


def chain_doubt(inputs: Inputs, own: Measurement, tight: Measurement, reference: str) -> str | None:
    """What to say of a job that was measured with another window, filter or clock than the reference job, or hit twice; None where not.

    Parameters
    ----------
    inputs : Inputs
    own, tight : Measurement
        On the same lines, or nothing is compared.
    reference : str
        Name of the reference job.
    """
    if own.values.shape != tight.values.shape or unlike(own.frequency_hz, tight.frequency_hz):
        return None
    names, air = [response.name for response in inputs.responses], SOUND_SPEED in inputs.recipe.names
    blow = second_blow(own.frequency_hz, own.values, tight.values, reference)
    return blow or other_chain(own.frequency_hz, own.values, tight.values, reference, names, inputs.statistics.modal, air=air)
