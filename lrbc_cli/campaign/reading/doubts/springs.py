"""Compares springs of a table with those in the stiffness matrix: in other units, contained twice, at other nodes, or missing."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from lrbc_cli.arrays import Floats, Integers
from lrbc_cli.campaign.reading.groups import TermGroup
from lrbc_cli.campaign.reading.places import POWERS
from lrbc_cli.config import Campaign
from lrbc_cli.errors import listing
from lrbc_cli.model.dofs import COMPONENTS, DofTable, PointTable
from lrbc_cli.model.fem import FeModel
from lrbc_cli.model.units import SI, USUAL_SYSTEMS, UnitSystem, parse_system

#: Largest relative difference of a spring's stiffness in matrix and table.
HELD = 0.01


def held_springs(campaign: Campaign, model: FeModel, groups: Sequence[TermGroup], dofs: DofTable | None) -> Iterator[str]:
    """Warnings if the matrix contains the springs to be updated in other units, without stated baseline, or less than the baseline."""
    for group in groups:
        held = [] if dofs is None or group.config.select.bushings is None else _held(model, group, dofs)
        text = _unit_text(campaign, group, held)
        if text is not None:
            yield text
        elif group.config.baseline < 1.0 and group.config.kind == "stiffness":
            shares = [float(np.median(share)) for _, share in held if share.size]
            if any(abs(share - 1.0) < HELD for share in shares):
                wrong = (
                    f"a share of {1.0 - group.config.baseline:g} stays when one is lost" if group.config.baseline else "they count twice"
                )
                yield (
                    f"parameters {group.name}: the stiffness matrix already contains these springs, so {wrong}. Write "
                    f"parameters.{group.name}.baseline: 1.0"
                )
        elif group.config.kind == "stiffness" and _exceeded(model, group):
            yield f"parameters {group.name}: the baseline {group.config.baseline:g} is more than the stiffness matrix contains there"


def exceeding_springs(
    model: FeModel,
    groups: Sequence[TermGroup],
    dofs: DofTable | None,
    bolts: PointTable | None,
    *,
    share: float = 0.25,
    rounding: float = 1e-3,
) -> Iterator[str]:
    """Warnings about a few springs, at most ``share`` of a table, of which the matrix contains more than stated, and of the others as much.

    A common element would add to each spring. ``rounding``: of matrix and coordinates, relative to the magnitudes of a row.
    """
    for group in groups:
        baseline, file = group.config.baseline, group.config.select.bushings
        if dofs is None or file is None or group.config.kind != "stiffness":
            continue
        springs = list(_springs(model, group, dofs))
        off = [(one.share - baseline) / max(HELD * (baseline or 1.0), rounding * one.size) for one in springs]
        over = [one for one, excess in zip(springs, off, strict=True) if excess > 1.0]
        right = sum(abs(excess) <= 1.0 for excess in off)
        if not over or len(over) > share * len(springs) or len(over) + right < len(springs):
            continue
        named = dict[str, list[str]]()
        for one in over:
            owner = -1 if group.bolt is None else int(group.bolt[one.parameter])
            which = bolts.name[owner] if bolts is not None and owner >= 0 else f"node {one.nodes[0]}"
            named.setdefault(which, []).append(f"{one.component} {one.share:.3g} times")
        told = listing([f"{which} ({', '.join(each)})" for which, each in named.items()], 4)
        yield (
            f"parameters {group.name}: the stiffness matrix contains {baseline:g} times the springs of {file.name}, as the baseline says, "
            f"but more at {told}. Check whether a boundary condition or a contact was left in the FE model there, and export it without; "
            f"otherwise correct {file.name}"
        )


def half_grounded(model: FeModel, groups: Sequence[TermGroup], dofs: DofTable | None) -> Iterator[str]:
    """Warnings about springs to ground whose nodes, bolt by bolt, are joined to other nodes by the springs of another table."""
    if dofs is None:
        return
    alone: dict[str, dict[tuple[int, int], str]] = {}
    joined: dict[tuple[int, int], tuple[str, int]] = {}
    for group in groups:
        if group.bolt is None or group.config.select.bushings is None:
            continue
        left = model.terms.left[:, group.terms].tocsc()
        for k, bolt in enumerate(group.bolt[group.parameter].tolist()):
            nodes = np.unique(dofs.node[left.indices[left.indptr[k] : left.indptr[k + 1]]]).tolist()
            if len(nodes) == 1:
                alone.setdefault(group.name, {})[bolt, nodes[0]] = group.config.select.bushings.name
            for one, other in (nodes, nodes[::-1]) if len(nodes) == 2 else ():
                joined[bolt, one] = group.name, other
    for name, places in alone.items():
        found = [(place, joined[place]) for place in places if joined.get(place, (name,))[0] != name]
        if len(found) == len(places):
            (_, node), (other, partner) = found[0]
            yield (
                f"parameters.{name}: springs of {next(iter(places.values()))} go to ground, but those of {other} join the same nodes to "
                f"other nodes (node {node} to {partner}). Check whether node_b was left empty, and fill it in. If these springs hold the "
                "part to ground, leave it empty"
            )


def doubled_springs(
    model: FeModel,
    groups: Sequence[TermGroup],
    pair: tuple[TermGroup, TermGroup],
    terms: Sequence[int],
    dofs: DofTable,
    bolts: PointTable | None,
) -> str:
    """Warning about springs that two tables contain, with the components that the same nodes lack and others have.

    Parameters
    ----------
    model : FeModel
    groups : sequence of TermGroup
    pair : (TermGroup, TermGroup)
        The two groups.
    terms : sequence of int
        Terms of the second group that the first one contains, too.
    dofs : DofTable
    bolts : PointTable or None
    """
    left = model.terms.left.tocsc()

    def spring(term: int) -> tuple[tuple[int, ...], str]:
        at = left.indices[left.indptr[term] : left.indptr[term + 1]]
        return tuple(np.unique(dofs.node[at]).tolist()), "/".join(sorted(set(dofs.component[at].tolist())))

    have: dict[tuple[int, ...], set[str]] = {}
    for group in groups:
        for nodes, component in map(spring, group.terms.tolist() if group.config.select.bushings is not None else ()):
            have.setdefault(nodes, set()).add(component)
    first, second = pair
    named, lacking = [], set[str]()
    for term in terms:
        nodes, component = spring(term)
        named.append(
            f"{component} {_of_bolt(second, term, bolts)}({'nodes' if len(nodes) > 1 else 'node'} {' and '.join(map(str, nodes))})"
        )
        lacking |= set().union(*have.values()) - have[nodes]
    tables = dict.fromkeys(group.config.select.bushings.name for group in pair if group.config.select.bushings is not None)
    fix = "Remove them from one of the two"
    if lacking:
        fix = f"These joints lack {' or '.join(sorted(lacking))}, which others have: correct the component of one of the two, or remove it"
    return (
        f"parameters {first.name} and {second.name} contain the same {len(terms)} spring{'s' if len(terms) > 1 else ''} "
        f"({' and '.join(tables)}), which act twice and whose values cannot be distinguished: {listing(named, 4)}. {fix}"
    )


def _of_bolt(group: TermGroup, term: int, bolts: PointTable | None) -> str:
    if group.bolt is None or bolts is None:
        return ""
    owner = int(group.bolt[group.parameter[group.terms == term][0]])
    return f"of {bolts.name[owner]} " if owner >= 0 else ""


def lacking_springs(model: FeModel, group: TermGroup, dofs: DofTable | None, bolts: PointTable | None) -> str | None:
    """Hint on springs of a table that the matrix does not contain as stated; None if unknown. Used once a baseline is known to be missing.

    Exchanged components are seen of all springs; else translational springs to ground are examined, by the forces under a translation.

    Parameters
    ----------
    model : FeModel
    group : TermGroup
    dofs : DofTable or None
    bolts : PointTable or None
    """
    file, baseline = group.config.select.bushings, group.config.baseline
    if dofs is None or file is None or baseline <= 0.0:
        return None
    if exchanged := _exchanged_text(model, group, dofs, bolts, file.name):
        return exchanged
    left = model.terms.left[:, group.terms].tocsc()
    alone = np.flatnonzero(np.diff(left.indptr) == 1)
    alone = alone[np.isin(dofs.component[left.indices[left.indptr[alone]]], COMPONENTS[:3])]
    rows, stated = left.indices[left.indptr[alone]], baseline * left.data[left.indptr[alone]] ** 2
    force = {name: model.K.real @ (dofs.component == name).astype(float) for name in COMPONENTS[:3]}
    held = np.array([force[str(dofs.component[row])][row] for row in rows])
    lacking = np.flatnonzero(held < (1.0 - HELD) * stated)
    if not lacking.size:
        return None
    label = dofs.component[rows[lacking]]
    known = [name for name in COMPONENTS[:3] if np.any(label == name)]
    means = {name: tuple(float(np.median(each[lacking][label == name])) for each in (held, stated)) for name in known}
    if np.all(np.abs(held[lacking]) < HELD * stated[lacking]):
        return _absent(file.name, group, dofs, bolts, (rows, stated, lacking, group.parameter[alone]), force)
    told = ", ".join(f"{have / want * baseline:.4g} times in {name}" for name, (have, want) in means.items())
    return f"the matrix contains the springs of {file.name} {told}, not {baseline:g} times as stated: correct that table, or the baseline"


def _absent(
    table: str,
    group: TermGroup,
    dofs: DofTable,
    bolts: PointTable | None,
    springs: tuple[Integers, Floats, Integers, Integers],
    force: Mapping[str, Floats],
) -> str:
    """Hint on springs that the matrix lacks; ``springs``: DOF and stiffness of all, indices of those lacking, parameter of each."""
    rows, stated, lacking, parameter = springs
    if lacking.size == rows.size:
        shares = [force[str(dofs.component[row])] / k for row, k in zip(rows[lacking], stated[lacking], strict=True)]
        if not any(np.any(np.abs(share - 1.0) < HELD) for share in shares):
            return (
                f"the matrix contains none of the springs of {table}; it was probably exported without them: write "
                f"parameters.{group.name}.baseline: 0, or export it with the springs"
            )
    k = int(lacking[0])
    row, name = int(rows[k]), str(dofs.component[rows[k]])
    there = np.flatnonzero((dofs.component == name) & (np.abs(force[name] / stated[k] - 1.0) < HELD))
    there = there[~np.isin(there, rows)]
    owners = () if bolts is None or group.bolt is None else (bolts.name[b] for b in group.bolt[parameter[lacking]].tolist() if b >= 0)
    of = f" ({', '.join(dict.fromkeys(owners))})".replace(" ()", "")
    if there.size:
        away = np.linalg.norm(dofs.xyz[there] - dofs.xyz[row], axis=1)
        other, gap = int(dofs.node[there[np.argmin(away)]]), 1e3 * float(away.min())
        return (
            f"the matrix contains no spring at node {dofs.node[row]} {name}{of}, but one of that stiffness at node {other}, {gap:.3g} mm "
            f"away: correct the nodes in {table} ({lacking.size} springs)"
        )
    nodes = ", ".join(dict.fromkeys(str(dofs.node[at]) for at in rows[lacking[:6]]))
    return (
        f"the matrix contains no spring at node{'s' if ', ' in nodes else ''} {nodes}{of}, where {table} has one. Check whether it was "
        f"exported with bolts missing. Export it with all of them, or correct the nodes in {table}"
    )


@dataclass(frozen=True, kw_only=True)
class _Spring:
    """A spring of a table: its parameter, component and nodes, its stiffness there and the share of it that the matrix contains.

    ``size``: sum of the magnitudes from which that share was found, relative to the stiffness, by which rounding of the files counts.
    """

    parameter: int
    component: str
    nodes: tuple[int, ...]
    stated: float
    share: float
    size: float


def _springs(model: FeModel, group: TermGroup, dofs: DofTable) -> Iterator[_Spring]:
    """Springs of a group along one component, with their shares in the matrix.

    Springs to ground are found by the forces under a rigid motion, springs between two nodes without common element by the coupling entry.
    """
    K, left = model.K.real, model.terms.left[:, group.terms].tocsc()
    moved = {label: K @ (dofs.component == label).astype(float) for label in COMPONENTS[:3]}
    for k in range(left.shape[1]):
        at, size = left.indices[left.indptr[k] : left.indptr[k + 1]], left.data[left.indptr[k] : left.indptr[k + 1]]
        labels = sorted(set(dofs.component[at].tolist()))
        row, stated = int(at[0]), abs(float(size[0] * size[-1]))
        if at.size == 2 and len(labels) == 1:
            force = K[at[0], at[1]] * np.sign(size[0] * size[1])
            summed = abs(force)
        elif at.size == 1 and labels[0].startswith("ROT"):
            turned = turned_about(dofs, row)
            force, summed = (K[[row]] @ turned)[0], (abs(K[[row]]) @ np.abs(turned))[0]
        elif at.size == 1:
            force, summed = moved.get(labels[0], np.zeros(model.size))[row], abs(K[[row]]).sum()
        else:
            continue
        nodes = tuple(sorted(dofs.node[at].tolist()))
        yield _Spring(
            parameter=int(group.parameter[k]),
            component=str(labels[0]),
            nodes=nodes,
            stated=stated,
            share=float(force / stated),
            size=float(summed / stated),
        )


def _held(model: FeModel, group: TermGroup, dofs: DofTable) -> list[tuple[bool, Floats]]:
    """Ratios of the stiffness in the matrix to that in the table, separately for translations (False) and rotations (True)."""
    springs = list(_springs(model, group, dofs))
    return [(turns, np.array([one.share for one in springs if one.component.startswith("ROT") == turns])) for turns in (False, True)]


def _exchanged_text(model: FeModel, group: TermGroup, dofs: DofTable, bolts: PointTable | None, table: str) -> str | None:
    """Hint if the matrix contains the stiffnesses of a table along each other's components, at all joints or some; else None."""
    joints: dict[tuple[object, ...], list[_Spring]] = {}
    for one in _springs(model, group, dofs):
        joints.setdefault((one.parameter, one.nodes, one.component.startswith("ROT")), []).append(one)
    named: dict[str, list[str]] = {}
    for own in joints.values():
        there = np.array([one.share * one.stated for one in own])
        stated = np.array([group.config.baseline * one.stated for one in own])
        off = np.flatnonzero(np.abs(there / stated - 1.0) > HELD)
        if off.size < 2 or np.any(np.abs(np.sort(there[off]) / np.sort(stated[off]) - 1.0) > HELD):
            continue
        owner = -1 if group.bolt is None else int(group.bolt[own[0].parameter])
        which = bolts.name[owner] if bolts is not None and owner >= 0 else f"node {own[0].nodes[0]}"
        named.setdefault(listing(sorted(own[k].component for k in off), 6, " and " if off.size == 2 else ", "), []).append(which)
    if not named:
        return None
    every = sum(map(len, named.values())) == len(joints)
    told = ", and ".join(f"{components}{'' if every else f' of {listing(list(dict.fromkeys(at)), 8)}'}" for components, at in named.items())
    return f"the matrix contains the stiffnesses of {told} in each other's place: exchange them in {table}"


