"""Options of a reduction and its result: the reduced model with held-out errors, error bound, trace and costs."""

from __future__ import annotations

from dataclasses import dataclass, field

from lrbc_cli.arrays import Floats
from lrbc_cli.reduction.reduced.model import ReducedModel


@dataclass(frozen=True, kw_only=True)
class ReductionOptions:
    """Settings that determine the reduced model.

    Attributes
    ----------
    band_hz : (float, float)
        Ends of the band [Hz].
    tolerance : float
        Largest relative error of y, for each line and physical quantity.
    held_out : int
        Number of lines outside the basis at which the final error is measured.
    max_points : int
        Largest number of expansion points.
    max_size : int or None
        Largest number of reduced DOFs; None: no limit.
    """

    band_hz: tuple[float, float]
    tolerance: float = 1e-3
    held_out: int = 5
    max_points: int = 400
    max_size: int | None = None


@dataclass(frozen=True)
class HeldOut:
    """Measured errors at one held-out line, a line that was not used to build the basis.

    Attributes
    ----------
    frequency_hz : float
    errors : dict
        Largest relative error of y by kind of parameter vector (``ERROR_KINDS``).
    """

    frequency_hz: float
    errors: dict[str, float]

    @property
    def worst(self) -> float:
        """Largest error over all kinds."""
        return max(self.errors.values())


@dataclass(frozen=True, kw_only=True)
class Step:
    """One step in the trace of a reduction: a factorisation, or the compression of the basis.

    Attributes
    ----------
    frequency_hz : float
        Line that was factorised; NaN for the compression and for a model kept whole.
    size : int
        Reduced DOFs after the step.
    order, added : int
        Number of moments, and of directions, added to the basis.
    measured_error : float or None
        Of the basis before the step; None if it was not measured.
    grid_hz, estimate : (F,) float arrays
        Estimated error over the band after the step; NaN if it was not estimated.
    """

    frequency_hz: float
    size: int
    order: int
    added: int
    measured_error: float | None
    grid_hz: Floats = field(repr=False)
    estimate: Floats = field(repr=False)


@dataclass(frozen=True, kw_only=True)
class Reduction:
    """A reduced model with its certificate (measured errors and error bound) and its costs.

    Attributes
    ----------
    model : ReducedModel
    options : ReductionOptions
    reached : bool
        Whether every measured error is at most the tolerance.
    held_out : tuple of HeldOut
    unseen : float
        Statistical bound of the error at the other lines of the band (``unseen_bound``); NaN with fewer than two held-out lines.
    trace : tuple of Step
    seconds : dict
        ``full_line`` (one line of the full model: shortest factorisation, one solve, one refinement step), ``factor`` (shortest
        factorisation), ``basis``, ``projection``, ``estimate``, ``compression``, ``certificate``, ``total``.
    backend : str
        ``superlu`` or ``pardiso``.
    coupling : str
        Symmetry of the system in words, from ``Coupling``.
    sizes : tuple of int
        Reduced DOFs of each field.
    full_size : int
        DOFs of the full model.
    vectors : int
        Parameter vectors for which each held-out error was measured.
    machine : dict
        Platform, processor and cores on which the seconds were measured.
    date : str
        Date and time, UTC.
    stopped : str
        Why the basis was not extended further, if the tolerance was not reached; else empty.
    rows : (k, r) float array or None
        Rows of the basis at the requested DOFs.
    """

    model: ReducedModel
    options: ReductionOptions
    reached: bool
    held_out: tuple[HeldOut, ...] = field(repr=False)
    unseen: float
    trace: tuple[Step, ...] = field(repr=False)
    seconds: dict[str, float] = field(repr=False)
    backend: str
    coupling: str
    sizes: tuple[int, ...]
    full_size: int
    vectors: int
    machine: dict[str, str | int] = field(repr=False)
    date: str
    stopped: str = ""
    rows: Floats | None = field(default=None, repr=False)

    @property
    def worst(self) -> float:
        """Largest measured error at a held-out line; NaN without any."""
        return max((line.worst for line in self.held_out), default=float("nan"))
