"""Detects copies of a measurement: saved under another name, exported again, in other units or with fewer digits."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from threading import Lock
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lrbc_cli.arrays import Complexes, Floats
from lrbc_cli.campaign.identification.records import Measurement, read_measurement
from lrbc_cli.campaign.reading.inputs import Inputs
from lrbc_cli.errors import LrbcError, listing
from lrbc_cli.io.atomic import file_hash
from lrbc_cli.remembered import Remembered
from lrbc_cli.updating.comparison.correlation import measured_values
from lrbc_cli.updating.robust import medians
from lrbc_cli.updating.statistics.decibels import decibel
from lrbc_cli.updating.statistics.model import ValidationChannels

#: Rounding error in single precision of levels below 500 dB, and of their differences [dB].
_ROUNDING = 1e-4


def copied_responses(own: Measurement, other: Measurement, limits: ValidationChannels) -> NDArray[np.int64]:
    """Responses whose magnitudes are those of another measurement up to a constant factor and the rounding of three digits.

    Criterion: on half of the common lines the difference of the levels is within ``copied_db`` of its median. Two measurements of one
    state differ by more: by 0.03 dB with a coherence of 0.9999 and ten averages.

    Parameters
    ----------
    own, other : Measurement
        Of the same responses; their lines may differ.
    limits : ValidationChannels

    Returns
    -------
    int array
        Indices; empty if fewer than ``least_common`` lines are common.
    """
    mine, theirs = _common_lines(own.frequency_hz, other.frequency_hz, limits)
    a, b = own.values[mine], other.values[theirs]
    found = []
    for i in range(min(a.shape[1], b.shape[1])):
        valid = measured_values(a[:, i]) & measured_values(b[:, i])
        if int(valid.sum()) < limits.least_common:
            continue
        difference = decibel(a[valid, i]) - decibel(b[valid, i])
        if float(np.median(np.abs(difference - np.median(difference)))) <= limits.copied_db:
            found.append(i)
    return np.array(found, dtype=np.int64)


def _common_lines(own: Floats, other: Floats, limits: ValidationChannels) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Indices of the common lines in both axes [Hz]."""
    near = np.minimum(np.searchsorted(other, own * (1 - limits.same_line)), other.size - 1)
    common = np.flatnonzero(np.abs(other[near] - own) <= limits.same_line * own)
    return common, near[common]


def proportional(one: Complexes, other: Complexes, limits: ValidationChannels) -> bool:
    """Whether two FRFs differ by a constant factor only, as those of two sensors never do; ``other`` must not contain zeros."""
    ratio = one / other
    return bool(np.all(np.abs(ratio - ratio[0]) <= limits.copied * abs(ratio[0])))


def pasted(measurement: Measurement, responses: list[str], limits: ValidationChannels) -> Iterator[str]:
    """Warnings about pairs of responses of one job that have the same numbers up to a factor, and about constant ones beside others."""
    values = measurement.values
    constant = [name for name, own in zip(responses, values.T, strict=True) if _constant(own, limits)]
    if 0 < len(constant) < int(measured_values(values).any(axis=0).sum()):
        yield (
            f"{listing(constant)} {'is' if len(constant) == 1 else 'are'} the same number at all lines: the FRFs of this job were probably "
            "computed over this channel, not over the hammer. Select the force as the reference of the FRFs in the analyser, and export "
            "them again"
        )
    for i, first in enumerate(responses):
        for j in range(i + 1, len(responses)):
            both = measured_values(values[:, i]) & measured_values(values[:, j])
            # Constant values are no FRF.
            if both.sum() < limits.least_common or first in constant:
                continue
            if proportional(values[both, j], values[both, i], limits):
                yield (
                    f"{first} and {responses[j]} have the same numbers. Possible causes: one column copied over the other, one channel "
                    f"exported twice. Export the record of each again"
                )


def _constant(values: Complexes, limits: ValidationChannels, *, rounding: float = 1e-6) -> bool:
    """Whether an FRF (F,) is one number, but for rounding."""
    known = values[measured_values(values)]
    return known.size >= limits.least_common and bool(np.ptp(np.abs(known)) + np.ptp(np.angle(known)) <= rounding * np.abs(known).max())


@dataclass(frozen=True)
class Levels:
    """Levels (R, F) of a measurement [dB], NaN where there is no value, at its lines (F,) [Hz]."""

    frequency_hz: Floats
    db: NDArray[np.float32]

    @classmethod
    def of(cls, measurement: Measurement) -> Levels:
        """Those of all responses."""
        size = np.abs(measurement.values.T)
        return cls(measurement.frequency_hz, np.asarray(decibel(np.where(size > 0, size, np.nan)), dtype=np.float32))


