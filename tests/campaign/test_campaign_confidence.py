"""What a campaign states of its own certainty: coverage, drift, baselines, and the gate."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from campaigns import BOX_TRUTH, Folder, box, frame, two_jobs
from linear import line_group
from scipy.stats import norm

import lrbc_cli
from lrbc_cli import Measurement
from lrbc_cli.campaign.identification import nuisances
from lrbc_cli.campaign.identification.sampling import opens_of
from lrbc_cli.campaign.reduced.stage import affine_model
from lrbc_cli.io.frf import read_frf, write_frf
from lrbc_cli.model.frf import FrfSet
from lrbc_cli.model.terms import Parameterisation
from lrbc_cli.updating.misfit.extended import ExtendedFrf
from lrbc_cli.updating.misfit.nuisances import ModelFactor, Nuisance, Shift
from lrbc_cli.updating.statistics.error_model import ERRORS
from lrbc_cli.updating.statistics.model import STATISTICS
from lrbc_cli.updating.unknowns.shapes import bolt_shapes

AUTO = "update.regularisation=auto"


class Made:
    """A campaign whose measurements are made by its own reduced model: without any error but what is asked for."""

    def __init__(self, folder: Folder, *overrides: str, **by_hand: Any) -> None:
        self.study = lrbc_cli.load(folder.config, overrides=(AUTO, *overrides), cache=folder.cache)
        self.study = self.study.with_method(**by_hand)
        self.tight, self.other = self.study.jobs[:2]
        self.hz = self.study.read(self.tight).frequency_hz
        self.parameters = self.study.parameters(self.hz)
        bolts = self.study.inputs.bolts
        assert bolts is not None
        self.shapes = bolt_shapes(self.parameters, bolts.xyz, self.study.inputs.statistics.values)
        self.rng = np.random.default_rng(0)

    def frf(self, theta: np.ndarray) -> np.ndarray:
        return self.study.frf(self.hz, theta)

    def measured(self, y: np.ndarray, noise: float = 0.03) -> Measurement:
        """FRFs with a relative error of every value."""
        error = (self.rng.normal(size=y.shape) + 1j * self.rng.normal(size=y.shape)) / np.sqrt(2.0)
        return self.study.measurement(self.hz, y * (1.0 + noise * error))


#: A tight frame where the FRFs feel the edge, and its damping exponent.
FRAME_TIGHT = np.array([*np.linspace(5.2, 5.8, 10), 1.0])


#: Measurements of a study of coverage, each with six bolts.
ROUNDS = 30


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["box", "frame"])
def test_intervals_cover_the_truth(kind: str, tmp_path: Path) -> None:
    """Changes drawn from the prior, noise in both measurements: the 95 % intervals hold the truth about that often."""
    lines = {"box": "update.lines=all", "frame": "update.lines=resonances"}[kind]
    # The model is exact: nothing that it lacks in the reference job would have to be corrected.
    # Intervals are those of the Gaussian prior, with or without a mixture sampled after it.
    made = Made({"box": box, "frame": frame}[kind](tmp_path / kind), lines, relative=False, mixture=False)
    tight = BOX_TRUTH["tight"] if kind == "box" else FRAME_TIGHT
    apart = []
    for round_ in range(ROUNDS):
        if round_ % 2 == 0:
            reference = made.study.identify(made.tight, made.measured(made.frf(tight)))
        z = made.rng.normal(size=made.shapes.std.size) * made.shapes.std
        measured = made.measured(made.frf(tight + made.shapes.T @ z))
        found = made.study.identify(made.other, measured, reference=reference).identification.posterior
        assert found is not None
        at = made.shapes.bolts
        apart.append((found.z - z)[at] / found.std[at])
    covered = float(np.mean(np.abs(apart) <= 1.96))
    assert 0.90 <= covered <= 0.995, covered


def test_intervals_against_the_profile_likelihood(tmp_path: Path) -> None:
    """The others free at every step: half the width at which the cost is 3.84 higher, against 1.96 standard deviations."""
    from scipy.optimize import brentq

    from lrbc_cli.updating.misfit.cost import Misfit
    from lrbc_cli.updating.search.descent import Level
    from lrbc_cli.updating.search.optimise import gauss_newton

    made = Made(box(tmp_path / "box"), "update.weights=none")
    tight = BOX_TRUTH["tight"]
    reference = made.study.identify(made.tight, made.measured(made.frf(tight), 0.0))
    z = np.array([0.1, -0.2, -0.6, 0.2, 0.0, 0.3])
    measured = made.measured(made.frf(tight + made.shapes.T @ z), 0.2)
    result = made.study.identify(made.other, measured, reference=reference).identification
    known = result.posterior
    assert known is not None
    used = made.study.inputs.used
    model = made.study.source.model(2j * np.pi * made.hz, made.parameters, result.selected, used)
    values = measured.values[np.ix_(result.selected, used)]
    misfit = Misfit(model, values, result.prior, result.regularisation, known.shapes.penalty())
    bounds = made.parameters.bounds

    def profile(bolt: int, value: float) -> float:
        rest = np.delete(known.shapes.T, bolt, axis=1)
        level = Level(misfit, result.prior + known.shapes.T[:, bolt] * value, rest)
        start = np.delete(known.z, bolt)
        return gauss_newton(level, start, level.bounds(bounds), tolerance=1e-8).evaluation.total

    assert known.own is not None
    for bolt in (0, 2, 4):
        std = float(np.sqrt(known.own[bolt, bolt]))
        base = profile(bolt, float(known.z[bolt]))

        def excess(step: float, bolt: int = bolt, base: float = base) -> float:
            return (profile(bolt, float(known.z[bolt]) + step) - base) / known.noise.variance - 1.96**2

        width = 0.5 * (brentq(excess, 0.2 * std, 10 * std, xtol=0.01 * std) + abs(brentq(excess, -10 * std, -0.2 * std, xtol=0.01 * std)))
        assert width == pytest.approx(1.96 * std, rel=0.25)


NUISANCES = ("update.nuisances.temperature=2.0", "update.nuisances.gain=0.3", "update.nuisances.hammer=0.01")


def drifted(made: Made, theta: np.ndarray, kelvin: float, gains: np.ndarray, offset: float) -> np.ndarray:
    """FRFs with warmer air, gains [dB] and a hammer beside its node."""
    every = np.arange(len(made.study.responses))
    nuisances: list[Nuisance] = [
        ModelFactor(name="sound_speed", std=0.1, reach=1.0),
        Shift(name="hammer", load=0, direction=0, std=0.1, reach=1.0),
    ]
    affine = affine_model(made.study.inputs, made.study.stage)
    model = ExtendedFrf(affine, 2j * np.pi * made.hz, made.parameters, nuisances, every)
    speed = 0.5 * np.log1p(kelvin / 293.15)
    return model.frf(np.concatenate([theta, [speed, offset]])) * 10.0 ** (gains / 20.0)


def plane_box(path: Path) -> Folder:
    """The box with its masses on two rows: a hammer beside its node is then defined along both axes."""
    folder = box(path)
    lines = (folder.data / "dofs.csv").read_text().splitlines()
    for i in range(8):
        dof, node, component, x, _, z = lines[1 + i].split(",")
        lines[1 + i] = ",".join([dof, node, component, x, f"{0.04 * (i % 2) * (i > 5):g}", z])
    (folder.data / "dofs.csv").write_text("\n".join(lines) + "\n")
    return folder


def test_drift_is_told_from_bolts(tmp_path: Path) -> None:
    """Two kelvin, 0.3 dB and 3 mm: found within their intervals, and no bolt called loose; ignored, they go into the bolts."""
    gains = np.array([0.3, -0.3, 0.3, -0.3])
    changes = {}
    folder, tight = plane_box(tmp_path / "box"), BOX_TRUTH["tight"]
    made = Made(folder, *NUISANCES, relative=False)
    files = made.measured(made.frf(tight), 0.005), made.measured(drifted(made, tight, 2.0, gains, 0.003), 0.005)
    for drift in (NUISANCES, ()):
        study = made.study if drift else Made(folder, relative=False).study
        reference = study.identify(made.tight, files[0])
        tree = study.identify(made.other, files[1], reference=reference).record.tree()
        changes[bool(drift)] = np.array([bolt["change"] for bolt in tree["bolts"]])
        if drift:
            found = tree["nuisances"]
            kelvin = found["temperature_kelvin"]
            assert abs(kelvin["value"] - 2.0) <= 3 * kelvin["std"]
            assert kelvin["std"] < 1.0
            for entry, gain in zip(found["gain_db"].values(), gains, strict=True):
                assert abs(entry["value"] - gain) <= 3 * entry["std"]
                assert entry["std"] <= 0.3 * 1.01
            offset = found["hammer_offset_mm"]["hammer x"]
            assert abs(offset["value"] - 3.0) <= 3 * offset["std"]
            assert not [bolt for bolt in tree["bolts"] if bolt["verdict"] == "loose"]
        else:
            assert tree["nuisances"] == {}
    assert np.abs(changes[True]).max() < 0.5 * np.abs(changes[False]).max()


def test_a_further_factor_has_its_own_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Damping of the structure beside the air: defined by one function, identified, and told as neither the other nor by its settings."""
    damping = ModelFactor(name="beta.structure", std=0.2, reach=1.2)
    monkeypatch.setattr(nuisances, "DRIFTS", (*nuisances.DRIFTS, lambda *_: (damping,)))
    made = Made(box(tmp_path / "box"), "update.nuisances.temperature=2.0", relative=False)
    reference = made.study.identify(made.tight, made.measured(made.frf(BOX_TRUTH["tight"]), 0.005))
    affine = affine_model(made.study.inputs, made.study.stage)
    model = ExtendedFrf(affine, 2j * np.pi * made.hz, made.parameters, [damping], np.arange(len(made.study.responses)))
    y = model.frf(np.append(BOX_TRUTH["tight"], np.log(1.25)))
    record = made.study.identify(made.other, made.measured(y, 0.005), reference=reference).record
    found = record.tree()["nuisances"]
    assert list(found) == ["sound_speed_percent", "temperature_kelvin", "beta_structure_percent"]
    assert abs(found["beta_structure_percent"]["value"] - 25.0) <= 3 * found["beta_structure_percent"]["std"] < 30.0
    assert abs(found["sound_speed_percent"]["value"]) <= 3 * found["sound_speed_percent"]["std"] < 1.0
    assert [(key, of) for key, of, _ in record.nuisances.entries()] == [(key, "") for key in found]


