"""Keeps a campaign in memory while its jobs arrive: model, calibration and reduced model are read or built once."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from lrbc_cli.campaign.beside import outlived
from lrbc_cli.campaign.calibrate import run_calibration
from lrbc_cli.campaign.calibration import with_stored_calibration
from lrbc_cli.campaign.documents import require_own_output
from lrbc_cli.campaign.identification.records import read_measurement
from lrbc_cli.campaign.identification.unknowns import parameterise, select_lines
from lrbc_cli.campaign.jobs.plans import needs, of_earlier_files
from lrbc_cli.campaign.jobs.run import run_jobs
from lrbc_cli.campaign.jobs.standing import Outcome
from lrbc_cli.campaign.protect import require_inputs_apart
from lrbc_cli.campaign.reading.inputs import Inputs, read_as_exported
from lrbc_cli.campaign.reduced.stage import FrfSource, obtain_source
from lrbc_cli.config import Campaign, load_campaign
from lrbc_cli.errors import from_folder
from lrbc_cli.io.common import head
from lrbc_cli.io.encoding import unfinished
from lrbc_cli.report.write import write_report
from lrbc_cli.updating.misfit.cost import SLOPE_STEP
from lrbc_cli.updating.statistics.lines import covers

#: Bytes read at the end of a text file, to see whether its last line has a line end.
TAIL = 64


@dataclass(frozen=True, kw_only=True)
class WatchSettings:
    """Options of the command line for a session."""

    config: Path
    overrides: tuple[str, ...]
    cache: Path
    calibration: bool = True
    accept: bool = False


class Session:
    """A campaign with its model, calibration and reduced model, which judges one job after another.

    Parameters
    ----------
    settings : WatchSettings
    progress : callable
        Called with one line of text for each step.

    Raises
    ------
    ConfigError, DataError
        If the campaign file or its model cannot be used.
    """

    def __init__(self, settings: WatchSettings, progress: Callable[[str], None] = lambda _: None) -> None:
        self.settings, self.progress = settings, progress
        self.exported = self._read(load_campaign(settings.config, settings.overrides))
        self.inputs = with_stored_calibration(self.exported, calibration=settings.calibration)
        self._source: FrfSource | None = None
        self._calibrated = False

    @property
    def campaign(self) -> Campaign:
        """The campaign by the last reading of its file and of the watched folder."""
        return self.inputs.campaign

    @property
    def output(self) -> Path:
        """Folder of the results."""
        return self.campaign.output

    @property
    def tight(self) -> tuple[str, ...]:
        """Jobs on which others rest, in the order of judging: the job of the calibration, the reference job, the baselines."""
        update, calibration = self.campaign.update, self.campaign.calibration if self.settings.calibration else None
        names = (None if calibration is None else calibration.job, update.reference, *update.baselines)
        return tuple(dict.fromkeys(name for name in names if name is not None))

    def needed(self, name: str) -> tuple[str, ...]:
        """Jobs without which a job cannot be judged: those of ``tight`` except baselines, which may be missing."""
        return tuple(other for other in self.tight if other != name and other not in self.campaign.update.baselines)

    def rests_on(self, name: str) -> tuple[str, ...]:
        """Reference job and baselines with which a job is compared."""
        reference, baselines = needs(self.campaign, name)
        return baselines if reference is None else (reference, *baselines)

    def reload(self) -> None:
        """Read the campaign again: new or removed jobs are taken over; if anything else changed, the model is read again too.

        Raises
        ------
        ConfigError, DataError
            If the file cannot be used; the session keeps its earlier state.
        """
        new = load_campaign(self.settings.config, self.settings.overrides)
        require_inputs_apart(new)
        if new.model_dump(exclude={"jobs"}) == self.campaign.model_dump(exclude={"jobs"}):
            self.exported, self.inputs = replace(self.exported, campaign=new), replace(self.inputs, campaign=new)
            return
        exported = self._read(new)
        self.exported, self.inputs = exported, with_stored_calibration(exported, calibration=self.settings.calibration)
        self._source, self._calibrated = None, False

    def prepare(self) -> FrfSource:
        """FRF source of the reduced model, built or loaded at the first call; raises as ``obtain_reduction``."""
        if self._source is None:
            settings = self.settings
            self._source = obtain_source(self.inputs, settings.cache, accept=settings.accept, progress=self.progress)
        return self._source

    def complete(self, name: str) -> bool:
        """Whether the measurement of a job seems complete: it covers the band, and no text file ends within a line.

        Raises
        ------
        LrbcError
            If it cannot be read.
        """
        job = self.campaign.jobs[name]
        found = read_measurement(self.inputs, job, name).frequency_hz
        return covers(found, self.campaign.reduction.band) and not any(_cut(path) for path in job.all_files)

    def judge(self, name: str, missing: Sequence[str]) -> Outcome:
        """Identify and judge one job, and the jobs that it rests on if they changed; calibrates first if the campaign says so.

        Parameters
        ----------
        name : str
        missing : sequence of str
            Jobs that are not measured yet.

        Raises
        ------
        LrbcError
            If the calibration fails or the results cannot be written.
        """
        settings, calibration = self.settings, self.campaign.calibration
        if calibration is not None and settings.calibration and (name == calibration.job or not self._calibrated):
            _, kept = run_calibration(self.exported, settings.cache, accept=settings.accept, progress=self.progress)
            before = self.inputs.calibration
            self.inputs = with_stored_calibration(self.exported)
            if not kept or before != self.inputs.calibration:
                self._source = None
            self._calibrated = True
        outcome, _ = run_jobs(
            self.inputs,
            settings.cache,
            wanted=[name],
            missing=missing,
            source=self.prepare(),
            accept=settings.accept,
            progress=self.progress,
        )
        return outcome

    def warm(self, name: str) -> None:
        """Prepare libraries, interface FRFs and start values for further jobs with the lines of this one; raises as ``judge``."""
        source, found = self.prepare(), read_measurement(self.inputs, self.campaign.jobs[name], name)
        select_lines(self.inputs, found, name)
        s = 2j * np.pi * found.frequency_hz
        parameters, _ = parameterise(self.inputs, source, s)
        source.model(s + 2j * np.pi * SLOPE_STEP * found.frequency_hz[-1], parameters)

    def report(
        self, *, live: bool, figures: bool, halt: Callable[[], bool], unusable: Mapping[str, str], passed_over: Sequence[str]
    ) -> Path:
        """Write the page again, with paths as seen from the campaign file; raises as ``write_report``."""
        here = self.campaign.path.parent
        return write_report(
            self.output,
            expected=list(self.campaign.jobs),
            unusable={name: from_folder(text, here) for name, text in unusable.items()},
            # Changed files are judged anew.
            earlier={name: why for name, why in of_earlier_files(self.campaign, contents=False).items() if name not in unusable},
            passed_over=[*(from_folder(text, here) for text in passed_over), *outlived(self.campaign)],
            workers=1,
            live=live,
            draw=figures,
            halt=halt,
        )

    def _read(self, campaign: Campaign) -> Inputs:
        require_own_output(campaign)
        return read_as_exported(campaign)


def _cut(path: Path) -> bool:
    """Whether a text file ends within a line; False for binary files."""
    if b"\0\0" in head(path, 4096):
        return False
    with path.open("rb") as file:
        file.seek(-min(TAIL, path.stat().st_size), 2)
        return unfinished(file.read())
