"""The code of classes that do not belong to this package, as part of an identity: another code is another model."""

from __future__ import annotations

from collections.abc import Iterator
from types import CodeType, FunctionType
from typing import Any

_PACKAGE = __name__.partition(".")[0]
_PLAIN = (bool, int, float, complex, str, tuple, frozenset, type(None))


def code_of(kind: type) -> str:
    """Name of a class and, unless it belongs to this package, the code of its methods and what this uses of its module."""
    if kind.__module__.partition(".")[0] == _PACKAGE:
        return kind.__qualname__
    parts = [(name, _told(part, kind.__module__, set())) for name, part in sorted(vars(kind).items()) if name not in _ABOUT]
    return repr((kind.__qualname__, parts, [code_of(base) for base in kind.__bases__ if base is not object]))


#: Entries of a class that compute nothing.
_ABOUT = ("__doc__", "__module__", "__firstlineno__", "__dataclass_params__", "__match_args__", "__static_attributes__")


def _told(part: Any, module: str, seen: set[str]) -> object:
    """A value in a form that each process finds alike: functions of the module by their code, further objects not at all."""
    part = getattr(part, "fget", None) or getattr(part, "__func__", part)
    if isinstance(part, FunctionType):
        name = f"{part.__module__}.{part.__qualname__}"
        # Functions that classes get, such as those of a dataclass, may state no module.
        if part.__module__ not in (module, None, "builtins") or name in seen:
            return name
        seen.add(name)
        used = sorted({name for code in _codes(part.__code__) for name in code.co_names} & set(part.__globals__))
        inside = [cell.cell_contents for cell in part.__closure__ or ()]
        further = [(name, _told(part.__globals__[name], module, seen)) for name in used]
        return [_constants((part.__defaults__, part.__kwdefaults__, part.__code__)), further, [_told(one, module, seen) for one in inside]]
    return repr(_constants((part,))) if isinstance(part, _PLAIN) else getattr(part, "tolist", lambda: None)()


def _codes(code: CodeType) -> Iterator[CodeType]:
    yield code
    for one in code.co_consts:
        if isinstance(one, CodeType):
            yield from _codes(one)


def _constants(constants: tuple[Any, ...]) -> list[object]:
    """Constants of a function: the code of functions inside it instead of their addresses, sets in an order that each process finds."""
    return [
        (one.co_code, one.co_names, _constants(one.co_consts))
        if isinstance(one, CodeType)
        else sorted(map(repr, one))
        if isinstance(one, frozenset)
        else one
        for one in constants
    ]
