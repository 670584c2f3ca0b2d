"""Warnings about settings that contradict each other, or with which no bolt can be found loose."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from lrbc_cli.config import Campaign
from lrbc_cli.config.settings import UpdateConfig
from lrbc_cli.method.rule import rule_of


def setting_slips(campaign: Campaign) -> Iterator[str]:
    """Warnings about settings, each with its remedy."""
    yield from _tight_states(campaign)
    lenient = lenient_text(campaign.update)
    if lenient:
        yield f"{lenient}. Remove loose_change, or write -0.5 (a third of the stiffness left)"
    yield from _narrow_prior(campaign.update)
    yield from _ranges(campaign)
    yield from _coarse(campaign)
    yield from _wide_nuisances(campaign.update)


def _coarse(campaign: Campaign, *, most: float = 0.05) -> Iterator[str]:
    """Warning about a tolerance that allows errors of about half a decibel or more in the reduced model."""
    tolerance = campaign.reduction.tolerance
    if tolerance > most:
        yield (
            f"reduction.tolerance: {tolerance:g} allows errors of {20.0 * np.log10(1.0 + tolerance):.1f} dB in the FRFs of the reduced "
            "model, as much as loosened bolts change them. Write 1.0e-3; this costs a few more factorisations, once"
        )


def _tight_states(campaign: Campaign) -> Iterator[str]:
    update, calibration = campaign.update, campaign.calibration
    roles = [("update.reference", update.reference), *(("update.baselines", name) for name in update.baselines)]
    roles += [("calibration.job", calibration.job)] if calibration is not None else []
    for key, name in roles:
        removed = campaign.jobs[name].removed if name in campaign.jobs else ()
        if removed:
            yield (
                f"{key}: {name} is taken as the tight state, but jobs.{name}.removed says that {', '.join(removed)} "
                f"{'is' if len(removed) == 1 else 'are'} missing there. Give a job with all bolts tight, or correct `removed`"
            )


def lenient_text(update: UpdateConfig, *, most: float = -1.0) -> str:
    """Warning if ``loose_change`` calls bolts tight that lost more than nine tenths of their stiffness; else empty."""
    if update.loose_change is None or update.loose_change >= most:
        return ""
    lost = 100.0 * (1.0 - 10.0**update.loose_change)
    return f"update.loose_change: {update.loose_change:g} calls a bolt tight that lost up to {lost:.4g} % of its stiffness"


def _narrow_prior(update: UpdateConfig, *, most: float = 4.0) -> Iterator[str]:
    """Warning if the threshold of a loose bolt is more than ``most`` standard deviations of the prior away (probability 1 in 30 000)."""
    change = rule_of(update).mixture_change
    if update.prior_std != "auto" and update.reference is not None and -change > most * update.prior_std:
        yield (
            f"update.prior_std: {update.prior_std:g} practically excludes loose bolts, so they are not found: a bolt counts as loose from "
            f"a change of {change:g} decades, {-change / update.prior_std:.0f} standard deviations away. Write auto"
        )


def _wide_nuisances(update: UpdateConfig, *, decibels: float = 3.0, kelvin: float = 40.0) -> Iterator[str]:
    """Warnings about impossibly large standard deviations of nuisance parameters, probably in per cent or degrees."""
    gain, air = update.nuisances.gain, update.nuisances.temperature
    if gain is not None and gain > decibels:
        yield (
            f"update.nuisances.gain: {gain:g} is a standard deviation in dB, a factor of {10.0 ** (gain / 20.0):.2g}: levels then carry "
            f"no information. If per cent was meant, write {20.0 * np.log10(1.0 + gain / 100.0):.2g}"
        )
    if air is not None and air > kelvin:
        yield (
            f"update.nuisances.temperature: {air:g} is a standard deviation in K: how much the air temperature differs between jobs. "
            "The temperature itself is `room`, in degrees Celsius. Write about 2"
        )


def start_slips(campaign: Campaign, *, far: float = 2.0) -> dict[str, str]:
    """Warnings, by group, about start values or bounds of springs of a table that are no log10 of factors on the table."""
    found: dict[str, str] = {}
    for name, group in campaign.parameters.items():
        file, start, bounds = group.select.bushings, group.initial, group.bounds
        if file is None:
            continue
        if isinstance(start, float) and abs(start) >= far:
            found[name] = (
                f"parameters.{name}.initial: {start:g} means {10.0**start:g} times the stiffnesses in {file.name}. Values are log10 of "
                "multiples of the stiffness in the table: write initial: 0, and bounds around 0"
            )
        elif isinstance(start, float) and not isinstance(bounds, str) and 0.0 < (low := float(np.min(bounds))) < 1.0 <= start:
            meant = f"[{np.log10(low):.3g}, {np.log10(float(np.max(bounds))):.3g}]"
            found[name] = (
                f"parameters.{name}.bounds: [{low:g}, {float(np.max(bounds)):g}] around {start:g} are probably factors on the stiffnesses "
                f"in {file.name}. Values are log10 of factors: write initial: {np.log10(start):.3g}, bounds: {meant}"
            )
    return found


def _ranges(campaign: Campaign, *, loss: float = 1.0) -> Iterator[str]:
    """Warnings of ``start_slips``, and about bounds within which no bolt can become loose, or no joint lose ``loss`` decades."""
    change, slips = rule_of(campaign.update).mixture_change, start_slips(campaign)
    yield from slips.values()
    for name, group in campaign.parameters.items():
        level = group.start
        if group.kind != "stiffness" or campaign.update.reference is None or level is None or isinstance(group.bounds, str):
            continue
        low = float(np.min(group.bounds))
        if low > level + change and name not in slips:
            yield (
                f"parameters.{name}.bounds: no bolt can become loose: from the start value {level:g} it cannot fall below {low:g}, but it "
                f"counts as loose from a change of {change:g} decades. Write a lower bound of {level - 3.0:g} or less (a thousandth of the "
                "stiffness)"
            )
        elif low > level - loss and group.select.bushings is not None and name not in slips:
            yield (
                f"parameters.{name}.bounds: from the start value {level:g} a joint cannot fall below {low:g}, but a loose one loses one to "
                f"three decades, and such a job then looks as if its sensors were wrong. Write a lower bound of {level - 3.0:g} or less"
            )


def guesses(campaign: Campaign) -> list[str]:
    """Warning about a guessed reference job that the user has not confirmed yet; else empty."""
    update = campaign.update
    if update.reference is None or not update.reference_guessed:
        return []
    return [
        f"{campaign.place('update', 'reference')}: {update.reference} was guessed from names by `lrbc init --from`. If all bolts were "
        "tight there, remove `reference_guessed`; otherwise give another job"
    ]
