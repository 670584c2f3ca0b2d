"""Draws what changes between the jobs of a rehearsal besides the bolts: air temperature, hammer points, sensor gains, factors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field

import numpy as np

from lrbc_cli.arrays import Floats

#: Temperature at which the air of the model has its stated properties [K].
ROOM = 293.15


@dataclass(frozen=True, kw_only=True)
class Drift:
    """Drift of one job against the model.

    Attributes
    ----------
    kelvin : float
        Rise of the air temperature [K].
    hammer : (float, float)
        Offset of the hits along the two axes of the surface [m].
    gain : mapping of str to float
        Gain of each response [dB].
    factors : mapping of str to float
        Further global factors of the model, see ``model.factors``.
    """

    kelvin: float = 0.0
    hammer: tuple[float, float] = (0.0, 0.0)
    gain: Mapping[str, float] = field(default_factory=dict)
    factors: Mapping[str, float] = field(default_factory=dict)

    @property
    def warming(self) -> float:
        """Factor on the squared speed of sound, and inverse factor on the density of the air."""
        return (ROOM + self.kelvin) / ROOM

    def gains(self, names: Sequence[str]) -> Floats:
        """Linear gains of the responses `names`, (r,)."""
        return np.array([10 ** (self.gain.get(name, 0.0) / 20) for name in names])

    def as_dict(self) -> dict[str, object]:
        """Drift that is not zero, as stored in ``rehearsal.json``."""
        return {key: value for key, value in asdict(self).items() if value and value != (0.0, 0.0)}


@dataclass(frozen=True, kw_only=True)
class Scatter:
    """Standard deviations of the drift, which is drawn from normal distributions for each job.

    Attributes
    ----------
    kelvin : float
        Of the air temperature [K].
    hammer : float
        Of the hammer point along each of two axes [m].
    gain : float
        Of each response [dB].
    factors : mapping of str to float
        Of the natural logarithms of further global factors of the model.
    """

    kelvin: float = 0.0
    hammer: float = 0.0
    gain: float = 0.0
    factors: Mapping[str, float] = field(default_factory=dict)

    def draw(self, names: Sequence[str], rng: np.random.Generator) -> Drift:
        """Drift of one job; always draws the same random numbers, so a change of one deviation does not change the other drifts."""
        kelvin, x, y, *gain = rng.standard_normal(3 + len(names))
        gains = {name: round(self.gain * float(value), 4) for name, value in zip(names, gain, strict=True)} if self.gain else {}
        factors = {name: float(np.exp(std * rng.standard_normal())) for name, std in self.factors.items()}
        hammer = round(self.hammer * float(x), 6), round(self.hammer * float(y), 6)
        return Drift(kelvin=round(self.kelvin * float(kelvin), 4), hammer=hammer, gain=gains, factors=factors)
