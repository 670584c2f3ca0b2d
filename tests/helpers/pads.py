"""A beam on pads: stiffness terms along it that can come loose, identified from a few accelerations. Small enough for dense algebra."""

from __future__ import annotations

import numpy as np
from systems import beam, csc, dense_ports, fe_model, unit, whole

from lrbc_cli.model.terms import EdgeDamping, ParameterGroup, Parameterisation, smoothing_matrix
from lrbc_cli.reduction.reduced.model import ReducedModel

PADS = 10
THIRDS = (1 / 3, 2 / 3, 1 / 3)
S = 2j * np.pi * np.linspace(15.0, 400.0, 120)


def pads_model(smoothing=THIRDS, *, beta: float | None = 2e-5, extras: bool = False, bounds=(0.0, 7.0), initial: float = 4.5):
    """FeModel and Parameterisation; with ``extras`` a dashpot and a mass of unknown size beside the pads."""
    K, M = beam(44, bending=40.0)
    n = K.shape[0]
    nodes = np.linspace(4, 40, PADS).round().astype(int)
    left = [unit(n, *(2 * nodes - 1)).toarray()]
    powers = [0] * PADS
    at = nodes / 44
    stiffness = ParameterGroup(
        name="pads",
        kind="stiffness",
        terms=np.arange(PADS),
        parameter=np.arange(PADS),
        initial=np.full(PADS, initial),
        bounds=np.tile(bounds, (PADS, 1)),
        smoothing=smoothing_matrix(smoothing, PADS),
        damping=None if beta is None else EdgeDamping(beta=beta, initial=0.0, bounds=(-2.0, 3.0)),
        xyz=np.column_stack([at, 0 * at, 0 * at]),
        arc_length=at - at[0],
    )
    groups = [stiffness]
    if extras:
        left += [unit(n, 23).toarray(), unit(n, 60).toarray()]
        powers += [1, 2]
        for j, (name, kind, start, limits) in enumerate((("pot", "damping", 0.5, (-1.0, 3.0)), ("lump", "mass", -2.0, (-4.0, 0.0)))):
            at = np.array([PADS + j])
            groups.append(
                ParameterGroup(
                    name=name,
                    kind=kind,
                    terms=at,
                    parameter=np.array([0]),
                    initial=np.array([start]),
                    bounds=np.array([limits]),
                    smoothing=np.eye(1),
                )
            )
    model = fe_model(
        K,
        M,
        loads=unit(n, 19),
        outputs=unit(n, 11, 33, 51, 75),
        left=csc(np.hstack(left)),
        power=powers,
        damping=(6.0, 4e-6),
        output_power=2,
    )
    return model, Parameterisation(tuple(groups))


def pads_ports(model, s=S):
    """Port FRFs about a stiffness inside the range."""
    reference = np.zeros((model.terms.size, 3))
    reference[model.terms.power == 0] = [1e4, 1.0, 0.0]
    return dense_ports(model, s, reference)


def pads_dynamic(model) -> ReducedModel:
    """The dynamic stiffness itself, as the other formula."""
    return whole(model, structure=model.size)


def loosened(parameters, tight=5.0, loose=2.0, at=(4, 5, 6), p_damp=0.5):
    """Theta with some pads loose."""
    theta = parameters.initial.copy()
    _, values, damping = parameters.placed[0]
    theta[values] = tight
    theta[values][list(at)] = loose
    if damping is not None:
        theta[damping] = p_damp
    return theta
