"""Mistakes that people make with models, measurements and campaign files: each is found by check, with a message that names the fix."""

from __future__ import annotations

import gzip
import io
import re
import shutil
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import h5py
import numpy as np
import pytest
import scipy.io
import scipy.sparse as sp
from campaigns import Folder, Result, lrbc
from campaigns import frame as make_frame
from campaigns import plate as make_plate
from looking import seen
from samples import reduced_cache

from lrbc_cli.campaign.looking import trials
from lrbc_cli.campaign.looking.causes import rescaled
from lrbc_cli.io.meshes.nodes import read_nodes
from lrbc_cli.model.fem import FeModel
from lrbc_cli.reduction import predict
from lrbc_cli.reduction.problem.full import full_ports
from lrbc_cli.reduction.reduced.ports import PortFrf

Damage = Callable[[Folder], object]
Rows = Callable[[np.ndarray], np.ndarray]

FRFS = ("frf/tight.csv", "frf/loose-2.csv", "frf/loose-all.csv")
COLUMNS = "frequency_hz,acc1_real,acc1_imag,acc2_real,acc2_imag,acc3_real,acc3_imag,acc4_real,acc4_imag"
EDGE = "      vectors: data/model/edge.mtx\n      positions: data/model/edge.csv\n"


def config(*pairs: tuple[str, str]) -> Damage:
    """Replace texts of the campaign file, one after the other."""
    return lambda folder: [folder.replace(old, new) for old, new in pairs]


def text(name: str, change: Callable[[str], str]) -> Damage:
    """Change a text file; it must change."""

    def damage(folder: Folder) -> None:
        path = folder.data / name
        before = path.read_text()
        assert change(before) != before
        path.write_text(change(before))

    return damage


def write(name: str, content: bytes) -> Damage:
    return lambda folder: (folder.data / name).write_bytes(content)


def all_of(*damages: Damage) -> Damage:
    return lambda folder: [damage(folder) for damage in damages]


def numbers(name: str, change: Rows, header: str | None = None, plain: str = "%.9g") -> Damage:
    """Change the numbers below the header of a CSV file, after the words of each row."""

    def change_text(content: str) -> str:
        first, *rows = content.splitlines()
        cells = [row.split(",") for row in rows]
        words = {"dofs": 3, "bolts": 1}.get(Path(name).stem, 0)
        values = change(np.array([[float(cell) for cell in row[words:]] for row in cells]))
        named = [row[:words] for row in cells] if words else [[] for _ in values]
        lines = [",".join([*row, *(plain % value for value in own)]) for row, own in zip(named, values, strict=True)]
        return "\n".join([header or first, *lines]) + "\n"

    return text(name, change_text)


def times(factor: float, first: int = 0, last: int | None = None) -> Rows:
    def change(rows: np.ndarray) -> np.ndarray:
        rows = rows.copy()
        rows[:, first:last] *= factor
        return rows

    return change


def integrated(rows: np.ndarray) -> np.ndarray:
    """Velocities of accelerations."""
    values = (rows[:, 1::2] + 1j * rows[:, 2::2]) / (2j * np.pi * rows[:, :1])
    return np.column_stack([rows[:, :1], *(part for value in values.T for part in (value.real, value.imag))])


def gap(rows: np.ndarray) -> np.ndarray:
    rows = rows.copy()
    rows[100:300, 1:3] = np.nan
    return rows


def quarter_lines(rows: np.ndarray) -> np.ndarray:
    """Four lines for each that was measured, in between on straight lines."""
    hz = np.arange(rows[0, 0], rows[-1, 0] + 0.1, 0.25)
    return np.column_stack([hz, *(np.interp(hz, rows[:, 0], column) for column in rows[:, 1:].T)])


def first_lines(share: float) -> Callable[[str], str]:
    return lambda content: "".join((lines := content.splitlines(keepends=True))[: int(share * len(lines))])


def cut_gz(name: str) -> Damage:
    def damage(folder: Folder) -> None:
        path = folder.data / name
        path.write_bytes(gzip.compress(first_lines(0.6)(gzip.decompress(path.read_bytes()).decode()).encode()))

    return damage


def zipped(*names: str) -> bytes:
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w") as archive:
        for name in names:
            archive.writestr(name, "x" * 100)
    return content.getvalue()


def table(head: str, columns: np.ndarray) -> bytes:
    return "\n".join([head, *(",".join(f"{value:.6g}" for value in row) for row in columns)]).encode()


def by_component(content: str) -> str:
    """A DOF table that goes component by component."""
    head, *rows = content.splitlines()
    cells = sorted((row.split(",")[1:] for row in rows), key=lambda row: (row[1], int(row[0])))
    return "\n".join([head, *(",".join([str(k), *row]) for k, row in enumerate(cells))]) + "\n"


def scattered(content: str) -> str:
    """The places of a DOF table without any order."""
    head, *rows = content.splitlines()
    places = {row.split(",")[1]: row.split(",", 3)[3] for row in rows}
    other = dict(zip(places, np.random.default_rng(1).permutation(list(places.values())), strict=True))
    return "\n".join([head, *(",".join([*row.split(",")[:3], other[row.split(",")[1]]]) for row in rows)]) + "\n"


def without(record: str) -> Callable[[str], str]:
    return lambda content: re.sub(rf"    -1\n    58\nFrequency response function {record}\n(.*\n)*?    -1\n", "", content)


def decimal_commas(content: str) -> str:
    head, *rows = content.splitlines()
    return "\n".join([head, *(",".join(f"{float(cell):.6f}".replace(".", ",") for cell in row.split(",")) for row in rows)]) + "\n"


def whole(content: str) -> str:
    head, *rows = content.splitlines()
    return "\n".join([head, *(row.replace(".", ",") for row in rows)]) + "\n"


def german(content: str) -> str:
    return content.replace(",", ";").replace(".", ",")


def conjugate(rows: np.ndarray) -> np.ndarray:
    return rows * np.where(np.isin(np.arange(rows.shape[1]), range(2, 9, 2)), -1.0, 1.0)


def exchanged(rows: np.ndarray) -> np.ndarray:
    return rows[:, [0, 3, 4, 1, 2, *range(5, 9)]]


def as_complex(change: Callable[[np.ndarray, np.ndarray], np.ndarray]) -> Rows:
    """Change FRFs, (F, R), given their frequencies."""

    def rows_of(rows: np.ndarray) -> np.ndarray:
        values = change(rows[:, :1], rows[:, 1::2] + 1j * rows[:, 2::2])
        return np.column_stack([rows[:, :1], *(part for value in values.T for part in (value.real, value.imag))])

    return rows_of


def decibels(hz: np.ndarray, values: np.ndarray) -> np.ndarray:
    return 20.0 * np.log10(np.abs(values)) + 0j


def magnitudes(hz: np.ndarray, values: np.ndarray) -> np.ndarray:
    return np.abs(values) + 1j * np.degrees(np.angle(values))


def some(factor: float, *channels: int) -> Rows:
    at = np.array(channels)

    def change(hz: np.ndarray, values: np.ndarray) -> np.ndarray:
        values[:, at] *= factor
        return values

    return as_complex(change)


def without_signal(channel: int) -> Rows:
    """What is left of a channel whose cable is off: noise of its front end."""
    rng = np.random.default_rng(3)

    def change(hz: np.ndarray, values: np.ndarray) -> np.ndarray:
        noise = rng.normal(size=(2, values.shape[0]))
        values[:, channel] = 1e-3 * np.median(np.abs(values[:, channel])) * (noise[0] + 1j * noise[1])
        return values

    return as_complex(change)


def matrix_times(name: str, factor: float) -> Damage:
    """A Matrix Market file with other numbers, under another name."""

    def damage(folder: Folder) -> None:
        matrix = scipy.io.mmread(folder.data / "model" / name, spmatrix=False)
        scipy.io.mmwrite(folder.data / "model" / "other.mtx", factor * matrix, symmetry="symmetric", precision=17)
        folder.replace(f"data/model/{name}", "data/model/other.mtx")

    return damage


def triplets_times(name: str, factor: float) -> Damage:
    def damage(folder: Folder) -> None:
        path = folder.data / name
        lines = [line.split() for line in gzip.decompress(path.read_bytes()).decode().splitlines()]
        text_ = "".join(f"{row} {column} {float(value) * factor:.14e}\n" for row, column, value in lines)
        path.write_bytes(gzip.compress(text_.encode()))

    return damage


def cut_in_line(name: str, share: float = 0.6) -> Damage:
    """Without the last number of a line, and without its end."""

    def cut(content: str) -> str:
        content = content[: int(share * len(content))]
        return content[: max(content.rindex(sign) for sign in ", " if sign in content)]

    return text(name, cut)


def named_columns(*names: str) -> Damage:
    """The FRFs of two jobs in HDF5, with a list of names."""

    def damage(folder: Folder) -> None:
        for name in FRFS[:2]:
            rows = np.loadtxt(folder.data / name, delimiter=",", skiprows=1)
            with h5py.File((folder.data / name).with_suffix(".h5"), "w") as file:
                file["frequency"], file["H"], file["names"] = rows[:, 0], rows[:, 1::2] + 1j * rows[:, 2::2], names

    return damage


HZ = np.arange(30.0, 501.0)
COHERENCE = 1.0 - 0.05 * np.random.default_rng(1).random((HZ.size, 4))
SECONDS = np.arange(2048) / 2048


def parts(change: Callable[[np.ndarray, np.ndarray], np.ndarray]) -> Rows:
    """Change the complex values of all channels, (F,) frequencies and (F, R) values."""

    def rows(rows: np.ndarray) -> np.ndarray:
        values = change(rows[:, 0], rows[:, 1::2] + 1j * rows[:, 2::2])
        return np.column_stack([rows[:, 0], *(part for value in values.T for part in (value.real, value.imag))])

    return rows


def exponential(hz: np.ndarray, values: np.ndarray, end: float = 0.01) -> np.ndarray:
    """An exponential window of the whole record, on values that fade to nothing beside the band."""
    count, fade = hz.size, np.linspace(0.0, 1.0, hz.size)[:, None]
    padded = np.concatenate([values[:1] * fade, values, values[-1:] * fade[::-1]])
    # Of the record; what leaks in front of its beginning is not windowed.
    time = np.arange(3 * count) / (3 * count)
    time = np.where(time > 0.9, 0.0, time)
    return np.fft.fft(np.fft.ifft(padded, axis=0) * end ** time[:, None], axis=0)[count : 2 * count]


def high_pass(hz: np.ndarray, values: np.ndarray) -> np.ndarray:
    """AC coupling of the second channel."""
    corner = 1j * hz / 90.0
    return values * np.where(np.arange(values.shape[1]) == 1, (corner**2 / (corner**2 + 1.414 * corner + 1.0))[:, None], 1.0)


