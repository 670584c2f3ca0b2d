"""95 % intervals from the posterior: of the stiffness along an edge and of the changes of joints, open to a side if saturated."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from lrbc_cli.arrays import Bools, Floats
from lrbc_cli.model.terms import LN10, ParameterGroup, Parameterisation
from lrbc_cli.updating.normal import NORMAL_95

#: 95 % quantile of chi-squared with one degree of freedom: limit for the increase of the data's sum of squares over their variance.
CHI2_95 = NORMAL_95**2


@dataclass(frozen=True)
class Band:
    """Uncertainty of the k effective values ``log10(W 10^p)`` of one group.

    Attributes
    ----------
    std : (k,) float array
        Standard deviations, linearised [decades].
    lower, upper : (k,) float arrays
        95 % limits; infinite on a side where the interval is open.
    """

    std: Floats
    lower: Floats
    upper: Floats


def band(group: ParameterGroup, p: Floats, covariance: Floats, opens: tuple[Bools, Bools]) -> Band:
    """Standard deviations and 95 % intervals of the effective values of a group.

    Parameters
    ----------
    group : ParameterGroup
    p : (k,) float array
        log10 values of the group.
    covariance : (k, k) float array
        Of p.
    opens : two (k,) bool arrays
        Whether an interval is open downwards, and upwards, see ``open_values``.

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
    """How far the 95 % interval of a joint's change extends below the linear one, if its predicted effect on the FRFs errs by a share.

    The FRFs determine a change by the path that they have moved, ``L(z) = integral of the speed from 0 to z``. If ``L`` has the relative
    standard deviation ``share``, changes up to ``L(z) = (1 + 1.96 share) L(change)`` are possible. For a nearly free joint, where FRFs
    hardly move, this z is far below the change, or the joint may be free. The part proportional to the change, ``1.96 share change``, is
    subtracted (in squares), because standard deviations already contain it.

    Parameters
    ----------
    change : float
        Identified change, negative [decades].
    steps : (k,) float array
        Changes from 0 down to that of a free joint [decades].
    speeds : (k,) float array
        Speed of the FRFs there [1/decade], see ``FrfModel.speeds``.
    share : float

    Returns
    -------
    float
        Zero or more [decades]; infinite if the joint may be free.
    """
    way = np.concatenate([[0.0], np.cumsum(0.5 * (speeds[1:] + speeds[:-1]) * np.abs(np.diff(steps)))])
    gone = float(np.interp(-change, -steps, way))
    most = (1.0 + NORMAL_95 * share) * gone
    if most >= way[-1]:
        return float(np.inf)
    reach = -float(np.interp(most, way, -steps)) - change
    return float(np.sqrt(max(reach**2 - (NORMAL_95 * share * change) ** 2, 0.0)))


def open_sides(data: Callable[[Floats], float], theta: Floats, patches: Floats, bounds: Floats, variance: float) -> tuple[Bools, Bools]:
    """Whether the data allow patches of values to be free (at their lower bound), or clamped (at their upper bound).

    Parameters
    ----------
    data : callable
        Sum of squares of the data residuals at theta [dB²].
    theta : (size,) float array
        The optimum.
    patches : (size, q) float array
        Patches of values, with weights from 0 to 1.
    bounds : (size, 2) float array
    variance : float
        Of a residual, correlation included [dB²].

    Returns
    -------
    down, up : (q,) bool arrays
        Whether moving a patch to its lower or upper bound raises the sum of squares by less than ``CHI2_95 variance``.
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
    """Whether the data allow each stiffness value to be free, or clamped: on an edge with all values within half a pitch of it.

    Parameters
    ----------
    parameters : Parameterisation
    pitch : float
        Of the bolts [m]; half of it is replaced by the median distance of the values if that is larger.
    data, theta, variance
        See ``open_sides``.

    Returns
    -------
    down, up : (size,) bool arrays
        Whether the interval is open to that side; False for entries of theta that are no stiffness.
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
