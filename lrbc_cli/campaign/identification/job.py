"""The fit of one job: reads its measurement, sets up its cost, and finds the minimum. ``Job.best`` runs all steps in order.

The search is described on the guide page *method* (Updating), weights and gains on the page *statistics*.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from lrbc_cli.arrays import Complexes, Floats, Integers
from lrbc_cli.campaign.identification.found import Fit
from lrbc_cli.campaign.identification.gains import Gains, Sharers, columns_of, gains_of, kept, none_shown, sharers
from lrbc_cli.campaign.identification.nuisances import hits_of, nuisances_of
from lrbc_cli.campaign.identification.records import Measurement, read_measurement, unlike
from lrbc_cli.campaign.identification.unknowns import calibrated_start, parameterise, penalty_of, select_lines, stored_covariance, theta_of
from lrbc_cli.campaign.identification.weights import correction, joint_sigma, left_out, line_sigma, lines_doubt, without_noise
from lrbc_cli.campaign.reading.inputs import Inputs
from lrbc_cli.campaign.reduced.stage import FrfSource
from lrbc_cli.errors import DataError, NumericalError
from lrbc_cli.updating.judging.reference import ReferenceState
from lrbc_cli.updating.misfit.cost import SLOPE_STEP, ChangeError, Misfit
from lrbc_cli.updating.misfit.nuisances import Nuisance
from lrbc_cli.updating.posterior.fit import Posterior, extended_misfit, follow_noise, no_worse, noise_of, posterior, weighed
from lrbc_cli.updating.search.descent import Level, descend
from lrbc_cli.updating.search.lcurve import l_curve
from lrbc_cli.updating.search.levels import gauss_newton_by_levels
from lrbc_cli.updating.search.optimise import Solution, bfgs, gauss_newton
from lrbc_cli.updating.search.search import search
from lrbc_cli.updating.search.smooth import narrowed, smoothed_costs
from lrbc_cli.updating.search.starts import LEVELS, alone, between
from lrbc_cli.updating.statistics.chain.damping import beside_damping, damping_pattern
from lrbc_cli.updating.statistics.decibels import decibel
from lrbc_cli.updating.unknowns.shapes import Shapes, bolt_shapes, neighbouring_columns, node_shapes

log = logging.getLogger(__name__)


class Job:
    """Measurement, model, unknowns and weights of one job, and the steps of its identification.

    Attributes
    ----------
    measurement : Measurement
    s : (F,) complex array
        i omega of the measured lines [rad/s].
    parameters, limits : Parameterisation, dict
        See ``unknowns.parameterise``.
    start, prior : (size,) float arrays
        Theta of the start values; theta of the reference job, or the start values without it.
    against_reference : bool
        The unknowns are changes relative to the reference job.
    shapes : Shapes
        ``theta = prior + T z``: hats and joints in jobs that follow a reference job, single values otherwise.
    selected, near : int arrays
        Lines that enter the cost, and all lines of the resonances to which they belong.
    sharp : bool
        The lines do not resolve the peaks.
    error : ChangeError or None
    gains, sharers : (U, K) float array or None, Sharers or None
        Gains to be marginalised, see ``gains.columns_of``, and the responses that share one.
    sigma, tight_sigma : (m, U) float arrays or None
        Measurement noise of this and of the reference job [dB].
    """

    def __init__(
        self, inputs: Inputs, source: FrfSource, name: str, reference: ReferenceState | None, given: Mapping[str, Measurement]
    ) -> None:
        self.inputs, self.source, self.name, self.reference, self._given = inputs, source, name, reference, dict(given)
        self.method, self.statistics = inputs.method, inputs.statistics
        self.begin = time.perf_counter()
        self.measurement = self._read(name)
        self.seconds_read = time.perf_counter() - self.begin
        for warning in self.measurement.warnings:
            log.warning("job %s: %s", name, warning)
        self.s = 2j * np.pi * self.measurement.frequency_hz
        self.parameters, self.limits = parameterise(inputs, source, self.s)
        self.start = self.parameters.initial
        self.notes: list[str] = []
        self.warnings: list[str] = []
        before = self._before()
        self.against_reference = before is not None
        self.prior = self.start if before is None else before
        self.shapes = self._shapes()
        self.tight: Measurement | None = None
        self._values: dict[tuple[str, bool], Complexes] = {}
        told = self.told(name, self.measurement)
        self.selected, self.near = select_lines(inputs, replace(self.measurement, values=told), name)
        self.model = source.model(self.s, self.parameters, self.selected, inputs.used)
        tight = self.of_reference() if self.against_reference and name != inputs.campaign.update.reference else None
        self.sharp = lines_doubt(inputs, (name, self.measurement, tight)) is not None
        self.error = self._change_error()
        self.gains: Floats | None = None
        self.sharers: Sharers | None = None
        self.sigma, notes = line_sigma(inputs, self.measurement, inputs.campaign.jobs[name], self.selected)
        self.tight_sigma: Floats | None = None
        noise_of = inputs.campaign.update.reference if self.against_reference else None
        self.notes += [*notes, *left_out(inputs, self.measurement, told, noise_of)]

    def _read(self, name: str) -> Measurement:
        """Measurement of a job, read from its files unless it was passed in or read before."""
        if name not in self._given:
            self._given[name] = read_measurement(self.inputs, self.inputs.campaign.jobs[name], name)
        return self._given[name]

    def _before(self) -> Floats | None:
        """Theta of the reference job if that is the prior, else None."""
        job = self.inputs.campaign.update.reference
        if self.method.approach == "paper" or job is None or job == self.name:
            return None
        found = None if self.reference is None else theta_of(self.parameters, self.reference.parameters)
        if found is None:
            self.warnings.append(f"the reference job {job} has no result: the start values are the prior, and no bolt is judged")
        return found

    def _change_error(self) -> ChangeError | None:
        """Error of the changes that the model predicts; None without a result of the reference job, or if lines are not weighted."""
        if self.reference is None or not self.shapes.by_bolt or not self.method.weighted:
            return None
        step = SLOPE_STEP * float(self.measurement.frequency_hz[-1])
        above = self.source.model(self.s + 2j * np.pi * step, self.parameters, self.selected, self.inputs.used)
        # A change is the difference of two states, each as wrong as the reference state.
        most = float(np.sqrt(2.0)) * max(self.reference.sigma_db, self.reference.misfit_db)
        lines = self.measurement.frequency_hz[self.selected]
        here, size, errors = self.model, self.parameters.size, self.statistics.errors
        return ChangeError(most=most, here=here, above=above, frequency_hz=lines, step_hz=step, size=size, errors=errors)

    def _shapes(self) -> Shapes:
        values, bolts = self.statistics.values, self.inputs.bolts
        if self.against_reference and bolts is not None:
            found = bolt_shapes(self.parameters, bolts.xyz, values, self.statistics.bolts)
            if (found.bolts >= 0).any():
                return found
        # A weight given in the campaign refers to decades, not to standard deviations.
        return node_shapes(self.parameters, values.std if self.method.follows_noise else 1.0)

    def measured(self) -> Complexes:
        """(m, U) measured FRFs on the selected lines, for the responses used, without the gains of the reference job."""
        return self._used(self.name, self.measurement, self.selected)

    def told(self, job: str, measurement: Measurement, *, known: bool = False) -> Complexes:
        """(F, R) measured values of a job, see ``without_noise``; computed once."""
        if (job, known) not in self._values:
            other = self.against_reference and job != self.inputs.campaign.update.reference
            tight = self.of_reference() if other else None
            self._values[job, known] = without_noise(self.inputs, job, measurement, tight, known=known)
        return self._values[job, known]

    def _used(self, job: str, measurement: Measurement, lines: Integers) -> Complexes:
        """(m, U) FRFs of a job on some lines, for the responses used, NaN where noisy, without the gains of the reference job."""
        return np.asarray((self.told(job, measurement) / self.lifted)[np.ix_(lines, self.inputs.used)])

    @property
    def lifted(self) -> Floats:
        """(R,) factors by which the FRFs of the reference job lie above those of the model."""
        known = self.reference.gain_db if self.against_reference and self.reference is not None else {}
        return np.array([10.0 ** (known.get(response.name, 0.0) / 20.0) for response in self.inputs.responses])

    def corrected(self) -> Complexes | None:
        """(m, U) ``measured`` times the model's over the measured FRFs of the reference state; None if these cannot be compared.

        The model discrepancy of the reference state is mostly that of the other states too, so it cancels, and small changes show.
        """
        reference = self.inputs.campaign.update.reference
        if not self.against_reference or reference is None:
            return None
        try:
            tight = self.tight = self._read(reference)
        except DataError as error:
            # The stored result of the reference job is still the prior.
            self.warnings.append(f"the measurement of {reference} is unusable ({error.problem}): compared without correction")
            return None
        if which := unlike(self.measurement.frequency_hz, tight.frequency_hz):
            self.warnings.append(f"its frequency lines differ from those of {reference} ({which}): compared without correction by it")
            return None
        self.tight_sigma, _ = line_sigma(self.inputs, tight, self.inputs.campaign.jobs[reference], self.selected)
        known = self._used(reference, tight, self.selected)
        return self.measured() * correction(self._tight_frf(), known, self.statistics.errors.most_correction_db)

    def of_reference(self) -> Measurement | None:
        """Measurement of the reference job; None in the reference job itself, or if it cannot be read."""
        reference = self.inputs.campaign.update.reference
        if self.tight is not None or reference in (None, self.name):
            return self.tight
        try:
            return self._read(reference)
        except DataError:
            return None

    def fit(self, measured: Complexes, relative: bool, *, unexplained_db: float = 3.0) -> Fit:
        """Minimum of the cost, with the weight of the prior as the method sets it; more starts if more than ``unexplained_db`` is left."""
        method, bounds, weight = self.method, self.parameters.bounds, self.method.regularisation
        misfit = self.cost(measured, relative)
        span = self.shapes.T if self.shapes.by_bolt else None
        curve, sought = None, 0
        further = {} if span is not None else calibrated_start(self.inputs, self.parameters)
        known = tuple(further.values())
        begin = self.prior if span is not None else self.start
        if weight == "l-curve":
            curve = l_curve(misfit, begin, bounds)
            misfit = misfit.with_eta(curve.chosen)
            further |= {"end of the L-curve": curve.nearest}
        if method.optimiser == "bfgs":
            solution = self.descend(misfit, begin)
        else:
            stop: dict[str, Any] = {"tolerance": method.tolerance, "max_iterations": method.max_iterations}
            mirrors = alone if self.inputs.bolts is None else partial(self.shapes.mirrored, self.inputs.bolts.xyz)
            beside: dict[str, Any] = {"span": span, "joints": self.shapes.joint_columns, "mirrors": mirrors}
            if span is not None:
                beside["wide"] = self._smoothed(misfit, relative) if self.shapes.joint_columns else []
                further, sought = self._sought(misfit, beside["wide"])
            solution = gauss_newton_by_levels(misfit, begin, bounds, further=further, **beside, **stop)
            if span is not None and solution.evaluation.misfit_db > unexplained_db:
                # The valley may be narrower than the steps of the table: try levels between them.
                closer, more = self._table(misfit, between(LEVELS))
                first, places = solution, {"the end without it": solution.theta} | closer
                again = gauss_newton_by_levels(misfit, begin, bounds, further=places, **beside, **stop)
                solution, sought = min(first, again, key=lambda end: end.evaluation.total), sought + more
                sought += (first.evaluations + again.evaluations) - solution.evaluations
        if solution.status == "failed":
            raise NumericalError(f"job {self.name}: {solution.reason}")
        found = self.weighted(misfit, solution, (measured, relative), (begin, *known))
        return replace(found, curve=curve, evaluations=found.evaluations + (curve.evaluations if curve else 0)).after(sought)

    def weighted(self, misfit: Misfit, solution: Solution, compared: tuple[Complexes, bool], places: Sequence[Floats]) -> Fit:
        """The fit after a descent to ``solution``, with weights that follow the noise; ``places``: see ``follow_noise``."""
        if self.method.follows_noise:
            misfit, solution, noise = follow_noise(misfit, solution, self.descend, self.selected, self.error, places)
        else:
            noise = noise_of(misfit, solution.evaluation, self.selected)
        knowledge = posterior(misfit, solution, self.shapes, (), noise, self.prior)
        known: dict[str, Any] = {"plain": misfit, "misfit": misfit, "solution": solution, "knowledge": knowledge, "curve": None}
        return Fit(measured=compared[0], relative=compared[1], evaluations=solution.evaluations, **known)

    def _table(self, misfit: Misfit, levels: Sequence[float] = LEVELS) -> tuple[dict[str, Floats], int]:
        """Theta of the best states of loosened bolts by tables, by description, and evaluations; neighbours are tried in pairs, too."""
        bolts = self.inputs.bolts
        assert bolts is not None
        pairs = neighbouring_columns(self.parameters, bolts.xyz, self.shapes)
        return search(misfit, self.shapes, self.parameters.bounds, pairs, names=bolts.name, levels=levels)

    def _sought(self, misfit: Misfit, wide: Sequence[Misfit]) -> tuple[dict[str, Floats], int]:
        """Theta of the starts of descents, by description, and evaluations; ``wide``: costs between smoothed spectra, may be empty."""
        further, sought = self._table(misfit)
        if not wide:
            return further, sought
        # If all joints scatter, a loose one shows in smoothed spectra only; where the model errs, on the measured lines only.
        tabled, more = self._table(wide[0])
        led, most = narrowed(wide, tabled, self.parameters.bounds, self.shapes.T)
        return further | led, sought + more + most

    def cost(self, measured: Complexes, relative: bool) -> Misfit:
        """The first cost, with the weight of the prior as the method sets it."""
        weight = self.method.regularisation
        eta = self.statistics.values.first_variance if weight == "noise" else 0.0 if weight == "l-curve" else float(weight)
        sigma = joint_sigma(self.sigma, self.tight_sigma if relative else None)  # a ratio has the noise of both
        options, errors = self.method.residual, self.statistics.errors
        rows = penalty_of(self.method, self.statistics.values, self.parameters, self.shapes, self.against_reference)
        further: dict[str, Any] = {"options": options, "sharp": self.sharp, "gains": self.gains}
        return Misfit(self.model, measured, self.prior, eta, rows, sigma=sigma, errors=errors, **further)

    def _smoothed(self, misfit: Misfit, relative: bool) -> list[Misfit]:
        """Costs between smoothed spectra, the strongest smoothing first."""
        used, every = self.inputs.used, np.arange(self.s.size)
        reference = self.inputs.campaign.update.reference
        tight = self._used(str(reference), self.tight, every) if relative and self.tight is not None else None
        own, model = self._used(self.name, self.measurement, every), lambda s: self.source.model(s, self.parameters, None, used)
        return smoothed_costs(misfit, model, self.measurement.frequency_hz, own, tight, self.statistics.calibration)

    def descend(self, misfit: Misfit, start: Floats) -> Solution:
        """One descent from theta ``start`` by the optimiser of the method; the Jacobian of its result is with respect to z."""
        method, bounds = self.method, self.parameters.bounds
        if method.optimiser == "gauss-newton":
            return descend(misfit, start, bounds, self.shapes.T, tolerance=method.tolerance, max_iterations=method.max_iterations)
        return bfgs(misfit, start, bounds, tolerance=method.tolerance, max_iterations=method.max_iterations)

    def _nuisances(self) -> tuple[Nuisance, ...]:
        """Nuisance parameters of this job; in the reference job only the hammer offset, as the others are relative to that job."""
        if self.against_reference:
            return nuisances_of(self.inputs)
        return hits_of(self.inputs) if self.name == self.inputs.campaign.update.reference else ()

    def _tight_frf(self) -> Complexes:
        """(m, U) FRFs of the model in the reference state on the selected lines, with the hammer offset of the reference job."""
        nuisances = hits_of(self.inputs)
        offsets = {} if self.reference is None else self.reference.hammer_offset_m
        if not nuisances or self.source.stage is None or not offsets:
            return self.model.frf(self.prior)
        model = self.source.drifting(self.s[self.selected], self.parameters, nuisances, self.inputs.used)
        return model.frf(np.concatenate([self.prior, [offsets.get(nuisance.name, 0.0) for nuisance in nuisances]]))

    def drifted(self, fit: Fit, *, rounds: int = 3, steps: int = 12, tolerance: float = 1e-3, change: float = 0.15) -> Fit:
        """The fit continued with nuisance parameters, from its end and from the reference state; the same fit without any.

        Each evaluation factorises the reduced model at every line. At most ``rounds`` of new weights, each with ``steps`` iterations
        (stop: ``tolerance``), until the noise variance changes by less than the share ``change``.
        """
        nuisances = self._nuisances()
        if not nuisances:
            return fit
        # With the full model, campaigns with nuisance parameters were refused when the file was read.
        model = self.source.drifting(self.s[self.selected], self.parameters, nuisances, self.inputs.used)
        noise, least = fit.knowledge.noise, self.statistics.errors.least_variance
        T = np.zeros((model.size, self.shapes.T.shape[1] + len(nuisances)))
        T[: self.parameters.size, : self.shapes.T.shape[1]] = self.shapes.T
        T[self.parameters.size :, self.shapes.T.shape[1] :] = np.eye(len(nuisances))
        misfit = extended_misfit(fit.misfit, model, nuisances, noise.variance)
        level = Level(misfit, misfit.prior, T)
        box = level.bounds(model.bounds)

        def onwards(z: Floats, iterations: int) -> Solution:
            limit = min(iterations, self.method.max_iterations)
            return gauss_newton(level, np.clip(z, box[:, 0], box[:, 1]), box, tolerance=tolerance, max_iterations=limit)

        # Nuisance parameters alone may explain what the first fit attributed to bolts: the reference state is a second start.
        first = np.concatenate([fit.knowledge.z, np.zeros(len(nuisances))])
        begun = [onwards(z, 2) for z in (first, np.zeros(first.size))]
        evaluations = fit.evaluations + sum(found.evaluations for found in begun)
        found = min(begun, key=lambda end: end.evaluation.total)
        for _ in range(rounds):
            found = onwards(found.theta, steps)
            evaluations += found.evaluations
            now = noise_of(misfit, found.evaluation, self.selected)
            settled = abs(now.variance - noise.variance) < change * max(noise.variance, least)
            if not self.method.follows_noise or settled:
                break
            base, variance = weighed(misfit, found.evaluation, now, level.theta(found.theta), self.error)
            noise = now.at(float(np.sqrt(variance / now.at(1.0).variance)))
            misfit = extended_misfit(fit.misfit.weighted_as(base).with_eta(max(noise.variance, least)), model, nuisances, noise.variance)
            level = Level(misfit, misfit.prior, T)
        best = no_worse(level, found, (first, np.zeros(first.size)), lambda z: onwards(z, steps))
        evaluations += best.evaluations - found.evaluations
        found = replace(best, theta=level.theta(best.theta))
        noise = noise_of(misfit, found.evaluation, self.selected)
        knowledge = posterior(misfit, found, self.shapes, nuisances, noise, self.prior)
        history = fit.solution.history
        solution = replace(
            found,
            theta=found.theta[: self.parameters.size],
            starts=fit.solution.starts,
            history=history,
            iterations=fit.solution.iterations + found.iterations,
            evaluations=fit.solution.evaluations + evaluations - fit.evaluations,
        )
        # Nuisance parameters are taken out of the measurement at their estimates, so that later steps can use the interface FRFs.
        own = solution.theta
        measured = fit.measured * (self.model.frf(own) / model.frf(found.theta))
        plain = self.cost(measured, fit.relative).with_eta(misfit.eta if fit.plain.eta else 0.0).weighted_as(misfit)
        return replace(fit, measured=measured, plain=plain, misfit=misfit, solution=solution, knowledge=knowledge, evaluations=evaluations)

    def best(self) -> Fit:
        """Final fit: relative to the reference job if its lines are the same, with gains if accepted, then with nuisance parameters."""
        corrected = self.corrected() if self.method.relative and self.error is not None else None
        known = (self.measured(), False) if corrected is None else (corrected, True)
        self.compared, found = known, self.fit(*known)
        if self._may_have_gains(found):
            groups = sharers(self.inputs, self._elsewhere(found)) if self.against_reference else iter((None,))
            for self.sharers in groups:
                found = self._gained(found, *known)
                if self.gains is not None:
                    break
        return self.drifted(found)

    def _gained(self, found: Fit, measured: Complexes, relative: bool) -> Fit:
        """The fit with the gain that ``sharers`` share, if it is accepted, otherwise the given one."""
        off, more = self._off(found)
        if off:
            self.gains = columns_of(self.inputs, self.sharers)
            again = self.fit(measured, relative)
            better = kept(self.inputs, self.gains_of(again), (found.left_db, again.left_db), self._elsewhere(again))
            more += (found if better else again).evaluations
            found, self.gains = (again, self.gains) if better else (found, None)
        return found.after(more)

    def _may_have_gains(self, found: Fit) -> bool:
        """Whether gains are looked for: relative to the reference job, or of the reference job relative to the model."""
        update = self.inputs.campaign.update
        if self.against_reference:
            return self.error is not None and self.method.nuisances.gain is None
        return self.method.approach != "paper" and self.name == update.reference and not none_shown(self.inputs, self._elsewhere(found))

    def gains_of(self, fit: Fit) -> Gains | None:
        """Gains at the end of a fit; None if its cost has none."""
        solution, knowledge = fit.solution, fit.knowledge
        rows = solution.evaluation.jacobian[: fit.plain.valid.sum() * (2 if self.method.residual.phase else 1)]
        of = rows, knowledge.covariance, knowledge.noise.variance
        return gains_of(self.inputs, fit.plain, solution.theta, *of, shared=self.sharers)

    def _off(self, fit: Fit) -> tuple[bool, int]:
        """Whether any gain is significant when identified from the end of a fit without gains, and evaluations.

        Changes at bolts partly compensate for a gain, so there is a second descent from the reference state or the start values.
        """
        misfit = fit.misfit.with_gains(columns_of(self.inputs, self.sharers))
        ends = [self.descend(misfit, theta) for theta in (fit.solution.theta, self.prior)]
        best = min(ends, key=lambda end: end.evaluation.total)
        knowledge = posterior(misfit, best, self.shapes, (), noise_of(misfit, best.evaluation, self.selected), self.prior)
        gains = self.gains_of(replace(fit, plain=misfit, solution=best, knowledge=knowledge))
        seen = gains is not None and bool(gains.seen(self.statistics.errors).any())
        return seen, sum(end.evaluations for end in ends)

    def _elsewhere(self, fit: Fit) -> Floats:
        """(m, U) measured levels above those that a fit expects, on lines that are not compared, the effect of damping removed [dB].

        Relative to the reference job if there is one. Far from resonances damping matters little, but in a heavily damped structure it
        affects all lines. Without other lines the compared ones are used; no rows if the lines of the reference job differ.
        """
        rest, used = np.setdiff1d(np.arange(self.s.size), self.near), self.inputs.used
        rest = rest if rest.size else self.selected
        tight = self.of_reference() if self.against_reference else None
        if self.against_reference and (tight is None or unlike(self.measurement.frequency_hz, tight.frequency_hz)):
            return np.zeros((0, used.size))
        step, theta = SLOPE_STEP * float(self.measurement.frequency_hz[-1]), fit.solution.theta
        model = self.source.model(self.s, self.parameters, rest, used)
        nearby = self.source.model(self.s + 2j * np.pi * step, self.parameters, rest, used).frf(theta)
        with np.errstate(divide="ignore", invalid="ignore"):
            here = model.frf(theta)
            above = decibel(self._used(self.name, self.measurement, rest) / here)
            if tight is not None:
                above = above - decibel(self._used(str(self.inputs.campaign.update.reference), tight, rest) / model.frf(self.prior))
            slope = (nearby / here - 1.0) / step
        return beside_damping(above, damping_pattern(self.measurement.frequency_hz[rest], slope))

    def about_reference(self, fit: Fit) -> Fit:
        """The same fit with the uncertainty of the reference state added to its posterior."""
        if not self.against_reference:
            return fit
        state, knowledge = stored_covariance(self.parameters, self.reference), fit.knowledge
        if fit.relative:
            # Its error cancels between model and corrected measurement; the noise of its measurement is in the residuals.
            return replace(fit, knowledge=knowledge.about_estimate(state))
        value = fit.misfit(np.concatenate([fit.solution.theta, knowledge.values]))
        rows = fit.misfit.data_rows(value)
        jacobian = fit.solution.evaluation.jacobian[:rows]
        return replace(fit, knowledge=knowledge.about_estimate(state, jacobian, value.jacobian[:rows, : self.parameters.size])).after(1)

    def frf(self, theta: Floats, knowledge: Posterior | None = None) -> Complexes:
        """(F, R) FRFs of the model on all measured lines, with the nuisance parameters of ``knowledge``, without common gain."""
        if knowledge is None or self.source.stage is None or not knowledge.nuisances:
            return self.source.model(self.s, self.parameters).frf(theta)
        return self.source.drifting(self.s, self.parameters, knowledge.nuisances).frf(np.concatenate([theta, knowledge.values]))
