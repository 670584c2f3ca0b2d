"""Finds the record of each response in the measured files, and warns of records that were measured elsewhere."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from lrbc_cli.arrays import Complexes, Floats
from lrbc_cli.campaign.identification.compared.appended import require_one_measurement
from lrbc_cli.campaign.reading.inputs import Inputs, Response
from lrbc_cli.config.fields import plain_name
from lrbc_cli.config.settings import JobConfig, files_of
from lrbc_cli.config.structure import FileRecordRef, RecordRef
from lrbc_cli.errors import DataError, listing
from lrbc_cli.io.atomic import file_hash, unchanged
from lrbc_cli.io.frf import CoherenceKey, TextLayout, read_coherence
from lrbc_cli.io.frf_common import WORDS, alike
from lrbc_cli.model.frf import FrfRecord, FrfSet

Wanted = str | int | RecordRef | FileRecordRef

#: Least share of the responses used that a job must have to be identified without the others.
LEAST_USED = 0.5

#: Largest number of records in one message.
MOST_NAMED = 12


def describe(record: FrfRecord, several: bool = False) -> str:
    """A record in words; with its file if ``several`` files were read."""
    parts = [record.name or "(no name)"]
    if record.response_node is not None:
        parts.append(f"node {record.response_node} direction {record.response_direction}")
    if record.reference_node is not None:
        parts.append(f"over node {record.reference_node} direction {record.reference_direction}")
    if record.reference_name:
        parts.append(f"hammer point {record.reference_name}")
    parts.append(record.quantity or "quantity unknown")
    number = f"record {record.number}"
    place = record.place if record.place == number or not record.number else f"{number} ({record.place})"
    return f"{Path(record.file).name + ' ' if several else ''}{place}: {', '.join(parts)}"


def listed(frf: FrfSet) -> str:
    """All records in one line of text."""
    several = len({record.file for record in frf.records}) > 1
    return "; ".join(describe(r, several) for r in frf.records[:MOST_NAMED]) + (" ..." if len(frf.records) > MOST_NAMED else "")


def _wanted_text(wanted: Wanted) -> str:
    if isinstance(wanted, RecordRef):
        over = "" if wanted.reference_node is None else f" over node {wanted.reference_node}"
        return f"node {wanted.node} direction {wanted.direction}{over}"
    if isinstance(wanted, FileRecordRef):
        which = f"number {wanted.number}" if wanted.number is not None else f"name {wanted.name}" if wanted.name else "the one record"
        return f"{which} of {wanted.file.name}"
    return f"number {wanted}" if isinstance(wanted, int) else f"name {wanted}"


def _place_text(response: Response) -> str:
    if response.node is None:
        return ""
    return f", or of node {response.node}" + ("" if response.direction is None else f" direction {response.direction}")


def named(record: FrfRecord, name: str) -> bool:
    """Whether a record has this name, apart from case."""
    return record.name.strip().lower() == name.strip().lower()


def parted(files: Iterable[str]) -> dict[str, str]:
    """The part of the name of each file that the others do not share, by words at its begin and end: ``H01`` of ``tight_H01.csv``."""
    words = {file: WORDS.split(Path(file).stem) for file in dict.fromkeys(files)}
    least = min(map(len, words.values()), default=0)
    columns = list(zip(*(own[:least] for own in words.values()), strict=True))
    ends = list(zip(*(own[::-1][:least] for own in words.values()), strict=True))
    first = next((k for k, column in enumerate(columns) if len(set(column)) > 1), least)
    last = next((k for k, column in enumerate(ends) if len(set(column)) > 1), 0)
    return {file: "-".join(own[first : len(own) - last]) for file, own in words.items()}


def with_files(frf: FrfSet) -> dict[int, tuple[str, ...]]:
    """Names of records with the part of their file, ``A1-H01``, by the identity of the record: where several files have records of a name.

    In a job of one file, which may be the only one that was measured, it is that with any word of the file.
    """
    names = [record.file for record in frf.records]
    if len(set(names)) == 1:
        words = {file: WORDS.split(Path(file).stem) for file in names}
        return {id(r): tuple(f"{r.name}-{word}" for word in words[r.file]) for r in frf.records if r.name}
    parts, often = parted(names), Counter(alike(record.name) for record in frf.records)
    return {id(r): (f"{r.name}-{parts[r.file]}",) for r in frf.records if r.name and often[alike(r.name)] > 1}


def _plain(name: str) -> str:
    """A name for comparison, with any separators."""
    return alike(name.replace("-", " ").replace("_", " "))


def _with_its_file(wanted: str, frf: FrfSet) -> Callable[[FrfRecord], bool]:
    """Test whether a record has this name together with a part of the name of its file."""
    full = with_files(frf)
    return lambda r: any(_plain(name) == _plain(wanted) for name in full.get(id(r), ()))


def _asked(wanted: Wanted, frf: FrfSet) -> Callable[[FrfRecord], bool]:
    """Test whether a record is the one that the campaign names."""
    if isinstance(wanted, str):
        return partial(named, name=wanted) if any(named(r, wanted) for r in frf.records) else _with_its_file(wanted, frf)
    if isinstance(wanted, int):
        return lambda r: r.number == wanted
    if isinstance(wanted, FileRecordRef):
        return lambda r: r.file == str(wanted.file) and wanted.number in (None, r.number) and (wanted.name is None or named(r, wanted.name))
    return lambda r: (
        (r.response_node, r.response_direction) == (wanted.node, wanted.direction)
        and wanted.reference_node in (None, r.reference_node)
        and wanted.reference_direction in (None, r.reference_direction)
    )


def _one(found: list[FrfRecord], how: str, response: Response, frf: FrfSet, inputs: Inputs) -> FrfRecord | None:
    """The only record found or, if the files contain several hammer points, that of the response's own; DataError if ambiguous."""
    if len(found) < 2:
        return found[0] if found else None
    node, direction = inputs.excitation_points[response.input]
    own = [r for r in found if node is not None and r.reference_node == node]
    if len(own) > 1 and direction is not None:
        own = [r for r in own if r.reference_direction == direction]
    if not own:
        # Files may name hammer points instead; in the campaign file a name has no accents or signs.
        excitation, called = inputs.excitations[response.input], [r for r in found if r.reference_name]
        own = [r for r in called if excitation in (r.reference_name, plain_name(r.reference_name))]
        own = own or [r for r in called if alike(r.reference_name) == alike(excitation)]
    if len(own) == 1:
        return own[0]
    names = list(dict.fromkeys(Path(record.file).name for record in found))
    text = "; ".join(describe(r, len(names) > 1) for r in found[:MOST_NAMED])
    if len(names) > 1:
        raise DataError(
            f"the files {names[0]} and {names[1]} both contain response {response.name} ({how})",
            file=found[1].file or frf.source,
            expected="each response once",
            found=text,
            hint=f"remove one of them from the job's frf, or select one under its records: {{{response.name}: {{file: {names[0]}}}}}",
        )
    require_one_measurement(inputs.campaign, frf, found[0].file)
    raise DataError(
        f"several records fit response {response.name} ({how})",
        file=found[0].file or frf.source,
        found=text,
        hint=f"select one in responses.{response.name}.record or in the job's records, for instance by its number",
    )


