"""Finds measurement files that belong to no job, and results without a job: nothing may be forgotten in an all-clear."""

from __future__ import annotations

import os
import re
from contextlib import suppress
from pathlib import Path

from lrbc_cli.campaign.protect import input_files
from lrbc_cli.config import Campaign
from lrbc_cli.config.fields import shown
from lrbc_cli.config.watch import HIDDEN
from lrbc_cli.errors import listing
from lrbc_cli.results.model import CampaignRecord
from lrbc_cli.results.store import read


def passed_over(campaign: Campaign) -> list[str]:
    """Notes on measurements in and below the watched folder that belong to no job, with remedies."""
    if campaign.watch is None:
        return []
    return list(campaign.watch.passed_over({path for path, _ in input_files(campaign)}, campaign.output))


def unnamed(campaign: Campaign, *, most: int = 3) -> list[str]:
    """Warnings about files in the folders of the measurements, with the same endings, that no job names (without watched folder)."""
    own = namesakes(campaign)
    found = []
    for job, path in own.items():
        given = ", ".join(shown(file) for file in campaign.jobs[job].all_files)
        found.append(
            f"job {job} reads {given}, but no job uses {shown(path)}, which bears its name. Check which one was meant: for "
            f"{shown(path)} write jobs.{job}.frf: {campaign.relative(path)}"
        )
    for folder, there in _unused(campaign).items():
        if beside := [shown(path) for path in there if path not in own.values()]:
            found.append(f"no job uses {listing(beside, most)} in {folder}: if that is a measurement, add a job for it")
    return found


def namesakes(campaign: Campaign) -> dict[str, Path]:
    """Unused files that bear exactly the name of a job whose own files bear other names, by job."""
    unused = {path.stem.casefold(): path for there in _unused(campaign).values() for path in there}
    return {name: unused[name.casefold()] for name in campaign.jobs if name.casefold() in unused and not _bears_name(campaign, name)}


def taken_twice(campaign: Campaign, first: str, second: str) -> list[str]:
    """Warning about two jobs with the same measurement, to be corrected where the file bears the name of the other job.

    Empty if another warning names the file that was meant (``namesakes``).
    """
    if {first, second} & set(namesakes(campaign)):
        return []
    named = [_bears_name(campaign, name) for name in (first, second)]
    wrong, right = (first, second) if named == [False, True] else (second, first)
    own = f"Write its own file under jobs.{wrong}.frf"
    if named[0] == named[1]:
        own = f"If titles or dates in the files show which one it is, write its own file under jobs.{wrong}.frf, or that of {right} there"
    return [f"job {wrong}: the same measurement as {right}. Check whether another file was meant; a repeat must be measured again. {own}"]


def _bears_name(campaign: Campaign, job: str) -> bool:
    """Whether a file of a job begins with its name, as in ``state-1.uff`` or ``state-1_h2.uff``, but not ``state-12.uff``."""
    begins = re.compile(re.escape(job) + r"(?![^\W_])", re.IGNORECASE)
    return any(begins.match(file.stem) for file in campaign.jobs[job].all_files)


def _unused(campaign: Campaign) -> dict[Path, list[Path]]:
    """Files in each folder of measurements, with the same endings, that no job names; empty with a watched folder."""
    if campaign.watch is not None:
        return {}
    # realpath, since `resolve` fails on links that lead to themselves.
    known = {os.path.realpath(path) for path, _ in input_files(campaign)}
    results = os.path.realpath(campaign.output)
    kinds: dict[Path, set[str]] = {}
    files = [file for job in campaign.jobs.values() for file in job.all_files]
    # If a file is missing, another one in its folder may be that file renamed; its error says so.
    missing = {file.parent for file in files if not file.exists()}
    for file in files:
        if file.parent not in missing:
            kinds.setdefault(file.parent, set()).add(file.suffix.lower())
    found: dict[Path, list[Path]] = {}
    for folder, suffixes in kinds.items():
        with suppress(OSError):
            # Files written by this program are no measurements.
            entries = () if os.path.realpath(folder) == results else folder.iterdir()
            there = sorted(path for path in entries if path.suffix.lower() in suffixes and path.is_file())
            found[folder] = [path for path in there if os.path.realpath(path) not in known and not path.name.startswith(HIDDEN)]
    return found


def outlived(campaign: Campaign) -> list[str]:
    """Notes on results in the report whose job no longer exists."""
    record = read(campaign.output / "campaign.json", CampaignRecord)
    gone = [name for name in (() if record is None else record.jobs) if name not in campaign.jobs and _has_result(campaign, name)]
    ago = f"no longer a job of {campaign.path.name}; the result is that of an earlier job. `lrbc update` leaves it out"
    return [f"{name}: {ago}" for name in gone]


def _has_result(campaign: Campaign, name: str) -> bool:
    try:
        return (campaign.output / name / "result.json").is_file()
    except OSError:
        return False  # the report says so


def unseen(campaign: Campaign) -> str:
    """Reason why there may be measurements in the watched folder that belong to no job; empty if there is none."""
    watched = campaign.watch
    if watched is None:
        return ""
    if not watched.in_reach:
        return f"the watched folder {watched.folder} is not there"
    return "; ".join(passed_over(campaign))
