"""Notes and warnings on the records that a job takes for its responses: of other nodes or numbers, or by names that are only alike."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from lrbc_cli.arrays import Floats
from lrbc_cli.campaign.identification.matching import MOST_NAMED, describe, named, reciprocal
from lrbc_cli.campaign.reading.inputs import Inputs, Response
from lrbc_cli.campaign.reading.places import MILLIMETRES
from lrbc_cli.config.settings import JobConfig
from lrbc_cli.config.structure import PointConfig
from lrbc_cli.errors import listing
from lrbc_cli.model.dofs import COMPONENTS, DofTable
from lrbc_cli.model.frf import FrfRecord
from lrbc_cli.model.selection import nearest, spacing

_MIRRORED = (
    "all records were measured at other nodes of the model than the campaign file says; these are its places mirrored or turned. Give "
    "hammer, sensors and bolts in the axes of the model (lrbc check -v lists the nodes of the records); otherwise the wrong bolt is found "
    "loose"
)


def pair_notes(inputs: Inputs, job: JobConfig, pairs: Sequence[tuple[Response, FrfRecord]]) -> list[str]:
    """Notes on what the files do not say about records, and on records that neither the campaign nor their name or node decided."""
    found = []
    if unstated := [r.name for r, record in pairs if record.quantity is None]:
        found.append(f"quantities not stated in the file, taken as in the campaign: {', '.join(unstated)}")
    if exchanged := [r.name for r, record in pairs if reciprocal(record, r, inputs)]:
        found.append(f"hammer and sensor exchanged, by reciprocity: {', '.join(exchanged)}")
    if similar := _only_alike(inputs, job, pairs):
        found.append(f"by names that are only alike: {listing(similar, 6)}")
    return found


def _only_alike(inputs: Inputs, job: JobConfig, pairs: Sequence[tuple[Response, FrfRecord]]) -> list[str]:
    """Responses, with the names of their records, where neither the campaign nor name or node decided, but names that are alike."""

    def decided(r: Response, record: FrfRecord) -> bool:
        stated = job.records.get(r.name, inputs.campaign.responses[r.name].record) is not None
        return stated or named(record, r.name) or (r.node is not None and record.response_node == r.node) or reciprocal(record, r, inputs)

    return [f"{r.name} is {record.name}" for r, record in pairs if not decided(r, record)]


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
    named = ", ".join(f"{r.name} selects record {record.number} ({record.name})" for r, record in own[:MOST_NAMED])
    by, way = abs(min(away)), "high" if min(away) > 0 else "low"
    return (
        f"the record numbers are probably {by} too {way}: {named}{' ...' if len(own) > MOST_NAMED else ''}. Correct "
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
        return [_MIRRORED] if _congruent(inputs, own) else []
    found = []
    for r, record in own:
        key, where = f"responses.{r.name}", f"{describe(record)} was measured"
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
                f"the hammer hit along {axes[ways.pop()]}, but excitation.{name} is {axes[along or 0]}: correct "
                f"excitation.{name}.component, or use the measurement that was hit along {axes[along or 0]}"
            )
        over = {record.reference_node for r, record in own if r.input == at}
        if node is not None and len(over) == 1 and not over & {None, node}:
            hit = over.pop()
            metres = _in_metres(inputs, inputs.campaign.excitation[name], hit)
            fix = f"Correct excitation.{name}, or, if only this measurement is affected, measure it again at node {node}"
            found.append(
                f"the hammer hit node {hit}, but excitation.{name} is node {node} of the model: "
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
