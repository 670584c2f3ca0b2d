"""A campaign is loaded as written, or refused with one message that says where and how to fix it."""

from __future__ import annotations

import json
import pickle
from pathlib import Path

import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from sample_campaign import VALID

from lrbc_cli.config import Campaign, EveryLine, ListedLines, MatrixRef, ProportionalDamping, RecordRef, load_campaign
from lrbc_cli.config.fields import MatrixFormat
from lrbc_cli.errors import ConfigError


def swap(old: str, new: str) -> str:
    assert VALID.count(old) >= 1
    return VALID.replace(old, new, 1)


def line_of(text: str, part: str) -> int:
    return text[: text.index(part)].count("\n") + 1


def test_a_valid_campaign(campaign: Campaign, tmp_path: Path) -> None:
    assert campaign.name == "box"
    assert campaign.path == tmp_path / "campaign.yaml"
    assert campaign.output == (tmp_path / "../runs/box").resolve()
    assert campaign.model.stiffness.path == (tmp_path / "model.h5").resolve()
    assert (campaign.model.stiffness.group, campaign.model.stiffness.format, campaign.model.stiffness.text) == ("K", None, "model.h5#K")
    assert (campaign.model.mass.group, campaign.model.mass.format, campaign.model.mass.text) == ("M", "hdf5", "model.h5#M")
    assert isinstance(campaign.model.damping, ProportionalDamping)
    assert campaign.model.damping.structure.beta == 2.554e-6
    assert campaign.model.damping.acoustic.beta == 0.0
    assert campaign.responses["mic01"].component == "PRES"
    assert [point.form for point in (campaign.excitation["hammer"], *campaign.responses.values())] == ["near", "near", "matrix"]
    assert campaign.responses["acc1"].record == RecordRef(node=201, direction=3)
    assert campaign.parameters["left_edge"].bounds == (-1.0, 7.0)
    assert campaign.reduction.band == (20.0, 400.0)
    assert campaign.update.method == "bfgs"
    assert list(campaign.jobs) == ["bolts-00", "bolts-04"]
    assert campaign.jobs["bolts-04"].removed == ("B08", "B09")
    assert campaign.jobs["bolts-04"].records == {"mic01": "channel 7"}


def test_defaults(write) -> None:  # type: ignore[no-untyped-def]
    text = """
campaign: small
model: {stiffness: k.mtx, mass: m.mtx}
excitation: {f: {dof: 3}}
responses: {r: {vector: "r.npz#v"}}
parameters: {p: {select: {vectors: b.mtx, positions: b.csv}}}
reduction: {band: [1, 10]}
"""
    campaign = load_campaign(write(text))
    assert campaign.output == campaign.path.parent.resolve() / "output"
    assert campaign.model.damping is None
    assert campaign.model.dofs is None
    assert campaign.jobs == {}
    group = campaign.parameters["p"]
    assert (group.kind, group.initial, group.bounds, group.baseline, group.smoothing, group.damping) == (
        "stiffness",
        "auto",
        "auto",
        0.0,
        None,
        None,
    )
    assert (campaign.reduction.tolerance, campaign.reduction.held_out, campaign.reduction.backend) == (1e-3, 5, "auto")
    assert (campaign.update.lines, campaign.update.method, campaign.update.regularisation) == ("resonances", "gauss-newton", "auto")


def test_it_cannot_be_changed(campaign: Campaign) -> None:
    with pytest.raises(ValueError, match="frozen"):
        campaign.update = campaign.update  # type: ignore[misc]
    with pytest.raises(TypeError, match="read-only"):
        campaign.jobs["new"] = campaign.jobs["bolts-00"]
    with pytest.raises(TypeError, match="read-only"):
        campaign.jobs.pop("bolts-00")


def test_it_can_be_sent_to_a_worker(campaign: Campaign) -> None:
    twin = pickle.loads(pickle.dumps(campaign))
    assert twin == campaign
    assert twin.place("jobs") == campaign.place("jobs")
    assert twin.model.stiffness.text == "model.h5#K"


