"""One resolver: what settings come to, the same for check, plan and update, and part of what a result rests on."""

from __future__ import annotations

import json
from dataclasses import dataclass, fields, replace
from typing import Any

import pytest
from campaigns import Folder

from lrbc_cli import load
from lrbc_cli.campaign.digests import code
from lrbc_cli.campaign.jobs import identity
from lrbc_cli.campaign.jobs.plans import plan
from lrbc_cli.campaign.reading.inputs import Inputs
from lrbc_cli.campaign.reduced import cache
from lrbc_cli.config.settings import UpdateConfig
from lrbc_cli.method.resolve import Facts, Method, formula, noise_source, resolve
from lrbc_cli.updating.statistics.model import STATISTICS
from lrbc_cli.updating.statistics.priors import BoltPrior

JOBS = ["tight", "loose-2", "loose-all"]


def method(*, reference: bool = True, bolts: bool = True, **settings: Any) -> Method:
    return resolve(UpdateConfig.model_validate(settings), Facts(reference, bolts))


@pytest.mark.parametrize(
    ("found", "approach", "regularisation", "optimiser", "sampled"),
    [
        (method(), "bolts", "noise", "gauss-newton", True),
        (method(reference=False), "paper", "noise", "gauss-newton", False),
        (method(bolts=False), "bolts", "noise", "gauss-newton", False),
        (method(regularisation=0.04), "paper", 0.04, "gauss-newton", False),
        (method(regularisation="l-curve"), "paper", "l-curve", "gauss-newton", False),
        (method(method="bfgs"), "paper", "noise", "bfgs", False),
        (method(approach="paper"), "paper", "noise", "gauss-newton", False),
        (method(approach="bolts", regularisation=0.04, method="bfgs"), "bolts", "noise", "gauss-newton", True),
    ],
)
def test_two_ways(found: Method, approach: str, regularisation: Any, optimiser: str, sampled: bool) -> None:
    assert (found.approach, found.regularisation, found.optimiser) == (approach, regularisation, optimiser)
    assert found.mixture == found.relative == sampled
    assert set(found.reasons) == {"approach", "regularisation", "optimiser", "weighted", "relative", "mixture"}


def test_settings_of_the_other_way_are_named() -> None:
    assert method(regularisation=0.04, method="bfgs").warnings == ()
    first, second = method(approach="bolts", regularisation=0.04, method="bfgs").warnings
    assert "update.regularisation: 0.04" in first
    assert "update.method: bfgs" in second


@pytest.mark.parametrize(
    ("settings", "idle", "needed"),
    [
        ({"approach": "paper", "regularisation": 0.04, "prior_std": 0.5}, "update.prior_std: 0.5", {"regularisation": "auto"}),
        ({"approach": "paper", "regularisation": "l-curve", "weights": "auto"}, "update.weights: auto", {"regularisation": "auto"}),
        ({"loss_scale": 1.0}, "update.loss_scale: 1", {"loss": "soft"}),
        ({"nuisances": {"room": 23.0}}, "update.nuisances.room: 23", {"nuisances": {"room": 23.0, "temperature": 2.0}}),
        ({"nuisances": {"room": 23.0, "sound_speed": 0.01}}, "update.nuisances.room: 23", {"nuisances": {"sound_speed": 0.01}}),
        ({"confidence": 0.9, "bolts": False}, "update.confidence", {"bolts": True}),
        ({"baselines": ("again",), "loose_change": -0.4, "bolts": False}, "update.baselines", {"bolts": True}),
    ],
)
def test_keys_without_effect_are_named(settings: Any, idle: str, needed: Any) -> None:
    assert method(**settings).warnings[0].startswith(idle)
    assert method(**(settings | needed)).warnings == ()


def test_averages_without_a_coherence_are_named(frame: Folder) -> None:
    said = "averages: 7 is not used, as the job has no coherence"
    outcome = frame.run("check", "--override", "jobs.tight.averages=7")
    assert (outcome.stdout + outcome.stderr).count(said) == 1
    assert said not in frame.run("check").stdout


def test_every_command_says_what_is_not_used(frame: Folder) -> None:
    words = ("--override", "update.approach=bolts", "--override", "update.regularisation=0.04")
    for command in (("check",), ("update", "--dry-run"), ("reduce", "--dry-run")):
        outcome = frame.run(*command, *words)
        assert (outcome.stdout + outcome.stderr).count("update.regularisation: 0.04") == 1, command


