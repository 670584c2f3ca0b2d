"""Writes the files of a plan."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

from lrbc_cli.errors import DataError
from lrbc_cli.results.plan import PlanRecord
from lrbc_cli.results.store import read, unwritable, write_sealed
from lrbc_cli.results.tables import write_csv

COLUMNS = (
    *("name", "group", "x", "y", "z", "arc_length_m", "verdict", "std", "variance_removed", "loss", "change", "d_prime"),
    *("right", "right_low", "right_high", "missed", "alarm", "draws", "draws_right", "draws_missed", "draws_alarm", "note"),
)


def write_plan(output: Path, record: PlanRecord) -> list[str]:
    """Write ``plan.csv``, a row for each bolt and loss, and ``plan.json``; a plan of more rehearsals there is kept beside them.

    Returns
    -------
    list of str
        Names of the files to which the earlier plan was moved; empty if none was.

    Raises
    ------
    ConfigError
        If the output folder cannot be written.
    """
    kept = _kept(output, record)
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
    return kept


def _kept(output: Path, record: PlanRecord) -> list[str]:
    """Move a plan of more rehearsals, which took minutes, out of the way of one that took less; the names of its files."""
    earlier = None
    with suppress(DataError):
        earlier = read(output / "plan.json", PlanRecord)
    if earlier is None or earlier.draws <= record.draws:
        return []
    kept = []
    for name in ("plan.json", "plan.csv"):
        path = output / name
        if path.is_file():
            to = path.with_name(f"plan.previous{path.suffix}")
            try:
                path.replace(to)
            except OSError as error:
                raise unwritable(to, error) from error
            kept.append(to.name)
    return kept
