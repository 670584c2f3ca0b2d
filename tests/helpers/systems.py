"""Small systems with known blocks, and their FRFs by dense solves that share no formula with the program."""

from __future__ import annotations

import numpy as np
import scipy.linalg as la
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from lrbc_cli.model.fem import FeModel, proportional_damping
from lrbc_cli.model.terms import LowRankTerms
from lrbc_cli.reduction.reduced.model import ReducedModel
from lrbc_cli.reduction.reduced.ports import PortFrf, port_frf


def csc(matrix) -> sp.csc_array:
    """Canonical csc_array."""
    out = sp.csc_array(matrix)
    out.eliminate_zeros()
    out.sort_indices()
    return out


def chain(n: int, stiffness: float = 2e5, mass: float = 0.05, *, grounded: bool = True) -> tuple[sp.csc_array, sp.csc_array]:
    """K and M of masses in a row; free-free where not grounded."""
    diagonal = np.full(n, 2.0)
    diagonal[-1] = 1.0
    diagonal[0] = 2.0 if grounded else 1.0
    K = stiffness * sp.diags_array([diagonal, -np.ones(n - 1), -np.ones(n - 1)], offsets=[0, 1, -1])
    # Unlike masses, so that no two modes coincide.
    return csc(K), csc(sp.diags_array(mass * (1.0 + 0.3 * np.sin(np.arange(n)))))


def beam_element(h: float, bending: float, line_mass: float) -> tuple[np.ndarray, np.ndarray]:
    """Stiffness and consistent mass of an Euler-Bernoulli beam: deflection and slope at both ends."""
    bend = [[12, 6 * h, -12, 6 * h], [6 * h, 4 * h**2, -6 * h, 2 * h**2], [-12, -6 * h, 12, -6 * h], [6 * h, 2 * h**2, -6 * h, 4 * h**2]]
    mass = [
        [156, 22 * h, 54, -13 * h],
        [22 * h, 4 * h**2, 13 * h, -3 * h**2],
        [54, 13 * h, 156, -22 * h],
        [-13 * h, -3 * h**2, -22 * h, 4 * h**2],
    ]
    return bending / h**3 * np.array(bend), line_mass * h / 420 * np.array(mass)


def beam(elements: int, length: float = 1.0, bending: float = 60.0, line_mass: float = 0.8) -> tuple[sp.csc_array, sp.csc_array]:
    """Euler-Bernoulli beam, pinned at both ends: DOFs are rotations and deflections, rotation of the left end first.

    DOF order: rot_0, w_1, rot_1, ..., w_(N-1), rot_(N-1), rot_N.
    """
    k, m = beam_element(length / elements, bending, line_mass)
    size = 2 * (elements + 1)
    K, M = np.zeros((size, size)), np.zeros((size, size))
    for e in range(elements):
        at = slice(2 * e, 2 * e + 4)
        K[at, at] += k
        M[at, at] += m
    keep = np.delete(np.arange(size), [0, 2 * elements])
    return csc(K[np.ix_(keep, keep)]), csc(M[np.ix_(keep, keep)])


def duct(
    ns: int, na: int, kappa: float = 1.3, *, coupling: float = 0.02, stiffness: float = 4e4
) -> tuple[sp.csc_array, sp.csc_array, np.ndarray]:
    """u-p model: a chain of masses on the flank of a duct of air; K_sa = -A, M_as = kappa Aᵀ. Returns K, M, is_acoustic."""
    Ks, Ms = chain(ns, stiffness, 0.02)
    h, rho, c = 2.0 / na, 1.2, 340.0
    diagonal = np.full(na, 2.0)
    diagonal[[0, -1]] = 1.0
    Ka = sp.diags_array([diagonal, -np.ones(na - 1), -np.ones(na - 1)], offsets=[0, 1, -1]) * (1 / (rho * h))
    consistent = sp.diags_array([2 * diagonal, np.ones(na - 1), np.ones(na - 1)], offsets=[0, 1, -1])
    Ma = consistent * (h / (6 * rho * c**2))
    # Each mass feels the pressures beside it.
    A = np.zeros((ns, na))
    for i in range(ns):
        at = i * (na - 2) // ns
        A[i, at : at + 3] = coupling * np.array([0.2, 0.6, 0.2]) * (1 + 0.1 * i)
    scale = kappa  # with M_as = kappa Aᵀ the acoustic rows carry 1/kappa of their own energy
    K = sp.block_array([[Ks, -A], [None, Ka * scale]])
    M = sp.block_array([[Ms, None], [kappa * A.T, Ma * scale]])
    return csc(K), csc(M), np.arange(ns + na) >= ns


