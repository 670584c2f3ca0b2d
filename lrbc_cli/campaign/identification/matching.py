"""Finds the record of each response in the measured files, and warns of records that were measured elsewhere."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from lrbc_cli.arrays import Complexes, Floats
from lrbc_cli.campaign.reading.inputs import Inputs, Response
from lrbc_cli.campaign.reading.places import MILLIMETRES
from lrbc_cli.config.settings import JobConfig
from lrbc_cli.config.structure import FileRecordRef, PointConfig, RecordRef
from lrbc_cli.errors import DataError
from lrbc_cli.io.frf_common import alike
from lrbc_cli.model.dofs import COMPONENTS, DofTable
from lrbc_cli.model.frf import FrfRecord, FrfSet
from lrbc_cli.model.selection import nearest, spacing

Wanted = str | int | RecordRef | FileRecordRef

#: Least share of the responses used that a job must have to be identified without the others.
LEAST_USED = 0.5

#: Largest number of records in one message.
_MOST = 12


def describe(record: FrfRecord, several: bool = False) -> str:
    """A record in words; with its file if ``several`` files were read."""
    parts = [record.name or "(no name)"]
    if record.response_node is not None:
        parts.append(f"node {record.response_node} direction {record.response_direction}")
    if record.reference_node is not None:
        parts.append(f"over node {record.reference_node} direction {record.reference_direction}")
    parts.append(record.quantity or "quantity unknown")
    number = f"record {record.number}"
    place = record.place if record.place == number or not record.number else f"{number} ({record.place})"
    return f"{Path(record.file).name + ' ' if several else ''}{place}: {', '.join(parts)}"


def listed(frf: FrfSet) -> str:
    """All records in one line of text."""
    several = len({record.file for record in frf.records}) > 1
    return "; ".join(describe(r, several) for r in frf.records[:_MOST]) + (" ..." if len(frf.records) > _MOST else "")


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


def _named(record: FrfRecord, name: str) -> bool:
    return record.name.strip().lower() == name.strip().lower()


def _asked(wanted: Wanted) -> Callable[[FrfRecord], bool]:
    """Test whether a record is the one that the campaign names."""
    if isinstance(wanted, str):
        return lambda r: _named(r, wanted)
    if isinstance(wanted, int):
        return lambda r: r.number == wanted
    if isinstance(wanted, FileRecordRef):
        return lambda r: (
            r.file == str(wanted.file) and wanted.number in (None, r.number) and (wanted.name is None or _named(r, wanted.name))
        )
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
    if len(own) == 1:
        return own[0]
    names = list(dict.fromkeys(Path(record.file).name for record in found))
    text = "; ".join(describe(r, len(names) > 1) for r in found[:_MOST])
    if len(names) > 1:
        raise DataError(
            f"the files {names[0]} and {names[1]} both contain response {response.name} ({how})",
            file=found[1].file or frf.source,
            expected="each response once",
            found=text,
            hint=f"remove one of them from the job's frf, or select one under its records: {{{response.name}: {{file: {names[0]}}}}}",
        )
    raise DataError(
        f"several records fit response {response.name} ({how})",
        file=found[0].file or frf.source,
        found=text,
        hint=f"select one in responses.{response.name}.record or in the job's records, for instance by its number",
    )


def match_record(response: Response, wanted: Wanted | None, frf: FrfSet, inputs: Inputs) -> FrfRecord | None:
    """Record of a response: as the campaign states, else by name, node and direction, reciprocity, or a name that is only alike.

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
        return one(_asked(wanted), _wanted_text(wanted))
    found = one(_asked(response.name), f"name {response.name}")
    if found is not None:
        return found
    if response.node is None:
        return _named_alike(response, frf, inputs)
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
    return found if found is not None else _named_alike(response, frf, inputs)


