"""Compares the damping of the model, its coefficients or its modes, with that of measured modes."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from lrbc_cli.arrays import Floats
from lrbc_cli.campaign.identification.records import Measurement
from lrbc_cli.campaign.looking.fitted import undone
from lrbc_cli.campaign.looking.states import Looking
from lrbc_cli.campaign.reading.inputs import Inputs
from lrbc_cli.config.structure import FieldDamping, ProportionalDamping
from lrbc_cli.updating.statistics.chain.modal import fitted_modes, window_of_model


def misdamped_text(inputs: Inputs, own: Measurement, *, decades: float = 1.5, seen: float = 0.2) -> str | None:
    """Warning if the coefficients of the damping differ by powers of ten, or of 2 pi, from the damping of the measured modes; else None.

    No state of the bolts and no other place does that. On right campaigns the median differed by at most 0.4 decades.

    Parameters
    ----------
    inputs : Inputs
    own : Measurement
        Of the tight state, on all its lines.
    decades : float
        Least median difference of the damping ratios [decades]. A choice: half of the usual slip of three digits.
    seen : float
        Damping ratio above which a mode has no resonance. Beside another field, from whose modes the measured peaks may come, the
        damping must be as large as this.
    """
    damping, rule = inputs.campaign.model.damping, inputs.statistics.modal
    modes = fitted_modes(own.frequency_hz, own.values, rule)
    if not isinstance(damping, ProportionalDamping) or modes.decay.size < rule.least:
        return None
    omega = 2.0 * np.pi * modes.frequency_hz
    measured = modes.decay / omega
    units = {"alpha": 0.5 / omega, "beta": 0.5 * omega, "loss_factor": np.full(omega.size, 0.5)}
    there = {"structure": not inputs.model.is_acoustic.all(), "acoustic": bool(inputs.model.is_acoustic.any())}
    parts = {field: {key: getattr(getattr(damping, field), key) * unit for key, unit in units.items()} for field in there if there[field]}
    ratio = {field: np.sum(list(own.values()), axis=0) for field, own in parts.items()}
    off = {field: float(np.median(np.log10(own / measured))) for field, own in ratio.items() if own.all()}
    told = list[str]()
    for field in off:
        # Peaks of one field may be those of another, which is damped less or more.
        large = off[field] >= decades and (len(parts) == 1 or np.median(ratio[field]) >= seen)
        if not large and (len(off) < len(parts) or max(off.values()) > -decades):
            continue
        key = max(units, key=lambda name: float(np.median(parts[field][name])))
        # Other damping adds to the measured one, so the least of these ratios is nearest.
        power = round(float(np.quantile(np.log10(parts[field][key] / measured), 0.9)))
        stated = getattr(getattr(damping, field), key)
        at = int(np.argsort(ratio[field])[omega.size // 2])
        # As a loss factor it would be about twice the damping ratio.
        typed = key == "beta" and measured.min() <= stated <= 4.0 * measured.max()
        told.append(
            f"model.damping.{field}: {key}: {stated:g} is probably wrong by a power of ten: at {modes.frequency_hz[at]:.4g} Hz the damping "
            f"ratio is {100.0 * ratio[field][at]:.4g} %, that of the measured resonances {100.0 * measured.min():.2g} to "
            f"{100.0 * measured.max():.2g} %. Write {key}: {stated * 10.0**-power:.6g}{_also(inputs, key, stated)}"
            f"{f', or loss_factor: {stated:g} if that is what it is' if typed else ''}"
        )
    if told:
        return "; ".join(told)
    return _of_hertz(damping.structure, omega, measured) if len(parts) == 1 and there["structure"] else None


def uncalibrated_text(inputs: Inputs, own: Measurement, *, least: float = 0.5, most: float = 1.5) -> str | None:
    """Warning if the damping of a structure without air is wrong by a factor that no calibration corrects; else None.

    Parameters
    ----------
    inputs : Inputs
    own : Measurement
        Of the tight state, on all its lines.
    least, most : float
        Median difference of the damping ratios [decades]: on right campaigns it was at most 0.4; more is a matter of ``misdamped_text``.
    """
    calibration, damping, rule = inputs.campaign.calibration, inputs.campaign.model.damping, inputs.statistics.modal
    corrected = calibration is not None and any(name.startswith(("alpha.", "beta.", "loss_factor.")) for name in calibration.names)
    if corrected or not isinstance(damping, ProportionalDamping) or inputs.model.is_acoustic.any():
        return None
    modes = fitted_modes(own.frequency_hz, own.values, rule)
    omega = 2.0 * np.pi * modes.frequency_hz
    stated, units = damping.structure, {"alpha": 0.5 / omega, "beta": 0.5 * omega, "loss_factor": np.full(omega.size, 0.5)}
    parts = {key: getattr(stated, key) * unit for key, unit in units.items()}
    computed, measured = np.sum(list(parts.values()), axis=0), modes.decay / omega
    if modes.decay.size < rule.least or not computed.all():
        return None
    off = float(np.median(np.log10(computed / measured)))
    # Joints that are stated with damping of their own add to that of the structure.
    tied = any(not isinstance(one.damping, str | None) for one in inputs.campaign.parameters.values())
    if not least <= abs(off) < most or (off < 0.0 and tied):
        return None
    key, low, high = max(parts, key=lambda name: float(np.median(parts[name]))), *(1e2 * np.quantile(measured, (0.1, 0.9)))
    right = " and ".join(f"{name}: {getattr(stated, name) * 10.0**-off:.2g}" for name in parts if getattr(stated, name))
    return (
        f"the damping of the model is {10.0 ** abs(off):.2g} times too {'large' if off > 0.0 else 'small'}: damping ratios of "
        f"{1e2 * float(np.median(computed)):.2g} %, those of {omega.size} measured resonances {low:.2g} to {high:.2g} %. Write about "
        f"{right} under model.damping.structure, or add {key}.structure to calibration.factors"
    )


def _also(inputs: Inputs, key: str, stated: float) -> str:
    """Clause on springs that are stated with the same damping; empty if there are none."""
    tied = {name: one.damping for name, one in inputs.campaign.parameters.items() if key == "beta"}
    also = [name for name, one in tied.items() if one is not None and not isinstance(one, str) and one.beta == stated]
    return f", also in the damping of parameters.{' and parameters.'.join(also)}" if also else ""


def _of_hertz(own: FieldDamping, omega: Floats, measured: Floats, *, least: float = 0.35, left: float = 0.5) -> str | None:
    """Warning if alpha and beta fit measured damping ratios only as if computed from frequencies in Hz in place of rad/s; else None.

    Parameters
    ----------
    own : FieldDamping
    omega, measured : (m,) float arrays
        Frequencies of the modes [rad/s], and their damping ratios.
    least : float
        Least rms of their deviations as stated [decades]. On right campaigns of one field it was 0.21 at most.
    left : float
        Largest share of it, and of the deviations from one common factor, that may remain with the right values.
    """
    if not own.alpha or not own.beta or own.loss_factor:
        return None
    turn = 2.0 * np.pi
    right = (turn * own.alpha, own.beta / turn)
    off = [np.log10(0.5 * (alpha / omega + beta * omega) / measured) for alpha, beta in ((own.alpha, own.beta), right)]
    before, after = (float(np.sqrt(np.mean(one**2))) for one in off)
    # Damping that is merely too small, that of joints left out for example, differs by about one factor, which a calibration corrects.
    if before < least or after > left * min(before, float(np.std(off[0]))):
        return None
    return (
        f"model.damping.structure: alpha: {own.alpha:g} and beta: {own.beta:g} were probably computed from frequencies in Hz in place of "
        f"rad/s: the damping ratios of {omega.size} measured resonances differ by a factor of {10.0**before:.2g} (rms), with alpha times "
        f"2 pi and beta over 2 pi by {10.0**after:.2g}. Write alpha: {right[0]:.4g}, beta: {right[1]:.4g}; if beta of the damping under "
        "parameters has the same origin, correct it, too"
    )


def windowed_text(source: Looking, job: str, own: Measurement, factors: Mapping[str, float]) -> str:
    """Warning if all modes of a tight job decay faster than those of the model by the same amount, as with a window; else empty.

    A calibration takes that for damping, which grows with frequency, so its factors of the damping are left out.

    Parameters
    ----------
    source : Looking
        FRFs of the model with ``factors``.
    job : str
    own : Measurement
        On all its lines.
    factors : mapping of str to float
    """
    if source.stage is None:
        return ""
    plain = undone(source, {name: value for name, value in factors.items() if name.partition(".")[0] in ("alpha", "beta", "loss_factor")})
    s = 2j * np.pi * own.frequency_hz
    parameters = plain.parameters(s)
    model = plain.model(s, parameters).frf(parameters.initial)
    count, rate = window_of_model(own.frequency_hz, own.values, model, source.inputs.statistics.modal)
    if not count:
        return ""
    air = " (and of acoustic)" if source.inputs.model.is_acoustic.any() else ""
    return (
        f"job {job}: all {count} modes that can be compared decay faster than in the model by the same {rate:.3g} 1/s (median), but "
        "damping of the material grows with frequency. Check whether an exponential window with a time constant of about "
        f"{1.0 / rate:.2g} s was set in all jobs. Measure without one, or add its decay to the damping of the model: "
        f"model.damping.structure{air}: alpha: {2.0 * rate:.3g} more"
    )
