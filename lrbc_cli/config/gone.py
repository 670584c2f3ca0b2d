"""Keys that campaign files had once, and what to write instead."""

from __future__ import annotations

from collections.abc import Mapping

from lrbc_cli.config.document import Document
from lrbc_cli.errors import ConfigError

_BOLTS = "approach: bolts (the default where there is a reference job) or approach: paper"

#: Key of ``update`` -> what to write instead.
GONE = {
    "prior": f"remove it, and write {_BOLTS}: paper draws values to their start, bolts changes to the reference job",
    "unknowns": f"remove it, and write {_BOLTS}: paper seeks values along the edge, bolts changes at bolts",
    "comparison": "remove it: jobs are compared relative to the reference job with approach: bolts, directly with approach: paper",
    "prior_shape": "remove it: with approach: bolts each bolt is tight or loose, with approach: paper the prior is normal",
    "penalty": "remove it: departures are penalised; write the weight as update.regularisation, with approach: paper",
}

#: The same for single values of keys.
GONE_VALUES = {
    ("residual", "complex"): "write residual: log-complex, which takes the phase too, or db",
    ("lines", "resonances-both"): "write lines: resonances",
    ("weights", "coherence"): "write weights: auto, which takes the coherence where it is known",
    ("weights", "scatter"): "write weights: auto, which takes the scatter of repeats where no coherence is known",
}


def refuse_gone(document: Document) -> None:
    """Raise a ConfigError where a file says what is gone."""
    values = document.root.plain()
    update = values.get("update") if isinstance(values, Mapping) else None
    if not isinstance(update, Mapping):
        return
    for key, value in update.items():
        found: tuple[str, str] | None = None
        if key in GONE:
            found = f"the key '{key}' is gone", GONE[key]
        elif isinstance(value, str) and (key, value) in GONE_VALUES:
            found = f"'{value}' is gone", GONE_VALUES[key, value]
        if found is not None:
            raise ConfigError(
                found[0], file=document.file, place=document.place("update", key), expected="a key or value of `lrbc schema`", hint=found[1]
            )
