"""Models of the sections ``model``, ``excitation``, ``responses`` and ``parameters``: what is measured and identified."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, ConfigDict, Discriminator, Field, Tag, model_validator

from lrbc_cli.config.fields import (
    Auto,
    Component,
    FilePath,
    MatrixFormat,
    MatrixRef,
    Name,
    NumberOrAuto,
    OperatorRef,
    Point,
    Positive,
    Quantity,
    Range,
    Strict,
    check_inside,
    check_smoothing,
    check_smoothing_sum,
    check_unique,
    problem,
    told_apart,
)

NodeNumber = Annotated[int, Field(ge=0)]
RecordName = Annotated[str, Field(min_length=1)]
RecordNumber = Annotated[int, Field(ge=1)]
Forms = Sequence[tuple[tuple[str, ...], tuple[str, ...]]]

POINT_FORMS: Forms = ((("near", "component"), ()), (("node", "component"), ()), (("dof",), ()), (("vector",), ()))
RESPONSE_FORMS: Forms = (*POINT_FORMS, (("matrix",), ("row",)))
SELECT_FORMS: Forms = (
    (("component", "box"), ()),
    (("component", "along", "tolerance"), ()),
    (("component", "boundary"), ("box",)),
    (("component", "near_bolts"), ()),
    (("nodes", "component"), ()),
    (("dofs",), ()),
    (("vectors", "positions"), ()),
    (("left", "right", "positions"), ()),
    (("bushings",), ("component",)),
)

#: Values of keys that are not given, if not None.
FORM_DEFAULTS = {"row": 0}


def _form_text(forms: Forms) -> str:
    return " or ".join("{" + ", ".join(f"{key}:" for key in (*required, *optional)) + "}" for required, optional in forms)


def _forms_schema(forms: Forms) -> ConfigDict:
    """JSON Schema that allows the same forms as `_check_form`."""
    keys = sorted({key for required, optional in forms for key in (*required, *optional)})
    branches = [
        {
            "required": list(required),
            "properties": {key: {"const": FORM_DEFAULTS.get(key)} for key in keys if key not in (*required, *optional)}
            | {key: {"not": {"const": None}} for key in required},
        }
        for required, optional in forms
    ]
    return ConfigDict(json_schema_extra={"oneOf": branches})  # type: ignore[dict-item]


def _check_form(value: Strict, forms: Forms) -> None:
    """Raise an error unless the given keys are exactly those of one form."""
    keys = {key for required, optional in forms for key in (*required, *optional)}
    given = {key for key in keys if getattr(value, key) != FORM_DEFAULTS.get(key)}
    for required, optional in forms:
        if set(required) <= given <= {*required, *optional}:
            return
    found = "{" + ", ".join(f"{key}:" for key in type(value).model_fields if key in given) + "}" if given else "none of these keys"
    near = [(required, optional) for required, optional in forms if given <= {*required, *optional}]
    if given and len(near) == 1:
        lacking = [f"'{key}'" for key in near[0][0] if key not in given]
        raise problem(
            f"the key{'s' if len(lacking) > 1 else ''} {' and '.join(lacking)} must be given too", expected=_form_text(near), found=found
        )
    raise problem("DOFs must be selected in exactly one way", expected=_form_text(forms), found=found)


class FieldDamping(Strict):
    """Damping of one field, C = alpha M + beta K and K (1 + i loss_factor) on its diagonal block."""

    alpha: float = Field(default=0.0, ge=0, description="Mass-proportional coefficient [1/s].")
    beta: float = Field(default=0.0, ge=0, description="Stiffness-proportional coefficient [s].")
    loss_factor: float = Field(default=0.0, ge=0, le=1.0, description="Loss factor of hysteretic (structural) damping; 0.02 is 2 %.")


class ProportionalDamping(Strict):
    """Damping per field, proportional or hysteretic; it acts on the diagonal blocks, never on the coupling."""

    structure: FieldDamping = Field(default=FieldDamping(), description="Coefficients of the structure.")
    acoustic: FieldDamping = Field(default=FieldDamping(), description="Coefficients of the acoustic field (component PRES).")


def _damping_form(value: object) -> str:
    proportional = isinstance(value, ProportionalDamping) or (isinstance(value, dict) and "file" not in value)
    return "form:proportional" if proportional else "form:matrix"


Damping = Annotated[
    Annotated[OperatorRef, Tag("form:matrix")] | Annotated[ProportionalDamping, Tag("form:proportional")], Discriminator(_damping_form)
]


class DofSource(Strict):
    """DOF of each row of the matrices, and coordinates of the nodes: {map:, nodes:}."""

    nodes: FilePath = Field(
        description="Coordinates of the nodes: CSV node,x,y,z, an input file (*NODE of Abaqus and CalculiX, GRID of Nastran, NBLOCK or "
        "NLIST of Ansys), or a mesh of gmsh, exodus or others."
    )
    map: FilePath | None = Field(
        default=None,
        description="Node and component of each row: CalculiX .dof, mapping of Ansys HBMAT or nodal mapping vector, or CSV "
        "dof,node,component. May be omitted if the matrices state it, as those of Abaqus, DMIG and .full do.",
    )
    order: FilePath | None = Field(
        default=None,
        description="Matrix that maps the rows of `map` to those of the matrices: NOD2BCS or NOD2SOLV of Ansys, beside a nodal mapping "
        "vector. If omitted: the rows are the same.",
    )
    components: Annotated[tuple[Component, ...], Field(min_length=1), AfterValidator(check_unique)] | None = Field(
        default=None,
        description="DOFs of each node in their order, if no file names them. With a mapping vector of nodes: if omitted, the usual ones. "
        "Without a map: the rows are the nodes in ascending order, each with these DOFs.",
    )


Dofs = Annotated[
    Annotated[FilePath, Tag("form:file")] | Annotated[DofSource, Tag("form:source")], told_apart(dict | DofSource, "source", "file")
]


class ModelConfig(Strict):
    """The finite-element model that the measurement is compared with."""

    stiffness: OperatorRef = Field(description="Stiffness matrix K: 'file', 'file#group' or {file:, group:, format:, symmetric:}.")
    mass: OperatorRef = Field(description="Mass matrix M, given like the stiffness.")
    damping: Damping | None = Field(
        default=None, description="Damping: a matrix C, or {structure: {alpha:, beta:, loss_factor:}, acoustic: {...}}. If omitted: none."
    )
    dofs: Dofs | None = Field(
        default=None,
        description="DOF table (CSV: dof,node,component,x,y,z; 0-based dof), or {map:, nodes:}. If the matrices name their DOFs, the "
        "coordinates of the nodes suffice. If omitted: every DOF is structural, and DOFs can only be selected by number, vector or file.",
    )
    format: MatrixFormat | None = Field(default=None, description="Format of all matrix files. If omitted: each recognised by content.")


class PointConfig(Strict):
    """Where a force acts: {near:, component:}, {node:, component:}, {dof:} or {vector:}."""

    model_config = _forms_schema(POINT_FORMS)

    near: Point | None = Field(
        default=None, description="Coordinates [x, y, z] in metres or the length of `units`. The nearest node with the component is used."
    )
    node: NodeNumber | None = Field(default=None, description="Node number of the DOF table.")
    component: Component | None = Field(
        default=None, description="DOF label at the node: UX, UY, UZ, ROTX, ROTY, ROTZ, PRES or another of the DOF table."
    )
    dof: NodeNumber | None = Field(default=None, description="0-based number of the DOF.")
    vector: MatrixRef | None = Field(default=None, description="Vector with one entry per DOF, for interpolated or distributed points.")
    scale: float = Field(default=1.0, description="Factor on the load or output row, for instance -1 for the opposite direction.")

    @property
    def form(self) -> Literal["near", "node", "dof", "vector", "matrix"]:
        """Key that identifies the form used."""
        for key in ("near", "node", "dof", "vector"):
            if getattr(self, key) is not None:
                return key
        return "matrix"

    @model_validator(mode="after")
    def _one_form(self) -> PointConfig:
        _check_form(self, RESPONSE_FORMS if isinstance(self, ResponseConfig) else POINT_FORMS)
        if self.scale == 0:
            raise problem("a factor of zero", "scale", expected="a number other than 0")
        return self


Direction = Annotated[int, Field(ge=0, le=6)]


class RecordRef(Strict):
    """Node and direction of a response in an FRF file; if the file contains several hammer points, also those of the reference."""

    node: NodeNumber = Field(description="Response node of the record.")
    direction: Direction = Field(
        description="Response direction of the record, without sign: 0 scalar, 1 to 3 translation, 4 to 6 rotation."
    )
    reference_node: NodeNumber | None = Field(default=None, description="Reference node of the record (hammer point). If omitted: any.")
    reference_direction: Direction | None = Field(default=None, description="Reference direction of the record. If omitted: any.")


class FileRecordRef(Strict):
    """A record in one of the files of a job: {file:} if it contains one record, {file:, number:} or {file:, name:}."""

    file: FilePath = Field(description="One of the files of the job's `frf`.")
    number: RecordNumber | None = Field(
        default=None, description="Number of the record in that file, from 1, as `lrbc check -v` lists them."
    )
    name: RecordName | None = Field(default=None, description="Name of the record in that file.")

    @model_validator(mode="after")
    def _one_way(self) -> FileRecordRef:
        if self.number is not None and self.name is not None:
            raise problem(
                "the record is given by number and by name", "name", expected="number or name", found="both", hint="remove one of them"
            )
        return self


def _record_form(value: object) -> str:
    if isinstance(value, str | int):
        return "form:name" if isinstance(value, str) else "form:number"
    return "form:file" if isinstance(value, FileRecordRef) or (isinstance(value, dict) and "file" in value) else "form:node"


Record = Annotated[
    Annotated[RecordName, Tag("form:name")]
    | Annotated[RecordNumber, Tag("form:number")]
    | Annotated[RecordRef, Tag("form:node")]
    | Annotated[FileRecordRef, Tag("form:file")],
    Discriminator(_record_form),
]


class ResponseConfig(PointConfig):
    """What is measured: a point as for an excitation, or {matrix:, row:}."""

    model_config = _forms_schema(RESPONSE_FORMS)

    matrix: MatrixRef | None = Field(default=None, description="Matrix of output rows, one column per DOF.")
    row: NodeNumber = Field(default=0, description="0-based row of the matrix.")
    quantity: Quantity | None = Field(
        default=None, description="pressure, displacement, velocity or acceleration. If omitted: pressure at PRES, else displacement."
    )
    labelled: Quantity | None = Field(
        default=None, description="Quantity that the FRF files wrongly state for this response: its numbers are taken as `quantity`."
    )
    record: Record | None = Field(
        default=None,
        description="Record of this response in the FRF files, if its name differs: a name, a number from 1, or {node:, direction:}.",
    )
    excitation: Name | None = Field(default=None, description="The excitation of this response; only needed if there are several.")


Box = tuple[tuple[float, float], tuple[float, float], tuple[float, float]]


def _check_box(value: tuple[tuple[float, float], ...]) -> tuple[tuple[float, float], ...]:
    for axis, (lower, upper) in enumerate(value):
        if lower > upper:
            raise problem("the box is empty", axis, expected="[from, to] with from at most to", found=f"[{lower:g}, {upper:g}]")
    return value


Nodes = Annotated[
    Annotated[FilePath, Tag("form:file")]
    | Annotated[tuple[NodeNumber, ...], Field(min_length=1), AfterValidator(check_unique), Tag("form:list")],
    told_apart(str | Path, "file", "list"),
]


class SelectConfig(Strict):
    """Which DOFs or vectors carry the terms of a group."""

    model_config = _forms_schema(SELECT_FORMS)

    component: Component | None = Field(
        default=None, description="DOF label at the selected nodes. With `bushings`: only the springs with this component."
    )
    box: Annotated[Box, AfterValidator(_check_box)] | None = Field(
        default=None,
        description="[[x0, x1], [y0, y1], [z0, z1]] in metres or the length of `units`: all nodes inside, borders included. Several edges "
        "in it become separate groups NAME-1, NAME-2 ... where values are tied to their neighbours.",
    )
    along: Annotated[tuple[Point, ...], Field(min_length=2)] | None = Field(
        default=None, description="Corners [x, y, z] of a line: all nodes within `tolerance` of it, in order along it."
    )
    tolerance: Positive | None = Field(default=None, description="Distance from the line up to which nodes are selected.")
    boundary: Literal[True] | None = Field(
        default=None,
        description="true: the nodes on the border of a flat field of nodes, either of all with the component or of those in `box`. The "
        "border is found from the coordinates; nodes in corners that are cut out of the field are left out.",
    )
    near_bolts: Positive | None = Field(
        default=None,
        description="Distance from the bolts of `bolts` up to which nodes are selected. Each node belongs to its nearest bolt.",
    )
    nodes: Nodes | None = Field(default=None, description="Node numbers, in the order along the edge, or a CSV file with a column `node`.")
    dofs: FilePath | None = Field(
        default=None,
        description="CSV file with a column `dof` (0-based), one term per line. Terms with equal entries in a column `parameter` share one "
        "parameter. A column `bolt` names the bolt of each term. Columns x,y,z give positions if there is no DOF table.",
    )
    vectors: MatrixRef | None = Field(default=None, description="Matrix with one column per term, b_k = c_k.")
    left: MatrixRef | None = Field(default=None, description="Matrix of the left vectors b_k, one column per term.")
    right: MatrixRef | None = Field(default=None, description="Matrix of the right vectors c_k, one column per term.")
    positions: FilePath | None = Field(
        default=None,
        description="CSV file with x,y,z of each term. Terms with equal entries in a column `parameter` share one parameter. A column "
        "`bolt` names the bolt of each term. Without it, entries of `parameter` that are names of bolts do.",
    )
    bushings: FilePath | None = Field(
        default=None,
        description="CSV file of springs, one per line: bolt,node_a,node_b,component,stiffness, with nodes of the DOF table. node_b empty: "
        "to ground. component: UX to ROTZ, in local axes if there are columns x_x,x_y,x_z (local x) and y_x,y_y,y_z (a vector in the local "
        "xy plane). The springs of a bolt share one parameter, in log10 relative to the given stiffness: 0 is nominal, and the start value "
        "for auto.",
    )

    @model_validator(mode="after")
    def _one_form(self) -> SelectConfig:
        _check_form(self, SELECT_FORMS)
        return self


class GroupDampingConfig(Strict):
    """Damping tied to the identified stiffness, eq. (33): (s beta + i loss_factor) 10^p_damp k, one p_damp for the group."""

    initial: float = Field(default=0.0, description="Start value of p_damp (log10).")
    bounds: Range = Field(default=(-3.0, 4.0), description="Bounds of p_damp (log10).")
    beta: Annotated[float, Field(ge=0)] | None = Field(
        default=None, description="Stiffness-proportional coefficient [s]. If omitted: that of the structure in `model.damping`."
    )
    loss_factor: Annotated[float, Field(ge=0, le=1.0)] | None = Field(
        default=None, description="Loss factor of hysteretic damping. If omitted: that of the structure in `model.damping`."
    )

    def coefficients(self, model: Damping | None) -> tuple[float, float]:
        """Beta [s] and loss factor; those of the structure in the model if not given here."""
        structure = model.structure if isinstance(model, ProportionalDamping) else FieldDamping()
        return (
            structure.beta if self.beta is None else self.beta,
            structure.loss_factor if self.loss_factor is None else self.loss_factor,
        )

    @model_validator(mode="after")
    def _inside(self) -> GroupDampingConfig:
        check_inside(self.initial, self.bounds)
        return self


TiedDamping = Annotated[
    Annotated[GroupDampingConfig, Tag("form:damping")] | Annotated[Literal["none"], Tag("form:none")], told_apart(str, "none", "damping")
]


Bounds = Annotated[Annotated[Range, Tag("form:range")] | Annotated[Auto, Tag("form:auto")], told_apart(str, "auto", "range")]

#: Largest plausible log10 stiffness; a larger number is probably the stiffness itself.
LARGEST_LOG10 = 20.0

Weight = Annotated[float, Field(ge=0)]


def _conditional_schema(schema: dict[str, Any]) -> None:
    given = {"enum": ["damping", "mass"]}
    schema["if"] = {"properties": {"kind": given}, "required": ["kind"]}
    number = {"not": {"const": "auto"}}
    schema["then"] = {"required": ["initial", "bounds"], "properties": {"initial": number, "bounds": number, "damping": {"type": "null"}}}


class GroupConfig(Strict):
    """One group of low-rank terms whose parameters are identified."""

    model_config = ConfigDict(json_schema_extra=_conditional_schema)

    kind: Literal["stiffness", "damping", "mass"] = Field(default="stiffness", description="Matrix that the terms are added to: K, C or M.")
    select: SelectConfig = Field(
        description="The terms: {component:, box:}, {component:, along:, tolerance:}, {component:, boundary:}, {component:, near_bolts:}, "
        "{nodes:, component:}, {dofs:}, {vectors:, positions:}, {left:, right:, positions:} or {bushings:}."
    )
    initial: NumberOrAuto = Field(
        default="auto",
        description="Start value (log10), or auto for stiffness: where the FRFs differ by about 0.3 dB from the clamped limit; for "
        "bushings the nominal stiffness. Damping and mass need a number.",
    )
    bounds: Bounds = Field(
        default="auto",
        description="Bounds [lower, upper] (log10), or auto for stiffness: upper where the FRFs differ by 0.02 dB from the clamped limit. "
        "Damping and mass need numbers.",
    )
    baseline: float = Field(
        default=0.0,
        ge=0,
        description="What the matrices already contain for these terms (linear, not log10); it is subtracted exactly. For bushings: 1 if "
        "the stiffness matrix contains them.",
    )
    smoothing: Annotated[tuple[Weight, ...], Field(min_length=1, max_length=99), AfterValidator(check_smoothing)] | None = Field(
        default=None,
        description="Weights over neighbouring terms (an odd number of them), for instance [0.333333, 0.666667, 0.333333]. If omitted: "
        "none.",
    )
    normalised: bool = Field(default=False, description="Scale each row of smoothing weights to the sum 1, also at the ends.")
    damping: TiedDamping | None = Field(
        default=None,
        description="For stiffness groups: {initial:, bounds:, beta:, loss_factor:}, and the damping exponent p_damp is identified; or "
        "none: undamped. If omitted: springs of bolts are damped as the structure in `model.damping`, with p_damp; others are not damped.",
    )

    @property
    def start(self) -> float | None:
        """Start value (log10); None if it is determined from the FRFs."""
        return self.initial if self.initial != "auto" else None if self.select.bushings is None else 0.0

    def _logarithms(self) -> str:
        """Start value and bounds as logarithms, if all of them can be values without log10; else empty."""
        if isinstance(self.initial, str) or isinstance(self.bounds, str) or not 0.0 < self.bounds[0] <= self.initial <= self.bounds[1]:
            return ""
        start, low, high = (f"{math.log10(value):.3g}" for value in (self.initial, *self.bounds))
        return f"if these are values, write log10 of each: initial: {start}, bounds: [{low}, {high}]"

    @model_validator(mode="after")
    def _consistent(self) -> GroupConfig:
        for key, value in (("initial", self.initial), *(("bounds", bound) for bound in self.bounds if self.bounds != "auto")):
            if not isinstance(value, str) and value > LARGEST_LOG10:
                raise problem(
                    "the logarithm is too large for a stiffness",
                    key,
                    expected=f"log10 of the value, at most {LARGEST_LOG10:g}",
                    found=f"{value:g}",
                    hint=self._logarithms() or f"write {math.log10(value):.3g} for {value:g}",
                )
        if self.kind != "stiffness":
            for key in ("initial", "bounds"):
                if getattr(self, key) == "auto":
                    raise problem(f"'auto' is for stiffness only; the kind of this group is {self.kind}", key, hint=f"give {key} in log10")
            if self.damping is not None:
                raise problem(f"damping tied to a {self.kind} term", "damping", expected="only where kind is stiffness", hint="remove it")
        if self.start is not None and self.bounds != "auto":
            check_inside(self.start, self.bounds)
        if self.normalised and self.smoothing is None:
            raise problem("'normalised' needs smoothing", "normalised", hint="add smoothing, or remove it")
        check_smoothing_sum(self.smoothing, self.normalised)
        return self
