"""Predicts memory and time of a reduction for `lrbc check`, from the fill and operations of its factors, without a factorisation.

Pattern, ordering and analysis are those of the reduction itself. Memory is the sum of its large arrays: operators on the union pattern,
factors, snapshots (solutions) of one expansion point, the basis, and the lines of the error estimate.
"""

from __future__ import annotations

from dataclasses import dataclass
from timeit import repeat

import numpy as np

from lrbc_cli.model.fem import FeModel
from lrbc_cli.reduction.outcome import ReductionOptions
from lrbc_cli.reduction.problem.basis import SKETCH
from lrbc_cli.reduction.problem.problem import Problem
from lrbc_cli.reduction.solve.dynamic import Analysis, columns_at_once
from lrbc_cli.reduction.steps.estimate import GRID_LINES, grid_lines
from lrbc_cli.reduction.steps.full_lines import COMBINATIONS, SIDE_BY_SIDE_BYTES, moments_worth
from lrbc_cli.reduction.threads import cores, single_threaded

COMPLEX, REAL = 16, 8

#: Bytes for each entry of the union pattern: K, C and M twice, their values on the pattern, its indices, and memory that the allocator
#: keeps. Measured on models of 10 000 to 90 000 DOFs; real and complex matrices differ by less than the two solvers do.
PATTERN_BYTES = {"superlu": 150, "pardiso": 120}

#: Bytes for each entry of SuperLU's factors: its value, its share of the row subscripts, and the reserve by which the arrays grow.
SUPERLU_BYTES = 18.6

#: Copies of the snapshots of one expansion point while they are orthogonalised, and of the right-hand sides that are solved together.
SNAPSHOT_COPIES, SOLVE_COPIES = 5, 5

#: Arrays as large as the basis: the basis, and temporarily the new directions with their images.
BASIS_ARRAYS = 2

#: Reduced DOFs for each input and each dual right-hand side: 3.3 to 4.5 on all sample models, if the band has no more modes than the
#: model has terms and responses. Each further mode adds about one DOF; ``max_size`` is the limit.
SIZE_RELATION = 4

#: Copies of the largest arrays of the error estimate: of its sketches, and of the port FRFs at its lines, with those in a few states.
ESTIMATE_COPIES, PORT_COPIES = 3, 8

#: Bytes of libraries and thread buffers that only a reduction loads.
LIBRARIES = 60e6

#: Expansion points beside the held-out lines.
POINTS = 4

#: Reduced DOFs for each input and each dual right-hand side, mean over the passes of the error estimate: the first has two, the last two
#: about four and, compressed, two.
SIZE_SWEPT = 2.6

#: Speed relative to that of a dense matrix product: (factorisation, solve of many right-hand sides) by solver, and orthogonalisation.
EFFICIENCY = {"superlu": (0.5, 0.1), "pardiso": (0.5, 0.15)}
ORTHOGONALISATION = 0.2


@dataclass(frozen=True, kw_only=True)
class Cost:
    """Predicted memory and time of a reduction.

    Attributes
    ----------
    memory : dict
        Bytes needed in addition to those after reading the model, by purpose.
    work : float
        Operations, weighted by how much slower each step is than a dense product; the same on every machine.
    line : float
        The same for one line of the full model with all right-hand sides.
    seconds : float
        Time of ``work`` at the speed of a dense product in one thread, measured now.
    nonzeros : int
        Entries of the factors.
    backend : str
    """

    memory: dict[str, float]
    work: float
    line: float
    seconds: float
    nonzeros: int
    backend: str

    @property
    def additional(self) -> float:
        """Sum of ``memory`` [bytes]."""
        return sum(self.memory.values())


def memory_bound(model: FeModel) -> float:
    """Quick bound [bytes] that a reduction hardly exceeds, without an ordering: twice the fill of a regular three-dimensional mesh.

    The fill of such a mesh after nested dissection grows as n^(4/3) (George 1973); the constant is that of a cube of quadratic tetrahedra.
    """
    n = model.size
    entries = model.K.nnz + model.M.nnz
    fill = 2 * 18e6 * (n / 21_000) ** (4 / 3) * max(entries / n / 62.0, 0.2)
    columns = model.inputs.shape[1] + model.outputs.shape[0]
    arrays = 2 * SNAPSHOT_COPIES * COMPLEX * n * columns + BASIS_ARRAYS * REAL * n * min(SIZE_RELATION * columns, n)
    pattern = 2 * PATTERN_BYTES["superlu"] * entries
    return float(SUPERLU_BYTES * min(fill, float(n) ** 2) + pattern + arrays + _estimate_bytes(model, GRID_LINES) + LIBRARIES)


