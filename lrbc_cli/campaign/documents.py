"""Output folder and cache folder: checks that the output belongs to this campaign, and finds the cache."""

from __future__ import annotations

import os
from pathlib import Path

import platformdirs

from lrbc_cli.config import Campaign
from lrbc_cli.errors import ConfigError, DataError
from lrbc_cli.results.model import CampaignRecord
from lrbc_cli.results.store import read


def require_own_output(campaign: Campaign) -> None:
    """Refuse an output folder with the results of another campaign, as jobs with equal names would be confused.

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
            hint="choose another `output`, or remove the folder; if only the campaign was renamed, remove its campaign.json",
        )


def cache_folder(folder: Path | None) -> Path:
    """Folder of the cache: as given, or in the user cache of the platform.

    Raises
    ------
    ConfigError
        If it cannot be used.
    """
    found = Path(os.path.realpath(folder or platformdirs.user_cache_dir("lrbc", appauthor=False)))
    try:
        # The access that look_up makes, with a name of full length.
        (found / ("0" * 32) / "model.h5").is_file()
    except OSError as error:
        raise ConfigError(
            f"the cache cannot be used ({error.strerror or error})", file=found, hint="give another folder with --cache or LRBC_CACHE"
        ) from error
    return found
