"""Unit labels."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lrbc_cli.io.units import numerator_quantity, parse_unit, response_quantity

G, LBF = 9.80665, 0.45359237 * 9.80665


@pytest.mark.parametrize(
    ("label", "factor", "quantity"),
    [
        ("Pa/N", 1.0, "pressure"),
        ("kPa / kN", 1.0, "pressure"),
        ("[uPa/N]", 1e-6, "pressure"),
        ("µPa/N", 1e-6, "pressure"),
        ("psi/lbf", 1 / 0.0254**2, "pressure"),
        ("m/N", 1.0, "displacement"),
        ("um/N", 1e-6, "displacement"),
        ("mm/s/N", 1e-3, "velocity"),
        ("(mm/s)/N", 1e-3, "velocity"),
        ("in/s/lbf", 0.0254 / LBF, "velocity"),
        ("m/s^2/N", 1.0, "acceleration"),
        ("m/s²/N", 1.0, "acceleration"),
        ("m/s2/N", 1.0, "acceleration"),
        ("m/(s^2 N)", 1.0, "acceleration"),
        ("(1/N)*(m/s²)", 1.0, "acceleration"),
        ("m s^-2 N^-1", 1.0, "acceleration"),
        ("m·s⁻²/N", 1.0, "acceleration"),
        ("g/N", G, "acceleration"),
        ("g/lb", G / LBF, "acceleration"),
        ("1/kg", 1.0, "acceleration"),
        ("rad/s/N", 1.0, "velocity"),
        ("rad/(N m)", 1.0, "displacement"),
        ("rad/Nm", 1.0, "displacement"),
    ],
)
def test_units_over_force(label, factor, quantity):
    unit = parse_unit(label)
    assert unit.factor == pytest.approx(factor, rel=1e-14)
    assert response_quantity(unit) == quantity


@pytest.mark.parametrize(
    ("label", "quantity"),
    [
        ("Pa", "pressure"),
        ("m", "displacement"),
        ("mm/s", "velocity"),
        ("g", "acceleration"),
        ("rad/s^2", "acceleration"),
        ("N", None),
        ("s", None),
    ],
)
def test_units_of_a_response_alone(label, quantity):
    assert numerator_quantity(parse_unit(label)) == quantity


def test_case_matters_only_where_it_must():
    assert parse_unit("HZ").time == -1
    assert parse_unit("PA").factor == 1.0
    assert parse_unit("MPa").factor == 1e6
    assert parse_unit("mPa").factor == 1e-3
    assert parse_unit("MPA") is None


@pytest.mark.parametrize(
    "label", ["", "NONE", "none", "-", "dB", "sone", "Pa/", "/N", "(Pa/N", "Pa/N)", "m^", "m^N", "m^99", "!!", "(" * 70]
)
def test_what_is_not_understood(label):
    assert parse_unit(label) is None


@given(st.text("PaNmsgk/*^()[]²0123456789 -", max_size=30) | st.text(max_size=90))
def test_no_label_is_a_crash(label):
    unit = parse_unit(label)
    if unit is not None:
        assert isinstance(unit.factor, float)
        response_quantity(unit)
        numerator_quantity(unit)
