"""The DOF table of a finite-element model, and points in space."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

ACOUSTIC_COMPONENT = "PRES"

#: Labels of a node's DOFs in the order of every FE program.
COMPONENTS = ("UX", "UY", "UZ", "ROTX", "ROTY", "ROTZ")


@dataclass(frozen=True)
class DofLabels:
    """Node and component of each row of a matrix.

    Attributes
    ----------
    node : (n,) int array
        Negative for what the FE program added by itself.
    component : (n,) str array
        As in ``DofTable``.
    """

    node: NDArray[np.int64]
    component: NDArray[np.str_]

    @property
    def size(self) -> int:
        """Number of DOFs."""
        return int(self.node.size)

    def find(self, other: DofLabels) -> NDArray[np.int64]:
        """(m,) row here of each row of another matrix, -1 where there is none."""
        at = {key: row for row, key in enumerate(zip(self.node.tolist(), self.component.tolist(), strict=True))}
        return np.array([at.get(key, -1) for key in zip(other.node.tolist(), other.component.tolist(), strict=True)], dtype=np.int64)


@dataclass(frozen=True)
class DofTable:
    """What each row of the matrices stands for.

    Attributes
    ----------
    node : (n,) int array
        Node number of each DOF.
    component : (n,) str array
        Label, upper case: ``UX UY UZ ROTX ROTY ROTZ PRES``; ``PRES`` is acoustic, any other label structure.
    xyz : (n, 3) float array
        Coordinates in metres.
    """

    node: NDArray[np.int64]
    component: NDArray[np.str_]
    xyz: NDArray[np.float64]

    @property
    def size(self) -> int:
        """Number of DOFs."""
        return int(self.node.size)

    @property
    def is_acoustic(self) -> NDArray[np.bool_]:
        """(n,) mask of the acoustic pressures."""
        return np.asarray(self.component == ACOUSTIC_COMPONENT)


@dataclass(frozen=True)
class PointTable:
    """Named points in space, such as bolts.

    Attributes
    ----------
    name : tuple of str
    xyz : (m, 3) float array
        Coordinates in metres.
    """

    name: tuple[str, ...]
    xyz: NDArray[np.float64]


def numbers_text(node: NDArray[np.int64]) -> str:
    """What to do about a number that no node has."""
    return f"the nodes of the model are numbered {node.min()} to {node.max()}: write one of these numbers, those of this model"
