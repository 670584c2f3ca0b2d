"""The decision rule of a campaign's settings: all that judging needs of them, and loaded without the rest."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from lrbc_cli.config.settings import UpdateConfig
from lrbc_cli.errors import ConfigError
from lrbc_cli.updating.judging.rule import DecisionRule

#: Keys of ``update`` that decide, and change no identification.
RULE = ("confidence", "loose_change", "largest_misfit")


def rule_of(update: UpdateConfig) -> DecisionRule:
    """The decision rule of the settings: a given ``loose_change`` holds for either posterior."""
    rule = DecisionRule(confidence=update.confidence, largest_misfit=update.largest_misfit)
    if "largest_misfit" in update.model_fields_set:
        # A limit that is given is the only one.
        rule = replace(rule, misfit_margin=0.0)
    given = update.loose_change
    return rule if given is None else replace(rule, loose_change=given, mixture_change=given)


def changed_rule(update: UpdateConfig, changes: Mapping[str, Any]) -> DecisionRule:
    """The same with other values of some keys of ``RULE``.

    Raises
    ------
    ConfigError
        Where a key is no part of the rule, or its value is none.
    """
    expected = "confidence, loose_change or largest_misfit"
    if unknown := set(changes) - {*RULE}:
        raise ConfigError("not part of the decision rule", expected=expected, found=", ".join(sorted(unknown)))
    try:
        return rule_of(type(update).model_validate(update.model_dump(by_alias=True, exclude_unset=True) | dict(changes)))
    except ValueError as error:
        raise ConfigError("no such decision rule", expected=f"values of {expected} as in the campaign file", found=changes) from error
