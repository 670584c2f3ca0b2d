"""What is said of a loose bolt that rattles? Hammer tests of virtual rigs in the time domain, with a contact that opens and closes.

    python tests/benchmarks/rattle.py [--virtual DESIGN:SEEDS]... [--out DIR] [--resume]

A rig of ``data_samples/virtual.py`` (cover, lap, flange) is hit as an operator does, five blows a point of differing force. In each judged
job but one a single bolt has lost 97 % of its rocking stiffness, and its axial spring is a contact: it opens on one side, or has play of a
share of its motion. The identification is linear and knows nothing of this. Takes three to five minutes a campaign.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import scipy.linalg as sl
from blind import designs

import lrbc_cli as lrbc
from lrbc_cli.arrays import Complexes, Floats, Integers
from lrbc_cli.virtual.drift import Scatter

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "data_samples"))

from rigs.joints.campaign import BASELINE, REFERENCE, chain_of, write_campaign  # noqa: E402
from rigs.joints.designs import JOINT_DESIGNS  # noqa: E402
from rigs.joints.nominal import ensure_model  # noqa: E402
from rigs.joints.truth import Rig, State, draw_state  # noqa: E402
from rigs.uff import ACCELERATION, Header, write_uff  # noqa: E402

#: Time step and length of a record [s].
STEP, LENGTH = 2e-5, 4.0

#: Share of a contact's stiffness that is left where it is open, and of rocking stiffness of such a bolt.
LEFT, ROCKING = 0.02, 10**-1.5

#: Most damping of a mode: static responses in the basis are no real modes.
MOST_DAMPING = 0.3


@dataclass(frozen=True)
class Contact:
    """The axial spring of a bolt: closed on one side only, or on both beyond a play (share of its rms motion when free)."""

    one_sided: bool
    play: float

    def __str__(self) -> str:
        return "one-sided" if self.one_sided else f"play {self.play:g}"

    def taken(self, gap: float, motion: Floats) -> Floats:
        """What of a motion the spring does not resist, as a motion: its part within the gap, or to the open side."""
        return np.maximum(motion, -gap) if self.one_sided else np.clip(motion, -gap, gap)

    def settled(self, gap: float, free: Floats, share: float) -> Floats:
        """The motion x with ``x = free + share taken(x)``, ``share`` below 1."""
        within, beyond = free / (1.0 - share), free - share * gap
        if self.one_sided:
            return np.where(free >= -gap * (1.0 - share), within, beyond)
        return np.where(np.abs(free) <= gap * (1.0 - share), within, free + np.sign(free) * share * gap)


#: Never closed; and what is tried.
FREE = Contact(one_sided=False, play=1e9)
CONTACTS = (Contact(one_sided=True, play=0.0), *(Contact(one_sided=False, play=play) for play in (0.1, 0.5, 1.5)))


class Bench:
    """A rig in one state as modes with viscous damping, stepped exactly under forces that are held for a step.

    Parameters
    ----------
    rig : Rig
    state : State
    bolt : str or None
        That of the contact, whose axial spring is closed here.
    """

    def __init__(self, rig: Rig, state: State, bolt: str | None) -> None:
        design, count = rig.design, len(rig.design.springs)
        springs, hammers, sensors = np.split(rig.rows, [count, count + len(design.hammers)], axis=1)
        dynamic = rig.stiffness(state)
        own = [i for i, spring in enumerate(design.springs) if spring.joint == bolt]
        for i in own:
            dynamic[i] *= 1.0 if design.springs[i].component == "UZ" else ROCKING
        k = dynamic.real
        values, vectors = sl.eigh(np.diag(rig.values) + (springs * k) @ springs.T)
        omega = np.sqrt(np.maximum(values, 1.0))
        # The loss of each mode by its share of the strain energy.
        loss = ((vectors.T @ springs) ** 2 * dynamic.imag).sum(axis=1) / omega**2
        if design.loss:
            loss += design.loss * rig.specimen.loss * (vectors.T**2 * rig.values).sum(axis=1) / omega**2
        else:
            alpha, beta = (c * rig.specimen.viscous for c in design.proportional)
            loss += alpha / omega + beta * omega
        zeta = np.clip(0.5 * loss, 0.0, MOST_DAMPING)
        damped, decay = omega * np.sqrt(1.0 - zeta**2), np.exp(-zeta * omega * STEP)
        sine, cosine = decay * np.sin(damped * STEP) / damped, decay * np.cos(damped * STEP)
        self.keep = (cosine + zeta * omega * sine)[:, None], sine[:, None], (-(omega**2) * sine)[:, None]
        self.speed = (cosine - zeta * omega * sine)[:, None]
        self.push = ((1.0 - self.keep[0][:, 0]) / omega**2)[:, None], sine[:, None]
        self.square, self.rate = omega[:, None] ** 2, 2.0 * (zeta * omega)[:, None]
        self.hammers, self.sensors = vectors.T @ hammers, vectors.T @ sensors
        axial = [i for i in own if design.springs[i].component == "UZ"]
        self.axial = (vectors.T @ springs)[:, axial]
        self.stiffness = float(k[axial[0]]) if axial else 0.0

    def run(self, blows: Floats, points: Integers, contact: Contact | None, gap: float, steps: int) -> tuple[Floats, Floats]:
        """Accelerations (steps, sensors, blows) and motions of the contact (steps, blows), forces (steps, blows) at points (blows,)."""
        q, v = (np.zeros((self.square.size, points.size)) for _ in range(2))
        found, motions = np.empty((steps, self.sensors.shape[1], points.size)), np.zeros((steps, points.size))
        hit, lost, reach = self.hammers[:, points], (1.0 - LEFT) * self.stiffness, float((self.axial**2 * self.push[0]).sum())
        for i in range(steps):
            # The force of a blow is that of the middle of the step, that of the contact the mean of both ends: no delay, hence no damping.
            load = hit * blows[i]
            q, v = self.keep[0] * q + self.keep[1] * v + self.push[0] * load, self.keep[2] * q + self.speed * v + self.push[1] * load
            if contact is not None:
                before = contact.taken(gap, motions[i - 1]) if i else 0.0
                free = self.axial[:, 0] @ q + 0.5 * reach * lost * before
                motions[i] = contact.settled(gap, free, 0.5 * reach * lost)
                mean = self.axial * (0.5 * lost * (before + contact.taken(gap, motions[i])))
                q, v = q + self.push[0] * mean, v + self.push[1] * mean
                load = hit * (0.5 * (blows[i] + blows[min(i + 1, steps - 1)])) + self.axial * (lost * contact.taken(gap, motions[i]))
            else:
                load = hit * (0.5 * (blows[i] + blows[min(i + 1, steps - 1)]))
            found[i] = self.sensors.T @ (load - self.square * q - self.rate * v)
        return found, motions


def measured(rig: Rig, state: State, bolt: str | None, contact: Contact | None, rng: np.random.Generator) -> tuple[Complexes, Floats]:
    """FRFs (f, responses) by H1 and their coherence, from noisy records."""
    design, chain, bench = rig.design, chain_of(rig.design), Bench(rig, state, bolt)
    steps, lines = round(LENGTH / STEP), np.rint(design.frequencies * LENGTH).astype(int)
    points = np.repeat(np.arange(len(design.hammers)), chain.hits)
    start = rng.uniform(0.01, 0.02, points.size)
    duration, peak = (nominal * np.exp(rng.normal(0.0, s, points.size)) for nominal, s in ((chain.duration, 0.05), (chain.peak, 0.25)))
    # In the middle of each step; motions are those of its end.
    phase = ((np.arange(steps)[:, None] + 0.5) * STEP - start) / duration
    blows = np.where((phase > 0.0) & (phase < 1.0), peak * np.sin(np.pi * phase), 0.0)
    gap = 0.0
    if contact is not None and contact.play:
        free = bench.run(blows, points, FREE, FREE.play, steps // 10)[1]
        gap = contact.play * float(np.sqrt(np.mean(free**2)))
    force, response = (np.fft.rfft(each, axis=0)[lines] for each in (blows, bench.run(blows, points, contact, gap, steps)[0]))
    response *= np.exp(-1j * np.pi * design.frequencies * STEP)[:, None, None]

    def noisy(spectrum: Complexes, level: Floats | float) -> Complexes:
        noise = rng.standard_normal(spectrum.shape) + 1j * rng.standard_normal(spectrum.shape)
        return np.asarray(spectrum + level * noise / np.sqrt(2))

    frfs, coherences = [], []
    for point in range(len(design.hammers)):
        own = points == point
        x, y = force[:, own], response[:, :, own]
        x = noisy(x, chain.force_noise * float(np.abs(x).max()))
        y = noisy(y, chain.response_noise * np.sqrt(np.mean(np.abs(y) ** 2, axis=(0, 2)))[:, None])
        cross, power = (y * x.conj()[:, None]).sum(axis=2), (np.abs(x) ** 2).sum(axis=1)[:, None]
        frfs.append(cross / power)
        coherences.append(np.abs(cross) ** 2 / (power * (np.abs(y) ** 2).sum(axis=2)))
    return np.concatenate(frfs, axis=1), np.concatenate(coherences, axis=1)


def jobs_of(names: list[str], seed: int) -> dict[str, tuple[str | None, Contact | None]]:
    """Bolt and contact of each job: two bolts with each contact."""
    drawn = np.random.default_rng([seed, 77]).choice(names, 2, replace=False).tolist()
    every = [(bolt, contact) for contact in CONTACTS for bolt in drawn]
    return {REFERENCE: (None, None), BASELINE: (None, None)} | {f"state-{k + 1}": one for k, one in enumerate([(None, None), *every])}


def run(name: str, seed: int, folder: Path, resume: bool) -> Counter[str]:
    """Measure and judge a campaign; what was said of its rattling bolts, and of others."""
    design = JOINT_DESIGNS[name]
    rng_rig, rng_state, rng_noise = (np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(3))
    specimen = design.draw(rng_rig)
    rig, jobs, model = Rig(design, specimen), jobs_of(list(design.bolts), seed), folder.parent / "model"
    (folder / "frf").mkdir(parents=True, exist_ok=True)
    ensure_model(design, model)
    states = {job: draw_state(design, specimen, 0, 0.3, rng_state) for job in jobs}
    for job, (bolt, contact) in jobs.items():
        path = folder / "frf" / f"{job}.uff"
        if not (resume and path.is_file()):
            estimate, coherence = measured(rig, states[job], bolt, contact, rng_noise)
            hammers = {response: hammer for response, (hammer, _) in design.responses.items()}
            write_uff(
                path, Header(f"{design.title} {job}", chain_of(design).hits, hammers, ACCELERATION), design.frequencies, estimate, coherence
            )
    write_campaign(design, folder, model, Scatter(kelvin=0.0, hammer=0.0, gain=0.0))
    text = (folder / "campaign.yaml").read_text(encoding="utf-8").split("jobs:\n")[0]
    text += "jobs:\n" + "".join(f"  {job}: {{frf: frf/{job}.uff}}\n" for job in jobs)
    (folder / "campaign.yaml").write_text(text, encoding="utf-8", newline="\n")
    lrbc.load(folder / "campaign.yaml", calibration=True).calibrate(force=not resume)
    outcome = lrbc.load(folder / "campaign.yaml").update(force=not resume)
    said = Counter[str]()
    for job, (bolt, contact) in jobs.items():
        record = outcome.results[job]
        changes = {one: value - states[REFERENCE].log10[one] for one, value in states[job].log10.items()}
        print(f"| {name}-{seed} | {job} | {bolt or ''} | {contact or ''} | {record.sentence.partition(': ')[2].partition(' (not')[0]} |")
        finding = record.finding
        for each in finding.bolts:
            likely = each.probability is not None and each.probability > 0.5
            word = each.verdict if each.verdict != "undecided" else "probably loose" if likely else "inconclusive"
            if not record.explained:
                word = "named without verdict" if each.name in finding.nearest else "not named, without verdict"
            if each.name == bolt:
                said[word] += 1
            elif bolt is not None and word in ("loose", "probably loose", "named without verdict"):
                said[f"another bolt {word}"] += 1
                print(f"  {each.name}: {word}; by itself it changed by {changes[each.name]:+.2f} decades")
    return said


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--virtual", type=designs, action="append", metavar="DESIGN:SEEDS", help="as cover:1-5 (cover:3)")
    parser.add_argument("--out", type=Path, help="folder of the campaigns (a temporary one)")
    parser.add_argument("--resume", action="store_true", help="keep measurements, calibrations and results that are there")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="lrbc-rattle-") as scratch:
        work: Path = arguments.out or Path(scratch)
        said = Counter[str]()
        print("| campaign | job | bolt | contact | result |\n| --- | --- | --- | --- | --- |")
        for name, seeds in arguments.virtual or [("cover", [3])]:
            for seed in seeds:
                said += run(name, seed, work / name / f"seed-{seed}", arguments.resume)
    print("\n" + "\n".join(f"{word}: {count}" for word, count in said.most_common()))


if __name__ == "__main__":
    main()
