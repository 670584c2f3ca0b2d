"""Decides whether the phases in a column of a text file are in degrees or radians."""

from __future__ import annotations

import re

import numpy as np

from lrbc_cli.io.encoding import fold
from lrbc_cli.io.layout import TextLayout
from lrbc_cli.io.text.sniff import TextTable

#: Range of the largest phase in columns in degrees that are wrapped at half or at a whole turn.
WRAPPED = 90.0, 360.1


def angle_unit(table: TextTable, at: int, layout: TextLayout, notes: list[str], warnings: list[str]) -> str:
    """Unit of the phases of a column, ``deg`` or ``rad``: as the layout or the heading states, else by its range.

    Parameters
    ----------
    table : TextTable
    at : int
        Index of the column.
    layout : TextLayout
    notes, warnings : list of str
        Assumptions and doubts are appended.
    """
    if layout.phase:
        return layout.phase
    text = fold(f"{table.headings[at].text} {table.headings[at].unit}")
    largest = float(np.nanmax(np.abs(table.values[:, at]), initial=0.0))
    if re.search(r"deg|°|grad", text):
        # The largest phase is half a turn in radians.
        if 0.99 * np.pi <= largest <= 1.001 * np.pi:
            warnings.append(
                "the heading says degrees, but no phase is larger than 3.14: check whether they are radians; if so, set 'format: {phase: "
                "rad}' of the job"
            )
        return "deg"
    if re.search(r"(?<![a-z])rad", text):
        # The largest phase is half a turn in degrees; unwrapped phases would rise or fall steadily.
        known = table.values[:, at][np.isfinite(table.values[:, at])]
        jumps = np.abs(np.diff(known)).max(initial=0.0) > 2.0 * np.pi
        if WRAPPED[0] <= largest <= WRAPPED[1] and jumps:
            warnings.append(
                f"the heading says radians, but the phases jump and reach {largest:.4g}: check whether they are degrees; "
                "if so, set 'format: {phase: deg}' of the job"
            )
        return "rad"
    found = "deg" if largest > 2.0 * np.pi * 1.01 else "rad"
    notes.append(f"phase assumed in {found}, by its range; if that is wrong, set 'phase:' in the format")
    return found