def _named_alike(response: Response, frf: FrfSet, inputs: Inputs) -> FrfRecord | None:
    """The only record with a name such as ``H1(acc1/hammer)`` or ``Acc 1`` for the response ``acc1``.

    None if several records or responses are alike, or the record has the name of another response.
    """
    wanted = alike(response.name)
    found = [record for record in frf.records if alike(record.name) == wanted]
    others = [other.name for other in inputs.responses if other is not response]
    taken = any(alike(name) == wanted or _named(record, name) for record in found for name in others)
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
    for response in inputs.responses:
        settings = inputs.campaign.responses[response.name]
        wanted = job.records.get(response.name, settings.record)
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
    raise DataError(
        f"no record of response {response.name}" + (f", nor of {', '.join(other.name for other in lacking[1:])}" if lacking[1:] else ""),
        file=job.first,
        place=f"job {name}",
        expected=_wanted_text(wanted) if wanted is not None else f"a record named {response.name}" + _place_text(response),
        found=listed(frf),
        # Warnings about the files may give the reason.
        hint="; ".join([*frf.warnings, _which([response, *(other for other in lacking[1:] if other.name not in stated)], spare)]),
    )


def unmatched(records: Sequence[FrfRecord | None], frf: FrfSet) -> list[str]:
    """Names of the records that belong to no response."""
    return [record.name for record in frf.records if record.name and not any(record is other for other in records)]


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


def _miscounted(inputs: Inputs, job: JobConfig, records: list[FrfRecord | None]) -> str:
    """Warning if all records selected by number have names of other responses, each the same number of records away; else empty."""
    names = {r.name.lower() for r in inputs.responses}
    found = [
        (r, record)
        for r, record in zip(inputs.responses, records, strict=True)
        if record is not None and isinstance(job.records.get(r.name, inputs.campaign.responses[r.name].record), int)
    ]
    own = [(r, record) for r, record in found if record.name.strip().lower() in names]
    order = [r.name.lower() for r in inputs.responses]
    away = {order.index(record.name.strip().lower()) - order.index(r.name.lower()) for r, record in own}
    if len(own) < max(2, len(found)) or len(away) != 1 or away == {0}:
        return ""
    named = ", ".join(f"{r.name} selects record {record.number} ({record.name})" for r, record in own[:_MOST])
    by, way = abs(min(away)), "high" if min(away) > 0 else "low"
    return (
        f"{called(job)}: the record numbers are probably {by} too {way}: {named}{' ...' if len(own) > _MOST else ''}. Correct "
        "responses.NAME.record (records are counted from 1), or remove it, as the names in the file are those of the responses"
    )


def misplaced(inputs: Inputs, job: JobConfig, records: list[FrfRecord | None]) -> list[str]:
    """Warnings about records of other nodes or directions than their responses, if most nodes in the files are those of the model."""
    if miscounted := _miscounted(inputs, job, records):
        return [miscounted]
    pairs = [(r, record) for r, record in zip(inputs.responses, records, strict=True) if record is not None and r.node is not None]
    own = [(r, record) for r, record in pairs if record.response_node is not None and not reciprocal(record, r, inputs)]
    alike = sum(record.response_node == r.node for r, record in own)
    if 2 * alike <= len(pairs):
        return [_mirrored(inputs, job)] if _congruent(inputs, own) else []
    found = []
    for r, record in own:
        key, where = f"responses.{r.name}", f"{called(job)}: {describe(record)} was measured"
        if record.response_node != r.node:
            metres = _in_metres(inputs, inputs.campaign.responses[r.name], record.response_node)
            found.append(
                f"{where} at node {record.response_node}, but response {r.name} is node {r.node} of the "
                f"model: {metres or f'correct the place of {key}, or its record'}"
            )
        elif {record.response_direction, r.direction} <= {1, 2, 3} and record.response_direction != r.direction:
            axes = dict(enumerate(COMPONENTS[:3], start=1))
            found.append(
                f"{where} along {axes[record.response_direction]}, but response {r.name} is {axes[r.direction or 0]} of that node: write "
                f"{key}.component: {axes[record.response_direction]}, or use another channel of the sensor ({key}.record)"
            )
    for at, (name, (node, along)) in enumerate(zip(inputs.excitations, inputs.excitation_points, strict=True)):
        ways = {abs(record.reference_direction or 0) for r, record in own if r.input == at}
        if len(ways) == 1 and {along, *ways} <= {1, 2, 3} and along not in ways:
            axes = dict(enumerate(COMPONENTS[:3], start=1))
            found.append(
                f"{called(job)}: the hammer hit along {axes[ways.pop()]}, but excitation.{name} is {axes[along or 0]}: correct "
                f"excitation.{name}.component, or use the measurement that was hit along {axes[along or 0]}"
            )
        over = {record.reference_node for r, record in own if r.input == at}
        if node is not None and len(over) == 1 and not over & {None, node}:
            hit = over.pop()
            metres = _in_metres(inputs, inputs.campaign.excitation[name], hit)
            fix = f"Correct excitation.{name}, or, if only this measurement is affected, measure it again at node {node}"
            found.append(
                f"{called(job)}: the hammer hit node {hit}, but excitation.{name} is node {node} of the model: "
                f"{metres or f'check whether hammer and sensor are exchanged. {fix}'}"
            )
    return found