def test_gains_alone_are_part_of_the_updated_frfs(tmp_path: Path) -> None:
    """Without temperature and hammer, too: else what was found would not explain the measurement."""
    folder, gains = box(tmp_path / "box"), np.array([0.3, -0.3, 0.3, -0.3])
    made = Made(folder, "update.nuisances.gain=0.3", relative=False)
    y = made.frf(BOX_TRUTH["tight"])
    reference = made.study.identify(made.tight, made.measured(y, 0.0))
    found = made.study.identify(made.other, made.measured(y * 10.0 ** (gains / 20.0), 0.0), reference=reference)
    used = made.study.inputs.used
    level = 20.0 * np.log10(np.abs(found.identification.updated / y)).mean(axis=0)
    np.testing.assert_allclose(level[used], gains[used], atol=0.03)
    assert found.misfit_db < 0.05


@pytest.mark.parametrize("relative", [False, True])
@pytest.mark.parametrize("loose", [None, 2])
def test_a_mixture_tells_drift_from_bolts(loose: int | None, relative: bool, tmp_path: Path) -> None:
    """With the prior of tight and loose bolts too, and with what drifted and the reference state uncertain."""
    # The model is exact.
    exact = replace(STATISTICS, errors=replace(ERRORS, coarsening=1.0))
    made = Made(plane_box(tmp_path / "box"), *NUISANCES, relative=relative, statistics=exact)
    tight = BOX_TRUTH["tight"]
    reference = made.study.identify(made.tight, made.measured(made.frf(tight), 0.005))
    z = np.zeros(made.shapes.std.size)
    if loose is not None:
        z[made.shapes.bolts[loose]] = -0.8
    y = drifted(made, tight + made.shapes.T @ z, 2.0, np.array([0.3, -0.3, 0.3, -0.3]), 0.003)
    found = made.study.identify(made.other, made.measured(y, 0.005), reference=reference)
    assert [i for i, verdict in enumerate(found.verdicts.values()) if verdict == "loose"] == ([] if loose is None else [loose])
    result = found.identification
    assert result.changes is not None
    assert result.posterior is not None
    apart = (result.changes.mean - z[result.changes.bolts]) / result.changes.std
    assert np.abs(apart).max() < 3.5
    # Where the data say far more than either prior both give the same: what drifted and the reference state are marginalised alike.
    np.testing.assert_allclose(result.changes.std, result.posterior.std[result.changes.bolts], rtol=0.3)
    np.testing.assert_allclose(result.changes.mean, result.posterior.z[result.changes.bolts], atol=4e-3)


