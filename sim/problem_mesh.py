"""The mesh that a contact problem deserves: fine where the gel will be touched, coarse elsewhere."""

import math

from gelgap.sim.mesh import GelMesh, half_disc_mesh, layer_depths, pad_mesh
from gelgap.sim.problem import ContactProblem, contact_mm

# The sphere of 1.5 mm at 1 mm depth, for which the qualities' lengths are given, meets the plane in this radius.
_REFERENCE_CONTACT_MM = math.sqrt(2.0)
# Gel further from the contact than this does not matter, and is not meshed.
_DISC_THICKNESSES = 3.3


def mesh_scale(sphere_radius_mm: float, thickness_mm: float, depth_mm: float) -> float:
    """Return by how much a scene's mesh is coarser than that which the qualities' lengths are given for."""
    contact = contact_mm(sphere_radius_mm, depth_mm)
    return max(min(sphere_radius_mm / 1.5, thickness_mm / 3.0), contact / _REFERENCE_CONTACT_MM)


def mesh_for(problem: ContactProblem) -> GelMesh:
    """Mesh the gel finely where it will be touched; vertices lie no closer than the largest contact deserves."""
    size, contact = problem.mesh_size, problem.contact_mm
    scale = mesh_scale(problem.sphere_radius_mm, problem.thickness_mm, problem.depth_mm)
    spacing = size.surface_mm * scale
    first_mm = min(size.layer_mm * scale, size.layer_growth * problem.thickness_mm / 6)
    layers = layer_depths(problem.thickness_mm, first_mm, size.layer_growth)
    fine = 1.15 * contact + problem.reach_mm + spacing
    disc = max(_DISC_THICKNESSES * problem.thickness_mm, 1.5 * fine)
    if problem.on_half_disc:
        return half_disc_mesh(disc, fine, spacing, layers, size.sectors, size.ring_growth)
    return pad_mesh(
        problem.pad_mm or (-math.inf, math.inf, -math.inf, math.inf),
        disc,
        fine,
        spacing,
        layers,
        size.sectors,
        half=problem.half,
        ring_growth=size.ring_growth,
    )
