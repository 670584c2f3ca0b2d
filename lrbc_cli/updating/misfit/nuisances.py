"""Kinds of nuisance parameters: a class says what its unknown changes and how the estimate is told.

Which nuisance parameters a campaign has is defined in ``campaign.identification.nuisances``.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar, Generic, TypeVar

import numpy as np

T = TypeVar("T")

#: Units with which the keys of estimates end.
UNITS = {"percent": "%", "db": "dB", "mm": "mm", "kelvin": "K"}


@dataclass(frozen=True)
class Effects(Generic[T]):
    """What nuisance parameters change, or (F, R) derivatives of the FRFs to their unknowns.

    Global factors of the model by name, gains [dB] by index of the response among all, offsets of loads [m] by load and direction.
    """

    factors: dict[str, T] = field(default_factory=dict)
    gains: dict[int, T] = field(default_factory=dict)
    offsets: dict[tuple[int, int], T] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class Nuisance(ABC):
    """A nuisance parameter: a scalar unknown beside the boundary parameters, with a Gaussian prior.

    Attributes
    ----------
    kind, key, scale : str, str, float
        Of the class. The key of its estimates ends with their unit, see ``UNITS``; times the scale they have this unit.
    name : str
        Name of the factor, of the response, or of load and direction.
    words : str
        What drifts, for a sentence; empty: the name.
    mean, std : float
        Of the prior, in the unit of the unknown.
    reach : float
        Distance of the bounds from the mean.
    """

    kind: ClassVar[str]
    key: ClassVar[str]
    scale: ClassVar[float] = 1.0
    name: str
    words: str = ""
    mean: float = 0.0
    std: float
    reach: float

    @property
    def bounds(self) -> tuple[float, float]:
        """Lower and upper bound."""
        return self.mean - self.reach, self.mean + self.reach

    @abstractmethod
    def place(self, effects: Effects[T]) -> tuple[dict[Any, T], Any]:
        """What the unknown changes: a table of the effects, and the key in it."""

    def effect(self, value: float) -> float:
        """What a value of the unknown changes it to."""
        return value

    def told(self, value: float, std: float) -> dict[str, dict[str, Any]]:
        """Estimate as in ``result.json``, by key and name."""
        return {self.key: {self.name: _estimate(self.scale * value, self.scale * std)}}


@dataclass(frozen=True, kw_only=True)
class ModelFactor(Nuisance):
    """Global factor of the model, see ``model.factors``; the unknown is its natural logarithm, and it is told in per cent.

    Attributes
    ----------
    also : mapping of str to float
        Further quantities to be told: by key, what a logarithm of 1 stands for.
    """

    kind = "factor"
    also: Mapping[str, float] = field(default_factory=dict)

    def place(self, effects: Effects[T]) -> tuple[dict[Any, T], Any]:
        """See ``Nuisance.place``."""
        return effects.factors, self.name

    def effect(self, value: float) -> float:
        """Factor."""
        return float(np.exp(value))

    def told(self, value: float, std: float) -> dict[str, dict[str, Any]]:
        """Change of the factor, and the further quantities, by key alone."""
        own = {f"{self.name.replace('.', '_')}_percent": _estimate(100.0 * float(np.expm1(value)), 100.0 * std)}
        return own | {key: _estimate(scale * value, scale * std) for key, scale in self.also.items()}


@dataclass(frozen=True, kw_only=True)
class Gain(Nuisance):
    """Gain of a response [dB]; ``index`` is that of the response among all."""

    kind, key = "gain", "gain_db"
    words: str = "gains of the responses"
    index: int

    def place(self, effects: Effects[T]) -> tuple[dict[Any, T], Any]:
        """See ``Nuisance.place``."""
        return effects.gains, self.index


@dataclass(frozen=True, kw_only=True)
class Shift(Nuisance):
    """Offset of a load [m] along one of the two directions across its normal."""

    kind, key, scale = "shift", "hammer_offset_mm", 1e3
    words: str = "point of the hammer"
    load: int
    direction: int

    def place(self, effects: Effects[T]) -> tuple[dict[Any, T], Any]:
        """See ``Nuisance.place``."""
        return effects.offsets, (self.load, self.direction)


def _estimate(value: float, std: float) -> dict[str, Any]:
    return {"value": value, "std": std}


def estimates(nuisances: Sequence[Nuisance], values: Iterable[float], stds: Iterable[float]) -> dict[str, Any]:
    """Estimates of nuisance parameters as in ``result.json``."""
    tree: dict[str, Any] = {}
    for nuisance, value, std in zip(nuisances, values, stds, strict=True):
        for key, found in nuisance.told(float(value), float(std)).items():
            tree.setdefault(key, {}).update(found)
    return tree


def title_of(key: str) -> str:
    """Title of the key of an estimate: ``hammer_offset_mm`` is *hammer offset [mm]*."""
    words, _, unit = key.rpartition("_")
    return f"{words} [{UNITS[unit]}]".replace("_", " ") if unit in UNITS else key
