"""Matrices in the layouts of FE programs, for files that no program here can write."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import scipy.sparse as sp

NUMBERS = {"UX": 1, "UY": 2, "UZ": 3, "ROTX": 4, "ROTY": 5, "ROTZ": 6, "PRES": 8}


def entries(matrix: Any, half: bool) -> Iterator[tuple[int, int, float]]:
    """Row, column and value, of one triangle where asked for."""
    found = sp.coo_array(sp.triu(matrix) if half else matrix)
    yield from zip(found.row.tolist(), found.col.tolist(), found.data.tolist(), strict=True)


def write_abaqus(path: Path, matrix: Any, node: Sequence[int], component: Sequence[str], layout: str, half: bool = True) -> None:
    """``*MATRIX OUTPUT`` in the layouts matrix input, labels and coordinate."""
    dof = [NUMBERS[name] for name in component]
    lines = ["** Assembled nodal matrix", "*MATRIX"] if layout == "labels" else []
    for i, j, value in entries(matrix, half):
        if layout == "matrix input":
            lines.append(f"{node[i]},{dof[i]}, {node[j]},{dof[j]}, {value:.17e}".replace("e", "D"))
        elif layout == "labels":
            lines.append(f"   {node[i]}  {dof[i]}   {node[j]}  {dof[j]}   {value:.17e}")
        else:
            lines.append(f"{i + 1} {j + 1} {value:.17e}")
    path.write_text("\n".join(lines) + "\n")


def write_sierra(path: Path, matrix: Any) -> None:
    """The lower triangle in an ``.m`` file."""
    lines = [f"{i + 1} {j + 1} {value:.17e}" for i, j, value in entries(sp.coo_array(sp.tril(matrix)), False)]
    path.write_text("% Kaa\nKaa = [\n" + "\n".join(lines) + "\n];\nKaa = sparse(Kaa(:,1), Kaa(:,2), Kaa(:,3));\n")


def write_harwell_boeing(path: Path, matrix: Any) -> None:
    """Lower triangle as HBMAT writes it, numbers side by side without blanks."""
    lower = sp.csc_array(sp.tril(sp.csc_array(matrix)))
    lower.sort_indices()

    def cards(numbers: Any, form: str, a_line: int) -> list[str]:
        texts = [form.format(number) for number in numbers]
        return ["".join(texts[k : k + a_line]) for k in range(0, len(texts), a_line)]

    parts = (
        cards(lower.indptr + 1, "{:14d}", 1),
        cards(lower.indices + 1, "{:14d}", 1),
        cards(lower.data, "{:25.17E}", 3),
    )
    n = lower.shape[0]
    header = [
        f"{'file.full':72s}{'key':8s}",
        "".join(f"{count:14d}" for count in (sum(map(len, parts)), *map(len, parts), 0)),
        f"{'RSA':14s}{n:14d}{n:14d}{lower.nnz:14d}{0:14d}",
        f"{'(1I14)':16s}{'(1I14)':16s}{'(3E25.17)':20s}{'':20s}",
    ]
    path.write_text("\n".join([*header, *(line for part in parts for line in part)]) + "\n")


def write_dmig(path: Path, name: str, matrix: Any, node: Sequence[int], component: Sequence[str]) -> None:
    """One triangle in large fields."""
    dof = [NUMBERS[label] for label in component]
    lines, last = [f"DMIG    {name:8s}{0:8d}{6:8d}{2:8d}{0:8d}{'':16s}{len(dof):8d}"], -1
    upper = sp.csc_array(sp.triu(sp.csc_array(matrix)))
    for j in range(len(dof)):
        for k in range(upper.indptr[j], upper.indptr[j + 1]):
            if j != last:
                lines.append(f"DMIG*   {name:16s}{node[j]:16d}{dof[j]:16d}")
                last = j
            i = upper.indices[k]
            lines.append(f"*       {node[i]:16d}{dof[i]:16d}{upper.data[k]:16.9E}")
    path.write_text("\n".join(lines) + "\n")


def write_op4(path: Path, name: str, matrix: Any, order: str = "<", big: bool = True) -> None:
    """Sparse binary OP4 in double precision."""
    columns = sp.csc_array(matrix)
    n, m = columns.shape

    def record(*parts: bytes) -> bytes:
        content = b"".join(parts)
        size = np.array([len(content)], dtype=order + "i4").tobytes()
        return size + content + size

    def whole(*numbers: int) -> bytes:
        return np.array(numbers, dtype=order + "i4").tobytes()

    out = [record(whole(m, -n if big else n, 6, 2), name.ljust(8).encode())]
    for j in range(m):
        rows, values = columns.indices[columns.indptr[j] : columns.indptr[j + 1]], columns.data[columns.indptr[j] : columns.indptr[j + 1]]
        strings = []
        for run in np.split(np.arange(rows.size), np.flatnonzero(np.diff(rows) != 1) + 1):
            length, first = 2 * run.size, int(rows[run[0]]) + 1
            head = whole(length + 1, first) if big else whole(first + 65536 * (length + 1))
            strings.append(head + values[run].astype(order + "f8").tobytes())
        words = sum(map(len, strings)) // 4
        out.append(record(whole(j + 1, 0, words), *strings))
    out.append(record(whole(m + 1, 1, 2), np.ones(1, dtype=order + "f8").tobytes()))
    path.write_bytes(b"".join(out))
