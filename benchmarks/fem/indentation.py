"""Equilibrium of a pad under a rigid sphere that moves in steps: contact, friction, and Newton's method.

Contact is a stiff penalty, collocated at the displaced nodes against the exact sphere, with Coulomb friction by return
mapping (Wriggers, Computational Contact Mechanics, 2006, ch. 5). Vectors have d components: (r, z) with symmetry about
an axis, (x, y, z) without.
"""

import contextlib
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import splu

from gelgap.benchmarks.fem.pad import Pad

Floats = NDArray[np.float64]

MAX_ITERATIONS = 26
NEWTON_SHARES = (1.0, 0.5, 0.25, 0.125)
SMALLEST_STEP = 1 / 256  # of a step of the sphere; one in which Newton's method fails is halved until then
# Where a step has ended in slip, the next one starts on Coulomb's cone: rounding must not decide that it sticks.
ON_THE_CONE = 1 - 1e-9


@dataclass(frozen=True)
class Touch:
    """Contact at one iterate, by surface node (k).

    `force_n` (k, d) is the sphere's force on a node and `tangent` (k, d, d) its negative derivative by the node's
    position, `pressure_mpa` (k,) and `shear_mpa` (k, d) are per undeformed area. `stick_mm` (k, d) is where a node
    will stick from then on, measured from the sphere's centre: where it is if it sticks, dragged along if it slips,
    NaN if it is free.
    """

    force_n: Floats
    tangent: Floats
    pressure_mpa: Floats
    shear_mpa: Floats
    slipping: NDArray[np.bool_]
    stick_mm: Floats


@dataclass(frozen=True)
class SphereContact:
    """A sphere that touches the surface at the origin where it is not displaced.

    Nodes enter the sphere by pressure / `penalty` and give way by shear / `stick_stiffness`, both in MPa/mm. `friction`
    is Coulomb's coefficient: 0 slips freely, `inf` never slips.
    """

    radius_mm: float
    friction: float
    penalty: float
    stick_stiffness: float

    def touch(self, position_mm: Floats, area_mm2: Floats, sphere_mm: Floats, stick_mm: Floats) -> Touch:
        """Return the contact of nodes at a position (k, d) with the sphere displaced by `sphere_mm` (d,)."""
        identity = np.eye(len(sphere_mm))
        from_centre = position_mm - sphere_mm - self.radius_mm * identity[-1]
        distance = np.linalg.norm(from_centre, axis=1)
        normal = from_centre / distance[:, None]
        across = identity - _outer(normal, normal)
        d_normal = across / distance[:, None, None]
        gap = distance - self.radius_mm
        active = gap < 0
        pressure = np.where(active, -self.penalty * gap, 0.0)
        d_pressure = np.where(active[:, None], -self.penalty * normal, 0.0)

        # The trial shear opposes the offset from the stick point along the sphere: −k (1 − n⊗n)·offset.
        held = active & ~np.isnan(stick_mm[:, 0]) & (self.friction > 0)
        offset = np.where(held[:, None], from_centre - np.nan_to_num(stick_mm), 0.0)
        inward = np.einsum("ni,ni->n", normal, offset)
        trial = -self.stick_stiffness * np.einsum("nij,nj->ni", across, offset)
        d_offset = across - inward[:, None, None] * d_normal
        d_offset -= _outer(normal, np.einsum("ni,nij->nj", offset, d_normal))
        d_trial = np.where(held[:, None, None], -self.stick_stiffness * d_offset, 0.0)

        # Return mapping: shear that Coulomb's cone does not allow is cut back to it.
        size = np.linalg.norm(trial, axis=1)
        limit = self.friction * pressure if np.isfinite(self.friction) else np.full_like(pressure, np.inf)
        slipping = held & (size > ON_THE_CONE * limit)
        kept = np.where(slipping, limit, 1.0) / np.where(slipping, size, 1.0)
        direction = trial / np.where(size > 0, size, 1.0)[:, None]
        shear = trial * kept[:, None]
        turning = kept[:, None, None] * ((identity - _outer(direction, direction)) @ d_trial)
        d_slip = (self.friction if slipping.any() else 0.0) * _outer(direction, d_pressure) + turning
        d_shear = np.where(slipping[:, None, None], d_slip, d_trial)

        d_traction = _outer(normal, d_pressure) + pressure[:, None, None] * d_normal + d_shear
        return Touch(
            force_n=area_mm2[:, None] * (pressure[:, None] * normal + shear),
            tangent=-area_mm2[:, None, None] * d_traction,
            pressure_mpa=pressure,
            shear_mpa=shear,
            slipping=slipping,
            stick_mm=np.where(active[:, None], from_centre + shear / self.stick_stiffness, np.nan),
        )