# -- baselines, the gate and plans ----------------------------------------------------------------------------------------


def noisy(folder: Folder, source: str, name: str, seed: int, level: float = 0.01) -> None:
    """The same state measured again."""
    rng = np.random.default_rng(seed)
    records = tuple(
        replace(r, values=r.values * (1 + level * rng.normal(size=r.values.size))) for r in read_frf(folder.data / source).records
    )
    write_frf(folder.data / f"{name}.uff", FrfSet(source=name, records=records))


def make_baselines(path: Path) -> Folder:
    """The box with two further measurements of its tight state."""
    folder = box(path)
    for k in (1, 2):
        noisy(folder, "tight.uff", f"again-{k}", k)
    tree = folder.tree()
    tree["jobs"] |= {f"again-{k}": {"frf": f"data/again-{k}.uff"} for k in (1, 2)}
    tree["update"] |= {"baselines": ["again-1", "again-2"], "regularisation": "auto"}
    folder.write(tree)
    return folder


@pytest.fixture(scope="module")
def judged_once(tmp_path_factory: pytest.TempPathFactory) -> Folder:
    folder = make_baselines(tmp_path_factory.mktemp("judged") / "box")
    assert folder.run("update").code == 0
    return folder


@pytest.fixture
def judged(judged_once: Folder, tmp_path: Path) -> Folder:
    """All jobs are done."""
    return judged_once.copy(tmp_path / "judged")


