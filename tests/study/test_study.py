"""The public face: what the command line gives, from Python and without result files; and bare matrices."""

from __future__ import annotations

import doctest
import errno
import runpy
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from campaigns import Folder, box
from derivatives import check_derivative
from matplotlib.figure import Figure

import lrbc_cli
import lrbc_cli.matrices
import lrbc_cli.modelled
import lrbc_cli.study
from lrbc_cli import Study
from lrbc_cli.arrays import Floats
from lrbc_cli.campaign.jobs.standing import Outcome
from lrbc_cli.cli.main import _told
from lrbc_cli.config.settings import NuisanceConfig, UpdateConfig
from lrbc_cli.errors import ConfigError, DataError, NumericalError
from lrbc_cli.io.frf import read_frf
from lrbc_cli.method.rule import rule_of
from lrbc_cli.updating.judging.rule import DecisionRule

ROOT = Path(lrbc_cli.__file__).parents[1]
HZ = np.array([60.0, 61.5, 140.0, 320.0])


@pytest.fixture(scope="module")
def study(frame_once: Folder) -> Study:
    return lrbc_cli.load(frame_once.config, cache=frame_once.cache)


def test_every_public_name_can_be_had() -> None:
    assert {name: getattr(lrbc_cli, name) for name in lrbc_cli.__all__}.keys() == set(lrbc_cli.__all__)
    assert set(lrbc_cli.__all__) <= set(dir(lrbc_cli))
    with pytest.raises(AttributeError, match="nonsense"):
        _ = lrbc_cli.nonsense


def test_the_package_itself_loads_nothing() -> None:
    """The command line starts in a tenth of a second because names are imported when they are asked for."""
    code = "import sys, lrbc_cli; print([m for m in ('numpy', 'scipy', 'pydantic') if m in sys.modules])"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.strip() == "[]"


