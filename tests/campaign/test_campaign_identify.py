"""Identification: the truth comes back for every kind of group, line choice, formula and optimiser."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest
import scipy.io
import scipy.sparse as sp
from campaigns import BOX_TRUTH, Folder
from systems import direct_frf

import lrbc_cli
from lrbc_cli.campaign.identification import identify as identification
from lrbc_cli.campaign.identification import job as job_module
from lrbc_cli.campaign.jobs.identity import identification as identity_of
from lrbc_cli.campaign.reading.factors import CalibrationUse
from lrbc_cli.campaign.reading.inputs import read_as_exported
from lrbc_cli.campaign.reduced.cache import key_parts
from lrbc_cli.config import load_campaign
from lrbc_cli.io.frf import read_frf, write_frf
from lrbc_cli.model.factors import with_factors
from lrbc_cli.model.frf import FrfRecord, FrfSet
from lrbc_cli.results.model import Boundary
from lrbc_cli.updating.search import descent
from lrbc_cli.updating.statistics.priors import BOLT_PRIOR

FREQUENCY = np.arange(20.0, 401.0, 2.0)
S = 2j * np.pi * FREQUENCY

AUTO = "update.regularisation=auto"

#: A truth near the start: these tests are about what is computed, not about how far the optimiser sees.
MILD = np.array([4.6, 4.4, 4.0, 4.1, 4.55, 4.65])


def measure(folder: Folder, D: np.ndarray, job: str = "loose") -> None:
    """Write the FRFs of the campaign's own model by dense solves: no formula of the program, and no error of the model."""
    inputs = folder.inputs()
    y = direct_frf(inputs.model, S, np.broadcast_to(D, (S.size, inputs.model.terms.size)).astype(complex), inputs.input_of)
    records = [FrfRecord(name=r.name, frequency_hz=FREQUENCY, values=y[:, i], quantity=r.quantity) for i, r in enumerate(inputs.responses)]
    write_frf(folder.data / f"{job}.uff", FrfSet(source=job, records=tuple(records)))


def identify(folder: Folder, *overrides: str, job: str = "loose", status: str = "converged", says: str = "does not reach the data") -> Any:
    """Result of one job."""
    args = [word for text in overrides for word in ("--override", text)]
    outcome = folder.run("update", "--json", "--job", job, *args)
    assert outcome.code == 0, outcome.stderr
    # Settings that hold the fit away from the data, or bolts at tight, say so, and another job may lie outside what they can explain.
    aside = (says, "stated to be missing", "practically excludes loose bolts")
    lines = [line for line in outcome.stderr.splitlines() if not any(text in line for text in aside)]
    assert not [line for line in lines if f"job {job}:" in line or not line.startswith("warning: job ")]
    tree = outcome.json["results"][job]
    assert tree["status"] == status
    return tree


def values(tree: Any, group: str = "springs") -> np.ndarray:
    return np.array(tree["parameters"][group]["log10"])


def groups(folder: Folder, **wanted: Any) -> None:
    """Replace the parameter groups; no bolts, no reference."""
    tree = folder.tree()
    tree["parameters"] = wanted
    tree["jobs"].pop("tight")
    del tree["update"]["reference"], tree["bolts"], tree["jobs"]["loose"]["removed"]
    folder.write(tree)


# -- formulas and optimisers --------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_formulas_agree_on_the_frame(frame: Folder) -> None:
    band = "reduction.band=[30.0, 160.0]"
    found = {kind: identify(frame, band, f"update.evaluation={kind}", job="loose-2") for kind in ("port", "reduced", "full")}
    port = found["port"]
    for kind in ("reduced", "full"):
        group, other = found[kind]["parameters"]["left_edge"], port["parameters"]["left_edge"]
        # The same model in two formulas; against the full order, as far as the tolerance of the FRFs goes.
        tolerance = 1e-6 if kind == "reduced" else 1e-3
        np.testing.assert_allclose(group["log10"], other["log10"], atol=tolerance)
        assert group["damping_exponent"] == pytest.approx(other["damping_exponent"], abs=tolerance)
        assert found[kind]["misfit_db"]["final"] == pytest.approx(port["misfit_db"]["final"], abs=1e-4)
        assert [b["verdict"] for b in found[kind]["bolts"]] == [b["verdict"] for b in port["bolts"]]
    assert "certificate" in port["provenance"]
    assert "certificate" not in found["full"]["provenance"]


