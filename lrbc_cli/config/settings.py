"""Models of the sections ``reduction``, ``update`` and ``jobs``, and of the layout of measurement files."""

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
            "the band does not begin above 0 Hz",
            expected="a lower end above 0 Hz",
            found=f"{value[0]:g}",
            hint="begin at the first usable line, for instance 1.0",
        )
    return value


class ReductionConfig(Strict):
    """The reduced model: its frequency band and its accuracy."""

    band: Annotated[Range, AfterValidator(_check_band)] = Field(description="Frequency band [lower, upper] in Hz.")
    tolerance: float = Field(
        default=1e-3,
        gt=0,
        lt=1,
        description="Largest measured error of the responses, relative to the norm of each line over the responses of one quantity.",
    )
    backend: Literal["auto", "superlu", "pardiso"] = Field(
        default="auto", description="Sparse solver. auto: the accelerated one if it is installed. Does not change results."
    )
    max_size: int | None = Field(
        default=None, ge=1, description="Largest order of the reduced model. If omitted: as large as the tolerance needs."
    )
    held_out: int = Field(
        default=5, ge=5, le=1000, description="Number of lines that are not used for the basis and at which the error is measured."
    )
    memory_limit: float | None = Field(
        default=None,
        gt=0,
        description="Memory in GB that a reduction may use; the need is predicted before it begins. If omitted: the available memory.",
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
    """What may have drifted between the reference job and another, each with its standard deviation. If omitted: held constant."""

    temperature: Positive | None = Field(
        default=None, description="Standard deviation of the air temperature in K. The speed of sound follows its square root."
    )
    room: Annotated[float, Field(gt=-273.15)] = Field(
        default=20.0, description="Temperature of the reference job in degrees Celsius, about which `temperature` varies."
    )
    sound_speed: Annotated[float, Field(gt=0, lt=0.2)] | None = Field(
        default=None, description="Relative standard deviation of the speed of sound, instead of `temperature`."
    )
    gain: Positive | None = Field(default=None, description="Standard deviation of the gain of each response in dB.")
    hammer: Annotated[float, Field(gt=0, lt=0.1)] | None = Field(
        default=None, description="Standard deviation of the hammer point, along the surface, in metres."
    )

    @property
    def given(self) -> tuple[str, ...]:
        """Keys of the standard deviations that are given: those of the values that are None by default."""
        return tuple(key for key, value in self if value is not None and type(self).model_fields[key].default is None)

    @model_validator(mode="after")
    def _one_speed(self) -> NuisanceConfig:
        if self.temperature is not None and self.sound_speed is not None:
            raise problem(
                "temperature and sound_speed are the same effect", "sound_speed", expected="temperature or sound_speed", found="both"
            )
        return self


class UpdateConfig(Strict):
    """The identification: what is compared, at which lines, and how the optimum is found."""

    reference: Name | None = Field(
        default=None, description="The job measured with all bolts tight, for verdicts. If omitted: no comparison."
    )
    reference_guessed: bool = Field(
        default=False,
        description="true: `lrbc init --from` guessed the reference job from names, and nobody has confirmed it. Commands and report page "
        "say so. Remove the key once all bolts are known to be tight in that job. Does not change results.",
    )
    responses: Annotated[tuple[Name, ...], Field(min_length=1), AfterValidator(check_unique)] | None = Field(
        default=None, description="Names of the responses to fit. If omitted: all. The others are validation channels."
    )
    lines: Lines = Field(
        default="resonances",
        description="Lines to fit: resonances (of the measurement, without lines that follow from their neighbours), all, {every: n} or "
        "{list: [Hz, ...]}.",
    )
    approach: Literal["bolts", "paper"] | None = Field(
        default=None,
        description="bolts: one change per bolt against the reference job, each bolt tight or loose. paper: all values along the edge, "
        "drawn to their start values, as published. If omitted: bolts if there is a reference job, unless a weight or bfgs is given. Keys "
        "of the other approach are not used; `lrbc check` reports them.",
    )
    residual: Literal["db", "log-complex"] = Field(
        default="db",
        description="Residual of a line: db, the difference of the magnitudes in dB, as in the paper; log-complex, also the difference of "
        "the phases (8.69 dB per radian).",
    )
    loss: Literal["squares", "soft"] = Field(
        default="squares",
        description="squares, or soft (pseudo-Huber): differences well above `loss_scale` count linearly, not squared.",
    )
    loss_scale: Positive = Field(default=3.0, description="Difference in dB above which the soft loss becomes linear.")
    floor: Positive | None = Field(
        default=None,
        description="Level in dB below the largest selected line of a response. Differences below this level count less, so that "
        "antiresonances do not dominate. If omitted: none.",
    )
    weights: Literal["auto", "none"] = Field(
        default="auto",
        description="auto: weights of the lines 1/sqrt(1 + (sigma/s)²), with sigma from the coherence (and the `averages` of the job) or "
        "from the scatter of its `repeats`, if measured, and s the model discrepancy, which follows the residuals. Without either, values "
        "that are mostly noise, judged by their neighbours, are left out. none: all lines count equally. Always none if a weight of the "
        "penalty is given.",
    )
    regularisation: Regularisation = Field(
        default="auto",
        description="For approach: paper. Weight eta of the penalty on the values, eq. (29): a number, at least 0, in dB² per decade² "
        "(0.04 in the paper), or l-curve: chosen for each job at the corner of its L-curve; auto: from the noise of the residuals and "
        "`prior_std`.",
    )
    prior_std: PositiveOrAuto = Field(
        default="auto",
        description="Standard deviation, in decades, by which the unknowns are expected to differ from the prior; used if no weight of the "
        "prior is given. auto: 0.35, and 1 for the change of a joint (a bolt that owns its terms). It is the prior of the fit; that of "
        "tight and loose bolts, on which verdicts rest, stays as it is (`lrbc guide statistics`, section 6).",
    )
    method: Literal["gauss-newton", "bfgs"] = Field(
        default="gauss-newton",
        description="Optimiser, for approach: paper. gauss-newton: bounded least squares, from coarse to fine profiles and from several "
        "starts. bfgs: as in the paper, from one start. The L-curve and `lrbc calibrate` always use gauss-newton.",
    )
    max_iterations: int = Field(
        default=100,
        ge=1,
        description="Largest number of iterations of each descent. A job whose last descent reaches it is `stopped`; its result is usable.",
    )
    tolerance: Annotated[float, Field(gt=0, lt=1)] | None = Field(
        default=None,
        description="Stopping criterion. bfgs stops when successive costs (log10 of the sum, eq. (29)) differ by less; if omitted: 1e-3, "
        "as in the paper. gauss-newton stops when the sum itself decreases twice by a smaller fraction; if omitted: 1e-4.",
    )
    evaluation: Literal["auto", "port", "reduced", "full"] = Field(
        default="auto",
        description="How FRFs are computed: port (port formula), reduced (reduced dynamic stiffness) or full (full model, no reduction). "
        "auto: the cheaper of the first two.",
    )
    baselines: Annotated[tuple[Name, ...], AfterValidator(check_unique)] = Field(
        default=(),
        description="Further jobs with all bolts tight. The scatter of their changes sets the smallest change that counts as loose.",
    )
    loose_change: Annotated[float, Field(lt=0)] | None = Field(
        default=None,
        description="A bolt is loose if its change of log10 stiffness against the reference job is below this value. If omitted: -0.35 "
        "where each bolt is a mixture of tight and loose (approach: bolts), else -0.5.",
    )
    confidence: Annotated[float, Field(gt=0.5, lt=1)] = Field(
        default=0.95, description="Probability that the verdict loose or tight requires; otherwise the bolt is inconclusive."
    )
    largest_misfit: Positive = Field(
        default=3.0,
        description="Largest mean misfit in dB of the validation channels (of the responses used, if all are used). Above it the model "
        "does not explain the measurement and no verdict is given. If omitted: 3 for the reference job, and 1.5 above its misfit for the "
        "others.",
    )
    nuisances: NuisanceConfig = Field(
        default=NuisanceConfig(), description="What may drift between jobs (nuisance parameters), estimated with the unknowns."
    )


SEPARATORS = {"tab": "\t", "blank": " "}


def _separator(value: str) -> str:
    return SEPARATORS.get(value, value)


Column = Annotated[
    Annotated[str, Field(min_length=1), Tag("form:name")] | Annotated[int, Field(ge=1), Tag("form:number")],
    told_apart(str, "name", "number"),
]


class TextFormat(Strict):
    """Layout of a text file of FRFs. What is omitted is recognised. Unit and quantity apply to files of any format."""

    delimiter: Annotated[Literal[",", ";", "\t", " ", "tab", "blank"], AfterValidator(_separator)] | None = Field(
        default=None, description="Column separator: ',', ';', tab or blank (any run of blanks). If omitted: recognised."
    )
    decimal: Literal[".", ","] | None = Field(default=None, description="Decimal sign. If omitted: recognised.")
    skip: int | None = Field(
        default=None, ge=0, description="Lines before the heading, or before the numbers if there is none. If omitted: recognised."
    )
    frequency: Column | None = Field(default=None, description="Name or number (from 1) of the frequency column. If omitted: recognised.")
    frequency_unit: Literal["Hz", "kHz", "rad/s"] | None = Field(
        default=None, description="Hz, kHz or rad/s. If omitted: from the heading."
    )
    representation: Literal["real-imag", "magnitude-phase", "db-phase"] | None = Field(
        default=None,
        description="What the two columns of a response contain. If omitted: recognised from the heading. HDF5, MATLAB, .npz files: what "
        "the last dimension of a real array (lines, responses, 2) contains. If omitted: such arrays are not read as FRFs.",
    )
    phase: Literal["deg", "rad"] | None = Field(default=None, description="Unit of the phase. If omitted: recognised.")
    unit: str | None = Field(
        default=None, min_length=1, description="Unit of the FRFs, for instance Pa/N or g/N. It takes precedence over the file."
    )
    quantity: Quantity | None = Field(
        default=None, description="pressure, displacement, velocity or acceleration. It takes precedence over the file."
    )
    coherence: Column | None = Field(
        default=None,
        description="Variable of a MATLAB, HDF5 or .npz file that contains the coherence, or column (name, or number from 1) of a text "
        "file with one FRF. If omitted: variables called coherence, coh and similar beside the FRFs.",
    )
    columns: Annotated[dict[str, tuple[Column, Column]], AfterValidator(FrozenDict)] = Field(
        default={},
        validate_default=True,
        description="Two columns (names, or numbers from 1) of each record, by its name; others are left out. If omitted: recognised.",
    )

    @model_validator(mode="after")
    def _different_signs(self) -> TextFormat:
        if self.delimiter is not None and self.delimiter == self.decimal:
            raise problem("delimiter and decimal sign are the same", "delimiter", expected="two signs", found=f"'{self.delimiter}'")
        return self


class MeasuredFile(Strict):
    """A file with its own layout: ``{file:, format:}``."""

    file: FilePath = Field(description="The file, relative to the campaign file.")
    format: TextFormat = Field(
        default=TextFormat(), description="Layout of this file. A key given here replaces that key of the job's `format`."
    )


def _file_form(value: object) -> str:
    return "form:own" if isinstance(value, Mapping | MeasuredFile) else "form:file"


def _files_form(value: object) -> str:
    return "form:list" if isinstance(value, list | tuple) else _file_form(value)


OneFile = Annotated[Annotated[FilePath, Tag("form:file")] | Annotated[MeasuredFile, Tag("form:own")], Discriminator(_file_form)]
#: One file or several, each optionally with a layout of its own.
Files = Annotated[
    Annotated[FilePath, Tag("form:file")]
    | Annotated[MeasuredFile, Tag("form:own")]
    | Annotated[tuple[OneFile, ...], Field(min_length=1), AfterValidator(check_unique), Tag("form:list")],
    Discriminator(_files_form),
]


def entries_of(value: Path | MeasuredFile | tuple[Path | MeasuredFile, ...] | None) -> tuple[Path | MeasuredFile, ...]:
    """Entries of the campaign for files: none, one or several."""
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
        description="File with the measured FRFs (UFF 58, CSV and other text, MATLAB, HDF5, NumPy .npz), recognised by content; or a list "
        "of files with the same lines, for instance one for each response or hammer point. {file:, format:} is a file with its own layout."
    )
    removed: Annotated[tuple[str, ...], AfterValidator(check_unique)] = Field(
        default=(),
        description="Names of the bolts known to be removed. For the report and `lrbc check` only; the identification does not use them.",
    )
    format: TextFormat | None = Field(
        default=None, description="Layout of text files, and unit and quantity of files of any format. If omitted: recognised."
    )
    records: NameMap[Record] = Field(
        default={},
        validate_default=True,
        description="Record of each response in the files, by response: a name, a number, {node:, direction:}, {file:} or {file:, "
        "number:}.",
    )
    scale: Scale = Field(
        default={},
        validate_default=True,
        description="Factor on the measured FRFs: one number for all responses, or by response, for instance for a recalibrated sensor.",
    )
    coherence: Files | None = Field(
        default=None,
        description="File with the coherence of these FRFs, or a list of files. If omitted: from the FRF files, if they contain it.",
    )

    averages: int = Field(
        default=5,
        ge=1,
        description="Number of averages of each measured FRF (hammer blows, blocks) of one file. With the coherence it gives the noise.",
    )
    repeats: Annotated[tuple[Files, ...], AfterValidator(check_unique)] = Field(
        default=(),
        description="Further measurements of the same state with the same lines, each a file or a list of files. FRFs are averaged; their "
        "scatter gives the noise of the lines.",
    )

    @property
    def measurements(self) -> tuple[tuple[Path, ...], ...]:
        """Files of the measurement, then those of each repeat."""
        return (files_of(self.frf), *map(files_of, self.repeats))

    @property
    def entries(self) -> tuple[Path | MeasuredFile, ...]:
        """Entries of all files of the job: FRFs, repeats, coherence."""
        return tuple(entry for value in (self.frf, *self.repeats, self.coherence) for entry in entries_of(value))

    def format_of(self, file: Path, of_coherence: bool = False) -> TextFormat | None:
        """Layout of a file: that of the job, overridden by the file's own; a coherence file takes only ``coherence`` from the job."""
        entries = entries_of(self.coherence) if of_coherence else self.entries
        own = next((entry.format for entry in entries if isinstance(entry, MeasuredFile) and entry.file == file), None)
        common = self.format
        if of_coherence and common is not None:
            common = TextFormat(coherence=common.coherence)
        elif common is not None and self.coherence is not None:
            # The key names a variable of the separate coherence file.
            common = common.model_copy(update={"coherence": None})
        if own is None or common is None:
            return own or common
        return common.model_copy(update={key: getattr(own, key) for key in own.model_fields_set})

    @property
    def first(self) -> Path:
        """First file of the measurement, which messages on the whole measurement name."""
        return self.measurements[0][0]

    @property
    def all_files(self) -> tuple[Path, ...]:
        """Paths of all files that are read for the job."""
        return (*self.measurements[0], *files_of(self.coherence), *(file for files in self.measurements[1:] for file in files))

    @model_validator(mode="after")
    def _other_files(self) -> JobConfig:
        first, *further = self.measurements
        for index, files in enumerate(further):
            if set(files) & {*first, *(file for other in further[:index] for file in other)}:
                raise problem(
                    "the repeat uses a file that this job already contains",
                    *("repeats", index),
                    expected="further files",
                    hint="remove it: repeats are measurements in addition to frf",
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
        """Factor on the measured FRF of a response."""
        return self.scale.get(response, 1.0) if isinstance(self.scale, Mapping) else self.scale
