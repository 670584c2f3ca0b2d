"""Coordinates of structural nodes in another order than the matrices, beside a cavity; coupling blocks of the wrong sign."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp
from helpers.systems import duct
from looking import seen

from lrbc_cli.campaign.looking.causes.rescaled import air_text
from lrbc_cli.campaign.reading.doubts.coupled import coupled_doubt, opposed_text, uncoupled_doubt
from lrbc_cli.campaign.reading.doubts.numbering import numbering_doubts
from lrbc_cli.model.dofs import DofTable
from lrbc_cli.model.fem import FeModel
from lrbc_cli.model.terms import LowRankTerms

COUNT = 40
ROW = 0.05 * np.arange(COUNT)
PLATE = np.column_stack([ROW, np.zeros((COUNT, 2))])
NODE = np.concatenate([np.arange(COUNT), np.arange(COUNT)])
COMPONENT = np.repeat(["UZ", "PRES"], COUNT)


def told(structure: np.ndarray) -> str | None:
    """A row of plate nodes, each coupled to the air node above it."""
    entries = np.ones(COUNT), (np.arange(COUNT), COUNT + np.arange(COUNT))
    K = sp.csc_array(entries, (2 * COUNT, 2 * COUNT))
    dofs = DofTable(node=NODE, component=COMPONENT, xyz=np.concatenate([structure, PLATE + np.array([0.0, 0.0, 0.01])]))
    return coupled_doubt(K, sp.csc_array(K.T), dofs, "dofs.csv")


def test_structure_and_air_lie_at_the_same_places() -> None:
    assert told(PLATE) is None


def test_structural_nodes_in_reverse_order() -> None:
    text = str(told(PLATE[::-1]))
    assert "these couple structure and air at DOFs that are 1 m apart in dofs.csv (median, node spacing 0.05 m)" in text
    assert "With the structural nodes in reverse order it is 0.01 m" in text


def test_structural_nodes_in_any_other_order() -> None:
    text = str(told(np.random.default_rng(0).permutation(PLATE)))
    assert "Export matrices and DOF table of one model in one run" in text
    assert "reverse order" not in text


def test_without_air_there_is_nothing_to_compare() -> None:
    dofs = DofTable(node=np.arange(3), component=np.full(3, "UZ"), xyz=np.eye(3))
    assert coupled_doubt(sp.csc_array(np.eye(3)), sp.csc_array(np.eye(3)), dofs, "dofs.csv") is None


def surface(coupled: int, *, above: float = 0.0) -> str | None:
    """A row of plate nodes on air, of which the first ones are coupled; the others lie above it."""
    entries = np.ones(coupled), (np.arange(coupled), COUNT + np.arange(coupled))
    K = sp.csc_array(entries, (2 * COUNT, 2 * COUNT))
    structure = PLATE + np.outer(np.arange(COUNT) >= coupled, [0.0, 0.0, above])
    dofs = DofTable(node=NODE, component=COMPONENT, xyz=np.concatenate([structure, PLATE]))
    return uncoupled_doubt(K, sp.csc_array(K.T), dofs)


def test_a_coupling_surface_that_ends_early() -> None:
    assert surface(COUNT) is None
    assert surface(COUNT - 2) is None
    text = str(surface(25))
    assert text.startswith("15 structural nodes lie as near to the air as the 25 that the matrices couple to it, but are not coupled")
    assert "x from 1.25 to 1.95 m" in text
    # Dry nodes lie farther away.
    assert surface(25, above=0.02) is None


def coupled(left: tuple[float, float], right: tuple[float, float], mass: float = 1.0) -> FeModel:
    """A chain beside a duct; rows and columns of both fields (structure, air) times these, and the coupling block of the mass."""
    K, M, air = duct(6, 12, 1.2)
    rows, columns = (sp.diags_array(np.where(air, each[1], each[0])) for each in (left, right))
    M = M.tolil()
    M[np.ix_(air, ~air)] *= mass
    K, M = (sp.csc_array(rows @ matrix.tocsc() @ columns) for matrix in (K, M))
    none = sp.csc_array((air.size, 0))
    terms = LowRankTerms(left=none, right=none, power=np.zeros(0, dtype=np.int64), baseline=np.zeros(0))
    B = sp.csc_array((air.size, 1))
    return FeModel(
        K=K, C=sp.csc_array(K.shape), M=M, B=B, L=sp.csc_array(B.T), output_power=np.zeros(1, dtype=np.int64), is_acoustic=air, terms=terms
    )


#: Signs and scales of the rows and columns of both fields: conventions of pressures, of equations, and units.
CONVENTIONS = [
    ((1.0, 1.0), (1.0, 1.0)),
    ((1.0, -1.0), (1.0, -1.0)),
    ((1.0, -1.0), (1.0, 1.0)),
    ((1.0, 1.0), (1.0, -1.0)),
    ((-1.0, 1.0), (1.0, 1.0)),
    ((1.0, 1e3), (1.0, 1e-6)),
]


@pytest.mark.parametrize(("left", "right"), CONVENTIONS)
def test_coupling_that_adds_energy(left: tuple[float, float], right: tuple[float, float]) -> None:
    """Whatever the convention, one block of the wrong sign makes resonances unstable, and right ones do not."""
    assert opposed_text(coupled(left, right)) is None
    text = str(opposed_text(coupled(left, right, mass=-1.0)))
    assert "structure and air gain energy from their coupling" in text
    assert "Reverse the sign of the block in the mass matrix (the normals of the faces there) in the FE model" in text


@pytest.mark.parametrize("mass", [1.0, -1.0])
def test_frequencies_show_which_sign_conserves_energy(mass: float) -> None:
    """The frequencies of the whole model: real for the one sign only, once the coupling is strong."""
    model = coupled((1.0, 1.0), (1.0, 1.0), mass)
    K, M = model.K.toarray(), model.M.toarray()
    air = model.is_acoustic
    K[np.ix_(~air, air)] *= 50.0
    M[np.ix_(air, ~air)] *= 50.0
    squared = np.linalg.eigvals(np.linalg.solve(M, K))
    assert (np.abs(squared.imag).max() < 1e-6 * np.abs(squared).max()) == (mass > 0.0)


def test_coupling_in_the_mass_alone_is_no_other_numbering() -> None:
    """The stiffness couples the other way, or was exported without its coupling, of which another warning tells."""
    K, M, air = duct(150, 151, 1.2)
    K = sp.csc_array(sp.block_diag([K[:150, :150], K[150:, 150:]]))
    none = sp.csc_array((air.size, 0))
    model = FeModel(
        K=K, C=sp.csc_array(K.shape), M=M, B=none, L=sp.csc_array(none.T), output_power=np.zeros(0, dtype=np.int64), is_acoustic=air,
        terms=LowRankTerms(left=none, right=none, power=np.zeros(0, dtype=np.int64), baseline=np.zeros(0)),
    )  # fmt: skip
    assert list(numbering_doubts(model, None)) == []
    order = np.random.default_rng(1).permutation(air.size)
    (text,) = numbering_doubts(replace(model, M=sp.csc_array(M[order][:, order]), is_acoustic=air[order]), None)
    assert text.startswith("model.mass: the mass matrix connects nodes that the stiffness matrix does not")


@pytest.mark.parametrize(
    ("density", "said"),
    [
        (10.0, "the density of the air in the model is probably 10 times too large: corrected, the level misfit falls from "),
        (1e-3, "the density of the air in the model is probably 1000 times too small: corrected"),
        (1.05, ""),
        (3.0, ""),
    ],
)
def test_the_density_of_the_air(density: float, said: str) -> None:
    """Of a chain of masses on the flank of a duct, the density given over the true one."""
    hz, (K, M, air) = np.linspace(20.0, 400.0, 60), duct(12, 30, 1.2, coupling=0.2)
    own = sp.diags_array(air.astype(float))
    heard, none = np.flatnonzero(air)[[3, 20]], sp.csc_array((air.size, 0))
    L = sp.csc_array((np.ones(6), (np.arange(6), [2, 5, 8, 11, *heard])), (6, air.size))

    def of(ratio: float) -> FeModel:
        lighter = [sp.csc_array(matrix + (1.0 / ratio - 1.0) * (own @ matrix @ own)) for matrix in (K, M)]
        return FeModel(
            K=lighter[0],
            C=sp.csc_array(2e-5 * lighter[0]),
            M=lighter[1],
            B=sp.csc_array((np.ones(1), ([4], [0])), (air.size, 1)),
            L=L,
            output_power=np.array([2, 2, 2, 2, 0, 0]),
            is_acoustic=air,
            terms=LowRankTerms(left=none, right=none, power=np.zeros(0, dtype=np.int64), baseline=np.zeros(0)),
        )

    def frf(model: FeModel) -> np.ndarray:
        s = 2j * np.pi * hz
        solved = [np.linalg.solve((model.K + at * model.C + at**2 * model.M).toarray(), model.B.toarray()[:, 0]) for at in s]
        return np.array([at**model.output_power * (model.L @ x) for at, x in zip(s, solved, strict=True)])

    given = of(density)
    campaign = SimpleNamespace(reduction=SimpleNamespace(band=(10.0, 420.0), backend="superlu"))
    inputs: Any = SimpleNamespace(model=given, campaign=campaign, input_of=np.zeros(6, dtype=np.int64))
    parameters = SimpleNamespace(initial=np.zeros(0), dynamic=lambda _, s: np.zeros((len(s), 0), dtype=complex))
    source = SimpleNamespace(inputs=inputs, known={b"work": 1.0})
    job = seen(frf(of(1.0)), frf(given)[None], hz=hz, source=source, parameters=parameters)
    text = air_text(job, job.misfit)
    assert text.startswith(said)
    assert bool(text) == bool(said)


def test_coupling_one_way_is_no_matter_of_signs() -> None:
    assert opposed_text(coupled((1.0, 1.0), (1.0, 1.0), mass=0.0)) is None
