"""Acquisition errors: a misplaced rig and an inaccurate force sensor. Off by default."""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from gelgap.assets.settings import Settings
from gelgap.domains.random_streams import random_stream
from gelgap.sim import ContactPath, Pose

ContactSampling = Literal["paired", "independent"]

# Poses that agree share a solve; a micrometre is far below what a rig can tell.
_RESOLUTION_MM = 1e-3


class AcquisitionError(Settings):
    """Standard deviations of a rig's errors, each drawn once per domain (force noise: once per frame)."""

    point_offset_mm: Annotated[float, Field(ge=0, le=1)] = Field(
        default=0.0, description="offset of all contact points along x and along y, mm, 0 to 1"
    )
    depth_zero_mm: Annotated[float, Field(ge=0, le=0.5)] = Field(
        default=0.0, description="error of the depth at which contact is taken to begin, mm, 0 to 0.5"
    )
    tilt_deg: Annotated[float, Field(ge=0, le=3)] = Field(
        default=0.0,
        description="tilt of the pad about x and about y, degrees, 0 to 3; it changes the depth from point to point",
    )
    force_noise_n: Annotated[float, Field(ge=0, le=1)] = Field(
        default=0.0, description="noise of the force sensor per frame and axis, N, 0 to 1"
    )
    force_bias_n: Annotated[float, Field(ge=0, le=1)] = Field(
        default=0.0, description="bias of the force sensor along each axis, N, 0 to 1"
    )


@dataclass(frozen=True)
class DrawnErrors:
    """The errors of one domain as drawn: which a real rig would not know."""

    point_offset_mm: tuple[float, float]
    depth_zero_mm: float
    tilt_deg: tuple[float, float]
    force_bias_n: tuple[float, float, float]

    def actual(self, pose: Pose) -> Pose:
        """Return the contact that happens when this pose is commanded."""
        if pose.depth_mm == 0:
            return pose
        slope_x, slope_y = (math.tan(math.radians(angle)) for angle in self.tilt_deg)
        depth = pose.depth_mm + self.depth_zero_mm + slope_x * pose.point_x_mm + slope_y * pose.point_y_mm
        return replace(
            pose,
            depth_mm=max(0.0, _rounded(depth)),
            point_x_mm=_rounded(pose.point_x_mm + self.point_offset_mm[0]),
            point_y_mm=_rounded(pose.point_y_mm + self.point_offset_mm[1]),
        )


def draw_errors(error: AcquisitionError, seed: int, domain: str) -> DrawnErrors:
    """Draw a domain's errors: the same (seed, domain) always gives the same."""
    unit = [float(value) for value in random_stream(seed, domain, "acquisition").standard_normal(8)]
    return DrawnErrors(
        point_offset_mm=(error.point_offset_mm * unit[0], error.point_offset_mm * unit[1]),
        depth_zero_mm=error.depth_zero_mm * unit[2],
        tilt_deg=(error.tilt_deg * unit[3], error.tilt_deg * unit[4]),
        force_bias_n=tuple(error.force_bias_n * value for value in unit[5:]),
    )


def independent_poses(path: ContactPath, seed: int, domain: str) -> tuple[Pose, ...]:
    """Return the path's poses moved within their cells, so that no contact has an exact partner in another domain.

    Uniformly, a point moves by up to a quarter of the spacing of points, a direction by up to half the spacing of
    angles, and each level of depth and travel by up to a quarter of its spacing. A level moves as a whole: real runs
    repeat their levels too, and poses at one level share their solves.
    """
    rng = random_stream(seed, domain, "contacts")
    depths = _moved_levels(rng, path.depths_mm)
    radii = _moved_levels(rng, path.radii_mm)
    half_angle = 180.0 / max(len(path.angles_deg), 1)
    point_room = [_spacing(values) / 4 for values in (path.points_x_mm, path.points_y_mm)]
    points: dict[int, tuple[float, float]] = {}
    moved = []
    for pose in path.poses:
        if pose.point_id not in points:
            dx, dy = (_rounded(rng.uniform(-room, room)) for room in point_room)
            points[pose.point_id] = (pose.point_x_mm + dx, pose.point_y_mm + dy)
        angle = math.radians(pose.angle_deg + rng.uniform(-half_angle, half_angle))
        radius = radii.get(pose.radius_mm, pose.radius_mm)
        moved.append(
            replace(
                pose,
                depth_mm=depths.get(pose.depth_mm, pose.depth_mm),
                shear_x_mm=radius * math.cos(angle),
                shear_y_mm=radius * math.sin(angle),
                point_x_mm=points[pose.point_id][0],
                point_y_mm=points[pose.point_id][1],
            )
        )
    return tuple(moved)


def _moved_levels(rng: np.random.Generator, levels: Sequence[float]) -> dict[float, float]:
    room = _spacing(levels) / 4
    return {level: max(_RESOLUTION_MM, _rounded(level + rng.uniform(-room, room))) for level in levels}


def _spacing(values: Sequence[float]) -> float:
    ordered = sorted(set(values))
    return min((b - a for a, b in itertools.pairwise(ordered)), default=0.0)


def _rounded(value_mm: float) -> float:
    return round(round(value_mm / _RESOLUTION_MM) * _RESOLUTION_MM, 9)
