"""States with which ``lrbc check`` compares a measurement: the model, tight or with bolts loosened, and the measured tight state."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import ClassVar

import numpy as np

from lrbc_cli.arrays import Complexes, Floats, Integers, spaced
from lrbc_cli.campaign.identification.compared.likeness import LEAST_DIFFERENCE, apart, levels, spread
from lrbc_cli.campaign.identification.records import Measurement, unlike
from lrbc_cli.campaign.identification.unknowns import calibrated_start, parameterise
from lrbc_cli.campaign.reading.inputs import Inputs
from lrbc_cli.campaign.reduced.memory import options_of, reduction_cost
from lrbc_cli.campaign.reduced.stage import FrfSource
from lrbc_cli.model.terms import ParameterGroup, Parameterisation
from lrbc_cli.reduction.build import Reduction, reduce_model
from lrbc_cli.reduction.reduced.many import ports_of
from lrbc_cli.reduction.reduced.ports import PortFrf
from lrbc_cli.updating.comparison.correlation import measured_values
from lrbc_cli.updating.comparison.scale import LEAST_LINES, POWERS
from lrbc_cli.updating.search.starts import LEVELS
from lrbc_cli.updating.statistics.decibels import decibel
from lrbc_cli.updating.unknowns.shapes import joints_of

#: Largest number of lines of a job, and of states of the model, that are compared.
LINES, MOST_STATES = 200, 150

#: Predicted operations up to which a reduced model is built here if none is in the cache: at most ten seconds. Counted, not timed, so that
#: the findings do not depend on the load of the machine. 20 000 DOFs of a plate with a cavity take 5e11.
BUILT_WORK = 6e11

#: Tolerance of that model.
COARSE = 3e-2


@dataclass(kw_only=True)
class Looking(FrfSource):
    """FRFs of the model for ``lrbc check``, which are not stored in the cache.

    Attributes
    ----------
    start : mapping of str to float array
        Values of a rough calibration that replace the start values, by group; damping exponents under ``GROUP.damping``.
    factors : mapping of str to float
        Factors of the rough calibration.
    at_bounds : mapping of str to float
        Those of them that are at a bound, of stiffnesses and masses.
    note : str
        Text for the user on the calibration used.
    fits : dict of str to (Parameterisation, float array)
        Parameters and theta of the state of the bolts fitted coarsely to each job.
    changes : dict of str to float array
        Changes of the bolts in these states [decades], NaN for bolts without values.
    away : dict of str to float array
        Level misfits (R,) of each job with the state fitted coarsely to it [dB].
    near : dict of str to float array
        The same of jobs that are near the tight state, with that state.
    left : dict of str to float
        Level misfit of each job with the nearest state, median over the responses [dB].
    """

    # Found for every changed model; they are means over the lines, and a coarse fit ends far from the bounds.
    most_lines: ClassVar[int | None] = 50

    start: Mapping[str, Floats] = field(default_factory=dict, repr=False)
    factors: Mapping[str, float] = field(default_factory=dict, repr=False)
    at_bounds: Mapping[str, float] = field(default_factory=dict, repr=False)
    note: str = ""
    fits: dict[str, tuple[Parameterisation, Floats]] = field(default_factory=dict, repr=False)
    changes: dict[str, Floats] = field(default_factory=dict, repr=False)
    away: dict[str, Floats] = field(default_factory=dict, repr=False)
    near: dict[str, Floats] = field(default_factory=dict, repr=False)
    left: dict[str, float] = field(default_factory=dict, repr=False)

    @property
    def fitted_to(self) -> str | None:
        """Job that is said to be tight and to which the model was fitted, roughly or by the stored calibration; None if to none."""
        settings, use = self.inputs.campaign.calibration, self.inputs.calibration
        fitted = self.start or (use is not None and use.used)
        return settings.job if fitted and settings is not None else None

    def _compute(self, s: Complexes) -> PortFrf:
        assert self.stage is not None
        return ports_of(self.stage.reduction.model, s)

    def parameters(self, s: Complexes) -> Parameterisation:
        """Parameter groups for the lines s [rad/s], with the start values of a rough calibration, else of the stored one if it is used."""
        found = parameterise(self.inputs, self, s)[0]
        # The stored factors were identified together with these values, and fit with them only.
        start = self.start or next((found.by_group(theta) for theta in calibrated_start(self.inputs, found).values()), {})
        return Parameterisation(tuple(_started(group, start) for group in found.groups))


def coarsely_reduced(inputs: Inputs, progress: Callable[[str], None] = lambda _: None, *, blocks: int = 12) -> Reduction:
    """A reduced model good enough for ``lrbc check``.

    ``blocks``: see ``reduce_model``. Two to three expansion points are usual. With a mass in a wrong unit there are hundreds of modes in
    the band, and no measurement is near such a model.

    Raises
    ------
    NumericalError
    """
    options = replace(options_of(inputs), tolerance=max(COARSE, inputs.campaign.reduction.tolerance), held_out=1)
    return reduce_model(inputs.model, inputs.input_of, options, backend=inputs.campaign.reduction.backend, progress=progress, blocks=blocks)


def _started(group: ParameterGroup, start: Mapping[str, Floats]) -> ParameterGroup:
    """The group with start values from ``start``, if it has some."""
    values, exponent = start.get(group.name), start.get(f"{group.name}.damping")
    if group.damping is not None and exponent is not None:
        group = replace(group, damping=replace(group.damping, initial=exponent.item()))
    return group if values is None else replace(group, initial=np.clip(values, *group.bounds.T))


@dataclass(frozen=True, kw_only=True)
class Seen:
    """A job and the states with which it is compared, on some of its lines.

    Attributes
    ----------
    source : Looking
        FRFs of the model, with those computed before.
    job : str
    measurement : Measurement
        On these lines.
    parameters : Parameterisation
    states : (S, F, R) complex array
        FRFs of the model at the start values, then with loosened bolts, then measured or fitted states.
    loosened : list of int arrays
        Indices of the values at their lower bounds, for each state of the model.
    tight : (F, R) complex array or None
        Measured FRFs of the reference job, if the job is compared with it; NaN where there is no value.
    """

    source: Looking
    job: str
    measurement: Measurement
    parameters: Parameterisation
    states: Complexes = field(repr=False)
    loosened: list[Integers] = field(default_factory=list, repr=False)
    tight: Complexes | None = field(default=None, repr=False)

    @classmethod
    def of(cls, source: Looking, job: str, whole: Measurement, reference: Measurement | None = None) -> Seen:
        """A measurement on at most ``LINES`` lines, with that of the reference job if its lines are the same."""
        few, lines = _few_lines(whole)
        s = 2j * np.pi * few.frequency_hz
        parameters = source.parameters(s)
        states, loosened = states_of(source, parameters, s)
        tight = None if reference is None or unlike(whole.frequency_hz, reference.frequency_hz) else reference.values[lines]
        return cls(source=source, job=job, measurement=few, parameters=parameters, states=states, loosened=loosened, tight=tight)

    @classmethod
    def of_model(cls, source: Looking, job: str, whole: Measurement) -> Seen:
        """The same with the model at its start values as the only state, which takes little time."""
        few, _ = _few_lines(whole)
        s = 2j * np.pi * few.frequency_hz
        parameters = source.parameters(s)
        model = source.model(s, parameters).frf(parameters.initial)
        return cls(source=source, job=job, measurement=few, parameters=parameters, states=model[None])

    @property
    def inputs(self) -> Inputs:
        """Inputs of the campaign."""
        return self.source.inputs

    @property
    def quantities(self) -> list[str]:
        """Quantity of each of the R responses."""
        return [response.quantity for response in self.inputs.responses]

    @property
    def s(self) -> Complexes:
        """(F,) i omega of the lines [rad/s]."""
        return 2j * np.pi * self.measurement.frequency_hz

    @property
    def measured(self) -> Complexes:
        """(F, R) measured FRFs."""
        return self.measurement.values

    @property
    def model(self) -> Complexes:
        """(F, R) FRFs of the model at the start values."""
        found: Complexes = self.states[0]
        return found

    @property
    def dynamic(self) -> Complexes:
        """(F, m) dynamic values of the terms at the start values."""
        return self.parameters.dynamic(self.parameters.initial, self.s)

    @property
    def reference(self) -> bool:
        """Whether this is the reference job."""
        return self.job == self.inputs.campaign.update.reference

    @property
    def held(self) -> Complexes | None:
        """(F, R) measured tight state, free of model discrepancy; responses not measured there are the model's. None without it."""
        if self.tight is None:
            return None
        return np.where(measured_values(self.tight).sum(axis=0) >= 2 * LEAST_LINES, self.tight, self.model)

    def at(self, theta: Floats) -> Seen:
        """The same with other start values: a job beside one state of the bolts."""
        values = self.parameters.by_group(theta)
        parameters = Parameterisation(tuple(_started(group, values) for group in self.parameters.groups))
        state = self.source.model(self.s, parameters).frf(parameters.initial)
        return replace(self, parameters=parameters, states=state[None], loosened=[])

    def beside(self, state: Complexes | None) -> Seen:
        """The same with a further state (F, R), unless that is None."""
        return self if state is None else replace(self, states=np.concatenate([self.states, state[None]]))

    def reading(self, values: Complexes) -> Seen:
        """The same with other (F, R) values in place of those measured."""
        return replace(self, measurement=replace(self.measurement, values=values))

    def on(self, lines: Integers) -> Seen:
        """The same on some of the lines."""
        own = replace(self.measurement, frequency_hz=self.measurement.frequency_hz[lines], values=self.measured[lines])
        return replace(self, measurement=own, states=self.states[:, lines], tight=None if self.tight is None else self.tight[lines])

    def few(self, most: int) -> Seen:
        """The same on at most ``most`` lines."""
        return self.on(spaced(self.s.size, most))

    @property
    def misfit(self) -> float:
        """Level misfit at the start values, mean level of each response removed, median over the responses [dB]."""
        return float(np.median(apart(self.measured, self.model)))

    @property
    def by_excitation(self) -> dict[int, float]:
        """As ``misfit``, separately for the responses of each excitation [dB]."""
        return by_excitation(apart(self.measured, self.model), self.inputs.input_of)

    def work(self, lines: int) -> float:
        """Predicted operations of full solves at that many lines."""
        known = self.source.known
        if (key := b"work") not in known:
            known[key] = reduction_cost(self.inputs)[0].line
        return float(known[key] * lines)

    def least_of(self, at: int, *, times: float = 2.0, calibrated: float = 1.0) -> float:
        """Misfit of the responses of excitation ``at`` up to which they count as explained [dB].

        After a calibration, an excitation may be wrong by less than ``LEAST_DIFFERENCE``, if its misfit is more than ``times`` that
        of the others and above that of a calibrated model. On right campaigns it was 1.3 times as large at most.
        """
        others = [db for other, db in self.by_excitation.items() if other != at]
        if not others or self.source.fitted_to is None:
            return LEAST_DIFFERENCE
        return min(LEAST_DIFFERENCE, max(times * max(others), calibrated))

    @property
    def left(self) -> float:
        """Level misfit of the nearest state: median over the responses, mean level of each removed [dB]."""
        return float(np.median(apart(self.measured, self.states), axis=1).min())


