"""Numbers of the statistical model and of the decision rule are checked where they are set."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from dataclasses import dataclass, fields, replace

import numpy as np
import pytest

from lrbc_cli.errors import ConfigError
from lrbc_cli.updating.checked import Checked, Positive
from lrbc_cli.updating.judging.rule import DecisionRule
from lrbc_cli.updating.statistics.model import STATISTICS, StatisticalModel
from lrbc_cli.updating.statistics.priors import BoltPrior

PARTS = [DecisionRule(), *(getattr(STATISTICS, entry.name) for entry in fields(STATISTICS))]


class Mine(BoltPrior):
    """As a user writes it, with another class inside the function that calls it."""


@pytest.mark.parametrize("part", PARTS, ids=lambda part: type(part).__name__)
@pytest.mark.parametrize("wrong", [np.nan, -np.inf, "0.5", True, None, -1e9])
def test_every_number_is_checked(part: Checked, wrong: object) -> None:
    for entry in fields(part):  # type: ignore[arg-type]
        # The only numbers of either sign.
        if wrong == -1e9 and ("_mean" in entry.name or "_change" in entry.name):
            continue
        with pytest.raises(ConfigError) as caught:
            replace(part, **{entry.name: wrong})  # type: ignore[type-var]
        assert caught.value.place == f"{type(part).__name__}.{entry.name}"
        assert (caught.value.found, bool(caught.value.expected)) == (repr(wrong), True)


@pytest.mark.parametrize(
    ("make", "expected"),
    [
        (lambda: Mine(loose_share=3), "a number above 0 and below 1"),
        (lambda: BoltPrior(loose_mean=0.5), "a number below 0"),
        (lambda: DecisionRule(confidence=0.5), "a number above 0.5 and below 1"),
        (lambda: replace(STATISTICS.errors, noise_window=2.5), "a whole number at least 1"),
        (lambda: replace(STATISTICS.resolution, aside=(2, 0)), "a tuple, each a whole number at least 1"),
        (lambda: replace(STATISTICS.limits, fallback=(1.0, 2.0)), "a tuple of 3, each a number"),
        (lambda: StatisticalModel(bolts=DecisionRule()), "an instance of BoltPrior"),
    ],
)
def test_the_message_says_what_is_expected(make: Callable[[], object], expected: str) -> None:
    with pytest.raises(ConfigError) as caught:
        make()
    assert caught.value.expected == expected


def test_numbers_of_numpy_and_whole_numbers_are_numbers() -> None:
    assert BoltPrior(tight_std=np.float64(0.1), loose_std=1).loose_std == 1


def test_own_classes_keep_what_a_frozen_dataclass_offers() -> None:
    own = Mine(loose_share=0.2)
    assert own == Mine(loose_share=0.2) != BoltPrior(loose_share=0.2)
    assert len({own, Mine(loose_share=0.2), pickle.loads(pickle.dumps(own))}) == 1
    assert replace(STATISTICS, bolts=own).bolts is own


def test_fields_of_own_classes_are_checked_as_far_as_their_types_are_known() -> None:
    @dataclass(frozen=True, kw_only=True)
    class More(BoltPrior):
        width: Positive = 1.0

    class Local:
        pass

    @dataclass(frozen=True, kw_only=True)
    class Hidden(BoltPrior):
        width: Local | None = None

    with pytest.raises(ConfigError, match=r"More\.width"):
        More(width=-1.0)
    with pytest.raises(ConfigError, match=r"Hidden\.tight_std"):
        Hidden(tight_std=-1.0)