class Earlier:
    """Earlier measurements, for a fast search for one of which a further measurement is a copy (see ``copied_responses``).

    Measurements that cannot be the original are excluded for all on the same lines at once: the median deviation from the median is small
    only if half of the deviations are. This is done in single precision with a margin.

    Parameters
    ----------
    limits : ValidationChannels
    read : callable
        The measurement of a job that was added, by its name; called only for those that are not excluded.
    """

    def __init__(self, limits: ValidationChannels, read: Callable[[str], Measurement]) -> None:
        self.limits, self._read = limits, read
        #: By the bytes of the lines: lines [Hz], names, and levels of all responses (R, F) [dB].
        self._grids: dict[bytes, tuple[Floats, list[str], list[NDArray[np.float32]]]] = {}
        self._order: list[str] = []

    def add(self, name: str, levels: Levels) -> None:
        """Add a measurement."""
        _, names, known = self._grids.setdefault(levels.frequency_hz.tobytes(), (levels.frequency_hz, [], []))
        names.append(name)
        known.append(levels.db)
        self._order.append(name)

    def copied(self, own: Measurement, responses: list[str], among: Sequence[str] | None = None) -> tuple[str, str]:
        """The first measurement (of ``among``, or as they were added) of which ``own`` is a copy, and a warning; else empty texts."""
        likely = set(self._likely(own))
        named = [name for name in (self._order if among is None else among) if name in likely]
        for name in named:
            # A file may have gone meanwhile.
            with suppress(LrbcError):
                if text := copied_text(own, self._read(name), name, responses, self.limits):
                    return name, text
        return "", ""

    def _likely(self, own: Measurement) -> Iterator[str]:
        level = Levels.of(own).db
        for lines, names, levels in self._grids.values():
            mine, theirs = _common_lines(own.frequency_hz, lines, self.limits)
            if mine.size < self.limits.least_common:
                continue
            difference: Any = np.stack(levels)[:, :, theirs] - level[:, mine]
            known = np.count_nonzero(~np.isnan(difference), axis=2)
            near = np.count_nonzero(np.abs(difference - medians(difference, 2)) <= self.limits.copied_db + _ROUNDING, axis=2)
            alike = ((2 * near >= known) & (known >= self.limits.least_common)).any(axis=1)
            yield from (name for name, candidate in zip(names, alike, strict=True) if candidate)


class Originals:
    """Measurements of other jobs, of which that of a job must be no copy: read when first asked for. Safe for threads.

    Parameters
    ----------
    inputs : Inputs
    """

    def __init__(self, inputs: Inputs) -> None:
        self._inputs, self._lock, self._tried = inputs, Lock(), set[str]()
        self._earlier = Earlier(inputs.statistics.validation, self._read)

    def _read(self, name: str) -> Measurement:
        return read_measurement(self._inputs, self._inputs.campaign.jobs[name], name)

    def _levels(self, name: str) -> Levels:
        job = self._inputs.campaign.jobs[name]
        content = "".join(map(file_hash, job.all_files)).encode()
        campaign = self._inputs.campaign
        kind = (job.model_dump_json(), campaign.reduction.band, repr(campaign.responses), repr(campaign.excitation))
        return _known.of(content, lambda: Levels.of(self._read(name)), kind)

    def copied(self, name: str, others: Sequence[str], own: Measurement | None = None) -> tuple[str, str]:
        """The first of ``others`` of which the measurement of a job is a copy, and a warning; empty texts if there is none.

        Parameters
        ----------
        name : str
        others : sequence of str
            One that cannot be read is the failure of its own job.
        own : Measurement or None
            Measurement of the job; None: read from its files.
        """
        responses = [response.name for response in self._inputs.responses]
        with self._lock:
            for other in others:
                if other not in self._tried:
                    self._tried.add(other)
                    with suppress(LrbcError):
                        self._earlier.add(other, self._levels(other))
            with suppress(LrbcError):
                return self._earlier.copied(own or self._read(name), responses, others)
        return "", ""


#: Levels of files that were read: `lrbc watch` compares each new measurement with all earlier ones.
_known = Remembered[Levels](2048)


def copied_text(own: Measurement, other: Measurement, name: str, responses: list[str], limits: ValidationChannels) -> str:
    """Warning if a measurement is a copy of that of the job ``name``; empty if not."""
    same = copied_responses(own, other, limits)
    if not same.size:
        return ""
    held = int(np.isfinite(own.values).any(axis=0).sum())
    told = f"it has the numbers of the measurement of {name}"
    if same.size == held:
        return f"{told}: check whether another file was meant"
    return (
        f"{told} in {listing([responses[i] for i in same], 6)}, and others elsewhere: the file of one of the two jobs, this one or {name}, "
        "has records of the other. Check which one"
    )
