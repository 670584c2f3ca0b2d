"""The tools beside the samples are scripts; their packages lie in ``data_samples``."""

from __future__ import annotations

import sys
from pathlib import Path

sys.path[:0] = [str(Path(__file__).parents[1] / "helpers"), str(Path(__file__).parents[2] / "data_samples")]
