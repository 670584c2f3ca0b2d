"""The command ``lrbc check``."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import click

from lrbc_cli.campaign.check import Findings
from lrbc_cli.campaign.check import check as examine
from lrbc_cli.campaign.files import unusable_files
from lrbc_cli.campaign.reading.inputs import Inputs
from lrbc_cli.campaign.structure import structure_of
from lrbc_cli.cli.common import cache_folder, load, progress, say_json
from lrbc_cli.cli.options import calibration_option, campaign_options, verbosity
from lrbc_cli.cli.terminal import complain, say
from lrbc_cli.config import Campaign, load_unfilled
from lrbc_cli.errors import LrbcError


@click.command()
@campaign_options
@calibration_option
@click.option("--picture", is_flag=True, help="Draw the structure: structure.png and structure.html in the output folder.")
def check(config: Path, overrides: tuple[str, ...], cache: Path | None, as_json: bool, calibration: bool, *, picture: bool) -> int:
    """Check all inputs and print what will be done. Nothing is changed; with --picture, the picture is written.

    If the model cannot be built, all files that cannot be read are listed.
    """
    campaign, unfilled = load_unfilled(config, overrides)
    if unfilled:
        first = unfilled[0]
        first.others = tuple(unfilled[1:])
        return _without_model(campaign, first, as_json)
    try:
        inputs = load(config, overrides, calibration=calibration, warn=False)
    except LrbcError as error:
        return _without_model(campaign, error, as_json)
    drawn = _draw(inputs, tell=not as_json) if picture else []
    detailed, section = as_json or verbosity.level >= 1, (lambda *_: None) if as_json else _section
    findings = examine(inputs, cache_folder(cache), detailed=detailed, pictured=picture, progress=progress(), section=section)
    if as_json:
        say_json(findings.tree | ({"picture": drawn} if picture else {}))
    elif findings.warnings:
        _section("warnings", findings.warnings)
        if left := findings.left.text:
            say(f"{left[0].upper()}{left[1:]}", finding=True)
    elif not findings.errors:
        say(_nothing_found(findings), finding=True)
    for message in _once(findings.errors.values()):
        complain(message)
    return max((unusable.exit_code for unusable in findings.errors.values()), default=0)


def _nothing_found(findings: Findings) -> str:
    """The last line if there are no warnings: what was not compared, or what is left unexplained."""
    if not findings.compared:
        return "no warnings, but measured and computed FRFs were not compared: see jobs"
    return f"no warnings, but {left}" if (left := findings.left.text) else "no warnings"


def _section(title: str, lines: Iterable[str]) -> None:
    say(title)
    for line in lines:
        say(f"  {line}")


def _once(errors: Iterable[LrbcError]) -> list[str]:
    """Messages without repetition: other files with the same error are listed below the first message."""
    told: dict[tuple[str, ...], list[LrbcError]] = {}
    for error in errors:
        told.setdefault((error.problem, *(str(part) for part in (error.expected, error.found, error.hint))), []).append(error)
    return [
        first.message
        + (f"\n  same error: {', '.join(Path(error.file).name if error.file else str(error.place) for error in others)}" if others else "")
        for first, *others in told.values()
    ]


def _draw(inputs: Inputs, *, tell: bool) -> list[Path]:
    """Write the picture of the structure; with `tell`, print its files."""
    # Imported here because it loads matplotlib, which is slow.
    from lrbc_cli.report.write import write_structure

    record = structure_of(inputs)
    files = write_structure(inputs.campaign.output, record)
    if tell:
        _section("picture", [*map(str, files), *record.notes] if files else [f"none: {record.reason}"])
    return files


def _without_model(campaign: Campaign, first: LrbcError, as_json: bool) -> int:
    """Print the error that stopped the reading and those of all other files that cannot be read; returns the exit code."""
    found = unusable_files(campaign)
    errors = {error.message: error for error in (first, *first.others, *(error for several in found.values() for error in several))}
    if as_json:
        trees = {key: [error.tree() for error in several] for key, several in found.items()}
        beside = [error.tree() for error in first.others]
        say_json({"campaign": campaign.name, "exit_code": first.exit_code, "error": first.tree(), "others": beside, "errors": trees})
    for message in errors:
        complain(message)
    if len(errors) > 1 and not as_json:
        say(f"{len(errors)} errors to fix; all other files can be read on their own")
    return first.exit_code
