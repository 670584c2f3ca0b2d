"""Numbers that decide a verdict are fields of the statistical model or of the decision rule; none lies about in a module."""

from __future__ import annotations

import ast
import hashlib
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from functools import cache
from pathlib import Path

import pytest

import lrbc_cli
from lrbc_cli.campaign.numbers import NUMBERS
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
    "versions and names": {
        *("FORMAT_VERSION", "CALIBRATION_VERSION", "RESULT_FORMAT", "RESULT_VERSION", "EVIDENCE_FORMAT"),
        *("IDENTIFICATION_VERSION", "JUDGEMENT_VERSION"),
    },
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
        *("MOST_LEFT", "COARSE", "MOST_WORK", "UNLIKE", "LARGEST_LOG10"),
        *("CLEARLY", "REAL", "LEAST_ALIKE", "MOST_STATES", "NEAREST", "MOST_OFF", "MORE", "PROMINENCE", "_FURTHER", "USUAL"),
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
    "how much a process remembers": {"_modes", "_files", "MOST_KEPT"},
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


#: Rooms and modules whose numbers belong to a stage; what judges is no part of identifying.
JUDGING = (
    *(f"updating/judging/{name}.py" for name in ("decide", "rule", "clearance")),
    "updating/normal.py",
    "campaign/jobs/judging.py",
)
STAGES = {
    "reduction": ("model", "reduction"),
    "identification": ("updating", "campaign/reading", "campaign/identification", "campaign/calibrate.py", "campaign/jobs/evidence.py"),
    "judgement": JUDGING,
}


def modules_of(stage: str) -> list[Path]:
    """Where the numbers of a stage stand."""
    found = [path for name in STAGES[stage] for path in ([ROOT / name] if name.endswith(".py") else sorted((ROOT / name).rglob("*.py")))]
    return found if stage == "judgement" else [path for path in found if path.relative_to(ROOT).as_posix() not in JUDGING]


def numbers(node: ast.AST) -> Iterator[str]:
    """Numbers and operators in their order, without annotations, decorators and formatted text."""
    if isinstance(node, ast.Constant):
        if isinstance(node.value, bool | int | float | complex):
            yield repr(node.value)
    elif isinstance(node, ast.operator | ast.unaryop | ast.cmpop | ast.boolop):
        yield type(node).__name__
    elif not isinstance(node, ast.JoinedStr):
        for name, value in ast.iter_fields(node):
            if name not in ("annotation", "returns", "decorator_list"):
                for part in value if isinstance(value, list) else [value]:
                    if isinstance(part, ast.AST):
                        yield from numbers(part)


def digest_of(sources: list[str]) -> str:
    """Of the numbers in sources, wherever in them a function or a constant stands."""
    found = sorted(" ".join(numbers(statement)) for source in sources for statement in ast.parse(source).body)
    return hashlib.sha256("\n".join(line for line in found if line).encode()).hexdigest()[:16]


SOURCE = "A, B = 0.5, 3\n\n\ndef f(x: float = 1 / 3) -> float:\n    return x if x < 2 else -x\n"


@pytest.mark.parametrize(
    "same",
    [
        SOURCE.replace("return", "# A comment.\n    return"),
        SOURCE.replace("    return", "    'Words about 7.'\n    return"),
        SOURCE.replace("x: float", "x: float | None").replace("f(", "g("),
        SOURCE.replace("    return", "    print(f'{2 * x:.3f}')\n    return"),
        "\n".join(reversed(SOURCE.split("\n\n\n"))),
    ],
)
def test_words_and_places_are_no_numbers(same):
    assert digest_of([same]) == digest_of([SOURCE])


@pytest.mark.parametrize(
    "other",
    [
        SOURCE.replace(*each)
        for each in (("0.5", "0.6"), ("0.5, 3", "3, 0.5"), ("1 / 3", "1 * 3"), ("1 / 3", "1"), ("<", "<="), ("-x", "x"), ("< 2", "< 2.0"))
    ],
)
def test_every_number_counts(other):
    assert digest_of([other]) != digest_of([SOURCE])


def test_results_rest_on_the_numbers_that_the_code_has():
    found = {stage: digest_of([path.read_text(encoding="utf-8") for path in modules_of(stage)]) for stage in STAGES}
    assert found == NUMBERS, (
        "numbers or operators changed in the code, and what was found with the others would be kept as if nothing had; "
        f"write into lrbc_cli/campaign/numbers.py, which makes that out of date: NUMBERS = {found}"
    )


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
