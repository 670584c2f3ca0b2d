"""The commented campaign file and folders that a user fills in."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path

from lrbc_cli.errors import ConfigError

FILE = "campaign.yaml"
FOLDERS = ("model", "frf")


def write_skeleton(folder: Path) -> list[Path]:
    """Write a commented campaign file, and folders for the model and the FRFs.

    Parameters
    ----------
    folder
        Where; made if need be.

    Returns
    -------
    list of Path
        What was made.

    Raises
    ------
    ConfigError
        Where a campaign file stands already (it is left as it is), or the folder cannot be written.
    """
    folder = Path(folder)
    template = files("lrbc_cli.config").joinpath("template.yaml").read_text(encoding="utf-8")
    file = folder / FILE
    for below in (folder / name for name in FOLDERS):
        if below.exists() and not below.is_dir():
            raise ConfigError("a file stands where a folder is wanted", file=below, hint="name another folder: lrbc init DIR")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with file.open("x", encoding="utf-8", newline="\n") as stream:
            stream.write(template)
        made = [file]
        for name in FOLDERS:
            below = folder / name
            if not below.is_dir():
                below.mkdir()
                made.append(below)
    except FileExistsError as error:
        taken = Path(error.filename or file)
        raise ConfigError(
            "it exists already and is left as it is", file=taken, hint="name another folder: lrbc init DIR, or move it away"
        ) from None
    except (OSError, ValueError) as error:
        raise ConfigError("the folder cannot be written", file=folder, found=getattr(error, "strerror", None) or str(error)) from None
    return made
