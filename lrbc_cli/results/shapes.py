"""``NAME/shapes.json``: operational deflection shapes of the updated model at its largest peaks, and the measured values there."""

from __future__ import annotations

from typing import Literal, Self

from pydantic import model_validator

from lrbc_cli.results.fields import Gap, Gaps, Many, Record, StoredRecord, Vector, same_length, wrong


class DeflectionShape(Record):
    """Complex displacement at one line, divided by the largest one, ``largest`` [m/N].

    ``real`` and ``imag`` hold x, y and z of each drawn node of the structure, one node after the other, relative to the phase of the
    largest displacement. The values of the responses are displacements along their directions in the same scale; pressures are relative
    to the largest one of the model, with a phase of their own. ``cosine`` is the FDAC of measurement and model at the line.
    """

    frequency_hz: float
    largest: float
    cosine: Gap
    real: Vector
    imag: Vector
    measured_real: Gaps
    measured_imag: Gaps
    modelled_real: Gaps
    modelled_imag: Gaps


class ShapesRecord(StoredRecord):
    """Shapes of a job for one excitation, by frequency; ``nodes`` is the number of structural nodes in ``structure.json``."""

    format: Literal["lrbc-shapes"]
    job: str
    excitation: str
    nodes: int
    responses: Many[str]
    shapes: Many[DeflectionShape]

    @model_validator(mode="after")
    def _whole(self) -> Self:
        for index, shape in enumerate(self.shapes):
            if len(shape.real) != 3 * self.nodes or len(shape.imag) != 3 * self.nodes:
                raise wrong(f".shapes[{index}].real", f"{3 * self.nodes} values, as many in imag", f"{len(shape.real)} values")
            if len(shape.measured_real) != len(self.responses):
                raise wrong(f".shapes[{index}].measured_real", f"{len(self.responses)} values", f"{len(shape.measured_real)} values")
            same_length(shape, "measured_real", "measured_imag", "modelled_real", "modelled_imag")
        return self