def _outer(a: Floats, b: Floats) -> Floats:
    return a[:, :, None] * b[:, None, :]


@dataclass(frozen=True)
class State:
    """Displacements of the sphere (d,) and of all dofs, with stiffness, contact and residual on the free dofs, N."""

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

    It has converged when the norm of the residual is below `tolerance_n`; a step that raises that norm more than
    `largest_rise` times is shortened.
    """

    pad: Pad
    contact: SphereContact
    tolerance_n: float
    largest_rise: float

    def untouched(self) -> State:
        """Return the state before contact."""
        pad = self.pad
        return self.fun(np.zeros(pad.size), np.zeros(pad.dimensions), np.full(pad.surface_dofs.shape, np.nan))

    def advance(self, state: State, sphere_mm: Floats) -> State:
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
                state = self.newtonrhapson(state, start + share * (sphere_mm - start))
            except FloatingPointError as failure:
                step /= 2
                if step < SMALLEST_STEP:
                    raise RuntimeError(
                        f"no equilibrium with the sphere near {sphere_mm} mm: {failure}"
                    ) from None
            else:
                done = share
        return state

    def newtonrhapson(self, state: State, sphere_mm: Floats) -> State:
        """Return the equilibrium with the sphere at `sphere_mm`; raise FloatingPointError if none is found."""
        pad, stick_mm = self.pad, state.touch.stick_mm
        # First step: to the contact, a moving sphere is the same as its nodes moving the other way.
        start = self.fun(state.u, state.sphere_mm, stick_mm)
        load = np.zeros(pad.size)
        load[pad.surface_dofs] = start.touch.tangent @ (sphere_mm - state.sphere_mm)
        state, du, largest_fnorm = start, self.solve(self.jac(start), load[pad.free] - start.residual), np.inf
        for _ in range(MAX_ITERATIONS):
            state = self._line_search(state.u, du, sphere_mm, stick_mm, largest_fnorm)
            if self.check(state):
                return state
            du = self.solve(self.jac(state), -state.residual)
            largest_fnorm = self.largest_rise * state.fnorm
        raise FloatingPointError("Newton's method does not settle")

    def fun(self, u: Floats, sphere_mm: Floats, stick_mm: Floats) -> State:
        """Return the residual of displacements, and what it is made of."""
        pad = self.pad
        force, stiffness = pad.assemble(u)
        position = pad.nodes[pad.surface] + u[pad.surface_dofs]
        touch = self.contact.touch(position, pad.surface_area_mm2, sphere_mm, stick_mm)
        force[pad.surface_dofs] -= touch.force_n
        return State(sphere_mm, u, stiffness, touch, force[pad.free])

    def jac(self, state: State) -> sparse.csc_matrix:
        """Return the derivative of the residual by the free dofs."""
        tangent = state.stiffness + self.pad.matrix(self.pad.surface_dofs, state.touch.tangent)
        return tangent[self.pad.free][:, self.pad.free].tocsc()

    def solve(self, jac: sparse.csc_matrix, right_side: Floats) -> Floats:
        """Return the change of all dofs under forces on the free ones; fixed dofs stay where they are."""
        # Friction makes the tangent unsymmetric, but not its pattern.
        options = {
            "permc_spec": "MMD_AT_PLUS_A",
            "diag_pivot_thresh": 0.01,
            "options": {"SymmetricMode": True},
        }
        du = np.zeros(self.pad.size)
        du[self.pad.free] = splu(jac, **options).solve(right_side)
        return du

    def check(self, state: State) -> bool:
        """Return whether Newton's method has converged."""
        return state.fnorm < self.tolerance_n

    def _line_search(
        self, u: Floats, du: Floats, sphere_mm: Floats, stick_mm: Floats, largest_fnorm: float
    ) -> State:
        """Take the longest share of `du` with a small enough residual, or the one with the smallest."""
        tried = []
        for share in NEWTON_SHARES:
            with contextlib.suppress(FloatingPointError):
                tried.append(self.fun(u + share * du, sphere_mm, stick_mm))
                if tried[-1].fnorm < largest_fnorm:
                    break
        if not tried:
            raise FloatingPointError("no share of the Newton step keeps the elements' volume")
        return min(tried, key=lambda state: state.fnorm)
