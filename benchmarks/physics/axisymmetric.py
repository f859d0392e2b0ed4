"""A rigid sphere that presses a round bonded pad: finite elements with symmetry about the axis.

The project's own check of MuJoCo's forces and surfaces, which shares nothing with it; a user is never given its results
as a frame. It is also the solver behind `equivalent_moduli`. Units are mm, N and MPa; vectors are (r, z).

Elements are biquadratic quadrilaterals of finite strain whose volume ratio is projected on linear functions, so that
they do not lock (Q2/P1 discontinuous: Simo & Taylor 1991, Comput. Methods Appl. Mech. Eng. 85:273). A deformation
gradient F is an array (…, 5) of its components rr, rz, zr, zz and φφ. The volume ratio J comes with its derivatives
`dj` (…, 5) and `ddj` (…, 5, 5) by the same components. Contact is a stiff penalty, collocated at the displaced nodes
against the exact sphere, with Coulomb friction by return mapping (Wriggers, Computational Contact Mechanics, 2006,
ch. 5).
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.polynomial.legendre import leggauss
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import splu

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

# 1/mm: a node enters the sphere by pressure / (first · E), some 0.05 µm; where it sticks it gives way by shear /
# (second · E), some 1 µm.
NORMAL_STIFFNESS, STICK_STIFFNESS = 1e4, 3e2
TOLERANCE = 1e-8  # of the modulus times the sphere's radius squared
MAX_ITERATIONS = 26
SMALLEST_STEP = 1e-3  # of an element's edge; a step in which Newton's method fails is halved until then
# Where a step has ended in slip, the next one starts on Coulomb's cone: rounding must not decide that it sticks.
ON_THE_CONE = 1 - 1e-9
GROWTH = 1.18  # ratio of neighbouring elements away from the contact
# With nothing of the volumetric modulus on J itself, the Stable Neo-Hookean form's −μ (J−1) softens what the projection
# does not see, and a frictionless press collapses; biquadratic elements do not lock at this ratio (that of ν = 0.45).
POINTWISE_PER_SHEAR = 10.0

IDENTITY = np.array([1.0, 0.0, 0.0, 1.0, 1.0])
# d²J/dF² is this times F, for J = (F_rr F_zz − F_rz F_zr) F_φφ.
SECOND_DERIVATIVE = np.zeros((5, 5, 5))
for _a, _b, _sign in ((0, 3, 1.0), (1, 2, -1.0)):
    for _places in ((_a, _b, 4), (_a, 4, _b), (_b, _a, 4), (_b, 4, _a), (4, _a, _b), (4, _b, _a)):
        SECOND_DERIVATIVE[_places] = _sign


@dataclass(frozen=True)
class Press:
    """One axisymmetric press problem.

    `energy` is "isochoric" for μ/2 (J^(−2/3) I₁ − 3) + K/2 (J−1)², of a nearly incompressible silicone, or "stable" for
    MuJoCo's Stable Neo-Hookean μ/2 (I₁−3) − μ (J−1) + (λ+μ)/2 (J−1)² (Smith et al. 2018, ACM Trans. Graph. 37:12).
    `friction` is Coulomb's coefficient: 0 slips freely, `inf` never slips. `element_mm` is the edge of an element at
    the contact (nodes are half as far apart).
    """

    young_modulus_mpa: float = 0.3
    poisson_ratio: float = 0.49
    energy: Literal["isochoric", "stable"] = "isochoric"
    friction: float = np.inf
    indenter_radius_mm: float = 1.5
    thickness_mm: float = 3.0
    pad_radius_mm: float = 10.0
    element_mm: float = 0.06

    def __post_init__(self) -> None:
        if not 0 <= self.poisson_ratio < 0.5:
            raise ValueError(f"poisson_ratio = {self.poisson_ratio!r} must be in [0, 0.5)")

    @classmethod
    def scaled(
        cls, indenter_radius_mm: float, thickness_mm: float, poisson_ratio: float, friction: float
    ) -> "Press":
        """Return a press whose pad is wide enough and whose elements are a fifteenth of the indenter's radius."""
        return cls(
            poisson_ratio=poisson_ratio,
            friction=friction,
            indenter_radius_mm=indenter_radius_mm,
            thickness_mm=thickness_mm,
            pad_radius_mm=max(10.0, 3.5 * thickness_mm),
            element_mm=indenter_radius_mm / 15,
        )

    @property
    def deepest_mm(self) -> float:
        """A third of the thickness or two thirds of the radius, whichever comes first."""
        return min(self.thickness_mm / 3, 2 * self.indenter_radius_mm / 3)

    @property
    def shear_modulus_mpa(self) -> float:
        """μ."""
        return self.young_modulus_mpa / (2 * (1 + self.poisson_ratio))

    @property
    def volumetric_modulus_mpa(self) -> float:
        """The factor of (J − 1)²/2."""
        bulk_mpa = self.young_modulus_mpa / (3 * (1 - 2 * self.poisson_ratio))
        return bulk_mpa if self.energy == "isochoric" else bulk_mpa + self.shear_modulus_mpa / 3

    def __str__(self) -> str:
        return (
            f"R{self.indenter_radius_mm:g} h{self.thickness_mm:g} ν{self.poisson_ratio:g} μ{self.friction:g}"
        )


