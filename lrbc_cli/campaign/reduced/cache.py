"""Cache of reduced models and interface FRFs: keyed by the contents of all inputs, written atomically, with the reason of each miss."""

from __future__ import annotations

import json
import logging
import tempfile
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lrbc_cli.arrays import Floats, Integers
from lrbc_cli.campaign.digests import code, digest, key_of
from lrbc_cli.campaign.reading.inputs import Inputs
from lrbc_cli.errors import ConfigError, DataError
from lrbc_cli.io.atomic import atomic_write
from lrbc_cli.io.hdf5.store import read_store, write_store
from lrbc_cli.io.json_text import parse_json, read_json_text
from lrbc_cli.reduction.outcome import HeldOut, Reduction, ReductionOptions, Step
from lrbc_cli.reduction.problem.vectors import ERROR_KINDS
from lrbc_cli.reduction.reduced.model import ReducedModel
from lrbc_cli.reduction.reduced.ports import PortFrf

log = logging.getLogger(__name__)

#: Attributes of a reduction that are stored unchanged, in addition to model, sizes, certificate and trace.
_SUMMARY = ("reached", "backend", "coupling", "full_size", "vectors", "unseen", "stopped", "seconds", "machine", "date")

#: Names of the key's parts in messages.
PARTS = {
    "operators": "the matrices or the damping",
    "groups": "the matrices of the calibration's groups",
    "terms": "the terms",
    "loads": "the excitation",
    "outputs": "the responses",
    "band": "the band",
    "tolerance": "the tolerance",
    "limits": "held_out or max_size",
    "version": "the code that reduces",
}


def key_parts(inputs: Inputs) -> dict[str, str]:
    """Digest of each part on which the reduced model depends, by its name in ``PARTS``; never paths or time stamps."""
    m, r = inputs.model, inputs.campaign.reduction
    return {
        "operators": digest(m.K, m.C, m.M, m.is_acoustic),
        "groups": digest(
            *[part for name in sorted(m.extras) for key in sorted(m.extras[name]) for part in (name, key, m.extras[name][key])]
        ),
        "terms": digest(m.terms.left, m.terms.right, m.terms.power, m.terms.baseline),
        "loads": digest(m.B),
        "outputs": digest(m.L, m.output_power, inputs.input_of),
        "band": digest(r.band),
        "tolerance": digest(r.tolerance),
        "limits": digest(r.held_out, r.max_size),
        "version": code("reduction"),
    }


@dataclass(frozen=True, kw_only=True)
class CacheDecision:
    """Whether the cache contains a reduced model, and why.

    Attributes
    ----------
    key : str
    path : Path
        File of the model, whether it exists or not.
    hit : bool
    reason : str
    missed : str
        Error reached by a cached model that misses its tolerance, in words; else empty.
    """

    key: str
    path: Path
    hit: bool
    reason: str
    missed: str = ""


def look_up(folder: Path, parts: dict[str, str]) -> CacheDecision:
    """Whether ``folder`` contains the model with these parts; reads its stamp only."""
    key = key_of(parts)
    path = folder / key / "model.h5"
    if path.is_file():
        try:
            fault = "" if read_store(path, ("key",)) == {"key": key} else "the file in the cache was not made for this campaign"
        except DataError:
            fault = "the file in the cache is damaged"
        if fault:
            return CacheDecision(key=key, path=path, hit=False, reason=fault)
        return CacheDecision(
            key=key,
            path=path,
            hit=True,
            reason="matrices, terms, excitation, responses, band and tolerance are those of a model in the cache",
            missed=_missed(path),
        )
    nearest: list[str] | None = None
    for other in folder.glob("*/key.json"):
        try:
            stored = parse_json(read_json_text(other))
        except (OSError, ValueError):
            continue
        if isinstance(stored, dict):
            different = [name for name, part in parts.items() if stored.get(name) != part]
            if nearest is None or len(different) < len(nearest):
                nearest = different
    if nearest is None:
        reason = "the cache is empty"
    elif not nearest:
        reason = "this model was begun earlier, but not finished"
    elif len(nearest) == len(parts) or ("operators" in nearest and len(nearest) > 3):
        reason = "no model of these matrices is in the cache"
    else:
        reason = "changed since the nearest model in the cache: " + ", ".join(PARTS[name] for name in nearest)
    return CacheDecision(key=key, path=path, hit=False, reason=reason)


def _missed(path: Path) -> str:
    """Stored text about a model that misses its tolerance; empty if it does not, or if there is no such text."""
    try:
        stored = parse_json(read_json_text(path.with_name("key.json")))
    except (OSError, ValueError):
        return ""
    note = stored.get("missed") if isinstance(stored, dict) else None
    return note if isinstance(note, str) else ""


