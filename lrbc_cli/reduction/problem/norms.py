"""The norm that makes the error at a line relative: that of the responses of one physical quantity, with lower limits."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from lrbc_cli.arrays import Complexes, Floats, Integers
from lrbc_cli.model.fem import FeModel

#: Errors are relative to no less than this share (-100 dB) of the norm of the line in the reference state.
SILENT = 1e-5

#: Also to no less than this share (-260 dB) of the response at the loaded point, below which the full solution too is only rounding.
ROUNDING = 1e-13


def quantity_groups(model: FeModel) -> list[Integers]:
    """Indices of the responses that share a physical quantity (pressures, displacements, velocities, accelerations)."""
    acoustic = np.asarray(abs(model.L) @ model.is_acoustic.astype(float)) > 0
    key = np.where(acoustic, -1, model.output_power)
    return [np.flatnonzero(key == value) for value in np.unique(key)]


def local_responses(model: FeModel, s: complex, input_of: Integers) -> Floats:
    """(R,) estimated response if sensor and load were at one point: geometric mean of the flexibilities of both, from the diagonals alone.

    A response far below it belongs to a part that the load cannot reach: the exact solution is zero there, and a computed one is rounding.
    """
    omega = abs(s)
    diagonal = np.abs(model.K.diagonal()) + omega**2 * np.abs(model.M.diagonal())
    positive = diagonal[diagonal > 0]
    flexible = 1.0 / np.maximum(diagonal, positive.min() if positive.size else 1.0)
    # In a u-p system reciprocity holds up to the factor omega², by which the acoustic rows are divided to make it symmetric.
    outputs = np.where(model.is_acoustic, omega, 1.0) ** 2 * flexible
    inputs = np.where(model.is_acoustic, 1.0 / omega, 1.0) ** 2 * flexible
    heard = np.sqrt(np.asarray((abs(model.L) ** 2) @ outputs))
    driven = np.sqrt(np.asarray((abs(model.B) ** 2).T @ inputs))
    return np.asarray(heard * driven[input_of] * omega**model.output_power)


def relative_error(groups: Sequence[Integers], y: Complexes, exact: Complexes, reference: Complexes, local: Floats | None = None) -> float:
    """Error of y at one line relative to the norm of the line, for the physical quantity (``groups``) with the largest one.

    The norm is at least ``SILENT`` times that of the reference state: where the terms suppress the response (e.g. clamp the loaded point),
    the full solution itself is a difference of nearly equal numbers. It is also at least ``ROUNDING`` times that of the local responses,
    for loads that reach no response in the reference state either.
    """
    worst = 0.0
    for group in groups:
        norm = max(float(np.linalg.norm(exact[group])), SILENT * float(np.linalg.norm(reference[group])))
        if local is not None:
            norm = max(norm, ROUNDING * float(np.linalg.norm(local[group])))
        error = float(np.linalg.norm(y[group] - exact[group]))
        worst = max(worst, error / norm if norm else (0.0 if error == 0.0 else np.inf))
    return worst