def match_record(response: Response, wanted: Wanted | None, frf: FrfSet, inputs: Inputs) -> FrfRecord | None:
    """Record of a response: as the campaign states, else by name, node and direction, reciprocity, a name with that of its file, or alike.

    Returns
    -------
    FrfRecord or None
        None if the files contain none.

    Raises
    ------
    DataError
        If several records fit.
    """

    def one(fits: Callable[[FrfRecord], bool], how: str) -> FrfRecord | None:
        return _one([r for r in frf.records if fits(r)], how, response, frf, inputs)

    if wanted is not None:
        return one(_asked(wanted, frf), _wanted_text(wanted))
    found = one(partial(named, name=response.name), f"name {response.name}")
    if found is not None:
        return found

    def named_otherwise() -> FrfRecord | None:
        own = one(_with_its_file(response.name, frf), f"name {response.name}")
        return own if own is not None else _named_alike(response, frf, inputs)

    if response.node is None:
        return named_otherwise()
    driven, _ = inputs.excitation_points[response.input]
    several = len(inputs.excitations) > 1

    def fits(record: FrfRecord) -> bool:
        if record.response_node != response.node:
            return False
        # A response without direction fits any record at its node that has one.
        if response.direction is None and record.response_direction == 0:
            return False
        if response.direction is not None and record.response_direction != response.direction:
            return False
        return not several or driven is None or record.reference_node in (None, driven)

    direction = "" if response.direction is None else f" direction {response.direction}"
    found = one(fits, f"node {response.node}{direction}")
    found = found if found is not None else one(lambda r: reciprocal(r, response, inputs), f"hammer at node {response.node}{direction}")
    return found if found is not None else named_otherwise()


