"""The membrane around a pressed sphere as a calibration needs it: height over distance from the axis, for any depth."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np

STEP_MM = 0.02
GRID_MM = 0.1
_DEPTHS = 64
_TOUCHING_MM = 0.004
# Profiles reach further out than the solves by this factor; there they decay as the solves do over their last mm.
_BEYOND, _DECAY_MM = 2.5, 1.5
_MOST_MARKED = 1.12  # of the largest contact's radius: marks by hand are up to so much larger than found ones
# By what share of the distance from the edge they are smoothed, by as much nearer than this; and in how many steps.
_SMOOTHED, _SHARP_MM, _TURNS = 0.15, 0.2, 400


@dataclass(frozen=True)
class SolvedPress:
    """One straight press by a sphere: the membrane's points (n,) along a radius, deformed, and its contact's radius."""

    depth_mm: float
    radius_mm: np.ndarray = field(repr=False)
    z_mm: np.ndarray = field(repr=False)
    contact_radius_mm: float


@dataclass(frozen=True)
class PressProfiles:
    """z over the distance from the axis, every `STEP_MM`, for a row of depths in equal steps from 0.

    Inside the contact it is the sphere exactly, outside a monotone cubic through solved points. With a softness it is
    blurred by a Gaussian of that standard deviation, as a camera sees it whose point spread is as wide.
    """

    sphere_radius_mm: float
    depths_mm: np.ndarray = field(repr=False)  # (depths,)
    z_mm: np.ndarray = field(repr=False)  # (depths, radii)
    edges_mm: np.ndarray = field(repr=False)  # (solves + 1, 2): depth, how far out the membrane is the sphere
    contact_radii_mm: np.ndarray = field(repr=False)  # (solves + 1, 2): depth, radius of the contact
    softness_mm: float = 0.0

    @classmethod
    def from_solves(cls, sphere_radius_mm: float, solves: Sequence[SolvedPress]) -> "PressProfiles":
        """Return the profiles through straight presses of growing depth, two or more."""
        from scipy.interpolate import PchipInterpolator

        reach_mm = min(press.radius_mm.max() for press in solves)
        radii = np.arange(0, _BEYOND * reach_mm, STEP_MM)
        rows, edges = [np.zeros(len(radii))], [0.0]
        for press in solves:
            row, edge = _profile(press, sphere_radius_mm, radii, reach_mm)
            rows.append(row)
            edges.append(edge)
        depths = np.array([0.0, *(press.depth_mm for press in solves)])
        even = np.linspace(0, depths[-1], _DEPTHS)
        # A cubic over depth would overshoot where the contact's edge passes; the monotone one does not.
        z_mm = PchipInterpolator(depths, np.array(rows), axis=0)(even)
        contact = np.maximum.accumulate([0.0, *(press.contact_radius_mm for press in solves)])
        return cls(
            sphere_radius_mm, even, z_mm, np.column_stack([depths, edges]), np.column_stack([depths, contact])
        )

    @property
    def deepest_mm(self) -> float:
        return float(self.depths_mm[-1]) - 0.01

    def at(self, depth_mm: float) -> tuple[np.ndarray, np.ndarray]:
        """Return z in mm and its slope over the distance from the axis."""
        at = np.clip(depth_mm / self.depths_mm[1], 0, len(self.depths_mm) - 1.001)
        lower = int(at)
        share = at - lower
        solved = (1 - share) * self.z_mm[lower] + share * self.z_mm[lower + 1]
        r = STEP_MM * np.arange(len(solved))
        inside = r < np.interp(depth_mm, *self.edges_mm.T) - STEP_MM
        sphere = _sphere(self.sphere_radius_mm, depth_mm, r)
        z = np.where(inside, sphere, np.minimum(solved, 0.1 * self.sphere_radius_mm))
        z = np.where(r < self.sphere_radius_mm, np.minimum(z, sphere), z)  # never inside the sphere
        if self.softness_mm > 0:
            # Blurred in the plane, by Gauss–Hermite quadrature.
            nodes, weights = np.polynomial.hermite_e.hermegauss(7)
            x, y = (self.softness_mm * axis.ravel() for axis in np.meshgrid(nodes, nodes))
            weights = np.outer(weights, weights).ravel() / (2 * np.pi)
            z = np.interp(np.hypot(r[:, None] + x, y), r, z) @ weights
            return z, np.gradient(z, STEP_MM)
        of_sphere = r / np.sqrt(np.maximum(self.sphere_radius_mm**2 - r**2, 1e-9))
        return z, np.where(inside, of_sphere, np.gradient(z, STEP_MM))

    def contact_radius_mm(self, depth_mm: float) -> float:
        """Return the contact's radius at a depth: a smooth curve through the solves'."""
        return float(np.interp(depth_mm, *self._smooth_radii()))

    def depth_mm(self, contact_radius_mm: float) -> float:
        """Return the depth at which the contact has a radius.

        Raises
        ------
        ValueError
            If the sphere's cap cannot reach that radius.
        """
        depths, radii = self._smooth_radii()
        if contact_radius_mm > _MOST_MARKED * radii[-1]:
            raise ValueError(
                f"a contact of radius {contact_radius_mm:.2f} mm is marked, and a sphere of radius "
                f"{self.sphere_radius_mm:g} mm reaches {radii[-1]:.2f} mm at most; check sphere_diameter_mm, radius_px "
                "and the camera's field of view"
            )
        return float(np.interp(contact_radius_mm, radii, depths))

    def _smooth_radii(self) -> tuple[np.ndarray, np.ndarray]:
        depths, radii = self.contact_radii_mm[1:].T
        degree = min(3, len(depths) - 1)
        fine = np.linspace(depths[0], depths[-1], 400)
        smooth = np.polyval(np.polyfit(np.sqrt(depths), radii, degree), np.sqrt(fine))
        return np.r_[0, fine], np.r_[0, np.maximum.accumulate(smooth)]

    def volume_mm3(self, depth_mm: float) -> float:
        """Return the volume of what stands above the flat membrane."""
        z, _ = self.at(depth_mm)
        r = STEP_MM * np.arange(len(z))
        return float(np.sum(np.maximum(-z, 0) * 2 * np.pi * r) * STEP_MM)

    def membrane(
        self, point_mm: tuple[float, float], depth_mm: float, half_extent_mm: tuple[float, float]
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return x_mm, y_mm and displacement_mm of a press as renderers take it; every point moves straight."""
        x, y = (
            GRID_MM * np.arange(-round(half / GRID_MM), round(half / GRID_MM) + 1) for half in half_extent_mm
        )
        z, _ = self.at(depth_mm)
        r = np.hypot(*np.meshgrid(x - point_mm[0], y - point_mm[1]))
        height = np.interp(r, STEP_MM * np.arange(len(z)), z, right=0.0)
        return x, y, np.stack([np.zeros_like(height), np.zeros_like(height), height], axis=-1)


