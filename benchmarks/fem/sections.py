"""A long body on a bonded pad in plane strain: a section of a lying cylinder, or of a box, pressed and dragged across.

The elements and the contact are those of the 3-D drag, one element deep: what a body many thicknesses long does in its
middle. Forces are per mm of length. Units are mm, N and MPa.
"""

import math
from dataclasses import dataclass

import numpy as np

from gelgap.benchmarks.fem.indentation import Floats, Indentation, NeoHookean, Pad, SphereContact, State
from gelgap.benchmarks.fem.spheres import DRAG_STIFFNESS, trilinear

GROWTH = 1.15  # ratio of neighbouring elements away from the contact
DEEP_MM = 0.2  # the elements' size along the body, which changes nothing
BESIDE_THICKNESSES = 4.0


@dataclass(frozen=True)
class Section:
    """A section whose bottom is `flat_mm` wide between two quarter circles of `rounding_mm`: a cylinder's if 0 wide.

    The gel is isochoric neo-Hookean. `friction` is Coulomb's coefficient, `inf` never slips; `element_mm` is the edge
    of an element at the contact, and `furthest_mm` how far the body is dragged.
    """

    flat_mm: float
    rounding_mm: float
    friction: float
    furthest_mm: float = 0.0
    element_mm: float = 0.06
    thickness_mm: float = 3.0
    young_modulus_mpa: float = 0.3
    poisson_ratio: float = 0.48

    @property
    def half_mm(self) -> float:
        return self.flat_mm / 2 + self.rounding_mm


@dataclass(frozen=True)
class SectionState:
    """Where the body is (x, z), its force (x, z) per mm of length, and the surface: x, u_x and u_z (3, nodes)."""

    place_mm: tuple[float, float]
    force_n_per_mm: Floats
    surface_mm: Floats


def solve_section(
    problem: Section, places_mm: tuple[tuple[float, float], ...], step_mm: float = 0.02
) -> tuple[SectionState, ...]:
    """Lead the body in straight lines through places (travel, depth), from touching the gel on.

    Raises
    ------
    RuntimeError
        If Newton's method fails at the smallest step.
    """
    penalty, stick_stiffness = (factor * problem.young_modulus_mpa for factor in DRAG_STIFFNESS)
    core = (problem.flat_mm / 2, math.inf, 0.0)
    contact = SphereContact(problem.rounding_mm, problem.friction, penalty, stick_stiffness, core)
    pad = section_of_strip(problem)
    tolerance_n = 1e-6 * problem.young_modulus_mpa * DEEP_MM * problem.half_mm
    scene = Indentation(pad, contact, tolerance_n, largest_rise=1.0)
    state, states = scene.untouched(), []
    for travel, depth in places_mm:
        start, end = state.sphere_mm, np.array([travel, 0.0, -depth])
        steps = max(1, math.ceil(float(np.linalg.norm(end - start)) / step_mm - 1e-9))
        for share in np.arange(1, steps + 1) / steps:
            state = scene.advance(state, start + share * (end - start))
        states.append(_section_state(pad, state))
    return tuple(states)


def section_of_strip(problem: Section) -> Pad:
    """Return a strip of the pad: the membrane at z = 0, the backing below, and nothing that moves along the body."""
    size, thickness = problem.element_mm, problem.thickness_mm
    ahead = _graded(1.2 * problem.half_mm + problem.furthest_mm, BESIDE_THICKNESSES * thickness, size, 0.4)
    x = np.concatenate([-ahead[:0:-1], ahead])
    z = -_graded(0.2 * thickness, thickness, size, 0.15)[::-1]
    index = np.arange(2 * len(x) * len(z)).reshape(2, len(x), len(z))
    quads = [index[:, :-1, :-1], index[:, 1:, :-1], index[:, :-1, 1:], index[:, 1:, 1:]]
    (a, d), (b, c), (e, h), (f, g) = (corner.reshape(2, -1) for corner in quads)
    places = np.stack(np.meshgrid([0.0, DEEP_MM], x, z, indexing="ij"), axis=-1).reshape(-1, 3)
    bonded = index[:, :, 0].ravel()
    width = np.zeros(len(x))
    width[:-1] += np.diff(x) / 2
    width[1:] += np.diff(x) / 2
    return Pad(
        nodes=places[:, [1, 0, 2]],
        connectivity=np.stack([a, b, c, d, e, f, g, h], axis=-1),
        element=trilinear(),
        material=NeoHookean(problem.young_modulus_mpa, problem.poisson_ratio),
        fixed_dofs=np.unique(np.concatenate([3 * bonded, 3 * bonded + 2, 3 * np.arange(len(places)) + 1])),
        surface=index[:, :, -1].ravel(),
        surface_area_mm2=np.tile(width * DEEP_MM / 2, 2),
    )


def _graded(fine_until_mm: float, end_mm: float, element_mm: float, largest_mm: float) -> Floats:
    """Return nodes from 0 to `end_mm`: equal elements first, then growing ones."""
    sizes = [element_mm] * max(1, math.ceil(fine_until_mm / element_mm))
    while sum(sizes) < end_mm:
        sizes.append(min(sizes[-1] * GROWTH, largest_mm))
    nodes = np.concatenate([[0.0], np.cumsum(sizes)])
    return nodes * (end_mm / nodes[-1])


def _section_state(pad: Pad, state: State) -> SectionState:
    on_face = slice(0, len(pad.surface) // 2)
    u = state.u[pad.surface_dofs][on_face]
    return SectionState(
        place_mm=(float(state.sphere_mm[0]), float(-state.sphere_mm[2])),
        force_n_per_mm=state.touch.force_n.sum(axis=0)[[0, 2]] / DEEP_MM,
        surface_mm=np.stack([pad.nodes[pad.surface][on_face, 0], u[:, 0], u[:, 2]]),
    )
