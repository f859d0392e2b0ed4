"""A rigid sphere pressed into a bonded pad and dragged over it: mean-dilatation hexahedra of finite strain.

The project's own check of MuJoCo's forces under friction, for which no closed form and no table exists. It is never
what a user gets as a frame, and shares with the delivered solver neither engine nor element nor contact law.

Elements are trilinear hexahedra whose volume ratio is averaged over the element (Q1/P0: Nagtegaal, Parks & Rice 1974;
Simo, Taylor & Pister 1985, Comput. Methods Appl. Mech. Eng. 51:177), which do not lock. Contact is collocated at the
surface nodes against the exact sphere with a stiff penalty, and Coulomb friction by return mapping (Wriggers,
Computational Contact Mechanics, 2006, ch. 5). Half the pad is meshed: the drag goes along x. Units are mm, N and MPa.
"""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from gelgap.benchmarks.fem.disc_hexahedra import half_disc_hexahedra
from gelgap.benchmarks.fem.tangent import solve_tangent
from gelgap.benchmarks.fem.theory import bulk_modulus_mpa, shear_modulus_mpa
from gelgap.sim.mesh.pad import layer_heights_mm
from gelgap.sim.mesh.plane import DiscGrid

Floats = NDArray[np.float64]

PENALTY_PER_MODULUS = 1e3  # 1/mm: the sphere is entered by pressure / (1e3 E), some 1 µm
STICK_PER_MODULUS = 5e2  # 1/mm: sticking nodes give way by shear / (5e2 E), some 1 µm
NEWTON_LIMIT = 15
RESIDUAL_TOLERANCE = 1e-6  # of the modulus times the square of the sphere's radius
SMALLEST_STEP = 1 / 256


@dataclass(frozen=True)
class Drag:
    """A sphere pressed `depth_mm` deep, then moved along x without rotating.

    The strain energy is μ/2 (J^(−2/3) I₁ − 3) + K/2 (J − 1)². `friction` is Coulomb's coefficient, `inf` never slips.
    `element_mm` is the edge of an element at the contact, `sectors` the number of them around half of it.
    """

    young_modulus_mpa: float = 0.3
    poisson_ratio: float = 0.48
    friction: float = np.inf
    sphere_radius_mm: float = 1.5
    thickness_mm: float = 3.0
    pad_radius_mm: float = 10.0
    depth_mm: float = 0.6
    element_mm: float = 0.2
    sectors: int = 24


@dataclass(frozen=True)
class DragState:
    """Equilibrium at one travel: the sphere's force on the pad (3,), N, and the share of it that sticks."""

    travel_mm: float
    force_n: Floats
    sticking_fraction: float


def solve_drag(problem: Drag, travels_mm: tuple[float, ...], step_mm: float = 0.05) -> tuple[DragState, ...]:
    """Press, then drag to each travel in turn (rising from 0), in steps of `step_mm`; return the states there.

    Raises
    ------
    ValueError
        If travels do not rise from 0.
    RuntimeError
        If Newton's method fails at the smallest step.
    """
    travels = np.asarray(travels_mm, float)
    if travels.size == 0 or travels[0] < 0 or np.any(np.diff(travels) <= 0):
        raise ValueError(f"travels_mm = {tuple(travels_mm)} must rise from 0")
    pad = _Pad(problem, furthest_mm=float(travels[-1]))
    state = _Contact.untouched(pad)
    first = min(step_mm, problem.depth_mm) / 4
    for depth in np.append(np.arange(first, problem.depth_mm - 1e-9, step_mm), problem.depth_mm):
        state = _advance(pad, state, np.array([0.0, 0.0, -depth]))
    states = []
    for travel in travels:
        start = state.sphere_mm[0]
        steps = max(1, math.ceil((travel - start) / step_mm - 1e-9))
        for x in start + (travel - start) * np.arange(1, steps + 1) / steps:
            state = _advance(pad, state, np.array([x, 0.0, -problem.depth_mm]))
        states.append(_describe(pad, state))
    return tuple(states)


