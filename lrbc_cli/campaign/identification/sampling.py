"""The mixture prior in a job: its fit as a problem of tight and loose bolts, with what drifted and the reference state marginalised."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from lrbc_cli.arrays import Bools, Complexes, Floats
from lrbc_cli.campaign.identification.found import Fit
from lrbc_cli.campaign.reading.inputs import Inputs
from lrbc_cli.updating.misfit.cost import ChangeError, Misfit
from lrbc_cli.updating.misfit.frf import FrfModel
from lrbc_cli.updating.posterior.confidence import beyond_errors, open_values
from lrbc_cli.updating.posterior.fit import Posterior
from lrbc_cli.updating.posterior.mixture import ChangeSamples, MixtureProblem
from lrbc_cli.updating.posterior.sampling import sample_changes
from lrbc_cli.updating.search.descent import Level
from lrbc_cli.updating.unknowns.places import pitch_of
from lrbc_cli.updating.unknowns.shapes import neighbours


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
    """Sample the changes at the bolts of a job whose prior is a mixture, or a Gaussian and a mixture.

    Parameters
    ----------
    inputs : Inputs
    plain : Misfit
        About the measurement without what drifted; its prior is the reference state.
    knowledge : Posterior
        Of the fit with a Gaussian prior: its noise, and where to begin.
    jacobian : (n, m + k) float array
        Of the fit, to its unknowns and to what drifted.
    state : (size, size) float array or None
        Covariance of the reference state; None where the comparison is free of its error.
    error : ChangeError or None
        How wrong predicted changes may be: the tight state predicts none, so nothing of it is forgiven there.
    ends : sequence of (size,) float array
        Theta where other descents ended: alternatives may begin there.
    least : float
        Directions of the reference state's covariance below this share of its largest say nothing.

    Returns
    -------
    ChangeSamples or None
        None where the prior is no mixture, or where the unknowns are no changes at bolts.
    """
    shapes = knowledge.shapes
    if not inputs.method.mixture or inputs.bolts is None or not shapes.by_bolt:
        return None
    parameters, prior, bolts = plain.model.parameters, plain.prior, inputs.bolts.xyz
    level = Level(plain, prior, shapes.T)
    count = shapes.std.size
    value = plain(prior + shapes.T @ knowledge.z)
    rows = plain.data_rows(value)
    # What drifted was taken out at its estimate: its prior lies that far from zero.
    columns, std = [jacobian[:rows, count:]], [nuisance.std for nuisance in knowledge.nuisances]
    mean = [nuisance.mean - float(at) for nuisance, at in zip(knowledge.nuisances, knowledge.values, strict=True)]
    if state is not None:
        variances, directions = np.linalg.eigh(state)
        kept = variances > least * max(float(variances.max(initial=0.0)), np.finfo(float).tiny)
        # An error of the reference state moves the model whatever the changes are.
        columns.append(value.jacobian[:rows, : parameters.size] @ (directions[:, kept] * np.sqrt(variances[kept])))
        mean += [0.0] * int(kept.sum())
        std += [1.0] * int(kept.sum())
    further = np.hstack(columns)
    variance = max(replace(knowledge.noise, coarsening=plain.errors.coarsening).variance, plain.errors.least_variance)

    def data_by(level: Level, further: Floats) -> Callable[[Floats], tuple[Floats, Floats]]:
        def data(z: Floats) -> tuple[Floats, Floats]:
            found = level(z[:count])
            return found.residual[:rows] + further @ z[count:], np.hstack([found.jacobian[:rows], further])

        return data

    def about(z: Floats) -> tuple[Callable[[Floats], tuple[Floats, Floats]], float]:
        assert error is not None
        there = plain.about(np.clip(level.theta(z[:count]), *parameters.bounds.T), error)
        offset = -0.5 * there.log_det * there.level**2 / variance
        return data_by(Level(there, prior, shapes.T), there.carried(further, plain)), offset

    free = np.tile([-np.inf, np.inf], (further.shape[1], 1))
    order, first = np.unique(shapes.bolts, return_index=True)
    order, joint = order[order >= 0], shapes.joint[first[order >= 0]]
    place = {int(column): i for i, column in enumerate(order)}
    pairs = [(place[int(shapes.bolts[a])], place[int(shapes.bolts[b])]) for a, b in neighbours(parameters, bolts, shapes)]
    problem = MixtureProblem(
        data=data_by(level, further),
        variance=variance,
        bounds=np.vstack([level.bounds(parameters.bounds), free]),
        bolts=order,
        neighbours=pairs,
        joint=joint,
        mean=np.concatenate([np.zeros(count), mean]),
        std=np.concatenate([shapes.std, std]),
        about=None if error is None else about,
        shared=plain.errors.shift_error,
        ratio=knowledge.noise.ratio,
    )
    inverse, rest = np.linalg.pinv(shapes.T), np.zeros(further.shape[1])
    starts = [knowledge.z, *(inverse @ (theta - prior) for theta in ends)]
    return sample_changes(problem, [np.concatenate([z, rest]) for z in starts], inputs.statistics.bolts)


def beyond_of(model: FrfModel, fit: Fit, changes: ChangeSamples | None, *, steps: tuple[int, int] = (65, 17)) -> Floats | None:
    """How much further each sampled joint may have loosened by the errors of its predicted effect, see ``confidence.beyond_errors``.

    Of joints that rather changed than not, along their common change to where all their values are free; zero of the others.

    Parameters
    ----------
    model : FrfModel
    fit : Fit
    changes : ChangeSamples or None
    steps : tuple of int
        Along the way: a sixteenth of a decade each where bounds lie four apart; fewer without ports, where each costs an evaluation.

    Returns
    -------
    (b,) float array or None
        [decades]; None without samples.
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


def opens_of(inputs: Inputs, fit: Fit, frf: Callable[[Floats], Complexes]) -> tuple[Bools, Bools]:
    """Whether the data object to a stretch of half a pitch about each stiffness value being free, or clamped.

    Parameters
    ----------
    inputs : Inputs
    fit : Fit
    frf : callable
        FRFs near its end, see ``FrfModel.nearby``.
    """
    pitch = 0.0 if inputs.bolts is None else pitch_of(inputs.bolts.xyz)
    data, noise = partial(fit.plain.data_sum, frf=frf), fit.knowledge.noise
    return open_values(fit.plain.model.parameters, pitch, data, fit.solution.theta, noise.variance * noise.ratio**2)
