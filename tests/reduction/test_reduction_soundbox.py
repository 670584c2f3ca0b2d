"""The SoundBox at full size: what the certificate promises, measured apart from it."""

from __future__ import annotations

import numpy as np
import pytest
from samples import reduced_sample, sample
from systems import relative
from threadpoolctl import threadpool_limits

from lrbc_cli.reduction.build import full_operators
from lrbc_cli.reduction.reduced.model import reference_dynamic
from lrbc_cli.reduction.reduced.ports import port_frf
from lrbc_cli.reduction.solve.dynamic import DynamicStiffness

pytestmark = pytest.mark.slow

LINES, VECTORS = 26, 20


def full_frfs_ports(inputs, s, reference):
    """Port FRFs by one full solve a line, at the same reference as the reduced model."""
    model = inputs.model
    with threadpool_limits(limits=1, user_api="blas"):
        Z = DynamicStiffness(*full_operators(model, reference), model.is_acoustic)
        rhs, outputs, H = model.inputs.toarray(), model.outputs, []
        for line, value in enumerate(s):
            factorisation = Z.factor(complex(value))
            X = factorisation.solve(rhs)
            if line % 10 == 0:
                assert factorisation.residual(X, rhs) < 1e-11
            H.append(outputs @ X)
    return port_frf(np.array(H), s, reference_dynamic(reference, s), model.output_power, inputs.input_of)


def vectors(s, nt, beta, rng):
    """Free, clamped, uniform, patchy and wild stiffness, from -2 to 9 decades, with damping exponents over their whole range."""
    damped = 1 + s[:, None] * beta * 10.0 ** rng.uniform(-3.0, 4.0)
    yield "free", np.zeros((s.size, nt), dtype=complex)
    yield "clamped", np.full((s.size, nt), np.inf + 0j)
    for i in range(VECTORS - 2):
        damped = 1 + s[:, None] * beta * 10.0 ** rng.uniform(-3.0, 4.0)
        if i % 3 == 0:
            p = np.full(nt, rng.uniform(-2, 9))
        elif i % 3 == 1:
            # Tight but for a gap.
            p = np.full(nt, rng.uniform(3, 7))
            at = rng.integers(0, nt - 5)
            p[at : at + rng.integers(2, 12)] = rng.uniform(-2, 2)
        else:
            p = rng.uniform(-2, 9, size=nt)
        yield ("uniform", "patch", "random")[i % 3], 10.0**p * damped


@pytest.mark.parametrize("part", [0, 1])
def test_measured_error_from_free_to_clamped(part):
    """At most 1e-3 of each line's norm at 26 lines that are no expansion points, for 20 stiffness vectors each; every other line a part."""
    inputs, reduction = sample("soundbox"), reduced_sample("soundbox")
    assert reduction.reached
    rng = np.random.default_rng(50)
    expanded = np.array([step.frequency_hz for step in reduction.trace if step.order])
    hz = rng.uniform(*reduction.options.band_hz, size=3 * LINES)
    hz = np.sort(hz[np.abs(hz[:, None] - expanded).min(axis=1) > 0.5][:LINES])
    assert hz.size == LINES
    s = 2j * np.pi * hz[part::2]
    full = full_frfs_ports(inputs, s, reduction.model.reference)
    ports = reduction.model.ports(s)
    worst: dict[str, float] = {}
    slopes = []
    for kind, D in vectors(s, inputs.model.terms.size, inputs.groups[0].beta, rng):
        worst[kind] = max(worst.get(kind, 0.0), relative(ports.evaluate(D), full.evaluate(D)))
        if kind == "uniform":
            # Sensitivities per decade, as the optimiser sees them.
            (_, dy), (y, dy0) = ports.linearise(D), full.linearise(D)
            error = np.linalg.norm((dy - dy0) * D[:, None], axis=(1, 2)) / np.linalg.norm(y, axis=1)
            slopes.append(error.max())
    assert max(worst.values()) <= 1e-3, worst
    assert max(slopes) <= 1e-3


def test_the_certificate():
    """Five held-out lines or more, all kinds of vectors, and a small model."""
    reduction = reduced_sample("soundbox")
    assert reduction.reached
    assert len(reduction.held_out) >= 5
    assert reduction.worst <= 1e-3
    assert reduction.model.size < 250
    assert len(reduction.sizes) == 2
    expanded = [step.frequency_hz for step in reduction.trace if step.order]
    assert not {line.frequency_hz for line in reduction.held_out} & set(expanded)
    assert "kappa" in reduction.coupling


def test_the_cost_in_full_lines():
    """Counted, not timed: factorisations of the whole reduction, certificate included."""
    assert len(reduced_sample("soundbox").trace) <= 16
