"""Decides whether the phases in the columns of a text file are in degrees or radians."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lrbc_cli.arrays import Floats
from lrbc_cli.io.encoding import fold
from lrbc_cli.io.layout import TextLayout
from lrbc_cli.io.text.sniff import TextTable

#: Range of the largest phase in columns in degrees that are wrapped at half or at a whole turn.
WRAPPED = 90.0, 360.1

#: Largest phase of wrapped radians, and largest step of unwrapped ones, with their rounding.
TURN, STEP = 2.02 * np.pi, 1.01 * np.pi

#: Steps of phases read as degrees, relative to those of the logarithm of their magnitudes: below the first number they are radians,
#: above the second one degrees. Measured and computed FRFs give 0.5 to 2 for degrees and 0.008 to 0.035 for radians.
LIKENESS = 0.07, 0.25

#: Steps between lines from which this ratio is taken as known.
FEWEST = 4


@dataclass(frozen=True, kw_only=True)
class PhaseColumn:
    """Columns of magnitude and phase of one FRF.

    Attributes
    ----------
    magnitude, phase : int
        Indices of the columns.
    in_db : bool
        Whether the magnitude is a level in dB.
    """

    magnitude: int
    phase: int
    in_db: bool


def angle_units(table: TextTable, columns: Sequence[PhaseColumn], layout: TextLayout, notes: list[str], warnings: list[str]) -> list[str]:
    """Unit of the phases of each FRF, ``deg`` or ``rad``: as the layout or the heading states, else by the values.

    Columns without a stated unit are in the same unit, which their values decide together.

    Parameters
    ----------
    table : TextTable
    columns : sequence of PhaseColumn
    layout : TextLayout
    notes, warnings : list of str
        Assumptions and doubts are appended.
    """
    if layout.phase:
        return [layout.phase] * len(columns)
    stated = [_stated(table, column.phase, warnings) for column in columns]
    silent = [column for column, unit in zip(columns, stated, strict=True) if unit is None]
    found = _by_values(table, silent, notes, warnings) if silent else ""
    return [unit or found for unit in stated]


def _stated(table: TextTable, at: int, warnings: list[str]) -> str | None:
    """Unit that a heading states; None if it states none."""
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
    return None


def _by_values(table: TextTable, columns: Sequence[PhaseColumn], notes: list[str], warnings: list[str]) -> str:
    """Unit of the phases of several FRFs by their values.

    Up to one turn they are wrapped radians. Larger ones are degrees, or unwrapped radians: these have steps of at most half a turn, and
    vary with the frequency like the logarithm of the magnitude does, since both are parts of one analytic function.
    """
    phases = _finite(table.values[:, [column.phase for column in columns]])
    largest = float(np.nanmax(np.abs(phases), initial=0.0))
    step = float(np.nanmax(np.abs(np.diff(phases, axis=0)), initial=0.0))
    wrapped = largest <= TURN
    ratio = _likeness(table, columns, 2.0 * np.pi if wrapped else 360.0)
    as_radians, as_degrees = ratio is not None and ratio < LIKENESS[0], ratio is not None and ratio > LIKENESS[1]
    if wrapped:
        found, sure = "rad", as_radians
    elif as_radians and step <= STEP:
        found, sure = "rad", True
    else:
        # Steps above half a turn in radians exclude unwrapped radians, unless lines were left out.
        found, sure = "deg", as_degrees or (step > STEP and not as_radians) or (step > 180.0 and WRAPPED[0] <= largest <= WRAPPED[1])
    if sure:
        notes.append(f"phase assumed in {found}, by its values; if that is wrong, set 'phase:' in the format")
    else:
        other = "rad" if found == "deg" else "deg"
        warnings.append(
            f"the headings state no unit of the phases, and their values leave it open: read as {found}; check it, and "
            f"set 'format: {{phase: {found}}}' of the job, or 'format: {{phase: {other}}}' if they are in {other}"
        )
    return found


def _likeness(table: TextTable, columns: Sequence[PhaseColumn], turn: float) -> float | None:
    """Steps of phases read as degrees, relative to those of the logarithm of the magnitudes (RMS); None if they are too few.

    Parameters
    ----------
    table : TextTable
    columns : sequence of PhaseColumn
    turn : float
        Multiples of it are removed from the steps of the phases, which may be wrapped.
    """
    turned, grown, count = 0.0, 0.0, 0
    for column in columns:
        steps = np.diff(_finite(table.values[:, column.phase]))
        steps -= turn * np.round(steps / turn)
        growth = np.diff(_logarithm(_finite(table.values[:, column.magnitude]), column.in_db))
        known = np.isfinite(steps) & np.isfinite(growth)
        turned += float(np.sum(np.radians(steps[known]) ** 2))
        grown += float(np.sum(growth[known] ** 2))
        count += int(known.sum())
    return float(np.sqrt(turned / grown)) if count >= FEWEST and min(turned, grown) > 0.0 else None


def _logarithm(magnitudes: Floats, in_db: bool) -> Floats:
    """Natural logarithm of magnitudes or levels; NaN for zeros."""
    positive = np.where(magnitudes == 0.0, np.nan, np.abs(magnitudes))
    return np.asarray(magnitudes * (np.log(10.0) / 20.0) if in_db else np.log(positive))


def _finite(values: Floats) -> Floats:
    """Values with NaN in place of infinite ones."""
    return np.where(np.isfinite(values), values, np.nan)
