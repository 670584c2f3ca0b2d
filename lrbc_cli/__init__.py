"""Find the loose bolts of a structure from measured FRFs by low-rank parametric model order reduction.

>>> import lrbc_cli as lrbc
>>> study = lrbc.load("configs/frame.yaml")
>>> study.frf([100.0], left_edge=6.5).shape
(1, 4)
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from lrbc_cli.version import __version__

#: Where each public name stands: imported when it is asked for, so that the command line starts quickly.
_PUBLIC = {
    "load": "lrbc_cli.study",
    "reduce": "lrbc_cli.matrices",
    "Study": "lrbc_cli.study",
    "Identified": "lrbc_cli.identified",
    "TermModel": "lrbc_cli.matrices",
    "FeModel": "lrbc_cli.model.fem",
    "LowRankTerms": "lrbc_cli.model.terms",
    "Reduction": "lrbc_cli.reduction.build",
    "ReductionOptions": "lrbc_cli.reduction.build",
    "reduce_model": "lrbc_cli.reduction.build",
    "BoltPrior": "lrbc_cli.updating.statistics.priors",
    "Loss": "lrbc_cli.updating.statistics.losses",
    "Measurement": "lrbc_cli.campaign.identification.records",
    "read_frf": "lrbc_cli.io.frf",
    "write_frf": "lrbc_cli.io.frf",
    "LrbcError": "lrbc_cli.errors",
}

__all__ = [
    "BoltPrior",
    "FeModel",
    "Identified",
    "Loss",
    "LowRankTerms",
    "LrbcError",
    "Measurement",
    "Reduction",
    "ReductionOptions",
    "Study",
    "TermModel",
    "__version__",
    "load",
    "read_frf",
    "reduce",
    "reduce_model",
    "write_frf",
]

if TYPE_CHECKING:
    from lrbc_cli.campaign.identification.records import Measurement
    from lrbc_cli.errors import LrbcError
    from lrbc_cli.identified import Identified
    from lrbc_cli.io.frf import read_frf, write_frf
    from lrbc_cli.matrices import TermModel, reduce
    from lrbc_cli.model.fem import FeModel
    from lrbc_cli.model.terms import LowRankTerms
    from lrbc_cli.reduction.build import Reduction, ReductionOptions, reduce_model
    from lrbc_cli.study import Study, load
    from lrbc_cli.updating.statistics.losses import Loss
    from lrbc_cli.updating.statistics.priors import BoltPrior


def __getattr__(name: str) -> Any:
    if name not in _PUBLIC:
        raise AttributeError(f"module 'lrbc_cli' has no attribute {name!r}")
    import importlib

    return getattr(importlib.import_module(_PUBLIC[name]), name)


def __dir__() -> list[str]:
    return sorted(__all__)
