"""Reads the parameter groups of a campaign: their rank-one terms from DOFs, vectors or springs, and the bolts that own them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from lrbc_cli.arrays import Floats
from lrbc_cli.campaign.reading.doubts.astray import (
    beside_their_dofs,
    beside_their_springs,
    misnamed_springs,
    misnamed_text,
    renumbered_text,
    stray_springs,
)
from lrbc_cli.campaign.reading.doubts.names import missing_springs, odd_springs
from lrbc_cli.campaign.reading.joints import aside_text, bolts_of_terms, bushing_vectors, joint_notes, owners, require_free
from lrbc_cli.campaign.reading.places import EXCHANGES, require_near
from lrbc_cli.campaign.reading.reader import ModelReader, Parts
from lrbc_cli.config.structure import Damping, GroupConfig, GroupDampingConfig
from lrbc_cli.errors import DataError
from lrbc_cli.io.text.bushings import BushingTable, read_bushings
from lrbc_cli.io.text.tables import Positions, read_points, read_positions
from lrbc_cli.model.dofs import PointTable
from lrbc_cli.model.selection import arc_length, edges_of, is_line, unit_columns
from lrbc_cli.model.terms import KIND_POWER, LowRankTerms


@dataclass(frozen=True, kw_only=True)
class TermGroup:
    """The terms of one parameter group before start values and bounds are known.

    Attributes
    ----------
    name : str
    config : GroupConfig
    terms, parameter : (m,) int arrays
        Columns of the model's terms, and the parameter that scales each.
    xyz : (k, 3) float array or None
        Position of each parameter [m].
    arc_length : (k,) float array or None
        Arc length of each parameter along the edge [m]; None for joints.
    damping : GroupDampingConfig or None
        Start value and bounds of the exponent of tied damping, eq. (33); None if the terms are undamped.
    beta, loss_factor : float
        Stiffness-proportional [s] and hysteretic damping of the terms.
    bolt : (k,) int array or None
        Index of the bolt that owns each parameter, -1 if none does; None if bolts own none.
    """

    name: str
    config: GroupConfig
    terms: NDArray[np.int64]
    parameter: NDArray[np.int64]
    xyz: Floats | None
    arc_length: Floats | None
    damping: GroupDampingConfig | None
    beta: float
    bolt: NDArray[np.int64] | None = None
    loss_factor: float = 0.0

    @property
    def count(self) -> int:
        """Number of parameters."""
        return int(self.parameter.max()) + 1


@dataclass(frozen=True, kw_only=True)
class Terms:
    """A group with its vectors (n, m), the bolt of each parameter by name, and whether all terms go to ground (None: some, or unknown)."""

    group: TermGroup
    left: sp.csc_array
    right: sp.csc_array
    bolt: tuple[str, ...] | None
    ground: bool | None


def _tied(config: GroupConfig, model: Damping | None, owned: bool) -> GroupDampingConfig | None:
    """Damping tied to the stiffness of a group (``owned``: of joints); None if undamped.

    By default joints are damped as the structure: resonances that strain undamped joints would be sharper than measured ones, and a fit
    would move them between lines.
    """
    if config.damping is not None or config.kind != "stiffness" or not owned:
        return None if config.damping == "none" else config.damping
    found = GroupDampingConfig()
    return found if any(found.coefficients(model)) else None


def _damping_text(config: GroupConfig, damping: GroupDampingConfig | None, owned: bool) -> str:
    if not owned or config.kind != "stiffness":
        return ""
    if damping is None:
        return ", undamped"
    return ", damped as the structure" if damping.beta is None and damping.loss_factor is None else ", with damping of their own"


class GroupReader(ModelReader):
    """Reads bolts and parameter groups."""

    @cached_property
    def bushings(self) -> list[BushingTable]:
        """Tables of springs of the groups read so far, in the units of the files."""
        return []

    def terms(self) -> tuple[list[Terms], LowRankTerms]:
        """All groups, and their terms side by side."""
        found: list[Terms] = []
        first = 0
        parts = Parts()
        for name, config in self.campaign.parameters.items():
            one = parts.read(partial(self.group, name, config, first))
            if one is not None:
                found.append(one)
                first += one.left.shape[1]
        parts.require()
        for text, tables in self.beside.items():
            tables = list(dict.fromkeys(tables))
            names = f"nodes given in {' and '.join(tables)}"
            self.warn(f"bolts: {self.campaign.bolts.name if self.campaign.bolts else ''}: {text} ({names})")
        if self.dofs is not None:
            self.warn(*missing_springs(self.bushings, self.dofs, self.misnamed), *(text for _, text in odd_springs(self.bushings)))
        power = np.concatenate([np.full(f.group.terms.size, KIND_POWER[f.group.config.kind]) for f in found])
        baseline = np.concatenate([np.full(f.group.terms.size, f.group.config.baseline) for f in found])
        left, right = (sp.hstack(vectors, format="csc") for vectors in ([f.left for f in found], [f.right for f in found]))
        return found, LowRankTerms(left=left, right=right, power=power, baseline=baseline)

    @property
    def astray(self) -> set[str]:
        """Responses more than a mesh size from any node; other warnings report these."""
        return {name for (section, name), point in self.near.items() if section == "responses" and point.away > 1.0}

    def require_points(self) -> None:
        """Refuse hammer and sensors far outside the model, in one error, because they mostly have one cause."""
        keys = list(self.near)
        if self.dofs is None or not keys:
            return

        def place(some: Sequence[int]) -> str:
            sections = " and ".join(dict.fromkeys(keys[k][0] for k in some))
            return sections if len(some) > 1 else self.campaign.place(*keys[some[0]], "near")

        names = [(section.removesuffix("s"), name) for section, name in keys]
        require_near(np.array([point.place for point in self.near.values()]), names, self.dofs.xyz, file=self.campaign.path, place=place)

    def read_bolts(self) -> None:
        """Read the bolts file if there is one."""
        file = self.campaign.bolts
        if file is not None:
            found = read_points(file)
            self.bolts = replace(found, xyz=found.xyz * self.unit.length)
            self.table(file)

    def owned(self, found: list[Terms]) -> tuple[PointTable | None, list[TermGroup]]:
        """Bolts of the file, else those that terms name; and the groups with the indices of the bolts that own their parameters."""
        bolts, file = self.bolts, self.campaign.bolts
        if bolts is None or file is None:
            bolts = bolts_of_terms([(f.group.name, f.bolt, f.group.xyz) for f in found])
        else:
            known = [self.dofs.xyz] if self.dofs else [f.group.xyz for f in found if f.group.xyz is not None]
            if known:
                names = [("bolt", name) for name in bolts.name]
                all_of = np.concatenate(known)
                own = _places_of(found, bolts.name)
                require_near(bolts.xyz, names, all_of, file=file, known=self.dofs is not None, own=own, unit=self.unit.length)
        owned = [f for f in found if f.bolt is not None]
        if bolts is None or not owned:
            return bolts, [f.group for f in found]
        ground = {f.ground for f in owned}
        self.notes += joint_notes(bolts, [(f.group.name, f.bolt or ()) for f in owned], ground.pop() if len(ground) == 1 else None)
        index = {name: b for b, name in enumerate(bolts.name)} | {"": -1}
        at = [None if f.bolt is None else np.array([index[name] for name in f.bolt], dtype=np.int64) for f in found]
        return bolts, [replace(f.group, bolt=bolt) for f, bolt in zip(found, at, strict=True)]

    def group(self, name: str, config: GroupConfig, first: int) -> Terms:
        """Terms of one group, which begin at column ``first`` of the terms of the model."""
        select, known = config.select, None if self.bolts is None else self.bolts.name
        ground: bool | None = None
        xyz: Floats | None
        file = select.positions or select.dofs or select.bushings
        if select.vectors is not None or select.left is not None:
            left, right, positions = self._vectors(name, config)
            xyz, labels, bolts = positions.xyz, positions.parameter, positions.bolt
        elif select.bushings is not None:
            left, xyz, bolts, ground = self._bushings(name, select.bushings, select.component)
            right, labels = left, None
        else:
            listed = self.term_dofs(name, config)
            left = right = unit_columns(listed.dof, self.n)
            xyz, labels, bolts, ground = listed.xyz, listed.parameter, listed.bolt, True
        m = left.shape[1]
        own = owners(m, labels, bolts, known, file)
        count = int(own.parameter.max()) + 1
        if xyz is not None:
            xyz = np.stack([xyz[own.parameter == k].mean(axis=0) for k in range(count)])
        along = arc_length(xyz) if xyz is not None and own.bolt is None else None
        if own.bolt is not None and config.smoothing is not None and sum(weight > 0 for weight in config.smoothing) > 1:
            hint = "remove smoothing"
            raise self.campaign.error("smoothing couples values of different bolts", "parameters", name, "smoothing", hint=hint)
        model = self.campaign.model.damping
        damping = _tied(config, model, own.bolt is not None)
        beta, loss_factor = (damping or GroupDampingConfig()).coefficients(model)
        group = TermGroup(
            name=name,
            config=config,
            terms=np.arange(first, first + m),
            parameter=own.parameter,
            xyz=xyz,
            arc_length=along,
            damping=damping,
            beta=beta,
            loss_factor=loss_factor,
        )
        self.notes.append(
            f"parameters {name}: {config.kind}, {m} terms, {count} parameters"
            # With jumps between edges, the total is not the length of an edge.
            + (f", {along[-1]:.3f} m along the edge" if along is not None and count > 1 and _one_edge(xyz) else "")
            + _damping_text(config, damping, own.bolt is not None)
        )
        return Terms(group=group, left=left, right=right, bolt=own.bolt, ground=ground)

    def _vectors(self, name: str, config: GroupConfig) -> tuple[sp.csc_array, sp.csc_array, Positions]:
        """Left and right vectors (n, m) of a group, and their positions."""
        select = config.select
        first = select.vectors or select.left
        assert first is not None
        assert select.positions is not None
        left = self.vectors(first, f"parameters.{name}")
        right = self.vectors(select.right, f"parameters.{name}") if select.right is not None else left
        positions = read_positions(select.positions, None if self.bolts is None else self.bolts.name)
        positions = replace(positions, xyz=positions.xyz * self.unit.length)
        self.table(select.positions)
        if self.dofs is not None:
            places = [("term", f"{k} of {name}") for k in range(positions.xyz.shape[0])]
            require_near(positions.xyz, places, self.dofs.xyz, file=select.positions)
        if left.shape != right.shape or positions.xyz.shape[0] != left.shape[1]:
            raise DataError(
                f"vectors and positions of {name} do not match",
                file=select.positions,
                expected=f"{left.shape[1]} terms in all files",
                found=f"{right.shape[1]} right vectors, {positions.xyz.shape[0]} positions",
            )
        empty = np.flatnonzero((np.diff(left.indptr) == 0) | (np.diff(right.indptr) == 0))
        if empty.size:
            raise DataError(f"vector {empty[0]} of {name} is empty", file=first.path)
        # If the DOF table is wrong, the places of the DOFs are wrong, not those of the terms.
        dofs = None if self.misplaced else self.dofs
        felt = (abs(left) + abs(right)).tocsc()
        beside = None if dofs is None else beside_their_dofs(positions.xyz, felt, dofs.xyz)
        if beside and self.axes and dofs is not None and not beside_their_dofs(positions.xyz[:, EXCHANGES[self.axes]], felt, dofs.xyz):
            self.table_exchanged = True
        elif beside:
            self.warn(f"parameters.{name}: the places in {select.positions.name} are {beside}")
        return left, right, positions

    def _bushings(self, name: str, file: Path, component: str | None) -> tuple[sp.csc_array, Floats, tuple[str, ...], bool | None]:
        """Vectors (n, m) of springs, positions (m, 3), bolts, and whether all go to ground (None: some do)."""
        keys = ("parameters", name, "select")
        # A campaign file with bushings but without DOF table was refused before.
        assert self.dofs is not None
        table = read_bushings(file, None if self.bolts is None else self.bolts.name)
        self.table(file)
        if component is not None:
            if component not in table.component:
                raise self.campaign.error(
                    "no bushing has this component",
                    *keys,
                    "component",
                    expected=f"one of {', '.join(dict.fromkeys(table.component))}",
                    found=component,
                )
            table = table.only(component)
        self.bushings.append(table)
        unit = self.unit
        turns = np.char.startswith(np.array(table.component), "ROT")
        table = replace(table, stiffness=table.stiffness * unit.force * np.where(turns, unit.length, 1.0 / unit.length))
        require_free(table, self.held)
        vectors, places = bushing_vectors(table, self.dofs)
        if not self.misplaced and (aside := aside_text(table, self.dofs)):
            self.warn(f"{file.name}: {aside}")
        check = partial(beside_their_springs, springs=places, owner=table.bolt, unit=self.unit.length)
        astray = None if self.bolts is None or self.misplaced else check(self.bolts)
        if self.bolts is not None and not self.misplaced:
            astray = renumbered_text(table, places, self.bolts, self.dofs, self.unit.length) or astray
        if astray and self.axes and self.bolts and not check(replace(self.bolts, xyz=self.bolts.xyz[:, EXCHANGES[self.axes]])):
            self.table_exchanged = True
        elif astray:
            self.beside.setdefault(astray, []).append(file.name)
        elif self.bolts is not None:
            misnamed = misnamed_springs(table, places, self.bolts)
            self.misnamed |= set(misnamed.values())
            stray = stray_springs(table, places, self.bolts, self.dofs, self.unit.length, misnamed=misnamed)
            self.strayed |= bool(stray)
            self.warn(*(f"{file.name}: {text}" for text in (misnamed_text(table, misnamed), stray) if text))
        if len(set(zip(table.bolt, table.component, strict=True))) > len(set(table.bolt)):
            self.notes.append(
                f"parameters {name}: springs of several components share one value for each bolt; the loss of one of them alone may stay "
                "unseen or come out smaller (a group for each component, `component:` beside `bushings:`, tells them apart)"
            )
        grounded = {node is None for node in table.node_b}
        return vectors, places, table.bolt, grounded.pop() if len(grounded) == 1 else None


def _places_of(found: Sequence[Terms], names: Sequence[str]) -> Floats | None:
    """(m, 3) mean place of the terms that each bolt owns, NaN where it owns none; None if none of them owns any."""
    places: dict[str, list[Floats]] = {}
    for terms in found:
        for k, name in enumerate(terms.bolt or ()):
            if terms.group.xyz is not None:
                places.setdefault(name, []).append(terms.group.xyz[k])
    nowhere = [np.full(3, np.nan)]
    return np.array([np.mean(places.get(name, nowhere), axis=0) for name in names]) if places.keys() & set(names) else None


def _one_edge(xyz: Floats | None) -> bool:
    """Whether positions follow one edge."""
    return xyz is not None and len(edges_of(xyz)) == 1 and is_line(xyz)
