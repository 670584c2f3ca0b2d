"""How far one loosened bolt alone moves what a sensor measures: a mass on one joint is as good as cut off by it."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from looking import seen

import lrbc_cli as lrbc
from lrbc_cli.campaign.identification.compared.likeness import apart_there, off_level
from lrbc_cli.campaign.looking.states import reach_of_one
from lrbc_cli.model.terms import ParameterGroup, Parameterisation
from lrbc_cli.updating.misfit.frf import port_model

HZ = np.arange(20.0, 400.0, 2.0)
S = 2j * np.pi * HZ
STIFF = 7.0


def parameters(bolt: list[int] | None) -> Parameterisation:
    at = np.arange(3)
    group = ParameterGroup(
        name="joints",
        kind="stiffness",
        terms=at,
        parameter=at,
        initial=np.full(3, STIFF),
        bounds=np.tile([STIFF - 4.0, STIFF + 1.0], (3, 1)),
        smoothing=np.eye(3),
        bolt=None if bolt is None else np.array(bolt),
    )
    return Parameterisation((group,))


def three_masses() -> lrbc.TermModel:
    """Two masses side by side on the ground, each on a joint, and a light one that a third joint holds on the first."""
    M, K = np.diag([8.0, 9.0, 1.0]), np.array([[2e6, -2e6, 0.0], [-2e6, 2e6, 0.0], [0.0, 0.0, 0.0]])
    terms = np.array([[1.0, 0.0, 1.0], [0.0, 1.0, 0.0], [0.0, 0.0, -1.0]])
    loads, outputs = np.eye(3)[:, :1], np.eye(3)
    return lrbc.reduce(K, M, 1e-5 * K + 2.0 * M, loads=loads, outputs=outputs, terms=terms, band_hz=(20.0, 400.0))


def reach(bolt: list[int] | None) -> tuple[np.ndarray, np.ndarray]:
    P, ports = parameters(bolt), three_masses().reduction.model.ports(S)
    model = port_model(ports, P)
    source: Any = SimpleNamespace(model=lambda s, parameters: model, known={})
    states = model.frf(P.initial)[None]
    level, rest = reach_of_one(seen(states[0], states, hz=HZ, source=source, parameters=P))
    return np.asarray(level), np.asarray(rest)


def test_what_stands_on_one_joint_is_cut_off_by_it() -> None:
    level, rest = reach([0, 1, 2])
    assert level[2] > 20.0
    assert level[2] > 1.5 * level[:2].max()
    assert rest.min() > 0.0


def test_without_joints_nothing_is_known() -> None:
    level, rest = reach(None)
    assert not level.any()
    assert not rest.any()


@pytest.mark.parametrize(("reached", "told"), [(0.0, True), (20.0, True), (26.0, False)])
def test_a_level_that_one_bolt_explains_is_no_wrong_sensitivity(reached: float, told: bool) -> None:
    rng = np.random.default_rng(2)
    tight = rng.normal(size=(100, 4)) + 1j * rng.normal(size=(100, 4))
    measured = tight * np.array([1.0, 1.0, 10.0 ** (-24.0 / 20.0), 1.0])
    responses = [SimpleNamespace(name=f"a{i}", node=i, direction=3) for i in range(4)]
    inputs: Any = SimpleNamespace(responses=responses)
    found = off_level(inputs, measured, tight, "tight", "loose", np.full(4, reached))
    assert list(found) == ([2] if told else [])


def test_where_the_model_feels_nothing_nothing_is_near() -> None:
    """Constants taken out, rounding is as near to a measurement as anything, and zero has no level at all."""
    rng = np.random.default_rng(1)
    measured = rng.normal(size=(40, 3)) + 1j * rng.normal(size=(40, 3))
    computed = measured * np.array([1.0, 0.0, 1e-14])
    assert apart_there(measured, computed, float(np.abs(measured).max())).tolist() == [pytest.approx(0.0, abs=1e-9), np.inf, np.inf]


@pytest.mark.parametrize(("calibrated", "second", "least"), [(True, 0.5, 1.0), (True, 1.2, 2.4), (True, 2.5, 3.0), (False, 0.5, 3.0)])
def test_a_hammer_point_beside_others_that_fit(calibrated: bool, second: float, least: float) -> None:
    """A point 7 cm off left 3 dB beside half a decibel at the other one, and nothing was said."""
    away = np.where(np.arange(40)[:, None] % 2, 1.0, -1.0) * np.array([2.9, 2.9, second, second])
    fitted_to = "tight" if calibrated else None
    source: Any = SimpleNamespace(inputs=SimpleNamespace(input_of=np.array([0, 0, 1, 1])), known={}, fitted_to=fitted_to)
    job = seen(10.0 ** (away / 20.0) + 0j, np.ones((1, 40, 4), dtype=complex), source=source)
    assert job.by_excitation[0] == pytest.approx(2.9)
    assert job.least_of(0) == pytest.approx(least)
