"""Equilibrium of a pad under a sphere that moves in steps, by Newton's method."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import splu

from gelgap.benchmarks.fem.contact import SphereContact, Touch
from gelgap.benchmarks.fem.pad import Pad

Floats = NDArray[np.float64]

MAX_ITERATIONS = 26
NEWTON_SHARES = (1.0, 0.5, 0.25, 0.125)
SMALLEST_STEP = 1 / 256  # of a step of the sphere; one in which Newton's method fails is halved until then


@dataclass(frozen=True)
class Iterate:
    """Displacements of the sphere (d,) and of all dofs, with stiffness, contact and out-of-balance forces."""

    sphere_mm: Floats
    u: Floats
    stiffness: sparse.csc_matrix
    touch: Touch
    residual: Floats

    @property
    def fnorm(self) -> float:
        return float(np.linalg.norm(self.residual))


@dataclass(frozen=True)
class Indentation:
    """A pad, the sphere that touches it, and the settings of Newton's method.

    It has converged when the norm of the out-of-balance forces is below `tolerance_n`; a step that raises that norm
    more than `largest_rise` times is shortened.
    """

    pad: Pad
    contact: SphereContact
    tolerance_n: float
    largest_rise: float

    def untouched(self) -> Iterate:
        """Return the state before contact."""
        pad = self.pad
        return self._at(np.zeros(pad.size), np.zeros(pad.dimensions), np.full(pad.surface_dofs.shape, np.nan))

    def advance(self, state: Iterate, sphere_mm: Floats) -> Iterate:
        """Move the sphere to `sphere_mm`, in shorter steps where Newton's method fails.

        Raises
        ------
        RuntimeError
            If it fails at the smallest step.
        """
        start, done, step = state.sphere_mm, 0.0, 1.0
        while done < 1.0:
            share = min(done + step, 1.0)
            try:
                state = self._equilibrium(state, start + share * (sphere_mm - start))
            except FloatingPointError as failure:
                step /= 2
                if step < SMALLEST_STEP:
                    raise RuntimeError(
                        f"no equilibrium with the sphere near {sphere_mm} mm: {failure}"
                    ) from None
            else:
                done = share
        return state

    def _equilibrium(self, state: Iterate, sphere_mm: Floats) -> Iterate:
        """Return the equilibrium with the sphere at `sphere_mm`; raise FloatingPointError if none is found."""
        pad = self.pad
        # First step: to the contact, a moving sphere is the same as its nodes moving the other way.
        stick_mm = state.touch.stick_mm
        start = self._at(state.u, state.sphere_mm, stick_mm)
        load = np.zeros(pad.size)
        load[pad.surface_dofs] = start.touch.tangent @ (sphere_mm - state.sphere_mm)
        dx = self._solve(start, load[pad.free] - start.residual)
        iterate = self._step(state.u, dx, sphere_mm, stick_mm, np.inf)
        for _ in range(MAX_ITERATIONS):
            if iterate.fnorm < self.tolerance_n:
                return iterate
            dx = self._solve(iterate, -iterate.residual)
            iterate = self._step(iterate.u, dx, sphere_mm, stick_mm, self.largest_rise * iterate.fnorm)
        raise FloatingPointError("Newton's method does not settle")

    def _at(self, u: Floats, sphere_mm: Floats, stick_mm: Floats) -> Iterate:
        pad = self.pad
        force, stiffness = pad.assemble(u)
        position = pad.nodes[pad.surface] + u[pad.surface_dofs]
        touch = self.contact.touch(position, pad.surface_area_mm2, sphere_mm, stick_mm)
        force[pad.surface_dofs] -= touch.force_n
        return Iterate(sphere_mm, u, stiffness, touch, force[pad.free])

    def _solve(self, iterate: Iterate, right_side: Floats) -> Floats:
        """Return the change of all dofs under forces on the free ones; fixed dofs stay where they are."""
        pad = self.pad
        tangent = iterate.stiffness + pad.matrix(pad.surface_dofs, iterate.touch.tangent)
        # Friction makes the tangent unsymmetric, but not its pattern.
        factors = splu(
            tangent[pad.free][:, pad.free].tocsc(),
            permc_spec="MMD_AT_PLUS_A",
            diag_pivot_thresh=0.01,
            options={"SymmetricMode": True},
        )
        dx = np.zeros(pad.size)
        dx[pad.free] = factors.solve(right_side)
        return dx

    def _step(
        self, u: Floats, dx: Floats, sphere_mm: Floats, stick_mm: Floats, largest_fnorm: float
    ) -> Iterate:
        """Take the longest share of `dx` with a small enough residual, or the one with the smallest."""
        best = None
        for share in NEWTON_SHARES:
            try:
                iterate = self._at(u + share * dx, sphere_mm, stick_mm)
            except FloatingPointError:
                continue
            if best is None or iterate.fnorm < best.fnorm:
                best = iterate
            if best.fnorm < largest_fnorm:
                return best
        if best is None:
            raise FloatingPointError("no share of the Newton step keeps the elements' volume")
        return best
