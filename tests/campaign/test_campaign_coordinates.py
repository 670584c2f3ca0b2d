"""A sensor that is stated with its coordinates exchanged, by all its FRFs at once."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp
from looking import seen
from samples import reduced_cache, sample

from lrbc_cli.campaign.identification.compared.likeness import exchanged, exchanged_text
from lrbc_cli.campaign.identification.unknowns import parameterise
from lrbc_cli.campaign.looking.causes.coordinates import _on_other_part, coordinates_texts
from lrbc_cli.campaign.reduced.stage import FrfSource, obtain_reduction
from lrbc_cli.model.dofs import DofTable
from lrbc_cli.model.fem import FeModel
from lrbc_cli.model.selection import nearest
from lrbc_cli.model.terms import LowRankTerms
from lrbc_cli.reduction.problem.full import full_ports

HZ = np.arange(40.0, 500.0, 6.0)
S = 2j * np.pi * HZ


@cache
def frame() -> tuple[Any, Any, np.ndarray, np.ndarray]:
    """The frame sample, and FRFs of all sensors: as stated, and with x and y of acc1 exchanged."""
    inputs = sample("frame")
    source = FrfSource(inputs=inputs, stage=obtain_reduction(inputs, reduced_cache("frame")), kind="port")
    parameters = parameterise(inputs, source, S)[0]
    model, place = inputs.model, inputs.dofs.xyz[inputs.model.L.tocsr()[[0]].indices[0]]
    L = model.L.tolil()
    L[0, :] = 0.0
    L[0, nearest(inputs.dofs, place[[1, 0, 2]], "UZ")[0]] = 1.0
    dynamic = parameters.dynamic(parameters.initial, S)
    stated, other = (
        full_ports(replace(model, L=sp.csc_array(rows), extras={}), inputs.input_of, S, (40.0, 500.0)).evaluate(dynamic)
        for rows in (model.L, L)
    )
    return inputs, parameters, stated, other


def told(measured: np.ndarray, error_db: float, *, twice: bool = False) -> dict[tuple[int, ...], str]:
    inputs, parameters, stated, _ = frame()
    off = 10.0 ** (np.random.default_rng(7).normal(0.0, error_db, measured.shape) / 20.0)
    measured = measured * off
    if twice:
        # acc1 measured under another blow.
        model = inputs.model
        L, order = sp.vstack([model.L, model.L.tocsr()[[0]]]).tocsc(), [*range(measured.shape[1]), 0]
        inputs = replace(inputs, model=replace(model, L=L, output_power=model.output_power[order], extras={}))
        object.__setattr__(inputs, "responses", tuple(inputs.responses[i] for i in order))
        measured, stated = measured[:, order], stated[:, order]
    job = seen(measured, stated[None], hz=HZ, inputs=inputs, parameters=parameters)
    return coordinates_texts(job, unlike=False)[0]


@pytest.mark.slow
def test_all_frfs_of_a_sensor_tell_what_one_does_not() -> None:
    other = frame()[3]
    assert told(other, 8.0) == {}
    (responses, text), *_ = told(other, 8.0, twice=True).items()
    assert responses == (0, 4)
    assert "sensor probably stated with x and y exchanged" in text
    assert "near: [0.28, 0.32, 0]" in text


def test_one_frf_is_enough_where_little_is_left() -> None:
    assert list(told(frame()[3], 1.0)) == [(0,)]


def test_sensors_in_each_others_place_beside_a_model_that_lacks_something() -> None:
    """All levels are as far off as a calibration mends: of the two sensors hardly more is left than of the others."""
    inputs, _, stated, _ = frame()
    rough = np.random.default_rng(3).normal(0.0, 9.0, stated.shape)
    measured = stated * 10.0 ** (rough / 20.0)
    assert exchanged(inputs, measured, [stated]) == []
    assert exchanged(inputs, measured[:, [1, 0, 2, 3]], [stated]) == [(0, 1)]


def test_cables_of_two_quantities_in_each_others_place() -> None:
    """Levels are compared without their means, so another unit and sensitivity do not hide it."""
    inputs, _, stated, _ = frame()
    mixed = replace(inputs)
    object.__setattr__(
        mixed, "responses", tuple(replace(r, quantity="pressure" if r is inputs.responses[3] else r.quantity) for r in inputs.responses)
    )
    assert exchanged(mixed, 40.0 * stated[:, [0, 1, 3, 2]], [stated]) == [(2, 3)]
    text = exchanged_text(mixed, [(2, 3)], "tight")
    assert "They measure different quantities, so their cables were probably exchanged at the front end" in text
    assert "records" not in text
    assert "different quantities" not in exchanged_text(mixed, [(1, 2)], "tight")


def test_nothing_is_said_where_places_are_right() -> None:
    assert told(frame()[2], 8.0) == {}


def test_cables_in_each_others_place_are_so_at_every_hammer_point() -> None:
    """Clear of one point, and of the other nearer than as stated: both are told."""
    inputs, _, stated, _ = frame()
    points = [replace(response, input=at) for at in (0, 1) for response in inputs.responses]
    two = replace(inputs)
    object.__setattr__(two, "responses", tuple(points))
    rng = np.random.default_rng(4)
    both = np.concatenate([stated, stated * 10.0 ** (rng.normal(0.0, 12.0, stated.shape) / 20.0)], axis=1)
    model = np.concatenate([stated, stated], axis=1)
    assert exchanged(two, both, [model]) == []
    assert exchanged(two, both[:, [1, 0, 2, 3, 5, 4, 6, 7]], [model]) == [(0, 1), (4, 5)]
    # Exchanged at one point alone, as of records: that one.
    assert exchanged(two, both[:, [1, 0, 2, 3, 4, 5, 6, 7]], [model]) == [(0, 1)]


def test_an_exchange_of_the_reference_job_needs_less_evidence_in_the_others() -> None:
    """Their bolts are loose, and an exchange of some of the same sensors may fit by chance; cables are changed for all jobs."""
    inputs, _, stated, _ = frame()
    rough = stated * 10.0 ** (np.random.default_rng(4).normal(0.0, 20.0, stated.shape) / 20.0)
    assert exchanged(inputs, rough[:, [2, 0, 1, 3]], [stated]) == []
    assert exchanged(inputs, rough[:, [2, 0, 1, 3]], [stated], [(0, 2, 1)]) == [(0, 2, 1)]
    # Right cables in this job, and another exchange that is clear.
    assert exchanged(inputs, rough, [stated], [(0, 2, 1)]) == []
    assert exchanged(inputs, stated[:, [0, 1, 3, 2]], [stated], [(0, 1)]) == [(2, 3)]


def test_nodes_of_the_other_part_in_the_overlap_of_a_lap_joint() -> None:
    """Half of the mesh size away at most, in the same component, and of a part that only springs join."""
    x = np.array([0.0, 0.02, 0.04, 0.02, 0.04, 0.06])
    xyz = np.stack([x, np.zeros(6), np.repeat([0.0, 0.003], 3)], axis=1)
    dofs, part = DofTable(node=np.arange(6), component=np.full(6, "UZ"), xyz=xyz), np.repeat([0, 1], 3)
    assert [_on_other_part(dofs, part, own) for own in range(6)] == [None, 3, 4, 1, 2, None]
    # One part, and plates farther apart than the mesh is fine.
    assert _on_other_part(dofs, np.zeros(6, dtype=np.int64), 1) is None
    assert _on_other_part(replace(dofs, xyz=xyz * [1.0, 1.0, 5.0]), part, 1) is None


def test_a_sensor_on_the_other_plate_of_a_lap_joint() -> None:
    """Stated on the wrong plate at the same x and y: its FRFs of both blows fit the node of the other plate."""
    assert lap(1) == {}
    (text,) = lap(0).values()
    assert text.startswith("a1-h1, a1-h2: sensor probably stated on the wrong one of two parts that overlap there: at node 50 the level")
    assert "near: [0.2, 0, 0.003]" in text


def lap(measured_on: int) -> dict[tuple[int, ...], str]:
    """Texts about a sensor that is stated on the second of two rows of masses, joined by three springs at their overlap."""
    count, own = 40, 10
    row = np.diag(np.full(count, 2.0)) - np.eye(count, k=1) - np.eye(count, k=-1)
    row[0, 0] = row[-1, -1] = 1.0
    n = 2 * count
    left = np.zeros((n, 3))
    for term, at in enumerate((2, 20, 37)):
        left[at, term], left[count + at, term] = 1.0, -1.0
    K, M = sp.csc_array(4e7 * sp.block_diag([row, 0.6 * row])), sp.csc_array(sp.diags_array(np.full(n, 0.4)))
    bolts, place = sp.csc_array(left), (own + count, own)
    terms = LowRankTerms(left=bolts, right=bolts, power=np.zeros(3, dtype=np.int64), baseline=np.zeros(3))
    loads = sp.csc_array((np.ones(2), ([5, count + 30], [0, 1])), (n, 2))
    input_of, hz = np.repeat([0, 1], 2), np.linspace(10.0, 400.0, 150)

    def model(at: int) -> FeModel:
        outputs = sp.csc_array((np.ones(4), (np.arange(4), [at, 27] * 2)), (4, n))
        common = {"output_power": np.full(4, 2), "is_acoustic": np.zeros(n, dtype=bool), "terms": terms}
        return FeModel(K=K, C=sp.csc_array(2e-5 * K), M=M, B=loads, L=outputs, **common)

    def frf(at: int) -> np.ndarray:
        s = 2j * np.pi * hz
        return np.asarray(full_ports(model(at), input_of, s, (10.0, 400.0)).evaluate(np.full((hz.size, 3), 1e6 + 0j)))

    xyz = np.stack([np.tile(0.02 * np.arange(count), 2), np.zeros(n), np.repeat([0.003, 0.0], count)], axis=1)
    campaign = SimpleNamespace(reduction=SimpleNamespace(band=(10.0, 400.0), backend="superlu"), unit_system=SimpleNamespace(length=1.0))
    inputs: Any = SimpleNamespace(
        model=model(place[0]),
        dofs=DofTable(node=np.roll(np.arange(n), count), component=np.full(n, "UZ"), xyz=xyz),
        campaign=campaign,
        input_of=input_of,
        responses=[SimpleNamespace(name=f"{sensor}-{hammer}") for hammer in ("h1", "h2") for sensor in ("a1", "a2")],
    )
    parameters = SimpleNamespace(initial=np.zeros(3), dynamic=lambda theta, s: np.full((len(s), 3), 1e6 + 0j))
    source = SimpleNamespace(inputs=inputs, known={b"work": 1.0})
    job = seen(frf(place[1 - measured_on]), frf(place[0])[None], hz=hz, source=source, parameters=parameters)
    return coordinates_texts(job, unlike=False)[0]
