"""Reads the campaign file into frozen pydantic models; wrong files give one error with line, key path and advice."""

from lrbc_cli.config.campaign import Campaign
from lrbc_cli.config.fields import MatrixRef
from lrbc_cli.config.loader import load_campaign, load_unfilled
from lrbc_cli.config.schema import campaign_schema
from lrbc_cli.config.settings import EveryLine, JobConfig, ListedLines, UpdateConfig
from lrbc_cli.config.skeleton import write_skeleton
from lrbc_cli.config.structure import ModelConfig, ProportionalDamping, RecordRef

__all__ = [
    "Campaign",
    "EveryLine",
    "JobConfig",
    "ListedLines",
    "MatrixRef",
    "ModelConfig",
    "ProportionalDamping",
    "RecordRef",
    "UpdateConfig",
    "campaign_schema",
    "load_campaign",
    "load_unfilled",
    "write_skeleton",
]
