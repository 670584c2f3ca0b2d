"""The guide that ships with the package."""

from __future__ import annotations

import contextlib
import re
from dataclasses import fields
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

import lrbc_cli
from lrbc_cli import guide
from lrbc_cli.cli.main import COMMANDS, main
from lrbc_cli.config.schema import campaign_schema
from lrbc_cli.updating.judging.rule import DecisionRule
from lrbc_cli.updating.statistics.chain.blows import BlowRule
from lrbc_cli.updating.statistics.chain.modal import ModalRule
from lrbc_cli.updating.statistics.error_model import ErrorModel
from lrbc_cli.updating.statistics.lines import Resolution, Resonances
from lrbc_cli.updating.statistics.model import ValidationChannels
from lrbc_cli.updating.statistics.priors import BoltPrior, CalibrationPrior, ValuePrior
from lrbc_cli.updating.statistics.saturation import Limits


def shown(*args: str) -> str:
    found = CliRunner().invoke(main, ["guide", *args])
    assert found.exit_code == 0, found.output
    return found.output


@pytest.mark.parametrize("topic", guide.TOPICS)
def test_every_topic_of_the_list_is_a_page(topic: str) -> None:
    assert re.search(rf"^  {topic} +\S", shown(), flags=re.MULTILINE)
    text = shown(topic)
    assert text.startswith("# ")
    assert text.endswith("\n")


def test_the_readme_lists_every_topic() -> None:
    text = (Path(__file__).parents[2] / "README.md").read_text(encoding="utf-8")
    table = text.split("## The guide")[1].split("##")[0]
    assert set(re.findall(r"`([a-z]+)`", table.split("| --- | --- |")[1])) == set(guide.TOPICS)


def properties(node: Any) -> set[str]:
    """Keys of all objects of a schema, at any depth."""
    if isinstance(node, list):
        return set().union(*map(properties, node))
    if not isinstance(node, dict):
        return set()
    own = set(node["properties"]) if isinstance(node.get("properties"), dict) else set()
    return own.union(*map(properties, node.values()))


def test_the_page_on_the_campaign_file_has_every_key_of_the_schema() -> None:
    text = shown("campaign")
    missing = {key for key in properties(campaign_schema()) if f"| `{key}` |" not in text}
    assert not missing


def test_tables_are_well_formed() -> None:
    """As many cells in each row as in its head: a bar inside a cell would shift what follows."""
    for topic in guide.TOPICS:
        width = 0
        for line in guide.page(topic).splitlines():
            if not line.startswith("|"):
                width = 0
                continue
            cells = len(re.findall(r"(?<!\\)\|", line))
            width = width or cells
            assert cells == width, (topic, line)


def test_pages_name_commands_that_exist() -> None:
    for topic in guide.TOPICS:
        named = set(re.findall(r"`lrbc ([a-z]+)", guide.page(topic)))
        assert named <= set(COMMANDS), topic


def test_the_page_on_python_has_every_public_name() -> None:
    text = shown("api")
    for name in lrbc_cli.__all__:
        if not name.startswith("_"):
            assert re.search(rf"^## `{name}\b", text, flags=re.MULTILINE), name
            assert getattr(lrbc_cli, name).__doc__.splitlines()[0] in text
    for method in ("Study.identify(job, measurement=None, *, reference=None, baselines=None)", "Study.jobs", "TermModel.frf(hz, values)"):
        assert f"### `{method}`" in text
    assert "study.frf([100.0], left_edge=6.5)" in text


def test_a_wrong_topic_lists_the_pages() -> None:
    found = CliRunner().invoke(main, ["guide", "nonsense"])
    assert found.exit_code == 2
    assert "verdicts" in found.output


#: Classes whose fields the page on the statistical model lists.
LISTED = (
    *(ErrorModel, BoltPrior, ValuePrior, DecisionRule, ValidationChannels),
    *(Resolution, ModalRule, BlowRule, Resonances, CalibrationPrior, Limits),
)


def test_the_statistics_page_has_every_number_with_its_default() -> None:
    """``name=value`` in the row of its class; a row without a class goes on with that of the row before."""
    classes = {each.__name__: each for each in LISTED}
    found, name = set(), ""
    for line in guide.page("statistics").split("## The numbers")[1].splitlines():
        named = re.match(r"\| \d* ?\| (?:`(\w+)` )?\| ", line)
        if not named:
            continue
        name = named[1] or name
        for key, number, below in re.findall(r"`(\w+)=([-\d.e]+)(?:/(\d+))?`", line):
            assert float(number) / float(below or 1) == getattr(classes[name](), key), (name, key)
            found.add((name, key))
    single = {(each.__name__, entry.name) for each in LISTED for entry in fields(each) if not isinstance(entry.default, tuple)}
    assert single <= found


def test_numbers_beside_a_field_are_its_default() -> None:
    """Also in the text of both pages on the statistical model: ``name`` (0.3)."""
    known = {entry.name: entry.default for each in LISTED[:5] for entry in fields(each)}
    for topic in ("statistics", "reasons"):
        for key, number in re.findall(r"`(\w+)` \((-?\d[\d.e-]*)", guide.page(topic)):
            assert key not in known or float(number) == known[key], (topic, key)


def test_the_example_of_another_model_works() -> None:
    """Without its last line, the identification."""
    example = guide.page("statistics").split("```python\n")[1].split("```")[0]
    *lines, last = example.strip().splitlines()
    assert last == 'other.identify("tight")'
    names: dict[str, Any] = {}
    with contextlib.chdir(Path(__file__).parents[2]):
        exec("\n".join(lines), names)
    assert names["other"].inputs.statistics.bolts.loose_mean == -0.8
    assert names["study"].inputs.statistics.bolts.loose_mean == BoltPrior().loose_mean
