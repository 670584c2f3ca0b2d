"""What identifications are worth once the truth is known: figures over bolts and jobs, from stored results alone.

No figure is computed on what a run claims of itself: the removed bolts come from ``truth.json``, which the identification never reads.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from lrbc_cli.updating.unknowns.places import Edge, foot, pitch_of

Floats = NDArray[np.float64]

#: Distances along the edge are compared up to this share of a pitch.
ROUND = 1e-6

#: A job without a probability for a bolt says nothing of it.
NO_PROBABILITY = 0.5

Score = Literal["probability", "change"]


@dataclass(frozen=True)
class BoltScore:
    """One bolt of one job.

    Attributes
    ----------
    campaign, job, bolt : str
    position : float
        Along the edge [m].
    removed : bool
        By the truth.
    near : bool
        A term lies within half a pitch.
    interior : bool
        More than a pitch from both ends of the edge.
    change, std : float or None
        As the job has them [decades].
    probability : float or None
    verdict : str
    """

    campaign: str
    job: str
    bolt: str
    position: float
    removed: bool
    near: bool
    interior: bool
    change: float | None
    std: float | None
    probability: float | None
    verdict: str

    @property
    def decided(self) -> bool:
        """Whether there is a verdict."""
        return self.verdict in ("tight", "loose")

    @property
    def wrong(self) -> bool:
        """Whether there is one, and it is not the truth."""
        return self.decided and (self.verdict == "loose") != self.removed

    def score(self, by: Score) -> float:
        """Larger for what is more likely loose."""
        if by == "probability":
            return NO_PROBABILITY if self.probability is None else self.probability
        return 0.0 if self.change is None else -self.change


@dataclass(frozen=True)
class JobScore:
    """One job.

    Attributes
    ----------
    campaign, job, status : str
    role : str
        ``reference``, ``baseline`` or ``judged``.
    removed : tuple of str
    pitch : float
        Of the bolts [m].
    bolts : tuple of BoltScore
    contrast : float or None
        Mean log10 stiffness within half a pitch of tight bolts (or of the same places in the reference state, where none is left), less
        that within half a pitch of removed ones [decades].
    misfit_initial, misfit, held_out : float or None
        Mean absolute difference [dB] over all lines of the band: responses used (start, end), the others.
    sigma, factor : float or None
        Standard deviation of the residuals [dB] and inflation by their correlation.
    relative : bool
        Compared after correcting the measurement by the reference job.
    damping_exponent : float or None
    drift : mapping
        What the job says has drifted.
    evaluations : int
    seconds : float or None
    notes : tuple of str
    """

    campaign: str
    job: str
    status: str
    role: str
    removed: tuple[str, ...]
    pitch: float
    bolts: tuple[BoltScore, ...]
    contrast: float | None = None
    misfit_initial: float | None = None
    misfit: float | None = None
    held_out: float | None = None
    sigma: float | None = None
    factor: float | None = None
    relative: bool = False
    damping_exponent: float | None = None
    drift: Mapping[str, Any] | None = None
    evaluations: int = 0
    seconds: float | None = None
    notes: tuple[str, ...] = ()


def place_bolts(tree: Mapping[str, Any]) -> tuple[Edge, Floats, float]:
    """The edge of a result with one stiffness group, where its bolts stand along it [m], and their pitch [m]."""
    (group,) = [g for g in tree["parameters"].values() if g["kind"] == "stiffness"]
    arc = np.array(group["arc_length"], dtype=float)
    edge = Edge(
        xyz=np.array(group["positions"], dtype=float),
        arc_length=arc,
        log10=np.array(group["log10_effective"], dtype=float),
        cap=np.inf,
        reference=None,
    )
    xyz = np.array([bolt["position"] for bolt in tree["bolts"]], dtype=float)
    return edge, np.array([foot(edge.xyz, edge.arc_length, point)[0] for point in xyz]), pitch_of(xyz)


def score_job(campaign: str, tree: Mapping[str, Any], reference: Mapping[str, Any], removed: Sequence[str], role: str) -> JobScore:
    """Compare a result with the truth.

    Parameters
    ----------
    campaign : str
    tree, reference : mapping
        ``result.json`` of the job and of the reference job, which serves for geometry where the job failed.
    removed : sequence of str
        By the truth.
    role : str
        See ``JobScore``.
    """
    failed = tree["status"] == "failed"
    edge, at, pitch = place_bolts(reference if failed else tree)
    arc = edge.arc_length
    away = np.abs(arc[None, :] - at[:, None])
    near = away.min(axis=1) <= 0.5 * pitch * (1 + ROUND)
    # Terms stand at the free nodes: the clamped end of the edge lies one spacing beyond the last of them.
    spacing = float(np.median(np.diff(arc)))
    inside = np.minimum(at - (arc[0] - spacing), arc[-1] + spacing - at)
    bolts = tuple(
        BoltScore(
            campaign,
            tree["job"],
            bolt["name"],
            float(at[i]),
            bolt["name"] in removed,
            bool(near[i]),
            bool(inside[i] > pitch * (1 + ROUND)),
            None if failed else bolt["change"],
            None if failed else bolt.get("change_std"),
            None if failed else bolt.get("probability_loose"),
            "undecided" if failed else bolt["verdict"],
        )
        for i, bolt in enumerate(reference["bolts"] if failed else tree["bolts"])
    )
    if failed:
        return JobScore(campaign, tree["job"], "failed", role, tuple(removed), pitch, bolts, notes=(str(tree["reason"]),))
    misfit, noise = tree["misfit_db"], tree.get("noise") or {}
    (group,) = [g for g in tree["parameters"].values() if g["kind"] == "stiffness"]
    before = place_bolts(reference)[0].log10
    return JobScore(
        campaign,
        tree["job"],
        tree["status"],
        role,
        tuple(removed),
        pitch,
        bolts,
        _contrast(edge.log10, before, away <= 0.5 * pitch * (1 + ROUND), np.array([b.removed for b in bolts])),
        misfit["initial"],
        misfit["final"],
        misfit["held_out_final"],
        noise.get("sigma_db"),
        noise.get("correlation_factor"),
        (tree.get("prior") or {}).get("comparison") == "relative",
        group.get("damping_exponent"),
        tree.get("nuisances"),
        int(tree["evaluations"]),
        float(tree["seconds"]["total"]),
        tuple(tree.get("notes", ())),
    )


def _contrast(log10: Floats, before: Floats, close: NDArray[np.bool_], removed: NDArray[np.bool_]) -> float | None:
    gone = close[removed].any(axis=0)
    left = close[~removed].any(axis=0) & ~gone
    if not gone.any():
        return None
    tight = log10[left] if left.any() else before[gone]
    return float(tight.mean() - log10[gone].mean())


def roc_auc(bolts: Sequence[BoltScore], by: Score) -> tuple[float | None, int, int]:
    """Area under the ROC curve of removed against tight bolts, ties as half; None where one kind is missing; and how many of each."""
    high = np.array([b.score(by) for b in bolts if b.removed])
    low = np.array([b.score(by) for b in bolts if not b.removed])
    if not high.size or not low.size:
        return None, high.size, low.size
    return float(np.mean((high[:, None] > low) + 0.5 * (high[:, None] == low))), high.size, low.size


@dataclass(frozen=True)
class Location:
    """Where a job puts a bolt that is loose by itself."""

    campaign: str
    job: str
    bolt: str
    found: str
    distance: float
    located: bool


def locate(job: JobScore, by: Score) -> list[Location]:
    """Whether the highest peaks of the score along the edge, as many as there are loose bolts, lie within one pitch of them.

    Empty unless every loose bolt stands more than two pitches from any other. A peak is a bolt above both of its neighbours.
    """
    gone = [b for b in job.bolts if b.removed]
    reach = job.pitch * (1 + ROUND)
    if not gone or any(abs(a.position - b.position) <= 2 * reach for a in gone for b in gone if a is not b):
        return []
    row = sorted((b for b in job.bolts if b.near), key=lambda b: b.position)
    # Of bolts that are certain either way the change still tells which is the lowest.
    height = [(b.score(by), b.score("change")) for b in row]
    low = (-np.inf, -np.inf)
    beside = [low, *height, low]
    peaks = [i for i in range(len(row)) if height[i] >= beside[i] and height[i] > beside[i + 2]]
    best = [row[i] for i in sorted(peaks, key=lambda i: height[i], reverse=True)[: len(gone)]]
    found = []
    for bolt in gone:
        nearest = min(best, key=lambda b: abs(b.position - bolt.position))
        distance = abs(nearest.position - bolt.position)
        found.append(Location(job.campaign, job.job, bolt.bolt, nearest.bolt, distance, bool(distance <= reach)))
    return found


@dataclass(frozen=True)
class Figure:
    """One figure with its limit.

    Attributes
    ----------
    key, title : str
    value : float or None
        None where there is nothing to measure.
    limit : float or None
        None for what is only told.
    at_least : bool
        The limit is the least value that holds, else the largest.
    counts : mapping of str to int
    """

    key: str
    title: str
    value: float | None
    limit: float | None
    at_least: bool
    counts: Mapping[str, int]

    @property
    def holds(self) -> bool | None:
        """None where there is nothing to hold."""
        if self.value is None or self.limit is None:
            return None
        return self.value >= self.limit if self.at_least else self.value <= self.limit


def _mean(values: Sequence[float | None]) -> float | None:
    known = [v for v in values if v is not None]
    return float(np.mean(known)) if known else None


def _rms(values: Sequence[float]) -> float | None:
    return float(np.sqrt(np.mean(np.square(values)))) if values else None


def _share(part: int, whole: int) -> float | None:
    return part / whole if whole else None


def figures(jobs: Sequence[JobScore]) -> list[Figure]:
    """All figures over these jobs, of one campaign or pooled."""
    judged = [job for job in jobs if job.role == "judged"]
    some = [b for job in judged if job.removed for b in job.bolts]
    every = [b for job in judged for b in job.bolts]
    found: list[Figure] = []

    def add(key: str, title: str, value: float | None, limit: float | None, at_least: bool = True, **counts: int) -> None:
        found.append(Figure(key, title, value, limit, at_least, counts))

    for at, where, limit in (("near", "terms near", 0.95), ("interior", "interior", 0.99)):
        for by in ("probability", "change"):
            auc, high, low = roc_auc([b for b in some if getattr(b, at)], by)
            add(
                f"auc_{at}_{by}",
                f"ROC AUC by {by}, bolts with {where}" if at == "near" else f"ROC AUC by {by}, interior bolts",
                auc,
                limit,
                removed=high,
                tight=low,
            )
    # Fully tightened campaigns: no job of theirs has a bolt removed.
    loose_somewhere = {job.campaign for job in jobs if job.removed}
    calm = [job for job in judged if job.campaign not in loose_somewhere]
    alarms = sum(b.verdict == "loose" for job in calm for b in job.bolts)
    campaigns = len({job.campaign for job in calm})
    add(
        "alarms",
        "alarms on fully tightened campaigns",
        float(alarms) if calm else None,
        0.0,
        False,
        campaigns=campaigns,
        jobs=len(calm),
        bolts=sum(len(j.bolts) for j in calm),
    )
    for by in ("probability", "change"):
        places = [place for job in judged for place in locate(job, by)]
        hit = sum(place.located for place in places)
        add(f"located_{by}", f"single loose bolt within one pitch, by {by}", _share(hit, len(places)), 0.95, located=hit, bolts=len(places))
    decided = [b for b in every if b.decided]
    wrong = sum(b.wrong for b in decided)
    add(
        "wrong",
        "wrong among verdicts tight or loose",
        _share(wrong, len(decided)),
        0.02,
        False,
        wrong=wrong,
        verdicts=len(decided),
        bolts=len(every),
    )
    inner = [b for b in every if b.interior]
    sure = sum(b.decided for b in inner)
    add("decided", "interior bolts decided", _share(sure, len(inner)), 0.80, decided=sure, bolts=len(inner))
    gone = [b for b in inner if b.removed]
    caught = sum(b.verdict == "loose" for b in gone)
    add("caught", "removed interior bolts judged loose", _share(caught, len(gone)), None, loose=caught, bolts=len(gone))
    used = [job.misfit for job in jobs]
    held = [job.held_out for job in jobs]
    add("misfit_used", "mean misfit, responses used [dB]", _mean(used), 1.0, False, jobs=len(used))
    add("misfit_held_out", "mean misfit, held out [dB]", _mean(held), 1.3, False, jobs=len(held))
    seconds = [job.seconds for job in jobs if job.seconds is not None]
    add("seconds", "longest identification [s]", max(seconds) if seconds else None, 3.0, False, jobs=len(seconds))
    contrasts = [job.contrast for job in jobs if job.contrast is not None]
    add("contrast", "least contrast of tight and removed [decades]", min(contrasts) if contrasts else None, None, jobs=len(contrasts))
    quiet = [b for b in inner if not b.removed and b.change is not None and b.std]
    add(
        "tight_change", "change of tight interior bolts, rms [decades]", _rms([float(b.change or 0) for b in quiet]), None, bolts=len(quiet)
    )
    ratios = [float(b.change or 0) / float(b.std or 1) for b in quiet]
    add("tight_ratio", "the same in its standard deviations, rms", _rms(ratios), None, bolts=len(quiet))
    lost = sum(job.status in ("failed", "unexplained") for job in jobs)
    add("lost", "jobs failed or unexplained", float(lost), None, jobs=len(jobs))
    return found
