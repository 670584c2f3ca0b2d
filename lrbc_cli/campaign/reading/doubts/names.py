"""Detects names of bolts that were sorted in a spreadsheet without their coordinates."""

from __future__ import annotations

import re
from collections.abc import Iterator

import numpy as np

from lrbc_cli.model.dofs import PointTable


def sorted_names(bolts: PointTable | None) -> Iterator[str]:
    """Warning if the names of bolts in a row are in alphabetical order (1, 10, 11 ... 2) instead of that of their numbers.

    Parameters
    ----------
    bolts : PointTable or None
    """
    if bolts is None or not len(set(bolts.name)) == len(bolts.name) >= 3:
        return
    away = bolts.xyz - bolts.xyz.mean(axis=0)
    along = away @ np.linalg.svd(away, full_matrices=False)[2][0]
    row = [bolts.name[k] for k in np.argsort(along, kind="stable")]
    row = row if row[0] <= row[-1] else row[::-1]

    def counted(name: str) -> list[tuple[str, int]]:
        return [(word, int(number or 0)) for word, number in re.findall(r"(\D*)(\d*)", name)]

    by_number = sorted(row, key=counted)
    if row == sorted(row) and row != by_number:
        at = next(k for k in range(len(row)) if row[k] != by_number[k])
        yield (
            f"bolts: {', '.join(row[max(at - 1, 0) : at + 3])} ... lie in a row in alphabetical order. Check whether the names were sorted "
            "in a spreadsheet without their coordinates, and give each bolt its own place. If the bolts are really named in this order, "
            "ignore this warning"
        )