@pytest.mark.slow
def test_full_order_needs_no_reduced_model(box: Folder) -> None:
    for path in [*box.cache.rglob("*.*"), box.out / "reduction.json"]:
        path.unlink()
    for _ in range(2):
        np.testing.assert_allclose(values(identify(box, "update.evaluation=full")), BOX_TRUTH["loose"], atol=1e-6)
    assert not list(box.cache.rglob("model.h5"))


@pytest.mark.slow
def test_bfgs(frame: Folder, box: Folder) -> None:
    gauss_newton = frame.result("loose-2")
    tree = identify(frame, "update.method=bfgs", job="loose-2")
    assert tree["optimiser"]["method"] == "bfgs"
    assert tree["cost"]["final"] < tree["cost"]["initial"] - 0.5
    assert tree["misfit_db"]["final"] < 1.0
    assert tree["misfit_db"]["final"] < 3 * gauss_newton["misfit_db"]["final"]
    assert {"B3", "B4"} <= {b["name"] for b in tree["bolts"] if b["verdict"] == "loose"}
    # Without errors in the FRFs log10 of the cost falls without end: the limit of iterations stops it, at the truth.
    measure(box, 10.0**MILD)
    tree = identify(box, "update.method=bfgs", "update.tolerance=1e-9", status="stopped")
    np.testing.assert_allclose(values(tree), MILD, atol=1e-3)


def test_the_limit_of_iterations_holds_where_the_weight_follows_the_noise(frame: Folder) -> None:
    for method in ("gauss-newton", "bfgs"):
        # What a single iteration leaves may not explain the measurement.
        keys = (AUTO, f"update.method={method}", "update.tolerance=1e-9", "update.largest_misfit=100")
        tree = identify(frame, *keys, "update.max_iterations=1", job="loose-all", status="stopped")
        assert tree["reason"] == "limit of 1 iterations"


def test_bfgs_is_the_descent_at_every_weight(frame: Folder, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: Any, **__: Any) -> None:
        raise AssertionError("gauss-newton")

    monkeypatch.setattr(descent, "gauss_newton", refuse)
    monkeypatch.setattr(job_module, "gauss_newton", refuse)
    tree = identify(frame, AUTO, "update.method=bfgs", job="loose-2")
    assert tree["optimiser"]["regularisation"] == pytest.approx(
        tree["noise"]["sigma_db"] ** 2 * tree["noise"]["correlation_factor"], rel=0.1
    )


# -- lines --------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("lines", "expected"),
    [
        ("all", FREQUENCY),
        ("{every: 2}", FREQUENCY[::2]),
        ("{every: 1000}", FREQUENCY[:1]),
        ("{list: [60.0, 44.0, 120.9, 333.2]}", [44.0, 60.0, 120.0, 334.0]),
        ("{list: [20.0, 400.0]}", [20.0, 400.0]),
    ],
)
def test_lines(box: Folder, lines: str, expected: list[float]) -> None:
    outcome = box.run("update", "--json", "--override", f"update.lines={lines}")
    assert outcome.code == 0
    for tree in outcome.json["results"].values():
        np.testing.assert_allclose(tree["lines"]["frequency_hz"], expected)
        assert tree["lines"]["count"] == len(expected)
        # What is reported covers all lines of the band.
        assert tree["misfit_db"]["responses"]["mic1"]["final"] is not None


def test_resonance_lines_are_those_around_the_peaks(box: Folder) -> None:
    measure(box, 10.0**MILD)
    tree = identify(box, "update.lines=resonances")
    chosen = np.array(tree["lines"]["frequency_hz"])
    assert 20 < chosen.size < FREQUENCY.size
    assert set(chosen) <= set(FREQUENCY)
    level = np.mean([20 * np.log10(np.abs(r.values)) for r in read_frf(box.data / "loose.uff").records], axis=0)
    assert FREQUENCY[np.argmax(level)] in chosen
    assert level[np.isin(FREQUENCY, chosen)].mean() > level[~np.isin(FREQUENCY, chosen)].mean()
    np.testing.assert_allclose(values(tree), MILD, atol=1e-5)


