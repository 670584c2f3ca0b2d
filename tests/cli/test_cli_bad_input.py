"""Bad input: one message that names file, place, what was expected and found; the exit code; nothing else is touched."""

from __future__ import annotations

import gzip
import re
import shutil
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
import scipy.io
import scipy.sparse as sp
from campaigns import Folder, Result

from lrbc_cli.io.frf import read_frf, write_frf
from lrbc_cli.model.frf import FrfRecord, FrfSet

Damage = Callable[[Folder], None]


def on_file(name: str, change: Callable[[bytes], bytes]) -> Damage:
    """Change the bytes of one input file."""

    def damage(folder: Folder) -> None:
        path = folder.data / name
        path.write_bytes(change(path.read_bytes()))

    return damage


def substitute(name: str, pattern: str, text: str, count: int = 1) -> Damage:
    """Replace what a pattern matches; it must match."""

    def change(content: bytes) -> bytes:
        new, found = re.subn(pattern.encode(), text.encode(), content, count=count, flags=re.MULTILINE)
        assert found, pattern
        return new

    return on_file(name, change)


def remove(name: str) -> Damage:
    return lambda folder: (folder.data / name).unlink()


def empty(name: str) -> Damage:
    return on_file(name, lambda _: b"")


def garbage(name: str) -> Damage:
    return on_file(name, lambda content: np.random.default_rng(1).bytes(len(content)))


