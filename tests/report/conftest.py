from pathlib import Path

import pytest
from fake_campaign import write_campaign

from lrbc_cli.report import write_report


@pytest.fixture
def output(tmp_path: Path) -> Path:
    """A small campaign that each test may spoil."""
    write_campaign(tmp_path, (0, 4), responses=("mic01", "mic02"), used=("mic01",), lines=60)
    return tmp_path


@pytest.fixture(scope="session")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A campaign with its report, a failed job included; read only."""
    folder = tmp_path_factory.mktemp("finished")
    write_campaign(
        folder, (0, 4, 15), responses=("mic01", "mic02"), used=("mic01",), failed=("bolts-20",), lines=90, band=True, coherence=True
    )
    write_report(folder, workers=1)
    return folder
