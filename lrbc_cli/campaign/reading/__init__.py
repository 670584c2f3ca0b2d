"""Reading a campaign: model, terms, loads, outputs, bolts; and whether they fit together."""
