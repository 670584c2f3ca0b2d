"""Checks across the keys of a campaign, which the models of single sections cannot make."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping

from lrbc_cli.config.calibration import FACTOR_NAMES, FIELDS
from lrbc_cli.config.campaign import Campaign
from lrbc_cli.config.explain import suggestion
from lrbc_cli.config.fields import RESERVED_JOBS, MatrixRef
from lrbc_cli.config.structure import GroupConfig, GroupDampingConfig, PointConfig, ProportionalDamping


def check_references(campaign: Campaign) -> None:
    """Check that the keys of a campaign agree with each other.

    Raises
    ------
    ConfigError
        For names that do not exist or clash, settings that exclude each other, selections without the DOF table that they need,
        or damping without a coefficient.
    """
    for section in ("excitation", "responses", "parameters", "jobs"):
        _check_case(campaign, section)
    for name in campaign.jobs:
        if name.lower() in RESERVED_JOBS:
            raise campaign.error("the job has the name of a result file", "jobs", name, hint="choose another name")
    _check_names(campaign)
    _check_calibration(campaign)
    _check_excitations(campaign)
    if campaign.model.dofs is None:
        for keys in _selections_by_table(campaign):
            raise campaign.error(
                "a selection by node or place needs the DOF table",
                *keys,
                expected="model.dofs",
                found="a model without 'dofs'",
                hint="add model.dofs, or select by {dof:}, {dofs:}, {vector:}, {vectors:} or {matrix:}",
            )
    for name, group in campaign.parameters.items():
        _check_beta(campaign, name, group)


def _check_case(campaign: Campaign, section: str) -> None:
    seen: dict[str, str] = {}
    for name in getattr(campaign, section):
        other = seen.setdefault(name.lower(), name)
        if other != name:
            raise campaign.error(
                "the names differ only in case and would share one file",
                section,
                name,
                found=f"'{other}' and '{name}'",
                hint="rename one of them",
            )


def _check_names(campaign: Campaign) -> None:
    update = campaign.update
    if campaign.watch is not None and campaign.watch.like is not None:
        _known(campaign, campaign.watch.like, campaign.jobs, "job", "watch", "like")
    if update.reference is not None:
        again = campaign.calibration is not None and campaign.calibration.job == update.reference
        also = " (calibration.job names it as well)" if again else ""
        _known(campaign, update.reference, campaign.jobs, "job", "update", "reference", also=also)
    elif update.approach == "bolts" and campaign.jobs:
        raise campaign.error(
            "'approach: bolts' needs a reference job",
            "update",
            "approach",
            expected="update.reference: the job with all bolts tight",
            hint="set update.reference, or write approach: paper",
        )
    given = update.nuisances.given
    if given and update.evaluation == "full":
        raise campaign.error(
            "nuisance parameters need the reduced model",
            "update",
            "nuisances",
            expected="update.evaluation: auto, port or reduced",
            found=f"update.evaluation: full, and {', '.join(given)}",
        )
    for index, name in enumerate(update.baselines):
        _known(campaign, name, campaign.jobs, "job", "update", "baselines", index)
        if update.reference is None or name == update.reference:
            raise campaign.error(
                "baselines need a reference job" if update.reference is None else "the reference job cannot be a baseline, too",
                "update",
                "baselines",
                index,
                expected="update.reference: a tight job, and baselines: other tight jobs",
                found=name,
            )
    for index, name in enumerate(update.responses or ()):
        _known(campaign, name, campaign.responses, "response", "update", "responses", index)
    for job, config in campaign.jobs.items():
        for section, names in (("records", config.records), ("scale", config.scale if isinstance(config.scale, Mapping) else ())):
            for name in names:
                _known(campaign, name, campaign.responses, "response", "jobs", job, section, name)


def _check_calibration(campaign: Campaign) -> None:
    calibration = campaign.calibration
    if calibration is None:
        return
    _known(campaign, calibration.job, campaign.jobs, "job", "calibration", "job")
    damping = campaign.model.damping
    proportional = damping if isinstance(damping, ProportionalDamping) else None
    possible = []
    for name in FACTOR_NAMES:
        scale, _, field = name.partition(".")
        if scale in ("alpha", "beta"):
            if proportional is None or getattr(getattr(proportional, field), scale) == 0.0:
                continue
        elif scale == "damping" and not isinstance(damping, MatrixRef):
            continue
        if campaign.model.dofs is not None or field == FIELDS[0]:
            possible.append(name)
    for index, name in enumerate(calibration.factors):
        if name in possible or name in calibration.groups:
            continue
        if name not in FACTOR_NAMES:
            _known(campaign, name, [*possible, *calibration.groups], "factor", "calibration", "factors", index)
        scale, _, field = name.partition(".")
        reason = {
            "alpha": f"needs model.damping.{field}.alpha above 0",
            "beta": f"needs model.damping.{field}.beta above 0",
            "damping": "needs a damping matrix in model.damping",
        }.get(scale, "needs a DOF table with pressure DOFs")
        if scale in ("alpha", "beta", "damping") and name not in possible and campaign.model.dofs is None and field != FIELDS[0]:
            reason = "needs a DOF table with pressure DOFs"
        raise campaign.error(
            f"the factor '{name}' {reason}", "calibration", "factors", index, expected=f"one of {', '.join(possible)}", found=name
        )
    for name, group in calibration.groups.items():
        if group.damping is not None and not isinstance(damping, MatrixRef):
            raise campaign.error(
                "the group has a damping matrix, but the model has none",
                "calibration",
                "groups",
                name,
                "damping",
                expected="model.damping: a matrix that contains it",
                hint="remove it: proportional damping follows the group's stiffness and mass",
            )


def _check_excitations(campaign: Campaign) -> None:
    for name, response in campaign.responses.items():
        if response.excitation is not None:
            _known(campaign, response.excitation, campaign.excitation, "excitation", "responses", name, "excitation")
        elif len(campaign.excitation) > 1:
            raise campaign.error(
                "the excitation of this response is not stated",
                "responses",
                name,
                expected=f"excitation: one of {', '.join(campaign.excitation)}",
                hint="add 'excitation:' to every response if there are several excitations",
            )


def _known(campaign: Campaign, name: str, names: Iterable[str], kind: str, *keys: str | int, also: str = "") -> None:
    names = list(names)
    if name not in names:
        raise campaign.error(
            f"no {kind} has the name '{name}'",
            *keys,
            expected=f"one of {', '.join(names)}" if names else f"a {kind} of this file",
            hint=f"{suggestion(name, names) or 'give one of them'}{also}" if also else suggestion(name, names),
        )


def _selections_by_table(campaign: Campaign) -> Iterator[tuple[str, ...]]:
    sections: tuple[tuple[str, dict[str, PointConfig]], ...] = (
        ("excitation", campaign.excitation),
        ("responses", dict(campaign.responses)),
    )
    for section, points in sections:
        for name, point in points.items():
            if point.form in ("near", "node"):
                yield section, name, point.form
    for name, group in campaign.parameters.items():
        if group.select.component is not None or group.select.bushings is not None:
            yield "parameters", name, "select"


def _check_beta(campaign: Campaign, name: str, group: GroupConfig) -> None:
    damping = campaign.model.damping
    tied = group.damping
    if not isinstance(tied, GroupDampingConfig) or any(tied.coefficients(damping)):
        return
    found = "a damping matrix" if isinstance(damping, MatrixRef) else "no model.damping.structure.beta or loss_factor above 0"
    if tied.beta is not None or tied.loss_factor is not None:
        found = "both 0"
    raise campaign.error(
        "damping tied to the stiffness needs beta or a loss factor",
        "parameters",
        name,
        "damping",
        expected="parameters.NAME.damping.beta or loss_factor, or one of them under model.damping.structure",
        found=found,
        hint="give 'beta:' (in seconds) or 'loss_factor:' above 0 here, or write 'damping: none' for undamped terms",
    )
