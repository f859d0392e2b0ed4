"""Fitting a sensor file to a real sensor: LED colours, levels and positions, and the coat's gloss.

Where a sphere touches the membrane, the membrane has the sphere's shape. So the fit uses the reference picture, where
the membrane is flat, and the inside of the contact of each press. No other part of the membrane shadows a point there.
LED colours enter linearly and are solved for exactly at every step; only positions, the weight of the gloss and the
presses' centres are searched, by least squares on errors in code values.
"""

from dataclasses import dataclass

import numpy as np

from gelgap.render.contact_pixels import (
    KnownPoints,
    PressPicture,
    contact_pixels,
    contact_points,
    find_contact_mm,
    flat_points,
)
from gelgap.render.led import Led
from gelgap.render.sensor import Sensor
from gelgap.render.unshadowed_light import unshadowed_light


@dataclass(frozen=True)
class Calibration:
    """The fitted sensor, with its LEDs, and how well it explains the pictures."""

    sensor: Sensor
    rms_code_values: float
    press_points_mm: tuple[tuple[float, float], ...]
    evaluations: int


@dataclass(frozen=True)
class _Guess:
    """What is searched for."""

    led_positions_mm: np.ndarray  # (leds, 3)
    specular: float
    points_mm: list[tuple[float, float]]  # where each press is


def calibrate(
    sensor: Sensor, reference: np.ndarray, presses: tuple[PressPicture, ...], fit_gloss: bool = False
) -> Calibration:
    """Fit the LEDs of a sensor, and optionally the weight of its gloss, to pictures of a real one.

    Parameters
    ----------
    sensor
        The start: camera, coat, and its own LEDs roughly where they are (within 6 mm); their sizes and directions are
        kept. Colours and levels need no start.
    reference
        uint8 (h, w, 3) without contact.
    presses
        Pictures of pressed spheres; it takes three or more at different places to determine the positions.
    fit_gloss
        Whether the weight of the coat's rough-plastic part is fitted as well.

    Raises
    ------
    ValueError
        If the sensor has no LEDs of its own, there is no press, sizes differ, a depth exceeds the sphere's radius, or
        no contact is found in a picture.
    """
    _check(sensor, reference, presses)
    problem = _Problem(sensor, reference, tuple(presses), fit_gloss)
    fit = _search(problem, problem.start())
    if problem.unknown_points:
        # Pixels were chosen around points that were found roughly; choose them anew around the fitted ones.
        problem.choose_pixels(problem.guess(fit.x).points_mm)
        fit = _search(problem, fit.x)
    guess = problem.guess(fit.x)
    levels, residuals = problem.solve_levels(guess)
    return Calibration(
        sensor=_fitted_sensor(sensor, problem.moved_leds(guess), levels, guess.specular),
        rms_code_values=float(np.sqrt(np.mean(residuals**2))),
        press_points_mm=tuple(guess.points_mm),
        evaluations=int(fit.nfev),
    )


def _check(sensor: Sensor, reference: np.ndarray, presses: tuple[PressPicture, ...]) -> None:
    if sensor.illumination is None:
        raise ValueError(
            f"sensor {sensor.name!r} has no LEDs of its own to start from; give it an [illumination]"
        )
    if not presses:
        raise ValueError("no press picture was given; calibration needs at least one press of a known sphere")
    for press in presses:
        if press.picture.shape != reference.shape:
            raise ValueError(
                f"a press picture has shape {press.picture.shape}, and the reference {reference.shape}"
            )
        if press.depth_mm is None or press.sphere_diameter_mm is None:
            raise ValueError(
                "a press has no depth_mm or no sphere_diameter_mm; the fit of LEDs alone asks for both of each press"
            )
        if not 0 < press.depth_mm < press.sphere_diameter_mm / 2:
            raise ValueError(
                f"depth_mm is {press.depth_mm}; it must lie between 0 and the sphere's radius, "
                f"{press.sphere_diameter_mm / 2}"
            )


