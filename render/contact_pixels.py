"""Pixels of a real sensor's pictures whose geometry is known: flat membrane, and the inside of a sphere's contact."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from gelgap.render.camera import Camera
from gelgap.render.imaging import srgb_decode, srgb_slope
from gelgap.render.inpainting import detect_markers

REFERENCE_POINTS = (28, 21)
PRESS_POINTS = 250
# Share of the estimated contact radius within which the membrane surely touches the sphere.
SURE_CONTACT = 0.8
SATURATED = 250
DARK = 4
_LEAST_CHANGE = 5.0  # code values


@dataclass(frozen=True)
class PressPicture:
    """A picture of a pressed sphere. Depth is that of the sphere's lowest point below the undeformed membrane.

    `point_mm` is where the sphere was pressed, or `center_px` (column, row) where its imprint's centre is; without
    either it is found in the picture. Instead of the depth, `radius_px` may say how large the imprint is.
    `marks_off_px` says by how much these two marks may be wrong. Without a diameter the sphere is an unknown one, the
    same in all presses.
    """

    picture: np.ndarray  # uint8 (h, w, 3)
    sphere_diameter_mm: float | None
    depth_mm: float | None = None
    point_mm: tuple[float, float] | None = None
    radius_px: float | None = None
    center_px: tuple[float, float] | None = None
    name: str = ""
    marks_off_px: float = 3.0


class KnownPoints(NamedTuple):
    """Points of the membrane, and what the camera read there.

    `weight` turns errors of the linear values into code values; it is 0 where a value is saturated or too dark.
    """

    positions_mm: np.ndarray  # (n, 3)
    normals: np.ndarray  # (n, 3)
    linear: np.ndarray  # (n, 3)
    weight: np.ndarray  # (n, 3)


def pixel_rays(camera: Camera, columns: np.ndarray, rows: np.ndarray, size_px: tuple[int, int]) -> np.ndarray:
    """Return (n, 3) directions with z = 1 of pixel coordinates, with the lens distortion undone."""
    distorted = (np.stack([columns, rows], axis=1) - np.asarray(size_px) / 2) / camera.focal_length_px(
        size_px[0]
    )
    k1, k2 = camera.radial_distortion
    slope = distorted.copy()
    for _ in range(10):
        r2 = (slope**2).sum(1, keepdims=True)
        slope = distorted / (1 + r2 * (k1 + r2 * k2))
    return np.column_stack([slope, np.ones(len(slope))])


def _read(camera: Camera, picture: np.ndarray, columns: np.ndarray, rows: np.ndarray):
    """Return linear values of pixels, vignetting undone, and weights that turn their errors into code values."""
    height, width, _ = picture.shape
    code = picture[rows, columns].astype(float)
    r2 = ((columns + 0.5 - width / 2) ** 2 + (rows + 0.5 - height / 2) ** 2) / (
        (width / 2) ** 2 + (height / 2) ** 2
    )
    gain = (1 - camera.vignetting * r2)[:, None]
    linear = srgb_decode(code / 255) / gain
    usable = (code < SATURATED) & (code > DARK)
    return linear, np.where(usable, 255 * srgb_slope(linear * gain) * gain, 0.0)


def _without_dots(picture: np.ndarray, columns: np.ndarray, rows: np.ndarray) -> np.ndarray:
    return ~detect_markers(picture)[rows, columns]


def flat_points(camera: Camera, reference: np.ndarray) -> KnownPoints:
    height, width, _ = reference.shape
    columns, rows = np.meshgrid(
        np.linspace(2, width - 3, REFERENCE_POINTS[0]).round().astype(int),
        np.linspace(2, height - 3, REFERENCE_POINTS[1]).round().astype(int),
    )
    columns, rows = columns.ravel(), rows.ravel()
    clear = _without_dots(reference, columns, rows)
    columns, rows = columns[clear], rows[clear]
    rays = pixel_rays(camera, columns + 0.5, rows + 0.5, (width, height))
    positions = np.asarray(camera.position_mm) - camera.position_mm[2] * rays
    normals = np.broadcast_to([0.0, 0.0, -1.0], positions.shape).copy()
    return KnownPoints(positions, normals, *_read(camera, reference, columns, rows))


def contact_pixels(camera: Camera, press: PressPicture, point_mm: tuple[float, float]):
    """Return columns and rows of pixels that surely see the sphere's contact, free of dots."""
    height, width, _ = press.picture.shape
    radius_mm = SURE_CONTACT * np.sqrt(press.depth_mm * press.sphere_diameter_mm / 2)
    along = np.linspace(-radius_mm, radius_mm, round(np.sqrt(PRESS_POINTS * 4 / np.pi)))
    dx, dy = np.meshgrid(along, along)
    inside = np.hypot(dx, dy) < radius_mm
    points = np.column_stack(
        [point_mm[0] + dx[inside], point_mm[1] + dy[inside], np.full(inside.sum(), -press.depth_mm)]
    )
    columns, rows = np.floor(camera.project_px(points, (width, height))).astype(int).T
    seen = (columns >= 0) & (columns < width) & (rows >= 0) & (rows < height)
    columns, rows = columns[seen], rows[seen]
    clear = _without_dots(press.picture, columns, rows)
    return columns[clear], rows[clear]


