"""Overrides act as if written in the file, and their errors name them."""

from __future__ import annotations

import pytest
from sample_campaign import VALID

from lrbc_cli.config import Campaign, EveryLine, load_campaign


def load(write, *overrides: str) -> Campaign:  # type: ignore[no-untyped-def]
    return load_campaign(write(VALID), overrides)


def test_values_replace_what_is_written(write) -> None:  # type: ignore[no-untyped-def]
    campaign = load(write, "update.method=gauss-newton", "reduction.band=[30, 3e2]", "update.lines={every: 3}", "update.method=bfgs")
    assert campaign.update.method == "bfgs"
    assert campaign.reduction.band == (30.0, 300.0)
    assert campaign.update.lines == EveryLine(every=3)


def test_keys_can_be_added_and_removed(write) -> None:  # type: ignore[no-untyped-def]
    campaign = load(write, "update.max_iterations=7", "jobs.new.frf=a=b.uff", "model.damping=", "parameters.left_edge.damping=null")
    assert campaign.update.max_iterations == 7
    assert campaign.jobs["new"].frf.name == "a=b.uff"
    assert campaign.model.damping is None
    assert campaign.parameters["left_edge"].damping is None


@pytest.mark.parametrize("key", ["update.responses[1]", "update.responses.1"])
def test_list_entries(write, key: str) -> None:  # type: ignore[no-untyped-def]
    assert load(write, "update.responses=[mic01, mic01]", f"{key}=acc1").update.responses == ("mic01", "acc1")


def test_names_with_dots(write) -> None:  # type: ignore[no-untyped-def]
    path = write(VALID + "  run.v2: {frf: a.uff}\n")
    assert load_campaign(path, ["jobs.run.v2.removed=[B1]"]).jobs["run.v2"].removed == ("B1",)


def test_paths_are_relative_to_the_file(write) -> None:  # type: ignore[no-untyped-def]
    campaign = load(write, "output=elsewhere", "model.stiffness=other.h5#K2")
    assert campaign.output == campaign.path.parent.resolve() / "elsewhere"
    assert campaign.model.stiffness.text == "other.h5#K2"
    assert campaign.resolved()["output"] == "elsewhere"
    assert campaign.resolved()["model"]["stiffness"] == "other.h5#K2"


def test_places_name_the_override(write) -> None:  # type: ignore[no-untyped-def]
    campaign = load(write, "update.tolerance=1e-4", "jobs.x={frf: a.uff}")
    assert campaign.place("update", "tolerance") == "--override update.tolerance"
    assert campaign.place("jobs", "x", "frf") == "--override jobs.x, jobs.x.frf"
    assert campaign.place("update", "method").startswith("line ")


@pytest.mark.parametrize(
    ("override", "place", "part"),
    [
        ("update.method=bfg", "--override update.method", "did you mean 'bfgs'?"),
        ("update.methd=bfgs", "--override update.methd", "did you mean 'method'?"),
        ("update.tolerance=no", "--override update.tolerance", "a number"),
        ("update.tolerance='1e-3'", "--override update.tolerance", "a number"),
        ("update.lines={every: 0}", "--override update.lines, update.lines.every", "at least 1"),
        ("update.responses[0]=mic1", "--override update.responses[0]", "did you mean 'mic01'?"),
        ("update.responses[2]=mic01", "--override update.responses[2]", "an index from 0 to 1"),
        ("update.responses.first=mic01", "--override update.responses.first", "an index"),
        ("update.method.x=1", "--override update.method.x", "is a value and has no keys"),
        ("update.lines=[1, 2", "--override update.lines", "YAML"),
        ("update.lines=!!python/name:os.system", "--override update.lines", "tags"),
        ("update={method: bfgs, method: bfgs}", "--override update", "is given twice"),
        ("update.method", "--override update.method", "key.path=value"),
        ("=3", "--override =3", "key.path=value"),
        ("update..method=3", "--override update..method=3", "key.path=value"),
        (".".join("a" * 100) + "=1", "--override a.a.a", "key.path=value"),
        ("reduction.band=[5, 4]", "--override reduction.band", "lower below upper"),
        ("jobs.con.frf=a.uff", "--override jobs.con.frf, jobs.con", "Windows"),
        ("jobs={Reduction.json: {frf: a.uff}}", "--override jobs, jobs.Reduction.json", "the name of a result file"),
        ("jobs={campaign.json: {frf: a.uff}}", "--override jobs, jobs.campaign.json", "the name of a result file"),
        ("calibration={job: bolts00, factors: [mass.structure]}", "--override calibration", "did you mean 'bolts-00'?"),
        ("update.regularisation=lcurve", "--override update.regularisation", "l-curve"),
        ("update.residual=log-complx", "--override update.residual", "did you mean 'log-complex'?"),
        ("update={comparison: relative}", "--override update, update.comparison", "no longer exists"),
        ("update={evaluation: full, nuisances: {gain: 0.1}}", "--override update, update.nuisances", "need the reduced model"),
        ("model=", "--override model", "nothing"),
        ("output=" + "x" * 5000, "--override output", "the path is longer than this system allows"),
        ("model.dofs=" + "x/" * 5000, "--override model.dofs", "the path is longer than this system allows"),
        # What a terminal without UTF-8 makes of other letters.
        ("jobs.t\udcc3\udcbcr.frf=a.uff", r"--override 'jobs.t\udcc3", "PYTHONUTF8=1"),
        ("output=t\udcc3\udcbcr", r"--override 'output=t\udcc3", "PYTHONUTF8=1"),
    ],
)
def test_messages(fails, override: str, place: str, part: str) -> None:  # type: ignore[no-untyped-def]
    error = fails(VALID, override)
    assert error.place.startswith(place)
    assert part in error.message


def test_an_override_can_break_what_stands_in_the_file(fails) -> None:  # type: ignore[no-untyped-def]
    error = fails(VALID, "parameters.left_edge.bounds=[5, 6]")
    assert error.place.endswith("parameters.left_edge.initial")
    assert error.place.startswith("line ")
