"""Simulates the measurement of FRFs: hammer hits, noise on force and responses, H1 estimate and coherence."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lrbc_cli.arrays import Complexes, Floats


@dataclass(frozen=True, kw_only=True)
class Chain:
    """Measurement chain: hammer, noise and averages.

    Attributes
    ----------
    peak : float
        Mean peak force [N].
    duration : float
        Mean duration of the half-sine pulse [s]; at the frequency 1 / duration its spectrum is about 10 dB lower than at zero.
    force_noise : float
        Noise of the force spectrum relative to its largest line.
    response_noise : float
        Noise of a response spectrum relative to its root mean square over the lines; it rises below `corner`.
    corner : float
        Frequency [Hz].
    hits : int
        Number of averages.
    """

    peak: float = 80.0
    duration: float = 0.0025
    force_noise: float = 0.002
    response_noise: float = 0.004
    corner: float = 25.0
    hits: int = 5

    def force(self, frequencies: Floats, rng: np.random.Generator) -> Complexes:
        """Spectrum of one hit [N s], (f,): a half-sine pulse of random peak, duration and delay; `frequencies` in Hz."""
        duration = self.duration * np.exp(rng.normal(0.0, 0.05))
        peak = self.peak * np.exp(rng.normal(0.0, 0.25))
        x = 2 * frequencies * duration
        # cos(pi x / 2) / (1 - x^2), regular at x = 1.
        shape = np.pi / 4 * (np.sinc((x - 1) / 2) + np.sinc((x + 1) / 2))
        delay = rng.uniform(0.01, 0.02) + duration / 2
        return np.asarray(2 * peak * duration / np.pi * shape * np.exp(-2j * np.pi * frequencies * delay))

    def measure(self, frfs: Complexes, frequencies: Floats, rng: np.random.Generator) -> tuple[Complexes, Floats]:
        """H1 estimate and coherence of noisy measurements over all hits.

        Parameters
        ----------
        frfs : (f, r) complex array
            True FRFs.
        frequencies : (f,) array
            Lines [Hz].
        rng : numpy.random.Generator

        Returns
        -------
        estimate : (f, r) complex array
        coherence : (f, r) array
        """

        def noise(*shape: int) -> Complexes:
            return np.asarray((rng.standard_normal(shape) + 1j * rng.standard_normal(shape)) / np.sqrt(2))

        cross: Complexes = np.zeros(frfs.shape, dtype=complex)
        force_power = np.zeros(frequencies.size)
        response_power = np.zeros(frfs.shape)
        colour = np.sqrt(1 + (self.corner / frequencies) ** 4)
        typical = self.force(frequencies, np.random.default_rng(0))
        level = self.response_noise * np.sqrt(np.mean(np.abs(frfs * typical[:, None]) ** 2, axis=0))
        for _ in range(self.hits):
            true_force = self.force(frequencies, rng)
            force = true_force + self.force_noise * np.abs(typical).max() * noise(frequencies.size)
            response = frfs * true_force[:, None] + level * colour[:, None] * noise(*frfs.shape)
            cross += response * force.conj()[:, None]
            force_power += np.abs(force) ** 2
            response_power += np.abs(response) ** 2
        return cross / force_power[:, None], np.abs(cross) ** 2 / (force_power[:, None] * response_power)