@pytest.mark.slow
def test_baselines(tmp_path: Path) -> None:
    folder = make_baselines(tmp_path / "box")
    first = folder.run("update", "-v")
    assert first.code == 0
    # Before the others, which they set the threshold of, although they stand last in the file.
    order = [line.split(":")[0] for line in first.stderr.splitlines() if ", misfit " in line]
    assert order == ["tight", "again-1", "again-2", "loose"]
    results = folder.results()
    for name in ("again-1", "again-2"):
        assert {b["verdict"] for b in results[name]["bolts"]} == {"tight"}
        assert all(b["probability_loose"] is None for b in results[name]["bolts"])
        assert results[name]["prior"]["scatter"] == 0.0
    changes = [b["change"] for name in ("again-1", "again-2") for b in results[name]["bolts"]]
    scatter = results["loose"]["prior"]["scatter"]
    assert scatter == pytest.approx(np.sqrt(np.mean(np.square(changes))))
    assert scatter > 0
    far = {"B1", "B6"}
    for bolt in results["loose"]["bolts"]:
        # Beside the gap, B3 and B4, it lies further down.
        assert bolt["threshold"] <= min(-0.35, -4 * scatter) + 1e-12
        assert bolt["name"] not in far or bolt["threshold"] == pytest.approx(min(-0.35, -4 * scatter))
        assert bolt["change_std"] >= scatter
    # In any order the same.
    assert folder.run("update", "--force", "--workers", "3").code == 0
    again = folder.results()
    for name in results:
        assert again[name]["bolts"] == results[name]["bolts"]
    assert folder.run("update", "--fail-on-loose").code == 6


@pytest.mark.slow
def test_a_baseline_that_is_not_tight(judged: Folder) -> None:
    """It makes the alarm deaf: said on the console, in the result and in the report; a tight one is not spoken of."""
    folder = judged
    noisy(folder, "loose.uff", "again-2", 3)
    outcome = folder.run("update")
    assert outcome.code == 0
    assert "warning: job again-2: probably not all tight (loose or probably loose against the reference job: B3" in outcome.stderr
    assert "again-1" not in outcome.stderr
    results = folder.results()
    (warning,) = results["again-2"]["warnings"]
    assert "update.baselines" in warning
    assert warning in results["again-2"]["notes"]
    assert all(results[name]["warnings"] == [] for name in ("tight", "again-1", "loose"))
    assert {b["verdict"] for b in results["again-2"]["bolts"]} == {"tight"}
    assert {b["name"] for b in results["again-2"]["bolts"] if "comes out loose" in b["note"]} >= {"B3", "B4"}
    assert results["loose"]["bolts"][2]["threshold"] < -1.0
    # Kept results are spoken of too.
    assert "warning: job again-2" in folder.run("update").stderr
    assert folder.run("report", "--job", "again-2").code == 0
    assert "again-2: probably not all tight" in (folder.out / "report.html").read_text()