@dataclass(frozen=True)
class PressState:
    """The equilibrium at one depth; arrays run over the surface nodes from the axis outwards.

    `force_n` is the force on the pad (negative: compression). `pressure_mpa` and `shear_mpa` are nominal
    tractions (per undeformed area) along and across the sphere's normal; shear counts outwards.
    """

    depth_mm: float
    force_n: float
    contact_radius_mm: float
    r_mm: Floats
    u_r_mm: Floats
    u_z_mm: Floats
    pressure_mpa: Floats
    shear_mpa: Floats
    volume_change_mm3: float

    def surface_mm(self, r_mm: Floats) -> tuple[Floats, Floats]:
        """Return (u_r, u_z) at material radii, with the elements' own quadratic functions."""
        element = np.clip(np.searchsorted(self.r_mm[::2], r_mm, side="right") - 1, 0, len(self.r_mm) // 2 - 1)
        nodes = 2 * element[..., None] + np.arange(3)
        start, end = self.r_mm[nodes[..., 0]], self.r_mm[nodes[..., 2]]
        values, _ = _quadratic(np.clip((2 * r_mm - start - end) / (end - start), -1, 1))
        return (values * self.u_r_mm[nodes]).sum(-1), (values * self.u_z_mm[nodes]).sum(-1)


def solve_press(
    problem: Press, depths_mm: tuple[float, ...], nodes_per_step: float = 0.5
) -> tuple[PressState, ...]:
    """Press to each depth in turn (rising), and return the states there.

    Between them the sphere moves in steps that let the contact grow by about `nodes_per_step` nodes; stick
    points are made at the end of the step in which a node first touches.

    Raises
    ------
    ValueError
        If depths do not rise from above zero, or reach through the pad.
    RuntimeError
        If Newton's method fails in the smallest steps.
    """
    depths = np.array([0.0, *depths_mm])
    if len(depths) < 2 or np.any(np.diff(depths) <= 0) or depths[-1] >= problem.thickness_mm:
        raise ValueError(f"depths_mm = {tuple(depths_mm)} must rise within (0, {problem.thickness_mm})")
    radius = problem.indenter_radius_mm
    pad = Pad(problem, depths[-1])
    state = pad.iterate(np.zeros(pad.size), 0.0, np.full(pad.surface_dofs.shape, np.nan))
    states = []
    for depth in depths[1:]:
        while state.depth_mm < depth:
            # Hertz's contact radius √(R d) grows by `nodes_per_step` nodes.
            contact_mm = (radius * state.depth_mm) ** 0.5  # Hertz (Johnson 1985, eq. 4.22)
            target = (contact_mm + nodes_per_step * problem.element_mm / 2) ** 2 / radius
            state = pad.equilibrium(state, target if depth - target >= 1e-3 * depth else depth)
        states.append(_press_state(pad, state))
    return tuple(states)


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
class Iterate:
    """Displacements of all dofs, with stiffness, contact and residual on the free dofs, N."""

    depth_mm: float
    u: Floats
    stiffness: sparse.csc_matrix
    touch: Touch
    residual: Floats


class Pad:
    """Half the section of a round pad: the axis at r = 0, the membrane at z = 0 and the backing below.

    Its `nodes` (n, 2) have two displacements each, those of `u` (dofs,). `surface` names those that can be touched,
    `surface_area_mm2` the undeformed area that belongs to each.
    """

    def __init__(self, press: Press, deepest_mm: float) -> None:
        contact = (press.indenter_radius_mm * deepest_mm) ** 0.5  # by Hertz
        ring = min(1.15 * contact, 1.2 * press.indenter_radius_mm)
        r = _graded(ring, press.pad_radius_mm, press.element_mm, press.thickness_mm / 4)
        z = -_graded(0, press.thickness_mm, press.element_mm, press.thickness_mm / 6)[::-1]
        index = np.arange(len(r) * len(z)).reshape(len(r), len(z))
        self.press = press
        self.nodes = np.stack(np.meshgrid(r, z, indexing="ij"), axis=-1).reshape(-1, 2)
        self.size = self.nodes.size
        backing_and_axis = np.concatenate([2 * index[:, 0], 2 * index[:, 0] + 1, 2 * index[0]])
        self.free = np.setdiff1d(np.arange(self.size), backing_and_axis)
        self.surface, self.surface_area_mm2 = index[:, -1], _nodal_areas_mm2(r)
        self.surface_dofs = _dofs_of(self.surface)
        of_element = (
            index[:-2:2, :-2:2].reshape(-1, 1) + (np.arange(3)[:, None] * len(z) + np.arange(3)).ravel()
        )
        self.dofs = _dofs_of(of_element).reshape(len(of_element), -1)
        # Of the volumetric modulus a part acts on J, the rest on its projection.
        pointwise = POINTWISE_PER_SHEAR * press.shear_modulus_mpa
        self.pointwise_mpa = min(press.volumetric_modulus_mpa, pointwise)
        self.projected_mpa = press.volumetric_modulus_mpa - self.pointwise_mpa

        # Functions of an element's nodes (a) and their slopes at its 3×3 Gauss points (q).
        points, weights = leggauss(3)
        values, slopes = _quadratic(points)
        shape, along_r, along_z = (
            np.einsum("ai,bj->abij", *factors).reshape(9, 9)
            for factors in ((values, values), (slopes, values), (values, slopes))
        )
        corners = self.nodes[of_element]
        slope = np.stack([along_r, along_z], axis=-1)
        jacobian = np.einsum("qai,eaj->eqij", slope, corners)
        gradient = np.einsum("eqji,qai->eqja", np.linalg.inv(jacobian), slope)
        radius = corners[..., 0] @ shape.T
        self.volume = 2 * np.pi * radius * (np.linalg.det(jacobian) * np.outer(weights, weights).ravel())
        # An element's displacements times `strain` (e, q, 5, dofs of an element) are the components of F − 1.
        strain = np.zeros((*radius.shape, 5, 9, 2))
        strain[:, :, 0:2, :, 0] = strain[:, :, 2:4, :, 1] = gradient
        strain[:, :, 4, :, 0] = shape / radius[..., None]
        self.strain = strain.reshape(*radius.shape, 5, -1)
        # `projection` (e, q, q) turns values at Gauss points into those of the best linear function there.
        modes = np.stack([np.ones(9), np.repeat(points, 3), np.tile(points, 3)], axis=-1)
        moments = np.einsum("eq,qa,qb->eab", self.volume, modes, modes)
        self.projection = modes @ np.linalg.inv(moments) @ (modes.T * self.volume[:, None, :])

    def deformation(self, u: Floats) -> tuple[Floats, Floats, Floats, Floats]:
        """Return F (e, q, c), J (e, q), and J's first and second derivative by F: J is homogeneous of degree three."""
        f = np.einsum("eqij,ej->eqi", self.strain, u[self.dofs]) + IDENTITY
        ddj = np.tensordot(f, SECOND_DERIVATIVE, 1)
        dj = np.einsum("eqij,eqj->eqi", ddj, f) / 2
        return f, np.einsum("eqi,eqi->eq", dj, f) / 3, dj, ddj

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
        projected = np.einsum("eqp,ep->eq", self.projection, j - 1)
        pressure = (self.pointwise_mpa * (j - 1) + self.projected_mpa * projected)[..., None]
        stress, tangent = sheared(self.press, f, j, dj, ddj)
        stress = stress + pressure * dj
        tangent = tangent + pressure[..., None] * ddj
        tangent += self.pointwise_mpa * dj[..., :, None] * dj[..., None, :]

        elements, points, components, dofs = self.strain.shape
        force = np.einsum("eqij,eqi->ej", self.strain, self.volume[..., None] * stress)
        b = self.strain.reshape(elements, points * components, dofs)
        ab = (self.volume[..., None, None] * (tangent @ self.strain)).reshape(b.shape)
        dilation = np.einsum("eqi,eqij->eqj", dj, self.strain)
        weighted_dilation = self.volume[..., None] * dilation
        stiffness = b.transpose(0, 2, 1) @ ab
        stiffness += self.projected_mpa * weighted_dilation.transpose(0, 2, 1) @ (self.projection @ dilation)
        forces = np.bincount(self.dofs.ravel(), force.ravel(), self.size).astype(np.float64, copy=False)
        return forces, self._matrix(self.dofs, stiffness)

    def iterate(self, u: Floats, depth_mm: float, stick_mm: Floats) -> Iterate:
        """Return the residual of displacements with the sphere at a depth, and what it is made of."""
        force, stiffness = self.assemble(u)
        position = self.nodes[self.surface] + u[self.surface_dofs]
        touch = touched(self.press, position, self.surface_area_mm2, depth_mm, stick_mm)
        force[self.surface_dofs] -= touch.force_n
        return Iterate(depth_mm, u, stiffness, touch, force[self.free])

    def equilibrium(self, start: Iterate, depth_mm: float) -> Iterate:
        """Return the equilibrium with the sphere at another depth, by way of one half as far where that fails.

        Raises
        ------
        RuntimeError
            If none is found in the smallest steps.
        """
        try:
            return self._newton(start, depth_mm)
        except FloatingPointError as failure:
            if depth_mm - start.depth_mm < SMALLEST_STEP * self.press.element_mm:
                raise RuntimeError(f"no equilibrium at a depth of {depth_mm:g} mm: {failure}") from None
        return self.equilibrium(self.equilibrium(start, (start.depth_mm + depth_mm) / 2), depth_mm)

    def _newton(self, start: Iterate, depth_mm: float) -> Iterate:
        """Return the equilibrium with the sphere at another depth; raise FloatingPointError if none is found."""
        tolerance_n = TOLERANCE * self.press.young_modulus_mpa * self.press.indenter_radius_mm**2
        stick_mm = start.touch.stick_mm
        # First step: to the contact, a moving sphere is the same as its nodes moving the other way.
        state = self.iterate(start.u, start.depth_mm, stick_mm)
        load = np.zeros(self.size)
        load[self.surface_dofs] = state.touch.tangent @ np.array([0.0, start.depth_mm - depth_mm])
        du = self._solve(state, load[self.free] - state.residual)
        for _ in range(MAX_ITERATIONS):
            state = self.iterate(state.u + du, depth_mm, stick_mm)
            if np.linalg.norm(state.residual) < tolerance_n:
                return state
            du = self._solve(state, -state.residual)
        raise FloatingPointError("Newton's method does not settle")

    def _solve(self, state: Iterate, right_side: Floats) -> Floats:
        """Return the change of all dofs under forces on the free ones; fixed dofs stay where they are."""
        tangent = state.stiffness + self._matrix(self.surface_dofs, state.touch.tangent)
        # Friction makes the tangent unsymmetric, but not its pattern.
        factor = splu(
            tangent[self.free][:, self.free].tocsc(),
            permc_spec="MMD_AT_PLUS_A",
            diag_pivot_thresh=0.01,
            options={"SymmetricMode": True},
        )
        du = np.zeros(self.size)
        du[self.free] = factor.solve(right_side)
        return du

    def _matrix(self, dofs: Ints, blocks: Floats) -> sparse.csc_matrix:
        """Return the sparse (dofs, dofs) sum of dense blocks (k, m, m) at their dofs (k, m)."""
        rows = np.broadcast_to(dofs[:, :, None], blocks.shape).ravel()
        columns = np.broadcast_to(dofs[:, None, :], blocks.shape).ravel()
        return sparse.csc_matrix((blocks.ravel(), (rows, columns)), shape=(self.size, self.size))


def _dofs_of(nodes: Ints) -> Ints:
    """Return the indices (…, 2) of the nodes' displacements in `u`."""
    return 2 * nodes[..., None] + np.arange(2)


def sheared(press: Press, f: Floats, j: Floats, dj: Floats, ddj: Floats) -> tuple[Floats, Floats]:
    """Return the first Piola–Kirchhoff stress (…, 5) without the volumetric term, and its derivative by F, MPa."""
    modulus_mpa, identity = press.shear_modulus_mpa, np.eye(5)
    if press.energy == "stable":
        return modulus_mpa * (f - dj), modulus_mpa * (identity - ddj)
    third = ((f**2).sum(-1) / (3 * j))[..., None]
    mixed = f[..., :, None] * dj[..., None, :]
    tangent = (
        identity
        - (2 / (3 * j))[..., None, None] * (mixed + np.swapaxes(mixed, -1, -2))
        + 5 / 3 * (third / j[..., None])[..., None] * dj[..., :, None] * dj[..., None, :]
        - third[..., None] * ddj
    )
    scale_mpa = (modulus_mpa * j ** (-2 / 3))[..., None]
    return scale_mpa * (f - third * dj), scale_mpa[..., None] * tangent


def touched(press: Press, position_mm: Floats, area_mm2: Floats, depth_mm: float, stick_mm: Floats) -> Touch:
    """Return the contact of nodes at a position (k, 2) with the sphere, which at depth 0 touches the origin."""
    penalty, stick_stiffness = (
        press.young_modulus_mpa * factor for factor in (NORMAL_STIFFNESS, STICK_STIFFNESS)
    )
    identity = np.eye(2)
    from_centre = position_mm - np.array([0.0, press.indenter_radius_mm - depth_mm])
    distance = np.linalg.norm(from_centre, axis=1)
    normal = from_centre / distance[:, None]
    across = identity - _outer(normal, normal)
    d_normal = across / distance[:, None, None]
    gap = distance - press.indenter_radius_mm
    active = gap < 0
    pressure = np.where(active, -penalty * gap, 0.0)
    d_pressure = np.where(active[:, None], -penalty * normal, 0.0)

    # The trial shear opposes the offset from the stick point along the sphere: −k (1 − n⊗n)·offset.
    held = active & ~np.isnan(stick_mm[:, 0]) & (press.friction > 0)
    offset = np.where(held[:, None], from_centre - np.nan_to_num(stick_mm), 0.0)
    inward = np.einsum("ni,ni->n", normal, offset)
    trial = -stick_stiffness * np.einsum("nij,nj->ni", across, offset)
    d_offset = across - inward[:, None, None] * d_normal
    d_offset -= _outer(normal, np.einsum("ni,nij->nj", offset, d_normal))
    d_trial = np.where(held[:, None, None], -stick_stiffness * d_offset, 0.0)

    # Return mapping: shear that Coulomb's cone does not allow is cut back to it.
    size = np.linalg.norm(trial, axis=1)
    limit = press.friction * pressure if np.isfinite(press.friction) else np.full_like(pressure, np.inf)
    slipping = held & (size > ON_THE_CONE * limit)
    kept = np.where(slipping, limit, 1.0) / np.where(slipping, size, 1.0)
    direction = trial / np.where(size > 0, size, 1.0)[:, None]
    shear = trial * kept[:, None]
    turning = kept[:, None, None] * ((identity - _outer(direction, direction)) @ d_trial)
    d_slip = (press.friction if slipping.any() else 0.0) * _outer(direction, d_pressure) + turning
    d_shear = np.where(slipping[:, None, None], d_slip, d_trial)

    d_traction = _outer(normal, d_pressure) + pressure[:, None, None] * d_normal + d_shear
    return Touch(
        force_n=area_mm2[:, None] * (pressure[:, None] * normal + shear),
        tangent=-area_mm2[:, None, None] * d_traction,
        pressure_mpa=pressure,
        shear_mpa=shear,
        stick_mm=np.where(active[:, None], from_centre + shear / stick_stiffness, np.nan),
    )


def _outer(a: Floats, b: Floats) -> Floats:
    return a[:, :, None] * b[:, None, :]


def _graded(fine_until_mm: float, end_mm: float, element_mm: float, largest_mm: float) -> Floats:
    """Return nodes from 0 to `end_mm`, midpoints included: equal elements first, then growing ones."""
    sizes = [element_mm] * max(1, round(min(fine_until_mm, end_mm) / element_mm))
    while sum(sizes) < end_mm:
        sizes.append(min(sizes[-1] * GROWTH, largest_mm))
    corners = np.concatenate([[0], np.cumsum(sizes)])
    corners *= end_mm / corners[-1]
    nodes = np.empty(2 * len(corners) - 1)
    nodes[::2] = corners
    nodes[1::2] = (corners[1:] + corners[:-1]) / 2
    return nodes


def _quadratic(x: Floats) -> tuple[Floats, Floats]:
    """Return quadratic Lagrange functions of the nodes −1, 0, 1 and their slopes, each (len(x), 3)."""
    values = np.stack([x * (x - 1) / 2, 1 - x**2, x * (x + 1) / 2], axis=-1)
    slopes = np.stack([x - 0.5, -2 * x, x + 0.5], axis=-1)
    return values, slopes


def _nodal_areas_mm2(r: Floats) -> Floats:
    """Return the surface area that belongs to each surface node.

    A uniform pressure puts no force on the axis node; a little area keeps it out of the sphere.
    """
    width = np.diff(r[::2])
    simpson = np.zeros(len(r))
    simpson[1::2] = 2 / 3 * width
    simpson[:-2:2] += width / 6
    simpson[2::2] += width / 6
    area = 2 * np.pi * r * simpson
    area[0] = np.pi * (width[0] / 8) ** 2
    return area


def _press_state(pad: Pad, state: Iterate) -> PressState:
    r, touch = pad.nodes[pad.surface, 0], state.touch
    u_r, u_z = state.u[pad.surface_dofs].T
    return PressState(
        depth_mm=state.depth_mm,
        force_n=float(touch.force_n[:, 1].sum()),
        contact_radius_mm=_edge_radius_mm(r + u_r, touch.pressure_mpa),
        r_mm=r,
        u_r_mm=u_r,
        u_z_mm=u_z,
        pressure_mpa=touch.pressure_mpa,
        shear_mpa=np.copysign(np.linalg.norm(touch.shear_mpa, axis=1), touch.shear_mpa[:, 0]),
        volume_change_mm3=float((pad.volume * (pad.deformation(state.u)[1] - 1)).sum()),
    )


def _edge_radius_mm(radius_mm: Floats, pressure_mpa: Floats) -> float:
    """Where the normal pressure vanishes: p² is linear in r near the edge, as in Hertz's p ∝ √(a² − r²)."""
    touching = np.flatnonzero(pressure_mpa > 0)
    last = touching[max(-8, -max(3, len(touching) // 4)) :]
    slope, intercept = np.polyfit(radius_mm[last], pressure_mpa[last] ** 2, 1)
    return float(-intercept / slope)
