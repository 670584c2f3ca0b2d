"""The template loads, shows every key, and never overwrites."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from lrbc_cli.config import Campaign, campaign_schema, load_campaign, write_skeleton
from lrbc_cli.config.explain import key_paths
from lrbc_cli.errors import ConfigError


def test_it_writes_a_campaign_that_loads(tmp_path: Path) -> None:
    folder = tmp_path / "new" / "campaign"
    made = write_skeleton(folder)
    tables = [folder / "model" / "dofs.csv", folder / "model" / "bolts.csv"]
    assert made == [folder / "campaign.yaml", folder / "model", folder / "frf", folder / "campaign.schema.json", *tables]
    # Editors find the schema, and rows that only show how are comments.
    assert made[0].read_text(encoding="utf-8").startswith(f"# yaml-language-server: $schema={made[3].name}\n")
    assert json.loads(made[3].read_text(encoding="utf-8")) == campaign_schema()
    for table in tables:
        assert all(line.startswith("#") for line in table.read_text().splitlines()[1:])
    campaign = load_campaign(made[0])
    assert campaign.parameters["edge"].initial == "auto"


def test_existing_folders_are_used(tmp_path: Path) -> None:
    (tmp_path / "model").mkdir()
    (tmp_path / "model" / "dofs.csv").write_text("mine")
    made = write_skeleton(tmp_path)
    assert made == [tmp_path / name for name in ("campaign.yaml", "frf", "campaign.schema.json", "model/bolts.csv")]
    assert (tmp_path / "model" / "dofs.csv").read_text() == "mine"


def test_nothing_is_overwritten(tmp_path: Path) -> None:
    (tmp_path / "campaign.yaml").write_text("mine")
    with pytest.raises(ConfigError, match="already exists"):
        write_skeleton(tmp_path)
    assert (tmp_path / "campaign.yaml").read_text() == "mine"
    assert list(tmp_path.iterdir()) == [tmp_path / "campaign.yaml"]


@pytest.mark.parametrize("name", ["", "frf"])
def test_a_file_in_the_way(tmp_path: Path, name: str) -> None:
    folder = tmp_path / "campaign"
    if name:
        folder.mkdir()
    (folder / name).write_text("mine")
    with pytest.raises(ConfigError) as caught:
        write_skeleton(folder)
    assert caught.value.file == str(folder / name)
    assert not (folder / "campaign.yaml").exists()


def test_the_template_shows_every_key_and_its_default(tmp_path: Path) -> None:
    text = write_skeleton(tmp_path)[0].read_text(encoding="utf-8")
    for path in key_paths(Campaign):
        assert re.search(rf"\b{path.rsplit('.', 1)[-1]}\b", text), path
    defaults = {
        "tolerance": "1.0e-3",
        "held_out": "5",
        "max_iterations": "100",
        "loose_change": "-0.5",
        "regularisation": "auto",
        "prior_std": "auto",
        "largest_misfit": "3.0",
    }
    for key, value in defaults.items():
        assert re.search(rf"\b{key}: {re.escape(value)}\s", text), key


def test_the_commented_keys_are_valid_too(tmp_path: Path) -> None:
    path = write_skeleton(tmp_path)[0]
    lines = [
        re.sub(r"^( *)# (?= *[a-z_]+[-\d]*:(\s|$))", r"\1", line) if "hammer" not in line or "excitation: hammer" in line else line
        for line in path.read_text(encoding="utf-8").splitlines()
    ]
    path.write_text("\n".join(lines), encoding="utf-8")
    campaign = load_campaign(path)
    assert campaign.jobs["loose-1"].format is not None
    assert list(campaign.responses) == ["acc1", "acc2", "mic1"]
    assert campaign.reduction.max_size == 500
    assert campaign.parameters["edge"].damping is not None
    assert campaign.parameters["edge"].damping.beta == 1e-6
