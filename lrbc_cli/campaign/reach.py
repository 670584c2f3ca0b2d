"""Whether every response can feel its excitation at all."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.sparse.csgraph import connected_components

from lrbc_cli.errors import DataError
from lrbc_cli.model.fem import FeModel


def parts_of(model: FeModel) -> NDArray[np.int64]:
    """(n,) number of the connected part that each DOF belongs to; matrices and terms connect."""
    rows, cols = [], []
    for matrix in (model.K, model.C, model.M):
        coo = matrix.tocoo()
        keep = coo.data != 0
        rows.append(coo.row[keep])
        cols.append(coo.col[keep])
    n = model.size
    # A term connects all DOFs of its two vectors with the first of them.
    both = sp.vstack([model.terms.left, model.terms.right], format="csc")
    for start, stop in zip(both.indptr[:-1], both.indptr[1:], strict=True):
        dofs = both.indices[start:stop] % n
        rows.append(dofs)
        cols.append(np.full(dofs.size, dofs[0]))
    row, col = np.concatenate(rows), np.concatenate(cols)
    pattern = sp.csr_array((np.ones(row.size, dtype=bool), (row, col)), shape=(n, n))
    return np.asarray(connected_components(pattern, directed=False)[1], dtype=np.int64)


def require_reach(model: FeModel, responses: list[str], excitations: list[str], input_of: list[int]) -> None:
    """Refuse a response that nothing connects with its excitation: its FRF is zero whatever the parameters are.

    Parameters
    ----------
    model : FeModel
    responses, excitations : lists of str
        Names.
    input_of : list of int
        Excitation of each response.

    Raises
    ------
    DataError
    """
    part = parts_of(model)
    for i, name in enumerate(responses):
        own = part[model.L[[i]].tocoo().col]
        driven = part[model.B[:, [input_of[i]]].tocoo().row]
        if not np.isin(own, driven).any():
            raise DataError(
                f"the FRF of response {name} over {excitations[input_of[i]]} is zero: nothing in the matrices connects them",
                expected="a model in one piece",
                found=f"{int(part.max()) + 1} separate pieces",
                hint="correct the place of the response, or export the parts merged or tied",
            )
