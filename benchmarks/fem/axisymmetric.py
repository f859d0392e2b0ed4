"""A rigid sphere pressed into a bonded pad: locking-free axisymmetric finite elements of finite strain.

The project's own check of MuJoCo's forces and surfaces, and the solver behind `equivalent_material`. It is
never what a user gets as a frame.

Elements are biquadratic quadrilaterals in (r, z) whose volume ratio is projected, element by element, on
linear functions (Q2/P1 discontinuous: the mean-dilatation method, which does not lock; Simo & Taylor 1991,
Comput. Methods Appl. Mech. Eng. 85:273). Contact is collocated at the displaced surface nodes against the
exact sphere with a stiff penalty and Coulomb friction by return mapping. Units are mm, N and MPa.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.polynomial.legendre import leggauss
from numpy.typing import NDArray
from scipy import sparse

from gelgap.benchmarks.fem.tangent import solve_tangent
from gelgap.benchmarks.fem.theory import bulk_modulus_mpa, hertz_contact_radius_mm, shear_modulus_mpa

Floats = NDArray[np.float64]
Energy = Literal["isochoric", "stable"]

PENALTY_PER_MODULUS = 1e4  # 1/mm: the sphere is entered by pressure / (1e4 E), some 0.05 µm
STICK_PER_MODULUS = 3e2  # 1/mm: sticking nodes give way by shear / (3e2 E), less than 1 µm
GROWTH = 1.18  # ratio of neighbouring elements away from the contact
# Of the volumetric modulus, as much as this times the shear modulus acts on J itself and the rest on its
# projection: with none the Stable Neo-Hookean form's −μ (J−1) softens what the projection does not see, and a
# frictionless press collapses; biquadratic elements do not lock at this ratio (that of ν = 0.45).
POINTWISE_PER_SHEAR = 10.0
NEWTON_LIMIT = 25
RESIDUAL_TOLERANCE = 1e-8  # of the modulus times the square of the indenter's radius
SMALLEST_STEP = 1 / 64


@dataclass(frozen=True)
class Press:
    """One axisymmetric press problem.

    `energy` is "isochoric" for μ/2 (J^(−2/3) I₁ − 3) + K/2 (J−1)², or "stable" for MuJoCo's Stable
    Neo-Hookean μ/2 (I₁−3) − μ (J−1) + (λ+μ)/2 (J−1)². `friction` is Coulomb's coefficient: 0 slips freely,
    `inf` never slips. `element_mm` is the edge of an element at the contact (nodes are half as far apart).
    """

    young_modulus_mpa: float = 0.3
    poisson_ratio: float = 0.49
    energy: Energy = "isochoric"
    friction: float = np.inf
    indenter_radius_mm: float = 1.5
    thickness_mm: float = 3.0
    pad_radius_mm: float = 10.0
    element_mm: float = 0.06

    def __post_init__(self) -> None:
        bounds = {
            "young_modulus_mpa": (self.young_modulus_mpa > 0, "> 0"),
            "poisson_ratio": (0 <= self.poisson_ratio < 0.5, "in [0, 0.5)"),
            "energy": (self.energy in ("isochoric", "stable"), '"isochoric" or "stable"'),
            "friction": (self.friction >= 0, "≥ 0"),
            "indenter_radius_mm": (self.indenter_radius_mm > 0, "> 0"),
            "thickness_mm": (self.thickness_mm > 0, "> 0"),
            "pad_radius_mm": (self.pad_radius_mm > self.indenter_radius_mm, "> indenter_radius_mm"),
            "element_mm": (0 < self.element_mm <= self.thickness_mm, "in (0, thickness_mm]"),
        }
        for name, (holds, allowed) in bounds.items():
            if not holds:
                raise ValueError(f"{name} = {getattr(self, name)!r} must be {allowed}")

    @property
    def shear_modulus_mpa(self) -> float:
        return float(shear_modulus_mpa(self.young_modulus_mpa, self.poisson_ratio))

    @property
    def volumetric_modulus_mpa(self) -> float:
        """The factor of (J−1)²/2: the bulk modulus K, or λ+μ of the Stable Neo-Hookean form."""
        bulk = float(bulk_modulus_mpa(self.young_modulus_mpa, self.poisson_ratio))
        return bulk if self.energy == "isochoric" else bulk + self.shear_modulus_mpa / 3


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
    energy_mj: float

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
        If Newton's method fails at the smallest step.
    """
    depths = np.asarray(depths_mm, float)
    if (
        depths.size == 0
        or depths[0] <= 0
        or np.any(np.diff(depths) <= 0)
        or depths[-1] >= problem.thickness_mm
    ):
        raise ValueError(f"depths_mm = {tuple(depths_mm)} must rise within (0, {problem.thickness_mm})")
    pad = _Pad(problem, _mesh(problem, depths[-1]))
    state = _Contact.untouched(pad)
    states = []
    spacing = problem.element_mm / 2 * nodes_per_step
    for depth in depths:
        while state.depth_mm < depth:
            # Hertz's radius √(R d) grows by `spacing`
            grown = hertz_contact_radius_mm(problem.indenter_radius_mm, state.depth_mm) + spacing
            target = min(depth, grown**2 / problem.indenter_radius_mm)
            state = _advance(pad, state, depth if depth - target < 1e-3 * depth else target)
        states.append(_describe(pad, state))
    return tuple(states)


