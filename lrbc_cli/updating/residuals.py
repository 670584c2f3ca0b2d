"""What is squared: differences between model and measurement, bounded against wild lines, floored and weighted."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from lrbc_cli.errors import DataError

Floats = NDArray[np.float64]
Complexes = NDArray[np.complexfloating[Any, Any]]

#: d(20 log10 x)/d ln x.
DB = 20.0 / float(np.log(10.0))

#: Standard deviation at which a line loses half of its weight in the sum of squares [dB].
SIGMA_DB = 1.0

#: Coherences below this say no more than that there is nothing but noise.
LEAST_COHERENCE = 1e-4


def decibel(H: Complexes | Floats) -> Floats:
    """20 log10 |H|, eqs. (30), (31)."""
    return np.asarray(20.0 * np.log10(np.abs(H)))


@dataclass(frozen=True)
class ResidualOptions:
    """How the difference of a line is formed.

    Attributes
    ----------
    kind : str
        ``db``: difference of the magnitudes in dB, eqs. (29) to (31). ``log-complex``: ``20/ln10 ln(y/m)``, the difference in dB and the
        wrapped difference of the phases, a radian counting as 8.69 dB. ``complex``: ``20/ln10 (y - m)`` over the rms of the response's
        selected lines, so that a small error counts as its dB where the response is at its rms.
    loss_scale : float or None
        Differences well above it [dB] count by their size and no longer by its square; None: squares throughout.
    floor : float or None
        Level below a response's largest selected line [dB] under which differences fade; not for ``complex``.
    """

    kind: Literal["db", "log-complex", "complex"] = "db"
    loss_scale: float | None = None
    floor: float | None = None


class DataResidual:
    """Residuals of the data and their Jacobian, from the FRFs of the model and their logarithmic derivatives.

    Parameters
    ----------
    measured : (F, R) complex array
        NaN or zero where a line is not to count.
    options : ResidualOptions
    weights : (F, R) float array or None
        Factors on the residuals; ones where None.

    Attributes
    ----------
    valid : (F, R) bool array
    target : (F, R) float array
        Measurement in dB, zero where not valid.

    Raises
    ------
    DataError
        Where nothing is left to compare.
    """

    def __init__(self, measured: Complexes, options: ResidualOptions | None = None, weights: Floats | None = None) -> None:
        self.options = ResidualOptions() if options is None else options
        self.valid = np.isfinite(measured) & (np.abs(measured) > 0)
        if not self.valid.any():
            raise DataError("no measured value is left to compare with", expected="finite, non-zero FRFs on the selected lines")
        filled = np.where(self.valid, measured, 1.0)
        self.target = np.where(self.valid, decibel(filled), 0.0)
        self._measured = filled[self.valid]
        self._weights = None if weights is None else weights[self.valid]
        power = np.where(self.valid, np.abs(filled) ** 2, 0.0)
        self._floor: Floats | None = None
        if self.options.floor is not None:
            floor = power.max(axis=0) * 10.0 ** (-self.options.floor / 10.0)
            self._floor = np.broadcast_to(floor, self.valid.shape)[self.valid]
        if self.options.kind == "complex":
            # A response without any line has no rms, and needs none.
            rms = np.sqrt(power.sum(axis=0) / np.maximum(self.valid.sum(axis=0), 1))
            self._rms = np.broadcast_to(rms, self.valid.shape)[self.valid]

    @property
    def phase(self) -> bool:
        """Whether the phase enters: then the logarithmic derivatives have to be complex."""
        return self.options.kind != "db"

    def __call__(self, y: Complexes, J: Floats | Complexes) -> tuple[Floats, Floats, Floats]:
        """Residuals at the valid lines.

        Parameters
        ----------
        y : (F, R) complex array
        J : (F, R, size) float or complex array
            ``20/ln10 dln(y)/dtheta``; its real part suffices without the phase.

        Returns
        -------
        residual : (m,) float array
            [dB]; real parts, then imaginary parts where the phase enters.
        jacobian : (m, size) float array
        difference : (v,) float array
            Plain difference in dB of each valid line.
        """
        difference = (decibel(y) - self.target)[self.valid]
        jacobian: NDArray[Any] = J[self.valid]
        residual: NDArray[Any] = difference
        if self.options.kind == "complex":
            now = y[self.valid]
            residual = DB * (now - self._measured) / self._rms
            jacobian = jacobian * (now / self._rms)[:, None]
        elif self.options.kind == "log-complex" or self._floor is not None:
            residual, jacobian = self._logarithmic(y[self.valid], difference, jacobian)
        if self.options.loss_scale is not None:
            residual, jacobian = soft(residual, jacobian, self.options.loss_scale)
        if self._weights is not None:
            residual, jacobian = self._weights * residual, self._weights[:, None] * jacobian
        if np.iscomplexobj(residual):
            residual, jacobian = np.concatenate([residual.real, residual.imag]), np.vstack([jacobian.real, jacobian.imag])
        return np.asarray(residual), np.asarray(jacobian), difference

    def _logarithmic(
        self, now: Complexes, difference: Floats, jacobian: Floats | Complexes
    ) -> tuple[Floats | Complexes, Floats | Complexes]:
        """Difference in dB, of ``sqrt(|H|² + f²)`` where there is a floor f, with that of the phases as imaginary part."""
        real, slope = difference, np.ones_like(difference)
        weight: Floats | float = 1.0
        if self._floor is not None:
            power, before = np.abs(now) ** 2, np.abs(self._measured) ** 2
            real = 0.5 * DB * np.log((power + self._floor) / (before + self._floor))
            slope = power / (power + self._floor)
            # The phase fades as the magnitude does, by what was measured: so both parts weigh the same where the model fits.
            weight = before / (before + self._floor)
        real_rows = slope[:, None] * jacobian.real
        if not self.phase:
            return real, real_rows
        angle = weight * DB * np.angle(now / self._measured)
        return real + 1j * angle, real_rows + 1j * (np.broadcast_to(weight, angle.shape)[:, None] * jacobian.imag)


def soft(residual: Floats | Complexes, jacobian: Floats | Complexes, scale: float) -> tuple[Floats | Complexes, Floats | Complexes]:
    """Residuals whose squares are the pseudo-Huber loss ``2 a² (sqrt(1 + |r|²/a²) - 1)`` of the given ones.

    ``q = r sqrt(2/(1 + u))`` with ``u = sqrt(1 + |r|²/a²)``: smooth, of the same sign or direction, r where it is small and growing
    as the root of ``|r|`` where it is large. A complex residual shrinks as a whole.

    Parameters
    ----------
    residual : (m,) float or complex array
    jacobian : (m, size) float or complex array
    scale : float
        a.

    Returns
    -------
    The transformed residual and its Jacobian.
    """
    u = np.sqrt(1.0 + np.abs(residual) ** 2 / scale**2)
    factor = np.sqrt(2.0 / (1.0 + u))
    along = (np.conj(residual)[:, None] * jacobian).real / scale**2
    return factor * residual, factor[:, None] * jacobian - (residual * factor / (2.0 * u * (1.0 + u)))[:, None] * along


def coherence_sigma(coherence: Floats, averages: Floats | int) -> Floats:
    """Standard deviation of the magnitude of an averaged FRF [dB].

    ``20/ln10 sqrt((1 - g²)/(2 n g²))``, the random error of a frequency response in Bendat and Piersol, *Random Data*, chapter 9.

    Parameters
    ----------
    coherence : float array
        Ordinary coherence g²; NaN where unknown.
    averages : int or float array
        n.

    Returns
    -------
    float array
        NaN where the coherence is unknown.
    """
    g2 = np.clip(coherence, LEAST_COHERENCE, 1.0)
    return np.asarray(DB * np.sqrt((1.0 - g2) / (2.0 * averages * g2)))


def noise_weights(sigma: Floats) -> Floats:
    """Factors ``1/sqrt(1 + (sigma/1 dB)²)`` on residuals in dB; 1 where sigma is NaN.

    Below 1 dB the errors of a model outweigh those of a measurement: such lines keep about their weight.

    Parameters
    ----------
    sigma : float array
        Standard deviations [dB].
    """
    return np.where(np.isnan(sigma), 1.0, 1.0 / np.sqrt(1.0 + (np.nan_to_num(sigma, posinf=np.inf) / SIGMA_DB) ** 2))
