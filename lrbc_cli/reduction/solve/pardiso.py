"""The sparse solver Intel MKL PARDISO, called through ctypes: complex symmetric LDLᵀ and unsymmetric LU, one analysis for all s.

The wheel ``mkl`` contains the library; the reference manual of MKL documents the call and ``iparm``.
"""

from __future__ import annotations

import ctypes
import importlib.metadata
import sys
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lrbc_cli.arrays import Complexes
from lrbc_cli.errors import ConfigError, NumericalError

_MESSAGES = {
    -1: "input inconsistent",
    -2: "not enough memory",
    -3: "reordering failed",
    -4: "zero pivot: the matrix is singular",
    -7: "diagonal matrix is singular",
    -8: "32-bit integer overflow",
}


@cache
def library() -> ctypes.CDLL | None:
    """The MKL runtime library; None if it is not installed."""
    names = ["mkl_rt", "libmkl_rt"]
    candidates: list[Path] = []
    try:
        files = importlib.metadata.distribution("mkl").files or []
        candidates = [Path(str(f.locate())) for f in files if Path(str(f)).name.split(".")[0] in names]
    except importlib.metadata.PackageNotFoundError:
        return None
    for path in candidates:
        if path.suffix in {".dll", ".dylib", ".so"} or ".so." in path.name:
            try:
                return ctypes.CDLL(str(path.resolve()), mode=ctypes.RTLD_GLOBAL if sys.platform != "win32" else ctypes.DEFAULT_MODE)
            except OSError:
                continue
    return None


def resolved(backend: str) -> str:
    """The sparse solver for a setting: ``auto`` becomes ``pardiso`` if it is installed, else ``superlu``; other names are returned."""
    return backend if backend != "auto" else "pardiso" if library() else "superlu"


class Pardiso:
    """A pattern that is analysed once and can be factorised with different values.

    Parameters
    ----------
    indptr, indices : int arrays
        CSR pattern with sorted indices; if ``symmetric``, the upper triangle with a full diagonal.
    symmetric : bool
        Complex symmetric LDLᵀ (mtype 6), otherwise complex LU (mtype 13).

    Raises
    ------
    ConfigError
        If MKL is not installed.
    """

    def __init__(self, indptr: NDArray[Any], indices: NDArray[Any], *, symmetric: bool) -> None:
        lib = library()
        if lib is None:
            raise ConfigError(
                "the accelerated factorisation is not installed",
                place="reduction.backend",
                expected="auto or superlu on this machine",
                found="pardiso",
                hint="run pip install mkl (the extra `accelerated`), or set reduction.backend: superlu",
            )
        self._lib = lib
        self._handle = np.zeros(64, dtype=np.int64)
        self._iparm = np.zeros(64, dtype=np.int32)
        # Defaults of pardisoinit, then: no scaling or matching (the matrix is equilibrated), zero-based indices.
        self._iparm[0] = 1
        self._iparm[1] = 2
        self._iparm[7] = 0
        self._iparm[9] = 8 if symmetric else 13
        self._iparm[17] = -1  # count the non-zeros of the factors
        self._iparm[20] = 1
        self._iparm[34] = 1
        self._type = 6 if symmetric else 13
        self._n = indptr.size - 1
        self._indptr = np.ascontiguousarray(indptr, dtype=np.int32)
        self._indices = np.ascontiguousarray(indices, dtype=np.int32)
        self._data: Complexes = np.zeros(indices.size, dtype=complex)
        self._analysed = False

    def analyse(self) -> tuple[int, float, float]:
        """Order and analyse the pattern; values are not needed.

        Returns
        -------
        nonzeros : int
            Entries of the factors.
        operations : float
            Operations of an LDLᵀ factorisation of a real matrix with this pattern.
        bytes : float
            Memory: the larger of the peak during analysis, and of factors and analysis together.
        """
        self._iparm[18] = -1
        self._call(11)
        self._analysed = True
        peak, kept, factors = (1024.0 * float(self._iparm[i]) for i in (14, 15, 16))
        # iparm counts millions of operations, of complex numbers and, for LU, of both factors.
        operations = 1e6 * float(self._iparm[18]) / (4 if self._type == 6 else 8)
        self._iparm[18] = 0
        return self.nonzeros, operations, max(peak, kept + factors)

    def factor(self, data: Complexes) -> None:
        """Factorise the values ``data`` on the pattern; the first call analyses the pattern if ``analyse`` was not called."""
        self._data = np.ascontiguousarray(data, dtype=complex)
        self._call(22 if self._analysed else 12)
        self._analysed = True

    def solve(self, rhs: Complexes, *, transposed: bool = False) -> Complexes:
        """Solution of A X = rhs, or Aᵀ X = rhs, with rhs (n,) or (n, m); the result has Fortran order."""
        b = np.asfortranarray(rhs, dtype=complex)
        x = np.empty_like(b, order="F")
        self._iparm[11] = 2 if transposed else 0
        self._call(33, b, x)
        return x

    @property
    def nonzeros(self) -> int:
        """Non-zeros of the factors."""
        return int(self._iparm[17])

    def _call(self, phase: int, b: NDArray[Any] | None = None, x: NDArray[Any] | None = None) -> None:
        def integer(value: int) -> Any:
            return ctypes.byref(ctypes.c_int32(value))

        def pointer(array: NDArray[Any] | None) -> Any:
            return ctypes.c_void_p(None if array is None else array.ctypes.data)

        error = ctypes.c_int32(0)
        columns = 1 if b is None or b.ndim == 1 else b.shape[1]
        self._lib.pardiso(
            pointer(self._handle), integer(1), integer(1), integer(self._type), integer(phase), integer(self._n), pointer(self._data),
            pointer(self._indptr), pointer(self._indices), pointer(None), integer(columns), pointer(self._iparm),
            integer(0), pointer(b), pointer(x), ctypes.byref(error),
        )  # fmt: skip
        if error.value:
            raise NumericalError(f"PARDISO failed ({_MESSAGES.get(error.value, f'error {error.value}')})")

    def release(self) -> None:
        """Release the factors; the analysis is kept."""
        if self._analysed:
            self._call(0)

    def close(self) -> None:
        """Release the factors and the analysis."""
        if self._analysed:
            self._analysed = False
            self._call(-1)

    def __del__(self) -> None:
        # At interpreter exit modules are gone already, and the memory is freed with the process.
        if getattr(self, "_analysed", False) and not sys.is_finalizing():
            self.close()
