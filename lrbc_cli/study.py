"""The public face: a campaign as an object that reduces, computes FRFs, identifies and judges.

The command line does the same through the same functions; nothing here writes result files.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from lrbc_cli.arrays import Complexes, Floats
from lrbc_cli.campaign.calibration import read_inputs
from lrbc_cli.campaign.documents import cache_folder
from lrbc_cli.campaign.identification.found import Identification
from lrbc_cli.campaign.identification.identify import identify
from lrbc_cli.campaign.identification.records import Measurement, read_measurement, with_job
from lrbc_cli.campaign.identification.unknowns import found_on_frfs, parameterise, start_parameters
from lrbc_cli.campaign.jobs.evidence import copied_baseline, evidence_of
from lrbc_cli.campaign.jobs.finished import result_record
from lrbc_cli.campaign.jobs.judging import role_of, scatter_of_records
from lrbc_cli.campaign.planning.plan import Request, make_plan
from lrbc_cli.campaign.reading.inputs import Inputs
from lrbc_cli.campaign.reduced.stage import FrfSource, ReductionStage, cheaper_formula, frf_source, obtain_reduction
from lrbc_cli.config import load_campaign
from lrbc_cli.errors import ConfigError, DataError
from lrbc_cli.method.rule import RULE, rule_of
from lrbc_cli.model.fem import FeModel
from lrbc_cli.model.terms import Parameterisation
from lrbc_cli.reduction.outcome import Reduction
from lrbc_cli.reduction.steps.grid import require_in_band
from lrbc_cli.results.job import JobRecord
from lrbc_cli.results.plan import PlanRecord
from lrbc_cli.updating.judging.decide import Judgement, judge
from lrbc_cli.updating.judging.evidence import Evidence


@dataclass(frozen=True)
class Identified:
    """One job, identified and judged.

    Attributes
    ----------
    name : str
    identification : Identification
        Values, posterior, FRFs before and after.
    evidence : Evidence
        What judging needs of it.
    record : JobRecord
        What ``result.json`` would hold, see ``lrbc guide results``.
    """

    name: str
    identification: Identification = field(repr=False)
    evidence: Evidence = field(repr=False)
    record: JobRecord = field(repr=False)

    @property
    def status(self) -> str:
        """``converged``, ``stopped`` or ``unexplained``."""
        return self.record.status

    @property
    def misfit_db(self) -> float:
        """Mean absolute misfit of the responses used [dB]."""
        return self.record.misfit_db.final

    @property
    def verdicts(self) -> dict[str, str]:
        """Verdict of each bolt."""
        return {bolt.name: bolt.verdict for bolt in self.record.bolts}

    @property
    def probability_loose(self) -> dict[str, float | None]:
        """Posterior probability of each bolt of being loose; None where none is stated."""
        return {bolt.name: bolt.probability_loose for bolt in self.record.bolts}


class Study:
    """A campaign: its model with the stored calibration, its reduced model and its jobs. ``load`` makes it.

    Parameters
    ----------
    inputs : Inputs
        As read, a stored calibration applied.
    cache : Path or None
        Folder of the cache; the user's where None.
    progress : callable
        Gets one line of text a step.
    """

    def __init__(self, inputs: Inputs, cache: Path | None = None, progress: Callable[[str], None] = lambda _: None) -> None:
        self.inputs = inputs
        self._folder, self._progress = cache_folder(cache), progress
        self._stage: ReductionStage | None = None
        self._source: FrfSource | None = None
        self._start: Parameterisation | None = None

    def __repr__(self) -> str:
        return f"Study({self.inputs.campaign.name!r}, {self.model.size} DOFs, {self.model.terms.size} terms, jobs {self.jobs})"

    @property
    def model(self) -> FeModel:
        """The full-order model, calibrated where a stored calibration fits."""
        return self.inputs.model

    @property
    def responses(self) -> list[str]:
        """Names of the responses, in the order of the columns of all FRFs."""
        return [response.name for response in self.inputs.responses]

    @property
    def jobs(self) -> list[str]:
        """Names of the jobs."""
        return list(self.inputs.campaign.jobs)

    def reduce(self, *, force: bool = False, accept: bool = False) -> Reduction:
        """The reduced model with its certificate: from the cache, or built and kept.

        Parameters
        ----------
        force : bool
            Build anew.
        accept : bool
            Accept a model that does not reach its tolerance.

        Raises
        ------
        NumericalError
            Where the tolerance is not reached and not accepted, or memory does not suffice.
        """
        if self._stage is None or force:
            self._stage = obtain_reduction(self.inputs, self._folder, force=force, accept=accept, progress=self._progress)
            self._source = self._start = None
        return self._stage.reduction

    @property
    def stage(self) -> ReductionStage:
        """The reduced model, and whether the cache had it."""
        self.reduce()
        assert self._stage is not None
        return self._stage

    @property
    def source(self) -> FrfSource:
        """FRFs on any lines of the band: of the reduced model, unless the campaign says ``evaluation: full``."""
        if self._source is None:
            self._source = frf_source(self.inputs, None if self.inputs.method.full_order else self.stage, self._progress)
        return self._source

    def parameters(self, hz: ArrayLike | None = None) -> Parameterisation:
        """The unknowns with start values and bounds.

        Parameters
        ----------
        hz : (F,) array or None
            Lines on which ``auto`` is resolved, as an identification does on those that were measured [Hz]; None: the 1 Hz lines of the
            band, as for ``frf`` and `lrbc simulate`.
        """
        if hz is not None:
            return parameterise(self.inputs, self.source, self._lines(hz))[0]
        if self._start is None:
            source = self.source
            if source.stage is None and found_on_frfs(self.inputs):
                kind = cheaper_formula(self.inputs, self.stage)
                source = FrfSource(inputs=self.inputs, stage=self.stage, kind=kind, progress=self._progress)
            self._start = start_parameters(self.inputs, source)
        return self._start

    def frf(self, hz: ArrayLike, theta: ArrayLike | None = None, /, **log10: ArrayLike) -> Complexes:
        """(F, R) FRFs of the reduced model.

        Parameters
        ----------
        hz : (F,) array
            Lines inside the band [Hz].
        theta : (size,) array or None
            All unknowns, in the order of ``parameters()``; None: their start values.
        **log10
            Values by parameter group, one or one a parameter, put into theta; ``inf`` clamps, ``-inf`` frees. A damping exponent is
            ``**{"GROUP.damping": value}``.

        Examples
        --------
        >>> study = load("configs/frame.yaml")
        >>> study.frf([100.0, 101.0], left_edge=6.5).shape
        (2, 4)
        """
        s, parameters = self._lines(hz), self.parameters()
        return self.source.model(s, parameters).frf(self._theta(parameters, theta, log10))

    def sensitivities(self, hz: ArrayLike, theta: ArrayLike | None = None, /, **log10: ArrayLike) -> tuple[Complexes, Floats]:
        """FRFs and the derivative of their levels to all unknowns.

        Parameters
        ----------
        hz, theta, **log10
            As for ``frf``; values must be finite.

        Returns
        -------
        y : (F, R) complex array
        J : (F, R, size) float array
            dB per decade, eqs. (35), (36); in the order of ``parameters()``.
        """
        s, parameters = self._lines(hz), self.parameters()
        y, J = self.source.model(s, parameters).sensitivities(self._theta(parameters, theta, log10))
        return y, np.asarray(J.real)

    def measurement(self, hz: ArrayLike, values: ArrayLike, coherence: ArrayLike | None = None) -> Measurement:
        """FRFs at hand as a measurement: in SI units, signs as in the model.

        Parameters
        ----------
        hz : (F,) array
        values : (F, R) complex array
            One column a response of the campaign, NaN where not measured.
        coherence : (F, R) array or None

        Raises
        ------
        DataError
            Where shapes do not fit the responses, or lines are not ascending.
        """
        lines, H = np.asarray(hz, dtype=float), np.asarray(values, dtype=complex)
        expected = (lines.size, len(self.responses))
        if lines.ndim != 1 or H.shape != expected or np.any(np.diff(lines) <= 0):
            raise DataError("these arrays are no measurement", expected=f"ascending lines and FRFs of shape {expected}", found=f"{H.shape}")
        known = np.full(expected, np.nan) if coherence is None else np.broadcast_to(np.asarray(coherence, dtype=float), expected)
        return Measurement(
            frequency_hz=lines, values=H, coherence=known, notes=("handed over as arrays",), warnings=(), records=(), hashes={}
        )

    def identify(
        self,
        job: str,
        measurement: Measurement | None = None,
        *,
        reference: Identified | None = None,
        baselines: Sequence[Identified] = (),
    ) -> Identified:
        """Identify one job, and judge it.

        Parameters
        ----------
        job : str
            A job of the campaign; with a measurement also a new name.
        measurement : Measurement or None
            Instead of the job's file, see ``measurement``.
        reference : Identified or None
            The reference job, for changes and verdicts; None: a direct identification, as of the reference job itself.
        baselines : sequence of Identified
            Other jobs with all bolts tight: how much they scatter moves the threshold.

        Raises
        ------
        ConfigError, DataError, NumericalError
            Where the job is unknown, its measurement unusable, or the optimisation fails.
        """
        inputs = self._with_job(job, measurement is not None)
        given = {job: measurement} if measurement is not None else {}
        before = None
        if reference is not None:
            before = reference.record.state
            given[reference.name] = reference.identification.measurement
        found = identify(inputs, self.source, job, before, given)
        evidence = evidence_of(inputs, found).beside(copied_baseline(inputs, job, found.measurement))
        others = {other.name: other.record for other in baselines}
        record = result_record(inputs, self.source.stage, found, evidence, others)
        return Identified(name=job, identification=found, evidence=evidence, record=record)

    def judge(self, found: Identified, *, baselines: Sequence[Identified] = (), **rule: Any) -> Judgement:
        """Judge the bolts of an identified job by another decision rule, without identifying anew.

        Parameters
        ----------
        found : Identified
        baselines : sequence of Identified
            Other jobs with all bolts tight.
        **rule
            Keys of ``update`` that decide: ``confidence``, ``loose_change``, ``largest_misfit``; others as in the campaign.

        Raises
        ------
        ConfigError
            Where a key is no part of the rule, or its value is none.
        """
        update, expected = self.inputs.campaign.update, "confidence, loose_change or largest_misfit"
        if unknown := set(rule) - {*RULE}:
            raise ConfigError("not part of the decision rule", expected=expected, found=", ".join(sorted(unknown)))
        try:
            update = type(update).model_validate(update.model_dump(by_alias=True, exclude_unset=True) | rule)
        except ValueError as error:
            raise ConfigError("no such decision rule", expected=f"values of {expected} as in the campaign file", found=rule) from error
        scatter = scatter_of_records(other.record for other in baselines)
        return judge(found.evidence, rule_of(update), role_of(update, found.name), scatter, found.identification.reference)

    def plan(self, state: str | None = None, *, noise_db: float | None = None, draws: int | None = None) -> PlanRecord:
        """What `lrbc update` will say of each bolt if it alone is loose: the record of ``plan.json``, see ``lrbc guide sensors``.

        Parameters
        ----------
        state : str or None
            ``initial``, ``clamped``, ``free`` or ``job:NAME``; None: the reference job's stored result, else ``initial``.
        noise_db : float or None
            Standard deviation of a line [dB]; None: what the reference job tells.
        draws : int or None
            Rehearsals of each bolt and loss; None: about 150 in all; 0 gives linearised figures only.
        """
        return make_plan(self.inputs, self._folder, Request(state, noise_db, draws=draws), progress=self._progress)

    def read(self, job: str) -> Measurement:
        """The measurement of a job, in SI units on the lines of the band."""
        return read_measurement(self.inputs, self._with_job(job, False).campaign.jobs[job], job)

    def plot_frf(self, found: Identified, response: str) -> Any:
        """Measured, initial and updated FRF of one response: magnitude in dB, as a matplotlib figure."""
        from matplotlib.figure import Figure

        at, result = self.responses.index(response), found.identification
        figure = Figure(figsize=(8, 4), layout="constrained")
        axes = figure.subplots()
        curves = (("measured", result.measurement.values, "-"), ("initial", result.initial, ":"), ("updated", result.updated, "--"))
        with np.errstate(divide="ignore", invalid="ignore"):
            for label, H, style in curves:
                axes.plot(result.measurement.frequency_hz, 20 * np.log10(np.abs(H[:, at])), style, label=label)
        axes.set(xlabel="frequency [Hz]", ylabel=f"{response} [dB re 1 {self.inputs.responses[at].unit}]", title=found.name)
        axes.legend()
        return figure

    def plot_profile(self, found: Identified) -> Any:
        """Stiffness along each edge, or of each joint, with its 95 % interval, as a matplotlib figure (paper, Fig. 6)."""
        from matplotlib.figure import Figure

        groups = {name: entry for name, entry in found.record.parameters.items() if entry.arc_length is not None or entry.bolts}
        figure = Figure(figsize=(8, 3.2 * max(len(groups), 1)), layout="constrained")
        for axes, (name, entry) in zip(np.atleast_1d(figure.subplots(max(len(groups), 1))), groups.items(), strict=False):
            if entry.arc_length is None:
                at = np.arange(len(entry.log10))
                axes.vlines(at, entry.lower95, entry.upper95, alpha=0.25, linewidth=8, label="95 % interval")
                axes.plot(at, entry.log10_effective, "_", markersize=14, label="identified")
                axes.set_xticks(at, [bolt or "" for bolt in entry.bolts or ()])
            else:
                axes.fill_between(entry.arc_length, entry.lower95, entry.upper95, alpha=0.25, label="95 % interval")
                axes.plot(entry.arc_length, entry.log10_effective, label="identified")
            axes.set(xlabel="along the edge [m]" if entry.bolts is None else "", ylabel=f"log10 of {name} [{entry.unit}]", title=found.name)
            axes.legend()
        return figure

    def _lines(self, hz: ArrayLike) -> Complexes:
        lines = np.atleast_1d(np.asarray(hz, dtype=float))
        require_in_band(lines, self.inputs.campaign.reduction.band, hint="change reduction.band")
        return np.asarray(2j * np.pi * lines)

    def _with_job(self, job: str, measured: bool) -> Inputs:
        """The inputs with a job of that name, which need not have a file where its measurement is at hand."""
        campaign = self.inputs.campaign
        if not measured:
            campaign.require_job(job)
        return self.inputs if job in campaign.jobs else with_job(self.inputs, job)

    def _theta(self, parameters: Parameterisation, given: ArrayLike | None, log10: Mapping[str, ArrayLike]) -> Floats:
        theta = parameters.initial

        def put(name: str, part: Floats, value: ArrayLike) -> None:
            values = np.asarray(value, dtype=float)
            if values.shape not in ((), part.shape):
                raise ConfigError(f"the number of values does not fit {name}", expected=f"1 or {part.size}", found=values.size)
            part[...] = values

        if given is not None:
            put("theta", theta, given)
        places: dict[str, slice] = {}
        for group, (where, at) in zip(parameters.groups, parameters.slices, strict=True):
            places |= {group.name: where} | ({} if at is None else {f"{group.name}.damping": slice(at, at + 1)})
        for name, value in log10.items():
            if name not in places:
                raise ConfigError(f"no parameter group '{name}'", file=self.inputs.campaign.path, expected=", ".join(places), found=name)
            put(name, theta[places[name]], value)
        return theta


def load(
    config: str | Path,
    *,
    overrides: Sequence[str] = (),
    calibration: bool = True,
    cache: str | Path | None = None,
    progress: Callable[[str], None] = lambda _: None,
) -> Study:
    """Read a campaign file and its model.

    Parameters
    ----------
    config : path
    overrides : sequence of str
        ``key.path=value``.
    calibration : bool
        Apply the stored calibration where it fits, as the command line does.
    cache : path or None
        Folder of the cache of reduced models.
    progress : callable

    Returns
    -------
    Study

    Raises
    ------
    ConfigError, DataError
        Where the file or an input is wrong: one message with file, place, expected, found and how to fix it.

    Examples
    --------
    >>> study = load("configs/frame.yaml")
    >>> study.responses
    ['acc1', 'acc2', 'acc3', 'acc4']
    """
    inputs = read_inputs(load_campaign(Path(config), tuple(overrides)), calibration=calibration)
    return Study(inputs, None if cache is None else Path(cache), progress)


__all__ = ["Identified", "Study", "load"]