class _Pad:
    """The discretised half pad: its strain energy's forces and stiffness for displacements `u` (3 × nodes)."""

    def __init__(self, problem: Drag, furthest_mm: float) -> None:
        self.problem = problem
        below = max(problem.sphere_radius_mm - problem.depth_mm, 0.0)
        contact = math.sqrt(problem.sphere_radius_mm**2 - below**2)
        self.nodes, self.hexahedra = half_disc_hexahedra(
            DiscGrid(
                problem.pad_radius_mm, 1.15 * contact + furthest_mm, problem.element_mm, problem.sectors
            ),
            layer_heights_mm(problem.thickness_mm, 0.75 * problem.element_mm, 1.25),
        )
        self.surface = np.flatnonzero(self.nodes[:, 2] > -1e-9)
        self.area = _nodal_areas_mm2(self.nodes, self.hexahedra, self.surface)
        bonded = np.flatnonzero(self.nodes[:, 2] < -problem.thickness_mm + 1e-9)
        mirror = np.flatnonzero(np.abs(self.nodes[:, 1]) < 1e-9)
        self.size = 3 * len(self.nodes)
        fixed = np.concatenate([(3 * bonded[:, None] + np.arange(3)).ravel(), 3 * mirror + 1])
        self.free = np.setdiff1d(np.arange(self.size), fixed)
        self.dofs = (3 * self.hexahedra[:, :, None] + np.arange(3)).reshape(-1, 24)
        self._integrate()

    def _integrate(self) -> None:
        """Precompute shape-function gradients (elements, 8, 8, 3) and weights at the 2×2×2 Gauss points."""
        corners = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)], float)
        corner = np.concatenate([np.column_stack([corners, np.full(4, z)]) for z in (-1.0, 1.0)])
        at = (
            corner[:, None, :] * corner[None] / np.sqrt(3)
        )  # (point, node, axis): ξ of the point times the node's
        factor = (1 + at) / 2
        slope = np.stack(
            [corner[None, :, i] / 2 * factor[..., (i + 1) % 3] * factor[..., (i + 2) % 3] for i in range(3)],
            -1,
        )
        jacobian = np.einsum("qai,eaj->eqij", slope, self.nodes[self.hexahedra])
        self.gradient = np.einsum("eqji,qai->eqaj", np.linalg.inv(jacobian), slope)
        self.volume = np.linalg.det(jacobian)
        if not self.volume.min() > 0:
            raise ValueError("the mesh has an inverted hexahedron")

    def assemble(self, u: Floats) -> tuple[Floats, sparse.csc_matrix]:
        """Return internal forces (3 × nodes) and the tangent stiffness.

        Raises
        ------
        FloatingPointError
            If an element is turned inside out.
        """
        f = np.einsum("eai,eqaj->eqij", u.reshape(-1, 3)[self.hexahedra], self.gradient) + np.eye(3)
        j = np.linalg.det(f)
        if not j.min() > 0:
            raise FloatingPointError("an element has no volume left")
        mu = float(shear_modulus_mpa(self.problem.young_modulus_mpa, self.problem.poisson_ratio))
        bulk = float(bulk_modulus_mpa(self.problem.young_modulus_mpa, self.problem.poisson_ratio))
        whole = self.volume.sum(1)
        pressure = bulk * ((self.volume * j).sum(1) / whole - 1)
        cofactor = _cofactor(f)
        curvature = _cofactor_slope(f)
        stress, stiffness = _isochoric(f, j, cofactor, curvature)
        stress = mu * stress + pressure[:, None, None, None] * cofactor
        stiffness = mu * stiffness + pressure[:, None, None, None] * curvature
        elements = len(f)
        element_force = np.einsum("eq,eqij,eqaj->eai", self.volume, stress, self.gradient)
        strain = np.zeros((elements, 8, 3, 3, 8, 3))
        for i in range(3):
            strain[:, :, i, :, :, i] = np.swapaxes(self.gradient, 2, 3)
        strain = strain.reshape(elements, 8, 9, 24)
        weighted = self.volume[..., None, None] * (stiffness @ strain)
        matrix = strain.reshape(elements, 72, 24).transpose(0, 2, 1) @ weighted.reshape(elements, 72, 24)
        dilation = np.einsum("eq,eqi,eqij->ej", self.volume, cofactor.reshape(elements, 8, 9), strain)
        matrix += (bulk / whole)[:, None, None] * dilation[:, :, None] * dilation[:, None, :]
        force = np.bincount(self.dofs.ravel(), element_force.ravel(), self.size)
        rows = np.broadcast_to(self.dofs[:, :, None], matrix.shape).ravel()
        columns = np.broadcast_to(self.dofs[:, None, :], matrix.shape).ravel()
        return force, sparse.csc_matrix((matrix.ravel(), (rows, columns)), shape=(self.size, self.size))

    @cached_property
    def surface_dofs(self) -> NDArray[np.int64]:
        return 3 * self.surface[:, None] + np.arange(3)


def _nodal_areas_mm2(nodes: Floats, hexahedra: NDArray[np.int64], surface: NDArray[np.int64]) -> Floats:
    """Return the area of the outer membrane that belongs to each of its nodes."""
    quads = hexahedra[np.isin(hexahedra[:, 4:], surface).all(axis=1), 4:]
    corner = nodes[quads, :2]
    across, along = corner[:, 2] - corner[:, 0], corner[:, 3] - corner[:, 1]
    area = np.abs(across[:, 0] * along[:, 1] - across[:, 1] * along[:, 0]) / 2
    return np.bincount(quads.ravel(), np.repeat(area / 4, 4), len(nodes))[surface]


