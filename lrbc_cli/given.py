"""Checks of the arguments of the Python interface (``study``, ``matrices``): each returns the converted argument or raises ConfigError."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike, NDArray

from lrbc_cli.arrays import Floats
from lrbc_cli.errors import ConfigError


def refuse(name: str, expected: str, found: object) -> ConfigError:
    """The ConfigError (returned, not raised) for an argument that is not as documented."""
    return ConfigError(f"the argument {name} cannot be used", expected=expected, found=found)


def numbers(name: str, value: ArrayLike, shape: tuple[int | None, ...], *, finite: bool = True) -> Floats:
    """The argument as a real array of the given shape, without NaN and, with ``finite``, without inf.

    Parameters
    ----------
    name : str
        Of the argument, for the message.
    value : array_like
    shape : tuple
        Size of each axis; None allows any size.
    finite : bool

    Raises
    ------
    ConfigError
    """
    what = "finite numbers" if finite else "numbers, none of them NaN"
    expected = f"{what}, an array of shape ({', '.join('any' if size is None else str(size) for size in shape)})"
    found = array(name, value, float, expected)
    if found.ndim != len(shape) or any(size is not None and size != own for size, own in zip(shape, found.shape, strict=True)):
        raise refuse(name, expected, f"shape {found.shape}")
    if np.isnan(found).any() or (finite and not np.isfinite(found).all()):
        raise refuse(name, expected, "NaN" if np.isnan(found).any() else "inf")
    return found


def array(name: str, value: ArrayLike, kind: type, expected: str) -> NDArray[Any]:
    """The argument as an array of any shape with elements of ``kind`` (float or complex); raises ConfigError."""
    try:
        if kind is float and np.iscomplexobj(value):
            raise refuse(name, expected, "complex numbers")
        return np.asarray(value, dtype=kind)
    except (TypeError, ValueError) as error:
        raise refuse(name, expected, _shown(value)) from error


def one_or_each(name: str, value: ArrayLike, size: int, *, finite: bool = True) -> Floats:
    """(size,) array from one number for all or one for each; raises as ``numbers`` does."""
    single = np.isscalar(value) and not isinstance(value, str)
    return np.full(size, numbers(name, value, (), finite=finite)) if single else numbers(name, value, (size,), finite=finite)


def lines(hz: ArrayLike) -> Floats:
    """(F,) frequencies of one line or several [Hz]; raises as ``numbers`` does."""
    return numbers("hz", np.atleast_1d(array("hz", hz, float, "frequencies, one or an array of shape (any)")), (None,))


def matrix(name: str, value: Any, rows: int | None, columns: int | None) -> sp.csc_array:
    """The argument, sparse or dense, as a sparse matrix with finite entries; ``rows`` or ``columns`` None allow any number.

    Raises
    ------
    ConfigError
    """
    sizes = ["any" if size is None else str(size) for size in (rows, columns)]
    expected = f"a matrix of {sizes[0]} rows and {sizes[1]} columns with finite numbers, sparse or dense"
    if not sp.issparse(value) and array(name, value, complex, expected).ndim != 2:
        raise refuse(name, expected, _shown(value))
    try:
        found = sp.csc_array(value)
        entries = np.asarray(found.data, dtype=complex)
    except (TypeError, ValueError) as error:
        raise refuse(name, expected, _shown(value)) from error
    if any(size is not None and size != own for size, own in zip((rows, columns), found.shape, strict=True)):
        raise refuse(name, expected, f"{found.shape[0]} rows and {found.shape[1]} columns")
    if not np.isfinite(entries).all():
        raise refuse(name, expected, "NaN or inf")
    return found


def band(value: Any) -> tuple[float, float]:
    """Two ascending frequencies above zero [Hz]; raises as ``numbers`` does."""
    low, high = (float(end) for end in numbers("band_hz", value, (2,)))
    if not 0.0 < low < high:
        raise refuse("band_hz", "two ascending frequencies above 0 Hz", f"{low:g} and {high:g}")
    return low, high


def between(name: str, value: Any, low: float, high: float) -> float:
    """A number above ``low`` and below ``high``; raises as ``numbers`` does."""
    found = float(numbers(name, value, ()))
    if not low < found < high:
        raise refuse(name, f"a number above {low:g} and below {high:g}", f"{found:g}")
    return found


def count(name: str, value: Any, least: int = 0) -> int:
    """A whole number of at least ``least``; raises ConfigError."""
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < least:
        raise refuse(name, f"a whole number, at least {least}", _shown(value))
    return int(value)


def known(name: str, value: Any, choices: Iterable[str]) -> str:
    """One of the given words; raises ConfigError."""
    names = list(choices)
    if value not in names:
        raise refuse(name, ", ".join(names), _shown(value))
    return str(value)


def made_by(name: str, value: Any, kind: type | tuple[type, ...], how: str) -> None:
    """Raise ConfigError unless the argument has the type ``kind``; ``how`` says where such an object comes from."""
    if not isinstance(value, kind):
        raise refuse(name, how, _shown(value))


def _shown(value: Any) -> str:
    """A short description of a wrong argument, for the message."""
    if isinstance(value, str):
        return repr(value)
    if isinstance(value, (int, float, complex)) or value is None:
        return str(value)
    shape = getattr(value, "shape", None)
    return type(value).__name__ + ("" if shape is None else f" of shape {shape}")