def test_resolved_is_json_and_loads_again(campaign: Campaign, write) -> None:  # type: ignore[no-untyped-def]
    resolved = campaign.resolved()
    assert resolved["model"]["stiffness"] == "model.h5#K"
    assert resolved["output"] == "../runs/box"
    assert resolved["jobs"]["bolts-00"]["frf"] == "frf/bolts-00.uff"
    assert resolved["update"]["max_iterations"] == 100
    again = load_campaign(write(json.dumps(resolved)))
    assert again.resolved() == resolved
    assert again.model_dump() == campaign.model_dump()


def test_places(campaign: Campaign) -> None:
    assert campaign.place("parameters", "left_edge", "bounds") == f"line {line_of(VALID, '    bounds:')}, parameters.left_edge.bounds"
    assert campaign.place("update", "responses", 1) == f"line {line_of(VALID, '  responses: [mic')}, update.responses[1]"
    assert campaign.place("update", "tolerance") == f"line {line_of(VALID, 'update:')}, update.tolerance"
    error = campaign.error("no such node", "responses", "mic01", expected="a node", found="none", hint="look again")
    assert isinstance(error, ConfigError)
    assert str(campaign.path) in error.message
    assert f"line {line_of(VALID, '  mic01: {near')}, responses.mic01: no such node" in error.message


@pytest.mark.parametrize(
    ("text", "attribute", "value"),
    [
        (swap("lines: resonances", "lines: all"), "lines", "all"),
        (swap("lines: resonances", "lines: {every: 2}"), "lines", EveryLine(every=2)),
        (swap("lines: resonances", "lines: {list: [33.3, 71]}"), "lines", ListedLines.model_validate({"list": (33.3, 71.0)})),
    ],
)
def test_lines(write, text: str, attribute: str, value: object) -> None:  # type: ignore[no-untyped-def]
    assert getattr(load_campaign(write(text)).update, attribute) == value


def test_damping_may_be_a_matrix(write) -> None:  # type: ignore[no-untyped-def]
    text = swap("damping: {initial: 0.0, ", "damping: {beta: 1e-6, initial: 0.0, ")
    start, end = text.index("  damping:\n"), text.index("  dofs:")
    for damping in ("model.h5#C", "{file: model.h5, group: C}"):
        campaign = load_campaign(write(f"{text[:start]}  damping: {damping}\n{text[end:]}"))
        assert isinstance(campaign.model.damping, MatrixRef)
        assert campaign.model.damping.text == "model.h5#C"


def test_names_that_yaml_1_1_takes_for_booleans(write) -> None:  # type: ignore[no-untyped-def]
    campaign = load_campaign(write(VALID.replace("bolts-00", "no").replace("B08", "off")))
    assert campaign.update.reference == "no"
    assert campaign.jobs["bolts-04"].removed == ("off", "B09")