# --- mesh ---------------------------------------------------------------------------------------------------


def _graded(fine_until_mm: float, end_mm: float, element_mm: float, largest_mm: float) -> Floats:
    """Corner coordinates from 0: equal elements up to `fine_until_mm`, then growing ones to `end_mm`."""
    sizes = [element_mm] * max(1, round(min(fine_until_mm, end_mm) / element_mm))
    while sum(sizes) < end_mm:
        sizes.append(min(sizes[-1] * GROWTH, largest_mm))
    corners = np.concatenate([[0], np.cumsum(sizes)])
    return corners * end_mm / corners[-1]


def _with_midpoints(corners: Floats) -> Floats:
    nodes = np.empty(2 * len(corners) - 1)
    nodes[::2] = corners
    nodes[1::2] = (corners[1:] + corners[:-1]) / 2
    return nodes


def _mesh(problem: Press, deepest_mm: float) -> tuple[Floats, Floats]:
    """Return node coordinates r (from the axis) and z (from the backing to the surface at 0)."""
    contact = hertz_contact_radius_mm(problem.indenter_radius_mm, deepest_mm)
    ring = min(1.15 * contact, 1.2 * problem.indenter_radius_mm)
    r = _graded(ring, problem.pad_radius_mm, problem.element_mm, problem.thickness_mm / 4)
    z = _graded(0, problem.thickness_mm, problem.element_mm, problem.thickness_mm / 6)
    return _with_midpoints(r), -_with_midpoints(z)[::-1]


def _quadratic(x: Floats) -> tuple[Floats, Floats]:
    """Quadratic Lagrange functions of the nodes −1, 0, 1 and their slopes, each (len(x), 3)."""
    values = np.stack([x * (x - 1) / 2, 1 - x**2, x * (x + 1) / 2], axis=-1)
    slopes = np.stack([x - 0.5, -2 * x, x + 0.5], axis=-1)
    return values, slopes


