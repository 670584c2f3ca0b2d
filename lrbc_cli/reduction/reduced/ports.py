"""Port FRFs: the parameter-free H(s) of the extended system, and y for any parameter values (method of eqs. (14)-(18))."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from lrbc_cli.arrays import Complexes, Floats, Integers
from lrbc_cli.reduction.threads import by_lines

#: Hpp counts as symmetric where its asymmetry is below this fraction of its norm.
SYMMETRY = 1e-9

#: Flexibility that is left where a term clamps, relative to its port: none would make terms that depend on each other singular.
CLAMPED = 1e-14

#: A motion that nothing holds counts as driven where loads move it by more than this fraction of what its own port does: far above
#: rounding, far below a signal.
DRIVEN = 1e-9

#: Roundings of a complex product and a sum: a pivot that is no more has lost all its digits.
LOST = 4.0


@dataclass(frozen=True, kw_only=True)
class PortFrf:
    """H(s) = L_ext Z_ref(s)⁻¹ B_ext at the lines of an update, taken about reference values D_ref of the terms.

    Attributes
    ----------
    s : (F,) complex array
        i omega.
    H00 : (F, R) complex array
        Responses over their own input, at the reference.
    H0p : (F, R, nt) complex array
        Responses over the term inputs.
    Hp0 : (F, nt, n_in) complex array
        Term outputs over the inputs.
    Hpp : (F, nt, nt) complex array
        Term outputs over the term inputs.
    D_ref : (F, nt) complex array
        What the terms already have in the base system.
    input_of : (R,) int array
        Which input each response belongs to.
    symmetric : bool
        Hpp equals its transpose (made exactly so).
    """

    s: Complexes
    H00: Complexes
    H0p: Complexes
    Hp0: Complexes
    Hpp: Complexes
    D_ref: Complexes
    input_of: Integers
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
        """The same for some lines and responses."""
        return PortFrf(
            s=self.s[lines],
            H00=self.H00[np.ix_(lines, responses)],
            H0p=self.H0p[np.ix_(lines, responses)],
            Hp0=self.Hp0[lines],
            Hpp=self.Hpp[lines],
            D_ref=self.D_ref[lines],
            input_of=self.input_of[responses],
            symmetric=self.symmetric,
        )

    def evaluate(self, D: Complexes) -> Complexes:
        """FRFs for the dynamic values D of the terms.

        ``y = H00 - H0p (I + Delta Hpp)⁻¹ Delta Hp0`` with ``Delta = D - D_ref``: regular from free (D = 0) to clamped (D infinite).

        Parameters
        ----------
        D : (..., F, nt) complex array
            D_j(s), of one state or of several; infinite entries clamp.

        Returns
        -------
        (..., F, R) complex array
        """
        states = D.shape[:-2]
        y = np.empty((*states, *self.H00.shape), dtype=complex)

        def work(part: slice) -> None:
            E, F = self._split(D[..., part, :], part)
            y[..., part, :] = self._respond(F, self._solved(self.Hpp[part], E, F, self.Hp0[part]), part)

        by_lines(self.lines, D.shape[-1], math.prod(states), work)
        return y

    def about(self, D: Complexes) -> PortFrf:
        """The same with other reference values of the terms: what changes from there may be few terms, see ``among``.

        ``Hpp' = (I + Hpp Delta)⁻¹ Hpp``, and likewise for the inputs and the responses.

        Parameters
        ----------
        D : (F, nt) complex array, finite
        """
        E, F = self._split(D)
        w = self._solved(self.Hpp, E, F, np.concatenate([self.Hp0, self.Hpp], axis=2))
        n_in, moved = self.Hp0.shape[2], E[:, :, None] * w
        y = (self.H0p * F[:, None, :]) @ w
        H00 = self.H00 - y[:, np.arange(self.input_of.size), self.input_of]
        return replace(self, H00=H00, H0p=self.H0p - y[:, :, n_in:], Hp0=moved[:, :, :n_in], Hpp=moved[:, :, n_in:], D_ref=D)

    def among(self, terms: Integers) -> PortFrf:
        """The same for some of the terms, the others staying at their reference values: the cost is that of so many terms."""
        return replace(
            self,
            H0p=self.H0p[:, :, terms],
            Hp0=self.Hp0[:, terms],
            Hpp=self.Hpp[:, terms[:, None], terms],
            D_ref=self.D_ref[:, terms],
        )

    def drive(self, D: Complexes) -> tuple[Complexes, Complexes]:
        """FRFs, and the auxiliary inputs ``u = -Delta c^T x`` (6)-(8) that unit inputs cause through the terms.

        Returns
        -------
        y : (F, R) complex array
        u : (F, nt, n_in) complex array
        """
        E, F = self._split(D)
        w = self._solved(self.Hpp, E, F, self.Hp0)
        return self._respond(F, w), -F[:, :, None] * w

    def motions(self, D: Complexes, heard: Complexes) -> tuple[Complexes, Complexes, Complexes, Complexes, Complexes]:
        """FRFs, and what the terms do and feel in the problems of the inputs and in the dual ones of some responses.

        Parameters
        ----------
        D : (F, nt) complex array
        heard : (F, nt, k) complex array
            Rows of H0p, as columns.

        Returns
        -------
        y : (F, R) complex array
        u : (F, nt, n_in) complex array
            As of ``drive``.
        v : (F, nt, k) complex array
            What the terms add to the dual problems, ``-Delta (I + Hppᵀ Delta)⁻¹ heard``.
        after : (F, nt, n_in) complex array
            ``c^T x = (I + Hpp Delta)⁻¹ Hp0``.
        before : (F, nt, k) complex array
            The same of the dual problems.
        """
        E, F = self._split(D)
        w, v = self._solved_both(self.Hpp, E, F, self.Hp0, heard)
        return self._respond(F, w), -F[:, :, None] * w, -F[:, :, None] * v, E[:, :, None] * w, E[:, :, None] * v

    def linearise(self, D: Complexes) -> tuple[Complexes, Complexes]:
        """FRFs and their derivatives to every D_j, in one pass.

        ``dy/dD_j = -[H0p (I + Delta Hpp)⁻¹]_j [(I + Hpp Delta)⁻¹ Hp0]_j``; where Hpp is symmetric both factors come from one factorisation.

        Parameters
        ----------
        D : (F, nt) complex array, finite

        Returns
        -------
        y : (F, R) complex array
        dy : (F, R, nt) complex array
        """
        y, dy = np.empty(self.H00.shape, dtype=complex), np.empty(self.H0p.shape, dtype=complex)

        def work(part: slice) -> None:
            E, F = self._split(D[part], part)
            Hpp, Hp0, right = self.Hpp[part], self.Hp0[part], self.H0p[part].transpose(0, 2, 1)
            w, v = self._solved_both(Hpp, E, F, Hp0, right)
            y[part] = self._respond(F, w, part)
            w = w * -(E**2)[:, :, None]
            np.multiply(v.transpose(0, 2, 1), w[:, :, self.input_of].transpose(0, 2, 1), out=dy[part])

        by_lines(self.lines, D.shape[1], 1, work)
        return y, dy

    def _split(self, D: Complexes, part: slice = slice(None)) -> tuple[Floats, Complexes]:
        """E = 1/(1 + h|Delta|) and F = Delta E, with h the size of Hpp: finite even where Delta is infinite."""
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
        """``(E + Hpp F)⁻¹ B`` and ``(E + Hppᵀ F)⁻¹ L``, by one factorisation where both are the same."""
        if self.symmetric:
            both = self._solved(Hpp, E, F, np.concatenate([B, L], axis=2))
            return both[:, :, : B.shape[2]], both[:, :, B.shape[2] :]
        return self._solved(Hpp, E, F, B), self._solved(Hpp.transpose(0, 2, 1), E, F, L)

    @staticmethod
    def _solved(Hpp: Complexes, E: Floats, F: Complexes, B: Complexes) -> Complexes:
        """``(E + Hpp F)⁻¹ B``."""
        A = Hpp * F[..., None, :]
        diagonal = np.einsum("...ii->...i", A)
        diagonal += E
        # A term that alone holds a motion, set free: E + Hpp F is zero or its rounding, by chance. Where nothing drives the motion, any
        # number but zero gives the rest; this one is within the rounding of E. A motion that is driven has no answer.
        least = np.finfo(float).eps * E
        lost = np.abs(diagonal) <= LOST * least
        within = np.where(lost, least, 0.0)
        np.copyto(diagonal, least, where=lost)
        B = np.broadcast_to(B, (*A.shape[:-1], B.shape[-1]))
        try:
            found = np.linalg.solve(A, B)
        except np.linalg.LinAlgError:
            # The same of several terms together.
            diagonal += least
            within += least
            found = np.linalg.solve(A, B)
        size = np.abs(np.einsum("...ii->...i", Hpp))
        if within.any() and np.any(np.abs(within[..., None] * found).max(axis=-1) > DRIVEN * size):
            raise np.linalg.LinAlgError("a motion that nothing holds is driven")
        return np.asarray(found)

    def _respond(self, F: Complexes, w: Complexes, part: slice = slice(None)) -> Complexes:
        y = (self.H0p[part] * F[..., None, :]) @ w
        rows = np.arange(self.input_of.size)
        return np.asarray(self.H00[part] - y[..., rows, self.input_of])


def port_frf(
    H: Complexes,
    s: Complexes,
    D_ref: Complexes,
    output_power: Integers,
    input_of: Integers,
) -> PortFrf:
    """Arrange the raw transfer matrix of the extended system.

    Parameters
    ----------
    H : (F, R + nt, n_in + nt) complex array
        L_ext Z_ref⁻¹ B_ext.
    s : (F,) complex array
    D_ref : (F, nt) complex array
    output_power : (R,) int array
        Power of s that turns the displacement of a response into its quantity.
    input_of : (R,) int array

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
    return PortFrf(
        s=s,
        H00=H00,
        H0p=H0p,
        Hp0=np.ascontiguousarray(H[:, R:, :n_in]),
        Hpp=np.ascontiguousarray(Hpp),
        D_ref=D_ref,
        input_of=input_of,
        symmetric=symmetric,
    )
