"""Detects a wrong choice among the matrices of a file: one for two operators, the same numbers twice, or a part of the stiffness."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import numpy as np
import scipy.sparse as sp

from lrbc_cli.arrays import Bools
from lrbc_cli.campaign.reading.doubts.numbering import node_of_rows
from lrbc_cli.config import Campaign, ModelConfig
from lrbc_cli.config.fields import MatrixRef, OperatorRef
from lrbc_cli.config.structure import ProportionalDamping
from lrbc_cli.errors import DataError, LrbcError, listing
from lrbc_cli.io.matrices.read import matrix_names, read_matrix
from lrbc_cli.model.dofs import DofTable
from lrbc_cli.model.factors import FIELDS, block
from lrbc_cli.model.fem import FeModel

#: Usual names of matrices in files of several.
_NAMES = {
    "stiffness": ("k", "stiffness", "kaa", "kgg"),
    "mass": ("m", "mass", "maa", "mgg"),
    "damping": ("c", "d", "damping", "baa", "bgg"),
}

#: Fields of a model in words.
_FIELDS = {"structure": "structure", "acoustic": "air"}

#: Number of digits in which equal entries agree.
_DIGITS = 9


def require_own(campaign: Campaign) -> None:
    """Refuse one matrix for two operators of ``model``.

    Raises
    ------
    ConfigError
        Names the other matrices of the file, if there are any.
    """
    model, seen = campaign.model, dict[str, str]()
    for name in ("stiffness", "mass", "damping"):
        ref = getattr(model, name)
        first = seen.setdefault(repr(ref), name) if isinstance(ref, MatrixRef) else name
        if first != name:
            raise campaign.error(
                f"model.{first} and model.{name} give the same matrix",
                "model",
                name,
                expected="a separate matrix for each",
                found=ref.path.name + (f"#{ref.group}" if ref.group else ""),
                hint=_own_matrix(campaign, name, ref)
                + ("; damping proportional to the stiffness is {structure: {beta: ...}}" if name == "damping" else ""),
            )


def _own_matrix(campaign: Campaign, name: str, ref: MatrixRef) -> str:
    """Hint with the key for the right matrix, if one file contains several."""
    held = list[str]()
    with suppress(LrbcError):
        held = [found for found in matrix_names(ref.path) if found is not None]
    others = [found for found in held if found != ref.group]
    if not others:
        return "give its own file"
    likely = next((found for found in others if _usual(name, found)), "NAME")
    return f"write model.{name}: {campaign.relative(ref.path)}#{likely}; the file contains {listing(held, 8)}"


def require_apart(source: ModelConfig, **matrices: sp.csc_array) -> None:
    """Refuse the last of ``matrices`` (by key of ``model``) if it contains the numbers of another one.

    Raises
    ------
    DataError
    """
    *others, (name, own) = matrices.items()
    for other, matrix in others:
        if own.nnz == 0 or own.nnz != matrix.nnz or abs(own - matrix).max() > 10.0**-_DIGITS * abs(own).max():
            continue
        ref, first = getattr(source, name), getattr(source, other)
        raise DataError(
            f"model.{name}: {ref.path.name} contains the same numbers as model.{other} ({first.path.name})",
            file=ref.path,
            place=ref.group,
            expected=f"the {name} matrix",
            found=f"the {other} matrix again",
            hint=f"check whether the {other} was exported twice. Export the {name} matrix, and give its file"
            + ("; damping proportional to mass or stiffness is {structure: {alpha: ..., beta: ...}}" if name == "damping" else ""),
        )


def part_of_stiffness(campaign: Campaign, model: FeModel, dofs: DofTable | None, *, least: float = 0.1) -> Iterator[str]:
    """Warning if at least the share ``least`` of the nodes with mass has neither stiffness nor terms, as with the matrix of a part.

    A few masses that nothing holds are possible. So are single DOFs without stiffness, as those in the plane of plates that only bend.
    """
    if dofs is None:
        return
    node = node_of_rows(model.size, dofs)
    heavy = np.unique(node[_filled(model.M)])
    bare = np.setdiff1d(heavy, node[_filled(model.K, model.terms.left, model.terms.right)])
    if not bare.size or bare.size < least * heavy.size:
        return
    ref, calibration = campaign.model.stiffness, campaign.calibration
    groups = {} if calibration is None else calibration.groups
    named = next((f", as calibration.groups.{name} says of it" for name, group in groups.items() if _at(group.stiffness) == _at(ref)), "")
    numbers = [str(int(dofs.node[np.argmax(node == k)])) for k in bare[:4].tolist()]
    yield (
        f"model.stiffness: at {bare.size} of {heavy.size} nodes the matrix has only empty rows, although they have a mass (node "
        f"{', '.join(numbers)}{' ...' if bare.size > len(numbers) else ''}): {ref.path.name}{f'#{ref.group}' if ref.group else ''} is "
        f"probably a part of the stiffness{named}. {_fuller(campaign, ref) or 'Export the stiffness of the whole model, and give its file'}"
    )


def whole_group(campaign: Campaign, key: str, ref: MatrixRef, matrix: sp.csc_array, whole: sp.csc_array, acoustic: Bools) -> Iterator[str]:
    """Warning if the matrix of a calibration group is that of the model, or all of a field of it: it has the factor of that field again.

    Parameters
    ----------
    campaign : Campaign
    key : str
        Key of the matrix, ending with the operator.
    ref : MatrixRef
    matrix, whole : (n, n) csc_array
        Matrices of the group and of the model.
    acoustic : (n,) bool array
        DOFs that are pressures.
    """
    fields = [name for name in FIELDS if _same(block(matrix, acoustic, name), block(whole, acoustic, name))]
    if not fields:
        return
    operator, factors = key.rpartition(".")[2], () if campaign.calibration is None else campaign.calibration.factors
    own = [f"{operator}.{name}" for name in fields]
    doubled = " and ".join(name for name in own if name in factors)
    unused = list[str]()
    with suppress(LrbcError):
        unused = [found for found in matrix_names(ref.path) if found is not None and (ref.path, found) not in _taken(campaign)]
    also = f" ({ref.path.name} also contains {listing(unused, 8)}, which nothing uses)" if unused else ""
    yield (
        f"{key}: {ref.path.name}{f'#{ref.group}' if ref.group else ''} is the whole {operator} matrix of the "
        f"{' and of the '.join(_FIELDS[name] for name in fields)}, not a share of it"
        + (f", and {doubled} scales it already" if doubled else "")
        + f". Give the matrix of the share{also}, or remove the group"
        + ("" if doubled else f" and write {', '.join(own)} under calibration.factors")
    )


def _taken(campaign: Campaign) -> list[tuple[Path, str | None] | None]:
    """The matrices that the campaign reads."""
    groups = () if campaign.calibration is None else campaign.calibration.groups.values()
    model = campaign.model
    used = [model.stiffness, model.mass, model.damping, *(each for group in groups for each in group.matrices.values())]
    return [_at(each) for each in used if not isinstance(each, ProportionalDamping)]


def _same(part: sp.csc_array, whole: sp.csc_array) -> bool:
    """Whether two matrices have the same entries; not if they are empty."""
    largest = float(abs(whole).max()) if whole.nnz else 0.0
    return largest > 0.0 and float(abs(part - whole).max()) <= 10.0**-_DIGITS * largest


def _filled(*matrices: sp.csc_array) -> Bools:
    """(n,) rows in which one of the matrices has entries."""
    return np.asarray(sum(np.asarray(abs(A).sum(axis=1)).ravel() for A in matrices) > 0.0)


def _at(ref: OperatorRef | None) -> tuple[Path, str | None] | None:
    """File of a matrix, and place in it."""
    return None if ref is None else (ref.path, ref.group)


def _fuller(campaign: Campaign, ref: OperatorRef) -> str:
    """Hint at an unused matrix of the same file with fewer empty rows; empty if there is none."""
    taken = _taken(campaign)
    counts: dict[str, int] = {}
    with suppress(LrbcError):
        own = read_matrix(ref.path, ref.group).matrix
        for name in matrix_names(ref.path):
            if name is None or (ref.path, name) in taken:
                continue
            with suppress(LrbcError):
                other = read_matrix(ref.path, name).matrix
                if other.shape == own.shape and np.count_nonzero(_filled(other)) > np.count_nonzero(_filled(own)):
                    counts[name] = int(np.count_nonzero(_filled(other)))
    if not counts:
        return ""
    best = max(counts, key=lambda name: (_usual("stiffness", name), counts[name]))
    return f"{ref.path.name} also contains {best}, which nothing uses: write model.stiffness: {campaign.relative(ref.path)}#{best}"


def _usual(operator: str, name: str) -> bool:
    return name.rpartition("/")[2].casefold() in _NAMES[operator]