class _Pad:
    """The discretised pad: its strain energy, forces and stiffness for displacements `u` (2 × nodes)."""

    def __init__(self, problem: Press, nodes: tuple[Floats, Floats]) -> None:
        self.problem = problem
        self.r, self.z = nodes
        rows, columns = len(self.z), len(self.r)
        index = np.arange(columns * rows).reshape(columns, rows)  # nodes run up each column in turn
        corner = index[:-2:2, :-2:2].ravel()
        offsets = (np.arange(3)[:, None] * rows + np.arange(3)).ravel()
        self.connectivity = corner[:, None] + offsets  # (elements, 9)
        self.dofs = (2 * self.connectivity[:, :, None] + np.arange(2)).reshape(len(corner), 18)
        self.surface = index[:, -1]
        fixed = np.concatenate([2 * index[:, 0], 2 * index[:, 0] + 1, 2 * index[0]])  # backing; axis
        self.size = 2 * index.size
        self.free = np.setdiff1d(np.arange(self.size), fixed)
        self._integrate()

    def _integrate(self) -> None:
        """Precompute strain operators and weights at the 3×3 Gauss points of each element."""
        points, weights = leggauss(3)
        values, slopes = _quadratic(points)
        shape = np.einsum("ai,bj->abij", values, values).reshape(9, 9)
        shape_r = np.einsum("ai,bj->abij", slopes, values).reshape(9, 9)
        shape_z = np.einsum("ai,bj->abij", values, slopes).reshape(9, 9)
        node_r, node_z = (grid.ravel() for grid in np.meshgrid(self.r, self.z, indexing="ij"))
        corners = self.connectivity[:, [0, 8]]
        half_r = np.diff(node_r[corners], axis=1)[:, 0] / 2
        half_z = np.diff(node_z[corners], axis=1)[:, 0] / 2
        gauss_r = node_r[self.connectivity] @ shape.T  # (elements, 9)
        self.volume = 2 * np.pi * gauss_r * np.outer(half_r * half_z, np.outer(weights, weights))
        strain = np.zeros((len(corners), 9, 5, 9, 2))  # (F_rr, F_rz, F_zr, F_zz, F_φφ) by node displacement
        strain[:, :, 0, :, 0] = strain[:, :, 2, :, 1] = shape_r / half_r[:, None, None]
        strain[:, :, 1, :, 0] = strain[:, :, 3, :, 1] = shape_z / half_z[:, None, None]
        strain[:, :, 4, :, 0] = shape / gauss_r[:, :, None]
        self.strain = strain.reshape(len(corners), 9, 5, 18)
        linear = np.stack([np.ones(9), np.repeat(points, 3), np.tile(points, 3)], axis=-1)
        moments = np.einsum("eq,qa,qb->eab", self.volume, linear, linear)
        # `projection` turns values at Gauss points into the best linear function's values there
        self.projection = linear @ np.linalg.inv(moments) @ (linear.T * self.volume[:, None, :])

    @cached_property
    def surface_area_mm2(self) -> Floats:
        """The surface area that belongs to each surface node: where it can be pressed against the sphere.

        A uniform pressure puts no force on the axis node; a little area keeps it out of the sphere.
        """
        start, middle, end = self.r[:-2:2], self.r[1:-1:2], self.r[2::2]
        area = np.zeros(len(self.r))
        width = end - start
        area[:-2:2] += 2 * np.pi * width * start / 6
        area[1:-1:2] += 2 * np.pi * width * middle * 2 / 3
        area[2::2] += 2 * np.pi * width * end / 6
        area[0] = np.pi * (width[0] / 8) ** 2
        return area

    def deformation(self, u: Floats) -> tuple[Floats, Floats]:
        """Return F's five components (elements, 9, 5) and the volume ratio J (elements, 9)."""
        f = np.einsum("eqij,ej->eqi", self.strain, u[self.dofs]) + np.array([1.0, 0, 0, 1, 1])
        return f, (f[..., 0] * f[..., 3] - f[..., 1] * f[..., 2]) * f[..., 4]

    @property
    def _volumetric_split(self) -> tuple[float, float]:
        """The parts of the volumetric modulus that act on J itself and on its projection, MPa."""
        whole = self.problem.volumetric_modulus_mpa
        pointwise = min(whole, POINTWISE_PER_SHEAR * self.problem.shear_modulus_mpa)
        return pointwise, whole - pointwise

    def energy_mj(self, u: Floats) -> float:
        """Stored elastic energy in N mm."""
        f, j = self.deformation(u)
        mu = self.problem.shear_modulus_mpa
        squares = (f**2).sum(-1)
        if self.problem.energy == "isochoric":
            shape = mu / 2 * (j ** (-2 / 3) * squares - 3)
        else:
            shape = mu / 2 * (squares - 3) - mu * (j - 1)
        pointwise, projected = self._volumetric_split
        dilation = np.einsum("eqp,ep->eq", self.projection, j - 1)
        volumetric = pointwise / 2 * (j - 1) ** 2 + projected / 2 * dilation**2
        return float((self.volume * (shape + volumetric)).sum())

    def assemble(self, u: Floats) -> tuple[Floats, sparse.csc_matrix]:
        """Return internal forces (2 × nodes) and the tangent stiffness.

        Raises
        ------
        FloatingPointError
            If an element is turned inside out.
        """
        f, j = self.deformation(u)
        if not j.min() > 0:
            raise FloatingPointError("an element has no volume left")
        slope, curvature = _volume_ratio_derivatives(f)
        mu = self.problem.shear_modulus_mpa
        pointwise, projected = self._volumetric_split
        stress, stiffness = _shape_response(self.problem.energy, f, j, slope, curvature)
        pressure = pointwise * (j - 1) + projected * np.einsum("eqp,ep->eq", self.projection, j - 1)
        stress = mu * stress + pressure[..., None] * slope
        stiffness = mu * stiffness + pressure[..., None, None] * curvature
        stiffness += pointwise * slope[..., :, None] * slope[..., None, :]

        weighted = self.volume[..., None] * stress
        element_force = np.einsum("eqij,eqi->ej", self.strain, weighted)
        b = self.strain.reshape(len(f), 45, 18)
        ab = (self.volume[..., None, None] * (stiffness @ self.strain)).reshape(len(f), 45, 18)
        dilation = np.einsum("eqi,eqij->eqj", slope, self.strain)
        weighted_dilation = self.volume[..., None] * dilation
        element_stiffness = b.transpose(0, 2, 1) @ ab
        element_stiffness += projected * weighted_dilation.transpose(0, 2, 1) @ (self.projection @ dilation)

        force = np.bincount(self.dofs.ravel(), element_force.ravel(), self.size)
        rows = np.broadcast_to(self.dofs[:, :, None], element_stiffness.shape).ravel()
        columns = np.broadcast_to(self.dofs[:, None, :], element_stiffness.shape).ravel()
        matrix = sparse.csc_matrix((element_stiffness.ravel(), (rows, columns)), shape=(self.size, self.size))
        return force, matrix


