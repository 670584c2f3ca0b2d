"""Restores evenly spaced frequency axes of universal files, which give first value and increment with six digits only."""

from __future__ import annotations

import math
from decimal import Decimal
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

# Odd parts of the usual sampling rates (44 100, 48 000, 50 000, 51 200 Hz, ...); a line spacing is such a rate over a power of two.
_ODD_PARTS = (1, 3, 5, 15, 25, 75, 125, 375, 625, 3125, 11025)
_LARGEST_POWER = 7
_LARGEST_DENOMINATOR = 32


def even_axis(count: int, minimum: str, increment: str) -> tuple[NDArray[np.float64], str | None]:
    """Axis (count,) from its first value and increment as printed, and a note if digits were restored.

    An increment printed as 1.95313E-01 stands for 0.1953125; taken literally it would shift line 1000 by 5e-4.
    If a simple fraction, or a usual sampling rate over a power of two, rounds to the printed number, it is taken instead.
    """
    step = restore(increment)
    start = float(minimum)
    nearest = round(start / step) * step if abs(start / step) < 1e15 else start
    start = nearest if abs(nearest - start) <= _half_unit(minimum) else restore(minimum)
    note = None
    if abs(step - float(increment)) > 1e-12 * step:
        note = f"the increment {increment} was read as {step!r}"
    with np.errstate(over="ignore"):
        return np.asarray(start + step * np.arange(count), dtype=np.float64), note


#: Numbers above this are left as printed: no axis is that large.
_BEYOND = 1e100


def restore(printed: str) -> float:
    """Exact value that a number printed with few digits most likely stands for."""
    value = float(printed)
    half = _half_unit(printed)
    digits = printed.split("E")[0]
    if not 0 < value < _BEYOND or not 1e-9 * value < half < 1e-4 * value or digits.endswith("00"):
        return value  # all digits are given, too few are, or the decimal number itself is round
    for power in range(_LARGEST_POWER + 1):
        binary = round(value * 2**power) / 2**power
        if abs(binary - value) <= half:
            return float(binary)
    for odd in _ODD_PARTS:
        rate: float = odd * 2.0 ** round(math.log2(value / odd))
        if abs(rate - value) <= half:
            return rate
    simple = _simplest(Fraction(value - half), Fraction(value + half))
    return float(simple) if simple.denominator <= _LARGEST_DENOMINATOR and not digits.endswith("0") else value


def _half_unit(printed: str) -> float:
    """Half a unit of the last printed digit."""
    exponent = Decimal(printed).as_tuple().exponent
    # Slightly more than half, since a tie may have been rounded either way.
    return 0.5000001 * float(f"1e{exponent}") if isinstance(exponent, int) else 0.0


def _simplest(low: Fraction, high: Fraction) -> Fraction:
    """Fraction with the smallest denominator in [low, high], 0 < low < high, by continued fractions."""
    whole = low.numerator // low.denominator
    if low == whole:
        return Fraction(whole)
    if whole + 1 <= high:
        return Fraction(whole + 1)
    return whole + 1 / _simplest(1 / (high - whole), 1 / (low - whole))