@pytest.mark.parametrize("wanted", ["[60.0, 500.0]", "[10.0]", "[60.0, 402.0]"])
def test_a_line_that_was_not_measured(box: Folder, wanted: str) -> None:
    override = ("--override", f"update.lines={{list: {wanted}}}")
    outcome = box.run("update", *override)
    assert outcome.code == 3
    for part in ("a listed frequency line was not measured", "loose.uff", "lines from 20 to 400 Hz", "Hz", "update.lines"):
        assert part in outcome.stderr
    assert box.run("check", *override).code == 3


def test_unused_responses_do_not_enter(box: Folder) -> None:
    """A response that is only reported may be wrong."""
    measure(box, 10.0**MILD)
    path = box.data / "loose.uff"
    records = list(read_frf(path).records)
    records[2] = FrfRecord(name="mic3", frequency_hz=FREQUENCY, values=3.0 * np.roll(records[2].values, 7), quantity="pressure")
    write_frf(path, FrfSet(source="loose", records=tuple(records)))
    few = "update.responses=[mic1, mic2, acc1]"
    tree = identify(box, few, "update.largest_misfit=100", says="mic3")
    assert any("over 100 times worse than the channels used (mic3)" in warning for warning in tree["warnings"])
    np.testing.assert_allclose(values(tree), MILD, atol=1e-6)
    assert tree["misfit_db"]["final"] < 1e-6
    assert tree["misfit_db"]["held_out_final"] > 3.0
    # But then the model does not explain the measurement: no verdict.
    tree = identify(box, few, status="unexplained", says="mic3")
    np.testing.assert_allclose(values(tree), MILD, atol=1e-6)
    assert {bolt["verdict"] for bolt in tree["bolts"]} == {"undecided"}


# -- groups -------------------------------------------------------------------------------------------------------------


def test_two_groups_are_the_same_as_one(box: Folder) -> None:
    low = {"select": {"component": "UZ", "nodes": [1, 2, 3]}, "initial": 4.5, "bounds": [1.0, 7.0]}
    high = {"select": {"component": "UZ", "nodes": [6, 5, 4]}, "initial": 4.5, "bounds": [1.0, 7.0]}
    groups(box, low=low, high=high)
    measure(box, 10.0 ** MILD[[0, 1, 2, 5, 4, 3]])
    tree = identify(box)
    np.testing.assert_allclose(values(tree, "low"), MILD[:3], atol=1e-6)
    np.testing.assert_allclose(values(tree, "high"), MILD[:2:-1], atol=1e-6)
    np.testing.assert_allclose([p[0] for p in tree["parameters"]["high"]["positions"]], [1.5, 1.2, 0.9])


def test_groups_of_every_kind(box: Folder) -> None:
    groups(
        box,
        springs={"select": {"component": "UZ", "nodes": [1, 2, 3]}, "initial": 4.0, "bounds": [1.0, 7.0]},
        dashpots={"kind": "damping", "select": {"component": "UZ", "nodes": [4, 5]}, "initial": 0.5, "bounds": [-2.0, 3.0]},
        masses={"kind": "mass", "select": {"component": "UZ", "nodes": [6]}, "initial": -2.5, "bounds": [-4.0, 0.0]},
    )
    truth = np.array([3.5, 4.4, 4.1, 0.9, 0.2, -1.9])
    power = np.array([0, 0, 0, 1, 1, 2])
    measure(box, 10.0**truth * S[:, None] ** power)
    tree = identify(box)
    found = np.concatenate([values(tree, name) for name in ("springs", "dashpots", "masses")])
    np.testing.assert_allclose(found, truth, atol=1e-5)
    assert [tree["parameters"][name]["unit"] for name in ("springs", "dashpots", "masses")] == ["N/m", "N s/m", "kg"]
    assert "saturation" in tree["parameters"]["springs"]
    assert "saturation" not in tree["parameters"]["masses"]


