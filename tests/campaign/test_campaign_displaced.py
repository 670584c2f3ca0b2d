"""A joint whose springs are at another place in the model than on the structure."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp
from rows import COUNT, InputsAlone, assembly, told

from lrbc_cli.campaign.looking import displaced
from lrbc_cli.campaign.looking.states import Seen
from lrbc_cli.model.fem import FeModel


@pytest.fixture(autouse=True)
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    """Cheap enough to be reduced once more."""
    monkeypatch.setattr(displaced, "reduction_cost", lambda _: (SimpleNamespace(work=0.0), None))


def joined(*pairs: tuple[int, int]) -> FeModel:
    """Two rows of masses with joints between these pairs of nodes."""
    ends = np.zeros((2 * COUNT, len(pairs)))
    for term, (one, other) in enumerate(pairs):
        ends[one, term], ends[COUNT + other, term] = 1.0, -1.0
    plain = assembly(mass=1.3)
    left = sp.csc_array(ends)
    return replace(plain, C=sp.csc_array(0.3 * plain.C), terms=replace(plain.terms, left=left, right=left))


def displaced_by(job: Seen, calibrated: float) -> str:
    """With the inputs of a campaign that calibrates from this job."""
    inputs: Any = job.source.inputs
    file = Path("joints.csv")
    config = SimpleNamespace(kind="stiffness", select=SimpleNamespace(bushings=file))
    inputs.groups = [SimpleNamespace(config=config, terms=np.arange(3), bolt=np.arange(3), parameter=np.arange(3))]
    inputs.bolts = SimpleNamespace(name=["B1", "B2", "B3"])
    inputs.campaign.calibration = SimpleNamespace(job=job.job, names=())
    source: Any = job.source
    source.stage = object()
    return displaced.displaced_cause(job, job.measurement, calibrated).text


def test_the_joint_and_its_place_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    """The second of three joints is 12 nodes away from where the model has it, on both of the parts that it joins."""
    monkeypatch.setattr(displaced, "_calibrated_with", lambda _, __, place, ___: place.left)
    given, true = joined((3, 4), (15, 15), (36, 35)), joined((3, 4), (27, 27), (36, 35))
    text = told(given, true, displaced_by)
    assert text.startswith("the springs of B2 are probably at a wrong place in the model: with them at or near node 27 at (0.5538, 0, 0) m")
    assert "0.246 m from node 15" in text
    assert "leaves a level misfit of 0.0 dB" in text
    assert "the nodes of its springs in joints.csv" in text
    # A right model, and a part of another material, are no joint.
    assert told(given, given, displaced_by) == ""
    assert told(given, replace(given, M=sp.csc_array(2.9 * given.M)), displaced_by) == ""


def test_a_place_that_another_joint_explains_as_well_is_none(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(displaced, "_calibrated_with", lambda *_: 0.5)
    assert told(joined((3, 4), (15, 15), (36, 35)), joined((3, 4), (27, 27), (36, 35)), displaced_by) == ""


def test_nothing_is_said_where_full_solves_take_too_long(monkeypatch: pytest.MonkeyPatch) -> None:
    """A large model, or one whose joints have no other node to go to."""
    given, true = joined((3, 4), (15, 15), (36, 35)), joined((3, 4), (27, 27), (36, 35))
    monkeypatch.setattr(displaced, "_elsewhere", lambda *_, **__: iter(()))
    assert told(given, true, displaced_by) == ""
    monkeypatch.undo()
    monkeypatch.setattr(displaced, "reduction_cost", lambda _: (SimpleNamespace(work=0.0), None))
    monkeypatch.setattr(displaced, "affordable", lambda *_: False)
    assert told(given, true, displaced_by) == ""


def test_what_the_matrix_holds_of_a_joint_goes_with_its_springs(monkeypatch: pytest.MonkeyPatch) -> None:
    """The model with a joint elsewhere is that which was assembled there."""
    monkeypatch.setattr(displaced, "recipe_of", lambda *_: None)
    given, true = (joined((3, 4), (at, at), (36, 35)) for at in (15, 27))
    held = np.array([0.0, 2e6, 0.0])
    given, true = (
        replace(model, K=sp.csc_array(model.K + (model.terms.left * held) @ model.terms.left.T), terms=replace(model.terms, baseline=held))
        for model in (given, true)
    )
    joint = displaced._Joint(
        bolt=1, terms=np.array([1]), term=np.zeros(2, dtype=int), dof=np.array([15, COUNT + 15]), value=np.array([1.0, -1.0])
    )
    inputs: Any = InputsAlone(model=given, campaign=None, recipe=None)
    moved = displaced._moved(inputs, displaced._Elsewhere(joint, np.array([27, COUNT + 27])))
    assert abs(moved.model.K - true.K).max() == pytest.approx(0.0, abs=1e-6)
    assert abs(moved.model.terms.left - true.terms.left).max() == 0.0
