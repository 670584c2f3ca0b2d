"""Writes the files of a plan."""

from __future__ import annotations

from pathlib import Path

from lrbc_cli.results.plan import PlanRecord
from lrbc_cli.results.store import write_sealed
from lrbc_cli.results.tables import write_csv

COLUMNS = (
    *("name", "group", "x", "y", "z", "arc_length_m", "verdict", "std", "variance_removed", "loss", "change", "d_prime"),
    *("right", "right_low", "right_high", "missed", "alarm", "draws", "draws_right", "draws_missed", "draws_alarm", "note"),
)


def write_plan(output: Path, record: PlanRecord) -> None:
    """Write ``plan.csv``, a row for each bolt and loss, and ``plan.json``.

    Raises
    ------
    ConfigError
        If the output folder cannot be written.
    """
    rows = []
    for bolt in record.bolts:
        place = (None,) * 3 if bolt.position is None else bolt.position
        own = [bolt.name, bolt.group, *place, bolt.arc_length, bolt.verdict, bolt.std, bolt.variance_removed]
        for loss in bolt.losses:
            counts = (0, None, None, None) if (one := loss.rehearsal) is None else (one.draws, one.loose, one.tight, one.alarms)
            said = [loss.decades, loss.change, loss.d_prime, loss.right, *(loss.right95 or (None, None)), loss.missed, loss.alarm]
            rows.append([*own, *said, *counts, bolt.note])
    write_csv(output / "plan.csv", COLUMNS, rows)
    write_sealed(output / "plan.json", record)
