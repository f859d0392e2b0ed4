"""Closed forms of sphere contact: Hertz (`gelgap.sim` has the bonded layer). Approximate checks.

Units are mm, N and MPa. Forces are magnitudes (positive under compression); the rest of gelgap counts
compression as Fz < 0. Every argument may be an array; arguments broadcast.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]


def hertz_contact_radius_mm(indenter_radius_mm: ArrayLike, depth_mm: ArrayLike) -> Floats:
    """Return Hertz's contact radius a = √(R d), mm (Johnson 1985, eq. 4.22).

    Valid for a half-space and a ≪ R. A pad thinner than about 10 a spreads the contact further; a finite
    depth narrows it, since the sphere is not a paraboloid.
    """
    return np.sqrt(np.asarray(indenter_radius_mm) * np.asarray(depth_mm))


def hertz_force_n(
    young_modulus_mpa: ArrayLike, poisson_ratio: ArrayLike, indenter_radius_mm: ArrayLike, depth_mm: ArrayLike
) -> Floats:
    """Return Hertz's normal force F = 4/3 · E/(1−ν²) · √R · d^1.5, N (Johnson 1985, eq. 4.23).

    Valid without friction on a half-space, d ≪ R and √(R d) ≪ pad thickness.
    """
    plane_modulus = np.asarray(young_modulus_mpa) / (1 - np.asarray(poisson_ratio) ** 2)
    return 4 / 3 * plane_modulus * np.sqrt(indenter_radius_mm) * np.asarray(depth_mm) ** 1.5
