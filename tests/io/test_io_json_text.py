"""JSON that is read back: whatever is in a file, a value or a ValueError, soon and in little memory."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from lrbc_cli.io import json_text
from lrbc_cli.io.json_text import DEEPEST, parse_json, read_json_text


def test_what_is_written_is_read(tmp_path: Path) -> None:
    tree = {"a": [1.5, -(2**63), None, True, {"b": "Prüfstand 1 – Δ 🔩"}], "tiny": 5e-324, "huge": 1.7e308}
    path = tmp_path / "x.json"
    for ascii_only in (False, True):
        path.write_text(json.dumps(tree, ensure_ascii=ascii_only), encoding="utf-8")
        assert parse_json(read_json_text(path)) == tree


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("1" * 400, "400 digits"),
        ("-" + "1" * 5000, "5000 digits"),
        ('{"a": [' + "9" * 20 + "]}", "20 digits"),
        ("1e999", "beyond the range"),
        ("[-1e400]", "beyond the range"),
        ("[" * 200_000 + "]" * 200_000, "nested too deeply"),
        ("[" * 200_000, "nested too deeply"),
        ('{"a":' * 200_000, "nested too deeply"),
        ("[" * (DEEPEST + 2) + "]" * (DEEPEST + 2), "nested too deeply"),
        (f'{{"deep": {"[" * 900 + "]" * 900}}}', "nested too deeply"),
        ("[NaN]", "NaN is not JSON"),
        ("[-Infinity]", "-Infinity is not JSON"),
        (r'{"a": "\ud800"}', "not Unicode"),
        (r'{"\udfff": [1]}', "not Unicode"),
        ("", "Expecting value"),
    ],
)
def test_what_no_result_holds(text: str, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        parse_json(text)


def test_the_deepest_document_is_read() -> None:
    assert parse_json("[" * DEEPEST + "]" * DEEPEST) is not None


def test_a_file_that_is_too_long(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "x.json"
    monkeypatch.setattr(json_text, "MOST_BYTES", 2**20)
    path.write_bytes(b" " * (2**20 - 2) + b"{}")
    assert parse_json(read_json_text(path)) == {}
    path.write_bytes(b" " * (2**20 - 1) + b"{}")
    with pytest.raises(ValueError, match="longer than 1 MiB"):
        read_json_text(path)