def _congruent(inputs: Inputs, own: list[tuple[Response, FrfRecord]], *, least: int = 4, same: float = 0.01) -> bool:
    """Whether the nodes in the files are the places of the campaign mirrored or rotated: other nodes with equal mutual distances.

    If node numbers of the test are unrelated to the model, the distances differ. ``same``: tolerance relative to the extent of the model.
    """
    if inputs.dofs is None:
        return False
    pairs = {(r.node, record.response_node) for r, record in own}
    pairs |= {(inputs.excitation_points[r.input][0], record.reference_node) for r, record in own}
    stated, measured = (_places(inputs.dofs, [pair[k] for pair in pairs]) for k in (0, 1))
    if stated is None or measured is None or len(stated) < least:
        return False
    extent = float(np.ptp(inputs.dofs.xyz, axis=0).max())
    apart = [np.linalg.norm(xyz[:, None] - xyz, axis=2) for xyz in (stated, measured)]
    moved = np.linalg.norm(stated - measured, axis=1).max() > same * extent
    return bool(moved and np.abs(apart[0] - apart[1]).max() <= same * extent and np.ptp(stated, axis=0).max() > same * extent)


def _places(dofs: DofTable, nodes: Sequence[int | None]) -> Floats | None:
    """(k, 3) coordinates of nodes [m]; None if one of them is not in the model."""
    at = [np.flatnonzero(dofs.node == node) for node in nodes]
    return None if any(node is None or not found.size for node, found in zip(nodes, at, strict=True)) else dofs.xyz[[int(f[0]) for f in at]]


def _mirrored(inputs: Inputs, job: JobConfig) -> str:
    return (
        f"{called(job)}: all records were measured at other nodes of the model than the campaign file says; these are its places "
        "mirrored or turned. Give hammer, sensors and bolts in the axes of the model (lrbc check -v lists the nodes of the records); "
        "otherwise the wrong bolt is found loose"
    )


def _in_metres(inputs: Inputs, point: PointConfig, node: int | None) -> str | None:
    """Hint that a point was given in metres instead of millimetres, if 1000 times its coordinates lie at the measured node; else None.

    The opposite mistake puts points outside the model, which is refused elsewhere.
    """
    if point.near is None or point.component is None or inputs.dofs is None:
        return None
    place = [value / MILLIMETRES for value in point.near]
    dof, distance = nearest(inputs.dofs, [value * inputs.campaign.unit_system.length for value in place], point.component) or (-1, np.inf)
    if dof < 0 or inputs.dofs.node[dof] != node or distance > spacing(inputs.dofs, dof):
        return None
    text = ", ".join(f"{value:.6g}" for value in place)
    return f"multiplied by 1000, the given point lies there: write near: [{text}], in the units of the campaign"


def require_signals(inputs: Inputs, records: list[FrfRecord | None], values: Complexes) -> None:
    """Refuse records of responses used that contain only zeros.

    Raises
    ------
    DataError
        One for all of them.
    """
    dead = [i for i in inputs.used if records[i] is not None and not np.any(np.abs(np.nan_to_num(values[:, i])) > 0)]
    if not dead:
        return
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
