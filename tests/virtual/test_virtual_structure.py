"""A user's model as the structure might turn out: what is off, what is loosened, how it is measured."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from campaigns import lrbc
from samples import reduced_cache, sample

from lrbc_cli.campaign.planning.draws import estimates
from lrbc_cli.campaign.planning.patches import Structure, patches
from lrbc_cli.campaign.reading.inputs import Inputs, read_as_exported
from lrbc_cli.config import load_campaign
from lrbc_cli.errors import ConfigError
from lrbc_cli.io.frf import read_frf
from lrbc_cli.virtual.drift import Drift, Scatter
from lrbc_cli.virtual.structure import Settings, VirtualStructure, moved_loads

FRAME = Path(__file__).parents[2] / "configs" / "frame.yaml"
EXACT = Settings(noise=0.0, retorque=0.0, perturb=0.0, damping=0.0)
LINES = np.arange(30.0, 500.0, 7.0)


def structure(settings: Settings, *overrides: str) -> VirtualStructure:
    inputs = read_as_exported(load_campaign(FRAME, overrides))
    return VirtualStructure(inputs, settings, 1, reduced_cache("frame"), LINES)


def linear_field(inputs: Inputs, a: float, b: float, c: float) -> np.ndarray:
    """DOFs of the deflection a + b x + c y."""
    table = inputs.dofs
    assert table is not None
    x, y, _ = table.xyz.T
    values = {"UZ": a + b * x + c * y, "ROTX": np.full(x.size, c), "ROTY": np.full(x.size, -b), "TWIST": np.zeros(x.size)}
    return np.select([table.component == name for name in values], list(values.values()))


@pytest.mark.parametrize("rotations", [True, False], ids=["moment", "gradient"])
def test_moved_hit_works_on_the_moved_deflection(rotations: bool) -> None:
    inputs = sample("frame")
    table = inputs.dofs
    assert table is not None
    if not rotations:
        inputs = replace(inputs, dofs=replace(table, component=np.where(table.component == "UZ", "UZ", "OTHER")))
    load = moved_loads(inputs, (0.004, -0.003)).toarray()[:, 0]
    field = linear_field(sample("frame"), 0.2, 1.5, -0.7)
    x, y = 0.16, 0.12
    assert load @ field == pytest.approx(0.2 + 1.5 * (x + 0.004) - 0.7 * (y - 0.003), rel=1e-9)


def test_patches_share_the_edge() -> None:
    inputs = sample("frame")
    found = patches(inputs, None)
    total = np.sum([w["left_edge"] for w in found.values()], axis=0)
    assert np.all(total <= 1 + 1e-12)
    assert np.all(total > 0.3)
    arc = inputs.groups[0].arc_length
    assert arc is not None
    centres = [float(arc @ w["left_edge"] / w["left_edge"].sum()) for w in found.values()]
    assert np.all(np.diff(centres) > 0.04)
    with pytest.raises(ConfigError, match="the campaign has none"):
        patches(replace(inputs, bolts=None), None)


@pytest.mark.parametrize("loss", [0.5, 2.0])
def test_a_plan_loosens_what_a_rehearsal_loosens(loss: float) -> None:
    """The stiffness of the terms: were it the values that are smoothed, neighbours would give most of it back."""
    virtual = structure(replace(EXACT, depth=loss))
    inputs, smoothed = virtual.inputs, virtual.parameters
    own = Structure.of(inputs, smoothed, smoothed.initial, by_bolt=True)
    values = own.parameters.placed[0][1]
    assert np.array_equal(own.parameters.groups[0].smoothing, np.eye(values.stop - values.start))
    # The same structure, whichever way it is written.
    s = virtual.s
    np.testing.assert_allclose(own.parameters.dynamic(own.theta, s), smoothed.dynamic(smoothed.initial, s), rtol=1e-12)
    for bolt, name in enumerate(("B1", "B4")):
        there, by = own.changed(3 * bolt, -loss)
        drawn = np.array(virtual.profile([name])[1]["left_edge"])
        assert by == pytest.approx(-loss)
        np.testing.assert_allclose((there - own.theta)[values], drawn - smoothed.initial[values], atol=1e-3)
        assert (own.theta - there)[values].max() > 0.95 * loss


def test_probabilities_of_few_draws() -> None:
    """By a bolt's own draws and the share among the others as one more; intervals by its own draws."""
    probability, interval = estimates([3, 0, 2], [3, 3, 3])
    np.testing.assert_allclose(probability, [(3 + 2.5 / 7) / 4, (0 + 5.5 / 7) / 4, (2 + 3.5 / 7) / 4])
    assert interval[0][1] == 1.0
    assert interval[1][0] == 0.0
    _, (eight, none) = estimates([8, 0], [10, 10])
    np.testing.assert_allclose(eight, [0.502, 0.955], atol=0.02)
    np.testing.assert_allclose(none, [0.0, 0.217], atol=0.01)
    alone, _ = estimates([5], [5])
    assert alone == pytest.approx(5.5 / 6)


