"""Loss of stiffness at a loose bolt in a rehearsal: in the terms that it owns, or in a patch along its edge, narrower than its hat."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from lrbc_cli.arrays import Floats
from lrbc_cli.campaign.reading.inputs import Inputs
from lrbc_cli.errors import ConfigError
from lrbc_cli.model.terms import Parameterisation
from lrbc_cli.updating.unknowns.places import foot, pitch_of


def patches(inputs: Inputs, reach: float | None) -> dict[str, dict[str, Floats]]:
    """Share of each bolt in each value of the stiffness groups that it owns, or along whose edge it lies.

    Parameters
    ----------
    inputs : Inputs
    reach : float or None
        Half width of a patch along an edge [m]; None: half the pitch of the bolts.

    Returns
    -------
    dict
        By bolt and group: (k,) weights, 1 for values that it owns, else ``exp(-(r / reach)^4)`` with r along the edge [m], summing to at
        most 1 over the bolts.

    Raises
    ------
    ConfigError
        If there are no bolts, or no stiffness groups that they own or along which they lie.
    """
    campaign, bolts = inputs.campaign, inputs.bolts
    groups = [g for g in inputs.groups if g.config.kind == "stiffness"]
    edges = [g for g in groups if g.xyz is not None and g.arc_length is not None]
    joints = [g for g in groups if g.bolt is not None]
    if bolts is None or not (edges or joints):
        raise ConfigError(
            "bolts cannot be loosened" + (": the campaign has none" if bolts is None else ": no stiffness group has positions"),
            file=campaign.path,
            expected="bolts: a CSV file, and a group of kind stiffness whose terms have coordinates",
        )
    own = {name: {g.name: np.where(g.bolt == b, 1.0, 0.0) for g in joints if np.any(g.bolt == b)} for b, name in enumerate(bolts.name)}
    rest = np.array([bool(edges) and not own[name] for name in bolts.name])
    reach = reach or 0.5 * pitch_of(bolts.xyz[rest])
    weights: dict[str, dict[str, Floats]] = {name: own[name] for name in bolts.name}
    for name, xyz in zip(np.array(bolts.name)[rest].tolist(), bolts.xyz[rest], strict=True):
        feet = {}
        for group in edges:
            assert group.xyz is not None
            assert group.arc_length is not None
            feet[group.name] = foot(group.xyz, group.arc_length, xyz)
        nearest = min(distance for _, distance in feet.values())
        for group in edges:
            at, distance = feet[group.name]
            if distance <= nearest + 0.5 * (reach or 0.0):
                along = np.abs(np.asarray(group.arc_length) - at)
                weights[name][group.name] = np.exp(-((along / reach) ** 4)) if reach else np.ones(group.count)
    for group in edges:
        total = np.sum([w[group.name] for w in weights.values() if group.name in w], axis=0)
        for w in weights.values():
            if group.name in w:
                w[group.name] = w[group.name] / np.maximum(total, 1.0)
    return weights


@dataclass(frozen=True)
class Structure:
    """The structure that rehearsals measure: each value is independent, where an identification smooths along its edge.

    Attributes
    ----------
    parameters : Parameterisation
    theta : (size,) float array
        log10 of the effective values in the tight state.
    loosened : (size, n) float array
        Change of theta by one decade at each bolt; with values instead of bolts the identity.
    """

    parameters: Parameterisation
    theta: Floats
    loosened: Floats

    @classmethod
    def of(cls, inputs: Inputs, parameters: Parameterisation, theta: Floats, by_bolt: bool) -> Structure:
        """Structure with the effective values of the state theta; ``loosened`` by bolt, or value by value."""
        groups, there = [], theta.copy()
        for group, values, _ in parameters.placed:
            there[values] = np.log10(group.values(theta[values]))
            limits = np.column_stack([np.minimum(group.bounds[:, 0], there[values]), np.maximum(group.bounds[:, 1], there[values])])
            groups.append(replace(group, initial=there[values], bounds=limits, smoothing=np.eye(group.count)))
        plain = Parameterisation(tuple(groups))
        if not by_bolt:
            return cls(plain, there, np.eye(plain.size))
        loosened = np.zeros((plain.size, len(inputs.bolts.name) if inputs.bolts else 0))
        slices = {group.name: values for group, values, _ in plain.placed}
        for column, own in zip(loosened.T, patches(inputs, None).values(), strict=True):
            for name, weights in own.items():
                column[slices[name]] = weights
        return cls(plain, there, loosened)

    def changed(self, bolt: int, change: float) -> tuple[Floats, float]:
        """(size,) theta with a bolt changed by ``change`` decades within the bounds, and the change reached [decades]."""
        shape = self.loosened[:, bolt]
        there = np.clip(self.theta + change * shape, *self.parameters.bounds.T)
        # Bounds may limit some values: the mean change, weighted by the shape.
        return there, float(shape @ (there - self.theta)) / max(float(shape @ shape), np.finfo(float).tiny)
