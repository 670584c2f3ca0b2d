"""Which factors a measurement cannot tell apart."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lrbc_cli.arrays import Floats
from lrbc_cli.updating.normal import NORMAL_95
from lrbc_cli.updating.statistics.priors import CALIBRATION_PRIOR, CalibrationPrior


def indistinguishable(
    names: Sequence[str], data: Floats, prior_std: Floats, others: Floats, prior: CalibrationPrior = CALIBRATION_PRIOR
) -> list[tuple[tuple[str, ...], bool]]:
    """Groups of factors of which the data determine but a combination.

    The information of the data on the factors is what is left of JᵀJ once all other unknowns are fitted. Scaled to a unit diagonal it is
    the negative correlation of two estimates, and its small eigenvalues are directions that the factors can be moved along together.

    Parameters
    ----------
    names : sequence of str
        Of the factors: the first columns.
    data : (n, k + m) float array
        Jacobian of the data residuals over their standard deviation.
    prior_std : (k,) float array
        Standard deviations of the factors in the prior.
    others : (m, m) float array
        Precision of the prior of the other unknowns.
    prior : CalibrationPrior
        Its ``same``, ``belongs`` and ``left``.

    Returns
    -------
    list of (names, bool)
        The factors of each weak direction, and whether it is left to the prior.
    """
    k = len(names)
    if k < 2:
        return []
    information = data.T @ data
    left = information[:k, :k]
    if information.shape[0] > k:
        left = left - information[:k, k:] @ np.linalg.solve(information[k:, k:] + others, information[k:, :k])
    # A factor that nothing depends on is a case of its own.
    felt = np.flatnonzero(np.diag(left) * prior_std**2 > 1e-6)
    if felt.size < 2:
        return []
    left = left[np.ix_(felt, felt)]
    scale = np.sqrt(np.diag(left))
    values, vectors = np.linalg.eigh(left / np.outer(scale, scale))
    posterior = np.linalg.inv(left + np.diag(prior_std[felt] ** -2.0))
    found: list[tuple[tuple[str, ...], bool]] = []
    for value, vector in zip(values, vectors.T, strict=True):
        if value >= 1.0 - prior.same:
            break
        share = np.abs(vector)
        members = np.flatnonzero(share >= prior.belongs * share.max())
        group = tuple(names[felt[i]] for i in members)
        direction = vector / scale
        # How far the prior would let them go along it, and how far they still can.
        normal = np.diag(prior_std[felt] ** -2.0) @ direction
        kept = float(normal @ posterior @ normal / (normal @ direction))
        if members.size > 1 and group not in [known for known, _ in found]:
            found.append((group, kept >= prior.left))
    return found


@dataclass(frozen=True)
class Losses:
    """What damps a field, as loss factors: alpha / omega, beta omega, and a loss factor.

    Attributes
    ----------
    names : tuple of str
        ``alpha.FIELD``, ``beta.FIELD``, ``loss_factor.FIELD``, those that there are.
    values : (k,) float array
        alpha [1/s], beta [s], the loss factor.
    covariance : (k, k) float array
        Of their logarithms.
    frequency_hz : (F,) float array
    """

    names: tuple[str, ...]
    values: Floats
    covariance: Floats
    frequency_hz: Floats

    @property
    def field(self) -> str:
        """The field that they damp."""
        return self.names[0].partition(".")[2]

    @property
    def terms(self) -> list[str]:
        """What each adds to the loss factor, in words."""
        kinds = [name.partition(".")[0] for name in self.names]
        return [{"alpha": "alpha / omega", "beta": "beta omega"}.get(kind, kind) for kind in kinds]

    def best_known(self) -> tuple[float, float, float]:
        """Their sum where it is known best, the standard deviation of its logarithm, and the frequency [Hz]."""
        omega = 2 * np.pi * self.frequency_hz
        shape = {"alpha": 1 / omega, "beta": omega, "loss_factor": np.ones_like(omega)}
        parts = np.stack([value * shape[name.partition(".")[0]] for name, value in zip(self.names, self.values, strict=True)])
        total = parts.sum(axis=0)
        spread = np.sqrt(np.maximum(np.einsum("if,ij,jf->f", parts, self.covariance, parts), 0.0)) / total
        at = int(np.argmin(spread))
        return float(total[at]), float(spread[at]), float(self.frequency_hz[at])


def apart_notes(groups: Sequence[tuple[tuple[str, ...], bool]], damping: Sequence[Losses] = ()) -> list[str]:
    """What to say of them; of factors that damp one field, what they come to together."""
    notes = []
    for names, left in groups:
        words = f"{', '.join(names[:-1])} and {names[-1]}"
        text = f"{words} cannot be told apart by these FRFs: only their combination is determined, "
        # Data without errors of the model would still tell a little.
        text += "the prior shares it between them" if left else "what each has of it rests on the last few per cent of the fit"
        for losses in damping:
            if len(set(names) & set(losses.names)) > 1:
                total, spread, hz = losses.best_known()
                low, high = (total * np.exp(sign * NORMAL_95 * spread) for sign in (-1, 1))
                text += (
                    f"; the loss factor {' + '.join(losses.terms)} of field {losses.field} is "
                    f"{total:.3g} ({low:.3g} to {high:.3g}) at {hz:.4g} Hz"
                )
        notes.append(text)
    return notes