def grid(*shape: int) -> sp.csr_array:
    """Laplacian of a 2-D or 3-D grid, shifted to be regular."""
    K = sp.csr_array((1, 1))
    for count in shape:
        line = sp.diags_array([np.full(count, 2.0), -np.ones(count - 1), -np.ones(count - 1)], offsets=[0, 1, -1])
        K = sp.kron(sp.eye_array(K.shape[0]), line) + sp.kron(K, sp.eye_array(count))
    out = sp.csr_array(K + 0.1 * sp.eye_array(K.shape[0]))
    out.eliminate_zeros()
    return out


def random_vectors(n: int, count: int, rng: np.random.Generator, entries: int = 3) -> sp.csc_array:
    """Sparse columns with a few random entries."""
    columns = np.zeros((n, count))
    for j in range(count):
        columns[rng.choice(n, size=min(entries, n), replace=False), j] = rng.normal(size=min(entries, n))
    return csc(columns)


def unit(n: int, *dofs: int) -> sp.csc_array:
    """Unit columns."""
    return csc(np.eye(n)[:, list(dofs)])


def fe_model(
    K,
    M,
    *,
    loads: sp.csc_array,
    outputs: sp.csc_array,
    left: sp.csc_array,
    right: sp.csc_array | None = None,
    power=0,
    baseline=0.0,
    C=None,
    damping: tuple[float, float] = (0.0, 0.0),
    acoustic_damping: tuple[float, float] | None = None,
    is_acoustic=None,
    output_power=0,
) -> FeModel:
    """A model from the pieces that a test cares for; outputs are given as columns."""
    n = K.shape[0]
    is_acoustic = np.zeros(n, dtype=bool) if is_acoustic is None else is_acoustic
    if C is None:
        C = proportional_damping(K, M, is_acoustic, damping, acoustic_damping or damping)
    terms = LowRankTerms(
        left=csc(left),
        right=csc(left if right is None else right),
        power=np.broadcast_to(np.asarray(power, dtype=np.int64), (left.shape[1],)).copy(),
        baseline=np.broadcast_to(np.asarray(baseline, dtype=float), (left.shape[1],)).copy(),
    )
    q = np.broadcast_to(np.asarray(output_power, dtype=np.int64), (outputs.shape[1],)).copy()
    return FeModel(K=csc(K), C=csc(C), M=csc(M), B=csc(loads), L=csc(outputs.T), output_power=q, is_acoustic=is_acoustic, terms=terms)


def whole(model: FeModel, **other) -> ReducedModel:
    """The model as its own reduced model; with other values of some fields."""
    fields = {name: getattr(model, name).toarray() for name in "KCMBL"}
    fields |= {"left": model.terms.left.toarray(), "right": model.terms.right.toarray(), "output_power": model.output_power}
    fields |= {"input_of": np.zeros(model.L.shape[0], dtype=np.int64), "reference": np.zeros((model.terms.size, 3))}
    return ReducedModel(**{**fields, "structure": int((~model.is_acoustic).sum()), **other})


