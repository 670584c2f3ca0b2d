"""FRFs whose dB values are linear in the unknowns: then a posterior is known in closed form."""

from __future__ import annotations

import numpy as np

from lrbc_cli.model.terms import EdgeDamping, ParameterGroup, Parameterisation


def line_group(count: int, *, damping: bool = False) -> ParameterGroup:
    """Values along a straight edge of one metre, from 0 to 8."""
    at = np.linspace(0.0, 1.0, count)
    return ParameterGroup(
        name="edge",
        kind="stiffness",
        terms=np.arange(count),
        parameter=np.arange(count),
        initial=np.full(count, 4.0),
        bounds=np.tile([0.0, 8.0], (count, 1)),
        smoothing=np.eye(count),
        damping=EdgeDamping(beta=1e-6) if damping else None,
        xyz=np.column_stack([0 * at, at, 0 * at]),
        arc_length=at,
    )


class LinearModel:
    """``20 log10 |y| = A theta``; A (F, R, size)."""

    def __init__(self, A: np.ndarray, parameters: Parameterisation) -> None:
        self.A, self.parameters = A, parameters
        self.s = 1j * np.arange(1.0, A.shape[0] + 1)

    def frf(self, theta: np.ndarray) -> np.ndarray:
        return 10.0 ** (self.A @ theta / 20.0) * np.exp(0.3j)

    def sensitivities(self, theta: np.ndarray, phase: bool = False) -> tuple[np.ndarray, np.ndarray]:
        assert not phase
        return self.frf(theta), self.A

    def near(self, theta: np.ndarray) -> LinearModel:
        return self
