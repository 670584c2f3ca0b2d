"""Weight of the penalty at the corner of the L-curve (Hansen, *SIAM Review* 34 (1992) 561), as in the paper."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from lrbc_cli.arrays import Floats
from lrbc_cli.updating.misfit.cost import Misfit
from lrbc_cli.updating.peaks import peaks_of
from lrbc_cli.updating.search.descent import descend
from lrbc_cli.updating.search.levels import gauss_newton_by_levels
from lrbc_cli.updating.search.optimise import Solution


@dataclass(frozen=True, kw_only=True)
class Corner:
    """Corner of an L-curve: index of the nearest weight tried, the weight, and the sums of squares of data and departures there."""

    index: int
    eta: float
    data: float
    penalty: float


@dataclass(frozen=True, kw_only=True)
class LCurve:
    """Data and penalty of the minima at n weights.

    Attributes
    ----------
    eta : (n,) float array
        Weights, ascending [dB² per decade²].
    data : (n,) float array
        Sum of squares of the data residuals [dB²].
    penalty : (n,) float array
        Sum of squares of the penalised departures, without eta.
    corner : Corner or None
        None if the curve has none.
    chosen : float
        The weight at the corner, or the fallback.
    evaluations : int
    theta : (n, size) float array
        The minimum found at each weight.
    """

    eta: Floats
    data: Floats
    penalty: Floats
    corner: Corner | None
    chosen: float
    evaluations: int
    theta: Floats = field(repr=False)

    @property
    def nearest(self) -> Floats:
        """(size,) theta of the minimum at the weight nearest to the chosen one."""
        return np.asarray(self.theta[int(np.abs(np.log10(self.eta) - np.log10(max(self.chosen, np.finfo(float).tiny))).argmin())])


def natural_weight(misfit: Misfit, theta: Floats) -> float:
    """Weight at which a departure of every parameter by one decade costs as much as 1 dB in every residual.

    Parameters
    ----------
    misfit : Misfit
    theta : (size,) float array
        Any; only the number of residuals is used.
    """
    rows = misfit.rows
    residuals = misfit(theta).residual.size - rows.shape[0]
    return float(residuals / np.sum(rows**2))


def l_curve(
    misfit: Misfit,
    start: Floats,
    bounds: Floats,
    fallback: float | None = None,
    *,
    decades: float = 3.0,
    weights: int = 9,
    tolerance: float = 1e-3,
    iterations: int = 8,
    cheaper: float = 1e-9,
) -> LCurve:
    """L-curve of minima at weights from the largest to the smallest and back, each from several starts, and its corner.

    Along a curve of global minima the data misfit falls with the weight, and the departures rise. Ends in different basins need not do so.
    Therefore every weight is tried from the start and from the end of the weight before, the smallest also by levels (a strong penalty
    keeps the others in the basin of the prior), and finally from the end of any other weight whose cost is lower at this one.

    Parameters
    ----------
    misfit : Misfit
        Its own weight is not used; its penalty must have rows.
    start : (size,) float array
    bounds : (size, 2) float array
    fallback : float or None
        Weight if the curve has no corner; None for the natural one, see ``natural_weight``.
    decades, weights : float, int
        Range of the weights to either side of the natural one, and their number.
    tolerance, iterations : float, int
        Stop rule of a descent at a weight.
    cheaper : float
        The end at another weight is a start if its cost is lower by this share.

    Returns
    -------
    LCurve
    """
    natural = natural_weight(misfit, start)
    etas = natural * np.logspace(-decades, decades, weights)
    ends = _Ends(misfit, etas, bounds, tolerance, iterations)
    for i in reversed(range(weights)):
        ends.attempt(i, start)
        if i + 1 < weights:
            ends.attempt(i, ends.found[i + 1].theta)
    least = misfit.with_eta(float(etas[0]))
    ends.keep(0, gauss_newton_by_levels(least, start, bounds, tolerance=tolerance, max_iterations=4 * iterations))
    # Back to larger weights: a valley found at small ones is followed as long as it exists.
    for i in range(1, weights):
        ends.attempt(i, ends.found[i - 1].theta)
    data, penalty = ends.level_out(cheaper)
    corner = find_corner(etas, data, penalty)
    return LCurve(
        eta=etas,
        data=data,
        penalty=penalty,
        corner=corner,
        chosen=corner.eta if corner is not None else (natural if fallback is None else fallback),
        evaluations=ends.evaluations,
        theta=np.array([ends.found[i].theta for i in range(weights)]),
    )


class _Ends:
    """Collects the lowest end found at each weight."""

    def __init__(self, misfit: Misfit, etas: Floats, bounds: Floats, tolerance: float, iterations: int) -> None:
        self._misfit, self._etas, self._bounds, self._tolerance, self._iterations = misfit, etas, bounds, tolerance, iterations
        self.found: dict[int, Solution] = {}
        self.evaluations = 1

    def keep(self, i: int, solution: Solution) -> None:
        """Keep a solution at the i-th weight if it is the lowest so far."""
        self.evaluations += solution.evaluations
        if i not in self.found or solution.evaluation.total < self.found[i].evaluation.total:
            self.found[i] = solution

    def attempt(self, i: int, theta: Floats) -> None:
        """Descend at the i-th weight from theta."""
        misfit = self._misfit.with_eta(float(self._etas[i]))
        self.keep(i, descend(misfit, theta, self._bounds, tolerance=self._tolerance, max_iterations=self._iterations))

    def level_out(self, cheaper: float) -> tuple[Floats, Floats]:
        """Descend at each weight from the end of another one if its cost is lower there, until none is; gives ``curve`` then."""
        for _ in range(self._etas.size):
            data, penalty = self.curve()
            totals = data + self._etas[:, None] * penalty
            worse = np.flatnonzero(totals.min(axis=1) < (1 - cheaper) * np.diag(totals))
            if not worse.size:
                break
            thetas = [self.found[int(j)].theta for j in totals.argmin(axis=1)]
            for at in worse:
                self.attempt(int(at), thetas[at])
        return data, penalty

    def curve(self) -> tuple[Floats, Floats]:
        """(n,) sums of squares of the data residuals and (n,) of the departures at each weight."""
        ends = [self.found[i] for i in range(self._etas.size)]
        return np.array([end.evaluation.data for end in ends]), np.array([self._misfit.departures(end.theta) for end in ends])


def curvature(eta: Floats, data: Floats, penalty: Floats, *, width: float = 0.2, between: int = 60) -> tuple[Floats, Floats]:
    """Curvature along the L-curve; positive at a corner.

    The curve passes through the points without overshoot (monotone cubics of log10 data and log10 penalty over log10 eta) and is then
    smoothed over ``width``: at its steep ends many points nearly coincide, and the curvature of an unsmoothed curve would be that of
    errors of the optimiser's stop rule.

    Parameters
    ----------
    eta, data, penalty : (n,) float arrays
        Positive, eta ascending.
    width : float
        Standard deviation of the smoothing [decades along the curve].
    between : int
        Number of points of the curve between two weights.

    Returns
    -------
    points : (k, 3) float array
        log10 of weight, data and penalty, evenly spaced along the curve.
    kappa : (k,) float array
        [1/decade].
    """
    t = np.linspace(np.log10(eta[0]), np.log10(eta[-1]), between * (eta.size - 1) + 1)
    # Imported here: few campaigns choose their weight by an L-curve.
    from scipy.interpolate import PchipInterpolator
    from scipy.ndimage import gaussian_filter1d

    x, y = (PchipInterpolator(np.log10(eta), np.log10(values))(t) for values in (data, penalty))
    along = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(x), np.diff(y)))])
    if not along[-1] > 0.0:
        return np.column_stack([t, x, y]), np.zeros_like(t)
    # Weights at which the curve does not move have no arc length of their own: np.interp needs ascending values.
    moving = np.concatenate([[True], np.diff(along) > 1e-12 * along[-1]])
    s = np.linspace(0.0, along[-1], max(int(40 * along[-1] / width), 8))
    step = s[1]
    x, y, t = (np.interp(s, along[moving], values[moving]) for values in (x, y, t))
    dx, dy = (gaussian_filter1d(np.gradient(values, step), width / step, mode="nearest") for values in (x, y))
    turn = np.unwrap(np.arctan2(dy, dx))
    return np.column_stack([t, x, y]), np.asarray(np.gradient(turn, step))


def find_corner(eta: Floats, data: Floats, penalty: Floats, *, sharpness: float = 1.0) -> Corner | None:
    """Corner of an L-curve: the largest maximum of its curvature, without the first and last weight.

    Parameters
    ----------
    eta, data, penalty : (n,) float arrays
    sharpness : float
        Least curvature of a corner [1/decade]: that of a circle with a radius of one decade.

    Returns
    -------
    Corner or None
        None if the curve has none.
    """
    if not (np.all(data > 0) and np.all(penalty > 0)):
        return None
    points, kappa = curvature(eta, data, penalty)
    peaks = peaks_of(kappa, height=sharpness)
    t = np.log10(eta)
    inner = [peak for peak in peaks if t[1] <= points[peak, 0] <= t[-2]]
    if not inner:
        return None
    at = points[max(inner, key=lambda peak: kappa[peak])]
    weight, least, departure = (float(10.0**value) for value in at)
    return Corner(index=int(np.abs(t - at[0]).argmin()), eta=weight, data=least, penalty=departure)


def curve_notes(curve: LCurve) -> tuple[str, ...]:
    """A warning if an L-curve has no corner, else nothing."""
    if curve.corner is not None:
        return ()
    return (
        f"the L-curve has no corner between {curve.eta[0]:.3g} and {curve.eta[-1]:.3g} dB² per decade². "
        f"Regularisation {curve.chosen:.3g} was used, at which a change of every unknown by a decade costs as much as 1 dB in every "
        "residual. Choose one by hand, for all jobs",
    )
