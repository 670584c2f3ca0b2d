"""Sensors with several axes that are mounted turned."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp
from hypothesis import given, settings
from hypothesis import strategies as st
from looking import modal, seen
from scipy.spatial.transform import Rotation

from lrbc_cli.campaign.findings import Finding, Kind, without_responses
from lrbc_cli.campaign.looking import multiaxial
from lrbc_cli.campaign.looking.multiaxial import bodies_of, turn_of, turned_findings
from lrbc_cli.model.dofs import DofTable

HZ = np.arange(30.0, 600.0, 3.0)

#: Two hammer points, and sensors at nodes 1 (x, y, z), 2 (x, z) and 3 (z).
STATED = [(1, "UX"), (1, "UY"), (1, "UZ"), (2, "UX"), (2, "UZ"), (3, "UZ")]


def inputs(stated: list[tuple[int, str]], rotated: dict[int, np.ndarray] | None = None) -> Any:
    """Of a table with three translations a node; ``rotated``: stated directions of a sensor by node, instead of the components."""
    rows = [(node, f"U{axis}") for node in (1, 2, 3) for axis in "XYZ"]
    dofs = DofTable(node=np.array([node for node, _ in rows]), component=np.array([name for _, name in rows]), xyz=np.zeros((9, 3)))
    every = [*stated, *stated]
    L = sp.lil_array((len(every), 9))
    count = {node: 0 for node, _ in every}
    for i, (node, component) in enumerate(every):
        if rotated is not None and node in rotated:
            L[i, 3 * (node - 1) : 3 * node] = rotated[node][count[node] % len(rotated[node])]
            count[node] += 1
        else:
            L[i, rows.index((node, component))] = 1.0
    responses = [
        SimpleNamespace(name=f"A{node}{component[1]}-H{1 + i // len(stated)}", input=i // len(stated))
        for i, (node, component) in enumerate(every)
    ]
    return SimpleNamespace(dofs=dofs, model=SimpleNamespace(L=L.tocsr()), responses=responses)


def told(turns: dict[int, np.ndarray], error_db: float = 1.0) -> list[Finding]:
    """Findings where the model is right up to ``error_db``, and sensors are turned by matrices of their own axes, by node."""
    computed = np.concatenate([modal(HZ, seed, len(STATED)) for seed in (1, 2)], axis=1)
    measured = computed.copy()
    for node, turn in turns.items():
        for point in range(2):
            at = [point * len(STATED) + i for i, (own, _) in enumerate(STATED) if own == node]
            measured[:, at] = computed[:, at] @ turn.T
    measured = measured * 10.0 ** (np.random.default_rng(3).normal(0.0, error_db, measured.shape) / 20.0)
    return turned_findings(seen(measured, computed[None], hz=HZ, inputs=inputs(STATED)))


def about(axis: str, degrees: float) -> np.ndarray:
    return np.asarray(Rotation.from_euler(axis, degrees, degrees=True).as_matrix())


def test_bodies_are_sensors_with_perpendicular_axes() -> None:
    first, second = bodies_of(inputs(STATED))
    assert (first.node, second.node) == (1, 2)
    assert first.responses.tolist() == [[0, 1, 2], [6, 7, 8]]
    np.testing.assert_array_equal(second.axes, [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    rotated = bodies_of(inputs(STATED, {1: about("z", 30.0)}))[0]
    np.testing.assert_allclose(rotated.axes, about("z", 30.0), atol=1e-12)
    skew = np.array([[1.0, 0.0, 0.0], [0.6, 0.8, 0.0], [0.0, 0.0, 1.0]])
    assert [body.node for body in bodies_of(inputs(STATED, {1: skew}))] == [2]
    # A DOF with two names is one axis.
    twice = bodies_of(inputs([*STATED[:3], STATED[0], *STATED[3:]]))[0]
    assert twice.responses.tolist() == [[0, 1, 2], [7, 8, 9]]
    assert bodies_of(SimpleNamespace(dofs=None, model=SimpleNamespace(L=sp.csr_array((0, 0))))) == []


@settings(deadline=None, max_examples=40)
@given(st.integers(0, 10_000), st.booleans())
def test_the_turn_is_found_whatever_it_is(seed: int, mirrored: bool) -> None:
    turn = Rotation.random(random_state=seed).as_matrix() * (-1.0 if mirrored else 1.0)
    computed = modal(HZ, seed, 3)[:, None]
    np.testing.assert_allclose(turn_of(computed @ turn.T, computed), turn, atol=1e-9)
    values = (computed @ turn.T).copy()
    values[::3, 0, 1] = np.nan
    np.testing.assert_allclose(turn_of(values, computed), turn, atol=1e-9)


@pytest.mark.parametrize("degrees", [25.0, 45.0, -60.0, 150.0])
def test_a_turned_sensor_is_found(degrees: float) -> None:
    (finding,) = told({1: about("y", degrees)})
    assert finding.kind is Kind.COORDINATES
    assert finding.responses == (0, 1, 2, 6, 7, 8)
    angle, _, rest = finding.text.partition(" degrees about ")
    assert int(angle.rsplit(" ", 1)[1]) == pytest.approx(abs(degrees), abs=2)
    # The channels read along R: the sensor itself is turned the other way round.
    assert rest.startswith("-Y:" if degrees > 0 else "Y:")
    assert "A1Y-H1" not in rest


def test_a_sensor_with_two_axes_that_is_turned_in_their_plane() -> None:
    (finding,) = told({2: np.array([[0.8, 0.6], [-0.6, 0.8]])})
    assert finding.responses == (3, 4, 9, 10)
    assert "mounted turned by about 37 degrees about -Y: A2X-H1 along 0.80 X + 0.60 Z instead of X, " in finding.text
    assert "A2Z-H1 along -0.60 X + 0.80 Z instead of Z" in finding.text


def test_a_small_turn_shows_at_the_axis_of_little_motion() -> None:
    """Median over all records it is nothing: a tenth of the motion of the strong axes."""
    computed = np.concatenate([modal(HZ, seed, len(STATED)) for seed in (1, 2)], axis=1) * np.tile([10.0, 1.0, 0.3, 1.0, 1.0, 1.0], 2)
    measured = computed.copy()
    for point in range(2):
        measured[:, 6 * point : 6 * point + 3] = computed[:, 6 * point : 6 * point + 3] @ about("y", 10.0).T
    measured *= 10.0 ** (np.random.default_rng(3).normal(0.0, 1.0, measured.shape) / 20.0)
    (finding,) = turned_findings(seen(measured, computed[None], hz=HZ, inputs=inputs(STATED)))
    assert "by about 10 degrees about -Y" in finding.text
    # At one of two hammer points nothing was measured.
    measured[:, 6:9] = np.nan
    assert len(turned_findings(seen(measured, computed[None], hz=HZ, inputs=inputs(STATED)))) == 1
    # Nor along one of the axes: then nothing is known.
    measured[:, 1] = np.nan
    assert turned_findings(seen(measured, computed[None], hz=HZ, inputs=inputs(STATED))) == []


def test_a_reflection_is_told_as_one() -> None:
    (finding,) = told({2: np.array([[0.6, 0.8], [0.8, -0.6]])})
    assert "mounted turned, with one channel reversed or two of them exchanged: A2X-H1 along 0.60 X + 0.80 Z" in finding.text


def test_right_sensors_signs_and_exchanged_axes_are_none() -> None:
    assert told({}) == []
    assert told({}, 5.0) == []
    # Other tests tell these.
    assert told({1: np.diag([-1.0, -1.0, 1.0])}) == []
    assert told({1: np.eye(3)[[2, 1, 0]]}) == []


@pytest.mark.parametrize(("axes", "found"), [(("A1X-H1", "A1Z-H1"), True), (("A1X-H1",), False)])
def test_a_sensor_at_another_place_by_several_axes(monkeypatch: pytest.MonkeyPatch, axes: tuple[str, ...], found: bool) -> None:
    computed = np.concatenate([modal(HZ, k, len(STATED)) for k in (1, 2)], axis=1)
    elsewhere = computed.copy()
    elsewhere[:, [0, 1, 2, 6, 7, 8]] = np.concatenate([modal(HZ, k, 3) for k in (5, 6)], axis=1)
    elsewhere *= 10.0 ** (np.random.default_rng(3).normal(0.0, 1.0, elsewhere.shape) / 20.0)
    # A record without values says nothing, and is at no distance.
    elsewhere[:, 1] = np.nan
    job = seen(elsewhere, computed[None], hz=HZ, inputs=inputs(STATED))
    names = [response.name for response in job.inputs.responses]
    monkeypatch.setattr(multiaxial, "sensor_text", lambda _, i: f"; at or near node {i}" if names[i] in axes else "")
    told = multiaxial.moved_findings(job, ())
    assert [each.responses for each in told] == ([(0, 1, 2, 6, 7, 8)] if found else [])
    assert not found or "A1X-H1: at or near node 0; A1Z-H1: at or near node 2. Check where it was" in told[0].text
    # Exchanged axes are told as such.
    exchanged = computed.copy()
    exchanged[:, [0, 2, 6, 8]] = 1.1 * computed[:, [2, 0, 8, 6]]
    assert multiaxial.moved_findings(seen(exchanged, computed[None], hz=HZ, inputs=inputs(STATED)), ()) == []
    # A sensor that is turned was told already; right ones are not asked.
    assert multiaxial.moved_findings(job, {1}) == []
    assert multiaxial.moved_findings(seen(computed, computed[None], hz=HZ, inputs=inputs(STATED)), ()) == []


def test_findings_about_the_same_responses_are_replaced() -> None:
    about_some = [Finding(text="a", responses=(1, 2)), Finding(text="b", cycles=((1, 2),)), Finding(text="c", responses=(1, 5))]
    assert [each.text for each in without_responses([*about_some, Finding(text="d")], {1, 2, 3})] == ["c", "d"]