def test_damping_tied_to_the_stiffness(box: Folder) -> None:
    tree = box.tree()
    tree["parameters"]["springs"]["damping"] = {"initial": 0.0, "bounds": [-2.0, 3.0]}
    box.write(tree)
    k = 10.0 ** BOX_TRUTH["loose"]
    measure(box, k * (1 + S[:, None] * 2e-5 * 10**0.8))
    found = identify(box)["parameters"]["springs"]
    np.testing.assert_allclose(found["log10"], BOX_TRUTH["loose"], atol=1e-5)
    assert found["damping_exponent"] == pytest.approx(0.8, abs=1e-5)
    assert found["damping_factor"] == pytest.approx(10**0.8, rel=1e-4)
    assert found["damping_beta"] == 2e-5
    other = identify(box, "parameters.springs.damping.beta=1e-4")["parameters"]["springs"]
    assert other["damping_exponent"] == pytest.approx(0.8 + np.log10(0.2), abs=1e-5)


def test_smoothing(box: Folder) -> None:
    tree = box.tree()
    tree["parameters"]["springs"]["smoothing"] = [0.25, 0.5, 0.25]
    box.write(tree)
    p = np.array([4.6, 4.3, 4.2, 4.3, 4.5, 4.6])
    W = 0.5 * np.eye(6) + 0.25 * (np.eye(6, k=1) + np.eye(6, k=-1))
    measure(box, W @ 10.0**p)
    found = identify(box)["parameters"]["springs"]
    np.testing.assert_allclose(found["log10_effective"], np.log10(W @ 10.0**p), atol=1e-5)
    # A parameter that its neighbours outweigh is less certain than its effect.
    np.testing.assert_allclose(found["log10"], p, atol=1e-3)


def write_terms(folder: Folder, vectors: np.ndarray, parameter: list[str] | None = None, name: str = "terms", step: float = 0.3) -> None:
    scipy.io.mmwrite(folder.data / f"{name}.mtx", sp.coo_array(vectors), symmetry="general", precision=17)
    rows = [f"{step * k},0,0" + (f",{parameter[k]}" if parameter else "") for k in range(vectors.shape[1])]
    header = "x,y,z" + (",parameter" if parameter else "")
    (folder.data / f"{name}.csv").write_text("\n".join([header, *rows]) + "\n")


def test_terms_that_share_a_parameter(box: Folder) -> None:
    vectors = np.eye(32)[:, :6]
    write_terms(box, vectors, ["a", "b", "a", "b", "c", "c"])
    select = {"vectors": "data/terms.mtx", "positions": "data/terms.csv"}
    groups(box, springs={"select": select, "initial": 4.0, "bounds": [1.0, 7.0]})
    truth = np.array([4.3, 3.8, 4.1])
    measure(box, 10.0 ** truth[[0, 1, 0, 1, 2, 2]])
    tree = identify(box)
    np.testing.assert_allclose(values(tree), truth, atol=1e-6)
    np.testing.assert_allclose(tree["parameters"]["springs"]["positions"], [[0.3, 0, 0], [0.6, 0, 0], [1.35, 0, 0]], atol=1e-12)
    assert "6 terms, 3 parameters" in box.run("check").stdout


def test_left_and_right_vectors(box: Folder) -> None:
    """A nonreciprocal coupling: force on one mass by the motion of the next."""
    left, right = np.eye(32)[:, [0, 2, 4]], np.eye(32)[:, [1, 3, 5]]
    write_terms(box, left, step=0.6)
    write_terms(box, right, name="right")
    select = {"left": "data/terms.mtx", "right": "data/right.mtx", "positions": "data/terms.csv"}
    groups(box, links={"select": select, "initial": 3.0, "bounds": [1.0, 4.5]})
    truth = np.array([3.9, 2.8, 3.5])
    measure(box, 10.0**truth)
    assert "left and right vectors differ" in box.run("check").stdout
    np.testing.assert_allclose(values(identify(box), "links"), truth, atol=1e-5)


