"""Descents by Gauss-Newton on all values of theta or on unknowns z of a subspace, on measured lines or over smoothed spectra."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from lrbc_cli.arrays import Floats
from lrbc_cli.model.terms import Parameterisation
from lrbc_cli.updating.knots import hats
from lrbc_cli.updating.misfit.cost import Evaluation, Misfit
from lrbc_cli.updating.search.optimise import Objective, Solution, gauss_newton

#: Rounding error of sums: smaller differences of totals (relative) and of theta count as zero.
ROUND_OFF = 1e-9


def even_hats(positions: Floats, knots: int) -> Floats:
    """(k, m) weights of the piecewise linear interpolation from evenly spaced knots to k positions, without knots that reach none."""
    if knots == 1 or np.ptp(positions) == 0.0:
        return np.ones((positions.size, 1))
    at = np.linspace(positions[0], positions[-1], knots)
    T = hats(positions, at)
    return np.asarray(T[:, T.any(axis=0)])


def level_matrix(parameters: Parameterisation, knots: int, damping: bool) -> Floats:
    """(size, m) map T from the values at the knots of each group to theta; p_damp has a column of its own if ``damping``."""
    columns: list[Floats] = []
    for group, values, at in parameters.placed:
        positions = group.arc_length if group.arc_length is not None else np.arange(group.count, dtype=float)
        block = np.eye(group.count) if group.count <= knots else even_hats(positions, knots)
        columns.append(np.zeros((parameters.size, block.shape[1])))
        columns[-1][values] = block
        if at is not None and damping:
            columns.append(np.zeros((parameters.size, 1)))
            columns[-1][at] = 1.0
    return np.hstack(columns)


class Level:
    """The cost as a function of z in ``theta + T z``, about a fixed theta.

    Parameters
    ----------
    misfit : callable
    theta : (size,) float array
    T : (size, m) float array
        Hats of a coarse profile, or the span of the unknowns.
    """

    def __init__(self, misfit: Objective, theta: Floats, T: Floats) -> None:
        self._misfit, self._theta, self._T = misfit, theta, T

    def __call__(self, z: Floats) -> Evaluation:
        """Cost, with the Jacobian to z."""
        value = self._misfit(self.theta(z))
        return replace(value, jacobian=value.jacobian @ self._T)

    def theta(self, z: Floats) -> Floats:
        """(size,) ``theta + T z``."""
        return self._theta + self._T @ z

    def bounds(self, bounds: Floats) -> Floats:
        """(m, 2) bounds of z from the bounds (size, 2) of theta, each from the entries that have more than half of its largest weight."""
        low, high = bounds[:, 0] - self._theta, bounds[:, 1] - self._theta
        half = 0.5 * self._T.max(axis=0)
        inside = half < self._T
        return np.array([[low[column].max(), high[column].min()] for column in inside.T])


def admissible(misfit: Misfit, bounds: Floats, span: Floats | None) -> Callable[[Floats], bool]:
    """Test whether a theta can be a solution: inside its bounds and, with a span, equal to ``prior + span z`` with z inside its bounds."""

    def inside(values: Floats, box: Floats) -> bool:
        return bool(np.all((values >= box[:, 0] - ROUND_OFF) & (values <= box[:, 1] + ROUND_OFF)))

    if span is None:
        return lambda theta: inside(theta, bounds)
    T, inverse, box = span, np.linalg.pinv(span), Level(misfit, misfit.prior, span).bounds(bounds)

    def spanned(theta: Floats) -> bool:
        z = inverse @ (theta - misfit.prior)
        return inside(theta, bounds) and inside(z, box) and bool(np.abs(misfit.prior + T @ z - theta).max() <= ROUND_OFF)

    return spanned


def descend(
    misfit: Misfit,
    start: Floats,
    bounds: Floats,
    span: Floats | None = None,
    *,
    tolerance: float = 1e-4,
    max_iterations: int = 100,
    most_led: int = 50,
) -> Solution:
    """Gauss-Newton on all values, or on the unknowns z of ``prior + span z``; the Jacobian of the solution is to these.

    If the lines do not resolve the peaks (``misfit.sharp``), a second descent starts at the end of one with differences on Riemann's
    sphere, and the lower end is the solution. The descent on the sphere, in which poles may have to pass many lines, has ``most_led``
    iterations at most.
    """
    if not misfit.sharp:
        return _one_descent(misfit, start, bounds, span, tolerance, max_iterations)
    led = _one_descent(misfit.on_sphere(), start, bounds, span, tolerance, most_led)
    ends = [_one_descent(misfit, place, bounds, span, tolerance, max_iterations) for place in (start, led.theta)]
    best = min(ends, key=lambda end: end.evaluation.total if np.isfinite(end.evaluation.total) else np.inf)
    history = tuple(entry for end in ends for entry in end.history)
    return replace(best, evaluations=led.evaluations + len(history), history=history)


def _one_descent(misfit: Misfit, start: Floats, bounds: Floats, span: Floats | None, tolerance: float, max_iterations: int) -> Solution:
    if span is None:
        return gauss_newton(misfit, start, bounds, tolerance=tolerance, max_iterations=max_iterations)
    level = Level(misfit, misfit.prior, span)
    box = level.bounds(bounds)
    z = np.clip(np.linalg.lstsq(span, start - misfit.prior, rcond=None)[0], box[:, 0], box[:, 1])
    found = gauss_newton(level, z, box, tolerance=tolerance, max_iterations=max_iterations)
    return replace(found, theta=level.theta(found.theta))


def over_smoothed(
    wide: Sequence[Misfit], theta: Floats, bounds: Floats, span: Floats | None, *, tolerance: float = 1e-3, max_iterations: int = 20
) -> Solution:
    """Successive descents over smoothed spectra, widest first; the last one, with the evaluations of all."""
    evaluations = 0
    for misfit in wide:
        end = descend(misfit, theta, bounds, span, tolerance=tolerance, max_iterations=max_iterations)
        theta, evaluations = end.theta, evaluations + end.evaluations
    return replace(end, evaluations=evaluations)
