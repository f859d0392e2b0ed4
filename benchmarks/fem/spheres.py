"""A rigid sphere that presses a bonded pad, solved with symmetry about the axis.

The project's own check of MuJoCo's forces and surfaces, which shares nothing with it; a user is never given its results
as a frame. It is also the solver behind `equivalent_moduli`. Elements are biquadratic quadrilaterals in (r, z) whose
volume ratio is projected on linear functions (Q2/P1 discontinuous: Simo & Taylor 1991, Comput. Methods Appl. Mech. Eng.
85:273). Units are mm, N and MPa.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.polynomial.legendre import leggauss

from gelgap.benchmarks.fem.indentation import (
    Element,
    Floats,
    Indentation,
    NeoHookean,
    Pad,
    SphereContact,
    StableNeoHookean,
    State,
)
from gelgap.benchmarks.fem.theory import hertz_contact_radius_mm

# 1/mm: a node enters the sphere by pressure / (first · E), some 0.05 µm; where it sticks it gives way by shear /
# (second · E), some 1 µm.
STIFFNESS = (1e4, 3e2)
TOLERANCE = 1e-8  # of the modulus times the sphere's radius squared
GROWTH = 1.18  # ratio of neighbouring elements away from the contact
# With nothing of the volumetric modulus on J itself, the Stable Neo-Hookean form's −μ (J−1) softens what the projection
# does not see, and a frictionless press collapses; biquadratic elements do not lock at this ratio (that of ν = 0.45).
POINTWISE_PER_SHEAR = 10.0


@dataclass(frozen=True)
class Press:
    """One axisymmetric press problem.

    `energy` is "isochoric" for μ/2 (J^(−2/3) I₁ − 3) + K/2 (J−1)², or "stable" for MuJoCo's Stable
    Neo-Hookean μ/2 (I₁−3) − μ (J−1) + (λ+μ)/2 (J−1)². `friction` is Coulomb's coefficient: 0 slips freely,
    `inf` never slips. `element_mm` is the edge of an element at the contact (nodes are half as far apart).
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

    def __str__(self) -> str:
        return (
            f"R{self.indenter_radius_mm:g} h{self.thickness_mm:g} ν{self.poisson_ratio:g} μ{self.friction:g}"
        )

    @property
    def material(self) -> NeoHookean:
        energy = NeoHookean if self.energy == "isochoric" else StableNeoHookean
        return energy(self.young_modulus_mpa, self.poisson_ratio)


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
    depths = np.array([0.0, *depths_mm])
    if len(depths) < 2 or np.any(np.diff(depths) <= 0) or depths[-1] >= problem.thickness_mm:
        raise ValueError(f"depths_mm = {tuple(depths_mm)} must rise within (0, {problem.thickness_mm})")
    radius = problem.indenter_radius_mm
    young_mpa = problem.young_modulus_mpa
    contact = SphereContact(radius, problem.friction, *(factor * young_mpa for factor in STIFFNESS))
    scene = Indentation(section_of_pad(problem, depths[-1]), contact, TOLERANCE * young_mpa * radius**2)
    state, reached, states = scene.untouched(), 0.0, []
    for depth in depths[1:]:
        while reached < depth:
            # Hertz's contact radius √(R d) grows by `nodes_per_step` nodes.
            contact_mm = hertz_contact_radius_mm(radius, reached) + nodes_per_step * problem.element_mm / 2
            target = contact_mm**2 / radius
            reached = target if depth - target >= 1e-3 * depth else depth
            state = scene.advance(state, np.array([0.0, -reached]))
        states.append(_press_state(scene.pad, state))
    return tuple(states)


def section_of_pad(problem: Press, deepest_mm: float) -> Pad:
    """Return half the section of a round pad: the axis at r = 0, the membrane at z = 0 and the backing below."""
    contact = hertz_contact_radius_mm(problem.indenter_radius_mm, deepest_mm)
    ring = min(1.15 * contact, 1.2 * problem.indenter_radius_mm)
    r = _graded(ring, problem.pad_radius_mm, problem.element_mm, problem.thickness_mm / 4)
    z = -_graded(0, problem.thickness_mm, problem.element_mm, problem.thickness_mm / 6)[::-1]
    index = np.arange(len(r) * len(z)).reshape(len(r), len(z))
    offsets = (np.arange(3)[:, None] * len(z) + np.arange(3)).ravel()
    material = problem.material
    return Pad(
        nodes=np.stack(np.meshgrid(r, z, indexing="ij"), axis=-1).reshape(-1, 2),
        connectivity=index[:-2:2, :-2:2].reshape(-1, 1) + offsets,
        element=_biquadratic(),
        material=material,
        fixed_dofs=np.concatenate([2 * index[:, 0], 2 * index[:, 0] + 1, 2 * index[0]]),  # backing; axis
        surface=index[:, -1],
        surface_area_mm2=_nodal_areas_mm2(r),
        pointwise_mpa=min(material.volumetric_modulus_mpa, POINTWISE_PER_SHEAR * material.shear_modulus_mpa),
    )


def _biquadratic() -> Element:
    """Return the element of nine nodes with 3×3 Gauss points; J is projected on linear functions."""
    points, weights = leggauss(3)
    values, slopes = _quadratic(points)
    along_r, along_z = (
        np.einsum("ai,bj->abij", *factors).reshape(9, 9) for factors in ((slopes, values), (values, slopes))
    )
    return Element(
        shape=np.einsum("ai,bj->abij", values, values).reshape(9, 9),
        slope=np.stack([along_r, along_z], axis=-1),
        weights=np.outer(weights, weights).ravel(),
        modes=np.stack([np.ones(9), np.repeat(points, 3), np.tile(points, 3)], axis=-1),
    )


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


def _press_state(pad: Pad, state: State) -> PressState:
    r = pad.nodes[pad.surface, 0]
    u_r, u_z = state.u[pad.surface_dofs].T
    j = pad.deformation(state.u)[1]
    pressure = state.touch.pressure_mpa
    return PressState(
        depth_mm=float(-state.sphere_mm[1]),
        force_n=float(state.touch.force_n[:, 1].sum()),
        contact_radius_mm=_edge_radius_mm(r + u_r, pressure),
        r_mm=r,
        u_r_mm=u_r,
        u_z_mm=u_z,
        pressure_mpa=pressure,
        shear_mpa=np.copysign(np.linalg.norm(state.touch.shear_mpa, axis=1), state.touch.shear_mpa[:, 0]),
        volume_change_mm3=float((pad.volume * (j - 1)).sum()),
        energy_mj=pad.energy_mj(state.u),
    )


def _edge_radius_mm(radius_mm: Floats, pressure_mpa: Floats) -> float:
    """Where the normal pressure vanishes: p² is linear in r near the edge, as in Hertz's p ∝ √(a² − r²)."""
    touching = np.flatnonzero(pressure_mpa > 0)
    last = touching[max(-8, -max(3, len(touching) // 4)) :]
    slope, intercept = np.polyfit(radius_mm[last], pressure_mpa[last] ** 2, 1)
    return float(-intercept / slope)
