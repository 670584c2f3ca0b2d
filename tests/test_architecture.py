"""The plan of the rooms: imports run downward only, numerics know no files, no module grows without end."""

from __future__ import annotations

import ast
import subprocess
import sys
from functools import cache
from graphlib import TopologicalSorter
from itertools import pairwise
from pathlib import Path

import pytest

import lrbc_cli

ROOT = Path(lrbc_cli.__file__).parent

#: Modules below all rooms.
BASE = {"arrays", "remembered", "version"}

#: Rooms that each room may import from, besides itself and those of ``BASE``.
ALLOWED = {
    "arrays": set(),
    "remembered": set(),
    "version": set(),
    "errors": set(),
    "model": {"errors"},
    "io": {"errors", "model"},
    "config": {"errors", "model"},
    "reduction": {"errors", "model"},
    "updating": {"errors", "model", "reduction"},
    "results": {"errors", "io", "updating"},
    "method": {"errors", "config", "updating"},
    "report": {"errors", "io", "updating", "results"},
    "campaign": {"errors", "model", "io", "config", "reduction", "updating", "results", "method"},
    "virtual": {"errors", "model", "io", "config", "reduction", "updating", "results", "campaign"},
    "watch": {"errors", "io", "config", "updating", "results", "campaign", "report"},
    "guide": {"config"},
    "given": {"errors"},
    "matrices": {"errors", "given", "model", "reduction", "updating"},
    "identified": {"errors", "given", "updating", "results", "campaign"},
    "modelled": {"given", "model", "reduction", "campaign"},
    "study": {"given", "config", "updating", "results", "method", "campaign", "virtual", "identified", "modelled"},
    "cli": {
        "errors",
        "model",
        "io",
        "config",
        "reduction",
        "updating",
        "results",
        "campaign",
        "virtual",
        "report",
        "watch",
        "guide",
        "study",
    },
    "__main__": {"cli"},
}

#: Sub-rooms that each sub-room of the numerics may import from, besides itself and the modules that stand in the room.
ALLOWED_PARTS = {
    "reduction/solve": set(),
    "reduction/reduced": set(),
    "reduction/problem": {"solve", "reduced"},
    "reduction/steps": {"solve", "reduced", "problem"},
    "updating/comparison": set(),
    "updating/statistics": set(),
    "updating/unknowns": {"statistics"},
    "updating/misfit": {"statistics"},
    "updating/search": {"statistics", "unknowns", "misfit"},
    "updating/posterior": {"statistics", "unknowns", "misfit", "search"},
    "updating/judging": {"unknowns", "posterior"},
    "updating/calibration": {"statistics", "misfit", "search", "posterior"},
}

#: Packages that only some rooms may know.
NO_FILES = {"yaml", "h5py", "click", "matplotlib", "pydantic", "pyuff", "platformdirs"}
FORBIDDEN = {
    "arrays": NO_FILES | {"scipy"},
    "remembered": NO_FILES | {"numpy", "scipy"},
    "version": NO_FILES | {"numpy", "scipy"},
    "errors": NO_FILES | {"numpy", "scipy"},
    "model": NO_FILES,
    "reduction": NO_FILES,
    "updating": NO_FILES,
    "io": {"yaml", "click", "matplotlib", "pydantic"},
    "config": {"h5py", "click", "matplotlib", "scipy"},
    "method": NO_FILES,
    "results": {"yaml", "h5py", "click", "matplotlib", "scipy"},
    "campaign": {"yaml", "click", "matplotlib"},
    "virtual": {"yaml", "h5py", "click", "matplotlib", "pydantic"},
    "report": {"yaml", "h5py", "click", "pydantic"},
    "watch": NO_FILES | {"scipy"},
    "guide": NO_FILES | {"numpy", "scipy"},
    "given": NO_FILES,
    "matrices": NO_FILES,
    "identified": {"yaml", "h5py", "click", "pydantic"},
    "modelled": {"yaml", "h5py", "click", "pydantic", "matplotlib"},
    "study": {"yaml", "h5py", "click", "pydantic", "matplotlib"},
    "cli": {"yaml", "h5py", "matplotlib", "pydantic", "numpy", "scipy"},
    "__main__": NO_FILES | {"numpy", "scipy"},
}

LONGEST = 450

#: Lines of a function, and how many functions may have more; positional arguments, ``self`` not counted.
LONGEST_FUNCTION, MOST_LONG_FUNCTIONS, MOST_ARGUMENTS = 60, 5, 7

