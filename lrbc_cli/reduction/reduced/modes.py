"""Modes of the reduced model at given values of its terms (frequencies, damping, shapes), and the MAC between two states."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from lrbc_cli.arrays import Complexes, Floats
from lrbc_cli.errors import NumericalError
from lrbc_cli.reduction.reduced.model import ReducedModel
from lrbc_cli.reduction.reduced.statespace import assembled, poles_of

#: Poles whose possible rounding error exceeds this fraction are left out.
SURE = 1e-5

#: Coupling blocks count as those of a u-p system, M_as = -kappa K_saᵀ, up to this relative difference.
COUPLED = 1e-6

#: Two modes of different states are paired if their MAC is at least this.
ALIKE = 0.5


@dataclass(frozen=True)
class Modes:
    """Modes of one state in ascending order of frequency.

    Attributes
    ----------
    poles : (m,) complex array
        Poles in the upper half plane [rad/s].
    shapes : (r, m) complex array
        Mode shapes in reduced DOFs, as columns.
    """

    poles: Complexes
    shapes: Complexes

    @property
    def frequency_hz(self) -> Floats:
        """(m,) natural frequencies |pole| / 2 pi [Hz]; with proportional damping those of the undamped system."""
        return np.asarray(np.abs(self.poles) / (2.0 * np.pi))

    @property
    def damping_ratio(self) -> Floats:
        """(m,) damping ratio zeta; half the loss factor."""
        return np.asarray(-self.poles.real / np.abs(self.poles))


def modes_of(model: ReducedModel, terms: Complexes | Floats, band_hz: tuple[float, float]) -> Modes:
    """Modes in a band, from the quadratic eigenvalue problem ``(s² M + s C + K) x = 0`` with the terms included in K, C and M.

    Parameters
    ----------
    model : ReducedModel
    terms : (nt, 3) array
        Coefficients k, c and m of ``D(s) = k + s c + s² m``; complex with hysteretic damping.
    band_hz : (float, float)
        Band for which the model was reduced [Hz].

    Raises
    ------
    NumericalError
        If the eigenvalues cannot be computed.
    """
    omega = 2.0 * np.pi * band_hz[1]
    try:
        with np.errstate(all="ignore"):
            if any(np.iscomplexobj(A) for A in (model.K, model.C, terms)):
                K, C, M = (A + (model.left * terms[:, q]) @ model.right.T for q, A in enumerate((model.K, model.C, model.M)))
                basis, second = np.eye(model.size), replace(model, K=K, C=C, M=M)
            else:
                basis, second = assembled(model, np.asarray(terms), omega)
            poles, errors, shapes = poles_of(second, omega)
    except np.linalg.LinAlgError as error:
        raise NumericalError(f"the natural frequencies of the reduced model cannot be computed ({error})") from error
    hz = np.abs(poles) / (2.0 * np.pi)
    kept = np.flatnonzero((poles.imag > 0) & (hz >= band_hz[0]) & (hz <= band_hz[1]) & (errors <= SURE * np.abs(poles)))
    kept = kept[np.argsort(hz[kept], kind="stable")]
    return Modes(np.asarray(poles[kept]), np.asarray(basis @ shapes[:, kept]))


def mac(model: ReducedModel, a: Modes, b: Modes) -> Floats:
    """(m_a, m_b) modal assurance criterion between the modes of two states, weighted by kinetic energy over the whole model.

    With ``M_as = -kappa K_saᵀ`` the energies of structure and air are ``omega² uᴴ M_s u`` and ``pᴴ K_a p / (kappa omega²)``; undamped
    modes of one state are orthogonal in their sum. Pressures are left out if the coupling is not of this form. Products of reduced shapes
    with reduced matrices equal those of the expanded shapes with the full matrices.
    """
    ns = model.structure
    K, M = np.asarray(model.K), np.asarray(model.M)
    towards, back = K[:ns, ns:].real, -M[ns:, :ns].T
    size = float(np.sum(towards**2))
    kappa = float(np.sum(towards * back)) / size if size else 0.0
    coupled = kappa > 0 and float(np.linalg.norm(back - kappa * towards)) <= COUPLED * float(np.linalg.norm(back))

    def product(left: Modes, right: Modes) -> Complexes:
        omega = np.outer(np.abs(left.poles), np.abs(right.poles))
        found = omega * (left.shapes[:ns].conj().T @ M[:ns, :ns] @ right.shapes[:ns])
        if coupled or not ns:
            found = found + left.shapes[ns:].conj().T @ K[ns:, ns:].real @ right.shapes[ns:] / (omega * (kappa or 1.0))
        return np.asarray(found)

    own = np.outer(np.diag(product(a, a)).real, np.diag(product(b, b)).real)
    return np.asarray(np.abs(product(a, b)) ** 2 / np.where(own > 0, own, np.inf))


def paired(likeness: Floats) -> list[tuple[int | None, int | None]]:
    """Pair the modes of two states one to one by their MAC; a mode without a counterpart is paired with None.

    Parameters
    ----------
    likeness : (m_a, m_b) float array
        From ``mac``.

    Returns
    -------
    list of pairs of int or None
    """
    # Imported here, since most commands do not need it.
    from scipy.optimize import linear_sum_assignment

    rows, columns = linear_sum_assignment(-likeness)
    pairs: list[tuple[int | None, int | None]] = [(int(a), int(b)) for a, b in zip(rows, columns, strict=True) if likeness[a, b] >= ALIKE]
    first, second = {a for a, _ in pairs}, {b for _, b in pairs}
    pairs += [(a, None) for a in range(likeness.shape[0]) if a not in first]
    pairs += [(None, b) for b in range(likeness.shape[1]) if b not in second]
    return pairs
