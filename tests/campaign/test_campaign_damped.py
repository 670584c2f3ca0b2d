"""Damping coefficients that are off by powers of ten, by the damping of the measured modes."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from looking import measurement

from lrbc_cli.campaign.looking.causes.damped import misdamped_text
from lrbc_cli.config.structure import FieldDamping, ProportionalDamping
from lrbc_cli.updating.statistics.chain.modal import MODAL

HZ = np.arange(20.0, 400.0, 0.5)
MODES = 2.0 * np.pi * np.array([61.0, 118.0, 190.0, 262.0, 341.0])
ALPHA, BETA = 3.0, 4e-6


def told(alpha: float = ALPHA, beta: float = BETA, loss: float = 0.0, air: FieldDamping | None = None) -> str | None:
    """A structure with these modes, and a model with these coefficients, perhaps with air."""
    s, shapes = 2j * np.pi * HZ[:, None], np.random.default_rng(1).standard_normal((5, 4))
    H = s**2 / (s**2 + (ALPHA + BETA * MODES**2) * s + MODES**2) @ shapes
    damping = ProportionalDamping(structure=FieldDamping(alpha=alpha, beta=beta, loss_factor=loss), acoustic=air or FieldDamping())
    model = SimpleNamespace(is_acoustic=np.array([False, air is not None]))
    tied = {name: SimpleNamespace(damping=SimpleNamespace(beta=beta + more)) for name, more in (("axial", 0.0), ("rocking", 1.0))}
    campaign = SimpleNamespace(model=SimpleNamespace(damping=damping), parameters=tied)
    inputs: Any = SimpleNamespace(campaign=campaign, model=model, statistics=SimpleNamespace(modal=MODAL))
    return misdamped_text(inputs, measurement(HZ, H))


def test_damping_as_measured_and_within_a_decade() -> None:
    assert told() is None
    assert told(alpha=10.0 * ALPHA, beta=5.0 * BETA) is None
    assert told(alpha=0.0, beta=0.0) is None


@pytest.mark.parametrize(
    ("wrong", "fix"),
    [
        ({"beta": 1e3 * BETA}, "beta: 4e-06"),
        ({"alpha": 1e3 * ALPHA}, "alpha: 3"),
        ({"loss": 0.4, "alpha": 0.0, "beta": 0.0}, "loss_factor"),
    ],
)
def test_a_coefficient_a_thousand_times_too_large(wrong: dict[str, float], fix: str) -> None:
    text = str(told(**wrong))
    assert f"Write {fix}" in text
    # Springs with the same coefficient.
    assert (", also in the damping of parameters.axial" in text) == ("beta" in wrong and wrong["beta"] > 0.0)
    assert "is probably wrong by a power of ten" in text


def test_a_loss_factor_stated_as_beta_of_both_fields() -> None:
    """Each is told at once, and what it may be."""
    stated = 0.012
    text = str(told(alpha=0.0, beta=stated, air=FieldDamping(beta=stated)))
    for field in ("structure", "acoustic"):
        assert f"model.damping.{field}: beta: 0.012 is probably wrong by a power of ten" in text
    assert text.count(", or loss_factor: 0.012 if that is what it is") == 2
    # Ten times as much is no loss factor of these modes.
    assert "loss_factor" not in str(told(alpha=0.0, beta=0.4))


def test_all_damping_far_too_small() -> None:
    assert "Write beta: 4e-06" in str(told(alpha=1e-3 * ALPHA, beta=1e-3 * BETA))


def test_coefficients_computed_from_frequencies_in_hz() -> None:
    turn = 2.0 * np.pi
    text = str(told(alpha=ALPHA / turn, beta=BETA * turn))
    assert "were probably computed from frequencies in Hz in place of rad/s" in text
    assert "Write alpha: 3, beta: 4e-06" in text
    # Damping of another height, or one coefficient alone, is not that.
    assert told(alpha=ALPHA / turn, beta=BETA) is None
    assert told(alpha=ALPHA, beta=BETA * turn) is None
    assert told(alpha=ALPHA * turn, beta=BETA / turn) is None
    # Nor is damping that is too small by one factor, where beta hardly counts: that of joints, for example, was left out.
    assert told(alpha=0.3 * ALPHA, beta=0.1 * BETA) is None
    # The measured peaks may be those of the air.
    assert told(alpha=ALPHA / turn, beta=BETA * turn, air=FieldDamping(alpha=ALPHA, beta=BETA)) is None


def test_beside_air_only_a_structure_that_does_not_ring_is_told() -> None:
    """The measured peaks may be those of the air."""
    air = FieldDamping(alpha=ALPHA, beta=BETA)
    assert told(alpha=30.0 * ALPHA, beta=20.0 * BETA, air=air) is None
    assert "structure: beta: 0.004" in str(told(beta=1e3 * BETA, air=air))
    # The air explains the measured damping.
    assert told(alpha=1e-4, beta=0.0, air=air) is None
