"""What one updating job found."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from lrbc_cli.arrays import Bools, Complexes, Floats, Integers
from lrbc_cli.campaign.identification.gains import Gains
from lrbc_cli.campaign.identification.records import Measurement
from lrbc_cli.model.terms import Parameterisation
from lrbc_cli.updating.judging.reference import ReferenceState
from lrbc_cli.updating.misfit.cost import Misfit
from lrbc_cli.updating.posterior.fit import Posterior
from lrbc_cli.updating.posterior.mixture import ChangeSamples
from lrbc_cli.updating.search.lcurve import LCurve
from lrbc_cli.updating.search.optimise import Solution
from lrbc_cli.updating.statistics.saturation import Saturation


@dataclass(frozen=True, kw_only=True)
class Fit:
    """One way to compare, carried through; ``plain`` is the cost about the measurement without what drifted."""

    measured: Complexes
    relative: bool
    plain: Misfit
    misfit: Misfit
    solution: Solution
    knowledge: Posterior
    curve: LCurve | None
    evaluations: int

    @property
    def left_db(self) -> float:
        """Mean difference at the lines compared, a gain that is allowed for taken out [dB]."""
        return self.plain.mean_db(self.plain.model.frf(self.solution.theta))

    def after(self, evaluations: int) -> Fit:
        """The same, with what was evaluated on another way."""
        solution = replace(self.solution, evaluations=self.solution.evaluations + evaluations)
        return replace(self, solution=solution, evaluations=self.evaluations + evaluations)


@dataclass(frozen=True, kw_only=True)
class Identification:
    """Result of one job.

    Attributes
    ----------
    name : str
    solution : Solution
        Its theta is that of ``parameters``.
    parameters : Parameterisation
    saturations : dict
        By stiffness group.
    measurement : Measurement
    selected : int array
        Lines that entered the cost.
    initial, updated : (F, R) complex arrays
        FRFs of the model on all measured lines, what drifted included in the latter.
    misfit_initial, misfit_final : (R,) float arrays
        Mean absolute dB difference over all lines of the band.
    notes : tuple of str
        On weights, on the choice of the regularisation, on what was compared.
    posterior : Posterior
    opens : two (size,) bool arrays
        Whether the data object to each value being free, or clamped; True where they do not.
    prior : (size,) float array
    against_reference : bool
        The unknowns are changes against the reference job.
    relative : bool
        The measurement was corrected by the model discrepancy of the reference state.
    line_evaluations : int
    seconds : dict
    regularisation : float
        Weight of the penalty [dB² per decade²].
    l_curve : LCurve or None
        Where the weight was chosen by it.
    changes : ChangeSamples or None
        Changes at the bolts where their prior is a mixture.
    beyond : (b,) float array or None
        How much further those of joints may have loosened, see ``sampling.beyond_of`` [decades].
    warnings : tuple of str
        Those of the notes that a user has to act on.
    reference : ReferenceState or None
        Of the reference job, where there is another and it has a result.
    tight : Measurement or None
        Of that job, where it can be read.
    expected : (F, R) complex array or None
        What the reference job measured, with the change that was identified; None without it, or on other lines.
    gains : Gains or None
        Against the reference job, in that itself against the model; part of ``updated``, as those of the reference job are.
    """

    name: str
    solution: Solution = field(repr=False)
    parameters: Parameterisation
    saturations: dict[str, Saturation]
    measurement: Measurement = field(repr=False)
    selected: Integers = field(repr=False)
    initial: Complexes = field(repr=False)
    updated: Complexes = field(repr=False)
    misfit_initial: Floats = field(repr=False)
    misfit_final: Floats = field(repr=False)
    notes: tuple[str, ...]
    posterior: Posterior = field(repr=False)
    opens: tuple[Bools, Bools] = field(repr=False)
    prior: Floats = field(repr=False)
    against_reference: bool = False
    relative: bool = False
    line_evaluations: int = 0
    seconds: dict[str, float] = field(default_factory=dict)
    regularisation: float = 0.0
    l_curve: LCurve | None = None
    changes: ChangeSamples | None = None
    beyond: Floats | None = None
    warnings: tuple[str, ...] = ()
    reference: ReferenceState | None = field(default=None, repr=False)
    tight: Measurement | None = field(default=None, repr=False)
    expected: Complexes | None = field(default=None, repr=False)
    gains: Gains | None = None
