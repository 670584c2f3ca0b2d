"""The SoundBox on other meshes: its equations, its size, and frequencies that converge to those of the sample."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import scipy.sparse as sp

pytest.importorskip("skfem")

from lrbc_cli.campaign.reading.inputs import read_as_exported
from lrbc_cli.config import load_campaign
from lrbc_cli.model.coupling import coupling_of
from rigs.coupled import factorise, lowest_modes
from rigs.design import EDGES, Design
from rigs.designs import SOUNDBOX
from rigs.nominal import Model, build, point_load
from rigs.refine import Terms, refined, scaled, size, write_model, write_refined

pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning")

ROOT = Path(__file__).parents[2]


def frequencies(model: Model) -> tuple[np.ndarray, np.ndarray]:
    """First uncoupled frequencies of plate and air [Hz]."""
    n, out = model.structure_size, []
    for part, count, shift in ((slice(None, n), 5, 0.0), (slice(n, None), 6, -1e4)):
        K, M = model.stiffness[part, part], model.mass[part, part]
        values = lowest_modes(K, M, count, shift, factorise(K - shift * M))[0]
        out.append(np.sqrt(np.maximum(values, 0.0)) / (2 * np.pi))
    return out[0], out[1][1:]


def test_frequencies_converge_to_those_of_the_sample() -> None:
    exact = frequencies(build(SOUNDBOX))
    errors = []
    for factor in (0.4, 0.7):
        found = frequencies(build(scaled(SOUNDBOX, factor)))
        errors.append([np.abs(f / e - 1).max() for f, e in zip(found, exact, strict=True)])
    coarse, fine = np.array(errors)
    # The plate has enough elements on every mesh; the air does not.
    assert fine[0] < 1e-4
    assert fine[1] < 2e-3
    assert fine[1] < 0.4 * coarse[1]


@pytest.mark.parametrize("dofs", [10_000, 20_000, 50_000, 100_000, 250_000])
def test_meshes_of_any_size(dofs: int) -> None:
    design = refined(SOUNDBOX, dofs)
    assert size(design) == pytest.approx(dofs, rel=0.02)
    np.testing.assert_allclose(design.plate_end, SOUNDBOX.plate_end, rtol=1e-12)
    with pytest.raises(ValueError, match="no mesh of about 100 DOFs"):
        refined(SOUNDBOX, 100)


def test_the_sample_is_one_of_them() -> None:
    assert scaled(SOUNDBOX, 1.0) == SOUNDBOX
    assert size(SOUNDBOX) == 21_107


def small(terms: Terms) -> Design:
    return terms.support(refined(SOUNDBOX, 8_000))


def test_model_is_coupled_and_has_its_size() -> None:
    design = small(Terms(("left", "right"), 40))
    model = build(design)
    n, acoustic = model.structure_size, model.component == "PRES"
    assert model.mass.shape[0] == size(design) == model.node.size
    found = coupling_of(model.stiffness.tocsc(), sp.csc_array(model.mass.shape), model.mass.tocsc(), acoustic)
    assert found.symmetric
    assert found.kappa == pytest.approx(1.0)
    # A constant pressure stores no energy, and pushes with the area of the plate on a deflection of one.
    assert np.abs(model.stiffness[n:, n:].sum(axis=1)).max() == 0.0
    for xyz in design.microphones.values():
        assert np.linalg.norm(model.xyz[acoustic] - xyz, axis=1).min() < 1e-9


def test_pressure_on_the_plate_is_integrated_exactly() -> None:
    """Pressure 1, x and y² on shape functions of a node inside: integrals of cubic Hermite functions by hand."""
    design = small(Terms())
    model = build(design)
    n, (hx, hy) = model.structure_size, design.plate_step
    coupling = model.stiffness[:n, n:]
    x, y, _ = model.xyz[n:].T
    at = np.flatnonzero(model.component[:n] == "UZ")[77]
    px, py = model.xyz[at, :2]
    # Moments of a cubic hat of half width h: area h, second moment 2 h³ / 15.
    for pressure, expected in ((np.ones_like(x), hx * hy), (x, hx * hy * px), (y**2, hx * hy * py**2 + hx * 2 * hy**3 / 15)):
        assert (coupling @ pressure)[at] == pytest.approx(expected, rel=1e-6)


def test_load_between_nodes() -> None:
    design = small(Terms())
    model = build(design)
    n = model.structure_size
    at = np.flatnonzero(model.component[:n] == "UZ")[50]
    expected = np.zeros(n)
    expected[at] = 1.0
    np.testing.assert_allclose(point_load(design, *model.xyz[at, :2]).toarray()[:, 0], expected, atol=1e-12)
    # A cubic deflection and its slopes are met exactly at any point.
    x, y, _ = model.xyz[:n].T
    w = {"UZ": x**3 * y**2, "ROTX": 2 * x**3 * y, "ROTY": -3 * x**2 * y**2, "TWIST": 6 * x**2 * y}
    field = np.choose([list(w).index(c) for c in model.component[:n]], list(w.values()))
    hammer = design.hammer
    assert field @ point_load(design, *hammer).toarray()[:, 0] == pytest.approx(hammer[0] ** 3 * hammer[1] ** 2, rel=1e-9)


def test_terms_are_spread_over_the_edges() -> None:
    terms = Terms(("left", "right"), 20)
    design = small(terms)
    model = build(design)
    found = terms.select(design, model)
    assert {edge: dofs.size for edge, dofs in found.items()} == {"left": 10, "right": 10}
    for edge, x in (("left", design.plate_origin[0]), ("right", design.plate_end[0])):
        np.testing.assert_allclose(model.xyz[found[edge], 0], x)
        assert set(model.component[found[edge]]) == {"ROTY"}
        assert np.all(np.diff(model.xyz[found[edge], 1]) > 0)
    with pytest.raises(ValueError, match="rotations, not 100000"):
        Terms(("left",), 100_000).select(design, model)


def test_more_terms_than_an_edge_has_across() -> None:
    terms = Terms(EDGES, 500)
    design = small(terms)
    assert design.held_at_nodes
    model = build(design)
    dofs = np.concatenate(list(terms.select(design, model).values()))
    assert np.unique(dofs).size == 500
    assert set(model.component[dofs]) == {"ROTX", "ROTY"}
    assert size(design) > size(small(Terms(EDGES, 10)))


def test_campaign_is_read(tmp_path: Path) -> None:
    terms = Terms(("left", "bottom"), 12)
    design = small(terms)
    model = write_model(design, tmp_path)
    frf = ROOT / "data_samples" / "soundbox" / "frf"
    path = write_refined(design, model, terms, tmp_path, frf, {"bolts-00": [], "bolts-04": ["B08"]}, "campaign")
    inputs = read_as_exported(load_campaign(path))
    assert inputs.warnings == ()
    assert inputs.model.size == size(design)
    assert inputs.model.terms.size == 12
    assert [group.name for group in inputs.groups] == ["left_edge", "bottom_edge"]
    # The load stands on the plate and pushes along +z with one newton.
    rigid = (inputs.dofs.component == "UZ").astype(float)
    assert (rigid @ inputs.model.B.toarray())[0] == pytest.approx(1.0)


def test_command(tmp_path: Path) -> None:
    command = [sys.executable, str(ROOT / "data_samples" / "soundbox" / "generate" / "refined.py"), "--out", str(tmp_path)]
    done = subprocess.run([*command, "--dofs", "8000", "--terms", "10"], capture_output=True, text=True, check=True)
    assert "terms 10" in done.stdout
    assert (tmp_path / "campaign.yaml").is_file()
    for wrong, text in (
        (["--edges", "north"], "is not 'all'"),
        (["--dofs", "9"], "no mesh"),
    ):
        failed = subprocess.run([*command, "--dofs", "8000", *wrong], capture_output=True, text=True, check=False)
        assert failed.returncode == 2
        assert text in failed.stderr
