"""What of a user's class counts as its code."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

SOURCE = """
from dataclasses import dataclass
import numpy as np
import lrbc_cli as lrbc

FACTOR, TABLE = 2.0, np.array([1.0, 2.0])

def helper(x):
    return FACTOR * x

class Mine(lrbc.BoltPrior):
    '''Words.'''
    share = 0.5

    def tables(self, joint):
        kinds = {"b", "a", "c"}
        return (lambda x: helper(x) + TABLE[0] * self.share + 4.0)(joint), kinds & {"a", "z"}, super().tables(joint)

@dataclass(frozen=True, kw_only=True)
class Wider(Mine):
    more: float = 1.0

from lrbc_cli.updating.own_code import code_of
print(code_of(Wider))
"""


def code(folder: Path, source: str = SOURCE, seed: str = "0") -> str:
    file = folder / "mine.py"
    file.write_text(source)
    env = {"PYTHONHASHSEED": seed, "PYTHONDONTWRITEBYTECODE": "1", "PYTHONPATH": f"{folder}:{Path(__file__).parents[2]}"}
    return subprocess.run([sys.executable, "-c", "import mine"], capture_output=True, text=True, check=True, env=env, cwd=folder).stdout


def test_each_process_finds_the_same_and_words_do_not_count(tmp_path: Path) -> None:
    assert code(tmp_path) == code(tmp_path, seed="7") == code(tmp_path, SOURCE.replace("Words", "Other words").replace("\n\n", "\n\n# x\n"))


@pytest.mark.parametrize(
    "change",
    [("FACTOR, TABLE = 2.0", "FACTOR, TABLE = 3.0"), ("[1.0,", "[1.5,"), ("FACTOR * x", "FACTOR + x"), ("share = 0.5", "share = 0.6")],
)
def test_what_the_methods_use_counts(tmp_path: Path, change: tuple[str, str]) -> None:
    assert code(tmp_path, SOURCE.replace(*change)) != code(tmp_path)


@pytest.mark.parametrize("change", [("4.0", "5.0"), ("kinds &", "kinds |"), ("more: float = 1.0", "more: float = 2.0")])
def test_the_methods_count(tmp_path: Path, change: tuple[str, str]) -> None:
    assert code(tmp_path, SOURCE.replace(*change)) != code(tmp_path)
