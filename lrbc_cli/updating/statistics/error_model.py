"""Errors of measurement and model: every number of the likelihood, in one place; see ``lrbc guide statistics``, sections 1 to 4."""

from __future__ import annotations

from dataclasses import dataclass

from lrbc_cli.updating.checked import Checked, Count, CountOrNone, Inside, NotNegative, Positive, Share


@dataclass(frozen=True, kw_only=True)
class ErrorModel(Checked):
    """Numbers of the covariance of the residuals: noise, model discrepancy, errors of predicted changes, correlation of lines.

    Each entry says where its number comes from; "a choice" means that no data determined it.

    Attributes
    ----------
    least_coherence : float
        Smaller coherences g² are raised to this. A choice: it only keeps sigma finite.
    first_discrepancy_db : float
        Model discrepancy ``s`` before it is estimated from residuals, and throughout if the lines have no weights; noise of this size
        halves the weight of a line's square [dB]. A choice.
    least_discrepancy_db, most_discrepancy_db : float
        Range of ``s`` [dB]: rounding of the files below, no agreement at all above.
    change_error : float
        Standard deviation of a predicted change of level, over that change: of each line by itself (``sigma_l``), and of the mean over the
        lines about a resonance (``G``). 0.1 to 0.35 (rms over the lines) when single bolts of virtual rigs are removed.
    shift_error : float
        Standard deviation of a predicted shift of a resonance, over that shift (``P``). 0.08 to 0.17 when bolts of virtual rigs are
        removed. The same share is added to the error of a joint's change, because all resonances may err alike.
    shift_knots : float
        Distance of the knots between which the shift of the frequency axis is interpolated, and width of the bands of ``G``, both over the
        highest line. A choice: resonances further apart than this err independently.
    gain_db : float
        Standard deviation of a gain that all channels of a job have relative to the reference job (another hammer, a wrong sensitivity),
        and of the gains of the reference job relative to the model [dB]. A choice that hardly matters: hundreds of lines give the gain.
    least_gain_db : float
        A gain is accepted if its 95 % interval is beyond this [dB]: 3.5 %, the accuracy to which hammers are calibrated. In 42 jobs
        without a gain, of the samples and of virtual rigs, the interval reached 0.24 dB, because loosened bolts change the damping, too.
    gain_shown : float
        Lines that are not compared must confirm a gain to within this share of it. With gains of the reference job the square of the misfit
        must also fall by the square of this share of their rms. A choice.
    astray_db : float
        Excess of the misfits of one sensor's FRFs, or one hammer point's, over those in the reference job and of the others, from which
        these do not fit [dB]. In 107 jobs of virtual rigs it was 1.2 at most without a fault, 1.9 at least where a sensor was moved by
        30 mm and more or turned, and 2.1 for a hammer point moved by 30 mm. The margin by which a job may fit worse as a whole.
    noise_window : int
        Number of lines over which the noise estimated from neighbouring lines is taken as constant. A choice: a few bandwidths of a peak.
    most_noise_db : float
        Values with more estimated noise than this (half of their size) are not compared, if the noise is known from neighbouring lines
        only [dB]. A choice.
    gain_rounds : int
        Number of times that the gain is identified again with the loss linearised about it. A choice: the last changes it by less than
        0.01 dB.
    most_correction_db : float
        Limit of the correction by the reference job [dB]: beyond it model and measurement have different resonances there.
    most_lags : int
        Largest lag of the autocorrelation of residuals, in lines. A choice: ``least_correlation`` ends the sum long before.
    least_correlation : float
        The sum over the lags ends where the autocorrelation falls below this. A choice: one standard error of 400 pairs.
    least_pairs : int
        Least number of pairs of lines for a lag to count. A choice.
    least_variance : float
        Least variance of the residuals [dB²]: below it double precision cannot separate errors of the reference state from changes.
    coarsening : float
        Number of residuals that count as one where joints are identified, because lines and responses share errors that no covariance here
        describes (coarsened posterior: Miller and Dunson, J. Am. Stat. Assoc. 114, 2019). 4 by trial on virtual rigs.
    level_error : float
        Standard deviation of the level of a joint's springs in the reference state, by errors of the model that the fit takes up and its
        residuals do not show [decades]. 0.15 to 0.35 (rms over the joints) on a lap joint, a cover, flanges, a space frame, a rail and a
        casing.
    runaway, least_runaway_db : float
        A round of weights that raises the mean misfit by this factor and this many dB is not kept: the errors assumed for a large change
        tolerate large residuals. By trial on virtual rigs.
    """

    least_coherence: Inside = 1e-4
    first_discrepancy_db: Positive = 1.0
    least_discrepancy_db: Positive = 0.01
    most_discrepancy_db: Positive = 100.0
    change_error: NotNegative = 0.25
    shift_error: NotNegative = 0.12
    shift_knots: Positive = 0.02
    gain_db: NotNegative = 1.0
    least_gain_db: NotNegative = 0.3
    gain_shown: Positive = 0.5
    astray_db: Positive = 1.5
    noise_window: Count = 15
    most_noise_db: Positive = 3.0
    gain_rounds: CountOrNone = 2
    most_correction_db: Positive = 6.0
    most_lags: CountOrNone = 20
    least_correlation: Share = 0.05
    least_pairs: Count = 10
    least_variance: Positive = 1e-6
    coarsening: Positive = 4.0
    level_error: NotNegative = 0.25
    runaway: Positive = 1.5
    least_runaway_db: NotNegative = 0.1

    def coarsening_of(self, joints: bool) -> float:
        """Number of residuals that count as one: ``coarsening`` for joints; 1 along edges, where neighbours hold a value."""
        return self.coarsening if joints else 1.0


#: The defaults, for callers that use a part of the package by itself.
ERRORS = ErrorModel()
