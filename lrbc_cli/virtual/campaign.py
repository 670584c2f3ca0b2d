"""The command ``lrbc rehearse``: writes simulated measurements of the user's model as a campaign that ``lrbc run`` can process."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from lrbc_cli.campaign.identification.nuisances import nuisances_of
from lrbc_cli.campaign.protect import require_new, require_no_input
from lrbc_cli.campaign.reading.inputs import Inputs
from lrbc_cli.config.document import as_yaml
from lrbc_cli.config.fields import NAME_LENGTH, is_name
from lrbc_cli.config.skeleton import FILE
from lrbc_cli.config.structure import RecordRef
from lrbc_cli.errors import ConfigError
from lrbc_cli.io.atomic import atomic_write
from lrbc_cli.io.frf import write_frf
from lrbc_cli.model.factors import SOUND_SPEED
from lrbc_cli.reduction.steps.grid import require_in_band
from lrbc_cli.results.rehearsal import RehearsalRecord
from lrbc_cli.results.store import versions, write_sealed
from lrbc_cli.updating.misfit.nuisances import ModelFactor
from lrbc_cli.virtual.drift import ROOM, Scatter
from lrbc_cli.virtual.structure import Settings, VirtualStructure

RECORD = "rehearsal.json"
#: Description of the written campaign: it must say that nothing was measured.
VIRTUAL = "Rehearsal: no measurements, FRFs drawn from the model itself with noise, drift and scatter of the joints."

Jobs = Mapping[str, Sequence[str]]


def declared_scatter(inputs: Inputs) -> Scatter:
    """Drift between jobs as the campaign states it (``update.nuisances``)."""
    nuisances = inputs.campaign.update.nuisances
    factors = {nuisance.name: nuisance.std for nuisance in nuisances_of(inputs) if isinstance(nuisance, ModelFactor)}
    return Scatter(
        kelvin=2.0 * ROOM * factors.pop(SOUND_SPEED, 0.0), hammer=nuisances.hammer or 0.0, gain=nuisances.gain or 0.0, factors=factors
    )


def job_list(inputs: Inputs, loose: Sequence[str], tight: int | None = None, seed: int = 1) -> dict[str, list[str]]:
    """Loosened bolts by job: first the jobs with all bolts tight, of which the first has the name of the campaign's reference job.

    Parameters
    ----------
    inputs : Inputs
    loose : sequence of str
        Comma-separated names of loosened bolts, one text for each job.
    tight : int or None
        Number of jobs with all bolts tight. None: one; if ``loose`` is empty, there is also a job with one loose bolt drawn by ``seed``.
    seed : int

    Raises
    ------
    ConfigError
        If a bolt does not exist.
    """
    known = inputs.bolts.name if inputs.bolts else ()
    if not loose and tight is None and known:
        loose = [known[int(np.random.default_rng(seed).integers(len(known)))]]
    jobs: dict[str, list[str]] = {inputs.campaign.update.reference or "tight": []}
    jobs |= {f"tight-{k}": [] for k in range(2, (tight or 1) + 1)}
    for number, text in enumerate(loose, 1):
        names = [name.strip() for name in text.split(",")]
        if unknown := [name for name in names if name not in known]:
            raise ConfigError(
                "no such bolt", place=f"--loose {text}", expected=", ".join(known) or "bolts in the campaign", found=", ".join(unknown)
            )
        called = "loose-" + "-".join(names)
        usable = is_name(called) and len(called) <= NAME_LENGTH and called not in jobs
        jobs[called if usable else f"loose-{number}"] = names
    return jobs


def required(inputs: Inputs, jobs: Jobs) -> Jobs:
    """The jobs, if they can be written and their bolts loosened.

    Raises
    ------
    ConfigError
        If there is no job, a name is not usable, the first job has loose bolts, or a bolt does not exist.
    """
    known, names = inputs.bolts.name if inputs.bolts else (), list(jobs)
    if wrong := [name for name in names if not is_name(name) or len(name) > NAME_LENGTH]:
        raise ConfigError(
            "not the name of a job", place="jobs", expected=f"letters, digits, - and _, at most {NAME_LENGTH}", found=wrong[0]
        )
    if not names or jobs[names[0]]:
        raise ConfigError("no reference job", place="jobs", expected="first a job without loose bolts", found=names[0] if names else "none")
    if unknown := [bolt for bolts in jobs.values() for bolt in bolts if bolt not in known]:
        expected = ", ".join(known) or "bolts in the campaign"
        raise ConfigError("no such bolt", place="jobs", expected=expected, found=", ".join(unknown))
    return jobs


def campaign_tree(inputs: Inputs, jobs: Jobs) -> dict[str, Any]:
    """The user's campaign file with the simulated jobs; paths are absolute, so that the file can lie in any folder."""
    reference = next(iter(jobs))
    tree: dict[str, Any] = inputs.campaign.model_dump(mode="json", by_alias=True, exclude_unset=True)
    tree |= {"campaign": f"{tree['campaign']} (rehearsal)"[:200], "output": "output"}
    # The report must say that nothing was measured.
    tree["description"] = f"{VIRTUAL} {tree.get('description', '')}"[:2000].strip()
    tree.pop("operator", None)
    tree["update"] = {key: value for key, value in tree.get("update", {}).items() if key != "baselines"} | {"reference": reference}
    if tree.get("calibration"):
        tree["calibration"] |= {"job": reference}
    # References to records by number or file do not fit the files written here.
    counted = [name for name, response in inputs.campaign.responses.items() if not isinstance(response.record, str | RecordRef | None)]
    for name in counted:
        del tree["responses"][name]["record"]
    tree["jobs"] = {job: {"frf": f"frf/{job}.uff"} | ({"removed": list(removed)} if removed else {}) for job, removed in jobs.items()}
    return tree


