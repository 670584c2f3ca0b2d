"""Where the FRFs stop to feel a stiffness."""

from __future__ import annotations

import numpy as np
import pytest
from pads import PADS, S, pads_model, pads_ports
from systems import csc, fe_model

from lrbc_cli.reduction.problem.vectors import local_scale
from lrbc_cli.updating.statistics.decibels import decibel
from lrbc_cli.updating.statistics.saturation import LIMITS, saturation

TERMS = np.arange(PADS)


def found(model, ports, D=None):
    scale = local_scale(model.K, model.M, model.terms, 2 * np.pi * 400.0)
    D = np.zeros((S.size, model.terms.size), dtype=complex) if D is None else D
    return saturation(ports.evaluate, D, TERMS, float(np.exp(np.mean(np.log(scale[TERMS])))))


def distance(ports, p, limit, D=None):
    """Mean dB between uniform stiffness 10^p and a limit."""

    def level(value):
        trial = np.zeros((S.size, ports.D_ref.shape[1]), dtype=complex) if D is None else np.array(D, dtype=complex)
        trial[:, TERMS] = value
        return decibel(ports.evaluate(trial))

    return np.mean(np.abs(level(10.0**p) - level(limit)))


@pytest.fixture(scope="module")
def pads():
    model, _ = pads_model(None)
    return model, pads_ports(model)


def test_the_start_lies_below_the_plateau(pads):
    model, ports = pads
    limits = found(model, ports)
    assert distance(ports, limits.start, np.inf) == pytest.approx(LIMITS.start_db, rel=0.1)
    assert distance(ports, limits.upper, np.inf) == pytest.approx(LIMITS.bound_db, rel=0.1)
    assert distance(ports, limits.lower, 0.0) == pytest.approx(LIMITS.bound_db, rel=0.1)
    assert limits.lower < limits.start < limits.upper


def test_monotone_beyond_the_start(pads):
    """A start further up is nearer to the clamped FRFs."""
    model, ports = pads
    limits = found(model, ports)
    steps = np.linspace(limits.start, limits.upper + 2, 12)
    levels = [distance(ports, p, np.inf) for p in steps]
    assert np.all(np.diff(levels) < 0)


def test_the_exporters_scale_moves_it_along(pads):
    """Vectors a hundred times as long: all values four decades lower."""
    model, ports = pads
    longer = fe_model(
        model.K, model.M, C=model.C, loads=model.B, outputs=csc(model.L.T), left=100 * model.terms.left, output_power=model.output_power
    )
    first, second = found(model, ports), found(longer, pads_ports(longer))
    np.testing.assert_allclose(
        [second.start, second.lower, second.upper], np.array([first.start, first.lower, first.upper]) - 4.0, atol=2e-3
    )


def test_other_groups_stay_where_they_are():
    model, _ = pads_model(None, extras=True)
    ports = pads_ports(model)
    D = np.zeros((S.size, PADS + 2), dtype=complex)
    D[:, PADS], D[:, PADS + 1] = 20.0 * S, 0.05 * S**2
    limits = found(model, ports, D=D)
    assert distance(ports, limits.start, np.inf, D=D) == pytest.approx(LIMITS.start_db, rel=0.1)
    assert abs(limits.start - found(model, ports).start) > 1e-3


def test_terms_without_influence_give_an_interval_all_the_same():
    """A pad that no response feels: bounds stay finite and ordered."""
    limits = saturation(lambda D: np.ones((S.size, 2), dtype=complex), np.zeros((S.size, PADS), dtype=complex), TERMS, 1e4)
    assert limits.lower < limits.start < limits.upper
    assert np.all(np.isfinite([limits.lower, limits.start, limits.upper]))


def test_a_response_that_clamping_silences_has_no_limit():
    """A spring at the loaded point: the FRF falls for ever, so decades around the local stiffness are taken, and it is said."""
    s = 2j * np.pi * np.linspace(10.0, 50.0, 9)

    def values(D):
        return (1.0 / (1e4 + 3.0 * s + s**2 + D[:, 0]))[:, None]

    found = saturation(values, np.zeros((s.size, 1), dtype=complex), np.array([0]), 1e4)
    assert not found.found
    assert found.lower < 4.0 < found.start < found.upper