def _named_alike(response: Response, frf: FrfSet, inputs: Inputs) -> FrfRecord | None:
    """The only record with a name such as ``H1(acc1/hammer)`` or ``Acc 1`` for the response ``acc1``.

    None if several records or responses are alike, or the record has the name of another response.
    """
    wanted = alike(response.name)
    found = [record for record in frf.records if alike(record.name) == wanted]
    others = [other.name for other in inputs.responses if other is not response]
    taken = any(alike(name) == wanted or named(record, name) for record in found for name in others)
    return found[0] if len(found) == 1 and not taken else None


def reciprocal(record: FrfRecord, response: Response, inputs: Inputs) -> bool:
    """Whether a record is the FRF of the response with hammer and sensor exchanged, which is equal for translations."""
    node, direction = inputs.excitation_points[response.input]
    ends = (node, direction), (response.node, response.direction)
    if any(at is None or along not in (1, 2, 3) for at, along in ends):
        return False
    return ((record.response_node, record.response_direction), (record.reference_node, record.reference_direction)) == ends


def matched(inputs: Inputs, job: JobConfig, name: str, frf: FrfSet) -> list[FrfRecord | None]:
    """Record of each response; None if it has none and the job can be identified without it.

    Raises
    ------
    DataError
        If a response has several records, one of another quantity, or none although it is needed, or shares one with another response.
    ConfigError
        If the campaign refers to a file that is not among those of the job.
    """
    records: list[FrfRecord | None] = []
    files = [str(file) for files in job.measurements for file in files]
    # Text files have names instead of node numbers.
    nameless = not any(record.name for record in frf.records) or any(record.response_node is not None for record in frf.records)
    for response in inputs.responses:
        settings = inputs.campaign.responses[response.name]
        stated = settings.record if nameless or not isinstance(settings.record, RecordRef) else None
        wanted = job.records.get(response.name, stated)
        if isinstance(wanted, FileRecordRef) and str(wanted.file) not in files:
            keys = ("jobs", name, "records", response.name) if response.name in job.records else ("responses", response.name, "record")
            raise inputs.campaign.error(
                "this is not one of the job's files",
                *(*keys, "file"),
                expected=", ".join(Path(file).name for file in files),
                found=wanted.file.name,
                hint="list it under frf of the job",
            )
        record = match_record(response, wanted, frf, inputs)
        if record is not None and record.quantity not in (None, response.quantity, settings.labelled):
            raise DataError(
                f"the record of response {response.name} has another quantity",
                file=record.file or job.first,
                place=record.place,
                expected=response.quantity,
                found=record.quantity,
                hint=f"set responses.{response.name}.quantity; if the file states it wrongly, also responses.{response.name}.labelled: "
                f"{record.quantity}, or jobs.{name}.format.quantity for all its records",
            )
        records.append(record)
    _require_own(inputs, job, name, records)
    _require_used(inputs, job, name, records, frf)
    return records


def _require_own(inputs: Inputs, job: JobConfig, name: str, records: list[FrfRecord | None]) -> None:
    """Refuse one record for two responses if the campaign states it for either of them.

    If it does not, one record may serve two responses: by reciprocity, or with two names for one place.
    """
    seen: dict[int, Response] = {}
    for response, record in zip(inputs.responses, records, strict=True):
        if record is None:
            continue
        first = seen.setdefault(id(record), response)
        asked = [job.records.get(one.name, inputs.campaign.responses[one.name].record) for one in (first, response)]
        if first is not response and any(one is not None for one in asked):
            raise DataError(
                f"responses {first.name} and {response.name} have the same record",
                file=record.file or job.first,
                place=f"job {name}",
                expected="a record of its own for each response",
                found=describe(record, len(job.measurements[0]) > 1),
                hint=f"correct the job's records, or responses.{response.name}.record",
            )


