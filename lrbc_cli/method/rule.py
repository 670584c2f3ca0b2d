"""The decision rule of a campaign's settings: all that judging needs of them, and loaded without the rest."""

from __future__ import annotations

from dataclasses import replace

from lrbc_cli.config.settings import UpdateConfig
from lrbc_cli.updating.judging.rule import DecisionRule

#: Keys of ``update`` that decide, and change no identification.
RULE = ("confidence", "loose_change", "largest_misfit")


def rule_of(update: UpdateConfig) -> DecisionRule:
    """The decision rule of the settings: a given ``loose_change`` holds for either posterior."""
    rule = DecisionRule(confidence=update.confidence, largest_misfit=update.largest_misfit)
    if "largest_misfit" in update.model_fields_set:
        # A limit that is given is the only one.
        rule = replace(rule, misfit_margin=update.largest_misfit)
    given = update.loose_change
    return rule if given is None else replace(rule, loose_change=given, mixture_change=given)