def _cofactor(f: Floats) -> Floats:
    """Return dJ/dF."""
    rows = [np.cross(f[..., (i + 1) % 3, :], f[..., (i + 2) % 3, :]) for i in range(3)]
    return np.stack(rows, axis=-2)


def _cofactor_slope(f: Floats) -> Floats:
    """Return d²J/dF² (…, 9, 9): ε_ikm ε_jln F_mn."""
    levi = np.zeros((3, 3, 3))
    for i, k, m in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        levi[i, k, m], levi[i, m, k] = 1.0, -1.0
    constant = np.einsum("ikm,jln->ijklmn", levi, levi).reshape(81, 9)
    return (f.reshape(*f.shape[:-2], 9) @ constant.T).reshape(*f.shape[:-2], 9, 9)


def _isochoric(f: Floats, j: Floats, cofactor: Floats, curvature: Floats) -> tuple[Floats, Floats]:
    """Stress and stiffness, per shear modulus, of ½ (J^(−2/3) I₁ − 3)."""
    flat, slope = f.reshape(*j.shape, 9), cofactor.reshape(*j.shape, 9)
    scale = (j ** (-2 / 3))[..., None]
    third = ((flat**2).sum(-1) / (3 * j))[..., None]
    stress = scale * (flat - third * slope)
    mixed = flat[..., :, None] * slope[..., None, :]
    stiffness = (
        np.eye(9)
        - (2 / (3 * j))[..., None, None] * (mixed + np.swapaxes(mixed, -1, -2))
        + (5 * third / (3 * j[..., None]))[..., None] * slope[..., :, None] * slope[..., None, :]
        - third[..., None] * curvature
    )
    return stress.reshape(f.shape), scale[..., None] * stiffness


# --- contact ------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Contact:
    """A converged step; `stick_mm` (surface nodes, 3) is where, from the sphere's centre, a node sticks, or NaN."""

    sphere_mm: Floats
    u: Floats
    stick_mm: Floats

    @classmethod
    def untouched(cls, pad: _Pad) -> "_Contact":
        return cls(np.zeros(3), np.zeros(pad.size), np.full((len(pad.surface), 3), np.nan))


@dataclass(frozen=True)
class _Touch:
    """Contact at one iterate: the sphere's force on each surface node, its negative slope, the next stick points."""

    force_n: Floats
    tangent: Floats
    next_stick_mm: Floats
    slipping: NDArray[np.bool_]
    push_n: Floats


def _touch(pad: _Pad, u: Floats, sphere_mm: Floats, stick_mm: Floats) -> _Touch:
    """Penalty contact of the displaced surface nodes with the sphere, Coulomb friction by return mapping."""
    problem = pad.problem
    radius, modulus = problem.sphere_radius_mm, problem.young_modulus_mpa
    penalty, hold = PENALTY_PER_MODULUS * modulus, STICK_PER_MODULUS * modulus
    centre = sphere_mm + np.array([0.0, 0.0, radius])
    reach = pad.nodes[pad.surface] + u.reshape(-1, 3)[pad.surface] - centre
    distance = np.linalg.norm(reach, axis=1)
    n = reach / distance[:, None]
    gap = distance - radius
    touched = ~np.isnan(stick_mm[:, 0])
    active = gap < 0
    push = np.where(active, -penalty * gap, 0.0)
    held = active & touched & (problem.friction > 0)
    past = np.where(held[:, None], reach - np.nan_to_num(stick_mm), 0.0)
    nn = n[:, :, None] * n[:, None, :]
    across = np.eye(3) - nn
    trial = -hold * np.einsum("nij,nj->ni", across, past)
    size = np.linalg.norm(trial, axis=1)
    limit = problem.friction * push if np.isfinite(problem.friction) else np.inf
    slipping = held & (size > limit)
    share = np.where(slipping, limit / np.maximum(size, 1e-300), 1.0)
    traction = trial * share[:, None]
    direction = trial / np.maximum(size, 1e-300)[:, None]

    # d n = across/|reach| dx;  d(across past) = across dx − (dn (n·past) + n (past·dn))
    dn = across / distance[:, None, None]
    along = np.einsum("ni,ni->n", n, past)
    d_trial = -hold * (
        across - along[:, None, None] * dn - n[:, :, None] * np.einsum("ni,nij->nj", past, dn)[:, None, :]
    )
    d_push = -penalty * n
    on_sphere = np.eye(3) - direction[:, :, None] * direction[:, None, :]
    friction = problem.friction if np.isfinite(problem.friction) else 0.0
    d_slip = friction * direction[:, :, None] * d_push[:, None, :] + share[:, None, None] * (
        on_sphere @ d_trial
    )
    d_traction = np.where(slipping[:, None, None], d_slip, d_trial) * held[:, None, None]
    d_normal = n[:, :, None] * d_push[:, None, :] + push[:, None, None] * dn
    slope = np.where(active[:, None, None], d_normal, 0.0) + d_traction
    area = pad.area
    next_stick = np.where(active[:, None], reach + traction / hold, np.nan)
    return _Touch(
        force_n=area[:, None] * (push[:, None] * n + traction),
        tangent=-area[:, None, None] * slope,
        next_stick_mm=next_stick,
        slipping=slipping,
        push_n=area * push,
    )


