"""Measurements of a user's own model with loosened bolts: what a campaign would find, before anything is built."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import scipy.sparse as sp
import yaml

from lrbc_cli.campaign.inputs import Inputs
from lrbc_cli.campaign.stage import FrfSource, cheaper_formula, obtain_reduction
from lrbc_cli.campaign.unknowns import parameterise
from lrbc_cli.config.structure import RecordRef
from lrbc_cli.errors import ConfigError, DataError, NumericalError
from lrbc_cli.io.frf import write_frf
from lrbc_cli.model.fem import FeModel
from lrbc_cli.model.frf import FrfRecord, FrfSet
from lrbc_cli.model.terms import Parameterisation
from lrbc_cli.reduction.build import ReductionOptions, reduce_model
from lrbc_cli.reduction.ports import PortFrf
from lrbc_cli.updating.verdicts import Edge, foot, pitch_of
from rigs.chain import Chain
from rigs.design import Array
from rigs.drift import Drift, Scatter

#: Axes of a translation's plane, in which a hit may be off; and of its own direction.
AXES = {"UX": 0, "UY": 1, "UZ": 2}
ROTATIONS = ("ROTX", "ROTY", "ROTZ")
NEIGHBOURS = 8


@dataclass(frozen=True)
class Settings:
    """What is simulated.

    Attributes
    ----------
    depth : float
        Decades by which the stiffness at a loose bolt is lowered.
    reach : float or None
        Radius of a bolt's patch along the edge [m]; None: half the bolt pitch.
    level : float or None
        log10 of a tight term; None: the campaign's start value.
    noise : float
        Of a response line relative to its root mean square; half of it on the force.
    retorque : float
        Standard deviation of the log stiffness of tight bolts from job to job.
    perturb : float
        Standard deviation of the factors on structural stiffness, structural mass and air stiffness.
    damping : float
        Of the factors on the damping of structure and air.
    scatter : Scatter
    """

    depth: float = 2.0
    reach: float | None = None
    level: float | None = None
    noise: float = 0.004
    retorque: float = 0.08
    perturb: float = 0.005
    damping: float = 0.1
    scatter: Scatter = field(default_factory=Scatter)


def scaled(matrix: sp.csc_array, acoustic: np.ndarray, structure: float, air: float) -> sp.csc_array:
    """A matrix with the blocks of both fields multiplied, their coupling left alone."""
    coo = matrix.tocoo()
    row, column = acoustic[coo.row], acoustic[coo.col]
    factor = np.where(row != column, 1.0, np.where(row, air, structure))
    return sp.csc_array(sp.coo_array((factor * coo.data, (coo.row, coo.col)), shape=matrix.shape))


def patches(inputs: Inputs, reach: float | None) -> dict[str, dict[str, Array]]:
    """Share of each bolt in each parameter of the stiffness groups near it.

    Returns
    -------
    dict
        By bolt and group: (k,) weights ``exp(-(r / reach)^4)``, r along the edge, summing to at most 1 over the bolts.

    Raises
    ------
    ConfigError
        Where there are no bolts, or no stiffness groups with positions.
    """
    campaign, bolts = inputs.campaign, inputs.bolts
    groups = [g for g in inputs.groups if g.config.kind == "stiffness" and g.xyz is not None and g.arc_length is not None]
    if bolts is None or not groups:
        raise ConfigError(
            "bolts cannot be loosened" + (": the campaign has none" if bolts is None else ": no stiffness group has positions"),
            file=campaign.path,
            expected="bolts: a CSV file, and a group of kind stiffness whose terms have coordinates",
        )
    reach = reach or 0.5 * pitch_of(bolts.xyz)
    weights: dict[str, dict[str, Array]] = {name: {} for name in bolts.name}
    for name, xyz in zip(bolts.name, bolts.xyz, strict=True):
        feet = {}
        for group in groups:
            assert group.xyz is not None
            assert group.arc_length is not None
            feet[group.name] = foot(Edge(group.xyz, group.arc_length, np.zeros(group.count), np.inf, None), xyz)
        nearest = min(distance for _, distance in feet.values())
        for group in groups:
            at, distance = feet[group.name]
            if distance <= nearest + 0.5 * (reach or 0.0):
                along = np.abs(np.asarray(group.arc_length) - at)
                weights[name][group.name] = np.exp(-((along / reach) ** 4)) if reach else np.ones(group.count)
    for group in groups:
        total = np.sum([w[group.name] for w in weights.values() if group.name in w], axis=0)
        for w in weights.values():
            if group.name in w:
                w[group.name] = w[group.name] / np.maximum(total, 1.0)
    return weights


def moved_load(inputs: Inputs, offset: tuple[float, float]) -> sp.csc_array:
    """Loads (n, n_in) with every hit moved within the plane that it hits, along the axes that follow its own (UZ: x, y).

    A node with rotations gets the moment of the offset; otherwise the force spreads over the nearest nodes so that it does the work of the
    deflection continued by its least-squares gradient.

    Raises
    ------
    ConfigError
        Where an excitation is not a translation of the DOF table.
    """
    model, table = inputs.model, inputs.dofs
    columns = []
    for index, name in enumerate(inputs.excitations):
        column = sp.csc_array(model.B[:, [index]])
        dof = int(column.indices[0])
        axis = AXES.get(str(table.component[dof])) if table is not None and column.nnz == 1 else None
        if table is None or axis is None:
            raise ConfigError(
                "this hit cannot be moved",
                file=inputs.campaign.path,
                place=f"excitation.{name}",
                expected="a DOF UX, UY or UZ of the DOF table",
                hint="leave out --hammer",
            )
        force = np.zeros(3)
        force[axis] = column.data[0]
        shift = np.zeros(3)
        shift[[(axis + 1) % 3, (axis + 2) % 3]] = offset
        moment = np.cross(shift, force)
        dense = np.zeros(model.size)
        dense[dof] = force[axis]
        here = {str(c): int(d) for d, c in enumerate(table.component) if table.node[d] == table.node[dof] and d != dof}
        needed = [k for k in range(3) if k != axis]
        if all(ROTATIONS[k] in here for k in needed):
            for k in needed:
                dense[here[ROTATIONS[k]]] += moment[k]
        else:
            same = np.flatnonzero((table.component == table.component[dof]) & (table.node != table.node[dof]))
            near = same[np.argsort(np.linalg.norm(table.xyz[same] - table.xyz[dof], axis=1))[:NEIGHBOURS]]
            away = table.xyz[near] - table.xyz[dof]
            # w(shift) = w + shift . gradient, gradient = pinv(away) (w_near - w)
            share = shift @ np.linalg.pinv(away, rcond=1e-6) * force[axis]
            np.add.at(dense, near, share)
            dense[dof] -= share.sum()
        columns.append(sp.csc_array(dense[:, None]))
    return sp.csc_array(sp.hstack(columns, format="csc"))


class Rehearsal:
    """A user's model as it might turn out, measured with some bolts loose.

    Parameters
    ----------
    inputs : Inputs
        Of the user's campaign.
    settings : Settings
    seed : int
    cache : Path
        Folder of reduced models of the user's own model, as of ``lrbc``.
    frequencies : (f,) array
        Lines [Hz].
    progress : callable
    """

    def __init__(
        self, inputs: Inputs, settings: Settings, seed: int, cache: Path, frequencies: Array, progress: Callable[[str], None]
    ) -> None:
        self.inputs, self.settings, self.seed, self.progress = inputs, settings, seed, progress
        self.frequencies, self.s = frequencies, 2j * np.pi * frequencies
        rng, *streams = (np.random.default_rng(child) for child in np.random.SeedSequence(seed).spawn(4))
        self._settle, self._noise, self._drift = streams
        self.patches = patches(inputs, settings.reach)
        stage = obtain_reduction(inputs, cache, progress=progress)
        self.parameters: Parameterisation = parameterise(inputs, FrfSource(inputs, stage, cheaper_formula(inputs, stage)), self.s)[0]
        acoustic = bool(inputs.model.is_acoustic.any())
        if settings.scatter.kelvin and not acoustic:
            raise ConfigError("the model has no air to warm", place="--kelvin", expected="DOFs PRES", hint="leave out --kelvin")
        draw = rng.standard_normal(5)
        self.factors = {
            "stiffness.structure": float(1 + settings.perturb * draw[0]),
            "mass.structure": float(1 + settings.perturb * draw[1]),
            "stiffness.acoustic": float(1 + settings.perturb * draw[2]) if acoustic else 1.0,
            "damping.structure": float(np.exp(settings.damping * draw[3])),
            "damping.acoustic": float(np.exp(settings.damping * draw[4])) if acoustic else 1.0,
        }
        self._ports: dict[tuple[float, tuple[float, float]], PortFrf] = {}

    def model(self, drift: Drift) -> FeModel:
        """The model of one job, without its terms."""
        given, f = self.inputs.model, self.factors
        terms, acoustic = given.terms, given.is_acoustic
        # What K holds of the joints is not part of what is off.
        held = np.where(terms.power == 0, terms.baseline, 0.0) * (1 - f["stiffness.structure"])
        # Warm air: int grad p . grad q / rho grows, rho c^2 stays; the row of an exporter that multiplied it by rho is the same.
        K = scaled(given.K, acoustic, f["stiffness.structure"], f["stiffness.acoustic"] * drift.warming)
        return replace(
            given,
            K=sp.csc_array(K + (terms.left * held[None, :]) @ terms.right.T),
            M=scaled(given.M, acoustic, f["mass.structure"], 1.0),
            C=scaled(given.C, acoustic, f["damping.structure"], f["damping.acoustic"]),
            B=moved_load(self.inputs, drift.hammer) if any(drift.hammer) else given.B,
        )

    def _table(self, drift: Drift) -> PortFrf:
        key = drift.kelvin, drift.hammer
        if key not in self._ports:
            settings = self.inputs.campaign.reduction
            options = ReductionOptions(settings.band, settings.tolerance, settings.held_out, max_size=settings.max_size)
            reduction = reduce_model(self.model(drift), self.inputs.input_of, options, backend=settings.backend, progress=self.progress)
            if not reduction.reached:
                raise NumericalError(
                    "the reduced model does not reach its tolerance", expected=f"{options.tolerance:.1e}", found=f"{reduction.worst:.1e}"
                )
            self._ports[key] = reduction.model.ports(self.s)
        return self._ports[key]

    def profile(self, removed: Sequence[str]) -> tuple[np.ndarray, dict[str, Any], dict[str, float]]:
        """Dynamic values (f, nt) of the terms, log10 of each parameter by group, and each bolt's change [decades]."""
        settings = self.settings
        change = {}
        for name in self.patches:
            scatter = settings.retorque * float(self._settle.standard_normal()) / np.log(10)
            change[name] = -settings.depth if name in removed else scatter
        theta = self.parameters.initial
        D = self.parameters.spectra(theta, self.s)
        kappa = np.zeros(self.parameters.terms)
        values: dict[str, Any] = {}
        for group, (where, _) in zip(self.parameters.groups, self.parameters.slices, strict=True):
            level = theta[where].copy()
            if group.kind == "stiffness":
                if settings.level is not None:
                    level[:] = settings.level
                for name, share in self.patches.items():
                    level = level + change[name] * share.get(group.name, 0.0)
            kappa[group.terms] = 10.0 ** level[group.parameter]
            values[group.name] = [round(float(v), 4) for v in level]
        return D * kappa - self.parameters.baseline(self.s), values, change

    def measure(self, removed: Sequence[str]) -> tuple[FrfSet, dict[str, Any]]:
        """FRFs of one job with noise and coherence, and what was drawn for it."""
        inputs, settings = self.inputs, self.settings
        drift = settings.scatter.draw([r.name for r in inputs.responses], self._drift)
        D, values, change = self.profile(removed)
        frfs = self._table(drift).evaluate(D) * drift.gains([r.name for r in inputs.responses])
        low, high = inputs.campaign.reduction.band
        # As in the SoundBox: the pulse has lost 10 dB at the end of the band, noise rises at its beginning.
        chain = Chain(duration=1 / high, force_noise=settings.noise / 2, response_noise=settings.noise, corner=1.25 * low)
        records: list[FrfRecord | None] = [None] * len(inputs.responses)
        for index in range(len(inputs.excitations)):
            rows = np.flatnonzero(inputs.input_of == index)
            estimate, coherence = chain.measure(frfs[:, rows], self.frequencies, self._noise)
            for k, row in enumerate(rows):
                records[row] = self._record(int(row), estimate[:, k], coherence[:, k])
        removal = {"removed": list(removed), "decades": {name: round(value, 4) for name, value in change.items()}, "log10": values}
        return FrfSet("rehearsal", tuple(r for r in records if r is not None)), removal | {"drift": drift.as_dict()}

    def _record(self, row: int, values: np.ndarray, coherence: Array) -> FrfRecord:
        response = self.inputs.responses[row]
        called = self.inputs.campaign.responses[response.name].record
        node, direction = response.node, response.direction or 0
        if isinstance(called, RecordRef):
            node, direction = called.node, called.direction
        hammer, along = self.inputs.excitation_points[response.input]
        return FrfRecord(
            called if isinstance(called, str) else response.name,
            self.frequencies,
            values,
            response.quantity,
            response_node=node,
            response_direction=direction,
            reference_node=hammer,
            reference_direction=along or 0,
            coherence=coherence,
        )


