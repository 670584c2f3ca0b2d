"""The virtual structure of a rehearsal: the user's model with slightly wrong materials and loosened joints, measured by a noisy chain."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import scipy.sparse as sp

from lrbc_cli.arrays import Complexes, Floats
from lrbc_cli.campaign.identification.unknowns import parameterise
from lrbc_cli.campaign.planning.patches import patches
from lrbc_cli.campaign.reading.inputs import Inputs
from lrbc_cli.campaign.reduced.memory import options_of
from lrbc_cli.campaign.reduced.stage import frf_source, obtain_reduction
from lrbc_cli.config.structure import RecordRef
from lrbc_cli.errors import ConfigError, NumericalError
from lrbc_cli.model.factors import SOUND_SPEED, with_factors
from lrbc_cli.model.fem import FeModel
from lrbc_cli.model.frf import FrfRecord, FrfSet
from lrbc_cli.model.shifts import load_shifts
from lrbc_cli.reduction.build import reduce_model
from lrbc_cli.reduction.reduced.many import ports_of
from lrbc_cli.reduction.reduced.ports import PortFrf
from lrbc_cli.virtual.chain import Chain
from lrbc_cli.virtual.drift import Drift, Scatter


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Settings of a simulated structure and its measurement.

    Attributes
    ----------
    depth : float
        Loss of stiffness at a loose bolt [decades].
    reach : float or None
        Radius of the part of the edge that a bolt clamps [m]; None: half the bolt pitch.
    level : float or None
        log10 stiffness of a tight term; None: the start value of the campaign.
    noise : float
        Noise of a response spectrum relative to its root mean square; half of it acts on the force.
    retorque : float
        Standard deviation of the natural logarithm of the stiffness of tight bolts from job to job.
    perturb : float
        Standard deviation of the factors on structural stiffness, structural mass and air stiffness.
    damping : float
        Standard deviation of the natural logarithm of the factors on the damping of structure and air.
    scatter : Scatter
        Drift between jobs.
    """

    depth: float = 2.0
    reach: float | None = None
    level: float | None = None
    noise: float = 0.004
    retorque: float = 0.08
    perturb: float = 0.005
    damping: float = 0.1
    scatter: Scatter = field(default_factory=Scatter)


def moved_loads(inputs: Inputs, offset: tuple[float, float]) -> sp.csc_array:
    """Load matrix (n, n_in) with every hit moved by `offset` [m] along the two axes of its surface, in the order x, y, z.

    Raises
    ------
    ConfigError
        If an excitation is not a single translational DOF of the DOF table.
    """
    table, columns = inputs.dofs, []
    for index, name in enumerate(inputs.excitations):
        load = sp.csc_array(inputs.model.B[:, [index]])
        found = load_shifts(table, int(load.indices[0])) if table is not None and load.nnz == 1 else None
        if found is None:
            raise ConfigError(
                "the hammer point of this excitation cannot be moved",
                file=inputs.campaign.path,
                place=f"excitation.{name}",
                expected="a DOF UX, UY or UZ of the DOF table",
                hint="give --hammer 0",
            )
        columns.append(load + sp.csc_array(load.data[0] * (found[0] @ np.asarray(offset))[:, None]))
    return sp.csc_array(sp.hstack(columns, format="csc"))


