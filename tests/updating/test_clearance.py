"""What counts as an all-clear: every way in which it is not earned, and the sentence that says so."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest

from lrbc_cli.cli.update import tell_clearance
from lrbc_cli.updating.judging.clearance import (
    BoltFinding,
    JobFinding,
    across,
    loose_there,
    not_clear,
    once_more,
    open_groups,
    open_points,
    sentence,
)


def job(verdicts: str, status: str = "converged", **more: object) -> JobFinding:
    """One letter a bolt: tight, loose, undecided, probably loose (undecided), outside."""
    words = {"t": ("tight", 0.002), "l": ("loose", 0.99), "u": ("undecided", 0.3), "p": ("undecided", 0.7), "o": ("outside", None)}
    bolts = tuple(
        BoltFinding(name=f"B{i}", verdict=words[letter][0], probability=words[letter][1]) for i, letter in enumerate(verdicts, start=1)
    )
    return JobFinding(status=status, bolts=bolts, **more)  # type: ignore[arg-type]


REFERENCE = job("tttttt", assumed="reference")


def test_an_all_clear() -> None:
    assert not_clear({"tight": REFERENCE, "a": job("tttttt"), "b": job("ttttto", "stopped")}) == {}
    # Baselines beside a job that is compared are no obstacle; no more is a reference job that sees nothing.
    assert not_clear({"tight": job("oo", assumed="reference"), "again": job("tt", assumed="baseline"), "a": job("tt")}) == {}


def risen(*changes: float, verdict: str = "tight", probability: float | None = 0.001, std: float = 0.15, **more: Any) -> JobFinding:
    bolts = [
        BoltFinding(name=f"B{i}", verdict="tight", change=change, change_std=std, threshold=-0.5)
        for i, change in enumerate(changes, start=1)
    ]
    return JobFinding(status="converged", bolts=[replace(bolts[0], verdict=verdict, probability=probability), *bolts[1:]], **more)


def test_a_bolt_that_the_other_jobs_show_stiffer_was_loose_in_the_reference_job() -> None:
    """A pump casing, B04 at 3 % of its stiffness in the reference job: the calibration took it up, and nothing was said."""
    reference = job("tttttt", assumed="reference")
    jobs = {"tight": reference, "again": replace(risen(0.74, 0.1), assumed="baseline"), "a": risen(0.52, -0.1), "b": risen(0.25, 0.3)}
    found = loose_there(jobs)
    assert list(found) == ["tight"]
    assert found["tight"].startswith("probably not all tight: half of the other jobs, or more, show bolts stiffer than here")
    assert "B1 (+0.52 decades)." in found["tight"]
    assert across(jobs) == found
    assert not_clear(jobs)["tight"] == [found["tight"]]
    # The reference job need not be of this call.
    assert loose_there({"a": jobs["a"]}, jobs) == found
    assert "tight" in not_clear({"a": jobs["a"]}, jobs)


@pytest.mark.parametrize(
    "last",
    [
        # The median counts, and it must exceed the threshold.
        risen(0.49, 0.0),
        # A job in which the bolt is loose, or probably, shows the opposite.
        risen(0.6, 0.0, verdict="loose"),
        risen(0.6, 0.0, verdict="undecided", probability=0.7),
        # Nothing is told by a job without verdicts, by a change that is hardly known, such as that of a joint far above the others in the
        # reference job, by a job compared with an earlier reference job, and by the same measurement once more.
        replace(risen(0.9, 0.0), status="unexplained"),
        risen(1.2, 0.0, std=1.2),
        risen(0.9, 0.0, against="another"),
        risen(0.9, 0.0, content="a"),
    ],
)
def test_little_shows_no_loose_reference_job(last: JobFinding) -> None:
    jobs = {"tight": job("tt", assumed="reference"), "a": risen(0.6, 0.0, content="a"), "b": risen(0.3, 0.0), "c": last}
    assert loose_there(jobs) == {}
    assert loose_there({name: own for name, own in jobs.items() if name != "tight"}) == {}
    assert loose_there(jobs | {"c": risen(0.6, 0.0)})


@pytest.mark.parametrize(
    ("other", "words"),
    [
        (job("tttttl"), "B6 loose"),
        (job("tttttu"), "1 inconclusive"),
        (job("tttttp"), "B6 probably loose"),
        (job("tttttt", "unexplained"), "does not explain"),
        (job("", "failed"), "no verdict: failed"),
        (job("tttttt", "of a later version"), "no verdict"),
        (job(""), "no bolts to judge"),
        (job("oooooo"), "no bolt is within reach"),
        (job("tttttt", validated=False), "not validated"),
        (job("tttttt", assumed="baseline", doubtful=("B3",)), "B3 taken as tight, but probably loose"),
        (job("tttttt", assumed="reference", doubtful=("B3",)), "B3 taken as tight, but far looser than the other bolts there"),
        (job("tttuut", assumed="reference"), "2 inconclusive"),
        (job("tttttt", "unexplained", assumed="reference"), "does not explain"),
        (
            replace(
                job("tt"), bolts=(BoltFinding(name="B1", verdict="tight"), BoltFinding(name="B2", verdict="a word of a later version"))
            ),
            "1 inconclusive",
        ),
    ],
)
def test_one_open_point_is_enough(other: JobFinding, words: str) -> None:
    found = not_clear({"tight": REFERENCE, "clear": job("tttttt"), "other": other})
    assert list(found) == ["other"]
    assert words in " ".join(found["other"])
    assert open_points(other) == found["other"]


def test_one_measurement_under_two_names_shows_one_state() -> None:
    once, again = (job("tttttt", measurement=figures, copied_db=2e-4) for figures in ((1.0, 2.0), (1.00001, 2.00001)))
    jobs = {"tight": REFERENCE, "after": once, "later": again, "other": job("tttttt", measurement=(1.0, 2.001)), "unknown": job("tttttt")}
    assert not_clear(jobs) == {name: [text] for name, text in once_more(jobs).items()}
    assert list(not_clear(jobs)) == ["after", "later"]
    assert once_more(jobs)["after"].startswith("the same measurement as later")
    assert once_more({"after": replace(once, copied_db=1e-6), "later": replace(again, copied_db=1e-6)}) == {}
    # That of the reference job is told where it is identified: its numbers validate nothing.
    assert once_more({"tight": replace(REFERENCE, measurement=(1.0, 2.0)), "after": once}) == {}


def test_the_coherence_of_another_job_clears_neither() -> None:
    """Also that of the reference job; zeros, where it is constant or unknown, are nobody's."""
    own = job("tttttt", measurement=(1.0, 2.0), coherence=(-30.0, -14.0), copied_db=2e-4)
    copy = replace(own, measurement=(1.5, 2.5))
    silent = [replace(own, measurement=(figure, 2.0), coherence=(0.0, 0.0)) for figure in (3.0, 4.0)]
    jobs = {"tight": REFERENCE, "after": own, "later": copy, "fifth": silent[0], "sixth": silent[1]}
    assert list(not_clear(jobs)) == ["after", "later"]
    assert once_more(jobs)["later"].startswith("the coherence is that of after, so one of them is of another measurement")
    assert once_more(jobs | {"later": replace(copy, coherence=(-30.001, -14.0))}) == {}
    beside = {"tight": replace(REFERENCE, coherence=own.coherence), "after": own}
    assert list(once_more(beside)) == ["after"]
    assert "that of tight" in once_more(beside)["after"]


