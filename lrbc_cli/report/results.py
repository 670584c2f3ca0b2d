"""What the report shows, as typed values: campaign, reduced model, jobs and their FRFs, read from the files under ``output/``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from lrbc_cli.errors import DataError
from lrbc_cli.report.evidence import Correlation, Noise, Nuisance, Validity, read_correlation, read_noise, read_nuisances, read_validity
from lrbc_cli.report.reading import HINT, FloatArray, Node, mapping_of, numbers_of, read_document, read_table
from lrbc_cli.updating.clearance import BoltFinding as JobBolt
from lrbc_cli.updating.clearance import JobFinding

STATUSES = ("converged", "stopped", "unexplained", "failed")
VERDICTS = ("tight", "loose", "undecided", "outside")


@dataclass(frozen=True)
class Response:
    """A response of the campaign; ``unit`` is that of the FRF, ``used`` tells whether the updating sees it."""

    name: str
    quantity: str
    unit: str
    used: bool


@dataclass(frozen=True)
class Campaign:
    """The campaign's own file: names, order and places; the key of the calibration its jobs rest on, empty for none, None where unknown."""

    name: str
    reference: str | None
    jobs: tuple[str, ...]
    bolts: tuple[str, ...]
    responses: tuple[Response, ...]
    tool: str
    calibration: str | None = None

    def response(self, name: str) -> Response:
        """Return a response by name; one that the campaign does not list is unknown and unused."""
        return next((entry for entry in self.responses if entry.name == name), Response(name, "response", "1/N", False))


@dataclass(frozen=True)
class Group:
    """The identified values of one parameter group.

    Attributes
    ----------
    log10, effective, initial : (n,) float arrays
        Decadic logarithms of the parameters, of the smoothed terms, and of the start values.
    reference, lower, upper : (n,) float array or None
        The tight state; the confidence band of ``effective``, NaN where it is open to that side.
    positions : (n, 3) float array or None
        In metres.
    arc_length : (n,) float array or None
        In metres, along the ordered terms.
    """

    name: str
    kind: str
    unit: str
    log10: FloatArray
    effective: FloatArray
    initial: FloatArray
    reference: FloatArray | None
    lower: FloatArray | None
    upper: FloatArray | None
    positions: FloatArray | None
    arc_length: FloatArray | None
    damping_exponent: float | None
    damping_factor: float | None


@dataclass(frozen=True)
class BoltVerdict:
    """What was found at one bolt; ``removed`` is what is known about it, None where nothing is.

    ``change`` and its ``change_std`` are in decades, and so is the ``threshold`` at which a bolt counts as loose. A bolt outside, which no
    term reaches, has none of these numbers.
    """

    name: str
    position: FloatArray
    log10_stiffness: float | None
    change: float | None
    verdict: str
    removed: bool | None
    note: str | None
    probability_loose: float | None
    change_std: float | None = None
    threshold: float | None = None
    probability_changed: float | None = None

    @property
    def outside(self) -> bool:
        """Whether no term reaches it, so that the FRFs say nothing of it."""
        return self.verdict == "outside"


@dataclass(frozen=True)
class Change:
    """A figure before and after updating; ``used`` tells whether the response took part."""

    initial: float
    final: float
    used: bool = True


@dataclass(frozen=True)
class Evaluation:
    """One entry of the optimiser's history."""

    number: float
    cost: float
    misfit_db: float
    accepted: bool


@dataclass(frozen=True)
class LCurve:
    """Sums of squares of data and departures for each weight tried; ``corner`` holds both at the corner, None where there is none."""

    eta: FloatArray
    data: FloatArray
    penalty: FloatArray
    corner: tuple[float, float] | None
    chosen: float


