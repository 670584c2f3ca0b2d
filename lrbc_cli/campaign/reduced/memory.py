"""Checks before a reduction whether the memory of this machine suffices, and predicts its cost."""

from __future__ import annotations

import sys
from pathlib import Path

import psutil

from lrbc_cli.campaign.reading.inputs import Inputs
from lrbc_cli.errors import NumericalError
from lrbc_cli.reduction.outcome import ReductionOptions
from lrbc_cli.reduction.predict import Cost, memory_bound, predict

GB = 1e9

#: Folders in which the kernel states memory limits of containers, and the files with limit and usage; cgroup versions 2 and 1.
CGROUPS = (
    (Path("/sys/fs/cgroup"), "memory.max", "memory.current"),
    (Path("/sys/fs/cgroup/memory"), "memory.limit_in_bytes", "memory.usage_in_bytes"),
)


def available_bytes() -> float:
    """Memory that this process can still allocate [bytes]: what the system calls available, within the limits of container and ulimit."""
    found = float(psutil.virtual_memory().available)
    for folder, limit, used in _cgroups():
        try:
            room = float((folder / limit).read_text(encoding="ascii")) - float((folder / used).read_text(encoding="ascii"))
        except (OSError, ValueError):  # no container, or "max"
            continue
        # The file cache of the container counts as used, but is released on demand.
        room += _number_in(folder / "memory.stat", "inactive_file ") or 0.0
        found = min(found, max(room, 0.0))
    return min(found, _address_space())


def _cgroups() -> list[tuple[Path, str, str]]:
    """Cgroup folders that limit the memory of this process, and the files with limit and usage in them."""
    found = list(CGROUPS)
    try:
        lines = Path("/proc/self/cgroup").read_text(encoding="ascii", errors="replace").splitlines()
    except OSError:
        return found
    for line in lines:
        _, controllers, path = [*line.split(":", 2), "", ""][:3]
        if controllers and "memory" not in controllers.split(","):
            continue
        root, *files = CGROUPS[1] if controllers else CGROUPS[0]
        own = root / path.strip("/")
        found += [(folder, files[0], files[1]) for folder in (own, *own.parents) if root in folder.parents]
    return found


def _address_space() -> float:
    """Address space left by ``ulimit -v`` [bytes]; infinite without such a limit."""
    if sys.platform == "win32":
        return float("inf")
    import resource

    limit, _ = resource.getrlimit(resource.RLIMIT_AS)
    if limit == resource.RLIM_INFINITY:
        return float("inf")
    return max(float(limit) - float(psutil.Process().memory_info().vms), 0.0)


def resident_bytes() -> float:
    """Resident memory of this process [bytes]."""
    return float(psutil.Process().memory_info().rss)


def options_of(inputs: Inputs) -> ReductionOptions:
    """Options of the reduction as the campaign states them."""
    r = inputs.campaign.reduction
    return ReductionOptions(band_hz=r.band, tolerance=r.tolerance, held_out=r.held_out, max_size=r.max_size)


def reduction_cost(inputs: Inputs) -> tuple[Cost, float]:
    """Predicted cost of the reduction, and peak memory of this process with it [bytes]."""
    held = resident_bytes()
    cost = predict(inputs.model, options_of(inputs), backend=inputs.campaign.reduction.backend)
    return cost, held + cost.additional


def limit_of(inputs: Inputs) -> tuple[float, str]:
    """Largest allowed memory of this process [bytes], and the source of that limit."""
    stated = inputs.campaign.reduction.memory_limit
    if stated is not None:
        return stated * GB, "reduction.memory_limit"
    return resident_bytes() + available_bytes(), "available on this machine"


def require_memory(inputs: Inputs) -> None:
    """Refuse a reduction for which the memory does not suffice; its cost is predicted only if a simple bound exceeds the limit.

    Raises
    ------
    NumericalError
        If it does not suffice; states the prediction and the limit.
    """
    limit, source = limit_of(inputs)
    if resident_bytes() + memory_bound(inputs.model) <= limit:
        return
    cost, peak = reduction_cost(inputs)
    if peak <= limit:
        return
    largest = max(cost.memory, key=lambda part: cost.memory[part])
    hints = ["a coarser model"]
    if largest in ("snapshots", "basis", "estimate"):
        hints.append("fewer terms or responses")
    elif cost.backend == "superlu":
        hints.append("reduction.backend: pardiso, which needs half the memory for symmetric models")
    raise NumericalError(
        "not enough memory for the reduction",
        place="reduction",
        expected=f"at most {limit / GB:.3g} GB ({source})",
        found=f"a predicted peak of {peak / GB:.2f} GB, {cost.memory[largest] / GB:.2f} GB of it for the {largest}",
        hint=f"{' or '.join(hints)}; to try anyway, give what may be used: --override reduction.memory_limit=GIGABYTES",
    )


def _number_in(file: Path, name: str) -> float | None:
    try:
        lines = file.read_text(encoding="ascii", errors="replace").splitlines()
    except OSError:
        return None
    return next((float(line.split()[1]) for line in lines if line.startswith(name)), None)
