"""Sorts FRF files into jobs, and names FRFs without a name after their files or folders."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from lrbc_cli.campaign.drafting.recognise import FilesFound
from lrbc_cli.campaign.drafting.roles import BOLTS, HAMMER, PointFound, names_loose, tight_states
from lrbc_cli.config.fields import job_name, plain_name
from lrbc_cli.errors import LrbcError
from lrbc_cli.io.frf_common import WORDS, alike
from lrbc_cli.io.text.tables import read_table
from lrbc_cli.model.frf import FrfRecord

#: Names of numbered sensors and channels.
CHANNELS = re.compile(r"(acc|bes|beschl|mic|mik|vel|disp|sens|sensor|kanal|ch|chan|channel)[\s_.-]*\d+[\s_.-]*[xyz]?", re.IGNORECASE)

#: Names of numbered states, which no hammer point has; those of bolts say that something is loose.
STATES = re.compile(r"(s|state|zustand)[\s_.-]*\d+", re.IGNORECASE)

#: Separators from either end of a name at which it may be divided.
_DIVISIONS = (-1, 0, -2, 1, -3, 2)


@dataclass(frozen=True, kw_only=True)
class NamedFile:
    """State and channel of an FRF without a name, by its file.

    Attributes
    ----------
    folder : Path
        Folder of all files of the measurement.
    state : str
        Name of the measurement.
    channel : str
        Name of the FRF.
    """

    folder: Path
    state: str
    channel: str


def name_after_files(found: FilesFound) -> dict[Path, NamedFile]:
    """Name the FRFs without a name, which are alone in their files, where the files or folders name sensors; `found` is changed.

    Three layouts are recognised: ``tight/acc1.txt``, ``acc1/tight.txt`` and ``tight_acc1.txt``. The first one needs the same files in
    several folders or names of the table of points; the others need names of that table, or of numbered sensors.
    """
    unnamed = [path for path, frf in found.measurements.items() if len(frf.records) == 1 and _is_nameless(frf.records[0])]
    is_channel = _channels(found)
    named: dict[Path, NamedFile] = {}
    for folder in dict.fromkeys(path.parent for path in unnamed):
        named |= _by_parts(folder, [path for path in unnamed if path.parent == folder], is_channel)
    named |= _by_folders(found, [path for path in unnamed if path not in named], is_channel)
    for path, one in named.items():
        frf = found.measurements[path]
        found.measurements[path] = replace(frf, records=(replace(frf.records[0], name=one.channel),))
    return named


def jobs_of(found: FilesFound, named: Mapping[Path, NamedFile]) -> dict[str, list[Path]]:
    """Files of each job: one file, all files with a single record of the same state, or those of the hammer points of a state."""
    states: dict[tuple[Path, str], list[Path]] = {}
    hits = _by_hammer(found)
    for path, frf in found.measurements.items():
        one = named.get(path)
        key = (path.parent, _state_of(path, frf.records)) if one is None else (one.folder, one.state)
        states.setdefault(hits.get(path, key), []).append(path)
    jobs: dict[str, list[Path]] = {}
    for (parent, state), paths in states.items():
        name = state if len(paths) > 1 or paths[0] in named else paths[0].stem
        jobs[job_name([name, f"{parent.name}-{name}"], jobs, found.called(paths[0]))] = paths
    return jobs


def other_names(paths: Sequence[Path], named: Mapping[Path, NamedFile]) -> dict[str, Path]:
    """Files by the name of their FRF, where this is not the name of the file, which the readers give it."""
    return {one.channel: path for path in paths if (one := named.get(path)) is not None and alike(one.channel) != alike(path.stem)}


class Struck(NamedTuple):
    """Node and direction of a hammer point by the file, and its name if it has no node."""

    node: int | None
    direction: int
    name: str


def struck_at(record: FrfRecord) -> Struck:
    """Hammer point of a record."""
    return Struck(record.reference_node, record.reference_direction, "" if record.reference_node is not None else record.reference_name)


def ends(record: FrfRecord) -> tuple[object, ...]:
    """Both ends of a record, its name where the response has no node."""
    return record.response_node, record.response_direction, record.name if record.response_node is None else "", *struck_at(record)


def hammers(
    records: Sequence[FrfRecord],
    point: Callable[[str], PointFound | None],
    near: Callable[[PointFound], str],
    at_node: Callable[[int | None, int], str | None],
) -> dict[Struck, tuple[str, str | None]]:
    """Name and place of each hammer point in the files, the place None if not known.

    By the names of the files, if each has a ``point`` and they differ as names in a campaign file; else by their nodes.
    """
    called = {struck_at(record): record.reference_name for record in reversed(records)}
    points = {at: point(name) for at, name in called.items() if name}
    names = {plain_name(called[at]) for at, own in points.items() if own is not None} - {""}
    found: dict[Struck, tuple[str, str | None]] = {}
    for at in map(struck_at, records):
        own = points.get(at) if len(names) == len(called) else None
        found.setdefault(at, (f"h{len(found) + 1}", at_node(at.node, at.direction)) if own is None else (plain_name(called[at]), near(own)))
    return found


def address(record: FrfRecord, number: int, quoted: Callable[[str], str], *, several: bool, alone: bool) -> str:
    """How a record is addressed in a campaign file: by name, node or number; by its hammer point, too, if there are ``several``.

    By its number, too, if it is not ``alone`` with its nodes or, where it has none, with its name.
    """
    if several and not alone:
        return str(number)
    if record.response_node is None or (not several and record.name) or (several and record.reference_node is None):
        return quoted(record.name) if record.name else str(number)
    struck = f", reference_node: {record.reference_node}, reference_direction: {record.reference_direction}" if several else ""
    return f"{{node: {record.response_node}, direction: {record.response_direction}{struck}}}"


def _by_hammer(found: FilesFound) -> dict[Path, tuple[Path, str]]:
    """Folder and state of files of a roving hammer, one for each hammer point: ``tight/H01.uff``, ``tight_H01.uff`` or ``H01_tight.uff``.

    All records of such a file name the same node and direction of the hammer.
    """
    struck: dict[Path, Struck] = {}
    for path, frf in found.measurements.items():
        places = set(map(struck_at, frf.records))
        if len(places) == 1 and (place := places.pop()).node is not None:
            struck[path] = place
    folders: dict[Path, list[Path]] = {}
    for path in struck:
        folders.setdefault(path.parent, []).append(path)
    names, states = _called(found, folders), dict[Path, tuple[Path, str]]()
    for folder, paths in folders.items():
        places = {struck[path] for path in paths}
        if len(places) < 2:
            continue
        if len(places) == len(paths) and not any(_is_state(path.stem) or STATES.fullmatch(path.stem) for path in paths):
            states |= {path: (folder, names[folder]) for path in paths}
        else:
            states |= {path: (folder, state) for path, state in _without_hit(paths, struck).items()}
    return states


def _without_hit(paths: Sequence[Path], struck: Mapping[Path, Struck]) -> dict[Path, str]:
    """States in the names of files such as ``tight_H01``, whose other parts stand for one hammer point each; empty if there is no such."""
    for at in _DIVISIONS:
        for last in (True, False):
            states, hits = dict[Path, str](), set[tuple[str, Struck]]()
            for path in paths:
                cuts = list(WORDS.finditer(path.stem))
                if at < len(cuts) and -at <= len(cuts):
                    left, right = path.stem[: cuts[at].start()], path.stem[cuts[at].end() :]
                    state, hit = (left, right) if last else (right, left)
                    states[path] = state
                    hits.add((hit, struck[path]))
            if any(_is_state(hit) or STATES.fullmatch(hit) for hit, _ in hits):
                continue
            once = len({hit for hit, _ in hits}) == len({place for _, place in hits}) == len(hits) > 1
            if len(states) == len(paths) and once and len({(states[path], struck[path]) for path in paths}) == len(paths):
                return states
    return {}


def _is_nameless(record: FrfRecord) -> bool:
    return not record.name.strip() and record.response_node is None


def _channels(found: FilesFound) -> Callable[[str], bool]:
    """Test whether a name is that of a sensor: in a table of points, or by its word."""
    points: set[str] = set()
    for path in (*found.of("points"), *found.of("named")):
        if BOLTS.search(path.stem) is None:
            with suppress(LrbcError):
                names = read_table(path, ("name",), ("x", "y", "z", "component", "quantity")).text("name")
                points.update(alike(name) for name in names if HAMMER.search(name) is None)
    return lambda text: alike(text) in points or CHANNELS.fullmatch(text.strip()) is not None


def _is_state(text: str) -> bool:
    """Whether a name says that something is tight or loose."""
    return names_loose(text) or bool(tight_states({text: text})[0])


def _mostly(texts: Iterable[str], test: Callable[[str], bool]) -> bool:
    told = [test(text) for text in texts]
    return 2 * sum(told) > len(told)


def _by_parts(folder: Path, paths: Sequence[Path], is_channel: Callable[[str], bool]) -> dict[Path, NamedFile]:
    """Files of one folder such as ``tight_acc1.txt``: all pairs of the states and the channels in their names."""
    for at in _DIVISIONS:
        for last in (True, False):
            found: dict[Path, NamedFile] = {}
            for path in paths:
                cuts = list(WORDS.finditer(path.stem))
                if at >= len(cuts) or -at > len(cuts):
                    continue
                left, right = path.stem[: cuts[at].start()], path.stem[cuts[at].end() :]
                state, channel = (left, right) if last else (right, left)
                if state and is_channel(channel) and not is_channel(state):
                    found[path] = NamedFile(folder=folder, state=state, channel=plain_name(channel))
            pairs = {(one.state.lower(), alike(one.channel)) for one in found.values()}
            states, channels = {state for state, _ in pairs}, {channel for _, channel in pairs}
            if 2 * len(found) > len(paths) and len(channels) > 1 and len(pairs) == len(found) == len(states) * len(channels):
                return found
    return {}


def _by_folders(found: FilesFound, paths: Sequence[Path], is_channel: Callable[[str], bool]) -> dict[Path, NamedFile]:
    """Files such as ``tight/acc1.txt`` or ``acc1/tight.txt``."""
    folders = dict.fromkeys(path.parent for path in paths)
    stems = {path.stem for path in paths}
    by_channel = _mostly(stems, is_channel)
    if not by_channel and len(folders) > 1 and _mostly([folder.name for folder in folders], is_channel):
        return {
            path: NamedFile(folder=path.parent.parent, state=path.stem, channel=plain_name(path.parent.name))
            for path in paths
            if is_channel(path.parent.name)
        }
    if not by_channel and any(map(_is_state, stems)):
        return {}
    often = Counter(alike(path.stem) for path in paths)
    names = _called(found, folders)
    return {
        path: NamedFile(folder=path.parent, state=names[path.parent], channel=path.stem)
        for path in paths
        if often[alike(path.stem)] > 1 or is_channel(path.stem)
    }


def _called(found: FilesFound, folders: Iterable[Path]) -> dict[Path, str]:
    """Names of folders, with the folders around them where names repeat."""
    own = {folder: folder.resolve().name for folder in folders}
    often = Counter(own.values())
    return {
        folder: name if often[name] == 1 or folder == found.folder else "-".join(folder.relative_to(found.folder).parts)
        for folder, name in own.items()
    }


def _state_of(path: Path, records: Sequence[FrfRecord]) -> str:
    """State of a file: its name without that of its single record, or the name of its folder if nothing remains."""
    channel = records[0].name.strip() if len(records) == 1 else ""
    if not channel or channel.lower() not in path.stem.lower():
        return path.stem
    at = path.stem.lower().index(channel.lower())
    return (path.stem[:at] + path.stem[at + len(channel) :]).strip("-_. ") or path.parent.name


def measured_band(
    records: Sequence[FrfRecord], *, least: float = 0.75, wide: float = 0.25, cut: float = 0.02, usual: tuple[float, float] = (20.0, 400.0)
) -> tuple[tuple[float, float], str]:
    """Band of records [Hz], and in words why it is not the whole range of their lines; empty if it is.

    With coherence it is the part of the range in which lines with a good one most outnumber others: hammer and sensors reach no further.

    Parameters
    ----------
    records : sequence of FrfRecord
    least : float
        Good coherence, median over the records.
    wide, cut : float
        Least shares of the lines that a part must hold, and leave out.
    usual : (float, float)
        The band without records.
    """
    lines = np.concatenate([record.frequency_hz for record in records]) if records else np.zeros(0)
    above = lines[lines > 0]
    if above.size < 2:
        return usual, ""
    whole = low, high = float(above.min()), float(above.max())
    known = [record for record in records if record.coherence is not None and np.array_equal(record.frequency_hz, records[0].frequency_hz)]
    if not known:
        return whole, ""
    axis = records[0].frequency_hz
    typical = np.median([record.coherence for record in known], axis=0)
    # Sums up to each line, of which the largest rise is looked for.
    sums = np.concatenate([[0.0], np.cumsum(np.where((typical >= least) & (axis > 0), 1.0, -1.0))])
    rise = sums - np.minimum.accumulate(sums)
    last = int(np.argmax(rise))
    first = int(np.argmin(sums[: last + 1])) if rise[last] > 0 else last
    if not wide * axis.size <= last - first <= (1.0 - cut) * axis.size:
        return whole, ""
    part = float(axis[first]), float(axis[last - 1])
    return (
        part,
        f"{part[0]:g} to {part[1]:g} Hz, where the coherence is mostly {least:g} or more; the lines reach from {low:g} to {high:g} Hz",
    )
