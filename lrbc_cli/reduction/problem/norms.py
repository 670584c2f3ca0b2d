"""What the error of a line is relative to: its norm over responses of one quantity, and what counts as silence or rounding."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from lrbc_cli.arrays import Complexes, Floats, Integers
from lrbc_cli.model.fem import FeModel

#: A line this much (100 dB) below that of the reference state is silent.
SILENT = 1e-5

#: A line this much (260 dB) below what a unit load does where it acts is zero: what is left of it is rounding, in the full solution too.
ROUNDING = 1e-13


def quantity_groups(model: FeModel) -> list[Integers]:
    """Responses that share a physical quantity."""
    acoustic = np.asarray(abs(model.L) @ model.is_acoustic.astype(float)) > 0
    key = np.where(acoustic, -1, model.output_power)
    return [np.flatnonzero(key == value) for value in np.unique(key)]


def local_responses(model: FeModel, s: complex, input_of: Integers) -> Floats:
    """(R,) size of a response if its place were where the load acts: the mean flexibility of both, taken from the diagonals alone.

    What is far below it is no response: a part that the load cannot reach, where the full solution is zero and every other one rounding.
    """
    omega = abs(s)
    diagonal = np.abs(model.K.diagonal()) + omega**2 * np.abs(model.M.diagonal())
    positive = diagonal[diagonal > 0]
    flexible = 1.0 / np.maximum(diagonal, positive.min() if positive.size else 1.0)
    # Rows of the air are divided by omega² where the u-p system is made symmetric: reciprocity holds up to that factor.
    outputs = np.where(model.is_acoustic, omega, 1.0) ** 2 * flexible
    inputs = np.where(model.is_acoustic, 1.0 / omega, 1.0) ** 2 * flexible
    heard = np.sqrt(np.asarray((abs(model.L) ** 2) @ outputs))
    driven = np.sqrt(np.asarray((abs(model.B) ** 2).T @ inputs))
    return np.asarray(heard * driven[input_of] * omega**model.output_power)


def relative_error(groups: Sequence[Integers], y: Complexes, exact: Complexes, reference: Complexes, local: Floats | None = None) -> float:
    """Error of one line relative to its norm, the worst over quantities (pressures apart from motions).

    Where the terms silence a line (clamping the loaded point, say) it counts against ``SILENT`` of the reference state instead: below
    that the full solution itself is a difference of numbers that cancel. Where nothing answers in the reference state either, it counts
    against ``ROUNDING`` of the local responses.
    """
    worst = 0.0
    for group in groups:
        norm = max(float(np.linalg.norm(exact[group])), SILENT * float(np.linalg.norm(reference[group])))
        if local is not None:
            norm = max(norm, ROUNDING * float(np.linalg.norm(local[group])))
        error = float(np.linalg.norm(y[group] - exact[group]))
        worst = max(worst, error / norm if norm else (0.0 if error == 0.0 else np.inf))
    return worst
