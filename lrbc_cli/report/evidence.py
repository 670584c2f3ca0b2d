"""What a result says about how far it can be trusted: correlation with the measurement, validity, nuisances, noise."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from lrbc_cli.errors import DataError
from lrbc_cli.report.reading import HINT, FloatArray, Node, mapping_of, read_table


@dataclass(frozen=True)
class Peak:
    """A measured peak and the same resonance of the model before and after [Hz]; NaN where the model has none."""

    measured: float
    initial: float
    final: float


@dataclass(frozen=True)
class ResponseCorrelation:
    """FRAC before and after of one response, and its peaks."""

    frac_initial: float
    frac_final: float
    peaks: tuple[Peak, ...]


@dataclass(frozen=True)
class Correlation:
    """How well the FRFs agree before and after; means are over the responses used, shifts over peaks matched both times [%]."""

    frac_initial: float
    frac_final: float
    shift_initial: float
    shift_final: float
    peaks: tuple[Peak, ...]
    responses: Mapping[str, ResponseCorrelation]


@dataclass(frozen=True)
class Fdac:
    """FDAC maps before and after: (g, g), rows are measured lines, columns lines of the model; NaN where unknown."""

    frequency_hz: FloatArray
    initial: FloatArray
    updated: FloatArray


@dataclass(frozen=True)
class Validity:
    """Whether the model explains the measurement.

    ``passed`` is None where there are no validation channels and nothing speaks against the model; ``held_out_db`` is the misfit of the
    validation channels, ``limit_db`` the most that it may be [dB], where known.
    """

    passed: bool | None
    held_out_db: float | None
    limit_db: float | None
    reason: str


@dataclass(frozen=True)
class Nuisance:
    """A value that was estimated beside the parameters, of a response or direction where ``of`` says so."""

    name: str
    of: str
    value: float
    std: float | None


@dataclass(frozen=True)
class Noise:
    """What the confidence rests on: scatter of the residuals [dB], and how many lines are worth one."""

    sigma_db: float | None
    correlation_factor: float | None


def read_correlation(result: Node) -> Correlation | None:
    """Read the key ``correlation`` of a result; None where it is absent."""
    if not result.has("correlation"):
        return None
    node = result.node("correlation")
    return Correlation(
        _number(node, "frac_initial"),
        _number(node, "frac_final"),
        _number(node, "peak_shift_percent_initial"),
        _number(node, "peak_shift_percent_final"),
        _peaks(node.maybe_node("mean_spectrum")),
        {
            name: ResponseCorrelation(_number(entry, "frac_initial"), _number(entry, "frac_final"), _peaks(entry))
            for name, entry in node.maybe_node("responses").items()
        },
    )


def _peaks(node: Node) -> tuple[Peak, ...]:
    return tuple(Peak(entry.number("measured_hz"), entry.number("initial_hz"), entry.number("final_hz")) for entry in node.nodes("peaks"))


def _number(node: Node, key: str) -> float:
    value = node.maybe_number(key)
    return math.nan if value is None else value


def read_validity(result: Node) -> Validity | None:
    """Read the key ``validity`` of a result; None where it is absent."""
    if not result.has("validity"):
        return None
    node = result.node("validity")
    passed, held_out = node.maybe_flag("passed"), node.maybe_number("held_out_db")
    responses = result.maybe_node("misfit_db").maybe_node("responses")
    if not node.has("compared") and all(entry.maybe_flag("used") is not False for _, entry in responses.items()):
        # An earlier version passed a job by the misfit of the channels that it had fitted.
        passed, held_out = None if passed else passed, None
    return Validity(passed, held_out, node.maybe_number("limit_db"), node.maybe_text("reason") or "")


def read_noise(result: Node) -> Noise | None:
    """Read the key ``noise`` of a result; None where it is absent."""
    if not result.has("noise"):
        return None
    node = result.node("noise")
    return Noise(node.maybe_number("sigma_db"), node.maybe_number("correlation_factor"))


def read_nuisances(result: Node) -> tuple[Nuisance, ...]:
    """Read the key ``nuisances`` of a result: values, or objects with ``value`` and ``std``, or one such a response or direction."""
    node = result.maybe_node("nuisances")
    found: list[Nuisance] = []
    for key in mapping_of(result.raw("nuisances")):
        found += _nuisances(node, key, key, "")
    return tuple(found)


def _nuisances(node: Node, key: str, name: str, of: str) -> Iterator[Nuisance]:
    value = node.raw(key)
    if value is None:
        return
    if not isinstance(value, dict):
        yield Nuisance(name, of, node.number(key), None)
    elif "value" in value:
        entry = node.node(key)
        yield Nuisance(name, of, entry.number("value"), entry.maybe_number("std"))
    elif of:
        raise node.wrong(key, "a number, or an object with value and std", value)
    else:
        for part in value:
            yield from _nuisances(node.node(key), part, name, part)


def read_fdac(output: Path, job: str) -> Fdac | None:
    """Read ``NAME/fdac.csv``; None where there is none or nothing in it.

    Raises
    ------
    DataError
        Where it is damaged.
    """
    file = output / job / "fdac.csv"
    if not file.exists():
        return None
    table = read_table(file)
    columns = ("measured_hz", "model_hz", "initial", "updated")
    measured, model, initial, updated = (table.get(name, np.empty(0)) for name in columns)
    frequency = np.unique(measured)
    size = len(frequency)
    whole = set(columns) <= set(table) and len(measured) == size**2
    if not whole or not np.array_equal(measured, np.repeat(frequency, size)) or not np.array_equal(model, np.tile(frequency, size)):
        raise DataError(
            "this result file is damaged",
            file=file,
            expected=f"columns {', '.join(columns)} with every pair of lines",
            found=f"{len(measured)} rows of {', '.join(table)}"[:100],
            hint=HINT,
        )
    if size < 2 or not np.isfinite(initial).any():
        return None
    return Fdac(frequency, initial.reshape(size, size), updated.reshape(size, size))
