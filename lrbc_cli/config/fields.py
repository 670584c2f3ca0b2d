"""Field types that the models of the campaign file share: strict base class, names, paths, matrix references, frozen mappings."""

from __future__ import annotations

import errno
import os
import re
import unicodedata
import zlib
from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, Literal, NoReturn, TypeVar

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Discriminator,
    Field,
    GetJsonSchemaHandler,
    PrivateAttr,
    Tag,
    ValidationInfo,
    WithJsonSchema,
    model_validator,
)
from pydantic.functional_validators import ModelWrapValidatorHandler
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema, PydanticCustomError

T = TypeVar("T")

NAME_PATTERN = r"[A-Za-z0-9_-][A-Za-z0-9._-]*"
NAME_LENGTH = 100
#: Files that commands write into the output folder, beside the folders of the jobs. Temporary ones begin with a dot, which no name does.
RESULT_FILES = (
    *("campaign.csv", "campaign.json", "reduction.json", "calibration.json"),
    *("plan.json", "plan.csv", "plan.previous.json", "plan.previous.csv", "structure.json", "structure.html", "report.html"),
    *(f"{stem}.{kind}" for stem in ("plan", "structure", "verdicts", "damping") for kind in ("png", "pdf", "svg")),
)
#: Names that no job may have.
RESERVED_JOBS = (*RESULT_FILES, "calibration")
_WINDOWS = {"con", "prn", "aux", "nul", *(f"{port}{number}" for port in ("com", "lpt") for number in range(1, 10))}


def problem(text: str, *keys: str | int, expected: object = None, found: object = None, hint: str | None = None) -> PydanticCustomError:
    """Return the error that a validator raises; `keys` is the path from the validated value to the wrong one."""
    return PydanticCustomError("lrbc", "{text}", {"text": text, "keys": keys, "expected": expected, "found": found, "hint": hint})


