"""Natural frequencies before and after updating, as ``result.json`` holds them."""

from __future__ import annotations

from typing import Literal

from lrbc_cli.results.fields import Gap, Many, Record


class ModePair(Record):
    """A mode of the model before and after: natural frequencies [Hz], damping ratios zeta, and the MAC of both shapes over the whole model.

    Null where the other state has no mode like it in the band; the loss factor of a mode is twice its damping ratio.
    """

    before_hz: Gap
    before_damping: Gap
    after_hz: Gap
    after_damping: Gap
    mac: Gap


class ModesRecord(Record):
    """Modes of the band, of the reduced model; ``before`` is the reference state or the start values."""

    before: Literal["reference", "initial"]
    pairs: Many[ModePair]
