"""The decision rule that the settings give: the only settings on which judging depends, in a module that loads fast."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, replace
from typing import Any

from lrbc_cli.config.settings import UpdateConfig
from lrbc_cli.errors import ConfigError
from lrbc_cli.updating.judging.rule import DecisionRule

#: Keys of ``update`` that belong to the decision rule; they change no identification.
RULE = ("confidence", "loose_change", "largest_misfit")


def rule_of(update: UpdateConfig) -> DecisionRule:
    """The decision rule of the settings."""
    return changed_rule(DecisionRule(), {key: getattr(update, key) for key in RULE if key in update.model_fields_set})


def changed_rule(rule: DecisionRule, changes: Mapping[str, Any]) -> DecisionRule:
    """A decision rule with other values: for keys of ``RULE`` as in the campaign file, for further fields of ``DecisionRule`` by number.

    Raises
    ------
    ConfigError
        If a key is not part of the rule, or its value is not valid.
    """
    new = dict(changes)
    if unknown := set(new) - {entry.name for entry in fields(DecisionRule)}:
        expected = "confidence, loose_change, largest_misfit or another field of DecisionRule"
        raise ConfigError("not part of the decision rule", expected=expected, found=", ".join(sorted(unknown)))
    if "largest_misfit" in new:
        # A given limit is the only one: no margin over the reference job.
        new.setdefault("misfit_margin", 0.0)
    if (limit := new.pop("loose_change", None)) is not None:
        # It replaces the thresholds of both posteriors, sampled and Gaussian.
        new = {"loose_change": limit, "mixture_change": limit} | new
    return replace(rule, **new)
