"""Writes the text of a campaign file for the recognised files, with open questions as comments."""

from __future__ import annotations

import json
import math
import os
import re
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from lrbc_cli.campaign.drafting.channels import (
    NamedFile,
    Struck,
    address,
    ends,
    hammers,
    jobs_of,
    measured_band,
    name_after_files,
    other_names,
    struck_at,
)
from lrbc_cli.campaign.drafting.recognise import FilesFound, MatrixFound
from lrbc_cli.campaign.drafting.roles import (
    HAMMER,
    PointFound,
    Roles,
    edge_near,
    holds_springs,
    names_loose,
    quantity_of,
    roles_of,
    table_of,
    tight_states,
    units_of,
)
from lrbc_cli.campaign.reading.reader import LABELS
from lrbc_cli.config.document import resolve_scalar
from lrbc_cli.config.fields import plain_name
from lrbc_cli.config.skeleton import SCHEMA_LINE
from lrbc_cli.errors import LrbcError, listing
from lrbc_cli.io.frf_common import response_of
from lrbc_cli.io.text.bushings import read_bushings
from lrbc_cli.io.text.tables import read_dof_list, read_points, read_positions
from lrbc_cli.model.dofs import DofTable
from lrbc_cli.model.frf import FrfRecord

#: Damping ratio at mid-band of a model without damping.
ASSUMED_RATIO = 0.01

NO_DOFS = "  dofs: model/dofs.csv              # not found among the files"

#: Place to be filled in; letters, so that every command refuses it.
NOWHERE = "{near: [x, y, z], component: UZ}"


