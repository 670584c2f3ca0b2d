"""One updating job: from a measurement to identified parameters."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lrbc_cli.campaign.inputs import Inputs, TermGroup
from lrbc_cli.campaign.records import Measurement, read_measurement
from lrbc_cli.campaign.stage import FrfSource
from lrbc_cli.campaign.weights import line_weights, residual_options
from lrbc_cli.config.settings import DEFAULT_REGULARISATION, EveryLine, ListedLines
from lrbc_cli.errors import ConfigError, DataError, NumericalError
from lrbc_cli.model.terms import EdgeDamping, ParameterGroup, Parameterisation, smoothing_matrix
from lrbc_cli.reduction.vectors import local_scale
from lrbc_cli.updating.lcurve import LCurve, l_curve
from lrbc_cli.updating.levels import gauss_newton_by_levels
from lrbc_cli.updating.lines import resonance_lines
from lrbc_cli.updating.misfit import Misfit, mean_misfit, penalty_rows
from lrbc_cli.updating.optimise import Solution, bfgs
from lrbc_cli.updating.saturation import Saturation, saturation

log = logging.getLogger(__name__)

Floats = NDArray[np.float64]
Complexes = NDArray[np.complexfloating[Any, Any]]


@dataclass(frozen=True)
class Identification:
    """Result of one job.

    Attributes
    ----------
    name : str
    solution : Solution
    parameters : Parameterisation
    saturations : dict
        By stiffness group.
    measurement : Measurement
    selected : int array
        Lines that entered the cost.
    initial, updated : (F, R) complex arrays
        FRFs of the model on all measured lines.
    misfit_initial, misfit_final : (R,) float arrays
        Mean absolute dB difference over all lines of the band.
    notes : tuple of str
        On weights and on the choice of the regularisation.
    cost_initial : float
    line_evaluations : int
    seconds : dict
    regularisation : float
        The weight eta that was used.
    l_curve : LCurve or None
        From which it was chosen.
    """

    name: str
    solution: Solution
    parameters: Parameterisation
    saturations: dict[str, Saturation]
    measurement: Measurement = field(repr=False)
    selected: NDArray[np.int64] = field(repr=False)
    initial: Complexes = field(repr=False)
    updated: Complexes = field(repr=False)
    misfit_initial: Floats = field(repr=False)
    misfit_final: Floats = field(repr=False)
    notes: tuple[str, ...] = ()
    cost_initial: float = 0.0
    line_evaluations: int = 0
    seconds: dict[str, float] = field(default_factory=dict)
    regularisation: float = 0.0
    l_curve: LCurve | None = None


def parameterise(inputs: Inputs, source: FrfSource, s: Complexes) -> tuple[Parameterisation, dict[str, Saturation]]:
    """Start values, bounds and smoothing of every group; ``auto`` is resolved on the lines s.

    Returns
    -------
    Parameterisation
    dict
        Where the FRFs saturate, by stiffness group.
    """
    model = inputs.model
    scale = local_scale(model.K, model.M, model.terms, 2 * np.pi * inputs.campaign.reduction.band[1])
    # Other groups stand at their start values, or at their local stiffness while those are unknown.
    nominal = np.array(scale)
    for group in inputs.groups:
        if group.config.initial != "auto":
            nominal[group.terms] = 10.0**group.config.initial
    D = (nominal - model.terms.baseline) * s[:, None] ** model.terms.power
    found: dict[str, Saturation] = {}
    groups = []
    for group in inputs.groups:
        limits: Saturation | None = None
        if group.config.kind == "stiffness":
            empty = Parameterisation(())
            values = source.model(s, empty, responses=inputs.used).values
            typical = float(np.exp(np.mean(np.log(scale[group.terms]))))
            limits = found[group.name] = saturation(values, D, group.terms, typical, group.config.baseline)
        groups.append(_group(group, limits))
    return Parameterisation(tuple(groups)), found


def _group(group: TermGroup, limits: Saturation | None) -> ParameterGroup:
    config, count = group.config, group.count
    W = smoothing_matrix(config.smoothing, count, config.normalised)
    if np.any(W.sum(axis=1) <= 0):
        raise ConfigError(
            "smoothing weights that leave a term without stiffness",
            place=f"parameters.{group.name}.smoothing",
            expected="a positive weight in the middle",
            found=str(list(config.smoothing or ())),
        )
    if config.bounds != "auto":
        low, high = config.bounds
    else:
        assert limits is not None
        low, high = limits.lower, limits.upper
    if config.initial != "auto":
        start = float(config.initial)
        low, high = (min(low, start), max(high, start)) if config.bounds == "auto" else (low, high)
    else:
        assert limits is not None
        start = float(np.clip(limits.start, low, high))
    damping = None
    if config.damping is not None:
        damping = EdgeDamping(group.beta, config.damping.initial, config.damping.bounds)
    return ParameterGroup(
        group.name,
        config.kind,
        group.terms,
        group.parameter,
        np.full(count, start),
        np.tile([low, high], (count, 1)),
        W,
        config.baseline,
        damping,
        group.xyz,
        group.arc_length,
    )


def stored_theta(parameters: Parameterisation, tree: Mapping[str, Any] | None) -> Floats | None:
    """Theta of a stored result; None where there is none or it belongs to other groups."""
    if tree is None or tree.get("status") == "failed":
        return None
    theta = parameters.initial
    for group, (where, at) in zip(parameters.groups, parameters.slices, strict=True):
        stored = tree["parameters"].get(group.name)
        if stored is None or len(stored["log10"]) != group.count or (at is not None) != ("damping_exponent" in stored):
            return None
        theta[where] = stored["log10"]
        if at is not None:
            theta[at] = stored["damping_exponent"]
    return theta


def select_lines(inputs: Inputs, measurement: Measurement, name: str, model: Callable[[], Complexes] | None = None) -> NDArray[np.int64]:
    """Indices of the lines that enter the cost; for ``resonances-both`` the model gives its (F, U) FRFs at the prior.

    Raises
    ------
    DataError
        Where a listed line was not measured.
    """
    lines = inputs.campaign.update.lines
    frequency = measurement.frequency_hz
    if isinstance(lines, EveryLine):
        return np.arange(0, frequency.size, lines.every)
    if isinstance(lines, ListedLines):
        wanted = np.sort(np.array(lines.frequencies, dtype=float))
        distance = np.abs(frequency[None, :] - wanted[:, None])
        nearest = distance.argmin(axis=1)
        step = np.median(np.diff(frequency)) if frequency.size > 1 else 0.0
        off = distance[np.arange(wanted.size), nearest] > 0.5 * step + 1e-9 * wanted
        if off.any():
            raise DataError(
                "a listed line was not measured",
                file=inputs.campaign.jobs[name].frf,
                place=f"job {name}",
                expected=f"lines from {frequency[0]:g} to {frequency[-1]:g} Hz",
                found=", ".join(f"{f:g} Hz" for f in wanted[off][:5]),
                hint="correct update.lines",
            )
        return np.unique(nearest)
    if lines == "all":
        return np.arange(frequency.size)
    both = model() if lines == "resonances-both" and model is not None else None
    return resonance_lines(frequency, measurement.values[:, inputs.used], both)


def curve_notes(curve: LCurve) -> tuple[str, ...]:
    """A warning where an L-curve has no corner."""
    if curve.corner is not None:
        return ()
    return (
        f"the L-curve has no corner between {curve.eta[0]:.3g} and {curve.eta[-1]:.3g} dB² per decade²; "
        f"regularisation {curve.chosen:g}, the default, was used: choose one by hand, for all jobs",
    )


def identify(inputs: Inputs, source: FrfSource, name: str, reference: Mapping[str, Any] | None = None) -> Identification:
    """Run one job.

    Parameters
    ----------
    inputs : Inputs
    source : FrfSource
    name : str
    reference : mapping or None
        Stored result of the reference job, for ``update.prior: reference``.

    Returns
    -------
    Identification

    Raises
    ------
    DataError
        Where its measurement is unusable.
    NumericalError
        Where the optimisation fails.
    """
    start = time.perf_counter()
    settings = inputs.campaign.update
    measurement = read_measurement(inputs, inputs.campaign.jobs[name], name)
    for warning in measurement.warnings:
        log.warning("job %s: %s", name, warning)
    read = time.perf_counter()
    s = 2j * np.pi * measurement.frequency_hz
    parameters, limits = parameterise(inputs, source, s)
    theta0 = parameters.initial
    prior = None
    if settings.prior == "reference" and settings.reference != name:
        prior = stored_theta(parameters, reference)
        if prior is None:
            raise DataError(
                "the reference job has no result to serve as the prior",
                file=inputs.campaign.path,
                place=f"job {name}",
                expected=f"a result of job {settings.reference} for the same parameter groups",
                hint=f"see why {settings.reference} failed, or set update.prior: initial",
            )
    if prior is None:
        prior = theta0
    selected = select_lines(inputs, measurement, name, lambda: source.model(s, parameters, responses=inputs.used).frf(prior))
    model = source.model(s, parameters, selected, inputs.used)
    ports = time.perf_counter()
    measured = measurement.values[np.ix_(selected, inputs.used)]
    about = settings.penalty
    penalty = penalty_rows(parameters, about.value, about.slope, about.curvature)
    weights, notes = line_weights(inputs, measurement, inputs.campaign.jobs[name], selected)
    eta = 0.0 if settings.regularisation == "l-curve" else settings.regularisation
    misfit = Misfit(model, measured, prior, eta, penalty, residual_options(settings), weights)
    curve, further = None, {}
    if settings.regularisation == "l-curve":
        curve = l_curve(misfit, theta0, parameters.bounds, DEFAULT_REGULARISATION)
        misfit = misfit.with_eta(curve.chosen)
        further = {"end of the L-curve": curve.nearest}
        notes = (*notes, *curve_notes(curve))
    if settings.method == "bfgs":
        solution = bfgs(misfit, theta0, parameters.bounds, tolerance=settings.tolerance or 1e-3, max_iterations=settings.max_iterations)
    else:
        solution = gauss_newton_by_levels(
            misfit,
            theta0,
            parameters.bounds,
            tolerance=settings.tolerance or 1e-4,
            max_iterations=settings.max_iterations,
            further=further,
        )
    if solution.status == "failed":
        raise NumericalError(f"job {name}: {solution.reason}")
    optimised = time.perf_counter()
    band = source.model(s, parameters)
    initial, updated = band.frf(theta0), band.frf(solution.theta)
    return Identification(
        name,
        solution,
        parameters,
        limits,
        measurement,
        selected,
        initial,
        updated,
        mean_misfit(initial, measurement.values),
        mean_misfit(updated, measurement.values),
        notes,
        solution.history[0].cost,
        (solution.evaluations + (curve.evaluations if curve else 0)) * misfit.lines,
        {"read": read - start, "port": ports - read, "optimise": optimised - ports, "total": time.perf_counter() - start},
        misfit.eta,
        curve,
    )
