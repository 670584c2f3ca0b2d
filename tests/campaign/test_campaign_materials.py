"""A matrix that is too large by a factor: in which unit numbers were written, and what the units of the campaign want, with an example."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp
from campaigns import Folder

from lrbc_cli.campaign.reading.doubts.materials import massless_part, material_cause
from lrbc_cli.campaign.reading.places import mistake_text
from lrbc_cli.model.units import parse_system


@pytest.mark.parametrize(
    ("units", "matrix", "factor", "says"),
    [
        (
            "mm-N-t",
            "mass",
            1e3,
            "density in kg/mm³, but `units: mm-N-t` requires t/mm³, 7.85e-09 for steel; or masses in kg, but it requires t",
        ),
        ("mm-N-t", "mass", 1e12, "density in kg/m³, but `units: mm-N-t` requires t/mm³, 7.85e-09 for steel"),
        ("mm-N-t", "mass", 10.0, "density: `units: mm-N-t` requires t/mm³, 7.85e-09 for steel"),
        ("mm-kg-ms", "mass", 1e9, "density in kg/m³, but `units: mm-kg-ms` requires kg/mm³, 7.85e-06 for steel"),
        ("cm-kg-s", "mass", 1e6, "density in kg/m³, but `units: cm-kg-s` requires kg/cm³, 0.00785 for steel"),
        (
            "in-lbf-s",
            "mass",
            386.0886,
            "density in lbm/in³, but `units: in-lbf-s` requires lbf s²/in⁴, 0.0007345 for steel; or masses in lbm",
        ),
        ("SI", "mass", 1e-3, "density in g/cm³ or t/m³, but SI requires kg/m³, 7850 for steel; or masses in t, but it requires kg"),
        ("SI", "stiffness", 1e-6, "modulus in MPa, but SI requires Pa, 2.1e+11 for steel"),
        (
            "mm-N-t",
            "stiffness",
            1e3,
            "springs in N/m, but `units: mm-N-t` requires N/mm; it requires the modulus in MPa, 2.1e+05 for steel",
        ),
        ("in-lbf-s", "stiffness", 6894.7573, "modulus in Pa, but `units: in-lbf-s` requires psi, 3.046e+07 for steel"),
        ("mm-kg-ms", "stiffness", 1e9, "modulus in Pa, but `units: mm-kg-ms` requires GPa, 210 for steel"),
    ],
)
def test_what_each_system_of_units_wants(units: str, matrix: str, factor: float, says: str) -> None:
    assert str(material_cause(parse_system(units), matrix, factor)).startswith(says)


def test_the_units_are_those_of_the_campaign(frame: Folder) -> None:
    campaign = frame.inputs().campaign
    assert campaign.unit_system.text == "SI"
    assert ", but SI requires kg/m³, 7850 for steel; or masses in t, but it requires kg)" in mistake_text(campaign, "mass", 1e-3)
    assert "a weight density" in mistake_text(campaign, "mass", 9.80665)
    assert material_cause(campaign.unit_system, "damping", 10.0) is None


@pytest.mark.parametrize(
    ("bare", "told"),
    [
        ([], ""),
        ([0], ""),
        # Nodes of rigid links: each has mass beside it.
        ([0, 3, 4, 7, 8, 11, 12], ""),
        ([5, 6, 7], "3 of 20 nodes have no mass in any direction (5, 6, 7)"),
        ([5, 6, 7, 11], "3 of 20 nodes have no mass in any direction (5, 6, 7)"),
        (list(range(20)), "20 of 20"),
    ],
)
def test_a_part_without_a_density(bare: list[int], told: str) -> None:
    """A chain of 20 nodes; rotations, and directions of their own, need no mass."""
    node = np.repeat(np.arange(20), 3)
    component = np.tile(np.array(["UX", "UZ", "ROTX"]), 20)
    mass = np.where(component == "UZ", 1.0, 0.0)
    mass[np.isin(node, bare)] = 0.0
    dofs: Any = SimpleNamespace(node=node, component=component)
    chain = sp.diags_array([np.full(19, -1.0), np.full(20, 2.0), np.full(19, -1.0)], offsets=[-1, 0, 1])
    model: Any = SimpleNamespace(M=sp.diags_array(mass).tocsc(), K=sp.kron(chain, np.ones((3, 3))).tocsc())
    (text,) = list(massless_part(model, dofs)) or [""]
    assert told in text
    assert bool(text) is bool(told)