@pytest.mark.slow
def test_without_the_reference(judged: Folder) -> None:
    """Its measurement is gone after its result was made; then there is none at all."""
    folder = judged
    assert folder.run("update", "--job", "loose").stderr == ""
    (folder.data / "tight.uff").unlink()
    outcome = folder.run("update", "--force")
    assert outcome.code == 5
    assert "warning: job loose: the measurement of tight is unusable" in outcome.stderr
    assert folder.run("report", "--job", "loose").code == 0
    page = (folder.out / "report.html").read_text()
    assert "loose: the measurement of tight is unusable" in page
    for name in ("result.json", "result.previous.json"):
        (folder.out / "tight" / name).unlink()
    outcome = folder.run("update", "--force")
    assert "warning: job loose: the reference job tight has no result" in outcome.stderr
    assert {b["verdict"] for b in folder.result("loose")["bolts"]} == {"undecided"}


def plans(folder: Folder, *words: str, what: str = "run") -> dict[str, Any]:
    outcome = folder.run("update", "--dry-run", "--json", *[part for word in words for part in ("--override", word)])
    assert outcome.code == 0, outcome.stderr
    return {name: job[what] for name, job in outcome.json["jobs"].items()}


def test_what_results_rest_on(judged: Folder) -> None:
    folder = judged
    assert not any(plans(folder).values())
    # Another measurement of a baseline: those that must not be a copy of it are judged anew; the reference job is compared with none.
    noisy(folder, "tight.uff", "again-1", 9)
    assert plans(folder) == {"tight": False, "again-1": True, "again-2": False, "loose": False}
    for name in ("again-2", "loose"):
        assert plans(folder, what="reason")[name] == "changed: the measurements of the baselines"
    noisy(folder, "tight.uff", "again-1", 1)
    assert all(plans(folder, "update.nuisances.gain=0.3").values())
    for words, anew in (
        ("update.confidence=0.9", {"tight", "again-1", "again-2", "loose"}),
        ("update.baselines=[again-2]", {"again-1", "again-2", "loose"}),
    ):
        assert not any(plans(folder, words).values())
        assert {name for name, judged in plans(folder, words, what="judge").items() if judged} == anew


def test_the_gate(box: Folder) -> None:
    """A response that was not used and does not fit: no verdict, whatever the others say."""
    path = box.data / "loose.uff"
    records = list(read_frf(path).records)
    records[2] = replace(records[2], values=3.0 * np.roll(records[2].values, 9))
    write_frf(path, FrfSet(source="loose", records=tuple(records)))
    words = ("--override", "update.responses=[mic1, mic2, acc1]")
    result = box.run("update", "--fail-on-loose", "--json", *words)
    assert result.code == 7
    assert result.json["findings"]["loose"] == "no verdict: the model does not explain the measurement"
    tree = result.json["results"]["loose"]
    assert tree["status"] == "unexplained"
    assert "above the limit of " in tree["reason"]
    assert tree["validity"]["passed"] is False
    assert tree["validity"]["held_out_db"] == pytest.approx(tree["misfit_db"]["held_out_final"])
    for bolt in tree["bolts"]:
        assert bolt["verdict"] == "undecided"
        assert bolt["probability_loose"] is None
        assert "does not explain" in bolt["note"]
    assert box.run("report", "--job", "loose", *words).code == 0
    # With another limit it is judged, by errors as large as that response has: nothing is certain then.
    result = box.run("update", "--fail-on-loose", "--json", *words, "--override", "update.largest_misfit=100")
    assert result.code == 7
    tree = result.json["results"]["loose"]
    assert tree["status"] == "converged"
    assert tree["noise"]["validation_ratio"] > 1e3
    assert {bolt["name"] for bolt in tree["bolts"] if bolt["probability_loose"] > 0.5} == {"B3", "B4"}