def _volume_ratio_derivatives(f: Floats) -> tuple[Floats, Floats]:
    """First and second derivatives of J = (F_rr F_zz − F_rz F_zr) F_φφ by the five components."""
    rr, rz, zr, zz, hoop = np.moveaxis(f, -1, 0)
    slope = np.stack([zz * hoop, -zr * hoop, -rz * hoop, rr * hoop, rr * zz - rz * zr], axis=-1)
    curvature = np.zeros((*f.shape, 5))
    for i, k, value in ((0, 3, hoop), (1, 2, -hoop), (0, 4, zz), (1, 4, -zr), (2, 4, -rz), (3, 4, rr)):
        curvature[..., i, k] = curvature[..., k, i] = value
    return slope, curvature


def _shape_response(
    energy: Energy, f: Floats, j: Floats, slope: Floats, curvature: Floats
) -> tuple[Floats, Floats]:
    """Stress and stiffness, per shear modulus, of the part of the energy that is not projected."""
    identity = np.eye(5)
    if energy == "stable":
        return f - slope, identity - curvature
    scale = j ** (-2 / 3)
    third = (f**2).sum(-1) / (3 * j)
    mixed = f[..., :, None] * slope[..., None, :]
    stiffness = (
        identity
        - (2 / (3 * j))[..., None, None] * (mixed + np.swapaxes(mixed, -1, -2))
        + (5 * third / (3 * j))[..., None, None] * slope[..., :, None] * slope[..., None, :]
        - third[..., None, None] * curvature
    )
    return scale[..., None] * (f - third[..., None] * slope), scale[..., None, None] * stiffness


