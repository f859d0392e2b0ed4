"""The membranes around pressed spheres: solves of a soft gel at some depths, as profiles for any depth."""

from collections.abc import Iterable

import numpy as np

from gelgap import sim
from gelgap.calibrate.profiles import PressProfiles, SolvedPress

# Depths that are solved, in radii of the sphere.
DEPTHS_IN_RADII = (0.075, 0.15, 0.225, 0.3, 0.375, 0.45, 0.525, 0.6, 0.65, 0.7, 0.75, 0.8, 0.85, 0.9, 0.95)
_DEEPEST_IN_THICKNESSES = 0.6
_BEYOND = 1.3
CALIBRATION_GEL = sim.Elastomer(
    young_modulus_mpa=0.3, poisson_ratio=0.48, friction=0.5, thickness_mm=4.0, pad_size_mm=(40.0, 40.0)
)
"""What a gel is taken for; from 4 mm on, pictures of presses hardly depend on it."""


def sphere_profiles(
    diameters_mm: Iterable[float], deepest_mm: float | None = None, quality: str = "draft"
) -> dict[float, PressProfiles]:
    """Return the membrane around spheres of some diameters, by diameter, down to a depth or as deep as can be.

    Raises
    ------
    ValueError
        If a diameter is not one that can be pressed.
    RuntimeError
        If too few depths were solved.
    """
    limit_mm = _DEEPEST_IN_THICKNESSES * CALIBRATION_GEL.thickness_mm
    profiles = {}
    for diameter_mm in set(diameters_mm):
        radius_mm = diameter_mm / 2
        depths = [share * radius_mm for share in DEPTHS_IN_RADII if share * radius_mm <= limit_mm]
        if deepest_mm is not None:
            needed = sum(depth < _BEYOND * deepest_mm for depth in depths) + 1
            depths = depths[: max(needed, 3)]
        poses = tuple(sim.Pose(depth_mm=depth) for depth in depths)
        states = sim.solve_poses(CALIBRATION_GEL, sim.Sphere(diameter_mm=diameter_mm), poses, quality)
        solves = []
        for depth, state in zip(depths, states, strict=True):
            if state.converged:
                row, first = len(state.y_mm) // 2, len(state.x_mm) // 2
                x, _, z = np.asarray(state.displacement_mm[row, first:], float).T
                solves.append(SolvedPress(depth, state.x_mm[first:] + x, z, state.contact_radius_mm))
        if len(solves) < 3:
            raise RuntimeError(
                f"only {len(solves)} of {len(depths)} depths of a {diameter_mm} mm sphere converged"
            )
        profiles[diameter_mm] = PressProfiles.from_solves(radius_mm, solves)
    return profiles