@dataclass(frozen=True)
class JobResult:
    """One job: its outcome, or the reason why there is none (``complete`` tells)."""

    job: str
    status: str
    reason: str
    removed: tuple[str, ...] | None
    groups: tuple[Group, ...]
    cost: Change | None
    misfit: Change | None
    responses: Mapping[str, Change]
    bolts: tuple[BoltVerdict, ...]
    iterations: float | None
    evaluations: float | None
    line_evaluations: float | None
    history: tuple[Evaluation, ...]
    lines_hz: FloatArray
    optimiser: str
    seconds: Mapping[str, float]
    provenance: Mapping[str, Any]
    notes: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    validity: Validity | None = None
    nuisances: tuple[Nuisance, ...] = ()
    noise: Noise | None = None
    correlation: Correlation | None = None
    l_curve: LCurve | None = None
    starts: int = 0
    assumed: str | None = None
    doubtful: tuple[str, ...] = ()

    @property
    def validated(self) -> bool:
        """Whether nothing says that the verdicts lack a validation."""
        return not self.explained or self.validity is None or self.validity.passed is not None

    @property
    def observable(self) -> list[BoltVerdict]:
        """The bolts that a term reaches."""
        return [bolt for bolt in self.bolts if not bolt.outside]

    @property
    def finding(self) -> JobFinding:
        """What it says of the bolts."""
        return JobFinding(
            self.status,
            tuple(JobBolt(bolt.name, bolt.verdict, bolt.probability_loose) for bolt in self.bolts),
            self.validity is not None and self.validity.passed is True,
            self.assumed,
            self.doubtful,
        )

    @property
    def explained(self) -> bool:
        """Whether the model explains the measurement, so that there are verdicts."""
        return self.complete and self.status != "unexplained"

    @property
    def complete(self) -> bool:
        """Whether there are identified values to show."""
        return self.status != "failed"

    def names(self, verdict: str) -> list[str]:
        """Return the names of the bolts with this verdict."""
        return [bolt.name for bolt in self.bolts if bolt.verdict == verdict]

    def damping(self) -> list[Group]:
        """Return the groups with an identified damping exponent."""
        return [group for group in self.groups if group.damping_exponent is not None]


@dataclass(frozen=True)
class Frf:
    """The FRFs of one job: magnitudes in dB, phases in degrees, NaN where absent.

    Attributes
    ----------
    frequency_hz : (F,) float array
    responses : mapping of response name to mapping of column to (F,) float array
        Columns ``measured_db``, ``measured_phase_deg``, ``initial_db``, ..., ``coherence``.
    """

    frequency_hz: FloatArray
    responses: Mapping[str, Mapping[str, FloatArray]]


FRF_COLUMNS = (*(f"{state}_{part}" for state in ("measured", "initial", "updated") for part in ("db", "phase_deg")), "coherence")


def read_campaign(output: Path) -> Campaign:
    """Read ``campaign.json``.

    Raises
    ------
    DataError
        Where it is missing or damaged, or a job's name cannot be a folder's.
    """
    file = output / "campaign.json"
    if not file.is_file():
        raise DataError("there are no results here", file=file, hint="run `lrbc update` first; the report only shows what it wrote")
    node = read_document(file, "lrbc-campaign")
    jobs = node.texts("jobs")
    for job in jobs:
        if not job.strip() or job in {".", ".."} or any(mark in job for mark in '/\\:\0\n\r\t"<>|?*'):
            raise DataError("a job's name is no folder's name", file=file, place="jobs", found=repr(job)[:80], hint=HINT)
    if len(set(jobs)) != len(jobs):
        raise DataError("a job is listed twice", file=file, place="jobs", hint=HINT)
    tool = node.maybe_node("tool")
    return Campaign(
        name=node.text("campaign"),
        reference=node.maybe_text("reference"),
        jobs=jobs,
        bolts=tuple(bolt.text("name") for bolt in node.nodes("bolts")),
        responses=tuple(
            Response(entry.text("name"), entry.maybe_text("quantity") or "response", entry.maybe_text("unit") or "1/N", entry.flag("used"))
            for entry in node.nodes("responses")
        ),
        calibration=node.maybe_text("calibration"),
        tool=" ".join(filter(None, (tool.maybe_text("name"), tool.maybe_text("version")))),
    )


