"""The mesh that a contact problem deserves: fine where the gel will be touched, coarse elsewhere."""

import math

import numpy as np
from numpy.typing import NDArray

from gelgap.sim.mesh import GelMesh, box_mesh, graded_spacings, half_disc_mesh, layer_depths
from gelgap.sim.problem import ContactProblem

# The sphere of 1.5 mm at 1 mm depth, for which the qualities' lengths are given, meets the plane in this radius.
_REFERENCE_CONTACT_MM = math.sqrt(2.0)


def mesh_for(problem: ContactProblem) -> GelMesh:
    """Mesh the gel finely where it will be touched; vertices lie no closer than the largest contact deserves."""
    quality = problem.quality
    reach = max(math.hypot(x, y) for x, y, _ in problem.waypoints_mm)
    depth = max(-z for _, _, z in problem.waypoints_mm)
    radius = problem.sphere_radius_mm
    contact = math.sqrt(max(radius**2 - max(radius - depth, 0.0) ** 2, 0.0))
    scale = min(radius / 1.5, problem.thickness_mm / 3.0)
    spacing = quality.surface_mm * max(scale, contact / _REFERENCE_CONTACT_MM)
    first_layer = min(spacing * quality.layer_mm / quality.surface_mm, problem.thickness_mm / 6)
    layers = layer_depths(problem.thickness_mm, first_layer, quality.layer_growth)
    fine = 1.15 * contact + reach + 2 * spacing
    if problem.pad_mm is None:
        radius = max(3.3 * problem.thickness_mm, 1.5 * fine)
        return half_disc_mesh(radius, fine, spacing, layers, quality.sectors)
    x_min, x_max, y_min, y_max = problem.pad_mm
    spacing *= 1.6
    x_mm = _axis(x_min, x_max, spacing, fine)
    half = y_max == -y_min and all(y == 0 for _, y, _ in problem.waypoints_mm)
    y_mm = graded_spacings(y_max, spacing, fine) if half else _axis(y_min, y_max, spacing, fine)
    return box_mesh(x_mm, y_mm, layers, half=half)


def _axis(low: float, high: float, spacing: float, fine: float) -> NDArray[np.float64]:
    below, above = graded_spacings(-low, spacing, fine), graded_spacings(high, spacing, fine)
    return np.concatenate([-below[::-1], above[1:]])
