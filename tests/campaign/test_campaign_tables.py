"""Springs of tables in another unit, and models of another material beside them."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp
from looking import seen

from lrbc_cli.campaign.looking.causes import tables
from lrbc_cli.campaign.looking.causes.tables import other_tables

S = 2j * np.pi * np.linspace(20.0, 300.0, 200)
SHAPES = np.random.default_rng(5).normal(size=(6, 4))


def frf(springs: np.ndarray, times: float = 1.0) -> np.ndarray:
    """Of a beam on two groups of springs; ``times`` its stiffness and its mass."""
    free = (2.0 * np.pi * np.array([30.0, 55.0, 90.0, 140.0, 200.0, 270.0])) ** 2
    held = (2.0 * np.pi * np.array([25.0, 40.0, 60.0, 70.0, 80.0, 100.0])) ** 2
    first = np.array([1.0, 0.1, 0.6, 0.2, 0.9, 0.3])
    own = times * free + held * (10.0 ** springs[0] * first + 10.0 ** springs[1] * (1.0 - first))
    modes = S[:, None] ** 2 / (own * (1.0 + 0.02j) + times * S[:, None] ** 2)
    return modes @ SHAPES


def campaign(*, joined: bool = False) -> tuple[Any, Any]:
    """Source and parameters of that beam, a table of springs for each group, or both groups in one table with one value for a joint."""
    names = ("joints",) if joined else ("axial", "rocking")
    terms = [np.arange(2)] if joined else [np.array([0]), np.array([1])]
    groups = [
        SimpleNamespace(name=n, terms=own, config=SimpleNamespace(kind="stiffness", select=SimpleNamespace(bushings=Path(f"{n}.csv"))))
        for n, own in zip(names, terms, strict=True)
    ]
    inputs = SimpleNamespace(
        groups=groups,
        campaign=SimpleNamespace(unit_system=SimpleNamespace(text="SI")),
        dofs=SimpleNamespace(component=np.array(["UZ", "ROTY"])),
        model=SimpleNamespace(terms=SimpleNamespace(left=sp.csc_array(np.eye(2)), size=2)),
    )
    placed = [(SimpleNamespace(name=group.name, kind="stiffness"), slice(i, i + 1), None) for i, group in enumerate(groups)]
    model = SimpleNamespace(nearby=lambda _: lambda values: np.array([frf(row) for row in values]))
    ports = SimpleNamespace(evaluate=lambda dynamic: frf(np.log10(dynamic[0].real)))
    source = SimpleNamespace(inputs=inputs, model=lambda s, parameters: model, table=lambda s: ports)
    theta = np.zeros(len(groups))
    parameters = SimpleNamespace(
        initial=theta, placed=placed, size=theta.size, dynamic=lambda theta, s: np.ones((s.size, 2), dtype=complex)
    )
    return source, parameters


def told(measured: np.ndarray, *, joined: bool = False) -> str:
    source, parameters = campaign(joined=joined)
    job = seen(measured, frf(np.zeros(2))[None], source=source, parameters=parameters)
    return "; ".join(map(str, other_tables(job)))


def test_one_table_or_all_of_them_in_another_unit() -> None:
    assert "with all stiffnesses of axial.csv times 1000" in told(frf(np.array([3.0, 0.0])))
    assert "with all stiffnesses of axial.csv and rocking.csv times 1000" in told(frf(np.array([3.0, 3.0])))


def test_the_nearest_unit_is_meant(monkeypatch: pytest.MonkeyPatch) -> None:
    """Springs that clamp as good as all: a million times leaves no more than a thousand times does."""
    left = dict.fromkeys((-12, -9, -6, -3, -2, -1, 1), 14.6) | {2: 4.0, 3: 1.4, 6: 1.0, 9: 1.0, 12: 1.0}

    def changed(_: Any, __: Any, powers: np.ndarray) -> np.ndarray:
        return np.array([left.get(power, 14.6) for power in powers.tolist()])

    monkeypatch.setattr(tables, "_changed", changed)
    assert "times 1000, " in told(frf(np.array([6.0, 0.0])))


def test_a_table_in_newtons_per_millimetre() -> None:
    """A thousandth of N/m, and of N m/rad a thousand times."""
    text = told(frf(np.array([3.0, -3.0])))
    assert "with all stiffnesses of axial.csv and rocking.csv times 1000, those of rotations times 0.001" in text
    assert "Multiply the stiffnesses there by 1000, those of rotations by 0.001" in text


def test_rotations_alone_in_another_unit() -> None:
    """One value for a joint scales all its springs, but a table may be wrong in its rotations only."""
    text = told(frf(np.array([0.0, 3.0])), joined=True)
    assert "with all stiffnesses of the rotations in joints.csv times 1000" in text
    assert "Multiply the stiffnesses there by 1000" in text
    assert "with all stiffnesses of joints.csv times 1000" in told(frf(np.array([3.0, 3.0])), joined=True)


def test_a_model_of_another_material() -> None:
    """A third of stiffness and mass: springs as in the model are three times as stiff beside it, and levels are 9.5 dB higher."""
    text = told(frf(np.zeros(2), 1.0 / 3.0))
    assert "stiffness and mass of the model are probably both about 3" in text
    assert "times too large" in text
    assert "above the model's" in text


def test_nothing_is_said_of_a_right_model_or_of_noise() -> None:
    rng = np.random.default_rng(6)
    assert told(frf(np.array([0.1, -0.1]))) == ""
    assert told(10.0 ** rng.normal(size=(S.size, 4)) + 0j) == ""


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (
            [1.04, 0.99, 1.15, 0.98],
            "the springs of all joints are probably wrong: with those of B1, B2, B3, B4 about 10 times",
        ),
        (
            [1.04, 0.1, 0.0, 0.2],
            "the springs of some joints are probably wrong: with those of B1 about 11 times as stiff, and",
        ),
        ([1.04, 0.6, 0.0, 0.2], ""),
        ([0.7, 0.7, 0.7, 0.7], ""),
    ],
)
def test_springs_a_decade_too_soft(monkeypatch: pytest.MonkeyPatch, change: list[float], text: str) -> None:
    """One of eight springs that were all a decade too soft was fitted at 0.98 decades, so that nothing was said."""
    monkeypatch.setattr(tables, "widely_fitted", lambda _: (1.3, np.array(change)))
    inputs = SimpleNamespace(bolts=SimpleNamespace(name=("B1", "B2", "B3", "B4")), groups=())
    found = tables.joints_text(SimpleNamespace(misfit=10.5, inputs=inputs, job="tight"))  # type: ignore[arg-type]
    assert found.startswith(text)
    assert bool(found) == bool(text)
