"""All points of hammer and sensors moved or mirrored in the same way, by all FRFs at once."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scipy.sparse as sp
from looking import seen
from samples import reduced_cache, sample

from lrbc_cli.campaign.identification.unknowns import parameterise
from lrbc_cli.campaign.looking.causes.together import together_text
from lrbc_cli.campaign.reduced.stage import FrfSource, obtain_reduction
from lrbc_cli.model.selection import nearest
from lrbc_cli.reduction.problem.full import full_ports

HZ = np.arange(40.0, 500.0, 6.0)
S = 2j * np.pi * HZ


def told(signs: tuple[int, int], shift: tuple[float, float], error_db: float = 1.0, *, hammer: bool = False) -> str:
    """The text if sensors, and the hammer, were at their stated places times ``signs`` plus ``shift``."""
    inputs = sample("frame")
    source = FrfSource(inputs=inputs, stage=obtain_reduction(inputs, reduced_cache("frame")), kind="port")
    parameters, dofs = parameterise(inputs, source, S)[0], inputs.dofs

    def there(dof: int) -> int:
        place = dofs.xyz[dof] * [*signs, 1.0] + [*shift, 0.0]
        return nearest(dofs, place.tolist(), str(dofs.component[dof]))[0]

    # Two of the sensors have interpolated rows; here they are at nodes.
    L = inputs.model.L.tolil()
    for row, place in ((2, [0.2, 0.16, 0.0]), (3, [0.28, 0.08, 0.0])):
        L[row, :] = 0.0
        L[row, nearest(dofs, place, "UZ")[0]] = 1.0
    model = replace(inputs.model, L=sp.csc_array(L), extras={})
    inputs = replace(inputs, model=model)
    at = [there(int(row.indices[0])) for row in (model.L.tocsr()[[i]] for i in range(model.L.shape[0]))]
    moved = replace(model, L=sp.csc_array((np.ones(len(at)), (np.arange(len(at)), at)), model.L.shape), extras={})
    if hammer:
        struck = there(int(model.B.tocsc().indices[0]))
        moved = replace(moved, B=sp.csc_array(([1.0], ([struck], [0])), model.B.shape))
    dynamic = parameters.dynamic(parameters.initial, S)
    stated, measured = (full_ports(each, inputs.input_of, S, (40.0, 500.0)).evaluate(dynamic) for each in (model, moved))
    measured = measured * 10.0 ** (np.random.default_rng(7).normal(0.0, error_db, measured.shape) / 20.0)
    return together_text(seen(measured, stated[None], hz=HZ, inputs=inputs, parameters=parameters))


def test_right_places_are_left_alone() -> None:
    assert told((1, 1), (0.0, 0.0)) == ""
    assert told((1, 1), (0.0, 0.0), 5.0) == ""


@pytest.mark.slow
def test_points_from_another_origin() -> None:
    """A mesh width off, all of them lie at nodes."""
    xyz = sample("frame").dofs.xyz
    width = float(np.diff(np.unique(xyz[:, 0].round(6))).min())
    both = told((1, 1), (width, width), hammer=True)
    assert "hammer and sensors are probably stated from another origin" in both
    assert f"with ({width:g}, {width:g}, 0) added" in both
    assert told((1, 1), (width, width)).startswith("all sensors are probably stated")


@pytest.mark.slow
def test_sensors_from_the_other_side() -> None:
    ends = np.ptp(sample("frame").dofs.xyz[:, 0])
    text = told((-1, 1), (ends, 0.0))
    assert "all sensors are probably stated with x counted from the other side" in text
    assert "mirrored variant" not in text
    # With the hammer, too, the model may as well be that of the other hand.
    text = told((-1, 1), (ends, 0.0), hammer=True)
    assert "if their places are right, the model is the mirrored variant, and the bolts are wrong, too" in text
