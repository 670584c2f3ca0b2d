"""First-order form: the same FRFs as the assembled matrices, poles that a structure can have, and what it refuses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg as la
from pads import pads_model
from samples import reduced_sample, sample
from systems import chain, csc, direct_frf, duct, fe_model, random_vectors, relative, resonances_hz, unit, whole

from lrbc_cli.errors import NumericalError
from lrbc_cli.reduction.build import ReductionOptions, reduce_model
from lrbc_cli.reduction.reduced.model import ReducedModel
from lrbc_cli.reduction.reduced.statespace import state_space

BAND = (20.0, 400.0)
S = 2j * np.pi * np.linspace(*BAND, 77)
NS, NA = 8, 24
BETA = 2e-5
EPS = np.finfo(float).eps


def dense(model, structure=None) -> ReducedModel:
    """The model itself as a reduced model."""
    return whole(model) if structure is None else whole(model, structure=structure)


def cavity(alpha=20.0, beta=BETA, air=(6.0, 1e-6), left=None, right=None, output_power=(0, 0, 1, 2, 0), kappa=1.3):
    """Masses on the flank of a sealed duct, six of eight on springs of unknown stiffness: a SoundBox of 32 DOFs."""
    K, M, acoustic = duct(NS, NA, kappa=kappa, coupling=1.0)
    n = NS + NA
    return fe_model(
        K,
        M,
        loads=unit(n, 7, NS + 5),
        outputs=unit(n, NS + 2, NS + 20, 6, 6, 7),
        left=unit(n, *range(6)) if left is None else left,
        right=right,
        damping=(alpha, beta),
        acoustic_damping=air,
        is_acoustic=acoustic,
        output_power=output_power,
    )


def values(log10, p_damp=None, beta=BETA):
    """(nt, 3) stiffness with damping tied to it."""
    k = np.where(np.isposinf(log10), np.inf, 10.0 ** np.where(np.isposinf(log10), 0.0, log10))
    terms = np.zeros((k.size, 3))
    terms[:, 0] = k
    if p_damp is not None:
        terms[:, 1] = np.where(np.isinf(k), 0.0, k) * beta * 10.0**p_damp
    return terms


def off(found, expected) -> float:
    """Largest error of a response relative to its largest magnitude: single ones fade where a line says nothing."""
    return float(np.max(np.abs(found - expected).max(axis=0) / np.abs(expected).max(axis=0)))


def dynamic(terms, s):
    """(F, nt) k + s c + s² m; infinite where clamped."""
    finite = np.where(np.isinf(terms), 0.0, terms)
    D = finite[:, 0] + s[:, None] * finite[:, 1] + s[:, None] ** 2 * finite[:, 2]
    D[:, np.isinf(terms[:, 0])] = np.inf
    return D


STATES = {
    "free": np.full(6, -np.inf),
    "loose": np.array([4.5, 4.5, 1.0, 0.5, 4.5, 4.5]),
    "tight": np.full(6, 5.0),
    "stiff": np.full(6, 12.0),
    "wild": np.array([-2.0, 9.0, 3.0, 7.0, 0.0, 11.0]),
    "clamped": np.full(6, np.inf),
    "partly": np.array([np.inf, 2.0, np.inf, 4.0, -np.inf, 6.0]),
}


@pytest.mark.parametrize("state", STATES)
@pytest.mark.parametrize("p_damp", [None, 1.0])
def test_frfs_are_those_of_the_assembled_matrices(state, p_damp):
    model = cavity()
    terms = values(STATES[state], p_damp)
    system = state_space(dense(model), terms, BAND)
    assert system.E is None
    assert system.states == 2 * (NS + NA - int(np.isinf(terms[:, 0]).sum()))
    assert system.deviation < 1e-10
    y = system.transfer(S)
    D = dynamic(terms, S)
    for load in (0, 1):
        expected = direct_frf(model, S, D, np.full(5, load))
        assert off(y[:, :, load], expected) < 1e-10
    # What the DOFs are: outputs without derivatives are L x with x = basis q.
    L = model.L.toarray()[:2]
    np.testing.assert_allclose(system.C[:2], np.hstack([L @ system.basis, 0 * L @ system.basis]), atol=1e-12)
    clamped = np.isinf(terms[:, 0])
    assert np.abs(system.basis[:6][clamped]).max(initial=0.0) < 1e-9 * np.abs(system.basis).max()


def test_quantities_and_feedthrough():
    """Only an acceleration answers at once: a driven mass with 1/m, another one not at all."""
    model = cavity(output_power=(0, 0, 1, 2, 2))
    system = state_space(dense(model), values(STATES["tight"], 0.0), BAND)
    assert not np.any(system.D[:3])
    # D = L M⁻¹ B sums as many products as there are states, whose parts are of the size of 1/m: each rounds.
    at_once = 1.0 / model.M[7, 7]
    np.testing.assert_allclose(system.D[3:], [[0.0, 0.0], [at_once, 0.0]], rtol=0, atol=system.states * EPS * at_once)
    other = state_space(dense(replace(model, output_power=np.zeros(5, dtype=np.int64))), values(STATES["tight"], 0.0), BAND)
    expected = S[:, None, None] ** model.output_power[:, None] * other.transfer(S)
    assert off(system.transfer(S), expected) < 1e-10


@pytest.mark.parametrize("state", STATES)
@pytest.mark.parametrize("p_damp", [None, *(pytest.param(p, marks=pytest.mark.slow) for p in (-3.0, 0.0, 2.0)), 4.0])
@pytest.mark.parametrize("split", ["full", "reduced"])
def test_no_pole_in_the_right_half_plane(state, p_damp, split):
    """The unsymmetric u-p system is a gyroscopic one of positive matrices; its poles at zero are the constant pressure of the cavity."""
    model = cavity()
    if split == "full":
        small = dense(model)
    else:
        small = reduce_model(model, np.zeros(5, dtype=np.int64), ReductionOptions(band_hz=BAND, tolerance=1e-4, max_size=24)).model
        assert small.size <= 24
        assert 0 < small.structure < small.size
    system = state_space(small, values(STATES[state], p_damp), BAND)
    assert system.unstable == 0
    # Away from zero all are damped for certain, though poles may reach 1e13 rad/s.
    away = np.abs(system.poles) > 1e-3
    assert np.all(system.poles.real[away] < -system.errors[away])
    # The basis of the band need not hold the constant.
    assert np.sum(~away) == (split == "full")
    assert np.all(np.abs(system.poles[~away]) <= system.errors[~away])
    assert np.all(system.errors[~away] < 1e-3)
    assert system.abscissa < 1e-5


@pytest.mark.parametrize("p_damp", [None, 4.0])
@pytest.mark.parametrize("log10", [9.0, 12.0, 15.0, 300.0])
def test_stiff_terms_leave_the_poles_of_the_clamped_system(log10, p_damp):
    """Poles of 1e16 rad/s do not drown those of the band."""
    model = dense(cavity())
    system = state_space(model, values(np.full(6, log10), p_damp), BAND)
    clamped = state_space(model, values(np.full(6, np.inf)), BAND).poles
    moved = np.abs(system.poles[:, None] - clamped).min(axis=0)
    # A motion gives way by the dynamic stiffness of the masses, 4e6 N/m at 1.5e4 rad/s, over that of its spring.
    assert np.all(moved < 1e-6 + 4e6 / 10.0**log10 * np.abs(clamped))
    if p_damp is not None and log10 < 300.0:
        # A pinned motion creeps back with k/c; what else holds it adds to k.
        creep = -1.0 / (BETA * 10.0**p_damp)
        near = np.sort(np.abs(system.poles - creep))[:6]
        assert near.max() < 1e-8 + 1e6 / 10.0**log10 * abs(creep)


@pytest.mark.parametrize("grounded", [True, False])
@pytest.mark.parametrize("alpha", [0.0, 3.0, -0.01])
def test_errors_of_the_poles_hold(grounded, alpha):
    """Proportional damping has poles by a formula: the errors stated cover what is off, a double pole at zero included."""
    K, M = chain(20, grounded=grounded)
    model = fe_model(K, M, loads=unit(20, 3), outputs=unit(20, 9), left=unit(20, 0), damping=(alpha, 0.0))
    system = state_space(dense(model), np.zeros((1, 3)), BAND)
    squared = la.eigh(K.toarray(), M.toarray(), eigvals_only=True)
    squared[: 0 if grounded else 1] = 0.0
    expected = -alpha / 2 + np.array([1, -1])[:, None] * np.sqrt(alpha**2 / 4 - squared + 0j)
    # Rounding of the symmetric eigenvalues themselves.
    own = 20 * EPS * squared[-1] / np.maximum(np.abs(expected), 1.0)
    off_by = np.abs(system.poles[:, None] - expected.ravel())
    assert system.poles.size == 40
    assert np.all(off_by.min(axis=0) <= (system.errors[off_by.argmin(axis=0)] + own.ravel()))
    # None is idle but for two poles that (nearly) coincide at zero: those of the resonances are known to nine digits of the band.
    assert np.sort(system.errors)[:38].max() < 1e-9 * 2 * np.pi * BAND[1]
    assert system.unstable == (0 if alpha >= 0 else 40 if grounded else 39)


def test_undamped_poles_are_the_resonances():
    model = cavity(0.0, 0.0, (0.0, 0.0))
    system = state_space(dense(model), np.zeros((6, 3)), BAND)
    assert system.unstable == 0
    found = np.sort(np.abs(system.poles.imag))[::2] / (2 * np.pi)
    expected = resonances_hz(model.K, model.M)
    np.testing.assert_allclose(found[1:], expected[1:], rtol=1e-8)
    assert np.abs(system.poles.real).max() < 1e-6 * np.abs(system.poles).max()


@pytest.mark.parametrize("damping", [{"alpha": -50.0}, {"air": (-20.0, 0.0)}])
def test_negative_damping_is_seen(damping):
    system = state_space(dense(cavity(**damping)), values(STATES["loose"]), BAND)
    assert system.unstable > 0
    assert system.abscissa > 5e-3


def test_a_coupling_of_the_wrong_sign_is_seen():
    """Signs of the coupling that feed energy: the very mistake of an exporter that a stability check finds."""
    model = cavity()
    K = model.K.toarray()
    K[:NS, NS:] *= -1
    system = state_space(dense(replace(model, K=csc(K))), values(STATES["loose"]), BAND)
    assert system.unstable > 0
    assert system.abscissa > 0.1


def massless():
    """A chain where every second mass is missing."""
    K, M = chain(12)
    M = csc(M.toarray() * (np.arange(12) % 2 == 1))
    outputs = unit(12, 6, 5, 7, 10)
    return fe_model(K, M, loads=unit(12, 11), outputs=outputs, left=unit(12, 0, 4), damping=(8.0, 1e-5), output_power=[0, 1, 2, 2])


@pytest.mark.parametrize("log10", [[-np.inf, -np.inf], [4.0, 2.0], [5.0, np.inf]])
def test_a_singular_mass_gives_the_descriptor_form(log10):
    model = massless()
    terms = values(np.array(log10), 0.0)
    system = state_space(dense(model), terms, BAND)
    assert system.E is not None
    assert system.states == 2 * (12 - int(np.isinf(terms[:, 0]).sum())) + 2
    expected = direct_frf(model, S, dynamic(terms, S))
    assert off(system.transfer(S)[:, :, 0], expected) < 1e-9
    assert 0 < system.poles.size < system.states
    assert np.all(np.isfinite(system.poles))
    assert system.poles.real.max() < 0


def test_damping_and_mass_terms():
    model, parameters = pads_model(extras=True)
    theta = parameters.initial
    terms = parameters.polynomial(theta)
    assert np.all(terms.any(axis=0))
    system = state_space(dense(model), terms, BAND)
    expected = direct_frf(model, S, parameters.dynamic(theta, S))
    assert off(system.transfer(S)[:, :, 0], expected) < 1e-9
    assert system.poles.real.max() < 0


@pytest.mark.parametrize("log10", [[3.0, 4.0], [np.inf, 3.0]])
@pytest.mark.parametrize("across", [False, True])
def test_left_and_right_vectors_that_differ(log10, across):
    """Terms of any form, also such that bind a motion to a pressure."""
    rng = np.random.default_rng(3)
    n = NS + NA

    def vectors():
        if across:
            return csc(unit(n, 2, 4).toarray() + 1e-3 * unit(n, NS + 3, NS + 8).toarray())
        return csc(np.vstack([random_vectors(NS, 2, rng).toarray(), np.zeros((NA, 2))]))

    model = cavity(left=vectors(), right=vectors())
    terms = values(np.array(log10), 0.0)
    system = state_space(dense(model), terms, BAND)
    # Rounding of states in coordinates of one size: eps times 64 states times the condition of s E - A, some 1e4.
    assert off(system.transfer(S)[:, :, 0], direct_frf(model, S, dynamic(terms, S))) < 1e-10


def test_clamped_forces_that_no_constraint_takes():
    model = cavity(left=unit(NS + NA, 0, 1), right=unit(NS + NA, 2, 2))
    with pytest.raises(NumericalError, match="do not constrain as many motions"):
        state_space(dense(model), values(np.array([np.inf, np.inf])), BAND)


@pytest.mark.parametrize("which", ["K", "C"])
def test_hysteretic_damping_is_refused(which):
    small = dense(cavity())
    complex_one = replace(small, **{which: getattr(small, which) * (1 + 0.02j)})
    with pytest.raises(NumericalError, match="harmonic motion only") as caught:
        state_space(complex_one, values(STATES["tight"]), BAND)
    assert "--state-space" in caught.value.message
    # Complex in type only: the same but for the order of summation, which follows the alignment of the arrays.
    plain = state_space(small, values(STATES["tight"]), BAND)
    found = state_space(replace(small, K=small.K + 0j), values(STATES["tight"]), BAND)
    np.testing.assert_allclose(found.A, plain.A, rtol=0, atol=1e-13 * np.abs(plain.A).max())


def test_a_singular_system_is_an_error():
    model = cavity()
    empty = csc(np.zeros((NS + NA, NS + NA)))
    with pytest.raises(NumericalError, match="singular"):
        state_space(dense(replace(model, K=empty, C=empty, M=empty)), np.zeros((6, 3)), BAND)


def test_an_extreme_value_on_a_diagonal_is_a_clamp():
    """A motion of its own can be pinned by any number; so the same in all arithmetic units."""
    model = massless()
    stiff = state_space(dense(model), values(np.array([300.0, 4.0])), BAND)
    clamped = state_space(dense(model), values(np.array([np.inf, 4.0])), BAND)
    assert off(stiff.transfer(S), clamped.transfer(S)) < 1e-10
    assert stiff.poles.size == clamped.poles.size
    np.testing.assert_allclose(np.sort_complex(stiff.poles), np.sort_complex(clamped.poles), rtol=1e-8)


def test_values_that_cannot_be_used():
    """Where forces and motions of a term are unlike, a value of 1e25 leaves nothing of the matrices beside it."""
    rng = np.random.default_rng(3)
    left, right = (csc(np.vstack([random_vectors(NS, 2, rng).toarray(), np.zeros((NA, 2))])) for _ in range(2))
    with pytest.raises(NumericalError, match="first-order form"):
        state_space(dense(cavity(left=left, right=right)), values(np.array([25.0, 4.0])), BAND)
    # Beyond the range of floats once multiplied.
    with pytest.raises(NumericalError, match="first-order form"):
        state_space(dense(cavity()), values(np.full(6, 304.0), 4.0), BAND)


def test_motions_without_mass_and_damping_have_no_pole():
    """Infinite poles come in pairs that rounding moves far: none of them is taken for a finite one."""
    model = massless()
    model = replace(model, C=csc(8.0 * model.M.toarray()))
    system = state_space(dense(model), values(np.array([4.0, 2.0])), BAND)
    assert system.E is not None
    assert system.poles.size == 12
    np.testing.assert_allclose(system.poles.real, -4.0, rtol=1e-8)


@pytest.mark.slow
@pytest.mark.parametrize("p_damp", [-3.0, 0.0, 4.0])
@pytest.mark.parametrize("state", ["free", "loose", "start", "tight", "wild", "clamped"])
def test_the_soundbox(state, p_damp):
    """The sample at full size: stable, explicit, and the port formula's FRFs."""
    inputs, model = sample("soundbox"), reduced_sample("soundbox").model
    nt, beta = model.terms, inputs.groups[0].beta
    at = np.arange(nt)
    log10 = {
        "free": np.full(nt, -np.inf),
        "loose": np.where((at > 10) & (at < 18), 1.0, 5.0),
        "start": np.full(nt, 4.0),
        "tight": np.full(nt, 7.0),
        "wild": np.random.default_rng(7).uniform(-2, 8, nt),
        "clamped": np.full(nt, np.inf),
    }[state]
    terms = values(log10, p_damp, beta)
    system = state_space(model, terms, BAND)
    assert system.E is None
    assert system.unstable == 0
    away = np.abs(system.poles) > 10.0
    assert system.poles.real[away].max() < -1.0
    assert system.poles.real[~away].max(initial=-1.0) < 1e-2
    y = model.ports(S, workers=1).evaluate(dynamic(terms, S))
    assert relative(system.transfer(S)[:, :, 0], y) < 1e-8
