"""The reduced model as ``reduction.json`` tells of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lrbc_cli.report.reading import FloatArray, Node, mapping_of, numbers_of, read_document


@dataclass(frozen=True)
class HeldOut:
    """Measured error of the reduced model at one line outside its basis, per kind of parameter vector."""

    frequency_hz: float
    errors: Mapping[str, float]


@dataclass(frozen=True)
class Step:
    """One step of the adaptive reduction: the estimated error over the band, and what was then measured."""

    number: int
    size: float
    factorised_hz: float | None
    measured_error: float | None
    frequency_hz: FloatArray
    estimate: FloatArray


@dataclass(frozen=True)
class Reduction:
    """The reduced model: sizes, certificate, costs, machine."""

    size: float
    full_size: float
    terms: float | None
    band_hz: FloatArray
    tolerance: float
    reached: bool
    backend: str
    points: tuple[tuple[float, float | None, float | None], ...]
    held_out: tuple[HeldOut, ...]
    worst: float | None
    vectors: float | None
    unseen: tuple[float, float, float] | None
    steps: tuple[Step, ...]
    seconds: Mapping[str, float]
    machine: Mapping[str, Any]
    date: str
    cache: Mapping[str, Any]
    versions: Mapping[str, Any]


def read_reduction(output: Path) -> Reduction | None:
    """Read ``reduction.json``; None where there is none (the report then does without).

    Raises
    ------
    DataError
        Where it is damaged.
    """
    file = output / "reduction.json"
    if not file.exists():
        return None
    node = read_document(file, "lrbc-reduction")
    certificate = node.maybe_node("certificate")
    return Reduction(
        size=node.number("size"),
        full_size=node.number("full_size"),
        terms=node.maybe_number("terms"),
        band_hz=node.array("band_hz", size=2),
        tolerance=node.number("tolerance"),
        reached=node.flag("reached"),
        backend=node.maybe_text("backend") or "",
        points=tuple(
            (point.number("frequency_hz"), point.maybe_number("order"), point.maybe_number("added"))
            for point in node.nodes("expansion_points")
        ),
        held_out=tuple(HeldOut(line.number("frequency_hz"), numbers_of(line.raw("errors"))) for line in certificate.nodes("held_out")),
        worst=certificate.maybe_number("worst"),
        vectors=certificate.maybe_number("vectors"),
        unseen=_unseen(certificate),
        steps=tuple(_step(count, step) for count, step in enumerate(node.nodes("trace"), start=1)),
        seconds=numbers_of(node.raw("seconds")),
        machine=mapping_of(node.raw("machine")),
        date=node.maybe_text("date") or "",
        cache=mapping_of(node.raw("cache")),
        versions=mapping_of(node.raw("versions")),
    )


def _unseen(certificate: Node) -> tuple[float, float, float] | None:
    """Bound of the error at other lines, the share of them that it is for, and its confidence."""
    bound, share, sure = (certificate.maybe_number(name) for name in ("unseen", "unseen_share", "unseen_confidence"))
    return None if bound is None or share is None or sure is None else (bound, share, sure)


def _step(count: int, node: Node) -> Step:
    frequency = node.array("frequency_hz")
    number = node.maybe_number("step")
    return Step(
        number=count if number is None else int(number),
        size=node.number("size"),
        factorised_hz=node.maybe_number("factorised_hz"),
        measured_error=node.maybe_number("measured_error"),
        frequency_hz=frequency,
        estimate=node.array("estimate", size=len(frequency)),
    )