class VirtualStructure:
    """The user's model with randomly perturbed materials and damping, measured with some bolts loose.

    Parameters
    ----------
    inputs : Inputs
        Those of the user's campaign, without a stored calibration.
    settings : Settings
    seed : int
    cache : Path
        Folder of the cached reduced model of the user's own model.
    frequency_hz : (F,) array
        Lines [Hz].
    progress : callable

    Raises
    ------
    ConfigError
        If bolts cannot be loosened, or the air temperature is to drift in a model without air.
    """

    def __init__(
        self,
        inputs: Inputs,
        settings: Settings,
        seed: int,
        cache: Path,
        frequency_hz: Floats,
        progress: Callable[[str], None] = lambda _: None,
    ) -> None:
        self.inputs, self.settings, self.seed, self.progress = inputs, settings, seed, progress
        self.frequency_hz, self.s = frequency_hz, 2j * np.pi * frequency_hz
        rng, self._settle, self._noise, self._drift = (np.random.default_rng(child) for child in np.random.SeedSequence(seed).spawn(4))
        self.patches = patches(inputs, settings.reach)
        if settings.scatter.kelvin and SOUND_SPEED not in inputs.recipe.names:
            raise ConfigError("the model has no air DOFs", place="--temperature", expected="DOFs PRES", hint="give --temperature 0")
        stage = obtain_reduction(inputs, cache, progress=progress)
        self.parameters = parameterise(inputs, frf_source(inputs, stage), self.s)[0]
        draw = rng.standard_normal(5)
        damped = np.exp(settings.damping * draw[3:])
        undamped = ("stiffness.structure", "mass.structure", "stiffness.acoustic")
        drawn = {name: float(1 + settings.perturb * d) for name, d in zip(undamped, draw, strict=False)}
        for kind in ("damping", "alpha", "beta", "loss_factor"):
            drawn |= {f"{kind}.structure": float(damped[0]), f"{kind}.acoustic": float(damped[1])}
        self.factors = {name: value for name, value in drawn.items() if name in inputs.recipe.names}
        self._ports: dict[tuple[object, ...], PortFrf] = {}

    def model(self, drift: Drift) -> FeModel:
        """Full model of one job with perturbed materials and drift; the joints are not perturbed here, see ``profile``."""
        moved = {name: self.factors.get(name, 1.0) * value for name, value in drift.factors.items()}
        air = {SOUND_SPEED: float(np.sqrt(drift.warming))} if drift.kelvin else {}
        model, _ = with_factors(self.inputs.model, self.inputs.recipe, self.factors | moved | air)
        return replace(model, B=moved_loads(self.inputs, drift.hammer) if any(drift.hammer) else model.B[:, : len(self.inputs.excitations)])

    def _table(self, drift: Drift) -> PortFrf:
        key = drift.kelvin, drift.hammer, tuple(drift.factors.items())
        if key not in self._ports:
            options, backend = options_of(self.inputs), self.inputs.campaign.reduction.backend
            reduction = reduce_model(self.model(drift), self.inputs.input_of, options, backend=backend, progress=self.progress)
            if not reduction.reached:
                raise NumericalError(
                    "the reduced model of the virtual structure does not reach its tolerance",
                    expected=f"{options.tolerance:.1e}",
                    found=f"{reduction.worst:.1e}",
                    hint="increase reduction.tolerance",
                )
            self._ports[key] = ports_of(reduction.model, self.s)
        return self._ports[key]

    def profile(self, removed: Sequence[str]) -> tuple[Complexes, dict[str, list[float]], dict[str, float]]:
        """Dynamic values of the terms (F, nt), log10 of the parameters by group, and change of each bolt [decades]."""
        settings = self.settings
        change = {}
        for name in self.patches:
            scatter = settings.retorque * float(self._settle.standard_normal()) / np.log(10)
            change[name] = -settings.depth if name in removed else scatter
        theta = self.parameters.initial
        D = self.parameters.spectra(theta, self.s)
        kappa = np.zeros(self.parameters.terms)
        values: dict[str, list[float]] = {}
        for group, where, _ in self.parameters.placed:
            level = theta[where].copy()
            if group.kind == "stiffness":
                if settings.level is not None:
                    level[:] = settings.level
                for name, share in self.patches.items():
                    level = level + change[name] * share.get(group.name, 0.0)
            kappa[group.terms] = 10.0 ** level[group.parameter]
            values[group.name] = [round(float(v), 4) for v in level]
        return D * kappa, values, change

    def measure(self, removed: Sequence[str]) -> tuple[FrfSet, dict[str, Any]]:
        """Noisy FRFs and coherence of one job, and what was drawn for it (see ``RehearsedJob``)."""
        inputs, noise = self.inputs, self.settings.noise
        names = [response.name for response in inputs.responses]
        drift = self.settings.scatter.draw(names, self._drift)
        D, values, change = self.profile(removed)
        frfs = self._table(drift).evaluate(D) * drift.gains(names)
        low, high = inputs.campaign.reduction.band
        # The force spectrum falls by 10 dB up to the end of the band; noise rises at its beginning.
        chain = Chain(duration=1 / high, force_noise=noise / 2, response_noise=noise, corner=1.25 * low)
        measured, coherence = np.empty(frfs.shape, dtype=complex), np.empty(frfs.shape)
        for index in range(len(inputs.excitations)):
            rows = np.flatnonzero(inputs.input_of == index)
            measured[:, rows], coherence[:, rows] = chain.measure(frfs[:, rows], self.frequency_hz, self._noise)
        records = tuple(self._record(row, measured[:, row], coherence[:, row]) for row in range(len(names)))
        decades = {name: round(value, 4) for name, value in change.items()}
        return FrfSet(source="rehearsal", records=records), {
            "removed": list(removed),
            "decades": decades,
            "log10": values,
            "drift": drift.as_dict(),
        }

    def _record(self, row: int, values: Complexes, coherence: Floats) -> FrfRecord:
        response = self.inputs.responses[row]
        called = self.inputs.campaign.responses[response.name].record
        node, direction = response.node, response.direction or 0
        if isinstance(called, RecordRef):
            node, direction = called.node, called.direction
        hammer, along = self.inputs.excitation_points[response.input]
        if isinstance(called, RecordRef) and called.reference_node is not None:
            hammer, along = called.reference_node, called.reference_direction or along
        return FrfRecord(
            name=called if isinstance(called, str) else response.name,
            frequency_hz=self.frequency_hz,
            values=np.asarray(values, dtype=np.complex128),
            quantity=response.quantity,
            response_node=node,
            response_direction=direction,
            reference_node=hammer,
            reference_direction=along or 0,
            coherence=coherence,
        )
