"""Reads a campaign (model, terms, loads, outputs, bolts) and checks that the parts fit together."""