def predict(model: FeModel, options: ReductionOptions, *, backend: str = "auto") -> Cost:
    """Order and analyse the dynamic stiffness, and predict memory and time of its reduction.

    Parameters
    ----------
    model : FeModel
    options : ReductionOptions
    backend : str
        As in ``reduce_model``.

    Returns
    -------
    Cost

    Raises
    ------
    ConfigError
        If ``backend`` is ``pardiso`` and it is not installed.
    NumericalError
        If the analysis of PARDISO fails.
    """
    # Which input a response belongs to has no effect on the cost.
    problem = Problem.of(model, np.zeros(model.L.shape[0], dtype=np.int64), options, backend=backend)
    n, Z, analysis, backend = model.size, problem.Z, problem.Z.analyse(), problem.Z.backend
    inputs = problem.inputs.shape[1]
    columns = inputs + problem.dual.shape[1]
    moments = moments_worth(problem, analysis)
    size = n if problem.is_small else min(SIZE_RELATION * columns, options.max_size or n, n)
    # Two lines solved at the same time need two factors.
    width = 2 if backend == "superlu" and cores() > 1 and COMPLEX * analysis.nonzeros <= SIDE_BY_SIDE_BYTES else 1
    factors = float(analysis.bytes or width * SUPERLU_BYTES * analysis.nonzeros)
    snapshots = float(COMPLEX * n * columns * moments)
    together = columns_at_once(n)
    solving = width * (snapshots + SOLVE_COPIES * COMPLEX * n * min(together, columns))
    # Large factors are released before their solutions are orthogonalised.
    released = COMPLEX * analysis.nonzeros > SIDE_BY_SIDE_BYTES
    arrays = SNAPSHOT_COPIES * snapshots
    memory = {
        "operators": float(PATTERN_BYTES[backend] * Z.entries),
        "factors": factors,
        "snapshots": max(solving, arrays - factors) if released else max(solving, arrays),
        # With two fields the basis is block diagonal: each column fills one field only.
        "basis": BASIS_ARRAYS * REAL * size * float(n if not model.is_acoustic.any() or model.is_acoustic.all() else 0.5 * n),
        "estimate": _estimate_bytes(model, grid_lines(model.terms.size, options.held_out)),
        "libraries": LIBRARIES,
    }
    work, line = _work(problem, analysis, size)
    return Cost(memory=memory, work=work, line=line, seconds=work / _product_rate(), nonzeros=analysis.nonzeros, backend=backend)


def _work(problem: Problem, analysis: Analysis, size: int) -> tuple[float, float]:
    """``work`` and ``line`` of ``Cost``, with ``size`` DOFs of the reduced model."""
    n, inputs, options, terms = problem.model.size, problem.inputs.shape[1], problem.options, problem.model.terms.size
    columns, moments = inputs + problem.dual.shape[1], moments_worth(problem, analysis)
    factor, solve = EFFICIENCY[problem.Z.backend]
    # A complex multiplication and addition is eight operations of reals; LU takes two triangles.
    line = (4 if problem.Z.half else 8) * analysis.operations / factor
    solved = 8 * 2 * analysis.triangle * inputs / solve
    more = solved * (columns * moments / inputs - 1)
    lines = grid_lines(terms, options.held_out)
    if problem.is_small:
        # Kept whole, it is evaluated once on the lines of the estimate, and not expanded.
        rest = 8 * lines * (n**3 / 3 + n**2 * columns) / factor
    else:
        # With very many inputs only the first point is expanded for all of them.
        further = COMBINATIONS + columns - terms if problem.many else columns
        new = 2 * moments * (columns + (POINTS - 1) * further) / POINTS
        orthogonalised = 2 * n * new * (new + 2 * size) / ORTHOGONALISATION
        swept = min(2 * columns + COMBINATIONS if problem.many else SIZE_SWEPT * columns, size)
        reduced = 8 * lines * (swept**3 / 3 + (swept**2 + 2 * SKETCH * swept) * columns) / ORTHOGONALISATION
        rest = POINTS * (line + solved + more + orthogonalised + reduced)
    return float(options.held_out * (line + solved) + rest), float(line + solved + more)


def _estimate_bytes(model: FeModel, lines: int) -> float:
    fields = 2 if model.is_acoustic.any() and not model.is_acoustic.all() else 1
    ports = model.inputs.shape[1] * model.outputs.shape[0]
    return float(COMPLEX * lines * (ESTIMATE_COPIES * fields * SKETCH * model.inputs.shape[1] + PORT_COPIES * ports))


def _product_rate() -> float:
    """Operations per second of a dense complex product on this machine in one thread, the best of five.

    One thread, because on busy or shared cores the threads of so short a product wait for each other and are up to a hundred times slower,
    which says nothing about a reduction.
    """
    A = np.full((256, 256), 0.5 + 0.5j)
    with single_threaded():
        return float(8 * A.shape[0] ** 3 / min(repeat(lambda: A @ A, number=1, repeat=5)))
