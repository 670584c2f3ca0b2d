"""What changes between the jobs of a campaign besides the bolts: temperature, hits, gains, torque."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field

import numpy as np

from lrbc_cli.arrays import Floats

#: Temperature at which the design's air has its properties [K].
ROOM = 293.15


@dataclass(frozen=True)
class Drift:
    """One job's share of it.

    Attributes
    ----------
    kelvin : float
        Air temperature above the design's [K].
    hammer : (float, float)
        Hits off their usual place along x and y [m].
    gain : mapping of str to float
        Sensitivity of each response against its calibration [dB].
    """

    kelvin: float = 0.0
    hammer: tuple[float, float] = (0.0, 0.0)
    gain: Mapping[str, float] = field(default_factory=dict)

    @property
    def warming(self) -> float:
        """Factor on the squared speed of sound, and the inverse of that on the density of the air."""
        return (ROOM + self.kelvin) / ROOM

    def gains(self, names: Sequence[str]) -> Floats:
        """(r,) linear gains."""
        return np.array([10 ** (self.gain.get(name, 0.0) / 20) for name in names])

    def as_dict(self) -> dict[str, object]:
        """For the record beside the data."""
        return {key: value for key, value in asdict(self).items() if value and value != (0.0, 0.0)}


@dataclass(frozen=True)
class Scatter:
    """Standard deviations of what is drawn, normally distributed, for every job.

    Attributes
    ----------
    kelvin : float
        [K]
    hammer : float
        Along x and along y [m].
    gain : float
        Of each response [dB].
    """

    kelvin: float = 0.0
    hammer: float = 0.0
    gain: float = 0.0

    def draw(self, names: Sequence[str], rng: np.random.Generator) -> Drift:
        """Draw one job; the same numbers are taken from `rng` whatever the scatter, so one does not change the others."""
        kelvin, x, y, *gain = rng.standard_normal(3 + len(names))
        gains = {name: round(self.gain * float(value), 4) for name, value in zip(names, gain, strict=True)} if self.gain else {}
        return Drift(round(self.kelvin * float(kelvin), 4), (round(self.hammer * float(x), 6), round(self.hammer * float(y), 6)), gains)