def test_left_and_right_files_must_fit(box: Folder) -> None:
    write_terms(box, np.eye(32)[:, :3])
    write_terms(box, np.eye(32)[:, :2], name="right")
    groups(box, links={"select": {"left": "data/terms.mtx", "right": "data/right.mtx", "positions": "data/terms.csv"}})
    result = box.run("check")
    assert result.code == 3
    for part in ("vectors and positions of links do not match", "3 terms in all files", "2 right vectors, 3 positions"):
        assert part in result.stderr
    empty = np.eye(32)[:, :3]
    empty[:, 1] = 0.0
    write_terms(box, empty)
    write_terms(box, np.eye(32)[:, :3], name="right")
    result = box.run("check")
    assert result.code == 3
    assert "vector 1 of links is empty" in result.stderr


def test_lists_of_dofs(box: Folder) -> None:
    (box.data / "list.csv").write_text("dof\n" + "\n".join(map(str, range(6))) + "\n")
    tree = box.tree()
    tree["parameters"]["springs"]["select"] = {"dofs": "data/list.csv"}
    box.write(tree)
    np.testing.assert_allclose(values(identify(box)), BOX_TRUTH["loose"], atol=1e-6)
    for text, part in (("dof\n0\n32\n", "0 to 31"), ("dof\n0\n0\n", "twice"), ("dof\n", "no lines"), ("number\n1\n", "missing")):
        (box.data / "list.csv").write_text(text)
        result = box.run("check")
        assert result.code == 3
        assert "list.csv" in result.stderr
        assert part in result.stderr


def test_a_baseline_that_the_matrix_does_not_hold(box: Folder) -> None:
    """A loss would look small, since what is identified begins above it: an all-clear that is not earned."""
    tree = box.tree()
    tree["parameters"]["springs"]["baseline"] = 3e6
    box.write(tree)
    for command in ("reduce", "update", "plan"):
        result = box.run(command)
        assert result.code == 3
        for part in ("parameters.springs.baseline", "does not contain what is subtracted", "fix:"):
            assert part in result.stderr


def test_springs_that_the_matrix_holds_leave_with_their_damping(box: Folder) -> None:
    """Proportional damping and factors of a calibration are the structure's alone: a spring that goes leaves nothing behind."""
    tree = box.tree()
    tree["model"]["damping"]["structure"]["loss_factor"] = 0.02
    box.write(tree)
    without = read_as_exported(load_campaign(box.config))
    path = box.data / "K.mtx"
    K = scipy.io.mmread(path, spmatrix=False).toarray()
    K[np.arange(6), np.arange(6)] += 3e4
    scipy.io.mmwrite(path, sp.coo_array(K), symmetry="general", precision=17)
    tree["parameters"]["springs"]["baseline"] = 3e4
    box.write(tree)
    held = read_as_exported(load_campaign(box.config))
    factors = {"stiffness.structure": 0.5, "beta.structure": 2.0, "loss_factor.structure": 3.0}
    for chosen in ({}, factors):
        one, other = (with_factors(inputs.model, inputs.recipe, chosen)[0] for inputs in (without, held))
        for name in ("K", "C", "M"):
            expected, found = (getattr(model, name).toarray() for model in (one, other))
            np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-12 * np.abs(expected).max())
    assert not held.model.terms.baseline.any()


def test_springs_stiffer_than_what_holds_them_without_are_compared(box: Folder) -> None:
    """The baseline was taken off twice, so that it seemed to be missing, and no measurement was compared, without a warning."""
    path, tree = box.data / "K.mtx", box.tree()
    K = scipy.io.mmread(path, spmatrix=False).toarray()
    size = 10.0 * float(K.max())
    K[np.arange(6), np.arange(6)] += size
    scipy.io.mmwrite(path, sp.coo_array(K), symmetry="general", precision=17)
    tree["parameters"]["springs"]["baseline"] = size
    box.write(tree)
    assert not read_as_exported(load_campaign(box.config)).held_doubt
    assert "once the warnings on model and parameters are corrected" not in box.run("check").stdout
    tree["parameters"]["springs"]["baseline"] = 3.0 * size
    box.write(tree)
    assert read_as_exported(load_campaign(box.config)).held_doubt