def turned_about(dofs: DofTable, row: int) -> Floats:
    """(n,) rigid rotation by 1 rad about the axis of a rotational DOF through its node."""
    axis = np.eye(3)[("ROTX", "ROTY", "ROTZ").index(str(dofs.component[row]))]
    motion = np.cross(axis, dofs.xyz - dofs.xyz[row])
    found = np.zeros(dofs.size)
    for i, (shift, turn) in enumerate((("UX", "ROTX"), ("UY", "ROTY"), ("UZ", "ROTZ"))):
        found += np.where(dofs.component == shift, motion[:, i], 0.0) + np.where(dofs.component == turn, axis[i], 0.0)
    return found


def _unit_text(campaign: Campaign, group: TermGroup, held: Sequence[tuple[bool, Floats]]) -> str | None:
    """Warning if the stiffnesses of a table are in other units than stated, by their ratios ``held`` to the matrix; else None."""
    expected = group.config.baseline or 1.0
    known = [(turns, float(np.median(share)) / expected) for turns, share in held if share.size and np.median(share) > 0.0]
    stated = campaign.unit_system
    others = [SI] if stated != SI else [parse_system(name) for name in USUAL_SYSTEMS]
    for unit in others:
        ratios = [(turns, share, _stiffness(unit, turns) / _stiffness(stated, turns)) for turns, share in known]
        if not ratios or any(abs(share / ratio - 1.0) > HELD for _, share, ratio in ratios) or all(abs(r - 1.0) < HELD for *_, r in ratios):
            continue
        kinds = [
            f"{'rotational springs' if turns else 'translational springs'} are probably in {_name(unit, turns)}, not in "
            f"{_name(stated, turns)}: {'divide' if ratio < 1.0 else 'multiply'} them by {max(ratio, 1.0 / ratio):g}"
            for turns, _, ratio in ratios
        ]
        file, times = group.config.select.bushings, ratios[0][1]
        table = file.name if file is not None else "the table"
        return (
            f"parameters {group.name}: the stiffness matrix contains {times:.4g} times the stiffness in {table}: "
            f"{'; '.join(kinds)} (`units: {stated.text}` applies to that file too). If that file is right, all of model.stiffness is "
            f"{times:.4g} times what it should be"
        )
    return _thousands_text(campaign, group, [share for _, share in known]) or _times_text(campaign, group, held)


