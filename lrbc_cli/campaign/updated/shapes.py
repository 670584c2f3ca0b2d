"""Operational deflection shapes of the updated model of a job at the drawn nodes, with the measured motion of the sensors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from lrbc_cli.arrays import Complexes, Floats, Integers
from lrbc_cli.campaign.identification.found import Identification
from lrbc_cli.campaign.reading.inputs import Inputs
from lrbc_cli.campaign.reduced.stage import ReductionStage
from lrbc_cli.campaign.structure import drawn_dofs
from lrbc_cli.reduction.reduced.affine import AffineModel
from lrbc_cli.results.shapes import ShapesRecord
from lrbc_cli.updating.comparison.correlation import fdac, mean_spectrum, measured_values, quantity_weights, spectrum_peaks
from lrbc_cli.updating.misfit.extended import ExtendedFrf

#: Largest number of shapes of a job, and number of their decimals.
MOST, DIGITS = 6, 3


def shapes_of(inputs: Inputs, stage: ReductionStage | None, result: Identification) -> ShapesRecord | None:
    """Shapes at the largest peaks of the model's mean spectrum, for the excitation with most responses; None without basis or peak."""
    if stage is None or stage.rows is None:
        return None
    load = int(np.bincount(inputs.input_of).argmax())
    own = np.flatnonzero(inputs.input_of == load)
    measured, updated = result.measurement.values[:, own], result.updated[:, own]
    f, valid = result.measurement.frequency_hz, measured_values(measured)
    level = mean_spectrum(updated, valid)
    at = spectrum_peaks(f, level).line
    at = np.sort(at[np.argsort(-level[at], kind="stable")][:MOST])
    if not at.size:
        return None
    dofs = drawn_dofs(inputs)
    moved = np.zeros((at.size, dofs.size), dtype=complex)
    moved[:, np.flatnonzero(dofs.ravel() >= 0)] = displacements(inputs, stage, result, 2j * np.pi * f[at], load)
    responses = [inputs.responses[i] for i in own]
    air = np.array([response.quantity == "pressure" for response in responses])
    cosine = np.diag(fdac(measured[at], updated[at], quantity_weights(measured, tuple(r.quantity for r in responses))))
    to_quantity = (2j * np.pi * f[at, None]) ** inputs.model.output_power[own]
    shapes = []
    for k, line in enumerate(at):
        unit = _unit(moved[k])
        units = np.where(air, _unit(updated[line, air]) if air.any() else 1.0, unit * to_quantity[k])
        seen = np.asarray(measured[line] / units, dtype=complex)
        seen[~valid[line]] = np.nan
        shapes.append(
            {"frequency_hz": f[line], "largest": abs(unit), "cosine": cosine[k]}
            | _parts("", moved[k] / unit)
            | _parts("measured_", seen)
            | _parts("modelled_", updated[line] / units)
        )
    tree = {"job": result.name, "excitation": inputs.excitations[load], "nodes": dofs.shape[0]}
    return ShapesRecord.checked(tree | {"responses": [response.name for response in responses], "shapes": shapes})


def displacements(inputs: Inputs, stage: ReductionStage, result: Identification, s: Complexes, load: int) -> Complexes:
    """(F, k) displacements [m] at the rows of the basis for a unit force at one load, with nuisance parameters."""
    assert stage.rows is not None
    affine = AffineModel(stage.reduction.model, inputs.recipe, inputs.shifts)
    drifted = ExtendedFrf(affine, s, result.parameters, result.posterior.nuisances, np.arange(len(inputs.responses)))
    theta = np.concatenate([result.solution.theta, result.posterior.values])
    factors = drifted.effects(theta).factors
    one: Integers = np.zeros(len(stage.rows), dtype=np.int64)
    model = replace(
        affine.at(factors) if factors else affine.base,
        B=affine.loads(drifted.offset(theta))[:, [load]],
        L=stage.rows,
        output_power=one,
        input_of=one,
    )
    return model.evaluate(s, result.parameters.dynamic(result.solution.theta, s), workers=1)


def _unit(values: Complexes) -> complex:
    """Complex unit of a shape: the largest magnitude, with the phase at which the values are largest together."""
    size = float(np.abs(values).max(initial=0.0)) or 1.0
    return complex(size * np.exp(0.5j * np.angle(np.sum((values / size) ** 2))))


def _parts(name: str, values: Complexes) -> dict[str, Floats]:
    # Adding 0.0 turns -0.0 into 0.0.
    real, imag = np.asarray(values.real, dtype=float), np.asarray(values.imag, dtype=float)
    return {f"{name}real": real.round(DIGITS) + 0.0, f"{name}imag": imag.round(DIGITS) + 0.0}
