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
FILES = ("profile.csv", "frf.csv", "fdac.csv")

#: What of a result may differ between two identifications of the same: times, places, words.
PASSING = ("seconds", "provenance", "warnings", "notes")


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


def content_of(tree: Mapping[str, Any]) -> str:
    """Digest of what a result found, as far as other jobs can rest on it; the same in memory and read back."""
    found = {key: value for key, value in plain(tree).items() if key not in PASSING}
    return hashlib.sha256(json.dumps(found, sort_keys=True).encode()).hexdigest()


class TightStates:
    """The results of the jobs that others rest on, by their content; each is digested once."""

    def __init__(self) -> None:
        self._known: dict[str, str] = {}

    def content(self, name: str, tree: Mapping[str, Any]) -> str:
        """See ``content_of``; a job has one result while this lives."""
        if name not in self._known:
            self._known[name] = content_of(tree)
        return self._known[name]

    def rests_on(self, name: str | None, reference: Mapping[str, Any] | None, baselines: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
        """What the verdicts of a job rest on: null, or left out, where one had no result."""
        return {
            "reference": None if reference is None or name is None else self.content(name, reference),
            "baselines": {other: self.content(other, tree) for other, tree in baselines.items()},
        }


def other_rests(stored: Mapping[str, Any] | None, now: Mapping[str, Any], reference: str | None) -> str | None:
    """Why a result does not rest on the tight states that there are now; None where it does."""
    if stored is None:
        return "it is of an earlier version, which does not say what its verdicts rest on"
    before = stored.get("reference")
    if before != now["reference"]:
        if before is None:
            return f"it was identified without a result of {reference}"
        return f"it rests on a result of {reference} that is no longer there"
    names = [*stored["baselines"], *now["baselines"]]
    changed = [name for name in dict.fromkeys(names) if stored["baselines"].get(name) != now["baselines"].get(name)]
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
