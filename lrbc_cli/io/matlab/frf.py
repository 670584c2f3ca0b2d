"""Reads FRFs from MATLAB files (level 5): from variables and fields of structures, see ``io.named``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from numpy.typing import NDArray
from scipy.sparse import issparse

from lrbc_cli.io.common import damaged
from lrbc_cli.io.layout import TextLayout
from lrbc_cli.io.matlab.variables import list_variables, load_texts, load_variables
from lrbc_cli.io.named import Named, frf_set
from lrbc_cli.io.sparse import numeric
from lrbc_cli.model.frf import FrfSet


def read_frf_mat(path: Path, layout: TextLayout) -> FrfSet:
    """Read FRFs from variables of a MATLAB file.

    Raises
    ------
    DataError
        If none is found, or a value is not finite.
    """
    return frf_set(named_mat(path), path, layout)


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
