"""Finds measurement files that belong to no job, and results without a job: nothing may be forgotten in an all-clear."""

from __future__ import annotations

import os
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
    if campaign.watch is not None:
        return []
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
    found = []
    for folder, suffixes in kinds.items():
        with suppress(OSError):
            # Files written by this program are no measurements.
            entries = () if os.path.realpath(folder) == results else folder.iterdir()
            there = sorted(path for path in entries if path.suffix.lower() in suffixes and path.is_file())
            beside = [shown(path) for path in there if os.path.realpath(path) not in known and not path.name.startswith(HIDDEN)]
            if beside:
                named = listing(beside, most)
                found.append(f"no job uses {named} in {folder}: if that is a measurement, add a job for it")
    return found


def outlived(campaign: Campaign) -> list[str]:
    """Notes on results in the report whose job or measurement file no longer exists."""
    record = read(campaign.output / "campaign.json", CampaignRecord)
    found = []
    for name in () if record is None else record.jobs:
        job = campaign.jobs.get(name)
        try:
            if not (campaign.output / name / "result.json").is_file():
                continue
        except OSError:
            continue  # the report says so
        if job is None:
            ago = f"no longer a job of {campaign.path.name}; the result is that of an earlier job. `lrbc update` leaves it out"
            found.append(f"{name}: {ago}")
        elif lacking := [file for file in job.all_files if not file.exists()]:
            found.append(f"{name}: {lacking[0].name} no longer exists; the result is that of an earlier measurement")
    return found


def unseen(campaign: Campaign) -> str:
    """Reason why there may be measurements in the watched folder that belong to no job; empty if there is none."""
    watched = campaign.watch
    if watched is None:
        return ""
    if not watched.in_reach:
        return f"the watched folder {watched.folder} is not there"
    return "; ".join(passed_over(campaign))
