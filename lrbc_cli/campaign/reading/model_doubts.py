"""What may be wrong with a model although it can be used: said by every command that reads it."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from lrbc_cli.campaign.reading.groups import TermGroup
from lrbc_cli.config import ModelConfig
from lrbc_cli.errors import DataError
from lrbc_cli.model.fem import FeModel
from lrbc_cli.reduction.vectors import highest_omega

#: Stiffness that no structure has: a penalty [N/m, or N/mm].
PENALTY = 1e30


def doubts(model: FeModel, groups: Iterable[TermGroup]) -> list[str]:
    """Warnings about the matrices and the terms, in words."""
    m, found = model, []
    if np.iscomplexobj(m.K.data) and loss_factor(m) < 0:
        found.append(
            "the imaginary part of the stiffness is negative: with exp(+i omega t) it adds energy; say `conjugate: true` beside its file"
        )
    structure = np.abs(m.K.diagonal())[~m.is_acoustic]
    penalty = int((structure > 1e8 * max(float(np.median(structure)), 1e-300)).sum()) if structure.size else 0
    if penalty:
        found.append(
            f"{penalty} structural DOFs have a huge diagonal: penalties of fixed DOFs? they cannot be loosened; export the edge pinned"
        )
    for group in groups:
        if group.config.baseline > 0 and group.config.kind == "stiffness":
            left, right = m.terms.left[:, group.terms], m.terms.right[:, group.terms]
            share = np.asarray((left.multiply(m.K.real @ right)).sum(axis=0)).ravel()
            norm = np.asarray((left.multiply(right)).sum(axis=0)).ravel() ** 2
            if np.any(share < group.config.baseline * norm * (1 - 1e-9)):
                stated = f"parameters {group.name}: the baseline {group.config.baseline:g}"
                found.append(f"{stated} is more than the stiffness matrix holds there")
    return found


def require_roles(K: sp.csc_array, M: sp.csc_array, source: ModelConfig, band_hz: tuple[float, float]) -> None:
    """Refuse stiffness and mass in each other's place.

    Raises
    ------
    DataError
        Where no local frequency comes near the band, but all would if the two were exchanged.
    """
    highest, exchanged = highest_omega(K, M) / (2.0 * np.pi), highest_omega(M, K) / (2.0 * np.pi)
    if not highest * 10.0 < band_hz[1] < exchanged < np.inf:
        return
    largest = [float(np.abs(matrix.data).max(initial=0.0)) for matrix in (K, M)]
    negative = int((np.real(M.diagonal()) < 0).sum())
    raise DataError(
        "the stiffness and the mass matrix stand in each other's place",
        file=source.mass.path,
        place=source.mass.group or "model.mass",
        expected=f"a mass far below the stiffness: frequencies in the band up to {band_hz[1]:g} Hz",
        found=f"entries up to {largest[1]:.1e} as mass, up to {largest[0]:.1e} as stiffness: all frequencies below {highest:.1g} Hz, "
        f"exchanged up to {exchanged:.1g} Hz" + (f"; {negative} negative masses" if negative else ""),
        hint="exchange model.stiffness and model.mass in the campaign file",
    )


def fixed_dofs(K: sp.csc_array, M: sp.csc_array) -> tuple[NDArray[np.bool_], str]:
    """(n,) mask of DOFs that the export left as rows of zeros, or held with a penalty (Abaqus: 1e36), and what is said about them."""
    empty = (np.abs(K).sum(axis=0) == 0) & (np.abs(M).sum(axis=0) == 0) & (np.abs(K).sum(axis=1) == 0) & (np.abs(M).sum(axis=1) == 0)
    held = np.abs(K.diagonal()) >= PENALTY
    counts = ((int(empty.sum()), "empty rows in both matrices"), (int(held.sum()), "a penalty on the diagonal"))
    told = ", ".join(f"{count} with {text}" for count, text in counts if count)
    return empty | held, f"fixed DOFs left out: {told}" if told else ""


def loss_factor(model: FeModel) -> float:
    """Of a complex stiffness matrix, from its diagonal."""
    return float(model.K.imag.diagonal().sum() / model.K.real.diagonal().sum())
