"""``lrbc simulate``: FRFs of the model at start values, given or identified parameters, by the reduced or the full model."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lrbc_cli.arrays import Floats
from lrbc_cli.campaign.identification.unknowns import layout, start_parameters, theta_of
from lrbc_cli.campaign.protect import require_new, require_no_input
from lrbc_cli.campaign.reading.inputs import Inputs
from lrbc_cli.campaign.reduced.stage import frf_source, obtain_reduction
from lrbc_cli.errors import ConfigError, DataError, NumericalError
from lrbc_cli.io.frf import WRITERS, write_frf
from lrbc_cli.model.frf import FrfRecord, FrfSet
from lrbc_cli.model.terms import Parameterisation
from lrbc_cli.reduction.steps.grid import MAX_LINES, band_lines, require_in_band
from lrbc_cli.results.job import JobRecord
from lrbc_cli.results.store import read_job

#: Largest magnitude of a log10 value that is accepted.
MAX_LOG10 = 30.0


def parse_lines(text: str | None, band: tuple[float, float]) -> Floats:
    """Lines [Hz] from ``START:STOP:STEP`` or ``33.3,71.7``; None: the 1 Hz lines of the band, or its ends if there are none.

    Raises
    ------
    ConfigError
        If the text is neither, gives too many lines, or lines at or below 0 Hz.
    """

    def refuse(problem: str, found: object) -> ConfigError:
        return ConfigError(
            problem, place=f"--lines {text}", expected="START:STOP:STEP or F1,F2,... in Hz, for instance 20:400:1 or 33.3,71.7", found=found
        )

    if text is None:
        return band_lines(band, "--lines", "give the lines: START:STOP:STEP")
    number = r"\s*[-+]?(\d+(\.\d*)?|\.\d+)([eE][-+]?\d+)?\s*"
    if re.fullmatch(f"{number}:{number}(:{number})?", text):
        values = [float(part) for part in text.split(":")]
        start, stop, step = values[0], values[1], values[2] if len(values) == 3 else 1.0
        if step <= 0 or stop < start or not np.isfinite((stop - start) / step):
            raise refuse("this range holds no line", text)
        if (stop - start) / step > MAX_LINES:
            raise refuse(f"more than {MAX_LINES} lines", f"{(stop - start) / step:.3g}")
        lines = np.asarray(start + step * np.arange(int(np.floor((stop - start) / step + 1e-9)) + 1), dtype=float)
    elif re.fullmatch(f"{number}(,{number})*", text):
        lines = np.unique([float(part) for part in text.split(",")])
    else:
        raise refuse("these are not frequency lines", text)
    if lines[0] <= 0:
        raise refuse("lines start above 0 Hz", f"{lines[0]:g} Hz")
    return np.asarray(lines, dtype=np.float64)


def parse_values(assignments: Sequence[str], parameters: Parameterisation, theta: Floats) -> Floats:
    """(size,) theta with values replaced by ``group=VALUE``, ``group=V1,V2,...`` (log10; inf clamps, -inf frees), ``group.damping=VALUE``.

    Raises
    ------
    ConfigError
        If a group is unknown, or values are no numbers, out of range, or of the wrong count.
    """
    theta = theta.copy()
    names = [group.name for group in parameters.groups]
    for text in assignments:
        name, equals, values = text.partition("=")
        group_name = name.strip()
        # Names of groups may contain dots.
        damped = group_name not in names and group_name.endswith(".damping")
        group_name = group_name.removesuffix(".damping") if damped else group_name
        if not equals or group_name not in names:
            raise ConfigError(
                "not a value for a parameter group",
                place=f"--set {text}",
                expected="GROUP=LOG10, GROUP=V1,V2,... or GROUP.damping=LOG10 with GROUP one of " + ", ".join(names),
                found=text,
            )
        group, where, at = parameters.placed[names.index(group_name)]
        try:
            numbers = np.array([float(value) for value in values.split(",")])
        except ValueError:
            raise ConfigError("not a number", place=f"--set {text}", expected="log10 values, inf or -inf", found=values) from None
        if damped:
            if at is None or numbers.size != 1 or not abs(numbers[0]) <= MAX_LOG10:
                raise ConfigError(
                    f"group {group_name} has no damping exponent"
                    if at is None
                    else f"the damping exponent is one number up to {MAX_LOG10:g}",
                    place=f"--set {text}",
                )
            theta[at] = numbers[0]
            continue
        if numbers.size not in (1, group.count):
            raise ConfigError(
                "the number of values does not fit the group",
                place=f"--set {text}",
                expected=f"1 or {group.count} values",
                found=numbers.size,
            )
        if np.any(np.abs(numbers[np.isfinite(numbers)]) > MAX_LOG10):
            raise ConfigError(
                "a value out of range",
                place=f"--set {text}",
                expected=f"log10 values between {-MAX_LOG10:g} and {MAX_LOG10:g}, inf or -inf",
                found=values,
            )
        if np.isnan(numbers).any() or (np.isposinf(numbers).any() and group.kind != "stiffness"):
            raise ConfigError(
                "this value cannot be used", place=f"--set {text}", expected="log10 values; inf only clamps stiffness", found=values
            )
        theta[where] = numbers
    return theta


def job_values(inputs: Inputs, name: str, parameters: Parameterisation) -> Floats:
    """(size,) theta of a finished job.

    Raises
    ------
    ConfigError, DataError
        If the job is unknown, has no usable result, or has other parameter groups.
    """
    campaign = inputs.campaign
    campaign.require_job(name, "--job")
    path = campaign.output / name / "result.json"
    job = read_job(campaign.output, name)
    if not isinstance(job, JobRecord):
        raise DataError(f"job {name} has no identified parameters", file=path, hint=f"run lrbc update {campaign.path.name} --job {name}")
    theta = theta_of(parameters, job.parameters)
    if theta is None:
        raise DataError(f"the result of job {name} does not match the current parameter groups", file=path, hint="run lrbc update again")
    return theta


def check_parameters(inputs: Inputs, job: str | None, assignments: Sequence[str]) -> None:
    """Refuse, before anything is computed, a job or values that do not fit.

    Raises
    ------
    ConfigError, DataError
        As ``parse_values`` and ``job_values``.
    """
    parameters = layout(inputs)
    theta = parameters.initial if job is None else job_values(inputs, job, parameters)
    parse_values(assignments, parameters, theta)


def simulate(
    inputs: Inputs,
    folder: Path,
    out: Path,
    *,
    job: str | None = None,
    lines: str | None = None,
    assignments: Sequence[str] = (),
    full: bool = False,
    replace: bool = False,
    accept: bool = False,
    progress: Callable[[str], None] = lambda _: None,
) -> FrfSet:
    """Compute FRFs and write them.

    Parameters
    ----------
    inputs : Inputs
    folder : Path
        Folder of the cache of reduced models.
    out : Path
        ``.csv``, ``.uff`` or ``.h5``.
    job : str or None
        Job whose identified parameters are used; None: start values.
    lines, assignments
        See ``parse_lines`` and ``parse_values``.
    full : bool
        Use the full model, with one solve per line.
    replace : bool
        Replace an existing file; inputs of the campaign are never replaced.
    accept : bool
        Accept a reduced model that misses its tolerance.
    progress : callable

    Returns
    -------
    FrfSet
    """
    band = inputs.campaign.reduction.band
    _require_target(inputs, out, replace)
    frequency = parse_lines(lines, band)
    if not full:
        require_in_band(frequency, band, f"--lines {lines}", "change reduction.band, or use --full")
    check_parameters(inputs, job, assignments)
    s = 2j * np.pi * frequency
    auto = job is None and any(group.config.start is None for group in inputs.groups)
    stage = None if full and not auto else obtain_reduction(inputs, folder, accept=accept or full, progress=progress)
    reduced = None if stage is None else frf_source(inputs, stage, progress)
    source = frf_source(inputs, None, progress) if full or reduced is None else reduced
    parameters = start_parameters(inputs, reduced) if auto and reduced is not None else layout(inputs)
    theta = parameters.initial if job is None else job_values(inputs, job, parameters)
    theta = parse_values(assignments, parameters, theta)
    frf = _records(inputs, out, frequency, source.model(s, parameters).frf(theta))
    try:
        write_frf(out, frf)
    except OSError as error:
        raise ConfigError(f"the file cannot be written ({error.strerror or error})", file=out, place="--out") from error
    return frf


def _require_target(inputs: Inputs, out: Path, replace: bool) -> None:
    if out.suffix.lower() not in WRITERS:
        raise ConfigError(
            "this ending of an FRF file is not known", file=out, place="--out", expected=", ".join(WRITERS), found=out.suffix or "none"
        )
    require_no_input(out, inputs.campaign, "--out")
    if not replace:
        require_new(out, "--out", "--force")


def _records(inputs: Inputs, out: Path, frequency: Floats, y: NDArray[np.complexfloating]) -> FrfSet:
    if not np.all(np.isfinite(y)):
        line, row = (int(index[0]) for index in np.nonzero(~np.isfinite(y)))
        raise NumericalError(
            f"the FRF of {inputs.responses[row].name} is not finite at {frequency[line]:g} Hz",
            hint="use less extreme values, or damping in the model",
        )
    records = []
    for i, response in enumerate(inputs.responses):
        node, direction = inputs.excitation_points[response.input]
        records.append(
            FrfRecord(
                name=response.name,
                frequency_hz=frequency,
                values=y[:, i].astype(complex),
                quantity=response.quantity,
                response_node=response.node,
                response_direction=response.direction or 0,
                reference_node=node,
                reference_direction=direction or 0,
                place=response.name,
            )
        )
    return FrfSet(source=str(out), records=tuple(records))