#: Fields of a record that may be built by position; fewer if neighbours have the same type, unless they are a point, a line or a unit.
MOST_FIELDS, MOST_ALIKE = 5, 3
BY_POSITION = {"Curve", "Unit", "UnitSystem", "Known", "Area", "Axis", "Note", "Saturation"}

#: Modules in one folder; `cli` may have more: one a command.
WIDEST, UNDIVIDED = 13, {"cli"}

MODULES = sorted(ROOT.rglob("*.py"))


def name_of(path: Path) -> str:
    parts = ("lrbc_cli", *path.relative_to(ROOT).with_suffix("").parts)
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def room_of(module: str) -> str | None:
    parts = module.split(".")
    return parts[1] if parts[0] == "lrbc_cli" and len(parts) > 1 else None


@cache
def tree_of(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


@cache
def imports_of(path: Path) -> set[str]:
    """Every imported module, also inside functions and under TYPE_CHECKING, relative ones resolved."""
    module = name_of(path)
    package = module if path.name == "__init__.py" else module.rpartition(".")[0]
    found = set()
    for node in ast.walk(tree_of(path)):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                base = ".".join([*package.split(".")[: len(package.split(".")) - node.level + 1], *([base] if base else [])])
            # ``from lrbc_cli import campaign`` imports a room, ``from lrbc_cli.io import x`` perhaps a module.
            found |= {base} | {f"{base}.{alias.name}" for alias in node.names if base.startswith("lrbc_cli")}
    return found


def modules(path: Path):
    return pytest.param(path, id=name_of(path))


@pytest.mark.parametrize("path", [modules(p) for p in MODULES if room_of(name_of(p))])
def test_imports_run_downward_only(path):
    room = room_of(name_of(path))
    rooms = {room_of(name) for name in imports_of(path)} - {None, room} - BASE
    assert rooms <= ALLOWED[room], f"{name_of(path)} may not import from {sorted(rooms - ALLOWED[room])}"


@pytest.mark.parametrize("path", [modules(p) for p in MODULES if room_of(name_of(p))])
def test_rooms_know_only_their_packages(path):
    packages = {name.partition(".")[0] for name in imports_of(path)}
    assert not packages & FORBIDDEN[room_of(name_of(path))]


@pytest.mark.parametrize("path", [modules(p) for p in MODULES])
def test_no_module_is_too_long(path):
    assert len(path.read_text(encoding="utf-8").splitlines()) <= LONGEST


def functions(path: Path):
    """All functions of a module, and whether their first argument is ``self`` or ``cls``."""
    tree = tree_of(path)
    methods = {
        part
        for node in ast.walk(tree)
        if isinstance(node, ast.ClassDef)
        for part in node.body
        if isinstance(part, ast.FunctionDef) and "staticmethod" not in map(ast.unparse, part.decorator_list)
    }
    return [(node, node in methods) for node in ast.walk(tree) if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)]


def test_warnings_are_not_caught_where_threads_run():
    """``warnings.catch_warnings`` changes the filters of the whole process: of two threads, one restores them under the other."""
    alone = {"lrbc_cli.report.drawing.png", "lrbc_cli.io.matrices.columns"}
    assert {name_of(path) for path in MODULES if "catch_warnings" in path.read_text()} == alone


def test_few_functions_are_long():
    """From the ``def`` to the last line, docstring included."""
    found = {
        f"{name_of(path)}.{node.name}": node.end_lineno - node.lineno + 1
        for path in MODULES
        for node, _ in functions(path)
        if node.end_lineno - node.lineno >= LONGEST_FUNCTION
    }
    assert len(found) <= MOST_LONG_FUNCTIONS, found


def test_no_function_has_many_positional_arguments():
    found = {
        f"{name_of(path)}.{node.name}": count
        for path in MODULES
        for node, bound in functions(path)
        if (count := len(node.args.posonlyargs) + len(node.args.args) - bound) > MOST_ARGUMENTS
    }
    assert not found


def test_records_of_many_fields_are_built_by_keyword():
    found = []
    for path in MODULES:
        for node in (node for node in ast.walk(tree_of(path)) if isinstance(node, ast.ClassDef)):
            decorators = [text for text in map(ast.unparse, node.decorator_list) if text.split("(")[0].endswith("dataclass")]
            fields = [part for part in node.body if isinstance(part, ast.AnnAssign) and "ClassVar" not in ast.unparse(part.annotation)]
            types = [ast.unparse(part.annotation) for part in fields if part.value is None or "init=False" not in ast.unparse(part.value)]
            alike = node.name not in BY_POSITION and any(one == other for one, other in pairwise(types))
            if decorators and len(fields) > (MOST_ALIKE if alike else MOST_FIELDS) and "kw_only=True" not in decorators[0]:
                found.append(f"{name_of(path)}.{node.name}")
    assert not found


