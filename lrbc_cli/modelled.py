"""The model of a campaign, full and reduced, for Python: the part of ``Study`` that needs no measurement."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from lrbc_cli import given
from lrbc_cli.arrays import Complexes, Floats
from lrbc_cli.campaign.documents import cache_folder
from lrbc_cli.campaign.identification.unknowns import found_on_frfs, parameterise, start_parameters, with_values
from lrbc_cli.campaign.reading.inputs import Inputs
from lrbc_cli.campaign.reduced.stage import FrfSource, ReductionStage, frf_source, obtain_reduction
from lrbc_cli.model.fem import FeModel
from lrbc_cli.model.terms import Parameterisation
from lrbc_cli.reduction.outcome import Reduction
from lrbc_cli.reduction.steps.grid import require_in_band

Progress = Callable[[str], None]


class ModelStudy:
    """The (calibrated) full-order model of a campaign and its reduced model.

    Parameters
    ----------
    inputs : Inputs
        Contents of the campaign, with the stored calibration applied to the model.
    cache : Path or None
        Folder of the cache of reduced models; None: that of the user.
    progress : callable
        Called with one line of text for each step.
    """

    def __init__(self, inputs: Inputs, cache: Path | None = None, progress: Progress = lambda _: None) -> None:
        self.inputs = inputs
        self._folder, self._progress = cache_folder(cache), progress
        self._stage: ReductionStage | None = None
        self._source: FrfSource | None = None
        self._start: Parameterisation | None = None

    @property
    def model(self) -> FeModel:
        """The full-order model, calibrated where a stored calibration fits."""
        return self.inputs.model

    @property
    def responses(self) -> list[str]:
        """Names of the responses, in the order of the columns of all FRFs."""
        return [response.name for response in self.inputs.responses]

    @property
    def jobs(self) -> list[str]:
        """Names of the jobs."""
        return list(self.inputs.campaign.jobs)

    def reduce(
        self, *, force: bool = False, accept: bool = False, missed: Callable[[ReductionStage], object] = lambda _: None
    ) -> Reduction:
        """The reduced model with its certificate: read from the cache, or built and stored there.

        Parameters
        ----------
        force : bool
            Build it even if the cache has it.
        accept : bool
            Accept a model that does not reach its tolerance.
        missed : callable
            Called with a model that misses the tolerance and is not accepted, before the error is raised.

        Raises
        ------
        NumericalError
            If the tolerance is not reached and this is not accepted, or if memory does not suffice.
        """
        if self._stage is None or force:
            self._stage = obtain_reduction(self.inputs, self._folder, force=force, accept=accept, progress=self._progress, missed=missed)
            self._source = self._start = None
        return self._stage.reduction

    @property
    def stage(self) -> ReductionStage:
        """The reduced model, and whether it came from the cache; reduces if necessary."""
        self.reduce()
        assert self._stage is not None
        return self._stage

    @property
    def source(self) -> FrfSource:
        """Computes FRFs on any lines of the band, with the reduced model or, with ``evaluation: full``, with the full model."""
        if self._source is None:
            self._source = frf_source(self.inputs, None if self.inputs.method.full_order else self.stage, self._progress)
        return self._source

    def parameters(self, hz: ArrayLike | None = None) -> Parameterisation:
        """The unknowns (log10 values and damping exponents) with start values and bounds.

        Parameters
        ----------
        hz : (F,) array or None
            Lines [Hz] on which start values and bounds given as ``auto`` are determined; an identification uses the measured lines. None:
            the 1 Hz lines of the band, as for ``frf`` and `lrbc simulate`.
        """
        if hz is not None:
            return parameterise(self.inputs, self.source, self._lines(hz))[0]
        if self._start is None:
            source = self.source
            if source.stage is None and found_on_frfs(self.inputs):
                source = frf_source(self.inputs, self.stage, self._progress)
            self._start = start_parameters(self.inputs, source)
        return self._start

    def frf(self, hz: ArrayLike, theta: ArrayLike | None = None, /, **log10: ArrayLike) -> Complexes:
        """(F, R) FRFs at given values of the unknowns, in the unit of each response, from ``source``.

        Parameters
        ----------
        hz : (F,) array
            Lines inside the band [Hz].
        theta : (size,) array or None
            All unknowns, in the order of ``parameters()``; None: their start values.
        **log10
            Values that replace those of a parameter group in theta, one for all or one for each parameter; ``inf`` clamps, ``-inf`` frees.
            A damping exponent is given as ``**{"GROUP.damping": value}``.

        Examples
        --------
        >>> from lrbc_cli import load
        >>> study = load("configs/frame.yaml")
        >>> study.frf([100.0, 101.0], left_edge=6.5).shape
        (2, 4)
        """
        s, parameters = self._lines(hz), self.parameters()
        return self.source.model(s, parameters).frf(with_values(parameters, theta, log10, self.inputs.campaign.path))

    def sensitivities(self, hz: ArrayLike, theta: ArrayLike | None = None, /, **log10: ArrayLike) -> tuple[Complexes, Floats]:
        """FRFs, and the derivatives of their levels [dB] with respect to all unknowns.

        Parameters
        ----------
        hz, theta, **log10
            As for ``frf``; values must be finite.

        Returns
        -------
        y : (F, R) complex array
        J : (F, R, size) float array
            Jacobian in dB per decade, eqs. (35), (36); columns in the order of ``parameters()``.
        """
        s, parameters = self._lines(hz), self.parameters()
        at = given.numbers("theta", with_values(parameters, theta, log10, self.inputs.campaign.path), (parameters.size,))
        y, J = self.source.model(s, parameters).sensitivities(at)
        return y, np.asarray(J.real)

    def _lines(self, hz: ArrayLike) -> Complexes:
        lines = given.lines(hz)
        require_in_band(lines, self.inputs.campaign.reduction.band, hint="change reduction.band")
        return np.asarray(2j * np.pi * lines)
