"""The mesh that a contact problem needs: fine where the gel will be touched, coarse elsewhere."""

import numpy as np
from numpy.typing import NDArray

from gelgap.sim.mesh.pad import GelMesh, layer_heights_mm, pad_mesh
from gelgap.sim.mesh.plane import DiscGrid
from gelgap.sim.mesh.scale import mesh_scale
from gelgap.sim.problem import ContactProblem

# Gel further from the contact than this does not matter, and is not meshed.
_DISC_THICKNESSES = 3.3
# What a contact wider than the gel is thick squeezes out bulges beside it, and matters as far as this beyond it.
_BESIDE_WIDE_CONTACT_THICKNESSES = 4.0
_SMALLEST_DISC = 1.5  # of the finely meshed radius
_FINE_MARGIN = 1.15  # of the penetration radius


def mesh_for(problem: ContactProblem) -> GelMesh:
    """Mesh the gel finely where it will be touched, at the spacing that the largest contact needs."""
    from gelgap.sim.mesh.ordering import ordered_for_elimination

    mesh = unordered_mesh(problem)
    return ordered_for_elimination(mesh, touchable_vertices(problem, mesh))


def touchable_vertices(problem: ContactProblem, mesh: GelMesh) -> NDArray[np.int64]:
    """Return the surface vertices that the indenter can touch on its way."""
    from gelgap.sim.mesh.ordering import touchable

    return touchable(mesh, problem.penetration_radius_mm, problem.segments_mm[:, :, :2])


def unordered_mesh(problem: ContactProblem) -> GelMesh:
    """Return the mesh of `mesh_for` before its vertices are put in the order of elimination."""
    size, thickness = problem.mesh_size, problem.thickness_mm
    scale = mesh_scale(problem.indenter, thickness, problem.depth_mm)
    spacing = size.surface_mm * scale
    first_layer = min(size.layer_mm * scale, size.layer_growth * thickness / 6)
    fine_radius = _FINE_MARGIN * problem.penetration_radius_mm + problem.travel_mm + spacing
    radius = max(_DISC_THICKNESSES * thickness, _SMALLEST_DISC * fine_radius)
    if problem.contact_width > 1:
        beside_mm = _BESIDE_WIDE_CONTACT_THICKNESSES * thickness
        radius = max(radius, problem.penetration_radius_mm + problem.travel_mm + beside_mm)
    return pad_mesh(
        DiscGrid(radius, fine_radius, spacing, size.sectors, size.ring_growth),
        layer_heights_mm(thickness, first_layer, size.layer_growth),
        problem.pad_mm,
        symmetric=problem.symmetric,
    )
