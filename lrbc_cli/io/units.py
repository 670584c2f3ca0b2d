"""Parses unit labels such as ``Pa/N`` or ``(m/s^2)/N`` into a factor to SI and a dimension, which tells the quantity of an FRF."""

from __future__ import annotations

import re
from dataclasses import dataclass

STANDARD_GRAVITY = 9.80665  # m/s2, CGPM 1901
POUND = 0.45359237  # kg, international pound
INCH = 0.0254  # m


@dataclass(frozen=True)
class Unit:
    """A unit as a factor to SI and powers of length, force and time.

    Attributes
    ----------
    factor : float
        Multiplies a value in this unit to give SI (m, N, s).
    length, force, time : int
        Exponents; a pascal is (-2, 1, 0).
    """

    factor: float
    length: int = 0
    force: int = 0
    time: int = 0

    def __mul__(self, other: Unit) -> Unit:
        """Product of two units."""
        return Unit(self.factor * other.factor, self.length + other.length, self.force + other.force, self.time + other.time)

    def __pow__(self, exponent: int) -> Unit:
        """Integer power of a unit."""
        return Unit(self.factor**exponent, self.length * exponent, self.force * exponent, self.time * exponent)

    def __truediv__(self, other: Unit) -> Unit:
        """Quotient of two units."""
        return self * other**-1

    @property
    def dimension(self) -> tuple[int, int, int]:
        """Exponents of length, force and time."""
        return (self.length, self.force, self.time)


_UNITS: dict[str, Unit] = {
    "1": Unit(1.0),
    "rad": Unit(1.0),
    "deg": Unit(0.017453292519943295),
    "°": Unit(0.017453292519943295),
    "Hz": Unit(1.0, time=-1),
    "kHz": Unit(1e3, time=-1),
    "s": Unit(1.0, time=1),
    "sec": Unit(1.0, time=1),
    "ms": Unit(1e-3, time=1),
    "m": Unit(1.0, length=1),
    "km": Unit(1e3, length=1),
    "dm": Unit(1e-1, length=1),
    "cm": Unit(1e-2, length=1),
    "mm": Unit(1e-3, length=1),
    "um": Unit(1e-6, length=1),
    "nm": Unit(1e-9, length=1),
    "in": Unit(INCH, length=1),
    "inch": Unit(INCH, length=1),
    "ft": Unit(12 * INCH, length=1),
    "N": Unit(1.0, force=1),
    "kN": Unit(1e3, force=1),
    "mN": Unit(1e-3, force=1),
    "kgf": Unit(STANDARD_GRAVITY, force=1),
    "lbf": Unit(POUND * STANDARD_GRAVITY, force=1),
    "lb": Unit(POUND * STANDARD_GRAVITY, force=1),
    "dyn": Unit(1e-5, force=1),
    "kg": Unit(1.0, length=-1, force=1, time=2),
    "Nm": Unit(1.0, length=1, force=1),
    "Pa": Unit(1.0, length=-2, force=1),
    "hPa": Unit(1e2, length=-2, force=1),
    "kPa": Unit(1e3, length=-2, force=1),
    "MPa": Unit(1e6, length=-2, force=1),
    "mPa": Unit(1e-3, length=-2, force=1),
    "uPa": Unit(1e-6, length=-2, force=1),
    "bar": Unit(1e5, length=-2, force=1),
    "mbar": Unit(1e2, length=-2, force=1),
    "psi": Unit(POUND * STANDARD_GRAVITY / INCH**2, length=-2, force=1),
    "g": Unit(STANDARD_GRAVITY, length=1, time=-2),
    "gn": Unit(STANDARD_GRAVITY, length=1, time=-2),
    "G": Unit(STANDARD_GRAVITY, length=1, time=-2),
    "mg": Unit(1e-3 * STANDARD_GRAVITY, length=1, time=-2),
}

_SUPERSCRIPTS = str.maketrans("⁰¹²³⁴⁵⁶⁷⁸⁹⁻", "0123456789-")
_TOKEN = re.compile(r"\s*(\*\*|\^|[()*/·]|[A-Za-zµμ°]+|-?\d+)")
_DECIBEL = re.compile(r"db(?![a-z])\s*(?:(?:re|ref|rel|bez)\b\.?:?|/)?\s*([\d.,]+(?:e[-+]?\d+)?)?\s*(.*)", re.IGNORECASE)

#: Quantity of a motion by its dimension (length, time); rotations have no length.
_RESPONSES = {(1, 0): "displacement", (1, -1): "velocity", (1, -2): "acceleration"}