class Strict(BaseModel):
    """Base of all models: no unknown keys, no coercion, no change after loading, finite numbers."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, allow_inf_nan=False)


class FrozenDict(dict[str, T]):
    """A dictionary that cannot be changed."""

    def _refuse(self, *_: object, **__: object) -> NoReturn:
        raise TypeError("the campaign is read-only")

    __setitem__ = __delitem__ = __ior__ = clear = pop = popitem = setdefault = update = _refuse

    def __reduce__(self) -> tuple[Any, ...]:
        return FrozenDict, (dict(self),)


def _freeze(value: dict[str, T]) -> dict[str, T]:
    return FrozenDict(value)


def is_name(text: str) -> bool:
    """Whether the characters of a text are allowed in file names on every system and in key paths."""
    return re.fullmatch(NAME_PATTERN, text) is not None and not text.endswith(".")


def check_name(name: str) -> str:
    """Return a name that can be a file or folder name on every system; refuse wrong characters, long and reserved names."""
    rule = "letters, digits, '.', '_' and '-', not beginning or ending with '.'"
    if not is_name(name):
        raise problem("this name cannot be used as a file name", expected=rule, found=f"'{name}'" if name else "an empty name")
    if len(name) > NAME_LENGTH:
        raise problem("the name is too long", expected=f"at most {NAME_LENGTH} characters", found=f"{len(name)}")
    if name.split(".")[0].lower() in _WINDOWS:
        raise problem("Windows reserves this name for a device", found=f"'{name}'", hint="choose another name")
    return name


def plain_name(text: str) -> str:
    """Name made from a text: letters without accents, dashes for characters that are not allowed; may be empty."""
    plain = unicodedata.normalize("NFKD", text).encode("ascii", "ignore").decode()
    return re.sub(r"[^A-Za-z0-9._-]+", "-", plain).strip("-._")[:NAME_LENGTH].rstrip(".")


def job_name(texts: Sequence[str], taken: Collection[str], key: str) -> str:
    """Name of a further job: the first of `texts` that is allowed and free, else the first one with a checksum of `key`.

    Parameters
    ----------
    texts : sequence of str
        Candidates.
    taken : collection of str
        Names of other jobs; case does not matter.
    key : str
        A text that no other job has, such as the name of its file.
    """
    others = {name.lower() for name in (*taken, *RESERVED_JOBS)}
    names = [name for name in map(plain_name, texts) if name]
    for name in names:
        with suppress(PydanticCustomError):
            if check_name(name).lower() not in others:
                return name
    return f"{(*names, 'job')[0][: NAME_LENGTH - 9]}-{zlib.crc32(key.encode()):08x}"


#: A name in the campaign file, which is also used for files and columns.
Name = Annotated[
    str,
    AfterValidator(check_name),
    WithJsonSchema({"type": "string", "pattern": f"^{NAME_PATTERN}$", "maxLength": NAME_LENGTH}),
]

#: A read-only mapping by name.
NameMap = Annotated[dict[Name, T], AfterValidator(_freeze)]


def _to_path(value: object, info: ValidationInfo) -> object:
    if not isinstance(value, str):
        raise problem("a value of the wrong type", expected="a path, as text")
    if not value or "\n" in value:
        raise problem("this is not a path", expected="a path relative to the campaign file", found=f"{value!r}")
    folder = (info.context or {}).get("folder", Path())
    given = Path(folder) / value
    path = Path(os.path.realpath(given))
    if os.path.islink(given) and os.path.isfile(given):  # noqa: PTH113, PTH114
        # A link to a file stays in its folder: messages name what the user wrote, and other measurements lie beside it.
        path = Path(os.path.realpath(given.parent)) / given.name
    try:
        path.lstat()
    except OSError as error:
        # Missing or unreachable files are reported by the code that reads or writes them.
        if error.errno == errno.ENAMETOOLONG:
            raise problem("the path is longer than this system allows", found=f"{len(str(path))} characters", hint="shorten it") from None
    return path


#: A path: text in the file, absolute after loading.
FilePath = Annotated[Path, BeforeValidator(_to_path), WithJsonSchema({"type": "string", "minLength": 1})]


def told_apart(kinds: type | UnionType, form: str, other: str) -> Discriminator:
    """Discriminator of two forms of a value: tag ``form:`` with `form` for values of the types `kinds`, with `other` for all others."""
    return Discriminator(lambda value: f"form:{form if isinstance(value, kinds) else other}")


Auto = Literal["auto"]
#: A number, or the word auto.
NumberOrAuto = Annotated[Annotated[float, Tag("form:number")] | Annotated[Auto, Tag("form:auto")], told_apart(str, "auto", "number")]


def check_ordered(value: tuple[float, float]) -> tuple[float, float]:
    """Return a pair of numbers; refuse it unless the first is below the second."""
    if not value[0] < value[1]:
        raise problem(
            "the range is empty",
            expected="[lower, upper] with lower below upper",
            found=f"[{value[0]:g}, {value[1]:g}]",
            hint=f"write [{value[1]:g}, {value[0]:g}]" if value[1] < value[0] else None,
        )
    return value


#: A range [lower, upper].
Range = Annotated[tuple[float, float], AfterValidator(check_ordered)]
Point = tuple[float, float, float]
Positive = Annotated[float, Field(gt=0)]
#: A number above 0, or the word auto.
PositiveOrAuto = Annotated[Annotated[Positive, Tag("form:number")] | Annotated[Auto, Tag("form:auto")], told_apart(str, "auto", "number")]
Quantity = Literal["pressure", "displacement", "velocity", "acceleration"]


def _check_label(value: str) -> str:
    if not value or value != value.strip():
        raise problem(
            "this is not a DOF label", expected="UX, UY, UZ, ROTX, ROTY, ROTZ, PRES or another label of the DOF table", found=f"{value!r}"
        )
    return value.upper()


#: Label of a DOF; case does not matter.
Component = Annotated[str, AfterValidator(_check_label), WithJsonSchema({"type": "string", "minLength": 1})]


def check_inside(initial: float, bounds: tuple[float, float]) -> None:
    """Refuse a start value outside its bounds."""
    if not bounds[0] <= initial <= bounds[1]:
        raise problem(
            "the start value is outside its bounds", "initial", expected=f"between {bounds[0]:g} and {bounds[1]:g}", found=f"{initial:g}"
        )


def check_unique(values: tuple[T, ...]) -> tuple[T, ...]:
    """Return a list; refuse it if an entry is repeated."""
    for index, value in enumerate(values):
        if value in values[:index]:
            raise problem("an entry is given twice", index, expected="each entry once", found=f"'{value}'", hint="remove one of them")
    return values


#: A number, or [real, imaginary].
ComplexFactor = Annotated[
    Annotated[float, Tag("form:number")] | Annotated[tuple[float, float], Tag("form:pair")], told_apart(list | tuple, "pair", "number")
]

#: Formats of matrix files that the campaign can prescribe.
MatrixFormat = Literal[
    "matrix-market",
    "hdf5",
    "mat-v7.3",
    "mat-v5",
    "npz",
    "abaqus",
    "triplets",
    "sierra-sd",
    "harwell-boeing",
    "nastran-op4",
    "nastran-dmig",
    "ansys-full",
]


class ArraysConfig(Strict):
    """Names of the arrays of a compressed matrix in HDF5. Indices may count from 0 or 1. The matrix must be square."""

    data: str = Field(default="data", min_length=1, description="Values; complex values as pairs `real`, `imag`.")
    indices: str = Field(default="indices", min_length=1, description="Column of each value (csc: row).")
    indptr: str = Field(default="indptr", min_length=1, description="Begin of each row (csc: column), and the end.")
    layout: Literal["csr", "csc"] = Field(default="csr", description="Whether rows or columns are compressed.")


class MatrixRef(Strict):
    """A matrix in a file: ``file``, ``file#group``, or a mapping with ``file``, ``group``, ``format``."""

    path: FilePath = Field(alias="file", description="The file, relative to the campaign file.")
    group: str | None = Field(
        default=None,
        min_length=1,
        description="Group or variable inside the file (HDF5, MATLAB). May be omitted if the file contains one matrix.",
    )
    format: MatrixFormat | None = Field(default=None, description="Format of the file. If omitted: recognised by content.")
    arrays: ArraysConfig | None = Field(
        default=None, description="Names of the arrays of a compressed matrix in a group of HDF5, if the group does not state them."
    )
    _text: str = PrivateAttr(default="")

    @property
    def text(self) -> str:
        """The reference as written, ``file#group``."""
        return self._text

    @model_validator(mode="wrap")
    @classmethod
    def _split(cls, value: Any, handler: ModelWrapValidatorHandler[MatrixRef]) -> MatrixRef:
        if isinstance(value, str):
            file, hash_sign, group = value.rpartition("#") if "#" in value else (value, "", "")
            if not file or (hash_sign and not group):
                raise problem("this is not a reference to a matrix", expected="'file' or 'file#group'", found=f"'{value}'")
            value = {"file": file, "group": group} if hash_sign else {"file": file}
        elif not isinstance(value, Mapping):
            raise problem("a value of the wrong type", expected="a matrix: 'file', 'file#group' or {file:, group:, format:}")
        reference = handler(value)
        reference._text = value["file"] + (f"#{reference.group}" if reference.group else "")
        return reference

    @classmethod
    def __get_pydantic_json_schema__(cls, core_schema: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        """Allow the short form in the JSON Schema too."""
        schema = handler.resolve_ref_schema(handler(core_schema))
        mapping = {key: schema.pop(key) for key in ("type", "properties", "required", "additionalProperties") if key in schema}
        schema["anyOf"] = [{"type": "string", "minLength": 1, "description": "'file' or 'file#group'."}, mapping]
        return schema


class OperatorRef(MatrixRef):
    """A square matrix of the model: as any matrix in a file, and with ``symmetric`` where the file holds one triangle of it."""

    symmetric: bool | None = Field(
        default=None,
        description="true: the matrix is symmetric; if the file contains one triangle, the other is filled in. false: a matrix of one "
        "triangle is used as given. If omitted: a matrix of one triangle is refused.",
    )
    scale: ComplexFactor = Field(
        default=1.0,
        description="Factor on the matrix, for instance -1 if it was exported with the opposite sign; [real, imaginary] if it is complex.",
    )
    conjugate: bool = Field(
        default=False,
        description="Use the complex conjugate: for hysteretic damping exported for exp(-i omega t), with a negative imaginary part.",
    )


def check_smoothing(value: tuple[float, ...]) -> tuple[float, ...]:
    """Return smoothing weights; refuse them unless their number is odd and their sum positive."""
    if len(value) % 2 == 0:
        raise problem("the smoothing weights have no middle", expected="an odd number of weights", found=f"{len(value)}")
    if not sum(value) > 0:
        raise problem("all smoothing weights are zero", expected="a positive sum")
    return value


def check_smoothing_sum(weights: tuple[float, ...] | None, normalised: bool) -> None:
    """Refuse smoothing weights with a sum above ten: effective values would lie more than a decade above the parameters."""
    if weights is None or normalised or sum(weights) <= 10.0:
        return
    own = ", ".join(f"{weight / 100.0:g}" for weight in weights)
    raise problem(
        "the smoothing weights multiply the stiffness",
        "smoothing",
        expected="weights whose sum is about 1",
        found=f"a sum of {sum(weights):g}",
        hint=f"probably in per cent: write [{own}]; or add normalised: true",
    )


def unspeakable(path: Path) -> bool:
    """Whether a path contains bytes that are no text, as names from another character set; no result file could name it."""
    return any(0xD800 <= ord(letter) <= 0xDFFF for letter in str(path))


def shown(path: Path) -> str:
    """The name of a file for a message, with a question mark for each byte that is no text."""
    return path.name.encode("utf-8", "replace").decode()
