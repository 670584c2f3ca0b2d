"""Two hammers in each other's place, by the sensors that they have in common."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from looking import seen

from lrbc_cli.campaign.findings import Finding, Kind
from lrbc_cli.campaign.identification.compared.likeness import by_sensors, exchanged_text
from lrbc_cli.campaign.looking.all_jobs import pooled
from lrbc_cli.campaign.looking.causes.moved import _places, hammers_text, unmoved_text
from lrbc_cli.campaign.looking.unexplained import beside_fitted
from lrbc_cli.model.dofs import DofTable


def campaign(reference: str = "tight") -> Any:
    return SimpleNamespace(update=SimpleNamespace(reference=reference))


def two_hammers() -> tuple[Any, np.ndarray]:
    """Four sensors, hit at two places, and FRFs of the model."""
    rng = np.random.default_rng(3)
    responses = [
        SimpleNamespace(name=f"a{node}-h{at + 1}", node=node, direction=3, quantity="acceleration", input=at)
        for at in (0, 1)
        for node in (1, 2, 3, 4)
    ]
    return SimpleNamespace(responses=responses, excitations=("h1", "h2"), campaign=campaign()), 10.0 ** rng.normal(
        0.0, 0.5, (1, 200, 8)
    ) + 0j


def test_two_hammers_in_each_others_place() -> None:
    inputs, states = two_hammers()
    measured = 1.1 * states[0][:, [4, 5, 6, 7, 0, 1, 2, 3]]
    text = hammers_text(seen(measured, states, inputs=inputs))
    assert text.startswith("h1 and h2 are probably exchanged")
    own = "records: {a1-h1: a1-h2, a2-h1: a2-h2, a3-h1: a3-h2, a4-h1: a4-h2, a1-h2: a1-h1, a2-h2: a2-h1, a3-h2: a3-h1, a4-h2: a4-h1}"
    assert own in text
    # Of the reference job the campaign file is wrong, of another one its records.
    exchange = "the places of excitation.h1 and excitation.h2"
    assert text.endswith(f"Exchange {exchange}, or write jobs.tight.{own}")
    inputs.campaign = campaign("another")
    assert hammers_text(seen(measured, states, inputs=inputs)).endswith(f"{own}, or, if all jobs are affected, exchange {exchange}")


def test_nothing_is_said_where_they_are_right_or_where_it_explains_nothing() -> None:
    inputs, states = two_hammers()
    assert hammers_text(seen(1.1 * states[0], states, inputs=inputs)) == ""
    assert hammers_text(seen(np.roll(states[0], 50, axis=0), states, inputs=inputs)) == ""


def test_what_other_hammers_leave_may_be_left_of_exchanged_ones() -> None:
    """A model that is not calibrated leaves 5 dB of every FRF."""
    rng = np.random.default_rng(5)
    responses = [
        SimpleNamespace(name=f"a{node}-h{at + 1}", node=node, direction=3, quantity="acceleration", input=at)
        for at in (0, 1, 2)
        for node in (1, 2, 3, 4)
    ]
    inputs: Any = SimpleNamespace(responses=responses, excitations=("h1", "h2", "h3"), campaign=campaign())
    states = 10.0 ** rng.normal(0.0, 1.0, (1, 400, 12)) + 0j
    errs = 10.0 ** (rng.normal(0.0, 5.0, (400, 12)) * np.sqrt(np.pi / 2.0) / 20.0)
    measured = states[0][:, [8, 9, 10, 11, 4, 5, 6, 7, 0, 1, 2, 3]] * errs
    assert hammers_text(seen(measured, states, inputs=inputs)).startswith("h1 and h3 are probably exchanged")
    assert hammers_text(seen(states[0] * errs, states, inputs=inputs)) == ""
    # Right FRFs of the third say that the model does not leave so much.
    measured[:, 4:8] = states[0][:, 4:8]
    assert hammers_text(seen(measured, states, inputs=inputs)) == ""


def test_cables_exchanged_are_one_finding_whatever_was_hit() -> None:
    inputs, _ = two_hammers()
    one, other = by_sensors(inputs, [(0, 1), (2, 3), (4, 5)])
    assert one == ((0, 1), (4, 5))
    assert other == ((2, 3),)
    text = exchanged_text(inputs, one, "loose")
    assert text.startswith("a1-h1 and a2-h1; a1-h2 and a2-h2 are probably exchanged: each fits the model's FRF of the other. Write ")
    assert "jobs.loose.records: {a2-h1: a1-h1, a1-h1: a2-h1, a2-h2: a1-h2, a1-h2: a2-h2}, or, if all jobs are affected, exchange" in text
    assert text.endswith("the places of responses.a1-h1 and responses.a2-h1; responses.a1-h2 and responses.a2-h2")
    # Three of them the other way round is another exchange.
    assert len(by_sensors(inputs, [(0, 1, 2), (4, 6, 5)])) == 2
    (three,) = by_sensors(inputs, [(0, 1, 2), (4, 5, 6)])
    text = exchanged_text(inputs, three, "tight")
    assert text.startswith("a1-h1, a2-h1 and a3-h1; a1-h2, a2-h2 and a3-h2 are probably exchanged: each fits the model's FRF of the next, ")
    assert (
        "last that of the first. Give each of these responses the place of the next, or write jobs.tight.records: {a2-h1: a1-h1, " in text
    )


def test_a_job_that_shows_part_of_an_exchange_shows_that_exchange() -> None:
    cycles = {"tight": ((0, 1), (4, 5)), "loose": ((4, 5),), "other": ((2, 3),)}
    found = pooled({name: [Finding(kind=Kind.EXCHANGED, text=f"of {name}", cycles=own)] for name, own in cycles.items()}, "tight")
    assert [str(each) for each in found] == ["job tight: of tight", "job loose: of tight", "job other: of other"]


def test_a_hammer_that_was_not_moved() -> None:
    inputs, states = two_hammers()
    measured = 1.1 * states[0]
    measured[:, 4:] = measured[:, :4] * (1.0 + 0.02 * np.random.default_rng(4).normal(size=(200, 4)))
    text = unmoved_text(seen(measured, states, inputs=inputs))
    assert text.startswith("the hammer was probably not moved: FRFs of h1 and of h2 are the same at all 4 sensors")
    assert "again at its own place" in text


def test_places_that_are_alike_in_the_model_are_alike_when_measured() -> None:
    inputs, states = two_hammers()
    assert unmoved_text(seen(1.1 * states[0], states, inputs=inputs)) == ""
    states[0][:, 4:] = states[0][:, :4]
    assert unmoved_text(seen(1.1 * states[0], states, inputs=inputs)) == ""


def test_records_exchanged_in_a_job_with_loosened_bolts_show_beside_a_fit() -> None:
    """No state that is known is near; that which is fitted to the records, exchanged, is, and that fitted as they are is not."""
    inputs, states = two_hammers()
    loosened = np.roll(states[0], 35, axis=0)
    exchanged = loosened[:, [4, 5, 6, 7, 0, 1, 2, 3]]

    def fitted(measured: np.ndarray) -> np.ndarray:
        right = np.allclose(measured, loosened)
        return 1.05 * loosened if right else states[0]

    assert hammers_text(seen(exchanged, states, inputs=inputs, job="loose")) == ""
    assert "jobs.loose.records" in hammers_text(seen(exchanged, states, inputs=inputs, job="loose"), fitted)
    assert hammers_text(seen(loosened, np.concatenate([states, 1.05 * loosened[None]]), inputs=inputs, job="loose"), fitted) == ""
    assert hammers_text(seen(exchanged, states, inputs=inputs, job="loose"), lambda _: None) == ""


@pytest.mark.parametrize(("h1_db", "h2_db", "told"), [(5.0, 2.0, True), (5.0, 2.8, False), (5.0, 4.0, False), (2.5, 1.0, False)])
def test_a_hammer_that_hit_elsewhere_in_a_job_with_loosened_bolts(h1_db: float, h2_db: float, told: bool) -> None:
    """Its records are far from the fitted state, those of the other hammer point are not; errors of the model show at both."""
    inputs, states = two_hammers()
    inputs.campaign, inputs.input_of = campaign("another"), np.repeat([0, 1], 4)
    errs = np.random.default_rng(6).laplace(0.0, 1.0, (200, 8)) * np.repeat([h1_db, h2_db], 4)
    texts = [str(one) for one in beside_fitted(seen(states[0] * 10.0 ** (errs / 20.0), states, inputs=inputs), states[0])]
    assert any("FRFs of h1 differ from the state of the bolts that fits best by" in text for text in texts) == told
    if told:
        assert len(texts) == 1
        assert "direction of excitation.h1 in this job" in texts[0]


@pytest.mark.parametrize(("a2", "others", "told"), [((12.0, 7.0), 2.0, True), ((12.0, 7.0), 4.0, False), ((7.0, 3.0), 2.0, False)])
def test_a_sensor_that_was_overloaded_in_a_job_with_loosened_bolts(a2: tuple[float, float], others: float, told: bool) -> None:
    """Its records are far from the fitted state in the median over the hammer points, three times as far as those of the other sensors."""
    inputs, states = two_hammers()
    inputs.campaign, inputs.input_of = campaign("another"), np.repeat([0, 1], 4)
    sizes = np.full(8, others)
    sizes[[1, 5]] = a2
    errs = np.random.default_rng(7).laplace(0.0, 1.0, (200, 8)) * sizes
    texts = [str(one) for one in beside_fitted(seen(states[0] * 10.0 ** (errs / 20.0), states, inputs=inputs), states[0])]
    assert [text.partition(" by ")[0] for text in texts] == [
        f"a2-{at} differs from the state of the bolts that fits best" for at in ("h1", "h2") if told
    ]
    assert all("Check whether its sensor was loose, dead, overloaded or moved" in text for text in texts)


def test_a_record_that_was_overloaded_alone() -> None:
    """A sensor that is right at the other hammer point was neither dead nor moved, and its record there is no finding."""
    inputs, states = two_hammers()
    inputs.campaign, inputs.input_of = campaign("another"), np.repeat([0, 1], 4)
    sizes = np.full(8, 1.5)
    sizes[[1, 5]] = 15.0, 2.0
    errs = np.random.default_rng(7).laplace(0.0, 1.0, (200, 8)) * sizes
    (text,) = (str(one) for one in beside_fitted(seen(states[0] * 10.0 ** (errs / 20.0), states, inputs=inputs), states[0]))
    assert text.startswith("a2-h1 differs from the state of the bolts that fits best")
    assert "Check whether its sensor was overloaded or had fallen off, or a cable was loose, during these blows" in text


@pytest.mark.parametrize("most", [40, 10_000])
def test_places_tried_for_several_hammer_points(most: int) -> None:
    """One set for all, so that they share the solves: near each of them, and spread over the structure."""
    nodes = np.repeat(np.arange(1, 101), 3)
    xyz = np.zeros((300, 3))
    xyz[:, 0] = nodes
    table = DofTable(node=nodes, component=np.tile(["UX", "UY", "UZ"], 100), xyz=xyz)
    # Node 10 along Z, node 80 along Z, node 50 along Y.
    own = [29, 239, 148]
    found = _places(table, own, most)
    assert set(own) <= set(found.tolist())
    assert all({27, 28, 29} <= set(_places(table, [29], one).tolist()) for one in (40, 10_000))
    along = {component: sorted(nodes[found[table.component[found] == component]].tolist()) for component in ("UX", "UY", "UZ")}
    assert along["UX"] == [10, 50, 80]
    if most > 300:
        assert along["UY"] == along["UZ"] == list(range(1, 101))
    else:
        # As near to each as for one alone, and others between them and beyond.
        assert {*range(6, 15), *range(76, 85)} <= set(along["UZ"])
        assert any(35 < node < 55 for node in along["UZ"])
        assert any(node > 90 for node in along["UZ"])
        assert 2 * most >= found.size
