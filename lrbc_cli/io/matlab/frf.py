"""Reads variables and fields of structures from MATLAB files (level 5), in which ``io.named`` finds FRFs by their names."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from numpy.typing import NDArray
from scipy.sparse import issparse

from lrbc_cli.io.common import damaged
from lrbc_cli.io.matlab.variables import list_variables, load_texts, load_variables
from lrbc_cli.io.named import Named
from lrbc_cli.io.sparse import numeric


def named_mat(path: Path) -> Named:
    """Dense arrays and texts of a MATLAB file, by name.

    Raises
    ------
    DataError
        If the file is damaged.
    """
    names = [name for name, _, kind in list_variables(path, elements=True) if kind in ("double", "single") or "int" in kind]
    arrays: dict[str, NDArray[Any]] = {}
    for name, value in load_variables(path, names, elements=True).items():
        with damaged(path, "MATLAB variable", name):
            if not issparse(value):
                arrays[name] = numeric(value, path, name)
    return Named(arrays, load_texts(path))