def contact_points(camera: Camera, press: PressPicture, point_mm: tuple[float, float], pixels) -> KnownPoints:
    columns, rows = pixels
    height, width, _ = press.picture.shape
    rays = pixel_rays(camera, columns + 0.5, rows + 0.5, (width, height))
    radius_mm = press.sphere_diameter_mm / 2
    center = np.array([*point_mm, radius_mm - press.depth_mm])
    offset = np.asarray(camera.position_mm) - center
    a, b = (rays**2).sum(1), rays @ offset
    root = np.sqrt(np.maximum(b**2 - a * (offset @ offset - radius_mm**2), 0))
    positions = np.asarray(camera.position_mm) + ((-b - root) / a)[:, None] * rays
    return KnownPoints(
        positions, (positions - center) / radius_mm, *_read(camera, press.picture, columns, rows)
    )


def find_contact_mm(picture: np.ndarray, reference: np.ndarray, camera: Camera) -> tuple[float, float]:
    """Return where a press is: midway between what it made brighter and what it made darker, in each channel.

    A dent is brighter on the side that faces a light and darker on the other, and seldom as much.

    Raises
    ------
    ValueError
        If the picture hardly differs from the reference.
    """
    import cv2

    change = picture.astype(np.float32) - reference
    change = cv2.GaussianBlur(change, (0, 0), picture.shape[1] / 80)
    if np.abs(change).max() < _LEAST_CHANGE:
        raise ValueError("the picture hardly differs from the reference; no contact was found in it")
    height, width, _ = change.shape
    middles, weights = [], []
    for channel in np.moveaxis(change, 2, 0):
        lobes = [np.maximum(channel, 0), np.maximum(-channel, 0)]
        weakest = min(lobe.max() for lobe in lobes)
        if weakest >= _LEAST_CHANGE:
            middles.append(np.mean([_center_px(lobe) for lobe in lobes], axis=0))
            weights.append(weakest)
    if not weights:
        middles, weights = [_center_px(np.abs(change).max(axis=2))], [1.0]
    column, row = np.average(middles, axis=0, weights=weights)
    return tuple(plane_points_mm(camera, np.array([column]), np.array([row]), (width, height))[0].tolist())


def _center_px(change: np.ndarray) -> tuple[float, float]:
    """Return column and row of the centre of mass of what exceeds half of the largest change."""
    strong = np.where(change > 0.5 * change.max(), change, 0)
    rows, columns = np.indices(strong.shape)
    return (strong * columns).sum() / strong.sum(), (strong * rows).sum() / strong.sum()


def plane_points_mm(
    camera: Camera, columns: np.ndarray, rows: np.ndarray, size_px: tuple[int, int]
) -> np.ndarray:
    """Return (n, 2): where the rays through pixels' centres meet the plane of the undeformed membrane."""
    rays = pixel_rays(camera, columns + 0.5, rows + 0.5, size_px)
    return np.asarray(camera.position_mm[:2]) - camera.position_mm[2] * rays[:, :2]
