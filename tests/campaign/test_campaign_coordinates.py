"""A sensor that is stated with its coordinates exchanged, by all its FRFs at once."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp
from looking import seen
from samples import reduced_cache, sample

from lrbc_cli.campaign.identification.compared.likeness import exchanged
from lrbc_cli.campaign.identification.unknowns import parameterise
from lrbc_cli.campaign.looking.causes.coordinates import coordinates_texts
from lrbc_cli.campaign.reduced.stage import FrfSource, obtain_reduction
from lrbc_cli.model.selection import nearest
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
