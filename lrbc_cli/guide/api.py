"""The page on the interface for Python, from the public names and their docstrings."""

from __future__ import annotations

import inspect
from collections.abc import Iterator
from typing import Any

import lrbc_cli

_INTRODUCTION = """# The interface for Python

`import lrbc_cli as lrbc`. This page lists what `lrbc_cli.__all__` exports, with the docstrings of the installed version; everything else
may change. The commands use the same functions. `data_samples/notebooks` of the source shows a campaign, and bare matrices. Errors are
`LrbcError`s: one message with file, place, what was expected and found, and how to fix it.
"""


def api_page() -> str:
    """The page as Markdown: functions first, then classes with what they offer."""
    public = {name: getattr(lrbc_cli, name) for name in lrbc_cli.__all__ if not name.startswith("_")}
    lines = [_INTRODUCTION, "```python", *inspect.cleandoc(lrbc_cli.__doc__ or "").splitlines()[2:], "```", ""]
    for wanted in (inspect.isfunction, inspect.isclass):
        for name, thing in sorted(public.items()):
            if wanted(thing):
                lines += [f"## `{_call(name, thing)}`", "", *_text(thing)]
                for member, part in _members(thing) if inspect.isclass(thing) else ():
                    called = f"{name}.{member}"
                    lines += [f"### `{called if isinstance(part, property) else _call(called, part, bound=True)}`", "", *_text(part)]
    return "\n".join(lines).rstrip() + "\n"


def _members(owner: type) -> Iterator[tuple[str, Any]]:
    """Public methods and properties that the class, or a base of this package, documents, in their order."""
    ours = [each for each in reversed(owner.__mro__) if each.__module__.startswith("lrbc_cli.")]
    for name, part in {name: part for each in ours for name, part in vars(each).items()}.items():
        if not name.startswith("_") and (inspect.isfunction(part) or isinstance(part, property)) and part.__doc__:
            yield name, part


def _call(name: str, thing: Any, *, bound: bool = False) -> str:
    """How it is called, types left out: they stand in the text."""
    try:
        signature = inspect.signature(thing)
    except ValueError:
        return name
    # A default that is a function or an object has no readable form.
    readable = (bool, int, float, str, tuple, type(None), type(inspect.Parameter.empty))
    shown = []
    for part in list(signature.parameters.values())[bound:]:
        default = part.default if isinstance(part.default, readable) else ...
        shown.append(part.replace(annotation=part.empty, default=default))
    return name + str(signature.replace(parameters=shown, return_annotation=signature.empty)).replace("=Ellipsis", "=...")


def _text(thing: Any) -> list[str]:
    return ["```text", *inspect.cleandoc(thing.__doc__ or "").splitlines(), "```", ""]