def truncated(name: str) -> Damage:
    return on_file(name, lambda content: content[: len(content) // 2])


def directory(name: str) -> Damage:
    def damage(folder: Folder) -> None:
        (folder.data / name).unlink()
        (folder.data / name).mkdir()

    return damage


def gzipped(name: str, pattern: str, text: str) -> Damage:
    return on_file(
        name, lambda content: gzip.compress(re.sub(pattern.encode(), text.encode(), gzip.decompress(content), count=1, flags=re.M))
    )


def matrix(name: str, make: Callable[[sp.coo_array], object]) -> Damage:
    """Replace a Matrix Market file by what a function makes of it."""

    def damage(folder: Folder) -> None:
        path = folder.data / name
        scipy.io.mmwrite(path, make(sp.coo_array(scipy.io.mmread(path, spmatrix=False))), symmetry="general", precision=17)

    return damage


def config(old: str, new: str) -> Damage:
    return lambda folder: folder.replace(old, new)


def records(name: str, change: Callable[[list[FrfRecord]], list[FrfRecord]]) -> Damage:
    """Write the FRFs anew after a change."""

    def damage(folder: Folder) -> None:
        path = folder.data / name
        write_frf(path, FrfSet(source=name, records=tuple(change(list(read_frf(path).records)))))

    return damage


def outside(name: str) -> Damage:
    return records(name, lambda found: [replace(r, frequency_hz=r.frequency_hz + 2000) for r in found])


def doubled(name: str) -> Damage:
    return records(name, lambda found: [found[0], found[0], *found[1:]])


def zeroed(name: str) -> Damage:
    return records(name, lambda found: [replace(r, values=0 * r.values) if r.name == "mic2" else r for r in found])


@dataclass(frozen=True)
class Case:
    """A damage, and what the message must say."""

    what: str
    damage: Damage
    code: int
    parts: tuple[str, ...]
    commands: tuple[str, ...] = ("check",)

    def __str__(self) -> str:
        return self.what


MODEL = [
    Case("no stiffness", remove("K.mtx"), 3, ("K.mtx", "does not exist", "fix:"), ("check", "reduce", "update", "simulate")),
    Case("empty stiffness", empty("K.mtx"), 3, ("K.mtx", "empty", "0 bytes")),
    Case("folder for stiffness", directory("K.mtx"), 3, ("K.mtx", "not a file", "a folder")),
    Case("garbage stiffness", garbage("K.mtx"), 3, ("K.mtx", "expected:", "found:")),
    Case("truncated stiffness", truncated("K.mtx"), 3, ("K.mtx", "expected:", "found:", "fix:"), ("check", "reduce")),
    Case("text for stiffness", on_file("K.mtx", lambda _: b"hello\n"), 3, ("K.mtx", "expected:", "found:")),
    Case("no mass", remove("M.mtx"), 3, ("M.mtx", "does not exist")),
    Case("NaN in stiffness", substitute("K.mtx", r"^3 3 \S+", "3 3 nan"), 3, ("K.mtx", "row 2, column 2", "finite", "nan", "fix:")),
    Case("Inf in mass", substitute("M.mtx", r"^3 3 \S+", "3 3 -inf"), 3, ("M.mtx", "row 2, column 2", "finite", "-inf")),
    Case(
        "mass too small",
        matrix("M.mtx", lambda M: M.tocsr()[:-1, :-1].tocoo()),
        3,
        ("M.mtx", "wrong size", "32 x 32", "31 x 31", "fix:"),
    ),
    Case("stiffness not square", matrix("K.mtx", lambda K: K.tocsr()[:-1].tocoo()), 3, ("K.mtx", "not square", "31 x 32")),
    Case("complex mass", matrix("M.mtx", lambda M: sp.coo_array(M * (1 + 0.1j))), 3, ("M.mtx", "complex", "real numbers")),
    Case("index beyond size", substitute("K.mtx", r"^3 2 ", "99 2 "), 3, ("K.mtx", "line", "expected:", "found:")),
    Case("no number", substitute("K.mtx", r"^3 3 \S+", "3 3 four"), 3, ("K.mtx", "line", "four")),
    Case("huge header", substitute("K.mtx", r"^32 32 ", "2000000000 2000000000 "), 3, ("K.mtx", "2000000000")),
    Case("no such group", config("data/K.mtx", "data/K.mtx#K"), 3, ("K.mtx",)),
    Case("forced format", config("stiffness: data/K.mtx", "stiffness: {file: data/K.mtx, format: hdf5}"), 3, ("K.mtx", "HDF5")),
]

TABLES = [
    Case("no DOF table", remove("dofs.csv"), 3, ("dofs.csv", "does not exist")),
    Case("truncated DOF table", truncated("dofs.csv"), 3, ("dofs.csv", "expected:", "found:")),
    Case("garbage DOF table", garbage("dofs.csv"), 3, ("dofs.csv",)),
    Case("DOF missing", substitute("dofs.csv", r"^31,.*\n", ""), 3, ("dofs.csv", "does not fit", "32 DOFs", "31")),
    Case("DOF double", substitute("dofs.csv", r"^31,", "30,"), 3, ("dofs.csv", "line 33", "twice", "lines 32 and 33")),
    Case(
        "DOFs from one",
        on_file("dofs.csv", lambda t: re.sub(rb"(?m)^(\d+)", lambda m: str(int(m[1]) + 1).encode(), t)),
        3,
        ("counts from 1",),
    ),
    Case("column missing", substitute("dofs.csv", "component", "label"), 3, ("dofs.csv", "line 1", "component", "missing", "'label'")),
    Case("NaN coordinate", substitute("dofs.csv", r"^2,3,UZ,[\d.]+", "2,3,UZ,nan"), 3, ("dofs.csv", "line 4", "'x'", "finite")),
    Case("decimal comma", substitute("dofs.csv", r"^2,3,UZ,0\.6\d*", '2,3,UZ,"0,6"'), 3, ("dofs.csv", "line 4", "decimal point")),
    Case("no bolts", remove("bolts.csv"), 3, ("bolts.csv", "does not exist")),
    Case("bolt double", substitute("bolts.csv", "B2", "B1"), 3, ("bolts.csv", "line 3", "twice", "'B1'")),
    Case("garbage bolts", garbage("bolts.csv"), 3, ("bolts.csv",)),
    Case("Inf in bolts", substitute("bolts.csv", "B3,0.6[0-9]*", "B3,inf"), 3, ("bolts.csv", "line 4", "finite")),
]

SELECTIONS = [
    Case("unknown node", config("node: 103", "node: 999"), 2, ("campaign.yaml", "line", "responses.mic1", "node 999")),
    Case(
        "unknown component", config("node: 103\n    component: PRES", "node: 103\n    component: UY"), 2, ("responses.mic1", "PRES", "UY")
    ),
    Case(
        "no such component at all",
        config("component: UZ\n      box", "component: ROTY\n      box"),
        2,
        ("parameters.springs.select", "PRES, UZ", "ROTY"),
    ),
    Case("empty box", config("- 0\n        - 1.5", "- 7\n        - 8"), 2, ("parameters.springs.select.box", "x 0 to 2.1", "fix:")),
    Case(
        "unknown excitation node", config("node: 8\n    component: UZ", "node: 88\n    component: UZ"), 2, ("excitation.hammer", "node 88")
    ),
    Case("DOF out of range", config("node: 8\n    component: UZ", "dof: 32"), 2, ("excitation.hammer.dof", "0 to 31", "32")),
    Case(
        "unknown node of terms",
        config(
            "component: UZ\n      box:\n      - - 0\n        - 1.5\n      - - 0\n        - 0\n      - - 0\n        - 0",
            "component: UZ\n      nodes: [1, 77]",
        ),
        2,
        ("node 77", "nodes"),
    ),
    Case(
        "pressure for motion", config("quantity: acceleration", "quantity: pressure"), 2, ("responses.acc1.quantity", "motion", "pressure")
    ),
    Case(
        "motion for pressure",
        config("node: 103\n    component: PRES", "node: 103\n    component: PRES\n    quantity: velocity"),
        2,
        ("responses.mic1.quantity", "expected: pressure"),
    ),
]

MEASUREMENTS = [
    Case("no FRFs", remove("loose.uff"), 3, ("loose.uff", "does not exist")),
    Case("empty FRFs", empty("loose.uff"), 3, ("loose.uff", "empty")),
    Case("truncated FRFs", truncated("loose.uff"), 3, ("loose.uff", "record", "expected:", "found:")),
    Case("garbage FRFs", garbage("loose.uff"), 3, ("loose.uff", "expected:", "found:")),
    Case(
        "NaN in FRFs", substitute("loose.uff", r"^ {1,2}-?\d\.\d{12}E.\d\d", "                 NaN"), 3, ("loose.uff", "record 1", "finite")
    ),
    Case(
        "lines outside the band",
        outside("loose.uff"),
        3,
        ("loose.uff", "job loose", "lines between 20 and 400 Hz", "2020 to 2400 Hz", "fix:"),
    ),
    Case(
        "record not found",
        config("removed:", "records: {mic1: nothing}\n    removed:"),
        3,
        ("loose.uff", "job loose", "no record of response mic1", "name nothing", "record 4: acc1", "fix:"),
    ),
    Case(
        "node not found",
        config("removed:", "records: {mic1: {node: 3, direction: 0}}\n    removed:"),
        3,
        ("loose.uff", "no record of response mic1", "node 3 direction 0", "record 4: acc1"),
    ),
    Case(
        "another quantity", config("removed:", "records: {mic1: acc1}\n    removed:"), 3, ("record 4", "expected: pressure", "acceleration")
    ),
    Case("ambiguous records", doubled("loose.uff"), 3, ("loose.uff", "several records fit response mic1", "record 1", "record 2", "fix:")),
    Case("silent response", zeroed("loose.uff"), 3, ("loose.uff", "mic2", "zero")),
]

CONFIGURATION = [
    Case(
        "duplicate key",
        config("bolts: data/bolts.csv", "bolts: data/bolts.csv\nbolts: data/bolts.csv"),
        2,
        ("campaign.yaml", "line", "bolts"),
    ),
    Case("unknown key", config("tolerance: 1.0e-06", "tolerence: 1.0e-06"), 2, ("campaign.yaml", "line", "tolerence", "tolerance")),
    Case("wrong type", config("regularisation: 0.0", "regularisation: strong"), 2, ("campaign.yaml", "update.regularisation", "strong")),
    Case("no YAML", config("campaign: box", "campaign: [box"), 2, ("campaign.yaml", "line")),
    Case("missing section", config("reduction:", "reductions:"), 2, ("campaign.yaml", "reduction")),
    Case("unknown reference", config("reference: tight", "reference: tihgt"), 2, ("update.reference", "tihgt", "did you mean 'tight'?")),
]


def assert_one_message(result: Result, case: Case) -> None:
    __tracebackhide__ = True
    assert result.code == case.code, result.stderr
    assert "Traceback" not in result.stderr
    for part in case.parts:
        assert part in result.stderr, f"{part!r} is not in:\n{result.stderr}"
    # One message: one line that is not indented.
    told = [line for line in result.stderr.splitlines() if line and not line.startswith((" ", "warning:"))]
    assert len(told) == 1, result.stderr


def arguments(command: str, tmp_path: Path) -> list[str]:
    return ["--out", str(tmp_path / "sim.csv")] if command == "simulate" else []


@pytest.mark.parametrize("case", [*MODEL, *TABLES, *SELECTIONS, *CONFIGURATION], ids=str)
def test_unusable_inputs(box: Folder, tmp_path: Path, case: Case) -> None:
    case.damage(box)
    before = box.listing()
    for command in case.commands:
        result = box.run(command, *arguments(command, tmp_path))
        assert_one_message(result, case)
        assert result.stdout == ""
    assert box.listing() == before
    assert not (tmp_path / "sim.csv").exists()


@pytest.mark.parametrize("case", MEASUREMENTS, ids=str)
def test_unusable_measurements_are_found_by_check(box: Folder, case: Case) -> None:
    case.damage(box)
    before = box.listing()
    result = box.run("check")
    assert result.code == case.code
    for part in case.parts:
        assert part in result.stderr, f"{part!r} is not in:\n{result.stderr}"
    assert "loose: unusable" in result.stdout
    assert box.listing() == before
    told = box.run("check", "--json")
    assert told.code == case.code
    assert case.parts[0] in told.json["errors"]["loose"]
    assert told.json["errors"]["loose"] in told.stderr


@pytest.mark.parametrize("command", ["check", "reduce", "update", "report", "simulate"])
def test_no_campaign_file(box: Folder, tmp_path: Path, command: str) -> None:
    box.config.unlink()
    result = box.run(command, *arguments(command, tmp_path))
    assert result.code == 2
    assert "campaign.yaml" in result.stderr
    assert result.stdout == ""


@pytest.mark.parametrize("command", ["check", "reduce", "update", "report", "simulate"])
def test_a_bad_override_is_named(box: Folder, tmp_path: Path, command: str) -> None:
    result = box.run(command, "--override", "reduction.tolerance=-1", *arguments(command, tmp_path))
    assert result.code == 2
    assert "reduction.tolerance" in result.stderr
    assert result.stdout == ""


@pytest.mark.parametrize("command", ["update", "report", "simulate"])
def test_unknown_job(box: Folder, tmp_path: Path, command: str) -> None:
    result = box.run(command, "--job", "lose", *arguments(command, tmp_path))
    assert result.code == 2
    for part in ("lose", "expected: tight, loose"):
        assert part in result.stderr
    assert result.stdout == ""


def test_no_jobs(box: Folder) -> None:
    result = box.run("update", "--override", "jobs={}", "--override", "update.reference=")
    assert result.code == 2
    assert "no jobs" in result.stderr


@pytest.mark.slow
def test_frame_damaged_files(frame: Folder) -> None:
    """Compressed matrices, vectors, sensor rows and CSV FRFs of the other sample."""
    cases = [
        Case("gzip cut", truncated("model/mass.mtx.gz"), 3, ("mass.mtx.gz", "damaged")),
        Case("gzip NaN", gzipped("model/mass.mtx.gz", r"^(3 3) \S+", r"\1 nan"), 3, ("mass.mtx.gz", "finite")),
        Case("edge rows", substitute("model/edge.mtx", "^414 10 36", "415 10 36"), 3, ("edge.mtx", "left_edge", "414 rows", "415 x 10")),
        Case("positions", substitute("model/edge.csv", r"^0,0\.38,0\n", ""), 3, ("edge.csv", "10 terms", "9 positions")),
        Case("sensors", substitute("model/sensors.mtx", "^2 414 32", "2 413 32"), 3, ("sensors.mtx",)),
        Case("row", config("sensors.mtx, row: 1", "sensors.mtx, row: 2"), 2, ("responses.acc4.row", "0 to 1", "2")),
        Case("bolts", truncated("model/bolts.csv"), 3, ("bolts.csv",)),
        Case("csv text", substitute("frf/tight.csv", r"^40,[^,]*", "40,abc"), 3, ("tight.csv", "line 12", "abc")),
        Case("csv inf", substitute("frf/tight.csv", r"^40,[^,]*", "40,inf"), 3, ("tight.csv", "line 12", "acc1_real", "finite")),
        Case("csv order", substitute("frf/tight.csv", r"^40,", "39,"), 3, ("tight.csv", "frequencies do not increase", "39 Hz")),
        Case("csv column", substitute("frf/tight.csv", "acc2_imag", "acc2_img"), 3, ("tight.csv", "acc2")),
        Case(
            "csv unit",
            substitute("frf/tight.csv", "frequency_hz", "frequency_khz"),
            3,
            ("tight.csv", "30000 to 500000 Hz", "between 30 and 500 Hz"),
        ),
    ]
    kept = frame.path.with_name("kept")
    shutil.copytree(frame.path, kept)
    for case in cases:
        case.damage(frame)
        result = frame.run("check")
        assert result.code == case.code, (case.what, result.stderr)
        for part in case.parts:
            assert part in result.stderr, f"{case}: {part!r} is not in:\n{result.stderr}"
        shutil.copytree(kept / "data", frame.data, dirs_exist_ok=True)
        shutil.copy(kept / "campaign.yaml", frame.config)
    assert frame.run("check").code == 0
