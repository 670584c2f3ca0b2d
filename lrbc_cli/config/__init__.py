"""The campaign file: typed, frozen, strict."""

from lrbc_cli.config.calibration import CalibrationConfig, FactorGroup
from lrbc_cli.config.campaign import Campaign
from lrbc_cli.config.fields import ArraysConfig, MatrixRef, OperatorRef
from lrbc_cli.config.loader import load_campaign, load_unfilled
from lrbc_cli.config.schema import campaign_schema
from lrbc_cli.config.settings import (
    EveryLine,
    JobConfig,
    ListedLines,
    MeasuredFile,
    NuisanceConfig,
    ReductionConfig,
    TextFormat,
    UpdateConfig,
)
from lrbc_cli.config.skeleton import write_skeleton
from lrbc_cli.config.structure import (
    DofSource,
    FieldDamping,
    FileRecordRef,
    GroupConfig,
    GroupDampingConfig,
    ModelConfig,
    PointConfig,
    ProportionalDamping,
    RecordRef,
    ResponseConfig,
    SelectConfig,
)
from lrbc_cli.config.watch import WatchConfig

__all__ = [
    "ArraysConfig",
    "CalibrationConfig",
    "Campaign",
    "DofSource",
    "EveryLine",
    "FactorGroup",
    "FieldDamping",
    "FileRecordRef",
    "GroupConfig",
    "GroupDampingConfig",
    "JobConfig",
    "ListedLines",
    "MatrixRef",
    "MeasuredFile",
    "ModelConfig",
    "NuisanceConfig",
    "OperatorRef",
    "PointConfig",
    "ProportionalDamping",
    "RecordRef",
    "ReductionConfig",
    "ResponseConfig",
    "SelectConfig",
    "TextFormat",
    "UpdateConfig",
    "WatchConfig",
    "campaign_schema",
    "load_campaign",
    "load_unfilled",
    "write_skeleton",
]