def test_nothing_wrong_and_nothing_loose_is_the_model(tmp_path: Path) -> None:
    plain = "parameters.left_edge.smoothing=null"
    frf, _ = structure(EXACT, plain).measure([])
    out = tmp_path / "model.uff"
    assert lrbc("simulate", FRAME, "--override", plain, "--cache", tmp_path, "--out", out, "--lines", "30:500:7", "--full").code == 0
    for found, expected in zip(frf.records, read_frf(out).records, strict=True):
        assert found.name == expected.name
        np.testing.assert_allclose(found.values, expected.values, rtol=0, atol=1e-3 * np.abs(expected.values).max())


@pytest.mark.parametrize(
    ("settings", "removed"),
    [
        (replace(EXACT, perturb=0.005), ()),
        (replace(EXACT, damping=0.1), ()),
        (replace(EXACT, noise=0.01), ()),
        (replace(EXACT, retorque=0.3), ()),
        (replace(EXACT, level=7.0), ()),
        (replace(EXACT, scatter=Scatter(hammer=0.003)), ()),
        (replace(EXACT, scatter=Scatter(gain=0.5)), ()),
        (replace(EXACT, scatter=Scatter(factors={"damping.structure": 0.2})), ()),
        (EXACT, ("B3",)),
    ],
)
def test_drift_and_faults_change_the_measurement(settings: Settings, removed: tuple[str, ...]) -> None:
    def values(settings: Settings, removed: tuple[str, ...] = ()) -> np.ndarray:
        return np.array([r.values for r in structure(settings).measure(removed)[0].records])

    plain = values(EXACT)
    assert np.linalg.norm(values(settings, removed) - plain) > 1e-3 * np.linalg.norm(plain)


def test_no_air_warms_in_a_frame() -> None:
    with pytest.raises(ConfigError, match="the model has no air DOFs"):
        structure(replace(EXACT, scatter=Scatter(kelvin=2.0)))


@pytest.mark.slow
def test_warm_air_of_a_coupled_model() -> None:
    """As the frequencies of a gas: stiffness of the air by the temperature, all else as it was (its proportional damping follows)."""
    inputs = sample("soundbox")
    warm = VirtualStructure(inputs, EXACT, 1, reduced_cache("soundbox"), np.arange(20.0, 401.0)).model(Drift(kelvin=5.0))
    field, factor = inputs.model.is_acoustic, 1 + 5 / 293.15
    air = np.ix_(field, field)
    assert abs(warm.K[air] - factor * inputs.model.K[air]).max() <= 1e-12 * abs(inputs.model.K[air]).max()
    other = np.ix_(~field, field)
    assert abs(warm.K[other] - inputs.model.K[other]).max() == 0.0
    assert abs(warm.M - inputs.model.M).max() == 0.0
