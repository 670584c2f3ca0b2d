"""Parses YAML text into a tree that keeps the line of every value, by the core rules of YAML 1.2 only.

PyYAML parses the syntax; the tree is built here. Why not ruamel.yaml (0.19, tried): it has lines, duplicate keys and the numbers of YAML
1.2, but turns ``2001-01-01`` into a date and ``1_000`` into 1000, obeys ``%YAML 1.1``, accepts tags and merge keys, ends in a
RecursionError on deep nesting and does not count aliases. Refusing all that takes as much code as this, and reading takes twice as long.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NoReturn

import yaml

from lrbc_cli.errors import ConfigError

#: Limits far above any campaign file, against hostile ones.
MAX_BYTES = 1 << 20
MAX_NODES = 100_000
MAX_DEPTH = 32
MAX_DIGITS = 400

Scalar = str | int | float | bool | None
Keys = tuple[str | int, ...]
Content = yaml.ScalarEvent | yaml.MappingStartEvent | yaml.SequenceStartEvent

_NULL = re.compile(r"~|null|Null|NULL|")
_TRUE = re.compile(r"true|True|TRUE")
_FALSE = re.compile(r"false|False|FALSE")
_INT = re.compile(r"[-+]?[0-9]+")
_BASED = re.compile(r"0o[0-7]+|0x[0-9a-fA-F]+")
_FLOAT = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?|[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)")


def resolve_scalar(text: str) -> Scalar:
    """Value of an unquoted scalar by the core schema of YAML 1.2 (``1e6`` is a number, ``no`` is text)."""
    if len(text) > MAX_DIGITS:
        return text
    if _NULL.fullmatch(text):
        return None
    if _TRUE.fullmatch(text):
        return True
    if _FALSE.fullmatch(text):
        return False
    if _INT.fullmatch(text):
        return int(text)
    if _BASED.fullmatch(text):
        return int(text, 0)
    if _FLOAT.fullmatch(text):
        return float(text.lower().replace(".inf", "inf").replace(".nan", "nan"))
    return text


def dotted(keys: Sequence[str | int]) -> str:
    """Key path as text: ``update.responses[2]``."""
    return "".join(f"[{key}]" if isinstance(key, int) else f".{key}" for key in keys).removeprefix(".")


@dataclass(frozen=True)
class Node:
    """One value of the file with its place.

    Attributes
    ----------
    value
        A scalar, a mapping of nodes or a tuple of nodes.
    line
        Line of its key (or of the value itself, in a list), from 1.
    origin
        Key path of the override that gave it; empty for values of the file.
    size
        Number of nodes, this one and all below it.
    height
        Number of levels below it.
    """

    value: Scalar | Mapping[str, Node] | tuple[Node, ...]
    line: int
    origin: str = ""
    size: int = field(init=False, compare=False)
    height: int = field(init=False, compare=False)

    def __post_init__(self) -> None:
        below: Collection[Node] = ()
        if isinstance(self.value, Mapping):
            below = self.value.values()
        elif isinstance(self.value, tuple):
            below = self.value
        object.__setattr__(self, "size", 1 + sum(node.size for node in below))
        object.__setattr__(self, "height", 1 + max((node.height for node in below), default=-1))

    def child(self, key: str | int) -> Node | None:
        """Node under a key or index; None if there is none."""
        if isinstance(self.value, Mapping) and isinstance(key, str):
            return self.value.get(key)
        if isinstance(self.value, tuple) and isinstance(key, int) and 0 <= key < len(self.value):
            return self.value[key]
        return None

    def plain(self) -> object:
        """Value without lines: dict, tuple and scalars."""
        if isinstance(self.value, Mapping):
            return {key: node.plain() for key, node in self.value.items()}
        if isinstance(self.value, tuple):
            return tuple(node.plain() for node in self.value)
        return self.value


@dataclass(frozen=True)
class Document:
    """A campaign file with its lines.

    Attributes
    ----------
    file : Path
        The file, absolute.
    root : Node
        Its tree, overrides applied.
    """

    file: Path
    root: Node

    def node(self, keys: Sequence[str | int]) -> tuple[Node, int]:
        """Deepest existing node on the key path `keys`, and the number of keys that lead to it."""
        node = self.root
        for depth, key in enumerate(keys):
            below = node.child(key)
            if below is None:
                return node, depth
            node = below
        return node, len(keys)

    def place(self, *keys: str | int) -> str:
        """Place of a key path for messages: ``line 12, update.method`` or ``--override update.method``."""
        node, _ = self.node(keys)
        path = dotted(keys)
        if node.origin:
            return f"--override {node.origin}" if path in ("", node.origin) else f"--override {node.origin}, {path}"
        return f"line {node.line}, {path}" if path else f"line {node.line}"

    def error(self, problem: str, *keys: str | int, expected: object = None, found: object = None, hint: str | None = None) -> ConfigError:
        """Return (not raise) the error about the value at the key path `keys`."""
        return ConfigError(problem, file=self.file, place=self.place(*keys), expected=expected, found=found, hint=hint)


class _NodeReader:
    """Builds the tree from the events of the YAML parser."""

    def __init__(self, text: str, file: Path | None, origin: str) -> None:
        self.file, self.origin = file, origin
        self.events: Iterator[yaml.Event] = yaml.parse(text, Loader=yaml.SafeLoader)
        self.anchors: dict[str, Node] = {}
        self.count = 0

    def fail(
        self, problem: str, line: int, keys: Keys = (), expected: str | None = None, found: str | None = None, hint: str | None = None
    ) -> NoReturn:
        place = f"--override {self.origin}" if self.origin else ", ".join(part for part in (f"line {line}", dotted(keys)) if part)
        raise ConfigError(problem, file=self.file, place=place, expected=expected, found=found, hint=hint)

    def document(self) -> Node | None:
        """Tree of the only document; None if there is none."""
        root: Node | None = None
        for event in self.events:
            if isinstance(event, yaml.DocumentStartEvent):
                if root is not None:
                    self.fail("a second YAML document begins", _line(event), hint="keep one campaign in one file: remove '---'")
                root = self.node(next(self.events), (), None, 0)
        return root

    def node(self, event: yaml.Event, keys: Keys, key_line: int | None, depth: int) -> Node:
        line = _line(event) if key_line is None else key_line
        if isinstance(event, yaml.AliasEvent):
            if event.anchor not in self.anchors:
                self.fail(
                    f"the alias '*{event.anchor}' has no complete anchor",
                    line,
                    keys,
                    hint="define the anchor before it, not around it",
                )
            shared = self.anchors[event.anchor]
            self.tally(shared.size, line, keys)
            self.check_depth(depth + shared.height, line, keys)
            return Node(shared.value, line, shared.origin)
        if not isinstance(event, yaml.ScalarEvent | yaml.MappingStartEvent | yaml.SequenceStartEvent):
            raise AssertionError(f"an event that begins no value: {event}")
        if event.tag not in (None, "!"):
            tag = f"tag '{_short(event.tag)}'"
            self.fail("YAML tags are not accepted", line, keys, found=tag, hint="remove the tag; put text in quotes")
        self.check_depth(depth, line, keys)
        self.tally(1, line, keys)
        node = self.content(event, keys, line, depth)
        if event.anchor is not None:
            self.anchors[event.anchor] = node
        return node

    def content(self, event: Content, keys: Keys, line: int, depth: int) -> Node:
        if isinstance(event, yaml.MappingStartEvent):
            return Node(self.mapping(keys, depth), line, self.origin)
        if isinstance(event, yaml.SequenceStartEvent):
            items: list[Node] = []
            while not isinstance(item := next(self.events), yaml.SequenceEndEvent):
                items.append(self.node(item, (*keys, len(items)), None, depth + 1))
            return Node(tuple(items), line, self.origin)
        value = event.value if event.style is not None else resolve_scalar(event.value)
        if isinstance(value, str):
            self.check_text(value, line, keys)
        return Node(value, line, self.origin)

    def mapping(self, keys: Keys, depth: int) -> dict[str, Node]:
        entries: dict[str, Node] = {}
        while not isinstance(event := next(self.events), yaml.MappingEndEvent):
            line = _line(event)
            if not isinstance(event, yaml.ScalarEvent):
                self.fail("a key must be plain text", line, keys, hint="write 'key: value'")
            if event.tag not in (None, "!"):
                self.fail("YAML tags are not accepted", line, keys, found=f"tag '{_short(event.tag)}'")
            key = event.value
            self.check_text(key, line, keys)
            path = (*keys, key)
            if key == "<<" and event.style is None:
                self.fail(
                    "merge keys are not part of YAML 1.2", line, keys, hint="write the keys out, or use the alias for the whole value"
                )
            if key in entries:
                first = entries[key].line
                self.fail(
                    f"the key '{key}' is given twice",
                    line,
                    path,
                    "each key once",
                    f"lines {first} and {line}",
                    "remove or rename one of them",
                )
            if event.anchor is not None:
                self.anchors[event.anchor] = Node(key, line, self.origin)
            entries[key] = self.node(next(self.events), path, line, depth + 1)
        return entries

    def tally(self, size: int, line: int, keys: Keys) -> None:
        self.count += size
        if self.count > MAX_NODES:
            self.fail(f"more than {MAX_NODES} values (aliases expanded)", line, keys, hint="move long lists into separate files")

    def check_depth(self, depth: int, line: int, keys: Keys) -> None:
        if depth > MAX_DEPTH:
            self.fail(f"nested deeper than {MAX_DEPTH} levels (aliases expanded)", line, keys[:4])

    def check_text(self, text: str, line: int, keys: Keys) -> None:
        if any(0xD800 <= ord(char) <= 0xDFFF or char == "\0" for char in text):
            self.fail("text with characters that a file cannot contain", line, keys, found=ascii(_short(text)))


def parse(text: str, *, file: Path | None = None, origin: str = "") -> Node | None:
    """Parse YAML text into a tree.

    Parameters
    ----------
    text
        One YAML document.
    file
        The file that contains it, for messages.
    origin
        Key path of the override that gave it, for messages.

    Returns
    -------
    Node or None
        The tree; None if the text has no document.

    Raises
    ------
    ConfigError
        For wrong syntax, tags, duplicate keys, several documents, or values beyond the limits.
    """
    reader = _NodeReader(text, file, origin)
    try:
        return reader.document()
    except yaml.reader.ReaderError as error:
        line = text.count("\n", 0, error.position) + 1
        reader.fail("a character that YAML does not allow", line, found=f"code {ord(text[error.position]):#x}", hint="remove it")
    except yaml.MarkedYAMLError as error:
        _explain(error, reader)
    except (yaml.YAMLError, ValueError, OverflowError) as error:
        reader.fail("not readable as YAML", 1, found=_short(str(error).splitlines()[0] if str(error) else ""))


def _explain(error: yaml.MarkedYAMLError, reader: _NodeReader) -> NoReturn:
    mark = error.problem_mark or error.context_mark
    line = 1 if mark is None else mark.line + 1
    problem = error.problem or error.context or "unknown"
    found = problem if error.context is None or error.problem is None else f"{error.context}: {problem}"
    hint = "check the indentation, brackets, colons and quotes here and on the line before"
    if "'\\t'" in problem:
        reader.fail(
            "a tab where YAML requires blanks", line, expected="blanks for indentation", found="a tab", hint="replace tabs with blanks"
        )
    if "escape" in problem:
        hint = "in double quotes a backslash starts an escape: write paths with / or in single quotes"
    elif "mapping values are not allowed" in problem:
        hint = "either the indentation is wrong, or text that contains ': ' needs quotes"
    elif "could not find expected ':'" in problem:
        hint = "write 'key: value', with a blank after the colon, here or on the line before"
    elif "cannot start any token" in problem:
        hint = "put text that begins with a special character in quotes"
    reader.fail("not valid YAML", line, found=_short(found, 200), hint=hint)


def _line(event: yaml.Event) -> int:
    return 1 if event.start_mark is None else event.start_mark.line + 1


def _short(text: str, length: int = 60) -> str:
    return text if len(text) <= length else text[: length - 3] + "..."


def read_document(path: Path) -> Document:
    """Read a campaign file.

    Parameters
    ----------
    path
        The file.

    Returns
    -------
    Document
        Its tree; the root is a mapping.

    Raises
    ------
    ConfigError
        If the file is missing, no regular file, too large, not UTF-8, empty, not YAML, or not a mapping.
    """
    path = path.absolute()
    try:
        if not path.is_file():
            _refuse(path)
        with path.open("rb") as stream:
            data = stream.read(MAX_BYTES + 1)
    except (OSError, ValueError) as error:
        raise ConfigError("the campaign file cannot be read", file=path, found=getattr(error, "strerror", None) or str(error)) from None
    if len(data) > MAX_BYTES:
        raise ConfigError(
            "the campaign file is too large",
            file=path,
            expected=f"at most {MAX_BYTES} bytes of YAML",
            hint="give the campaign file, not a data file; move long lists into separate files",
        )
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise ConfigError(
            "the campaign file is not UTF-8 text",
            file=path,
            place=f"line {line}",
            found=f"byte {data[error.start]:#04x}",
            hint="save it as UTF-8 (and give the campaign file, not a data file)",
        ) from None
    root = parse(text, file=path)
    if root is None or root.value is None:
        raise ConfigError("the campaign file is empty", file=path, place="line 1", hint="'lrbc init' writes one to start from")
    if not isinstance(root.value, Mapping):
        raise ConfigError("the campaign file is not a list of keys", file=path, place=f"line {root.line}", expected="lines 'key: value'")
    return Document(path, root)


def as_yaml(tree: Mapping[str, object]) -> str:
    """Text of a campaign file from plain values; the order of keys is kept."""
    return yaml.safe_dump(dict(tree), sort_keys=False, allow_unicode=True, width=120)


def _refuse(path: Path) -> NoReturn:
    if path.is_dir():
        raise ConfigError("a folder, not a campaign file", file=path, hint="give the YAML file in it, for instance campaign.yaml")
    if path.exists():
        raise ConfigError("not a regular file", file=path)
    raise ConfigError("the campaign file does not exist", file=path, hint="check the path; 'lrbc init' writes a file to start from")