def direct_frf(model: FeModel, s: np.ndarray, D: np.ndarray, input_of: np.ndarray | None = None) -> np.ndarray:
    """(F, R) FRFs of the full model by one dense solve a line, the terms assembled into the matrices.

    Values that dwarf the rest enter with their force as an unknown, ``-x·c + u/D = 0``, so that infinite ones clamp exactly.
    """
    input_of = np.zeros(model.L.shape[0], dtype=int) if input_of is None else input_of
    K, C, M, B, L = (X.toarray() for X in (model.K, model.C, model.M, model.B, model.L))
    b, c = model.terms.left.toarray(), model.terms.right.toarray()
    n, y = model.size, np.empty((s.size, model.L.shape[0]), dtype=complex)
    for line, z in enumerate(s):
        Z = z**2 * M + z * C + K
        stiff = np.abs(D[line]) > 10 * np.abs(Z).max()
        soft = ~stiff
        Z = Z + (b[:, soft] * D[line, soft]) @ c[:, soft].T
        extra = int(stiff.sum())
        A = np.zeros((n + extra, n + extra), dtype=complex)
        A[:n, :n], A[:n, n:], A[n:, :n] = Z, b[:, stiff], -c[:, stiff].T
        big = D[line, stiff]
        A[n:, n:] = np.diag(np.where(np.isinf(big), 0.0, 1.0 / np.where(np.isinf(big), 1.0, big)))
        d = 1 / np.sqrt(np.maximum(np.abs(A).max(axis=1), 1e-300))
        rhs = np.vstack([B, np.zeros((extra, B.shape[1]))])
        x = d[:, None] * np.linalg.solve(d[:, None] * A * d, d[:, None] * rhs)
        y[line] = (L @ x[:n])[np.arange(L.shape[0]), input_of] * z**model.output_power
    return y


def sparse_frf(model: FeModel, s: np.ndarray, D: np.ndarray, input_of: np.ndarray | None = None) -> np.ndarray:
    """The same as ``direct_frf`` by SciPy's sparse LU, every term with its force as an unknown: for some thousand DOFs and many terms."""
    input_of = np.zeros(model.L.shape[0], dtype=int) if input_of is None else input_of
    n, nt = model.size, model.terms.size
    y = np.empty((s.size, model.L.shape[0]), dtype=complex)
    B = np.vstack([model.B.toarray(), np.zeros((nt, model.B.shape[1]))])
    for line, z in enumerate(s):
        Z = z**2 * model.M + z * model.C + model.K
        size = float(np.abs(Z.diagonal()).max())
        stiff = np.abs(D[line]) > size
        # Force of a soft term u = D cᵀ x, of a stiff one cᵀ x = u/D; forces in units of the structure's stiffness.
        inverse = np.where(np.isinf(D[line]), 0.0, size / np.where(stiff & np.isfinite(D[line]), D[line], 1.0))
        left = size * model.terms.left
        right = sp.diags_array(np.where(stiff, -1.0, -np.where(stiff, 0.0, D[line]) / size)) @ model.terms.right.T
        A = sp.block_array([[Z, left], [right, sp.diags_array(np.where(stiff, inverse, 1.0))]]).tocsc()
        x = splu(A).solve(B.astype(complex))[:n]
        y[line] = (model.L @ x)[np.arange(model.L.shape[0]), input_of] * z**model.output_power
    return y


def relative(found: np.ndarray, expected: np.ndarray) -> float:
    """Largest error of a line relative to its norm over the responses."""
    return float(np.max(np.linalg.norm(found - expected, axis=1) / np.linalg.norm(expected, axis=1)))


def resonances_hz(K, M) -> np.ndarray:
    """Undamped natural frequencies of a (possibly unsymmetric) small model."""
    w2 = la.eigvals(np.asarray(K.todense()).real, np.asarray(M.todense()))
    w2 = np.sort(w2[np.isfinite(w2)].real)
    return np.sqrt(np.maximum(w2, 0.0)) / (2 * np.pi)


def dense_ports(model: FeModel, s: np.ndarray, reference: np.ndarray | None = None, input_of: np.ndarray | None = None) -> PortFrf:
    """Port FRFs by dense solves about the reference values k + s c + s² m, (nt, 3)."""
    nt = model.terms.size
    reference = np.zeros((nt, 3)) if reference is None else reference
    input_of = np.zeros(model.L.shape[0], dtype=int) if input_of is None else input_of
    D_ref = reference[:, 0] + s[:, None] * reference[:, 1] + s[:, None] ** 2 * reference[:, 2]
    K, C, M, b, c = (X.toarray() for X in (model.K, model.C, model.M, model.terms.left, model.terms.right))
    outputs, inputs = model.outputs.toarray(), model.inputs.toarray()
    H = [outputs @ np.linalg.solve(z**2 * M + z * C + K + (b * D) @ c.T, inputs) for z, D in zip(s, D_ref, strict=True)]
    return port_frf(np.array(H), s, D_ref, model.output_power, input_of)
