"""Equilibrium of a round pad under a rigid sphere that moves in steps: finite elements, contact, and Newton's method.

All is symmetric about an axis, and vectors are (r, z). Elements of finite strain do not lock, since they project the
volume ratio on a few functions each (the mean-dilatation method: Simo, Taylor & Pister 1985, Comput. Methods Appl.
Mech. Eng. 51:177). A deformation gradient F is an array (…, 5) of its components rr, rz, zr, zz and φφ. The volume
ratio J comes with its derivatives `dj` (…, 5) and `ddj` (…, 5, 5) by the same components.

Contact is a stiff penalty, collocated at the displaced nodes against the exact sphere, with Coulomb friction by return
mapping (Wriggers, Computational Contact Mechanics, 2006, ch. 5). Units are mm, N and MPa.
"""

import contextlib
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import splu

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

MAX_ITERATIONS = 26
NEWTON_SHARES = (1.0, 0.5, 0.25, 0.125)
SMALLEST_STEP = 1 / 256  # of a step of the sphere; one in which Newton's method fails is halved until then
# Where a step has ended in slip, the next one starts on Coulomb's cone: rounding must not decide that it sticks.
ON_THE_CONE = 1 - 1e-9

AXISYMMETRIC = [0, 1, 3, 4, 8]
"""The components of a 3×3 matrix, row by row, that are not 0."""
IDENTITY = np.eye(3).ravel()[AXISYMMETRIC]
_i, _j, _k = np.indices((3, 3, 3))
LEVI_CIVITA = (_i - _j) * (_j - _k) * (_k - _i) / 2
# Its product with F is d²J/dF² = ε_ikm ε_jln F_mn.
SECOND_DERIVATIVE = np.einsum("ikm,jln->mnijkl", LEVI_CIVITA, LEVI_CIVITA).reshape(9, 9, 9)[
    np.ix_(AXISYMMETRIC, AXISYMMETRIC, AXISYMMETRIC)
]


@dataclass(frozen=True)
class NeoHookean:
    """μ/2 (J^(−2/3) I₁ − 3) + K/2 (J − 1)²: the energy of a nearly incompressible silicone, per undeformed volume.

    The volumetric term is left to the elements, which project J − 1.
    """

    young_modulus_mpa: float
    poisson_ratio: float

    @property
    def shear_modulus_mpa(self) -> float:
        return self.young_modulus_mpa / (2 * (1 + self.poisson_ratio))

    @property
    def volumetric_modulus_mpa(self) -> float:
        """The factor of (J − 1)²/2."""
        return self.young_modulus_mpa / (3 * (1 - 2 * self.poisson_ratio))

    def energy(self, f: Floats, j: Floats) -> Floats:
        """Return the energy density (…), N/mm²."""
        return self.shear_modulus_mpa / 2 * (j ** (-2 / 3) * (f**2).sum(-1) - 3)

    def stress(self, f: Floats, j: Floats, dj: Floats) -> Floats:
        """Return the first Piola–Kirchhoff stress (…, 5), MPa."""
        third = (f**2).sum(-1) / (3 * j)
        return self.shear_modulus_mpa * (j ** (-2 / 3))[..., None] * (f - third[..., None] * dj)

    def tangent(self, f: Floats, j: Floats, dj: Floats, ddj: Floats) -> Floats:
        """Return the derivative of the stress by F (…, 5, 5), MPa."""
        third = (f**2).sum(-1) / (3 * j)
        mixed = f[..., :, None] * dj[..., None, :]
        tangent = (
            np.eye(f.shape[-1])
            - (2 / (3 * j))[..., None, None] * (mixed + np.swapaxes(mixed, -1, -2))
            + (5 * third / (3 * j))[..., None, None] * dj[..., :, None] * dj[..., None, :]
            - third[..., None, None] * ddj
        )
        return self.shear_modulus_mpa * (j ** (-2 / 3))[..., None, None] * tangent


class StableNeoHookean(NeoHookean):
    """μ/2 (I₁ − 3) − μ (J − 1) + (λ + μ)/2 (J − 1)²: MuJoCo's (Smith et al. 2018, ACM Trans. Graph. 37:12)."""

    @property
    def volumetric_modulus_mpa(self) -> float:
        return super().volumetric_modulus_mpa + self.shear_modulus_mpa / 3

    def energy(self, f: Floats, j: Floats) -> Floats:
        return self.shear_modulus_mpa * (((f**2).sum(-1) - 3) / 2 - (j - 1))

    def stress(self, f: Floats, j: Floats, dj: Floats) -> Floats:
        return self.shear_modulus_mpa * (f - dj)

    def tangent(self, f: Floats, j: Floats, dj: Floats, ddj: Floats) -> Floats:
        return self.shear_modulus_mpa * (np.eye(f.shape[-1]) - ddj)