@pytest.mark.parametrize("jobs", [{}, {"tight": REFERENCE}, {"tight": REFERENCE, "again": job("tttttt", assumed="baseline")}])
def test_nothing_compared_is_nothing_shown(jobs: dict[str, JobFinding]) -> None:
    assert not_clear(jobs) == {"": ["no job was compared with the reference job"]}


@pytest.mark.parametrize(
    ("found", "text"),
    [
        (job("tttttt"), "no loose bolt found: 6 tight"),
        (job("tttttp"), "B6 probably loose; 5 tight"),
        (job("tltlup"), "B2, B4 loose, B6 probably; 2 tight, 1 inconclusive"),
        (job("lll"), "B1 to B3 loose"),
        (job("tto"), "no loose bolt found: 2 tight, 1 outside"),
        (job("uuu"), "no loose bolt found, but none is judged tight: 3 inconclusive"),
        (job("l" * 12), "B1 to B12 loose"),
        (job("lluppp"), "B1, B2 loose, B4 to B6 probably; 1 inconclusive"),
        (job("lt" * 10 + "lll"), "B1, B3, B5, B7, B9, B11, B13, B15 and 5 more loose; 10 tight"),
        (job("tt", "unexplained"), "no verdict: the model does not explain the measurement"),
        (
            job("uuu", "unexplained", nearest=("B1", "B2")),
            "no verdict: the model does not explain the measurement; check B1, B2 first (the nearest state has a loss there)",
        ),
        (job("", "failed"), "no verdict: failed"),
        (job(""), "no verdict: no bolts to judge"),
        (job("oo"), "no verdict: no bolt is within reach of the parameters"),
        (REFERENCE, "the reference job, taken as tight"),
        (job("tu", assumed="reference"), "the reference job, taken as tight: 1 tight, 1 inconclusive"),
        (job("", assumed="reference"), "the reference job, no bolts to judge"),
        (
            job("tt", assumed="reference", doubtful=("B2",)),
            "the reference job, taken as tight; but B2 far looser than the other bolts there",
        ),
        (job("tt", assumed="baseline", doubtful=("B2",)), "a baseline, taken as tight; but B2 probably loose against the reference job"),
    ],
)
def test_a_sentence_a_job(found: JobFinding, text: str) -> None:
    assert sentence(found) == text


