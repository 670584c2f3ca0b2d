"""States that resonate at a line: they do, the certificate measures them, and what rounding does there is foreseen."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg as la
from systems import chain, dense_ports, direct_frf, duct, fe_model, unit

from lrbc_cli.reduction.build import Reducer, ReductionOptions, reduce_model
from lrbc_cli.reduction.problem.resonant import LEAST_LOSS, resonant_vectors
from lrbc_cli.reduction.problem.vectors import band_omega, local_scale, reference_values
from lrbc_cli.reduction.reduced.ports import PortFrf
from lrbc_cli.reduction.steps.certify import measured_vectors

BAND = (10.0, 400.0)


def floating(n=300, damping=(0.0, 4e-6), **pieces):
    """A chain that its terms alone hold; as finely meshed as it is, they are soft beside its own springs."""
    K, M = chain(n, stiffness=4e6, mass=0.02, grounded=False)
    ends = (n // 15, n // 3, n // 2, 9 * n // 10)
    return fe_model(K, M, loads=unit(n, 5), outputs=unit(n, n // 5, n // 2 - 1, 5 * n // 6), left=unit(n, *ends), damping=damping, **pieces)


def one_input(model):
    return np.zeros(model.L.shape[0], dtype=np.int64)


def scale_of(model):
    return local_scale(model.K, model.M, model.terms, band_omega(model.K, model.M, BAND))


def ports_of(model, s) -> PortFrf:
    return dense_ports(model, s, reference_values(model.terms, scale_of(model), band_omega(model.K, model.M, BAND)))


class TestResonance:
    @pytest.mark.parametrize("baseline", [0.0, 300.0])
    def test_a_mode_lies_on_the_line(self, baseline):
        """Eigenvalues of the whole system with the springs in place share no formula with the ports."""
        model = floating(damping=(0.0, 1e-8), baseline=baseline)
        s = 2j * np.pi * np.array([10.0, 47.0, 180.0, 400.0])
        found = resonant_vectors(ports_of(model, s), model.terms, scale_of(model), patterns=3, count=2)
        assert len(found) == 6
        raised = np.array([D.real.max(axis=1) for D in found]) > -baseline + 1e-9 * scale_of(model)[0]
        # The lowest line has a resonance of every pattern, the others where a mode can be brought there.
        assert raised[::2, 0].all()
        for number, D in enumerate(found):
            for at, value in enumerate(s):
                if not raised[number, at]:
                    continue
                added = D[at].real
                assert np.all(added >= -baseline)
                K = model.K.toarray() + (model.terms.left * added) @ model.terms.right.T
                frequencies = np.sqrt(np.maximum(la.eigh(K, model.M.toarray(), eigvals_only=True), 0.0))
                assert np.abs(frequencies / value.imag - 1).min() < 1e-4

    def test_undamped_ones_get_a_little_damping(self):
        model = floating(damping=(0.0, 0.0))
        s = 2j * np.pi * np.array([33.0])
        D = resonant_vectors(ports_of(model, s), model.terms, scale_of(model), patterns=1, count=1)[0][0]
        assert D.imag == pytest.approx(LEAST_LOSS * D.real, rel=0.1)

    def test_a_line_without_a_resonance_is_left_free(self):
        """Above all that a few masses can do, springs of any stiffness raise one mode at most to it."""
        K, M = chain(4, stiffness=1e3, mass=1.0)
        model = fe_model(K, M, loads=unit(4, 0), outputs=unit(4, 3), left=unit(4, 1), damping=(0.0, 1e-6))
        s = 2j * np.pi * np.array([1.0])
        found = resonant_vectors(ports_of(model, s), model.terms, scale_of(model), patterns=2, count=3)
        assert len(found) == 2
        assert np.abs(np.array(found)).max() < 1e-6 * scale_of(model)[0]

    def test_none_without_springs(self):
        model = floating(power=1)
        s = 2j * np.pi * np.array([33.0])
        assert resonant_vectors(ports_of(model, s), model.terms, scale_of(model), patterns=3, count=2) == []
        assert "resonant" not in measured_vectors(ports_of(model, s), model.terms, scale_of(model))


@pytest.mark.parametrize("tolerance", [1e-3, 1e-5])
def test_true_errors_of_soft_states_are_below_the_bound(tolerance):
    """Random states between free and clamped on a dense scan, each with its resonances: full solves against what was stated."""
    model = floating()
    reduction = reduce_model(model, one_input(model), ReductionOptions(band_hz=BAND, tolerance=tolerance))
    assert reduction.reached
    s = 2j * np.pi * np.linspace(10.0, 60.0, 401)
    exact, found = dense_ports(model, s, reduction.model.reference), reduction.model.ports(s)
    rng, worst = np.random.default_rng(5), []
    for level in np.linspace(-7.0, -2.0, 21):
        D = np.broadcast_to(scale_of(model) * 10.0 ** (level + rng.uniform(-0.7, 0.7, 4)), (s.size, 4)).astype(complex)
        y, truth = found.evaluate(D), exact.evaluate(D)
        worst.append((np.linalg.norm(y - truth, axis=1) / np.linalg.norm(truth, axis=1)).max())
    assert max(worst) <= reduction.unseen
    assert max(worst) <= tolerance


@pytest.mark.parametrize("name", ["chain", "duct"])
def test_rounding_is_foreseen(name):
    """Kept whole, a model misses nothing: what is measured is rounding, of the full solution and of the reduced one."""
    if name == "chain":
        model = floating(60)
    else:
        K, M, is_acoustic = duct(30, 40)
        model = fe_model(
            K, M, loads=unit(70, 4), outputs=unit(70, 45, 60), left=unit(70, 2, 11, 25), damping=(0.5, 2e-6), is_acoustic=is_acoustic
        )
    R = Reducer(model, one_input(model), ReductionOptions(band_hz=BAND))
    R._whole(lambda _: None)
    lines = np.array([12.0, 55.0, 210.0, 390.0])
    sweep = R.estimator.sweep(R.basis.projected(), lines)
    assert sweep.estimate.max() < 1e-6 * sweep.rounding.max()
    s = 2j * np.pi * lines
    found = R.reduced().ports(s)
    # Complex numbers of twice as many digits are not to be had: the direct solution has a rounding of its own.
    measured = np.zeros(lines.size)
    for D in sweep.vectors:
        truth, y = direct_frf(model, s, D), found.evaluate(D)
        measured = np.maximum(measured, np.linalg.norm(y - truth, axis=1) / np.linalg.norm(truth, axis=1))
    # It is told to an order of magnitude or two: BLAS kernels add in different orders.
    assert np.all(measured <= 100 * sweep.rounding)
    assert measured.max() >= sweep.rounding.max() / 1000


def test_the_estimate_knows_each_state():
    """Not only the worst of all: measured over estimated is about the same from vector to vector, so that a few lines tell for all."""
    model = floating()
    R = Reducer(model, one_input(model), ReductionOptions(band_hz=BAND, tolerance=1e-4))
    R.run()
    lines = np.array([25.0, 141.0, 333.0])
    exact, found = ports_of(model, 2j * np.pi * lines), R.reduced().ports(2j * np.pi * lines)
    ratios = []
    for at in range(lines.size):
        here = exact.select(np.array([at]), np.arange(3))
        for D in measured_vectors(here, model.terms, R.problem.scale)["resonant"]:
            estimate = R.estimator.sweep(R.basis.projected(), lines[[at]], lambda _, D=D: [D]).estimate[0]
            y, truth = found.select(np.array([at]), np.arange(3)).evaluate(D), here.evaluate(D)
            ratios.append(np.linalg.norm(y - truth) / np.linalg.norm(truth) / estimate)
    assert min(ratios) > 1e-3
    assert max(ratios) < 5