@pytest.mark.parametrize(
    ("settings", "coherent", "repeated", "source"),
    [
        ({}, True, True, "coherence"),
        ({}, False, True, "scatter"),
        ({}, False, False, "none"),
        ({"weights": "none"}, True, True, "none"),
        ({"regularisation": 0.04}, True, True, "none"),
    ],
)
def test_where_the_noise_of_lines_is_from(settings: dict[str, Any], coherent: bool, repeated: bool, source: str) -> None:
    assert noise_source(method(**settings), coherent=coherent, repeated=repeated) == source


def test_formulas() -> None:
    assert [formula("auto", 10, 38), formula("auto", 40, 38), formula("reduced", 10, 38), formula("full", 10, 38)] == [
        "port",
        "reduced",
        "reduced",
        "port",
    ]


def test_nothing_is_auto_any_more() -> None:
    text = json.dumps({name: value for name, value in method().tree().items() if name != "reasons"})
    assert '"auto"' not in text


@pytest.mark.parametrize(("part", "name"), [(p.name, f.name) for p in fields(STATISTICS) for f in fields(getattr(STATISTICS, p.name))])
def test_every_number_is_part_of_the_identity(part: str, name: str) -> None:
    found = method()
    own = getattr(found.statistics, part)
    value = getattr(own, name)
    # Whole numbers stay whole, shares stay below one.
    one, *rest = (2 * x if isinstance(x, int) else x / 2 for x in (value if isinstance(value, tuple) else (value,)))
    other = (one, *rest) if isinstance(value, tuple) else one
    changed = replace(found.statistics, **{part: replace(own, **{name: other})})
    assert changed.digest() != found.statistics.digest()
    assert changed.digest(part) != found.statistics.digest(part)


def test_another_class_of_a_part_is_another_model() -> None:
    """It may compute otherwise with the same numbers."""

    @dataclass(frozen=True, kw_only=True)
    class Heavier(BoltPrior):
        pass

    assert replace(STATISTICS, bolts=Heavier()).digest() != STATISTICS.digest()


def test_reasons_are_no_part_of_the_identity() -> None:
    assert method(approach="bolts").digest == method().digest
    assert method(prior_std=0.3).statistics.digest() != method().statistics.digest()
    assert method(loss="soft").digest != method().digest


def runs(inputs: Inputs) -> list[str]:
    """Jobs that would run."""
    return [job.name for job in plan(inputs, cache.key_parts(inputs), JOBS) if job.run]


def test_a_number_of_the_statistical_model_makes_results_outdated(frame: Folder) -> None:
    inputs = frame.inputs()
    assert runs(inputs) == []
    errors = replace(STATISTICS.errors, shift_error=0.30)
    changed = replace(inputs, by_hand={"statistics": replace(inputs.statistics, errors=errors)})
    assert changed.method.statistics.errors.shift_error == 0.30
    assert runs(changed) == JOBS


def test_what_the_method_says_is_what_is_computed(frame: Folder) -> None:
    """Fields of the method that are set from Python: the record states them, and the identification follows them."""
    study = load(frame.config, cache=frame.cache)
    plain, other = study.identify("tight"), study.with_method(lines="all", responses=("acc1", "acc2")).identify("tight")
    assert (plain.record.method["lines"], other.record.method["lines"]) == ("resonances", "all")
    assert plain.record.lines.count < other.record.lines.count == study.read("tight").frequency_hz.size
    assert [name for name, entry in other.record.misfit_db.responses.items() if entry.used] == ["acc1", "acc2"]


@pytest.mark.parametrize(("stage", "verb"), [("reduction", "runs"), ("identification", "runs"), ("judgement", "judged anew")])
def test_a_change_of_the_code_makes_results_outdated(frame: Folder, monkeypatch: pytest.MonkeyPatch, stage: str, verb: str) -> None:
    inputs = frame.inputs()
    for module in (identity, cache):
        monkeypatch.setattr(module, "code", lambda name: "another" if name == stage else code(name))
    assert {job.verb for job in plan(inputs, cache.key_parts(inputs), JOBS)} == {verb}


def test_check_update_and_plan_take_the_same_method(frame: Folder) -> None:
    found = frame.run("check", "--json").json
    checked = found["method"]
    assert checked["approach"] == "bolts"
    assert all(frame.result(job)["method"] == checked for job in JOBS)
    assert all(frame.result(job)["decision_rule"] == found["decision_rule"] for job in JOBS)
    assert frame.run("plan", "--draws", "0").code == 0
    assert json.loads((frame.out / "plan.json").read_text())["identification"] == checked
    text = frame.run("check").stdout
    for line in ("approach: bolts (there is a reference job to compare with)", "mixture: yes (each bolt is tight or loose)"):
        assert line in text
    listing = frame.run("check", "--override", "update.approach=bolts", "--override", "update.regularisation=0.04").stdout
    assert "update.regularisation: 0.04 is not used: a weight of values along the edge needs approach: paper" in listing
