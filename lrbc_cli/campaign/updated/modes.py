"""Natural frequencies and damping ratios of the model of a job before and after updating, paired by MAC, for its result file."""

from __future__ import annotations

import logging
import pickle

import numpy as np

from lrbc_cli.arrays import Complexes, Floats
from lrbc_cli.campaign.identification.found import Identification
from lrbc_cli.campaign.reading.inputs import Inputs
from lrbc_cli.campaign.reduced.stage import ReductionStage
from lrbc_cli.errors import NumericalError
from lrbc_cli.model.terms import KIND_POWER, Parameterisation
from lrbc_cli.reduction.reduced.modes import Modes, mac, modes_of, paired
from lrbc_cli.reduction.threads import side_by_side
from lrbc_cli.remembered import Remembered
from lrbc_cli.results.agreement import ModePair, ModesRecord

log = logging.getLogger(__name__)

#: Modes of the last states; all jobs start from the same reference state.
_modes = Remembered[Modes](8)


def modes_record(inputs: Inputs, stage: ReductionStage | None, result: Identification) -> ModesRecord | None:
    """The modes in ``result.json``, without nuisance parameters; None without a reduced model, or if the modes are not found."""
    if stage is None:
        return None
    model, band = stage.reduction.model, inputs.campaign.reduction.band

    def modes(theta: Floats) -> Modes:
        terms = polynomial(result.parameters, theta)
        rests_on = (model.K, model.C, model.M, model.left, model.right, terms, np.array(band))
        return _modes.of(pickle.dumps([np.asarray(part) for part in rests_on]), lambda: modes_of(model, terms, band))

    try:
        before, after = side_by_side(modes, (result.prior, result.solution.theta))
    except NumericalError as error:
        log.warning("job %s: %s", result.name, error.problem)
        return None
    likeness = mac(model, before, after)
    pairs = []
    for a, b in paired(likeness):
        (before_hz, before_damping), (after_hz, after_damping) = _mode(before, a), _mode(after, b)
        same = float("nan") if a is None or b is None else likeness[a, b]
        pairs.append(ModePair(before_hz=before_hz, before_damping=before_damping, after_hz=after_hz, after_damping=after_damping, mac=same))
    pairs.sort(key=lambda pair: pair.before_hz if np.isnan(pair.after_hz) else pair.after_hz)
    return ModesRecord(before="reference" if result.against_reference else "initial", pairs=tuple(pairs))


def _mode(modes: Modes, index: int | None) -> tuple[float, float]:
    """Natural frequency [Hz] and damping ratio of a mode; NaN for None."""
    return (float("nan"), float("nan")) if index is None else (modes.frequency_hz[index], modes.damping_ratio[index])


def polynomial(parameters: Parameterisation, theta: Floats) -> Complexes | Floats:
    """(nt, 3) stiffness, damping and mass of the terms; complex if their damping is hysteretic."""
    terms = parameters.polynomial(theta)
    loss = np.zeros_like(terms)
    kappa = parameters.scales(theta)
    for group, _, at in parameters.placed:
        if group.damping is not None and at is not None and group.damping.loss_factor:
            loss[group.terms, KIND_POWER[group.kind]] = group.damping.loss_factor * kappa[group.terms] * 10.0 ** theta[at]
    return terms + 1j * loss if loss.any() else terms
