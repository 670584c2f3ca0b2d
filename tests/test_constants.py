"""Numbers that decide a verdict are fields of the statistical model or of the decision rule; none lies about in a module."""

from __future__ import annotations

import ast
import py_compile
import shutil
import zipfile
from dataclasses import fields, is_dataclass
from functools import cache
from pathlib import Path

import pytest

import lrbc_cli
from lrbc_cli.campaign import digests
from lrbc_cli.campaign.digests import STAGES, code, of_stage
from lrbc_cli.updating.statistics.model import STATISTICS

ROOT = Path(lrbc_cli.__file__).parent
ROOMS = ("updating", "campaign", "method", "config")

#: Numeric constants of modules that cannot decide a verdict, and why.
ALLOWED = {
    "mathematics or a unit": {
        *("NORMAL_95", "CHI2_95", "DB", "KELVIN", "GB", "MILLIMETRES"),
        *("GRAVITY", "POUND_FORCE", "INCH", "FOOT", "PSI", "GRAVITIES", "MEDIAN_SPREAD", "DEVIATION", "STUDENT"),
        *("DENSITIES", "MASSES", "MODULI", "STIFFNESSES", "STEEL"),
    },
    "rounding only": {"_ROUNDING", "ROUND_OFF", "LEAST_ETA", "SLOPE_STEP", "ROUNDING", "LEAST_CHANGE", "HELD"},
    "text and figures for readers only: correlation of FRFs, names in a sentence": {
        *("MOST_NAMES", "PROMINENCE_DB", "TOLERANCE", "SIMILARITY"),
    },
    "warnings and refusals of input that is in doubt: units, bands, places": {
        *("PARTS", "LEAST_LINES", "LEAST_OFFSET", "LEFT", "LEAST_REACH", "MOST_REACH", "BETTER", "POWERS", "ALIKE", "TURNED"),
        *("LATE", "LATER", "DELAY_LINES", "MOST_PLACES", "MOST_HITS", "MOST_NAMED", "_MOST_NODES", "_NODES"),
        *(
            "PLAUSIBLE",
            "FAR_ABOVE_NOISE",
            "LARGE_MISFIT",
            "LEAST_BAND",
            "SHOWN",
            "EVIDENT_HALVES",
            "LARGEST_SHARE",
            "FASTEST",
            "EVIDENT",
            "BEYOND",
        ),
        *("LEAST_DOFS", "MOST_FILLED", "ENTRIES", "FAR", "NEARER", "AT_NODE", "CLEARLY_NEARER", "EXCHANGES", "FEW", "MANY", "LARGE_LOSS"),
        *("_DIGITS", "EXCHANGED", "LEAST_DIFFERENCE", "ALONE", "OTHER_LEVEL_DB", "_EXCHANGES"),
        *("MOST_LEFT", "COARSE", "MOST_WORK", "BUILT_WORK", "EXPLAINED", "FEWEST", "UNLIKE", "LARGEST_LOG10"),
        *("CLEARLY", "REAL", "LEAST_ALIKE", "MOST_STATES", "MOST_OFF", "MORE", "_FURTHER", "USUAL", "LOST", "KEPT"),
        *("MIN_BAND", "FAR_ABOVE", "MAX_LINES", "MAX_LOG10", "SLOWEST", "LIGHTEST", "HEAVIEST", "PENALTY", "LEAST_USED", "MIN_COHERENCE"),
        *(
            "RATES",
            "NEAR",
            "CLEAR",
            "ANY_LEVEL_DB",
            "_SOFTER",
            "_NEARER",
            "_AS_MUCH",
            "_ALIKE",
            "_LEAST_LEVEL",
            "_OFF_LEVEL",
            "_LOW",
            "_ENOUGH",
            "MOSTLY",
            "FARTHER",
        ),
    },
    "campaign files that are drafted from what is there, lists in messages, the picture": {
        *("ASSUMED_RATIO", "MOST_FILES", "_MOST", "MOST", "_CHUNK", "DIGITS", "_DIVISIONS", "_BESIDE"),
    },
    "how much a process remembers": {"_modes", "_files", "_known", "MOST_KEPT"},
    "where a search begins; what it finds is judged by its cost": {"LEVELS"},
    "figures of `lrbc plan`, before anything is judged": {
        *("LOSSES", "LOSS", "SIGMA_DB", "FACTOR", "RANGE_DB", "DETECTABLE", "HIDDEN", "LINES", "NOISE_SHARE"),
        *("MOST_DETUNED", "LEAST_DETUNED", "MOST_WORKERS", "REHEARSALS", "DRAWS", "REFERENCES"),
    },
    "the campaign file: its limits, and what its short forms stand for": {
        "ANYWHERE",
        "DIRECTIONS",
        "FORM_DEFAULTS",
        "MAX_BYTES",
        "MAX_NODES",
        "MAX_DEPTH",
        "MAX_DIGITS",
        "NAME_LENGTH",
    },
}


def numeric(node: ast.expr) -> bool:
    """Whether a number is part of a value."""
    if isinstance(node, ast.Constant):
        return isinstance(node.value, int | float) and not isinstance(node.value, bool)
    if isinstance(node, ast.Dict):
        return any(numeric(value) for value in node.values)
    inner = {ast.UnaryOp: ("operand",), ast.BinOp: ("left", "right"), ast.Call: ("args",), ast.Tuple: ("elts",), ast.List: ("elts",)}
    values = [getattr(node, name) for name in inner.get(type(node), ())]
    return any(numeric(part) for value in values for part in (value if isinstance(value, list) else [value]))


