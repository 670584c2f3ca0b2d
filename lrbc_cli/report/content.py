"""Content of the page: the records of a campaign, and the charts made from them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

from lrbc_cli.report.drawing.chart import Chart
from lrbc_cli.results.job import Job, JobRecord
from lrbc_cli.results.model import CalibrationRecord, CampaignRecord, ReductionRecord
from lrbc_cli.results.plan import PlanRecord
from lrbc_cli.results.shapes import ShapesRecord
from lrbc_cli.results.structure import StructureRecord
from lrbc_cli.results.tables import Frf
from lrbc_cli.updating.judging.clearance import across, once_more


@dataclass(frozen=True, kw_only=True)
class FrfFigure:
    """An FRF chart with its job and response; ``used`` is false for a validation channel."""

    job: str
    response: str
    used: bool
    chart: Chart


@dataclass(frozen=True, kw_only=True)
class Content:
    """Everything that the page shows; charts are by job. ``missing`` names the jobs of the campaign without a result.

    ``unreadable`` has the errors of results that cannot be read, by job.

    ``unusable`` has the errors in the measurement files of jobs, whose result may be that of an earlier measurement; ``earlier`` says of
    other jobs why their result is; ``passed_over`` has messages on files in the watched folder that belong to no job.
    """

    campaign: CampaignRecord
    jobs: Sequence[Job]
    reduction: ReductionRecord | None
    profiles: Mapping[str, Chart]
    frfs: Sequence[FrfFigure]
    strip: Chart | None = None
    maps: Mapping[str, Chart] = field(default_factory=dict)
    channels: Mapping[str, Chart] = field(default_factory=dict)
    fdac: Mapping[str, Chart] = field(default_factory=dict)
    damping: Chart | None = None
    calibration: CalibrationRecord | None = None
    calibration_frf: Frf | None = None
    l_curves: Mapping[str, Chart] = field(default_factory=dict)
    plan: PlanRecord | None = None
    structure: StructureRecord | None = None
    shapes: Mapping[str, ShapesRecord] = field(default_factory=dict)
    missing: Sequence[str] = ()
    unreadable: Mapping[str, str] = field(default_factory=dict)
    unusable: Mapping[str, str] = field(default_factory=dict)
    earlier: Mapping[str, str] = field(default_factory=dict)
    passed_over: Sequence[str] = ()

    @property
    def along_edges(self) -> bool:
        """Whether any group lies along an edge; otherwise all values are those of joints."""
        return any(group.arc_length is not None for job in self.done for group in job.parameters.values())

    @cached_property
    def copies(self) -> dict[str, str]:
        """Messages on jobs with the measurement of another job."""
        return once_more({job.job: job.finding for job in self.jobs})

    @cached_property
    def across(self) -> dict[str, str]:
        """Messages on jobs that only several jobs show together."""
        return across({job.job: job.finding for job in self.jobs})

    @property
    def done(self) -> list[JobRecord]:
        """Jobs with a result."""
        return [job for job in self.jobs if isinstance(job, JobRecord)]

    @property
    def tool(self) -> str:
        """Name and version of the program that wrote the results."""
        return f"{self.campaign.tool.name} {self.campaign.tool.version}"

    @property
    def anchors(self) -> dict[str, str]:
        """HTML anchor of each job on the page."""
        return {job.job: f"job-{index}" for index, job in enumerate(self.jobs)}
