"""What ``Study.identify`` takes and returns: one identified and judged job, with figures for scripts and notebooks.

The page of `lrbc report` draws its own figures.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from lrbc_cli import given
from lrbc_cli.campaign.identification.found import Identification
from lrbc_cli.campaign.identification.handed import with_job
from lrbc_cli.campaign.identification.records import Measurement
from lrbc_cli.campaign.reading.inputs import Inputs
from lrbc_cli.errors import LrbcError
from lrbc_cli.results.job import JobRecord
from lrbc_cli.updating.judging.evidence import Evidence
from lrbc_cli.updating.judging.reference import ReferenceState


@dataclass(frozen=True, kw_only=True)
class Identified:
    """One identified and judged job.

    Attributes
    ----------
    name : str
    identification : Identification
        Identified values, their posterior, and the FRFs before and after the identification.
    evidence : Evidence
        The part of the identification on which verdicts rest.
    record : JobRecord
        Contents of ``result.json``, see ``lrbc guide results``.
    baselines : tuple of Identified
        Further jobs with all bolts tight, whose scatter moved the threshold.
    """

    name: str
    identification: Identification = field(repr=False)
    evidence: Evidence = field(repr=False)
    record: JobRecord = field(repr=False)
    baselines: tuple[Identified, ...] = field(default=(), repr=False)

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
        """Posterior probability that each bolt is loose; None if none is stated."""
        return {bolt.name: bolt.probability_loose for bolt in self.record.bolts}


class TightStates:
    """The reference job and the baselines of a campaign, identified once; with a reference job that was given, until another one is given.

    Parameters
    ----------
    identify : callable
        ``Study.identify``.
    """

    def __init__(self, identify: Callable[..., Identified]) -> None:
        self._identify = identify
        self._known: list[tuple[Identified | None, Identified]] = []

    def of(self, name: str, reference: Identified | None = None) -> Identified:
        """One of them; ``reference`` is the reference job that was given, None that of the campaign."""
        known = next((found for beside, found in self._known if found.name == name and beside is reference), None)
        if known is None:
            known = self._identify(name, reference=reference)
            self._known = [each for each in self._known if each[0] is None or each[0] is reference] + [(reference, known)]
        return known

    def usable(self, names: Sequence[str], reference: Identified | None, progress: Callable[[str], None]) -> tuple[Identified, ...]:
        """Those of the jobs that can be identified; ``progress`` tells of others."""
        found = []
        for name in names:
            try:
                found.append(self.of(name, reference))
            except LrbcError as error:
                progress(f"baseline {name} is left out: {error.problem}")
        return tuple(found)


def frf_figure(found: Identification, response: int, label: str) -> Any:
    """Plot the measured, initial and updated FRF of one response (a column index), magnitude in dB, as a matplotlib figure."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8, 4), layout="constrained")
    axes, measured = figure.subplots(), found.measurement.values
    with np.errstate(divide="ignore", invalid="ignore"):
        for name, H, style in (("measured", measured, "-"), ("initial", found.initial, ":"), ("updated", found.updated, "--")):
            axes.plot(found.measurement.frequency_hz, 20 * np.log10(np.abs(H[:, response])), style, label=name)
    axes.set(xlabel="frequency [Hz]", ylabel=label, title=found.name)
    axes.legend()
    return figure


def profile_figure(record: JobRecord) -> Any:
    """Plot the stiffness along each edge, or of each joint, with its 95 % interval, as a matplotlib figure."""
    from matplotlib.figure import Figure

    groups = {name: entry for name, entry in record.parameters.items() if entry.arc_length is not None or entry.bolts}
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
        axes.set(xlabel="along the edge [m]" if entry.bolts is None else "", ylabel=f"log10 of {name} [{entry.unit}]", title=record.job)
        axes.legend()
    return figure


def task(
    inputs: Inputs, job: str, measurement: Measurement | None, reference: Identified | None, identified: Callable[[str], Identified]
) -> tuple[Inputs, ReferenceState | None, dict[str, Measurement]]:
    """Arguments of an identification: inputs that contain the job, the reference state, and measurements already in memory.

    The reference job is taken from ``identified`` if none is given and this is another job.
    """
    given.made_by("job", job, str, "the name of a job (a measurement is the next argument)")
    if measurement is not None:
        given.made_by("measurement", measurement, Measurement, "the value returned by measurement or read")
    if reference is not None:
        given.made_by("reference", reference, Identified, "the value returned by identify for the reference job")
    known, tight = {} if measurement is None else {job: measurement}, inputs.campaign.update.reference
    if measurement is None:
        inputs.campaign.require_job(job)
    if reference is None and tight is not None and job != tight:
        reference = identified(tight)
    if reference is not None:
        known[reference.name] = reference.identification.measurement
    own = inputs if job in inputs.campaign.jobs else with_job(inputs, job)
    return own, None if reference is None else reference.record.state, known
