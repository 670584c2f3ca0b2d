"""The key ``nuisances`` of ``result.json``."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress

from pydantic import Field, TypeAdapter, ValidationError

from lrbc_cli.results.fields import Record


class Estimate(Record):
    """A value with its standard deviation."""

    value: float
    std: float | None = None


class Nuisances(Record):
    """Nuisance parameters, by response, or by excitation and direction.

    ``common_gain_db`` is the gain of all FRFs of the job against what those of the reference job predict, ``gain_db`` that of the FRFs of
    one sensor or hammer point. In the reference job ``gain_db`` is the gain of each of its FRFs against the model. A response that was
    not used has null as standard deviation. Gains are included in the updated FRFs, and no verdict rests on them.
    """

    common_gain_db: Estimate | None = None
    gain_db: dict[str, Estimate] = Field(default_factory=dict)
    hammer_offset_mm: dict[str, Estimate] = Field(default_factory=dict)
    sound_speed_percent: Estimate | None = None
    temperature_kelvin: Estimate | None = None

    def entries(self) -> Iterator[tuple[str, str, Estimate]]:
        """Key, name (empty: a single value) and estimate of all that is there, whether this class lists the key or not."""
        for key, found in self:
            with suppress(ValidationError):
                one = _FORMS.validate_python(found)
                yield from ((key, of, entry) for of, entry in ({"": one} if isinstance(one, Estimate) else one).items())


_FORMS: TypeAdapter[Estimate | dict[str, Estimate]] = TypeAdapter(Estimate | dict[str, Estimate])
