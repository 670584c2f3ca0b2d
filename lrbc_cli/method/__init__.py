"""What a campaign's settings come to: the one place that knows what ``auto`` and an absent key mean."""

from lrbc_cli.method.resolve import Facts, Method, formula, noise_source, resolve, rule_of

__all__ = ["Facts", "Method", "formula", "noise_source", "resolve", "rule_of"]
