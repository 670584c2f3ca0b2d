"""Base classes and field types of the records: strict types, arrays whose NaN are null in the file, and readable validation errors."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Self, TypeVar, get_args

import numpy as np
from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    GetJsonSchemaHandler,
    PlainSerializer,
    PlainValidator,
    TypeAdapter,
    ValidationError,
    WithJsonSchema,
)
from pydantic.fields import FieldInfo
from pydantic_core import CoreSchema, PydanticCustomError

from lrbc_cli.arrays import Floats
from lrbc_cli.errors import NumericalError

T = TypeVar("T")


class Record(BaseModel):
    """Base of all records: frozen, strict types, finite numbers. Keys that this version does not know are kept unchanged."""

    model_config = ConfigDict(
        frozen=True, strict=True, extra="allow", allow_inf_nan=False, arbitrary_types_allowed=True, populate_by_name=True
    )

    def __init__(self, /, **values: Any) -> None:
        """Record of computed values, which may be values of numpy; see ``Stated`` for None.

        Raises
        ------
        NumericalError
            If the values do not fit the record, for instance because they are not finite.
        """
        known = type(self).model_fields
        given = {name: plain(value) for name, value in values.items() if value is not None or not _only_stated(known.get(name))}
        with _computed():
            super().__init__(**given)

    # Reading a file does not come through here: there, what does not fit is damage.
    __init__.__pydantic_base_init__ = True  # type: ignore[attr-defined]

    @classmethod
    def checked(cls, tree: Mapping[str, Any]) -> Self:
        """Record of computed values by their keys in the file; errors as of the constructor, with the whole key path."""
        with _computed():
            return cls.model_validate(plain(tree))

    @classmethod
    def like(cls, source: object, **more: Any) -> Self:
        """Record of the attributes of an object that have the names of its fields, and of further values."""
        names = (name for name in cls.model_fields if name not in more and hasattr(source, name))
        return cls(**{name: getattr(source, name) for name in names}, **more)

    def tree(self) -> dict[str, Any]:
        """Content of the file: plain values by key, null for numbers that are not finite."""
        return self.model_dump(by_alias=True, exclude_unset=True)


@contextmanager
def _computed() -> Iterator[None]:
    try:
        yield
    except ValidationError as error:
        place, expected, found = first_wrong(error)
        raise NumericalError("this result cannot be written", place=place, expected=expected, found=found) from error


class StoredRecord(Record):
    """Base of the records that are files of their own: they state their format and version."""

    #: How to write the file again.
    HINT: ClassVar[str] = "run `lrbc update` to write the results again (`--force` for finished jobs)"

    format: str
    version: Literal[1]

    @classmethod
    def form(cls) -> str:
        """Value of ``format`` in files of this kind."""
        return str(get_args(cls.model_fields["format"].annotation)[0])

    @classmethod
    def checked(cls, tree: Mapping[str, Any]) -> Self:
        """See ``Record.checked``; format and version are added."""
        return super().checked({"format": cls.form(), "version": 1, **tree})


class SealedRecord(StoredRecord):
    """Base of the records with a digest of their own content, which shows whether the file was changed."""

    #: SHA-256 of all other keys, see ``store.digest_of``; None before it is written.
    digest: str | None = None


_AS_THEY_ARE = {str, int, bool, type(None)}


def plain(value: Any) -> Any:
    """Copy that JSON can hold, except for records, which are kept: numbers that are not finite become None."""
    kind = type(value)
    if kind in _AS_THEY_ARE:
        return value
    # Most values are numbers in lists, and the check for mappings is slow: numbers come first.
    if kind is float:
        return value if math.isfinite(value) else None
    if kind is list or kind is tuple:
        return [plain(item) for item in value]
    if isinstance(value, Record):
        return value
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return (
            value.tolist() if value.dtype.kind in "biu" or (value.dtype.kind == "f" and np.isfinite(value).all()) else plain(value.tolist())
        )
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, np.generic):
        return plain(value.item())
    if isinstance(value, Path):
        return value.as_posix()
    return value


def wrong(place: str, expected: object, found: object) -> PydanticCustomError:
    """Error of a validator: what was expected and found at ``place``, a key path relative to the validated value."""
    return PydanticCustomError("lrbc", "{expected}", {"place": place, "expected": expected, "found": found})


_EXPECTED = {
    "missing": "a value",
    "string_type": "text",
    "bool_type": "true or false",
    "float_type": "a number",
    "int_type": "a whole number",
    "tuple_type": "a list",
    "dict_type": "an object",
    "model_type": "an object",
}


def first_wrong(error: ValidationError) -> tuple[str, str, str]:
    """Key path, expected and found value of the first validation error."""
    first = error.errors(include_url=False)[0]
    context = first.get("ctx", {})
    place = "".join(f"[{key}]" if isinstance(key, int) else f".{key}" for key in first["loc"])
    if first["type"] == "lrbc":
        return (place + context["place"]).lstrip("."), str(context["expected"]), str(context["found"])
    found = "no such key" if first["type"] == "missing" else repr(first["input"])
    if first["type"] == "literal_error" and isinstance(first["input"], str):
        found = first["input"]
    expected = _EXPECTED.get(first["type"]) or context.get("expected") or first["msg"].removeprefix("Input should be ")
    return place.lstrip("."), str(expected).replace("'", ""), found


def _vector(value: Any, gaps: bool, size: int | None, place: str = "") -> Floats:
    what = f"{'' if size is None else f'{size} '}numbers"
    if not isinstance(value, list):
        raise wrong(place, f"a list of {what}", repr(value))
    allowed = {int, float, type(None)} if gaps else {int, float}
    if not set(map(type, value)) <= allowed:
        index = next(i for i, item in enumerate(value) if type(item) not in allowed)
        raise wrong(f"{place}[{index}]", "a number", repr(value[index]))
    if size is not None and len(value) != size:
        raise wrong(place, f"{size} values", f"{len(value)} values")
    # None becomes NaN.
    array = np.array(value, dtype=float)
    array.flags.writeable = False
    return array


def _vectors(gaps: bool = False, size: int | None = None) -> Callable[[Any], Floats]:
    return lambda value: value if isinstance(value, np.ndarray) else _vector(value, gaps, size)


def _rows(width: int | None, gaps: bool = False) -> Callable[[Any], Floats]:
    """Validator of a list of rows of `width` numbers; None: as many as there are rows."""

    def validate(value: Any) -> Floats:
        if isinstance(value, np.ndarray):
            return value
        if not isinstance(value, list):
            raise wrong("", "a list of rows", repr(value))
        columns = len(value) if width is None else width
        array = np.array([_vector(row, gaps, columns, f"[{i}]") for i, row in enumerate(value)]).reshape(len(value), columns)
        array.flags.writeable = False
        return array

    return validate


def _gap(value: Any) -> float:
    if value is None:
        return math.nan
    if type(value) not in (int, float):
        raise wrong("", "a number", repr(value))
    return float(value)


_NUMBER, _GAP = {"type": "number"}, {"type": ["number", "null"]}
_AS_LISTS = PlainSerializer(plain)


def _list(items: dict[str, Any], size: int | None = None) -> WithJsonSchema:
    sized = {} if size is None else {"minItems": size, "maxItems": size}
    return WithJsonSchema({"type": "array", "items": items, **sized})


#: A number; null in the file becomes NaN.
Gap = Annotated[float, PlainValidator(_gap), _AS_LISTS, WithJsonSchema(_GAP)]
#: (n,) array of numbers; the next ones accept null as NaN: (n,) array, (3,) point, (2,) limits of a range.
Vector = Annotated[Floats, PlainValidator(_vectors()), _AS_LISTS, _list(_NUMBER)]
Gaps = Annotated[Floats, PlainValidator(_vectors(gaps=True)), _AS_LISTS, _list(_GAP)]
Point = Annotated[Floats, PlainValidator(_vectors(gaps=True, size=3)), _AS_LISTS, _list(_GAP, 3)]
Range = Annotated[Floats, PlainValidator(_vectors(gaps=True, size=2)), _AS_LISTS, _list(_GAP, 2)]
#: (n, 3) array; (n, n) array with null as NaN.
Points = Annotated[Floats, PlainValidator(_rows(3)), _AS_LISTS, _list({"type": "array", "items": _NUMBER, "minItems": 3, "maxItems": 3})]
Square = Annotated[Floats, PlainValidator(_rows(None, gaps=True)), _AS_LISTS, _list({"type": "array", "items": _GAP})]

#: A tuple; a list in the file.
Many = Annotated[tuple[T, ...], Field(strict=False)]
Share = Annotated[float, Field(ge=0.0, le=1.0)]

_ONLY_STATED = object()
#: A value that the constructor leaves out of the record, and so out of the file, if it is None.
Stated = Annotated[T | None, _ONLY_STATED]


class _OfMethod:
    """JSON Schema of a dict by the dataclasses of some of its values; reading keeps what other versions have written as it is."""

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        """Schema of the dict with that of these keys."""
        # Reading and judging need neither, and SciPy takes a while to load.
        from lrbc_cli.updating.statistics.model import StatisticalModel
        from lrbc_cli.updating.statistics.residuals import ResidualOptions

        kinds: dict[str, type] = {"residual": ResidualOptions, "statistics": StatisticalModel}
        return handler(schema) | {"properties": {name: handler(TypeAdapter(kind).core_schema) for name, kind in kinds.items()}}


#: How jobs are identified: ``Method`` with its reasons.
MethodTree = Annotated[dict[str, Any], _OfMethod()]


def _only_stated(field: FieldInfo | None) -> bool:
    return field is not None and _ONLY_STATED in field.metadata


def _total(value: dict[str, float]) -> dict[str, float]:
    if "total" not in value:
        raise wrong(".total", "a value", "no such key")
    return value


#: Seconds by stage, and their ``total``.
Seconds = Annotated[dict[str, float], AfterValidator(_total), Field(json_schema_extra={"required": ["total"]})]


def same_length(record: Record, first: str, *others: str) -> None:
    """Refuse a record if the lists in the fields `others` differ in length from that in `first`; None is no list."""
    size = len(getattr(record, first))
    for name in others:
        found = getattr(record, name)
        if found is not None and len(found) != size:
            raise wrong(f".{name}", f"{size} values", f"{len(found)} values")
