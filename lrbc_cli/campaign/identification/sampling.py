"""Posterior of the changes at bolts of one job: poses the mixture problem (tight or loose bolts) about the fit, and samples it.

Nuisance parameters and the error of the reference state are marginalised. Guide page *statistics*, section 6.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from lrbc_cli.arrays import Bools, Floats, Integers
from lrbc_cli.campaign.identification.found import Fit
from lrbc_cli.campaign.reading.inputs import Inputs
from lrbc_cli.model.terms import Parameterisation
from lrbc_cli.updating.misfit.cost import ChangeError, Misfit
from lrbc_cli.updating.misfit.frf import FrfModel, level_factor
from lrbc_cli.updating.posterior.confidence import beyond_errors, open_values
from lrbc_cli.updating.posterior.fit import Posterior
from lrbc_cli.updating.posterior.mixture import Data, MixtureProblem, SpringLoss, SpringLosses, Springs
from lrbc_cli.updating.posterior.samples import ChangeSamples
from lrbc_cli.updating.posterior.sampling import sample_changes
from lrbc_cli.updating.search.descent import Level
from lrbc_cli.updating.unknowns.places import pitch_of
from lrbc_cli.updating.unknowns.shapes import neighbours
from lrbc_cli.updating.unknowns.springs import SpringsOf


def changes_of(
    inputs: Inputs,
    plain: Misfit,
    knowledge: Posterior,
    jacobian: Floats,
    state: Floats | None,
    error: ChangeError | None = None,
    ends: Sequence[Floats] = (),
    *,
    least: float = 1e-10,
) -> ChangeSamples | None:
    """Samples of the changes at the bolts under the mixture prior, linearised about the fit.

    Parameters
    ----------
    inputs : Inputs
    plain : Misfit
        Cost without nuisance parameters; its prior is the reference state.
    knowledge : Posterior
        Of the fit with a Gaussian prior: gives the noise and the start.
    jacobian : (n, m + k) float array
        Derivatives of the residuals at the fit with respect to m unknowns and k nuisance parameters.
    state : (size, size) float array or None
        Covariance of the reference state; None if the comparison is free of its error.
    error : ChangeError or None
        Error of predicted changes; zero in the tight state, which changes nothing.
    ends : sequence of (size,) float array
        Theta at the ends of other descents: further starts of the search for the most probable state.
    least : float
        Eigenvalues of ``state`` below this share of the largest are taken as zero.

    Returns
    -------
    ChangeSamples or None
        None if the prior is no mixture or the unknowns are no changes at bolts.
    """
    shapes = knowledge.shapes
    if not inputs.method.mixture or inputs.bolts is None or not shapes.by_bolt:
        return None
    parameters, prior, bolts = plain.model.parameters, plain.prior, inputs.bolts.xyz
    level = Level(plain, prior, shapes.T)
    count = shapes.std.size
    value = plain(prior + shapes.T @ knowledge.z)
    rows = plain.data_rows(value)
    # The measurement is corrected by the estimates of the nuisance parameters, so their prior means are relative to these.
    columns, std = [jacobian[:rows, count:]], [nuisance.std for nuisance in knowledge.nuisances]
    mean = [nuisance.mean - float(at) for nuisance, at in zip(knowledge.nuisances, knowledge.values, strict=True)]
    if state is not None:
        variances, directions = np.linalg.eigh(state)
        kept = variances > least * max(float(variances.max(initial=0.0)), np.finfo(float).tiny)
        # An error of the reference state moves the model in the same way for all changes.
        columns.append(value.jacobian[:rows, : parameters.size] @ (directions[:, kept] * np.sqrt(variances[kept])))
        mean += [0.0] * int(kept.sum())
        std += [1.0] * int(kept.sum())
    further = np.hstack(columns)
    variance = max(replace(knowledge.noise, coarsening=plain.errors.coarsening).variance, plain.errors.least_variance)

    def place(z: Floats) -> Floats:
        return np.clip(level.theta(z[:count]), *parameters.bounds.T)

    def data_by(misfit: Misfit, further: Floats) -> Data:
        own = Level(misfit, prior, shapes.T)

        def data(z: Floats) -> tuple[Floats, Floats]:
            found = own(z[:count])
            return found.residual[:rows] + further @ z[count:], np.hstack([found.jacobian[:rows], further])

        return data

    def residuals_by(misfit: Misfit, further: Floats) -> Callable[[Floats], Floats]:
        return lambda z: misfit.residuals(level.theta(z[:count])) + further @ z[count:]

    def posed(misfit: Misfit, error: ChangeError | None) -> dict[str, Any]:
        def about(z: Floats) -> tuple[Data, float]:
            assert error is not None
            there = misfit.about(place(z), error)
            return data_by(there, there.carried(further, plain)), -0.5 * there.log_det * there.level**2 / variance

        def residuals(z: Floats) -> Callable[[Floats], Floats]:
            there = misfit if error is None else misfit.about(place(z), error)
            return residuals_by(there, there.carried(further, plain))

        return {"data": data_by(misfit, further), "about": None if error is None else about, "residuals": residuals}

    def losses(z: Floats) -> SpringLosses:
        theta = place(z)
        beside, errors = plain.near(theta), None if error is None else error.near(theta)
        here = beside if errors is None else beside.about(theta, errors)
        J = data_by(here, here.carried(further, plain))(z)[1]

        # At the reference level of few terms only these are solved for.
        before, tight = plain.model.near(prior), prior[: parameters.size]

        def compare(terms: Integers, decades: float, level: float) -> list[SpringLoss]:
            factor = level_factor(before, terms, level, tight) if level else None
            changed = (terms, decades + level, factor)
            ends = [(here, here.weakened(*changed))]
            if errors is not None:
                there = beside.weakened(*changed).about(theta, errors.weakened(*changed, prior))
                ends.append((there.with_model(beside.model, there.prior, there.rows, there.eta), there))
            found = []
            for without, lost in ends:
                carried = without.carried(further, plain)
                r, moved = (residuals_by(one, carried)(z) for one in (without, lost))
                found.append(SpringLoss(without=r, lost=moved, jacobian=J if without is here else without.carried(J, here)))
            return found

        return compare

    def near(z: Floats) -> MixtureProblem:
        theta = place(z)
        return replace(problem, **posed(plain.near(theta), None if error is None else error.near(theta)), near=None)

    free = np.tile([-np.inf, np.inf], (further.shape[1], 1))
    order, first = np.unique(shapes.bolts, return_index=True)
    order, joint = order[order >= 0], shapes.joint[first[order >= 0]]
    position = {int(column): i for i, column in enumerate(order)}
    pairs = [(position[int(shapes.bolts[a])], position[int(shapes.bolts[b])]) for a, b in neighbours(parameters, bolts, shapes)]
    inverse, rest = np.linalg.pinv(shapes.T), np.zeros(further.shape[1])
    apart = [replace(one, joint=position.get(int(shapes.bolts[one.joint]), -1)) for one in springs_apart(inputs, parameters)]
    problem = MixtureProblem(
        **posed(plain, error),
        variance=variance,
        bounds=np.vstack([level.bounds(parameters.bounds), free]),
        bolts=order,
        neighbours=pairs,
        joint=joint,
        mean=np.concatenate([np.zeros(count), mean]),
        std=np.concatenate([shapes.std, std]),
        shared=plain.errors.shift_error,
        ratio=knowledge.noise.ratio,
        springs=[one for one in apart if one.joint >= 0],
        losses=losses,
        level_error=plain.errors.level_error if state is None else 0.0,
        cells=plain.cells,
        near=near,
    )
    starts = [knowledge.z, *(inverse @ (theta - prior) for theta in ends)]
    return sample_changes(problem, [np.concatenate([z, rest]) for z in starts], inputs.statistics.bolts)


def springs_apart(inputs: Inputs, parameters: Parameterisation) -> list[Springs]:
    """Springs that a joint (by its number among the bolts) may lose: all, its groups, and of each its translations and its rotations.

    One value holds the components of a group together, but a joint can lose its rotations alone. Single components are not asked for: the
    loss of one with little effect fits errors of the model by chance.
    """
    turning = np.zeros(parameters.terms, dtype=bool)
    if inputs.dofs is not None:
        # A spring acts on translations or on rotations.
        most = np.asarray(abs(inputs.model.terms.left).argmax(axis=0)).ravel()
        turning = np.char.startswith(inputs.dofs.component[most], "ROT")
    owned: dict[int, list[tuple[str, Integers]]] = {}
    for group in parameters.groups:
        if group.kind != "stiffness" or group.bolt is None:
            continue
        owner = group.bolt[group.parameter]
        for bolt in np.unique(owner[owner >= 0]).tolist():
            owned.setdefault(bolt, []).append((group.name, group.terms[owner == bolt]))
    found = []
    for bolt, groups in owned.items():
        found.append(Springs(bolt, None, np.concatenate([terms for _, terms in groups])))
        for name, terms in groups:
            # The only group of a joint is the joint.
            if len(groups) > 1:
                found.append(Springs(bolt, SpringsOf(name), terms))
            kinds = {"translation": terms[~turning[terms]], "rotation": terms[turning[terms]]}
            if all(part.size for part in kinds.values()):
                found += [Springs(bolt, SpringsOf(name, kind), part) for kind, part in kinds.items()]
    return found


def beyond_of(model: FrfModel, fit: Fit, changes: ChangeSamples | None, *, steps: tuple[int, int] = (65, 17)) -> Floats | None:
    """Decades by which errors of the predicted effect extend the interval of each joint, see ``confidence.beyond_errors``.

    Computed for joints that probably loosened, along their common change to where all their values are free; zero for the others.

    Parameters
    ----------
    model : FrfModel
    fit : Fit
    changes : ChangeSamples or None
    steps : tuple of int
        Number of states on the path, with and without interface FRFs (ports): a sixteenth of a decade each if bounds are four decades
        apart; fewer without ports, where each state costs a solve.

    Returns
    -------
    (b,) float array or None
        For each sampled bolt [decades]; None without samples.
    """
    if changes is None:
        return None
    shapes, theta, plain = fit.knowledge.shapes, fit.solution.theta, fit.plain
    low, found = model.parameters.bounds[:, 0], np.zeros(changes.bolts.size)
    joints = set(shapes.bolts[shapes.joint].tolist())
    for k, column in enumerate(changes.bolts.tolist()):
        mean = float(changes.mean[k])
        own = shapes.T[:, column] > 0.0
        if column not in joints or changes.inclusion[k] < 0.5 or mean >= 0.0 or not own.any():
            continue
        tight = theta[own] - float(np.mean((theta - plain.prior)[own]))
        ways = np.linspace(0.0, float((low[own] - tight).min()), steps[model.ports is None])
        states = np.tile(theta, (ways.size, 1))
        states[:, own] = np.maximum(tight + ways[:, None], low[own])
        along = np.zeros_like(states)
        along[:, own] = states[:, own] > low[own]
        found[k] = beyond_errors(mean, ways, model.speeds(theta, states, along), plain.errors.shift_error)
    return found


def opens_of(inputs: Inputs, fit: Fit, error: ChangeError | None = None) -> tuple[Bools, Bools]:
    """Whether the data allow each stiffness value, with its surroundings of half a bolt pitch, to be free, and to be clamped.

    Parameters
    ----------
    inputs : Inputs
    fit : Fit
    error : ChangeError or None
        Error of predicted changes.

    Returns
    -------
    two (size,) bool arrays
        True if the data do not exclude it, with the covariance of the fit, or with the one that follows the change as in the posterior
        of the verdicts: the interval is open to that side.
    """
    pitch = 0.0 if inputs.bolts is None else pitch_of(inputs.bolts.xyz)
    own, variance = fit.solution.theta, fit.knowledge.noise.variance * fit.knowledge.noise.ratio**2
    plain, beside = fit.plain.near(own), None if error is None else error.near(own)

    def following(theta: Floats) -> float:
        assert beside is not None
        there = plain.about(theta, beside)
        return there.data_sum(theta) + there.log_det * there.level**2

    # Errors of a large change may explain what it changes. Of small changes on many lines they raise the determinant only, which must not
    # exclude what the data allow.
    costs: list[Callable[[Floats], float]] = [plain.data_sum, *([] if error is None else [following])]
    sides = [open_values(plain.model.parameters, pitch, data, own, variance) for data in costs]
    down, up = (np.any(side, axis=0) for side in zip(*sides, strict=True))
    return down, up
