"""The nominal model of a design as files that any FE program could have exported."""

from __future__ import annotations

from pathlib import Path

import h5py

from rigs.campaign import ensure
from rigs.joints.design import JointDesign
from rigs.joints.system import System
from rigs.nominal import write_csr


def _number(value: float) -> str:
    return f"{round(float(value), 8) + 0.0:g}" if abs(value) < 1e-4 else f"{value:.8f}".rstrip("0").rstrip(".")


def bolt_table(design: JointDesign) -> str:
    """The text of ``bolts.csv``."""
    return "\n".join(["name,x,y,z", *(f"{name}," + ",".join(map(_number, xyz)) for name, xyz in design.bolts.items())]) + "\n"


def groups(design: JointDesign) -> list[str]:
    """Kinds of components."""
    return list(dict.fromkeys(spring.group for spring in design.springs))


def bushing_table(design: JointDesign, system: System, group: str) -> str:
    """The springs of one kind: nodes that they join, component and stiffness."""
    lines = ["bolt,node_a,node_b,component,stiffness"]
    for spring in design.springs:
        if spring.group == group:
            a, b = design.nodes(system, spring)
            second = system.node[b] if b >= 0 else ""
            lines.append(f"{spring.joint},{system.node[a]},{second},{spring.component},{spring.stiffness:g}")
    return "\n".join(lines) + "\n"


def write(design: JointDesign, folder: Path) -> None:
    """Write ``model.h5`` with K, M, and the share of each part after the first, and the tables."""
    system = design.system(None)
    folder.mkdir(parents=True, exist_ok=True)
    with h5py.File(folder / "model.h5", "w", track_order=False) as file:
        write_csr(file, "K", system.stiffness)
        write_csr(file, "M", system.mass)
        for part in range(1, design.parts):
            write_csr(file, f"K_{part + 1}", system.share(part))
    lines = ["dof,node,component,x,y,z"]
    for dof, (node, component, xyz) in enumerate(zip(system.node, system.component, system.xyz, strict=True)):
        lines.append(f"{dof},{node},{component}," + ",".join(map(_number, xyz)))
    texts = {"dofs": "\n".join(lines) + "\n", "bolts": bolt_table(design)}
    for group in groups(design):
        texts[f"bushings-{group}"] = bushing_table(design, system, group)
    for name, text in texts.items():
        (folder / f"{name}.csv").write_text(text, encoding="utf-8", newline="\n")


def ensure_model(design: JointDesign, folder: Path) -> None:
    """Write the nominal model unless the folder holds it, see ``ensure``."""
    ensure(folder, design.name, bolt_table(design), lambda: write(design, folder))