@dataclass(frozen=True)
class _Iterate:
    """A trial of the displacements: its stiffness, contact and out-of-balance forces at the free dofs."""

    u: Floats
    matrix: sparse.csc_matrix
    touch: _Touch
    residual: Floats

    @classmethod
    def at(cls, pad: _Pad, u: Floats, sphere_mm: Floats, stick_mm: Floats) -> "_Iterate":
        force, matrix = pad.assemble(u)
        touch = _touch(pad, u, sphere_mm, stick_mm)
        force[pad.surface_dofs] -= touch.force_n
        return cls(u, matrix, touch, force[pad.free])

    @property
    def size(self) -> float:
        return float(np.linalg.norm(self.residual))


def _newton(pad: _Pad, state: _Contact, sphere_mm: Floats) -> _Contact:
    """Solve for equilibrium with the sphere at `sphere_mm`; raises FloatingPointError when that fails."""
    problem = pad.problem
    tolerance = RESIDUAL_TOLERANCE * problem.young_modulus_mpa * problem.sphere_radius_mm**2
    # The contact's forces change as if its nodes had moved against the sphere's motion.
    start = _Iterate.at(pad, state.u, state.sphere_mm, state.stick_mm)
    moved = np.einsum("nij,j->ni", start.touch.tangent, sphere_mm - state.sphere_mm)
    load = np.zeros(pad.size)
    load[pad.surface_dofs] = moved
    change = _solve(pad, start, load[pad.free] - start.residual)
    iterate = _damped(pad, state.u, change, sphere_mm, state.stick_mm, math.inf)
    for _ in range(NEWTON_LIMIT):
        if iterate.size < tolerance:
            return _Contact(sphere_mm, iterate.u, iterate.touch.next_stick_mm)
        change = _solve(pad, iterate, -iterate.residual)
        iterate = _damped(pad, iterate.u, change, sphere_mm, state.stick_mm, iterate.size)
    raise FloatingPointError("Newton's method does not settle")


def _solve(pad: _Pad, iterate: _Iterate, right_side: Floats) -> Floats:
    return solve_tangent(iterate.matrix, pad.surface_dofs, iterate.touch.tangent, pad.free, right_side)


def _damped(
    pad: _Pad, u: Floats, change: Floats, sphere_mm: Floats, stick_mm: Floats, size: float
) -> _Iterate:
    """Take the longest share of `change` that lowers the residual's size, or the one that raises it least."""
    best = None
    for share in (1.0, 0.5, 0.25, 0.125):
        try:
            iterate = _Iterate.at(pad, u + share * change, sphere_mm, stick_mm)
        except FloatingPointError:
            continue
        if iterate.size < size:
            return iterate
        if best is None or iterate.size < best.size:
            best = iterate
    if best is None:
        raise FloatingPointError("no share of the Newton step keeps the elements' volume")
    return best


def _advance(pad: _Pad, state: _Contact, sphere_mm: Floats) -> _Contact:
    """Move the sphere to `sphere_mm`, in shorter steps where Newton's method fails at once."""
    start, done, step = state.sphere_mm, 0.0, 1.0
    while done < 1.0:
        share = min(done + step, 1.0)
        try:
            state = _newton(pad, state, start + share * (sphere_mm - start))
        except FloatingPointError as failure:
            step /= 2
            if step < SMALLEST_STEP:
                raise RuntimeError(f"drag of {pad.problem} fails near {sphere_mm}: {failure}") from None
        else:
            done = share
    return state


def _describe(pad: _Pad, state: _Contact) -> DragState:
    touch = _touch(pad, state.u, state.sphere_mm, state.stick_mm)
    push = touch.push_n.sum()
    return DragState(
        travel_mm=float(state.sphere_mm[0]),
        force_n=2 * touch.force_n.sum(0) * [1, 0, 1],
        sticking_fraction=float(1 - touch.push_n[touch.slipping].sum() / push) if push > 0 else 1.0,
    )