CASES = [
    # unknown and missing keys
    (swap("  method:", "  methd:"), "update.methd", ["unknown key 'methd'", "did you mean 'method'?"]),
    (swap("stiffness: model", "stifness: model"), "model.stifness", ["unknown key", "did you mean 'stiffness'?"]),
    (swap("bolts: bolts.csv", "band: [1, 2]"), "band", ["unknown key", "reduction.band"]),
    (swap("bolts: bolts.csv", "zzz: 1"), "zzz", ["unknown key", "one of campaign, output"]),
    (swap("alpha: 5.1357, beta", "alpha: 5,1357, beta"), "model.damping.structure.1357", ["write alpha: 5.1357"]),
    (swap("beta: 2.554e-6", "betta: 1"), "model.damping.structure.betta", ["did you mean 'beta'?"]),
    (swap("group: M", "grp: M"), "model.mass.grp", ["did you mean 'group'?"]),
    (swap("row: 1", "rwo: 1"), "responses.acc1.rwo", ["did you mean 'row'?"]),
    (swap("direction: 3", "dir: 3"), "responses.acc1.record.dir", ["one of node, direction"]),
    (swap("removed:", "remove:"), "jobs.bolts-04.remove", ["did you mean 'removed'?"]),
    (swap("lines: resonances", "lines: {evry: 2}"), "update.lines.evry", ["did you mean 'every'?"]),
    (swap("campaign: box\n", ""), "campaign", ["the key 'campaign' is missing"]),
    (swap("band: [20.0, 400], ", ""), "reduction.band", ["the key 'band' is missing", "in Hz"]),
    (swap("frf: frf/bolts-00.uff", ""), "jobs.bolts-00.frf", ["the key 'frf' is missing"]),
    (swap("bolts: bolts.csv", "calibration: {job: bolts-00}"), "calibration.factors", ["without factors", "at least one"]),
    # types
    (swap("campaign: box", "campaign: 7"), "campaign", ["expected: text", "the number 7", "quotes"]),
    (swap("campaign: box", "campaign: ' '"), "campaign", ["not a valid campaign name"]),
    (swap("regularisation: 0.04", "regularisation: '0.04'"), "update.regularisation", ["a number", "the text '0.04'", "no quotes"]),
    (swap("regularisation: 0.04", "regularisation: true"), "update.regularisation", ["a number", "found:    true"]),
    (swap("regularisation: 0.04", "regularisation: no"), "update.regularisation", ["a number", "the text 'no'"]),
    (swap("regularisation: 0.04", "regularisation: 0,04"), "update.regularisation", ["decimal point"]),
    (swap("regularisation: 0.04", "regularisation:"), "update.regularisation", ["found:    nothing", "give it a value"]),
    (swap("regularisation: 0.04", "regularisation: .nan"), "update.regularisation", ["a number, at least 0"]),
    (swap("regularisation: 0.04", "regularisation: 1e999"), "update.regularisation", ["a number, at least 0"]),
    (swap("regularisation: 0.04", "regularisation: 1" + "0" * 390), "update.regularisation", ["a number"]),
    (swap("regularisation: 0.04", "regularisation: -1"), "update.regularisation", ["at least 0", "the number -1"]),
    (swap("regularisation: 0.04", "regularisation: lcurve"), "update.regularisation", ["a number", "l-curve"]),
    # keys and values that are gone
    (swap("regularisation: 0.04", "prior: initial"), "update.prior", ["the key 'prior' no longer exists", "approach: paper"]),
    (swap("regularisation: 0.04", "unknowns: values"), "update.unknowns", ["no longer exists", "values along the edge"]),
    (swap("regularisation: 0.04", "comparison: direct"), "update.comparison", ["no longer exists", "directly with approach: paper"]),
    (swap("regularisation: 0.04", "prior_shape: sparse"), "update.prior_shape", ["no longer exists", "tight or loose"]),
    (swap("regularisation: 0.04", "penalty: {slope: 1.0}"), "update.penalty", ["no longer exists", "update.regularisation"]),
    (swap("regularisation: 0.04", "residual: complex"), "update.residual", ["'complex' no longer exists", "log-complex"]),
    (swap("lines: resonances", "lines: resonances-both"), "update.lines", ["'resonances-both' no longer exists", "lines: resonances"]),
    (swap("regularisation: 0.04", "weights: scatter"), "update.weights", ["'scatter' no longer exists", "weights: auto"]),
    (swap("regularisation: 0.04", "weights: coherence"), "update.weights", ["'coherence' no longer exists", "weights: auto"]),
    (
        swap("  reference: bolts-00\n", "  approach: bolts\n"),
        "update.approach",
        ["needs a reference job", "update.reference", "approach: paper"],
    ),
    (swap("regularisation: 0.04", "approach: boltz"), "update.approach", ["did you mean 'bolts'?"]),
    (
        swap("frf: frf/bolts-00.uff", "frf: a.uff, repeats: [b.uff, a.uff]"),
        "jobs.bolts-00.repeats[1]",
        ["file that this job already contains"],
    ),
    (swap("frf: frf/bolts-00.uff", "frf: a.uff, averages: 0"), "jobs.bolts-00.averages", ["at least 1"]),
    (swap("method: bfgs", "method: bfg"), "update.method", ["'gauss-newton' or 'bfgs'", "did you mean 'bfgs'?"]),
    (swap("method: bfgs", "max_iterations: 1e2"), "update.max_iterations", ["a whole number", "write 100"]),
    (swap("method: bfgs", "max_iterations: 1.5"), "update.max_iterations", ["a whole number"]),
    (swap("method: bfgs", "loose_change: 0.5"), "update.loose_change", ["below 0"]),
    (swap("row: 1", "row: -1"), "responses.acc1.row", ["at least 0"]),
    (swap("model.h5#K", "[model.h5, K]"), "model.stiffness", ["'file#group'", "a list of 2"]),
    (swap("model.h5#K", "'model.h5#'"), "model.stiffness", ["'file#group'"]),
    (swap("format: hdf5", "format: hdf"), "model.mass.format", ["did you mean 'hdf5'?"]),
    (swap("dofs.csv", "12"), "model.dofs", ["a path", "the number 12"]),
    (swap("dofs.csv", "''"), "model.dofs", ["not a path"]),
    (swap("removed: [B08, B09]", "removed: [8, 9]"), "jobs.bolts-04.removed[0]", ["expected: text", "quotes", "removed[1]"]),
    (swap("removed: [B08, B09]", "removed: B08"), "jobs.bolts-04.removed", ["a list"]),
    (swap("removed: [B08, B09]", "removed: [B08, B08]"), "jobs.bolts-04.removed[1]", ["is given twice", "'B08'"]),
    (swap("mic01: channel 7", "mic01: 7.5"), "jobs.bolts-04.records.mic01", ["{node:, direction:}", "the number 7.5"]),
    (swap("lines: resonances", "lines: [1, 2]"), "update.lines", ["{list: [Hz, ...]}", "a list of 2"]),
    (swap("lines: resonances", "lines: resonance"), "update.lines", ["did you mean 'resonances'?"]),
    (swap("lines: resonances", "lines: {every: 0}"), "update.lines.every", ["at least 1"]),
    (swap("lines: resonances", "lines: {list: []}"), "update.lines.list", ["at least 1"]),
    (swap("initial: 4.0", "initial: automatic"), "parameters.left_edge.initial", ["auto", "'automatic'"]),
    (swap("frf/bolts-00.uff", "{file: a.csv, unit: g/N}"), "jobs.bolts-00.frf.unit", ["this key belongs to jobs.NAME.format.unit"]),
    (swap("frf/bolts-00.uff", "[{file: a.csv, format: {unit: 3}}]"), "jobs.bolts-00.frf[0].format.unit", ["put it in quotes"]),
    (swap("frf/bolts-00.uff", "a.csv, format: {delimiter: comma}"), "jobs.bolts-00.format.delimiter", ["';'", "the text 'comma'"]),
    *(
        (swap("frf/bolts-00.uff", f"a.csv, format: {{{key}: {value}}}"), f"jobs.bolts-00.format.{key}", [allowed])
        for key, value, allowed in (
            ("decimal", "';'", "','"),
            ("skip", "-1", "at least 0"),
            ("frequency_unit", "rpm", "'kHz'"),
            ("representation", "polar", "'real-imag'"),
            ("phase", "grad", "'rad'"),
            ("quantity", "force", "'pressure'"),
        )
    ),
    (swap("frf/bolts-00.uff", "a.csv, format: {columns: {a: [0, 1]}}"), "jobs.bolts-00.format.columns.a[0]", ["at least 1"]),
    (swap("frf/bolts-00.uff", "a.csv, format: {columns: {a: [1]}}"), "jobs.bolts-00.format.columns.a", ["exactly 2"]),
    (swap("frf/bolts-00.uff", "a.csv, format: {decimal: ',', delimiter: ','}"), "jobs.bolts-00.format.delimiter", ["the same"]),
    # ranges
    (swap("band: [20.0, 400]", "band: [400, 20]"), "reduction.band", ["lower below upper", "[400, 20]"]),
    (swap("band: [20.0, 400]", "band: [0, 400]"), "reduction.band", ["above 0 Hz"]),
    (swap("band: [20.0, 400]", "band: [20]"), "reduction.band", ["exactly 2", "found:    1"]),
    (swap("band: [20.0, 400]", "band: [1, 2, 3]"), "reduction.band", ["at most 2", "found:    3"]),
    (swap("tolerance: 1e-3", "held_out: 4"), "reduction.held_out", ["at least 5"]),
    (swap("bounds: [-1.0, 7.0]", "bounds: [7, -1]"), "parameters.left_edge.bounds", ["lower below upper"]),
    (swap("initial: 4.0", "initial: 8"), "parameters.left_edge.initial", ["between -1 and 7", "found:    8"]),
    (swap("initial: 0.0", "initial: 5"), "parameters.left_edge.damping.initial", ["between -3 and 4"]),
    (swap("[0.2, 0.7]", "[0.7, 0.2]"), "parameters.left_edge.select.box[1]", ["from at most to"]),
    (swap("[0.333333, 0.666667, 0.333333]", "[0.5, 0.5]"), "parameters.left_edge.smoothing", ["odd number", "found:    2"]),
    (swap("[0.333333, 0.666667, 0.333333]", "[0, 0, 0]"), "parameters.left_edge.smoothing", ["positive sum"]),
    (swap("{mic01: 1.02}", "{mic01: 0}"), "jobs.bolts-04.scale.mic01", ["other than 0"]),
    # forms
    (
        swap(", component: UZ", ""),
        "excitation.hammer",
        ["the key 'component' must be given too", "expected: {near:, component:}\n", "found:    {near:}"],
    ),
    (swap("component: UZ", "component: UZ, dof: 3"), "excitation.hammer", ["exactly one way", "{near:, component:, dof:}"]),
    (swap("matrix: rows.mtx, row: 1", "near: [0, 0, 0], component: UX, row: 1"), "responses.acc1", ["exactly one way"]),
    (swap("component: ROTY, box", "box"), "parameters.left_edge.select", ["{component:, box:}"]),
    (swap("near: [0.6, 0.5, 0.05]", "near: [0.6, 0.5]"), "responses.mic01.near", ["exactly 3", "found:    2"]),
    (swap("kind: stiffness", "kind: mass"), "parameters.left_edge.damping", ["kind is stiffness"]),
    (swap("kind: stiffness", "kind: spring"), "parameters.left_edge.kind", ["'stiffness', 'damping' or 'mass'"]),
    (
        swap("    smoothing: [0.333333, 0.666667, 0.333333]\n", "    normalised: true\n"),
        "parameters.left_edge.normalised",
        ["'normalised' needs smoothing"],
    ),
    # names
    (swap("  bolts-04:", "  bolts 04:"), "jobs.bolts 04", ["file name", "'bolts 04'"]),
    (swap("  bolts-04:", "  ../evil:"), "jobs.../evil", ["file name"]),
    (swap("  bolts-04:", "  .hidden:"), "jobs..hidden", ["file name"]),
    (swap("  bolts-04:", "  nul.uff:"), "jobs.nul.uff", ["Windows"]),
    (swap("  bolts-04:", "  ? ''\n  :"), "jobs.", ["an empty name"]),
    (swap("  bolts-04:", "  Bolts-00:"), "jobs.Bolts-00", ["case", "'bolts-00' and 'Bolts-00'"]),
    (swap("  bolts-04:", "  Report.html:"), "jobs.Report.html", ["name of a result file"]),
    (swap("  bolts-04:", f"  {'x' * 101}:"), f"jobs.{'x' * 101}", ["at most 100"]),
    # references
    (swap("reference: bolts-00", "reference: bolts-0"), "update.reference", ["no job", "did you mean"]),
    (swap("responses: [mic01, acc1]", "responses: [mic01, mic10]"), "update.responses[1]", ["no response", "did you mean 'mic01'?"]),
    (swap("responses: [mic01, acc1]", "responses: [mic01, mic01]"), "update.responses[1]", ["is given twice"]),
    (swap("responses: [mic01, acc1]", "responses: []"), "update.responses", ["at least 1"]),
    (swap("records: {mic01:", "records: {mic10:"), "jobs.bolts-04.records.mic10", ["no response"]),
    (swap("scale: {mic01:", "scale: {mic10:"), "jobs.bolts-04.scale.mic10", ["no response"]),
    (swap("scale: {mic01: 1.02}", "scale: {mic01: x}"), "jobs.bolts-04.scale.mic01", ["expected: a number"]),
    (swap("scale: {mic01: 1.02}", "scale: 0"), "jobs.bolts-04.scale", ["a factor of zero"]),
    (swap("scale: {mic01: 1.02}", "scale: [1, 2]"), "jobs.bolts-04.scale", ["one number for all responses, or by response"]),
    (swap("component: pres", "component: pres, excitation: hamer"), "responses.mic01.excitation", ["did you mean 'hammer'?"]),
    (swap("excitation:\n", "excitation:\n  second: {dof: 3}\n"), "responses.mic01", ["the excitation of this response", "second, hammer"]),
    (swap("  dofs: dofs.csv\n", ""), "excitation.hammer.near", ["DOF table", "model.dofs"]),
    (swap("alpha: 5.1357, beta: 2.554e-6", "alpha: 5.1357"), "parameters.left_edge.damping", ["beta"]),
]