@dataclass(kw_only=True)
class Draft:
    """Draft of a campaign file.

    Attributes
    ----------
    folder : Path
        Folder of the campaign file.
    found : FilesFound
    named : dict of NamedFile
        FRFs that are named after their files.
    roles : Roles
    table : DofTable or None
    todo : list of str
        What the user has to complete or confirm.
    recognised : list of str
        What was recognised, in words.
    """

    folder: Path
    found: FilesFound
    named: dict[Path, NamedFile]
    roles: Roles
    table: DofTable | None
    todo: list[str] = field(default_factory=list)
    recognised: list[str] = field(default_factory=list)

    def path(self, path: Path) -> str:
        """A path as written in the campaign file, relative to its folder if possible."""
        try:
            text = Path(os.path.relpath(path.resolve(), self.folder.resolve())).as_posix()
        except ValueError:  # another drive
            text = path.resolve().as_posix()
        return quoted(text)

    def matrix(self, found: MatrixFound) -> str:
        """A reference to a matrix, as written in the campaign file."""
        if found.group is None and "#" not in (text := self.path(found.path)):
            return text
        group = "" if found.group is None else f", group: {quoted(found.group)}"
        arrays = "" if found.arrays is None else f", {found.arrays.setting(quoted)}"
        return f"{{file: {self.path(found.path)}{group}{arrays}}}"

    def text(self) -> str:
        """The whole campaign file."""
        jobs = self._jobs()
        reference, baselines = self._reference(jobs)
        jobs = dict(sorted(jobs.items(), key=lambda job: job[0] != reference))
        record = [entry for path in next(iter(jobs.values()), []) for entry in self.found.measurements[path].records]
        driven = self._driven(record)
        kept = {number: one for number, one in enumerate(record, start=1) if driven or struck_at(one) == struck_at(record[0])}
        responses, names, sensors = self._responses(kept, driven)
        band, why = measured_band(record)
        sections = [
            self._model(band),
            [
                "# Where it is hit and what is measured: {near: [x, y, z], component:}, {node:, component:}, {dof:} or {vector: file}",
                *self._hammer(list(kept.values()), driven),
            ],
            ["responses:", *responses],
            ["# What is identified: terms of stiffness at the bolts (`lrbc guide campaign`)", *self._parameters()],
            [f"reduction: {{band: [{band[0]:g}, {band[1]:g}], tolerance: 1.0e-3}}"],
            self._update(reference, names, baselines, sensors),
            self._calibration(reference),
            ["jobs:" if jobs else "jobs: {}", *[f"  {name}: {self._job(paths)}" for name, paths in jobs.items()]],
        ]
        said = [line for section in sections[1:] for line in section if not line.startswith("#")]
        if NO_DOFS in sections[0] and not any(key in line for key in ("near:", "component:", "bushings:") for line in said):
            sections[0].remove(NO_DOFS)
        self.todo += [*([f"reduction.band: {why}"] if why else []), *self.roles.doubts]
        self.todo += [f"{name} has no role yet" for name in self.roles.spare]
        self.todo += [f"{self.found.called(path)} was not read: {why}" for path, why in self.found.rest.items()]
        name = ["campaign: " + quoted(self.folder.resolve().name or "campaign"), "output: output"]
        units = units_of(self.roles, self.table)
        if units[:1] == ["SI"]:
            name += ["# units: mm-N-t                     # where model and coordinates are not in SI"]
        elif units:
            name += [f"units: {units[0]:28} # of model and coordinates, by masses and distances"]
            self.todo.append(f"units: {' or '.join(units)}, guessed from masses and distances of the model")
        head = [
            SCHEMA_LINE,
            "# Written by `lrbc init --from` from the files that were there. Next: lrbc check, then lrbc run.",
            *(["#", "# To do, or to confirm:", *[f"#   - {' '.join(item.split())}" for item in self.todo]] if self.todo else []),
        ]
        return "\n\n".join("\n".join(part) for part in [head, name, *sections] if part) + "\n"

    def _reference(self, jobs: dict[str, list[Path]]) -> tuple[str | None, list[str]]:
        """Job that is most likely the tight state, and further tight states."""
        states = {name: f"{self.found.called(paths[0].parent)} {name if len(paths) > 1 else paths[0].stem}" for name, paths in jobs.items()}
        bolts = self._bolts()
        tight, numbered = tight_states(states, bolts)
        others = [name for name in jobs if not names_loose(states[name], bolts)]
        reference = next(iter([*tight, *numbered, *others]), None)
        if reference in (*tight, *numbered):
            self.todo.append(f"update.reference: {reference}, chosen by its name; check that all bolts are tight there")
        elif reference:
            self.todo.append(f"update.reference: no file name indicates the tight state; {reference} is only the first")
        elif jobs:
            self.todo.append(
                "update.reference: give the job of the tight state; every file name indicates something loose, or a single bolt"
            )
        self.todo += [f"calibration.job: {reference} too"] if reference else []
        return reference, [name for name in tight if name != reference]

    def _bolts(self) -> set[str]:
        """Names of the bolts in all tables."""
        names = set() if self.roles.bolts is None else set(read_points(self.roles.bolts).name)
        readers: dict[str, Callable[[Path], Any]] = {"bushings": read_bushings, "positions": read_positions, "terms": read_dof_list}
        for kind, read in readers.items():
            for path in self.found.of(kind):
                with suppress(LrbcError):
                    names.update(filter(None, read(path).bolt or ()))
        return names

    def _model(self, band: tuple[float, float]) -> list[str]:
        operators, lines = self.roles.operators, ["model:"]
        for role in ("stiffness", "mass", "damping"):
            if role in operators:
                lines.append(f"  {role}: {self.matrix(operators[role])}")
                self.recognised.append(f"{role}: {self.found.called(operators[role].path)}, {operators[role].matrix.shape[0]} DOFs")
            elif role != "damping":
                lines.append(f"  {role}: model/{role}.mtx         # not found among the files")
                self.todo.append(f"model.{role}: no square matrix was found; `lrbc guide export` says how to export it")
        if "damping" not in operators:
            beta = 2.0 * ASSUMED_RATIO / (math.pi * (band[0] + band[1]))
            self.todo.append(f"model.damping: no file contains it; {ASSUMED_RATIO:.0%} of critical at mid-band is assumed")
            lines.append(f"  damping:                          # assumed: {ASSUMED_RATIO:.0%} of critical at mid-band; calibration fits it")
            fields = ["structure", *(["acoustic"] if self._acoustic else [])]
            lines += [f"    {name}: {{alpha: 0.0, beta: {beta:.3g}}}" for name in fields]
        lines += self._dofs()
        return lines

    @property
    def _acoustic(self) -> bool:
        return self.table is not None and bool(self.table.is_acoustic.any())

    def _dofs(self) -> list[str]:
        found, stiffness = self.found, self.roles.operators.get("stiffness")
        if found.of("dofs"):
            path = found.of("dofs")[0]
            self.recognised.append(f"DOF table: {found.called(path)}")
            return [f"  dofs: {self.path(path)}"]
        if not found.of("nodes"):
            self.todo.append(
                "model.dofs: no table dof,node,component,x,y,z and no mesh was found; without it only DOF numbers can be used, no places"
            )
            return [NO_DOFS]
        nodes = found.of("nodes")[0]
        self.recognised.append(f"coordinates: {found.called(nodes)}")
        if found.of("map"):
            return [f"  dofs: {{map: {self.path(found.of('map')[0])}, nodes: {self.path(nodes)}}}"]
        if stiffness is None or stiffness.labels is None:
            self.todo.append("model.dofs: the DOF of each matrix row is not given: add `map:` or `components:`, see `lrbc guide export`")
        return [f"  dofs: {{nodes: {self.path(nodes)}}}"]

    def _struck(self, records: Sequence[FrfRecord]) -> dict[Struck, tuple[str, str | None]]:
        """Name and place of each hammer point: by its name in the table of points, else by its node if the model has those of the files."""
        at_node = self._at_node if self._numbered(records) else lambda *_: None
        return hammers(records, self.roles.point, self._near, at_node)

    def _driven(self, records: Sequence[FrfRecord]) -> dict[Struck, str]:
        """Names of several hammer points, if the places of all are known; else empty."""
        struck = self._struck(records)
        if len(struck) < 2:
            return {}
        if any(place is None for _, place in struck.values()):
            self.todo.append(f"excitation: the files contain {len(struck)} hammer points; only the first is used, give the others")
            return {}
        return {at: name for at, (name, _) in struck.items()}

    def _hammer(self, records: Sequence[FrfRecord], driven: Mapping[Struck, str]) -> list[str]:
        struck = self._struck(records)
        if driven:
            self.recognised.append(f"{len(driven)} hammer points: {', '.join(driven.values())}")
            return ["excitation:", *[f"  {name}: {place}" for name, place in struck.values()]]
        for name, point in self.roles.points.items():
            if HAMMER.search(name):
                return ["excitation:", f"  {_name(name, 'hammer')}: {self._near(point)}"]
        if self.roles.loads:
            return ["excitation:", f"  hammer: {{vector: {self.matrix(self.roles.loads[0])}}}"]
        place = next(iter(struck.values()))[1] if struck else None
        if place is None:
            self.todo.append("excitation.hammer: give its place; no file contains it")
        return ["excitation:", f"  hammer: {place or NOWHERE}" + ("" if place else "   # to do: its place")]

    def _near(self, point: PointFound) -> str:
        known = set() if self.table is None else {str(label) for label in self.table.component}
        wanted = point.component or ("PRES" if point.quantity == "pressure" else next((u for u in ("UZ", "UY", "UX") if u in known), "UZ"))
        place = ", ".join(f"{value:.9g}" for value in point.xyz)
        return f"{{near: [{place}], component: {quoted(wanted)}}}"

    def _numbered(self, records: Sequence[FrfRecord]) -> bool:
        """Whether the node numbers of all records are those of the model."""
        return all(self._at_node(r.response_node, r.response_direction) is not None for r in records)

    def _at_node(self, node: int | None, direction: int) -> str | None:
        if node is None or self.table is None:
            return None
        label = LABELS[direction]
        there = (self.table.node == node) & (self.table.component == label)
        return f"{{node: {node}, component: {label}}}" if there.sum() == 1 else None

    def _responses(self, records: Mapping[int, FrfRecord], driven: Mapping[Struck, str]) -> tuple[list[str], list[str], dict[str, str]]:
        """Lines of the section ``responses``, names of the responses that have a place, and the sensor of each, from numbered records."""
        lines, names, lost, sensors = list[str](), list[str](), list[tuple[str, FrfRecord, str]](), dict[str, str]()
        numbered = bool(records) and self._numbered(list(records.values()))
        several = Counter(map(ends, records.values()))
        for number, record in records.items():
            plain = _name(
                response_of(record.name),
                f"n{record.response_node}-{LABELS[record.response_direction].lower()}" if record.response_node else f"r{number}",
            )
            struck = driven.get(struck_at(record), "")
            name = f"{plain}-{struck}" if struck else plain
            name = name if name not in names else f"{name}-{number}"
            sensors[name] = plain if struck else name
            alone = several[ends(record)] == 1
            further = f", excitation: {struck}" if struck else ""
            further += "" if name == record.name else f", record: {address(record, number, quoted, several=bool(struck), alone=alone)}"
            names.append(name)
            point = self.roles.point(record.name)
            place = (
                self._near(point)
                if point is not None
                else self._at_node(record.response_node, record.response_direction)
                if numbered
                else None
            )
            quantity = record.quantity or (point.quantity if point else None) or quantity_of(response_of(record.name))
            further += f", quantity: {quantity}" if quantity else ""
            if place is None:
                lost.append((name, record, further))
            else:
                lines.append(f"  {name}: {place[:-1]}{further}}}")
        if numbered and not self.roles.points:
            self.todo.append("responses: the node numbers of the FRF files are taken as those of the model")
        rows = self.roles.rows
        if lost and rows is not None and min(rows.matrix.shape) == len(lost):
            self.todo.append(
                f"responses {', '.join(name for name, *_ in lost)}: taken as the rows of {self.found.called(rows.path)} in this order"
            )
            lines += [f"  {name}: {{matrix: {self.matrix(rows)}, row: {row}{further}}}" for row, (name, _, further) in enumerate(lost)]
            lost = []
        elif rows is not None:
            self.todo.append(
                f"{self.found.called(rows.path)} contains {min(rows.matrix.shape)} vectors over the DOFs: check whether they are rows of "
                "responses, a load, or terms"
            )
        if lost:
            which = listing([name for name, *_ in lost], 4)
            self.todo.append(f"responses {which}: give their places, or a table name,x,y,z,component of the points")
            for name, _, further in lost:
                place = NOWHERE.replace("UZ", "PRES") if "pressure" in further else NOWHERE
                lines.append(f"  {name}: {place[:-1]}{further}}}   # to do: its place")
        if not records:
            self.todo.append("responses: no FRF file was found; `lrbc guide formats` lists what is read")
            lines = [f"  response1: {NOWHERE}   # to do"]
        self.recognised += [f"{len(names)} responses: {', '.join(names)}"] if names else []
        return lines, [name for name in names if name not in {entry[0] for entry in lost}], sensors

    def _parameters(self) -> list[str]:
        groups = [(_name(path.stem, "bushings"), self._bushings(path)) for path in self.found.of("bushings")]
        groups += [
            (_name(matrix.name, "edge"), f"{{vectors: {self.matrix(matrix)}, positions: {self.path(path)}}}")
            for matrix, path in self.roles.terms
        ]
        groups += [(_name(path.stem, "terms"), f"{{dofs: {self.path(path)}}}") for path in self.found.of("terms")]
        self.recognised += [f"terms: {', '.join(name for name, _ in groups)}"] if groups else []
        lines = ["parameters:"]
        # Bushings have the damping of the structure by default.
        damped = "damping" not in self.roles.operators
        tied = "    damping: {initial: 0.0}         # that of the structure times 10^p_damp"
        for name, select in groups or [self._edge()]:
            lines += [
                f"  {name}:",
                f"    select: {select}",
                "    initial: auto                   # log10 of the start value",
                "    bounds: auto",
                *([tied] if damped and "bushings" not in select else []),
            ]
        if self.roles.bolts is not None:
            self.recognised.append(f"bolts: {self.found.called(self.roles.bolts)}")
            lines += ["", f"bolts: {self.path(self.roles.bolts)}"]
        return lines

    def _bushings(self, path: Path) -> str:
        """Selection of a table of springs, with a baseline if the matrices contain these springs."""
        held = holds_springs(path, self.roles, self.table)
        if held is None:
            self.todo.append(f"parameters: baseline: 1.0 if the stiffness matrix already contains the springs of {self.found.called(path)}")
        elif held:
            self.todo.append(
                f"parameters: baseline: 1.0, as the stiffness matrix probably contains the springs of {self.found.called(path)}"
            )
        return f"{{bushings: {self.path(path)}}}" + (
            "\n    baseline: 1.0                   # the stiffness matrix holds these springs" if held else ""
        )

    def _edge(self) -> tuple[str, str]:
        """Name and selection of the terms if no file contains them."""
        edge = None
        if self.roles.bolts is not None and self.table is not None:
            edge = edge_near(read_points(self.roles.bolts).xyz, self.table)
        if edge is None:
            self.todo.append("parameters: give the DOFs at the bolts: a table of bushings, a list of DOFs or a box (`lrbc guide campaign`)")
            return "edge", "{component: ROTY, box: [[x0, x1], [y0, y1], [z0, z1]]}   # to do"
        component, box = edge
        self.todo.append(
            "parameters.edge: the line of nodes nearest to the row of bolts, rotating about it; check that this is the bolted edge"
        )
        return "edge", f"{{component: {component}, box: [{', '.join(f'[{low:.6g}, {high:.6g}]' for low, high in box)}]}}"

    def _update(self, reference: str | None, names: Sequence[str], baselines: Sequence[str], sensors: Mapping[str, str]) -> list[str]:
        tight = f"  reference: {quoted(reference)}" if reference else "  # reference: tight               # the job with all bolts tight"
        guessed = "  reference_guessed: true             # remove this line once all bolts are known to be tight there"
        lines = ["update:", tight, *([guessed] if reference else [])]
        if reference and baselines:
            lines.append(f"  baselines: [{', '.join(map(quoted, baselines))}]   # further tight states: their scatter moves the threshold")
            self.todo.append(f"update.baselines: {', '.join(baselines)}, chosen by name; check that all bolts are tight there")
        # With several hammer points, all records of the last sensor, or of the last point: one alone would be no independent channel.
        hits = {name: name.removeprefix(sensors[name]) for name in names}
        for kind, of in (("sensor", sensors), ("hammer point", hits)):
            if len({of[name] for name in names}) <= 3:
                continue
            last = [name for name in names if of[name] == of[names[-1]]]
            used = [name for name in names if name not in last]
            lines.append(f"  responses: [{', '.join(map(quoted, used))}]   # the last {kind} checks the result")
            kept = "is left out as validation channel" if len(last) == 1 else "are left out as validation channels"
            self.todo.append(f"update.responses: {', '.join(last)} {kept}")
            break
        return [*lines, "  loss: soft                        # single outlying lines count little", "  loss_scale: 1.0"]

    def _calibration(self, reference: str | None) -> list[str]:
        if reference is None:
            return []
        factors = ["stiffness.structure", "damping.structure" if "damping" in self.roles.operators else "beta.structure"]
        factors += ["mass.acoustic"] if self._acoustic else []
        factors += ["beta.acoustic"] if self._acoustic and "damping" not in self.roles.operators else []
        return [
            "calibration:                        # factors on the model, from the tight state",
            f"  job: {quoted(reference)}",
            f"  factors: [{', '.join(factors)}]",
        ]

    def _jobs(self) -> dict[str, list[Path]]:
        """Files of each job."""
        jobs = jobs_of(self.found, self.named)
        self.recognised += [f"{len(jobs)} jobs: {', '.join(jobs)}"] if jobs else []
        if struck := next((paths for paths in jobs.values() if paths[0] not in self.named and len(paths) > 1), None):
            self.todo.append(f"jobs: files such as {', '.join(self.found.called(path) for path in struck[:2])} are taken as one state")
        if self.named:
            path, one = next(iter(self.named.items()))
            self.todo.append(
                f"jobs and responses: {len(self.named)} FRFs have no name in their files, so the files give it: "
                f"{self.found.called(path)} is taken as {one.channel} in the state {one.state}"
            )
        return jobs

    def _job(self, paths: Sequence[Path]) -> str:
        # The longest matching name counts: `tight-2-coherence` belongs to `tight-2`, not to `tight`.
        stems = {path.stem.lower() for path in self.found.measurements}
        of = {c: max((stem for stem in stems if stem in c.stem.lower()), key=len, default="") for c in self.found.coherences}
        # Files of the same name in several folders belong to the coherences of their own folder.
        folders = {path.parent for path in self.found.measurements}
        places = {(path.stem.lower(), path.parent) for path in paths}
        own = [c for c, stem in of.items() if any(stem == mine and (c.parent == at or c.parent not in folders) for mine, at in places)]
        keys = {"frf": paths, **({"coherence": own} if own else {})}
        lists = {key: [self.path(path) for path in several] for key, several in keys.items()}
        parts = [f"{key}: {texts[0] if len(texts) == 1 else '[' + ', '.join(texts) + ']'}" for key, texts in lists.items()]
        others = [f"{name}: {{file: {self.path(path)}}}" for name, path in other_names(paths, self.named).items()]
        return "{" + ", ".join([*parts, *([f"records: {{{', '.join(others)}}}"] if others else [])]) + "}"


def draft(folder: Path, found: FilesFound) -> Draft:
    """Draft of a campaign file in ``folder`` for the recognised files."""
    named = name_after_files(found)
    roles = roles_of(found)
    return Draft(folder=folder, found=found, named=named, roles=roles, table=table_of(found, roles))


def quoted(text: str) -> str:
    """A text quoted where YAML, also inside braces, would read it otherwise."""
    plain = re.fullmatch(r"[\w./-][\w./ -]*", text, re.ASCII) and text == text.strip() and isinstance(resolve_scalar(text), str)
    return text if plain and not text.startswith("-") else json.dumps(text, ensure_ascii=False)


def _name(text: str, otherwise: str) -> str:
    """A text as a name in the campaign file, without accents."""
    return plain_name(text) or otherwise