def _require_used(inputs: Inputs, job: JobConfig, name: str, records: list[FrfRecord | None], frf: FrfSet) -> None:
    """Refuse a job without a record of a response used, unless few are missing and no other job depends on it."""
    missing = [inputs.responses[i] for i in inputs.used if records[i] is None]
    if not missing:
        return
    update, calibration = inputs.campaign.update, inputs.campaign.calibration
    # Jobs on which others depend need all records; a mistyped name is thus noticed in the reference job.
    leading = update.reference in (None, name) or name in update.baselines or (calibration is not None and calibration.job == name)
    asked = [response for response in missing if response.name in job.records]
    enough = len(missing) <= (1.0 - LEAST_USED) * inputs.used.size and len(missing) < inputs.used.size
    if not leading and not asked and enough:
        return
    response = (asked or missing)[0]
    wanted = job.records.get(response.name, inputs.campaign.responses[response.name].record)
    # Responses that are not used are named, too.
    lacking = [
        response,
        *(other for other, record in zip(inputs.responses, records, strict=True) if record is None and other is not response),
    ]
    stated = {*job.records, *(other.name for other in lacking if inputs.campaign.responses[other.name].record is not None)}
    spare = [] if response.name in stated else unmatched(records, frf)
    # If each record that there is belongs to another response, this one was not measured or not exported.
    every = response.name not in job.records and all(any(own is record for own in records) for record in frf.records)
    struck = [r for other, r in zip(inputs.responses, records, strict=True) if every and r is not None and other.input == response.input]
    files = {record.file for record in struck}
    beside = replace(frf, records=tuple(record for record in frf.records if record.file in files))
    raise DataError(
        f"no record of response {response.name}" + (f", nor of {', '.join(other.name for other in lacking[1:])}" if lacking[1:] else ""),
        file=(files.pop() if len(files) == 1 else None) or job.first,
        place=f"job {name}",
        expected=_wanted_text(wanted) if wanted is not None else f"a record named {response.name}" + _place_text(response),
        found=listed(beside if struck else frf),
        # Files of another job, or warnings about the files, may give the reason.
        hint="; ".join(
            [
                *_of_another(inputs, job, name),
                *frf.warnings,
                _not_there(lacking) if struck else _which([response, *(o for o in lacking[1:] if o.name not in stated)], spare),
            ]
        ),
    )


def _of_another(inputs: Inputs, job: JobConfig, name: str) -> list[str]:
    """Remark on files of a job that another job lists, too; empty if there are none."""
    own, jobs = set(job.all_files), inputs.campaign.jobs
    meant = "check whether another file was meant"
    return [
        f"{listing(sorted(file.name for file in shared))} belong{'s' if len(shared) == 1 else ''} to job {other}, too: {meant}"
        for other, settings in jobs.items()
        if other != name and (shared := own & set(settings.all_files))
    ][:1]


def unmatched(records: Sequence[FrfRecord | None], frf: FrfSet) -> list[str]:
    """Names of the records that belong to no response, with parts of their files where several have the same."""
    rest = [record for record in frf.records if record.name and not any(record is other for other in records)]
    several = len({record.file for record in frf.records}) > 1
    full = with_files(frf) if several else {}
    return [full.get(id(record), (record.name,))[0] for record in rest]


def _not_there(lacking: Sequence[Response]) -> str:
    names, it = ", ".join(response.name for response in lacking), "them" if len(lacking) > 1 else "it"
    return (
        f"measure or export {it} again, or remove {names} from the campaign file; records with other names are given in the job's records"
    )


