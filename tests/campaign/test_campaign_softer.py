"""A state in which all bolts are a little looser is neither of the two kinds between which verdicts decide: a warning says so."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest

from lrbc_cli.campaign.jobs import judging
from lrbc_cli.campaign.jobs.judging import ComparedWith, _beside_baselines, final_judgement, nearest_text, softer
from lrbc_cli.updating.judging.bolt import BoltVerdict
from lrbc_cli.updating.judging.decide import Judgement, Validity
from lrbc_cli.updating.judging.rule import LOOSE, TIGHT, DecisionRule
from lrbc_cli.updating.unknowns.springs import SpringsOf

VALID = Validity(passed=True, compared=None, misfit_db=1.0, limit_db=3.0, reason="")


RULE = DecisionRule()

NAMES = {f"{kind}{k}" for kind in "BL" for k in range(9)}


def state(*changes: float | None, loose: tuple[float, ...] = (), threshold: float = -0.35) -> Judgement:
    own = [BoltVerdict(name=f"B{k}", verdict=TIGHT, change=change, threshold=threshold) for k, change in enumerate(changes)]
    gone = [BoltVerdict(name=f"L{k}", verdict=LOOSE, change=change, threshold=threshold) for k, change in enumerate(loose)]
    return Judgement(validity=VALID, bolts=(*own, *gone), implausible=())


def test_all_bolts_softer() -> None:
    """As on a skid whose 14 joints were hand-tight: one was called loose, one tight with -0.48 decades."""
    (text,) = softer(state(-0.13, -0.2, -0.29, -0.31, -0.4, -0.1, -0.33, loose=(-0.85,)), NAMES, RULE)
    assert text.startswith(
        "all 7 joints that are not judged loose are softer than in the reference job, half of them by 0.29 decades and more"
    )
    assert "Verdicts on single joints may be wrong" in text


@pytest.mark.parametrize(
    "other",
    [
        state(-0.13, -0.2, -0.29, 0.01, -0.31, -0.4, -0.33),
        state(-0.03, -0.05, -0.02, -0.1, -0.07, -0.17, -0.3),
        state(-0.3, -0.4, -0.3, -0.4, -0.3),
        state(None, None, None, None, None, None, -0.3),
        state(-0.13, -0.2, -0.29, -0.31, -0.4, -0.1, -0.33, threshold=-1.0),
        state(loose=(-0.5, -0.6, -0.7, -0.8, -0.9, -1.0)),
    ],
    ids=["one is stiffer", "little more than scatter", "few bolts", "few with values", "a wide scatter of tight states", "all loose"],
)
def test_states_that_are_decided(other: Judgement) -> None:
    assert softer(other, NAMES, RULE) == []


def test_an_edge_is_not_asked() -> None:
    """Neighbours of a gap take part of its change, so most bolts of the SoundBox are softer beside twelve removed ones."""
    assert softer(state(-0.13, -0.2, -0.29, -0.31, -0.4, -0.1, -0.33, loose=(-0.85,)), set(), RULE) == []


def test_bolts_to_check_first_are_named_before_faults_of_the_measurement() -> None:
    """Three clean measurements of a loose joint had ended in "the fault is probably in this measurement"."""
    far = replace(state(-0.1, -1.43, 0.02), validity=replace(VALID, passed=False, nearest=("B1",)))
    assert nearest_text(far) == (
        "the nearest state has a loss at B1 (-1.43 decades): check this bolt first. A loose bolt that rattles or slips makes FRFs that no "
        "linear model explains, and beside it the model errs most. If tight, see what else may be wrong: "
    )
    two = nearest_text(replace(far, validity=replace(far.validity, nearest=("B0", "B1"))))
    # One group of springs may be lost without a loss on the whole.
    assert two.startswith("the nearest state has a loss at B0, B1 (-1.43 decades): check these bolts first.")
    assert nearest_text(replace(far, validity=VALID)) == ""


@pytest.mark.parametrize(
    ("excluded", "unclear"),
    [
        ([], ()),
        ([("rot", "rot (rotation)", "shear")], ("rot", "shear")),
        ([("rot", "shear", "rot (rotation)"), ("shear",)], ("shear",)),
        ([("rot (rotation)",)], ("rot (rotation)",)),
        ([()], ()),
    ],
)
def test_what_baselines_leave_open_too_may_be_hidden_by_errors_of_the_model(
    excluded: Sequence[tuple[str, ...]], unclear: tuple[str, ...]
) -> None:
    """Without a baseline nothing tells whether the data can exclude the loss of such springs in a tight state."""
    springs = (SpringsOf("rot"), SpringsOf("rot", "rotation"), SpringsOf("shear"))
    bolt = BoltVerdict(name="B1", verdict="tight", open_groups=("rot", "shear"), unclear=dict.fromkeys(springs, True))
    records: Any = {
        str(k): SimpleNamespace(
            explained=True, bolts=[SimpleNamespace(name="B1", excluded_groups=own), SimpleNamespace(name="B2", excluded_groups=())]
        )
        for k, own in enumerate(excluded)
    }
    assert _beside_baselines([bolt], records)[0].unclear_groups == unclear
    for record in records.values():
        record.explained = False
    assert _beside_baselines([bolt], records)[0].unclear_groups == ()


@pytest.mark.parametrize(("open_ones", "asked", "told"), [(3, 4, True), (2, 4, False), (1, 1, False), (2, 3, True), (4, 0, False)])
def test_what_a_job_leaves_open_of_most_bolts_is_unclear_even_where_each_may_be_chance(open_ones: int, asked: int, told: bool) -> None:
    """``asked``: bolts of whose springs the baseline excludes the loss; the others are open there, too."""
    rot = SpringsOf("rot")
    bolts = [BoltVerdict(name=f"B{k}", verdict="tight", unclear={rot: False} if k < open_ones else {}) for k in range(5)]
    there = [SimpleNamespace(name=f"B{k}", excluded_groups=("rot",) if k < asked else ()) for k in range(5)]
    records: Any = {"tight-2": SimpleNamespace(explained=True, bolts=there)}
    found = [bool(bolt.unclear_groups) for bolt in _beside_baselines(bolts, records)]
    assert found == [told and k < open_ones for k in range(5)]


@pytest.mark.parametrize(
    ("own", "verdict", "role", "told"),
    [
        (1.55, "tight", "job", True),
        (1.55, "undecided", "job", True),
        (1.45, "tight", "job", False),
        (1.55, "loose", "job", False),
        (1.55, "probably", "job", False),
        (1.55, "outside", "job", False),
        (1.55, "tight", "tight-2", False),
    ],
)
def test_a_job_that_fits_worse_than_every_tight_state_without_a_loose_bolt_is_not_validated(
    own: float, verdict: str, role: str, told: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Reference job 0.8 dB, baselines 1.0 dB and, not explained or without a channel, 2.0 dB; the margin is 0.5 dB."""
    records: Any = {
        f"tight-{k}": SimpleNamespace(
            explained=k != 3, bolts=[], misfit_db=SimpleNamespace(final=db), finding=SimpleNamespace(missing=("a1",) if k == 4 else ())
        )
        for k, db in ((2, 1.0), (3, 2.0), (4, 2.0))
    }
    reference: Any = SimpleNamespace(misfit_db=0.8)
    evidence: Any = SimpleNamespace(job=role, bolts=[], used_misfit_db=own)
    campaign: Any = SimpleNamespace(update=SimpleNamespace(reference="tight", baselines=("tight-2", "tight-3")))
    valid = Validity(passed=True, compared="validation channels", misfit_db=own, limit_db=2.3, reason="within")
    bolt = BoltVerdict(name="B1", verdict=verdict)
    if verdict == "probably":
        bolt = BoltVerdict(name="B1", verdict="undecided", probability_loose=0.6)
    found = Judgement(validity=valid, bolts=(bolt,), implausible=())
    monkeypatch.setattr(judging, "judge", lambda *_: found)
    monkeypatch.setattr(judging, "contradicted", lambda *_: [])
    judged = final_judgement(campaign, DecisionRule(), evidence, ComparedWith(reference, records), None)[0].validity
    assert judged.passed is (None if told else True)
    assert judged.unvalidated.startswith("the misfit of the channels used, 1.55 dB, is 0.55 dB above that of every tight state") is told
