"""Matrices in the HDF5 layout that the tool reads as ``file#name``."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from scipy.sparse import csr_array


def write_matrix_hdf5(path: Path, matrices: Mapping[str, Any]) -> None:
    """Write matrices as CSR groups, as anndata does."""
    with h5py.File(path, "w") as file:
        for name, matrix in matrices.items():
            rows = csr_array(matrix)
            rows.sum_duplicates()
            node = file.create_group(name)
            node.attrs["encoding-type"] = "csr_matrix"
            node.attrs["encoding-version"] = "0.1.0"
            node.attrs["shape"] = np.asarray(rows.shape, dtype=np.int64)
            for key in ("data", "indices", "indptr"):
                values = getattr(rows, key)
                node.create_dataset(key, data=values, **({"compression": "gzip", "shuffle": True} if values.size else {}))
