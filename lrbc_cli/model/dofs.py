"""What the rows of the matrices stand for (node, component, coordinates), and named points such as bolts."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

ACOUSTIC_COMPONENT = "PRES"

#: Labels of the DOFs of a node, in the usual order of FE programs.
COMPONENTS = ("UX", "UY", "UZ", "ROTX", "ROTY", "ROTZ")


@dataclass(frozen=True)
class DofLabels:
    """Node and component of each row of a matrix, without coordinates.

    Attributes
    ----------
    node : (n,) int array
        Node number; negative for DOFs that the FE program added itself.
    component : (n,) str array
        Labels as in ``DofTable``.
    """

    node: NDArray[np.int64]
    component: NDArray[np.str_]

    @property
    def size(self) -> int:
        """Number of DOFs."""
        return int(self.node.size)

    def find(self, other: DofLabels) -> NDArray[np.int64]:
        """(m,) row of this matrix with the same node and component as each of the m rows of the other, -1 if there is none."""
        at = {key: row for row, key in enumerate(zip(self.node.tolist(), self.component.tolist(), strict=True))}
        return np.array([at.get(key, -1) for key in zip(other.node.tolist(), other.component.tolist(), strict=True)], dtype=np.int64)


@dataclass(frozen=True)
class DofTable:
    """Node, component and coordinates of each row of the matrices.

    Attributes
    ----------
    node : (n,) int array
        Node number of each DOF.
    component : (n,) str array
        Label in upper case: ``UX UY UZ ROTX ROTY ROTZ PRES``; ``PRES`` is acoustic, any other label is structure.
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

    @cached_property
    def is_acoustic(self) -> NDArray[np.bool_]:
        """(n,) mask of the acoustic pressure DOFs."""
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
    """Hint for error messages about a node number that the model does not have."""
    return f"the nodes of the model are numbered {node.min()} to {node.max()}: write the node numbers of this model"