def _few_lines(whole: Measurement) -> tuple[Measurement, Integers]:
    """A measurement on at most ``LINES`` lines, and their indices."""
    lines = spaced(whole.frequency_hz.size, LINES)
    return replace(whole, frequency_hz=whole.frequency_hz[lines], values=whole.values[lines]), lines


def by_excitation(far: Floats, input_of: Integers) -> dict[int, float]:
    """Median of level misfits (R,) over the responses of each excitation [dB]."""
    return {int(at): float(np.median(far[input_of == at])) for at in np.unique(input_of)}


def states_of(source: Looking, parameters: Parameterisation, s: Complexes) -> tuple[Complexes, list[Integers]]:
    """(S, F, R) FRFs of the states of ``values_of`` on the lines s, and the indices of the loosened values."""
    states, loosened = values_of(parameters)
    key = b"states" + s.tobytes()
    if key not in source.known:
        source.known[key] = source.model(s, parameters).nearby(parameters.initial)(np.array(states))
    found: Complexes = source.known[key]
    return found, loosened


def reach_of_one(seen: Seen) -> tuple[Floats, Floats]:
    """(R,) largest change by a single loosened bolt of the median level of a response, and of its levels without that constant [dB].

    A part on a single joint may be practically cut off by it, as a blade at its root. Zeros if bolts own no values.
    """
    source, parameters, model = seen.source, seen.parameters, seen.model
    if (key := b"reach" + seen.s.tobytes()) in source.known:
        known: tuple[Floats, Floats] = source.known[key]
        return known
    owners = [group.bolt.max() for group in parameters.groups if group.bolt is not None and group.bolt.size]
    joints = [np.concatenate(list(own.values())) for own in joints_of(parameters, 1 + int(max(owners, default=-1))) if own]
    frf, steps = source.model(seen.s, parameters).nearby(parameters.initial), np.array([*LEVELS, -np.inf])
    level, rest = np.zeros((2, model.shape[1]))
    for own in joints:
        theta = np.tile(parameters.initial, (len(steps), 1))
        theta[:, own] = np.maximum(theta[:, own] + steps[:, None], parameters.bounds[own, 0])
        loose = frf(theta)
        change = np.nan_to_num(np.median(levels(loose) - levels(model), axis=1))
        change -= np.median(change, axis=1, keepdims=True)
        level, rest = np.maximum(level, np.abs(change).max(axis=0)), np.maximum(rest, apart(loose, model).max(axis=0))
    source.known[key] = level, rest
    return level, rest


