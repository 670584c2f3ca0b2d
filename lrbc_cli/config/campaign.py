"""The top-level model of the campaign file, with the places of its keys for messages."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field, PrivateAttr

from lrbc_cli.config.calibration import CalibrationConfig
from lrbc_cli.config.document import Document
from lrbc_cli.config.explain import suggestion
from lrbc_cli.config.fields import FilePath, NameMap, Strict, problem
from lrbc_cli.config.settings import JobConfig, ReductionConfig, UpdateConfig
from lrbc_cli.config.structure import GroupConfig, ModelConfig, PointConfig, ResponseConfig
from lrbc_cli.config.watch import WatchConfig
from lrbc_cli.errors import ConfigError
from lrbc_cli.model.units import USUAL_SYSTEMS, UnitSystem, parse_system


def _check_title(value: str) -> str:
    if not value.strip() or "\n" in value:
        raise problem("this is not a valid campaign name", expected="one line of text", found=f"{value!r}")
    return value


def _meant_units(value: str) -> str | None:
    """Hint with the usual unit system of the same words, else of the same length and force; otherwise all usual systems."""
    plain = re.sub(r"[\s,;/_-]+", "-", value.strip()).lower().replace("tonnes", "t").replace("tonne", "t").replace("ton", "t")
    words = set(plain.split("-"))
    near = next((text for text in USUAL_SYSTEMS if set(text.lower().split("-")) == words), None)
    # If length, force and mass do not fit, the mass is most likely wrong.
    near = near or next(
        (text for text in USUAL_SYSTEMS if text.count("N") + text.count("lbf") and set(text.lower().split("-")[:2]) < words), None
    )
    return f"write units: {near}" if near else "the usual ones are " + ", ".join(USUAL_SYSTEMS)


def _check_units(value: str) -> str:
    try:
        parse_system(value)
    except ValueError as error:
        raise problem(
            "this is not a system of units",
            expected="SI or three of length, force, mass and time, such as mm-N-t",
            found=f"'{value}': {error}",
            hint=_meant_units(value),
        ) from None
    return value


class Campaign(Strict):
    """A campaign file: model, measurements, parameters and settings. Paths are relative to the file, units SI unless `units` says more.

    Read-only, including its mappings. `place` and `error` give messages of all layers the line and key path in the file.
    """

    name: Annotated[str, Field(max_length=200), AfterValidator(_check_title)] = Field(
        alias="campaign", description="Name of the campaign, for reports."
    )
    output: FilePath = Field(
        default=Path("output"), validate_default=False, description="Folder for the results. If omitted: `output` beside the campaign file."
    )
    description: Annotated[str, Field(max_length=2000)] = Field(
        default="", description="What was measured, in one or two sentences, for the head of the report page. Does not change results."
    )
    test_article: Annotated[str, Field(max_length=200)] = Field(
        default="", description="What was tested: name, drawing or serial number, for the head of the report page."
    )
    operator: Annotated[str, Field(max_length=200)] = Field(default="", description="Who measured, for the head of the report page.")
    compare_with: Literal["paper"] | None = Field(
        default=None,
        description="`paper`: the damping and the times that the paper states for its SoundBox are shown beside those of this campaign.",
    )
    units: Annotated[str, AfterValidator(_check_units)] = Field(
        default="SI",
        description="Units of the model files and of all coordinates, also of those in this file: three of length, force, mass and time, "
        "such as mm-N-t, mm-kg-ms or in-lbf-s. Everything else (values and bounds of parameters, damping, results) is in SI. FRF files "
        "state their own units.",
    )
    model: ModelConfig = Field(description="The finite-element model.")
    excitation: Annotated[NameMap[PointConfig], Field(min_length=1)] = Field(description="Excitation points by name, at least one.")
    responses: Annotated[NameMap[ResponseConfig], Field(min_length=1)] = Field(description="Responses by name, at least one.")
    parameters: Annotated[NameMap[GroupConfig], Field(min_length=1)] = Field(description="Parameter groups by name, at least one.")
    bolts: FilePath | None = Field(
        default=None,
        description="File of the bolts to be judged (CSV: name,x,y,z). If omitted: the bolts that the terms name, at the positions of the "
        "terms.",
    )
    reduction: ReductionConfig = Field(description="The reduced model.")
    update: UpdateConfig = Field(default=UpdateConfig(), description="The identification.")
    calibration: CalibrationConfig | None = Field(
        default=None, description="Global factors of the model, for `lrbc calibrate`. If omitted: the model as exported."
    )
    jobs: NameMap[JobConfig] = Field(
        default={}, validate_default=True, description="Measurements to identify, by name. Each gets a folder of results."
    )
    watch: WatchConfig | None = Field(
        default=None,
        description="A folder in which every file is a further job, with the name of the file, for every command. If omitted: only `jobs`.",
    )

    _document: Document = PrivateAttr()

    @property
    def unit_system(self) -> UnitSystem:
        """Unit system of the model files and of all coordinates."""
        return parse_system(self.units)

    @property
    def path(self) -> Path:
        """Absolute path of the campaign file."""
        return self._document.file

    def place(self, *keys: str | int) -> str:
        """Place of a key path for messages: ``line 12, parameters.left_edge.bounds``."""
        return self._document.place(*keys)

    def error(self, problem: str, *keys: str | int, expected: object = None, found: object = None, hint: str | None = None) -> ConfigError:
        """Return (not raise) a ConfigError about the value at the key path `keys`."""
        return self._document.error(problem, *keys, expected=expected, found=found, hint=hint)

    def relative(self, path: Path) -> str:
        """A path as the campaign file states it: relative to its folder."""
        return Path(os.path.relpath(path, self.path.parent)).as_posix()

    def require_job(self, name: str, place: str | None = None) -> None:
        """Raise a ConfigError if there is no job `name`; `place` is where the name was given, such as ``--job``."""
        if name not in self.jobs:
            known, hint = ", ".join(self.jobs) or "a job", suggestion(name, self.jobs)
            raise ConfigError(f"no job '{name}' in this campaign", file=self.path, place=place, expected=known, found=name, hint=hint)

    def resolved(self) -> dict[str, Any]:
        """The campaign as values for JSON: with all defaults and overrides, paths as written."""
        values = self.model_dump(by_alias=True)
        written = _as_written(values, self._document.root.plain(), self.path.parent)
        assert isinstance(written, dict)
        return written


def _as_written(value: object, raw: object, folder: Path) -> object:
    if isinstance(value, Path):
        return raw if isinstance(raw, str) else Path(os.path.relpath(value, folder)).as_posix()
    if isinstance(value, Mapping):
        if isinstance(raw, str):
            return raw
        return {key: _as_written(item, raw.get(key) if isinstance(raw, Mapping) else None, folder) for key, item in value.items()}
    if isinstance(value, list | tuple):
        parts = raw if isinstance(raw, tuple) and len(raw) == len(value) else (None,) * len(value)
        return [_as_written(item, part, folder) for item, part in zip(value, parts, strict=True)]
    return value
