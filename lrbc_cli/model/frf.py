"""Frequency response functions as read from files, measured or computed, in SI units."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

#: Power q of s = i omega in ``y = s^q L x``: turns displacement into velocity or acceleration; pressures are used directly.
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
        In Pa/N, m/N, m/s/N or m/s2/N; the sign of a negative response or reference direction is already applied.
    quantity : str or None
        One of ``QUANTITIES``; None if the file does not say.
    response_node, reference_node : int or None
    response_direction, reference_direction : int
        0 scalar, 1 to 3 translation, 4 to 6 rotation, without sign (see ``values``).
    reference_name : str
        Entity name of the hammer point; empty where the file has none.
    coherence : (F,) float array or None
        Ordinary coherence on the same lines.
    place : str
        Place in the file, for messages: ``record 3``, ``column mic01_real``.
    number : int
        Number of the record in its file, from 1.
    file : str
        The file that it was read from.
    uncalibrated : bool
        Whether its unit in the file contains a voltage: sensitivities were not entered in the analyser.
    """

    name: str
    frequency_hz: NDArray[np.float64]
    values: NDArray[np.complex128]
    quantity: str | None = None
    response_node: int | None = None
    response_direction: int = 0
    reference_node: int | None = None
    reference_direction: int = 0
    reference_name: str = ""
    coherence: NDArray[np.float64] | None = None
    place: str = ""
    number: int = 0
    file: str = ""
    uncalibrated: bool = False


@dataclass(frozen=True, kw_only=True)
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
        What may be wrong with the file, shown by every command.
    titles : tuple of str
        Comments on the measurement in the file, each line once.
    """

    source: str
    records: tuple[FrfRecord, ...]
    notes: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    titles: tuple[str, ...] = ()