def test_springs_of_a_matrix_beside_a_damping_matrix_are_warned_of(box: Folder) -> None:
    """What of C is theirs is not known: a spring that loosens leaves it behind (up to 20 dB on a beam)."""
    tree = box.tree()
    tree["parameters"]["springs"]["baseline"] = 1.0
    box.write(tree)
    assert not any("this damping stays when a spring loosens" in text for text in box.inputs().warnings)
    scipy.io.mmwrite(box.data / "C.mtx", sp.coo_array(20.0 * np.eye(32)), symmetry="general", precision=17)
    tree["model"]["damping"] = "data/C.mtx"
    box.write(tree)
    assert any("this damping stays when a spring loosens" in text for text in box.inputs().warnings)


@pytest.mark.slow
def test_baseline(box: Folder) -> None:
    """A model whose matrices contain springs already is the same as one without, in value and in result."""
    before = {job: box.result(job) for job in BOX_TRUTH}
    path = box.data / "K.mtx"
    K = scipy.io.mmread(path, spmatrix=False).toarray()
    K[np.arange(6), np.arange(6)] += 3e4
    scipy.io.mmwrite(path, sp.coo_array(K), symmetry="general", precision=17)
    assert not np.allclose(values(identify(box)), BOX_TRUTH["loose"], atol=0.1)
    tree = box.tree()
    tree["parameters"]["springs"]["baseline"] = 3e4
    # Damping stays what it was: proportional to K without the springs.
    C = 200.0 * scipy.io.mmread(box.data / "M.mtx", spmatrix=False).toarray() + 2e-5 * (K - 3e4 * np.diag(np.arange(32) < 6))
    C[8:, 8:] = 60.0 * scipy.io.mmread(box.data / "M.mtx", spmatrix=False).toarray()[8:, 8:] + 1e-6 * K[8:, 8:]
    C[:8, 8:] = C[8:, :8] = 0.0
    scipy.io.mmwrite(box.data / "C.mtx", sp.coo_array(C), symmetry="general", precision=17)
    tree["model"]["damping"] = "data/C.mtx"
    box.write(tree)
    for job, truth in BOX_TRUTH.items():
        # A damping matrix may hold damping of the springs, and here does not.
        result = identify(box, job=job, says="this damping stays when a spring loosens")
        np.testing.assert_allclose(values(result), truth, atol=1e-6)
        assert [b["verdict"] for b in result["bolts"]] == [b["verdict"] for b in before[job]["bolts"]]
        np.testing.assert_allclose([b["change"] for b in result["bolts"]], [b["change"] for b in before[job]["bolts"]], atol=1e-3)


def test_auto_start_and_bounds(box: Folder) -> None:
    auto = ("parameters.springs.initial=auto", "parameters.springs.bounds=auto")
    tree = identify(box, *auto)
    np.testing.assert_allclose(values(tree), BOX_TRUTH["loose"], atol=1e-4)
    group = tree["parameters"]["springs"]
    start, (low, high) = group["initial"], group["bounds"]
    assert len(set(start)) == 1
    assert low < start[0] < high
    limits = group["saturation"]
    assert limits["free"] == pytest.approx(low)
    assert limits["clamped"] == pytest.approx(high)
    assert limits["start"] == pytest.approx(start[0])
    # They go with the scale of the exported vectors: b times 100 is k divided by 10^4.
    write_terms(box, 100.0 * np.eye(32)[:, :6])
    config = box.tree()
    config["parameters"]["springs"] = {"select": {"vectors": "data/terms.mtx", "positions": "data/terms.csv"}}
    box.write(config)
    scaled = identify(box)["parameters"]["springs"]
    np.testing.assert_allclose(np.array(scaled["bounds"]) + 4.0, group["bounds"], atol=1e-3)
    np.testing.assert_allclose(np.array(scaled["log10"]) + 4.0, BOX_TRUTH["loose"], atol=1e-4)


