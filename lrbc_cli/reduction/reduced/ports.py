"""Port FRFs: H(s) between loads, responses and terms, which depends on no parameter, and y for any values of the terms, eqs. (14)-(18).

This is the core of the method: an evaluation of all FRFs needs solves only as large as the number of terms. See ``lrbc guide method``,
where they are called interface FRFs.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from lrbc_cli.arrays import Complexes, Floats, Integers
from lrbc_cli.model.terms import Slopes
from lrbc_cli.reduction.threads import by_lines

#: Hpp counts as symmetric if its asymmetry is at most this fraction of its largest entry.
SYMMETRY = 1e-9

#: Remaining flexibility of a clamped term, relative to that of its port; with zero, linearly dependent clamped terms would be singular.
CLAMPED = 1e-14

#: An unconstrained motion counts as excited if the loads move it by more than this fraction of its own port: far above rounding errors,
#: far below a response.
DRIVEN = 1e-9

#: Rows of H0p are those of one sensor if they differ by at most this fraction of their largest entry at each line: rounding errors.
SAME_ROW = 1e-12

#: A pivot of at most this many rounding errors (complex product and sum) has no correct digits.
LOST = 4.0


@dataclass(frozen=True, kw_only=True)
class PortFrf:
    """``H(s) = L_ext Z_ref(s)⁻¹ B_ext`` at F lines, with the terms at reference values D_ref.

    Attributes
    ----------
    s : (F,) complex array
        i omega.
    H00 : (F, R) complex array
        Responses over their own input, in the quantity of each response.
    H0p : (F, R, nt) complex array
        Responses over the term inputs.
    Hp0 : (F, nt, n_in) complex array
        Term outputs cᵀ x over the inputs.
    Hpp : (F, nt, nt) complex array
        Term outputs over the term inputs.
    D_ref : (F, nt) complex array
        Dynamic values that the terms have in H.
    input_of : (R,) int array
        Which input each response belongs to.
    heard : (O,) int array
        Responses whose rows of H0p differ, one of each sensor.
    output_of : (R,) int array
        Which entry of ``heard`` has the row of each response.
    symmetric : bool
        Hpp is symmetric (it is then made exactly so).
    """

    s: Complexes
    H00: Complexes
    H0p: Complexes
    Hp0: Complexes
    Hpp: Complexes
    D_ref: Complexes
    input_of: Integers
    heard: Integers
    output_of: Integers
    symmetric: bool

    @property
    def lines(self) -> int:
        """Number of lines F."""
        return int(self.s.size)

    @property
    def frequency_hz(self) -> Floats:
        """(F,) lines in Hz."""
        return np.asarray(self.s.imag / (2 * np.pi))

    def select(self, lines: Integers, responses: Integers) -> PortFrf:
        """The port FRFs of some of the lines and responses (index arrays)."""
        _, heard, output_of = np.unique(self.output_of[responses], return_index=True, return_inverse=True)
        return PortFrf(
            s=self.s[lines],
            H00=self.H00[np.ix_(lines, responses)],
            H0p=self.H0p[np.ix_(lines, responses)],
            Hp0=self.Hp0[lines],
            Hpp=self.Hpp[lines],
            D_ref=self.D_ref[lines],
            input_of=self.input_of[responses],
            heard=heard,
            output_of=output_of,
            symmetric=self.symmetric,
        )

    def evaluate(self, D: Complexes) -> Complexes:
        """FRFs for the dynamic values D of the terms; a system is as large as the number of terms that differ from D_ref.

        ``y = H00 - H0p (I + Delta Hpp)⁻¹ Delta Hp0`` with ``Delta = diag(D - D_ref)``; regular from free (D = 0) to clamped (D infinite).

        Parameters
        ----------
        D : (..., F, nt) complex array
            D_j(s) of one state or of several; infinite entries clamp.

        Returns
        -------
        (..., F, R) complex array
        """
        if (terms := self._differing(D)).size < D.shape[-1]:
            return self.among(terms).evaluate(D[..., terms])
        states = D.shape[:-2]
        y = np.empty((*states, *self.H00.shape), dtype=complex)

        def work(part: slice) -> None:
            E, F = self._split(D[..., part, :], part)
            y[..., part, :] = self._respond(F, self._solved(self.Hpp[part], E, F, self.Hp0[part]), part)

        by_lines(self.lines, D.shape[-1], math.prod(states), work)
        return y

    def about(self, D: Complexes) -> PortFrf:
        """The port FRFs with other reference values, ``Hpp' = (I + Hpp Delta)⁻¹ Hpp`` and so on.

        Evaluations at states that differ in few terms from there are cheap. Here, too, a system is as large as the number of terms that
        differ (Sherman, Morrison and Woodbury): from one state to the next at far less cost than from afar.

        Parameters
        ----------
        D : (F, nt) complex array, finite
        """
        terms = self._differing(D)
        rest, own, n_in = np.setdiff1d(np.arange(D.shape[1]), terms), self.among(terms), self.Hp0.shape[2]
        H00, H0p, Hp0, Hpp = (np.empty(old.shape, dtype=complex) for old in (self.H00, self.H0p, self.Hp0, self.Hpp))

        def work(part: slice) -> None:
            E, F = own._split(D[part][:, terms], part)
            both = np.concatenate([self.Hp0[part], self.Hpp[part]], axis=2)
            w = self._solved(own.Hpp[part], E, F, both[:, terms])
            both = _displacements(self.Hpp[part], both, (terms, rest), E, F, w)
            y = (own.H0p[part] * F[:, None, :]) @ w
            H00[part] = self.H00[part] - y[:, np.arange(self.input_of.size), self.input_of]
            H0p[part], Hp0[part], Hpp[part] = self.H0p[part] - y[:, :, n_in:], both[:, :, :n_in], both[:, :, n_in:]

        by_lines(self.lines, D.shape[1], 1, work)
        return replace(self, H00=H00, H0p=H0p, Hp0=Hp0, Hpp=Hpp, D_ref=D)

    def _differing(self, D: Complexes) -> Integers:
        """Terms whose values (..., F, nt) are not those of reference at all lines and states."""
        return np.flatnonzero((self.D_ref != D).any(axis=tuple(range(D.ndim - 1))))

    def among(self, terms: Integers) -> PortFrf:
        """The port FRFs of some of the terms, the others fixed at their reference values; evaluations cost only that many terms."""
        return replace(
            self, H0p=self.H0p[:, :, terms], Hp0=self.Hp0[:, terms], Hpp=self.Hpp[:, terms[:, None], terms], D_ref=self.D_ref[:, terms]
        )

    def drive(self, D: Complexes) -> tuple[Complexes, Complexes]:
        """FRFs, and the auxiliary inputs ``u = -Delta cᵀ x``, eqs. (6)-(8), of the terms under unit inputs.

        Returns
        -------
        y : (F, R) complex array
        u : (F, nt, n_in) complex array
        """
        E, F = self._split(D)
        w = self._solved(self.Hpp, E, F, self.Hp0)
        return self._respond(F, w), -F[:, :, None] * w

    def motions(self, D: Complexes, heard: Complexes) -> tuple[Complexes, Complexes, Complexes, Complexes, Complexes]:
        """FRFs, and the auxiliary inputs and displacements of the terms for unit inputs and for the dual problems of some responses.

        Parameters
        ----------
        D : (F, nt) complex array
        heard : (F, nt, k) complex array
            Rows of H0p for k responses, as columns.

        Returns
        -------
        y : (F, R) complex array
        u : (F, nt, n_in) complex array
            Auxiliary inputs as in ``drive``.
        v : (F, nt, k) complex array
            Auxiliary inputs of the dual problems, ``-Delta (I + Hppᵀ Delta)⁻¹ heard``.
        after : (F, nt, n_in) complex array
            Displacements ``cᵀ x = (I + Hpp Delta)⁻¹ Hp0``.
        before : (F, nt, k) complex array
            The same for the dual problems, bᵀ times the dual solution.
        """
        E, F = self._split(D)
        w, v = self._solved_both(self.Hpp, E, F, self.Hp0, heard)
        return self._respond(F, w), -F[:, :, None] * w, -F[:, :, None] * v, E[:, :, None] * w, E[:, :, None] * v

    def linearise(self, D: Complexes, slopes: Slopes | None = None) -> tuple[Complexes, Complexes]:
        """FRFs and their derivatives with respect to every D_j, or with ``slopes`` to every parameter.

        ``dy/dD_j = -[H0p (I + Delta Hpp)⁻¹]_j [(I + Hpp Delta)⁻¹ Hp0]_j``; for a symmetric Hpp both factors need one factorisation, as
        large as the number of terms that differ from D_ref. Responses of one sensor to several inputs share the first factor.

        Parameters
        ----------
        D : (F, nt) complex array, finite
        slopes : Slopes or None

        Returns
        -------
        y : (F, R) complex array
        dy : (F, R, nt) or (F, R, size) complex array
        """
        y = np.empty(self.H00.shape, dtype=complex)
        dy = np.empty((*y.shape, self.H0p.shape[2] if slopes is None else slopes.size), dtype=complex)
        terms = self._differing(D)
        rest = np.setdiff1d(np.arange(D.shape[1]), terms)
        own = self.among(terms) if rest.size else self

        def work(part: slice) -> None:
            Hpp, Hp0, right = self.Hpp[part], self.Hp0[part], self.H0p[part, self.heard].transpose(0, 2, 1)
            E, F = own._split(D[part][:, terms], part)
            w, v = own._solved_both(own.Hpp[part], E, F, Hp0[:, terms], right[:, terms])
            y[part] = own._respond(F, w, part)
            after = -_displacements(Hpp, Hp0, (terms, rest), E, F, w)
            before = _displacements(Hpp.transpose(0, 2, 1), right, (terms, rest), E, F, v)
            # Contiguous in the terms before responses are repeated.
            before, after = (np.ascontiguousarray(each.transpose(0, 2, 1)) for each in (before, after))
            product = before[:, self.output_of]
            product *= after[:, self.input_of]
            dy[part] = product if slopes is None else slopes.of(product, part)

        by_lines(self.lines, terms.size, 1, work)
        return y, dy

    def _split(self, D: Complexes, part: slice = slice(None)) -> tuple[Floats, Complexes]:
        """E = 1/(1 + h |Delta|) and F = Delta E with h = |diag Hpp|, so that Delta = F/E; both are finite for an infinite Delta."""
        h = np.abs(np.diagonal(self.Hpp[part], axis1=1, axis2=2))
        clamped = np.isinf(D)
        delta = np.where(clamped, 0.0, D) - self.D_ref[part]
        E = 1.0 / (1.0 + h * np.abs(delta))
        F = delta * E
        if clamped.any():
            E = np.where(clamped, CLAMPED, E)
            F = np.where(clamped, 1.0 / np.where(h > 0, h, 1.0), F)
        return E, F

    def _solved_both(self, Hpp: Complexes, E: Floats, F: Complexes, B: Complexes, L: Complexes) -> tuple[Complexes, Complexes]:
        """``(E + Hpp F)⁻¹ B`` and ``(E + Hppᵀ F)⁻¹ L``, by one factorisation if Hpp is symmetric."""
        if self.symmetric:
            both = self._solved(Hpp, E, F, np.concatenate([B, L], axis=2))
            return both[:, :, : B.shape[2]], both[:, :, B.shape[2] :]
        return self._solved(Hpp, E, F, B), self._solved(Hpp.transpose(0, 2, 1), E, F, L)

    @staticmethod
    def _solved(Hpp: Complexes, E: Floats, F: Complexes, B: Complexes) -> Complexes:
        """``(E + Hpp F)⁻¹ B``; raises LinAlgError if an unconstrained motion is excited."""
        A = Hpp * F[..., None, :]
        diagonal = np.einsum("...ii->...i", A)
        diagonal += E
        # If the only term that constrains a motion is free, a pivot of E + Hpp F is zero up to rounding. If nothing excites the motion, any
        # non-zero pivot gives the correct response (here one within the rounding of E). If it is excited, there is no solution.
        least = np.finfo(float).eps * E
        lost = np.abs(diagonal) <= LOST * least
        within = np.where(lost, least, 0.0)
        np.copyto(diagonal, least, where=lost)
        B = np.broadcast_to(B, (*A.shape[:-1], B.shape[-1]))
        try:
            found = np.linalg.solve(A, B)
        except np.linalg.LinAlgError:
            # The same for a motion that several terms constrain together.
            diagonal += least
            within += least
            found = np.linalg.solve(A, B)
        size = np.abs(np.einsum("...ii->...i", Hpp))
        if within.any() and np.any(np.abs(within[..., None] * found).max(axis=-1) > DRIVEN * size):
            raise np.linalg.LinAlgError("an unconstrained motion is excited")
        return np.asarray(found)

    def _respond(self, F: Complexes, w: Complexes, part: slice = slice(None)) -> Complexes:
        """(..., F, R) FRFs from the solution ``w = (E + Hpp F)⁻¹ Hp0``."""
        y = (self.H0p[part, self.heard] * F[..., None, :]) @ w
        return np.asarray(self.H00[part] - y[..., self.output_of, self.input_of])


def _displacements(H: Complexes, B: Complexes, split: tuple[Integers, Integers], E: Floats, F: Complexes, w: Complexes) -> Complexes:
    """(F, nt, k) displacements of all terms. Only the first ones of ``split`` have auxiliary inputs: ``w = (E + H F)⁻¹ B`` is of these."""
    terms, rest = split
    own = E[:, :, None] * w
    if not rest.size:
        return own
    found = np.empty(B.shape, dtype=complex)
    found[:, terms] = own
    found[:, rest] = B[:, rest] - (H[:, rest[:, None], terms] * F[:, None, :]) @ w
    return found


def _sensors(H0p: Complexes) -> tuple[Integers, Integers]:
    """``heard`` and ``output_of`` of ``PortFrf``: rows of H0p (F, R, nt) that are the same but for rounding errors belong to one sensor."""
    magnitude = np.abs(H0p)
    allowed, sums = SAME_ROW * magnitude.max(axis=2, initial=0.0), magnitude.sum(axis=(0, 2))
    # Sums of the same rows differ by no more than this, which leaves few to compare.
    reach = H0p.shape[2] * allowed.sum(axis=0)
    heard, output_of = list[int](), list[int]()
    for i in range(H0p.shape[1]):
        near = np.flatnonzero(np.abs(sums[heard] - sums[i]) <= reach[heard]).tolist() if heard else []
        same = (k for k in near if bool((np.abs(H0p[:, i] - H0p[:, heard[k]]).max(axis=1, initial=0.0) <= allowed[:, heard[k]]).all()))
        output_of.append(next(same, len(heard)))
        if output_of[-1] == len(heard):
            heard.append(i)
    return np.array(heard, dtype=np.int64), np.array(output_of, dtype=np.int64)


def port_frf(H: Complexes, s: Complexes, D_ref: Complexes, output_power: Integers, input_of: Integers) -> PortFrf:
    """Port FRFs from the transfer matrix of the extended system.

    Parameters
    ----------
    H : (F, R + nt, n_in + nt) complex array
        L_ext Z_ref⁻¹ B_ext; responses are displacements or pressures.
    s : (F,) complex array
    D_ref : (F, nt) complex array
    output_power : (R,) int array
        Power of s that turns the displacement of a response into its quantity.
    input_of : (R,) int array
        Which input each response belongs to.

    Returns
    -------
    PortFrf
    """
    R, nt = output_power.size, D_ref.shape[1]
    n_in = H.shape[2] - nt
    to_quantity = s[:, None] ** output_power[None, :]
    rows = np.arange(R)
    H00 = H[:, :R, :n_in][:, rows, input_of] * to_quantity
    H0p = H[:, :R, n_in:] * to_quantity[:, :, None]
    Hpp = H[:, R:, n_in:]
    scale = np.abs(Hpp).max() if Hpp.size else 0.0
    symmetric = bool(np.abs(Hpp - Hpp.transpose(0, 2, 1)).max() <= SYMMETRY * scale) if Hpp.size else True
    if symmetric:
        Hpp = 0.5 * (Hpp + Hpp.transpose(0, 2, 1))
    heard, output_of = _sensors(H0p)
    return PortFrf(
        s=s,
        H00=H00,
        H0p=H0p,
        Hp0=np.ascontiguousarray(H[:, R:, :n_in]),
        Hpp=np.ascontiguousarray(Hpp),
        D_ref=D_ref,
        input_of=input_of,
        heard=heard,
        output_of=output_of,
        symmetric=symmetric,
    )
