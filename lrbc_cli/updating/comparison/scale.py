"""Constant factors between measured and computed FRFs: wrong units, derivatives, signs or delays, as hints for the user.

A wrong unit changes all lines by the same factor, whereas the differences of a wrong model vary along the band. A factor is reported only
if the medians of parts of the band agree on it and most of the misfit vanishes when it is taken out.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from itertools import product

import numpy as np

from lrbc_cli.arrays import Complexes, Floats
from lrbc_cli.updating.comparison.delays import delay_of
from lrbc_cli.updating.robust import scatter

#: Number of parts of the band whose medians are compared, least number of lines of each, Student's t for so many medians (two-sided 95 %).
PARTS, LEAST_LINES, STUDENT = 8, 5, 2.365

#: Standard deviation of the median of Gaussian values over that of their mean.
MEDIAN_SPREAD = 1.2533

#: Least factor that counts [dB]: below it are gains of sensors, with model and mounting; the smallest factor of the table is 3 dB.
LEAST_OFFSET = 2.0

#: Largest share of the misfit that may be left when a factor is taken out: otherwise it has mostly other causes.
LEFT = 0.5

#: A known factor is recognised within half of the interval, limited to these: the error of a sensor's calibration (6 %), and half the
#: distance of two factors of the table [dB].
LEAST_REACH, MOST_REACH = 0.5, 1.5

#: A power of the frequency must leave less than this share of what a constant leaves, because in a narrow band both are alike.
BETTER = 0.95

#: Powers of the frequency that one or two derivatives or integrals too many leave.
POWERS = (-2, -1, 1, 2)

#: Least mean cosine between measured and computed phases that agree when turned or mirrored, and least excess of it over the cosine of
#: the unchanged phases: 0.6 is 53 degrees, while unrelated phases give 0.
ALIKE, TURNED = 0.6, 0.6

#: The same for the mean over all responses, to decide that all are mirrored.
LEAST_ALIKE = 0.35

OWN_UNITS = {"pressure": "Pa", "displacement": "m", "velocity": "m/s", "acceleration": "m/s2"}

GRAVITY, POUND_FORCE, INCH, FOOT, PSI = 9.80665, 4.4482216, 0.0254, 0.3048, 6894.757


@dataclass(frozen=True)
class Known:
    """A factor that a common mistake leaves.

    Attributes
    ----------
    db : float
        Measured over computed FRFs [dB].
    cause : str
    unit : str or None
        Unit of the FRFs with this mistake, instead of SI; None if the mistake is not a unit.
    of_model : bool
        Whether the mistake is in the model.
    of_all : bool
        Whether it affects all responses of a quantity to one excitation: unit of the force, convention of the analyser, the model.
    """

    db: float
    cause: str
    unit: str | None = None
    of_model: bool = False
    of_all: bool = False


@dataclass(frozen=True, kw_only=True)
class Offset:
    """The factor ``10^(db/20) (i 2 pi f)^power`` between the measured and the computed FRFs of a response.

    Attributes
    ----------
    response : int
    db : float
        Measured over computed, power of the frequency taken out [dB].
    half : float
        Half of its 95 % interval, from the scatter of medians over parts of the band [dB].
    power : int
        Power of ``i 2 pi f``.
    known : tuple of Known
        Common mistakes that leave this factor, likeliest first.
    before, after : float
        Mean absolute difference without and with the factor taken out [dB].
    named : bool
        Whether the factor explains the misfit and may be reported.
    reversed, conjugate : bool
        Whether the phase is turned by 180 degrees, and whether its sign is reversed.
    phases : mapping
        Mean cosine between the phases, by (turned, mirrored).
    delay : float
        Delay of the measured relative to the computed FRFs [s], negative if they lead; 0 if none is clear.
    uncalibrated : bool
        Whether the file states voltages: no mistake of a unit explains the factor then.
    """

    response: int
    db: float
    half: float
    power: int
    known: tuple[Known, ...]
    before: float
    after: float
    named: bool = False
    reversed: bool = False
    conjugate: bool = False
    phases: Mapping[tuple[bool, bool], float] = field(default_factory=dict, repr=False)
    delay: float = 0.0
    uncalibrated: bool = False

    @property
    def unit(self) -> Known | None:
        """The unit (or time derivative) that explains the factor; None if none does."""
        if not self.named:
            return None
        return next((known for known in self.known if known.unit is not None), None)


def _db(value: float) -> float:
    return float(20.0 * np.log10(value))


@cache
def known_factors(quantity: str) -> tuple[Known, ...]:
    """Common mistakes in FRFs of a physical quantity over a force."""
    found = [Known(0.0, "", "")]
    if quantity == "pressure":
        responses = [("hPa", 1e2), ("kPa", 1e3), ("MPa", 1e6), ("mPa", 1e-3), ("uPa", 1e-6), ("psi", PSI)]
    else:
        tail = {"velocity": "/s", "acceleration": "/s2"}.get(quantity, "")
        responses = [(f"{name}{tail}", size) for name, size in (("mm", 1e-3), ("cm", 1e-2), ("um", 1e-6), ("in", INCH), ("ft", FOOT))]
        if quantity == "acceleration":
            responses = [("g", GRAVITY), ("mg", 1e-3 * GRAVITY), *responses]
    forces = [("N", 1.0), ("lbf", POUND_FORCE), ("kN", 1e3), ("mN", 1e-3), ("kgf", GRAVITY)]
    # Mixtures such as metric forces with imperial lengths are not used.
    for (name, size), (force, per) in product(responses, forces[:2]):
        found.append(Known(_db(per / size), f"FRFs in {name}/{force}", f"{name}/{force}"))
    own = OWN_UNITS[quantity]
    found += [Known(_db(per), f"FRFs per {force}", f"{own}/{force}", of_all=True) for force, per in forces[1:]]
    if quantity == "pressure":
        found.append(Known(_db(1.0 / 2e-5), "levels in dB re 20 uPa/N read as dB re 1 Pa/N"))
    model = "a model in MPa" if quantity == "pressure" else "a model in mm"
    found.append(
        Known(
            120.0 if quantity == "pressure" else -60.0,
            f"{model} (exported in N, mm, t; then write `units: mm-N-t`)",
            own,
            of_model=True,
            of_all=True,
        )
    )
    for factor, cause in (
        (np.sqrt(2.0), "rms and peak values mixed"),
        (2.0, "one-sided and two-sided spectra, or peak and peak-to-peak values, mixed"),
        (2.0 * np.pi, "Hz and rad/s mixed"),
    ):
        found += [Known(_db(factor), cause, of_all=True), Known(-_db(factor), cause, of_all=True)]
    return tuple(found)


def _recognised(value: float, half: float, table: Sequence[Known]) -> tuple[Known, ...]:
    reach = min(max(half, LEAST_REACH), MOST_REACH)
    near = [known for known in table if abs(known.db - value) <= reach]
    if not near:
        return ()
    nearest = min(abs(known.db - value) for known in near)
    # Mistakes with the same factor are reported together.
    return tuple(known for known in near if abs(known.db - value) <= nearest + 0.05)


def unit_near(db: float, half: float, quantity: str) -> str | None:
    """Unit of FRFs of a quantity whose numbers, read as SI, are higher by a factor [dB] (``half``: of its interval); None if unknown."""
    found = next((known for known in _recognised(db, half, known_factors(quantity)) if known.unit is not None and not known.of_model), None)
    return None if found is None else found.unit or f"{OWN_UNITS[quantity]}/N"


def _parts(values: Floats) -> tuple[Floats, Floats]:
    """Median of each row (B, F), and half of its 95 % interval from the scatter of medians over parts of the band."""
    count = min(PARTS, values.shape[1] // LEAST_LINES)
    centres = np.median(values, axis=1)
    if count < 2:
        return centres, np.full(centres.size, np.inf)
    parts = np.stack([np.median(part, axis=1) for part in np.array_split(values, count, axis=1)])
    return centres, STUDENT * MEDIAN_SPREAD * scatter(parts) / float(np.sqrt(count))


def _scores(measured: Complexes, model: Complexes, power: int) -> dict[tuple[bool, bool], float]:
    """Mean cosine between the phases as they are, turned by 180 degrees, mirrored (conjugated), or both; by (turned, mirrored).

    Parameters
    ----------
    measured, model : (F,) complex arrays
        No zeros.
    power : int
        Power of i omega by which ``measured`` was divided before.
    """
    x, y = measured / np.abs(measured), model / np.abs(model)
    # Mirroring changes nothing near the real axis and equals a turn near the imaginary one: both kinds of lines get half the weight.
    sideways = np.abs(y.imag) > np.abs(y.real)
    tells = min(sideways.sum(), (~sideways).sum()) >= LEAST_LINES

    def alike(other: Complexes, sign: float = 1.0) -> float:
        cosine = sign * np.real(x * np.conj(other))
        return float(0.5 * (cosine[sideways].mean() + cosine[~sideways].mean())) if tells else float(cosine.mean())

    # The conjugate of i omega is -i omega.
    return {
        (turned, mirrored): (-1.0 if turned else 1.0) * (alike(np.conj(y), (-1.0) ** power) if mirrored else alike(y))
        for turned in (False, True)
        for mirrored in (False, tells)
    }


def _turns(scores: dict[tuple[bool, bool], float]) -> tuple[bool, bool]:
    """The (turned, mirrored) with the largest cosine if it is clear, else (False, False)."""
    best = max(scores, key=lambda key: scores[key])
    if scores[best] >= ALIKE and scores[best] - scores[False, False] >= TURNED:
        return best
    return False, False


def _one_convention(offsets: Sequence[Offset]) -> list[Offset]:
    """Decide whether the responses are mirrored: all or none, since a file has one sign convention; then whether each is reversed."""
    telling = [offset.phases for offset in offsets if (False, True) in offset.phases]

    def best(turned: bool) -> float:
        # Sensors may be reversed one by one.
        return float(np.mean([max(phases[False, turned], phases[True, turned]) for phases in telling])) if telling else 0.0

    mirrored = best(True) >= LEAST_ALIKE and best(True) - best(False) >= LEAST_ALIKE
    found = []
    for offset in offsets:
        if mirrored and (False, True) in offset.phases:
            scores = {(turned, False): offset.phases[turned, True] for turned in (False, True)}
        else:
            scores = {key: score for key, score in offset.phases.items() if not key[1]}
        found.append(replace(offset, conjugate=mirrored, reversed=_turns(scores)[0]))
    return found


def offset_of(
    response: int,
    frequency_hz: Floats,
    measured: Complexes,
    states: Sequence[Complexes],
    quantity: str,
    powers: Sequence[int] = (0, *POWERS),
) -> Offset | None:
    """The constant factor between measured and computed FRFs of one response.

    Parameters
    ----------
    response : int
    frequency_hz : (F,) float array
    measured : (F,) complex array
        NaN or zero where not measured.
    states : sequence of (F,) complex arrays
        FRFs of the model in all known states. The state with the least difference after its factor is taken out is used, because a fit
        may have moved resonances to compensate for the factor.
    quantity : str
        Physical quantity of the model's FRFs.
    powers : sequence of int
        Powers of the frequency that are tried.

    Returns
    -------
    Offset or None
        None if too few lines can be compared, or no known factor has one of these powers.
    """
    least = np.inf
    found: list[tuple[float, Offset, Complexes, Complexes, Floats]] = []
    for model in states:
        valid = np.isfinite(measured) & (np.abs(measured) > 0) & np.isfinite(model) & (np.abs(model) > 0)
        if valid.sum() < 2 * LEAST_LINES:
            continue
        x, y = measured[valid], model[valid]
        level = 20.0 * np.log10(np.abs(x / y))
        before = float(np.mean(np.abs(level)))
        least = min(least, before)
        rests = level - 20.0 * np.array(powers)[:, None] * np.log10(2.0 * np.pi * frequency_hz[valid])
        centres, halves = _parts(rests)
        lefts = np.abs(rests - centres[:, None]).mean(axis=1)
        for b, centre, half, left in zip(powers, centres.tolist(), halves.tolist(), lefts.tolist(), strict=True):
            known = _recognised(centre, half, known_factors(moved(quantity, b) or quantity))
            if b:
                known = tuple(k for k in known if k.unit is not None)
                # A constant that no unit explains may be a gain; with a power of the frequency it has no meaning.
                if not known:
                    continue
            offset = Offset(response=response, db=centre, half=half, power=b, known=known, before=before, after=left)
            found.append((left / BETTER if b else left, offset, x * 1j ** (-b), y, frequency_hz[valid]))
    if not found:
        return None
    _, best, x, y, lines = min(found, key=lambda entry: entry[0])
    big = best.power != 0 or abs(best.db) >= max(LEAST_OFFSET, best.half)
    named = bool(big and np.isfinite(best.half) and best.after <= LEFT * least)
    known = tuple(k for k in best.known if k.db != 0.0 or best.power)
    delay = delay_of(lines, x[:, None], y[:, None])
    return replace(best, known=known, before=least, named=named, phases=_scores(x, y, best.power), delay=delay)


def moved(quantity: str, power: int) -> str | None:
    """The motion after ``power`` time derivatives (integrals if negative) of a motion; None if there is none."""
    motions = ("displacement", "velocity", "acceleration")
    at = motions.index(quantity) + power if quantity in motions else -1
    return motions[at] if 0 <= at < len(motions) else None


def offsets_of(frequency_hz: Floats, measured: Complexes, states: Sequence[Complexes], quantities: Sequence[str]) -> tuple[Offset, ...]:
    """The constant factors of all responses that can be compared, with a common sign convention.

    Parameters
    ----------
    frequency_hz : (F,) float array
    measured : (F, R) complex array
    states : sequence of (F, R) complex arrays
    quantities : sequence of str

    Returns
    -------
    tuple of Offset
    """

    def of(r: int, powers: Sequence[int] = (0, *POWERS)) -> Offset | None:
        return offset_of(r, frequency_hz, measured[:, r], [y[:, r] for y in states], quantities[r], powers)

    found = [offset for offset in (of(r) for r in range(measured.shape[1])) if offset is not None]
    # Far from its peaks a single response may not distinguish a power from a constant: the majority decides.
    powers = [offset.power for offset in found if offset.named]
    usual = max(POWERS, key=powers.count)
    if 2 * powers.count(usual) > len(powers):
        first = tuple(found)
        for i, offset in enumerate(first):
            if not offset.named:
                continue
            other = offset if offset.power == usual else of(offset.response, (usual,))
            clear = other is not None and other.named
            if other is None or not clear or other.half > MOST_REACH:
                # One analyser wrote them: what is not clear by itself has the factor of the clearest, if most have one.
                own = [o for o in first if quantities[o.response] == quantities[offset.response]]
                shared = [o for o in own if o.named and o.power == usual]
                if 2 * len(shared) > len(own):
                    clearest = min(shared, key=lambda o: o.half)
                    other, clear = replace(clearest, response=offset.response, before=offset.before, after=offset.after), True
            if other is not None and clear:
                found[i] = other
    found = _one_convention(found)
    if any(o.delay or o.conjugate for o in found):
        return tuple(found)
    # One front end: what is not clear for any response alone may be for all together, in the state in which their phases agree best.
    every = [o.response for o in found]
    unturned = measured[:, every] * 1j ** -np.array([o.power for o in found])
    delay = max((delay_of(frequency_hz, unturned, y[:, every]) for y in states), key=abs, default=0.0) if every else 0.0
    return tuple(replace(o, delay=delay) for o in found)


@dataclass(frozen=True)
class Common:
    """Responses with the same factor.

    Attributes
    ----------
    responses : tuple of int
    offset : Offset
        That of the response with the narrowest interval, with the median of their factors.
    """

    responses: tuple[int, ...]
    offset: Offset


def grouped(offsets: Sequence[Offset], quantities: Sequence[str]) -> tuple[Common, ...]:
    """The named factors in groups that agree within their intervals; the mistake of a group is recognised by its median.

    Parameters
    ----------
    offsets : sequence of Offset
    quantities : sequence of str
        Physical quantity of all responses.
    """
    named = [o for o in offsets if o.named]
    # One file, one front end: a factor that is clear for some responses holds for all, if it is nearer to theirs than no factor.
    middle = float(np.median([o.db for o in offsets])) if offsets else 0.0
    reach = MOST_REACH + LEAST_REACH
    limits = [max(reach, o.half) if o.named else max(reach, o.half, abs(o.db)) for o in offsets]
    # Of many 95 % intervals some miss: a quarter may by as much again.
    away = [abs(o.db - middle) / most for o, most in zip(offsets, limits, strict=True)]
    alike = bool(named) and all(o.power == named[0].power and far <= 2.0 for o, far in zip(offsets, away, strict=True))
    alike = alike and 4 * sum(far > 1.0 for far in away) <= len(away)
    # A single gain beside the others is nearer to theirs only by the width of these limits.
    alike = alike and (named[0].power != 0 or abs(float(np.median([o.db for o in named])) - middle) <= abs(middle))
    shared = alike and len({quantities[o.response] for o in offsets}) == 1
    left = sorted(offsets if shared else named, key=lambda o: (not o.named, o.half, o.response))
    found = []
    while left:
        first = left[0]
        group = [o for o in left if shared or (o.power == first.power and abs(o.db - first.db) <= max(MOST_REACH, o.half + first.half))]
        left = [o for o in left if o not in group]
        middle = float(np.median([o.db for o in group]))
        table = known_factors(moved(quantities[first.response], first.power) or quantities[first.response])
        known = tuple(
            k
            for k in _recognised(middle, max(o.half for o in group), table)
            if (k.db != 0.0 or first.power) and (k.unit is not None or not first.power)
        )
        # If the median is not recognised, the clearest response decides.
        known = known or first.known
        found.append(Common(tuple(sorted(o.response for o in group)), replace(first, db=middle, known=known)))
    return tuple(found)


def misses_unit(offsets: Sequence[Offset]) -> bool:
    """Whether every response differs by a factor that a unit or a derivative explains, within the interval of the factor."""
    return bool(offsets) and all(
        o.unit is not None and o.half <= MOST_REACH and abs(o.db - o.unit.db) <= max(o.half, LEAST_REACH) for o in offsets
    )
