"""Deflection shapes: those of the full model, from the basis beside the reduced model; without it there are none, and a line says so."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from campaigns import Folder, finished

from lrbc_cli.campaign.identification.identify import identify
from lrbc_cli.campaign.reduced import cache
from lrbc_cli.campaign.reduced.stage import frf_source, obtain_reduction, with_rows
from lrbc_cli.campaign.structure import drawn_dofs, structure_of
from lrbc_cli.campaign.updated.shapes import displacements, shapes_of
from lrbc_cli.errors import DataError
from lrbc_cli.results.shapes import ShapesRecord
from lrbc_cli.results.store import read


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> Folder:
    return finished("frame").copy(tmp_path_factory.mktemp("shapes") / "frame")


@pytest.fixture(scope="module")
def found(done: Folder) -> tuple[Any, Any, Any]:
    inputs = done.inputs()
    stage, lacking = with_rows(inputs, obtain_reduction(inputs, done.cache))
    assert lacking == ""
    return inputs, stage, identify(inputs, frf_source(inputs, stage), next(iter(inputs.campaign.jobs)))


def test_shapes_are_those_of_the_full_model(found: tuple[Any, Any, Any]) -> None:
    inputs, stage, result = found
    record = shapes_of(inputs, stage, result)
    assert record is not None
    assert 3 <= len(record.shapes) <= 6
    dofs, m = drawn_dofs(inputs), inputs.model
    (plate,) = structure_of(inputs).fields
    # Each row of the record is the node of the picture.
    node, axis = np.nonzero(dofs >= 0)
    np.testing.assert_allclose(inputs.dofs.xyz[dofs[node, axis]], plate.xyz[node], atol=1e-6)
    assert (inputs.dofs.component[dofs[node, axis]] == np.array(["UX", "UY", "UZ"])[axis]).all()
    left, right = m.terms.left.toarray(), m.terms.right.toarray()
    s = 2j * np.pi * np.array([shape.frequency_hz for shape in record.shapes])
    D = result.parameters.dynamic(result.solution.theta, s)
    reduced = displacements(inputs, stage, result, s, 0)
    for k, shape in enumerate(record.shapes):
        Z = (m.K + s[k] * m.C + s[k] ** 2 * m.M).toarray() + (left * D[k]) @ right.T
        x = np.linalg.solve(Z, m.B.toarray()[:, 0])
        full = np.where(dofs >= 0, x[dofs], 0.0).ravel()
        size = np.abs(full).max()
        assert np.abs(reduced[k] - full[dofs.ravel() >= 0]).max() < inputs.campaign.reduction.tolerance * size
        drawn = (shape.real + 1j * shape.imag) * shape.largest
        turn = np.vdot(drawn, full) / np.vdot(drawn, drawn)
        np.testing.assert_allclose(abs(turn), 1.0, atol=0.003)
        np.testing.assert_allclose(drawn * turn, full, atol=0.003 * size)


def test_measured_points_stand_beside_the_model(found: tuple[Any, Any, Any]) -> None:
    inputs, stage, result = found
    record = shapes_of(inputs, stage, result)
    assert record is not None
    assert record.responses == tuple(response.name for response in inputs.responses)
    f, measured = result.measurement.frequency_hz, result.measurement.values
    for shape in record.shapes:
        line = int(np.flatnonzero(f == shape.frequency_hz)[0])
        # Accelerances here: one factor, complex, leads from the record to the FRFs of measurement and model.
        scale = -((2 * np.pi * f[line]) ** 2) * shape.largest
        for name, values in (("measured", measured[line]), ("modelled", result.updated[line])):
            own = getattr(shape, f"{name}_real") + 1j * getattr(shape, f"{name}_imag")
            np.testing.assert_allclose(np.abs(own * scale), np.abs(values), atol=0.001 * abs(scale))
        assert 0.7 < shape.cosine <= 1.0
        # What the sensor shows is what the picture does where it sits.
        sensor = structure_of(inputs).responses[0]
        near = int(np.argmin(np.linalg.norm(structure_of(inputs).fields[0].xyz - sensor.position, axis=1)))
        there = (shape.real + 1j * shape.imag).reshape(-1, 3)[near] @ sensor.direction
        assert abs(there - (shape.modelled_real[0] + 1j * shape.modelled_imag[0])) < 0.02


def test_without_the_basis_there_are_no_shapes_and_no_error(found: tuple[Any, Any, Any], done: Folder, tmp_path: Path) -> None:
    inputs, stage, result = found
    assert shapes_of(inputs, replace(stage, rows=None), result) is None
    assert shapes_of(inputs, None, result) is None
    folder = done.copy(tmp_path / "frame")
    stage = obtain_reduction(inputs, folder.cache)
    file, dofs = stage.decision.path.with_name("rows.h5"), drawn_dofs(inputs)
    content = file.read_bytes()
    file.write_bytes(content[:-40] + bytes(40))
    assert "damaged" in with_rows(inputs, stage)[1]
    file.write_bytes(content)
    # Of a model that was built anew, or at other nodes.
    other = replace(stage.reduction, model=replace(stage.reduction.model, B=2.0 * stage.reduction.model.B))
    assert "another model" in cache.load_rows(stage.decision, other, dofs[dofs >= 0])[1]
    assert "another model" in cache.load_rows(stage.decision, stage.reduction, dofs[dofs >= 0][1:])[1]


@pytest.mark.parametrize("damage", ["missing", "damaged"])
def test_a_basis_that_was_lost_is_built_anew(done: Folder, tmp_path: Path, damage: str) -> None:
    """Otherwise jobs identified without it stay without shapes for good."""
    folder = done.copy(tmp_path / "frame")
    (file,) = folder.cache.glob("*/rows.h5")
    if damage == "missing":
        file.unlink()
    else:
        file.write_bytes(file.read_bytes()[:-40] + bytes(40))
    job = next(iter(folder.tree()["jobs"]))
    outcome = folder.run("update", "--job", job, "--force")
    assert outcome.code == 0
    assert outcome.stderr.count("the cached reduced model is built anew") == 1
    assert "no deflection shapes" not in outcome.stderr
    assert "shapes.json" in folder.result(job)["provenance"]["files"]
    assert "built anew" not in folder.run("update", "--job", job, "--force").stderr


def test_the_record_is_checked(done: Folder, tmp_path: Path) -> None:
    job = next(iter(done.inputs().campaign.jobs))
    assert "shapes.json" in done.result(job)["provenance"]["files"]
    record = read(done.out / job / "shapes.json", ShapesRecord)
    assert record is not None
    assert (done.out / job / "shapes.json").stat().st_size < 100_000
    tree = record.tree()
    tree["shapes"][1]["real"] = tree["shapes"][1]["real"][1:]
    (tmp_path / "shapes.json").write_text(json.dumps(tree))
    with pytest.raises(DataError, match=r"shapes\[1\].real(.|\n)*324 values"):
        read(tmp_path / "shapes.json", ShapesRecord)
