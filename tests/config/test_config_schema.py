"""The JSON Schema says the same as the loader, and every key is described."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any, get_args

import jsonschema
import pytest
from pydantic import BaseModel
from sample_campaign import VALID

from lrbc_cli.config import Campaign, campaign_schema, load_campaign
from lrbc_cli.config.document import parse, read_document
from lrbc_cli.config.explain import key_paths
from lrbc_cli.config.fields import Strict
from lrbc_cli.config.settings import ReductionConfig

ROOT = Path(__file__).parents[2]


def all_of(base: type[BaseModel]) -> list[type[BaseModel]]:
    return [model for kind in base.__subclasses__() for model in (kind, *all_of(kind))]


MODELS = [model for model in all_of(Strict) if model.__module__.startswith("lrbc_cli.config.")]


@pytest.fixture(scope="module")
def validator() -> jsonschema.Draft202012Validator:
    schema = campaign_schema()
    jsonschema.Draft202012Validator.check_schema(schema)
    return jsonschema.Draft202012Validator(schema)


def as_json(value: object) -> Any:
    if isinstance(value, dict):
        return {key: as_json(item) for key, item in value.items()}
    return [as_json(item) for item in value] if isinstance(value, tuple) else value


def tree(text: str) -> Any:
    node = parse(text)
    assert node is not None
    return as_json(node.plain())


@pytest.mark.parametrize("model", MODELS)
def test_every_field_is_described(model: type[BaseModel]) -> None:
    assert model.__doc__
    for name, field in model.model_fields.items():
        assert field.description, f"{model.__name__}.{name}"
        assert field.description.endswith(".")


def properties(schema: Any) -> Iterator[tuple[str, Any, bool]]:
    if isinstance(schema, dict):
        required = schema.get("required", [])
        if "additionalProperties" in schema:
            for name, value in schema.get("properties", {}).items():
                yield name, value, name in required
        for value in schema.values():
            yield from properties(value)
    elif isinstance(schema, list):
        for value in schema:
            yield from properties(value)


def test_every_key_of_the_schema_has_description_and_default() -> None:
    found = list(properties(campaign_schema()))
    assert {name for name, _, _ in found} == {path.rsplit(".", 1)[-1] for path in key_paths(Campaign)}
    for name, value, required in found:
        assert value.get("description"), name
        assert required or "default" in value, name


def test_all_models_are_part_of_the_schema() -> None:
    assert set(campaign_schema()["$defs"]) == {model.__name__ for model in MODELS} - {"Campaign"}


def test_what_the_loader_accepts_validates(validator: jsonschema.Draft202012Validator, campaign: Campaign) -> None:
    validator.validate(tree(VALID))
    validator.validate(campaign.resolved())


@pytest.mark.parametrize("path", sorted((ROOT / "configs").glob("*.yaml")), ids=lambda path: path.name)
def test_sample_campaigns_validate(validator: jsonschema.Draft202012Validator, path: Path) -> None:
    campaign = load_campaign(path)
    validator.validate(as_json(read_document(path).root.plain()))
    validator.validate(campaign.resolved())


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("method: bfgs", "methd: bfgs"),
        ("method: bfgs", "method: bfg"),
        ("model.h5#K", "3"),
        ("group: M", "grp: M"),
        ("component: UZ", "component: UZ, dof: 3"),
        (", component: UZ", ""),
        ("component: ROTY, box", "box"),
        ("kind: stiffness", "kind: mass"),
        ("initial: 4.0", "initial: automatic"),
        ("bounds: [-1.0, 7.0]", "bounds: [-1.0]"),
        ("lines: resonances", "lines: {every: 0}"),
        ("lines: resonances", "lines: 3"),
        ("tolerance: 1e-3", "held_out: 4"),
        ("  bolts-04:", "  bolts 04:"),
        ("direction: 3", "direction: 7"),
        ("band: [20.0, 400], ", ""),
        ("campaign: box\n", ""),
        ("bolts: bolts.csv", "calibration: {}"),
        ("regularisation: 0.04", "regularisation: lcurve"),
        ("regularisation: 0.04", "floor: 0.0"),
    ],
)
def test_what_the_loader_refuses_does_not_validate(validator: jsonschema.Draft202012Validator, fails, old: str, new: str) -> None:  # type: ignore[no-untyped-def]
    assert old in VALID
    text = VALID.replace(old, new, 1)
    fails(text)
    assert not validator.is_valid(tree(text))


def test_literals_are_in_the_schema() -> None:
    backend = campaign_schema()["$defs"]["ReductionConfig"]["properties"]["backend"]
    assert backend["enum"] == list(get_args(ReductionConfig.model_fields["backend"].annotation))
    assert backend["default"] == "auto"
