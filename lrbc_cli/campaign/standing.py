"""What a stored result stands on, and what it says: the hashes of its files, the tight states behind its verdicts, its finding."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from lrbc_cli.errors import DataError
from lrbc_cli.io.atomic import file_hash
from lrbc_cli.results.fields import plain
from lrbc_cli.updating.clearance import BoltFinding, JobFinding

#: Tables beside ``result.json``, which vouches for them by their hashes.
FILES = ("profile.csv", "frf.csv", "fdac.csv", "evidence.json")

#: What of the result of a reference job the identification of others rests on.
STATE = ("job", "parameters", "covariance", "misfit_db", "noise", "nuisances")


def altered(folder: Path, tree: Mapping[str, Any]) -> str | None:
    """Why the files of a job are not those that were written with its result; None where they are."""
    hashes = tree["provenance"].get("files") or {}
    for name in FILES:
        try:
            if not (folder / name).is_file():
                return f"a result file is missing ({name})"
            if file_hash(folder / name) != hashes.get(name):
                return f"{name} is not the file that was written with it"
        except (DataError, OSError):
            return f"{name} cannot be read"
    return None


def state_of(tree: Mapping[str, Any]) -> str:
    """Digest of the state that a reference job found, judged in whatever way; the same in memory and read back."""
    return _digest({key: tree.get(key) for key in STATE})


def changes_of(tree: Mapping[str, Any]) -> str:
    """Digest of what a baseline tells of the scatter of tight states."""
    return _digest([[bolt.get(key) for key in ("name", "change", "change_std", "verdict")] for bolt in tree.get("bolts", [])])


def _digest(value: Any) -> str:
    return hashlib.sha256(json.dumps(plain(value), sort_keys=True).encode()).hexdigest()


def rests_on(reference: Mapping[str, Any] | None, baselines: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """What the verdicts of a job rest on: null, or left out, where one had no result."""
    return {
        "reference": None if reference is None else state_of(reference),
        "baselines": {other: changes_of(tree) for other, tree in baselines.items()},
    }


def other_reference(stored: Mapping[str, Any] | None, now: Mapping[str, Any], reference: str | None) -> str | None:
    """Why an identification does not rest on the reference state that there is now; None where it does."""
    if stored is None:
        return "it is of an earlier version, which does not say what its verdicts rest on"
    before = stored.get("reference")
    if before == now["reference"]:
        return None
    if before is None:
        return f"it was identified without a result of {reference}"
    return f"it rests on a result of {reference} that is no longer there"


def other_baselines(stored: Mapping[str, Any] | None, now: Mapping[str, Any]) -> str | None:
    """Why a judgement does not rest on the baselines that there are now; None where it does."""
    before = {} if stored is None else stored["baselines"]
    changed = [name for name in dict.fromkeys([*before, *now["baselines"]]) if before.get(name) != now["baselines"].get(name)]
    return f"it rests on other results of the baselines ({', '.join(changed)})" if changed else None


def finding_of(tree: Mapping[str, Any]) -> JobFinding:
    """What a stored result, or one about to be stored, says of the bolts."""
    tight = tree.get("taken_as_tight") or {}
    return JobFinding(
        status=tree["status"],
        bolts=tuple(BoltFinding(bolt["name"], bolt["verdict"], bolt.get("probability_loose")) for bolt in tree.get("bolts", [])),
        validated=(tree.get("validity") or {}).get("passed") is True,
        assumed=tight.get("as"),
        doubtful=tuple(tight.get("doubtful", ())),
    )


def findings_of(trees: Mapping[str, Mapping[str, Any]], names: Iterable[str]) -> dict[str, JobFinding]:
    """Of these jobs, in this order; one without a result has failed."""
    return {name: finding_of(trees[name]) if name in trees else JobFinding("failed") for name in names}
