"""Measured or computed frequency response functions, in SI units."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

#: Power of s = i omega that turns a displacement into the quantity; pressures are their own quantity.
QUANTITIES = {"pressure": 0, "displacement": 0, "velocity": 1, "acceleration": 2}


@dataclass(frozen=True, kw_only=True)
class FrfRecord:
    """One FRF, response over force, converted to SI when it was read.

    Attributes
    ----------
    name : str
        Entity name, column or data set name; empty where the file has none.
    frequency_hz : (F,) float array
        Strictly increasing lines.
    values : (F,) complex array
        In Pa/N, m/N, m/s/N or m/s2/N; a negative response or reference direction is already applied as a sign.
    quantity : str or None
        One of ``QUANTITIES``; None where the file does not say.
    response_node, reference_node : int or None
    response_direction, reference_direction : int
        0 scalar, 1..3 translation, 4..6 rotation (sign removed, see ``values``).
    coherence : (F,) float array or None
        Ordinary coherence on the same lines.
    place : str
        Where in the file, for messages: ``record 3``, ``column mic01_real``.
    number : int
        Of the record in its file, from 1.
    file : str
        The file it was read from.
    """

    name: str
    frequency_hz: NDArray[np.float64]
    values: NDArray[np.complex128]
    quantity: str | None = None
    response_node: int | None = None
    response_direction: int = 0
    reference_node: int | None = None
    reference_direction: int = 0
    coherence: NDArray[np.float64] | None = None
    place: str = ""
    number: int = 0
    file: str = ""


@dataclass(frozen=True)
class FrfSet:
    """All FRFs of one measurement file.

    Attributes
    ----------
    source : str
        The file, for messages.
    records : tuple of FrfRecord
    notes : tuple of str
        What the reader assumed or repaired, for ``lrbc check``.
    warnings : tuple of str
        What may be wrong with the file, for every command.
    titles : tuple of str
        What whoever wrote it said of the measurement, each line once.
    """

    source: str
    records: tuple[FrfRecord, ...]
    notes: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    titles: tuple[str, ...] = ()