@pytest.mark.parametrize(
    ("words", "key"),
    [
        (("update.nuisances.gain=0.3", "update.reference="), "update.nuisances.gain"),
        (("update.nuisances.gain=0.3", "update.approach=paper"), "update.nuisances.gain"),
    ],
)
def test_drift_needs_a_state_to_drift_from(box: Folder, words: tuple[str, ...], key: str) -> None:
    result = box.run("check", *[part for word in words for part in ("--override", word)])
    assert result.code == 2
    assert key in result.stderr


@pytest.mark.slow
def test_drift_of_the_air_needs_air(frame: Folder) -> None:
    result = frame.run("check", "--override", "update.nuisances.temperature=2")
    assert result.code == 2
    assert "update.nuisances.temperature" in result.stderr
    assert "PRES" in result.stderr


@pytest.mark.slow
def test_the_frame_with_all_of_it(tmp_path: Path) -> None:
    """Through the command line: a baseline, drift, verdicts with probabilities, exit code 6."""
    folder = two_jobs(tmp_path / "frame")
    (folder.data / "frf" / "again.csv").write_bytes((folder.data / "frf" / "tight.csv").read_bytes())
    tree = folder.tree()
    tree["jobs"]["again"] = {"frf": "data/frf/again.csv"}
    tree["update"] |= {"baselines": ["again"], "nuisances": {"gain": 0.3, "hammer": 0.002}}
    folder.write(tree)
    result = folder.run("update", "--fail-on-loose", "--json")
    assert result.code == 6, result.stderr
    results = result.json["results"]
    assert {b["verdict"] for b in results["again"]["bolts"]} == {"tight"}
    # The same file again: nothing changed.
    assert max(abs(b["change"]) for b in results["again"]["bolts"]) < 0.1
    nuisances = results["loose-2"]["nuisances"]
    assert list(nuisances["gain_db"]) == ["acc1", "acc2", "acc3"]
    assert set(nuisances["hammer_offset_mm"]) == {"hammer x", "hammer y"}
    assert {b["name"] for b in results["loose-2"]["bolts"] if b["verdict"] == "loose"} == {"B3", "B4"}
    assert folder.run("report", "--job", "loose-2").code == 0


class Alike:
    """A cost of residuals that are all ``slope (theta - 4)`` [dB], of which a share may be predicted wrongly."""

    level = 1.0

    def __init__(self, slope: float, count: int, std: float = 1.0) -> None:
        self.model = SimpleNamespace(parameters=Parameterisation((line_group(1),)))
        self.slope, self.count, self.std, self.log_det = slope, count, std, 2.0 * count * np.log(std)

    def near(self, theta: np.ndarray) -> Alike:
        return self

    def about(self, theta: np.ndarray, error: SimpleNamespace) -> Alike:
        return Alike(self.slope, self.count, float(np.hypot(1.0, error.share * self.slope * (theta[0] - 4.0))))

    def data_sum(self, theta: np.ndarray) -> float:
        return float(self.count * (self.slope * (theta[0] - 4.0) / self.std) ** 2)


@pytest.mark.parametrize(("change", "count"), [(1.0, 1), (2.5, 1), (4.0, 1), (0.35, 30), (0.37, 30)])
@pytest.mark.parametrize("share", [0.0, 0.4, 1.0])
def test_a_value_is_open_where_the_likelihood_with_or_without_the_error_of_the_change_allows_it(
    share: float, change: float, count: int
) -> None:
    noise, solution = SimpleNamespace(variance=1.0, ratio=1.0), SimpleNamespace(theta=np.array([4.0]))
    plain = Alike(-change / 4.0, count)
    error = SimpleNamespace(share=share)
    error.near = lambda _: error
    given: Any = (SimpleNamespace(plain=plain, solution=solution, knowledge=SimpleNamespace(noise=noise)), error)
    down, _ = opens_of(cast(Any, SimpleNamespace(bolts=None)), *given)
    lost = [count * (norm.logpdf(0.0) - norm.logpdf(change, scale=scale)) for scale in (1.0, np.hypot(1.0, share * change))]
    assert bool(down[0]) == (2.0 * min(lost) < 1.96**2)
