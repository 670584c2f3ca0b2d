"""The command ``lrbc reduce``."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import click

from lrbc_cli.campaign.export import check_targets, export, require_real
from lrbc_cli.campaign.jobs.results import write_campaign, write_reduction
from lrbc_cli.campaign.reading.inputs import Inputs
from lrbc_cli.campaign.reduced.cache import key_parts, look_up
from lrbc_cli.campaign.reduced.stage import bound_hint
from lrbc_cli.campaign.simulate import check_parameters
from lrbc_cli.cli.common import cache_folder, load, progress, say_json
from lrbc_cli.cli.options import accept_tolerance_option, calibration_option, campaign_options, verbosity
from lrbc_cli.cli.terminal import remark, say
from lrbc_cli.errors import ConfigError
from lrbc_cli.results.model import ReductionRecord
from lrbc_cli.study import Study


@click.command()
@campaign_options
@calibration_option
@click.option("--force", is_flag=True, help="Build the model again even if the cache has it.")
@click.option("--dry-run", is_flag=True, help="Print whether the cache has the model, and why; change nothing.")
@accept_tolerance_option
@click.option(
    "--export",
    "exports",
    type=click.Path(path_type=Path),
    multiple=True,
    metavar="FILE",
    help="Write the reduced model for other programs: .h5, .hdf5 or .mat; repeatable. Replaces earlier exports.",
)
@click.option("--overwrite", is_flag=True, help="Allow --export to replace any file that is not an input of the campaign.")
@click.option(
    "--state-space", is_flag=True, help="Also export a first-order state space, at the start values unless --job or --set is given."
)
@click.option("--job", metavar="NAME", help="State space at the parameters identified from this job.")
@click.option(
    "--set",
    "assignments",
    multiple=True,
    metavar="GROUP=LOG10",
    help="State space at this value, or at one value per parameter; inf: clamped, -inf: free. Damping: GROUP.damping=LOG10.",
)
def reduce(
    *,
    config: Path,
    overrides: tuple[str, ...],
    cache: Path | None,
    as_json: bool,
    calibration: bool,
    force: bool,
    dry_run: bool,
    accept_tolerance: bool,
    exports: tuple[Path, ...],
    overwrite: bool,
    state_space: bool,
    job: str | None,
    assignments: tuple[str, ...],
) -> None:
    """Build the reduced model, or load it from the cache. With --export, also export it."""
    if state_space and not exports:
        raise ConfigError("--state-space needs --export", expected="--export FILE.h5 or --export FILE.mat", found="no --export")
    if (job is not None or assignments) and not state_space:
        option = "--job" if job is not None else "--set"
        raise ConfigError(
            f"{option} needs --state-space: it sets its parameters", expected="--export FILE --state-space", found="no --state-space"
        )
    inputs = load(config, overrides, calibration=calibration)
    check_targets(exports, inputs, replace_foreign=overwrite)
    if state_space:
        check_parameters(inputs, job, assignments)
        require_real(inputs)
    folder = cache_folder(cache)
    if dry_run:
        _dry_run(inputs, folder, exports, force=force, as_json=as_json)
        return
    output, study = inputs.campaign.output, Study(inputs, folder, progress())
    # A model that misses its tolerance is written too: its certificate and trace show why.
    study.reduce(force=force, accept=accept_tolerance, missed=lambda stage: write_reduction(output, inputs, stage))
    stage = study.stage
    record = write_reduction(output, inputs, stage)
    write_campaign(output, inputs)
    options: dict[str, Any] = {"first_order": state_space, "replace_foreign": overwrite, "job": job, "assignments": assignments}
    written = export(inputs, stage, exports, **options) if exports else []
    if as_json:
        say_json(record.tree() | ({"exports": written} if exports else {}))
    else:
        say("\n".join([*describe(record, stage.seconds), *[describe_export(item, record) for item in written]]))
    unstable = written[0].get("state_space", {}).get("unstable_poles", 0) if written else 0
    if unstable and verbosity.level >= 0:
        remark(f"{unstable} poles of the state space lie in the right half plane: it is unstable", kind="warning")


def _dry_run(inputs: Inputs, folder: Path, exports: tuple[Path, ...], *, force: bool, as_json: bool) -> None:
    decision = look_up(folder, key_parts(inputs))
    if as_json:
        plan = {
            "hit": decision.hit,
            "reason": decision.reason,
            "key": decision.key,
            "builds": force or not decision.hit,
            "missed": decision.missed or None,
            "calibration": None if inputs.calibration is None else inputs.calibration.text,
        }
        say_json(plan | ({"exports": [{"file": file} for file in exports]} if exports else {}))
        return
    would = "builds the reduced model (--force)" if force else ("finds it in the cache" if decision.hit else "builds the reduced model")
    missed = [f"{decision.missed}; --accept-tolerance accepts it"] if decision.missed and not force else []
    say("\n".join([f"{would}: {decision.reason}", *missed, *[f"writes {file}" for file in exports]]))


def describe(record: ReductionRecord, seconds: float) -> list[str]:
    """Lines of text on the reduced model; `seconds` is the time of this call."""
    measured, spent = record.certificate, record.seconds
    held_out, missed = measured.held_out, "" if record.reached else ", NOT reached"
    lines = [
        f"reduced model: {record.size} DOFs ({record.size_structure} structural, {record.size_acoustic} acoustic) "
        f"for {record.full_size}, {record.terms} terms",
        f"cache: {'hit' if record.cache.hit else 'miss'} ({record.cache.reason}); {seconds:.1f} s",
        f"measured error: at most {measured.worst:.1e} (tolerance {record.tolerance:.0e}{missed}) at {len(held_out)} held-out lines, "
        f"{measured.vectors} parameter vectors each, free to clamped",
    ]
    bound, share, sure = measured.unseen, measured.unseen_share, measured.unseen_confidence
    if bound is not None and share is not None and sure is not None:
        hint = bound_hint(measured.worst, record.tolerance, len(held_out))
        above = f", which is ABOVE the tolerance: {hint}" if bound > record.tolerance else ""
        lines.append(
            f"other lines (bound from these {len(held_out)}): below {bound:.1e} at {round(100 * share)} % of them, "
            f"with {round(100 * sure)} % confidence{above}"
        )
    low, high = record.band_hz
    # Enough decimals to distinguish the lines of a narrow band.
    digits = max(2, math.ceil(3 - math.log10(high - low)))
    for line in held_out:
        errors = ", ".join(f"{kind} {error:.1e}" for kind, error in line.errors.items())
        lines.append(f"  {line.frequency_hz:{digits + 6}.{digits}f} Hz  {errors}")
    lines.append(
        f"built {record.date} with {record.backend}: {len(record.expansion_points)} expansion points, {spent['total']:.1f} s, "
        f"equal to {spent['full_lines_worth']:.0f} full lines ({spent['full_line']:.2g} s each)"
    )
    return lines


def describe_export(item: dict[str, Any], record: ReductionRecord) -> str:
    """Line of text on an exported file."""
    system = item.get("state_space")
    missed = "" if record.reached else ", tolerance NOT reached"
    first = (
        f", state space of {system['states']} states ({system['form']}, FRFs to {system['deviation']:.0e}, "
        f"poles up to {system['spectral_abscissa']:.3g} 1/s)"
        if system
        else ""
    )
    return f"exported {item['file']}: {item['size']} DOFs{first}{missed}"
