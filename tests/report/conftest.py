from pathlib import Path

import pytest
from fake_campaign import write_campaign

from lrbc_cli.report.write import write_report


@pytest.fixture
def output(tmp_path: Path) -> Path:
    """A small campaign that each test may spoil."""
    write_campaign(tmp_path, (0, 4), responses=("mic01", "mic02"), used=("mic01",), lines=60)
    return tmp_path


@pytest.fixture(scope="session")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A campaign with its report, a failed job included; read only."""
    folder = tmp_path_factory.mktemp("finished")
    said = {"description": "Virtual: nobody measured.", "test_article": "box 7", "operator": "A. Nobody", "compare_with": "paper"}
    options = {"responses": ("mic01", "mic02"), "used": ("mic01",), "lines": 90}
    write_campaign(folder, (0, 4, 15), failed=("bolts-20",), band=True, coherence=True, said=said, **options)
    for file in ("campaign.csv", *(f"bolts-{count:02d}/profile.csv" for count in (0, 4, 15))):
        (folder / file).touch()
    write_report(folder, workers=1)
    return folder