def _times_text(campaign: Campaign, group: TermGroup, held: Sequence[tuple[bool, Floats]], *, least: int = 3) -> str | None:
    """Warning if the matrix contains the springs of a table with a baseline all by one other factor than stated; else None.

    A table in N·m/degree, or of another state, looks like this. A common element would add to each spring another amount.
    """
    file, baseline = group.config.select.bushings, group.config.baseline
    shares = np.concatenate([share for _, share in held]) if held else np.zeros(0)
    times = float(np.median(shares)) if shares.size else 0.0
    if file is None or baseline <= 0.0 or shares.size < least or times <= (1.0 + HELD) * baseline:
        return None
    if np.any(np.abs(shares / times - 1.0) > HELD):
        return None
    degrees = all(turns for turns, share in held if share.size) and abs(times / baseline / np.rad2deg(1.0) - 1.0) < HELD
    unit = (
        f"the table is probably in {_name(campaign.unit_system, True).replace('rad', 'degree')}"
        if degrees
        else "correct that table, the matrix"
    )
    return (
        f"parameters {group.name}: the stiffness matrix contains {times:.4g} times the stiffness in {file.name}, not {baseline:g} times as "
        f"stated: {unit}{f'. Multiply its stiffnesses by {np.rad2deg(1.0):.6g}' if degrees else f', or parameters.{group.name}.baseline'}"
    )