def rehearse(
    inputs: Inputs,
    cache: Path,
    out: Path,
    jobs: Jobs,
    *,
    settings: Settings | None = None,
    seed: int = 1,
    lines: np.ndarray[Any, np.dtype[np.float64]],
    replace: bool = False,
    progress: Callable[[str], None] = lambda _: None,
) -> RehearsalRecord:
    """Simulate the measurements of a virtual structure, and write ``campaign.yaml``, ``frf/JOB.uff`` and ``rehearsal.json``.

    Parameters
    ----------
    inputs : Inputs
        The user's campaign without a stored calibration, which belongs to other measurements.
    cache : Path
        Folder of reduced models.
    out : Path
        Folder of the files.
    jobs : mapping
        Loosened bolts by job, the reference job first.
    settings : Settings or None
        None: the defaults, with the drift that the campaign states.
    seed : int
    lines : (F,) float array
        Frequency lines [Hz].
    replace : bool
        Replace the files of an earlier rehearsal.
    progress : callable

    Returns
    -------
    RehearsalRecord
        What was drawn; no command reads it.

    Raises
    ------
    ConfigError
        If a file exists or is an input, the folder cannot be written, lines lie outside the band, or bolts cannot be loosened.
    NumericalError
        If a reduced model does not reach its tolerance.
    """
    files = {job: out / "frf" / f"{job}.uff" for job in jobs}
    _require_targets(inputs, [out / FILE, out / RECORD, *files.values()], replace)
    require_in_band(lines, inputs.campaign.reduction.band, hint="change reduction.band")
    settings = settings or Settings(scatter=declared_scatter(inputs))
    structure = VirtualStructure(inputs=inputs, settings=settings, seed=seed, cache=cache, frequency_hz=lines, progress=progress)
    drawn: dict[str, Any] = {
        "campaign": inputs.campaign.path,
        "seed": seed,
        "settings": asdict(settings),
        "factors": structure.factors,
        "jobs": {},
        "versions": versions(),
    }
    try:
        for job, removed in jobs.items():
            progress(f"measuring {job}")
            frf, drawn["jobs"][job] = structure.measure(removed)
            write_frf(files[job], frf)
        with atomic_write(out / FILE) as stream:
            stream.write(f"# A rehearsal of {inputs.campaign.path.name}, written by lrbc rehearse; {RECORD} says what was drawn.\n\n")
            stream.write(as_yaml(campaign_tree(inputs, jobs)))
    except OSError as error:
        raise ConfigError(f"the folder cannot be written ({error.strerror or error})", file=out, place="--out") from error
    return write_sealed(out / RECORD, RehearsalRecord.checked(drawn))


def _require_targets(inputs: Inputs, files: Sequence[Path], replace: bool) -> None:
    for file in files:
        require_no_input(file, inputs.campaign, "--out")
        if not replace:
            require_new(file, "--out", "--force")
