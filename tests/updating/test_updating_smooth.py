"""Smoothed spectra: what they compare, and where they lead."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from systems import beam, dense_ports, fe_model, unit

from lrbc_cli.model.terms import ParameterGroup, Parameterisation
from lrbc_cli.updating.misfit.cost import Misfit
from lrbc_cli.updating.misfit.frf import port_model
from lrbc_cli.updating.search.descent import descend
from lrbc_cli.updating.search.race import Race
from lrbc_cli.updating.search.smooth import narrowed, smoothed_costs, smoothed_lines
from lrbc_cli.updating.unknowns.shapes import Shapes

JOINTS = 10
LINES = np.arange(15.0, 400.5, 0.5)


def joints(change: np.ndarray, lacks: complex = 1.0):
    """A beam on springs, each a joint with such a change, measured on many lines; costs between lines and between smoothed spectra."""
    K, M = beam(40, bending=1.0)
    n, at = K.shape[0], 2 * np.linspace(3, 37, JOINTS).round().astype(int) - 1
    ends = {"loads": unit(n, 19), "outputs": unit(n, 11, 33, 51)}
    model = fe_model(K, M, left=unit(n, *at), damping=(2.0, 4e-6), output_power=2, **ends)
    reference = np.zeros((JOINTS, 3))
    reference[:, :2] = [1e3, 1.0]
    each, tight = np.arange(JOINTS), np.full(JOINTS, 3.0)
    group = ParameterGroup(
        name="springs",
        kind="stiffness",
        terms=each,
        parameter=each,
        initial=tight,
        bounds=np.tile([-1.0, 5.0], (JOINTS, 1)),
        smoothing=np.eye(JOINTS),
        bolt=each,
    )
    parameters = Parameterisation((group,))
    lines = port_model(dense_ports(model, 2j * np.pi * LINES, reference), parameters)
    measured, before = (lacks * lines.frf(theta) for theta in (tight + change, tight))
    shapes = Shapes(T=np.eye(JOINTS), std=np.ones(JOINTS), bolts=each, joint=np.ones(JOINTS, dtype=bool))
    plain = Misfit(lines, measured / lacks, tight, 1e-3, shapes.penalty())
    wide = smoothed_costs(plain, lambda s: port_model(dense_ports(model, s, reference), parameters), LINES, measured, before)
    return plain, wide, parameters.bounds, shapes, tight + change


def test_what_the_model_lacks_in_the_tight_state_drops_out():
    change = np.zeros(JOINTS)
    change[[3, 6]] = -2.0
    _, plain, _, _, truth = joints(change)
    _, lacking, _, _, _ = joints(change, lacks=1.4)
    assert [cost.lines for cost in plain] == sorted(cost.lines for cost in plain)
    for a, b in zip(plain, lacking, strict=True):
        # What lies beyond the band is not the same in both states.
        assert a(truth).misfit_db < 0.9 * a(a.prior).misfit_db
        assert b(truth).misfit_db == pytest.approx(a(truth).misfit_db, rel=1e-6)


def test_none_where_lines_lie_too_far_apart():
    values = np.ones((5, 1), dtype=complex)
    assert smoothed_lines(np.linspace(10.0, 400.0, 5), values, 4.0, 0.8) is None
    assert smoothed_lines(LINES, np.ones((LINES.size, 1), dtype=complex), 4.0, 0.8) is not None


def test_none_where_both_measurements_have_no_band_in_common():
    plain, *_ = joints(np.zeros(JOINTS))
    ones, at = np.ones((LINES.size, 3), dtype=complex), LINES[:, None]
    low, high = (np.where(part, ones, np.nan) for part in (at < 250.0, at > 300.0))

    def model(s: np.ndarray) -> SimpleNamespace:
        return SimpleNamespace(frf=lambda theta: np.ones((s.size, 3), dtype=complex))

    # Each of them alone has lines enough.
    assert smoothed_lines(LINES, low, 16.0, 0.8) is not None
    assert smoothed_costs(plain, model, LINES, low, high) == []


def test_they_lead_where_a_descent_on_the_lines_does_not():
    """All joints scatter and one has lost two decades: peaks lie far from where the tight state has them."""
    rng = np.random.default_rng(3)
    change = 0.15 * rng.standard_normal(JOINTS)
    change[rng.integers(JOINTS)] -= 2.0
    plain, wide, bounds, shapes, truth = joints(change)
    ends, evaluations = narrowed(wide, {}, bounds, shapes.T)
    assert list(ends) == ["the reference job, over smoothed spectra"]
    assert evaluations > len(wide)
    led = descend(plain, next(iter(ends.values())), bounds, shapes.T)
    alone = descend(plain, plain.prior, bounds, shapes.T)
    assert led.evaluation.total <= 1.01 * plain(truth).total
    assert alone.evaluation.total > 100.0 * led.evaluation.total


@pytest.mark.parametrize("seed", [3, 7, 8])
@pytest.mark.slow
def test_an_end_in_the_wrong_valley_leads_on_over_them(seed: int):
    """A descent from the tight state alone ends far above the truth; the way on takes fewer evaluations on the measured lines."""
    rng = np.random.default_rng(seed)
    change = 0.15 * rng.standard_normal(JOINTS)
    change[rng.permutation(JOINTS)[:2]] -= [2.0, 1.0]
    plain, wide, bounds, shapes, truth = joints(change)
    assert descend(plain, plain.prior, bounds, shapes.T).evaluation.total > 100.0 * plain(truth).total
    counts = []
    for smoothed in (wide, []):
        race = Race(plain, bounds, shapes.T, 1e-6, 100)
        race.begin([("the reference job", plain.prior)], 3)
        race.look_beside(shapes.T, (0.2,), (3, 8), 3, range(JOINTS), wide=smoothed)
        race.go_on([race.best])
        described, end = race.ends[race.best]
        assert end.evaluation.total <= 1.01 * plain(truth).total
        assert described.startswith("the reference job, then")
        counts.append(len(race.history))
    assert counts[0] < 0.8 * counts[1]


@pytest.mark.parametrize("seed", [4, 14, 22])
def test_the_narrowest_alone_lead_where_the_widest_lead_away(seed: int):
    """One round beside an end in the wrong valley: over all widths in turn it stays there."""
    rng = np.random.default_rng(seed)
    change = 0.15 * rng.standard_normal(JOINTS)
    change[rng.permutation(JOINTS)[:3]] -= [3.0, 1.0, 0.5]
    plain, wide, bounds, shapes, truth = joints(change)
    race = Race(plain, bounds, shapes.T, 1e-6, 100)
    race.begin([("the reference job", plain.prior)], 100)
    assert race.ends[race.best][1].evaluation.total > 100.0 * plain(truth).total
    race.look_beside(shapes.T, (), (3, 8), 1, range(JOINTS), wide=wide)
    race.go_on([race.best])
    assert race.ends[race.best][1].evaluation.total <= 1.01 * plain(truth).total
