"""Exports the reduced model for other programs: second-order form with separate terms, and state space at given parameters."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from lrbc_cli.campaign.identification.unknowns import start_parameters
from lrbc_cli.campaign.protect import require_new, require_no_input
from lrbc_cli.campaign.reading.inputs import Inputs
from lrbc_cli.campaign.reading.reader import LABELS
from lrbc_cli.campaign.reduced.stage import ReductionStage, frf_source
from lrbc_cli.campaign.simulate import job_values, parse_values
from lrbc_cli.config.structure import ProportionalDamping
from lrbc_cli.errors import ConfigError, DataError
from lrbc_cli.io.export import check_ending, is_export, write_export
from lrbc_cli.model.terms import Parameterisation
from lrbc_cli.reduction.reduced.model import ReducedModel
from lrbc_cli.reduction.reduced.statespace import HYSTERETIC, VISCOUS, complex_matrix, state_space
from lrbc_cli.results.store import versions

ENCODING = "lrbc-reduced-model"


def check_targets(files: Sequence[Path], inputs: Inputs, *, replace_foreign: bool = False) -> None:
    """Refuse, before anything is computed, target files that cannot be written.

    An earlier export is replaced, another existing file only with ``replace_foreign``.

    Raises
    ------
    ConfigError
        For an unknown ending, a folder, an input of the campaign, a file that is no export, or a folder that cannot be written.
    """
    for file in files:
        check_ending(file)
        require_no_input(file, inputs.campaign, "--export")
        folder = next(parent for parent in file.resolve().parents if parent.exists())
        problem = (
            "is a folder"
            if file.is_dir()
            else "lies below a file"
            if not folder.is_dir()
            else "lies in a folder that cannot be written"
            if not os.access(folder, os.W_OK)
            else None
        )
        if problem:
            raise ConfigError(f"the file cannot be written: it {problem}", file=file, place="--export", hint="give another place")
        if not replace_foreign and not is_export(file, ENCODING):
            require_new(file, "--export", "--overwrite")


def require_real(inputs: Inputs) -> None:
    """Refuse, before anything is computed, a state space of a model without real first-order form.

    Raises
    ------
    DataError
        For complex matrices, and for loss factors of the model or of a group.
    """
    config, name = inputs.campaign.model, complex_matrix(inputs.model)
    factors = [f"parameters.{group.name}.damping" for group in inputs.groups if group.damping is not None and group.loss_factor]
    if isinstance(config.damping, ProportionalDamping) and (config.damping.structure.loss_factor or config.damping.acoustic.loss_factor):
        factors.insert(0, "model.damping")
    if name or factors:
        raise DataError(
            HYSTERETIC.format(name or "stiffness"),
            file=inputs.campaign.path if factors else getattr(config.stiffness if name == "stiffness" else config.damping, "path", None),
            place="--state-space",
            expected="real matrices and viscous damping",
            found=f"a loss factor in {factors[0]}" if factors else f"a complex {name} matrix",
            hint=VISCOUS,
        )


def export(
    inputs: Inputs,
    stage: ReductionStage,
    files: Sequence[Path],
    *,
    first_order: bool = False,
    replace_foreign: bool = False,
    job: str | None = None,
    assignments: Sequence[str] = (),
) -> list[dict[str, Any]]:
    """Write the reduced model to each file.

    Parameters
    ----------
    inputs : Inputs
    stage : ReductionStage
    files : sequence of Path
        ``.h5``, ``.hdf5`` or ``.mat``.
    first_order : bool
        Add the state space.
    replace_foreign : bool
        Also replace files that are no earlier exports.
    job, assignments
        Parameters of the state space, as for ``simulate``; start values otherwise.

    Returns
    -------
    list of dict
        Name and content of each file.

    Raises
    ------
    ConfigError
        If a file cannot be written, or parameters or job do not exist.
    DataError
        If the job has no usable result.
    NumericalError
        If there is no real first-order form.
    """
    check_targets(files, inputs, replace_foreign=replace_foreign)
    parameters = start_parameters(inputs, frf_source(inputs, stage))
    tree = second_order(inputs, stage, parameters)
    told: dict[str, Any] = {}
    if first_order:
        tree["state_space"], told = _first_order(inputs, stage, parameters, job, assignments)
    out = []
    for file in dict.fromkeys(files):
        try:
            write_export(file, tree, ENCODING)
        except OSError as error:
            raise ConfigError(f"the file cannot be written ({error.strerror or error})", file=file, place="--export") from error
        out.append({"file": file, "size": stage.reduction.model.size} | ({"state_space": told} if told else {}))
    return out


def second_order(inputs: Inputs, stage: ReductionStage, parameters: Parameterisation) -> dict[str, Any]:
    """The reduced model with terms, start values, responses and certificate as a tree; layout: ``lrbc guide formats``."""
    reduction, model = stage.reduction, stage.reduction.model
    damped = [group for group in parameters.groups if group.damping]
    return {
        "second_order": {
            "K": model.K,
            "C": model.C,
            "M": model.M,
            "B": model.B[:, : len(inputs.excitations)],
            "L": model.L,
            "output_power": model.output_power,
        },
        "terms": _terms(inputs, model, parameters),
        "parameters": {
            "name": _texts([f"{group.name}.{k + 1}" for group in parameters.groups for k in range(group.count)]),
            "group": _texts([group.name for group in parameters.groups for _ in range(group.count)]),
            "initial_log10": np.concatenate([group.initial for group in parameters.groups]),
            "xyz": np.vstack([np.full((group.count, 3), np.nan) if group.xyz is None else group.xyz for group in parameters.groups]),
        },
        "damping_exponents": {
            "group": _texts([group.name for group in damped]),
            "initial": np.array([group.damping.initial for group in damped if group.damping]),
        },
        "responses": _responses(inputs),
        "excitations": _excitations(inputs),
        "reduction": {
            "size": model.size,
            "size_structure": model.structure,
            "size_acoustic": model.size - model.structure,
            "full_size": reduction.full_size,
            "band_hz": np.array(reduction.options.band_hz),
            "tolerance": reduction.options.tolerance,
            "reached": reduction.reached,
            "worst_error": reduction.worst,
            "held_out_hz": np.array([line.frequency_hz for line in reduction.held_out]),
            "held_out_error": np.array([line.worst for line in reduction.held_out]),
            "symmetry": reduction.coupling,
        },
        "provenance": {
            "campaign": inputs.campaign.name,
            "key": stage.decision.key,
            "date": reduction.date,
            "version": versions()["lrbc"],
            "calibration": inputs.calibration.text if inputs.calibration is not None else "",
            "inputs": _texts([Path(name).name for name in inputs.hashes]),
            "sha256": _texts(list(inputs.hashes.values())),
        },
    }


def _terms(inputs: Inputs, model: ReducedModel, parameters: Parameterisation) -> dict[str, Any]:
    """The low-rank terms: vectors (r, nt), weights (nt, k) of the parameters, and damping."""
    nt = model.terms
    weights = np.zeros((nt, sum(group.count for group in parameters.groups)))
    beta, loss_factor = np.zeros((2, nt))
    kinds, owners = np.empty(nt, dtype=object), np.empty(nt, dtype=object)
    first = 0
    for group in parameters.groups:
        weights[group.terms, first : first + group.count] = group.smoothing[group.parameter]
        if group.damping:
            beta[group.terms], loss_factor[group.terms] = group.damping.beta, group.damping.loss_factor
        kinds[group.terms], owners[group.terms] = group.kind, group.name
        first += group.count
    return {
        "left": model.left,
        "right": model.right,
        "kind": _texts(kinds),
        "power": inputs.model.terms.power,
        "group": _texts(owners),
        "weights": weights,
        "baseline": inputs.model.terms.baseline,
        "damping_beta": beta,
        "damping_loss_factor": loss_factor,
    }


def _responses(inputs: Inputs) -> dict[str, Any]:
    responses = inputs.responses
    return {
        "name": _texts([r.name for r in responses]),
        "quantity": _texts([r.quantity for r in responses]),
        "unit": _texts([r.own_unit for r in responses]),
        "excitation": _texts([inputs.excitations[r.input] for r in responses]),
        "node": np.array([-1 if r.node is None else r.node for r in responses], dtype=np.int64),
        "component": _texts([_component(r.direction) for r in responses]),
        "place": _texts([r.text for r in responses]),
    }


def _first_order(
    inputs: Inputs, stage: ReductionStage, parameters: Parameterisation, job: str | None, assignments: Sequence[str]
) -> tuple[dict[str, Any], dict[str, Any]]:
    """State space as in the file, and a summary (form, states, deviation, stability)."""
    theta = parse_values(assignments, parameters, parameters.initial if job is None else job_values(inputs, job, parameters))
    # Without the further loads for hammer offsets.
    model = replace(stage.reduction.model, B=stage.reduction.model.B[:, : len(inputs.excitations)])
    system = state_space(model, parameters.polynomial(theta), inputs.campaign.reduction.band)
    form = "explicit" if system.E is None else "descriptor"
    told = {"deviation": system.deviation, "spectral_abscissa": system.abscissa, "unstable_poles": system.unstable}
    matrices = {name: getattr(system, name) for name in ("A", "B", "C", "D", "E", "basis") if getattr(system, name) is not None}
    given = "start values" if job is None else f"job {job}"
    tree = {
        "form": form,
        **matrices,
        "log10": np.concatenate([theta[where] for _, where, _ in parameters.placed]),
        "damping_exponent": np.array([theta[at] for _, _, at in parameters.placed if at is not None]),
        "source": ", ".join([given, *(f"--set {text}" for text in assignments)]),
        "poles": system.poles,
        **told,
    }
    return tree, {"form": form, "states": system.states, **told}


def _excitations(inputs: Inputs) -> dict[str, Any]:
    places, quantities, units = [], [], []
    for column, (name, (node, direction)) in enumerate(zip(inputs.excitations, inputs.excitation_points, strict=True)):
        point = inputs.campaign.excitation[name]
        load = inputs.model.B[:, [column]].indices
        air, motion = inputs.model.is_acoustic[load].any(), not inputs.model.is_acoustic[load].all()
        turns = direction is not None and direction > 3
        # Acoustic sources have the unit in which the exporter writes acoustic rows.
        quantities.append("load" if air and motion else "acoustic source" if air else "moment" if turns else "force")
        units.append("" if air else "N m" if turns else "N")
        if point.vector is not None:
            places.append(f"vector {point.vector.path.name}")
        elif node is not None:
            places.append(f"node {node} {_component(direction)}".strip())
        else:
            places.append(f"DOF {point.dof}")
    return {
        "name": _texts(inputs.excitations),
        "quantity": _texts(quantities),
        "unit": _texts(units),
        "node": np.array([-1 if node is None else node for node, _ in inputs.excitation_points], dtype=np.int64),
        "component": _texts([_component(direction) for _, direction in inputs.excitation_points]),
        "place": _texts(places),
    }


def _component(direction: int | None) -> str:
    return "" if direction is None else LABELS.get(direction, "")


def _texts(values: Sequence[str] | Any) -> Any:
    return np.array(list(values), dtype=np.str_)
