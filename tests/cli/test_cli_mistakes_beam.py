"""Mistakes on a beam, where a model has few resonances: each is found by check, with a message that names the fix."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import beam
import numpy as np
import pytest
import scipy.io
from campaigns import lrbc

import lrbc_cli
from lrbc_cli.campaign.looking import first_look, fitted, trials
from lrbc_cli.campaign.looking.causes import rescaled
from lrbc_cli.campaign.looking.causes.tables import of_other_unit_text

Damage = Callable[[Path], object]


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The reduced model of the beam as it should be is in it."""
    folder = tmp_path_factory.mktemp("beam")
    done = lrbc("reduce", beam.make(folder), "--cache", folder / "cache")
    assert done.code == 0, done.stderr
    return folder / "cache"


def frfs(damage: beam.Change, *jobs: str) -> Damage:
    return lambda folder: [beam.change(folder / f"{job}.csv", damage) for job in jobs or beam.STATES]


def text(name: str, old: str, new: str) -> Damage:
    def damage(folder: Path) -> None:
        before = (folder / name).read_text(encoding="utf-8")
        assert old in before
        (folder / name).write_text(before.replace(old, new), encoding="utf-8")

    return damage


def times(name: str, factor: float) -> Damage:
    def damage(folder: Path) -> None:
        matrix = scipy.io.mmread(folder / name, spmatrix=False)
        scipy.io.mmwrite(folder / name, factor * matrix, symmetry="symmetric", precision=17)

    return damage


def left_in(folder: Path) -> None:
    """A node between two bolts clamped by penalties."""
    K = scipy.io.mmread(folder / "K.mtx", spmatrix=False).tolil()
    K[68, 68] += 1e10
    K[69, 69] += 1e8
    scipy.io.mmwrite(folder / "K.mtx", K.tocoo(), symmetry="symmetric", precision=17)


