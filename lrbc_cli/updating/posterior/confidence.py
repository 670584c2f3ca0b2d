"""From the posterior to what a reader wants: confidence intervals along the edge, closed or open to one side."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from lrbc_cli.arrays import Bools, Floats
from lrbc_cli.model.terms import LN10, ParameterGroup, Parameterisation
from lrbc_cli.updating.normal import NORMAL_95

#: Increase of the data's sum of squares over the noise that 95 % of fluctuations do not reach (chi-squared, one unknown).
CHI2_95 = NORMAL_95**2


@dataclass(frozen=True)
class Band:
    """Confidence along one group.

    Attributes
    ----------
    std : (k,) float array
        Of log10(W 10^p), linearised.
    lower, upper : (k,) float arrays
        95 % limits of log10(W 10^p); infinite where the data say nothing to that side.
    """

    std: Floats
    lower: Floats
    upper: Floats


def band(group: ParameterGroup, p: Floats, covariance: Floats, opens: tuple[Bools, Bools]) -> Band:
    """Confidence of the effective values of a group.

    Parameters
    ----------
    group : ParameterGroup
    p : (k,) float array
    covariance : (k, k) float array
        Of p.
    opens : two (k,) bool arrays
        Where the interval opens downwards and upwards.

    Returns
    -------
    Band
    """
    values = group.values(p)
    J = group.value_jacobian(p) / (LN10 * values[:, None])
    variance = np.maximum(np.einsum("ij,jk,ik->i", J, covariance, J), 0.0)
    std = np.sqrt(variance)
    centre = np.log10(values)
    lower = np.where(opens[0], -np.inf, centre - NORMAL_95 * std)
    upper = np.where(opens[1], np.inf, centre + NORMAL_95 * std)
    return Band(std, lower, upper)


def beyond_errors(change: float, steps: Floats, speeds: Floats, share: float) -> float:
    """How much further a joint may have loosened where its predicted effect is wrong by a share, common to all resonances [decades].

    FRFs tell a change by the way that they have gone with it, ``L(z) = integral of the speed from 0 to z``. What errs by ``share L``
    (standard deviation) is compatible with changes up to ``L(z) = (1 + 1.96 share) L(change)``: where FRFs hardly move any more, a joint
    that is nearly free, that is far from the change, or free. Of it the part that is proportional to the change, ``1.96 share change``,
    is taken out, in squares: standard deviations hold it.

    Parameters
    ----------
    change : float
        Negative.
    steps : (k,) float array
        From 0 down to where the joint is free; [decades], as ``change``.
    speeds : (k,) float array
        Of the FRFs there, see ``FrfModel.speeds``.
    share : float

    Returns
    -------
    float
        Zero or more; infinite where it may be free.
    """
    way = np.concatenate([[0.0], np.cumsum(0.5 * (speeds[1:] + speeds[:-1]) * np.abs(np.diff(steps)))])
    gone = float(np.interp(-change, -steps, way))
    most = (1.0 + NORMAL_95 * share) * gone
    if most >= way[-1]:
        return float(np.inf)
    reach = -float(np.interp(most, way, -steps)) - change
    return float(np.sqrt(max(reach**2 - (NORMAL_95 * share * change) ** 2, 0.0)))


def open_sides(data: Callable[[Floats], float], theta: Floats, patches: Floats, bounds: Floats, variance: float) -> tuple[Bools, Bools]:
    """Where the data do not object to a stretch of the edge being free, or clamped.

    Parameters
    ----------
    data : callable
        Sum of squares of the data residuals at theta.
    theta : (size,) float array
    patches : (size, q) float array
        Stretches of an edge, weights from 0 to 1.
    bounds : (size, 2) float array
    variance : float
        Of the noise, correlation included.

    Returns
    -------
    down, up : (q,) bool arrays
        Whether moving the stretch to its lower or upper bound costs less than ``CHI2_95``.
    """
    base = data(theta)
    found = []
    for side in (0, 1):
        limit = bounds[:, side]
        costs = [data(theta + patch * (limit - theta)) - base for patch in patches.T]
        found.append(np.array(costs, dtype=float) < CHI2_95 * variance)
    return found[0], found[1]


def open_values(
    parameters: Parameterisation, pitch: float, data: Callable[[Floats], float], theta: Floats, variance: float
) -> tuple[Bools, Bools]:
    """Where the data do not object to a stretch of half a pitch about a stiffness value, or to a joint's value, being free, or clamped.

    Parameters
    ----------
    parameters : Parameterisation
    pitch : float
        Of the bolts [m]; the distance of the values counts where it is larger.
    data, theta, variance
        See ``open_sides``.

    Returns
    -------
    down, up : (size,) bool arrays
        False for values that are no stiffness.
    """
    size = parameters.size
    patches, owner = [], []
    for group, values, _ in parameters.placed:
        if group.kind != "stiffness":
            continue
        at = group.arc_length if group.arc_length is not None else np.arange(group.count, dtype=float)
        half = max(0.5 * pitch, float(np.median(np.diff(at)))) if group.count > 1 and group.bolt is None else 0.0
        for k in range(group.count):
            patch = np.zeros(size)
            patch[values] = np.abs(at - at[k]) <= half * (1 + 1e-9)
            patches.append(patch)
            owner.append(values.start + k)
    down, up = np.zeros(size, dtype=bool), np.zeros(size, dtype=bool)
    if patches:
        down[owner], up[owner] = open_sides(data, theta, np.column_stack(patches), parameters.bounds, variance)
    return down, up
