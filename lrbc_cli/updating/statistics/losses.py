"""Transformations of differences before they are squared: the stereographic projection, and losses that grow more slowly."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from lrbc_cli.arrays import Complexes, Floats
from lrbc_cli.errors import ConfigError
from lrbc_cli.updating.checked import Checked, Positive


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


@dataclass(frozen=True, kw_only=True)
class Loss(Checked, ABC):
    """A loss of residuals: ``sum rho(|r|²)`` is minimised instead of ``sum |r|²``.

    A subclass defines ``rho``; its fields are parameters, and its code is part of the identity of a result. With ``rho(z) = z`` for small
    z, residuals far below the scale of the loss count as without it.
    """

    def __post_init__(self) -> None:
        """Check the fields, and the slope of ``rho`` against its differences.

        Raises
        ------
        ConfigError
            If a field is not valid, or the slope is not the derivative of the value.
        """
        super().__post_init__()
        at = 10.0 ** np.arange(-2.0, 5.0)
        value, slope = self.rho(at)
        rise = (self.rho(1.001 * at)[0] - self.rho(0.999 * at)[0]) / (0.002 * at)
        if not (np.isfinite(value) & (value >= 0.0)).all() or not np.allclose(slope, rise, rtol=1e-3, atol=1e-6):
            expected = "values of at least 0, and their derivative with respect to the square"
            raise ConfigError("this loss cannot be used", place=f"{type(self).__name__}.rho", expected=expected, found=f"{value}, {slope}")

    @abstractmethod
    def rho(self, square: Floats) -> tuple[Floats, Floats]:
        """Loss of a residual, and its derivative with respect to the square.

        Parameters
        ----------
        square : (m,) float array
            ``|r|²`` [dB²].
        """

    def __call__(self, residual: Floats | Complexes, jacobian: Floats | Complexes) -> tuple[Floats | Complexes, Floats | Complexes]:
        """Residuals ``q = r sqrt(rho(|r|²) / |r|²)``, whose squares are the loss of the residuals r, and their Jacobian.

        Parameters
        ----------
        residual : (m,) float or complex array
        jacobian : (m, size) float or complex array
        """
        square = np.abs(residual) ** 2
        value, slope = self.rho(square)
        factor = np.sqrt(np.divide(value, square, out=np.array(slope, dtype=float), where=square > 0.0))
        below = square * factor
        bend = np.divide(slope - factor**2, below, out=np.zeros_like(below), where=below > 0.0)
        along = (np.conj(residual)[:, None] * jacobian).real
        return factor * residual, factor[:, None] * jacobian + (residual * bend)[:, None] * along


@dataclass(frozen=True, kw_only=True)
class Soft(Loss):
    """Pseudo-Huber loss ``2 a² (sqrt(1 + |r|²/a²) - 1)``.

    ``q = r sqrt(2/(1 + u))`` with ``u = sqrt(1 + |r|²/a²)``: smooth, with the sign (or the phase, if complex) of r, equal to r where
    ``|r|`` is far below a, and growing as the square root of ``|r|`` where it is far above.

    Attributes
    ----------
    scale : float
        a [dB].
    """

    scale: Positive

    def rho(self, square: Floats) -> tuple[Floats, Floats]:
        """See ``Loss.rho``."""
        u = np.sqrt(1.0 + square / self.scale**2)
        return 2.0 * square / (1.0 + u), 1.0 / u

    def __call__(self, residual: Floats | Complexes, jacobian: Floats | Complexes) -> tuple[Floats | Complexes, Floats | Complexes]:
        """See ``Loss``; the same without divisions by small squares."""
        u = np.sqrt(1.0 + np.abs(residual) ** 2 / self.scale**2)
        factor = np.sqrt(2.0 / (1.0 + u))
        along = (np.conj(residual)[:, None] * jacobian).real / self.scale**2
        return factor * residual, factor[:, None] * jacobian - (residual * factor / (2.0 * u * (1.0 + u)))[:, None] * along