def values_of(parameters: Parameterisation) -> tuple[list[Floats], list[Integers]]:
    """States theta, and indices of the loosened values: start values, then one value, neighbours, or all at their lower bounds."""
    start = parameters.initial
    states, loosened = [start], [np.zeros(0, dtype=np.int64)]
    for group, where, _ in parameters.placed:
        width = 1
        while group.kind == "stiffness" and width < 2 * group.count:
            for first in range(0, max(group.count - width // 2, 1), max(width // 2, 1)):
                loose = start.copy()
                at = np.arange(where.start + first, min(where.start + first + width, where.stop))
                loose[at] = group.bounds[at - where.start, 0]
                states.append(loose)
                loosened.append(at)
            width *= 2
    return states[:MOST_STATES], loosened[:MOST_STATES]


def nearest_states(seen: Seen, most: int = 1) -> list[Complexes]:
    """(F, R) FRFs at the start values, and of the ``most`` nearest states, up to a factor and for each power of the frequency."""
    omega = decibel(2.0 * np.pi * seen.measurement.frequency_hz)[:, None]
    level = levels(seen.measured) - levels(seen.states)
    orders = [np.median(spread(level - b * omega, 1), axis=1).argsort() for b in (0, *POWERS)]
    nearest = {int(k) for order in orders for k in order[:most]}
    return [seen.states[k] for k in sorted({0, *nearest})]


def on_lines(seen: Seen, measurements: Mapping[str, Measurement], names: Sequence[str]) -> list[Complexes]:
    """FRFs of some jobs on the lines of ``seen``, of those measured on the lines of its job."""
    whole = measurements[seen.job]
    lines = np.searchsorted(whole.frequency_hz, seen.measurement.frequency_hz)
    others = (measurements[name] for name in names)
    return [other.values[lines] for other in others if not unlike(other.frequency_hz, whole.frequency_hz)]
