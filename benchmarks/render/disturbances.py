"""What pictures of a real sensor may suffer: each disturbance turns a set of presses into a worse one, by a seed."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import cv2
import numpy as np

from gelgap.domains import PressSet
from gelgap.render import PressPicture
from gelgap.render.imaging import srgb_decode, srgb_encode

SPOILT = 2
"""Which of the fitted presses is made an outlier."""


@dataclass(frozen=True)
class Disturbance:
    """What happens to every picture of the sensor, and what to the presses that are fitted, or to the start."""

    name: str
    picture: Callable[[np.ndarray], np.ndarray] = lambda picture: picture
    fitted: Callable[[tuple[PressPicture, ...]], tuple[PressPicture, ...]] = lambda presses: presses
    start: Callable[[PressSet], PressSet] = lambda found: found
    outlier: bool = False


def exposed(picture: np.ndarray) -> np.ndarray:
    """Return the picture of 1.6 times the exposure, where much is saturated."""
    return codes(1.6 * srgb_decode(picture / 255))


def codes(linear: np.ndarray) -> np.ndarray:
    """Return uint8 codes of linear values."""
    return np.round(255 * srgb_encode(linear)).astype(np.uint8)


def blurred(picture: np.ndarray) -> np.ndarray:
    """Return the picture blurred by 2 px of 640."""
    return cv2.GaussianBlur(picture, (0, 0), 2 * picture.shape[1] / 640)


def compressed(picture: np.ndarray) -> np.ndarray:
    """Return the picture after JPEG of quality 50."""
    _, data = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, 50])
    return cv2.imdecode(data, cv2.IMREAD_COLOR)


def noisy(picture: np.ndarray) -> np.ndarray:
    """Return the picture with noise of 5 code values."""
    noise = np.random.default_rng(int(picture.sum())).normal(0, 5, picture.shape)
    return np.clip(np.round(picture + noise), 0, 255).astype(np.uint8)


def marked_badly(presses: tuple[PressPicture, ...]) -> tuple[PressPicture, ...]:
    """Return presses whose circles are marked with an error of 3 px, in the centre and in the radius."""
    rng = np.random.default_rng(0)
    return tuple(
        replace(
            press,
            center_px=tuple(press.center_px + rng.normal(0, 3, 2)),
            radius_px=press.radius_px + min(rng.normal(0, 3), 2.0),
        )
        for press in presses
    )


def unmarked(presses: tuple[PressPicture, ...]) -> tuple[PressPicture, ...]:
    """Return presses of which only the radius is marked."""
    return tuple(replace(press, center_px=None) for press in presses)


def some(presses: tuple[PressPicture, ...], count: int) -> tuple[PressPicture, ...]:
    """Return `count` of the presses, spread over the list."""
    return presses[:: len(presses) // count][:count]


def one_spoilt(change: Callable[[PressPicture, PressPicture], PressPicture]):
    """Return what spoils one press, given it and its neighbour in the list."""

    def fitted(presses: tuple[PressPicture, ...]) -> tuple[PressPicture, ...]:
        spoilt = change(presses[SPOILT], presses[SPOILT + 1])
        return (*presses[:SPOILT], spoilt, *presses[SPOILT + 1 :])

    return fitted


def two_imprints(press: PressPicture, other: PressPicture) -> PressPicture:
    """Return a press in whose picture another's imprint is seen as well."""
    return replace(press, picture=np.minimum(press.picture, other.picture))


def turned(found: PressSet, angle_deg: float = 30.0) -> PressSet:
    """Return a start whose LEDs are all turned about the sensor's axis."""
    cosine, sine = np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))

    def turn(vector: tuple[float, float, float]) -> tuple[float, float, float]:
        x, y, z = vector
        return float(cosine * x - sine * y), float(sine * x + cosine * y), z

    return _with_leds(
        found,
        [
            {"position_mm": turn(led.position_mm), "facing": turn(led.facing)}
            for led in found.start.illumination.leds
        ],
    )


def shifted(found: PressSet, distance_mm: float = 6.0) -> PressSet:
    """Return a start whose LEDs are each moved in a direction of its own."""
    rng = np.random.default_rng(1)
    updates = []
    for led in found.start.illumination.leds:
        step = rng.normal(size=3)
        x, y, z = led.position_mm + distance_mm * step / np.linalg.norm(step)
        highest = -led.half_extent_z_mm() - 0.05
        updates.append({"position_mm": (float(x), float(y), float(min(z, highest)))})
    return _with_leds(found, updates)


def _with_leds(found: PressSet, updates: list[dict]) -> PressSet:
    light = found.start.illumination
    leds = tuple(led.model_copy(update=update) for led, update in zip(light.leds, updates, strict=True))
    start = found.start.model_copy(update={"illumination": light.model_copy(update={"leds": leds})})
    return replace(found, start=start)


DISTURBANCES = (
    Disturbance("undisturbed"),
    Disturbance("start: LEDs turned by 30°", start=turned),
    Disturbance("start: each LED 6 mm off", start=shifted),
    Disturbance("circles marked ± 3 px", fitted=marked_badly),
    Disturbance("centres not marked", fitted=unmarked),
    Disturbance("12 presses", fitted=lambda presses: some(presses, 12)),
    Disturbance("6 presses", fitted=lambda presses: some(presses, 6)),
    Disturbance("exposed 1.6 times, saturated", picture=exposed),
    Disturbance("blurred by 2 px", picture=blurred),
    Disturbance("JPEG of quality 50", picture=compressed),
    Disturbance("noise of 5 code values", picture=noisy),
    Disturbance(
        "outlier: another press's picture",
        fitted=one_spoilt(lambda press, other: replace(press, picture=other.picture)),
        outlier=True,
    ),
    Disturbance(
        "outlier: centre marked 1 mm off",
        fitted=one_spoilt(
            lambda press, _: replace(press, center_px=(press.center_px[0] + 34, press.center_px[1]))
        ),
        outlier=True,
    ),
    Disturbance("outlier: two imprints", fitted=one_spoilt(two_imprints), outlier=True),
    Disturbance(
        "outlier: light at 70 %",
        fitted=one_spoilt(
            lambda press, _: replace(press, picture=codes(0.7 * srgb_decode(press.picture / 255)))
        ),
        outlier=True,
    ),
)
