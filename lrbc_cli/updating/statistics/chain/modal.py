"""Modes fitted to the peaks of two measurements, and differences of these that no bolt causes: a window, another clock, a filter.

An exponential window adds the same amount to the decay rates of all modes. Another clock scales all frequencies by the same factor. A
filter turns the phases of its channel against those of the others; bolts do not, since modes of lightly damped structures are real.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from lrbc_cli.arrays import Complexes, Floats
from lrbc_cli.updating.checked import Checked, Count, NotNegative, Positive, Share
from lrbc_cli.updating.knots import evenly
from lrbc_cli.updating.peaks import peaks_of


@dataclass(frozen=True, kw_only=True)
class ModalRule(Checked):
    """Limits from which differences of the modes of a job and the reference job are attributed to a window, a clock or a filter.

    Attributes
    ----------
    prominence_db : float
        Least prominence of a peak in the mean spectrum, and depth to which its lines are fitted [dB]. A choice: half the amplitude.
    lines : int
        Largest number of lines on each side of a peak that are fitted; at least two are. A choice.
    known : float
        Largest relative standard deviation of a decay rate. A choice.
    tolerance : float
        Largest relative distance of the frequencies of one mode in both jobs. A choice.
    alike : float
        Least MAC of their shapes: the usual limit for one mode.
    least : int
        Least number of modes that agree. Two could by chance.
    share : float
        Window: least difference of a decay rate, over the median difference. A choice: loosened bolts damp some modes and not others.
    powers : float
        Window: least decay over the length of a record, as exponent of e; a window that leaves more than 1/e at its end is none.
    level_db : float
        Window: least change of the levels at the peaks [dB]: as much as a misfit may rise before a job counts as unexplained.
    beyond : float
        Window: largest ratio of frequencies of a mode and of the lowest or highest mode of the reference job, beyond which it lies, up to
        which that mode's damping ratio is its expected one. A choice: damping varies little over an octave.
    clock : float
        Clock: least relative shift of the frequencies. A choice: the temperature of metals causes a third of it for 10 K.
    clock_in_air : float
        The same if the model contains air: the speed of sound, and with it all modes of air, rises by as much for 9 K. Also if fewer than
        ``clocked`` modes agree: bolts tightened anew move single modes by a per cent, and three of five agreed on a right rig.
    together : float
        Clock: largest deviation of a mode's relative shift from the median shift, over that, in the upper half of the shifts; for shifts by
        whole lines the largest deviation from these, in line spacings. A choice: bolts lower some modes and not others.
    tempered, most : float
        Clock: the same for another temperature of the structure, in all shifts, and the share of the modes that must agree. A choice: in no
        job of 20 virtual campaigns 70 % of five modes or more did.
    clocked : int
        Clock: least number of modes that can be compared. A choice. In 3 of 327 jobs of virtual rigs ``least`` of them agreed by chance;
        when more had to agree, jobs with another clock were judged without a doubt.
    seen : float
        Filter: a channel shows a mode if it has at least this share of the mean square amplitude of all channels. A choice.
    turned : float
        Filter: least median angle between a channel and the others, with the same sign at all modes that it shows [degrees]. A choice:
        neighbouring modes reach 16 on ring flanges, others 5.
    """

    prominence_db: Positive = 6.0
    lines: Count = 12
    known: Positive = 0.1
    tolerance: Positive = 0.05
    alike: Share = 0.9
    least: Count = 3
    share: NotNegative = 0.5
    powers: Positive = 1.0
    level_db: NotNegative = 1.5
    beyond: NotNegative = 2.0
    clock: Positive = 0.005
    clock_in_air: Positive = 0.015
    together: Positive = 0.15
    tempered: Positive = 0.25
    most: Share = 0.7
    clocked: Count = 4
    seen: Share = 0.1
    turned: NotNegative = 20.0


#: The default, for callers that use a part of the package by itself.
MODAL = ModalRule()


@dataclass(frozen=True)
class FittedModes:
    """Modes fitted to peaks, of those peaks that one mode fits well.

    Attributes
    ----------
    frequency_hz, decay : (m,) float arrays
        Damped frequency [Hz] and decay rate [1/s].
    shape : (m, R) complex array
        Residues at the R responses.
    """

    frequency_hz: Floats
    decay: Floats
    shape: Complexes

    def without(self, response: int) -> FittedModes:
        """The same without one response."""
        return FittedModes(self.frequency_hz, self.decay, np.delete(self.shape, response, axis=1))


def fitted_modes(frequency_hz: Floats, measured: Complexes, rule: ModalRule = MODAL) -> FittedModes:
    """Fit ``(a_r + b_r s) / (s - p)`` to the lines about each peak, with one pole p for all responses; linear least squares.

    Parameters
    ----------
    frequency_hz : (F,) float array
        Evenly spaced.
    measured : (F, R) complex array
        Responses with missing lines are left out.
    rule : ModalRule
    """
    H = measured[:, (np.isfinite(measured) & (measured != 0)).all(axis=0)]
    step = float(np.median(np.diff(frequency_hz))) if frequency_hz.size > 1 else 0.0
    found: list[tuple[float, float, Complexes]] = []
    if H.size and step > 0.0:
        power = np.abs(H) ** 2
        level = 10.0 * np.log10((power / np.median(power, axis=0)).mean(axis=1))
        for k in peaks_of(level, prominence=rule.prominence_db).tolist():
            first, last = _about(level, k, rule)
            if first < 0 or last >= level.size:
                continue
            offset, std, shape = _pole(H[first : last + 1], np.arange(first - k, last + 1 - k))
            decay = -2.0 * np.pi * step * offset.real
            # This also excludes negative decay rates.
            if 2.0 * np.pi * step * std < rule.known * decay:
                found.append((float(frequency_hz[k] + step * offset.imag), decay, shape))
    shapes = np.array([shape for *_, shape in found], dtype=complex).reshape(len(found), H.shape[1])
    return FittedModes(np.array([f for f, *_ in found]), np.array([decay for _, decay, _ in found]), shapes)


def _about(level: Floats, peak: int, rule: ModalRule) -> tuple[int, int]:
    """Indices of the first and last line about a peak that are fitted; they may exceed the lines."""
    ends = []
    for direction in (-1, 1):
        at = peak
        while abs(at - peak) < rule.lines and 0 <= at + direction < level.size and level[at + direction] > level[peak] - rule.prominence_db:
            at += direction
        ends.append(peak + direction * max(abs(at - peak), 2))
    return ends[0], ends[1]


def _pole(H: Complexes, line: Floats) -> tuple[complex, float, Complexes]:
    """Pole of FRFs (n, R) on ``line`` (n,), counted from the peak, its standard deviation, both in line spacings, and residues (R,).

    Linear least squares for ``(z - p) H = a + b z`` with ``z = i line``; a and b are projected out first.
    """
    z = 1j * line
    basis = np.stack([np.ones(z.size), z], axis=1)
    q = np.linalg.qr(basis)[0]

    def beside(values: Complexes) -> Complexes:
        return np.asarray(values - q @ (q.conj().T @ values))

    plain, moved = beside(H), beside(z[:, None] * H)
    size = float(np.vdot(plain, plain).real)
    pole = complex(np.vdot(plain, moved) / size) if size > 0.0 else 0j
    left = moved - pole * plain
    free = max(H.size - 2 * H.shape[1] - 1, 1)
    std = float(np.sqrt(np.vdot(left, left).real / free / size)) if size > 0.0 else np.inf
    constant, slope = np.linalg.lstsq(basis, (z - pole)[:, None] * H, rcond=None)[0]
    return pole, std, constant + pole * slope


def same_modes(own: FittedModes, other: FittedModes, rule: ModalRule = MODAL) -> list[tuple[int, int]]:
    """Index pairs of modes that are the same in both jobs: near in frequency, and each the other's best match by MAC."""
    if not own.decay.size or not other.decay.size or own.shape.shape[1] != other.shape.shape[1]:
        return []
    power = [(np.abs(each.shape) ** 2).sum(axis=1) for each in (own, other)]
    mac = np.abs(own.shape @ other.shape.conj().T) ** 2 / np.outer(*power)
    mac[np.abs(own.frequency_hz[:, None] / other.frequency_hz - 1.0) > rule.tolerance] = 0.0
    best = mac.argmax(axis=1)
    return [(i, int(k)) for i, k in enumerate(best) if mac[i, k] > rule.alike and mac[:, k].argmax() == i]