def job_list(inputs: Inputs, tight: int, loose: Sequence[str]) -> dict[str, list[str]]:
    """Loosened bolts by job: the tight ones first, the first of them under the name of the campaign's reference.

    Raises
    ------
    ConfigError
        Where a bolt does not exist.
    """
    first = inputs.campaign.update.reference or "tight"
    jobs: dict[str, list[str]] = {first: []} | {f"tight-{k}": [] for k in range(2, tight + 1)}
    known = inputs.bolts.name if inputs.bolts else ()
    for text in loose:
        names = [name.strip() for name in text.split(",")]
        if unknown := [name for name in names if name not in known]:
            raise ConfigError(
                "no such bolt", place=f"--loose {text}", expected=", ".join(known) or "bolts in the campaign", found=", ".join(unknown)
            )
        jobs["loose-" + "-".join(names)] = names
    return jobs


def campaign_tree(inputs: Inputs, jobs: Mapping[str, Sequence[str]]) -> dict[str, Any]:
    """The user's campaign file with other jobs; its paths are absolute, so that it can lie anywhere."""
    tree: dict[str, Any] = inputs.campaign.model_dump(mode="json", by_alias=True, exclude_unset=True)
    tree["campaign"] = f"{tree['campaign']} (rehearsal)"
    tree["output"] = "output"
    tree["update"] = tree.get("update", {}) | {"reference": next(iter(jobs))}
    tree["jobs"] = {job: {"frf": f"frf/{job}.uff"} | ({"removed": list(removed)} if removed else {}) for job, removed in jobs.items()}
    return tree


def rehearse(rehearsal: Rehearsal, jobs: Mapping[str, Sequence[str]], out: Path) -> None:
    """Write measurements, campaign file and ``truth.json``.

    Raises
    ------
    DataError
        Where the folder cannot be written.
    """
    drawn = {}
    try:
        (out / "frf").mkdir(parents=True, exist_ok=True)
        for job, removed in jobs.items():
            frf, drawn[job] = rehearsal.measure(removed)
            write_frf(out / "frf" / f"{job}.uff", frf)
        settings = {key: value for key, value in vars(rehearsal.settings).items() if key != "scatter"}
        truth = {"seed": rehearsal.seed, "settings": settings, "factors": rehearsal.factors, "jobs": drawn}
        (out / "truth.json").write_text(json.dumps(truth, indent=1) + "\n", encoding="utf-8", newline="\n")
        text = yaml.safe_dump(campaign_tree(rehearsal.inputs, jobs), sort_keys=False, allow_unicode=True, width=120)
        (out / "campaign.yaml").write_text(text, encoding="utf-8", newline="\n")
    except OSError as error:
        raise DataError(f"the folder cannot be written ({error.strerror or error})", file=out, place="--out") from error
