"""A beam on springs with next to no damping: peaks narrower than the lines are apart, a cost full of valleys, and exact data."""

from __future__ import annotations

from functools import cache

import numpy as np
from systems import beam, dense_ports, fe_model, unit

from lrbc_cli.model.terms import ParameterGroup, Parameterisation
from lrbc_cli.reduction.reduced.ports import PortFrf
from lrbc_cli.updating.misfit.cost import Misfit
from lrbc_cli.updating.misfit.frf import port_model

SPRINGS = 34
S = 2j * np.pi * np.arange(20.0, 401.0, 1.0)


@cache
def _ports(beta: float) -> PortFrf:
    K, M = beam(40, bending=1.0)
    n = K.shape[0]
    left = unit(n, *range(3, 2 * SPRINGS + 3, 2))
    model = fe_model(K, M, loads=unit(n, 19), outputs=unit(n, 11, 33, 51), left=left, damping=(0.0, beta), output_power=2)
    reference = np.zeros((SPRINGS, 3))
    reference[:, :2] = [1e3, 1.0]
    return dense_ports(model, S, reference)


def sharp_misfit(truth: float, *, beta: float = 1e-6, shared: bool = True, bounds: tuple[float, float] = (1.07, 6.0)) -> Misfit:
    """The cost against the model's own FRFs at ``truth``: one value for all springs, or one a spring."""
    count = 1 if shared else SPRINGS
    owner = np.zeros(SPRINGS, dtype=int) if shared else np.arange(SPRINGS)
    along = None if shared else np.linspace(0.0, 1.0, SPRINGS)
    box = np.tile(bounds, (count, 1))
    group = ParameterGroup(
        name="springs",
        kind="stiffness",
        terms=np.arange(SPRINGS),
        parameter=owner,
        initial=np.full(count, 4.0),
        bounds=box,
        smoothing=np.eye(count),
        arc_length=along,
    )
    parameters = Parameterisation((group,))
    frf = port_model(_ports(beta), parameters)
    return Misfit(frf, frf.frf(np.full(count, truth)), parameters.initial, 0.0)
