import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "helpers"))

from campaign_fixtures import frame, frame_once  # noqa: F401
