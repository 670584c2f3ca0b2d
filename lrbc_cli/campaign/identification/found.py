"""Results of one job: ``Fit`` passes from step to step of the identification, ``Identification`` goes on to the judgement and the files."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from lrbc_cli.arrays import Bools, Complexes, Floats, Integers
from lrbc_cli.campaign.identification.gains import Gains
from lrbc_cli.campaign.identification.records import Measurement
from lrbc_cli.model.terms import Parameterisation
from lrbc_cli.updating.judging.reference import ReferenceState
from lrbc_cli.updating.misfit.cost import Misfit
from lrbc_cli.updating.posterior.fit import Posterior
from lrbc_cli.updating.posterior.samples import ChangeSamples
from lrbc_cli.updating.search.lcurve import LCurve
from lrbc_cli.updating.search.optimise import Solution
from lrbc_cli.updating.statistics.saturation import Saturation


@dataclass(frozen=True, kw_only=True)
class Fit:
    """A fit to the measurement, absolute or relative to the reference job.

    Attributes
    ----------
    measured : (m, U) complex array
        What the FRFs of the model are compared with, on the selected lines, nuisance parameters taken out at their estimates.
    relative : bool
        The measurement was corrected by the model discrepancy of the reference state.
    plain : Misfit
        Cost about ``measured``, without nuisance parameters.
    misfit : Misfit
        Cost with nuisance parameters; the same as ``plain`` without any.
    solution : Solution
    knowledge : Posterior
    curve : LCurve or None
    evaluations : int
        Evaluations of the cost.
    """

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
        """Mean absolute difference over the lines compared, without a gain that is marginalised [dB]."""
        return self.plain.mean_db(self.plain.model.frf(self.solution.theta))

    def after(self, evaluations: int) -> Fit:
        """The same, with the evaluations of other attempts added."""
        solution = replace(self.solution, evaluations=self.solution.evaluations + evaluations)
        return replace(self, solution=solution, evaluations=self.evaluations + evaluations)


@dataclass(frozen=True, kw_only=True)
class Identification:
    """Result of one job.

    Attributes
    ----------
    name : str
    solution : Solution
        Its theta holds the values of ``parameters``, without nuisance parameters.
    parameters : Parameterisation
    saturations : dict
        Where the FRFs saturate, by stiffness group.
    measurement : Measurement
    selected : int array
        Lines that entered the cost.
    initial, updated : (F, R) complex arrays
        FRFs of the model on all measured lines; the latter with nuisance parameters and gains.
    misfit_initial, misfit_final : (R,) float arrays
        Mean absolute dB difference over all lines of the band.
    notes : tuple of str
        On weights, on the choice of the regularisation, and on what was compared.
    posterior : Posterior
    opens : two (size,) bool arrays
        Whether each value may be free, and whether it may be clamped: True if the data do not exclude it.
    prior : (size,) float array
        Theta of the reference job, or the start values.
    against_reference : bool
        The unknowns are changes against the reference job.
    relative : bool
        The measurement was corrected by the model discrepancy of the reference state.
    line_evaluations : int
    seconds : dict
        Wall time of each step [s].
    regularisation : float
        Weight of the penalty [dB² per decade²].
    l_curve : LCurve or None
        If the weight was chosen by it.
    changes : ChangeSamples or None
        Sampled changes at the bolts, if their prior is a mixture.
    beyond : (b,) float array or None
        How much further joints may have loosened than their samples say, see ``sampling.beyond_of`` [decades].
    warnings : tuple of str
        Notes that the user has to act on.
    reference : ReferenceState or None
        Of the reference job, if it is another job and has a result.
    tight : Measurement or None
        Of the reference job, if it can be read.
    expected : (F, R) complex array or None
        Measured FRFs of the reference job times the identified change; None without that measurement, or if its lines differ.
    gains : Gains or None
        Relative to the reference job, in the reference job to the model; ``updated`` contains them and those of the reference job.
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
