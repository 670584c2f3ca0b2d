"""Dataclasses of numbers that check their values: types, and the limits that ``annotated_types`` states in their annotations."""

from __future__ import annotations

import math
from functools import cache
from numbers import Integral
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

from annotated_types import Ge, Gt, Le, Lt

from lrbc_cli.errors import ConfigError

Positive = Annotated[float, Gt(0.0)]
NotNegative = Annotated[float, Ge(0.0)]
Negative = Annotated[float, Lt(0.0)]
#: From none to all; without both ends.
Share = Annotated[float, Ge(0.0), Le(1.0)]
Inside = Annotated[float, Gt(0.0), Lt(1.0)]
Count = Annotated[int, Ge(1)]
CountOrNone = Annotated[int, Ge(0)]

_LIMITS = {Gt: "above", Ge: "at least", Lt: "below", Le: "at most"}
_WORDS: dict[Any, str] = {float: "a number", int: "a whole number", str: "text", bool: "True or False", NoneType: "None"}


class Checked:
    """Base of frozen dataclasses whose values must be as annotated; also for own subclasses."""

    def __post_init__(self) -> None:
        """Check all fields.

        Raises
        ------
        ConfigError
            With class and field, what was expected and found.
        """
        owner: Any = type(self)
        for name, kind in _fields(owner).items():
            if not _fits(value := getattr(self, name), kind):
                place = f"{owner.__name__}.{name}"
                raise ConfigError("a value that is not allowed", place=place, expected=_expected(kind), found=repr(value))


@cache
def _fields(owner: Any) -> dict[str, Any]:
    """Types of the fields by name; those of a class whose names cannot be resolved, as inside a function, are left out."""
    found: dict[str, Any] = {}
    for base in reversed(owner.__mro__):
        try:
            hints = get_type_hints(base, include_extras=True)
        except NameError:
            continue
        found |= hints
    return {name: found[name] for name in getattr(owner, "__dataclass_fields__", {}) if name in found}


def _fits(value: object, kind: Any) -> bool:
    origin, parts = get_origin(kind), get_args(kind)
    if origin is Annotated:
        return _fits(value, parts[0]) and all(_within(value, limit) for limit in parts[1:])
    if origin in (Union, UnionType):
        return any(_fits(value, part) for part in parts)
    if origin is Literal:
        return any(type(value) is type(part) and value == part for part in parts)
    if origin is tuple:
        if not isinstance(value, tuple):
            return False
        kinds = parts[:1] * len(value) if parts[1:] == (...,) else parts
        return len(kinds) == len(value) and all(map(_fits, value, kinds))
    if kind is float:
        return isinstance(value, float | int) and not isinstance(value, bool) and math.isfinite(value)
    if kind is int:
        return isinstance(value, Integral) and not isinstance(value, bool)
    return isinstance(value, origin or kind)


def _within(value: Any, limit: object) -> bool:
    match limit:
        case Gt(gt=bound):
            return bool(value > bound)
        case Ge(ge=bound):
            return bool(value >= bound)
        case Lt(lt=bound):
            return bool(value < bound)
        case Le(le=bound):
            return bool(value <= bound)
    return True


def _expected(kind: Any) -> str:
    origin, parts = get_origin(kind), get_args(kind)
    if origin is Annotated:
        limits = [
            f"{word} {getattr(part, sign.__name__.lower()):g}" for part in parts[1:] for sign, word in _LIMITS.items() if type(part) is sign
        ]
        return " ".join([_expected(parts[0]), *([" and ".join(limits)] if limits else [])])
    if origin in (Union, UnionType):
        return " or ".join(map(_expected, parts))
    if origin is Literal:
        return ", ".join(map(repr, parts))
    if origin is tuple:
        return f"a tuple, each {_expected(parts[0])}" if parts[1:] == (...,) else f"a tuple of {len(parts)}, each {_expected(parts[0])}"
    return _WORDS.get(kind) or f"an instance of {(origin or kind).__name__}"
