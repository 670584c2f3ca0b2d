"""The designs, by name. All but the SoundBox were fixed by forward computations before anything was identified on them."""

from __future__ import annotations

from rigs.design import Design, Foundation, Materials, Mesh

SOUNDBOX = Design()


def _run(first: int, last: int) -> tuple[int, ...]:
    return tuple(range(first, last + 1))


#: Thin steel; gaps off the middle of the edge that grow towards either end.
STEEL = Design(
    name="steel",
    title="Steel box",
    plate_origin=(0.12, 0.11, -0.030),
    plate_cells=(40, 30),
    plate_step=(0.0155, 0.016),
    depth=0.94,
    front=((0.0, 0.0), (0.86, 0.0), (0.86, 0.70), (0.0, 0.70)),
    back=((0.006, 0.004), (0.846, 0.0), (0.852, 0.690), (0.010, 0.684)),
    hammer=(0.12 + 26 * 0.0155, 0.11 + 11 * 0.016),
    microphones={
        "mic01": (0.66, 0.20, 0.06),
        "mic02": (0.45, 0.20, 0.06),
        "mic03": (0.22, 0.20, 0.06),
        "mic04": (0.70, 0.50, 0.40),
        "mic05": (0.42, 0.50, 0.40),
        "mic06": (0.16, 0.50, 0.40),
        "mic07": (0.58, 0.33, 0.72),
        "mic08": (0.28, 0.33, 0.72),
        "mic09": (0.846, 0.0, 0.94),
        "mic10": (0.010, 0.684, 0.94),
    },
    used=("mic01", "mic03", "mic04", "mic06", "mic08", "mic09"),
    bolt_count=14,
    bolt_pitch=0.036,
    materials=Materials(ex=203e9, ey=208e9, nu=0.29, density=7850.0, thickness=0.002, stiffness_factor=0.94, acoustic_mass_factor=0.985),
    structure_damping=(3.1, 1.9e-6),
    acoustic_damping=(4.1, 4.6e-7),
    foundation=Foundation(patch_radius=0.018, clamp_compliance=1.078),
    nominal=Mesh((8, 6), (2, 2, 2, 2), (1, 5, 4, 3), 5),
    true=Mesh((9, 7), (2, 2, 2, 2), (1, 5, 5, 4), 3),
    jobs={
        "tight": (),
        "gap-04-05": _run(4, 5),
        "gap-04-06": _run(4, 6),
        "gap-03-07": _run(3, 7),
        "gap-03-09": _run(3, 9),
        "gap-10-11": _run(10, 11),
        "gap-09-12": _run(9, 12),
    },
)

#: Thick aluminium, few bolts far apart; gaps from one bolt to all of them.
TWELVE = Design(
    name="twelve",
    title="Box with twelve bolts",
    plate_origin=(0.09, 0.14, -0.045),
    plate_cells=(40, 40),
    plate_step=(0.017, 0.0155),
    depth=0.78,
    front=((0.0, 0.0), (0.92, 0.0), (0.92, 0.90), (0.0, 0.90)),
    back=((0.0, 0.010), (0.900, 0.014), (0.912, 0.880), (0.008, 0.892)),
    hammer=(0.09 + 15 * 0.017, 0.14 + 24 * 0.0155),
    microphones={
        "mic01": (0.72, 0.62, 0.08),
        "mic02": (0.50, 0.62, 0.08),
        "mic03": (0.24, 0.62, 0.08),
        "mic04": (0.64, 0.28, 0.30),
        "mic05": (0.40, 0.28, 0.30),
        "mic06": (0.18, 0.28, 0.30),
        "mic07": (0.60, 0.74, 0.56),
        "mic08": (0.30, 0.74, 0.56),
        "mic09": (0.912, 0.880, 0.78),
        "mic10": (0.0, 0.010, 0.78),
    },
    used=("mic01", "mic02", "mic05", "mic06", "mic07", "mic10"),
    bolt_count=12,
    bolt_pitch=0.052,
    materials=Materials(ex=69e9, ey=71e9, thickness=0.004, stiffness_factor=0.92, acoustic_mass_factor=0.985),
    structure_damping=(5.6, 2.3e-6),
    acoustic_damping=(3.4, 5.6e-7),
    foundation=Foundation(patch_radius=0.024, clamp_compliance=1.083),
    nominal=Mesh((8, 8), (1, 2, 2, 2), (1, 3, 3, 3), 5),
    true=Mesh((9, 9), (2, 2, 2, 2), (1, 4, 4, 3), 3),
    jobs={
        "tight": (),
        "gap-08": (8,),
        "gap-08-09": _run(8, 9),
        "gap-07-10": _run(7, 10),
        "gap-06-11": _run(6, 11),
        "gap-03-05": _run(3, 5),
        "gap-01-12": _run(1, 12),
    },
)

#: One bolt, or two far apart.
SINGLE = Design(
    name="single",
    title="Box with single loose bolts",
    plate_origin=(0.08, 0.16, -0.040),
    plate_cells=(35, 40),
    plate_step=(0.0156, 0.0145),
    depth=1.16,
    front=((0.0, 0.0), (0.74, 0.0), (0.74, 0.93), (0.0, 0.93)),
    back=((0.010, 0.006), (0.730, 0.0), (0.722, 0.918), (0.004, 0.910)),
    hammer=(0.08 + 12 * 0.0156, 0.16 + 13 * 0.0145),
    microphones={
        "mic01": (0.58, 0.36, 0.07),
        "mic02": (0.38, 0.36, 0.07),
        "mic03": (0.18, 0.36, 0.07),
        "mic04": (0.54, 0.66, 0.48),
        "mic05": (0.34, 0.66, 0.48),
        "mic06": (0.14, 0.66, 0.48),
        "mic07": (0.48, 0.24, 0.90),
        "mic08": (0.22, 0.24, 0.90),
        "mic09": (0.722, 0.918, 1.16),
        "mic10": (0.010, 0.006, 1.16),
    },
    used=("mic01", "mic03", "mic04", "mic06", "mic07", "mic09"),
    bolt_count=17,
    bolt_pitch=0.036,
    materials=Materials(ex=67e9, ey=73e9, stiffness_factor=0.93, acoustic_mass_factor=0.98),
    structure_damping=(4.8, 2.6e-6),
    acoustic_damping=(3.6, 5.0e-7),
    foundation=Foundation(patch_radius=0.018, clamp_compliance=1.083),
    nominal=Mesh((7, 8), (1, 1, 2, 3), (1, 6, 4, 3), 5),
    true=Mesh((8, 9), (2, 2, 2, 3), (1, 6, 5, 4), 3),
    jobs={
        "tight": (),
        "single-04": (4,),
        "single-07": (7,),
        "single-09": (9,),
        "single-12": (12,),
        "single-15": (15,),
        "pair-04-13": (4, 13),
        "pair-06-11": (6, 11),
    },
)

DESIGNS = {design.name: design for design in (SOUNDBOX, STEEL, TWELVE, SINGLE)}
