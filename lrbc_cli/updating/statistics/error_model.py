"""How measurement and model may be wrong: every number of the likelihood, in one place; see ``lrbc guide statistics``, sections 2 to 4."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class ErrorModel:
    """Covariance of the residuals: measurement noise, model discrepancy, errors of predicted changes, and what lines share.

    Attributes
    ----------
    least_coherence : float
        Coherences below this say no more than that there is nothing but noise. A choice: it only keeps sigma finite.
    first_discrepancy_db : float
        Model discrepancy ``s`` before residuals tell it, and where nothing is known of the measurement noise, against which a line loses
        half of its weight [dB]. A choice.
    least_discrepancy_db, most_discrepancy_db : float
        Range of ``s`` [dB]: digits of the files below, no model at all above.
    change_error : float
        Standard deviation of the change of a level that a model predicts, over that change: of each line for itself, and of the mean
        over the lines about a resonance together. 0.1 to 0.35 (rms over the lines) where single bolts of virtual rigs are removed.
    shift_error : float
        Standard deviation of the shift of a resonance that a model predicts, over that shift. 0.08 to 0.17 where bolts of virtual rigs
        are removed. Of it what all resonances share is an error of a joint's change, over that change.
    shift_knots : float
        Distance of the knots between which such errors of the frequency axis are interpolated, over the highest line, and width of the
        bands whose lines share an error of their mean change. A choice: resonances further apart than this err independently.
    gain_db : float
        Standard deviation of a gain that all channels of a job have and those of the reference job have not, another hammer or a
        sensitivity typed anew; and of one that the reference job has against the model [dB]. A choice: hundreds of lines tell the
        gain, this number hardly matters.
    least_gain_db : float
        A gain is allowed for where its 95 % interval lies beyond this: 3.5 %, to which hammers are calibrated [dB]. In 42 right jobs of
        the samples and of virtual rigs the interval came to 0.24 dB: loosened bolts change the damping, too.
    gain_shown : float
        Share of a gain that lines that are not compared have to show, and, against the model, the misfit to gain by it. A choice.
    noise_window : int
        Lines over which noise is taken as the same where neighbouring lines tell it. A choice: a few bandwidths of a peak.
    most_noise_db : float
        Values with more noise than this by their neighbours, half of their size, are not compared where nothing else tells it. A choice.
    gain_rounds : int
        So often it is found anew with the loss linearised about it. A choice: the last changes it by less than 0.01 dB.
    most_correction_db : float
        A correction by the reference job may not exceed this [dB]: beyond it model and measurement have different resonances there.
    most_lags : int
        Correlations of residuals are followed over at most so many lines. A choice: they end at ``least_correlation`` long before.
    least_correlation : float
        No further than where they fall below this. A choice: one standard error of 400 pairs.
    least_pairs : int
        Fewer pairs of lines than this say nothing about a lag. A choice.
    least_variance : float
        Least variance of the residuals [dB²]: below it errors of the reference state and changes cannot be told apart in double precision.
    coarsening : float
        How many residuals tell as much as one would if the model were exact: errors that no covariance here knows are shared by lines and
        responses (coarsened posterior: Miller and Dunson, J. Am. Stat. Assoc. 114, 2019). 4 by trial on virtual rigs.
    runaway, least_runaway_db : float
        A round of weights that makes the mean misfit larger by this factor and so many dB is not kept: weights of a loosened state forgive
        the tight one. By trial on virtual rigs.
    """

    least_coherence: float = 1e-4
    first_discrepancy_db: float = 1.0
    least_discrepancy_db: float = 0.01
    most_discrepancy_db: float = 100.0
    change_error: float = 0.25
    shift_error: float = 0.12
    shift_knots: float = 0.02
    gain_db: float = 1.0
    least_gain_db: float = 0.3
    gain_shown: float = 0.5
    noise_window: int = 15
    most_noise_db: float = 3.0
    gain_rounds: int = 2
    most_correction_db: float = 6.0
    most_lags: int = 20
    least_correlation: float = 0.05
    least_pairs: int = 10
    least_variance: float = 1e-6
    coarsening: float = 4.0
    runaway: float = 1.5
    least_runaway_db: float = 0.1


#: The defaults, for those who call a part alone.
ERRORS = ErrorModel()
