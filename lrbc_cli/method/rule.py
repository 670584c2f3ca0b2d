"""The decision rule that the settings give: the only settings on which judging depends, in a module that loads fast."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from lrbc_cli.config.settings import UpdateConfig
from lrbc_cli.errors import ConfigError
from lrbc_cli.updating.judging.rule import DecisionRule

#: Keys of ``update`` that belong to the decision rule; they change no identification.
RULE = ("confidence", "loose_change", "largest_misfit")


def rule_of(update: UpdateConfig) -> DecisionRule:
    """The decision rule of the settings; a given ``loose_change`` replaces the thresholds of both posteriors, sampled and Gaussian."""
    rule = DecisionRule(confidence=update.confidence, largest_misfit=update.largest_misfit)
    if "largest_misfit" in update.model_fields_set:
        # A given limit is the only one: no margin over the reference job.
        rule = replace(rule, misfit_margin=0.0)
    given = update.loose_change
    return rule if given is None else replace(rule, loose_change=given, mixture_change=given)


def changed_rule(update: UpdateConfig, changes: Mapping[str, Any]) -> DecisionRule:
    """The decision rule of the settings with other values for some keys of ``RULE``.

    Raises
    ------
    ConfigError
        If a key is not part of the rule, or its value is not valid.
    """
    expected = "confidence, loose_change or largest_misfit"
    if unknown := set(changes) - {*RULE}:
        raise ConfigError("not part of the decision rule", expected=expected, found=", ".join(sorted(unknown)))
    try:
        return rule_of(type(update).model_validate(update.model_dump(by_alias=True, exclude_unset=True) | dict(changes)))
    except ValueError as error:
        raise ConfigError("no such decision rule", expected=f"values of {expected} as in the campaign file", found=changes) from error
