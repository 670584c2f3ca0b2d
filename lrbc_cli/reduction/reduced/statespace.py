"""The reduced model at given values of its terms as a first-order system, for the time domain (paper, Sec. 2.1), and its poles."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag, cholesky, eig, eigh, eigvalsh, null_space, solve_triangular

from lrbc_cli.arrays import Bools, Complexes, Floats
from lrbc_cli.errors import NumericalError
from lrbc_cli.model.fem import FeModel
from lrbc_cli.reduction.reduced.model import ReducedModel
from lrbc_cli.reduction.reduced.ports import SYMMETRY

#: A mass matrix counts as singular if the smallest singular value of a field is at most this fraction of the largest.
SINGULAR = 1e-12

#: Largest relative difference between FRFs of the explicit and the second-order form; beyond it the descriptor form is tried.
EXPLICIT = 1e-9

#: Largest relative difference of the better of both forms; beyond it there is no usable state space.
USABLE = 1e-6

#: Message about a complex matrix, and its hint.
HYSTERETIC = "a complex {} (hysteretic damping) has no real first-order form: it is valid for harmonic motion only"
VISCOUS = "export without --state-space, or give the model viscous damping (model.damping)"

EXTREME = "use less extreme values; inf clamps exactly"

EPS = float(np.finfo(float).eps)

#: Singular values of the vectors of clamped terms below this fraction of the largest count as zero (dependent constraints).
RANK = 1e-10


#: Real or complex.
Numbers = NDArray[np.inexact[Any]]


@dataclass(frozen=True, kw_only=True)
class StateSpace:
    """First-order system ``E z' = A z + B u, y = C z + D u`` with ``z = [q, q', ...]`` and ``x = basis q``; explicit if E is the identity.

    Attributes
    ----------
    A : (N, N) float array
    B : (N, n_in) float array
    C : (n_out, N) float array
        Rows give each response in its quantity: displacement or pressure, velocity, acceleration.
    D : (n_out, n_in) float array
    E : (N, N) float array or None
        None in the explicit form. In the descriptor form each acceleration response is a further state.
    basis : (r, m) float array
        Maps the coordinates q to the reduced DOFs x; motions that clamped terms prevent are left out.
    deviation : float
        Largest difference from the FRFs of the second-order form on lines of the band, relative to the largest magnitude of each FRF.
    poles : (P,) complex array
        Finite poles [rad/s], the one with the largest real part first; P is at most N.
    errors : (P,) float array
        Possible rounding error of each pole [rad/s].
    """

    A: Floats
    B: Floats
    C: Floats
    D: Floats
    E: Floats | None
    basis: Floats
    deviation: float
    poles: Complexes
    errors: Floats

    @property
    def states(self) -> int:
        """Number of states N."""
        return int(self.A.shape[0])

    @property
    def abscissa(self) -> float:
        """Largest real part of a pole [1/s]; -inf where there is none."""
        return float(self.poles.real.max(initial=-np.inf))

    @property
    def unstable(self) -> int:
        """Number of poles in the right half plane by more than their rounding error; a sealed cavity has poles at zero."""
        return int(np.sum(self.poles.real > self.errors))

    def transfer(self, s: Complexes) -> Complexes:
        """(F, n_out, n_in) transfer matrix C (s E - A)⁻¹ B + D."""
        E = np.eye(self.states) if self.E is None else self.E
        return np.array([self.C @ np.linalg.solve(z * E - self.A, self.B.astype(complex)) + self.D for z in s])


def complex_matrix(model: FeModel | ReducedModel) -> str:
    """Name of the matrix with non-zero imaginary part, ``stiffness`` or ``damping``; empty if both are real."""
    named = (("stiffness", model.K), ("damping", model.C))
    return next((name for name, A in named if np.iscomplexobj(A) and abs(A.imag).max() > 0), "")


def state_space(model: ReducedModel, terms: Floats, band_hz: tuple[float, float]) -> StateSpace:
    """First-order form of the reduced model at given values of the terms.

    ``z = [q, q']`` with ``A = [[0, I], [-M⁻¹K, -M⁻¹C]]``; K, C, M include the terms, eqs. (3)-(5). Damping tied to a stiffness (33) is
    viscous and part of C. Accelerations are ``L x'' = -L M⁻¹ (K x + C x') + L M⁻¹ B u``. Clamped terms are constraints ``cᵀ x = 0``, which
    ``x = basis q`` satisfies.

    Stability of u-p models: with ``p = psi'`` and the acoustic rows divided by s, the mass and stiffness matrices are those of the two
    fields and the coupling is a skew (gyroscopic) damping; the poles are the same. If the matrices of the fields are positive semidefinite,
    the energy never grows. A basis split into fields preserves this, so that no pole lies in the right half plane.

    Parameters
    ----------
    model : ReducedModel
        With real matrices. The result has every response for every input.
    terms : (nt, 3) float array
        Coefficients k, c and m of ``D(s) = k + s c + s² m``; an infinite one clamps.
    band_hz : (float, float)
        Band in which the result is compared with the second-order form [Hz].

    Returns
    -------
    StateSpace

    Raises
    ------
    NumericalError
        If K or C is complex, the model is singular in the band, poles cannot be computed, or the FRFs differ from the second-order form.
    """
    if name := complex_matrix(model):
        expected, found = "real matrices and viscous damping", f"a complex {name} matrix"
        raise NumericalError(HYSTERETIC.format(name), expected=expected, found=found, hint=VISCOUS)
    omega = 2 * np.pi * band_hz[1]
    s = 2j * np.pi * np.linspace(*band_hz, 9)
    try:
        with np.errstate(all="ignore"):
            exact = _second_order(model, terms, s)
    except np.linalg.LinAlgError:
        raise NumericalError("the reduced model is singular in its band", hint="give the model damping (model.damping)") from None
    with np.errstate(all="ignore"):
        basis, second = assembled(model, terms, omega)
    if not all(np.all(np.isfinite(A)) for A in (second.K, second.C, second.M)):
        raise _unusable(np.inf)
    best = _closest(second, basis, s, exact)
    try:
        with np.errstate(all="ignore"):
            poles, errors, _ = poles_of(second, omega)
        return replace(best, poles=poles, errors=errors)
    except np.linalg.LinAlgError as error:
        raise NumericalError(f"the poles of the first-order form cannot be computed ({error})", hint=EXTREME) from error


def _closest(second: ReducedModel, basis: Floats, s: Complexes, exact: Complexes) -> StateSpace:
    """The explicit form if it reproduces the FRFs to ``EXPLICIT``, else the better of explicit and descriptor form."""
    best: StateSpace | None = None
    forms = [_descriptor] if _singular(np.asarray(second.M.real), second.structure) else [_explicit, _descriptor]
    for form in forms:
        with np.errstate(all="ignore"):
            A, B, C, D, E = form(second)
            none = np.zeros(0, dtype=complex)
            system = StateSpace(A=A, B=B, C=C, D=D, E=E, basis=basis, deviation=np.inf, poles=none, errors=np.zeros(0))
            deviation = _deviation(system, s, exact)
        if best is None or deviation < best.deviation:
            best = replace(system, deviation=deviation)
        if deviation <= EXPLICIT:
            break
    assert best is not None
    if not best.deviation <= USABLE:
        raise _unusable(best.deviation)
    return best


def _unusable(deviation: float) -> NumericalError:
    problem = "the first-order form does not reproduce the FRFs of the reduced model"
    return NumericalError(problem, expected=f"a difference of at most {USABLE:.0e}", found=f"{deviation:.1e}", hint=EXTREME)


def assembled(model: ReducedModel, terms: Floats, omega: float) -> tuple[Floats, ReducedModel]:
    """Coordinates in which rounding of stiff terms does not affect the rest, and the model in them with the terms in K, C and M."""
    clamped: Bools = np.any(np.isinf(terms), axis=1)
    kept = terms[~clamped]
    r, ns = model.size, model.structure
    fields = [part for part in (slice(0, ns), slice(ns, r)) if part.start < part.stop]
    # Structure and air keep separate coordinates if no term acts on both.
    apart = not any(np.any(np.any(v[:ns], axis=0) & np.any(v[ns:], axis=0)) for v in (model.left, model.right))
    K0, C0, M0 = (np.asarray(A.real, dtype=float) for A in (model.K, model.C, model.M))
    regular = apart and np.array_equal(model.left, model.right)
    modal = regular and all(_symmetric(A[f, f]) for A in (K0, M0) for f in fields) and all(_positive(M0[f, f]) for f in fields)
    if modal:
        size = np.abs(kept) @ omega ** np.arange(3.0)
        parts = [_modal(K0[f, f], M0[f, f], model.right[f][:, clamped], model.right[f][:, ~clamped], size) for f in fields]
        basis = rows = block_diag(*[part[0] for part in parts])
        left = right = np.vstack([part[1] for part in parts])
    else:
        fields = fields if apart else [slice(0, r)]
        basis, rows = (block_diag(*[_free(v[f][:, clamped]) for f in fields]) for v in (model.right, model.left))
        left, right = rows.T @ model.left[:, ~clamped], basis.T @ model.right[:, ~clamped]
    if rows.shape != basis.shape:
        # Constraint forces act along the left vectors.
        raise NumericalError(
            "the clamped terms do not constrain as many motions as they have constraint forces",
            expected=f"{basis.shape[1]} free motions",
            found=f"{rows.shape[1]}",
        )
    inside = int(np.sum(np.any(basis[:ns] != 0.0, axis=0))) if apart else basis.shape[1]
    K, C, M = (rows.T @ A @ basis + (left * kept[:, i]) @ right.T for i, A in enumerate((K0, C0, M0)))
    if not modal:
        # Equilibrate: displacements and pressures have different units, and pivots must not depend on them.
        row, column = _scales(K, C, M, omega)
        K, C, M = (row[:, None] * A * column for A in (K, C, M))
        rows, basis = rows * row, basis * column
    none = np.zeros((basis.shape[1], 0))
    return basis, replace(model, K=K, C=C, M=M, B=rows.T @ model.B, L=model.L @ basis, left=none, right=none, structure=inside, extras={})


def _modal(K: Floats, M: Floats, clamped: Floats, vectors: Floats, size: Floats) -> tuple[Floats, Floats]:
    """Mass-orthonormal coordinates of one field: (r, m) basis without clamped motions, and the (m, nt) vectors of the terms in them.

    The first coordinates are the modes with all terms clamped, by frequency, on which no term acts. Then, from the stiffest term to the
    softest, follows one motion each on which this term acts and stiffer ones do not. Zeros are exact, so that the rounding of a stiff term
    does not reach the other coordinates.
    """
    G = cholesky(M, lower=True)
    # The mass matrix is the identity for y = Gᵀ x.
    free = _free(solve_triangular(G, clamped, lower=True) if clamped.size else clamped)
    felt = free.T @ solve_triangular(G, vectors, lower=True) if vectors.size else np.zeros((free.shape[1], vectors.shape[1]))
    weight = size * np.sum(felt**2, axis=0)
    order = np.argsort(-weight, kind="stable")
    order = order[np.any(felt != 0.0, axis=0)[order]]
    Q, R = np.linalg.qr(felt[:, order], mode="complete")
    count = min(order.size, Q.shape[0])
    inner = free @ Q[:, count:]
    scaled = solve_triangular(G, solve_triangular(G, K, lower=True).T, lower=True)
    modes = eigh(inner.T @ scaled @ inner)[1] if inner.shape[1] else np.zeros((0, 0))
    basis = solve_triangular(G.T, np.hstack([inner @ modes, free @ Q[:, :count]]), lower=False)
    moved = np.zeros((basis.shape[1], vectors.shape[1]))
    moved[inner.shape[1] :, order] = R[:count]
    return basis, moved


def _free(vectors: Floats) -> Floats:
    """(r, m) orthonormal basis of the space orthogonal to the columns of ``vectors``."""
    norms = np.linalg.norm(vectors, axis=0)
    found = vectors[:, norms > 0.0] / norms[norms > 0.0]
    return np.asarray(null_space(found.T, rcond=RANK)) if found.size else np.eye(vectors.shape[0])


def _symmetric(A: Floats) -> bool:
    return bool(np.abs(A - A.T).max(initial=0.0) <= SYMMETRY * np.abs(A).max(initial=0.0))


def _positive(M: Floats) -> bool:
    values = eigvalsh(M)
    return bool(values[0] > SINGULAR * values[-1])


def _singular(M: Floats, structure: int) -> bool:
    """Whether the mass matrix of a field is singular."""
    for block in (M[:structure, :structure], M[structure:, structure:]):
        if block.size:
            values = np.linalg.svd(block, compute_uv=False)
            if values[-1] <= SINGULAR * values[0]:
                return True
    return False


def _explicit(model: ReducedModel) -> tuple[Floats, Floats, Floats, Floats, None]:
    """A, B, C, D and None for E, with the inverse of the mass matrix."""
    r, q = model.size, model.output_power[:, None]
    # Rows of structure and air differ by many orders of magnitude.
    scale = 1.0 / np.abs(model.M).max(axis=1, keepdims=True)
    solved = np.linalg.solve(scale * model.M, scale * np.hstack([model.K, model.C, model.B]))
    K, C, B = solved[:, :r], solved[:, r : 2 * r], solved[:, 2 * r :]
    none = np.zeros_like(model.L)
    A = np.block([[np.zeros((r, r)), np.eye(r)], [-K, -C]])
    rows = np.where(
        q == 0,
        np.hstack([model.L, none]),
        np.where(q == 1, np.hstack([none, model.L]), np.hstack([-model.L @ K, -model.L @ C])),
    )
    return A, np.vstack([np.zeros_like(B), B]), rows, np.where(q == 2, model.L @ B, 0.0), None


def _descriptor(model: ReducedModel) -> tuple[Floats, Floats, Floats, Floats, Floats]:
    """A, B, C, D and E without an inverse, for a singular or badly conditioned mass matrix."""
    r, n_in = model.size, model.B.shape[1]
    at = np.flatnonzero(model.output_power == 2)
    n, a = 2 * r + at.size, at.size
    A, E = np.zeros((n, n)), np.zeros((n, n))
    A[:r, r : 2 * r] = E[:r, :r] = np.eye(r)
    A[r : 2 * r, :r], A[r : 2 * r, r : 2 * r], E[r : 2 * r, r : 2 * r] = -model.K, -model.C, model.M
    # Each acceleration response is a state a = L q'', since M may be singular.
    A[2 * r :, 2 * r :], E[2 * r :, r : 2 * r] = np.eye(a), model.L[at]
    B = np.vstack([np.zeros((r, n_in)), model.B, np.zeros((a, n_in))])
    C = np.zeros((model.L.shape[0], n))
    for power in (0, 1):
        C[model.output_power == power, power * r : (power + 1) * r] = model.L[model.output_power == power]
    C[at, 2 * r + np.arange(a)] = 1.0
    return A, B, C, np.zeros((model.L.shape[0], n_in)), E


def _second_order(model: ReducedModel, terms: Floats, s: Complexes) -> Complexes:
    """(F, n_out, n_in) FRFs of every response over every input from the reduced dynamic stiffness (28), accurate for stiff terms too."""
    finite = np.where(np.isinf(terms), 0.0, terms)
    D = finite @ s[None, :] ** np.arange(3)[:, None]
    D[np.any(np.isinf(terms), axis=1)] = np.inf
    every = (np.full(model.L.shape[0], column) for column in range(model.B.shape[1]))
    return np.stack([replace(model, input_of=column).evaluate(s, D.T, workers=1) for column in every], axis=2)


def _deviation(system: StateSpace, s: Complexes, exact: Complexes) -> float:
    """Largest difference of an FRF, relative to its largest magnitude; infinite if the system cannot be evaluated."""
    try:
        difference = np.abs(system.transfer(s) - exact).max(axis=0)
    except np.linalg.LinAlgError:
        return float("inf")
    largest = np.abs(exact).max(axis=0)
    worst = float(np.max(difference / np.where(largest > 0.0, largest, 1.0), initial=0.0))
    return worst if np.isfinite(worst) else float("inf")


def _scales(K: Numbers, C: Numbers, M: Numbers, omega: float) -> tuple[Floats, Floats]:
    """(n,) row and (n,) column scales that make the largest entry of each in ``|K| + omega |C| + omega² |M|`` about one.

    Ruiz's iteration: each step divides by the square root of the largest entries. Powers of two cause no rounding.
    """
    size = np.abs(K) + omega * np.abs(C) + omega**2 * np.abs(M)
    row, column = np.ones(size.shape[0]), np.ones(size.shape[1])
    # Twelve steps reduce any ratio of floats to a factor below two.
    for _ in range(12):
        left = row[:, None] * size * column
        across, down = left.max(axis=1, initial=0.0), left.max(axis=0, initial=0.0)
        row, column = (v / np.sqrt(np.where(d > 0.0, d, 1.0)) for v, d in ((row, across), (column, down)))
    return np.exp2(np.round(np.log2(row))), np.exp2(np.round(np.log2(column)))


def poles_of(model: ReducedModel, omega: float) -> tuple[Complexes, Floats, Complexes]:
    """Finite poles [rad/s] by descending real part, their possible rounding errors, and their shapes as columns.

    Stiff terms cause poles of 1e13 rad/s beside those at zero, and eigenvalues of A are uncertain by eps times the largest. The eigenvalues
    ``theta = omega / (lambda - omega)`` of ``omega (A - omega E)⁻¹ E`` do not have this problem: they are about one for poles lambda in the
    band and vanish for poles far above it, so the matrix has size one whatever the terms. ``Z(omega)``, a sum of positive matrices in a
    stable system, is well conditioned after scaling of rows and columns. The error of an eigenvalue is at most its condition number times
    the error of the matrix.
    """
    row, column = _scales(np.asarray(model.K), np.asarray(model.C), np.asarray(model.M), omega)
    K, C, M = (row[:, None] * np.asarray(A) * column for A in (model.K, omega * model.C, omega**2 * model.M))
    r, Z = model.size, K + C + M
    if r == 0:
        return np.zeros(0, dtype=complex), np.zeros(0), np.zeros((0, 0), dtype=complex)
    solved = np.linalg.solve(Z, np.hstack([K, C + M, M]))
    stiffness, rest, mass = solved[:, :r], solved[:, r : 2 * r], solved[:, 2 * r :]
    shifted = np.block([[-rest, -mass], [stiffness, -mass]])
    # Entries far below rounding become zero, so that no exponent overflows when LAPACK balances the matrix.
    shifted[np.abs(shifted) < EPS**2] = 0.0
    if not np.all(np.isfinite(shifted)):
        raise np.linalg.LinAlgError("numbers out of range")
    theta, left, right = eig(shifted, left=True, right=True)
    condition = 1.0 / np.abs(np.sum(left.conj() * right, axis=0))
    # Backward errors of elimination and QR algorithm: eps times the number of unknowns 2 r.
    error = 2 * r * EPS * np.linalg.cond(Z) * np.linalg.norm(shifted, 2) * condition
    # A theta within rounding of zero belongs to a motion without mass, or to a pinned one: its pole is infinite.
    finite = np.abs(theta) > error
    theta, error, shapes = theta[finite], error[finite], column[:, None] * right[:r, finite]
    poles, errors = omega * (1.0 + 1.0 / theta), omega * error / (np.abs(theta) * (np.abs(theta) - error))
    order = np.argsort(-poles.real, kind="stable")
    return np.asarray(poles[order]), np.asarray(errors[order]), np.asarray(shapes[:, order])
