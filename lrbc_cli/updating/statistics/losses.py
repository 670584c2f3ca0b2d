"""Transformations of differences before they are squared: the stereographic projection, and the soft (pseudo-Huber) loss."""

from __future__ import annotations

import numpy as np

from lrbc_cli.arrays import Complexes, Floats


def on_sphere(level: Floats, phase: Floats) -> tuple[Floats, tuple[Floats, Floats]]:
    """(3, m) points of ``exp(level + i phase)`` on the unit sphere by stereographic projection, and their derivatives to level and phase.

    Parameters
    ----------
    level, phase : (m,) float arrays
        [Np], 0 is the equator; [rad].
    """
    cosine, sine, height, radius = np.cos(phase), np.sin(phase), np.tanh(level), 1.0 / np.cosh(level)
    point = np.stack([radius * cosine, radius * sine, height])
    by_level = np.stack([-radius * height * cosine, -radius * height * sine, radius**2])
    return point, (by_level, np.stack([-radius * sine, radius * cosine, np.zeros_like(phase)]))


def soft(residual: Floats | Complexes, jacobian: Floats | Complexes, scale: float) -> tuple[Floats | Complexes, Floats | Complexes]:
    """Residuals q whose squares are the pseudo-Huber loss ``2 a² (sqrt(1 + |r|²/a²) - 1)`` of the residuals r.

    ``q = r sqrt(2/(1 + u))`` with ``u = sqrt(1 + |r|²/a²)``: smooth, with the sign (or the phase, if complex) of r, equal to r where
    ``|r|`` is far below a, and growing as the square root of ``|r|`` where it is far above.

    Parameters
    ----------
    residual : (m,) float or complex array
    jacobian : (m, size) float or complex array
    scale : float
        a, in the unit of r.

    Returns
    -------
    (m,) and (m, size) arrays
        q and its Jacobian.
    """
    u = np.sqrt(1.0 + np.abs(residual) ** 2 / scale**2)
    factor = np.sqrt(2.0 / (1.0 + u))
    along = (np.conj(residual)[:, None] * jacobian).real / scale**2
    return factor * residual, factor[:, None] * jacobian - (residual * factor / (2.0 * u * (1.0 + u)))[:, None] * along
