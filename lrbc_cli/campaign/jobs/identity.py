"""Digests of everything on which an identification and its judgement depend, by part, so that a change of any part can be named."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from lrbc_cli.campaign.digests import about_measurement, code, content_of, digest, key_of
from lrbc_cli.campaign.jobs.judging import role_of, states_removed
from lrbc_cli.config import Campaign
from lrbc_cli.config.settings import files_of
from lrbc_cli.results.job import IdentityRecord
from lrbc_cli.updating.judging.rule import DecisionRule

if TYPE_CHECKING:
    # Judging anew does not need the model.
    from lrbc_cli.campaign.reading.inputs import Inputs

#: The parts of an identification in words.
PARTS = {
    "version": "the code that identifies",
    "model": "the model or its calibration",
    "reduction": "the reduction",
    "parameters": "the parameter groups",
    "bolts": "the bolts",
    "settings": "the settings of the identification",
    "statistics": "the statistical model",
    "responses": "the responses",
    "measurement": "its measurement",
    "reference": "the measurement or the settings of the reference job",
}


@dataclass(frozen=True)
class Identity:
    """Digest of everything on which a result depends.

    Attributes
    ----------
    digest : str
    parts : dict
        Digest of each part, by its name in ``PARTS`` or ``JUDGED``.
    """

    digest: str
    parts: dict[str, str]

    def record(self, copied: Copied | None) -> IdentityRecord:
        """Identity of a judgement as in ``result.json``."""
        return IdentityRecord(identity=self.digest, parts=self.parts, **({} if copied is None else copied._asdict()))

    @classmethod
    def of(cls, parts: dict[str, str]) -> Identity:
        """Identity from the digests of its parts."""
        return cls(key_of(parts), parts)


def identification(inputs: Inputs, model: Mapping[str, str], name: str) -> Identity:
    """Digest of what the identification of a job depends on: model, measurement, settings; not paths, back end or workers.

    Parameters
    ----------
    inputs : Inputs
    model : mapping
        See ``cache.key_parts``.
    name : str
    """
    reference = inputs.campaign.update.reference
    parts = _own(inputs, model, name)
    if reference is not None and reference != name and reference in inputs.campaign.jobs:
        parts["reference"] = Identity.of(_own(inputs, model, reference)).digest
    return Identity.of(parts)


def _own(inputs: Inputs, model: Mapping[str, str], name: str) -> dict[str, str]:
    campaign = inputs.campaign
    resolved = campaign.resolved()
    reduction, use = ("band", "tolerance", "limits", "version"), inputs.calibration
    calibrated = [] if use is None else [(key, value.log10.tolist(), value.damping_exponent) for key, value in use.boundary.items()]
    groups = [{key: value for key, value in group.items() if key != "select"} for group in resolved["parameters"].values()]
    return {
        "version": code("identification"),
        # Factors of a calibration are in the operators already; its boundary values are a start of their own.
        "model": digest(sorted((key, value) for key, value in model.items() if key not in reduction), calibrated),
        "reduction": digest(sorted((key, model[key]) for key in reduction)),
        "parameters": digest(
            list(resolved["parameters"]),
            groups,
            [(group.beta, group.loss_factor) for group in inputs.groups],
            *[group.xyz for group in inputs.groups if group.xyz is not None],
            # Which terms share a value; without positions, nothing else contains this.
            *[group.parameter for group in inputs.groups if group.count < group.parameter.size],
            *[group.bolt for group in inputs.groups if group.bolt is not None],
        ),
        "bolts": digest(None if inputs.bolts is None else (inputs.bolts.name, inputs.bolts.xyz.tolist())),
        "settings": digest(inputs.method.digest, campaign.update.reference == name),
        "statistics": inputs.method.statistics.digest(),
        "responses": digest({key: value.get("record") for key, value in resolved["responses"].items()}, inputs.addresses),
        "measurement": measured(campaign, name),
    }


def measured(campaign: Campaign, name: str, content: Callable[[Path], str | None] = content_of) -> str:
    """Digest of a job's files and of the settings about them; ``content`` gives the digest of a file, such as that which was read."""
    job = campaign.jobs[name]
    return digest(
        about_measurement(campaign.resolved(), job, name),
        [[content(file) for file in files] for files in job.measurements],
        None if job.coherence is None else [content(file) for file in files_of(job.coherence)],
    )


def compared_jobs(campaign: Campaign, name: str) -> list[str]:
    """Jobs of which the measurement of a job must not be a copy, the baselines first; of a baseline the other ones only.

    The reference job is compared when a job is identified. Jobs that are measured later are compared with those that are there, so that
    a new one changes nothing of these.
    """
    update = campaign.update
    if update.reference in (None, name):
        return []
    others = () if name in update.baselines else campaign.jobs
    return [other for other in dict.fromkeys((*update.baselines, *others)) if other not in (name, update.reference)]


class Copied(NamedTuple):
    """Why a measurement counts as a copy, the job with the original, and the digest of its measurement, see ``measured``."""

    copied: str
    original: str
    content: str


def judgement(campaign: Campaign, rule: DecisionRule, name: str) -> Identity:
    """Digest of what the judgement of a job depends on, without the tight states (for these see ``standing``)."""
    update = campaign.update
    baselines = [] if update.reference in (None, name) else [other for other in update.baselines if other != name]
    return Identity.of(
        {
            "version": code("judgement"),
            "rule": digest(sorted(asdict(rule).items())),
            "role": digest(role_of(update, name)),
            "baselines": digest([(other, measured(campaign, other)) for other in baselines]),
            # Results state the removed bolts with the verdicts.
            "removed": digest(list(campaign.jobs[name].removed) if states_removed(campaign) else None),
        }
    )


#: The parts of a judgement in words.
JUDGED = {
    "version": "the code that judges",
    "rule": "the decision rule",
    "role": "its role in the campaign",
    "baselines": "the measurements of the baselines",
    "removed": "the bolts stated as removed",
}


def changed(before: Mapping[str, str] | None, now: Mapping[str, str], words: Mapping[str, str]) -> str | None:
    """Names of the parts that differ, in words; None if none does."""
    names = [name for name in words if (before or {}).get(name) != now.get(name)]
    return f"changed: {', '.join(words[name] for name in names)}" if names else None
