"""Layout of a measurement file as the campaign states it (key ``format`` of a job): what the file itself does not say."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from lrbc_cli.errors import ConfigError
from lrbc_cli.io.units import Unit, numerator_quantity, parse_unit, response_quantity


@dataclass(frozen=True, kw_only=True)
class TextLayout:
    """Layout of a text file of FRFs; what is None is recognised from the file and noted.

    ``unit`` and ``quantity`` apply to files of any format and take precedence over what the file states.

    Attributes
    ----------
    delimiter : str or None
        Separator of columns: ``,``, ``;``, a tab, or a blank for any run of blanks.
    decimal : str or None
        ``.`` or ``,``.
    skip : int or None
        Lines before the header, or before the numbers if there is no header.
    frequency : str, int or None
        Name or number (from 1) of the column of frequencies.
    frequency_unit : str or None
        ``Hz``, ``kHz`` or ``rad/s``.
    representation : str or None
        ``real-imag``, ``magnitude-phase`` or ``db-phase`` (magnitude in dB).
    phase : str or None
        ``deg`` or ``rad``.
    unit : str or None
        Unit of the FRFs, such as ``Pa/N`` or ``g/N``; if it is the unit of the response alone, the force is in newtons.
    quantity : str or None
        pressure, displacement, velocity or acceleration.
    coherence : str, int or None
        Variable (MATLAB, HDF5, ``.npz``) that holds the coherence; in a text file with one FRF, name or number (from 1) of its column.
    columns : mapping
        Record name to the name or number (from 1) of each of its two columns; all other columns are left out.
    """

    delimiter: Literal[",", ";", "\t", " "] | None = None
    decimal: Literal[".", ","] | None = None
    skip: int | None = None
    frequency: str | int | None = None
    frequency_unit: Literal["Hz", "kHz", "rad/s"] | None = None
    representation: Literal["real-imag", "magnitude-phase", "db-phase"] | None = None
    phase: Literal["deg", "rad"] | None = None
    unit: str | None = None
    quantity: Literal["pressure", "displacement", "velocity", "acceleration"] | None = None
    coherence: str | int | None = None
    columns: Mapping[str, tuple[str | int, str | int]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Check that the keys agree: those of a job and of a single file are merged by now."""
        if self.delimiter is not None and self.delimiter == self.decimal:
            raise ConfigError("delimiter and decimal sign are the same", place="format", expected="two signs", found=repr(self.delimiter))
        stated = self.si_unit
        if stated is not None and self.quantity not in (None, response_quantity(stated)):
            raise ConfigError(
                "unit and quantity do not fit", place="format.unit", expected=f"a unit of {self.quantity} over force", found=self.unit
            )

    @property
    def si_unit(self) -> Unit | None:
        """Stated unit of the FRFs as response over force; None if none is stated."""
        if self.unit is None:
            return None
        unit = parse_unit(self.unit)
        if unit is not None and response_quantity(unit) is None and numerator_quantity(unit) is not None:
            unit = unit / Unit(1.0, force=1)
        if unit is None or response_quantity(unit) is None:
            expected = "a unit such as Pa/N, m/N, mm/s/N, m/s^2/N or g/N"
            raise ConfigError("this is not a unit of an FRF", place="format.unit", expected=expected, found=repr(self.unit))
        return unit

    @property
    def stated_quantity(self) -> str | None:
        """The stated quantity, or that of the stated unit."""
        unit = self.si_unit
        return self.quantity or (response_quantity(unit) if unit is not None else None)
