"""Tests whether stiffness, mass or damping of the model are wrong by a factor, such as that of a unit, by full solves at a few lines."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np
import scipy.sparse as sp
from scipy.optimize import minimize_scalar

from lrbc_cli.arrays import Complexes, spaced
from lrbc_cli.campaign.identification.compared.likeness import CLEARLY, LEAST_DIFFERENCE, apart
from lrbc_cli.campaign.identification.records import Measurement
from lrbc_cli.campaign.looking.fitted import roughly_calibrated
from lrbc_cli.campaign.looking.states import Seen
from lrbc_cli.campaign.looking.trials import EXPLAINED, FEWEST, MOST_WORK, left_of, peak_lines, ported, resonances
from lrbc_cli.campaign.reading.places import GRAVITIES, POWERS, mistake_text
from lrbc_cli.errors import LrbcError
from lrbc_cli.model.factors import with_factors
from lrbc_cli.reduction.reduced.ports import PortFrf
from lrbc_cli.updating.comparison.scale import LEAST_OFFSET, LEAST_REACH, Offset

#: Largest difference of the constants that a level misfit leaves out [dB].
MOST_OFF = 4.0

#: Powers of ten for typing errors of one or two digits.
_FURTHER = (-2, -1, 1, 2)

#: Least ratio of the numbers of resonances in measurement and model for which a factor is looked for. A factor of ten on a matrix changes
#: frequencies by 3.2, and the number of resonances in the band by as much for a plate, by 1.8 for a beam.
MORE = 1.6

#: See ``_cases``.
_Case = tuple[str, float, Complexes, float]

#: Calibrated factors of the structure.
_STRUCTURE = ("stiffness.structure", "mass.structure")


def explains(left: float, off: float, before: float, further: float, *, near: float = 0.3) -> bool:
    """Whether a factor explains a misfit: ``left`` of ``before`` remains, and the levels are ``off`` by a constant [dB].

    Levels within ``near`` [dB] are evidence of their own, because a wrong factor leaves them anywhere: then ``further`` times as much
    misfit may remain, as of a model that is not calibrated.
    """
    wider = further if abs(off) < near else 1.0
    return abs(off) < MOST_OFF and left < min(wider * EXPLAINED, wider * CLEARLY * before)


def rescaled_text(seen: Seen, before: float, *, further: float = 1.0) -> str | None:
    """Warning that names the matrix (stiffness or mass) that is wrong by the factor of a unit; None if no factor explains the misfit.

    A factor on the stiffness and its reciprocal on the mass shift frequencies alike; the level of the FRFs distinguishes them. What was
    solved is kept, so that a second look, with another limit, costs nothing.

    Parameters
    ----------
    seen : Seen
    before : float
        Level misfit without a factor, constants removed, median over the responses [dB].
    further : float
        See ``explains``: above 1 where nothing else explains the measurement.
    """
    measured, computed = resonances(seen.measured), resonances(seen.model)
    # A difference of one resonance at an end of the band is chance.
    if max(measured, computed) + 1 < MORE * min(measured, computed):
        return None
    found: list[tuple[float, str, float, float]] = []
    few = seen.few(FEWEST)
    inputs = seen.inputs
    line, spent = seen.work(few.s.size), 0.0
    factors = [10.0**power for power in (*sorted(POWERS, key=abs), *_FURTHER)]
    for factor in (*factors, *GRAVITIES, *(1.0 / gravity for gravity in GRAVITIES)):
        # A stiffer model has fewer resonances. After a factor that explains the measurement, only those within a decade are tried.
        if (factor > 1.0) != (computed > measured):
            continue
        if found and abs(np.log10(factor) - np.log10(min(found)[3])) > 1.0:
            continue
        spent += line * (2 if inputs.model.C.nnz else 1)
        if spent > MOST_WORK:
            break
        key = b"cases" + np.float64(factor).tobytes() + few.s.tobytes()
        if key not in seen.source.known:
            seen.source.known[key] = list(_cases(few, factor))
        for matrix, size, values, level in seen.source.known[key]:
            left, off = left_of(few, values)
            if explains(left, off - level, before, further):
                found.append((left, matrix, size, factor))
    if not found:
        return None
    left, matrix, size, factor = min(found)
    # The data cannot distinguish 9.81 from 10; for masses, a confusion with weights is more likely than a wrong digit.
    for gravity in (*GRAVITIES, *(1.0 / gravity for gravity in GRAVITIES)):
        near = [each for each in found if each[1] == "mass" and each[3] == gravity]
        if matrix == "mass" and near and abs(np.log10(factor / gravity)) < 0.01:
            left, matrix, size, factor = near[0]
    text = mistake_text(inputs.campaign, matrix, size)
    return f"{text}. This reduces the level misfit from {before:.1f} to {left:.1f} dB (mean level of each response removed)"


def scaled_text(seen: Seen, ratio: float, wrong: str, *, most: int = 12, share: float = 0.1, further: float = 1.5) -> str | None:
    """Warning that names the matrix and factor by which all resonances are shifted; None if shape and level of the FRFs do not decide.

    A factor on the mass acts relative to stiffness and bolt springs alike, so it is the square of ``ratio``. One on the stiffness leaves
    the bolt springs as they are, so it is found by minimisation. So is a thickness, if neither explains the level.

    Parameters
    ----------
    seen : Seen
    ratio : float
        Measured over computed frequencies.
    wrong : str
        What is wrong with the model if it is one matrix.
    most : int
        Largest number of full solutions of that minimisation.
    share : float
        Share of ``MOST_WORK`` up to which more than ``FEWEST`` lines are compared: few lines miss the narrow peaks of lightly damped modes.
    further : float
        See ``explains``.
    """
    count = int(np.clip(share * MOST_WORK / (most * seen.work(1)), FEWEST, seen.s.size))
    few, inputs, before = seen.few(count), seen.inputs, seen.misfit
    if most * seen.work(few.s.size) > MOST_WORK:
        return None

    def misfit(case: _Case) -> tuple[float, float]:
        left, off = left_of(few, case[2])
        return left, abs(off - case[3])

    def nearest(case: Callable[[Seen, float], _Case], middle: float, reach: float, limit: int) -> tuple[float, float, float]:
        """Factor with the smallest misfit, that misfit, and the level there [dB]; ``middle`` and ``reach`` of the powers of ten tried."""
        bounds, options = (middle - reach, middle + reach), {"maxiter": limit}
        found = minimize_scalar(lambda power: misfit(case(few, 10.0**power))[0], bounds=bounds, method="bounded", options=options)
        best = case(few, 10.0 ** float(found.x))
        return best[1], *misfit(best)

    with suppress(LrbcError, StopIteration):
        # With soft bolt springs the exponent is twice that of the frequency ratio, with stiff ones up to twice as much.
        log = float(np.log10(ratio))
        fits = {"stiffness": nearest(lambda at, factor: next(_cases(at, factor)), 2.0 * log, 2.0 * abs(log) + 0.05, most)}
        fits |= {case[0]: (case[1], *misfit(case)) for case in _cases(few, ratio**2) if case[0] == "mass"}
        right = [name for name, (_, left, off) in fits.items() if explains(left, off, before, further)]
        unexplained = min((fits[name][2] for name in right), default=MOST_OFF)
        if unexplained > LEAST_OFFSET:
            # The resonances of the stiffness found, but for springs that are softer or stiffer beside it.
            size, left, off = nearest(_thickened, -float(np.log10(fits["stiffness"][0])), 0.25 * abs(log), most // 3)
            if off < CLEARLY * unexplained and explains(left, off, before, further):
                return _thickness_text(size, left)
        if len(right) == 1:
            size = fits[right[0]][0]
            text = mistake_text(inputs.campaign, right[0], float(f"{size:.2g}") if size > 1.0 else 1.0 / float(f"{1.0 / size:.2g}"))
            return f"{wrong}; {text}"
    return None


def _thickness_text(size: float, left: float) -> str:
    """Warning about a thickness that is ``size`` times too large, with the misfit that it leaves [dB]."""
    wrong = f"{size:.2g} times too large" if size > 1.0 else f"{1.0 / size:.2g} times too small"
    return (
        f"The thickness of plates, or the height of beams, is probably {wrong} in the model: with the third power of this factor on the "
        f"stiffness and the first on the mass, frequencies and level of the FRFs fit ({left:.1f} dB left). Then the mass sum is too "
        f"{'large' if size > 1.0 else 'small'} by this factor: compare it with the weight of the structure. Correct the thickness in the "
        "FE model, and export it again"
    )


def both_text(seen: Seen, whole: Measurement, ratio: float, level: float, *, rounds: int = 3) -> str:
    """Warning if stiffness and mass of the model are wrong together, as by a thickness or by the material; else empty.

    A thickness changes the bending stiffness by its cube and the mass in proportion; steel and aluminium differ in both by 2.9. The springs
    of bolts remain, so frequencies alone do not tell this from one wrong matrix: rough calibrations find both factors, each from the end
    of the one before.

    Parameters
    ----------
    seen : Seen
    whole : Measurement
        The same on all its lines.
    ratio, level : float
        Measured over computed frequencies, and level of the FRFs with this taken out [dB].
    rounds : int
        Number of calibrations: each reaches a factor of 1.35.
    """
    found = _both(seen, whole, ratio, level, rounds)
    return "" if found is None else _both_text(*found)


def material_text(seen: Seen, whole: Measurement, offsets: Sequence[Offset]) -> str:
    """Warning if stiffness and mass of the model, wrong together, explain a factor of all FRFs that is clearly no known one; else empty.

    A unit leaves the shapes of the FRFs as they are. A material changes them, too, because the springs of bolts remain.

    Parameters
    ----------
    seen : Seen
    whole : Measurement
        The same on all its lines.
    offsets : sequence of Offset
        Factors of the responses.
    """
    level = float(np.median([offset.db for offset in offsets]))
    known = any(abs(each.db - level) <= LEAST_REACH for offset in offsets for each in offset.known)
    known = known or any(offset.uncalibrated for offset in offsets)
    if known or seen.misfit <= LEAST_DIFFERENCE or any(offset.power for offset in offsets):
        return ""
    found = _both(seen, whole, 1.0, level, 3)
    if found is None or found[1] > CLEARLY * seen.misfit or not (text := _both_text(*found)):
        return ""
    return (
        f"measured FRFs are {abs(level):.1f} dB {'above' if level > 0.0 else 'below'} the model's, and the level misfit is "
        f"{seen.misfit:.1f} dB (mean level of each response removed). {text}. Compare the mass sum with the weight of the structure first: "
        "if it is right, a sensitivity, a gain or a unit of all FRFs is wrong by these decibels instead"
    )


def _both(seen: Seen, whole: Measurement, ratio: float, level: float, rounds: int) -> tuple[dict[str, float], float] | None:
    """Factors of stiffness and mass, and the misfit there [dB], as ``brought_near`` finds them; None if not both are calibrated."""
    mass = 10.0 ** (-level / 20.0)
    start = dict(zip(_STRUCTURE, (mass * ratio**2, mass), strict=True))
    return brought_near(seen, whole, start, rounds) if start.keys() <= set(_calibrated_names(seen)) else None


def far_text(seen: Seen, whole: Measurement, ratio: float, *, rounds: int = 3, reached: float = 1.35) -> str:
    """Warning if rough calibrations bring the model near a measurement only from another stiffness; else empty.

    A wrong factor may be out of their reach from the model as exported, and not shift all resonances alike: beside springs of bolts, for
    example, or beside air.

    Parameters
    ----------
    seen : Seen
    whole : Measurement
        The same on all its lines.
    ratio : float
        Measured over computed frequencies, as far as one factor explains them: the squared is where the calibrations begin.
    rounds : int
        Number of calibrations.
    reached : float
        Factor within which a calibration finds its way from the model as exported.
    """
    names = [name for name in _STRUCTURE if name in _calibrated_names(seen)]
    start = {name: ratio**power for name, power in zip(names, (2.0 if names[:1] == ["stiffness.structure"] else -2.0, 0.0), strict=False)}
    found = brought_near(seen, whole, start, rounds) if start else None
    if found is None or found[1] > min(LEAST_DIFFERENCE, CLEARLY * seen.misfit):
        return ""
    factors, left = found
    stiff = factors.get("stiffness.structure", 1.0) / factors.get("mass.structure", 1.0)
    if 1.0 / reached < stiff < reached:
        return ""
    too, size = ("small", stiff) if stiff > 1.0 else ("large", 1.0 / stiff)
    text = _both_text(factors, left) if len(names) > 1 else ""
    # Where both factors are known, one of them near 1 is right.
    right = {name for name, value in factors.items() if len(factors) > 1 and 1.0 / reached < value < reached}
    causes = [f"modulus (70 GPa of aluminium, 210 GPa of steel) {size:.2g} times too {too}"] if _STRUCTURE[0] not in right else []
    if _STRUCTURE[1] not in right:
        causes.append(f"density {size:.2g} times too {'large' if stiff > 1.0 else 'small'}")
    if not right:
        causes.append(f"thickness of plates {size**0.5:.3g} times too {too}")
    text = text or (
        f"The stiffness of the structure is probably about {size:.2g} times too {too} relative to its mass ({', or '.join(causes)}): with "
        f"{' and '.join(f'{name} {value:.2g}' for name, value in factors.items())} a rough calibration leaves {left:.1f} dB. Correct it in "
        "the FE model, and export it again"
    )
    return (
        f"measured and computed FRFs have little in common: the level misfit is {seen.misfit:.1f} dB at the start values (mean level of "
        f"each response removed). {text}"
    )


def _calibrated_names(seen: Seen) -> list[str]:
    """Factors that the campaign calibrates from this job."""
    settings = seen.inputs.campaign.calibration
    return [] if settings is None or settings.job != seen.job else list(settings.names)


def brought_near(seen: Seen, whole: Measurement, start: dict[str, float], rounds: int) -> tuple[dict[str, float], float] | None:
    """Factors at the end of rough calibrations, each from the end of the one before, and the misfit there [dB]; None if one fails."""
    now, left = start, np.inf
    for _ in range(rounds):
        if (found := roughly_calibrated(seen.source, whole, beside=now)) is None:
            return None
        now, left = {name: value * found.factors[name] for name, value in now.items()}, Seen.of_model(found, seen.job, whole).misfit
    return now, left


def _both_text(factors: dict[str, float], left: float) -> str:
    """Warning that stiffness and mass are wrong together, as by a thickness or by the material; empty if they are not."""
    stiffness, mass = np.log([factors[name] for name in _STRUCTURE]).tolist()
    # Distances from what errors of a thickness, of the material, and of one matrix leave.
    away = {"thickness": abs(stiffness - 3.0 * mass) / 10.0**0.5, "material": abs(stiffness - mass) / 2.0**0.5}
    likely, *others = sorted((*away.items(), ("mass", abs(stiffness)), ("stiffness", abs(mass))), key=lambda each: each[1])
    # A smaller factor of the mass cannot be told from gains of the sensors, beside another clock for example.
    if likely[0] not in away or likely[1] > CLEARLY * others[0][1] or abs(mass) < np.log(10.0) / 20.0 * LEAST_OFFSET:
        return ""
    thin = likely[0] == "thickness"
    size = float(np.exp((3.0 * stiffness + mass) / 10.0 if thin else (stiffness + mass) / 2.0))
    wrong = f"{1.0 / size:.2g} times too large" if size < 1.0 else f"{size:.2g} times too small"
    said = f"with its stiffness times {np.exp(stiffness):.2g} and mass times {np.exp(mass):.2g} a rough calibration leaves {left:.1f} dB"
    if thin:
        return (
            f"The thickness of plates, or the height of beams, is probably {wrong} in the model: {said}, and these are about the third and "
            "the first power of one factor. Correct it in the FE model, and export it again"
        )
    return (
        f"Stiffness and mass of the model are probably both about {wrong}: {said}. Steel and aluminium differ by 2.9 in both. Correct "
        "modulus and density in the FE model, and export it again"
    )


def overdamped_text(seen: Seen, most: float) -> str | None:
    """Warning that names the power of ten by which the damping of the model is too large; None if none explains the measurement.

    Parameters
    ----------
    seen : Seen
    most : float
        Largest level misfit that may remain, constants removed, median over the responses [dB].
    """
    if resonances(seen.measured) < MORE * resonances(seen.model):
        return None
    plain = seen.inputs.model
    # Damping changes little away from resonances, so lines at peaks are added.
    peaks = peak_lines(seen.measured)
    few = seen.on(np.union1d(spaced(seen.s.size, FEWEST), peaks[spaced(peaks.size, FEWEST)]))
    dynamic = few.dynamic
    factors = [10.0**-power for power in range(1, max(POWERS) + 1)]
    factors = factors[: int(MOST_WORK / seen.work(few.s.size))]
    found: list[tuple[float, float]] = []
    for factor in factors:
        stiffness = plain.K.real + 1j * factor * plain.K.imag if np.iscomplexobj(plain.K) else plain.K
        with suppress(LrbcError):
            ports = ported(few, replace(plain, K=stiffness, C=plain.C * factor))
            # Springs of bolts have the damping of the structure.
            values = ports.evaluate(dynamic.real + 1j * factor * dynamic.imag)
            found.append((float(np.median(apart(few.measured, values))), factor))
        # Stop where a further reduction does not help.
        if len(found) > 1 and found[-1][0] >= found[-2][0]:
            break
    if not found or min(found)[0] > min(EXPLAINED, most):
        return None
    left, factor = min(found)
    text = mistake_text(seen.inputs.campaign, "damping", 1.0 / factor)
    return f"{text}. This reduces the level misfit to {left:.1f} dB (mean level of each response removed)"


def air_text(seen: Seen, before: float, *, factors: Sequence[float] = (0.1, 10.0, 1e-3, 1e3)) -> str:
    """Warning that the density of the air is wrong by a power of ten; empty if none of ``factors`` explains the misfit ``before`` [dB].

    The density multiplies what the air does to the structure, and the pressures: all matrix entries of the air against the coupling.
    """
    model, few, found = seen.inputs.model, seen.few(FEWEST), list[tuple[float, float]]()
    air = sp.diags_array(model.is_acoustic.astype(float))
    alone = model.is_acoustic.all() or not model.is_acoustic.any()
    if alone or before <= LEAST_DIFFERENCE or len(factors) * seen.work(few.s.size) > MOST_WORK:
        return ""
    for factor in factors:
        changed = {name: sp.csc_array(own + (factor - 1.0) * (air @ own @ air)) for name in "KCM" for own in [getattr(model, name)]}
        with suppress(LrbcError):
            left, off = left_of(few, ported(few, replace(model, **changed)).evaluate(few.dynamic))
            found += [(left, factor)] if explains(left, off, before, 1.0) else []
    if not found:
        return ""
    left, factor = min(found)
    return (
        f"the density of the air in the model is probably {max(factor, 1.0 / factor):g} times too {'large' if factor > 1.0 else 'small'}: "
        f"corrected, the level misfit falls from {before:.1f} to {left:.1f} dB (mean level of each response removed). Air has 1.2 kg/m3. "
        "Correct it in the FE model, and export it again"
    )


def softness_text(seen: Seen) -> str:
    """Clause that the model is too stiff or too soft, if its number of resonances differs much from the measured one; else empty.

    The lowest resonance must differ in the same sense, because heavy damping and noise can hide resonances or feign some.
    """
    peaks = [peak_lines(values) for values in (seen.measured, seen.model)]
    measured, computed = (max(own.size, 1) for own in peaks)
    first = [float(seen.s[own[0]].imag) if own.size else np.nan for own in peaks]
    soft = computed > measured
    if max(measured, computed) < MORE * min(measured, computed) or (first[1] >= first[0] if soft else first[1] <= first[0]):
        return ""
    wrong = "soft or too heavy" if soft else "stiff or too light"
    counts = f"The model has {computed} resonances, the measurement {measured}"
    return f". {counts}: the model is too {wrong} (density, modulus, thickness, supports)"


def _cases(seen: Seen, factor: float) -> Iterator[_Case]:
    """Matrix, factor by which it is too large, FRFs after correction (F, R), and level [dB] to be subtracted from the difference.

    Dividing the mass by f is the same as multiplying K + D + s C by f, with FRFs larger by f. Proportional damping follows the matrix that
    is corrected. Full solves are used because a model with thousands of modes in the band cannot be reduced.
    """
    plain, dynamic = seen.inputs.model, seen.dynamic
    with suppress(LrbcError):
        stiff = _stiffened(seen, factor, _damping(seen, "beta", factor))
        yield "stiffness", 1.0 / factor, stiff.evaluate(dynamic), 0.0
        light = _stiffened(seen, factor, _damping(seen, "alpha", 1.0 / factor) * factor) if plain.C.nnz else stiff
        yield "mass", factor, light.evaluate(factor * dynamic), 20.0 * float(np.log10(factor))


def _thickened(seen: Seen, factor: float) -> _Case:
    """As ``_cases``, for a thickness off by t, the square root of ``factor``: K t^3 + D - w^2 M t is t times K t^2 + D / t - w^2 M."""
    t = float(np.sqrt(factor))
    ports = _stiffened(seen, factor, _damping(seen, "beta", factor))
    return "thickness", 1.0 / t, ports.evaluate(seen.dynamic / t), -20.0 * float(np.log10(t))


def _stiffened(seen: Seen, factor: float, damping: sp.csc_array) -> PortFrf:
    """Port FRFs by full solves with another damping matrix and the stiffness matrix multiplied."""
    return ported(seen, replace(seen.inputs.model, K=seen.inputs.model.K * factor, C=damping))


def _damping(seen: Seen, of: str, times: float) -> sp.csc_array:
    """Damping matrix with alpha or beta of proportional damping multiplied."""
    recipe = seen.inputs.recipe
    return with_factors(seen.inputs.model, recipe, {name: times for name in recipe.proportional if name.startswith(of)})[0].C
