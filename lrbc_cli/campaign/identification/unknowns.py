"""Unknowns and lines of one job: start values, bounds, values taken from earlier results, penalty, and the lines that enter the cost."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from lrbc_cli.arrays import Complexes, Floats, Integers, spaced
from lrbc_cli.campaign.identification.records import Measurement
from lrbc_cli.campaign.reading.inputs import Inputs, TermGroup
from lrbc_cli.campaign.reduced.stage import FrfSource
from lrbc_cli.config.settings import EveryLine, ListedLines
from lrbc_cli.errors import ConfigError, DataError
from lrbc_cli.method.resolve import Method
from lrbc_cli.model.terms import EdgeDamping, ParameterGroup, Parameterisation, smoothing_matrix
from lrbc_cli.reduction.problem.vectors import band_omega, local_scale
from lrbc_cli.reduction.steps.grid import band_lines
from lrbc_cli.updating.judging.reference import ReferenceState
from lrbc_cli.updating.misfit.cost import penalty_rows
from lrbc_cli.updating.statistics.lines import resonance_lines
from lrbc_cli.updating.statistics.priors import ValuePrior
from lrbc_cli.updating.statistics.saturation import Saturation, saturation
from lrbc_cli.updating.statistics.thinning import thinned
from lrbc_cli.updating.unknowns.shapes import Shapes


def parameterise(inputs: Inputs, source: FrfSource, s: Complexes) -> tuple[Parameterisation, dict[str, Saturation]]:
    """Start values, bounds and smoothing of every group; ``auto`` is resolved by the FRFs at the lines s, once per set of lines.

    Parameters
    ----------
    inputs : Inputs
    source : FrfSource
    s : (F,) complex array
        i omega of the lines [rad/s].

    Returns
    -------
    Parameterisation
    dict
        Stiffnesses at which the FRFs saturate, by stiffness group.
    """
    key = s.tobytes()
    if key not in source.known:
        source.known[key] = _parameterise(inputs, source, s)
    found: tuple[Parameterisation, dict[str, Saturation]] = source.known[key]
    return found


def _parameterise(inputs: Inputs, source: FrfSource, s: Complexes, terms: int = 120) -> tuple[Parameterisation, dict[str, Saturation]]:
    """See ``parameterise``; saturation is determined on ``source.most_lines``, and on fewer with more than ``terms`` terms."""
    model = inputs.model
    s = s if source.most_lines is None else s[spaced(s.size, source.most_lines)]
    scale = local_scale(model.K, model.M, model.terms, band_omega(model.K, model.M, inputs.campaign.reduction.band))
    # While one group is examined, the others have their start values, or the local stiffness if these are not known yet.
    nominal = np.array(scale)
    for group in inputs.groups:
        if group.config.start is not None:
            nominal[group.terms] = 10.0**group.config.start
    D = nominal * s[:, None] ** model.terms.power
    found: dict[str, Saturation] = {}
    groups = []
    for group in inputs.groups:
        limits: Saturation | None = None
        if group.config.kind == "stiffness":
            empty = Parameterisation(())
            # An evaluation costs the cube of the number of terms.
            lines = np.arange(0, s.size, max(1, round((model.terms.size / terms) ** 2)))
            values = source.model(s, empty, lines, inputs.used).values
            typical = float(np.exp(np.mean(np.log(scale[group.terms]))))
            limits = saturation(values, D[lines], group.terms, typical, limits=inputs.statistics.limits)
            if group.config.start is not None:
                # A weak spring needs room to loosen although the FRFs do not respond to it: the other springs of its bolt lose as much.
                limits = replace(limits, lower=min(limits.lower, group.config.start + inputs.statistics.limits.fallback[0]))
            found[group.name] = limits
        groups.append(_group(group, limits))
    return Parameterisation(tuple(groups)), found


def start_parameters(inputs: Inputs, source: FrfSource) -> Parameterisation:
    """Start values and bounds without a measurement: ``auto`` is resolved at the 1 Hz lines of the band, not at measured ones."""
    if not found_on_frfs(inputs):
        return layout(inputs)
    return parameterise(inputs, source, 2j * np.pi * band_lines(inputs.campaign.reduction.band))[0]


def found_on_frfs(inputs: Inputs) -> bool:
    """Whether start values or bounds are ``auto``."""
    return any(group.config.start is None or group.config.bounds == "auto" for group in inputs.groups)


def layout(inputs: Inputs) -> Parameterisation:
    """Groups with their sizes only; start values and bounds that are ``auto`` are placeholders (0; -1 and 1)."""
    return Parameterisation(tuple(_group(group, Saturation(0.0, -1.0, 1.0, False)) for group in inputs.groups))


def _group(group: TermGroup, limits: Saturation | None) -> ParameterGroup:
    config, count = group.config, group.count
    W = smoothing_matrix(config.smoothing, count, config.normalised)
    if np.any(W.sum(axis=1) <= 0):
        raise ConfigError(
            "these smoothing weights leave a term without stiffness",
            place=f"parameters.{group.name}.smoothing",
            expected="a positive weight in the middle",
            found=str(list(config.smoothing or ())),
        )
    if config.bounds != "auto":
        low, high = config.bounds
    else:
        assert limits is not None
        low, high = limits.lower, limits.upper
    if config.start is not None:
        start = float(config.start)
        low, high = (min(low, start), max(high, start)) if config.bounds == "auto" else (low, high)
    else:
        assert limits is not None
        start = float(np.clip(limits.start, low, high))
    damping = None
    if group.damping is not None:
        damping = EdgeDamping(beta=group.beta, initial=group.damping.initial, bounds=group.damping.bounds, loss_factor=group.loss_factor)
    return ParameterGroup(
        name=group.name,
        kind=config.kind,
        terms=group.terms,
        parameter=group.parameter,
        initial=np.full(count, start),
        bounds=np.tile([low, high], (count, 1)),
        smoothing=W,
        damping=damping,
        xyz=group.xyz,
        arc_length=group.arc_length,
        bolt=group.bolt,
    )


class GroupValues(Protocol):
    """Identified values of one group, in a result, a reference state or a calibration."""

    @property
    def log10(self) -> Floats:
        """(k,) float array of log10 values."""

    @property
    def damping_exponent(self) -> float | None:
        """Exponent p_damp of eq. (33); None without tied damping."""


def theta_of(parameters: Parameterisation, groups: Mapping[str, GroupValues]) -> Floats | None:
    """(size,) theta with the values of ``groups``; None if a group is missing, or differs in size or damping."""
    theta = parameters.initial
    for group, where, at in parameters.placed:
        stored = groups.get(group.name)
        if stored is None or len(stored.log10) != group.count or (at is not None) != (stored.damping_exponent is not None):
            return None
        theta[where] = stored.log10
        if at is not None:
            theta[at] = stored.damping_exponent
    return theta


def with_values(parameters: Parameterisation, theta: ArrayLike | None, log10: Mapping[str, ArrayLike], file: Path) -> Floats:
    """(size,) theta (None: the start values) with some values replaced, by name of the group or ``GROUP.damping``.

    Raises
    ------
    ConfigError
        If a group is unknown (names the campaign file), or values are no numbers, NaN, or of the wrong count.
    """
    found = parameters.initial

    def put(name: str, part: Floats, value: ArrayLike) -> None:
        try:
            values = np.asarray(value, dtype=float)
        except (TypeError, ValueError) as error:
            raise ConfigError(f"no numbers for {name}", expected="log10 values", found=str(value)) from error
        if values.shape not in ((), part.shape):
            raise ConfigError(f"the number of values does not fit {name}", expected=f"1 or {part.size}", found=values.size)
        if np.isnan(values).any():
            raise ConfigError(f"NaN is not a value of {name}", expected="log10 values, inf clamps and -inf frees", found="NaN")
        part[...] = values

    if theta is not None:
        put("theta", found, theta)
    places: dict[str, slice] = {}
    for group, where, at in parameters.placed:
        places |= {group.name: where} | ({} if at is None else {f"{group.name}.damping": slice(at, at + 1)})
    for name, value in log10.items():
        if name not in places:
            raise ConfigError(f"no parameter group '{name}'", file=file, expected=", ".join(places), found=name)
        put(name, found[places[name]], value)
    return found


def calibrated_start(inputs: Inputs, parameters: Parameterisation) -> dict[str, Floats]:
    """Theta that the calibration identified beside its factors, by description: a start for jobs without reference; may be empty."""
    use = inputs.calibration
    found = None if use is None or not use.used else theta_of(parameters, use.boundary)
    return {} if found is None else {"the state found by the calibration": np.clip(found, *parameters.bounds.T)}


def stored_covariance(parameters: Parameterisation, reference: ReferenceState | None) -> Floats:
    """(size, size) covariance of theta in the reference state; zero if none is stored."""
    size = (parameters.size, parameters.size)
    stored = None if reference is None else reference.covariance
    return np.zeros(size) if stored is None or stored.shape != size else stored


def select_lines(inputs: Inputs, measurement: Measurement, name: str) -> tuple[Integers, Integers]:
    """Indices of the lines that enter the cost, by ``update.lines``, and of all lines of the resonances to which they belong.

    Raises
    ------
    DataError
        If a listed line was not measured.
    """
    lines = inputs.method.lines
    frequency = measurement.frequency_hz
    if isinstance(lines, EveryLine):
        chosen = np.arange(0, frequency.size, lines.every)
        return chosen, chosen
    if isinstance(lines, ListedLines):
        wanted = np.sort(np.array(lines.frequencies, dtype=float))
        distance = np.abs(frequency[None, :] - wanted[:, None])
        nearest = distance.argmin(axis=1)
        step = np.median(np.diff(frequency)) if frequency.size > 1 else 0.0
        off = distance[np.arange(wanted.size), nearest] > 0.5 * step + 1e-9 * wanted
        if off.any():
            raise DataError(
                "a listed frequency line was not measured",
                file=inputs.campaign.jobs[name].first,
                place=f"job {name}",
                expected=f"lines from {frequency[0]:g} to {frequency[-1]:g} Hz",
                found=", ".join(f"{f:g} Hz" for f in wanted[off][:5]),
                hint="correct update.lines",
            )
        return np.unique(nearest), np.unique(nearest)
    if lines == "all":
        return np.arange(frequency.size), np.arange(frequency.size)
    values, rule = measurement.values[:, inputs.used], inputs.statistics.resonances
    near = resonance_lines(frequency, values, rule)
    return thinned(frequency, values, near, rule), near


def penalty_of(method: Method, values: ValuePrior, parameters: Parameterisation, shapes: Shapes, against_reference: bool) -> Floats:
    """Rows R of the penalty (guide page *statistics*, section 5): in standard deviations of the prior if its weight follows the noise."""
    if shapes.by_bolt:
        return shapes.penalty()
    if not method.follows_noise:
        return penalty_rows(parameters)
    if against_reference:
        return penalty_rows(parameters) / values.std
    # Without a reference state the level is uncertain, but neighbours are similar.
    return penalty_rows(parameters, values.level_std**-2, values.std**-2)
