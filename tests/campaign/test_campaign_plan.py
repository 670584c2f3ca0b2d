"""The plan against the update: one bolt of the frame loosened through its shape, in the plan and in measurements that are identified."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from campaigns import Folder, frame
from scipy.stats import norm

from lrbc_cli.campaign.identification.unknowns import parameterise, theta_of
from lrbc_cli.campaign.planning.rehearsal import by_rule, threshold
from lrbc_cli.campaign.reduced.stage import frf_source, obtain_reduction
from lrbc_cli.io.frf import read_frf, write_frf
from lrbc_cli.results.store import read_job
from lrbc_cli.updating.unknowns.shapes import bolt_shapes

#: Bolts that are loosened, one in each job; relative noise of every value (0.3 dB in magnitude).
BOLTS, NOISE, LOSS = ("B2", "B5"), 0.05, 2.0

#: What one draw of each may differ by.
TOLERANCE = 0.1


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Folder:
    """The frame, its tight state identified, and the tight measurement times what the model says of one loosened bolt."""
    folder = frame(tmp_path_factory.mktemp("plan") / "frame")
    tree = folder.tree()
    tree["jobs"] = {"tight": tree["jobs"]["tight"]}
    folder.write(tree)
    assert folder.run("update").code == 0
    inputs = folder.inputs()
    assert inputs.bolts is not None
    source = frf_source(inputs, obtain_reduction(inputs, folder.cache))
    measured = read_frf(folder.data / "frf" / "tight.csv")
    frequency = measured.records[0].frequency_hz
    inside = (frequency >= 30.0) & (frequency <= 500.0)
    s = 2j * np.pi * frequency[inside]
    parameters, _ = parameterise(inputs, source, s)
    theta = theta_of(parameters, read_job(folder.out, "tight").parameters)
    assert theta is not None
    model, shapes = source.model(s, parameters), bolt_shapes(parameters, inputs.bolts.xyz)
    rng = np.random.default_rng(5)
    for name in BOLTS:
        column = shapes.T[:, shapes.bolts[inputs.bolts.name.index(name)]]
        there = np.clip(theta - LOSS * column, *parameters.bounds.T)
        ratio = model.frf(there) / model.frf(theta)
        records = []
        for i, response in enumerate(inputs.responses):
            record = next(r for r in measured.records if r.name == response.name)
            noise = (rng.normal(size=s.size) + 1j * rng.normal(size=s.size)) / np.sqrt(2.0)
            values = record.values[inside] * ratio[:, i] * (1.0 + NOISE * noise)
            records.append(replace(record, frequency_hz=frequency[inside], values=values))
        write_frf(folder.data / "frf" / f"{name}.csv", replace(measured, records=tuple(records)))
        tree["jobs"][name] = {"frf": f"data/frf/{name}.csv"}
    folder.write(tree)
    return Folder(Path(folder.path))


@pytest.mark.slow
def test_the_plan_states_what_the_update_states(folder: Folder) -> None:
    updated = folder.run("update", "--json")
    assert updated.code == 0, updated.stderr
    planned = folder.run("plan", "--json", "--draws", "1")
    assert planned.code == 0, planned.stderr
    promised = {bolt["name"]: bolt for bolt in planned.json["bolts"]}
    for name in BOLTS:
        (found,) = (bolt for bolt in updated.json["results"][name]["bolts"] if bolt["name"] == name)
        assert found["verdict"] == "loose"
        (said,) = (loss["rehearsal"] for loss in promised[name]["losses"] if loss["decades"] == LOSS)
        assert said["probability_loose"] == [pytest.approx(found["probability_loose"], abs=TOLERANCE)]
        # Neither draws the change to zero as a normal prior of 0.35 decades would.
        assert said["change"] == [pytest.approx(found["change"], abs=0.5)]
        assert said["loose"] == 1
    thresholds = {b["threshold"] for name in BOLTS for b in updated.json["results"][name]["bolts"]}
    assert planned.json["loose_change"] == max(thresholds)


def test_the_rule_of_a_verdict_limits_what_linearised_figures_promise(folder: Folder) -> None:
    """By hand: an estimate, normal about the true change, is judged with its own width and the scatter of tight joints."""
    inputs = folder.inputs()
    rule, limit, std = inputs.method.rule, threshold(inputs, joints=True), 0.05
    change = np.array([0.0, limit, -1.0, -2.0])
    own = np.hypot(std, 0.12 * change)
    told = np.hypot(own, rule.joint_spread * rule.joint_scatter)
    found = by_rule(inputs, change, np.full(change.size, std), joints=True)
    np.testing.assert_allclose(found, norm.cdf((limit - norm.ppf(rule.confidence) * told - change) / own), rtol=1e-9)
    # A joint that has lost as much as the threshold is hardly ever called loose, and one that has lost two decades nearly always.
    assert found[1] < 1.0 - rule.confidence
    assert found[3] > 0.99
    # Along an edge nothing is added to the standard deviation of a change where no baseline shows a scatter.
    edge, own = threshold(inputs, joints=False), by_rule(inputs, change, np.full(change.size, std), joints=False)
    np.testing.assert_allclose(own, norm.cdf((edge - norm.ppf(rule.confidence) * std - change) / std), rtol=1e-9, atol=1e-300)
