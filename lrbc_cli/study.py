"""The public face: a campaign as an object that reduces, computes FRFs, calibrates, identifies and judges; the command line uses it too.

Only ``calibrate`` and ``update`` write result files.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from lrbc_cli import given
from lrbc_cli.arrays import Complexes, Floats
from lrbc_cli.campaign.calibration import with_stored_calibration
from lrbc_cli.campaign.documents import cache_folder
from lrbc_cli.campaign.identification.found import Fit
from lrbc_cli.campaign.identification.identify import fit, identify
from lrbc_cli.campaign.identification.records import Measurement, read_measurement, with_job
from lrbc_cli.campaign.identification.unknowns import found_on_frfs, parameterise, start_parameters, with_values
from lrbc_cli.campaign.jobs.evidence import copied_baseline, evidence_of
from lrbc_cli.campaign.jobs.finished import result_record
from lrbc_cli.campaign.jobs.judging import role_of, scatter_of_records
from lrbc_cli.campaign.jobs.standing import Outcome
from lrbc_cli.campaign.planning.plan import Request, make_plan
from lrbc_cli.campaign.reading.inputs import Inputs, read_as_exported
from lrbc_cli.campaign.reduced.stage import FrfSource, ReductionStage, frf_source, obtain_reduction
from lrbc_cli.config import load_campaign
from lrbc_cli.errors import DataError
from lrbc_cli.identified import Identified, frf_figure, profile_figure
from lrbc_cli.method.rule import changed_rule
from lrbc_cli.model.fem import FeModel
from lrbc_cli.model.terms import Parameterisation
from lrbc_cli.reduction.outcome import Reduction
from lrbc_cli.reduction.steps.grid import require_in_band
from lrbc_cli.results.model import CalibrationRecord
from lrbc_cli.results.plan import PlanRecord
from lrbc_cli.updating.judging.decide import Judgement, judge
from lrbc_cli.updating.judging.reference import ReferenceState

Progress = Callable[[str], None]


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
    exported : Inputs or None
        The same without a stored calibration, which ``calibrate`` needs; None: they hold none.
    """

    def __init__(
        self, inputs: Inputs, cache: Path | None = None, progress: Progress = lambda _: None, exported: Inputs | None = None
    ) -> None:
        self.inputs, self._exported = inputs, inputs if exported is None else exported
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

    def reduce(
        self, *, force: bool = False, accept: bool = False, missed: Callable[[ReductionStage], object] = lambda _: None
    ) -> Reduction:
        """The reduced model with its certificate: from the cache, or built and kept.

        Parameters
        ----------
        force : bool
            Build anew.
        accept : bool
            Accept a model that does not reach its tolerance.
        missed : callable
            Gets a model that does not reach it and is not accepted, before that is raised.

        Raises
        ------
        NumericalError
            Where the tolerance is not reached and not accepted, or memory does not suffice.
        """
        if self._stage is None or force:
            self._stage = obtain_reduction(self.inputs, self._folder, force=force, accept=accept, progress=self._progress, missed=missed)
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
                source = frf_source(self.inputs, self.stage, self._progress, evaluation="auto")
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
        return self.source.model(s, parameters).frf(with_values(parameters, theta, log10, self.inputs.campaign.path))

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
        at = given.numbers("theta", with_values(parameters, theta, log10, self.inputs.campaign.path), (parameters.size,))
        y, J = self.source.model(s, parameters).sensitivities(at)
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
            Where shapes do not fit the responses, lines are not ascending or none lies in the band, or coherence is not between 0 and 1.
        """
        lines, H = given.lines(hz), given.array("values", values, complex, "FRFs")
        expected = (lines.size, len(self.responses))
        if H.shape != expected or not lines.size or np.any(np.diff(lines) <= 0) or lines[0] < 0.0:
            raise DataError("these arrays are no measurement", expected=f"ascending lines and FRFs of shape {expected}", found=f"{H.shape}")
        band = self.inputs.campaign.reduction.band
        inside = (lines >= band[0] * (1 - 1e-9)) & (lines <= band[1] * (1 + 1e-9))
        if not inside.any():
            lie = f"lines from {lines[0]:g} to {lines[-1]:g} Hz"
            raise DataError("no line lies in the band", expected=f"lines from {band[0]:g} to {band[1]:g} Hz", found=lie)
        known = np.full(expected, np.nan) if coherence is None else given.array("coherence", coherence, float, "numbers from 0 to 1")
        if known.shape != expected or np.any((known < 0.0) | (known > 1.0 + 1e-6)):
            raise DataError(
                "this is no coherence", expected=f"numbers from 0 to 1, NaN where unknown, of shape {expected}", found=known.shape
            )
        outside = int((lines < band[0] * (1 - 1e-9)).sum()), int((lines > band[1] * (1 + 1e-9)).sum())
        lines, H, known = lines[inside], H[inside], known[inside]
        return Measurement(
            frequency_hz=lines,
            values=H,
            coherence=known,
            left_out=outside,
            notes=("handed over as arrays",),
            warnings=(),
            records=(),
            hashes={},
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
        inputs, before, known = self._task(job, measurement, reference)
        found = identify(inputs, self.source, job, before, known)
        evidence = evidence_of(inputs, found).beside(copied_baseline(inputs, job, found.measurement))
        others = {other.name: other.record for other in baselines}
        record = result_record(inputs, self.source.stage, found, evidence, others)
        return Identified(name=job, identification=found, evidence=evidence, record=record)

    def fit(self, job: str, measurement: Measurement | None = None, *, reference: Identified | None = None) -> Fit:
        """The cost that ``identify`` minimises, as it is weighted in the end, and where it is least: for studies of the search."""
        inputs, before, known = self._task(job, measurement, reference)
        return fit(inputs, self.source, job, before, known)

    def calibrate(self, *, force: bool = False, accept: bool = False) -> tuple[CalibrationRecord, bool]:
        """Identify the global factors of the model as the campaign says, write and use them, as `lrbc calibrate` does.

        Parameters
        ----------
        force : bool
            Calibrate again even where nothing changed.
        accept : bool
            Accept a reduced model that does not reach its tolerance.

        Returns
        -------
        CalibrationRecord
        bool
            Whether an earlier one was kept.
        """
        from lrbc_cli.campaign.calibrate import run_calibration

        found = run_calibration(self._exported, self._folder, force=force, accept=accept, progress=self._progress)
        self.use_calibration()
        return found

    def use_calibration(self, wanted: bool = True) -> None:
        """Put the factors of the stored calibration into the model where it fits, or leave them out."""
        self.inputs = with_stored_calibration(self._exported, calibration=wanted)
        self._stage = self._source = self._start = None

    def update(self, jobs: Sequence[str] = (), *, force: bool = False, **options: Any) -> Outcome:
        """Identify and judge jobs and write their results, as `lrbc update` does: what is finished and still holds is kept.

        Parameters
        ----------
        jobs : sequence of str
            All where empty.
        force : bool
            Run finished jobs again.
        **options
            ``accept``, ``workers``, ``remote``, see ``run_jobs``.

        Returns
        -------
        Outcome
            ``results`` by job, and ``errors``: a job that fails is a record, not the end.
        """
        from lrbc_cli.campaign.jobs.run import run_jobs

        if isinstance(jobs, str):
            raise given.refuse("jobs", "a sequence of names", repr(jobs))
        if "workers" in options:
            given.count("workers", options["workers"], 1)
        return run_jobs(self.inputs, self._folder, wanted=jobs, force=force, progress=self._progress, **options)[0]

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
        update = self.inputs.campaign.update
        changed, scatter = changed_rule(update, rule), scatter_of_records(other.record for other in baselines)
        given.made_by("found", found, Identified, "what identify returned")
        return judge(found.evidence, changed, role_of(update, found.name), scatter, found.identification.reference)

    def plan(
        self,
        state: str | None = None,
        *,
        noise_db: float | None = None,
        by: str = "auto",
        draws: int | None = None,
        seed: int = 0,
        accept: bool = False,
    ) -> PlanRecord:
        """What `lrbc update` will say of each bolt if it alone is loose: the record of ``plan.json``, see ``lrbc guide sensors``.

        Parameters
        ----------
        state : str or None
            ``initial``, ``clamped``, ``free`` or ``job:NAME``; None: the reference job's stored result, else ``initial``.
        noise_db : float or None
            Standard deviation of a line [dB]; None: what the reference job tells.
        by : str
            What is loosened, one at a time: ``bolts``, ``values``, or ``auto``.
        draws, seed : int or None, int
            Rehearsals of each bolt and loss, about 150 in all where None, linearised figures only where 0; and of what is drawn.
        accept : bool
            Accept a reduced model that does not reach its tolerance.
        """
        given.known("by", by, ("auto", "bolts", "values"))
        given.count("seed", seed)
        if draws is not None:
            given.count("draws", draws)
        if noise_db is not None:
            given.between("noise_db", noise_db, 0.0, np.inf)
        return make_plan(self.inputs, self._folder, Request(state, noise_db, by, draws, seed), accept=accept, progress=self._progress)

    def read(self, job: str) -> Measurement:
        """The measurement of a job, in SI units on the lines of the band."""
        self.inputs.campaign.require_job(job)
        return read_measurement(self.inputs, self.inputs.campaign.jobs[job], job)

    def plot_frf(self, found: Identified, response: str) -> Any:
        """Measured, initial and updated FRF of one response: magnitude in dB, as a matplotlib figure."""
        at = self.responses.index(given.known("response", response, self.responses))
        return frf_figure(found.identification, at, f"{response} [dB re 1 {self.inputs.responses[at].unit}]")

    def plot_profile(self, found: Identified) -> Any:
        """Stiffness along each edge, or of each joint, with its 95 % interval, as a matplotlib figure (paper, Fig. 6)."""
        return profile_figure(found.record)

    def _lines(self, hz: ArrayLike) -> Complexes:
        lines = given.lines(hz)
        require_in_band(lines, self.inputs.campaign.reduction.band, hint="change reduction.band")
        return np.asarray(2j * np.pi * lines)

    def _task(
        self, job: str, measurement: Measurement | None, reference: Identified | None
    ) -> tuple[Inputs, ReferenceState | None, dict[str, Measurement]]:
        """What identifying a job takes: inputs that name it, the reference state, and the measurements at hand."""
        if measurement is not None:
            given.made_by("measurement", measurement, Measurement, "what measurement or read returned")
        if reference is not None:
            given.made_by("reference", reference, Identified, "what identify returned of the reference job")
        known = {} if measurement is None else {job: measurement}
        if reference is not None:
            known[reference.name] = reference.identification.measurement
        if measurement is None:
            self.inputs.campaign.require_job(job)
        inputs = self.inputs if job in self.jobs else with_job(self.inputs, job)
        return inputs, None if reference is None else reference.record.state, known


def load(
    config: str | Path,
    *,
    overrides: Sequence[str] = (),
    calibration: bool = True,
    cache: str | Path | None = None,
    progress: Progress = lambda _: None,
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
    exported = read_as_exported(load_campaign(Path(config), tuple(overrides)))
    inputs = with_stored_calibration(exported, calibration=calibration)
    return Study(inputs, None if cache is None else Path(cache), progress, exported)


__all__ = ["Identified", "Study", "load"]
