"""Which of two tight jobs is not."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from looking import seen

from lrbc_cli.campaign.looking.causes import tables, tightness
from lrbc_cli.campaign.looking.states import Seen


def job(spread_db: float, seed: int) -> np.ndarray:
    """FRFs whose levels are apart from a model of ones by so much in the mean."""
    levels = np.random.default_rng(seed).normal(size=(400, 3))
    levels *= spread_db / np.abs(levels - np.median(levels, axis=0)).mean(axis=0)
    return np.asarray(10.0 ** (levels / 20.0) + 0j)


def campaign(*baselines: str) -> Any:
    update = SimpleNamespace(baselines=baselines, reference="tight")
    return SimpleNamespace(campaign=SimpleNamespace(update=update, calibration=None), bolts=None)


def with_bolt(tight: Seen, free: np.ndarray) -> Seen:
    """The same with a model whose bolt B8 owns one value, and FRFs without it."""
    group = SimpleNamespace(name="axial", bolt=np.zeros(1, dtype=np.int64))
    inputs = SimpleNamespace(**vars(tight.inputs) | {"bolts": SimpleNamespace(name=("B8",))})
    return replace(
        tight,
        source=SimpleNamespace(inputs=inputs, known={}),  # type: ignore[arg-type]
        parameters=SimpleNamespace(placed=[(group, slice(0, 1), None)]),
        states=np.stack([tight.states[0], free]),
        loosened=[np.zeros(0, dtype=np.int64), np.zeros(1, dtype=np.int64)],
    )


def beside(inputs: Any, name: str, measured: np.ndarray) -> Seen:
    """A job beside that model."""
    parameters, states = SimpleNamespace(placed=()), np.ones((1, 400, 3), dtype=complex)
    return seen(measured, states, job=name, inputs=inputs, parameters=parameters, loosened=[np.zeros(0, dtype=np.int64)])


def tighter(monkeypatch: pytest.MonkeyPatch, other_db: float, *baselines: str, **further_db: float) -> str:
    monkeypatch.setattr(tightness.Seen, "of", lambda _, name, whole: beside(campaign(*baselines), name, whole))
    jobs: dict[str, Any] = {"tight": job(8.3, 1), "tight-2": job(other_db, 2)}
    jobs |= {name: job(spread_db, 3 + k) for k, (name, spread_db) in enumerate(further_db.items())}
    return tightness.tighter_text(beside(campaign(*baselines), "tight", jobs["tight"]), jobs)


def test_a_baseline_that_is_nearer_to_the_tight_model_names_a_loose_bolt_in_the_reference_job(monkeypatch: pytest.MonkeyPatch) -> None:
    text = tighter(monkeypatch, 4.8, "tight-2")
    assert text.startswith("tight-2 (4.8 dB) fits the tight model far better than tight (8.3 dB)")
    assert "Probably a bolt was loose in tight, or jobs.tight.frf is the file of another state: set update.reference" in text


def test_a_baseline_is_not_exchanged_with_the_reference_job_but_a_job_that_is_as_near(monkeypatch: pytest.MonkeyPatch) -> None:
    text = tighter(monkeypatch, 4.8, "tight-2", loose=5.1, free=7.0)
    assert text.startswith("loose (5.1 dB), tight-2 (4.8 dB) fit the tight model far better than tight (8.3 dB)")
    assert "exchange jobs.tight.frf and jobs.loose.frf. If a bolt" in text
    # Without a baseline that shows it, such a job is no sign.
    assert tighter(monkeypatch, 7.0, "tight-2", loose=5.1) == ""


@pytest.mark.parametrize(("left", "other", "named"), [(6.6, 8.0, True), (6.6, 7.2, False), (7.6, 8.3, False)])
def test_a_bolt_that_stands_out_is_named_beside_a_model_with_errors(
    monkeypatch: pytest.MonkeyPatch, left: float, other: float, named: bool
) -> None:
    """Its loss explains too little to be the cause for sure, but far more than that of any other bolt."""
    freed = [tightness.Freed(["B1"], "free", other), tightness.Freed(["B2"], "at 0.06 of its stiffness", left)]
    monkeypatch.setattr(tightness, "_partly_loose", lambda _: iter([*freed, tightness.Freed(["B2"], "at 0.5 of its stiffness", 8.2)]))
    text = tighter(monkeypatch, 4.8, "tight-2", loose=5.1)
    assert "If a bolt was loose in tight, set update.reference to a tight job, such as tight-2" in text
    clause = f". With B2 at 0.06 of its stiffness the level misfit is {left:.1f} dB, with a loss of any other bolt {other:.1f} dB or more"
    assert (clause in text) is named


@pytest.mark.parametrize(("left", "exchange"), [(5.2, False), (6.0, True)])
def test_no_exchange_is_advised_where_one_bolt_explains_the_reference_job(
    monkeypatch: pytest.MonkeyPatch, left: float, exchange: bool
) -> None:
    """It would put a loosened state in place of another one."""
    monkeypatch.setattr(tightness, "_partly_loose", lambda _: ())
    monkeypatch.setattr(tightness.Seen, "of", lambda _, name, whole: beside(campaign("tight-2"), name, whole))
    jobs: dict[str, Any] = {"tight": job(8.3, 1), "tight-2": job(4.8, 2), "loose": job(5.1, 3)}
    seen = with_bolt(beside(campaign("tight-2"), "tight", jobs["tight"]), jobs["tight"] / job(left, 9))
    text = tightness.tighter_text(seen, jobs)
    assert ("exchange" in text) is exchange
    assert text.startswith("With B8 free the level misfit is 5.2 dB, instead of 8.3 dB: B8 was probably loose in tight.") is not exchange
    advice = (
        ". Set update.reference to a tight job, such as tight-2, or tighten it and measure tight again. loose (5.1 dB), tight-2 (4.8 dB)"
    )
    assert (advice in text) is not exchange


def test_a_job_that_nobody_called_tight_has_to_be_far_nearer(monkeypatch: pytest.MonkeyPatch) -> None:
    assert tighter(monkeypatch, 4.8) == ""
    assert tighter(monkeypatch, 3.5).startswith("tight-2 (3.5 dB)")


def test_two_tight_jobs_as_far_from_the_model_are_no_finding(monkeypatch: pytest.MonkeyPatch) -> None:
    assert tighter(monkeypatch, 5.9, "tight-2") == ""


def weighed(own: np.ndarray, held: np.ndarray) -> str:
    return tightness.not_tight(beside(campaign("tight-2"), "tight-2", own), held)


def test_of_two_jobs_far_apart_the_one_nearer_to_the_tight_model_is_tight() -> None:
    text = weighed(job(3.9, 3), job(6.5, 4))
    assert "Check whether a bolt was loose in tight. Correct jobs.tight.frf" in text
    text = weighed(job(3.9, 3), 1.0 / job(4.0, 3))
    assert "Check whether all bolts were tight. Remove it from update.baselines" in text


def test_a_baseline_near_the_reference_job_is_weighed_by_the_tight_model_too() -> None:
    """A loosened reference job need not lie 6 dB from a tight one."""
    text = weighed(job(2.1, 3), job(4.3, 4))
    assert "nearer to the tight model (2.1 dB) than tight is (4.3 dB). Check whether a bolt was loose in tight." in text
    assert weighed(job(2.1, 3), job(2.6, 4)) == ""


def test_a_baseline_farther_off_than_most_jobs_to_be_judged() -> None:
    """Their loose bolts change less than its own, so it is not tight; with few jobs, nothing is said."""
    held, own = job(4.4, 5), job(5.6, 7)
    near, far = held * 10.0**0.02, job(9.5, 8)
    inputs = campaign("tight-2")
    one = beside(inputs, "tight-2", own)
    text = tightness.not_tight(one, held, [near, near, far])
    assert "more than 2 of 3 jobs that are to be judged. Check whether all bolts were tight. Remove it from update.baselines" in text
    assert (
        tightness.not_tight(one, held, [near, far, far]) == tightness.not_tight(one, held, [near, near]) == tightness.not_tight(one, held)
    )


@pytest.mark.parametrize(("left", "named"), [(1.0, True), (2.0, False)])
def test_a_bolt_that_stands_out_in_a_job_near_the_reference_job(monkeypatch: pytest.MonkeyPatch, left: float, named: bool) -> None:
    """The file of a loosened state under the name of a baseline, 2.5 dB from the reference job."""
    freed = [tightness.Freed(["B1"], "free", 2.4), tightness.Freed(["B2"], "at 0.01 of its stiffness", left)]
    monkeypatch.setattr(tightness, "_partly_loose", lambda _: iter(freed))
    held = np.ones((400, 3), dtype=complex)
    text = tightness.not_tight(beside(campaign("tight-2"), "tight-2", job(2.5, 3)), held)
    assert bool(text) is named
    assert not named or "With B2 at 0.01 of its stiffness the level misfit is 1.0 dB, with a loss of any other bolt 2.4 dB or more" in text


#: Levels of three responses that one decade of each of three joints moves [dB].
WAYS = np.random.default_rng(11).normal(0.0, 12.0, (3, 400, 3))


class Springs:
    """FRFs whose levels follow the joints, three of them, and a parameter group in a table for each."""

    def __init__(self, measured: tuple[float, float, float]) -> None:
        tables = {name: SimpleNamespace(select=SimpleNamespace(bushings=SimpleNamespace(name=f"{name}.csv"))) for name in "abc"}
        groups = [SimpleNamespace(name=name, kind="stiffness", bolt=None) for name in "abc"]
        placed = [(group, slice(k, k + 1), None) for k, group in enumerate(groups)]
        parameters = SimpleNamespace(initial=np.zeros(3), bounds=np.tile([-4.0, 2.0], (3, 1)), placed=placed)
        inputs = campaign()
        inputs.bolts, inputs.campaign.parameters = SimpleNamespace(name=["B1", "B2", "B3"]), tables
        source = SimpleNamespace(inputs=inputs, known={}, model=lambda *_: self)
        none = [np.zeros(0, dtype=np.int64)]
        self.seen = seen(self.frf(np.array(measured)), self.frf(np.zeros(3))[None], source=source, parameters=parameters, loosened=none)

    def frf(self, theta: np.ndarray) -> np.ndarray:
        return np.asarray(10.0 ** (np.tensordot(theta, WAYS, axes=1) / 20.0) + 0j)

    def nearby(self, _: np.ndarray) -> Any:
        return lambda states: np.stack([self.frf(theta) for theta in states])


def test_a_joint_that_has_lost_a_part_of_its_stiffness(monkeypatch: pytest.MonkeyPatch) -> None:
    """Hand-tight, not free: each joint is tried at each level of the search."""
    monkeypatch.setattr(tightness, "joints_of", lambda *_: [{"a": np.array([k])} for k in range(3)])
    one = Springs((0.0, -1.2, 0.0)).seen
    assert tightness.looser(one, one.misfit) == (
        ". With B2 at 0.06 of its stiffness the level misfit is 0.0 dB: check whether all bolts were tight"
    )
    stiffer = Springs((0.0, 1.2, 0.0)).seen
    assert tightness.looser(stiffer, stiffer.misfit) == ""
    both = Springs((-0.7, -1.2, 0.0)).seen
    assert tightness.looser(both, both.misfit) == ""
    # A joint of two groups may have lost one of them only.
    one.source.known.clear()
    monkeypatch.setattr(tightness, "joints_of", lambda *_: [{0: np.array([0]), 1: np.array([1])}, {2: np.array([2])}, {}])
    assert "With B1 at 0.06 of its stiffness in b the level misfit is 0.0 dB" in tightness.looser(one, one.misfit)
    whole = Springs((-1.2, -1.2, 0.0)).seen
    assert "With B1 at 0.06 of its stiffness the level misfit is 0.0 dB" in tightness.looser(whole, whole.misfit)


@pytest.mark.parametrize(("power", "told"), [(3, True), (-3, True), (6, True), (1, False)])
def test_a_table_of_springs_in_another_unit(power: int, told: bool) -> None:
    """Told by the table; a digit is left to the calibration."""
    one = Springs((0.0, 0.0, float(power))).seen
    text = tables.unit_text(one, one.misfit)
    assert text.startswith(f"with all springs of c times {10.0**power:.0e} the level misfit falls from") is told
    assert text.endswith(f"multiply the column stiffness of c.csv by {10.0**power:.0e}") is told
    assert told or text == ""


def risen(*changes: tuple[float, ...], calibration: str = "tight", odd: tuple[str, ...] = (), above: Any = None) -> str:
    """Warning about the reference job by the fitted changes of three bolts in other jobs."""
    update = SimpleNamespace(reference="tight", baselines=())
    settings = SimpleNamespace(update=update, calibration=SimpleNamespace(job=calibration))
    inputs: Any = SimpleNamespace(campaign=settings, bolts=SimpleNamespace(name=["B1", "B2", "B3"]), odd_bolts=odd)
    return tightness.risen_text(inputs, {f"job-{k}": np.array(own) for k, own in enumerate(changes)}, above)


def test_a_bolt_that_is_stiffer_in_most_other_jobs_was_loose_in_the_reference_job() -> None:
    jobs = [(0.1, 0.9, np.nan), (-2.0, 1.0, np.nan), (0.2, 0.8, np.nan), (0.0, -1.3, np.nan), (0.0, 0.9, np.nan)]
    assert "with a stiffer B2 (by 0.9 decades, a factor of 7.9)" in risen(*jobs)
    assert "Set update.reference and calibration.job to a job with all bolts tight" in risen(*jobs)
    assert "Set update.reference to a job" in risen(*jobs, calibration="tight-2")
    # The table has its springs too soft, which is told already.
    assert risen(*jobs, odd=("B2",)) == ""


def test_a_bolt_that_is_stiffer_in_all_other_jobs_by_less_was_loose_in_the_reference_job() -> None:
    """A calibration from that job takes up half of the loss."""
    jobs = [(0.1, 0.68, 0.0), (0.0, 0.91, 0.3), (0.2, 0.56, 0.1), (0.0, 0.63, 0.0)]
    assert "with a stiffer B2 (by 0.7 decades, a factor of 4.5)" in risen(*jobs)
    assert risen(*jobs[:3], (0.0, 0.4, 0.0)) == ""


def test_a_bolt_that_is_stiffer_elsewhere_and_softer_than_the_others_there_was_loose() -> None:
    """A pump casing, one bolt at 3 % in the reference job: calibrated 0.6 decades below the others, and half a decade stiffer elsewhere."""
    jobs = [(0.0, 0.34, 0.38), (0.0, 0.51, 0.26), (0.1, 0.49, 0.22), (-1.3, -0.26, 0.53), (0.0, 0.48, 0.23)]
    assert "with a stiffer B2 (by 0.5 decades" in risen(*jobs, above=np.array([0.1, -0.62, -0.18]))
    assert risen(*jobs) == risen(*jobs, above=np.array([0.1, -0.38, -0.18])) == ""
    # So is one that no other job shows stiffer, by design.
    assert risen(*((0.0, 0.38, 0.0) for _ in range(5)), above=np.array([0.1, -0.62, -0.18])) == ""


def test_the_levels_of_bolts_are_compared_within_their_groups() -> None:
    def group(kind: str, bolt: list[int] | None) -> Any:
        return SimpleNamespace(kind=kind, bolt=None if bolt is None else np.array(bolt))

    parts = [
        (group("stiffness", [0, 1, 2, -1]), 0),
        (group("stiffness", [1, 2, 0]), 4),
        (group("damping", [0, 1, 2]), 7),
        (group("stiffness", None), 10),
    ]
    placed = [(one, slice(at, at + (3 if one.bolt is None else one.bolt.size)), None) for one, at in parts]
    initial = np.array([0.0, -1.0, 0.2, 9.0, 5.0, 6.0, 6.5, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0])
    parameters: Any = SimpleNamespace(placed=placed, initial=initial)
    # Medians of 0 and 6 decades.
    assert tightness.beside_others(parameters, 4) == pytest.approx([(0.0 + 0.5) / 2, (-1.0 - 1.0) / 2, (0.2 + 0.0) / 2, 0.0])


def test_bolts_that_scatter_or_few_jobs_say_nothing_of_the_reference_job() -> None:
    assert risen((0.9, 0.3, 0.0), (0.2, -2.0, 0.0), (0.3, 0.4, 0.0), (0.1, 0.2, 0.0)) == ""
    assert risen((0.0, 0.9, 0.0), (0.0, 1.0, 0.0), (0.0, 0.9, 0.0)) == ""
    assert risen((0.0, 0.9, 0.0), (0.0, 1.0, 0.0), (0.0, 0.9, 0.0), (0.0, -0.9, 0.0)) == ""
    assert risen() == ""


def test_usual_changes_explain_a_baseline() -> None:
    """A large rise is none of them: then the bolt was loose in the reference job."""
    near = np.array([1.0, 2.0, 9.0])
    assert tightness.within_scatter(near, np.array([-0.6, 0.5, np.nan]))
    assert not tightness.within_scatter(near, np.array([-0.9, 0.5, np.nan]))
    assert not tightness.within_scatter(near, np.array([0.1, 1.2, np.nan]))
    assert not tightness.within_scatter(2.0 * near, np.zeros(3))
    assert not tightness.within_scatter(near, None)


def test_a_bolt_far_looser_in_a_baseline_was_not_tight_there() -> None:
    inputs = campaign("tight-2")
    inputs.bolts = SimpleNamespace(name=["B1", "B2", "B3"])
    text = tightness.fallen_text(inputs, "tight-2", np.array([-0.7, -1.9, np.nan]))
    assert "is fitted best with a looser B2 (by 1.9 decades, a factor of 79)" in text
    assert text.endswith("Remove it from update.baselines, or measure it again")
    assert tightness.fallen_text(inputs, "tight-2", np.array([-0.7, 1.9, np.nan])) == ""


@pytest.mark.parametrize(("reset", "told"), [(1.58, False), (1.80, True)])
def test_a_calibration_that_lowers_a_bolt_to_no_purpose_tells_nothing(reset: float, told: bool) -> None:
    """1.5 dB are left; with the springs of that bolt moved as those of the others, 1.58 dB (a right bracket) or 1.8 dB."""
    group, tried = SimpleNamespace(kind="stiffness", bolt=np.array([0, 1, 2])), list[np.ndarray]()

    def at(theta: np.ndarray) -> Any:
        tried.append(theta)
        return SimpleNamespace(misfit=reset)

    def job(*initial: float) -> Any:
        parameters = SimpleNamespace(initial=np.array(initial), placed=[(group, slice(0, 3), None)])
        inputs = SimpleNamespace(bolts=SimpleNamespace(name=["B1", "B2", "B3"]))
        return SimpleNamespace(parameters=parameters, inputs=inputs, misfit=1.5, at=at)

    text = tightness.lowered_text(job(6.0, 6.0, 6.0), job(6.1, 4.8, 6.1))
    assert text.startswith("a rough calibration from this job lowers the stiffness of B2 (by 1.3 decades") is told
    assert bool(text) is told
    np.testing.assert_allclose(tried, [[6.1, 6.1, 6.1]])
