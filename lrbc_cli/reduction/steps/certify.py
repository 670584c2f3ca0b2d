"""The certificate: errors of a reduced model measured against full solves at single lines, for certificate vectors from free to clamped."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from lrbc_cli.arrays import Complexes, Floats, Integers
from lrbc_cli.model.fem import FeModel
from lrbc_cli.model.terms import LowRankTerms
from lrbc_cli.reduction.outcome import HeldOut
from lrbc_cli.reduction.problem.full import full_ports
from lrbc_cli.reduction.problem.norms import local_responses, quantity_groups, relative_error
from lrbc_cli.reduction.problem.resonant import resonant_vectors
from lrbc_cli.reduction.problem.vectors import KINDS, RESONANT, band_omega, certificate_vectors, local_scale
from lrbc_cli.reduction.reduced.model import ReducedModel
from lrbc_cli.reduction.reduced.ports import PortFrf
from lrbc_cli.reduction.solve.dynamic import Factorisation

#: Number of patterns of resonant certificate vectors, see ``resonant_vectors``.
PATTERNS = 4


def port_errors(model: FeModel, scale: Floats, exact: PortFrf, approximate: PortFrf) -> dict[str, float]:
    """Largest relative error of y at one line by kind of parameter vector, from exact and approximate port FRFs.

    Parameters
    ----------
    model : FeModel
    scale : (nt,) float array
        From ``local_scale``.
    exact, approximate : PortFrf
        Of the full and the reduced model at the same single line.
    """
    groups = quantity_groups(model)
    local = local_responses(model, complex(exact.s[0]), exact.input_of)
    out = {}
    for kind, vectors in measured_vectors(exact, model.terms, scale).items():
        out[kind] = max(relative_error(groups, approximate.evaluate(D)[0], exact.evaluate(D)[0], exact.H00[0], local) for D in vectors)
    return out


def residual_errors(
    model: FeModel,
    scale: Floats,
    reduced: ReducedModel,
    factorisation: Factorisation,
    lift: Callable[[Complexes], Complexes],
    load: Callable[[Complexes], Complexes],
) -> dict[str, float]:
    """Largest relative error of y at one line by kind of parameter vector, from the residuals of the reduced solutions.

    The error is ``y - y_r = L Z(D)⁻¹ r`` with the residual r of the full system. It is solved with the factorisation at the reference
    values; the effect of D on it is computed with the port FRFs of the reduced model, so the error is known up to a share of itself.
    The number of solves is that of the vectors, not of the terms: cheaper with very many terms.

    Parameters
    ----------
    model : FeModel
    scale : (nt,) float array
        From ``local_scale``.
    reduced : ReducedModel
    factorisation : Factorisation
        Of the full model at the line, with the terms at their reference values.
    lift : callable
        Maps reduced to full solutions, (r, k) to (n, k).
    load : callable
        Maps amplitudes of all inputs to load vectors, (n_in + nt, k) to (n, k).
    """
    s = np.array([factorisation.s])
    groups, n_in = quantity_groups(model), model.B.shape[1]
    local = local_responses(model, factorisation.s, reduced.input_of)
    ports = reduced.ports(s, workers=1)
    kinds = measured_vectors(ports, model.terms, scale)
    vectors = [D for Ds in kinds.values() for D in Ds]
    Z = reduced.dynamic_stiffness(s, reduced.reference_dynamic(s))[0]
    driven = [ports.drive(D) for D in vectors]
    amplitudes = np.hstack([np.vstack([np.eye(n_in), u[0]]) for _, u in driven])
    states = np.linalg.solve(Z, np.hstack([reduced.B, reduced.left]) @ amplitudes)
    residual = load(amplitudes) - factorisation.owner.apply(factorisation.s, lift(states))
    missing = factorisation.solve(residual).reshape(model.size, len(vectors), n_in)
    to_quantity = factorisation.s**model.output_power
    errors = []
    for at, (D, (y, _)) in enumerate(zip(vectors, driven, strict=True)):
        w = missing[:, at]
        direct = (model.L @ w)[np.arange(y.shape[1]), reduced.input_of] * to_quantity
        error = replace(ports, H00=direct[None], Hp0=np.asarray(model.terms.right.T @ w)[None]).evaluate(D)[0]
        errors.append(relative_error(groups, y[0], y[0] + error, ports.H00[0], local))
    found = iter(errors)
    return {kind: max(itertools.islice(found, len(Ds))) for kind, Ds in kinds.items()}


def random_vectors(terms: int) -> int:
    """Number of random certificate vectors at each line; fewer with many terms, where each needs the solution of a large system."""
    return 16 if terms <= 150 else 4


def measured_vectors(ports: PortFrf, terms: LowRankTerms, scale: Floats) -> dict[str, list[Complexes]]:
    """Certificate vectors by kind, as (F, nt) dynamic values; resonant ones are found from the port FRFs of the lines."""
    drawn = random_vectors(terms.size)
    kinds = certificate_vectors(terms, scale, ports.s, drawn)
    resonant = resonant_vectors(ports, terms, scale, patterns=PATTERNS, count=drawn // PATTERNS)
    return kinds | ({RESONANT: resonant} if resonant else {})


def vector_count(terms: LowRankTerms) -> int:
    """Number of certificate vectors at each line."""
    drawn = random_vectors(terms.size)
    return 1 + len(KINDS) + drawn + PATTERNS * min(drawn // PATTERNS, int(np.sum(terms.power == 0)))


def lines_between(band_hz: tuple[float, float], points: Sequence[float], count: int) -> Floats:
    """(count,) lines [Hz], one in each of ``count`` equal parts of the band, as far from the given points as possible."""
    ends = np.linspace(*band_hz, count + 1)
    found = []
    for low, high in itertools.pairwise(ends):
        grid = np.linspace(low, high, 43)[1:-1]
        away = np.abs(grid[:, None] - np.array([*points, np.inf])[None, :]).min(axis=1)
        found.append(grid[int(np.argmax(away))])
    return np.array(found)


def measured_errors(
    model: FeModel,
    input_of: Integers,
    reduced: ReducedModel,
    band_hz: tuple[float, float],
    lines_hz: Floats,
    *,
    backend: str = "auto",
    progress: Callable[[int, int], None] = lambda *_: None,
) -> tuple[HeldOut, ...]:
    """Measure the error of a reduced model at given lines against a full model, e.g. one with other factors after a calibration.

    Parameters
    ----------
    model : FeModel
    input_of : (n_out,) int array
        Which input each response belongs to.
    reduced : ReducedModel
    band_hz : (float, float)
    lines_hz : (m,) float array
    backend : str
        Sparse solver, see ``DynamicStiffness``.
    progress : callable
        Called with the number of lines done and of all lines.

    Returns
    -------
    tuple of HeldOut
    """
    scale = local_scale(model.K, model.M, model.terms, band_omega(model.K, model.M, band_hz))
    s = 2j * np.pi * lines_hz
    exact = full_ports(model, input_of, s, band_hz, backend=backend, progress=progress)
    approximate = reduced.ports(s, workers=1)
    rows = np.arange(input_of.size)
    return tuple(
        HeldOut(float(f), port_errors(model, scale, exact.select(at, rows), approximate.select(at, rows)))
        for f, at in zip(lines_hz, np.arange(lines_hz.size)[:, None], strict=True)
    )