def test_every_class_has_a_name_of_its_own():
    found: dict[str, list[str]] = {}
    for path in MODULES:
        for node in ast.walk(tree_of(path)):
            if isinstance(node, ast.ClassDef):
                found.setdefault(node.name, []).append(name_of(path))
    assert not {name: where for name, where in found.items() if len(where) > 1}


def test_no_folder_is_too_wide():
    folders = [path for path in (ROOT, *ROOT.rglob("*")) if path.is_dir() and path.name not in UNDIVIDED]
    assert {str(path): count for path in folders if (count := len(list(path.glob("*.py")))) > WIDEST} == {}


def parts_of(room: str) -> dict[str, set[str]]:
    """Sub-rooms of a room and the modules that stand in the room itself, and which of the others each imports from."""
    found: dict[str, set[str]] = {}
    for path in (ROOT / room).rglob("*.py"):
        part = path.relative_to(ROOT / room).parts[0].removesuffix(".py")
        names = {name.split(".")[2] for name in imports_of(path) if name.startswith(f"lrbc_cli.{room}.")}
        found.setdefault(part, set()).update(names - {part})
    return {part: names & set(found) for part, names in found.items()}


def sub_rooms_of(room: str) -> dict[str, set[str]]:
    """The sub-rooms alone."""
    folders = {path.name for path in (ROOT / room).iterdir() if path.is_dir()}
    return {part: others & folders for part, others in parts_of(room).items() if part in folders}


ROOMS = sorted(path.name for path in ROOT.iterdir() if (path / "__init__.py").is_file())


@pytest.mark.parametrize("room", ROOMS)
def test_parts_of_a_room_have_no_circle(room):
    """Sub-rooms import each other in one direction, and what stands beside them is above them or below, never both."""
    assert tuple(TopologicalSorter(parts_of(room)).static_order())


@pytest.mark.parametrize("room", ["reduction", "updating"])
def test_sub_rooms_import_as_planned(room):
    found = {f"{room}/{part}": others for part, others in sub_rooms_of(room).items()}
    assert set(found) == {part for part in ALLOWED_PARTS if part.startswith(f"{room}/")}
    assert not {part: others - ALLOWED_PARTS[part] for part, others in found.items() if others - ALLOWED_PARTS[part]}


def test_the_writer_of_results_only_writes():
    """What identifies, judges and compares stands before it, in steps of its own."""
    known = imports_of(ROOT / "campaign" / "jobs" / "results.py")
    computing = (
        "lrbc_cli.updating",
        "lrbc_cli.campaign.identification",
        "lrbc_cli.campaign.jobs.judging",
        "lrbc_cli.campaign.updated.shapes",
    )
    assert not [name for name in known if name.startswith(computing)]


def test_every_room_is_in_the_plan():
    assert {room_of(name_of(path)) for path in MODULES} - {None} == set(ALLOWED)


def test_the_import_graph_has_no_cycle():
    known = {name_of(path) for path in MODULES}
    graph = {}
    for path in MODULES:
        names = set()
        for node in ast.walk(tree_of(path)):
            if isinstance(node, ast.Import):
                names |= {alias.name for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and (node.module or "").startswith("lrbc_cli"):
                # ``from room import module`` needs that module, not what else stands in the room's __init__.
                whole = [f"{node.module}.{alias.name}" for alias in node.names]
                names |= {name if name in known else node.module for name in whole}
        module = name_of(path)
        graph[module] = (names & known) - {module}

    state: dict[str, int] = {}

    def visit(module: str, trail: tuple[str, ...]) -> None:
        if state.get(module) == 2:
            return
        assert state.get(module) != 1, f"cycle: {' -> '.join([*trail, module])}"
        state[module] = 1
        for other in sorted(graph[module]):
            visit(other, (*trail, module))
        state[module] = 2

    for module in sorted(graph):
        visit(module, ())


def test_numerics_load_no_file_library():
    """What the import graph says, seen at run time: SciPy brings none of them in either."""
    code = "import sys, lrbc_cli.updating.search.levels, lrbc_cli.reduction.build; print(*sorted(m for m in sys.modules if '.' not in m))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert not set(done.stdout.split()) & NO_FILES
