"""The stored calibration: digests of what it depends on, whether it is up to date, and inputs with its factors in the model."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from lrbc_cli.campaign.digests import CALIBRATION_FILE as FILE
from lrbc_cli.campaign.digests import about_measurement, code, digest, key_of, surroundings
from lrbc_cli.campaign.reading.factors import CalibrationUse
from lrbc_cli.campaign.reading.inputs import Inputs, read_as_exported
from lrbc_cli.campaign.reduced import cache
from lrbc_cli.config import Campaign
from lrbc_cli.errors import DataError
from lrbc_cli.io.atomic import file_hash
from lrbc_cli.model.factors import with_factors
from lrbc_cli.results.model import CalibrationRecord
from lrbc_cli.results.store import read

#: Fields of the ``Method`` that a calibration uses.
METHOD = ("responses", "lines", "residual")

#: Parts of the statistical model that a calibration uses; those about bolts are not among them.
STATISTICS = ("errors", "values", "resonances", "resolution", "limits", "calibration", "validation")

#: Names of the key's parts in messages.
PARTS = {
    "model": "the matrices, the damping, the excitation or the responses",
    "terms": "the parameter groups",
    "band": "the band or the tolerance",
    "measurement": "the measurement",
    "settings": "the settings of calibration or update",
    "statistics": "the statistical model",
    "version": "the code that calibrates",
}


def key_parts(inputs: Inputs) -> dict[str, str]:
    """Digest of each part on which a calibration depends: the model as exported, never calibrated operators, paths or time stamps.

    Raises
    ------
    DataError
        If the measurement cannot be read.
    """
    campaign = inputs.campaign
    calibration = campaign.calibration
    assert calibration is not None
    resolved = campaign.resolved()
    reduced = cache.key_parts(inputs)
    groups = [{k: v for k, v in group.items() if k != "select"} for group in resolved["parameters"].values()]
    # As for jobs (``identity``): which terms share a value.
    shared = [group.parameter for group in inputs.groups if group.count < group.parameter.size]
    # Which bolts own values, and where these lie: neighbours are alike beforehand.
    placed = [each for group in inputs.groups for each in (group.bolt, group.xyz) if each is not None]
    return {
        "model": digest(*[reduced[name] for name in ("operators", "groups", "loads", "outputs")], list(inputs.model.extras)),
        "terms": digest(
            reduced["terms"],
            list(resolved["parameters"]),
            groups,
            [(group.beta, group.loss_factor) for group in inputs.groups],
            *shared,
            *placed,
        ),
        "band": digest(reduced["band"], reduced["tolerance"]),
        "measurement": measured(inputs),
        "settings": digest(
            {name: inputs.method.identity[name] for name in METHOD},
            resolved["update"]["weights"],
            inputs.method.nuisances.hammer,
            sorted(calibration.names),
            calibration.boundary,
            calibration.job,
        ),
        "statistics": inputs.statistics.digest(*STATISTICS),
        "version": digest(code("reduction"), code("identification")),
    }


def measured(inputs: Inputs, content: Callable[[Path], str | None] = file_hash) -> str:
    """Digest of the measurement; ``content`` gives the digest of a file, such as that which was read."""
    campaign = inputs.campaign
    assert campaign.calibration is not None
    resolved, job = campaign.resolved(), campaign.jobs[campaign.calibration.job]
    return digest(
        [content(file) for file in job.all_files],
        about_measurement(resolved, job, campaign.calibration.job),
        {name: value.get("record") for name, value in resolved["responses"].items()},
        inputs.addresses,
    )


@dataclass(frozen=True)
class Fitting:
    """A stored calibration that is up to date, or the reason why there is none.

    Attributes
    ----------
    record : CalibrationRecord or None
    reason : str
        In words.
    stored : bool
        Whether any calibration is stored.
    earlier : CalibrationRecord or None
        A stored one of the same inputs that another version of the code identified: nearer to the structure than the model as exported.
    """

    record: CalibrationRecord | None
    reason: str
    stored: bool = True
    earlier: CalibrationRecord | None = None


def fitting(inputs: Inputs) -> Fitting:
    """The stored calibration, if it is up to date with these inputs (as exported)."""
    try:
        stored = read(inputs.campaign.output / FILE, CalibrationRecord)
    except DataError as error:
        return Fitting(None, f"unusable ({': '.join(part for part in (error.problem, error.place) if part)})")
    if stored is None:
        return Fitting(None, "none yet", stored=False)
    try:
        parts = key_parts(inputs)
    except DataError as error:
        return Fitting(None, f"not comparable ({error.problem})")
    same = stored.key == key_of(parts)
    changed = [name for name in PARTS if stored.parts.get(name) != parts[name]]
    reason = "nothing changed" if same else f"changed since: {'; '.join(PARTS[name] for name in changed) or 'its file'}"
    if not same and changed != ["version"]:
        return Fitting(None, reason)
    unknown = [name for name in stored.factors if name not in inputs.recipe.names]
    if unknown:
        return Fitting(None, f"unusable (unknown factor {unknown[0]})")
    return Fitting(stored, reason) if same else Fitting(None, reason, earlier=stored)


def too_coarse(inputs: Inputs, record: CalibrationRecord) -> str:
    """Warning that a calibration leaves too much of the reference job for any job to be validated; empty if not."""
    misfit = record.misfit_db
    coarse = (
        inputs.method.rule.none_validated(misfit.final, misfit.held_out_final) if record.job == inputs.campaign.update.reference else ""
    )
    return f"calibration: unless the identification of {record.job} leaves less, {coarse}" if coarse else ""


def read_inputs(campaign: Campaign, *, calibration: bool) -> Inputs:
    """Inputs of a campaign, with the factors of the stored calibration in the model if it is up to date.

    Parameters
    ----------
    campaign : Campaign
    calibration : bool
        False ignores a stored calibration, as ``--no-calibration`` does.

    Returns
    -------
    Inputs
        ``calibration`` states whether it is used; None if the campaign has neither that section nor the file.

    Raises
    ------
    ConfigError, DataError
        See ``read_as_exported``.
    """
    return with_stored_calibration(read_as_exported(campaign), calibration=calibration)


def with_stored_calibration(inputs: Inputs, *, calibration: bool = True) -> Inputs:
    """As ``read_inputs``, for inputs that were read as exported."""
    campaign = inputs.campaign
    inputs = replace(inputs, read_with=surroundings(campaign, calibration))
    if campaign.calibration is None:
        try:
            there = (campaign.output / FILE).is_file()
        except OSError:
            there = False
        text = "ignored: the campaign file has no 'calibration'"
        return replace(inputs, calibration=CalibrationUse(used=False, text=text, stale=True)) if there else inputs
    if not calibration:
        return replace(inputs, calibration=CalibrationUse(used=False, text="left out (--no-calibration)"))
    found = fitting(inputs)
    stored = found.record or found.earlier
    if stored is None:
        text = f"ignored: {found.reason}; run `lrbc calibrate`" if found.stored else "none yet; `lrbc calibrate` identifies it"
        return replace(inputs, calibration=CalibrationUse(used=False, text=text, stale=found.stored))
    factors = {name: entry.value for name, entry in stored.factors.items()}
    model, recipe = with_factors(inputs.model, inputs.recipe, factors)
    limits = "" if stored.status == "converged" else f"; {stored.status}: {stored.reason}"
    text = f"used ({stored.job}, {len(factors)} factor{'s' if len(factors) > 1 else ''}{limits})"
    if found.earlier is not None:
        text += f", but {found.reason}; `lrbc calibrate` identifies it anew"
    use = CalibrationUse(
        used=True,
        text=text,
        key=stored.key,
        factors=factors,
        stale=found.earlier is not None,
        boundary=stored.boundary,
        coarse=too_coarse(inputs, stored),
    )
    return replace(inputs, model=model, recipe=recipe, calibration=use)
