"""Checks that each response is connected with its excitation, and that the band overlaps the frequencies of the model."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.sparse.csgraph import connected_components

from lrbc_cli.campaign.reading.doubts.coupled import joined_by_terms, one_way
from lrbc_cli.campaign.reading.places import frequencies_doubt
from lrbc_cli.config import Campaign
from lrbc_cli.errors import ConfigError, DataError
from lrbc_cli.model.dofs import DofTable
from lrbc_cli.model.fem import FeModel
from lrbc_cli.reduction.problem.vectors import highest_omega

#: Largest ratio of the end of the band to the highest frequency of the mesh.
BEYOND = 10.0


def parts_of(model: FeModel, *, joined: bool = True, rounding: float = 1e-12) -> NDArray[np.int64]:
    """(n,) number of the connected part to which each DOF belongs; entries of matrices and, if ``joined``, terms connect DOFs.

    ``rounding``: entry of the stiffness matrix, relative to those on its diagonal, up to which it is what a baseline that was subtracted
    leaves, and connects none.
    """
    part, diagonal = np.arange(model.size), np.sqrt(np.abs(model.K.diagonal()))
    # A term connects all DOFs of its two vectors.
    terms = sp.vstack([model.terms.left, model.terms.right], format="csc")
    # One matrix after the other, so that later ones need not join what is joined already.
    through = [(terms, _first_rows(terms) % model.size)] if joined else []
    for matrix, column in ((model.K, None), (model.C, None), (model.M, None), *through):
        row = part[matrix.indices % model.size]
        col = part[np.repeat(np.arange(model.size) if column is None else column, np.diff(matrix.indptr))]
        joins = (row != col) & (matrix.data != 0)
        if matrix is model.K:
            joins &= np.abs(matrix.data) > rounding * np.repeat(diagonal, np.diff(matrix.indptr)) * diagonal[matrix.indices]
        if joins.any():
            count = int(part.max()) + 1
            links = sp.csr_array((np.ones(int(joins.sum()), dtype=bool), (row[joins], col[joins])), shape=(count, count))
            part = np.asarray(connected_components(links, directed=False)[1], dtype=np.int64)[part]
    return part


def _first_rows(matrix: sp.csc_array) -> NDArray[np.int64]:
    """Row of the first entry of each column, 0 if it is empty."""
    first = np.zeros(matrix.shape[1], dtype=np.int64)
    some = np.diff(matrix.indptr) > 0
    first[some] = matrix.indices[matrix.indptr[:-1][some]]
    return first


def require_reach(
    model: FeModel, responses: Sequence[tuple[str, int]], excitations: Sequence[str], dofs: DofTable | None, misplaced: str = ""
) -> None:
    """Refuse a response that is not connected with its excitation: its FRF is zero for all parameters.

    Parameters
    ----------
    model : FeModel
    responses : sequence of (str, int)
        Name of each response, and number of its excitation.
    excitations : sequence of str
        Names.
    dofs : DofTable or None
    misplaced : str
        Doubt about the DOF table, which is the likely cause; may be empty.

    Raises
    ------
    DataError
    """
    part, deaf = parts_of(model), one_way(model)
    for i, (name, at) in enumerate(responses):
        heard, hit = model.L[[i]].tocoo().col, model.B[:, [at]].tocoo().row
        zero = f"the FRF of response {name} to excitation {excitations[at]} is zero"
        if deaf is not None and np.all(model.is_acoustic[heard] == deaf[0]) and np.all(model.is_acoustic[hit] != deaf[0]):
            raise DataError(
                f"{zero}: structure and air are coupled one way only",
                expected="coupling blocks in the rows of displacements and of pressures, one in the stiffness and one in the mass matrix",
                found=deaf[1],
                hint=f"export the {deaf[2]} matrix with the coupling",
            )
        if np.isin(part[heard], part[hit]).any():
            continue
        if np.unique(model.is_acoustic[[*heard, *hit]]).size > 1 and not _coupled(model):
            raise DataError(
                f"{zero}: no entry of the matrices couples structure and air",
                expected="coupling blocks between displacements and pressures, in the stiffness and in the mass matrix",
                found="none",
                hint="define the interface of structure and fluid in the FE model, and export the matrices of the coupled model",
            )
        if dofs is not None and set.intersection(*(set(dofs.node[np.isin(part, part[rows])].tolist()) for rows in (heard, hit))):
            raise DataError(
                f"{zero}: it and the hammer act along directions that nothing couples, in parts of the mesh that have nodes in common",
                expected="a model in which every response answers to its hammer",
                found="a plane or straight structure, whose motions in its plane and out of it are independent",
                hint=misplaced
                or "correct the component of the response or of the hammer; or let the model contain what couples them (an eccentric mass, "
                "an inclined support), or leave the response out at this hammer point. If the structure is none of these, the DOF table is "
                "not in the order of the matrices",
            )
        grounded = int((np.diff(model.terms.left.indptr) == 1).sum())
        ground = f"{grounded} of {model.terms.size} springs go to ground: where they join two parts, give node_b. " if grounded else ""
        place = f"{ground}{'Otherwise correct' if ground else 'correct'} the place of the response"
        fix = f"{place}, or export the parts merged or tied. If the mesh is in one piece, the DOF table is not in the order of the matrices"
        raise DataError(
            f"{zero}: nothing in the matrices connects them",
            expected="a model in one piece",
            found=f"{int(part.max()) + 1} separate pieces",
            hint=misplaced or fix,
        )


def _coupled(model: FeModel) -> bool:
    """Whether an entry of the matrices or a term couples structure and air."""
    air = model.is_acoustic
    entries = [matrix.tocoo() for matrix in (model.K, model.M, model.C)]
    return joined_by_terms(model) or any(np.any(each.data[air[each.row] != air[each.col]]) for each in entries)


def require_frequencies(model: FeModel, campaign: Campaign, dofs: DofTable | None) -> None:
    """Refuse a band that ends far above all frequencies of the mesh.

    Raises
    ------
    ConfigError
        If the band is probably wrong.
    DataError
        If wave speed and density of the mesh show that a matrix is wrong instead.
    """
    highest = highest_omega(model.K, model.M) / (2.0 * np.pi)
    band = campaign.reduction.band
    if band[1] > BEYOND * highest:
        likely = None if dofs is None else frequencies_doubt(model.K.real, model.M, dofs, campaign)
        if likely is not None:
            raise DataError(
                "all frequencies of the model lie far below the band",
                file=campaign.model.mass.path,
                place="model.mass and model.stiffness",
                expected=f"frequencies in the band up to {band[1]:g} Hz",
                found=f"none above {highest:.3g} Hz",
                hint=likely,
            )
        raise ConfigError(
            "the band ends far above every frequency of the model",
            file=campaign.path,
            place="reduction.band",
            expected=f"an upper end of at most {BEYOND * highest:.3g} Hz",
            found=f"{band[1]:g} Hz",
            hint="end the band where the measurement ends. Check that it is in Hz and the matrices are in SI units",
        )
