"""The output folder of a campaign: whose it is, and the results in it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from lrbc_cli.config import Campaign
from lrbc_cli.errors import DataError
from lrbc_cli.results.model import CampaignRecord
from lrbc_cli.results.store import read, read_job


def read_tree(output: Path, name: str, file: str = "result.json") -> dict[str, Any] | None:
    """The result of a job by key; None where there is none.

    Raises
    ------
    DataError, ConfigError
        As ``read_job``.
    """
    job = read_job(output, name, file)
    return None if job is None else job.tree()


def require_own_output(campaign: Campaign) -> None:
    """Refuse an output folder with the results of another campaign: jobs of one name would pass for each other.

    Raises
    ------
    ConfigError
    """
    try:
        record = read(campaign.output / "campaign.json", CampaignRecord)
    except DataError:
        return  # damaged: it is written anew, or the report says so
    if record is not None and record.campaign != campaign.name:
        raise campaign.error(
            "the output folder holds the results of another campaign",
            "output",
            expected=f"results of '{campaign.name}' in {campaign.output}",
            found=f"those of '{record.campaign}'",
            hint="choose another `output`, or remove the folder; if the campaign was only renamed, remove its campaign.json",
        )