@pytest.mark.parametrize(("text", "path", "parts"), CASES, ids=[case[1] for case in CASES])
def test_messages(fails, tmp_path: Path, text: str, path: str, parts: list[str]) -> None:  # type: ignore[no-untyped-def]
    error = fails(text)
    assert error.file == str(tmp_path / "campaign.yaml")
    line, _, found = error.place.partition(", ")
    assert found == path
    assert line.startswith("line ")
    last = path.rsplit(".", 1)[-1].split("[")[0]
    if last and "is missing" not in error.message and f"{last}:" in text:
        assert f"{last}:" in text.splitlines()[int(line[5:]) - 1]
    for part in parts:
        assert part in error.message
    assert "pydantic" not in error.message
    assert "Input should" not in error.message


@pytest.mark.parametrize("kind", ["mass", "damping"])
@pytest.mark.parametrize("key", ["initial", "bounds"])
def test_auto_serves_stiffness_only(fails, kind: str, key: str) -> None:  # type: ignore[no-untyped-def]
    text = swap("kind: stiffness", f"kind: {kind}").replace("    damping: {initial: 0.0, bounds: [-3.0, 4.0]}\n", "")
    value = {"initial": "4.0", "bounds": "[-1.0, 7.0]"}[key]
    error = fails(text.replace(f"{key}: {value}", f"{key}: auto"))
    assert f"parameters.left_edge.{key}" in error.message
    assert f"this group is {kind}" in error.message


