"""Judging: from what an identification says of the bolts to verdicts, by a decision rule. A pure function of values."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.special import ndtr

from lrbc_cli.updating.comparison.scale import DEVIATION
from lrbc_cli.updating.judging.evidence import USED, VALIDATION, BoltEvidence, Change, Evidence

#: Words of a verdict; that on a bolt that no term reaches: the FRFs say nothing of it, so it has no numbers.
TIGHT, LOOSE, UNDECIDED, OUTSIDE = "tight", "loose", "undecided", "outside"

#: What is said of a bolt that cannot well have been tight in the tight state.
FALLEN = "far looser than the other bolts"


#: What a job is in its campaign: the tight state itself, a further tight state, or one of unknown state.
REFERENCE, BASELINE, JOB = "reference", "baseline", "job"


@dataclass(frozen=True)
class TightScatter:
    """Changes between tight states.

    Attributes
    ----------
    rms : float
        [decades].
    baselines : int
        Of how many further tight states.
    """

    rms: float = 0.0
    baselines: int = 0


#: Of a campaign without baselines.
NO_SCATTER = TightScatter()


@dataclass(frozen=True, kw_only=True)
class DecisionRule:
    """When a bolt is judged, and when none may be.

    Attributes
    ----------
    loose_change : float
        Change of log10 stiffness below which a bolt is loose, where its posterior is Gaussian (negative) [decades]. A
        choice: a third of the stiffness is left.
    mixture_change : float
        The same where the change was sampled as tight or loose: less spreads to the neighbours. A choice; with it no bolt of the 50 tight
        campaigns of the benchmarks was called loose.
    confidence : float
        Posterior probability that a verdict, loose or tight, needs.
    largest_misfit : float
        Mean misfit above which the model does not explain the measurement, so that no bolt is judged [dB].
    validated_misfit : float
        Mean misfit above which nothing is validated, whatever limit a campaign sets; √2 times that of the reference job counts as one, too
        [dB]. The usual ``largest_misfit``.
    misfit_margin : float
        Mean misfit above that of the reference job, over the same channels, from which on the state is not explained either [dB]. A choice:
        states of the samples lie within 0.3, of virtual rigs within 0.9 of their reference. No less than ``largest_misfit`` where that is
        given.
    scatter_margin : float
        Standard deviations of the changes between tight states that the threshold keeps from zero: of a normal distribution 1 in 30 000
        lies beyond four.
    joint_margin : float
        The same of joints, where tight states scatter by a quarter of a decade. A choice; with ``joint_spread`` a joint is loose from 3.3
        of these standard deviations on (1 tight one in 2000), and tight down to 1.7.
    joint_scatter : float
        Standard deviation of the changes of joints between tight states where no baseline tells it [decades]: torques that scatter by 30 %
        in both states, and a seat. 0.18 to 0.28 on virtual rigs.
    joint_assumed : float
        Baselines that ``joint_scatter`` counts as where those measured scatter less. A choice: a single one, of a dozen joints, stated 0.06
        to 0.36 decades on 20 virtual campaigns whose tight joints scatter by 0.16 to 0.23.
    joint_spread : float
        Share of that scatter by which the posterior of a joint's change is widened: the rest is what tight joints do, not an error of this
        change. A choice.
    contrast_quantile : float
        Without a tight state bolts are compared with this quantile of them. A choice: some of a row may be loose.
    implausible_rise : float
        A bolt tighter than in the tight state by this many standard deviations of its prior is an error of the model: of a normal
        distribution 1 in 160 lies beyond 2.5.
    copied_db : float
        Jobs hold one measurement, written with other digits, where all figures of its levels differ by no more [dB]: no two blows of a
        hammer give the same means over hundreds of lines.
    """

    loose_change: float = -0.5
    mixture_change: float = -0.35
    confidence: float = 0.95
    largest_misfit: float = 3.0
    validated_misfit: float = 3.0
    misfit_margin: float = 1.5
    scatter_margin: float = 4.0
    joint_margin: float = 2.5
    joint_scatter: float = 0.2
    joint_assumed: float = 2.0
    joint_spread: float = 0.5
    contrast_quantile: float = 0.75
    implausible_rise: float = 2.5
    copied_db: float = 2e-4

    def scatter(self, measured: TightScatter, joint: bool) -> float:
        """Standard deviation of the changes between tight states [decades]: as baselines tell it, or of joints without any as assumed."""
        if not joint:
            return measured.rms
        assumed, told = self.joint_assumed, measured.baselines
        believed = np.sqrt((assumed * self.joint_scatter**2 + told * measured.rms**2) / (assumed + told))
        return max(measured.rms, float(believed))

    def limit(self, change: float, scatter: float, joint: bool = False) -> float:
        """A threshold, or further down where tight states scatter that much [decades]."""
        return min(change, -(self.joint_margin if joint else self.scatter_margin) * scatter)

    def most_db(self, before: float | None) -> float:
        """Mean misfit above which a state is not explained [dB], that of the reference job being ``before``; None: not known."""
        return self.largest_misfit if before is None else min(self.largest_misfit, before + self.misfit_margin)

    def word(self, probability: float) -> str:
        """Verdict at a posterior probability of being loose."""
        return LOOSE if probability >= self.confidence else TIGHT if probability <= 1.0 - self.confidence else UNDECIDED


@dataclass(frozen=True, kw_only=True)
class Validity:
    """Whether the model explains the measurement.

    Attributes
    ----------
    passed : bool or None
        By the validation channels; None where there are none and nothing speaks against it: then it is not validated.
    compared : str or None
        The channels whose misfit was compared: ``validation channels`` or ``channels used``.
    misfit_db : float or None
        Their mean misfit.
    limit_db : float
    reason : str
    unvalidated : str
        Why it is not validated, where nothing speaks against it.
    """

    passed: bool | None
    compared: str | None
    misfit_db: float | None
    limit_db: float
    reason: str
    unvalidated: str = ""

    @property
    def explained(self) -> bool:
        """Whether bolts may be judged."""
        return self.passed is not False


@dataclass(frozen=True, kw_only=True)
class BoltVerdict:
    """What is said of one bolt.

    Attributes
    ----------
    name : str
    verdict : str
        ``tight``, ``loose``, ``undecided``, or ``outside`` where no term reaches the bolt.
    note : str or None
    log10_stiffness : float or None
    change, change_std : float or None
        Against the tight state, and its standard deviation, scatter of tight states included [decades].
    probability_loose : float or None
        That the change lies below the threshold.
    threshold : float or None
        Of the change [decades].
    suspect : bool
        Taken as tight, but it would be loose in another job, or in the reference job lies far below the other bolts.
    """

    name: str
    verdict: str
    note: str | None = None
    log10_stiffness: float | None = None
    change: float | None = None
    change_std: float | None = None
    probability_loose: float | None = None
    threshold: float | None = None
    suspect: bool = False


@dataclass(frozen=True, kw_only=True)
class Judgement:
    """What is said of a job.

    Attributes
    ----------
    validity : Validity
    bolts : tuple of BoltVerdict
        In the order of the evidence.
    implausible : tuple of str
        Bolts that come out tighter than in the tight state by more than their prior allows.
    alternatives : tuple of (tuple of str, float)
        Bolts below their threshold in each of several states of nearly equal posterior probability; empty where these agree.
    fallen : dict
        How far bolts lie below the others of the tight state, by name, where they hardly can have been tight there [decades].
    """

    validity: Validity
    bolts: tuple[BoltVerdict, ...]
    implausible: tuple[str, ...]
    alternatives: tuple[tuple[tuple[str, ...], float], ...] = ()
    fallen: dict[str, float] = field(default_factory=dict)


def validity(evidence: Evidence, rule: DecisionRule) -> Validity:
    """Compare the misfit of the validation channels with ``rule.largest_misfit``, and with that of the reference job and a margin.

    The channels used must stay below it too, which is necessary and shows nothing: they were fitted, and where they are not explained a
    sensor may sit elsewhere than the model has it. So must both of the reference job: what the model does not explain is no state to
    compare with. Nor does a measurement that was not exchanged tell anything of the bolts. A limit that was raised lets bolts be judged,
    but above the usual one nothing is validated, nor is a change from a reference job that is known to within the limit only: it is the
    difference of two states, each as wrong as that one.
    """
    limit, misfit = rule.most_db(evidence.reference_misfit_db), evidence.misfit_db
    beside = f", {rule.misfit_margin:g} dB above the reference job" if limit < rule.largest_misfit else ""
    if misfit is None:
        return Validity(passed=False, compared=None, misfit_db=None, limit_db=limit, reason="no response can be compared")
    compared, fitted = evidence.compared, evidence.used_misfit_db
    if misfit <= limit and fitted is not None and fitted > rule.largest_misfit:
        compared, misfit, limit, beside = USED, fitted, rule.largest_misfit, ""
    within = misfit <= limit
    side = "within" if within else "above"
    reason = f"mean misfit of the {compared} {misfit:.2f} dB, {side} the limit of {limit:.3g} dB{beside}"
    for of, before in ((evidence.compared, evidence.reference_misfit_db), (USED, evidence.reference_used_misfit_db)):
        if within and before is not None and before > rule.largest_misfit:
            within = False
            most = f"{before:.2f} dB, above the limit of {rule.largest_misfit:.3g} dB"
            reason += f", but of the {of} of the reference job, with which it is compared, {most}"
    before = max(db or 0.0 for db in (evidence.reference_misfit_db, evidence.reference_used_misfit_db))
    worst = max(db for db in (misfit, fitted, before) if db is not None)
    usual = rule.validated_misfit
    raised = f"a misfit of {worst:.2f} dB validates nothing: the limit was raised from {usual:g} dB" if worst > usual else ""
    both = math.hypot(before, before)
    coarse = (
        f"the model explains the reference job to {before:.2f} dB, so that a change from it, a difference of two such states, may err "
        f"by {both:.2f} dB, above {usual:g} dB: improve model or calibration"
    )
    unvalidated = evidence.doubted or (evidence.unvalidated if evidence.compared != VALIDATION else "") or raised
    unvalidated = unvalidated or (coarse if both > usual else "")
    if not within or not unvalidated:
        return Validity(passed=within, compared=compared, misfit_db=misfit, limit_db=limit, reason=reason)
    reason = f"not validated: {unvalidated}; {reason}"
    return Validity(passed=None, compared=compared, misfit_db=misfit, limit_db=limit, reason=reason, unvalidated=unvalidated)


def judge(evidence: Evidence, rule: DecisionRule, role: str = JOB, scatter: TightScatter = NO_SCATTER) -> Judgement:
    """Judge the bolts of a job.

    Parameters
    ----------
    evidence : Evidence
    rule : DecisionRule
    role : str
        ``reference``, ``baseline`` or ``job``.
    scatter : TightScatter
        Of the changes between tight states, see ``scatter_of``; none where there is only one.

    Returns
    -------
    Judgement
        Without stiffness along edges every bolt is undecided.
    """
    valid = validity(evidence, rule)
    felt = [bolt.felt for bolt in evidence.bolts if bolt.felt is not None]
    level = float(np.quantile(felt, rule.contrast_quantile)) if felt else 0.0
    fallen = fallen_bolts(evidence.bolts, rule) if role != BASELINE else {}
    found = tuple(_verdict(bolt, evidence, rule, role, scatter, level, valid.explained) for bolt in evidence.bolts)
    if role == REFERENCE and valid.explained:
        found = tuple(v if v.name not in fallen else replace(v, suspect=True, note=f"{v.note}, but {FALLEN}") for v in found)
    limit = rule.implausible_rise * evidence.prior_std
    rises = tuple(v.name for v in found if v.change_std is not None and v.change is not None and v.change > limit)
    if role == JOB and valid.explained and (rises or fallen) and not any(v.verdict == LOOSE for v in found):
        # A reference state with loose bolts shows here: what it lacked has come back, and what it lacks still is compared with itself.
        why = f"{', '.join(rises)} tighter than in the reference job" if rises else f"{', '.join(fallen)} {FALLEN} in the reference job"
        why += ": was all tight there?"
        reasons = "; ".join([why, *([valid.unvalidated] if valid.unvalidated else [])])
        valid = replace(valid, passed=None, unvalidated=reasons, reason=f"not validated: {why} {valid.reason}")
    several = _alternatives(evidence, found) if valid.explained and role == JOB else ()
    return Judgement(validity=valid, bolts=found, implausible=rises, alternatives=several, fallen=fallen)


def fallen_bolts(bolts: Sequence[BoltEvidence], rule: DecisionRule) -> dict[str, float]:
    """Bolts that in the tight state lie below the others by more than these scatter, and how far [decades].

    Bolts of the same groups are compared, with their median. Their scatter is taken from the median of the departures, which those that
    are loose do not move as long as they are the fewer, and is no less than that of tight joints.
    """
    found = {}
    tight = {
        bolt.name: (bolt.felt - (bolt.difference or 0.0), bolt.tight_std, bolt.groups)
        for bolt in bolts
        if bolt.felt is not None and bolt.tight_std is not None
    }
    for name, (value, std, own) in tight.items():
        peers = np.array([other for other, _, groups in tight.values() if groups == own])
        middle = float(np.median(peers))
        scatter = max(DEVIATION * float(np.median(np.abs(peers - middle))), rule.joint_scatter)
        limit = rule.limit(rule.loose_change, scatter)
        if float(ndtr((limit - (value - middle)) / max(std, 1e-12))) >= rule.confidence:
            found[name] = value - middle
    return found


def _alternatives(evidence: Evidence, verdicts: Sequence[BoltVerdict]) -> tuple[tuple[tuple[str, ...], float], ...]:
    found = dict[tuple[str, ...], float]()
    for changes, share in evidence.alternatives:
        both = zip(verdicts, changes, strict=True)
        loose = tuple(v.name for v, change in both if change is not None and v.threshold is not None and change <= v.threshold)
        found[loose] = found.get(loose, 0.0) + share
    return tuple(sorted(found.items(), key=lambda one: -one[1])) if len(found) > 1 else ()


def _verdict(
    bolt: BoltEvidence, evidence: Evidence, rule: DecisionRule, role: str, scatter: TightScatter, level: float, explained: bool
) -> BoltVerdict:
    """On one bolt; ``level`` is that of the others."""
    if not evidence.along_edges:
        return BoltVerdict(name=bolt.name, verdict=UNDECIDED, note="no stiffness group that bolts own or lie along")
    if bolt.outside is not None:
        return BoltVerdict(name=bolt.name, verdict=OUTSIDE, note=bolt.outside)
    word, note, change, std, probability, threshold = _by_role(bolt, evidence, rule, role, scatter, level)
    suspect = role == BASELINE and word == LOOSE
    if role == BASELINE:
        word, probability = TIGHT, None
        tight = "a baseline, taken as tight"
        note = f"{tight}, but against the reference job it comes out loose" if suspect else note or tight
    if not explained:
        word, probability, note = UNDECIDED, None, "the model does not explain the measurement"
    return BoltVerdict(
        name=bolt.name,
        verdict=word,
        note=note,
        log10_stiffness=bolt.log10_stiffness,
        change=change,
        change_std=std,
        probability_loose=probability,
        threshold=threshold,
        suspect=suspect and explained,
    )


def _by_role(
    bolt: BoltEvidence, evidence: Evidence, rule: DecisionRule, role: str, scatter: TightScatter, level: float
) -> tuple[str, str | None, float | None, float | None, float | None, float | None]:
    """Verdict, note, change and its standard deviation, probability of being loose, threshold."""
    if role == REFERENCE:
        return TIGHT, "reference state, taken as tight", 0.0, None, None, None
    if bolt.change is not None:
        posterior = bolt.change
        # Beside a gap a tight bolt takes part of it: what is below the threshold for that says nothing.
        own = rule.loose_change if posterior.sampled is None else min(rule.mixture_change, posterior.leakage)
        between = rule.scatter(scatter, bolt.joint)
        limit = rule.limit(own, between, bolt.joint)
        between *= rule.joint_spread if bolt.joint else 1.0
        probability = posterior.below(limit, between)
        word = rule.word(probability)
        note = "the data do not decide: the interval of its change holds the threshold" if word == UNDECIDED else None
        excused = _excused(posterior, own, rule) if word == TIGHT else None
        if word == TIGHT and excused is None and bolt.joint and bolt.difference is not None and bolt.difference <= limit:
            excused = "its posterior says tight, but the stiffness identified lies below the threshold"
        if word == TIGHT and posterior.may_be_free:
            excused = "the data do not object to it being free: no response feels it as it is"
        if excused is not None:
            word, note = UNDECIDED, excused
        elif word == TIGHT and posterior.unfelt:
            note = f"judged by its other springs: no response feels those of {', '.join(posterior.unfelt)}"
        change = posterior.mean if posterior.ceiling is None else min(posterior.mean, posterior.ceiling)
        return word, note, change, float(np.hypot(posterior.std, between)), probability, limit
    if evidence.missing_reference is not None:
        # Changes were wanted: a contrast between bolts is no answer.
        return UNDECIDED, f"no result of {evidence.missing_reference} to compare with", bolt.difference, None, None, None
    if bolt.difference is not None:
        return LOOSE if bolt.difference <= rule.loose_change else TIGHT, None, bolt.difference, None, None, None
    # Without a tight state nothing says that a bolt is tight: all may be loose.
    loose = bolt.felt is not None and bolt.felt - level <= rule.loose_change
    note = "no tight state to compare with: loose by contrast with the other bolts, or inconclusive"
    return LOOSE if loose else UNDECIDED, note, None, None, None, None


def _excused(posterior: Change, own: float, rule: DecisionRule) -> str | None:
    """What excuses a change that lies above its threshold, where only that does; ``own``: the threshold without scatter of tight states.

    Excuses clear no bolt, least of all one that the data do not see: of the prior itself little lies below a threshold that was lowered.
    """
    if rule.word(posterior.below(own, 0.0)) != TIGHT:
        return "no more than tight states scatter, but not clearly above the threshold without that"
    gap = posterior.sampled is not None and own < rule.mixture_change
    if gap and TIGHT not in (rule.word(posterior.below(rule.mixture_change, 0.0)), rule.word(posterior.below(own, 0.0, changed=True))):
        return "no more than the gap beside it explains, but not clearly above the threshold without that"
    return None


def scatter_of(baselines: Iterable[Sequence[BoltVerdict]]) -> TightScatter:
    """Root mean square of the changes at the bolts of further tight jobs, and how many of these tell it."""
    told = [
        [bolt.change for bolt in bolts if bolt.change is not None and bolt.change_std is not None and bolt.verdict != UNDECIDED]
        for bolts in baselines
    ]
    changes = [change for own in told for change in own]
    return TightScatter(float(np.sqrt(np.mean(np.square(changes)))), sum(bool(own) for own in told)) if changes else NO_SCATTER
