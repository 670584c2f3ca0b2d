"""Unit systems of FE programs, such as mm-N-t, and their factors to SI."""

from __future__ import annotations

import math
from dataclasses import dataclass

_POUND = 0.45359237
_GRAVITY = 9.80665
_UNITS: dict[str, dict[str, float]] = {
    "length": {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "in": 0.0254, "ft": 0.3048},
    "force": {"N": 1.0, "kN": 1e3, "mN": 1e-3, "MN": 1e6, "lbf": _POUND * _GRAVITY},
    "mass": {
        "kg": 1.0,
        "t": 1e3,
        "g": 1e-3,
        "lbm": _POUND,
        "slug": _POUND * _GRAVITY / 0.3048,
        "slinch": _POUND * _GRAVITY / 0.0254,
    },
    "time": {"s": 1.0, "ms": 1e-3},
}


@dataclass(frozen=True)
class UnitSystem:
    """A consistent unit system: three given units, and the fourth from force = mass length / time².

    Attributes
    ----------
    text : str
        As given, for example ``mm-N-t``.
    length, force, mass, time : float
        Each unit in m, N, kg and s.
    """

    text: str
    length: float
    force: float
    mass: float
    time: float

    @property
    def length_name(self) -> str:
        """Short name of the unit of length, for messages."""
        return length_name(self.length)


def length_name(unit: float) -> str:
    """Short name of a unit of length [m], for messages."""
    names = (name for name, size in _UNITS["length"].items() if math.isclose(size, unit, rel_tol=1e-6))
    return next(names, f"{unit:.4g} m")


#: Systems that messages propose if the numbers of a model, or a misspelt name, fit one of them.
USUAL_SYSTEMS = ("mm-N-t", "mm-kg-ms", "in-lbf-s", "cm-kg-s")

#: The default.
SI = UnitSystem("SI", 1.0, 1.0, 1.0, 1.0)


def parse_system(text: str) -> UnitSystem:
    """The unit system named by three units joined by hyphens (``mm-N-t``, ``mm-kg-ms``, ``in-lbf-s``), or by ``SI``.

    Raises
    ------
    ValueError
        If a unit is unknown, the units are not three of different kinds, or the resulting unit of time is neither s, ms nor us.
    """
    if text.upper() == "SI":
        return SI
    known: dict[str, float] = {}
    for word in text.split("-"):
        kind = next((kind for kind, units in _UNITS.items() if word in units), None)
        if kind is None:
            raise ValueError(f"'{word}' is not a unit of length, force, mass or time")
        if kind in known:
            raise ValueError(f"two units of {kind}")
        known[kind] = _UNITS[kind][word]
    if len(known) != 3:
        raise ValueError(f"{len(known)} units")
    if "length" not in known:
        known["length"] = known["force"] * known["time"] ** 2 / known["mass"]
    elif "force" not in known:
        known["force"] = known["mass"] * known["length"] / known["time"] ** 2
    elif "mass" not in known:
        known["mass"] = known["force"] * known["time"] ** 2 / known["length"]
    else:
        known["time"] = math.sqrt(known["mass"] * known["length"] / known["force"])
        if not any(math.isclose(known["time"], unit, rel_tol=1e-3) for unit in (1.0, 1e-3, 1e-6)):
            raise ValueError(f"its unit of time would be {known['time']:.4g} s; with N and mm the mass is in t")
    return UnitSystem(text, **known)