def test_several_problems_are_told_at_once(fails) -> None:  # type: ignore[no-untyped-def]
    text = swap("method: bfgs", "method: bfg").replace("bolts: bolts.csv", "blots: bolts.csv").replace("tolerance: 1e-3", "tolerance: 2")
    error = fails(text)
    assert error.place.endswith("blots")
    assert "did you mean 'bolts'?" in error.message
    assert f"line {line_of(text, '  method')}, update.method" in error.message
    assert "reduction.tolerance" in error.message


def test_formats_are_those_of_the_readers() -> None:
    from typing import get_args

    matrices = pytest.importorskip("lrbc_cli.io.matrices.read")
    assert set(get_args(MatrixFormat)) == set(matrices.FORMATS)


def test_text_formats_are_those_of_the_reader(write) -> None:  # type: ignore[no-untyped-def]
    layouts = pytest.importorskip("lrbc_cli.io.layout")
    text = swap("frf/bolts-00.uff", "a.csv, format: {delimiter: tab, decimal: ',', frequency: f, unit: g/N, columns: {acc 1: [2, im]}}")
    layout = load_campaign(write(text)).jobs["bolts-00"].format
    assert layout is not None
    read = layouts.TextLayout(**layout.model_dump())
    assert (read.delimiter, read.decimal, read.frequency, read.columns) == ("\t", ",", "f", {"acc 1": (2, "im")})
    assert set(vars(read)) == set(type(layout).model_fields)