class ChainFault(NamedTuple):
    """Difference between the measuring chains of two jobs.

    Attributes
    ----------
    kind : str
        ``blow``: hit twice; ``window``, ``lines`` (counted from another first line), ``clock``, ``filter``.
    text : str
    """

    kind: str
    text: str


def other_chain(
    frequency_hz: Floats,
    own: Complexes,
    tight: Complexes,
    reference: str,
    names: list[str],
    rule: ModalRule = MODAL,
    *,
    air: bool = False,
    loosened: bool = True,
) -> ChainFault | None:
    """Whether a job was measured with another window, clock or filter than the reference job, as its modes show; None if not.

    Parameters
    ----------
    frequency_hz : (F,) float array
        Must be evenly spaced, otherwise None is returned.
    own, tight : (F, R) complex arrays
        NaN where a response was not measured.
    reference : str
        Name of the reference job.
    names : list of str
        Of the responses.
    rule : ModalRule
    air : bool
        Whether there are modes of air, whose frequencies depend on its temperature.
    loosened : bool
        Whether bolts may be looser than in the reference job, which lowers some modes: not in a baseline.
    """
    steps = np.diff(frequency_hz)
    if not evenly(frequency_hz):
        return None
    held = np.isfinite(own).all(axis=0) & np.isfinite(tight).all(axis=0) & (own != 0).all(axis=0) & (tight != 0).all(axis=0)
    one, other = (fitted_modes(frequency_hz, values[:, held], rule) for values in (own, tight))
    pairs = same_modes(one, other, rule)
    first, second = ([pair[i] for pair in pairs] for i in (0, 1))
    length = 1.0 / float(steps.mean())
    least, step = rule.clock_in_air if air else rule.clock, float(steps.mean())
    frequencies = one.frequency_hz[first], other.frequency_hz[second]
    window = _window(one.decay[first], other.decay[second], length, reference, rule)
    if text := window or _window_by_curve(one, other, length, reference, rule):
        return ChainFault("window", text)
    if text := _moved(*frequencies, step, reference, rule, loosened=loosened):
        return ChainFault("lines", text)
    if text := _clock(*frequencies, reference, rule, least, loosened=loosened):
        return ChainFault("clock", text)
    text = _filter(one, other, reference, [name for name, there in zip(names, held, strict=True) if there], rule)
    return None if text is None else ChainFault("filter", text)


