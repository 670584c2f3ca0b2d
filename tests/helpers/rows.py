"""Two rows of masses and springs that joints tie together, as the model and as the structure of a test of causes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import scipy.sparse as sp
from looking import seen

from lrbc_cli.campaign.looking.causes.parts import part_text
from lrbc_cli.campaign.looking.states import Seen
from lrbc_cli.model.dofs import DofTable
from lrbc_cli.model.factors import make_recipe
from lrbc_cli.model.fem import FeModel
from lrbc_cli.model.terms import LowRankTerms

#: Masses of each of two rows, joined by the springs of three bolts.
COUNT = 40
HZ = np.linspace(10.0, 400.0, 150)


def assembly(mass: float = 1.0, stiffness: float = 1.0, *, joined: bool = False, first: float = 1.0) -> FeModel:
    """Two rows of masses and springs; factors on those of the second, and on the ``first`` masses.

    ``joined``: by a spring of the matrix, too, as one part.
    """
    n, blocks = 2 * COUNT, []
    for factor in (1.0, stiffness):
        row = np.diag(np.full(COUNT, 2.0)) - np.eye(COUNT, k=1) - np.eye(COUNT, k=-1)
        row[0, 0] = row[-1, -1] = 1.0
        blocks.append(4e7 * factor * row)
    K = sp.lil_array(sp.block_diag(blocks))
    if joined:
        for i, j, sign in ((0, 0, 1.0), (COUNT, COUNT, 1.0), (0, COUNT, -1.0), (COUNT, 0, -1.0)):
            K[i, j] = K[i, j] + 1e3 * sign
    left = np.zeros((n, 3))
    for term, (a, b) in enumerate(((0, COUNT + 30), (15, COUNT + 5), (39, COUNT + 38))):
        left[a, term], left[b, term] = 1.0, -1.0
    bolts = sp.csc_array(left)
    terms = LowRankTerms(left=bolts, right=bolts, power=np.zeros(3, dtype=np.int64), baseline=np.zeros(3))
    M = np.repeat([0.4 * first, 0.4 * mass], COUNT)
    at = [3, 22, COUNT + 9, COUNT + 27]
    outputs = sp.csc_array((np.ones(4), (np.arange(4), at)), (4, n))
    loads = sp.csc_array((np.ones(1), ([8], [0])), (n, 1))
    return FeModel(
        K=sp.csc_array(K),
        C=sp.csc_array(2e-5 * K),
        M=sp.csc_array(sp.diags_array(M)),
        B=loads,
        L=outputs,
        output_power=np.full(4, 2),
        is_acoustic=np.zeros(n, dtype=bool),
        terms=terms,
    )


def frf(model: FeModel, springs: np.ndarray) -> np.ndarray:
    left, found = model.terms.left.toarray(), []
    for s in 2j * np.pi * HZ:
        Z = (model.K + s * model.C + s**2 * model.M).toarray() + left * springs @ left.T
        found.append(s**2 * (model.L @ np.linalg.solve(Z, model.B.toarray()))[:, 0])
    return np.array(found)


def told(given: FeModel, true: FeModel, cause: Callable[[Seen, float], str] = part_text, *, air: bool = False, **given_as: Any) -> str:
    springs = np.array([3e6, 1e6, 2e6])
    dofs = DofTable(
        node=np.arange(2 * COUNT),
        component=np.full(2 * COUNT, "UX"),
        xyz=np.stack([np.tile(np.linspace(0.0, 0.8, COUNT), 2), np.repeat([0.0, 0.1], COUNT), np.zeros(2 * COUNT)], axis=1),
    )
    metres = SimpleNamespace(length=1.0, length_name="m")
    campaign = SimpleNamespace(reduction=SimpleNamespace(band=(10.0, 400.0), backend="superlu"), unit_system=metres)
    if air:
        # Said to be a pressure, for want of a smaller model of both.
        given = replace(given, is_acoustic=np.arange(2 * COUNT) == 2 * COUNT - 1)
    inputs: Any = SimpleNamespace(
        responses=[],
        model=given,
        dofs=dofs,
        campaign=campaign,
        input_of=np.zeros(4, dtype=np.int64),
        recipe=make_recipe(**{"damping": None, "acoustic": False} | given_as),
    )
    initial = np.log10(springs)
    parameters = SimpleNamespace(initial=initial, dynamic=lambda theta, s: np.tile(10.0**theta + 0j, (len(s), 1)))
    source = SimpleNamespace(inputs=inputs, known={b"work": 1.0})
    job = seen(frf(true, springs), frf(given, springs)[None], hz=HZ, source=source, parameters=parameters)
    return cause(job, job.misfit)


@dataclass(frozen=True)
class InputsAlone:
    model: FeModel
    campaign: Any
    recipe: Any
    dofs: Any = None