def values() -> st.SearchStrategy[object]:
    scalars = st.one_of(
        st.none(), st.booleans(), st.integers(), st.floats(), st.text(max_size=8), st.sampled_from(["auto", "mic01", "all", "a.h5#K", "no"])
    )
    keys = st.one_of(
        st.sampled_from(["near", "component", "file", "alpha", "every", "list", "node", "direction", "x"]), st.text(max_size=5)
    )
    return st.recursive(scalars, lambda inner: st.lists(inner, max_size=3) | st.dictionaries(keys, inner, max_size=3), max_leaves=6)


def paths(value: object, prefix: tuple[str | int, ...] = ()) -> list[tuple[str | int, ...]]:
    below = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    return [prefix] * bool(prefix) + [path for key, item in below for path in paths(item, (*prefix, key))]


TREE = yaml.safe_load(VALID.replace("1e-3", "0.001").replace("2.554e-6", "0.000002"))


def refusal(path: Path, *overrides: str) -> ConfigError | None:
    try:
        campaign = load_campaign(path, overrides)
    except ConfigError as error:
        return error
    json.dumps(campaign.resolved(), allow_nan=False)
    return None


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow], deadline=None)
@given(path=st.sampled_from(paths(TREE)), value=values())
def test_any_value_anywhere_is_accepted_or_refused_with_its_place(write, path: tuple[str | int, ...], value: object) -> None:  # type: ignore[no-untyped-def]
    tree = json.loads(json.dumps(TREE))
    inner = tree
    for key in path[:-1]:
        inner = inner[key]
    inner[path[-1]] = value
    file = write(yaml.safe_dump(tree, allow_unicode=True))
    error = refusal(file)
    assert error is None or (error.file == str(file) and error.place.startswith("line ") and len(error.message) < 4000)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow], deadline=None)
