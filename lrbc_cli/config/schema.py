"""JSON Schema of the campaign file for editors, from the models that validate it."""

from __future__ import annotations

from typing import Any

from lrbc_cli.config.campaign import Campaign

DIALECT = "https://json-schema.org/draft/2020-12/schema"


def campaign_schema() -> dict[str, Any]:
    """JSON Schema of the campaign file, with the description and default of every key."""
    schema = Campaign.model_json_schema(by_alias=True)
    _close_maps(schema)
    return {"$schema": DIALECT, **schema, "title": "lrbc campaign file"}


def _close_maps(schema: Any) -> None:
    """Forbid keys of mappings that do not match the pattern of names."""
    if isinstance(schema, dict):
        if "patternProperties" in schema:
            schema["additionalProperties"] = False
        for value in schema.values():
            _close_maps(value)
    elif isinstance(schema, list):
        for value in schema:
            _close_maps(value)
