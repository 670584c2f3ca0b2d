"""Models that break reductions: the certificate holds, or it says that it does not; never one that lies."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse as sp
from systems import (
    beam,
    chain,
    csc,
    dense_ports,
    direct_frf,
    duct,
    fe_model,
    grid,
    random_vectors,
    relative,
    resonances_hz,
    sparse_frf,
    unit,
)

from lrbc_cli.errors import NumericalError
from lrbc_cli.reduction.build import FIRST_POINTS, Reduction, ReductionOptions, reduce_model
from lrbc_cli.reduction.problem.norms import SILENT
from lrbc_cli.reduction.problem.vectors import local_scale
from lrbc_cli.reduction.reduced.model import reference_dynamic
from lrbc_cli.reduction.solve import pardiso

BAND = (10.0, 400.0)
BACKENDS = ["superlu", *(["pardiso"] if pardiso.library() else [])]


def true_error(model, reduction: Reduction, input_of, *, direct=direct_frf, lines=10, limit=np.inf, seed=5) -> float:
    """Worst error of y as it is certified (each quantity by its norm at the line), against solves of the full model.

    Random lines outside the basis; values of the terms from 0 to 1e9 and, where ``limit`` is infinite, clamped: alike, log-uniform, and
    each term either free or stiff.
    """
    rng = np.random.default_rng(seed)
    s = 2j * np.pi * rng.uniform(*reduction.options.band_hz, size=lines)
    nt = model.terms.size
    values = [np.zeros(nt), *(np.full(nt, 10.0**p) for p in (0, 3, 6, 9)), np.full(nt, limit)]
    values += [10.0 ** rng.uniform(-3, 9, size=nt) for _ in range(4)]
    values += [np.where(rng.uniform(size=nt) < 0.5, 0.0, min(limit, 1e9)) for _ in range(2)]
    if np.any(model.terms.power):
        # Masses and dashpots beyond what the structure itself has are out of the question.
        values = [np.minimum(v, np.where(model.terms.power == 2, 1e2, np.where(model.terms.power == 1, 1e5, np.inf))) for v in values]
    ports = reduction.model.ports(s)
    acoustic = np.asarray(abs(model.L) @ model.is_acoustic.astype(float)) > 0
    key = np.where(acoustic, -1, model.output_power)
    power = s[:, None] ** model.terms.power
    floor = np.abs(direct(model, s, reference_dynamic(reduction.model.reference, s), input_of))
    worst = 0.0
    for value in values:
        base = model.terms.baseline
        D = np.where(np.isinf(value), np.inf, (np.where(np.isinf(value), 0.0, value) - base) * power)
        y, exact = ports.evaluate(D), direct(model, s, D, input_of)
        assert np.all(np.isfinite(y))
        for quantity in np.unique(key):
            group = key == quantity
            norm = np.maximum(np.linalg.norm(exact[:, group], axis=1), SILENT * np.linalg.norm(floor[:, group], axis=1))
            error = np.linalg.norm((y - exact)[:, group], axis=1)
            # Where nothing answers at all nothing may be invented.
            assert np.all(error[norm == 0] <= 1e-9 * max(np.abs(floor).max(), 1.0 / np.abs(model.K.diagonal()).max()))
            worst = max(worst, float(np.max(error[norm > 0] / norm[norm > 0], initial=0.0)))
    return worst


def judged(model, *, band=BAND, tolerance=1e-3, backend="auto", input_of=None, **checks) -> Reduction:
    """Reduce; where the certificate claims the tolerance, full solves confirm it, up to its own bound for lines that were not solved."""
    input_of = np.zeros(model.L.shape[0], dtype=np.int64) if input_of is None else np.asarray(input_of)
    reduction = reduce_model(model, input_of, ReductionOptions(band_hz=band, tolerance=tolerance), backend=backend)
    assert reduction.reached == (reduction.worst <= tolerance)
    if reduction.reached:
        assert true_error(model, reduction, input_of, **checks) <= np.fmax(tolerance, reduction.unseen)
    return reduction


def string(n=80, **more):
    """A beam with modes all over the band."""
    K, M = beam(n, bending=15.0)
    m = K.shape[0]
    pieces = {"loads": unit(m, 21), "outputs": unit(m, 51, 103, 131), "left": unit(m, 0, 60, m - 1), "damping": (4.0, 2e-6)}
    return K, M, pieces | more


def side_by_side(first, second):
    """Block-diagonal operators of two parts that do not touch."""
    return csc(sp.block_diag([first[0], second[0]])), csc(sp.block_diag([first[1], second[1]]))


def band_with_first_point_at(frequency: float, low: float = 10.0) -> tuple[float, float]:
    """A band whose first expansion point is the given frequency."""
    share = 0.5 - 0.5 * np.cos(0.5 * np.pi / FIRST_POINTS)
    band = low, low + (frequency - low) / share
    assert np.isclose(band[0] + share * (band[1] - band[0]), frequency, rtol=1e-14)
    return band


class TestResonantExpansionPoint:
    """The first point falls on a natural frequency of an undamped model."""

    @pytest.mark.parametrize("backend", BACKENDS)
    @pytest.mark.parametrize("mode", [1, 4])
    def test_of_the_free_model(self, backend, mode):
        """The base system has its terms at their reference: it is not singular there."""
        K, M, pieces = string(damping=(0.0, 0.0))
        band = band_with_first_point_at(float(resonances_hz(K, M)[mode]))
        reduction = judged(fe_model(K, M, **pieces), band=band, backend=backend)
        assert reduction.reached

    @pytest.mark.parametrize("backend", BACKENDS)
    def test_of_a_part_that_no_term_damps(self, backend):
        """The base system itself is singular at the point: answered truly, or refused with a message that says where."""
        K, M = side_by_side(beam(60, bending=15.0), beam(45, length=0.8, bending=12.0))
        n, first = K.shape[0], beam(60, bending=15.0)[0].shape[0]
        second = beam(45, length=0.8, bending=12.0)
        band = band_with_first_point_at(float(resonances_hz(*second)[3]))
        # Both parts are heard, only the first one has terms.
        model = fe_model(
            K, M, loads=csc(unit(n, 21) + unit(n, first + 20)), outputs=unit(n, 51, first + 31, first + 60), left=unit(n, 0, first - 1)
        )
        refusal = None
        try:
            judged(model, band=band, backend=backend)
        except NumericalError as error:
            refusal = error
        if refusal is not None:
            assert "singular at" in refusal.message
            assert refusal.hint


class TestUndamped:
    @pytest.mark.parametrize("backend", BACKENDS)
    def test_real_model_with_resonances_in_the_band(self, backend):
        K, M, pieces = string(damping=(0.0, 0.0))
        assert judged(fe_model(K, M, **pieces), backend=backend, lines=25).reached

    def test_no_term_near_the_loaded_part(self):
        """Real H on the whole band: no term, no damping."""
        K, M = side_by_side(beam(60, bending=15.0), chain(30))
        n = K.shape[0]
        left = unit(n, n - 5)
        judged(fe_model(K, M, loads=unit(n, 21), outputs=unit(n, 51, 81), left=left))

    def test_coupled_air_without_damping(self):
        K, M, acoustic = duct(40, 110, 1.2, coupling=0.05, stiffness=6e5)
        n = acoustic.size
        model = fe_model(
            K, M, loads=unit(n, 11), outputs=unit(n, 30, 60, 149), left=unit(n, 0, 39), is_acoustic=acoustic, output_power=[2, 0, 0]
        )
        judged(model)


class TestRigidBodies:
    @pytest.mark.parametrize("low", [1e-3, 0.5, 10.0])
    @pytest.mark.parametrize("backend", BACKENDS)
    def test_free_free_chain(self, low, backend):
        K, M = chain(150, 6e6, 0.05, grounded=False)
        model = fe_model(K, M, loads=unit(150, 3), outputs=unit(150, 20, 60, 100), left=unit(150, 0, 149), damping=(3.0, 1e-6))
        assert judged(model, band=(low, 400.0), backend=backend).reached

    @pytest.mark.parametrize("low", [1e-3, 10.0])
    def test_two_free_parts_that_a_term_joins(self, low):
        K, M = side_by_side(chain(80, 6e6, grounded=False), chain(70, 5e6, grounded=False))
        joint = unit(150, 79) - unit(150, 80)
        model = fe_model(K, M, loads=unit(150, 3), outputs=unit(150, 40, 100), left=joint, damping=(3.0, 1e-6))
        assert judged(model, band=(low, 400.0)).reached

    @pytest.mark.parametrize("low", [1e-3, 0.5, 10.0])
    @pytest.mark.parametrize("backend", BACKENDS)
    def test_cavity_with_rigid_walls(self, low, backend):
        """Constant pressure is in the kernel of K, and the term is the only stiffness against it."""
        K, M, _ = duct(2, 160)
        model = fe_model(
            csc(K[2:][:, 2:]), csc(M[2:][:, 2:]), loads=unit(160, 5), outputs=unit(160, 60, 159), left=1e-3 * unit(160, 90),
            is_acoustic=np.ones(160, dtype=bool), damping=(2.0, 1e-6),
        )  # fmt: skip
        assert judged(model, band=(low, 400.0), backend=backend).reached

    @pytest.mark.parametrize("low", [1e-2, 10.0])
    @pytest.mark.parametrize("backend", BACKENDS)
    def test_plate_on_a_closed_cavity(self, low, backend):
        """Near zero the symmetrised acoustic rows are divided by a vanishing number."""
        K, M, acoustic = duct(40, 110, 1.2, coupling=0.05, stiffness=6e5)
        n = acoustic.size
        model = fe_model(
            K, M, loads=unit(n, 11), outputs=unit(n, 30, 60, 149), left=unit(n, 0, 20, 39), is_acoustic=acoustic, damping=(4.0, 1e-6),
            output_power=[2, 0, 0],
        )  # fmt: skip
        assert judged(model, band=(low, 400.0), backend=backend).reached


class TestMatrices:
    @pytest.mark.parametrize("backend", BACKENDS)
    def test_massless_rotations(self, backend):
        K, _, pieces = string()
        lumped = np.zeros(K.shape[0])
        lumped[1:-1:2] = 0.8 / 80
        assert judged(fe_model(K, csc(sp.diags_array(lumped)), **pieces), backend=backend).reached

    def test_a_massless_load_point(self):
        """A spring in front of the structure, loaded and observed at its massless end."""
        K, M, pieces = string()
        n = K.shape[0]
        K = sp.block_diag([K, sp.csc_array((1, 1))]).tolil()
        K[n, n] = K[21, 21] + 4e3
        K[21, 21] += 4e3
        K[n, 21] = K[21, n] = -4e3
        M = csc(sp.block_diag([M, sp.csc_array((1, 1))]))
        pieces |= {"loads": unit(n + 1, n), "outputs": unit(n + 1, n, 51, 131), "left": unit(n + 1, 0, n, n - 1)}
        assert judged(fe_model(csc(K), M, **pieces)).reached

    @pytest.mark.parametrize("loss", [1e-4, 0.02, 0.5])
    def test_hysteretic_stiffness(self, loss):
        K, M, pieces = string(damping=(0.0, 0.0))
        assert judged(fe_model(csc(K * (1 + 1j * loss)), M, **pieces)).reached

    @pytest.mark.parametrize("heard", [0, 1])
    def test_one_part_is_loaded_and_the_other_heard(self, heard):
        """Nothing but the terms could connect them, and no term does: silence, and no invented sound."""
        K, M = side_by_side(beam(50, bending=15.0), beam(45, length=0.8, bending=12.0))
        n, first = K.shape[0], beam(50, bending=15.0)[0].shape[0]
        outputs = unit(n, first + 31, first + 60) if heard == 0 else unit(n, 51, first + 31)
        model = fe_model(K, M, loads=unit(n, 21), outputs=outputs, left=unit(n, 0, first), damping=(4.0, 2e-6))
        assert judged(model).reached

    def test_parts_that_only_a_term_joins(self):
        K, M = side_by_side(beam(50, bending=15.0), beam(45, length=0.8, bending=12.0))
        n, first = K.shape[0], beam(50, bending=15.0)[0].shape[0]
        joint = unit(n, 31) - unit(n, first + 31)
        model = fe_model(K, M, loads=unit(n, 21), outputs=unit(n, first + 31, first + 60), left=joint, damping=(4.0, 2e-6))
        assert judged(model).reached


class TestTerms:
    @pytest.mark.parametrize("gap", [0.0, 1e-12, 1e-7, 1e-3])
    def test_nearly_dependent(self, gap):
        K, M, pieces = string()
        n = K.shape[0]
        twin = unit(n, 60) + gap * unit(n, 75)
        left = csc(sp.hstack([unit(n, 0, 60), twin, unit(n, 61), unit(n, 60) + unit(n, 61)]))
        assert judged(fe_model(K, M, **(pieces | {"left": left})), limit=1e9).reached

    def test_the_same_term_many_times(self):
        K, M, pieces = string()
        left = unit(K.shape[0], *(12 * [60]))
        assert judged(fe_model(K, M, **(pieces | {"left": left})), limit=1e9).reached

    def test_a_term_that_does_nothing(self):
        """A vector of zeros."""
        K, M, pieces = string()
        n = K.shape[0]
        left = csc(sp.hstack([unit(n, 0), sp.csc_array((n, 1)), unit(n, n - 1)]))
        assert judged(fe_model(K, M, **(pieces | {"left": left})), limit=1e9).reached

    def test_out_of_reach_of_every_response(self):
        K, M = side_by_side(beam(80, bending=15.0), chain(20))
        n = K.shape[0]
        model = fe_model(
            K, M, loads=unit(n, 21), outputs=unit(n, 51, 103), left=unit(n, 0, n - 10), damping=(4.0, 2e-6)
        )  # fmt: skip
        assert judged(model).reached

    @pytest.mark.parametrize("backend", BACKENDS)
    def test_on_an_orphan(self, backend):
        """Free, the DOF has neither stiffness nor mass: what does not matter does not stop the rest."""
        K, M, pieces = string()
        n = K.shape[0]
        empty = sp.csc_array((1, 1))

        def grow(X):
            return csc(sp.vstack([X, sp.csc_array((1, X.shape[1]))]))

        pieces |= {name: grow(pieces[name]) for name in ("loads", "outputs")} | {"left": unit(n + 1, 0, n, n - 1)}
        model = fe_model(csc(sp.block_diag([K, empty])), csc(sp.block_diag([M, empty])), **pieces)

        def without(model, s, D, input_of):
            small = fe_model(K, M, **(string()[2] | {"left": unit(n, 0, n - 1)}))
            return direct_frf(small, s, D[:, [0, 2]], input_of)

        assert judged(model, backend=backend, direct=without).reached

    @pytest.mark.parametrize("backend", BACKENDS)
    def test_one(self, backend):
        K, M, pieces = string()
        assert judged(fe_model(K, M, **(pieces | {"left": unit(K.shape[0], 0)})), backend=backend).reached

    @pytest.mark.slow
    def test_five_hundred(self):
        """Springs spread over a few nodes each, 500 beside each other on a membrane of 3000 DOFs; full solves by sparse LU."""
        across, along = 30, 100
        n = across * along
        K, M = csc(4e4 * grid(along, across)), csc(0.01 * sp.eye_array(n))
        at = np.arange(along)[:, None] - np.linspace(5, along - 6, 500)
        shape = np.exp(-0.5 * (at / 4.0) ** 2) * (np.abs(at) < 16)
        left = csc(sp.kron(sp.csc_array(shape), unit(across, 10)))
        model = fe_model(K, M, loads=unit(n, 1234), outputs=unit(n, 77, 1500, 2222), left=left, damping=(5.0, 2e-6))
        assert model.terms.size == 500
        assert judged(model, band=(10.0, 250.0), direct=sparse_frf, lines=2, limit=1e9).reached

    def test_all_kinds_together(self):
        K, M, pieces = string()
        n = K.shape[0]
        more = {"left": unit(n, 0, 41, 91, n - 1, 71, 111), "power": [0, 1, 2, 0, 1, 2], "baseline": [0.0, 0.2, 0.003, 5.0, 0.0, 0.0]}
        b = more["left"].toarray()
        C = csc(4.0 * M + 2e-6 * K + 0.2 * b[:, [1]] @ b[:, [1]].T)
        M = csc(M + 0.003 * b[:, [2]] @ b[:, [2]].T)
        K = csc(K + 5.0 * b[:, [3]] @ b[:, [3]].T)
        pieces.pop("damping")
        assert judged(fe_model(K, M, C=C, **(pieces | more)), limit=1e9).reached

    def test_only_dashpots_and_masses(self):
        K, M, pieces = string(power=[1, 2, 1])
        assert judged(fe_model(K, M, **pieces), limit=1e9).reached

    @pytest.mark.parametrize("seed", [3, 4])
    def test_left_and_right_vectors_differ(self, seed):
        K, M, pieces = string()
        n, rng = K.shape[0], np.random.default_rng(seed)
        terms = {"left": random_vectors(n, 4, rng), "right": random_vectors(n, 4, rng)}
        judged(fe_model(K, M, **(pieces | terms)), limit=1e9)

    def test_left_and_right_vectors_without_a_common_dof(self):
        K, M, pieces = string()
        n = K.shape[0]
        judged(fe_model(K, M, **(pieces | {"left": unit(n, 0, 60), "right": unit(n, 60, n - 1)})), limit=1e9)

    @pytest.mark.parametrize("backend", BACKENDS)
    def test_on_the_air(self, backend):
        """Flexible walls (stiffness terms on pressures), absorbers (damping) and compliances (mass) beside springs of the plate."""
        K, M, acoustic = duct(40, 110, 1.2, coupling=0.05, stiffness=6e5)
        n = acoustic.size
        left = csc(sp.hstack([unit(n, 0, 39), 1e-3 * unit(n, 45, 90, 130)]))
        model = fe_model(
            K, M, loads=unit(n, 11), outputs=unit(n, 30, 60, 149), left=left, power=[0, 0, 0, 1, 2], is_acoustic=acoustic,
            damping=(4.0, 1e-6), output_power=[2, 0, 0],
        )  # fmt: skip
        assert judged(model, backend=backend, limit=1e9).reached


class TestHammers:
    @pytest.mark.parametrize("backend", BACKENDS)
    def test_several(self, backend):
        K, M, pieces = string()
        n = K.shape[0]
        more = {"loads": unit(n, 21, 81, 41, 121), "outputs": unit(n, 51, 103, 131, 51, 51, 103), "output_power": [2, 0, 1, 2, 2, 2]}
        judged_at = [0, 1, 1, 2, 3, 0]
        assert judged(fe_model(K, M, **(pieces | more)), input_of=judged_at, backend=backend).reached

    def test_the_same_point_twice_and_one_that_does_nothing(self):
        K, M = side_by_side(beam(80, bending=15.0), chain(20))
        n = K.shape[0]
        model = fe_model(
            K, M, loads=unit(n, 21, 21, n - 3), outputs=unit(n, 51, 103, 131), left=unit(n, 0, 60), damping=(4.0, 2e-6)
        )  # fmt: skip
        assert judged(model, input_of=[0, 1, 2]).reached


def next_to_an_idle_part():
    K, M = side_by_side(beam(80, bending=15.0), chain(20))
    n = K.shape[0]
    return fe_model(K, M, loads=unit(n, 21), outputs=unit(n, 51, 103), left=unit(n, 0, n - 10), damping=(4.0, 2e-6))


def lightly_damped():
    K, M, pieces = string(damping=(0.3, 1e-7))
    return fe_model(K, M, **pieces)


def slightly_hysteretic():
    K, M, pieces = string(damping=(0.0, 0.0))
    return fe_model(csc(K * (1 + 1e-3j)), M, **pieces)


def proportionally_damped():
    K, M, pieces = string()
    return fe_model(K, M, **pieces)


@pytest.mark.parametrize(
    ("make", "tolerance"),
    [
        (proportionally_damped, 1e-3),
        (proportionally_damped, 1e-5),
        (next_to_an_idle_part, 1e-5),
        (next_to_an_idle_part, 1e-3),
        (lightly_damped, 1e-3),
        (lightly_damped, 1e-5),
        (slightly_hysteretic, 1e-3),
        (slightly_hysteretic, 1e-5),
    ],
)
def test_no_state_and_no_line_is_missed(make, tolerance):
    """Where a few lines and vectors certify the model, all others hold too: every 1.5 Hz, random values about the local stiffness."""
    model, rng = make(), np.random.default_rng(1)
    reduction = reduce_model(model, np.zeros(model.L.shape[0], dtype=np.int64), ReductionOptions(band_hz=BAND, tolerance=tolerance))
    assert reduction.reached
    s = 2j * np.pi * np.linspace(*BAND, 261)
    scale = local_scale(model.K, model.M, model.terms, 2 * np.pi * BAND[1])
    exact, reduced = dense_ports(model, s, reduction.model.reference), reduction.model.ports(s)
    worst = 0.0
    for _ in range(150):
        D = np.tile(scale * 10.0 ** rng.uniform(-4, 5, size=scale.size) + 0j, (s.size, 1))
        worst = max(worst, relative(reduced.evaluate(D), exact.evaluate(D)))
    assert worst <= tolerance
