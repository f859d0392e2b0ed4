"""A rigid sphere pressed into a bonded pad and dragged over it: mean-dilatation hexahedra of finite strain.

The project's own check of MuJoCo's forces under friction, for which no closed form and no table exists; a user is never
given its results as a frame. Elements are trilinear hexahedra whose volume ratio is averaged over the element (Q1/P0:
Nagtegaal, Parks & Rice 1974, Comput. Methods Appl. Mech. Eng. 4:153). Half the pad is meshed, since the drag goes
along x. Units are mm, N and MPa.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gelgap.benchmarks.fem.indentation import Indentation, SphereContact, State
from gelgap.benchmarks.fem.pad import Element, NeoHookean, Pad
from gelgap.sim.mesh import DiscGrid, half_disc, layer_heights_mm

Floats = NDArray[np.float64]

PENALTY_PER_MODULUS = 1e3  # 1/mm: the sphere is entered by pressure / (1e3 E), some 1 µm
STICK_PER_MODULUS = 5e2  # 1/mm: sticking nodes give way by shear / (5e2 E), some 1 µm
RESIDUAL_TOLERANCE = 1e-6  # of the modulus times the square of the sphere's radius


@dataclass(frozen=True)
class Drag:
    """A sphere pressed `depth_mm` deep, then moved along x without rotating.

    The gel is isochoric neo-Hookean. `friction` is Coulomb's coefficient, `inf` never slips. `element_mm` is the edge
    of an element at the contact, `sectors` the number of them around half of it.
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
    scene = Indentation(
        pad=half_pad(problem, furthest_mm=float(travels[-1])),
        contact=SphereContact(
            problem.sphere_radius_mm,
            problem.friction,
            penalty=PENALTY_PER_MODULUS * problem.young_modulus_mpa,
            stick_stiffness=STICK_PER_MODULUS * problem.young_modulus_mpa,
        ),
        tolerance_n=RESIDUAL_TOLERANCE * problem.young_modulus_mpa * problem.sphere_radius_mm**2,
        largest_rise=1.0,
    )
    state = scene.untouched()
    first = min(step_mm, problem.depth_mm) / 4
    for depth in np.append(np.arange(first, problem.depth_mm - 1e-9, step_mm), problem.depth_mm):
        state = scene.advance(state, np.array([0.0, 0.0, -depth]))
    states = []
    for travel in travels:
        start = state.sphere_mm[0]
        steps = max(1, math.ceil((travel - start) / step_mm - 1e-9))
        for x in start + (travel - start) * np.arange(1, steps + 1) / steps:
            state = scene.advance(state, np.array([x, 0.0, -problem.depth_mm]))
        states.append(_describe(scene.pad, state))
    return tuple(states)


def half_pad(problem: Drag, furthest_mm: float) -> Pad:
    """Return half a round pad, y ≥ 0, with the membrane at z = 0 and the backing below."""
    above = max(problem.sphere_radius_mm - problem.depth_mm, 0.0)
    contact = math.sqrt(problem.sphere_radius_mm**2 - above**2)
    plane, quads = half_disc(
        DiscGrid(problem.pad_radius_mm, 1.15 * contact + furthest_mm, problem.element_mm, problem.sectors)
    )
    layers = layer_heights_mm(problem.thickness_mm, 0.75 * problem.element_mm, 1.25)
    below = np.arange(1, len(layers))[:, None, None] * len(plane) + quads
    nodes = np.concatenate([np.column_stack([plane, np.full(len(plane), z)]) for z in layers])
    connectivity = np.concatenate([below, below - len(plane)], axis=-1).reshape(-1, 8)
    _, y, z = nodes.T
    surface = np.flatnonzero(z > -1e-9)
    bonded, mirror = np.flatnonzero(z < -problem.thickness_mm + 1e-9), np.flatnonzero(np.abs(y) < 1e-9)
    return Pad(
        nodes=nodes,
        connectivity=connectivity,
        element=_trilinear(),
        material=NeoHookean(problem.young_modulus_mpa, problem.poisson_ratio),
        fixed_dofs=np.concatenate([(3 * bonded[:, None] + np.arange(3)).ravel(), 3 * mirror + 1]),
        surface=surface,
        surface_area_mm2=_nodal_areas_mm2(nodes, connectivity, surface),
    )


def _trilinear() -> Element:
    """Return the element of eight nodes with 2×2×2 Gauss points; J is averaged."""
    corners = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)], float)
    corner = np.concatenate([np.column_stack([corners, np.full(4, z)]) for z in (-1.0, 1.0)])
    factor = (1 + corner[:, None, :] * corner / np.sqrt(3)) / 2  # (point, node, axis)
    slopes = [corner[:, i] / 2 * factor[..., (i + 1) % 3] * factor[..., (i + 2) % 3] for i in range(3)]
    return Element(factor.prod(axis=-1), np.stack(slopes, axis=-1), np.ones(8), np.ones((8, 1)))


def _nodal_areas_mm2(nodes: Floats, hexahedra: NDArray[np.int64], surface: NDArray[np.int64]) -> Floats:
    """Return the area of the outer membrane that belongs to each of its nodes."""
    quads = hexahedra[np.isin(hexahedra[:, 4:], surface).all(axis=1), 4:]
    corner = nodes[quads, :2]
    across, along = corner[:, 2] - corner[:, 0], corner[:, 3] - corner[:, 1]
    area = np.abs(across[:, 0] * along[:, 1] - across[:, 1] * along[:, 0]) / 2
    return np.bincount(quads.ravel(), np.repeat(area / 4, 4), len(nodes))[surface]


def _describe(pad: Pad, state: State) -> DragState:
    touch = state.touch
    push = touch.pressure_mpa * pad.surface_area_mm2
    return DragState(
        travel_mm=float(state.sphere_mm[0]),
        force_n=2 * touch.force_n.sum(0) * [1, 0, 1],
        sticking_fraction=float(1 - push[touch.slipping].sum() / push.sum()),
    )