def _which(lacking: Sequence[Response], spare: Sequence[str]) -> str:
    """Hint how to state the records of responses without one, with likely records if as many are unassigned."""
    key, how = f"responses.{lacking[0].name}.record", "by name, number, node or file"
    if len(spare) != len(lacking):
        return f"give the record in {key} or in the job's records, {how}"
    lines = ", ".join(f"responses.{response.name}.record: {name}" for response, name in zip(lacking, spare, strict=True))
    if len(spare) == 1:
        return f"if it is {spare[0]}, write {lines}; otherwise give the record there or in the job's records, {how}"
    return f"if they are {', '.join(spare)}, in this order, write {lines}; otherwise give the records there or in the job's records, {how}"


def called(job: JobConfig) -> str:
    """Files of a job in words."""
    first, *others = job.measurements[0]
    return first.name + (f" and {len(others)} more" if others else "")


def dead_records(inputs: Inputs, records: list[FrfRecord | None], values: Complexes) -> list[str]:
    """Refuse records of responses used that contain only zeros; warnings about those of other responses.

    Raises
    ------
    DataError
        One for all of them.
    """
    zero = [i for i, record in enumerate(records) if record is not None and not np.any(np.abs(np.nan_to_num(values[:, i])) > 0)]
    dead = [i for i in zero if i in inputs.used]
    if not dead:
        return [
            f"the record of response {inputs.responses[i].name} is zero on the whole band, so it validates nothing: check whether its "
            "sensor or cable was off, and measure this job again, or remove the response"
            for i in zero
        ]
    names = ", ".join(inputs.responses[i].name for i in dead)
    several, all_of = len(dead) > 1, len(dead) == inputs.used.size
    remedy = f"or do without {'them' if several else 'it'} in all jobs: remove {names} from responses and update.responses"
    raise DataError(
        f"the records of responses {names} are zero on the whole band"
        if several
        else f"the record of response {names} is zero on the whole band",
        file=next(record.file for i in dead if (record := records[i]) is not None),
        expected="measured values",
        hint=f"check whether {'their sensors or cables were' if several else 'its sensor or cable was'} off. Measure this job again"
        + (", and check the hammer's signal and its trigger" if all_of and several else f", {remedy}"),
    )


def layout_of(job: JobConfig, file: Path, of_coherence: bool = False) -> TextLayout | None:
    """Layout that the campaign states for one of a job's files; None if it states none."""
    given = job.format_of(file, of_coherence)
    return None if given is None else TextLayout(**given.model_dump())


def keys_of(
    response: Response, record: FrfRecord | None, full: Mapping[int, tuple[str, ...]]
) -> tuple[CoherenceKey | tuple[int | None, int], ...]:
    """Keys under which the coherence of a response may be stored; for ``full`` see ``with_files``.

    A name that records of several files have is none of them without the part of its file.
    """
    if record is None:
        return (response.name,)
    names = full.get(id(record), ())
    return response.name, *(names or (record.name,)), (record.response_node, record.response_direction)


def coherences_of(job: JobConfig, hashes: dict[str, str]) -> dict[CoherenceKey, tuple[Floats, Floats]]:
    """Coherences of separate files, each with its lines [Hz]; adds the hashes of these files.

    A name that several files have goes with the part of the file's name that the others do not share, as for records: ``A1-H01``.
    """
    found: dict[CoherenceKey, tuple[Floats, Floats]] = {}
    every, parts = list[tuple[Path, CoherenceKey, tuple[Floats, Floats]]](), parted(map(str, files_of(job.coherence)))
    for file in files_of(job.coherence):
        hashes[file.as_posix()] = file_hash(file)
        own = unchanged(file, hashes[file.as_posix()], partial(read_coherence, file, layout_of(job, file, of_coherence=True)))
        if len(own) == 1 and "" in own:
            own = {file.stem: own[""]}
        every += [(file, key, pair) for key, pair in own.items()]
    often = Counter(key for _, key, _ in every)
    for file, key, pair in every:
        full = f"{key}-{parts[str(file)]}" if isinstance(key, str) and often[key] > 1 else key
        if full in found:
            hint = "name the columns like the responses, or remove one of the files"
            raise DataError("two files give the same coherence", file=file, expected="each once", found=f"{key} again", hint=hint)
        found[full] = pair
    return found