@dataclass(frozen=True)
class Element:
    """At the Gauss points (q): functions of the nodes (q, a), slopes (q, a, 2), weights (q,), modes of J − 1 (q, m)."""

    shape: Floats
    slope: Floats
    weights: Floats
    modes: Floats


class Pad:
    """A discretised pad: its strain energy, and forces and stiffness for displacements `u` (dofs,).

    Its `nodes` (n, 2) have two displacements each, and `connectivity` (e, a) names the nodes of the elements. `surface`
    and `surface_area_mm2` are the nodes that can be touched, and the area that belongs to each. `pointwise_mpa` of the
    volumetric modulus acts on J, the rest on its projection.
    """

    def __init__(
        self,
        nodes: Floats,
        connectivity: Ints,
        element: Element,
        material: NeoHookean,
        fixed_dofs: Ints,
        surface: Ints,
        surface_area_mm2: Floats,
        pointwise_mpa: float,
    ) -> None:
        self.nodes, self.material, self.pointwise_mpa = nodes, material, pointwise_mpa
        self.projected_mpa = material.volumetric_modulus_mpa - pointwise_mpa
        self.surface, self.surface_area_mm2 = surface, surface_area_mm2
        self.size = nodes.size
        self.free = np.setdiff1d(np.arange(self.size), fixed_dofs)
        self.dofs = self.dofs_of(connectivity).reshape(len(connectivity), -1)
        self.surface_dofs = self.dofs_of(surface)
        corners = nodes[connectivity]
        jacobian = np.einsum("qai,eaj->eqij", element.slope, corners)
        gradient = np.einsum("eqji,qai->eqja", np.linalg.inv(jacobian), element.slope)
        r = corners[..., 0] @ element.shape.T
        self.volume = 2 * np.pi * r * (np.linalg.det(jacobian) * element.weights)
        # An element's displacements times `strain` (e, q, 5, dofs of an element) are the components of F − 1.
        strain = np.zeros((*r.shape, 5, connectivity.shape[1], 2))
        strain[:, :, 0:2, :, 0] = strain[:, :, 2:4, :, 1] = gradient
        strain[:, :, 4, :, 0] = element.shape / r[..., None]
        self.strain = strain.reshape(*r.shape, 5, -1)
        moments = np.einsum("eq,qa,qb->eab", self.volume, element.modes, element.modes)
        # `projection` (e, q, q) turns values at Gauss points into those of the best combination of modes there.
        weighted = element.modes.T * self.volume[:, None, :]
        self.projection = element.modes @ np.linalg.inv(moments) @ weighted

    def dofs_of(self, nodes: Ints) -> Ints:
        """Return the indices (…, 2) of the nodes' displacements in `u`."""
        return 2 * nodes[..., None] + np.arange(2)

    def deformation(self, u: Floats) -> tuple[Floats, Floats, Floats, Floats]:
        """Return F (e, q, c), J (e, q), and J's first and second derivative by F: J is homogeneous of degree three."""
        f = np.einsum("eqij,ej->eqi", self.strain, u[self.dofs]) + IDENTITY
        ddj = np.tensordot(f, SECOND_DERIVATIVE, 1)
        dj = np.einsum("eqij,eqj->eqi", ddj, f) / 2
        return f, np.einsum("eqi,eqi->eq", dj, f) / 3, dj, ddj

    def energy_mj(self, u: Floats) -> float:
        """Return the stored elastic energy, N mm."""
        f, j, _, _ = self.deformation(u)
        volumetric = self.pointwise_mpa * (j - 1) ** 2 + self.projected_mpa * self._projected(j - 1) ** 2
        return float((self.volume * (self.material.energy(f, j) + volumetric / 2)).sum())

    def assemble(self, u: Floats) -> tuple[Floats, sparse.csc_matrix]:
        """Return internal forces (dofs,) and the tangent stiffness (dofs, dofs).

        Raises
        ------
        FloatingPointError
            If an element is turned inside out.
        """
        f, j, dj, ddj = self.deformation(u)
        if not j.min() > 0:
            raise FloatingPointError("an element has no volume left")
        pressure = (self.pointwise_mpa * (j - 1) + self.projected_mpa * self._projected(j - 1))[..., None]
        stress = self.material.stress(f, j, dj) + pressure * dj
        tangent = self.material.tangent(f, j, dj, ddj) + pressure[..., None] * ddj
        tangent += self.pointwise_mpa * dj[..., :, None] * dj[..., None, :]

        elements, points, components, dofs = self.strain.shape
        force = np.einsum("eqij,eqi->ej", self.strain, self.volume[..., None] * stress)
        b = self.strain.reshape(elements, points * components, dofs)
        ab = (self.volume[..., None, None] * (tangent @ self.strain)).reshape(b.shape)
        dilation = np.einsum("eqi,eqij->eqj", dj, self.strain)
        weighted_dilation = self.volume[..., None] * dilation
        stiffness = b.transpose(0, 2, 1) @ ab
        stiffness += self.projected_mpa * weighted_dilation.transpose(0, 2, 1) @ (self.projection @ dilation)
        return np.bincount(self.dofs.ravel(), force.ravel(), self.size), self.matrix(self.dofs, stiffness)

    def matrix(self, dofs: Ints, blocks: Floats) -> sparse.csc_matrix:
        """Return the sparse (dofs, dofs) sum of dense blocks (k, m, m) at their dofs (k, m)."""
        rows = np.broadcast_to(dofs[:, :, None], blocks.shape).ravel()
        columns = np.broadcast_to(dofs[:, None, :], blocks.shape).ravel()
        return sparse.csc_matrix((blocks.ravel(), (rows, columns)), shape=(self.size, self.size))

    def _projected(self, values: Floats) -> Floats:
        return np.einsum("eqp,ep->eq", self.projection, values)


