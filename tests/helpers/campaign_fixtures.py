"""Fixtures for the tests of campaigns and commands."""

from __future__ import annotations

from pathlib import Path

import campaigns
import pytest
from campaigns import Folder


@pytest.fixture(scope="session")
def frame_once() -> Folder:
    """The frame campaign, all jobs done; read only."""
    return campaigns.finished("frame")


@pytest.fixture
def frame(frame_once: Folder, tmp_path: Path) -> Folder:
    """A copy of the finished frame campaign to work on."""
    return frame_once.copy(tmp_path / "frame")


@pytest.fixture
def box(tmp_path: Path) -> Folder:
    """A copy of the finished tiny u-p campaign to work on."""
    return campaigns.finished("box").copy(tmp_path / "box")
