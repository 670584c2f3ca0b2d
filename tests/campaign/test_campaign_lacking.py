"""A stiffness matrix that was exported without the springs of some bolts."""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from lrbc_cli.campaign.reduced.stage import _of_some_bolts


@dataclass(frozen=True)
class Reduced:
    """The parts of a reduced model that tell whether baselines are in its stiffness matrix."""

    K: np.ndarray
    left: np.ndarray
    right: np.ndarray
    structure: int


@pytest.mark.parametrize(
    ("missing", "named"), [((), ""), ((1,), "B2"), ((0, 2), "B1, B3"), ((0, 1, 2, 3), "")], ids=["none", "one", "two", "all of them"]
)
def test_the_bolts_whose_springs_are_missing_are_named(missing: tuple[int, ...], named: str) -> None:
    """Springs between two plates, two a bolt; if all are missing, there is no bolt to name, but a baseline that is to be removed."""
    count, size = 4, 12
    shapes = np.random.default_rng(4).normal(size=(size, 2 * count))
    baseline = np.full(2 * count, 3.0)
    there = np.repeat([bolt not in missing for bolt in range(count)], 2)
    exported = np.diag(np.linspace(0.1, 0.5, size)) + (shapes * (baseline * there)) @ shapes.T
    model: Any = Reduced(K=exported - (shapes * baseline) @ shapes.T, left=shapes, right=shapes, structure=size)
    group = SimpleNamespace(terms=np.arange(2 * count), parameter=np.repeat(np.arange(count), 2), bolt=np.arange(count))
    inputs: Any = SimpleNamespace(bolts=SimpleNamespace(name=[f"B{k + 1}" for k in range(count)]), groups=[group])
    text = _of_some_bolts(inputs, model, baseline, 1e-3, 1e-11)
    assert bool(text) is bool(named)
    assert not named or f"but not those of {named}, or not as stiff" in text
