"""The pages of the guide. They ship with the package, and ``lrbc guide`` shows them."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import resources
from typing import Any

#: Topics in the order of a first reading, each with its line in the list.
TOPICS: dict[str, str] = {
    "tutorial": "from a CalculiX model with bushings to a verdict, step by step",
    "campaign": "every key of the campaign file, from the schema that validates it",
    "export": "matrices and coordinates from Abaqus, Ansys, CalculiX, COMSOL, Nastran and others; units",
    "measure": "what to export from Testlab, PULSE, Head, PAK, Dewesoft and Python; several files, roving hammer",
    "checking": "what lrbc check compares, in which order, and what its figures mean",
    "sensors": "choosing responses before anything is measured: lrbc plan",
    "rehearsal": "simulated measurements of your own model with loosened bolts: lrbc rehearse",
    "formats": "files that are read and written; the reduced model in other programs",
    "calibration": "global factors of the reference model",
    "watch": "judging while you measure: lrbc watch",
    "machines": "many jobs in parallel: lrbc update --workers, and --scheduler for other machines",
    "results": "result files",
    "page": "reading report.html; what inconclusive means; figures for print",
    "verdicts": "reading a verdict; exit codes for scripts",
    "method": "the method: low-rank terms, interface FRFs, reduction, updating",
    "statistics": "the statistical model as formulas: residuals, covariance, priors, decision; all of its numbers",
    "reasons": "why the statistical model is as it is: reasons, measured facts",
    "api": "the interface for Python, from its docstrings",
    "troubleshooting": "messages and their causes",
    "limits": "what the method and this version cannot do",
    "glossary": "the terms, one line each",
}


def page(topic: str) -> str:
    """One page as Markdown.

    Raises
    ------
    KeyError
        Where there is no such topic.
    """
    if topic not in TOPICS:
        raise KeyError(topic)
    if topic == "campaign":
        from lrbc_cli.config.schema import campaign_schema

        return campaign_page(campaign_schema())
    if topic == "api":
        from lrbc_cli.guide.api import api_page

        return api_page()
    return resources.files(__package__).joinpath(f"{topic}.md").read_text(encoding="utf-8")


def campaign_page(schema: Mapping[str, Any]) -> str:
    """The page on the campaign file, one table a section."""
    definitions: Mapping[str, Any] = schema.get("$defs", {})
    lines = [
        "# The campaign file",
        "",
        "YAML. Paths are relative to the file. Units are SI unless `units` or an input file says otherwise. Unknown keys are errors.",
        "`lrbc init` writes a commented file, `lrbc init --from DIR` one for the files of a folder (`lrbc guide formats`), both with",
        "the JSON Schema beside it, for completion and help in editors. `configs/frame.yaml` of the source is a complete one.",
        "",
    ]
    seen: set[str] = set()
    _section(lines, "", schema, definitions, seen)
    return "\n".join(lines).rstrip() + "\n"


def _section(lines: list[str], path: str, node: Mapping[str, Any], definitions: Mapping[str, Any], seen: set[str]) -> None:
    below: list[tuple[str, Mapping[str, Any]]] = []
    rows = []
    required = node.get("required", ())
    for key, value in node.get("properties", {}).items():
        place = f"{path}.{key}".lstrip(".")
        default = "required" if key in required else _default(value)
        rows.append(f"| `{key}` | {_choices(value, definitions)} | {default} | {_description(value)} |")
        for name, target, inner in _targets(value, definitions):
            if name not in seen:
                seen.add(name)
                below.append((place + inner, target))
    if rows:
        title = f"## `{path}`" if path else "## Top level"
        text = _description(node)
        lines += [title, "", *([text, ""] if path and text else [])]
        lines += ["| key | values | default | what it is |", "| --- | --- | --- | --- |", *rows, ""]
    for place, target in below:
        _section(lines, place, target, definitions, seen)


def _targets(value: Mapping[str, Any], definitions: Mapping[str, Any]) -> list[tuple[str, Mapping[str, Any], str]]:
    """Objects that a value refers to, by name, with what stands between: ``.NAME`` for a mapping from names."""
    found: list[tuple[str, Mapping[str, Any], str]] = []
    if "$ref" in value:
        name = str(value["$ref"]).rpartition("/")[2]
        target = definitions[name]
        found += [(name, target, "")] if "properties" in target else _targets(target, definitions)
    elif isinstance(value.get("properties"), Mapping):
        found.append((" ".join(value["properties"]), value, ""))
    for option in (*value.get("anyOf", ()), *value.get("oneOf", ()), *value.get("allOf", ())):
        found += _targets(option, definitions)
    for pattern in (*value.get("patternProperties", {}).values(), value.get("additionalProperties")):
        if isinstance(pattern, Mapping):
            found += [(name, target, ".NAME" + inner) for name, target, inner in _targets(pattern, definitions)]
    if isinstance(value.get("items"), Mapping):
        found += _targets(value["items"], definitions)
    return found


def _choices(value: Mapping[str, Any], definitions: Mapping[str, Any]) -> str:
    """Types and words that a key takes."""
    if "$ref" in value:
        name = str(value["$ref"]).rpartition("/")[2]
        return "block" if definitions[name].get("type") == "object" else _choices(definitions[name], definitions)
    if "const" in value:
        return f"`{value['const']}`"
    if "enum" in value:
        return ", ".join(f"`{option}`" for option in value["enum"])
    options = (*value.get("anyOf", ()), *value.get("oneOf", ()))
    if options:
        texts = [text for option in options for text in _choices(option, definitions).split(", ")]
        return ", ".join(dict.fromkeys(text for text in texts if text != "none"))
    kind = value.get("type")
    if kind == "array":
        inner = value.get("items")
        many = _choices(inner, definitions) if isinstance(inner, Mapping) else "values"
        return f"list of {many}"
    if kind == "object":
        return "block by name" if "patternProperties" in value or isinstance(value.get("additionalProperties"), Mapping) else "block"
    names = {"number": "number", "integer": "whole number", "string": "text", "boolean": "`true`, `false`", "null": "none"}
    return names.get(str(kind), "value")


def _default(value: Mapping[str, Any]) -> str:
    found = value.get("default")
    if found is None or found in ({}, []) or isinstance(found, Mapping):
        return "–"
    return f"`{str(found).lower() if isinstance(found, bool) else found}`"


def _description(value: Mapping[str, Any]) -> str:
    return " ".join(str(value.get("description", "")).split()).replace("|", "\\|")