def test_examples_in_docstrings(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.chdir(ROOT)
    monkeypatch.setenv("LRBC_CACHE", str(tmp_path))
    for module in (lrbc_cli, lrbc_cli.study, lrbc_cli.modelled, lrbc_cli.matrices):
        found = doctest.testmod(module)
        assert found.attempted >= 3
        assert found.failed == 0


def test_a_rehearsal_from_python_is_that_of_the_command(study: Study, frame: Folder, tmp_path: Path) -> None:
    record = study.rehearse(tmp_path / "python", {"tight": (), "loose-B3": ("B3",)}, seed=7, hz=np.arange(40.0, 60.0))
    assert list(record.jobs) == ["tight", "loose-B3"]
    line = ["--loose", "B3", "--seed", "7", "--lines", "40:59:1", "--out", tmp_path / "command"]
    assert frame.run("rehearse", *line).code == 0
    for name in ("tight", "loose-B3"):
        first, second = (read_frf(tmp_path / of / "frf" / f"{name}.uff").records for of in ("python", "command"))
        for own, other in zip(first, second, strict=True):
            np.testing.assert_array_equal(own.values, other.values)
    again = lrbc_cli.load(tmp_path / "python" / "campaign.yaml", cache=tmp_path, calibration=False)
    assert again.read("loose-B3").frequency_hz.size == 20
    wrong: list[tuple[dict[str, tuple[str, ...]], str]] = [
        ({"tight": (), "l": ("B9",)}, "no such bolt"),
        ({"l": ("B3",)}, "no reference job"),
    ]
    with pytest.raises(ConfigError, match="hz cannot be used"):
        study.rehearse(tmp_path / "wrong", {"tight": ()}, hz=[60.0, 50.0])
    for jobs, text in (*wrong, ({}, "no reference job"), ({"../up": ()}, "not the name of a job")):
        with pytest.raises(ConfigError, match=text):
            study.rehearse(tmp_path / "wrong", jobs)
    assert not (tmp_path / "wrong").exists()


def test_frfs_are_those_of_simulate(study: Study, frame: Folder, tmp_path: Path) -> None:
    out = tmp_path / "y.csv"
    assert frame.run("simulate", "--lines", "60:64:2", "--set", "left_edge=5.5", "--out", out).code == 0
    table = np.genfromtxt(out, delimiter=",", names=True)
    y = study.frf([60.0, 62.0, 64.0], left_edge=5.5)
    for i, name in enumerate(study.responses):
        np.testing.assert_allclose(y[:, i], table[f"{name}_real"] + 1j * table[f"{name}_imag"], rtol=1e-6)


def test_start_values_do_not_hang_on_the_lines_asked_for(tmp_path: Path) -> None:
    """Where they are found on the FRFs, these are those of the band, as for `lrbc simulate`; full-order evaluation has the same."""
    auto = ("parameters.springs.initial=auto", "parameters.springs.bounds=auto")
    folder = box(tmp_path / "box")
    study, out = lrbc_cli.load(folder.config, overrides=auto, cache=folder.cache), tmp_path / "y.csv"
    one = study.frf([100.0])
    np.testing.assert_allclose(study.frf([100.0, 333.0])[:1], one, rtol=1e-12)
    np.testing.assert_allclose(study.sensitivities([100.0, 333.0])[0][:1], one, rtol=1e-12)
    words = [part for text in auto for part in ("--override", text)]
    assert folder.run("simulate", "--lines", "100", "--out", out, *words).code == 0
    table = np.genfromtxt(out, delimiter=",", names=True)
    np.testing.assert_allclose(one[0], [table[f"{name}_real"] + 1j * table[f"{name}_imag"] for name in study.responses], rtol=1e-6)
    full = lrbc_cli.load(folder.config, overrides=(*auto, "update.evaluation=full"), cache=folder.cache)
    np.testing.assert_allclose(full.parameters().initial, study.parameters().initial, rtol=1e-9)
    # Those of an identification are found on its lines.
    assert np.any(study.parameters(HZ).initial != study.parameters().initial)


def test_what_is_handed_out_is_shown_in_few_words(study: Study) -> None:
    """At a prompt, whatever hangs on it."""
    for shown in (
        study,
        study.reduce(),
        study.reduce().model,
        study.stage,
        study.source,
        study.model,
        study.parameters(),
        study.read("tight"),
    ):
        assert len(repr(shown)) < 1200, type(shown)


def test_sensitivities_are_the_derivatives_of_the_levels(study: Study) -> None:
    count = study.parameters().groups[0].count
    p = np.linspace(5.0, 6.0, count)
    _, J = study.sensitivities(HZ, left_edge=p)
    rng = np.random.default_rng(1)
    check_derivative(lambda p: 20 * np.log10(np.abs(study.frf(HZ, left_edge=p))), J[:, :, :count], p, rng.normal(size=count))


def test_unknowns_by_group_or_all_at_once(study: Study) -> None:
    theta = np.append(np.linspace(5.0, 6.0, 10), 1.5)
    by_group = study.frf(HZ, left_edge=theta[:10], **{"left_edge.damping": 1.5})
    np.testing.assert_array_equal(study.frf(HZ, theta), by_group)
    np.testing.assert_array_equal(study.frf(HZ, theta, left_edge=6.5), study.frf(HZ, np.append(np.full(10, 6.5), 1.5)))
    np.testing.assert_array_equal(
        study.sensitivities(HZ, theta)[0], study.sensitivities(HZ, left_edge=theta[:10], **{"left_edge.damping": 1.5})[0]
    )
    for wrong in ({"left_edge": [6.0, 6.0]}, {"left_edge.damping": [1.0, 1.0]}):
        with pytest.raises(ConfigError, match="number of values does not fit left_edge"):
            study.frf(HZ, **wrong)
    with pytest.raises(ConfigError, match="does not fit theta"):
        study.frf(HZ, theta[:-1])


def test_identifying_gives_what_update_writes(study: Study, frame_once: Folder) -> None:
    tight = study.identify("tight")
    loose = study.identify("loose-2", reference=tight)
    # Without a reference: that of the campaign, identified once.
    assert study.identify("loose-2").probability_loose == study.identify("loose-2").probability_loose == loose.probability_loose
    for found in (tight, loose):
        written = frame_once.result(found.name)
        assert found.status == written["status"]
        assert found.misfit_db == pytest.approx(written["misfit_db"]["final"], rel=1e-6)
        assert found.verdicts == {bolt["name"]: bolt["verdict"] for bolt in written["bolts"]}
    stated = {bolt["name"]: bolt["probability_loose"] for bolt in frame_once.result("loose-2")["bolts"]}
    assert loose.probability_loose == pytest.approx(stated, abs=1e-6)
    # Whoever works on what was found changes a copy.
    values = tight.record.parameters["left_edge"].log10
    with pytest.raises(ValueError, match="read-only"):
        values -= 1.0
    # Handed over as arrays: the same numbers, no file.
    measured = study.read("loose-2")
    again = study.identify("new", study.measurement(measured.frequency_hz, measured.values), reference=tight)
    assert again.verdicts == loose.verdicts
    assert [bolt.verdict for bolt in study.judge(again).bolts] == list(loose.verdicts.values())
    assert again.probability_loose == pytest.approx(loose.probability_loose, abs=1e-6)
    # A rule that nothing can meet decides nothing; the sure ones stay.
    # Another rule for one number leaves the margin above the reference job as it was.
    state = replace(tight.record.state, misfit_db=0.1, validation_db=0.1)
    told = replace(loose.identification, reference=state)
    poor = replace(loose, identification=told, evidence=replace(loose.evidence, misfit_db=2.0, used_misfit_db=3.1))
    for rule in ({}, {"confidence": 0.9}):
        assert study.judge(poor, **rule).validity.passed is False
    assert study.judge(poor, largest_misfit=3.5).validity.passed is not False
    cautious = study.judge(loose, confidence=1 - 1e-12).bolts
    assert [v.verdict for v in study.judge(loose).bolts] == list(loose.verdicts.values())
    assert sum(v.verdict == "tight" for v in cautious) < sum(v == "tight" for v in loose.verdicts.values())
    # Tight states that scatter by half a decade move the threshold to four times that.
    bolt = tight.record.bolts[0].model_copy(update={"verdict": "tight", "change": 0.5, "change_std": 0.1})
    scattered = study.judge(loose, baselines=[replace(tight, record=tight.record.model_copy(update={"bolts": (bolt,)}))]).bolts
    assert max(v.threshold for v in scattered if v.threshold is not None) == pytest.approx(-2.0)
    assert isinstance(study.plot_frf(loose, "acc1"), Figure)
    assert isinstance(study.plot_profile(loose), Figure)


def test_the_cost_alone_is_least_where_identifying_ends(study: Study) -> None:
    tight = study.identify("tight")
    found, fit = study.identify("loose-2", reference=tight), study.fit("loose-2", reference=tight)
    np.testing.assert_array_equal(fit.solution.theta, found.identification.solution.theta)
    assert fit.plain(fit.solution.theta).total < fit.plain(tight.identification.solution.theta).total


def test_calibrating_and_updating_are_those_of_the_commands(frame: Folder) -> None:
    folder, tree = frame, frame.tree()
    tree["calibration"] = {"job": "tight", "factors": ["stiffness.structure", "damping.structure"]}
    folder.write(tree)
    told: list[str] = []
    study = lrbc_cli.load(folder.config, cache=folder.cache, progress=told.append)
    record, kept = study.calibrate()
    assert not kept
    # A calibration of many joints takes minutes: each descent is told, and is a point at which it can be interrupted.
    said = [text for text in told if text.startswith("calibration from tight: fitting the factors, round 1: a descent from ")]
    assert len(said) >= len(record.stages) > 2
    assert study.inputs.calibration is not None
    assert study.inputs.calibration.factors == {name: entry.value for name, entry in record.factors.items()}
    assert not study.update(["tight"]).errors
    said = folder.run("calibrate").stdout, folder.run("update", "--job", "tight", "--json").json["kept"]
    assert "kept: nothing changed" in said[0]
    assert said[1] == ["tight"]
    study.use_calibration(False)
    assert study.inputs.calibration is not None
    assert not study.inputs.calibration.used


def test_mistakes_are_told(study: Study) -> None:
    with pytest.raises(ConfigError, match="no parameter group 'edge'"):
        study.frf(HZ, edge=3.0)
    with pytest.raises(ConfigError, match="outside its band"):
        study.frf([5000.0])
    with pytest.raises(ConfigError, match="no job 'nobody'"):
        study.identify("nobody")
    with pytest.raises(DataError, match="this is not a measurement"):
        study.measurement(HZ, np.ones((HZ.size, 1)))
    with pytest.raises(ConfigError, match="decision rule"):
        study.judge(None, prior_std=1.0)  # type: ignore[arg-type]
    with pytest.raises(ConfigError, match=r"DecisionRule\.confidence"):
        study.judge(None, confidence=2.0)  # type: ignore[arg-type]
    for name, value in {"lines": "resonance", "statistics": 7, "relative": "no", "responses": ["acc1"], "tolerance": 0.0}.items():
        with pytest.raises(ConfigError, match=rf"Method\.{name}: a value that is not allowed"):
            study.with_method(**{name: value})


def test_bare_matrices_against_a_direct_solve() -> None:
    rng = np.random.default_rng(0)
    n = 60
    K = np.diag(np.full(n, 2e6)) - 1e6 * (np.eye(n, k=1) + np.eye(n, k=-1))
    M, C, unit = np.diag(rng.uniform(0.8, 1.2, n)), 1e-5 * K, np.eye(n)
    terms = unit[:, [20, 59]]
    chain = lrbc_cli.reduce(K, M, C, loads=unit[:, :1], outputs=unit[[9, 30]], terms=terms, band_hz=(5.0, 250.0), quantity="acceleration")
    assert chain.reduction.reached
    hz, k = np.array([20.0, 83.0, 201.0]), np.array([3e5, 2e6])

    def direct(k: np.ndarray) -> np.ndarray:
        s = 2j * np.pi * hz
        return np.stack([z**2 * unit[[9, 30]] @ np.linalg.solve(z**2 * M + z * C + K + (terms * k) @ terms.T, unit[:, 0]) for z in s])

    np.testing.assert_allclose(chain.frf(hz, k), direct(k), rtol=2e-3)
    y, J = chain.sensitivities(hz, np.log10(k))
    np.testing.assert_allclose(y, chain.frf(hz, k), rtol=1e-9)
    check_derivative(lambda p: 20 * np.log10(np.abs(chain.frf(hz, 10**p))), J, np.log10(k), np.array([1.0, -0.7]))
    with pytest.raises(ConfigError, match="the argument quantity cannot be used"):
        lrbc_cli.reduce(K, M, loads=unit[:, :1], outputs=unit[[9]], terms=terms, band_hz=(5.0, 250.0), quantity="force")
    # Two loads, and terms of two kinds: the outputs say which load is theirs.
    given = {"loads": unit[:, [0, 5]], "outputs": unit[[9, 30]], "terms": terms, "band_hz": (5.0, 250.0)}
    two = lrbc_cli.reduce(K, M, C, **given, load_of=[0, 1], kind=["stiffness", "damping"])
    s, c = 2j * np.pi * 83.0, np.array([3e5, 40.0])
    Z = s**2 * M + s * C + K + (terms * (c * np.array([1.0, s]))) @ terms.T
    np.testing.assert_allclose(two.frf([83.0], c)[0], [np.linalg.solve(Z, unit[:, i])[j] for i, j in ((0, 9), (5, 30))], rtol=2e-3)
    for wrong in ({"load_of": None}, {"load_of": [0, 2]}, {"load_of": [0, 1], "kind": ["mass"]}):
        with pytest.raises(ConfigError, match=r"the argument (load_of|kind) cannot be used"):
            lrbc_cli.reduce(K, M, **given, **wrong)
    with pytest.raises(ConfigError, match="outside its band"):
        chain.frf([300.0], k)


CHAIN = np.diag(np.full(12, 2e6)) - 1e6 * (np.eye(12, k=1) + np.eye(12, k=-1))


@pytest.mark.parametrize(
    ("argument", "value"),
    [
        ("K", CHAIN[0]),
        ("K", "K.mtx"),
        ("K", CHAIN[:, :-1]),
        ("K", [[1.0, 2.0], [1.0]]),
        ("K", np.where(np.eye(12) > 0, np.nan, CHAIN)),
        ("M", np.eye(11)),
        ("C", np.eye(11)),
        ("loads", np.ones(12)),
        ("outputs", np.eye(12)[:, [9]]),
        ("terms", np.eye(12)[[3]]),
        ("band_hz", (200.0, 5.0)),
        ("band_hz", (0.0, 200.0)),
        ("band_hz", 200.0),
        ("band_hz", "5 to 200"),
        ("tolerance", 0.0),
        ("tolerance", 2.0),
        ("tolerance", np.nan),
        ("load_of", [0.5]),
        ("acoustic", [True]),
        ("quantity", "pressure"),
    ],
)
def test_arguments_of_bare_matrices_are_refused(argument: str, value: object) -> None:
    unit = np.eye(12)
    right = {"K": CHAIN, "M": unit, "loads": unit[:, :1], "outputs": unit[[9]], "terms": unit[:, [11]], "band_hz": (5.0, 200.0)}
    with pytest.raises(ConfigError, match=f"the argument {'acoustic' if argument == 'quantity' else argument} cannot be used"):
        lrbc_cli.reduce(**(right | {argument: value}))


def test_a_model_that_misses_its_tolerance_is_returned_only_where_it_is_accepted() -> None:
    unit = np.eye(12)
    right = {"loads": unit[:, :1], "outputs": unit[[9]], "terms": unit[:, [11]], "band_hz": (5.0, 200.0), "tolerance": 1e-16}
    with pytest.raises(NumericalError, match="does not reach its tolerance"):
        lrbc_cli.reduce(CHAIN, unit, **right)
    assert not lrbc_cli.reduce(CHAIN, unit, **right, accept=True).reduction.reached


def test_values_that_are_none_are_no_clamp(study: Study) -> None:
    unit = np.eye(12)
    chain = lrbc_cli.reduce(CHAIN, unit, loads=unit[:, :1], outputs=unit[[9]], terms=unit[:, [5, 11]], band_hz=(5.0, 200.0))
    for wrong in (np.nan, [np.nan, 1.0], [1.0], [[1.0, 1.0]], [[1.0], [1.0, 2.0]], [1j, 1.0], "1", None):
        with pytest.raises(ConfigError, match="the argument values"):
            chain.frf([50.0], wrong)
    for wrong in ([4.0], np.inf, [4.0, np.nan]):
        with pytest.raises(ConfigError, match="the argument log10"):
            chain.sensitivities([50.0], wrong)
    np.testing.assert_array_equal(chain.frf(50.0, 1e6), chain.frf([50.0], [1e6, 1e6]))
    for wrong in (np.nan, None):
        with pytest.raises(ConfigError, match="NaN is not a value of left_edge"):
            study.frf([100.0], left_edge=wrong)
    with pytest.raises(ConfigError, match="the argument theta"):
        study.sensitivities([100.0], left_edge=np.inf)


def test_arguments_of_a_study_are_refused(study: Study) -> None:
    values = np.ones((HZ.size, 4), dtype=complex)
    with pytest.raises(DataError, match="this is not a measurement"):
        study.measurement(-HZ[::-1], values)
    with pytest.raises(ConfigError, match="the argument hz"):
        study.measurement(np.where(HZ > 100.0, np.nan, HZ), values)
    with pytest.raises(DataError, match="this is not a measurement"):
        study.measurement([], np.ones((0, 4)))
    with pytest.raises(ConfigError, match="the argument values"):
        study.measurement(HZ, [[1.0], [1.0, 2.0]])
    with pytest.raises(DataError, match="no line lies in the band"):
        study.measurement(HZ + 1e4, values)
    for coherence in (np.full(values.shape, 2.0), np.ones(HZ.size - 1)):
        with pytest.raises(DataError, match="this is not a coherence"):
            study.measurement(HZ, values, coherence)
    beyond = study.measurement(np.append(HZ, 1e4), np.vstack([values, values[:1]]))
    assert (beyond.frequency_hz.size, beyond.left_out) == (HZ.size, (0, 1))
    for call in (
        lambda: study.identify("tight", reference="tight"),  # type: ignore[arg-type]
        lambda: study.identify("tight", values),  # type: ignore[arg-type]
        lambda: study.identify(beyond),  # type: ignore[arg-type]
        lambda: study.identify(["tight"]),  # type: ignore[arg-type]
        lambda: lrbc_cli.load(3),  # type: ignore[arg-type]
        lambda: study.with_method(line="all"),
        lambda: study.with_method(nuisances=NuisanceConfig(hammer=0.001)),
        lambda: study.with_method(nuisances=NuisanceConfig(temperature=2.0)),
        lambda: study.judge("tight"),  # type: ignore[arg-type]
        lambda: study.update("tight"),
        lambda: study.update(workers=0),
        lambda: study.plot_frf(None, "mic"),  # type: ignore[arg-type]
    ):
        with pytest.raises(ConfigError, match="the argument"):
            call()
    for name, value in {"by": "bolt", "draws": -1, "seed": 0.5, "noise_db": np.nan}.items():
        with pytest.raises(ConfigError, match=rf"Request\.{name}: a value that is not allowed"):
            study.plan(**{name: value})  # type: ignore[arg-type]


def test_every_doubt_about_a_measurement_is_told(study: Study) -> None:
    """A file that is cut, written with another sensitivity of the hammer: the second was lost."""
    tight, whole = study.identify("tight"), study.read("loose-2")
    part = whole.frequency_hz < 0.8 * whole.frequency_hz[-1]
    found = study.identify("cut", study.measurement(whole.frequency_hz[part], 1.3 * whole.values[part]), reference=tight)
    assert [doubt.kind for doubt in found.evidence.doubts] == ["incomplete", "gain"]
    validity = found.record.validity
    assert validity is not None
    assert validity.passed is None
    assert validity.unvalidated == "; ".join(doubt.text for doubt in found.evidence.doubts)


def student(dof: float) -> lrbc_cli.Loss:
    class Own(lrbc_cli.Loss):
        def rho(self, square: Floats) -> tuple[Floats, Floats]:
            return dof * np.log1p(square / dof), 1.0 / (1.0 + square / dof)

    return Own()


def test_a_loss_of_ones_own(frame: Folder) -> None:
    """Without a file of the package; its numbers and its code are part of the identity."""
    study = lrbc_cli.load(frame.config, cache=frame.cache)

    def found(loss: lrbc_cli.Loss) -> Outcome:
        residual = replace(study.inputs.method.residual, loss=loss, loss_scale=None)
        return study.with_method(output=frame.path / "mine", residual=residual).update(["tight"])

    first = found(student(4.0)).results["tight"]
    assert first.method["residual"] == {"kind": "db", "loss_scale": None, "floor": None, "loss": {"class": "student.<locals>.Own"}}
    assert first.misfit_db != study.identify("tight").record.misfit_db
    assert found(student(4.0)).kept == ["tight"]
    assert found(student(5.0)).kept == []


def test_an_experiment_does_not_replace_the_results_of_the_campaign(frame: Folder) -> None:
    """The next `lrbc update` identified all jobs anew, and the results of the campaign were gone."""
    study = lrbc_cli.load(frame.config, cache=frame.cache)
    before = frame.results()
    other = study.with_method(lines="all")
    for write in (other.update, other.calibrate, study.with_method(output="mine").with_method(lines="all").update):
        with pytest.raises(ConfigError, match="output"):
            write()
    with pytest.raises(ConfigError, match="another folder"):
        study.with_method(output=frame.out, lines="all")
    apart = study.with_method(output=frame.path / "mine", lines="all").update(["tight"])
    assert apart.results["tight"].method["lines"] == "all"
    assert (frame.path / "mine" / "tight" / "result.json").is_file()
    assert frame.results() == before
    assert study.update(["tight"]).kept == ["tight"]


@pytest.mark.slow
def test_notebooks(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """They run from the root, and find what they put in."""
    monkeypatch.chdir(ROOT)
    monkeypatch.setenv("LRBC_CACHE", str(tmp_path))
    frame = runpy.run_path("data_samples/notebooks/frame_campaign.py")
    # The data say little on the neighbours of two missing bolts.
    expected = {"tight": ("B1", "B6"), "undecided": ("B2", "B5"), "loose": ("B3", "B4")}
    assert frame["loose"].verdicts == {name: word for word, names in expected.items() for name in names}
    assert frame["found"].verdicts["B3"] == frame["found"].verdicts["B4"] == "loose"
    beam = runpy.run_path("data_samples/notebooks/bare_matrices.py")
    np.testing.assert_allclose(beam["reduced"], beam["direct"], rtol=1e-3)
    np.testing.assert_allclose(beam["fit"].x, beam["true"], atol=0.02)
    assert all(isinstance(script[name], Figure) for script, name in ((frame, "frf"), (frame, "profile"), (beam, "figure")))


def test_a_baseline_that_fails_is_left_out(frame: Folder) -> None:
    told: list[str] = []
    overrides = ["update.baselines=[again]", "jobs.again.frf=missing.uff"]
    study = lrbc_cli.load(frame.config, overrides=overrides, cache=frame.path / "cache", calibration=False, progress=told.append)
    assert study.identify("loose-2").baselines == ()
    assert any(text.startswith("baseline again is left out: ") for text in told)


@pytest.mark.slow
def test_python_judges_as_the_command_line_does(tmp_path: Path) -> None:
    """Without the campaign's baselines a half loosened bolt had p = 0.71 from Python and 0.92 from `lrbc update`."""
    overrides = [f"output={tmp_path / 'output'}", "jobs.b3-half-b4-loose.removed=[B1]"]
    study = lrbc_cli.load(ROOT / "configs" / "plate.yaml", cache=tmp_path / "cache", overrides=overrides, calibration=False)
    found = study.identify("b3-half-b4-loose")
    assert [other.name for other in found.baselines] == ["tight-2"]
    written = study.update(["b3-half-b4-loose"]).results["b3-half-b4-loose"]
    assert found.probability_loose == pytest.approx({bolt.name: bolt.probability_loose for bolt in written.bolts}, abs=1e-6)
    assert [bolt.threshold for bolt in found.record.bolts] == pytest.approx([bolt.threshold for bolt in written.bolts], abs=1e-6)
    # What contradicts the campaign file is no all-clear either.
    again = study.judge(found)
    assert [bolt.verdict for bolt in again.bolts] == [bolt.verdict for bolt in written.bolts]
    assert again.validity.passed is written.validity.passed is None
    assert "stated to be missing" in again.validity.reason
    assert again.validity.reason == written.validity.reason
    # No baselines at all is another question.
    alone = study.judge(found, baselines=())
    assert max(bolt.threshold or -9.0 for bolt in alone.bolts) < max(bolt.threshold or -9.0 for bolt in again.bolts)


def test_judging_starts_from_the_rule_of_the_study(study: Study) -> None:
    """A rule given by ``with_method`` was forgotten, and the campaign's judged: an undecided bolt came out tight."""
    strict = study.with_method(rule=replace(study.inputs.method.rule, confidence=0.999, validated_misfit=1e-3))
    found = strict.identify("tight")
    kept, own = strict.judge(found), study.judge(found)
    assert not kept.validity.passed
    assert own.validity.passed
    assert study.judge(found, validated_misfit=1e-3).validity == kept.validity
    with pytest.raises(ConfigError, match=r"DecisionRule\.joint_margin"):
        study.judge(found, joint_margin="wide")


def test_defaults_of_the_settings_are_those_of_the_rule() -> None:
    """What is not set comes from the rule, so both must agree."""
    rule, update = DecisionRule(), UpdateConfig()
    assert (update.confidence, update.largest_misfit, update.loose_change) == (rule.confidence, rule.largest_misfit, None)
    assert rule_of(update) == rule


def test_a_calibration_of_another_method_is_another_one(study: Study) -> None:
    """One that was fitted with other lines and residuals was kept as that of the campaign."""
    from lrbc_cli.campaign.calibration import key_parts

    own = key_parts(study.inputs)
    for change in ({"lines": "all"}, {"residual": replace(study.inputs.method.residual, loss_scale=3.0)}):
        other = key_parts(study.with_method(**change).inputs)
        assert [name for name in own if own[name] != other[name]] == ["settings"]


@pytest.mark.skipif(sys.platform == "win32", reason="a file that is read cannot be replaced")
def test_a_file_that_changes_during_the_run_gives_no_result(tmp_path: Path) -> None:
    """Replaced after the identity was taken, and put back: the verdicts of the other content were kept as those of this one."""
    folder = box(tmp_path / "box")
    right, other = (folder.data / f"{name}.uff" for name in ("loose", "tight"))
    content = right.read_bytes()

    def swap(text: str) -> None:
        if text.startswith("loose: identifying"):
            right.write_bytes(other.read_bytes())

    outcome = lrbc_cli.load(folder.config, cache=folder.cache, progress=swap).update()
    assert outcome.failed == ["loose"]
    assert "the file changed during the run" in outcome.errors["loose"].message
    right.write_bytes(content)
    again = lrbc_cli.load(folder.config, cache=folder.cache).update()
    assert again.failed == []
    assert again.results["loose"].names("loose") == ["B3", "B4"]


def test_the_code_of_an_own_prior_is_part_of_the_identity(study: Study) -> None:
    """Only its name was: results of an earlier body of the same class were kept."""

    def own(factor: float, times: float = 1.0) -> str:
        body = f"def tables(self, *given, times={times}):\n        return [t * {factor} for t in super().tables(*given)]"
        space: dict[str, object] = {"Base": type(model.bolts), "__name__": "notebook"}
        exec(f"class Mine(Base):\n    {body}", space)
        return replace(model, bolts=space["Mine"]()).digest("bolts")  # type: ignore[operator]

    model = study.inputs.statistics
    assert own(2.0) == own(2.0)
    assert len({own(2.0), own(3.0), own(2.0, 2.0), model.digest("bolts")}) == 4


def test_a_job_whose_folder_cannot_be_written_does_not_stop_the_others(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its failure could not be noted either, which ended the command with an internal error."""
    from lrbc_cli.campaign.jobs import run

    def write_result(output: Path, finished: Any, original: Any = run.write_result) -> Any:
        if finished.record.job == "tight":
            raise PermissionError(errno.EACCES, "Permission denied", str(output / "tight"))
        return original(output, finished)

    def write_failure(output: Path, *_: Any) -> None:
        raise PermissionError(errno.EACCES, "Permission denied", str(output / "tight" / "result.json"))

    monkeypatch.setattr(run, "write_result", write_result)
    monkeypatch.setattr(run, "write_failure", write_failure)
    folder = box(tmp_path / "box")
    outcome = lrbc_cli.load(folder.config, cache=folder.cache).update()
    assert (outcome.failed, list(outcome.results)) == (["tight"], ["loose"])


def test_a_path_without_permission_is_no_defect_of_the_program() -> None:
    message, code = _told(PermissionError(errno.EACCES, "Permission denied", "out/tight/result.json"))
    assert code == 2
    assert message.startswith("out/tight/result.json: this path cannot be used (Permission denied)")