@dataclass(frozen=True)
class Touch:
    """Contact at one iterate, by surface node (k).

    `force_n` (k, 2) is the sphere's force on a node and `tangent` (k, 2, 2) its negative derivative by the node's
    position, `pressure_mpa` (k,) and `shear_mpa` (k, 2) are per undeformed area. `stick_mm` (k, 2) is where a node
    will stick from then on, measured from the sphere's centre: where it is if it sticks, dragged along if it slips,
    NaN if it is free.
    """

    force_n: Floats
    tangent: Floats
    pressure_mpa: Floats
    shear_mpa: Floats
    stick_mm: Floats


@dataclass(frozen=True)
class SphereContact:
    """A sphere that touches the surface at the origin where it is not displaced.

    Nodes enter it by pressure / `penalty` and give way by shear / `stick_stiffness`, both in MPa/mm. `friction` is
    Coulomb's coefficient: 0 slips freely, `inf` never slips.
    """

    radius_mm: float
    friction: float
    penalty: float
    stick_stiffness: float

    def touch(self, position_mm: Floats, area_mm2: Floats, sphere_mm: Floats, stick_mm: Floats) -> Touch:
        """Return the contact of nodes at a position (k, 2) with the sphere displaced by `sphere_mm` (2,)."""
        identity = np.eye(2)
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
            stick_mm=np.where(active[:, None], from_centre + shear / self.stick_stiffness, np.nan),
        )


def _outer(a: Floats, b: Floats) -> Floats:
    return a[:, :, None] * b[:, None, :]


@dataclass(frozen=True)
class State:
    """Displacements of the sphere (2,) and of all dofs, with stiffness, contact and residual on the free dofs, N."""

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
    """A pad, the sphere that touches it, and the residual's norm below which Newton's method has converged."""

    pad: Pad
    contact: SphereContact
    tolerance_n: float

    def untouched(self) -> State:
        """Return the state before contact."""
        pad = self.pad
        return self.fun(np.zeros(pad.size), np.zeros(2), np.full(pad.surface_dofs.shape, np.nan))

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
        state, du = start, self.solve(start, load[pad.free] - start.residual)
        for _ in range(MAX_ITERATIONS):
            state = self._moved(state.u, du, sphere_mm, stick_mm)
            if state.fnorm < self.tolerance_n:
                return state
            du = self.solve(state, -state.residual)
        raise FloatingPointError("Newton's method does not settle")

    def fun(self, u: Floats, sphere_mm: Floats, stick_mm: Floats) -> State:
        """Return the residual of displacements, and what it is made of."""
        pad = self.pad
        force, stiffness = pad.assemble(u)
        position = pad.nodes[pad.surface] + u[pad.surface_dofs]
        touch = self.contact.touch(position, pad.surface_area_mm2, sphere_mm, stick_mm)
        force[pad.surface_dofs] -= touch.force_n
        return State(sphere_mm, u, stiffness, touch, force[pad.free])

    def solve(self, state: State, right_side: Floats) -> Floats:
        """Return the change of all dofs under forces on the free ones; fixed dofs stay where they are."""
        pad = self.pad
        tangent = state.stiffness + pad.matrix(pad.surface_dofs, state.touch.tangent)
        # Friction makes the tangent unsymmetric, but not its pattern.
        factor = splu(
            tangent[pad.free][:, pad.free].tocsc(),
            permc_spec="MMD_AT_PLUS_A",
            diag_pivot_thresh=0.01,
            options={"SymmetricMode": True},
        )
        du = np.zeros(pad.size)
        du[pad.free] = factor.solve(right_side)
        return du

    def _moved(self, u: Floats, du: Floats, sphere_mm: Floats, stick_mm: Floats) -> State:
        """Take the longest share of `du` that turns no element inside out."""
        for share in NEWTON_SHARES:
            with contextlib.suppress(FloatingPointError):
                return self.fun(u + share * du, sphere_mm, stick_mm)
        raise FloatingPointError("no share of the Newton step keeps the elements' volume")