def store(decision: CacheDecision, parts: dict[str, str], reduction: Reduction) -> None:
    """Write a reduced model with its certificate, and delete interface FRFs of the model that it replaces."""
    model = {name: getattr(reduction.model, name) for name in ReducedModel.__dataclass_fields__}
    model["extras"] = {name: dict(group) for name, group in reduction.model.extras.items()}
    tree = {
        "key": decision.key,
        "parts": parts,
        "model": model,
        "options": asdict(reduction.options) | {"band_hz": list(reduction.options.band_hz)},
        "certificate": [{"frequency_hz": line.frequency_hz, "errors": line.errors} for line in reduction.held_out],
        "trace": [asdict(step) for step in reduction.trace],
        "summary": {name: getattr(reduction, name) for name in _SUMMARY} | {"sizes": list(reduction.sizes)},
    }
    try:
        # Interface (port) FRFs of the replaced model. Rows of its basis stay: they carry a stamp, and another process may be reading them.
        for old in decision.path.parent.glob("ports-*.h5"):
            old.unlink(missing_ok=True)
        write_store(decision.path, tree)
        with atomic_write(decision.path.with_name("key.json")) as file:
            json.dump(parts | {"missed": missed_text(reduction)}, file, indent=1)
    except OSError as error:
        raise _unwritable(decision.path.parent, error) from error


def missed_text(reduction: Reduction) -> str:
    """Text on a model that misses its tolerance: error reached, and what stopped the reduction; empty if it reaches it."""
    if reduction.reached:
        return ""
    reached = f"it does not reach its tolerance of {reduction.options.tolerance:.1e}: the measured error is {reduction.worst:.1e}"
    return reached + (f" (stopped by: {reduction.stopped})" if reduction.stopped else "")


def require_writable(decision: CacheDecision) -> None:
    """Check before a reduction that the cache can be written.

    Raises
    ------
    ConfigError
        If it cannot.
    """
    folder = decision.path.parent
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise _unwritable(folder, error) from error


def _unwritable(folder: Path, error: OSError) -> ConfigError:
    return ConfigError(
        f"the cache cannot be written ({error.strerror or error})", file=folder, hint="give another folder with --cache or LRBC_CACHE"
    )


def load(decision: CacheDecision, inputs: Inputs) -> Reduction:
    """Read a reduced model from the cache.

    Raises
    ------
    DataError
        If the file is damaged or contains another model; the caller then reduces again.
    """
    tree = read_store(decision.path)
    # A file may have been copied from another folder of the cache.
    if tree.get("key") != decision.key:
        problem = "this is not the reduced model of this campaign"
        raise DataError(problem, file=decision.path, expected=f"key {decision.key}", found=f"key {tree.get('key')}")
    try:
        options = tree["options"] | {"band_hz": tuple(tree["options"]["band_hz"])}
        summary = tree["summary"]
        model = ReducedModel(**tree["model"])
        _require_shapes(model, inputs)
        return Reduction(
            model=model,
            options=ReductionOptions(**options),
            reached=bool(summary["reached"]),
            held_out=tuple(_held_out(line) for line in tree["certificate"]),
            unseen=float(summary["unseen"]),
            trace=tuple(Step(**step) for step in tree["trace"]),
            seconds=dict(summary["seconds"]),
            backend=summary["backend"],
            coupling=summary["coupling"],
            sizes=tuple(summary["sizes"]),
            full_size=int(summary["full_size"]),
            vectors=int(summary["vectors"]),
            machine=dict(summary["machine"]),
            date=summary["date"],
            stopped=summary["stopped"],
        )
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise DataError(f"this reduced model is damaged ({error})", file=decision.path) from error


def _require_shapes(model: ReducedModel, inputs: Inputs) -> None:
    """Check that the arrays of a cached model fit each other and the inputs.

    Raises
    ------
    ValueError, TypeError
        If one does not; with its name.
    """
    full = inputs.model
    r, terms = model.size, full.terms.size
    responses, loads = full.L.shape[0], full.B.shape[1]
    _require_arrays(
        {"K": model.K, "C": model.C, "M": model.M, "B": model.B, "L": model.L, "left": model.left, "right": model.right}
        | {"reference": model.reference},
        {"K": (r, r), "C": (r, r), "M": (r, r), "B": (r, loads), "L": (responses, r), "left": (r, terms), "right": (r, terms)}
        | {"reference": (terms, 3)},
    )
    if not np.array_equal(model.input_of, inputs.input_of) or not np.array_equal(model.output_power, full.output_power):
        raise ValueError("its responses are others")
    if not isinstance(model.structure, int) or not 0 <= model.structure <= r:
        raise ValueError(f"{model.structure} structural DOFs of {r}")
    if {name: set(group) for name, group in model.extras.items()} != {name: set(group) for name, group in full.extras.items()}:
        raise ValueError("its groups of factors are others")
    for name, group in model.extras.items():
        _require_arrays({f"{name} {key}": matrix for key, matrix in group.items()}, {f"{name} {key}": (r, r) for key in group})


def _require_arrays(arrays: Mapping[str, Any], shapes: Mapping[str, tuple[int, ...]]) -> None:
    for name, array in arrays.items():
        if not isinstance(array, np.ndarray) or array.dtype.kind not in "fc" or array.shape != shapes[name]:
            raise ValueError(f"{name} is {getattr(array, 'shape', None)}, not {shapes[name]}")


