"""Tools and limits of the tests of causes: how a changed model is solved on few lines, and when it explains a measurement.

A level misfit is in dB, with the mean level of each response removed, median over the responses. The limits of ``likeness`` come first:
below ``LEAST_DIFFERENCE`` (3 dB) there is nothing to explain, and a cause must leave less than the share ``CLEARLY`` (a half) of it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy.sparse as sp

from lrbc_cli.arrays import Complexes, Integers
from lrbc_cli.campaign.identification.compared.likeness import levels, spread
from lrbc_cli.campaign.looking.states import Seen
from lrbc_cli.model.fem import FeModel
from lrbc_cli.reduction.problem.full import full_ports
from lrbc_cli.reduction.reduced.ports import PortFrf
from lrbc_cli.updating.peaks import peaks_of

#: Level misfit up to which no fit of loosened bolts, and no rough calibration, is needed to explain a measurement [dB].
NEAR = 2.0

#: Misfit of the reference job after a rough calibration up to which no other part or place is looked for [dB].
USUAL = 1.5

#: Level misfit of the tight state above which more than small errors of the model are wrong [dB].
UNLIKE = 6.0

#: Level misfit that a factor on the model, or another place, may leave [dB].
EXPLAINED = 4.0

#: Share of a misfit below which something is nearer where half of it (``CLEARLY``) is too strict: one of two jobs assumed tight, or another
#: place of the hammer beside a calibrated model (on right campaigns no other place was better than the stated one).
NEARER = 0.65

#: Number of lines on which changed models are solved, and the number where there are many of them.
LINES, FEWEST = 24, 12

#: Predicted operations up to which changed models are solved: half a minute.
MOST_WORK = 2e12


@dataclass(frozen=True)
class Cause:
    """What explains a job, in words, and the level misfit that it leaves [dB]; no words if it is no cause."""

    text: str = ""
    left: float = np.inf


def affordable(seen: Seen, times: float = 1.0) -> bool:
    """Whether so many full solves on ``LINES`` lines take no longer than ``MOST_WORK``."""
    return times * seen.work(LINES) <= MOST_WORK


def gradually(seen: Seen, *, wider: float = 1.6) -> Iterator[tuple[Seen, float]]:
    """The same on a third of ``LINES`` lines, then on all of them, with a factor of the limits: ``wider`` for few lines.

    What does not fit a third of the lines within wider limits needs no further full solves.
    """
    few = seen.few(LINES)
    yield few.on(np.arange(1, few.s.size, 3)), wider
    yield few, 1.0


def solved(seen: Seen, model: FeModel, input_of: Integers, key: bytes) -> PortFrf:
    """Full-order port FRFs of a changed model on the lines of ``seen``; lines that were solved before, under ``key``, are kept."""
    known: dict[complex, PortFrf] = seen.source.known.setdefault(key, {})
    if new := [value for value in seen.s.tolist() if value not in known]:
        settings = seen.inputs.campaign.reduction
        ports = full_ports(model, input_of, np.array(new), settings.band, backend=settings.backend, refine=0)
        every = np.arange(input_of.size)
        known.update({value: ports.select(np.array([k]), every) for k, value in enumerate(new)})
    own = [known[value] for value in seen.s.tolist()]
    by_line = ("s", "H00", "H0p", "Hp0", "Hpp", "D_ref")
    joined: dict[str, Any] = {name: np.concatenate([getattr(each, name) for each in own]) for name in by_line}
    return replace(own[0], **joined)


def picking(dofs: Integers, size: int) -> sp.csc_array:
    """(k, size) matrix that picks DOFs, one in each row."""
    return sp.csc_array((np.ones(dofs.size), (np.arange(dofs.size), dofs)), (dofs.size, size))


def with_ports(model: FeModel, dofs: Integers) -> FeModel:
    """A model with a further load and a further output at each of some DOFs, for ``full_frfs``."""
    at = picking(dofs, model.size)
    return replace(model, B=sp.hstack([model.B, at.T], format="csc"), L=sp.vstack([model.L, at], format="csc"), extras={})


def at_values(H: Complexes, further: Complexes, *, terms: bool = False) -> Complexes:
    """(F, n_out, n_in) FRFs with other dynamic values of the terms, eq. (18).

    Parameters
    ----------
    H : (F, n_out + m, n_in + m) complex array
        Of ``full_frfs``, or of this function with ``terms``.
    further : (F, m) complex array
        The values less those in ``H``.
    terms : bool
        Whether the ports of the terms are kept: then (F, n_out + m, n_in + m).
    """
    count, changed = further.shape[1], np.flatnonzero((further != 0.0).any(axis=0))
    outputs, loads, further = H.shape[1] - count, H.shape[2] - count, further[:, None, changed]
    last, end = (H.shape[1], H.shape[2]) if terms else (outputs, loads)
    rows, columns = H[:, outputs + changed], H[:, :last][:, :, loads + changed]
    held = np.linalg.solve(np.eye(changed.size) + rows[:, :, loads + changed] * further, rows[:, :, :end])
    found: Complexes = H[:, :last, :end] - (columns * further) @ held
    return found


def ported(seen: Seen, model: FeModel) -> PortFrf:
    """Port FRFs of another model by full solves on the lines of ``seen``."""
    settings = seen.inputs.campaign.reduction
    return full_ports(model, seen.inputs.input_of, seen.s, settings.band, backend=settings.backend, refine=0)


def left_of(seen: Seen, values: Complexes) -> tuple[float, float]:
    """Level misfit with other computed FRFs (F, R), median over the responses, and the constant that it leaves out [dB]."""
    difference = levels(seen.measured) - levels(values)
    return float(np.median(spread(difference, 0))), float(np.nanmedian(difference))


def peak_lines(values: Complexes, *, prominence: float = 3.0) -> Integers:
    """Lines at which the mean level of the responses has a resonance, by at least ``prominence`` [dB]."""
    level, at = levels(values), np.arange(len(values))
    there = np.isfinite(level)
    # Values that are mostly noise were left out: straight between their neighbours.
    known = [np.interp(at, at[own], level[own, r]) for r, own in enumerate(there.T) if 2 * own.sum() > own.size]
    return peaks_of(np.mean(known, axis=0), prominence=prominence) if known else np.zeros(0, dtype=np.int64)


def resonances(values: Complexes) -> int:
    """Number of resonances in the mean level of (F, R) FRFs, at least one."""
    return max(peak_lines(values).size, 1)
