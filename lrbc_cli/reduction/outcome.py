"""What a reduction is asked for, and what it gives: options, held-out errors, trace, certificate."""

from __future__ import annotations

from dataclasses import dataclass, field

from lrbc_cli.arrays import Floats
from lrbc_cli.reduction.reduced.model import ReducedModel

#: Increased whenever the same input would give another basis.
ALGORITHM_VERSION = 13


@dataclass(frozen=True)
class ReductionOptions:
    """What decides about the reduced model.

    Attributes
    ----------
    band_hz : (float, float)
    tolerance : float
        Relative error of y, per line and physical quantity.
    held_out : int
        Lines outside the basis at which the final error is measured.
    max_points : int
        Expansion points after which the reduction gives up.
    max_size : int or None
        Reduced DOFs at most.
    """

    band_hz: tuple[float, float]
    tolerance: float = 1e-3
    held_out: int = 5
    max_points: int = 400
    max_size: int | None = None


@dataclass(frozen=True)
class HeldOut:
    """Measured errors at one line outside the basis.

    Attributes
    ----------
    frequency_hz : float
    errors : dict
        Worst relative error of y by kind of parameter vector.
    """

    frequency_hz: float
    errors: dict[str, float]

    @property
    def worst(self) -> float:
        """Largest of them."""
        return max(self.errors.values())


@dataclass(frozen=True, kw_only=True)
class Step:
    """One factorisation in the trace, or the compression of the basis.

    Attributes
    ----------
    frequency_hz : float
        NaN for the compression.
    size : int
        Reduced DOFs after the step.
    order, added : int
        Moments and directions that the basis got.
    measured_error : float or None
        Of the basis before the step.
    grid_hz, estimate : (F,) float arrays
        Estimated error over the band after the step; NaN where the basis did not change or nobody looked.
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
    """A reduced model with its certificate and its costs.

    Attributes
    ----------
    model : ReducedModel
    options : ReductionOptions
    reached : bool
        Whether every measured error is at most the tolerance.
    held_out : tuple of HeldOut
    unseen : float
        Statistical bound of the error at the other lines of the band (``unseen_bound``); NaN where it could not be taken.
    trace : tuple of Step
    seconds : dict
        ``full_line`` (median of factorisation + one solve + one refinement step), ``factor``, ``basis``, ``projection``,
        ``estimate``, ``compression``, ``certificate``, ``total``.
    backend : str
    coupling : str
    sizes : tuple of int
        Reduced DOFs of each field.
    full_size : int
        DOFs of the full model.
    vectors : int
        Parameter vectors for which each held-out error was measured.
    machine : dict
        Where the seconds were measured.
    date : str
        When, UTC.
    stopped : str
        What kept the basis from growing where the tolerance was not reached.
    rows : (k, r) float array or None
        Of the basis, at the DOFs for which they were asked.
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
        """Largest measured error."""
        return max((line.worst for line in self.held_out), default=float("nan"))
