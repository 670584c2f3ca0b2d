"""The choices of the misfit through a whole campaign: weights, repeats, lines, the L-curve, several starts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from campaigns import Folder
from test_campaign_identify import identify, measure, values

from lrbc_cli.campaign.identification.records import read_measurement
from lrbc_cli.campaign.identification.unknowns import select_lines
from lrbc_cli.campaign.identification.weights import line_sigma, without_noise
from lrbc_cli.io.frf import read_frf, write_frf
from lrbc_cli.model.frf import FrfSet
from lrbc_cli.updating.statistics.decibels import coherence_sigma, noise_weights


def repeated(folder: Folder, count: int, error: float, *, lines: slice = slice(None)) -> list[str]:
    """Files with further measurements of the loose state, each with its own noise."""
    rng = np.random.default_rng(3)
    names = []
    for k in range(count):
        records = []
        for record in read_frf(folder.data / "loose.uff").records:
            noise = error * np.abs(record.values) * (rng.normal(size=(2, record.values.size)).T @ [1.0, 1j])
            records.append(replace(record, values=(record.values + noise)[lines], frequency_hz=record.frequency_hz[lines], coherence=None))
        names.append(f"again-{k}.uff")
        write_frf(folder.data / names[-1], FrfSet(source=names[-1], records=tuple(records)))
    return names


def with_repeats(folder: Folder, names: list[str]) -> None:
    tree = folder.tree()
    before = tree["jobs"]["loose"]["frf"]
    tree["jobs"]["loose"]["repeats"] = [before.replace("loose.uff", name) for name in names]
    folder.write(tree)


@pytest.mark.parametrize(
    "overrides",
    [
        ("update.residual=log-complex",),
        ("update.residual=log-complex", "update.loss=soft", "update.loss_scale=1.0", "update.floor=30.0"),
        ("update.loss=soft",),
        ("update.floor=40.0",),
    ],
    ids=" ".join,
)
def test_every_misfit_finds_the_truth(box: Folder, overrides: tuple[str, ...]) -> None:
    truth = np.array([4.35, 4.4, 4.3, 4.4, 4.45, 4.38])
    measure(box, 10.0**truth)
    tree = identify(box, *overrides, "update.regularisation=0.0", "update.reference=")
    np.testing.assert_allclose(values(tree), truth, atol=1e-3)
    assert tree["misfit_db"]["final"] < 1e-3


def test_the_mean_of_repeats(box: Folder) -> None:
    with_repeats(box, repeated(box, 3, 0.05))
    inputs = box.inputs()
    found = read_measurement(inputs, inputs.campaign.jobs["loose"], "loose")
    each = [read_frf(box.data / name).records for name in ("loose.uff", "again-0.uff", "again-1.uff", "again-2.uff")]
    stack = np.stack([np.stack([record.values for record in records], axis=1) for records in each])
    np.testing.assert_allclose(found.values, stack.mean(axis=0), rtol=1e-10)
    assert found.files == 4
    assert found.notes[-1] == "mean of 4 measurements"
    assert len(found.hashes) == 4
    # Three of four carry noise of 5 % in each part: the mean has sqrt(3)/4 of it, and the estimate is right on average.
    assert found.sigma_db is not None
    rms = float(np.sqrt(np.mean(found.sigma_db**2)))
    assert rms == pytest.approx(8.686 * 0.05 * np.sqrt(3.0) / 4.0, rel=0.1)


def test_the_scatter_of_repeats_is_a_weight(box: Folder) -> None:
    with_repeats(box, repeated(box, 2, 0.3))
    inputs = box.inputs("update.regularisation=auto")
    job = inputs.campaign.jobs["loose"]
    measurement = read_measurement(inputs, job, "loose")
    selected, _ = select_lines(inputs, measurement, "loose")
    sigma, notes = line_sigma(inputs, measurement, job, selected)
    assert notes == ()
    assert sigma is not None
    assert measurement.sigma_db is not None
    np.testing.assert_array_equal(sigma, measurement.sigma_db[np.ix_(selected, inputs.used)])
    weights = noise_weights(sigma, inputs.statistics.errors.first_discrepancy_db)
    assert weights.min() < 0.5 < weights.max() < 1.0
    alone = inputs.campaign.jobs["loose"].model_copy(update={"repeats": ()})
    assert line_sigma(inputs, read_measurement(inputs, alone, "loose"), alone, selected) == (None, ())


def test_repeats_change_the_result(box: Folder) -> None:
    before = values(identify(box))
    with_repeats(box, repeated(box, 1, 0.02))
    after = values(identify(box))
    assert 0 < np.abs(after - before).max() < 0.3
    # Another content under the same name is another measurement.
    records = read_frf(box.data / "loose.uff").records
    write_frf(box.data / "again-0.uff", FrfSet(source="again", records=records))
    np.testing.assert_allclose(values(identify(box)), before, atol=1e-6)


def test_repeats_on_other_lines(box: Folder) -> None:
    with_repeats(box, repeated(box, 1, 0.02, lines=slice(0, 150)))
    result = box.run("update", "--job", "loose")
    assert result.code == 5
    for part in ("again-0.uff", "other frequency lines", "191 lines from 20 to 400 Hz", "150 lines"):
        assert part in result.stderr


@pytest.mark.slow
def test_coherence_is_a_weight(box: Folder) -> None:
    records = list(read_frf(box.data / "loose.uff").records)
    g2 = np.linspace(0.2, 1.0, records[0].frequency_hz.size)
    write_frf(box.data / "loose.uff", FrfSet(source="loose", records=(*(replace(r, coherence=g2) for r in records[:-1]), records[-1])))
    inputs = box.inputs("update.regularisation=auto", "jobs.loose.averages=3")
    job = inputs.campaign.jobs["loose"]
    measurement = read_measurement(inputs, job, "loose")
    selected, _ = select_lines(inputs, measurement, "loose")
    sigma, notes = line_sigma(inputs, measurement, job, selected)
    assert sigma is not None
    np.testing.assert_allclose(sigma[:, 0], coherence_sigma(g2[selected], 3), rtol=1e-6)
    assert np.isnan(sigma[:, -1]).all()
    (note,) = notes
    assert f"weight 1, as there is no coherence, for {inputs.responses[inputs.used[-1]].name} ({selected.size} lines)" in note
    tree = identify(box, "update.regularisation=auto", "jobs.loose.averages=3")
    assert note in tree["notes"]
    # Ten times the averages: another weight, hence another cost for the same start.
    other = identify(box, "update.regularisation=auto", "jobs.loose.averages=30")
    assert other["cost"]["initial"] > tree["cost"]["initial"]
    assert other["misfit_db"]["initial"] == tree["misfit_db"]["initial"]


@pytest.mark.parametrize("written", [0.0, np.nan])
def test_no_coherence_is_not_a_bad_one(box: Folder, written: float) -> None:
    """Some programs write a column of zeros where they have none."""
    records = read_frf(box.data / "loose.uff").records
    g2 = np.full(records[0].frequency_hz.size, written)
    write_frf(box.data / "loose.h5", FrfSet(source="loose", records=tuple(replace(r, coherence=g2) for r in records)))
    inputs = box.inputs("update.regularisation=auto", "jobs.loose.frf=data/loose.h5")
    job = inputs.campaign.jobs["loose"]
    measurement = read_measurement(inputs, job, "loose")
    assert line_sigma(inputs, measurement, job, select_lines(inputs, measurement, "loose")[0]) == (None, ())


def test_zeros_between_other_values_are_the_worst_coherence(box: Folder) -> None:
    """Rounded or cut off by the export: such lines must not weigh as much as those without noise."""
    records = read_frf(box.data / "loose.uff").records
    g2 = np.where(np.arange(records[0].frequency_hz.size) % 10 == 0, 0.0, 0.9)
    write_frf(box.data / "loose.uff", FrfSet(source="loose", records=tuple(replace(r, coherence=g2) for r in records)))
    inputs = box.inputs("update.regularisation=auto")
    job = inputs.campaign.jobs["loose"]
    measurement = read_measurement(inputs, job, "loose")
    selected, _ = select_lines(inputs, measurement, "loose")
    sigma, notes = line_sigma(inputs, measurement, job, selected)
    assert notes == ()
    assert sigma is not None
    zero = g2[selected] == 0.0
    assert zero.any()
    assert sigma[zero].min() > 100.0
    np.testing.assert_allclose(sigma[~zero], coherence_sigma(np.full(sigma[~zero].shape, 0.9), job.averages), rtol=1e-6)


def test_noise_is_weighed_where_it_is_known(box: Folder) -> None:
    records = read_frf(box.data / "loose.uff").records
    g2 = np.full(records[0].frequency_hz.size, 0.9)
    write_frf(box.data / "loose.uff", FrfSet(source="loose", records=tuple(replace(r, coherence=g2) for r in records)))
    inputs = box.inputs("update.regularisation=auto")
    job = inputs.campaign.jobs["loose"]
    measurement = read_measurement(inputs, job, "loose")
    selected, _ = select_lines(inputs, measurement, "loose")
    sigma, _ = line_sigma(inputs, measurement, job, selected)
    np.testing.assert_allclose(sigma, coherence_sigma(np.full((selected.size, inputs.used.size), 0.9), job.averages), rtol=1e-6)
    # One average has no coherence; a weight of one's own for the prior leaves nothing to weigh the noise against.
    for words in (("update.regularisation=auto", "jobs.loose.averages=1"), ("update.regularisation=10",)):
        inputs = box.inputs(*words)
        assert line_sigma(inputs, measurement, inputs.campaign.jobs["loose"], selected)[0] is None


@pytest.mark.slow
def test_l_curve(frame: Folder) -> None:
    # As in the paper: all values, drawn to their start.
    paper = ["update.regularisation=l-curve", "update.loss=squares"]
    outcome = frame.run("update", "--json", *[word for key in paper for word in ("--override", key)])
    assert outcome.code == 0, outcome.stderr
    results = outcome.json["results"]
    for tree in results.values():
        curve = tree["l_curve"]
        assert len(curve["eta"]) == len(curve["data"]) == len(curve["penalty"]) == 9
        assert tree["optimiser"]["regularisation"] == curve["chosen"]
        assert tree["line_evaluations"] == (tree["evaluations"] + curve["evaluations"]) * tree["lines"]["count"]
    for job in ("loose-2", "loose-all"):
        curve = results[job]["l_curve"]
        assert curve["eta"][0] < curve["chosen"] < curve["eta"][-1]
        assert abs(np.log10(curve["chosen"] / curve["eta"][curve["corner"]])) <= 0.375 + 1e-9
        assert curve["data"][0] <= curve["at"]["data"] <= curve["data"][-1]
        assert not [note for note in results[job]["notes"] if "L-curve" in note]
    loose = {b["name"] for b in results["loose-2"]["bolts"] if b["verdict"] == "loose"}
    assert loose == {"B3", "B4"}
    # Nothing is loose in this state: the start explains most of it, and no weight stands out.
    tight = results["tight"]
    assert tight["l_curve"]["corner"] is tight["l_curve"]["at"] is None
    # A decade of each of ten values then costs as much as 1 dB in every residual of three responses.
    natural = tight["lines"]["count"] * 3 / 10
    assert tight["l_curve"]["chosen"] == tight["optimiser"]["regularisation"] == pytest.approx(natural)
    assert any("no corner" in note and f"{natural:.3g}" in note for note in tight["notes"])
    # The report draws them.
    assert frame.run("report", "--job", "tight", "--job", "loose-2", *[word for key in paper for word in ("--override", key)]).code == 0
    page = (frame.out / "report.html").read_text(encoding="utf-8")
    assert "Regularisation" in page
    assert page.count("L-curve of job") == 2
    for job in ("tight", "loose-2"):
        assert (frame.out / job / "l-curve.png").read_bytes().startswith(b"\x89PNG")


def test_l_curve_with_bfgs(frame: Folder) -> None:
    tree = identify(frame, "update.regularisation=l-curve", "update.method=bfgs", job="loose-2")
    assert tree["optimiser"]["regularisation"] == tree["l_curve"]["chosen"]
    assert tree["optimiser"]["starts"] == []


def test_starts_are_listed(frame: Folder) -> None:
    starts = frame.result("loose-2")["optimiser"]["starts"]
    # Two basins of a uniform change, the nearest states of the tables, and places beside the best of them.
    described = [start["description"] for start in starts]
    assert sum(text.startswith("table of changes: B") for text in described) == 2
    assert sum(", then " in text for text in described) >= 5
    assert any(text.startswith("uniform change of log10 by ") for text in described)
    # Values along the edge have no prior but their start values: uniform values. A weight that is given is the same at all ends.
    tree = identify(frame, "update.regularisation=10", job="loose-2")
    starts = tree["optimiser"]["starts"]
    assert any(start["description"].startswith("uniform log10 left_edge ") for start in starts)
    assert tree["l_curve"] is None
    (kept,) = [start for start in starts if start["kept"]]
    assert kept["cost"] == tree["cost"]["final"] == min(start["cost"] for start in starts)
    assert kept["total"] == pytest.approx(10.0 ** kept["cost"])


def drown(box: Folder, job: str, response: int = 0) -> np.ndarray:
    """Noise in place of one response of a job below 60 Hz; which lines."""
    records = list(read_frf(box.data / f"{job}.uff").records)
    hz, rng = records[response].frequency_hz, np.random.default_rng(8)
    noise = rng.normal(size=hz.size) + 1j * rng.normal(size=hz.size)
    drowned = np.where(hz < 60.0, np.abs(records[response].values).mean() * noise, records[response].values)
    records[response] = replace(records[response], values=drowned)
    write_frf(box.data / f"{job}.uff", FrfSet(source=job, records=tuple(records)))
    return np.asarray(hz < 60.0)


def test_what_is_mostly_noise_is_not_compared(box: Folder) -> None:
    """No peak of it is a resonance; where coherence tells the noise, or nothing is weighed against it, all is compared."""
    low = drown(box, "tight")
    inputs = box.inputs("update.regularisation=auto")
    measurement = read_measurement(inputs, inputs.campaign.jobs["tight"], "tight")
    lost = np.isnan(without_noise(inputs, "tight", measurement)) & np.isfinite(measurement.values)
    (at,) = np.flatnonzero(lost.any(axis=0)).tolist()
    assert lost[low, at].mean() > 0.8
    assert lost[~low, at].mean() < 0.05
    paper = box.inputs("update.regularisation=10")
    np.testing.assert_array_equal(without_noise(paper, "tight", measurement), measurement.values)
    coherent = replace(measurement, coherence=np.full(measurement.values.shape, 0.9))
    np.testing.assert_array_equal(without_noise(inputs, "tight", coherent), measurement.values)
    # A cost weights such values already, but a mean misfit does not.
    few = np.where(low[:, None] & (np.arange(measurement.values.shape[1]) == at), 0.1, 0.9)
    weighed = np.isnan(without_noise(inputs, "tight", replace(measurement, coherence=few), known=True))
    np.testing.assert_array_equal(weighed, np.isnan(measurement.values) | (few == 0.1))
    # The noise of the reference job decides: a response that drowns in a job alone is evidence, and counts.
    drowned = replace(measurement, coherence=few)
    clear = replace(measurement, coherence=np.full(measurement.values.shape, 0.9))
    np.testing.assert_array_equal(without_noise(inputs, "loose", drowned, clear, known=True), measurement.values)
    np.testing.assert_array_equal(np.isnan(without_noise(inputs, "loose", clear, drowned, known=True)), weighed)
    # A sensor that is dead on most lines is a fault, and no noise to do without.
    dead, rng = measurement.values.copy(), np.random.default_rng(9)
    dead[:, at] = rng.normal(size=len(dead)) + 1j * rng.normal(size=len(dead))
    np.testing.assert_array_equal(without_noise(inputs, "tight", replace(measurement, values=dead)), dead)
    # What the reference job does not tell is left out of the jobs that are compared with it.
    assert box.run("update", "--override", "update.regularisation=auto").code in (0, 5)
    for name, where in (("tight", "noise, by"), ("loose", "noise in tight, by")):
        (note,) = [text for text in box.result(name)["notes"] if "mostly noise" in text]
        assert where in note
        assert f"{inputs.responses[at].name} ({int(lost[:, at].sum())})" in note


def test_what_a_loosened_bolt_drowns_is_compared(box: Folder) -> None:
    """Where the reference job is clear the noise of another one is what has become of its level."""
    drown(box, "loose")
    assert box.run("update", "--override", "update.regularisation=auto").code in (0, 5)
    assert not [text for text in box.result("loose")["notes"] if "mostly noise" in text]
