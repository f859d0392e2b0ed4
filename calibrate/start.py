"""Where a fit starts: a bar of each colour, on the side from which the dents in the pictures are lit."""

from collections.abc import Sequence

import numpy as np

from gelgap.calibrate.pictures import PressPicture, find_contact_mm
from gelgap.render import Illumination, Led, Sensor
from gelgap.render.imaging import srgb_decode

_COLOURS = ("red", "green", "blue")


def light_azimuths(
    reference: np.ndarray, pictures: Sequence[np.ndarray], centers_px: np.ndarray, radii_px: np.ndarray
) -> np.ndarray:
    """Return (3,): by channel the azimuth in radians, from +x towards +y, that presses are lit from.

    A dent is brighter on the side that faces the LED. `centers_px` (n, 2) and `radii_px` (n,) say which part of each
    picture, uint8 (h, w, 3), is looked at.
    """
    untouched = np.maximum(srgb_decode(reference / 255), 1e-3)
    rows, columns = np.indices(reference.shape[:2])
    moments = np.zeros((3, 2))
    for picture, (x, y), radius in zip(pictures, centers_px, radii_px, strict=True):
        inside = np.hypot(columns - x, rows - y) < radius
        change = srgb_decode(picture[inside] / 255) / untouched[inside] - 1
        moments += change.T @ np.column_stack([columns[inside] - x, rows[inside] - y])
    return np.arctan2(moments[:, 1], moments[:, 0])


def lit_from_dents(sensor: Sensor, reference: np.ndarray, presses: Sequence[PressPicture]) -> Sensor:
    """Return a sensor with a bar for each colour, out of the view, in the direction that dents are lit from.

    Raises
    ------
    ValueError
        If a press without a place hardly differs from the reference.
    """
    camera = sensor.camera
    size_px = reference.shape[1], reference.shape[0]
    mm_per_px = camera.footprint_mm(size_px)[0] / size_px[0]
    centers, radii = [], []
    for press in presses:
        x, y = press.point_mm or (0.0, 0.0)
        if press.point_mm is None and press.center_px is None:
            x, y = find_contact_mm(press.picture, reference, camera)
        centers.append(press.center_px or camera.project_px(np.array([x, y, 0.0]), size_px) - 0.5)
        contact_mm = np.sqrt((press.depth_mm or 0.0) * (press.sphere_diameter_mm or 0.0))
        radii.append(press.radius_px or contact_mm / mm_per_px)
    pictures = [press.picture for press in presses]
    azimuths = light_azimuths(reference, pictures, np.array(centers), np.array(radii))
    light = bars_at(azimuths, camera.footprint_mm(size_px)[0])
    return sensor.model_copy(update={"illumination": light})


def bars_at(azimuths: Sequence[float], view_mm: float) -> Illumination:
    """Return bars that send red, green and blue from azimuths (3,) in radians, from outside a view of some width."""
    unit = view_mm / 18.88
    leds = []
    for name, azimuth in zip(_COLOURS, azimuths, strict=True):
        x, y = np.cos(azimuth), np.sin(azimuth)
        leds.append(
            Led(
                name=name,
                position_mm=(14 * unit * x, 14 * unit * y, -4.0 * unit),
                facing=(-x, -y, 0.0),
                length_mm=14.0 * unit,
                height_mm=2.5 * unit,
                spectrum={"rgb": tuple(float(name == colour) for colour in _COLOURS)},
            )
        )
    return Illumination(leds=tuple(leds))
