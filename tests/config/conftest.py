from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from sample_campaign import VALID

from lrbc_cli.config import Campaign, load_campaign
from lrbc_cli.errors import ConfigError

Write = Callable[[str | bytes], Path]


@pytest.fixture
def write(tmp_path: Path) -> Write:
    """Writes a campaign file."""

    def write(content: str | bytes) -> Path:
        path = tmp_path / "campaign.yaml"
        path.write_bytes(content.encode() if isinstance(content, str) else content)
        return path

    return write


@pytest.fixture
def campaign(write: Write) -> Campaign:
    return load_campaign(write(VALID))


@pytest.fixture
def fails(write: Write) -> Callable[..., ConfigError]:
    """Loads a campaign that must fail, and gives the error."""

    def fails(content: str | bytes = VALID, *overrides: str) -> ConfigError:
        path = write(content)
        with pytest.raises(ConfigError) as caught:
            load_campaign(path, overrides)
        assert caught.value.exit_code == 2
        return caught.value

    return fails
