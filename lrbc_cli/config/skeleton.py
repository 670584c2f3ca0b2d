"""The command ``lrbc init``: writes a commented campaign file, folders and tables for the user to fill in."""

from __future__ import annotations

import json
from importlib.resources import files
from pathlib import Path

from lrbc_cli.config.schema import campaign_schema
from lrbc_cli.errors import ConfigError

FILE = "campaign.yaml"
FOLDERS = ("model", "frf")

#: File of the JSON Schema beside the campaign file, and the line that refers editors to it.
SCHEMA = "campaign.schema.json"
SCHEMA_LINE = f"# yaml-language-server: $schema={SCHEMA}"

#: Tables to fill in, with commented rows as examples.
TABLES = {
    "model/dofs.csv": (
        "dof,node,component,x,y,z",
        "# one line a row of the matrices, from 0; coordinates in metres:",
        "# 0,1,UZ,0.0,0.0,0.0",
        "# 1,1,ROTX,0.0,0.0,0.0",
    ),
    "model/bolts.csv": ("name,x,y,z", "# one line a bolt; coordinates in metres:", "# B01,0.0,0.05,0.0", "# B02,0.0,0.15,0.0"),
}


def write_skeleton(folder: Path, text: str | None = None) -> list[Path]:
    """Write a campaign file with its schema beside it; if no `text` is given, the template with folders and tables to fill in.

    Parameters
    ----------
    folder
        Target folder; created if it does not exist.
    text
        Text of the campaign file; None: the template.

    Returns
    -------
    list of Path
        Files and folders that were created.

    Raises
    ------
    ConfigError
        If there is a campaign file already (it is not changed), or the folder cannot be written.
    """
    folder = Path(folder)
    template = f"{SCHEMA_LINE}\n" + files("lrbc_cli.config").joinpath("template.yaml").read_text(encoding="utf-8")
    file, folders = folder / FILE, FOLDERS if text is None else ()
    for below in (folder / name for name in folders):
        if below.exists() and not below.is_dir():
            raise ConfigError("there is a file where a folder is needed", file=below, hint="give another folder: lrbc init DIR")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with file.open("x", encoding="utf-8", newline="\n") as stream:
            stream.write(template if text is None else text)
        made = [file]
        for name in folders:
            below = folder / name
            if not below.is_dir():
                below.mkdir()
                made.append(below)
        tables = {name: "\n".join(lines) + "\n" for name, lines in TABLES.items()} if text is None else {}
        schema = json.dumps(campaign_schema(), indent=1, ensure_ascii=False) + "\n"
        for name, content in ({SCHEMA: schema} | tables).items():
            if not (folder / name).exists():
                with (folder / name).open("x", encoding="utf-8", newline="\n") as stream:
                    stream.write(content)
                made.append(folder / name)
    except FileExistsError as error:
        taken = Path(error.filename or file)
        raise ConfigError(
            "it already exists and was left unchanged", file=taken, hint="give another folder: lrbc init DIR, or move it away"
        ) from None
    except (OSError, ValueError) as error:
        raise ConfigError("the folder cannot be written", file=folder, found=getattr(error, "strerror", None) or str(error)) from None
    return made