def _thousands_text(campaign: Campaign, group: TermGroup, shares: Sequence[float]) -> str | None:
    """Warning if the stiffnesses of a table are wrong by powers of a thousand, which fit no usual units; else None."""
    file, times = group.config.select.bushings, next((10.0**b for b in POWERS if shares and abs(shares[0] / 10.0**b - 1.0) < HELD), 1.0)
    if file is None or times == 1.0 or any(abs(share / times - 1.0) > HELD for share in shares):
        return None
    return (
        f"parameters {group.name}: the stiffness matrix contains {times:g} times the stiffness in {file.name}, which must be in "
        f"{_name(campaign.unit_system, False)} (`units: {campaign.unit_system.text}`). Multiply the stiffnesses there by {times:g}"
    )


def _stiffness(unit: UnitSystem, turns: bool) -> float:
    return unit.force * unit.length if turns else unit.force / unit.length


def _name(unit: UnitSystem, turns: bool) -> str:
    names = {1.0: "N", 1e3: "kN", 4.4482216152605: "lbf"}
    force = next((name for size, name in names.items() if abs(unit.force / size - 1.0) < 1e-6), f"{unit.force:.4g} N")
    return f"{force} {unit.length_name}/rad" if turns else f"{force}/{unit.length_name}"


def _exceeded(model: FeModel, group: TermGroup) -> bool:
    """Whether a baseline is larger than the stiffness in the matrix at the DOFs of a term."""
    left, right = model.terms.left[:, group.terms], model.terms.right[:, group.terms]
    share = np.asarray((left.multiply(model.K.real @ right)).sum(axis=0)).ravel()
    norm = np.asarray((left.multiply(right)).sum(axis=0)).ravel() ** 2
    return bool(np.any(share < group.config.baseline * norm * (1 - 1e-9)))
