"""The decision rule that the settings give: the only settings on which judging depends, in a module that loads fast."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import fields, replace
from typing import Any

from lrbc_cli.config.settings import UpdateConfig
from lrbc_cli.errors import ConfigError
from lrbc_cli.updating.judging.rule import DecisionRule

#: Keys of ``update`` that belong to the decision rule; they change no identification.
RULE = ("confidence", "loose_change", "largest_misfit")


def rule_of(update: UpdateConfig) -> DecisionRule:
    """The decision rule of the settings."""
    return _with(DecisionRule(), update, update.model_fields_set)


def _with(rule: DecisionRule, update: UpdateConfig, keys: Collection[str]) -> DecisionRule:
    """The rule with the values that settings have under these keys."""
    if "confidence" in keys:
        rule = replace(rule, confidence=update.confidence)
    if "largest_misfit" in keys:
        # A given limit is the only one: no margin over the reference job.
        rule = replace(rule, largest_misfit=update.largest_misfit, misfit_margin=0.0)
    given = update.loose_change
    # It replaces the thresholds of both posteriors, sampled and Gaussian.
    return rule if given is None or "loose_change" not in keys else replace(rule, loose_change=given, mixture_change=given)


def changed_rule(rule: DecisionRule, update: UpdateConfig, changes: Mapping[str, Any]) -> DecisionRule:
    """A decision rule with other values: for keys of ``RULE`` as in the campaign file, for further fields of ``DecisionRule`` by number.

    Raises
    ------
    ConfigError
        If a key is not part of the rule, or its value is not valid.
    """
    further = {key: value for key, value in changes.items() if key not in RULE}
    known = {entry.name for entry in fields(DecisionRule)}
    expected = "confidence, loose_change, largest_misfit or another field of DecisionRule"
    if unknown := set(further) - known:
        raise ConfigError("not part of the decision rule", expected=expected, found=", ".join(sorted(unknown)))
    settings = {key: value for key, value in changes.items() if key in RULE}
    try:
        checked = type(update).model_validate(update.model_dump(by_alias=True, exclude_unset=True) | settings)
    except ValueError as error:
        raise ConfigError("no such decision rule", expected=f"values of {expected} as in the campaign file", found=changes) from error
    if wrong := [key for key, value in further.items() if isinstance(value, bool) or not isinstance(value, int | float)]:
        raise ConfigError("no such decision rule", expected=f"a number for {', '.join(wrong)}", found=changes)
    return replace(_with(rule, checked, settings), **further)