def _window(own: Floats, tight: Floats, length: float, reference: str, rule: ModalRule) -> str | None:
    """Message if the decay rates ``own`` and ``tight`` of the same modes [1/s] differ by a constant; ``length`` of a record [s]."""
    if own.size < rule.least:
        return None
    change = float(np.median(own - tight))
    sign = 1.0 if change > 0.0 else -1.0
    level = 20.0 * float(np.median(np.abs(np.log10(own / tight))))
    if abs(change) * length < rule.powers or level < rule.level_db or np.any(sign * (own - tight) < rule.share * abs(change)):
        return None
    # Damping of the material multiplies all decay rates, a window adds a constant to them. A loosened bolt, or two modes that broadened
    # peaks merge, change single ones: the middle half counts.
    times, added = (float(np.subtract(*np.percentile(of, (75, 25))) / abs(np.median(of))) for of in (np.log(own / tight), own - tight))
    if times < added:
        return None
    return (
        f"all {own.size} modes that can be compared decay {'faster' if sign > 0 else 'slower'} than in {reference} by the same "
        f"{abs(change):.3g} 1/s (median), {level:.1f} dB at their peaks. Check whether an exponential window was set for "
        f"{'this job' if sign > 0 else reference}, down to about {100.0 * np.exp(-abs(change) * length):.2g} % at the end of the record. "
        "Use one window in all jobs, best none"
    )


def _window_by_curve(one: FittedModes, other: FittedModes, length: float, reference: str, rule: ModalRule) -> str | None:
    """The same with decay rates of the reference job interpolated at the job's frequencies, since loosened bolts change mode shapes.

    Below its lowest and above its highest mode these have the damping ratio of that mode, as loosened bolts also lower frequencies.
    Differences must also be within ``share`` of their median, in both directions. In 235 jobs of virtual rigs and of structures of
    another FE code the closest one without a window had differences of 0.4 to 1.6 times the median; a window with a time constant of 8 %
    of the record was found in 164, by modes of the same shapes alone in 72.
    """
    order = np.argsort(other.frequency_hz)
    hz, decay = other.frequency_hz[order], other.decay[order]
    if hz.size < rule.clocked:
        return None
    within = (one.frequency_hz >= hz[0] / rule.beyond) & (one.frequency_hz <= hz[-1] * rule.beyond)
    at, own = one.frequency_hz[within], one.decay[within]
    there = np.interp(at, hz, decay) * np.maximum(at / hz[-1], 1.0) * np.minimum(at / hz[0], 1.0)
    change = own - there
    if own.size < rule.clocked or np.ptp(change) > 2.0 * rule.share * abs(np.median(change)):
        return None
    return _window(own, there, length, reference, rule)


def window_of_model(frequency_hz: Floats, measured: Complexes, model: Complexes, rule: ModalRule = MODAL) -> tuple[int, float]:
    """Number of modes that decay faster than those of a model by the same amount, and that amount, median [1/s]; zeros if they do not.

    An exponential window in all jobs does that. Each difference must be within ``share`` of their median, of ``clocked`` modes or more.

    Parameters
    ----------
    frequency_hz : (F,) float array
    measured, model : (F, R) complex arrays
        NaN where a response was not measured.
    rule : ModalRule
    """
    held = np.isfinite(measured).all(axis=0) & (measured != 0).all(axis=0)
    if not evenly(frequency_hz) or not held.any():
        return 0, 0.0
    own, other = (fitted_modes(frequency_hz, values[:, held], rule) for values in (measured, model))
    pairs = same_modes(own, other, rule)
    decay, stated = own.decay[[i for i, _ in pairs]], other.decay[[k for _, k in pairs]]
    length, added = 1.0 / float(np.diff(frequency_hz).mean()), decay - stated
    middle = float(np.median(added)) if added.size else 0.0
    same = added.size >= rule.clocked and middle > 0.0 and bool(np.all(np.abs(added - middle) <= rule.share * middle))
    return (added.size, middle) if same and _window(decay, stated, length, "", rule) else (0, 0.0)