def test_two_excitations(box: Folder) -> None:
    tree = box.tree()
    tree["excitation"] = {"near": {"node": 8, "component": "UZ"}, "loudspeaker": {"node": 120, "component": "PRES"}}
    tree["responses"] = {
        "a": {"node": 103, "component": "PRES", "excitation": "near"},
        "b": {"node": 103, "component": "PRES", "excitation": "loudspeaker"},
        "c": {"node": 7, "component": "UZ", "quantity": "velocity", "excitation": "loudspeaker"},
        "d": {"node": 7, "component": "UZ", "excitation": "near"},
    }
    box.write(tree)
    for job, truth in BOX_TRUTH.items():
        measure(box, 10.0**truth, job)
    for job, truth in BOX_TRUTH.items():
        np.testing.assert_allclose(values(identify(box, job=job)), truth, atol=1e-6)
    assert "2 excitation(s), 4 response(s)" in box.run("check").stdout


@pytest.mark.slow
def test_quantities_of_a_measurement_are_converted(box: Folder) -> None:
    """The same motion measured as displacement, velocity or acceleration."""
    level = []
    for quantity in ("displacement", "velocity", "acceleration"):
        tree = box.tree()
        tree["responses"]["acc1"]["quantity"] = quantity
        box.write(tree)
        for job, truth in BOX_TRUTH.items():
            measure(box, 10.0**truth, job)
        np.testing.assert_allclose(values(identify(box)), BOX_TRUTH["loose"], atol=1e-6)
        level.append(read_frf(box.data / "loose.uff").records[3].values)
    np.testing.assert_allclose(level[1:], S * np.array(level[:-1]), rtol=1e-6)


@pytest.mark.slow
def test_regularisation_draws_towards_the_start(box: Folder) -> None:
    distance = []
    for eta in (0.0, 10.0, 1000.0, 1e6):
        tree = identify(box, f"update.regularisation={eta}")
        distance.append(float(np.linalg.norm(values(tree) - 4.5)))
        assert tree["optimiser"]["regularisation"] == eta
        assert tree["optimiser"]["regularisation_per_residual"] == pytest.approx(eta / (191 * 4))
    assert distance == sorted(distance, reverse=True)
    assert distance[-1] < 0.1 * distance[0]


def test_bounds_hold(box: Folder) -> None:
    tree = identify(box, "parameters.springs.bounds=[3.0, 4.55]")
    found = values(tree)
    assert found.min() == pytest.approx(3.0)
    assert found.max() <= 4.55 + 1e-12
    assert tree["parameters"]["springs"]["bounds"] == [3.0, 4.55]


def test_without_a_reference(box: Folder) -> None:
    """Bolts are then judged by contrast, and the result says so."""
    tree = identify(box, "update.reference=")
    assert {b["name"] for b in tree["bolts"] if b["verdict"] == "loose"} == {"B3", "B4"}
    assert all(b["change"] is None for b in tree["bolts"])
    assert all("no tight state" in b["note"] for b in tree["bolts"])


def test_without_bolts(box: Folder) -> None:
    tree = box.tree()
    del tree["bolts"], tree["jobs"]["loose"]["removed"]
    box.write(tree)
    assert identify(box)["bolts"] == []
    # Nothing was there to see.
    assert box.run("update", "--fail-on-loose").code == 7
    assert box.run("report", "--job", "loose").code == 0


@pytest.mark.slow
def test_what_the_approaches_draw_to(box: Folder) -> None:
    """Values along the edge are drawn to their start, changes at bolts to the reference job, whether it was just run or kept."""
    # Far from the measurement: the gate of validity is not what this is about.
    anyway = "update.largest_misfit=1000"
    start = identify(box, "update.regularisation=1e7", "parameters.springs.initial=4.0", anyway)
    assert start["method"]["approach"] == "paper"
    np.testing.assert_allclose(values(start), 4.0, atol=0.05)
    strong = (AUTO, "update.prior_std=1e-4", "parameters.springs.initial=4.0", anyway)
    tight = values(identify(box, *strong, job="tight"))
    for _ in range(2):
        loose = identify(box, *strong, says="job loose")
        assert loose["method"]["approach"] == "bolts"
        np.testing.assert_allclose(values(loose), tight, atol=0.05)
        (box.out / "loose" / "result.json").unlink()