# --- contact ------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Contact:
    """A converged step: displacements, and for each surface node where on the sphere it sticks (or NaN)."""

    depth_mm: float
    u: Floats
    stick_mm: Floats
    traction_mpa: Floats  # (surface nodes, 2): normal and tangential

    @classmethod
    def untouched(cls, pad: _Pad) -> "_Contact":
        nodes = len(pad.r)
        return cls(0.0, np.zeros(pad.size), np.full(nodes, np.nan), np.zeros((nodes, 2)))


@dataclass(frozen=True)
class _Touch:
    """Contact at one iterate: forces on the surface nodes (nodes, 2), their tangent (nodes, 2, 2), …"""

    force: Floats
    tangent: Floats
    traction_mpa: Floats
    arc_mm: Floats
    active: NDArray[np.bool_]


def _touch(pad: _Pad, u: Floats, depth_mm: float, stick_mm: Floats) -> _Touch:
    """Penalty contact of the displaced surface nodes with the sphere, Coulomb friction by return mapping."""
    problem = pad.problem
    radius = problem.indenter_radius_mm
    across = pad.r + u[2 * pad.surface]
    above = radius - depth_mm - u[2 * pad.surface + 1]  # from the node up to the sphere's centre
    distance = np.hypot(across, above)
    normal = np.stack([across, -above], axis=-1) / distance[:, None]  # out of the sphere
    tangent = np.stack([above, across], axis=-1) / distance[:, None]  # outwards along the sphere
    gap = distance - radius
    arc = radius * np.arctan2(across, above)
    active = (gap < 0) & (above > 0)

    penalty = PENALTY_PER_MODULUS * problem.young_modulus_mpa
    stick = STICK_PER_MODULUS * problem.young_modulus_mpa
    pressure = np.where(active, -penalty * gap, 0.0)
    held = active & ~np.isnan(stick_mm) & (problem.friction > 0)
    trial = np.where(held, -stick * (arc - np.nan_to_num(stick_mm)), 0.0)
    limit = problem.friction * pressure if np.isfinite(problem.friction) else np.inf
    slipping = held & (np.abs(trial) > limit)
    shear = np.clip(trial, -limit, limit)

    # gradients: ∇gap = normal, ∇arc = R/distance tangent, ∇normal = t⊗t/distance, ∇tangent = −n⊗t/distance
    nn, tt, nt, tn = (
        a[:, :, None] * b[:, None, :]
        for a, b in ((normal, normal), (tangent, tangent), (normal, tangent), (tangent, normal))
    )
    sticking = (held & ~slipping)[:, None, None]
    friction = problem.friction if np.isfinite(problem.friction) else 0.0
    per_distance = (1 / distance)[:, None, None]
    stiffness = (
        np.where(active[:, None, None], penalty * nn, 0.0) - pressure[:, None, None] * tt * per_distance
    )
    stiffness += sticking * (stick * radius * per_distance * tt)
    stiffness += (slipping * np.sign(trial) * friction * penalty)[:, None, None] * tn
    stiffness += shear[:, None, None] * nt * per_distance
    area = pad.surface_area_mm2
    force = area[:, None] * (pressure[:, None] * normal + shear[:, None] * tangent)
    return _Touch(force, area[:, None, None] * stiffness, np.stack([pressure, shear], -1), arc, active)


def _residual(pad: _Pad, internal: Floats, touch: _Touch) -> Floats:
    residual = internal.copy()
    residual[2 * pad.surface] -= touch.force[:, 0]
    residual[2 * pad.surface + 1] -= touch.force[:, 1]
    return residual[pad.free]


