"""The reader of YAML: its rules, its limits, its messages."""

from __future__ import annotations

import math
import os

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lrbc_cli.config.document import MAX_BYTES, MAX_DEPTH, parse, read_document, resolve_scalar
from lrbc_cli.errors import ConfigError


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1e6", 1e6),
        ("1.0e-3", 1e-3),
        ("-.5", -0.5),
        ("3.", 3.0),
        ("017", 17),
        ("0x1F", 31),
        ("0o17", 15),
        ("+7", 7),
        ("-.inf", -math.inf),
        ("true", True),
        ("False", False),
        ("~", None),
        ("", None),
        ("null", None),
        *((word, word) for word in ("no", "yes", "on", "Off", "y", "12:30", "2018-04-01", "1_000", "1,5", "nan", "inf", "e5", ".", "0b1")),
    ],
)
def test_scalars_follow_the_core_schema(text: str, value: object) -> None:
    found = resolve_scalar(text)
    assert found == value
    assert type(found) is type(value)


def test_nan_is_read_as_a_number() -> None:
    found = resolve_scalar(".NaN")
    assert isinstance(found, float)
    assert math.isnan(found)


def test_keys_stay_text_and_quotes_make_text() -> None:
    node = parse("no: 'no'\n01: \"1e6\"\ntrue: 1\n")
    assert node is not None
    assert node.plain() == {"no": "no", "01": "1e6", "true": 1}


def test_lines_are_those_of_the_keys() -> None:
    node = parse("a:\n  b:\n    - 1\n    - c: |\n        text\n")
    assert node is not None
    inner = node.child("a").child("b")  # type: ignore[union-attr]
    assert inner is not None
    assert inner.line == 2
    assert [inner.child(0).line, inner.child(1).line] == [3, 4]  # type: ignore[union-attr]


def test_an_alias_repeats_a_value() -> None:
    node = parse("a: &x {k: [1, 2]}\nb: *x\n")
    assert node is not None
    assert node.plain() == {"a": {"k": (1, 2)}, "b": {"k": (1, 2)}}
    assert node.child("b").line == 2  # type: ignore[union-attr]


@pytest.mark.parametrize(
    ("text", "place", "part"),
    [
        ("a: 1\nb: 2\na: 3\n", "line 3, a", "lines 1 and 3"),
        ("x:\n  - {k: 1,\n     k: 2}\n", "line 3, x[0].k", "is given twice"),
        ("a: !!python/object/apply:os.system [ls]\n", "line 1, a", "tags"),
        ("a: !!int '3'\n", "line 1, a", "tags"),
        ("!!set {a}\n", "line 1", "tags"),
        ("a: {!!str b: 1}\n", "line 1, a", "tags"),
        ("a: 1\n---\nb: 2\n", "line 2", "second YAML document"),
        ("a: *x\n", "line 1, a", "alias"),
        ("a: &x [*x]\n", "line 1, a[0]", "alias"),
        ("a: 1\n<<: {b: 2}\n", "line 2", "merge keys"),
        ("[a]: 1\n", "line 1", "plain text"),
        ("? {a: 1}\n: 2\n", "line 1", "plain text"),
        ("a:\n\tb: 1\n", "line 2", "a tab"),
        ("a: 1\n b: 2\n", "line 2", "indentation"),
        ("a: b: c\n", "line 1", "quotes"),
        ('a: "..\\model.h5"\n', "line 1", "backslash"),
        ("a: [1, 2\n", "line 2", "brackets"),
        ("a: 1\nb: \x07\n", "line 2", "0x7"),
        ('a: "\\ud800"\n', "line 1, a", "a file cannot contain"),
        ('a: "\\0"\n', "line 1, a", "a file cannot contain"),
        ('a: "\\Uffffffff"\n', "line 1", "YAML"),
        ("%YAML 9.9\n---\na: 1\n", "line 1", "YAML"),
        ("a: @b\n", "line 1", "quotes"),
    ],
)
def test_what_is_not_plain_yaml_is_told_with_its_line(text: str, place: str, part: str) -> None:
    with pytest.raises(ConfigError) as caught:
        parse(text)
    assert caught.value.place == place
    assert part in str(caught.value)


def test_nesting_is_limited() -> None:
    with pytest.raises(ConfigError, match="nested deeper"):
        parse("[" * 500 + "]" * 500)


def test_aliases_cannot_multiply() -> None:
    lines = ["a0: &a0 [x, x, x, x, x, x, x, x, x]"]
    lines += [f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]" for i in range(1, 12)]
    with pytest.raises(ConfigError, match="more than 100000 values"):
        parse("\n".join(lines))


def test_aliases_cannot_nest_without_end() -> None:
    lines = ["a0: &a0 [x]"] + [f"a{i}: &a{i} [*a{i - 1}]" for i in range(1, 3 * MAX_DEPTH)]
    with pytest.raises(ConfigError, match="nested deeper"):
        parse("\n".join(lines))


@pytest.mark.parametrize(
    ("content", "part"),
    [
        (b"", "empty"),
        (b"# only a comment\n", "empty"),
        (b"---\n", "empty"),
        (b"- a\n- b\n", "key: value"),
        (b"just text\n", "key: value"),
        (b"a: 1\nb: caf\xe9\n", "line 2"),
        (b"\xff\xfea\x00", "UTF-8"),
        (b"\x89HDF\r\n\x1a\n", "UTF-8"),
        (b"#" * (MAX_BYTES + 1), "too large"),
    ],
)
def test_files_that_are_no_campaign(write, content: bytes, part: str) -> None:  # type: ignore[no-untyped-def]
    path = write(content)
    with pytest.raises(ConfigError) as caught:
        read_document(path)
    assert caught.value.file == str(path)
    assert part in str(caught.value)


def test_a_byte_order_mark_is_accepted(write) -> None:  # type: ignore[no-untyped-def]
    assert read_document(write("\ufeffa: 1\r\nb: 2\r\n".encode())).root.plain() == {"a": 1, "b": 2}


def test_missing_file_folder_and_pipe(tmp_path) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(ConfigError, match="does not exist"):
        read_document(tmp_path / "none.yaml")
    with pytest.raises(ConfigError, match=r"campaign\.yaml"):
        read_document(tmp_path)
    if hasattr(os, "mkfifo"):
        os.mkfifo(tmp_path / "pipe")
        with pytest.raises(ConfigError, match="not a regular file"):
            read_document(tmp_path / "pipe")


FRAGMENTS = st.sampled_from(
    [
        *"[]{}:,-&*!|>%@`'\"#?~<\t\n ",
        "\n  ",
        "a",
        "b: ",
        "- ",
        "&a ",
        "*a",
        "!!",
        "1e6",
        "no",
        "---\n",
        "...\n",
        '"\\x',
        "%YAML 1.2\n",
        "\\u",
        "é",
        "\x85",
    ]
)


@settings(deadline=None)
@given(st.one_of(st.text(max_size=200), st.lists(FRAGMENTS, max_size=60).map("".join)))
def test_any_text_is_read_or_refused(text: str) -> None:
    try:
        node = parse(text)
    except ConfigError:
        return
    assert node is None or node.size >= 1
