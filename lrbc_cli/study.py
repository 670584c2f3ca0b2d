"""The Python interface to a campaign: ``Study`` reduces, computes FRFs, calibrates, identifies and judges; the command line uses it too.

Only ``calibrate`` and ``update`` write result files.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from lrbc_cli import given
from lrbc_cli.campaign.calibration import with_stored_calibration
from lrbc_cli.campaign.identification.compared.copies import Originals
from lrbc_cli.campaign.identification.found import Fit
from lrbc_cli.campaign.identification.handed import measurement_of, with_choices
from lrbc_cli.campaign.identification.identify import fit, identify
from lrbc_cli.campaign.identification.nuisances import not_in_model
from lrbc_cli.campaign.identification.records import Measurement, read_measurement
from lrbc_cli.campaign.jobs.evidence import evidence_of
from lrbc_cli.campaign.jobs.finished import result_record
from lrbc_cli.campaign.jobs.identity import compared_jobs
from lrbc_cli.campaign.jobs.judging import ComparedWith, final_judgement
from lrbc_cli.campaign.jobs.plans import needs
from lrbc_cli.campaign.jobs.standing import Outcome
from lrbc_cli.campaign.planning.plan import Request, make_plan
from lrbc_cli.campaign.reading.inputs import Inputs, read_as_exported
from lrbc_cli.campaign.simulate import parse_lines
from lrbc_cli.config import load_campaign
from lrbc_cli.identified import Identified, TightStates, frf_figure, profile_figure, task
from lrbc_cli.method.resolve import Method
from lrbc_cli.method.rule import changed_rule
from lrbc_cli.modelled import ModelStudy, Progress
from lrbc_cli.results.model import CalibrationRecord
from lrbc_cli.results.plan import PlanRecord
from lrbc_cli.results.rehearsal import RehearsalRecord
from lrbc_cli.updating.judging.decide import Judgement
from lrbc_cli.virtual.campaign import rehearse, required
from lrbc_cli.virtual.structure import Settings


class Study(ModelStudy):
    """A campaign with its (calibrated) full-order model, its reduced model and its jobs; created by ``load``.

    Parameters
    ----------
    inputs : Inputs
        Contents of the campaign, with the stored calibration applied to the model.
    cache : Path or None
        Folder of the cache of reduced models; None: that of the user.
    progress : callable
        Called with one line of text for each step.
    exported : Inputs or None
        The same with the model as exported, from which ``calibrate`` starts; None: ``inputs`` contain no calibration.
    """

    def __init__(
        self, inputs: Inputs, cache: Path | None = None, progress: Progress = lambda _: None, exported: Inputs | None = None
    ) -> None:
        super().__init__(inputs, cache, progress)
        self._exported = inputs if exported is None else exported
        self._tight = TightStates(self.identify)
        self._writes = True

    def __repr__(self) -> str:
        return f"Study({self.inputs.campaign.name!r}, {self.model.size} DOFs, {self.model.terms.size} terms, jobs {self.jobs})"

    def measurement(self, hz: ArrayLike, values: ArrayLike, coherence: ArrayLike | None = None) -> Measurement:
        """A measurement made of arrays instead of a job's file: FRFs in SI units, with the signs of the model.

        Parameters
        ----------
        hz : (F,) array
            Ascending lines [Hz]; those outside the band are left out.
        values : (F, R) complex array
            One column for each response of the campaign, NaN where not measured.
        coherence : (F, R) array or None

        Raises
        ------
        DataError
            If shapes do not fit the responses, lines are not ascending, none lies in the band, or coherence is not between 0 and 1.
        """
        known = None if coherence is None else given.array("coherence", coherence, float, "numbers from 0 to 1")
        return measurement_of(self.inputs, given.lines(hz), given.array("values", values, complex, "FRFs"), known)

    def identify(
        self,
        job: str,
        measurement: Measurement | None = None,
        *,
        reference: Identified | None = None,
        baselines: Sequence[Identified] | None = None,
    ) -> Identified:
        """Identify the unknowns of one job and judge its bolts; nothing is written.

        Parameters
        ----------
        job : str
            A job of the campaign; together with a measurement also a new name.
        measurement : Measurement or None
            Used instead of the job's file, see ``measurement``.
        reference : Identified or None
            The reference job, from which changes are counted; None: that of the campaign, which is then identified first, once.
        baselines : sequence of Identified or None
            Further jobs with all bolts tight; their scatter moves the threshold. None: those of the campaign, identified first, once; one
            that fails is left out, as `lrbc update` does.

        Raises
        ------
        ConfigError, DataError, NumericalError
            If the job is unknown, its measurement is unusable, or the optimisation fails.

        Examples
        --------
        >>> study = load("configs/frame.yaml")
        >>> found = study.identify("loose-2")
        >>> found.verdicts["B3"], found.verdicts["B1"]
        ('loose', 'tight')
        >>> [bolt.name for bolt in study.judge(found, confidence=0.99).bolts if bolt.verdict == "loose"]
        ['B3', 'B4']
        """
        inputs, before, known = task(self.inputs, job, measurement, reference, self._tight.of)
        names = needs(inputs.campaign, job)[1]
        others = self._tight.usable(names, reference, self._progress) if baselines is None else tuple(baselines)
        found = identify(inputs, self.source, job, before, known)
        # Arrays that are handed over may be those of a job.
        alike = compared_jobs(inputs.campaign, job) if measurement is None else [each for each in names if each != job]
        evidence = evidence_of(inputs, found).beside(Originals(inputs).copied(job, alike, found.measurement)[1] or None)
        record = result_record(inputs, self.source.stage, found, evidence, {other.name: other.record for other in others})
        return Identified(name=job, identification=found, evidence=evidence, record=record, baselines=others)

    def fit(self, job: str, measurement: Measurement | None = None, *, reference: Identified | None = None) -> Fit:
        """The cost that ``identify`` minimises, with its final weights, and its minimum: for studies of the search."""
        inputs, before, known = task(self.inputs, job, measurement, reference, self._tight.of)
        return fit(inputs, self.source, job, before, known)

    def calibrate(self, *, force: bool = False, accept: bool = False) -> tuple[CalibrationRecord, bool]:
        """Identify the global factors of the model, write them and apply them to this study, as `lrbc calibrate` does.

        Parameters
        ----------
        force : bool
            Calibrate again even if nothing changed.
        accept : bool
            Accept a reduced model that does not reach its tolerance.

        Returns
        -------
        CalibrationRecord
        bool
            Whether an earlier calibration was kept.
        """
        from lrbc_cli.campaign.calibrate import run_calibration

        self._require_output()
        found = run_calibration(self._exported, self._folder, force=force, accept=accept, progress=self._progress)
        self.use_calibration()
        return found

    def with_method(self, *, output: str | Path | None = None, **choices: Any) -> Study:
        """The study with other fields of its ``Method`` (statistics, lines, responses, ...), for experiments.

        Parameters
        ----------
        output : path or None
            Folder for what `update` and `calibrate` of this study write; None: they are refused, since they would replace the results of
            the campaign.
        **choices
            New values of fields of ``Method``.

        Raises
        ------
        ConfigError
            If the method has no such field, the value is not valid, the model as it was read does not represent a nuisance parameter, or
            the folder is that of the campaign.
        """
        for name in choices:
            given.known("with_method", name, (entry.name for entry in fields(Method)))
        folder = None if output is None else Path(output)
        inputs, exported = (with_choices(each, choices, folder) for each in (self.inputs, self._exported))
        if lacking := not_in_model(inputs):
            raise given.refuse("nuisances", "what the campaign file sets, or gain", ", ".join(lacking))
        other = Study(inputs, self._folder, self._progress, exported)
        other._writes = folder is not None
        return other

    def use_calibration(self, wanted: bool = True) -> None:
        """Apply the factors of the stored calibration to the model if it still fits, or (``wanted=False``) return to the exported model."""
        self.inputs = with_stored_calibration(self._exported, calibration=wanted)
        self._stage = self._source = self._start = None
        self._tight = TightStates(self.identify)

    def update(self, jobs: Sequence[str] = (), *, force: bool = False, **options: Any) -> Outcome:
        """Identify and judge jobs and write their results, as `lrbc update` does; results that are still valid are kept.

        Parameters
        ----------
        jobs : sequence of str
            All jobs if empty.
        force : bool
            Identify finished jobs again.
        **options
            ``accept``, ``workers``, ``remote``, see ``run_jobs``.

        Returns
        -------
        Outcome
            ``results`` and ``errors`` by job: a job that fails does not end the run.
        """
        from lrbc_cli.campaign.jobs.run import run_jobs

        if isinstance(jobs, str):
            raise given.refuse("jobs", "a sequence of names", repr(jobs))
        if "workers" in options:
            given.count("workers", options["workers"], 1)
        self._require_output()
        return run_jobs(self.inputs, self._folder, wanted=jobs, force=force, progress=self._progress, **options)[0]

    def judge(self, found: Identified, *, baselines: Sequence[Identified] | None = None, **rule: Any) -> Judgement:
        """Judge the bolts of an identified job by another decision rule, without identifying it again.

        Parameters
        ----------
        found : Identified
        baselines : sequence of Identified or None
            Further jobs with all bolts tight; None: those with which it was identified.
        **rule
            New values of ``confidence``, ``loose_change``, ``largest_misfit`` (keys of ``update``) or other fields of ``DecisionRule``; the
            others stay as in this study (``inputs.method.rule``).

        Raises
        ------
        ConfigError
            If a key is not part of the rule, or its value is not valid.
        """
        changed = changed_rule(self.inputs.method.rule, rule)
        given.made_by("found", found, Identified, "what identify returned")
        others = {other.name: other.record for other in (found.baselines if baselines is None else baselines)}
        beside, certificate = ComparedWith(found.identification.reference, others), found.record.provenance.certificate
        return final_judgement(self.inputs.campaign, changed, found.evidence, beside, certificate)[0]

    def plan(
        self,
        state: str | None = None,
        *,
        noise_db: float | None = None,
        by: Literal["auto", "bolts", "values"] = "auto",
        draws: int | None = None,
        seed: int = 0,
        accept: bool = False,
    ) -> PlanRecord:
        """Predict how often `lrbc update` would find each bolt loose if it alone were: the record of ``plan.json``, ``lrbc guide sensors``.

        Parameters
        ----------
        state : str or None
            Tight state: ``initial``, ``clamped``, ``free`` or ``job:NAME``; None: the stored result of the reference job, else ``initial``.
        noise_db : float or None
            Standard deviation of the noise of a line [dB]; None: as known from the reference job.
        by : str
            What is loosened, one at a time: ``bolts``, ``values``, or ``auto``.
        draws, seed : int or None, int
            Rehearsals for each bolt and loss (None: about 150 in all; 0: linearised figures only), five times as many of the tight
            structure; and the seed of their random numbers.
        accept : bool
            Accept a reduced model that does not reach its tolerance.
        """
        request = Request(state=state, noise_db=noise_db, by=by, draws=draws, seed=seed)
        return make_plan(self.inputs, self._folder, request, accept=accept, progress=self._progress)

    def rehearse(
        self,
        out: str | Path,
        jobs: Mapping[str, Sequence[str]],
        *,
        settings: Settings | None = None,
        seed: int = 1,
        hz: ArrayLike | None = None,
        force: bool = False,
    ) -> RehearsalRecord:
        """Write a campaign of simulated measurements of this model, slightly changed, as `lrbc rehearse` does.

        Parameters
        ----------
        out : path
            Folder for ``campaign.yaml`` (which ``load`` reads), ``frf/JOB.uff`` and ``rehearsal.json``.
        jobs : mapping
            Loosened bolts by job; the first job is the reference job and has none.
        settings : Settings or None
            Noise, depth of a loss, errors of the model and drift (``lrbc_cli.virtual.structure``); None: the defaults, with the drift of
            the campaign.
        seed : int
            Seed of all random draws.
        hz : (F,) array or None
            Ascending lines inside the band [Hz]; None: its 1 Hz lines.
        force : bool
            Replace the files of an earlier rehearsal.

        Returns
        -------
        RehearsalRecord
            What was drawn.

        Raises
        ------
        ConfigError
            If a bolt does not exist or cannot be loosened, the reference job has loose bolts, or files exist or cannot be written.
        """
        lines = parse_lines(None, self.inputs.campaign.reduction.band) if hz is None else given.lines(hz)
        if np.any(np.diff(lines) <= 0.0):
            raise given.refuse("hz", "ascending lines", "lines that are not")
        # The stored calibration belongs to other measurements.
        drawn: dict[str, Any] = {"settings": settings, "seed": seed, "lines": lines, "replace": force, "progress": self._progress}
        return rehearse(self._exported, self._folder, Path(out), required(self._exported, jobs), **drawn)

    def read(self, job: str) -> Measurement:
        """Read the measurement of a job: FRFs in SI units on the lines inside the band."""
        self.inputs.campaign.require_job(job)
        return read_measurement(self.inputs, self.inputs.campaign.jobs[job], job)

    def plot_frf(self, found: Identified, response: str) -> Any:
        """Plot the measured, initial and updated FRF of one response, magnitude in dB, as a matplotlib figure."""
        at = self.responses.index(given.known("response", response, self.responses))
        return frf_figure(found.identification, at, f"{response} [dB re 1 {self.inputs.responses[at].unit}]")

    def plot_profile(self, found: Identified) -> Any:
        """Plot the stiffness along each edge, or of each joint, with its 95 % interval, as a matplotlib figure (paper, Fig. 6)."""
        return profile_figure(found.record)

    def _require_output(self) -> None:
        """Refuse to write what an experiment found where the campaign has its results."""
        if not self._writes:
            raise given.refuse(
                "output of with_method", "a folder for the results of this experiment", "none: they would replace the campaign's"
            )


def load(
    config: str | Path,
    *,
    overrides: Sequence[str] = (),
    calibration: bool = True,
    cache: str | Path | None = None,
    progress: Progress = lambda _: None,
) -> Study:
    """Read a campaign file and its model into a ``Study``.

    Parameters
    ----------
    config : path
    overrides : sequence of str
        Settings that replace those of the file, each ``key.path=value``.
    calibration : bool
        Apply the stored calibration if it fits, as the command line does.
    cache : path or None
        Folder of the cache of reduced models; None: that of the user.
    progress : callable

    Returns
    -------
    Study

    Raises
    ------
    ConfigError, DataError
        If the file or an input is wrong; the message names file, place, what was expected and found, and how to fix it.

    Examples
    --------
    >>> study = load("configs/frame.yaml")
    >>> study.responses
    ['acc1', 'acc2', 'acc3', 'acc4']
    """
    given.made_by("config", config, (str, Path), "the path of a campaign file")
    exported = read_as_exported(load_campaign(Path(config), tuple(overrides)))
    inputs = with_stored_calibration(exported, calibration=calibration)
    return Study(inputs, None if cache is None else Path(cache), progress, exported)


__all__ = ["Identified", "Study", "load"]
