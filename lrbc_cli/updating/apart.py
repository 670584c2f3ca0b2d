"""Which factors a measurement cannot tell apart."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from lrbc_cli.arrays import Floats
from lrbc_cli.updating.priors import CALIBRATION_PRIOR, CalibrationPrior


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


def apart_notes(groups: Sequence[tuple[tuple[str, ...], bool]]) -> list[str]:
    """What to say of them."""
    notes = []
    for names, left in groups:
        words = f"{', '.join(names[:-1])} and {names[-1]}"
        text = f"{words} cannot be told apart by these FRFs: only their combination is determined, "
        # Data without errors of the model would still tell a little.
        notes.append(
            text + ("the prior shares it between them" if left else "what each has of it rests on the last few per cent of the fit")
        )
    return notes