def constants(source: str) -> list[str]:
    """Names of the numeric constants of a module."""
    found = []
    for node in ast.parse(source).body:
        if isinstance(node, ast.Assign | ast.AnnAssign) and node.value is not None and numeric(node.value):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            found += [name.id for target in targets for name in ast.walk(target) if isinstance(name, ast.Name)]
    return found


def test_what_counts_as_a_numeric_constant():
    source = "A = 1.0\nB, C = 2, -3\nD: float = 1 / 3\nE = (4, 5)\nF = float(f(6))\nG = {'a': 7}\nH = 'text'\nI = True\ndef f(x=1): ...\n"
    assert constants(source) == ["A", "B", "C", "D", "E", "F", "G"]


def test_no_number_that_decides_a_verdict_lies_in_a_module():
    allowed = set().union(*ALLOWED.values())
    found = {
        name: path.relative_to(ROOT)
        for room in ROOMS
        for path in sorted((ROOT / room).rglob("*.py"))
        for name in constants(path.read_text(encoding="utf-8"))
    }
    assert not {name: str(path) for name, path in found.items() if name not in allowed}


#: Modules on which results rest, and where they are used; what reads, converts or judges must belong to a stage.
NUMERIC = (
    *("model", "reduction", "updating", "io", "method"),
    *("campaign/reading", "campaign/identification", "campaign/reduced", "config/settings.py", "config/structure.py"),
)


def numeric_module(name: str) -> bool:
    return name in NUMERIC or name.startswith(tuple(f"{part}/" for part in NUMERIC))


def test_all_code_that_computes_belongs_to_one_stage():
    names = [path.relative_to(ROOT).as_posix() for path in ROOT.rglob("*.py")]
    found = {name: [stage for stage in STAGES if of_stage(stage, name)] for name in names}
    assert not {name: own for name, own in found.items() if len(own) > 1 or (numeric_module(name) and not own)}
    parts = {part for own in STAGES.values() for part in own}
    assert not {part for part in parts if not (ROOT / part).exists()}
    judging = {name for name in names if name.startswith("updating/judging/")}
    left = {f"updating/judging/{name}.py" for name in ("evidence", "reference")}
    assert {name for name in judging if found[name] != ["judgement"]} == left
    assert found["updating/posterior/fit.py"] == found["io/frf.py"] == ["identification"]
    assert found["reduction/build.py"] == ["reduction"]
    assert not found["report/page.py"]


@pytest.fixture
def package(tmp_path, monkeypatch):
    """A copy of some modules, as it is installed there, and a function for the digests of its stages."""
    for name in ("model/fem.py", "updating/judging/decide.py", "updating/posterior/fit.py", "report/page.py", "io/frf.py"):
        (tmp_path / "lrbc_cli" / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / name, tmp_path / "lrbc_cli" / name)

    def found(root=None):
        monkeypatch.setattr(digests, "files", lambda _: root or tmp_path / "lrbc_cli")
        digests.code.cache_clear()
        digests._modules.cache_clear()
        return {stage: code(stage) for stage in STAGES}

    yield found
    monkeypatch.undo()
    digests.code.cache_clear()
    digests._modules.cache_clear()


@pytest.mark.parametrize(
    ("name", "stages"),
    [
        ("model/fem.py", {"reduction"}),
        ("updating/posterior/fit.py", {"identification"}),
        ("io/frf.py", {"identification"}),
        ("updating/judging/decide.py", {"judgement"}),
        ("report/page.py", set()),
    ],
)
def test_a_change_of_the_code_changes_its_stage(package, tmp_path, name, stages):
    before, file = package(), tmp_path / "lrbc_cli" / name
    # Line ends of a checkout are no change.
    file.write_bytes(file.read_bytes().replace(b"\n", b"\r\n"))
    assert package() == before
    file.write_text(file.read_text(encoding="utf-8") + "\nX = 1.0\n", encoding="utf-8")
    after = package()
    assert {stage for stage in STAGES if after[stage] != before[stage]} == stages


def test_archives_and_packages_without_sources_have_digests_too(package, tmp_path):
    before, root = package(), tmp_path / "lrbc_cli"
    archive = shutil.make_archive(str(tmp_path / "packed"), "zip", tmp_path, "lrbc_cli")
    assert package(zipfile.Path(archive, "lrbc_cli/")) == before
    for path in root.rglob("*.py"):
        py_compile.compile(str(path), str(path.with_suffix(".pyc")))
        path.unlink()
    without = package()
    assert len({*without.values(), *before.values()}) == 6
    (root / "model" / "fem.pyc").unlink()
    assert package()["reduction"] != without["reduction"]
    assert package()["judgement"] == without["judgement"]


@cache
def attributes() -> set[str]:
    """Names of all attributes that are read anywhere."""
    trees = [ast.parse(path.read_text(encoding="utf-8")) for path in ROOT.rglob("*.py")]
    return {node.attr for tree in trees for node in ast.walk(tree) if isinstance(node, ast.Attribute)}


@pytest.mark.parametrize("part", [field.name for field in fields(STATISTICS)])
def test_every_number_of_the_statistical_model_is_used_and_has_a_source(part):
    value = getattr(STATISTICS, part)
    assert is_dataclass(value)
    read, text = attributes(), type(value).__doc__ or ""
    for field in fields(value):
        assert field.name in read, f"nothing reads {field.name}"
        assert field.name in text, f"{field.name} is not documented"