def _held_out(line: dict[str, Any]) -> HeldOut:
    errors = dict(line["errors"])
    # HDF5 sorts names; restore the order from free to clamped.
    return HeldOut(float(line["frequency_hz"]), {kind: float(errors.pop(kind)) for kind in ERROR_KINDS if kind in errors} | errors)


def _rows_stamp(decision: CacheDecision, reduction: Reduction, dofs: Integers) -> dict[str, str]:
    """Stamp of stored rows of a basis: key and digest of the model, and digest of the DOFs."""
    return {"key": decision.key, "model": digest(reduction.model.K, reduction.model.B), "dofs": digest(dofs)}


def store_rows(decision: CacheDecision, reduction: Reduction, dofs: Integers) -> None:
    """Write rows of the basis beside the model, for deflection shapes; a failure is only logged."""
    assert reduction.rows is not None
    try:
        write_store(
            decision.path.with_name("rows.h5"),
            {"made_for": _rows_stamp(decision, reduction, dofs), "rows": reduction.rows.astype(np.float32)},
        )
    except OSError as error:
        log.warning("the basis at the drawn nodes was not kept (%s)", error)


def rows_fault(decision: CacheDecision) -> str:
    """Why the stored rows of the basis cannot be read; empty if they can, also if they are those of another model."""
    path = decision.path.with_name("rows.h5")
    if not path.is_file():
        return "the basis of the reduced model is not kept in the cache"
    try:
        read_store(path)
    except DataError as error:
        return f"the basis in the cache is damaged ({error.problem})"
    return ""


def load_rows(decision: CacheDecision, reduction: Reduction, dofs: Integers) -> tuple[Floats | None, str]:
    """(k, r) rows of the basis at k DOFs, and an empty text; None, and the reason, if they are missing, damaged or of another model."""
    fault = rows_fault(decision)
    if fault:
        return None, fault
    try:
        tree = read_store(decision.path.with_name("rows.h5"))
        if tree.get("made_for") != _rows_stamp(decision, reduction, dofs):
            return None, "the basis in the cache belongs to another model"
        _require_arrays({"rows": tree.get("rows")}, {"rows": (dofs.size, reduction.model.size)})
    except (DataError, ValueError) as error:
        return None, f"the basis in the cache is damaged ({error.problem if isinstance(error, DataError) else error})"
    return np.asarray(tree["rows"], dtype=np.float64), ""


def ports_path(decision: CacheDecision, s: NDArray[np.complexfloating[Any, Any]], kind: str) -> Path:
    """File of the interface (port) FRFs for the lines s (i omega), beside the reduced model."""
    return decision.path.parent / f"ports-{kind}-{digest(s)[:16]}.h5"


def _ports_stamp(decision: CacheDecision, s: NDArray[np.complexfloating[Any, Any]], kind: str) -> dict[str, str]:
    """Stamp of stored interface FRFs: key of the model, digest of the lines, and kind of evaluation."""
    return {"key": decision.key, "lines": digest(s), "kind": kind}


def store_ports(decision: CacheDecision, s: NDArray[np.complexfloating[Any, Any]], kind: str, ports: PortFrf) -> None:
    """Write interface FRFs; a failure (such as a full disk) is only logged, and costs the next run time."""
    arrays = {name: getattr(ports, name) for name in PortFrf.__dataclass_fields__}
    try:
        write_store(ports_path(decision, s, kind), {"made_for": _ports_stamp(decision, s, kind), "ports": arrays})
    except OSError as error:
        log.warning("port FRFs were not kept (%s)", error)


def load_ports(decision: CacheDecision, s: NDArray[np.complexfloating[Any, Any]], kind: str, inputs: Inputs) -> PortFrf | None:
    """Read interface FRFs for these lines; None if they are missing, damaged or of another model."""
    path = ports_path(decision, s, kind)
    if not path.is_file():
        return None
    try:
        tree = read_store(path)
        if tree.get("made_for") != _ports_stamp(decision, s, kind):
            raise ValueError("they belong to something else")
        ports = PortFrf(**tree["ports"])
        F, R, nt, loads = s.size, inputs.model.L.shape[0], inputs.model.terms.size, inputs.model.B.shape[1]
        _require_arrays(
            {name: getattr(ports, name) for name in ("s", "H00", "H0p", "Hp0", "Hpp", "D_ref")},
            {"s": (F,), "H00": (F, R), "H0p": (F, R, nt), "Hp0": (F, nt, loads), "Hpp": (F, nt, nt), "D_ref": (F, nt)},
        )
        if not np.array_equal(ports.s, s) or not np.array_equal(ports.input_of, inputs.input_of):
            raise ValueError("their lines or responses are others")
        return ports
    except (DataError, KeyError, TypeError, ValueError) as error:
        problem = error.problem if isinstance(error, DataError) else error
        log.warning("port FRFs in the cache are computed again (%s: %s)", path, problem)
        return None
