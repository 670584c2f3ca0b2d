"""Models of how it is computed: reduction, updating, jobs."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Literal

from pydantic import AfterValidator, Discriminator, Field, Tag, model_validator

from lrbc_cli.config.fields import (
    FilePath,
    FrozenDict,
    Name,
    NameMap,
    Positive,
    PositiveOrAuto,
    Quantity,
    Range,
    Strict,
    check_unique,
    problem,
    told_apart,
)
from lrbc_cli.config.structure import Record


def _check_band(value: tuple[float, float]) -> tuple[float, float]:
    if not value[0] > 0:
        raise problem(
            "a band that begins at 0 Hz",
            expected="a lower end above 0 Hz",
            found=f"{value[0]:g}",
            hint="begin at the first usable line, for instance 1.0",
        )
    return value


class ReductionConfig(Strict):
    """The reduced model: where it must hold, and how well."""

    band: Annotated[Range, AfterValidator(_check_band)] = Field(description="Frequency band [lower, upper] in Hz.")
    tolerance: float = Field(
        default=1e-3, gt=0, lt=1, description="Largest measured error of the responses, relative to each line's norm within one quantity."
    )
    backend: Literal["auto", "superlu", "pardiso"] = Field(
        default="auto", description="Sparse solver; auto takes the accelerated one where it is installed. Does not change results."
    )
    max_size: int | None = Field(
        default=None, ge=1, description="Largest order of the reduced model; absent: as large as the tolerance needs."
    )
    held_out: int = Field(default=5, ge=5, le=1000, description="Number of lines outside the basis at which the error is measured.")
    memory_limit: float | None = Field(
        default=None,
        gt=0,
        description="Memory in GB that a reduction may use, predicted before it begins; absent: what the machine has available.",
    )


class EveryLine(Strict):
    """Every n-th measured line of the band."""

    every: int = Field(ge=1, description="Take every n-th line, beginning with the first of the band.")


class ListedLines(Strict):
    """Lines by their frequencies."""

    frequencies: Annotated[tuple[Positive, ...], Field(min_length=1), AfterValidator(check_unique)] = Field(
        alias="list", description="Frequencies in Hz; each is matched to a measured line."
    )


def _lines_form(value: object) -> str:
    if isinstance(value, dict):
        return "form:every" if "every" in value else "form:list"
    return "form:word" if isinstance(value, str) else f"form:{'every' if isinstance(value, EveryLine) else 'list'}"


Lines = Annotated[
    Annotated[Literal["resonances", "all"], Tag("form:word")]
    | Annotated[EveryLine, Tag("form:every")]
    | Annotated[ListedLines, Tag("form:list")],
    Discriminator(_lines_form),
]


def _regularisation_form(value: object) -> str:
    return "form:word" if value in ("l-curve", "auto") else "form:number"


Regularisation = Annotated[
    Annotated[float, Field(ge=0), Tag("form:number")] | Annotated[Literal["auto", "l-curve"], Tag("form:word")],
    Discriminator(_regularisation_form),
]


class NuisanceConfig(Strict):
    """What may have drifted between the reference job and another, each with its standard deviation; absent: held."""

    temperature: Positive | None = Field(
        default=None, description="Standard deviation of the air temperature in K; the speed of sound follows its square root."
    )
    room: Annotated[float, Field(gt=-273.15)] = Field(
        default=20.0, description="Temperature of the reference job in degrees Celsius, about which `temperature` varies."
    )
    sound_speed: Annotated[float, Field(gt=0, lt=0.2)] | None = Field(
        default=None, description="Standard deviation of the speed of sound, relative; instead of `temperature`."
    )
    gain: Positive | None = Field(default=None, description="Standard deviation of the gain of each response in dB.")
    hammer: Annotated[float, Field(gt=0, lt=0.1)] | None = Field(
        default=None, description="Standard deviation of the point that the hammer hits, along the surface, in metres."
    )

    @model_validator(mode="after")
    def _one_speed(self) -> NuisanceConfig:
        if self.temperature is not None and self.sound_speed is not None:
            raise problem("two ways to say the same", "sound_speed", expected="temperature or sound_speed", found="both")
        return self


class UpdateConfig(Strict):
    """The identification: what is compared, at which lines, and how the optimum is sought."""

    reference: Name | None = Field(default=None, description="The job measured with all bolts tight, for verdicts; absent: no comparison.")
    reference_guessed: bool = Field(
        default=False,
        description="`lrbc init --from` guessed the reference job from names, and nobody confirmed it: commands and page say so. Remove it "
        "once all bolts are known to be tight there; it changes no result.",
    )
    responses: Annotated[tuple[Name, ...], Field(min_length=1), AfterValidator(check_unique)] | None = Field(
        default=None, description="Names of the responses to fit; absent: all. The others are reported only."
    )
    lines: Lines = Field(
        default="resonances",
        description="Lines to fit: resonances (of the measurement), all, {every: n} or {list: [Hz, ...]}.",
    )
    approach: Literal["bolts", "paper"] | None = Field(
        default=None,
        description="bolts: one change a bolt against the reference job, each tight or loose; paper: all values along the edge, drawn to "
        "their start values, as published. Absent: bolts where there is a reference job, unless a weight or bfgs is given. Keys of the "
        "other approach are not used; `lrbc check` says so.",
    )
    residual: Literal["db", "log-complex"] = Field(
        default="db",
        description="What is squared: db, the difference of the magnitudes in dB, as in the paper; log-complex, that and the difference of "
        "the phases (8.69 dB a radian).",
    )
    loss: Literal["squares", "soft"] = Field(
        default="squares", description="squares, or soft: differences well above `loss_scale` count by their size only (pseudo-Huber)."
    )
    loss_scale: Positive = Field(default=3.0, description="Where the soft loss bends, in dB.")
    floor: Positive | None = Field(
        default=None,
        description="dB below a response's largest selected line under which differences fade, so that antiresonances do not dominate; "
        "absent: none.",
    )
    weights: Literal["auto", "none"] = Field(
        default="auto",
        description="Weights of the lines 1/sqrt(1 + (sigma/s)²), sigma from coherence (with the jobs' `averages`) or from the scatter of "
        "the jobs' `repeats` where measured, s the model discrepancy, which follows the residuals; without either, values that are mostly "
        "noise by their neighbours are left out; none: all lines alike. With a given weight of the penalty always none.",
    )
    regularisation: Regularisation = Field(
        default="auto",
        description="For approach: paper, weight eta of the penalty on the values, eq. (29): a number, at least 0, in dB² per decade² "
        "(0.04 in the paper), or l-curve: chosen for each job at the corner of its L-curve. auto: from the noise of the residuals and "
        "`prior_std`.",
    )
    prior_std: PositiveOrAuto = Field(
        default="auto",
        description="Standard deviation in decades with which the unknowns are expected to differ from the prior, where its weight is not "
        "given. auto: 0.35, and 1 for the change of a joint (a bolt that owns its terms).",
    )
    method: Literal["gauss-newton", "bfgs"] = Field(
        default="gauss-newton",
        description="Optimiser of approach: paper: gauss-newton (bounded least squares, from coarse to fine profiles and from several "
        "starts) or bfgs (as in the paper, from one start). The L-curve and `lrbc calibrate` take gauss-newton in any case.",
    )
    max_iterations: int = Field(
        default=100,
        ge=1,
        description="Limit of iterations of each descent; a job whose last descent reaches it is `stopped`, its result usable.",
    )
    tolerance: Annotated[float, Field(gt=0, lt=1)] | None = Field(
        default=None,
        description="Stop rule. bfgs: when successive costs (log10 of the sum, eq. (29)) differ by less, "
        "1e-3 where absent, as in the paper; gauss-newton: when the sum itself twice decreases by a smaller fraction, 1e-4 where absent.",
    )
    evaluation: Literal["auto", "port", "reduced", "full"] = Field(
        default="auto",
        description="How FRFs are evaluated: port formula, reduced dynamic stiffness, or the full model without reduction; "
        "auto takes the cheaper of the first two.",
    )
    baselines: Annotated[tuple[Name, ...], AfterValidator(check_unique)] = Field(
        default=(),
        description="Further jobs with all bolts tight: the scatter of their changes sets the least change that counts as loose.",
    )
    loose_change: Annotated[float, Field(lt=0)] | None = Field(
        default=None,
        description="Change of log10 stiffness at a bolt against the reference job below which it is loose; absent: -0.5, and -0.35 for "
        "what a mixture says.",
    )
    confidence: Annotated[float, Field(gt=0.5, lt=1)] = Field(
        default=0.95, description="Probability that a verdict, loose or tight, needs; otherwise it is inconclusive."
    )
    largest_misfit: Positive = Field(
        default=3.0,
        description="Mean misfit in dB of the responses that are not used (of those used, where all are) above which the model does not "
        "explain the measurement: no verdict is given. Not given: 3 for the reference job, and 1.5 above that for the others.",
    )
    nuisances: NuisanceConfig = Field(default=NuisanceConfig(), description="What may drift between jobs, estimated with the unknowns.")


SEPARATORS = {"tab": "\t", "blank": " "}


def _separator(value: str) -> str:
    return SEPARATORS.get(value, value)


Column = Annotated[
    Annotated[str, Field(min_length=1), Tag("form:name")] | Annotated[int, Field(ge=1), Tag("form:number")],
    told_apart(str, "name", "number"),
]


class TextFormat(Strict):
    """Layout of a text file of FRFs; what is absent is recognised. Unit and quantity hold for files of any format."""

    delimiter: Annotated[Literal[",", ";", "\t", " ", "tab", "blank"], AfterValidator(_separator)] | None = Field(
        default=None, description="Column separator: ',', ';', tab or blank (any run of blanks); absent: recognised."
    )
    decimal: Literal[".", ","] | None = Field(default=None, description="Decimal sign; absent: recognised.")
    skip: int | None = Field(
        default=None, ge=0, description="Lines before the heading, or before the numbers where there is none; absent: recognised."
    )
    frequency: Column | None = Field(default=None, description="Name or number (from 1) of the column of frequencies; absent: recognised.")
    frequency_unit: Literal["Hz", "kHz", "rad/s"] | None = Field(default=None, description="Hz, kHz or rad/s; absent: from the heading.")
    representation: Literal["real-imag", "magnitude-phase", "db-phase"] | None = Field(
        default=None,
        description="What the two columns of a response hold; absent: recognised from the heading. Of HDF5 and MATLAB files: what the last "
        "dimension of a real array (lines, responses, 2) holds; absent: such arrays are no FRFs.",
    )
    phase: Literal["deg", "rad"] | None = Field(default=None, description="Unit of the phase; absent: recognised.")
    unit: str | None = Field(
        default=None, min_length=1, description="Unit of the FRFs, for instance Pa/N or g/N; it takes precedence over what the file says."
    )
    quantity: Quantity | None = Field(
        default=None, description="pressure, displacement, velocity or acceleration; it takes precedence over what the file says."
    )
    coherence: Column | None = Field(
        default=None,
        description="Variable of a MATLAB or HDF5 file that holds the coherence, or column (name, or number from 1) of a text file with "
        "one FRF; absent: coherence, coh and the like beside the FRFs.",
    )
    columns: Annotated[dict[str, tuple[Column, Column]], AfterValidator(FrozenDict)] = Field(
        default={},
        validate_default=True,
        description="Two columns (names, or numbers from 1) of each record, by its name; others are left out. Absent: recognised.",
    )

    @model_validator(mode="after")
    def _different_signs(self) -> TextFormat:
        if self.delimiter is not None and self.delimiter == self.decimal:
            raise problem("delimiter and decimal sign are the same", "delimiter", expected="two signs", found=f"'{self.delimiter}'")
        return self


class MeasuredFile(Strict):
    """A file with a layout of its own: ``{file:, format:}``."""

    file: FilePath = Field(description="The file, relative to the campaign file.")
    format: TextFormat = Field(
        default=TextFormat(), description="Layout of this file; a key that stands here holds in place of that of the job's `format`."
    )


def _file_form(value: object) -> str:
    return "form:own" if isinstance(value, Mapping | MeasuredFile) else "form:file"


def _files_form(value: object) -> str:
    return "form:list" if isinstance(value, list | tuple) else _file_form(value)


OneFile = Annotated[Annotated[FilePath, Tag("form:file")] | Annotated[MeasuredFile, Tag("form:own")], Discriminator(_file_form)]
#: One file or several, each with a layout of its own where it needs one.
Files = Annotated[
    Annotated[FilePath, Tag("form:file")]
    | Annotated[MeasuredFile, Tag("form:own")]
    | Annotated[tuple[OneFile, ...], Field(min_length=1), AfterValidator(check_unique), Tag("form:list")],
    Discriminator(_files_form),
]


def entries_of(value: Path | MeasuredFile | tuple[Path | MeasuredFile, ...] | None) -> tuple[Path | MeasuredFile, ...]:
    """The files as the campaign gives them: none, one or several."""
    return value if isinstance(value, tuple) else () if value is None else (value,)


def files_of(value: Path | MeasuredFile | tuple[Path | MeasuredFile, ...] | None) -> tuple[Path, ...]:
    """Paths of the files: none, one or several."""
    return tuple(entry.file if isinstance(entry, MeasuredFile) else entry for entry in entries_of(value))


#: Factors on measured FRFs: one for all, or by response.
Scale = Annotated[
    Annotated[float, Tag("form:number")] | Annotated[NameMap[float], Tag("form:names")], told_apart(Mapping, "names", "number")
]


class JobConfig(Strict):
    """One measurement to identify."""

    frf: Files = Field(
        description="File with the measured FRFs (UFF 58, CSV and other text, MATLAB, HDF5), recognised by its content; or a list of files "
        "on the same lines, for instance of one response or one hammer point each; {file:, format:} is one with a layout of its own."
    )
    removed: Annotated[tuple[str, ...], AfterValidator(check_unique)] = Field(
        default=(), description="Names of the bolts known to be removed; for the report only, the identification never sees them."
    )
    format: TextFormat | None = Field(
        default=None, description="Layout of text files, and unit and quantity of files of any format; absent: recognised."
    )
    records: NameMap[Record] = Field(
        default={},
        validate_default=True,
        description="What the files call a response, by response: a name, a number, {node:, direction:}, {file:} or {file:, number:}.",
    )
    scale: Scale = Field(
        default={},
        validate_default=True,
        description="Factor on the measured FRFs: one number for all responses, or by response, for instance of a recalibrated sensor.",
    )
    coherence: Files | None = Field(
        default=None, description="File with the coherence of these FRFs, or a list of files; absent: from the FRF files, if they have it."
    )

    averages: int = Field(
        default=5,
        ge=1,
        description="Averages behind each measured FRF (hammer blows, blocks), for the noise that its coherence tells; of one file.",
    )
    repeats: Annotated[tuple[Files, ...], AfterValidator(check_unique)] = Field(
        default=(),
        description="Further measurements of the same state on the same lines, each a file or a list of files; FRFs are averaged, their "
        "scatter tells the noise of the lines.",
    )

    @property
    def measurements(self) -> tuple[tuple[Path, ...], ...]:
        """Files of the measurement, then those of each repeat."""
        return (files_of(self.frf), *map(files_of, self.repeats))

    @property
    def entries(self) -> tuple[Path | MeasuredFile, ...]:
        """Every file as the campaign gives it: FRFs, repeats, coherence."""
        return tuple(entry for value in (self.frf, *self.repeats, self.coherence) for entry in entries_of(value))

    def format_of(self, file: Path, of_coherence: bool = False) -> TextFormat | None:
        """Layout of one of its files: the job's, with what the file's own says instead; of a file of coherence its own alone."""
        entries = entries_of(self.coherence) if of_coherence else self.entries
        own = next((entry.format for entry in entries if isinstance(entry, MeasuredFile) and entry.file == file), None)
        common = self.format
        if of_coherence and common is not None:
            common = TextFormat(coherence=common.coherence)
        elif common is not None and self.coherence is not None:
            # It names a variable of the coherence's own file.
            common = common.model_copy(update={"coherence": None})
        if own is None or common is None:
            return own or common
        return common.model_copy(update={key: getattr(own, key) for key in own.model_fields_set})

    @property
    def first(self) -> Path:
        """The file that a message on the whole measurement names."""
        return self.measurements[0][0]

    @property
    def all_files(self) -> tuple[Path, ...]:
        """Every file that is read for it."""
        return (*self.measurements[0], *files_of(self.coherence), *(file for files in self.measurements[1:] for file in files))

    @model_validator(mode="after")
    def _other_files(self) -> JobConfig:
        first, *further = self.measurements
        for index, files in enumerate(further):
            if set(files) & {*first, *(file for other in further[:index] for file in other)}:
                raise problem(
                    "a measurement as its own repeat",
                    *("repeats", index),
                    expected="further files",
                    hint="remove it: repeats are added to frf",
                )
        return self

    @model_validator(mode="after")
    def _nonzero(self) -> JobConfig:
        for name, factor in self.scale.items() if isinstance(self.scale, Mapping) else [(None, self.scale)]:
            if factor == 0:
                keys = ("scale",) if name is None else ("scale", name)
                raise problem("a factor of zero", *keys, expected="a number other than 0")
        return self

    def factor(self, response: str) -> float:
        """On the measured FRF of a response."""
        return self.scale.get(response, 1.0) if isinstance(self.scale, Mapping) else self.scale