def _newton(pad: _Pad, state: _Contact, depth_mm: float) -> _Contact:
    """Solve for equilibrium at `depth_mm` from a lower one; raises FloatingPointError when that fails."""
    problem = pad.problem
    tolerance = RESIDUAL_TOLERANCE * problem.young_modulus_mpa * problem.indenter_radius_mm**2
    _, matrix = pad.assemble(state.u)
    touch = _touch(pad, state.u, state.depth_mm, state.stick_mm)
    # the contact's forces change as if its nodes had moved up by as much as the sphere moves down
    load = np.zeros(pad.size)
    load[_surface_dofs(pad)] = -(depth_mm - state.depth_mm) * touch.tangent[:, :, 1]
    change = _solve(pad, matrix, touch, load[pad.free])
    u, internal, matrix, touch = _step(pad, state.u, change, depth_mm, state.stick_mm)
    for _ in range(NEWTON_LIMIT):
        change = _solve(pad, matrix, touch, -_residual(pad, internal, touch))
        u, internal, matrix, touch = _step(pad, u, change, depth_mm, state.stick_mm)
        if np.linalg.norm(_residual(pad, internal, touch)) < tolerance:
            return _Contact(depth_mm, u, _new_stick_points(problem, touch), touch.traction_mpa)
    raise FloatingPointError("Newton's method does not settle")


def _surface_dofs(pad: _Pad) -> NDArray[np.int64]:
    return 2 * pad.surface[:, None] + np.arange(2)


def _solve(pad: _Pad, matrix: sparse.csc_matrix, touch: _Touch, right_side: Floats) -> Floats:
    return solve_tangent(matrix, _surface_dofs(pad), touch.tangent, pad.free, right_side)


def _step(
    pad: _Pad, u: Floats, change: Floats, depth_mm: float, stick_mm: Floats
) -> tuple[Floats, Floats, sparse.csc_matrix, _Touch]:
    """Take the longest of a few shares of `change` that keeps every element's volume."""
    for share in (1.0, 0.5, 0.25, 0.125):
        trial = u + share * change
        try:
            internal, matrix = pad.assemble(trial)
        except FloatingPointError:
            continue
        return trial, internal, matrix, _touch(pad, trial, depth_mm, stick_mm)
    raise FloatingPointError("no share of the Newton step keeps the elements' volume")


def _new_stick_points(problem: Press, touch: _Touch) -> Floats:
    """Nodes that touch stick where they are; slipping ones drag their stick point; free ones lose it."""
    give = touch.traction_mpa[:, 1] / (STICK_PER_MODULUS * problem.young_modulus_mpa)
    return np.where(touch.active, touch.arc_mm + give, np.nan)


def _advance(pad: _Pad, state: _Contact, depth_mm: float) -> _Contact:
    """Move to `depth_mm`, in shorter steps where Newton's method fails at once."""
    whole = depth_mm - state.depth_mm
    step = whole
    while state.depth_mm < depth_mm:
        target = min(state.depth_mm + step, depth_mm)
        try:
            state = _newton(pad, state, target)
        except FloatingPointError as failure:
            step /= 2
            if step < SMALLEST_STEP * whole:
                raise RuntimeError(
                    f"press of {pad.problem} fails at depth {target:.4f} mm: {failure}"
                ) from None
    return state


def _describe(pad: _Pad, state: _Contact) -> PressState:
    touch = _touch(pad, state.u, state.depth_mm, state.stick_mm)
    u = state.u.reshape(-1, 2)[pad.surface]
    _, j = pad.deformation(state.u)
    pressure = state.traction_mpa[:, 0]
    return PressState(
        depth_mm=state.depth_mm,
        force_n=float(touch.force[:, 1].sum()),
        contact_radius_mm=_edge_radius_mm(pad.r + u[:, 0], pressure),
        r_mm=pad.r,
        u_r_mm=u[:, 0],
        u_z_mm=u[:, 1],
        pressure_mpa=pressure,
        shear_mpa=state.traction_mpa[:, 1],
        volume_change_mm3=float((pad.volume * (j - 1)).sum()),
        energy_mj=pad.energy_mj(state.u),
    )


def _edge_radius_mm(radius_mm: Floats, pressure_mpa: Floats) -> float:
    """Where the normal pressure vanishes: p² is linear in r near the edge, as in Hertz's p ∝ √(a² − r²)."""
    touching = np.flatnonzero(pressure_mpa > 0)
    last = touching[max(-8, -max(3, len(touching) // 4)) :]
    slope, intercept = np.polyfit(radius_mm[last], pressure_mpa[last] ** 2, 1)
    return float(-intercept / slope)
