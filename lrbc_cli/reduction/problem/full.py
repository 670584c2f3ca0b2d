"""Full-order operators with the terms at reference values, and port FRFs from full-order solves (``evaluation: full``)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import scipy.sparse as sp
from threadpoolctl import ThreadpoolController

from lrbc_cli.arrays import Complexes, Floats, Integers
from lrbc_cli.errors import NumericalError
from lrbc_cli.model.fem import FeModel
from lrbc_cli.reduction.problem.basis import narrow
from lrbc_cli.reduction.problem.vectors import band_omega, local_scale, reference_values
from lrbc_cli.reduction.reduced.model import reference_dynamic
from lrbc_cli.reduction.reduced.ports import PortFrf, port_frf
from lrbc_cli.reduction.solve.dynamic import DynamicStiffness


def full_operators(model: FeModel, reference: Floats) -> tuple[sp.csc_array, sp.csc_array, sp.csc_array]:
    """K, C, M of the model plus the terms at their reference values, (nt, 3) coefficients k, c, m."""
    out = []
    for power, operator in enumerate((model.K, model.C, model.M)):
        weight = reference[:, power]
        if np.any(weight):
            operator = (operator + (model.terms.left * weight[None, :]) @ model.terms.right.T).tocsc()
        out.append(narrow(operator))
    return out[0], out[1], out[2]


def full_ports(
    model: FeModel,
    input_of: Integers,
    s: Complexes,
    band_hz: tuple[float, float],
    *,
    backend: str = "auto",
    refine: int = 1,
    progress: Callable[[int, int], None] = lambda *_: None,
) -> PortFrf:
    """Port FRFs of the full-order model, by one factorisation and solve for each line; reduced models are compared with refined ones.

    Parameters
    ----------
    model : FeModel
    input_of : (n_out,) int array
        Which input each response belongs to.
    s : (F,) complex array
    band_hz : (float, float)
        Used for the reference values of the terms only.
    backend : str
        Sparse solver, see ``DynamicStiffness``.
    refine : int
        Steps of iterative refinement. Without any, which takes a third of the time, FRFs are right to far below a thousandth of a dB, but
        no reference for the errors of a reduced model; lines where that is not so are refined.
    progress : callable
        Called with the number of lines done and of all lines.

    Returns
    -------
    PortFrf

    Raises
    ------
    NumericalError
        If the full model is (nearly) singular at a line.
    """
    H, D_ref = full_frfs(model, s, band_hz, backend=backend, refine=refine, progress=progress)
    return port_frf(H, s, D_ref, model.output_power, input_of)


def full_frfs(
    model: FeModel,
    s: Complexes,
    band_hz: tuple[float, float],
    *,
    backend: str = "auto",
    refine: int = 1,
    progress: Callable[[int, int], None] = lambda *_: None,
) -> tuple[Complexes, Complexes]:
    """(F, n_out + nt, n_in + nt) FRFs between all loads, responses and terms, and the (F, nt) dynamic values of the terms in them.

    Responses are displacements or pressures. For the parameters and errors see ``full_ports``.
    """
    high = band_omega(model.K, model.M, band_hz)
    reference = reference_values(model.terms, local_scale(model.K, model.M, model.terms, high), high)
    with ThreadpoolController().select(internal_api="openblas").limit(limits=1):
        Z = DynamicStiffness(*full_operators(model, reference), model.is_acoustic, backend=backend)
        inputs, outputs = model.inputs.toarray(), model.outputs
        H = np.empty((s.size, outputs.shape[0], inputs.shape[1]), dtype=complex)
        for line, value in enumerate(s):
            factorisation = Z.factor(complex(value))
            X = factorisation.solve(inputs, refine=refine)
            # Tested by their sum: a test of each column takes as long as the solve.
            if not refine and not Z.regular(complex(value), X.sum(axis=1, keepdims=True), inputs.sum(axis=1, keepdims=True)):
                X = factorisation.solve(inputs, refine=1)
            if refine and (residual := factorisation.residual(X, inputs)) > 1e-8:
                raise NumericalError(
                    f"the full model is nearly singular at {value.imag / (2 * np.pi):.6g} Hz",
                    expected="residual at most 1e-8",
                    found=f"{residual:.1e}",
                )
            H[line] = outputs @ X
            progress(line + 1, s.size)
    return H, reference_dynamic(reference, s)
