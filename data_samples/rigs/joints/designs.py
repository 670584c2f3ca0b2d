"""The designs. Fixed, with their limits, by forward computations before anything was identified on them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from rigs.joints.beams import Frame, Member, Section
from rigs.joints.design import FrameDesign, JointDesign, Place, PlateDesign, Point, Spring, Support
from rigs.joints.plates import Sheet
from rigs.joints.system import Material

ALUMINIUM, STEEL = Material(70e9, 0.33, 2700.0), Material(208e9, 0.29, 7850.0)


def proportional(loss: float, low: float, high: float) -> tuple[float, float]:
    """Alpha and beta that give a loss factor at two frequencies [Hz]."""
    a, b = 2 * np.pi * low, 2 * np.pi * high
    return float(loss * a * b / (a + b)), float(loss / (a + b))


def bolted(bolts: dict[str, Point], axial: float, rocking: float) -> tuple[Spring, ...]:
    """An axial spring [N/m] and two rocking ones [N m/rad] for each bolt."""
    kinds = (("UZ", "axial", axial), ("ROTX", "rocking", rocking), ("ROTY", "rocking", rocking))
    return tuple(Spring(name, component, group, stiffness) for name in bolts for component, group, stiffness in kinds)


def _cover() -> PlateDesign:
    around = [(0.025, 0.025), (0.2, 0.025), (0.4, 0.025), (0.575, 0.025), (0.575, 0.225), (0.575, 0.425), (0.4, 0.425), (0.2, 0.425)]
    around += [(0.025, 0.425), (0.025, 0.225)]
    bolts = {f"B{k + 1:02d}": (x, y, 0.0) for k, (x, y) in enumerate(around)}
    return PlateDesign(
        name="cover",
        title="Cover on ten bolts",
        material=ALUMINIUM,
        band=(30.0, 500.0),
        loss=0.012,
        proportional=proportional(0.012, 80.0, 400.0),
        joint_loss=0.02,
        hammers={"h1": Place((0.15, 0.1, 0.0)), "h2": Place((0.475, 0.3, 0.0))},
        sensors={
            "a1": Place((0.1, 0.35, 0.0)),
            "a2": Place((0.3, 0.05, 0.0)),
            "a3": Place((0.5, 0.1, 0.0)),
            "a4": Place((0.35, 0.275, 0.0)),
            "a5": Place((0.55, 0.375, 0.0)),
            "a6": Place((0.225, 0.2, 0.0)),
        },
        held_out=("a6",),
        springs=bolted(bolts, 4.0e6, 600.0),
        bolts=bolts,
        loosened=(1, 0, 2, 1, 3, 1, 2, 5),
        sheets=(Sheet((0.0, 0.0), (0.6, 0.45), 0.0, 0.004, (24, 18), (40, 31)),),
    )


def _lap() -> PlateDesign:
    rows = [(x, y) for x in (0.36, 0.40) for y in (0.025, 0.1, 0.2, 0.275)]
    bolts = {f"B{k + 1:02d}": (x, y, 0.0) for k, (x, y) in enumerate(rows)}
    corners = ((0.03, 0.03, 0), (0.03, 0.27, 0), (0.73, 0.03, 1), (0.73, 0.27, 1))
    return PlateDesign(
        name="lap",
        title="Lap joint with eight bolts",
        material=STEEL,
        band=(20.0, 600.0),
        loss=0.008,
        proportional=proportional(0.008, 70.0, 450.0),
        joint_loss=0.02,
        hammers={"h1": Place((0.04, 0.075, 0.0)), "h2": Place((0.66, 0.225, 0.0), part=1)},
        sensors={
            "a1": Place((0.0, 0.3, 0.0)),
            "a2": Place((0.2, 0.1, 0.0)),
            "a3": Place((0.42, 0.25, 0.0)),
            "a4": Place((0.34, 0.05, 0.0), part=1),
            "a5": Place((0.54, 0.2, 0.0), part=1),
            "a6": Place((0.74, 0.0, 0.0), part=1),
        },
        held_out=("a5",),
        springs=bolted(bolts, 1.5e6, 250.0),
        bolts=bolts,
        loosened=(1, 2, 0, 1, 3, 2, 1, 4),
        # Hung on rubber cords, which the nominal model leaves out.
        supports=tuple(Support((x, y, 0.0), 150.0, part, nominal=False) for x, y, part in corners),
        sheets=(
            Sheet((0.0, 0.0), (0.42, 0.3), 0.0, 0.003, (21, 12), (37, 25)),
            Sheet((0.34, 0.0), (0.76, 0.3), 0.003, 0.0025, (21, 12), (39, 27)),
        ),
    )


def _frame() -> FrameDesign:
    hubs: dict[str, Point] = {}
    for k, (x, y) in enumerate(((0.0, 0.0), (1.2, 0.0), (1.2, 0.8), (0.0, 0.8))):
        hubs |= {f"foot{k}": (x, y, 0.0), f"top{k}": (x, y, 0.9)}
    column, girder = Section(0.04, 0.04, 0.002), Section(0.03, 0.05, 0.002)
    members = [Member(f"foot{k}", f"top{k}", column, (True, False)) for k in range(4)]
    members += [Member(f"top{k}", f"top{(k + 1) % 4}", girder, (True, True)) for k in range(4)]
    names = [f"F{k + 1}" for k in range(4)] + [f"G{k + 1}{end}" for k in range(4) for end in "ab"]
    # A joint stands where its member ends; for the eye and for distances 40 mm inside.
    ends = [(m, end) for m in members for end in (0, 1) if m.joints[end]]
    bolts: dict[str, Point] = {}
    springs: list[Spring] = []
    for name, (member, end) in zip(names, ends, strict=True):
        a, b = np.array(hubs[member.start]), np.array(hubs[member.end])
        if end:
            a, b = b, a
        along = (b - a) / np.linalg.norm(b - a)
        x, y, z = (a + 0.04 * along).round(6).tolist()
        bolts[name] = (x, y, z)
        for axis, component in enumerate(("ROTX", "ROTY", "ROTZ")):
            kind = "torsion" if abs(along[axis]) > 0.5 else "bending"
            springs.append(Spring(name, component, kind, 1.0e5 if kind == "torsion" else 3.0e5))
    return FrameDesign(
        name="space-frame",
        title="Space frame with twelve joints",
        material=STEEL,
        band=(10.0, 450.0),
        loss=0.0,
        proportional=(1.6, 6.0e-6),
        joint_loss=0.02,
        hammers={
            "h1": Place((0.48, 0.0, 0.9), "UZ"),
            "h2": Place((1.2, 0.48, 0.9), "UX"),
            "h3": Place((0.0, 0.8, 0.54), "UY"),
        },
        sensors={
            "a1": Place((0.72, 0.0, 0.9), "UY"),
            "a2": Place((1.2, 0.32, 0.9), "UZ"),
            "a3": Place((0.48, 0.8, 0.9), "UZ"),
            "a4": Place((0.0, 0.0, 0.54), "UX"),
            "a5": Place((1.2, 0.8, 0.36), "UY"),
            "a6": Place((0.0, 0.48, 0.9), "UX"),
            "a7": Place((0.0, 0.32, 0.9), "UZ"),
        },
        held_out=("a5",),
        springs=tuple(springs),
        bolts=bolts,
        loosened=(0, 1, 1, 2, 1, 3, 2, 6),
        frame=Frame(hubs, tuple(f"foot{k}" for k in range(4)), tuple(members), 0.4),
        elements=(5, 12),
    )


def _flange() -> PlateDesign:
    angles = 2 * np.pi * np.arange(12) / 12
    bolts = {f"B{k + 1:02d}": (round(0.21 * np.cos(a), 7), round(0.21 * np.sin(a), 7), 0.0) for k, a in enumerate(angles)}

    def polar(radius: float, degrees: float, part: int) -> Place:
        a = np.deg2rad(degrees)
        return Place((round(float(radius * np.cos(a)), 7), round(float(radius * np.sin(a)), 7), 0.0), part=part)

    ends = (0.15, 0.0), (0.25, 2 * np.pi)
    return PlateDesign(
        name="flange",
        title="Ring flange with twelve bolts",
        material=STEEL,
        band=(50.0, 900.0),
        loss=0.006,
        proportional=proportional(0.006, 150.0, 700.0),
        joint_loss=0.015,
        hammers={"h1": polar(0.25, 15.0, 1), "h2": polar(0.17, 142.5, 1)},
        sensors={
            "a1": polar(0.25, 60.0, 1),
            "a2": polar(0.15, 105.0, 1),
            "a3": polar(0.25, 195.0, 1),
            "a4": polar(0.23, 262.5, 1),
            "a5": polar(0.25, 330.0, 1),
            "a6": polar(0.15, 37.5, 0),
            "a7": polar(0.15, 225.0, 0),
        },
        held_out=("a4",),
        springs=bolted(bolts, 2.0e7, 3000.0),
        bolts=bolts,
        loosened=(1, 1, 0, 2, 1, 2, 3, 6),
        supports=tuple(Support((round(0.17 * np.cos(a), 7), round(0.17 * np.sin(a), 7), 0.0), 2.0e4) for a in np.deg2rad((15, 135, 255))),
        sheets=(
            Sheet(*ends, 0.0, 0.008, (5, 48), (9, 100), ring=True),
            Sheet(*ends, 0.008, 0.006, (5, 48), (9, 100), ring=True),
        ),
    )


def _damped() -> JointDesign:
    """The lap joint of sheets with damping layers: over this band alpha and beta cannot be what a loss factor is."""
    loss, band = 0.06, (15.0, 800.0)
    own = {"name": "damped", "title": "Lap joint of damped sheets", "loss": loss, "joint_loss": loss, "band": band}
    return replace(_lap(), **own, proportional=proportional(loss, 60.0, 480.0))


JOINT_DESIGNS: dict[str, JointDesign] = {design.name: design for design in (_cover(), _lap(), _frame(), _flange(), _damped())}