class _Problem:
    """The pictures, and what a guess of positions, gloss and press centres leaves unexplained.

    A search sees a guess as a vector: the LEDs' positions, the weight of the gloss if it is fitted, and the points of
    the presses for which none was given.
    """

    def __init__(
        self, sensor: Sensor, reference: np.ndarray, presses: tuple[PressPicture, ...], fit_gloss: bool
    ) -> None:
        self.sensor = sensor
        self.leds = sensor.illumination.leds
        self.presses = presses
        self.fit_gloss = fit_gloss
        self.flat_points = flat_points(sensor.camera, reference)
        self.start_points_mm = [
            press.point_mm or find_contact_mm(press.picture, reference, sensor.camera) for press in presses
        ]
        self.unknown_points = [index for index, press in enumerate(presses) if press.point_mm is None]
        self.choose_pixels(self.start_points_mm)

    def choose_pixels(self, points_mm: list[tuple[float, float]]) -> None:
        """Take from each press the pixels that surely see its contact if the sphere stands at that point."""
        self.pixels = [
            contact_pixels(self.sensor.camera, press, point)
            for press, point in zip(self.presses, points_mm, strict=True)
        ]

    def start(self) -> np.ndarray:
        """Return the vector that the search starts from."""
        positions = np.array([led.position_mm for led in self.leds]).ravel()
        gloss = [self.sensor.coating.specular] if self.fit_gloss else []
        points = [value for index in self.unknown_points for value in self.start_points_mm[index]]
        return np.concatenate([positions, gloss, points])

    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the least and the greatest vector: LEDs within 6 mm, points within 1 mm of the start."""
        count = 3 * len(self.leds)
        start = self.start()
        low, high = start - 1.0, start + 1.0
        low[:count], high[:count] = start[:count] - 6, start[:count] + 6
        half_extents_mm = np.array([led.half_extent_z_mm() for led in self.leds])
        high[2:count:3] = np.minimum(high[2:count:3], -half_extents_mm - 0.05)
        if self.fit_gloss:
            low[count], high[count] = -1e-9, 1
        return low, high

    def guess(self, vector: np.ndarray) -> _Guess:
        """Return what a vector of the search means."""
        count = 3 * len(self.leds)
        specular = float(vector[count]) if self.fit_gloss else self.sensor.coating.specular
        points = list(self.start_points_mm)
        for index, (x, y) in zip(
            self.unknown_points, vector[count + self.fit_gloss :].reshape(-1, 2), strict=True
        ):
            points[index] = (float(x), float(y))
        return _Guess(vector[:count].reshape(-1, 3), specular, points)

    def moved_leds(self, guess: _Guess) -> tuple[Led, ...]:
        """Return the LEDs at the guessed positions."""
        return tuple(
            led.model_copy(update={"position_mm": tuple(position.tolist())})
            for led, position in zip(self.leds, guess.led_positions_mm, strict=True)
        )

    def known_points(self, guess: _Guess) -> KnownPoints:
        """Return all points whose geometry is known, if the presses are where the guess says."""
        parts = [self.flat_points] + [
            contact_points(self.sensor.camera, press, point, pixels)
            for press, point, pixels in zip(self.presses, guess.points_mm, self.pixels, strict=True)
        ]
        return KnownPoints(*map(np.concatenate, zip(*parts, strict=True)))

    def solve_levels(self, guess: _Guess) -> tuple[np.ndarray, np.ndarray]:
        """Return (leds, 3) levels and the residuals in code values that remain with them."""
        from scipy.optimize import nnls

        points = self.known_points(guess)
        light = unshadowed_light(self.sensor, self.moved_leds(guess), points.positions_mm, points.normals)
        lambert, base, highlight = light[..., 0], light[..., 1], light[..., 2]
        gloss = guess.specular
        levels, residuals = np.empty((len(self.leds), 3)), []
        for channel, albedo in enumerate(self.sensor.coating.albedo):
            design = (1 - gloss) * albedo * lambert + gloss * (albedo * base + highlight)
            weight = points.weight[:, channel]
            weighted, target = weight[:, None] * design, weight * points.linear[:, channel]
            levels[:, channel], _ = nnls(weighted, target)
            residuals.append(weighted @ levels[:, channel] - target)
        return levels, np.concatenate(residuals)


def _fitted_sensor(sensor: Sensor, leds: tuple[Led, ...], levels: np.ndarray, specular: float) -> Sensor:
    """Return the sensor with LEDs of the levels (leds, 3); a level is drive × exposure × colour."""
    fitted = []
    for led, level in zip(leds, levels, strict=True):
        brightest = max(level.max(), 1e-9)
        values = led.model_dump() | {
            "drive": brightest / sensor.camera.exposure,
            "spectrum": {"rgb": tuple((level / brightest).tolist())},
        }
        fitted.append(Led(**values))
    illumination = sensor.illumination.model_copy(update={"leds": tuple(fitted)})
    coating = sensor.coating.model_copy(update={"specular": float(np.clip(specular, 0, 1))})
    return sensor.model_copy(update={"illumination": illumination, "coating": coating})


def _search(problem: _Problem, start: np.ndarray):
    from scipy.optimize import least_squares

    return least_squares(
        lambda vector: problem.solve_levels(problem.guess(vector))[1],
        start,
        bounds=problem.bounds(),
        loss="soft_l1",
        f_scale=3.0,
        diff_step=1e-4,
        xtol=1e-6,
        ftol=1e-6,
        max_nfev=40,
    )
