"""A rigid sphere against the nodes of a surface: a stiff penalty, and Coulomb friction by return mapping.

Contact is collocated at the displaced nodes against the exact sphere (Wriggers, Computational Contact Mechanics, 2006,
ch. 5). Vectors have d components: (r, z) with symmetry about an axis, (x, y, z) without.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

# Where a step has ended in slip, the next one starts on Coulomb's cone: rounding must not decide that it sticks.
ON_THE_CONE = 1 - 1e-9


@dataclass(frozen=True)
class Touch:
    """Contact at one iterate, by surface node (k).

    `force_n` (k, d) is the sphere's force on a node and `tangent` (k, d, d) its negative derivative by the node's
    position, `pressure_mpa` (k,) and `shear_mpa` (k, d) are per undeformed area. `stick_mm` (k, d) is where a node
    will stick from then on, measured from the sphere's centre: where it is if it sticks, dragged along if it slips,
    NaN if it is free.
    """

    force_n: Floats
    tangent: Floats
    pressure_mpa: Floats
    shear_mpa: Floats
    slipping: NDArray[np.bool_]
    stick_mm: Floats


@dataclass(frozen=True)
class SphereContact:
    """A sphere that touches the surface at the origin where it is not displaced.

    Nodes enter the sphere by pressure / `penalty` and give way by shear / `stick_stiffness`, both in MPa/mm. `friction`
    is Coulomb's coefficient: 0 slips freely, `inf` never slips.
    """

    radius_mm: float
    friction: float
    penalty: float
    stick_stiffness: float

    def touch(self, position_mm: Floats, area_mm2: Floats, sphere_mm: Floats, stick_mm: Floats) -> Touch:
        """Return the contact of nodes at a position (k, d) with the sphere displaced by `sphere_mm` (d,)."""
        identity = np.eye(len(sphere_mm))
        from_centre = position_mm - sphere_mm - self.radius_mm * identity[-1]
        distance = np.linalg.norm(from_centre, axis=1)
        normal = from_centre / distance[:, None]
        across = identity - _outer(normal, normal)
        d_normal = across / distance[:, None, None]
        gap = distance - self.radius_mm
        active = gap < 0
        pressure = np.where(active, -self.penalty * gap, 0.0)
        d_pressure = np.where(active[:, None], -self.penalty * normal, 0.0)

        # The trial shear opposes the offset from the stick point along the sphere: −k (1 − n⊗n)·offset.
        held = active & ~np.isnan(stick_mm[:, 0]) & (self.friction > 0)
        offset = np.where(held[:, None], from_centre - np.nan_to_num(stick_mm), 0.0)
        inward = np.einsum("ni,ni->n", normal, offset)
        trial = -self.stick_stiffness * np.einsum("nij,nj->ni", across, offset)
        d_offset = across - inward[:, None, None] * d_normal
        d_offset -= _outer(normal, np.einsum("ni,nij->nj", offset, d_normal))
        d_trial = np.where(held[:, None, None], -self.stick_stiffness * d_offset, 0.0)

        # Return mapping: shear that Coulomb's cone does not allow is cut back to it.
        size = np.linalg.norm(trial, axis=1)
        limit = self.friction * pressure if np.isfinite(self.friction) else np.full_like(pressure, np.inf)
        slipping = held & (size > ON_THE_CONE * limit)
        kept = np.where(slipping, limit, 1.0) / np.where(slipping, size, 1.0)
        direction = trial / np.where(size > 0, size, 1.0)[:, None]
        shear = trial * kept[:, None]
        turning = kept[:, None, None] * ((identity - _outer(direction, direction)) @ d_trial)
        d_slip = (self.friction if slipping.any() else 0.0) * _outer(direction, d_pressure) + turning
        d_shear = np.where(slipping[:, None, None], d_slip, d_trial)

        d_traction = _outer(normal, d_pressure) + pressure[:, None, None] * d_normal + d_shear
        return Touch(
            force_n=area_mm2[:, None] * (pressure[:, None] * normal + shear),
            tangent=-area_mm2[:, None, None] * d_traction,
            pressure_mpa=pressure,
            shear_mpa=shear,
            slipping=slipping,
            stick_mm=np.where(active[:, None], from_centre + shear / self.stick_stiffness, np.nan),
        )


def _outer(a: Floats, b: Floats) -> Floats:
    return a[:, :, None] * b[:, None, :]