def hum(hz: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Mains in all channels."""
    turns = np.exp(2j * np.pi * np.random.default_rng(5).random(values.shape))
    return values + np.where(hz[:, None] % 50.0 == 0.0, 6.0 * np.median(np.abs(values)) * turns, 0.0)


def radians(content: str) -> str:
    """Magnitudes and phases, these in radians under a heading that says degrees."""
    _, *rows = content.splitlines()
    values = np.array([[float(cell) for cell in row.split(",")] for row in rows])
    H = values[:, 1::2] + 1j * values[:, 2::2]
    columns = np.column_stack([values[:, 0], *(part for h in H.T for part in (np.abs(h), np.angle(h)))])
    head = "frequency_hz," + ",".join(f"acc{k}_magnitude,acc{k}_phase [deg]" for k in range(1, H.shape[1] + 1))
    return table(head, columns).decode()


def sorted_apart(content: str) -> str:
    """Ten bolts, whose names a spreadsheet has sorted without their places."""
    names = sorted(f"B{k}" for k in range(1, 12))
    return "name,x,y,z\n" + "".join(f"{name},-0.01,{0.4 * (k + 0.5) / 11:.6g},0\n" for k, name in enumerate(names))


def other_clock(factor: float) -> Rows:
    """Measured with another clock, on the same lines."""

    def rows_of(rows: np.ndarray) -> np.ndarray:
        hz = rows[:, 0]
        return np.column_stack([hz, *(np.interp(hz / factor, hz, column) for column in rows[:, 1:].T)])

    return rows_of


def hit_twice(hz: np.ndarray, values: np.ndarray) -> np.ndarray:
    """The second blow, half as hard after 12 ms, was cut from the force."""
    return values * (1.0 + 0.5 * np.exp(-2j * np.pi * hz * 0.012))[:, None]


def appended(content: str) -> str:
    return content + content.partition("\n")[2]


def two_sided(rows: np.ndarray) -> np.ndarray:
    below = rows[::-1] * np.where(np.isin(np.arange(rows.shape[1]), (0, *range(2, 9, 2))), -1.0, 1.0)
    return np.vstack([below, rows])


def turned_by_90_degrees(content: str) -> str:
    """Coordinates of the nodes in other axes than the matrices."""
    head, table, rest = re.split(r"(?<=NSET=ALL\n)|(?=\*ELEMENT)", content, maxsplit=2)
    return head + re.sub(r"(?m)^(\d+), ([^,]+), ([^,]+)", lambda m: f"{m[1]}, {float(m[3]):.6g}, {300 - float(m[2]):.6g}", table) + rest


@dataclass(frozen=True)
class Mistake:
    """What was done, to which sample, and what check says; ``fix`` is the part that tells what to do."""

    what: str
    sample: str
    damage: Damage
    code: int
    says: str
    fix: str


def by_y(table: str) -> str:
    """Sorted in a spreadsheet, the column dof filled down anew."""
    head, *rows = table.splitlines()
    cells = sorted((row.split(",") for row in rows), key=lambda row: (float(row[4]), float(row[3])))
    return "\n".join([head, *(",".join([str(k), *row[1:]]) for k, row in enumerate(cells))]) + "\n"


def solver_order(folder: Folder) -> None:
    """As Ansys exports matrices and BACK, NOD2BCS forgotten."""
    pairs = [line.split(".") for line in (folder.data / "plate.dof").read_text().split()]
    nodes = [int(node) for node, _ in pairs][::3]
    head = "%%MatrixMarket matrix array integer general\n"
    (folder.data / "V.mtx").write_text(f"{head}{len(nodes)} 1\n" + "\n".join(map(str, nodes)) + "\n")
    order = np.random.default_rng(0).permutation(len(pairs)) + 1
    for name in ("plate.sti.gz", "plate.mas.gz"):
        with gzip.open(folder.data / name) as file:
            a = np.loadtxt(file)
        a[:, 0], a[:, 1] = order[a[:, 0].astype(int) - 1], order[a[:, 1].astype(int) - 1]
        a[:, :2] = np.sort(a[:, :2], axis=1)
        with gzip.open(folder.data / name, "wt") as out:
            out.writelines(f"{int(i)} {int(j)} {value:.13e}\n" for i, j, value in a)
    folder.replace("map: data/plate.dof", "map: data/V.mtx")


#: Places of hammer and sensors on the plate.
PLACES = (("63.333", "60"), ("20", "100"), ("106.667", "180"), ("193.333", "60"), ("236.667", "140"), ("280", "100"))


def moved_to_the_middle(x: str, y: str) -> tuple[str, str]:
    return f"near: [{x}, {y}, 4]", f"near: [{float(x) - 150:.3f}, {float(y) - 100:g}, 4]"


def other_face(folder: Folder) -> None:
    """Each node of the lower face by the one above it, 4 mm away."""
    node, xyz, _ = read_nodes(folder.data / "plate.inp")
    above = {
        int(n): int(node[np.argmin(np.linalg.norm(xyz - place - [0.0, 0.0, 4.0], axis=1))]) for n, place in zip(node, xyz, strict=True)
    }
    text("bushings.csv", lambda t: re.sub(r"(?m)^(B\d),(\d+)", lambda m: f"{m[1]},{above[int(m[2])]}", t))(folder)


def without_springs(*bolts: str) -> Damage:
    """The matrix of the plate as it was exported without springs of some bolts."""

    def damage(folder: Folder) -> None:
        dofs = (folder.data / "plate.dof").read_text().split()
        table = [line.split(",") for line in (folder.data / "bushings.csv").read_text().splitlines()[1:]]
        less = {
            dofs.index(f"{node}.{('UX', 'UY', 'UZ').index(component) + 1}") + 1: float(k)
            for bolt, node, _, component, k in table
            if bolt in bolts
        }
        path = folder.data / "plate.sti.gz"
        entries = np.loadtxt(io.StringIO(gzip.decompress(path.read_bytes()).decode()))
        entries[:, 2] -= [less.get(int(i), 0.0) if i == j else 0.0 for i, j in entries[:, :2]]
        path.write_bytes(gzip.compress("".join(f"{int(i)} {int(j)} {k:.13e}\n" for i, j, k in entries).encode()))

    return damage


def fixed_at_bolts(folder: Folder) -> None:
    """Matrices of the plate as they are exported with a boundary condition at the bolts."""
    held = {line.split(",")[1] for line in (folder.data / "bushings.csv").read_text().splitlines()[1:]}
    dofs = (folder.data / "plate.dof").read_text().split()
    free = np.array([dof.split(".")[0] not in held for dof in dofs])
    (folder.data / "plate.dof").write_text("".join(f"{dof}\n" for dof, kept in zip(dofs, free, strict=True) if kept))
    row = np.cumsum(free)
    for name in ("plate.sti.gz", "plate.mas.gz"):
        entries = np.loadtxt(io.StringIO(gzip.decompress((folder.data / name).read_bytes()).decode()))
        at = entries[:, :2].astype(int) - 1
        kept = free[at].all(axis=1)
        lines = (f"{row[i]} {row[j]} {value:.13e}\n" for (i, j), value in zip(at[kept], entries[kept, 2], strict=True))
        (folder.data / name).write_bytes(gzip.compress("".join(lines).encode()))


def two_matrices(folder: Folder) -> None:
    """Matrices of an HDF5 file, one of them a share of another."""
    with h5py.File(folder.data / "model/model.h5", "w") as file:
        for name in ("K", "K_x", "M"):
            file[name] = np.eye(3)


def stretched(change: Callable[[float], float]) -> Damage:
    """Coordinates along x of another state of the model, of the nodes alone."""

    def nodes(content: str) -> str:
        head, table, rest = re.split(r"(?<=NSET=ALL\n)|(?=\*ELEMENT)", content, maxsplit=2)
        return head + re.sub(r"(?m)^(\d+), ([^,]+)", lambda m: f"{m[1]}, {change(float(m[2])):.6g}", table) + rest

    return text("plate.inp", nodes)


def few_digits(folder: Folder) -> None:
    path = folder.data / "plate.sti.gz"
    lines = (line.split() for line in gzip.decompress(path.read_bytes()).decode().splitlines())
    path.write_bytes(gzip.compress("".join(f"{i} {j} {float(k):.3e}\n" for i, j, k in lines).encode()))


def four_digits(folder: Folder) -> None:
    stiffness = scipy.io.mmread(folder.data / "model/stiffness.mtx", spmatrix=False)
    scipy.io.mmwrite(folder.data / "model/stiffness.mtx", stiffness, symmetry="symmetric", precision=4)


def structural(share: float) -> Damage:
    def damage(folder: Folder) -> None:
        stiffness = scipy.io.mmread(folder.data / "model/stiffness.mtx", spmatrix=False)
        scipy.io.mmwrite(folder.data / "model/damping.mtx", share * stiffness, symmetry="symmetric")
        folder.replace("data/model/damping.mtx.gz", "data/model/damping.mtx")

    return damage


def inverse(file: str) -> str:
    """Numerator and denominator exchanged in the header."""
    both = re.compile(r"( +12 +0 +0 +0 acceleration[^\n]*\n)( +13 +0 +0 +0 Force[^\n]*\n)")
    return both.sub(r"\2\1", file)


K, M = "data/model/stiffness.mtx", "data/model/mass.mtx.gz"
ACC1 = ", quantity: acceleration}\n  acc2"
SIDEWAYS = """\
    baseline: 1.0
  sideways:
    kind: stiffness
    select: {bushings: data/again.csv, component: UY}
"""
UNITS = "units: mm-N-t                             # of the model and of all coordinates; FRFs state their own\n"
LOOSE = "frf: data/frf/loose-2.csv"
TIGHT = "frf: data/frf/tight.csv"

#: Those that need a reduced model of their own, or look for their cause in several ways.
DEAR = {
    "bounds within which no joint can lose a decade",
    "a bolt without a spring",
    "modulus of aluminium for steel, springs of bolts as they are",
    "record numbers one too high",
    "coordinates turned by 90 degrees",
    "density of steel for aluminium",
    "stiffness with four digits",
    "nodes mirrored",
    "nodes of an older design",
    "matrix exported without its springs",
    "matrix exported with a bolt missing",
    "springs of one bolt at the node beside",
    "a loss factor of one",
    "bushings a thousand times too small beside a matrix without springs",
    "mass a thousand times too large where units are stated",
    "springs at the nodes of the other face",
    "stiffness of two directions exchanged",
    "DOF table sorted and numbered anew",
    "mapping of Ansys without the order",
    "coordinates of the test from the middle",
    "mass a thousand times too large",
    "stiffness a thousand times too large",
    "weight density",
    "DOF table component by component",
    "DOF table in no order",
    "loss factor in per cent",
    "hammer and sensor exchanged",
    "springs twice",
    "damping forgotten",
    "direction of one sensor",
    "files of the reference job and of a loose one exchanged",
    "hammer along another axis than the file says",
    "another axis than the file says",
    "one job hit at another node",
    "bolts counted from the other end",
    "bolts from the middle of the plate",
    "a repeat of another state",
    "reference measured with loose bolts",
    "hammer in metres",
    "bounds between which no bolt is loose",
    "input of an older mesh, which lacks the last nodes",
    "a digit lost in the place of a bolt",
    "hammer and sensors mirrored",
    "a sensor turned over in a loosened job alone",
    "bolts in metres in a campaign in mm",
    "x and y of the hammer exchanged",
    "band in rad/s",
    "a change that calls all bolts tight",
    "UFF cut in a line",
    "terms twice",
    "a loosened job as baseline",
    "calibrated by a loosened job",
    "force over acceleration",
    "band beyond what was measured",
    "a gain in per cent",
    "stiffness of a regular mesh with four digits",
    "damping matrix in other units",
    "a sensor elsewhere, in y",
    "hammer about an axis",
    "a sensor elsewhere",
}

MISTAKES = [
    Mistake(
        "K and M exchanged",
        "frame",
        config((K, "K"), (M, K), ("stiffness: K ", f"stiffness: {M} ")),
        3,
        "the stiffness and the mass matrix are exchanged",
        "exchange model.stiffness",
    ),
    Mistake(
        "half a triangle",
        "frame",
        text("model/stiffness.mtx", lambda t: t.replace("real symmetric", "real general")),
        3,
        "only the lower triangle",
        "symmetric: true",
    ),
    Mistake(
        "stiffness cut at a line end",
        "frame",
        text("model/stiffness.mtx", first_lines(0.6)),
        3,
        "found:    2844 entries",
        "copy it again",
    ),
    Mistake("list of entries cut at a line end", "plate", cut_gz("plate.sti.gz"), 3, "the stiffness matrix ends early", "file was cut off"),
    Mistake("stiffness cut in a line", "frame", cut_in_line("model/stiffness.mtx"), 3, "the file ends early", "copy it again"),
    Mistake("FRFs cut in a line", "frame", cut_in_line("frf/loose-2.csv"), 3, "the file ends early", "copy it again"),
    Mistake("UFF cut in a line", "plate", cut_in_line("frf/b5-loose.uff"), 3, "the file ends early", "copy it again"),
    Mistake("DOF table cut in a line", "frame", cut_in_line("model/dofs.csv"), 3, "the file ends early", "copy it again"),
    Mistake(
        "damping matrix in other units",
        "frame",
        config(("damping: data/model/damping.mtx.gz", "damping: {file: data/model/damping.mtx.gz, scale: 1000.0}")),
        0,
        "the damping matrix is 1000 times too large",
        "This reduces the level misfit to",
    ),
    Mistake(
        "a loss factor of one",
        "plate",
        config(("loss_factor: 0.01}", "loss_factor: 1.0}")),
        0,
        "model.damping.structure.loss_factor: 1 is 100%",
        "If per cent was meant, write 0.01",
    ),
    Mistake(
        "a loss factor of springs in per cent",
        "plate",
        config(("    initial: 0.0\n", "    initial: 0.0\n    damping: {loss_factor: 0.9}\n")),
        0,
        "parameters.bolts.damping.loss_factor: 0.9 is 90%",
        "If per cent was meant, write 0.009",
    ),
    Mistake(
        "record numbers one too high",
        "plate",
        config(*((f"acc{k}: {{near", f"acc{k}: {{record: {k + 1}, near") for k in range(1, 6))),
        0,
        "the record numbers are probably 1 too high: acc1 selects record 2 (acc2), acc2 selects record 3 (acc3)",
        "Correct responses.NAME.record (records are counted from 1), or remove it",
    ),
    Mistake(
        "bushings a thousand times too small",
        "plate",
        text("bushings.csv", lambda t: t.replace(",5000\n", ",5\n").replace(",1000\n", ",1\n")),
        0,
        "contains 1000 times the stiffness in bushings.csv",
        "Multiply the stiffnesses there by 1000",
    ),
    Mistake(
        "bushings a thousand times too small beside a matrix without springs",
        "plate",
        all_of(
            text("bushings.csv", lambda t: t.replace(",5000\n", ",5\n").replace(",1000\n", ",1\n")),
            config(("baseline: 1.0", "baseline: 1000.0")),
        ),
        0,
        "with all stiffnesses of bushings.csv times 1000, the level misfit falls",
        "Multiply the stiffnesses there by 1000",
    ),
    Mistake(
        "all bushings too soft by one factor that is no unit",
        "plate",
        text("bushings.csv", lambda t: t.replace(",5000\n", ",2500\n").replace(",1000\n", ",500\n")),
        0,
        "contains 2 times the stiffness in bushings.csv, not 1 times as stated",
        "correct that table, the matrix, or parameters.bolts.baseline",
    ),
    Mistake(
        "springs in N/m",
        "plate",
        text("bushings.csv", lambda t: t.replace(",5000\n", ",5000000\n").replace(",1000\n", ",1000000\n")),
        0,
        "contains 0.001 times the stiffness in bushings.csv",
        "are probably in N/m, not in N/mm: divide them by 1000",
    ),
    Mistake(
        "density in kg/m3 in mm, N, t",
        "plate",
        triplets_times("plate.mas.gz", 1e12),
        3,
        "far below the band",
        "the mass matrix is 1e+12 times too large (density in kg/m³, but `units: mm-N-t` requires t/mm³, 7.85e-09 for steel)",
    ),
    Mistake(
        "density in t/mm3 in SI",
        "frame",
        matrix_times("mass.mtx.gz", 1e-12),
        3,
        "do not fit",
        "model.mass: {file: data/model/other.mtx, scale: 1e+12}",
    ),
    Mistake("modulus in MPa in SI", "frame", matrix_times("stiffness.mtx", 1e-6), 3, "far below the band", "modulus in MPa, but"),
    Mistake("mass a thousand times too large", "frame", matrix_times("mass.mtx.gz", 1e3), 0, "1000 times too large", "masses in g"),
    Mistake(
        "weight density", "frame", matrix_times("mass.mtx.gz", 9.80665), 0, "9.807 times too large (a weight density", "scale: 0.101972}"
    ),
    Mistake(
        "stiffness a thousand times too large",
        "frame",
        matrix_times("stiffness.mtx", 1e3),
        0,
        "stiffness matrix is 1000 times",
        "scale: 0.001}",
    ),
    Mistake(
        "some channels in g",
        "frame",
        numbers(FRFS[1], some(1 / 9.80665, 0, 1)),
        0,
        "acc1, acc2: measured over computed",
        "jobs.loose-2.scale: {acc1: 9.80665, acc2: 9.80665}",
    ),
    Mistake(
        "one job in mm/s2",
        "frame",
        numbers(FRFS[1], some(1e3, 0, 1, 2, 3)),
        0,
        "all responses (acc1, acc2, acc3, acc4)",
        "jobs.loose-2.format.unit: mm/s2/N",
    ),
    Mistake(
        "inverse FRFs",
        "frame",
        all_of(*(numbers(n, as_complex(lambda hz, h: 1.0 / h)) for n in FRFS)),
        0,
        "probably inverse FRFs (apparent mass",
        "take the reciprocal",
    ),
    Mistake(
        "impedances",
        "frame",
        all_of(*(numbers(n, as_complex(lambda hz, h: 2j * np.pi * hz / h)) for n in FRFS)),
        0,
        "probably inverse FRFs (mechanical impedance",
        "export acceleration over force",
    ),
    Mistake(
        "decibels as real parts",
        "frame",
        numbers(FRFS[0], as_complex(decibels)),
        0,
        "decibels probably read as real parts",
        "export real and",
    ),
    Mistake(
        "magnitude and phase as two parts",
        "frame",
        numbers(FRFS[0], as_complex(magnitudes)),
        0,
        "phases probably read as real and imaginary",
        "jobs.tight.format: {representation: magnitude-phase}",
    ),
    Mistake("conjugate in one job", "frame", numbers(FRFS[1], conjugate), 0, "phases probably of opposite sign: all responses", "times -1"),
    Mistake(
        "velocities in one job",
        "frame",
        numbers(FRFS[1], integrated),
        0,
        "probable cause: velocity, not acceleration",
        "Export loose-2 again as acceleration",
    ),
    Mistake(
        "three sensors in a ring",
        "frame",
        numbers(FRFS[1], as_complex(lambda hz, h: h[:, [1, 2, 0, 3]])),
        0,
        "acc1, acc2 and acc3 are probably exchanged",
        "jobs.loose-2.records: {acc2: acc1, acc3: acc2, acc1: acc3}",
    ),
    Mistake("mass cut at a line end", "plate", cut_gz("plate.mas.gz"), 3, "the mass matrix ends early", "file was cut off"),
    Mistake("DOF map of another model", "plate", text("plate.dof", first_lines(0.9)), 3, "DOF map does not fit", "one model in one run"),
    Mistake(
        "DOF table component by component",
        "frame",
        text("model/dofs.csv", by_component),
        0,
        "rows of the matrices are in another order (node by node)",
        "Sort",
    ),
    Mistake(
        "DOF table in no order",
        "frame",
        text("model/dofs.csv", scattered),
        0,
        ", but the DOF table is not",
        "those of another numbering of the nodes",
    ),
    Mistake("DOF table sorted and numbered anew", "frame", text("model/dofs.csv", by_y), 0, "sorted by node number", "in a spreadsheet"),
    Mistake(
        "mass and damping exchanged",
        "frame",
        config(
            (f"mass: {M}", "mass: M"),
            ("damping: data/model/damping.mtx.gz", f"damping: {M}"),
            ("mass: M", "mass: data/model/damping.mtx.gz"),
        ),
        3,
        "mass and the damping matrix are exchanged",
        "exchange model.mass and model.damping",
    ),
    Mistake(
        "mass a thousand times too large where units are stated",
        "plate",
        triplets_times("plate.mas.gz", 1e3),
        0,
        "job tight-1: the mass matrix is 1000 times too large",
        "scale: 0.001}",
    ),
    Mistake(
        "bolts in metres in a campaign in mm",
        "plate",
        numbers("bolts.csv", times(1e-3)),
        0,
        "nearer to the springs of other bolts than to their own",
        "multiply them by 1000",
    ),
    Mistake(
        "a digit lost in the place of a bolt",
        "plate",
        text("bolts.csv", lambda t: t.replace("B3,280,", "B3,28,")),
        0,
        "bolts.csv: B3 lies nearer to the springs of other bolts than to its own",
        "correct the places there, or the nodes of the springs",
    ),
    Mistake(
        "springs at the nodes of the other face",
        "plate",
        other_face,
        0,
        "the matrix contains no spring at node",
        "4 mm away: correct the nodes in bushings.csv",
    ),
    Mistake(
        "stiffness of two directions exchanged",
        "plate",
        text("bushings.csv", lambda t: t.replace("UX,5000", "UX,@").replace("UZ,1000", "UZ,5000").replace("UX,@", "UX,1000")),
        0,
        "the matrix contains the stiffnesses of UX and UZ in each other's place",
        "exchange them in bushings.csv",
    ),
    Mistake("mapping of Ansys without the order", "plate", solver_order, 0, "in the solver's order", "order: NOD2BCS.mtx"),
    Mistake(
        "coordinates of the test from the middle",
        "plate",
        config(*(moved_to_the_middle(x, y) for x, y in PLACES)),
        0,
        "6 of 6 points of hammer and sensors",
        "with (150, 100, 0) added to each of them",
    ),
    Mistake(
        "another axis than the file says",
        "plate",
        config(("[193.333, 60, 4], component: UZ", "[193.333, 60, 4], component: UX")),
        0,
        "was measured along UZ, but response acc3 is UX",
        "write responses.acc3.component: UZ",
    ),
    Mistake(
        "force over acceleration",
        "plate",
        text("frf/tight-1.uff", inverse),
        3,
        "the file contains no FRF",
        "response and reference are exchanged",
    ),
    Mistake("model in mm without units", "plate", config((UNITS, "")), 3, "do not fit the matrices", "`units: mm-N-t`"),
    Mistake("t for kg", "plate", config(("units: mm-N-t", "units: mm-kg-ms")), 3, "do not fit the matrices", "`units: mm-N-t`"),
    Mistake("units in capitals", "plate", config(("units: mm-N-t", "units: MM-N-T")), 2, "not a system of units", "units: mm-N-t"),
    Mistake("DOF table in mm", "frame", numbers("model/dofs.csv", times(1e3)), 3, "do not fit the matrices", "millimetres"),
    Mistake(
        "matrix in a .zip",
        "frame",
        all_of(write("model/K.zip", zipped("stiffness.mtx")), config((K, "data/model/K.zip"))),
        3,
        "this is a zip archive",
        "unpack it, and give the file that it contains: stiffness.mtx",
    ),
    Mistake(
        "FRFs in a workbook",
        "frame",
        all_of(write("frf/loose-2.xlsx", zipped("[Content_Types].xml", "xl/workbook.xml")), config((LOOSE, LOOSE[:-3] + "xlsx"))),
        3,
        "Excel workbook",
        "save the sheet as CSV",
    ),
    Mistake("file misspelt", "frame", config((LOOSE, "frf: data/frf/loose_2.csv")), 3, "does not exist", "did you mean 'loose-2.csv'?"),
    Mistake("folder misspelt", "frame", config((LOOSE, "frf: data/frfs/loose-2.csv")), 3, "does not exist", "there is no folder"),
    Mistake("no bytes", "frame", write("frf/loose-2.csv", b""), 3, "empty", "export it again"),
    Mistake("backslashes in quotes", "frame", config((LOOSE, r'frf: "data\frf\loose-2.csv"')), 2, "not valid YAML", "write paths with /"),
    Mistake("backslashes", "frame", config((LOOSE, r"frf: data\frf\loose-2.csv")), 3, "does not exist", "write paths with /"),
    Mistake("loss factor in per cent", "plate", config(("loss_factor: 0.01", "loss_factor: 1.0")), 0, "is 100%", "write 0.01"),
    Mistake(
        "loss factor of air",
        "plate",
        config(("loss_factor: 0.01}", "loss_factor: 0.01}\n    acoustic: {loss_factor: 0.02}")),
        0,
        "model.damping.acoustic has no effect",
        "Remove it",
    ),
    Mistake(
        "point in mm",
        "frame",
        config(("[0.16, 0.12, 0.0]", "[160, 120, 0]")),
        3,
        "excitation hammer lies outside the model",
        "these are probably millimetres",
    ),
    Mistake(
        "DOF table with the lines of fixed DOFs",
        "frame",
        text(
            "model/dofs.csv",
            lambda t: t.rstrip("\n") + "\n" + "".join(f"{n},{9000 + n},UZ,0,0,0\n" for n in range(t.count("\n") - 1, t.count("\n") + 2)),
        ),
        3,
        "it has 3 lines more than the matrices have rows: probably those of fixed or tied DOFs",
        "Remove these lines and number the others from 0",
    ),
    Mistake(
        "DOF table without its last lines",
        "frame",
        text("model/dofs.csv", lambda t: "\n".join(t.rstrip("\n").split("\n")[:-3]) + "\n"),
        3,
        "it has 3 lines fewer than the matrices have rows",
        "List every row",
    ),
    Mistake("wrong node", "plate", config(("near: [20, 100, 4]", "node: 9417")), 2, "node 9417", "numbered 101 to 509"),
    Mistake("wrong component", "frame", config(("0.28, 0.0], component: UZ", "0.28, 0.0], component: UX")), 2, "UX", "TWIST, UZ"),
    Mistake(
        "two sensors at one place",
        "frame",
        config(("[0.32, 0.28,", "[0.08, 0.20,")),
        0,
        "the same DOF",
        "correct the place of the wrong one",
    ),
    Mistake(
        "hammer and sensor exchanged",
        "plate",
        config(("[63.333, 60, 4]", "HIT"), ("[20, 100, 4]", "[63.333, 60, 4]"), ("HIT", "[20, 100, 4]")),
        0,
        "the hammer hit node 393",
        "Correct excitation.hammer",
    ),
    Mistake(
        "two sensors exchanged",
        "frame",
        all_of(*(numbers(name, exchanged) for name in FRFS)),
        0,
        "acc1 and acc2 are probably exchanged",
        "Exchange the places of responses.acc1 and responses.acc2",
    ),
    Mistake("sensor upside down", "frame", numbers(FRFS[1], times(-1, 3, 5)), 0, "reversed sign", "jobs.loose-2.scale: {acc2: -1}"),
    Mistake("g for m/s²", "frame", all_of(*(numbers(n, times(1 / 9.81, 1)) for n in FRFS)), 0, "g/N", "jobs.tight.format.unit: g/N"),
    Mistake(
        "velocities", "frame", all_of(*(numbers(n, integrated) for n in FRFS)), 0, "cause: velocity", "responses.acc1.quantity: velocity"
    ),
    Mistake("rad/s", "frame", numbers(FRFS[1], times(2 * np.pi, 0, 1)), 0, "If the frequencies are in rad/s", "{frequency_unit: rad/s}"),
    Mistake("kHz", "frame", numbers(FRFS[1], times(1e-3, 0, 1)), 3, "no frequency line of this measurement", "{frequency_unit: kHz}"),
    Mistake("coherence for FRF", "frame", write(FRFS[1], table("f,acc1,acc2,acc3,acc4", np.c_[HZ, COHERENCE])), 3, "pair", "`coherence`"),
    Mistake("time history", "frame", write(FRFS[1], table("time_s,acc1,acc2", np.c_[SECONDS, SECONDS, SECONDS])), 3, "time history", "H1"),
    Mistake(
        "time history in UFF",
        "plate",
        text("frf/b5-loose.uff", lambda t: re.sub(r"18(    0    0    0) Frequency            Hz", r"17\1 Time                 s ", t)),
        3,
        "not a frequency",
        "H1",
    ),
    Mistake("no phase", "frame", write(FRFS[1], table("f,acc1,acc2,acc3,acc4", np.c_[HZ, 7 * COHERENCE])), 3, "pair", "magnitudes"),
    Mistake(
        "decimal commas, frequencies whole",
        "frame",
        text(FRFS[1], whole),
        3,
        "both decimal sign and column separator",
        "with decimal points",
    ),
    Mistake("an output that is a file", "frame", lambda f: (f.path / "out").write_text(""), 0, "is a file, so no result", "`output`"),
    Mistake("decimal commas", "frame", text(FRFS[1], decimal_commas), 3, "both decimal sign and column separator", "with decimal points"),
    Mistake("no record in a job", "plate", text("frf/b5-loose.uff", without("acc2")), 0, "no record of acc2", "measure acc2 again"),
    Mistake("no record in the reference", "plate", text("frf/tight-1.uff", without("acc2")), 3, "no record of response acc2", "records"),
    Mistake(
        "a column renamed", "frame", text(FRFS[1], lambda t: t.replace("acc2_", "Sensor 2_")), 0, "no record of acc2", "{acc2: Sensor 2}"
    ),
    Mistake(
        "a sensor elsewhere",
        "frame",
        config(("acc1: {near: [0.32, 0.28", "acc1: {near: [0.32, 0.20")),
        0,
        "acc1 differs from the model by 10",
        "the place",
    ),
    Mistake(
        "a sensor elsewhere, in y",
        "frame",
        config(("acc1: {near: [0.32, 0.28", "acc1: {near: [0.20, 0.28")),
        0,
        "acc1 differs from the model",
        "the place",
    ),
    Mistake("loose reference", "frame", config(("reference: tight", "reference: loose-2")), 0, "taken as the tight state", "Give a job"),
    Mistake(
        "one file twice",
        "frame",
        config(("frf/loose-all.csv", "frf/loose-2.csv")),
        0,
        "no job uses loose-all.csv, which bears its name",
        "write jobs.loose-all.frf: data/frf/loose-all.csv",
    ),
    Mistake(
        "the file of a later job",
        "frame",
        all_of(config(("frf/loose-2.csv", "frf/loose-all.csv")), lambda f: (f.data / FRFS[1]).unlink()),
        0,
        "job loose-2: the same measurement as loose-all",
        "its own file under jobs.loose-2.frf",
    ),
    Mistake(
        "a copy", "frame", lambda f: shutil.copy(f.data / FRFS[1], f.data / FRFS[2]), 0, "the same measurement as loose-2", "its own file"
    ),
    Mistake("gaps", "frame", numbers(FRFS[1], gap), 3, "not a finite number", "measure it again"),
    Mistake("band too wide", "frame", config(("[30.0, 500.0]", "[30.0, 900.0]")), 0, "cover 54% of the band", "reduction.band: [30, 500]"),
    Mistake("band in kHz", "frame", config(("[30.0, 500.0]", "[0.03, 0.5]")), 3, "no frequency line", "write it in Hz: [30, 500]"),
    Mistake("bolts in mm", "frame", numbers("model/bolts.csv", times(1e3)), 3, "outside the model", "these are probably millimetres"),
    Mistake(
        "bolts along another edge",
        "frame",
        numbers("model/bolts.csv", lambda r: r[:, [1, 0, 2]]),
        0,
        "B3, B4, B5, B6 of the bolts file lie beside all identified terms",
        "with X and Y exchanged every bolt lies at terms",
    ),
    Mistake(
        "row of a bolt copied, its name not changed",
        "frame",
        text("model/bolts.csv", lambda t: t.replace("\nB3,", "\nB2,")),
        3,
        "lines 3 and 4 are both B2 but lie at different places (y ",
        "give one its own name",
    ),
    Mistake(
        "row of a bolt twice",
        "frame",
        text("model/bolts.csv", lambda t: re.sub(r"(\nB2,[^\n]*)", r"\1\1", t)),
        3,
        "is given twice in the table",
        "lines 3 and 4 are identical: remove one of the two",
    ),
    Mistake("bolt misspelt", "frame", config(("removed: [B3, B4]", "removed: [B3, B04]")), 2, "'B04'", "did you mean 'B4'?"),
    Mistake("no list", "frame", config(("removed: [B3, B4]", "removed: B3, B4")), 2, "wrong type", "write a list: [B3, B4]"),
    Mistake(
        "empty box",
        "frame",
        config((EDGE, "      component: ROTY\n      box: [[0.5, 0.6], [0.0, 0.4], [0, 0]]\n")),
        2,
        "no DOF ROTY lies in this box",
        "move it onto the model",
    ),
    Mistake(
        "terms twice",
        "frame",
        config(("bolts: data/model/bolts.csv", f"  again:\n    select:\n{EDGE}\nbolts: data/model/bolts.csv")),
        0,
        "left_edge and again contain the same 10 terms",
        "remove these terms from one",
    ),
    Mistake("hammer about an axis", "frame", config(("0.12, 0.0], component: UZ", "0.12, 0.0], component: ROTX")), 0, "a moment", "UZ"),
    Mistake(
        "stiffness copied as mass",
        "frame",
        all_of(lambda f: shutil.copy(f.data / "model/stiffness.mtx", f.data / "model/M.mtx"), config((M, "data/model/M.mtx"))),
        3,
        "model.mass: M.mtx contains the same numbers as model.stiffness (stiffness.mtx)",
        "check whether the stiffness was exported twice",
    ),
    Mistake(
        "stiffness copied as mass, in mm, N, t",
        "plate",
        lambda f: shutil.copy(f.data / "plate.sti.gz", f.data / "plate.mas.gz"),
        3,
        "model.mass: plate.mas.gz contains the same numbers as model.stiffness (plate.sti.gz)",
        "check whether the stiffness was exported twice",
    ),
    Mistake(
        "mass copied as damping",
        "frame",
        lambda f: shutil.copy(f.data / "model/mass.mtx.gz", f.data / "model/damping.mtx.gz"),
        0,
        "model.damping: damping.mtx.gz contains the same numbers as model.mass (mass.mtx.gz)",
        "check whether the mass was exported twice",
    ),
    Mistake(
        "input of an older mesh, which lacks the last nodes",
        "plate",
        text("plate.inp", lambda t: re.sub(r"\n(49\d|50\d),.*(?=\n(\d+, |\*))", "", t)),
        0,
        "plate.dof contains 20 nodes (490 to 509) that are missing in plate.inp",
        "Check whether plate.inp is the input that the matrices were exported from",
    ),
    Mistake(
        "places of the terms with x and y exchanged",
        "frame",
        numbers("model/edge.csv", lambda r: r[:, [1, 0, 2]]),
        0,
        "the places in edge.csv are up to 523 mm from the DOFs that their vectors act on",
        "with x and y exchanged they fit",
    ),
    Mistake(
        "places of the terms with x and y exchanged, without bolts",
        "frame",
        all_of(
            numbers("model/edge.csv", lambda r: r[:, [1, 0, 2]]),
            config(("bolts: data/model/bolts.csv", ""), ("    removed: [B3, B4]", ""), ("    removed: [B1, B2, B3, B4, B5, B6]", "")),
        ),
        0,
        "the places in edge.csv are up to 523 mm from the DOFs that their vectors act on",
        "with x and y exchanged they fit",
    ),
    Mistake(
        "sparse matrix of numpy.savez",
        "frame",
        all_of(
            lambda f: np.savez(f.data / "model/K.npz", K=np.array(sp.coo_array(np.eye(3)), dtype=object)),
            config((K, "data/model/K.npz")),
        ),
        3,
        "the array contains Python objects",
        "scipy.sparse.save_npz('K.npz', K)",
    ),
    Mistake(
        "a name short in HDF5",
        "frame",
        all_of(named_columns("acc1", "acc2", "acc3"), config((LOOSE, LOOSE[:-3] + "h5"), (TIGHT, TIGHT[:-3] + "h5"))),
        3,
        "`names` has 3 entries for the 4 columns of H and was not used",
        "correct it, or give records: {",
    ),
    Mistake("sensor off", "frame", numbers(FRFS[0], times(0.0, 5, 7)), 3, "acc3 is zero on the whole band", "remove acc3 from responses"),
    Mistake(
        "two sensors off",
        "frame",
        numbers(FRFS[0], times(0.0, 3, 7)),
        3,
        "the records of responses acc2, acc3 are zero on the whole band",
        "remove acc2, acc3 from responses",
    ),
    Mistake(
        "all sensors off", "frame", numbers(FRFS[0], times(0.0, 1)), 3, "acc1, acc2, acc3 are zero", "check the hammer's signal and its"
    ),
    Mistake(
        "hammer in metres",
        "plate",
        config(("[63.333, 60, 4]", "[0.063333, 0.060, 0.004]")),
        0,
        "the hammer hit node 393, but excitation.hammer is node 101",
        "multiplied by 1000, the given point lies there: write near: [63.333, 60, 4]",
    ),
    Mistake("stiffness as damping", "frame", config(("data/model/damping.mtx.gz", K)), 2, "give the same matrix", "give its own file"),
    Mistake("conjugate", "frame", all_of(*(numbers(n, conjugate) for n in FRFS)), 0, "probably of opposite sign", "Conjugate the FRF file"),
    Mistake(
        "coordinates of a sensor exchanged",
        "frame",
        config(("near: [0.32, 0.28, 0.0]", "near: [0.28, 0.32, 0.0]")),
        0,
        "acc1: sensor probably stated with x and y exchanged",
        "correct responses.acc1: near: [0.32, 0.28, 0]",
    ),
    Mistake("no quantity", "frame", config((ACC1, "}\n  acc2")), 0, "cause: acceleration", "responses.acc1.quantity: acceleration"),
    Mistake("table of a German office", "frame", text("model/bolts.csv", german), 3, "'-0,01'", "with decimal points"),
    Mistake("band reversed", "frame", config(("[30.0, 500.0]", "[500.0, 30.0]")), 2, "the range is empty", "write [30, 500]"),
    Mistake("a folder", "frame", config((LOOSE, "frf: data/frf")), 3, "a folder", "give a file in it"),
    Mistake("singular", "frame", config(("\njobs:", "\njob:")), 2, "'job'", "did you mean 'jobs'?"),
    Mistake("no logarithm", "frame", config(("initial: 6.5", "initial: 3.2e6")), 2, "left_edge.initial", "write 6.51"),
    Mistake(
        "factors in place of logarithms",
        "frame",
        config(("initial: 6.5", "initial: 1.0"), ("bounds: [2.0, 8.0]", "bounds: [1e-4, 30]")),
        2,
        "left_edge.bounds",
        "write log10 of each: initial: 0, bounds: [-4, 1.48]",
    ),
    Mistake("no logarithms", "frame", config(("bounds: [2.0, 8.0]", "bounds: [1e2, 1e9]")), 2, "left_edge.bounds", "write 2 for 100"),
    Mistake("terms in mm", "frame", numbers("model/edge.csv", times(1e3)), 3, "outside the model", "these are probably millimetres"),
    Mistake(
        "bushing at no node",
        "plate",
        text("bushings.csv", lambda t: t.replace("B1,129,", "B1,1290,")),
        3,
        "node 1290",
        "numbered 101 to 509",
    ),
    Mistake(
        "bolts fixed in the export",
        "plate",
        fixed_at_bolts,
        3,
        "coordinates, but no DOFs in the matrices",
        "Remove the boundary condition at the bolts",
    ),
    Mistake(
        "springs to a fixed node",
        "plate",
        all_of(
            text("plate.inp", lambda t: t.replace("NSET=ALL\n", "NSET=ALL\n999, 0, 0, -10\n")),
            text("bushings.csv", lambda t: re.sub(r"(?m)^(B\d,\d+),,", r"\1,999,", t)),
        ),
        3,
        "node 999 has coordinates, but no DOFs in the matrices",
        "leave node_b empty",
    ),
    Mistake(
        "sensor at a node that the export fixed",
        "plate",
        all_of(fixed_at_bolts, config(("near: [20, 100, 4]", "node: 129"))),
        2,
        "node 129 has no DOF UZ",
        "Remove the boundary condition that holds it",
    ),
    Mistake(
        "damping forgotten",
        "plate",
        config(
            ("  damping:\n    structure: {alpha: 0.0, beta: 0.0, loss_factor: 0.01}\n", ""),
            ("structure, loss_factor.structure]", "structure]"),
        ),
        0,
        "the model has no damping",
        "Write model.damping: {structure: {loss_factor: 0.01}}",
    ),
    Mistake(
        "stiffness named as mass, of a file that holds both",
        "frame",
        all_of(two_matrices, config((K, "data/model/model.h5#K"), (M, "data/model/model.h5#K"))),
        2,
        "found:    model.h5#K",
        "write model.mass: data/model/model.h5#M; the file contains K, K_x, M",
    ),
    Mistake("springs twice", "plate", config(("baseline: 1.0  ", "baseline: 0.0  ")), 0, "count twice", "parameters.bolts.baseline: 1.0"),
    Mistake("key misspelt", "frame", config(("reduction: {band", "reduktion: {band")), 2, "'reduktion'", "did you mean 'reduction'?"),
    Mistake("indented wrongly", "frame", config(("\n  reference: tight", "\nreference: tight")), 2, "line 51", "indentation"),
    Mistake("a tab", "frame", config(("\n  reference: tight", "\n\treference: tight")), 2, "a tab", "replace tabs with blanks"),
    Mistake("decimal commas in a point", "frame", config(("[0.16, 0.12, 0.0]", "[0,16, 0,12, 0,0]")), 2, "at most 3", "decimal points"),
    Mistake("decimal comma", "frame", config(("initial: 6.5", "initial: 6,5")), 2, "'6,5'", "decimal point"),
    Mistake("no such response", "frame", config(("acc2, acc3]", "acc2, acc5]")), 2, "'acc5'", "did you mean 'acc4'?"),
    Mistake("no blank after a colon", "frame", config(("output: out", "output:out")), 2, "line 16", "a blank after the colon"),
    Mistake(
        "bolts from another origin",
        "frame",
        numbers("model/bolts.csv", lambda r: r - [0.0, 0.2, 0.0]),
        0,
        "B1, B2, B3 of the bolts file lie beside all identified terms",
        "with +0.2 m in Y added every bolt lies at terms",
    ),
    Mistake(
        "bolts of a longer structure",
        "frame",
        numbers("model/bolts.csv", lambda r: (r - r.mean(axis=0)) * 1.5 + r.mean(axis=0) + [0.0, 0.0, 0.005]),
        0,
        "2 of 6 bolts cannot be judged (B1, B6)",
        "All bolts of the file lie 5 mm or more off the plane of the structure, too: it is probably that of another structure",
    ),
    Mistake(
        "places of bolts as radius and angle",
        "plate",
        numbers("bolts.csv", lambda r: np.column_stack([np.hypot(r[:, 0], r[:, 1]), np.rad2deg(np.arctan2(r[:, 1], r[:, 0])), r[:, 2]])),
        0,
        "lie nearer to the springs of other bolts than to their own",
        "with x as radius and y as angle in degrees they lie at their springs",
    ),
    Mistake(
        "a bolt without a spring",
        "plate",
        text("bushings.csv", lambda t: "".join(line for line in t.splitlines(keepends=True) if not line.startswith("B4,"))),
        0,
        "1 of 6 bolts cannot be judged (B4): no term belongs to it",
        "Add springs there to the tables of parameters.NAME.select",
    ),
    Mistake(
        "a box that ends in the middle of the edge",
        "frame",
        config((EDGE, "      component: ROTY\n      box: [[-0.001, 0.001], [0.0, 0.17], [0, 0]]\n")),
        0,
        "left_edge.select.box ends at y = 0.17 in the middle of the edge: B4, B5, B6 lie beyond it",
        "Write [0, 0.366667] for y",
    ),
    Mistake(
        "a measurement that no job names",
        "frame",
        lambda folder: shutil.copy(folder.data / FRFS[1], folder.data / "frf" / "monday.csv"),
        0,
        "no job uses monday.csv",
        "add a job for it",
    ),
    Mistake(
        "a cable off in one job",
        "frame",
        numbers(FRFS[1], without_signal(2)),
        0,
        "dB below its level in tight, the other responses are not",
        "Measure it again, or remove its record from the file of loose-2",
    ),
    Mistake(
        "a sensor turned over in a loosened job alone",
        "plate",
        config(("b5-loose: {frf: data/frf/b5-loose.uff}", "b5-loose: {frf: data/frf/b5-loose.uff, scale: {acc3: -1}}")),
        0,
        "job b5-loose: probably reversed sign: acc3",
        "jobs.b5-loose.scale: {acc3: 1}",
    ),
    Mistake(
        "reference measured with loose bolts",
        "plate",
        lambda folder: shutil.copy(folder.data / "frf" / "b5-loose.uff", folder.data / "frf" / "tight-1.uff"),
        0,
        "With B5 at 0.06 of its stiffness the level misfit is",
        "B5 was probably loose in tight-1. Set update.reference and calibration.job to a tight job, such as tight-2",
    ),
    Mistake(
        "hammer and sensors mirrored",
        "plate",
        config(*((f"near: [{x}, {y}, 4]", f"near: [{300 - float(x):.3f}, {y}, 4]") for x, y in PLACES)),
        0,
        "at other nodes of the model than the campaign file says; these are its places mirrored or turned",
        "Give hammer, sensors and bolts in the axes of the model",
    ),
    Mistake(
        "coherence of something else",
        "frame",
        all_of(
            write("frf/coh.csv", table("f,x1,x2", np.c_[HZ, COHERENCE[:, 2:]])),
            config((LOOSE, f"{LOOSE}\n    coherence: data/frf/coh.csv")),
        ),
        0,
        "no coherence of the job belongs to a response (x1, x2)",
        "Name its columns",
    ),
    Mistake(
        "bins counted from 1 in one job",
        "frame",
        numbers(FRFS[1], lambda r: r - np.eye(1, 9)),
        0,
        "its frequency lines differ from those of tight (470 lines from 30 to 499 Hz instead of 471 lines from 30 to 500 Hz)",
        "Its file begins 1 Hz lower than that of tight, with as many lines. Check whether they were counted from another first line",
    ),
    Mistake(
        "every other line left out in one job",
        "frame",
        numbers(FRFS[1], lambda r: r[::2]),
        0,
        "its frequency lines differ from those of tight (236 lines from 30 to 500 Hz instead of 471 lines from 30 to 500 Hz)",
        "Measure or export it on the lines of tight",
    ),
    Mistake(
        "lines interpolated",
        "frame",
        all_of(*(numbers(name, quarter_lines, plain="%.5g") for name in FRFS)),
        0,
        "job tight: probably only one of 4 lines was measured",
        "Export the lines as they were measured",
    ),
    Mistake(
        "a change that calls all bolts tight",
        "plate",
        config(("baselines: [tight-2]", "baselines: [tight-2]\n  loose_change: -3")),
        0,
        "calls a bolt tight that lost up to 99.9 %",
        "Remove loose_change",
    ),
    Mistake(
        "a prior that expects no change",
        "frame",
        config(("loss_scale: 1.0", "loss_scale: 1.0\n  prior_std: 0.01")),
        0,
        "-0.35 decades, 35 standard deviations away",
        "Write auto",
    ),
    Mistake(
        "bounds between which no bolt is loose",
        "plate",
        config(("bounds: [-3.0, 1.0]", "bounds: [-0.3, 1.0]")),
        0,
        "no bolt can become loose: from the start value 0 it cannot fall below -0.3",
        "Write a lower bound of -3 or less",
    ),
    Mistake(
        "bounds within which no joint can lose a decade",
        "plate",
        config(("bounds: [-3.0, 1.0]", "bounds: [-0.6, 1.0]")),
        0,
        "from the start value 0 a joint cannot fall below -0.6, but a loose one loses one to three decades",
        "Write a lower bound of -3 or less",
    ),
    Mistake(
        "start value of springs in N/mm",
        "plate",
        config(("initial: 0.0", "initial: 3.0"), ("bounds: [-3.0, 1.0]", "bounds: [-3.0, 4.0]")),
        0,
        "parameters.bolts.initial: 3 means 1000 times the stiffnesses in bushings.csv",
        "write initial: 0",
    ),
    Mistake(
        "a loosened job as baseline",
        "plate",
        config(("baselines: [tight-2]", "baselines: [b5-loose]")),
        0,
        "job b5-loose: it is taken as tight, but differs",
        "check whether all bolts were tight. Remove it from update.baselines",
    ),
    Mistake(
        "calibrated by a loosened job",
        "plate",
        config(("  job: tight-1", "  job: b5-loose")),
        0,
        "job b5-loose: it is taken as tight, but differs",
        "Set calibration.job to a tight job",
    ),
    Mistake(
        "matrix exported without its springs",
        "plate",
        without_springs("B1", "B2", "B3", "B4", "B5", "B6"),
        0,
        "the matrix contains none of the springs of bushings.csv",
        "write parameters.bolts.baseline: 0, or export it with the springs",
    ),
    Mistake(
        "matrix exported with a bolt missing",
        "plate",
        without_springs("B5"),
        0,
        "the matrix contains no spring at node 239 (B5), where bushings.csv has one",
        "Export it with all of them, or correct the nodes in bushings.csv",
    ),
    Mistake(
        "springs of one bolt at the node beside",
        "plate",
        text("bushings.csv", lambda t: t.replace("B4,233,", "B4,234,")),
        0,
        "the matrix contains no spring at node 234 UX (B4), but one of that stiffness at node 233",
        "correct the nodes in bushings.csv (3 springs)",
    ),
    Mistake(
        "node 0 for ground",
        "plate",
        text("bushings.csv", lambda t: t.replace(",,", ",0,")),
        3,
        "node 0 does not exist",
        "leave node_b empty if a spring goes to ground",
    ),
    Mistake(
        "bolts from the middle of the plate",
        "plate",
        numbers("bolts.csv", lambda r: r - [150.0, 100.0, 0.0]),
        0,
        "B5, B6 lie nearer to the springs of other bolts than to their own",
        "probably given from another origin: add (150, 100, 0) to all of them",
    ),
    Mistake(
        "bolts counted from the other end",
        "plate",
        text("bolts.csv", lambda t: re.sub(r"(?m)^B([1346])", lambda m: f"B{dict(zip('1346', '3164', strict=True))[m[1]]}", t)),
        0,
        "B3 at the springs of B1, B1 at the springs of B3, B6 at the springs of B4, B4 at the springs of B6",
        "In the bolts file write the names in the order B1, B2, B3, B4 ... B6",
    ),
    Mistake(
        "places of the terms from the other end",
        "frame",
        numbers("model/edge.csv", lambda r: r[::-1]),
        0,
        "the places in edge.csv are up to 340 mm from the DOFs that their vectors act on",
        "in reverse order they fit; reverse the rows",
    ),
    Mistake(
        "one job hit at another node",
        "plate",
        text("frf/b5-loose.uff", lambda t: t.replace(" 393   3", " 399   3")),
        0,
        "b5-loose.uff: the hammer hit node 399, but excitation.hammer is node 393 of the model",
        "if only this measurement is affected, measure it again at node 393",
    ),
    Mistake(
        "nodes of an older design",
        "plate",
        stretched(lambda x: 320.0 / 300.0 * x),
        0,
        "the coordinates of the nodes are probably not those of the stiffness matrix: a rigid rotation about y causes forces at 28%",
        "the nodes of the model that was exported",
    ),
    Mistake(
        "nodes mirrored",
        "plate",
        stretched(lambda x: 300.0 - x),
        0,
        "the coordinates of the nodes are probably not those of the stiffness matrix",
        "with x mirrored it does not. Correct the coordinates",
    ),
    Mistake(
        "stiffness with four digits",
        "plate",
        few_digits,
        0,
        "the numbers of the stiffness matrix have 5 digits or fewer",
        "Export the matrices with all digits",
    ),
    Mistake(
        "stiffness of a regular mesh with four digits",
        "frame",
        four_digits,
        0,
        "the numbers of the stiffness matrix have 5 digits or fewer",
        "Export the matrices with all digits",
    ),
    Mistake(
        "structural damping for a viscous one",
        "frame",
        structural(0.02),
        0,
        "model.damping: the matrix is 0.02 times the stiffness, probably structural damping",
        "Write model.damping: {structure: {loss_factor: 0.02}}",
    ),
    Mistake(
        "structural damping below critical at the lower end of the band",
        "frame",
        structural(0.01),
        0,
        "model.damping: the matrix is 0.01 times the stiffness, probably structural damping",
        "Write model.damping: {structure: {loss_factor: 0.01}}",
    ),
    Mistake(
        "a tolerance to save time",
        "frame",
        config(("tolerance: 1.0e-3", "tolerance: 0.5")),
        0,
        "reduction.tolerance: 0.5 allows errors of 3.5 dB in the FRFs of the reduced model",
        "Write 1.0e-3",
    ),
    Mistake(
        "the responses to be left out listed as those used",
        "frame",
        config(("responses: [acc1, acc2, acc3]", "responses: [acc4]")),
        0,
        "update.responses: 1 of 4 responses is used, 3 are left to validate",
        "check whether those to be left out were meant, and list the others",
    ),
    Mistake(
        "band in kHz",
        "frame",
        config(("band: [30.0, 500.0]", "band: [0.03, 0.5]")),
        3,
        "same error: loose-2.csv, loose-all.csv",
        "if reduction.band is in kHz, write it in Hz: [30, 500]",
    ),
    Mistake(
        "a repeat of another state",
        "plate",
        config(("data/frf/b5-loose.uff}", "data/frf/b5-loose.uff, repeats: [data/frf/tight-2.uff]}")),
        0,
        "b5-loose.uff: its repeat tight-2.uff differs from it by 9.0 dB",
        "Remove it from jobs.b5-loose.repeats",
    ),
    Mistake(
        "one line of a hundred",
        "frame",
        config(("lines: resonances", "lines: {every: 100}")),
        0,
        "update.lines: {every: 100} selects no line at most of the resonances, where changes show most: tight (7 of 7), ",
        "Write lines: resonances",
    ),
    Mistake(
        "exponential window in one job",
        "frame",
        numbers(FRFS[1], parts(exponential)),
        0,
        "job loose-2: all 6 modes that can be compared decay faster than in tight by the same ",
        "Use one window in all jobs",
    ),
    Mistake(
        "exponential window in the reference job alone",
        "frame",
        numbers(FRFS[0], parts(exponential)),
        0,
        "Check whether an exponential window was set for tight",
        "Use one window in all jobs",
    ),
    Mistake(
        "AC coupling of one channel in one job",
        "frame",
        numbers(FRFS[1], parts(high_pass)),
        0,
        "job loose-2: phases are turned relative to the other responses at all modes: acc2 by ",
        "Measure again with the same settings",
    ),
    Mistake(
        "mains hum in one job",
        "frame",
        numbers(FRFS[1], parts(hum)),
        0,
        "job loose-2: probably mains hum of 50 Hz",
        "earth the whole chain at one point",
    ),
    Mistake(
        "one column pasted over another",
        "frame",
        numbers(FRFS[1], parts(lambda _, values: values[:, [0, 0, 2, 3]])),
        0,
        "job loose-2: acc1 and acc2 have the same numbers",
        "Export the record of each again",
    ),
    Mistake(
        "numbers of the lines for frequencies",
        "frame",
        numbers(FRFS[1], lambda rows: np.column_stack([np.arange(len(rows)), rows[:, 1:]])),
        0,
        "Its frequencies are probably the numbers of its lines, counted from 0",
        "jobs.loose-2.format.frequency",
    ),
    Mistake(
        "a line twice",
        "frame",
        text(FRFS[1], lambda content: re.sub(r"(?m)^(228,.*\n)", r"\1\1", content)),
        3,
        "the frequencies do not increase",
        "remove the duplicate line",
    ),
    Mistake("radians called degrees", "frame", text(FRFS[1], radians), 0, "heading says degrees, but no phase is larger", "{phase: rad}"),
    Mistake(
        "names of bolts sorted without their places",
        "frame",
        all_of(text("model/bolts.csv", sorted_apart), config(("    removed: [B3, B4]\n", ""))),
        0,
        "bolts: B1, B10, B11, B2 ... lie in a row in alphabetical order",
        "give each bolt its own place",
    ),
    Mistake(
        "density of steel for aluminium",
        "frame",
        matrix_times("mass.mtx.gz", 2.9),
        0,
        "all measured resonances are probably at 1.69 times the frequencies of the model",
        "The model is too soft or too heavy (modulus, thickness, density); the mass matrix is 2.9 times too large",
    ),
    Mistake(
        "modulus of aluminium for steel, springs of bolts as they are",
        "frame",
        matrix_times("stiffness.mtx", 1 / 3),
        0,
        "the stiffness matrix is 3 times too small",
        "scale: 3}",
    ),
    Mistake(
        "another sampling rate typed in for one job",
        "frame",
        numbers(FRFS[1], times(1.02, 0, 1)),
        0,
        "Its frequencies are 1.02 times those of tight, line by line",
        "Divide them by 1.02",
    ),
    Mistake(
        "another sampling rate typed in for all jobs",
        "frame",
        all_of(*(numbers(n, times(51.2 / 48, 0, 1)) for n in FRFS)),
        0,
        "all measured resonances are probably at 1.06 times the frequencies of the model",
        "divide the frequencies by 1.06",
    ),
    Mistake(
        "a clock 2 % fast in one job",
        "frame",
        numbers(FRFS[1], other_clock(1.02)),
        0,
        "3 of the 4 modes that can be compared are 1.74% higher than in tight",
        "Set it as in tight",
    ),
    Mistake(
        "a clock 2 % slow in one job",
        "frame",
        numbers(FRFS[1], other_clock(0.98)),
        0,
        "are 2.21% lower than in tight",
        "Set it as in tight",
    ),
    Mistake(
        "band in rad/s",
        "frame",
        config(("band: [30.0, 500.0]", "band: [188.5, 3141.6]")),
        0,
        "if the band is in rad/s, write it in Hz: reduction.band: [30, 500]",
        "also found in loose-2.csv, loose-all.csv",
    ),
    Mistake(
        "band beyond what was measured",
        "frame",
        config(("band: [30.0, 500.0]", "band: [30.0, 2000.0]")),
        0,
        "the lines from 30 to 500 Hz cover 24% of the band from 30 to 2000 Hz. Check whether the file is complete.",
        "Otherwise measure again over the whole band, or end the band of all jobs there: reduction.band: [30, 500]; also found in",
    ),
    Mistake(
        "each record normalised to its peak",
        "frame",
        numbers(FRFS[1], parts(lambda hz, values: values / np.abs(values).max(axis=0))),
        0,
        "loose-2.csv: every record has its largest magnitude at 1: each was normalised to its own peak",
        "Export the FRFs as response over force, without normalisation",
    ),
    Mistake(
        "one sensitivity ten times off in the reference job",
        "frame",
        numbers(FRFS[0], some(10.0, 2)),
        0,
        "job tight: probably a wrong sensitivity: acc3: measured over computed +19.96 dB",
        "a sensitivity or a range ten times off. Write jobs.tight.scale: {acc3: 0.1}",
    ),
    Mistake(
        "one sensitivity ten times off in a job with loose bolts",
        "frame",
        numbers(FRFS[1], some(10.0, 0)),
        0,
        "job loose-2: probably a wrong sensitivity: acc1: measured over computed +2",
        "a sensitivity or a range ten times off. Write jobs.loose-2.scale: {acc1: 0.1}",
    ),
    Mistake(
        "peak values, and a factor that the job has already",
        "frame",
        config(("  tight: {frf: ", "  tight: {scale: 1.5, frf: ")),
        0,
        "probable cause: rms and peak values mixed",
        "jobs.tight.scale: 1.06066",
    ),
    Mistake(
        "direction of one sensor",
        "plate",
        config(("acc3: {near: [193.333, 60, 4], component: UZ", "acc3: {near: [193.333, 60, 4], component: UX")),
        0,
        "acc3: sensor stated along UX probably measures along UZ",
        "Correct responses.acc3: component: UZ",
    ),
    Mistake(
        "reference job renamed in its list only",
        "frame",
        config(("  tight: {frf: ", "  tight-1: {frf: ")),
        2,
        "update.reference: no job has the name 'tight'",
        "did you mean 'tight-1'? (calibration.job names it as well)",
    ),
    Mistake(
        "band of one resonance",
        "frame",
        config(("band: [30.0, 500.0]", "band: [205.0, 250.0]")),
        0,
        "1 resonance in the band from 205 to 250 Hz",
        "Widen reduction.band (the file contains 30 to 500 Hz)",
    ),
    Mistake(
        "hit twice in one job",
        "frame",
        numbers(FRFS[1], parts(hit_twice)),
        0,
        "the hammer probably hit a second time in this job, 12 ms later and 50% as hard",
        "measure this job again",
    ),
    Mistake(
        "coordinates turned by 90 degrees",
        "plate",
        text("plate.inp", turned_by_90_degrees),
        0,
        "with all rotated by 90 degrees about z it does not",
        "Correct the coordinates in plate.inp, or the components if these are wrong",
    ),
    Mistake(
        "hammer along another axis than the file says",
        "plate",
        config(("hammer: {near: [63.333, 60, 4], component: UZ}", "hammer: {near: [63.333, 60, 4], component: UX}")),
        0,
        "tight-1.uff: the hammer hit along UZ, but excitation.hammer is UX",
        "correct excitation.hammer.component",
    ),
    Mistake("two measurements in one file", "frame", text(FRFS[1], appended), 3, "not increase", "points up to 471 or those from 472 on"),
    Mistake("two-sided spectra", "frame", numbers(FRFS[1], two_sided), 3, "-500 at point 1", "export one-sided spectra"),
    Mistake(
        "damping ratio for beta",
        "plate",
        config(("beta: 0.0, loss_factor: 0.01", "beta: 0.02"), ("loss_factor.structure", "beta.structure")),
        0,
        "beta is in seconds",
        "write loss_factor: 0.04 for both",
    ),
    Mistake(
        "smoothing in per cent",
        "frame",
        config(("smoothing: [0.333333, 0.666667, 0.333333]", "smoothing: [33, 67, 33]")),
        2,
        "a sum of 133",
        "write [0.33, 0.67, 0.33]",
    ),
    Mistake(
        "smoothing with equal weights",
        "frame",
        config(("smoothing: [0.333333, 0.666667, 0.333333]", "smoothing: [1, 1, 1]")),
        2,
        "1 in the middle, 2 beside it",
        "remove smoothing",
    ),
    Mistake(
        "a list as one string",
        "frame",
        config(("responses: [acc1, acc2, acc3]", "responses: acc1 acc2 acc3")),
        2,
        "the text 'acc1 acc2 acc3'",
        "write a list: [acc1, acc2, acc3]",
    ),
    Mistake(
        "a gain in per cent",
        "frame",
        config(("update:\n", "update:\n  nuisances: {gain: 12}\n")),
        0,
        "12 is a standard deviation in dB, a factor of 4",
        "write 0.98",
    ),
    Mistake("rows counted from 1", "frame", config(("row: 1,", "row: 2,"), ("row: 0,", "row: 1,")), 2, "0 to 1", "counted from 0"),
    Mistake(
        "no digits after the point",
        "frame",
        numbers(FRFS[1], lambda rows: rows * [1.0, *[0.03] * 8], plain="%.0f"),
        0,
        "loose-2.csv: numbers with too few digits",
        "in exponential format",
    ),
    Mistake(
        "confidence in per cent",
        "frame",
        config(("update:\n", "update:\n  confidence: 95\n")),
        2,
        "update.confidence: a value that is not allowed",
        "probably in per cent: write 0.95",
    ),
    Mistake(
        "coherence of a single blow",
        "frame",
        numbers(
            FRFS[1],
            lambda rows: np.column_stack([rows, np.ones((len(rows), 2))]),
            header=f"{COLUMNS},acc1_coherence,acc2_coherence",
        ),
        0,
        "loose-2.csv: the coherence of acc1, acc2 is 1 at every line",
        "write jobs.loose-2.averages: 1",
    ),
    Mistake(
        "frequencies without their first line",
        "frame",
        all_of(
            lambda folder: scipy.io.savemat(folder.data / "frf/loose-2.mat", {"f": HZ[1:], "H": np.ones((HZ.size, 4)) * (1.0 + 1.0j)}),
            config((LOOSE, LOOSE[:-3] + "mat")),
        ),
        3,
        "no FRF was recognised in the file",
        "f has 470 entries, H has 471 lines",
    ),
    Mistake(
        "a loose state as the reference job and for the calibration",
        "plate",
        config(("  reference: tight-1", "  reference: b5-loose"), ("  job: tight-1", "  job: b5-loose"), ("  baselines: [tight-2]\n", "")),
        0,
        "fit the tight model far better than b5-loose",
        "With B5 at 0.06 of its stiffness the level misfit is 3.8 dB: check whether all bolts were tight",
    ),
    Mistake(
        "files of the reference job and of a loose one exchanged",
        "plate",
        config(("tight-1.uff", "OTHER"), ("b3-half-b4-loose.uff", "tight-1.uff"), ("OTHER", "b3-half-b4-loose.uff")),
        0,
        "fit the tight model far better than tight-1",
        "If files are exchanged, exchange jobs.tight-1.frf and jobs.",
    ),
    Mistake(
        "a loose state as the reference job beside a calibration from a tight one",
        "plate",
        config(("reference: tight-1", "reference: b3-half-b4-loose")),
        0,
        "fit the tight model far better than b3-half-b4-loose",
        "Set update.reference to a tight job, such as tight-1",
    ),
    Mistake(
        "x and y of the hammer exchanged",
        "frame",
        config(("[0.16, 0.12, 0.0]", "[0.12, 0.16, 0.0]")),
        0,
        "job tight: the hammer probably hit elsewhere",
        "Correct excitation.hammer: near: [0.16, 0.12, 0]",
    ),
]


def check(folder: Folder, sample: str) -> Result:
    return lrbc("check", folder.config, "--cache", reduced_cache(sample))


def make(sample: str, path: Path) -> Folder:
    return {"frame": make_frame, "plate": make_plate}[sample](path)


@pytest.mark.parametrize("mistake", [pytest.param(m, id=m.what, marks=[pytest.mark.slow] if m.what in DEAR else []) for m in MISTAKES])
def test_a_mistake_is_found_and_its_fix_named(tmp_path: Path, mistake: Mistake) -> None:
    folder = make(mistake.sample, tmp_path)
    mistake.damage(folder)
    before = folder.listing()
    result = check(folder, mistake.sample)
    assert result.code == mistake.code, result.stderr
    told = result.stderr if mistake.code else result.stdout.partition("\nwarnings\n")[2]
    for part in (mistake.says, mistake.fix, *(["fix:"] if mistake.code and "expected:" not in told else [])):
        assert part in told, f"{part!r} is not in:\n{told}"
    assert folder.listing() == before


@pytest.mark.parametrize("sample", ["frame", "plate"])
def test_nothing_is_wrong_with_the_samples(tmp_path: Path, sample: str) -> None:
    result = check(make(sample, tmp_path), sample)
    assert (result.code, result.stderr) == (0, "")
    assert "\nwarnings\n" not in result.stdout


def test_every_wrong_response_and_group_is_told_at_once(tmp_path: Path) -> None:
    folder = make_frame(tmp_path)
    config(("near: [0.32, 0.28, 0.0]", "node: 9001"), ("near: [0.08, 0.20, 0.0]", "node: 9002"), ("row: 1,", "row: 7,"))(folder)
    config((EDGE, "      component: ROTY\n      box: [[0.5, 0.6], [0.0, 0.4], [0, 0]]\n"))(folder)
    result = check(folder, "frame")
    assert result.code == 2
    for part in ("node 9001", "node 9002", "responses.acc4.row", "left_edge.select.box"):
        assert result.stderr.count(part + " ") or result.stderr.count(part + ":"), result.stderr
    assert "4 errors to fix" in result.stdout


def test_points_in_millimetres_are_told_once(tmp_path: Path) -> None:
    """Each of hammer and ten microphones had a block of its own."""
    folder = make_frame(tmp_path)
    folder.config.write_text(
        re.sub(
            r"near: \[(.+?)\]", lambda m: f"near: [{', '.join(f'{1e3 * float(x):g}' for x in m[1].split(','))}]", folder.config.read_text()
        )
    )
    result = check(folder, "frame")
    assert result.code == 3
    assert "campaign.yaml, excitation and responses: excitation hammer and both responses lie outside the model" in result.stderr
    assert result.stderr.count("these are probably millimetres: divided by 1000 they fit") == 1
    text("model/bolts.csv", lambda t: t.replace("B2,-0.01", "B2,-10"))(folder := make_frame(tmp_path / "bolts"))
    assert "bolts.csv: bolt B2 lies outside" in check(folder, "frame").stderr
    numbers("model/bolts.csv", times(1e3))(folder := make_frame(tmp_path / "all"))
    assert "bolts.csv: all 6 bolts lie outside" in check(folder, "frame").stderr


def test_places_from_another_origin_are_the_one_thing_told(tmp_path: Path) -> None:
    """Sensors that fell on one node were to be taken out, though every one is good."""
    folder = make_plate(tmp_path)
    config(*(moved_to_the_middle(*place) for place in PLACES))(folder)
    told = check(folder, "plate").stdout.partition("\nwarnings\n")[2].splitlines()
    assert len(told) == 1
    assert "measured from another origin than that of the model" in told[0]


def test_exchanged_axes_of_the_nodes_are_the_one_thing_told(tmp_path: Path) -> None:
    """Bolts, hammer and sensors, all of them right, were to be corrected, and finer rows of the sensors to be written."""
    folder = make_plate(tmp_path)
    nodes = re.compile(r"(?m)^(\d+), *([^,\n]+), *([^,\n]+), *([^,\n]+)$")
    text("plate.inp", lambda t: nodes.sub(lambda m: f"{m[1]}, {m[3]}, {m[2]}, {m[4]}", t))(folder)
    told = check(folder, "plate").stdout.partition("\nwarnings\n")[2].splitlines()
    assert len(told) == 1
    assert "with x and y exchanged it does not. Correct the coordinates in plate.inp" in told[0]


@pytest.mark.slow
def test_bolts_beside_their_springs_are_told_once_for_all_tables(tmp_path: Path) -> None:
    folder = make_plate(tmp_path)
    shutil.copy(folder.data / "bushings.csv", folder.data / "again.csv")
    select = "    select: {bushings: data/bushings.csv}    # bolt, node, component, stiffness\n"
    config(
        (select, select.replace("csv}", "csv, component: UX}") + SIDEWAYS),
        ("factors: [stiffness.structure, loss_factor.structure]", "factors: [stiffness.structure]"),
    )(folder)
    text("bolts.csv", lambda t: t.replace("B1,", "B9,").replace("B2,", "B1,").replace("B9,", "B2,"))(folder)
    told = check(folder, "plate").stdout
    assert told.count("B2, B1 lie nearer to the springs of other bolts") == 1
    assert "(nodes given in bushings.csv and again.csv)" in told


def test_a_measurement_in_the_watched_folder_that_no_pattern_takes(tmp_path: Path) -> None:
    folder = make_frame(tmp_path)
    config(("jobs:", "watch: {folder: data/frf, pattern: '*.csv'}\n\njobs:"))(folder)
    shutil.copy(folder.data / FRFS[1], folder.data / "frf" / "second.dat")
    (folder.data / "frf" / "remarks.pdf").write_bytes(b"%PDF")
    told = check(folder, "frame").stdout.partition("\nwarnings\n")[2]
    assert "second.dat" in told
    assert "add '*.dat' there" in told
    assert "remarks" not in told
    assert FRFS[1].partition("/")[2] not in told


@pytest.mark.slow
def test_nodes_that_a_program_added_to_shells_are_no_mistake(tmp_path: Path) -> None:
    """Shells of CalculiX are expanded to solids with nodes of their own."""
    folder = make_plate(tmp_path)
    text("plate.inp", lambda t: re.sub(r"\n(49\d|50\d),.*(?=\n(\d+, |\*))", "", t).replace("TYPE=C3D20R", "TYPE=S8R"))(folder)
    result = check(folder, "plate")
    assert result.code == 0, result.stderr
    assert "60 DOFs of 20 nodes that are not in plate.inp are internal DOFs of the FE program" in result.stdout
    assert "missing in plate.inp" not in result.stdout


def test_without_a_reduced_model_a_coarse_one_tells_as_much(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing is kept of it; what else the machine does makes no difference."""
    monkeypatch.setattr(predict, "_product_rate", lambda: 1e6)
    folder = make_frame(tmp_path)
    numbers(FRFS[0], times(1 / 9.81, 1))(folder)
    result = folder.run("check")
    assert "job tight: probably not in the model's units" in result.stdout
    assert not folder.cache.exists()


@pytest.mark.slow
def test_factors_that_explain_nothing_cost_a_few_full_lines_each(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A soft model has thousands of modes in the band: reducing it took minutes."""
    solved = []

    def counted(model: FeModel, input_of: np.ndarray, s: np.ndarray, *args: object, **options: object) -> PortFrf:
        solved.append(s.size)
        return full_ports(model, input_of, s, *args, **options)  # type: ignore[arg-type]

    monkeypatch.setattr(trials, "full_ports", counted)
    inputs = make_plate(tmp_path).inputs()
    noise, smooth = np.random.default_rng(0).normal(size=(200, 5)) + 0j, np.ones((1, 200, 5), dtype=complex)
    parameters: Any = SimpleNamespace(initial=None, dynamic=lambda _, s: np.ones((s.size, inputs.model.terms.size), dtype=complex))
    job = seen(10.0**noise, smooth, hz=np.linspace(200.0, 800.0, 200), inputs=inputs, parameters=parameters)
    assert rescaled.rescaled_text(job, 6.0) is None
    # Four units, one or two digits, two gravities.
    assert solved == [12] * 8
    monkeypatch.setattr(rescaled, "MOST_WORK", 1e3)
    assert rescaled.rescaled_text(job, 6.0) is None
    assert len(solved) == 8


def test_bolts_that_may_lie_elsewhere_are_no_all_clear(tmp_path: Path) -> None:
    """A loose bolt stood beside all terms, and the others were clear."""
    folder = make_frame(tmp_path)
    numbers("model/bolts.csv", lambda r: r - [0.0, 0.2, 0.0])(folder)
    assert lrbc("update", folder.config, "--cache", reduced_cache("frame"), "--job", "tight", "--job", "loose-2").code == 0
    valid = folder.result("loose-2")["validity"]
    assert valid["passed"] is not True
    assert "check whether the file was written in other axes or from another origin" in valid["reason"]


@pytest.mark.slow
def test_a_measurement_that_no_job_names_is_told_beside_an_all_clear(tmp_path: Path) -> None:
    folder = make_frame(tmp_path)
    shutil.copy(folder.data / FRFS[1], folder.data / "frf" / "monday.csv")
    done = lrbc("update", folder.config, "--cache", reduced_cache("frame"))
    assert "no job uses monday.csv" in done.stderr
    alone = lrbc("update", folder.config, "--cache", reduced_cache("frame"), "--job", "tight")
    assert "monday" not in alone.stderr


@pytest.mark.slow
def test_a_calibration_leaves_the_springs_of_the_matrix_as_they_are(tmp_path: Path) -> None:
    """The plate a third too stiff beside springs that are right: only the plate is corrected, by any amount."""
    folder = make_plate(tmp_path)
    triplets_times("plate.sti.gz", 1.35)(folder)
    text("bushings.csv", lambda t: re.sub(r"([\d.e+]+)$", lambda m: f"{1.35 * float(m[1]):.6g}", t, flags=re.MULTILINE))(folder)
    done = lrbc("run", folder.config, "--cache", tmp_path / "cache", "--fail-on-loose")
    assert done.code == 6, done.stderr
    assert "b5-loose: B5 loose" in done.stdout


def test_a_row_of_bolts_may_be_longer_than_its_edge(tmp_path: Path) -> None:
    """As on the SoundBox, whose flange is longer than the panel."""
    folder = make_frame(tmp_path)
    numbers("model/bolts.csv", lambda r: (r - r.mean(axis=0)) * 1.5 + r.mean(axis=0))(folder)
    assert "cannot be judged" not in lrbc("check", folder.config, "--cache", reduced_cache("frame")).stdout


def test_a_box_that_holds_its_whole_edge_is_long_enough(tmp_path: Path) -> None:
    """Though the row of bolts is longer."""
    folder = make_frame(tmp_path)
    config((EDGE, "      component: ROTY\n      box: [[-0.001, 0.001], [0.0, 0.37], [0, 0]]\n"))(folder)
    numbers("model/bolts.csv", lambda r: (r - r.mean(axis=0)) * 1.5 + r.mean(axis=0))(folder)
    assert "cannot be judged" not in lrbc("check", folder.config).stdout


def test_a_name_of_a_bolt_copied_down_is_told_by_its_line_alone(tmp_path: Path) -> None:
    folder = make_plate(tmp_path)
    text("bushings.csv", lambda t: t.replace("B4,", "B3,"))(folder)
    said = lrbc("check", folder.config).stdout
    assert "springs of B3 at B4, which has none: write B4 there" in said
    assert "cannot be judged" not in said
    assert "mistyped" not in said


def test_a_file_with_the_name_of_a_job_is_the_only_fix(tmp_path: Path) -> None:
    folder = make_frame(tmp_path)
    folder.replace("frf/loose-2.csv", "frf/loose-all.csv")
    told = lrbc("check", folder.config, "--cache", reduced_cache("frame")).stdout
    assert "write jobs.loose-2.frf: data/frf/loose-2.csv" in told
    assert "jobs.loose-all.frf" not in told
    (folder.data / "frf" / "loose-all.csv").rename(folder.data / "frf" / "loose-2_h1.csv")
    folder.config.write_text(folder.config.read_text().replace("frf/loose-all.csv", "frf/loose-2_h1.csv"))
    assert "add a job for it" in lrbc("check", folder.config, "--cache", reduced_cache("frame")).stdout


def test_links_to_measurements_leave_the_folder_of_their_targets_alone(tmp_path: Path) -> None:
    """An archive of FRFs, from which a campaign takes some by links: the others there are not forgotten measurements."""
    folder = make_frame(tmp_path)
    (folder.data / "frf").rename(tmp_path / "archive")
    (folder.data / "frf").mkdir()
    shutil.copy(tmp_path / "archive" / "tight.csv", tmp_path / "archive" / "other.csv")
    for path in (tmp_path / "archive").glob("*.csv"):
        if path.name != "other.csv":
            (folder.data / "frf" / path.name).symlink_to(path)
    line = ("check", folder.config, "--cache", reduced_cache("frame"))
    assert "no job uses" not in lrbc(*line).stdout
    (folder.data / "frf" / "monday.csv").symlink_to(tmp_path / "archive" / "other.csv")
    assert "no job uses monday.csv" in lrbc(*line).stdout


def test_results_beside_the_measurements_are_no_measurements(tmp_path: Path) -> None:
    folder = make_frame(tmp_path)
    (folder.data / "frf" / "campaign.csv").write_text("job\n")
    line = ("check", folder.config, "--cache", reduced_cache("frame"))
    assert "no job uses campaign.csv" in lrbc(*line).stdout
    assert "no job uses" not in lrbc(*line, "--override", f"output={folder.data / 'frf'}").stdout


@pytest.mark.slow
def test_another_window_is_no_all_clear(tmp_path: Path) -> None:
    """Two tight bolts beside the removed ones were judged loose without a remark."""
    folder = make_frame(tmp_path)
    numbers(FRFS[1], parts(exponential))(folder)
    assert lrbc("update", folder.config, "--cache", reduced_cache("frame"), "--job", "tight", "--job", "loose-2").code == 0
    valid = folder.result("loose-2")["validity"]
    assert valid["passed"] is not True
    assert "Check whether an exponential window was set for this job" in valid["reason"]