def parse_unit(label: str) -> Unit | None:
    """Unit of a label; None if it is empty, ``NONE`` or not understood.

    Products, quotients (left to right), powers written as ``^2``, ``**2``, ``2`` or a superscript, and parentheses
    are understood. ``g`` is the standard acceleration of gravity, ``lb`` a pound-force.
    """
    text = re.sub(
        r"[⁰¹²³⁴⁵⁶⁷⁸⁹⁻]+", lambda m: "^" + m.group().translate(_SUPERSCRIPTS), label.strip().strip("[]").replace("µ", "u").replace("μ", "u")
    )
    # "ms-2" means m/s^2, not the inverse square of a millisecond.
    text = re.sub(r"(?<![A-Za-z])m ?s\^?-([12])", r"m/s^\1", text)
    if not text or text.upper() in ("NONE", "-") or len(text) > 80:
        return None
    tokens: list[str] = []
    position = 0
    text = text.rstrip()
    while position < len(text):
        match = _TOKEN.match(text, position)
        if match is None:
            return None
        tokens.append(match.group(1))
        position = match.end()
    try:
        unit, rest = _product(tokens)
    except (LookupError, ValueError, OverflowError, ZeroDivisionError, RecursionError):
        return None
    return unit if not rest else None


def is_voltage(label: str) -> bool:
    """Whether a label, such as ``V/V``, contains a voltage, as of channels whose sensitivity was not entered in the analyser."""
    return any(re.fullmatch(r"[mµμu]?V|volts?", part.strip("[]() "), re.IGNORECASE) for part in label.split("/"))


def decibel(label: str) -> tuple[float, str] | None:
    """Reference of a unit such as ``dB re 1 Pa/N`` as value and unit (empty if not stated); None if the label is not in decibels."""
    match = _DECIBEL.fullmatch(label.strip())
    if match is None:
        return None
    unit = match.group(2).strip()
    if unit and parse_unit(unit) is None:
        return None
    try:
        return float((match.group(1) or "1").replace(",", ".")), unit
    except ValueError:
        return None


def response_quantity(unit: Unit) -> str | None:
    """Quantity of an FRF by the dimension of its unit, response over force; None if the unit is not that of an FRF.

    Responses may be pressures, translations or rotations, inputs forces or moments; an angle over a moment counts
    as a displacement.
    """
    length, force, time = unit.dimension
    if force == 0 and time == 0 and length in (-2, -3):
        return "pressure"
    if force == -1 and length in (1, 0, -1):
        return _RESPONSES.get((1, time))
    return None


def numerator_quantity(unit: Unit) -> str | None:
    """Quantity of a response alone (not over a force) by the dimension of its unit; None if it is not that of a response."""
    if unit.dimension == (-2, 1, 0):
        return "pressure"
    if unit.force == 0 and unit.length in (0, 1) and (unit.length, unit.time) != (0, 0):
        return _RESPONSES.get((1, unit.time))
    return None


def _lookup(name: str) -> Unit:
    if name in _UNITS:
        return _UNITS[name]
    folded = [key for key in _UNITS if key.lower() == name.lower()]
    if len(folded) == 1:
        return _UNITS[folded[0]]
    raise LookupError(name)


def _product(tokens: list[str]) -> tuple[Unit, list[str]]:
    unit, rest = _power(tokens)
    while rest and rest[0] != ")":
        if rest[0] in ("*", "·"):
            factor, rest = _power(rest[1:])
            unit = unit * factor
        elif rest[0] == "/":
            factor, rest = _power(rest[1:])
            unit = unit / factor
        else:
            factor, rest = _power(rest)
            unit = unit * factor
    return unit, rest


def _power(tokens: list[str]) -> tuple[Unit, list[str]]:
    first, rest = tokens[0], tokens[1:]
    if first == "(":
        unit, rest = _product(rest)
        if rest[0] != ")":
            raise ValueError("unbalanced parenthesis")
        rest = rest[1:]
    else:
        unit = _lookup(first)
    if rest and rest[0] in ("^", "**"):
        return unit ** _exponent(rest[1]), rest[2:]
    if rest and re.fullmatch(r"-?\d", rest[0]) and first != "1":
        return unit ** _exponent(rest[0]), rest[1:]
    return unit, rest


def _exponent(token: str) -> int:
    value = int(token)
    if abs(value) > 9:
        raise ValueError("exponent out of range")
    return value