def _moved(own: Floats, tight: Floats, step: float, reference: str, rule: ModalRule, *, loosened: bool) -> str | None:
    """Message if the frequencies of the same modes [Hz] differ by a whole number of line spacings, in the upper half of the shifts.

    In all of them if no bolt is ``loosened``: half of the modes of a baseline agreed by chance.
    """
    if own.size < rule.clocked:
        return None
    upper = np.sort((own - tight) / step)[::-1][: max(rule.least, (own.size + 1) // 2) if loosened else own.size]
    count = round(float(np.median(upper)))
    if count == 0 or np.abs(upper - count).max() > rule.together:
        return None
    aside = f"{abs(count)} line{'s' if abs(count) > 1 else ''} ({abs(count) * step:.4g} Hz)"
    return (
        f"{upper.size} of the {own.size} modes that can be compared are {aside} {'higher' if count > 0 else 'lower'} than in {reference}, "
        "all by the same amount; a loosened bolt lowers some modes more than others. Check whether the lines of its file were counted from "
        f"another first line, or the first was left out; {'subtract' if count > 0 else 'add'} {abs(count) * step:.4g} Hz "
        f"{'from' if count > 0 else 'to'} its frequencies, or export it again"
    )


def _clock(own: Floats, tight: Floats, reference: str, rule: ModalRule, least: float, *, loosened: bool) -> str | None:
    """Message if frequencies of the same modes [Hz] differ by a factor, in the upper half, since ``loosened`` bolts lower some modes."""
    if own.size < rule.clocked:
        return None
    share = np.sort(own / tight - 1.0)[::-1]
    upper = share[: max(rule.least, (share.size + 1) // 2)]
    typical = float(np.median(upper))
    alike = np.abs(share - typical) <= rule.together * abs(typical)
    if alike.sum() < rule.clocked:
        # With all bolts tight, so few modes agree by chance only.
        least = max(least, rule.clock_in_air) if loosened else np.inf
    count = upper.size
    if abs(typical) < least or not alike[:count].all():
        # Another temperature shifts nearly all modes; bolts and supports keep their stiffness, so modes in which these work shift less.
        typical = float(np.median(share))
        count = int((np.abs(share - typical) <= rule.tempered * abs(typical)).sum())
        if abs(typical) < least or count < max(rule.clocked + 1, rule.most * share.size):
            return None
    return (
        f"{count} of the {own.size} modes that can be compared are {abs(typical):.2%} {'higher' if typical > 0 else 'lower'} than in "
        f"{reference}, all by the same percentage; a loosened bolt lowers some modes more than others. Check whether the sampling rate or "
        "the clock of the front end differs between the two jobs, or the structure is much warmer or colder. Set it as in "
        f"{reference} and measure again; if only the file is wrong, divide its frequencies by {1.0 + typical:.5g}"
        f"{', or by more, as far as loosened bolts lower them' if loosened else ''}"
    )


def _filter(own: FittedModes, tight: FittedModes, reference: str, names: list[str], rule: ModalRule) -> str | None:
    """Message if phases of a channel are turned against the others; modes are paired and scaled without that channel."""
    found = []
    for r, name in enumerate(names if len(names) > rule.least else ()):
        others = np.arange(len(names)) != r
        pairs = same_modes(own.without(r), tight.without(r), rule)
        mine, theirs = own.shape[[i for i, _ in pairs]], tight.shape[[k for _, k in pairs]]
        common = (theirs[:, others].conj() * mine[:, others]).sum(axis=1)
        seen = np.all([np.abs(each[:, r]) ** 2 > rule.seen * (np.abs(each) ** 2).mean(axis=1) for each in (mine, theirs)], axis=0)
        angle = np.degrees(np.angle(mine[:, r] * theirs[:, r].conj() / common))[seen]
        if angle.size >= rule.least and abs(np.median(angle)) >= rule.turned and np.unique(np.sign(angle)).size == 1:
            found.append(f"{name} by {np.abs(angle).min():.0f} to {np.abs(angle).max():.0f} degrees")
    if not found or 2 * len(found) > len(names):
        return None
    return (
        f"phases are turned relative to the other responses at all modes: {', '.join(found)}. No bolt does that. Check whether this "
        f"channel was measured with another filter, AC coupling or integration than in {reference}. Measure again with the same settings"
    )
