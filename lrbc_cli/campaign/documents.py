"""The folders that are written to: whose the output folder is, and where the cache lies."""

from __future__ import annotations

from pathlib import Path

import platformdirs

from lrbc_cli.config import Campaign
from lrbc_cli.errors import ConfigError, DataError
from lrbc_cli.results.model import CampaignRecord
from lrbc_cli.results.store import read


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
            hint="choose another `output`, or remove the folder; if only the campaign was renamed, remove its campaign.json",
        )


def cache_folder(folder: Path | None) -> Path:
    """The folder of the cache: as given, or the platform's user cache.

    Raises
    ------
    ConfigError
        Where there cannot be such a folder.
    """
    found = (folder or Path(platformdirs.user_cache_dir("lrbc", appauthor=False))).resolve()
    try:
        # What look_up asks for: a name as long as any in the cache.
        (found / ("0" * 32) / "model.h5").is_file()
    except OSError as error:
        raise ConfigError(
            f"the cache cannot be used ({error.strerror or error})", file=found, hint="give another folder with --cache or LRBC_CACHE"
        ) from error
    return found
