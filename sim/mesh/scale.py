"""The size of a contact, by which a quality's mesh is scaled to a scene."""

from gelgap.sim.indenters.base import Indenter
from gelgap.sim.indenters.sphere import Sphere

# The lengths of the qualities' meshes are given for this sphere, pad and depth.
_REFERENCE_INDENTER = Sphere(diameter_mm=3.0)
_REFERENCE_THICKNESS_MM = 3.0
_REFERENCE_DEPTH_MM = 1.0
# A contact wider than this many times the reference's, measured by the thickness, needs no coarser mesh than one as
# wide: the strains at its rim and the bulge beside it are as wide as the gel is thick.
_WIDEST_CONTACT = 1.2


def mesh_scale(indenter: Indenter, thickness_mm: float, depth_mm: float) -> float:
    """Return by which factor a scene's mesh is coarser than the one that a quality's lengths are given for."""
    size = indenter.feature_size_mm / _REFERENCE_INDENTER.feature_size_mm
    thickness = thickness_mm / _REFERENCE_THICKNESS_MM
    return max(min(size, thickness), min(_contact_scale(indenter, depth_mm), _WIDEST_CONTACT * thickness))


def contact_width(indenter: Indenter, thickness_mm: float, depth_mm: float) -> float:
    """Return the diameter of a contact, cut from the undeformed membrane, in thicknesses of the gel; 1 if smaller."""
    return max(1.0, 2 * indenter.penetration_radius_mm(depth_mm) / thickness_mm)


def _contact_scale(indenter: Indenter, depth_mm: float) -> float:
    reference_mm = _REFERENCE_INDENTER.penetration_radius_mm(_REFERENCE_DEPTH_MM)
    return indenter.penetration_radius_mm(depth_mm) / reference_mm