def test_a_prior_needs_the_result_of_the_reference_job(box: Folder) -> None:
    (box.data / "tight.uff").write_bytes(b"")
    # The tight state that was identified before the file was damaged still serves ...
    result = box.run("update", "--override", AUTO)
    assert result.code == 5
    assert box.result("loose")["status"] == "converged"
    assert box.result("loose")["bolts"][0]["change"] is not None
    for file in (box.out / "tight").glob("result*.json"):
        file.unlink()
    # ... and without one it is identified from the start values, and not judged.
    result = box.run("update", "--override", AUTO)
    assert result.code == 5
    tree = box.result("loose")
    assert tree["status"] == "converged"
    assert tree["prior"]["of"] == "initial"
    assert {b["verdict"] for b in tree["bolts"]} == {"undecided"}
    assert all("no result of tight" in b["note"] for b in tree["bolts"])
    assert any("has no result" in note and "no bolt is judged" in note for note in tree["notes"])


def test_a_mixture_of_tight_and_loose_bolts(box: Folder) -> None:
    """Verdicts by the sampled changes."""
    mixture = identify(box, AUTO)
    assert mixture["prior"]["shape"] == "mixture"
    lower = identify(box, AUTO, "update.loose_change=-0.4")
    for found, threshold in ((mixture, -0.35), (lower, -0.4)):
        changes = [0.0, *(b["change"] for b in found["bolts"]), 0.0]
        for i, bolt in enumerate(found["bolts"]):
            # Beside a gap a tight bolt shows up to a share of its neighbour's change.
            assert bolt["threshold"] == pytest.approx(min(threshold, BOLT_PRIOR.leakage * min(changes[i], changes[i + 2])), abs=1e-9)
    assert min(b["threshold"] for b in mixture["bolts"]) < -0.5
    for bolt in mixture["bolts"]:
        assert 0.0 <= bolt["probability_changed"] <= 1.0
        assert (bolt["probability_changed"] > 0.9) == (bolt["verdict"] == "loose")
    assert {b["name"] for b in mixture["bolts"] if b["verdict"] == "loose"} == {"B3", "B4"}
    again = identify(box, AUTO)
    assert [b["probability_loose"] for b in again["bolts"]] == [b["probability_loose"] for b in mixture["bolts"]]


def test_values_along_the_edge_have_a_normal_prior(box: Folder) -> None:
    weighed = identify(box, "update.regularisation=10")
    assert weighed["prior"]["shape"] == "normal"
    assert {b["probability_changed"] for b in weighed["bolts"]} == {None}
    assert {b["threshold"] for b in weighed["bolts"]} == {-0.5}


def test_the_reference_job_begins_where_the_calibration_ended(box: Folder, monkeypatch: pytest.MonkeyPatch) -> None:
    """A calibration identifies the boundary beside its factors. A reference job that ends above it makes all others look wrong."""
    measure(box, 10.0**MILD, job="tight")
    study, search = lrbc_cli.load(box.config, cache=box.cache), job_module.gauss_newton_by_levels
    # A search that goes nowhere: what is left is where it begins.
    nowhere: dict[str, Any] = {"max_iterations": 0, "knots": ()}
    monkeypatch.setattr(job_module, "gauss_newton_by_levels", lambda *given, **known: search(*given, **known | nowhere))
    stay = partial(descent.descend, max_iterations=0)
    monkeypatch.setattr(job_module.Job, "descend", lambda self, misfit, start: stay(misfit, start, self.parameters.bounds))
    use = CalibrationUse(used=True, text="used", boundary={"springs": Boundary(log10=MILD)})
    found = [identification.identify(replace(study.inputs, calibration=own), study.source, "tight") for own in (None, use)]
    before, after = (one.misfit_final.mean() for one in found)
    assert after < 0.05 < 0.5 < before
    assert [start.description for start in found[1].solution.starts if start.kept] == ["the state found by the calibration"]
    # Another state is another start, and so another identification.
    parts = [identity_of(inputs, key_parts(inputs), "tight").parts for inputs in (study.inputs, replace(study.inputs, calibration=use))]
    assert {name for name in parts[0] if parts[0][name] != parts[1][name]} == {"model"}