@given(st.binary(max_size=60), st.integers(0, len(VALID)), st.integers(0, 30))
def test_damaged_files_are_refused(write, junk: bytes, start: int, length: int) -> None:  # type: ignore[no-untyped-def]
    content = VALID.encode()
    error = refusal(write(content[:start] + junk + content[start + length :]))
    assert error is None or error.file


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow], deadline=None)
@given(st.text(max_size=40) | st.sampled_from([".".join(map(str, path)) for path in paths(TREE)]), st.text(max_size=20))
def test_any_override_is_accepted_or_refused(write, key: str, value: str) -> None:  # type: ignore[no-untyped-def]
    error = refusal(write(VALID), f"{key}={value}")
    assert error is None or error.place


@pytest.mark.parametrize(("written", "factors"), [("{mic01: 1.02}", (1.02, 1.0)), ("2.5", (2.5, 2.5))])
def test_factors_on_measured_frfs(tmp_path: Path, written: str, factors: tuple[float, float]) -> None:
    path = tmp_path / "campaign.yaml"
    path.write_text(swap("scale: {mic01: 1.02}", f"scale: {written}"), encoding="utf-8")
    job = load_campaign(path).jobs["bolts-04"]
    assert (job.factor("mic01"), job.factor("acc1")) == factors
