"""Closed forms of sphere contact: Hertz, the bonded layer and Cattaneo–Mindlin. Checks, not truth.

Units are mm, N and MPa. Forces are magnitudes (positive under compression); the rest of gelgap counts
compression as Fz < 0. Every argument may be an array; arguments broadcast.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]


def shear_modulus_mpa(young_modulus_mpa: ArrayLike, poisson_ratio: ArrayLike) -> Floats:
    """Return μ = E / 2(1+ν), MPa."""
    return np.asarray(young_modulus_mpa) / (2 * (1 + np.asarray(poisson_ratio)))


def bulk_modulus_mpa(young_modulus_mpa: ArrayLike, poisson_ratio: ArrayLike) -> Floats:
    """Return K = E / 3(1−2ν), MPa."""
    return np.asarray(young_modulus_mpa) / (3 * (1 - 2 * np.asarray(poisson_ratio)))


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


def bonded_layer_force_n(
    young_modulus_mpa: ArrayLike, indenter_radius_mm: ArrayLike, thickness_mm: ArrayLike, depth_mm: ArrayLike
) -> Floats:
    """Return the force on an incompressible layer bonded to a rigid backing, N.

    F = 16/9 · E · √R · d^1.5 · (1 + 1.133χ + 1.283χ² + 0.769χ³ + 0.0975χ⁴) with χ = √(R d)/h
    (Dimitriadis et al. 2002, Biophys. J. 82:2798). Small strain, no friction, paraboloid, χ ≤ 1. Against
    converged finite elements of R = 1.5 mm on 3 mm it is within 0.7 % at d ≤ 0.2 mm.
    """
    chi = hertz_contact_radius_mm(indenter_radius_mm, depth_mm) / np.asarray(thickness_mm)
    correction = 1 + 1.133 * chi + 1.283 * chi**2 + 0.769 * chi**3 + 0.0975 * chi**4
    return hertz_force_n(young_modulus_mpa, 0.5, indenter_radius_mm, depth_mm) * correction


def partial_slip_force_n(
    young_modulus_mpa: ArrayLike,
    poisson_ratio: ArrayLike,
    indenter_radius_mm: ArrayLike,
    depth_mm: ArrayLike,
    friction: ArrayLike,
    shear_mm: ArrayLike,
) -> Floats:
    """Return the tangential force of a sphere pressed and then moved sideways, N (Cattaneo–Mindlin).

    Q = μ P (1 − (1 − s/s*)^1.5) up to the displacement s* = 3 μ P (2−ν) / (16 a G) of full slip, and μ P
    beyond (Johnson 1985, eq. 7.42, one elastic body, no rotation; P, a are Hertz's). Half-space, a ≪ R.
    """
    normal = hertz_force_n(young_modulus_mpa, poisson_ratio, indenter_radius_mm, depth_mm)
    radius = hertz_contact_radius_mm(indenter_radius_mm, depth_mm)
    shear_modulus = shear_modulus_mpa(young_modulus_mpa, poisson_ratio)
    limit = np.asarray(friction) * normal
    full_slip_mm = 3 * limit * (2 - np.asarray(poisson_ratio)) / (16 * radius * shear_modulus)
    stuck = np.clip(1 - np.asarray(shear_mm) / full_slip_mm, 0, 1)
    return limit * (1 - stuck**1.5)
