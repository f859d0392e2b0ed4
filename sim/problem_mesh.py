"""The mesh that a contact problem deserves: fine where the gel will be touched, coarse elsewhere."""

import math

from gelgap.sim.mesh import GelMesh, half_disc_mesh, layer_depths, pad_mesh
from gelgap.sim.problem import ContactProblem

# The sphere of 1.5 mm at 1 mm depth, for which the qualities' lengths are given, meets the plane in this radius.
_REFERENCE_CONTACT_MM = math.sqrt(2.0)
# Gel further from the contact than this does not matter, and is not meshed.
_DISC_THICKNESSES = 3.3
# MuJoCo's factor of a whole pad takes five times the work of half a disc's, so that the pad is meshed more coarsely:
# vertices further apart by a factor, and cells that grow faster away from the contact.
_PAD_COARSENING = {"draft": 1.25, "standard": 1.6, "fine": 1.6}
_PAD_GROWTH = 1.8


def mesh_for(problem: ContactProblem) -> GelMesh:
    """Mesh the gel finely where it will be touched; vertices lie no closer than the largest contact deserves."""
    quality, whole = problem.quality, not (problem.pad_mm is None and problem.half)
    contact = problem.contact_mm
    scale = max(
        min(problem.sphere_radius_mm / 1.5, problem.thickness_mm / 3.0), contact / _REFERENCE_CONTACT_MM
    )
    if whole:
        scale *= _PAD_COARSENING[quality.name]
    spacing = quality.surface_mm * scale
    layers = layer_depths(
        problem.thickness_mm,
        min(quality.layer_mm * scale, problem.thickness_mm / 6),
        _PAD_GROWTH if whole else quality.layer_growth,
    )
    fine = 1.15 * contact + problem.reach_mm + (1 if whole else 2) * spacing
    disc = max(_DISC_THICKNESSES * problem.thickness_mm, 1.5 * fine)
    if not whole:
        return half_disc_mesh(disc, fine, spacing, layers, quality.sectors)
    return pad_mesh(
        problem.pad_mm or (-math.inf, math.inf, -math.inf, math.inf),
        disc,
        fine,
        spacing,
        layers,
        quality.sectors,
        half=problem.half,
        ring_growth=_PAD_GROWTH,
    )