def read_job(output: Path, job: str) -> JobResult:
    """Read ``NAME/result.json``.

    Raises
    ------
    DataError
        Where it is missing or damaged.
    """
    node = read_document(output / job / "result.json", "lrbc-result")
    # The name becomes part of paths: it has to be the folder's, which was checked.
    node.choice("job", (job,))
    status = node.choice("status", STATUSES)
    done = status != "failed"
    misfit = node.node("misfit_db") if done else node.maybe_node("misfit_db")
    parameters = node.node("parameters") if done else node.maybe_node("parameters")
    lines = node.maybe_node("lines").maybe_array("frequency_hz")
    return JobResult(
        job=job,
        status=status,
        reason=node.maybe_text("reason") or "",
        removed=node.texts("removed") if node.has("removed") else None,
        groups=tuple(_group(name, entry) for name, entry in parameters.items()) if done else (),
        cost=_change(node.node("cost")) if done else None,
        misfit=_change(misfit) if done else None,
        responses={name: _change(entry) for name, entry in misfit.maybe_node("responses").items()},
        bolts=tuple(_bolt(entry) for entry in node.nodes("bolts")),
        iterations=node.maybe_number("iterations"),
        evaluations=node.maybe_number("evaluations"),
        line_evaluations=node.maybe_number("line_evaluations"),
        history=tuple(
            Evaluation(
                entry.number("evaluation"),
                entry.number("cost"),
                _or_nan(entry.maybe_number("misfit_db")),
                entry.maybe_flag("accepted") is not False,
            )
            for entry in node.nodes("history")
        ),
        lines_hz=np.empty(0) if lines is None else lines,
        optimiser=node.maybe_node("optimiser").maybe_text("method") or "",
        seconds=numbers_of(node.raw("seconds")),
        provenance=mapping_of(node.raw("provenance")),
        notes=node.texts("notes") if node.has("notes") else (),
        warnings=node.texts("warnings") if node.has("warnings") else (),
        validity=read_validity(node),
        nuisances=read_nuisances(node),
        noise=read_noise(node),
        correlation=read_correlation(node),
        l_curve=_l_curve(node.node("l_curve")) if node.has("l_curve") else None,
        starts=sum(1 for _ in node.maybe_node("optimiser").nodes("starts")),
        assumed=node.maybe_node("taken_as_tight").maybe_text("as"),
        doubtful=node.node("taken_as_tight").texts("doubtful") if node.has("taken_as_tight") else (),
    )


def _l_curve(node: Node) -> LCurve:
    eta = node.array("eta")
    at = node.node("at") if node.has("at") else None
    corner = None if at is None else (at.number("data"), at.number("penalty"))
    return LCurve(eta, node.array("data", size=len(eta)), node.array("penalty", size=len(eta)), corner, node.number("chosen"))


def _group(name: str, node: Node) -> Group:
    log10 = node.array("log10")
    size = len(log10)
    effective = node.maybe_array("log10_effective", size=size)
    return Group(
        name=name,
        kind=node.maybe_text("kind") or "stiffness",
        unit=node.maybe_text("unit") or "",
        log10=log10,
        effective=log10 if effective is None else effective,
        initial=node.array("initial", size=size),
        reference=node.maybe_array("reference_log10_effective", size=size),
        lower=node.maybe_array("lower95", size=size),
        upper=node.maybe_array("upper95", size=size),
        positions=node.maybe_array("positions", size=size, width=3),
        arc_length=node.maybe_array("arc_length", size=size),
        damping_exponent=node.maybe_number("damping_exponent"),
        damping_factor=node.maybe_number("damping_factor"),
    )


def _bolt(node: Node) -> BoltVerdict:
    return BoltVerdict(
        name=node.text("name"),
        position=node.array("position", size=3),
        log10_stiffness=node.maybe_number("log10_stiffness"),
        change=node.maybe_number("change"),
        verdict=node.choice("verdict", VERDICTS),
        removed=node.maybe_flag("removed"),
        note=node.maybe_text("note"),
        probability_loose=_share(node, "probability_loose"),
        change_std=node.maybe_number("change_std"),
        threshold=node.maybe_number("threshold"),
        probability_changed=_share(node, "probability_changed"),
    )


def _share(node: Node, key: str) -> float | None:
    value = node.maybe_number(key)
    if value is not None and not 0.0 <= value <= 1.0:
        raise node.wrong(key, "a number from 0 to 1", value)
    return value


def _change(node: Node) -> Change:
    used = node.maybe_flag("used")
    return Change(node.number("initial"), node.number("final"), True if used is None else used)


def _or_nan(value: float | None) -> float:
    return float("nan") if value is None else value


def read_frf(output: Path, job: str) -> Frf:
    """Read ``NAME/frf.csv``.

    Raises
    ------
    DataError
        Where it is missing or damaged.
    """
    return read_frf_table(output / job / "frf.csv")


def read_frf_table(file: Path) -> Frf:
    """Read a table of measured, initial and updated FRFs.

    Raises
    ------
    DataError
        Where it is missing or damaged.
    """
    table = read_table(file)
    frequency = table.pop("frequency_hz", None)
    if frequency is None or not len(frequency):
        raise DataError("this result file is damaged", file=file, expected="a column frequency_hz with at least one line", hint=HINT)
    responses: dict[str, dict[str, FloatArray]] = {}
    for column, values in table.items():
        for suffix in FRF_COLUMNS:
            if column.endswith("_" + suffix):
                responses.setdefault(column[: -len(suffix) - 1], {})[suffix] = values
                break
    return Frf(frequency, responses)
