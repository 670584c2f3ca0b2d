"""``campaign.csv``: one row a job."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from lrbc_cli.campaign.documents import RESULT_FORMAT, read_json, write_csv
from lrbc_cli.campaign.standing import finding_of
from lrbc_cli.errors import DataError
from lrbc_cli.updating.clearance import sentence

CAMPAIGN_COLUMNS = [
    "job",
    "status",
    "loose",
    "loose_probability",
    "undecided",
    "outside",
    "removed",
    "damping_exponent",
    "damping_factor",
    "misfit_initial_db",
    "misfit_final_db",
    "held_out_misfit_final_db",
    "frac_initial",
    "frac_final",
    "cost_initial",
    "cost_final",
    "iterations",
    "evaluations",
    "line_evaluations",
    "seconds",
    "reason",
    "finding",
]


def write_table(output: Path, jobs: Sequence[str]) -> None:
    """Write ``campaign.csv``, one row a job that has a result."""
    rows = []
    for name in jobs:
        try:
            tree = read_json(output / name / "result.json", RESULT_FORMAT)
        except DataError:
            continue
        if tree is None:
            continue
        if tree["status"] == "failed":
            rows.append([name, "failed", *[None] * (len(CAMPAIGN_COLUMNS) - 4), tree["reason"], sentence(finding_of(tree))])
            continue
        damped = [group for group in tree["parameters"].values() if "damping_exponent" in group]
        misfit, correlation = tree["misfit_db"], tree.get("correlation") or {}
        rows.append(
            [
                name,
                tree["status"],
                _names(tree["bolts"], "loose"),
                _probabilities(tree["bolts"]),
                _names(tree["bolts"], "undecided"),
                _names(tree["bolts"], "outside"),
                " ".join(tree["removed"] or []),
                " ".join(f"{g['damping_exponent']:.6g}" for g in damped),
                " ".join(f"{g['damping_factor']:.6g}" for g in damped),
                misfit["initial"],
                misfit["final"],
                misfit["held_out_final"],
                correlation.get("frac_initial"),
                correlation.get("frac_final"),
                tree["cost"]["initial"],
                tree["cost"]["final"],
                tree["iterations"],
                tree["evaluations"],
                tree["line_evaluations"],
                tree["seconds"]["total"],
                tree["reason"],
                sentence(finding_of(tree)),
            ]
        )
    write_csv(output / "campaign.csv", CAMPAIGN_COLUMNS, rows)


def _names(bolts: Sequence[Mapping[str, Any]], verdict: str) -> str:
    return " ".join(bolt["name"] for bolt in bolts if bolt["verdict"] == verdict)


def _probabilities(bolts: Sequence[Mapping[str, Any]]) -> str:
    """Of being loose, in the order of the names of the loose bolts; empty where no bolt has one."""
    known = [bolt.get("probability_loose") for bolt in bolts if bolt["verdict"] == "loose"]
    return " ".join("-" if p is None else f"{p:.3g}" for p in known) if any(p is not None for p in known) else ""