def test_bolts_that_are_tight_as_a_whole_only_are_said() -> None:
    """The all-clear stands, but its sentence must not promise more than the verdicts."""
    first = [
        BoltFinding(name="B1", verdict="tight", open_groups=("rot",)),
        BoltFinding(name="B2", verdict="tight", open_groups=("rot", "shear")),
    ]
    some = JobFinding(status="converged", bolts=[*first, BoltFinding(name="B3", verdict="tight"), BoltFinding(name="B4", verdict="tight")])
    assert sentence(some) == "no loose bolt found: 4 tight (B1, B2 as a whole: springs of rot or shear alone may be loose)"
    every = replace(some, bolts=first[:1])
    assert sentence(every) == "no loose bolt found: 1 tight (as a whole: springs of rot alone may be loose)"
    assert not_clear({"tight": REFERENCE, "a": every}) == {}
    assert sentence(replace(every, assumed="baseline")) == "a baseline, taken as tight"


def test_a_job_of_which_another_one_is_a_copy_is_no_all_clear_either() -> None:
    """Scaled or thinned out, so that no figure is the same; of another measurement that was there before, it says nothing."""
    first = replace(job("tt"), measurement=(1.0, 2.0), content="a")
    copy = replace(job("tt", validated=False), measurement=(3.0, 4.0), content="b", copied_content="a")
    assert once_more({"first": first}, {"copy": copy}) == {"first": "the same measurement as copy: check whether another file was meant"}
    assert once_more({"first": replace(first, content="c")}, {"copy": copy}) == {}
    assert once_more({"first": replace(first, content="")}, {"copy": replace(copy, copied_content="")}) == {}


def test_a_group_whose_loss_would_show_but_is_not_excluded_is_no_all_clear() -> None:
    """A joint that had lost both rocking springs was tight as a whole, and the exit code was that of an all-clear."""
    first = BoltFinding(name="B1", verdict="tight", open_groups=("rot",), unclear_groups=("rot",))
    some = JobFinding(status="converged", bolts=[first, BoltFinding(name="B2", verdict="tight")])
    why = "unlike in the baselines, springs of rot of B1 alone may be loose"
    assert sentence(some) == f"no loose bolt found: 2 tight (B1 as a whole: springs of rot alone may be loose); {why}"
    assert not_clear({"tight": REFERENCE, "a": some}) == {"a": [why]}
    assert not_clear({"tight": REFERENCE, "a": some, "b": replace(some, assumed="baseline")}) == {"a": [why]}


