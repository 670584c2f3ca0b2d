"""Gathers the tests of DOF table and matrices against each other: units, order of rows and components, coordinates, digits."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from lrbc_cli.campaign.reading.dof_source import order_doubt
from lrbc_cli.campaign.reading.doubts.coupled import coupled_doubt, uncoupled_doubt
from lrbc_cli.campaign.reading.doubts.rigid import digits_doubt, places_doubt, symmetry_doubt
from lrbc_cli.campaign.reading.places import components_place, coordinates_file, require_metres
from lrbc_cli.config import Campaign
from lrbc_cli.model.dofs import DofTable


@dataclass(frozen=True, kw_only=True)
class MeshDoubts:
    """Warnings about the mesh.

    Attributes
    ----------
    units : str or None
        The warning that guesses wrong units; it is among ``warnings``.
    misplaced : str
        The warning that rows, components or coordinates are wrong, so that places say nothing; it is among ``warnings``, empty if none.
    warnings : tuple of str
    """

    units: str | None
    misplaced: str
    warnings: tuple[str, ...]


def mesh_doubts(
    campaign: Campaign, K: sp.csc_array, M: sp.csc_array, dofs: DofTable, *, entries: NDArray[np.number], exchanged: str | None
) -> MeshDoubts:
    """Warnings about the DOF table of a model; the first cause only, as further ones would be its consequences.

    Parameters
    ----------
    campaign : Campaign
    K, M : (n, n) csc_array
    dofs : DofTable
        Of n rows.
    entries : (k,) array
        Entries of the stiffness as stored in the file.
    exchanged : str or None
        Warning about the components, which are tested in the units of the files.

    Raises
    ------
    DataError
        See ``require_metres``.
    """
    table = found.name if (found := coordinates_file(campaign)) else ""
    # Rotations taken for translations look like those of other units.
    units = None if exchanged else require_metres(K, M, dofs, campaign)
    order = exchanged or order_doubt(K, dofs, campaign.model.dofs)
    wrong = order or places_doubt(K, dofs, table, components_place(campaign)) or coupled_doubt(K, M, dofs, table)
    dry = None if wrong else uncoupled_doubt(K, M, dofs)
    told = (units, wrong, dry, digits_doubt(K, entries, dofs.component), None if order else symmetry_doubt(K, dofs))
    return MeshDoubts(units=units, misplaced=wrong or "", warnings=tuple(text for text in told if text))
