"""Removed bolts that jobs state beside what they measured: exchanged files, and bolts numbered from the other end."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from looking import measurement
from samples import reduced_cache, sample

from lrbc_cli.campaign.identification.compared.likeness import apart
from lrbc_cli.campaign.looking.causes import removed
from lrbc_cli.campaign.looking.causes.removed import removed_findings
from lrbc_cli.campaign.looking.states import Looking, Seen
from lrbc_cli.campaign.reduced.stage import obtain_reduction

HZ = np.arange(40.0, 500.0, 2.0)


def told(jobs: dict[str, tuple[tuple[str, ...], tuple[str, ...]]], near: tuple[str, ...] = ()) -> list[str]:
    """Texts about jobs of the plate that state removed bolts, and have other ones loose; some are known as ``near`` the tight state."""
    inputs = sample("plate")
    first = next(iter(inputs.campaign.jobs.values()))
    stated = {name: first.model_copy(update={"removed": removed}) for name, (removed, _) in jobs.items()}
    campaign = inputs.campaign.model_copy(update={"jobs": {"tight-1": first} | stated})
    source = Looking(inputs=replace(inputs, campaign=campaign), stage=obtain_reduction(inputs, reduced_cache("plate")), kind="port")
    s = 2j * np.pi * HZ
    parameters, rng = source.parameters(s), np.random.default_rng(3)
    assert inputs.bolts is not None
    names = list(inputs.bolts.name)

    def frfs(loose: tuple[str, ...]) -> Any:
        theta = parameters.initial.copy()
        for group, where, _ in parameters.placed:
            if group.bolt is not None:
                theta[where][np.isin(group.bolt, [names.index(name) for name in loose])] -= 1.6
        y = source.model(s, parameters).frf(theta)
        noise = rng.normal(size=(2, *y.shape))
        return measurement(HZ, y * (1.0 + 0.02 * (noise[0] + 1j * noise[1])))

    measured = {"tight-1": frfs(())} | {name: frfs(loose) for name, (_, loose) in jobs.items()}
    source.left.update({name: float(np.median(apart(measured[name].values, measured["tight-1"].values))) for name in near})
    return [finding.text for finding in removed_findings(source, measured)]


ONE, TWO, THREE = ("B1",), ("B2", "B3"), ("B2",)


def test_jobs_with_the_bolts_that_they_state() -> None:
    assert told({"one": (ONE, ONE), "two": (TWO, TWO), "three": (THREE, THREE)}) == []
    # Without statements there is nothing to compare.
    assert told({"one": ((), ONE), "two": ((), TWO)}) == []


def test_a_single_job_with_other_bolts_than_it_states() -> None:
    assert told({"one": ((), ONE), "two": (ONE, ONE)}) == []
    (text,) = told({"one": ((), ONE), "two": (TWO, ONE)})
    assert text.startswith("B2, B3 are stated as removed, but the measurement is fitted best with B1 loose instead. Check the names")
    assert "whether they are numbered from the other end, and jobs.two.removed" in text


def test_a_job_measured_before_the_bolts_were_removed(monkeypatch: pytest.MonkeyPatch) -> None:
    """A lid over a cavity, S08 stated as removed: it is fitted best as the tight state."""
    (text,) = told({"one": (ONE, ())}, near=("one",))
    assert text.startswith("B1 is stated as removed, but the measurement is 0.")
    assert "dB from the nearest one without these (mean level of each response removed). Check if it was made before" in text
    # As far from the tight state as from the other one.
    assert told({"one": (ONE, ONE)}, near=("one",)) == []
    # The bolt hardly changes the FRFs: the lid of a box, 0.2 and 0.4 dB.
    monkeypatch.setattr(removed, "_distances", lambda *_: np.array([2.9]))
    assert told({"one": (ONE, ())}, near=("one",)) == []


def test_files_exchanged_with_a_job_that_states_nothing() -> None:
    """A lid over a cavity: S08 was removed in one job, and S05 half loose in the other."""
    (text,) = told({"one": (ONE, ()), "two": ((), ONE)})
    assert text == (
        "the files of one and two are probably exchanged: B1 is stated as removed in one and fitted best as tight, but loose in two. "
        "Exchange jobs.one.frf and jobs.two.frf, or correct `removed`"
    )
    both = told({"one": (ONE, ()), "two": ((), ONE), "three": (THREE, ()), "four": ((), THREE)})
    assert [text[:40] for text in both] == ["the files of one and two are probably ex", "the files of three and four are probably"]
    # It is not the only one, or has other bolts loose.
    assert told({"one": (ONE, ()), "two": ((), ("B4",))}) == []
    assert told({"one": (ONE, ()), "two": ((), ONE), "three": ((), ONE)}) == []


def test_files_of_two_jobs_exchanged() -> None:
    (text,) = told({"one": (ONE, TWO), "two": (TWO, ONE), "three": (THREE, THREE)})
    assert text.startswith("the files of one and two are probably exchanged: each fits the removed bolts of the other")
    assert "Exchange jobs.one.frf and jobs.two.frf, or correct `removed` of both" in text


def test_bolts_numbered_from_the_other_end_of_a_structure_that_is_nearly_symmetrical(monkeypatch: pytest.MonkeyPatch) -> None:
    """Stated bolts explain the jobs half as badly again: enough if each job is nearest to the others among the bolts of all jobs."""
    one, two = frozenset({"B1", "B2"}), frozenset({"B2"})

    def distances(seen: Seen, sets: list[frozenset[str]], third: float) -> np.ndarray:
        stated = one if seen.job == "one" else two
        turned = frozenset({"B5", "B6"}) if seen.job == "one" else frozenset({"B5"})
        near = {stated: 1.5, turned: 1.0}
        return np.array([near.get(each, third if "B5" in each else 2.0) for each in sets])

    jobs = {"one": (("B1", "B2"), ()), "two": (("B2",), ())}
    monkeypatch.setattr(removed, "_distances", lambda seen, sets: distances(seen, sets, 2.0))
    (text,) = told(jobs)
    assert "are probably numbered from the other end" in text
    # Of a bolt that hardly changes the FRFs, a neighbour may fit a little better.
    monkeypatch.setattr(removed, "_distances", lambda seen, sets: distances(seen, sets, 0.99))
    assert len(told(jobs)) == 1
    monkeypatch.setattr(removed, "_distances", lambda seen, sets: distances(seen, sets, 0.9))
    assert told(jobs) == []


@pytest.mark.parametrize(("third", "count"), [(2.0, 1), (1.2, 0)])
def test_files_exchanged_beside_a_model_that_is_not_calibrated(monkeypatch: pytest.MonkeyPatch, third: float, count: int) -> None:
    """Of twelve bolts along an edge, the model leaves 0.72 of the misfit: enough if no other stated bolts are nearer."""
    far = {"one": {ONE: 1.72, TWO: 1.33}, "two": {ONE: 1.76, TWO: 2.59}, "three": {THREE: 1.0}}

    def distances(seen: Seen, sets: list[frozenset[str]]) -> np.ndarray:
        own = {frozenset(bolts): left for bolts, left in far[seen.job].items()}
        return np.array([own.get(each, third) for each in sets])

    monkeypatch.setattr(removed, "_distances", distances)
    texts = told({"one": (ONE, ()), "two": (TWO, ()), "three": (THREE, ())})
    assert len(texts) == count
    assert all(text.startswith("the files of one and two are probably exchanged") for text in texts)


def test_bolts_numbered_from_the_other_end() -> None:
    names = list(sample("plate").bolts.name)  # type: ignore[union-attr]
    opposite = dict(zip(names, names[::-1], strict=True))
    jobs = {name: (own, tuple(opposite[bolt] for bolt in own)) for name, own in (("one", ONE), ("two", TWO), ("three", THREE))}
    (text,) = told(jobs)
    assert text.startswith("the bolts of bolts.csv are probably numbered from the other end: with the names in reverse order")