def _sphere(radius_mm: float, depth_mm: float, r: np.ndarray) -> np.ndarray:
    """Return the z of a sphere that is pressed down to a depth, at distances from its axis."""
    return -depth_mm + radius_mm - np.sqrt(np.maximum(radius_mm**2 - r**2, 1e-9))


def _profile(press: SolvedPress, sphere_radius_mm: float, radii: np.ndarray, reach_mm: float):
    """Return z at the radii, beyond `reach_mm` decaying as it did before, and where the membrane leaves the sphere."""
    from scipy.interpolate import PchipInterpolator
    from scipy.ndimage import gaussian_filter1d

    r, z, sphere = press.radius_mm, press.z_mm, partial(_sphere, sphere_radius_mm, press.depth_mm)
    gap = np.hypot(r, z - (sphere_radius_mm - press.depth_mm)) - sphere_radius_mm
    touching = np.flatnonzero(gap < _TOUCHING_MM)
    edge = float(r[touching.max()]) if touching.size else 0.0
    outside = r > edge + 0.03
    inner = edge * np.array([0.9, 0.97, 1.0]) if edge > 0 else np.array([0.0])
    known_r, known_z = np.concatenate([inner, r[outside]]), np.concatenate([sphere(inner), z[outside]])
    known_r, first = np.unique(known_r, return_index=True)
    beyond = PchipInterpolator(known_r, known_z[first])
    before, last = beyond((reach_mm - _DECAY_MM, reach_mm))
    decays = np.log(np.clip(before / last, 1.2, 2.7) if last else 2.7) / _DECAY_MM  # per mm
    # A coarse mesh leaves ripples, whose slopes show: they are smoothed the more, the farther from the edge.
    turn = np.linspace(0, np.arcsinh((_BEYOND * reach_mm - edge) / _SHARP_MM), _TURNS)
    away = edge + _SHARP_MM * np.sinh(turn)
    solved = beyond(np.minimum(away, reach_mm)) * np.exp(decays * np.minimum(reach_mm - away, 0))
    smooth = gaussian_filter1d(solved, _SMOOTHED / turn[1], mode="nearest")
    outer = PchipInterpolator(away, smooth)(np.maximum(radii, edge))
    return np.where(radii < edge, sphere(radii), outer), edge
