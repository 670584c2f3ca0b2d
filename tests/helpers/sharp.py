"""A beam on springs with next to no damping: peaks narrower than the lines are apart, a cost full of valleys, and exact data."""

from __future__ import annotations

import numpy as np
from systems import beam, dense_ports, fe_model, unit

from lrbc_cli.model.terms import ParameterGroup, Parameterisation
from lrbc_cli.updating.misfit import Misfit, port_model

SPRINGS = 34
S = 2j * np.pi * np.arange(20.0, 401.0, 1.0)


def sharp_misfit(
    truth: float, *, start: float = 4.0, beta: float = 1e-6, shared: bool = True, bounds=(1.07, 6.0), eta: float = 0.0, s=S
) -> Misfit:
    """The cost against the model's own FRFs at ``truth``: one value for all springs, or one a spring."""
    K, M = beam(40, bending=1.0)
    n = K.shape[0]
    model = fe_model(
        K,
        M,
        loads=unit(n, 19),
        outputs=unit(n, 11, 33, 51),
        left=unit(n, *range(3, 2 * SPRINGS + 3, 2)),
        damping=(0.0, beta),
        output_power=2,
    )
    count = 1 if shared else SPRINGS
    owner = np.zeros(SPRINGS, dtype=int) if shared else np.arange(SPRINGS)
    along = None if shared else np.linspace(0.0, 1.0, SPRINGS)
    group = ParameterGroup(
        "springs",
        "stiffness",
        np.arange(SPRINGS),
        owner,
        np.full(count, start),
        np.tile(bounds, (count, 1)),
        np.eye(count),
        arc_length=along,
    )
    parameters = Parameterisation((group,))
    reference = np.zeros((SPRINGS, 3))
    reference[:, :2] = [1e3, 1.0]
    frf = port_model(dense_ports(model, s, reference), parameters)
    return Misfit(frf, frf.frf(np.full(count, truth)), parameters.initial, eta)
