"""Identifiability of calibration factors: groups of which a measurement determines only a combination, factors at bounds, notes on both."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lrbc_cli.arrays import Floats
from lrbc_cli.model.terms import Parameterisation
from lrbc_cli.updating.misfit.nuisances import Nuisance
from lrbc_cli.updating.normal import NORMAL_95
from lrbc_cli.updating.statistics.priors import CALIBRATION_PRIOR, CalibrationPrior


def indistinguishable(
    names: Sequence[str], data: Floats, prior_std: Floats, others: Floats, prior: CalibrationPrior = CALIBRATION_PRIOR
) -> list[tuple[tuple[str, ...], bool]]:
    """Groups of factors of which the data determine only a combination.

    The information of the data on the factors is the Schur complement of JᵀJ after all other unknowns are fitted. Scaled to a unit
    diagonal, its off-diagonal entries are negative correlations for two factors, and its small eigenvalues belong to weak directions,
    along which the factors can be moved together.

    Parameters
    ----------
    names : sequence of str
        Names of the k factors, the first columns of ``data``.
    data : (n, k + m) float array
        Jacobian of the data residuals over their standard deviation.
    prior_std : (k,) float array
        Standard deviations of the factors in the prior.
    others : (m, m) float array
        Prior precision of the m other unknowns.
    prior : CalibrationPrior
        Gives ``same``, ``belongs`` and ``left``.

    Returns
    -------
    list of (names, bool)
        The factors of each weak direction, and whether the prior determines it.
    """
    k = len(names)
    if k < 2:
        return []
    information = data.T @ data
    left = information[:k, :k]
    if information.shape[0] > k:
        left = left - information[:k, k:] @ np.linalg.solve(information[k:, k:] + others, information[k:, :k])
    # Factors without influence on the data are left out: they would make a direction of their own.
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
        # Posterior variance along the direction over the prior variance.
        normal = np.diag(prior_std[felt] ** -2.0) @ direction
        kept = float(normal @ posterior @ normal / (normal @ direction))
        if members.size > 1 and group not in [known for known, _ in found]:
            found.append((group, kept >= prior.left))
    return found


@dataclass(frozen=True, kw_only=True)
class Losses:
    """Damping of a field as a sum of loss factors: alpha / omega, beta omega, and a constant loss factor.

    Attributes
    ----------
    names : tuple of str
        ``alpha.FIELD``, ``beta.FIELD``, ``loss_factor.FIELD``, as far as the model has them.
    values : (k,) float array
        alpha [1/s], beta [s], loss factor.
    covariance : (k, k) float array
        Of the natural logarithms of the values.
    frequency_hz : (F,) float array
        Lines of the fit.
    """

    names: tuple[str, ...]
    values: Floats
    covariance: Floats
    frequency_hz: Floats

    @property
    def field(self) -> str:
        """Name of the field."""
        return self.names[0].partition(".")[2]

    @property
    def terms(self) -> list[str]:
        """Contribution of each value to the loss factor, in words."""
        kinds = [name.partition(".")[0] for name in self.names]
        return [{"alpha": "alpha / omega", "beta": "beta omega"}.get(kind, kind) for kind in kinds]

    def best_known(self) -> tuple[float, float, float]:
        """Total loss factor at the line where it is known best, the standard deviation of its logarithm, and the frequency [Hz]."""
        omega = 2 * np.pi * self.frequency_hz
        shape = {"alpha": 1 / omega, "beta": omega, "loss_factor": np.ones_like(omega)}
        parts = np.stack([value * shape[name.partition(".")[0]] for name, value in zip(self.names, self.values, strict=True)])
        total = parts.sum(axis=0)
        spread = np.sqrt(np.maximum(np.einsum("if,ij,jf->f", parts, self.covariance, parts), 0.0)) / total
        at = int(np.argmin(spread))
        return float(total[at]), float(spread[at]), float(self.frequency_hz[at])


def apart_notes(groups: Sequence[tuple[tuple[str, ...], bool]], damping: Sequence[Losses] = ()) -> list[str]:
    """Messages on groups that are not identifiable separately; for damping factors of one field with their total loss factor."""
    notes = []
    for names, left in groups:
        words = f"{', '.join(names[:-1])} and {names[-1]}"
        text = f"{words} cannot be distinguished by these FRFs: only their combination is determined, "
        # Otherwise the data determine the shares weakly, and errors of the model distort them.
        text += "the prior divides it between them" if left else "the share of each rests on the last few per cent of the fit"
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


def at_bounds(P: Parameterisation, scalars: Sequence[Nuisance], theta: Floats, hz: Floats, *, hold: bool) -> list[str]:
    """Notes on factors and damping exponents that end at their bounds, or beyond any joint; ``hold``: the boundary was not identified."""
    found = []
    for scalar, value in zip(scalars, theta[P.size :], strict=True):
        if not scalar.bounds[0] < value < scalar.bounds[1]:
            found.append(
                f"{scalar.name}: at its bound {scalar.effect(value - scalar.mean):.4g}: the measurement does not determine it, or its "
                "start value is too far away (then give one nearer to it)"
            )
    found += [] if hold else [*damping_at_bounds(P, theta), *overdamped(P, theta, hz)]
    return found


def overdamped(P: Parameterisation, theta: Floats, hz: Floats, *, most: float = 1.0) -> list[str]:
    """Notes on groups with a loss factor above ``most`` at lines (F,) [Hz], more than any joint has."""
    found = []
    for group, _, at in P.placed:
        if at is not None and group.damping is not None:
            loss = np.abs(group.damping.loss(2j * np.pi * hz).imag) * 10.0 ** theta[at]
            worst = int(np.argmax(loss))
            if loss[worst] > most:
                found.append(
                    f"{group.name}: a loss factor of {loss[worst]:.2g} at {hz[worst]:.4g} Hz, more than any joint has: the damping "
                    "takes up errors of the model, or these springs hardly affect the FRFs. Check them, and the damping of the structure"
                )
    return found


def damping_at_bounds(P: Parameterisation, theta: Floats, *, near: float = 0.01) -> list[str]:
    """Notes on damping exponents that end within ``near`` [decades] of their bounds: their effect fades towards these."""
    found = []
    for group, _, at in P.placed:
        if at is not None and group.damping is not None:
            low, high = group.damping.bounds
            if not low + near < theta[at] < high - near:
                bound = low if theta[at] - low < high - theta[at] else high
                found.append(f"{group.name}: the damping exponent is at its bound {bound:g}: the FRFs do not determine it")
    return found
