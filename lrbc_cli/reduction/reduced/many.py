"""Port FRFs at many lines without a system of the reduced size at each: in modal coordinates of the structure, or of its air alone."""

from __future__ import annotations

import numpy as np

from lrbc_cli.arrays import Bools, Complexes
from lrbc_cli.reduction.reduced.condense import PAIRS, CondensedAir, air_is_diagonal, with_diagonal_air
from lrbc_cli.reduction.reduced.modal import modal_structure
from lrbc_cli.reduction.reduced.model import ReducedModel
from lrbc_cli.reduction.reduced.ports import PortFrf, port_frf
from lrbc_cli.reduction.threads import in_chunks


def ports_of(model: ReducedModel, s: Complexes, *, checked: int = 3, apart: float = 1e-7, louder: float = 1e4) -> PortFrf:
    """Port FRFs of a reduced model at the lines s, as ``ReducedModel.ports`` gives them.

    Of a structure, the transfer matrix without the terms is a sum over modes if damping is diagonal in them, and the terms enter at their
    reference values by the port formula (14)-(18). Beside a structure, the air is condensed out in the modes of its cavity. Both cost a
    fraction of a solution of size r. Rounding errors are those of the structure without its terms, and of the air in rigid walls, so lines
    about their own resonances are solved directly. On four structures the others were off by no more than 1300 rounding errors of that.

    Parameters
    ----------
    model : ReducedModel
    s : (F,) complex array
    checked : int
        Number of lines, spread over s, that are also solved directly.
    apart : float
        Largest difference there, over the largest entry of each block; beyond, all lines are solved directly.
    louder : float
        Ratio from which a line is solved directly: of the largest entries of Hpp without and with the terms, or of the parts of a mode of
        the air to their sum.
    """
    by = _by_modes if model.structure == model.size else _by_air
    found = by(model, s, louder) if s.size > checked else None
    if found is None:
        return model.ports(s)
    ports, rough = found[0], np.flatnonzero(found[1])
    at = np.union1d(np.linspace(0, s.size - 1, checked).round().astype(int), rough)
    if 2 * at.size > s.size:
        return model.ports(s)
    exact, fine = model.ports(s[at]), ~np.isin(at, rough)
    for name in ("H00", "H0p", "Hp0", "Hpp"):
        one, other = getattr(ports, name), getattr(exact, name)
        if not np.abs(one[at[fine]] - other[fine]).max(initial=0.0) <= apart * np.abs(other[fine]).max(initial=0.0):
            return model.ports(s)
        one[rough] = other[~fine]
    return ports


def _cheaper(model: ReducedModel, lines: int, each: float) -> bool:
    """Whether ``each`` multiplications and additions a line, after an eigenvalue problem, are fewer than those of solutions of size r."""
    r, loads = model.size, model.B.shape[1] + model.terms
    # An eigenvalue problem with vectors, and the transformation of three matrices.
    return bool(22.0 * r**3 + lines * each < lines * (8.0 / 3.0 * r**3 + 8.0 * r**2 * loads))


def _by_modes(model: ReducedModel, s: Complexes, louder: float) -> tuple[PortFrf, Bools] | None:
    """Port FRFs as a sum over modes, and (F,) which lines are rough; None if damping couples the modes or it costs more."""
    r, nt, loads, heard = model.size, model.terms, model.B.shape[1] + model.terms, model.L.shape[0] + model.terms
    if not _cheaper(model, s.size, 4.0 * r * loads * heard + 8.0 / 3.0 * nt**3 + 16.0 * nt**2 * loads):
        return None
    modal = modal_structure(model.K, model.C, model.M, omega=float(np.median(np.abs(s))))
    if modal is None:
        return None
    try:
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            H = modal.transfer(s, np.vstack([model.L, model.right.T]), np.hstack([model.B, model.left]))
            free = port_frf(H, s, np.zeros((s.size, model.terms), dtype=complex), model.output_power, model.input_of)
            ports = free.about(model.reference_dynamic(s))
            without, there = (np.abs(one.Hpp).max(axis=(1, 2), initial=0.0) for one in (free, ports))
            return ports, ~(without <= louder * there)
    except np.linalg.LinAlgError:
        # A resonance of the structure without its terms lies exactly at a line.
        return None


def _by_air(model: ReducedModel, s: Complexes, louder: float) -> tuple[PortFrf, Bools] | None:
    """Port FRFs with the air condensed out, and (F,) which lines are rough; None if its modes are not diagonal or it costs more."""
    ns, na, loads = model.structure, model.size - model.structure, model.B.shape[1] + model.terms
    # One real product of lower triangles for real and imaginary parts, or complex ones of whole matrices.
    formed = (2.0 if (na + model.terms) * ns**2 < 2 * PAIRS else 8.0) * ns**2 * (na + model.terms)
    if ns == 0 or not _cheaper(model, s.size, 8.0 / 3.0 * ns**3 + 8.0 * ns**2 * loads + formed + 8.0 * ns * na * loads):
        return None
    turned = with_diagonal_air(model)
    operators, terms = (turned.K, turned.C, turned.M), (turned.left, turned.right)
    if not air_is_diagonal(*operators, ns, *terms):
        return None
    air, D = CondensedAir(operators, terms, ns), model.reference_dynamic(s)
    inputs, outputs = np.hstack([turned.B, turned.left]), np.vstack([turned.L, turned.right.T])
    H = np.empty((s.size, outputs.shape[0], inputs.shape[1]), dtype=complex)

    def work(part: slice) -> None:
        # Each thread has settings of its own.
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            H[part] = outputs @ air.solve(s[part, None, None], D[part], inputs, np.zeros((model.size, 0)))[0]

    try:
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            in_chunks(s.size, work, chunk=32)
            return port_frf(H, s, D, model.output_power, model.input_of), ~(air.cancelled(s) <= louder)
    except np.linalg.LinAlgError:
        # A resonance of the cavity in rigid walls lies exactly at a line.
        return None