def test_springs_of_a_bolt_that_the_data_call_loose_are_said() -> None:
    some = [BoltFinding(name="B1", verdict="tight"), BoltFinding(name="B2", verdict="undecided", probability=1e-6, lost_groups=("rot",))]
    found = JobFinding(status="converged", bolts=some)
    assert sentence(found) == "no loose bolt found: 1 tight, 1 inconclusive (some springs of B2 probably loose)"
    assert not_clear({"tight": REFERENCE, "a": found}) == {"a": ["1 inconclusive (some springs of B2 probably loose)"]}
    both = replace(found, bolts=(*some, BoltFinding(name="B3", verdict="undecided", probability=0.7)))
    assert sentence(both) == "B3 probably loose; 1 tight, 1 inconclusive (some springs of B2 probably loose)"


def test_an_all_clear_says_what_it_leaves_open(capsys: pytest.CaptureFixture[str]) -> None:
    """The sentence of a job told it, and the last line of the command said that every bolt is tight."""
    bolts = [BoltFinding(name="B1", verdict="tight", open_groups=("rot",)), BoltFinding(name="B2", verdict="tight")]
    jobs = {"tight": REFERENCE, "a": JobFinding(status="converged", bolts=bolts), "b": job("tt")}
    assert (open_groups(jobs["a"]), open_groups(jobs["b"]), open_groups(replace(jobs["a"], assumed="baseline"))) == (["rot"], [], [])
    outcome: Any = SimpleNamespace(findings=jobs, not_clear=not_clear(jobs))
    tell_clearance(outcome, 0, True)
    said = capsys.readouterr().out.replace("\n", " ").strip()
    assert said == "all clear: every observable bolt is tight as a whole; that springs of rot alone are loose is not excluded, see above"
    tell_clearance(SimpleNamespace(findings={"b": jobs["b"]}, not_clear={}), 0, True)  # type: ignore[arg-type]
    assert capsys.readouterr().out.strip() == "all clear: every observable bolt is tight"


def test_many_bolts_that_are_tight_one_by_one_are_no_all_clear_together() -> None:
    """Each of twenty is tight at 0.003, but one of them may be loose at 0.06, which no verdict of 0.95 allows."""
    many = job("t" * 20)
    few = replace(many, bolts=tuple(replace(bolt, probability=0.0024) for bolt in many.bolts))
    some = replace(many, bolts=tuple(replace(bolt, probability=0.003) for bolt in many.bolts))
    assert not_clear({"tight": REFERENCE, "a": few}) == {}
    words = "one of them may be loose, with a probability of up to 0.06"
    assert not_clear({"tight": REFERENCE, "a": some}) == {"a": [f"20 tight, but {words}"]}
    assert sentence(some) == f"no loose bolt found: 20 tight; {words}"
    assert not_clear({"tight": REFERENCE, "a": replace(some, confidence=0.9)}) == {}
    # Bolts that are taken as tight have no such probability, and beside a loose or an inconclusive bolt there is no all-clear anyway.
    assert sentence(replace(some, assumed="baseline")) == "a baseline, taken as tight"
    assert words not in sentence(replace(some, bolts=(*some.bolts, BoltFinding(name="B99", verdict="loose", probability=1.0))))


def test_runs_of_bolts_keep_their_zeros() -> None:
    names = ["B08", "B09", "B10", "B12", "north", "P9", "P10", "P11"]
    assert (
        sentence(JobFinding(status="converged", bolts=[BoltFinding(name=name, verdict="loose") for name in names]))
        == "B08 to B10, B12, north, P9 to P11 loose"
    )


def test_what_was_not_validated_is_said() -> None:
    assert sentence(job("tt", validated=False)).startswith("no loose bolt found: 2 tight (not validated: no validation channel shows")
