"""Turns validation errors of pydantic into one message with line and advice, also for keys that no longer exist."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from types import UnionType
from typing import Annotated, Any, Union, get_args, get_origin

from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails

from lrbc_cli.config.document import Document
from lrbc_cli.errors import ConfigError, listing

MAPPING = "keys with values, 'key: value'"
EXPECTED = {
    "float_type": "a number",
    "int_type": "a whole number",
    "int_from_float": "a whole number",
    "string_type": "text",
    "bool_type": "true or false",
    "tuple_type": "a list [...]",
    "dict_type": MAPPING,
    "model_type": MAPPING,
    "model_attributes_type": MAPPING,
    "finite_number": "a finite number",
    "greater_than": "above {gt}",
    "greater_than_equal": "at least {ge}",
    "less_than": "below {lt}",
    "less_than_equal": "at most {le}",
    "literal_error": "{expected}",
    "too_short": "at least {min_length} of them",
    "too_long": "at most {max_length} of them",
    "string_too_short": "at least {min_length} characters",
    "string_too_long": "at most {max_length} characters",
}
WRONG_TYPE = {key for key in EXPECTED if key.endswith("_type") or key == "int_from_float"}


def suggestion(word: str, candidates: Iterable[str]) -> str | None:
    """``did you mean 'x'?`` with the most similar candidate; None if none is similar."""
    names = {name.lower(): name for name in candidates}
    near = difflib.get_close_matches(word.lower(), names, n=1, cutoff=0.6)
    return f"did you mean '{names[near[0]]}'?" if near else None


def key_name(name: str, field: FieldInfo) -> str:
    """Key of a field in the file."""
    return field.alias or name


def explain(error: ValidationError, document: Document, model: type[BaseModel]) -> ConfigError:
    """Return one ConfigError for a failed validation.

    It describes the first problem in full and lists the places of the others. Unknown keys come first, since others follow from them.

    Parameters
    ----------
    error
        Errors found by pydantic.
    document
        The campaign file.
    model
        The model of the whole file.
    """
    details = sorted(error.errors(include_url=False), key=lambda detail: _rank(detail, document))
    misspelt = {_keys(detail, document)[:-1] for detail in details if detail["type"] == "extra_forbidden"}
    details = [detail for detail in details if detail["type"] != "missing" or _keys(detail, document)[:-1] not in misspelt]
    # Pydantic does not count wrong entries of a list, so that it also calls the list too short.
    above = {_keys(detail, document)[:-1][:depth] for detail in details for depth in range(1, len(detail["loc"]))}
    details = [detail for detail in details if detail["type"] != "too_short" or _keys(detail, document) not in above]
    found = [_explain_one(detail, document, model) for detail in details]
    first, others = found[0], list(dict.fromkeys(f"{other.place} ({other.problem})" for other in found[1:]))
    if others:
        more = f"also wrong: {listing(others, 4, '; ')}"
        first.hint = f"{first.hint}; {more}" if first.hint else more
    return first


def _rank(detail: ErrorDetails, document: Document) -> tuple[int, int]:
    node, _ = document.node(_keys(detail, document))
    return (0 if detail["type"] == "extra_forbidden" else 2 if detail["type"] == "missing" else 1), node.line


def _keys(detail: ErrorDetails, document: Document) -> tuple[str | int, ...]:
    """Key path in the file: that of pydantic without the tags of unions and without keys inside short forms."""
    keys: list[str | int] = []
    steps: list[str | int] = [*detail["loc"], *detail.get("ctx", {}).get("keys", ())]
    for step in steps:
        node, _ = document.node(keys)
        if isinstance(step, str) and (step.startswith("form:") or step == "[key]") and node.child(step) is None:
            continue
        if not isinstance(node.value, Mapping | tuple):
            break
        keys.append(step)
    return tuple(keys)


def _explain_one(detail: ErrorDetails, document: Document, model: type[BaseModel]) -> ConfigError:
    keys = _keys(detail, document)
    kind, context = detail["type"], detail.get("ctx", {})
    if kind == "lrbc":
        found = context["found"]
        found = describe(detail["input"]) if found is None and not context["keys"] else found
        return document.error(context["text"], *keys, expected=context["expected"], found=found, hint=context["hint"])
    if kind == "extra_forbidden":
        return _unknown_key(document, keys, model)
    if kind == "missing":
        if isinstance(keys[-1], int):
            lengths = [len(get_args(option)) for option in _annotations(model, keys[:-1]) if get_origin(option) is tuple]
            return document.error("the wrong number of entries", *keys[:-1], expected=f"exactly {max(lengths)}", found=keys[-1])
        return document.error(f"the key '{keys[-1]}' is missing", *keys, expected=_description(model, keys), hint="add it")
    expected = EXPECTED[kind].format(**context) if kind in EXPECTED else detail["msg"]
    # In the notation of YAML.
    expected = "true" if expected == "True" else expected
    if kind in ("too_short", "too_long"):
        count, most = context.get("actual_length"), context.get("max_length")
        hint = "write numbers with decimal points: a comma separates entries" if most and count == 2 * most else None
        return document.error("the wrong number of entries", *keys, expected=expected, found=count, hint=hint or "add or remove entries")
    problem = "a value of the wrong type" if kind in WRONG_TYPE else "a value that is not allowed"
    meaning = _description(model, keys)
    hint = _hint(kind, detail["input"], model, keys) or _share(detail["input"], context)
    if str(detail["loc"][-1]).startswith("form:"):
        expected = meaning or _description(model, keys[:-1]) or expected
    elif meaning and hint is None:
        hint = f"{keys[-1]}: {meaning}"
    return document.error(problem, *keys, expected=expected, found=describe(detail["input"]), hint=hint)


def describe(value: object) -> str:
    """Short description of a value that was found."""
    if value is None:
        return "nothing"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return f"the text '{value}'" if len(value) <= 60 else f"the text '{value[:57]}...'"
    if isinstance(value, Mapping):
        return f"keys {listing(list(value), 6)}" if value else "no keys"
    if isinstance(value, list | tuple):
        return f"a list of {len(value)}"
    text = str(value) if not isinstance(value, int) or abs(value) < 10**30 else f"{str(value)[:20]}..."
    return f"the number {text}"


def _hint(kind: str, value: object, model: type[BaseModel], keys: Sequence[str | int]) -> str | None:
    if kind == "literal_error" and isinstance(value, str):
        words = [str(word) for annotation in _annotations(model, keys) for word in _literals(annotation)]
        if near := suggestion(value, words):
            return near
    if value is None:
        return "give it a value, or remove the key"
    if kind == "string_type" and not isinstance(value, list | tuple | Mapping):
        return "put it in quotes"
    number = kind in ("float_type", "int_type") or (kind == "literal_error" and isinstance(value, str) and value[:1] in "+-.0123456789")
    if number and isinstance(value, str) and any(char.isdigit() for char in value):
        return "write it like 1500, 0.5 or 1e6: decimal point, no unit, no quotes"
    if kind == "tuple_type" and isinstance(value, str | int | float):
        parts = str(value).replace(",", " ").replace(";", " ").split()
        return f"write a list: [{', '.join(parts) or value}]"
    if kind == "bool_type":
        return "write true or false"
    if kind in ("int_type", "int_from_float") and isinstance(value, float) and value.is_integer() and abs(value) < 1e15:
        return f"write {int(value)}"
    return None


def _share(value: object, limits: Mapping[str, Any]) -> str | None:
    """Hint for a share or probability that is given in per cent; None if it is not."""
    most = limits.get("lt", limits.get("le"))
    if most != 1.0 or isinstance(value, bool) or not isinstance(value, int | float) or not 1.0 < value < 100.0:
        return None
    return f"probably in per cent: write {value / 100:.6g}"


def _unknown_key(document: Document, keys: Sequence[str | int], model: type[BaseModel]) -> ConfigError:
    *parents, last = keys
    key = str(last)
    known = [key_name(name, field) for owner in _models(model, parents) for name, field in owner.model_fields.items()]
    hint = suggestion(key, known)
    elsewhere = [path for path in key_paths(model) if path.rsplit(".", 1)[-1] == key]
    elsewhere = [path for path in elsewhere if path.count(".") == min(other.count(".") for other in elsewhere)]
    if elsewhere and (hint is None or len(elsewhere) == 1):
        known_as = f"this key belongs to {' and '.join(elsewhere[:3])}"
        hint = known_as if hint is None else f"{hint} Otherwise {known_as}"
    if key.isdigit() and (before := _before(document, parents, key)):
        hint = f"probably a decimal comma (within braces a comma separates keys): write {before[0]}: {before[1]}.{key}"
    return document.error(f"unknown key '{key}'", *keys, expected=f"one of {', '.join(dict.fromkeys(known))}", hint=hint or "remove it")


def _before(document: Document, parents: Sequence[str | int], key: str) -> tuple[str, int] | None:
    """Key before `key` and its value, if that is a whole number; a decimal comma splits a number in this way."""
    siblings = document.node(parents)[0].value
    names = list(siblings) if isinstance(siblings, Mapping) else []
    at = names.index(key) if key in names else 0
    value = siblings[names[at - 1]].value if isinstance(siblings, Mapping) and at else None
    return (names[at - 1], value) if isinstance(value, int) and not isinstance(value, bool) else None


def _description(model: type[BaseModel], keys: Sequence[str | int]) -> str | None:
    for owner in _models(model, keys[:-1]) if keys else ():
        for name, field in owner.model_fields.items():
            if key_name(name, field) == keys[-1]:
                return (field.description or "").rstrip(".")
    return None


def key_paths(model: type[BaseModel], prefix: str = "") -> Iterator[str]:
    """Yield all keys that a campaign file can contain, such as ``jobs.NAME.frf``."""
    for name, field in model.model_fields.items():
        path = f"{prefix}{key_name(name, field)}"
        yield path
        for annotation in _unfold(field.annotation):
            inner, below = annotation, path
            while get_origin(inner) is dict:
                inner, below = next(_unfold(get_args(inner)[1])), f"{below}.NAME"
            for option in _unfold(inner):
                if isinstance(option, type) and issubclass(option, BaseModel):
                    yield from key_paths(option, f"{below}.")


def _unfold(annotation: Any) -> Iterator[Any]:
    """Yield the members of a type: without annotations, and each member of a union."""
    origin = get_origin(annotation)
    if origin is Annotated:
        yield from _unfold(get_args(annotation)[0])
    elif origin in (Union, UnionType):
        for part in get_args(annotation):
            yield from _unfold(part)
    else:
        yield annotation


def _annotations(annotation: Any, keys: Sequence[str | int]) -> Iterator[Any]:
    """Yield the types that are allowed at a key path."""
    for option in _unfold(annotation):
        if not keys:
            yield option
        elif get_origin(option) is dict:
            yield from _annotations(get_args(option)[1], keys[1:])
        elif get_origin(option) is tuple:
            yield from _annotations(get_args(option)[0], keys[1:])
        elif isinstance(option, type) and issubclass(option, BaseModel):
            for name, field in option.model_fields.items():
                if key_name(name, field) == keys[0]:
                    yield from _annotations(field.annotation, keys[1:])


def _models(model: type[BaseModel], keys: Sequence[str | int]) -> list[type[BaseModel]]:
    return [option for option in _annotations(model, keys) if isinstance(option, type) and issubclass(option, BaseModel)]


def _literals(annotation: Any) -> tuple[Any, ...]:
    return () if isinstance(annotation, type) else get_args(annotation)


_BOLTS = "approach: bolts (the default where there is a reference job) or approach: paper"

#: Advice by key of ``update`` that no longer exists.
GONE = {
    "prior": f"remove it, and write {_BOLTS}: paper draws values to their start values, bolts draws changes to the reference job",
    "unknowns": f"remove it, and write {_BOLTS}: paper identifies values along the edge, bolts identifies changes at bolts",
    "comparison": "remove it: jobs are compared relative to the reference job with approach: bolts, directly with approach: paper",
    "prior_shape": "remove it: with approach: bolts each bolt is tight or loose, with approach: paper the prior is normal",
    "penalty": "remove it: departures are penalised; write the weight as update.regularisation, with approach: paper",
}

#: The same for single values of a key.
GONE_VALUES = {
    ("residual", "complex"): "write residual: log-complex (with the phase), or db",
    ("lines", "resonances-both"): "write lines: resonances",
    ("weights", "coherence"): "write weights: auto, which uses the coherence where it is known",
    ("weights", "scatter"): "write weights: auto, which uses the scatter of repeats where no coherence is known",
}


def refuse_gone(document: Document) -> None:
    """Raise a ConfigError if the file uses a key or value that no longer exists."""
    values = document.root.plain()
    update = values.get("update") if isinstance(values, Mapping) else None
    if not isinstance(update, Mapping):
        return
    for key, value in update.items():
        found: tuple[str, str] | None = None
        if key in GONE:
            found = f"the key '{key}' no longer exists", GONE[key]
        elif isinstance(value, str) and (key, value) in GONE_VALUES:
            found = f"'{value}' no longer exists", GONE_VALUES[key, value]
        if found is not None:
            raise ConfigError(
                found[0], file=document.file, place=document.place("update", key), expected="a key or value of `lrbc schema`", hint=found[1]
            )


#: Letters that `lrbc init` writes for coordinates to be filled in.
UNFILLED = {"x", "y", "z", "x0", "x1", "y0", "y1", "z0", "z1"}

#: Keys with such letters by section of the campaign file; then the values that replace them while the rest is checked.
PLACES = {"excitation": ("near",), "responses": ("near",), "parameters": ("select", "box")}
ANYWHERE: dict[str, list[Any]] = {"near": [0.0, 0.0, 0.0], "box": [[0.0, 0.0], [0.0, 0.0], [0.0, 0.0]]}
UNFILLED_EXPECTED = "coordinates, as numbers"
UNFILLED_HINT = (
    "write the coordinates, or select by other keys (`lrbc guide campaign`); `lrbc init --from` fills them in if a table "
    "name,x,y,z,component of hammer and responses lies beside the files"
)


def refuse_unfilled(document: Document) -> None:
    """Raise a ConfigError if coordinates that `lrbc init` left open are not filled in."""
    unfilled = _unfilled(document)
    found = []
    for section, keys in PLACES.items():
        names = [place[1] for place in unfilled if place[0] == section]
        if names:
            found.append(f"letters in `{keys[-1]}` of {section} {listing(names, 6)}")
    if unfilled:
        raise document.error(
            "coordinates are not filled in yet", *unfilled[0], expected=UNFILLED_EXPECTED, found="; ".join(found), hint=UNFILLED_HINT
        )


def without_unfilled(document: Document) -> tuple[dict[tuple[str, ...], list[Any]], list[ConfigError]]:
    """Substitutes by key path for coordinates that are not filled in, so that the rest can be checked, and an error for each of them."""
    places = _unfilled(document)
    errors = [
        document.error("these coordinates are not filled in yet", *keys, expected=UNFILLED_EXPECTED, hint=None if index else UNFILLED_HINT)
        for index, keys in enumerate(places)
    ]
    return {keys: ANYWHERE[keys[-1]] for keys in places}, errors


def _unfilled(document: Document) -> list[tuple[str, ...]]:
    """Key paths of coordinates with letters instead of numbers."""
    values = document.root.plain()
    return [
        (section, name, *keys)
        for section, keys in PLACES.items()
        if isinstance(values, Mapping) and isinstance(entries := values.get(section), Mapping)
        for name, entry in entries.items()
        if UNFILLED & set(_texts(entry, keys))
    ]


def _texts(value: object, keys: Sequence[str] = ()) -> Iterator[str]:
    """Yield the texts in the lists under a key path."""
    if keys:
        yield from _texts(value[keys[0]], keys[1:]) if isinstance(value, Mapping) and keys[0] in value else ()
    elif isinstance(value, list | tuple):
        for part in value:
            yield from _texts(part)
    elif isinstance(value, str):
        yield value