def mass_of_other_numbers(folder: Path) -> None:
    M = scipy.io.mmread(folder / "M.mtx", spmatrix=False).tocsc()
    node = np.random.default_rng(0).permutation(M.shape[0] // 2)
    at = (2 * node[:, None] + [0, 1]).ravel()
    scipy.io.mmwrite(folder / "M.mtx", M[at][:, at].tocoo(), symmetry="symmetric", precision=17)


def diagonal_twice(folder: Path) -> None:
    upper = np.triu(scipy.io.mmread(folder / "K.mtx", spmatrix=False).toarray())
    scipy.io.mmwrite(folder / "K.mtx", scipy.sparse.coo_array(upper + upper.T), symmetry="symmetric", precision=17)


def elsewhere(folder: Path) -> None:
    beam.write_frf(folder / "loose.csv", beam.HZ, beam.measured(beam.STATES["loose"], hammer=0.22, seed=1))


def noisy(hz: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    noise = np.random.default_rng(2).normal(size=(2, *y.shape))
    return hz, y * (1.0 + 0.14 * (noise[0] + 1j * noise[1]))


def without_signal(hz: np.ndarray, y: np.ndarray, level: float = 0.1) -> tuple[np.ndarray, np.ndarray]:
    """Noise in place of what a3 measures."""
    noise = np.random.default_rng(3).normal(size=(2, hz.size))
    return hz, np.where(np.arange(y.shape[1]) == 2, level * np.median(np.abs(y)) * (noise[0] + 1j * noise[1])[:, None], y)


def soft_tip(hz: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Nothing but noise in the upper half of the band."""
    noise = np.random.default_rng(4).normal(size=(2, *y.shape))
    return hz, y * (1.0 + 3.0 * (noise[0] + 1j * noise[1]) * (hz > np.median(hz))[:, None])


def fixed_bolts(folder: Path) -> None:
    """The nodes of the bolts are held by far more than their springs."""
    K = scipy.io.mmread(folder / "K.mtx", spmatrix=False).tolil()
    for x in beam.BOLTS:
        at = 2 * round(x / beam.LENGTH * 90)
        K[at, at] += 1e10
    scipy.io.mmwrite(folder / "K.mtx", K.tocoo(), symmetry="symmetric", precision=17)


MISTAKES = {
    "bolts beside nodes that are fixed in the matrices": (
        fixed_bolts,
        0,
        "job ref: the springs of parameters.bolts have no effect: without them the computed FRFs change by less than 0.1 dB",
        "(a tie, a contact, merged or fixed nodes). Remove it in the FE model",
    ),
    "a channel without signal in one job": (
        frfs(without_signal, "loose"),
        0,
        "job loose: probably noise of a3: ",
        "most of them there; check the channel, and measure it again",
    ),
    "a channel that is off in all jobs": (
        frfs(partial(without_signal, level=1e-3)),
        0,
        "job ref: a3: no signal: 5",
        "Check the sensor, its cable and its supply, and measure again, or remove it from the campaign file",
    ),
    "no force in the upper half of the band in one job": (
        frfs(soft_tip, "loose"),
        0,
        "of the size of each line from 470 Hz (median), 1.1% in ref, and no such noise elsewhere",
        "Check whether the tip of the hammer was too soft. Measure it again, or let reduction.band end there",
    ),
    "no force in the upper half of the band": (
        frfs(soft_tip),
        0,
        "jobs ref, loose: probably noise",
        "measure with more averages, a harder tip or a stronger blow, or expect wide intervals",
    ),
    "weights for masses": (times("M.mtx", 9.80665), 0, "the mass matrix is 9.807 times too large (a weight density", "scale: 0.101972"),
    "one sensitivity ten times off": (
        frfs(lambda hz, y: (hz, y * [1, 1, 10, 1, 1])),
        0,
        "a3: measured over computed +20.00 dB",
        "probable cause: a sensitivity or a range ten times off. Write jobs.ref.scale: {a3: 0.1}; also found in loose",
    ),
    "hammer against its direction": (
        frfs(lambda hz, y: (hz, -y)),
        0,
        "probably reversed sign: all responses: measured phases are 180 degrees from the model's",
        "the direction of the hammer or of all sensors. Write excitation.hammer.scale: -1",
    ),
    "the other sign of time": (
        frfs(lambda hz, y: (hz, y.conj())),
        0,
        "phases probably of opposite sign: all responses (a1, a2, a3, a4, a5)",
        "Conjugate the FRF file: imaginary parts, or phases, times -1",
    ),
    "a sensor upside down": (
        frfs(lambda hz, y: (hz, y * [1, 1, -1, 1, 1])),
        0,
        "probably reversed sign: a3: measured phases are 180 degrees from the model's",
        "the direction of the sensor. Write responses.a3.scale: -1",
    ),
    "a sensitivity ten times off in the reference job": (
        frfs(lambda hz, y: (hz, y * [1, 1, 10, 1, 1]), "ref"),
        0,
        "job ref: probably a wrong sensitivity: a3: measured over computed +19.97 dB",
        "probable cause: a sensitivity or a range ten times off. Write jobs.ref.scale: {a3: 0.1}\n",
    ),
    "a sensor turned over after the reference job": (
        frfs(lambda hz, y: (hz, y * [1, 1, -1, 1, 1]), "loose"),
        0,
        "job loose: probably reversed sign: a3: measured phases are 180 degrees from the model's. "
        "Possible cause: the direction of the sensor",
        "jobs.loose.scale: {a3: -1}",
    ),
    "pounds of force": (
        frfs(lambda hz, y: (hz, 4.4482216 * y)),
        0,
        "all responses (a1, a2, a3, a4, a5): measured over computed +12.9",
        "probable cause: FRFs per lbf. Write jobs.ref.format.unit: m/s2/lbf, or jobs.ref.scale: 0.224809; also found in loose",
    ),
    "sensors counted from the other end": (
        lambda folder: [
            text("campaign.yaml", f"near: [{x:g}, 0, 0]", f"near: [{beam.LENGTH - x:.6g}, 0, 0]")(folder) for x in beam.SENSORS.values()
        ],
        0,
        "job ref: all sensors are probably stated with x counted from the other side",
        "Correct the places of these points: responses.a1: near: [0.1, 0, 0] and so on",
    ),
    "hammer elsewhere in one job": (
        elsewhere,
        0,
        "job loose: the hammer probably hit elsewhere than at excitation.hammer: at or near node 23, 0.08 m away",
        "Measure it again at the point of the reference job",
    ),
    "place of the hammer": (
        text("campaign.yaml", "near: [0.14, 0, 0]", "near: [0.41, 0, 0]"),
        0,
        "the hammer probably hit elsewhere than at excitation.hammer: at or near node 15, 0.27 m away",
        "Correct excitation.hammer: near: [0.14, 0, 0], component: UZ",
    ),
    "place of a sensor": (
        text("campaign.yaml", "a3: {near: [0.55, 0, 0]", "a3: {near: [0.05, 0, 0]"),
        0,
        "a3 differs from the model by 9.9 dB",
        "at or near node 56, 0.5 m away, it would differ by 0.9 dB (near: [0.55, 0, 0], component: UZ)",
    ),
    "boundary condition left in": (
        left_in,
        0,
        "the stiffness matrix holds 1 node to the ground in addition to the terms (35; UZ, ROTY)",
        "Remove it in the FE model, export the matrices again",
    ),
    "mass of another numbering": (
        mass_of_other_numbers,
        0,
        "model.mass: the mass matrix connects nodes that the stiffness matrix does not",
        "in one run, with one numbering",
    ),
    "diagonal counts twice": (
        diagonal_twice,
        3,
        "the diagonal of the stiffness matrix probably counts twice",
        "subtract the diagonal once",
    ),
    "lines missing": (
        frfs(lambda hz, y: (np.delete(hz, np.s_[300:360]), np.delete(y, np.s_[300:360], axis=0)), "loose"),
        0,
        "job loose: its frequency lines differ from those of ref",
        "Its lines from 340 to 399 Hz (60) are missing. Measure or export it on the lines of ref",
    ),
    "few averages": (frfs(noisy, "loose"), 0, "job loose: noise of 20% of the size of each line", "with more averages"),
    "no phases": (frfs(lambda hz, y: (hz, np.abs(y))), 0, "ref.csv, loose.csv: no phases", "or magnitudes with phases"),
    "real and imaginary part exchanged": (
        frfs(lambda hz, y: (hz, y.imag + 1j * y.real)),
        0,
        "job ref: real and imaginary parts are probably exchanged",
        "Exchange the two columns of each FRF in the file",
    ),
    "phases of a sine": (frfs(lambda hz, y: (hz, 1j * y)), 0, "all phases are probably 90 degrees from the model's", "Export the FRFs"),
    "a start frequency of 0 in all files": (
        frfs(lambda hz, y: (hz - 20.0, y)),
        0,
        "job ref: all measured resonances are probably 19 Hz below those of the model",
        "Check the start frequency in the headers of the files",
    ),
    "a band that was not measured": (
        text("campaign.yaml", "band: [40.0, 900.0]", "band: [0.5, 9000.0]"),
        0,
        "of the band from 0.5 to 9000 Hz",
        "or end the band of all jobs there: reduction.band: [",
    ),
    "no validation channel": (
        text("campaign.yaml", "responses: [a1, a2, a3, a4]", "responses: [a1, a2, a3, a4, a5]"),
        0,
        "update.responses: it lists all responses, and none is left to test the result",
        "Leave one out: update.responses: [a1, a2, a3, a4]",
    ),
}


#: Of those of a kind, these take longest.
DEAR = {"no force in the upper half of the band", "no force in the upper half of the band in one job", "weights for masses"}


@pytest.mark.parametrize("what", [pytest.param(what, marks=[pytest.mark.slow] if what in DEAR else []) for what in MISTAKES])
def test_a_mistake_on_a_beam_is_found_and_its_fix_named(tmp_path: Path, cache: Path, what: str) -> None:
    damage, code, says, fix = MISTAKES[what]
    file = beam.make(tmp_path)
    damage(tmp_path)
    done = lrbc("check", file, "--cache", cache)
    assert done.code == code, done.stderr
    told = done.stderr if code else done.stdout.partition("\nwarnings\n")[2]
    assert says in told
    assert fix in told


def test_nothing_is_wrong_with_the_beam(tmp_path: Path, cache: Path) -> None:
    told = lrbc("check", beam.make(tmp_path), "--cache", cache).stdout.partition("\nwarnings\n")[2]
    # Half a per cent of damping at lines of 1 Hz: so it is.
    assert [line for line in told.splitlines() if line.strip() and "lines too far apart" not in line] == []


def soft(folder: Path, levels: tuple[float, ...] = (0.3, 3.0, 0.4, 2.5, 0.5)) -> Path:
    """A model 6 % too soft with springs of about half the stiffness, none like another, and a block to calibrate it."""
    file = beam.make(folder)
    times("K.mtx", 0.94)(folder)
    head, *rows = (folder / "bushings.csv").read_text(encoding="utf-8").splitlines()
    own = [f"{row.rpartition(',')[0]},{level * beam.SPRING:g}" for row, level in zip(rows, levels, strict=True)]
    (folder / "bushings.csv").write_text("\n".join([head, *own]) + "\n", encoding="utf-8")
    block = "calibration: {job: ref, factors: [stiffness.structure, alpha.structure, beta.structure]}\n"
    file.write_text(file.read_text(encoding="utf-8") + block, encoding="utf-8")
    return file


def test_a_model_that_is_not_calibrated_is_compared_after_a_rough_calibration(tmp_path: Path, cache: Path) -> None:
    file = soft(tmp_path)
    before = sorted(tmp_path.rglob("*"))
    right = lrbc("check", file, "--cache", cache).stdout
    assert "compared with a rough calibration from ref, not stored (stiffness.structure 1.0" in right
    assert "differs from the model" not in right
    assert "little in common" not in right
    assert sorted(tmp_path.rglob("*")) == before
    text("campaign.yaml", "near: [0.78, 0, 0]", "near: [0.18, 0, 0]")(tmp_path)
    wrong = lrbc("check", file, "--cache", cache).stdout
    assert "job ref: a4 differs from the model by" in wrong
    assert "it would differ by 0.1 dB (near: [0.78, 0, 0], component: UZ)" in wrong


def test_a_sensor_ten_times_off_shows_before_any_calibration(tmp_path: Path, cache: Path) -> None:
    """Its level outweighs the resonances in a descent from afar: nothing but a model with little in common was told."""
    file = soft(tmp_path)
    frfs(lambda hz, y: (hz, y * np.where(np.arange(y.shape[1]) == 2, 10.0, 1.0)))(tmp_path)
    told = lrbc("check", file, "--cache", cache).stdout
    assert "little in common" not in told
    assert "job ref: probably a wrong sensitivity: a3: measured over computed" in told
    assert "jobs.ref.scale: {a3: 0.1}; also found in loose" in told


def warned(file: Path, cache: Path) -> str:
    told = lrbc("check", file, "--cache", cache).stdout.partition("\nwarnings\n")[2]
    return "".join(
        line
        for line in told.splitlines(keepends=True)
        if not any(text in line for text in ("lines too far apart", "no job will be validated"))
    )


def test_a_stored_calibration_is_compared_with_its_springs(tmp_path: Path, cache: Path) -> None:
    """Its factors hold with the springs that were found beside them, and not with those of the table."""
    file = soft(tmp_path, (0.06, 5.0, 0.05, 0.08, 4.0))
    coarse = "calibration: unless the identification of ref leaves less, no job will be validated, so none is an all-clear: a change from"
    calibrated = lrbc("calibrate", file, "--cache", cache)
    assert calibrated.code == 0
    assert f"note: {coarse} the reference job (misfit 2.27 dB)" in calibrated.stdout
    assert coarse in lrbc("check", file, "--cache", cache).stdout
    assert warned(file, cache).strip() == ""
    inputs, s = lrbc_cli.load(file, cache=cache).inputs, 2j * np.pi * beam.HZ
    assert inputs.calibration is not None
    source = first_look._source(inputs, cache, print)
    assert source is not None
    np.testing.assert_allclose(source.parameters(s).initial[:-1], inputs.calibration.boundary["bolts"].log10)
    exported = fitted.as_exported(source)
    assert exported is not None
    assert not exported.parameters(s).initial[:-1].any()
    shutil.rmtree(inputs.campaign.output)
    plain = lrbc_cli.load(file, cache=cache).inputs.model.K
    assert abs(inputs.model.K - plain).max() > 0.03 * abs(plain).max()
    assert abs(exported.inputs.model.K - plain).max() < 1e-12 * abs(plain).max()


@pytest.mark.slow
def test_a_stored_calibration_hides_no_mistake(tmp_path: Path, cache: Path) -> None:
    """Its factors make up for a matrix that is three times too stiff."""
    file = beam.make(tmp_path)
    times("K.mtx", 3.0)(tmp_path)
    block = "calibration: {job: ref, factors: [stiffness.structure, mass.structure, alpha.structure, beta.structure]}\n"
    file.write_text(file.read_text(encoding="utf-8") + block, encoding="utf-8")
    before = warned(file, cache)
    assert "stiffness.structure 0.34" in before
    assert lrbc("calibrate", file, "--cache", cache).code == 0
    assert "stiffness.structure 0.34" in warned(file, cache)


@pytest.mark.slow
def test_a_reference_job_that_no_calibration_explains_is_none_to_calibrate_from(tmp_path: Path, cache: Path) -> None:
    file = soft(tmp_path)
    beam.write_frf(tmp_path / "ref.csv", beam.HZ, beam.measured((1.0, 1e-3, 1e-3, 1e-3, 1.0), seed=1))
    told = lrbc("check", file, "--cache", cache).stdout
    assert "rough calibration" not in told
    assert "job ref: measured and computed FRFs have little in common" in told


def test_a_bolt_that_was_loose_in_the_reference_job_shows_after_a_rough_calibration(tmp_path: Path, cache: Path) -> None:
    file = soft(tmp_path)
    beam.write_frf(tmp_path / "ref.csv", beam.HZ, beam.measured((1.0, 0.06, 0.9, 1.05, 0.95), seed=1))
    told = lrbc("check", file, "--cache", cache).stdout
    assert "job ref: a rough calibration from this job lowers the stiffness of B2 (" in told
    assert "set update.reference and calibration.job to a tight job" in told


@pytest.mark.parametrize(
    ("stiffness", "mass", "told"),
    [
        (0.7**3, 0.7, "The thickness of plates, or the height of beams, is probably 1.4 times too small in the model: with its stiffness"),
        (2.9, 2.9, "Stiffness and mass of the model are probably both about 2.9 times too large"),
        # Of one matrix it is that one.
        pytest.param(2.2, 1.0, "the stiffness matrix is 2.2 times too large", marks=pytest.mark.slow),
    ],
)
def test_stiffness_and_mass_that_are_wrong_together(tmp_path: Path, stiffness: float, mass: float, told: str) -> None:
    file = beam.make(tmp_path)
    times("K.mtx", stiffness)(tmp_path)
    times("M.mtx", mass)(tmp_path)
    # Springs are not known well either.
    text("bushings.csv", f"{beam.SPRING:g}", f"{0.8 * beam.SPRING:g}")(tmp_path)
    block = "calibration: {job: ref, factors: [stiffness.structure, mass.structure, alpha.structure, beta.structure]}\n"
    file.write_text(file.read_text(encoding="utf-8") + block, encoding="utf-8")
    warnings = lrbc("check", file).stdout.partition("\nwarnings\n")[2]
    assert told in warnings
    assert ("height of beams" in warnings) == ("height of beams" in told)


def test_springs_in_another_unit_show_after_a_rough_calibration() -> None:
    """All springs of a table a thousand times lower, within the scatter of joints; no table, or a few springs alone, is none of it."""

    def seen(*initial: float, table: Path | None = Path("bending.csv")) -> Any:
        select = SimpleNamespace(select=SimpleNamespace(bushings=table))
        group = SimpleNamespace(name="bending")
        bounds = np.tile([-4.0, 1.5], (len(initial), 1))
        parameters = SimpleNamespace(initial=np.array(initial), bounds=bounds, placed=[(group, slice(0, len(initial)), None)])
        campaign = SimpleNamespace(parameters={"bending": select})
        return SimpleNamespace(parameters=parameters, inputs=SimpleNamespace(campaign=campaign))

    low = seen(-3.1, -2.9, -3.3, -2.8, -3.0)
    told = of_other_unit_text(seen(*[0.0] * 5), low)
    assert "multiplies all springs of bending by about 1e-03" in told
    assert "multiply the column stiffness of bending.csv by 1e-03" in told
    # At their bound the springs say no power of ten.
    told = of_other_unit_text(seen(*[0.0] * 5), seen(1.49, 1.5, 1.45, 1.2, 1.1))
    assert "multiplies all springs of bending by 28, to their bounds" in told
    assert "multiply the column stiffness of bending.csv by 1e+03" in told
    assert of_other_unit_text(seen(*[0.0] * 5), seen(1.49, 1.5, 1.2, 1.2, 1.1)) == ""
    told = of_other_unit_text(seen(*[0.0] * 5), seen(*[-4.0] * 5))
    assert "multiply the column stiffness of bending.csv by 1e-04" in told
    assert of_other_unit_text(seen(*[0.0] * 5, table=None), low) == ""
    assert of_other_unit_text(seen(*[0.0] * 5), seen(-3.0, 0.1, -0.2, 0.0, -2.9)) == ""
    assert of_other_unit_text(seen(*[0.0] * 5), seen(-3.0, -5.0, -1.0, -2.0, -4.5)) == ""


def test_what_would_take_long_is_not_looked_for(tmp_path: Path, cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(trials, "MOST_WORK", 0.0)
    for damage in (elsewhere, left_in):
        file = beam.make(tmp_path)
        damage(tmp_path)
        told = lrbc("check", file, "--cache", cache).stdout
        assert "elsewhere" not in told
        assert "to the ground in addition to the terms" not in told


def test_levels_that_agree_are_evidence_of_a_factor_of_their_own() -> None:
    assert rescaled.explains(3.0, 2.0, 10.0, 1.0)
    assert not rescaled.explains(5.3, 0.1, 10.0, 1.0)
    assert rescaled.explains(5.3, 0.1, 10.0, 1.5)
    # Levels somewhere, or little gained.
    assert not rescaled.explains(5.3, 0.9, 10.0, 1.5)
    assert not rescaled.explains(5.3, 0.1, 6.0, 1.5)
