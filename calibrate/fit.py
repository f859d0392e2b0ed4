"""The fit of a real sensor's light: variable projection over bars, scattered light and where each press is.

The intensities of bars, ambient and scattered light enter linearly and are solved for exactly; the bars' geometry is
searched, with the linear part solved inside every step, and each press's centre and depth follow by Gauss-Newton. The
camera's distance and blur are found by parabolas, each point of them with its own light and presses.
"""

from collections.abc import Callable
from copy import copy
from dataclasses import replace

import numpy as np

from gelgap.calibrate.light import Light, SeenPoints, gain_of, predicted_light
from gelgap.calibrate.pictures import DARK, SATURATED, FarField
from gelgap.calibrate.poses import LEAST_DEPTH_MM, PlacedPresses
from gelgap.calibrate.residual import fitted_residual
from gelgap.render.imaging import Camera, srgb_decode, srgb_encode, srgb_slope
from gelgap.render.normal_table import NormalTable
from gelgap.render.sensor import BallResidual

RIDGE = 0.1
# By how much the modelled flat light, of which the gain is made, is drawn to the reference.
REFERENCE_WEIGHT = 0.1
TABLE_RIDGE = 1e-3
# Flat light is smooth, so that one pixel of this many is enough.
_REFERENCE_STEP = 4
PRIOR = {"azimuth": 0.35, "distance": 0.25, "height": 0.6, "length": 0.4, "tall": 0.6}
PRIOR_WEIGHT = 30.0
_MOST_STEP_MM = 0.06
MOST_BLUR_PX = 2.0  # more stands in for the slope at the rim and widens edges twofold (results/sensors.md)
# By what share the error must fall for a blur to be believed: less is what meshes and pixels blur.
_LEAST_GAIN = 0.02
# By which slopes of marks' errors over place (a wrong scale) and depth (marks exaggerate it) are drawn to 0.
_HABIT_RIDGE_MM2 = 0.1


def nonnegative_least_squares(normal: np.ndarray, right: np.ndarray, count: int) -> np.ndarray:
    """Solve normal equations with the first `count` unknowns at 0 or above, by dropping negative ones."""
    free = np.ones(len(right), bool)
    while True:
        theta = np.zeros(len(right))
        theta[free] = np.linalg.solve(normal[np.ix_(free, free)], right[free])
        if (theta[:count] >= 0).all():
            return theta
        free[np.argmin(theta[:count])] = False


def _weighted(change: np.ndarray, of_change: np.ndarray, flat: np.ndarray, of_flat: np.ndarray) -> np.ndarray:
    """Return the rows of the least-squares problem: a change for each pixel, flat light for some of them."""
    return np.concatenate([change * of_change[:, None], flat[::_REFERENCE_STEP] * of_flat[:, None]])


class LightFit:
    """Fits a light to some of the presses (indices `which`) on gel whose untouched light is `field`; start with `run`.

    `nearness_range` bounds 1 / the camera's distance; without it the camera is kept. `placed` are the presses as the
    camera sees them, as far as it is fitted.
    """

    def __init__(
        self,
        placed: PlacedPresses,
        which: np.ndarray,
        field: FarField,
        light: Light,
        nearness_range: tuple[float, float] | None = None,
    ) -> None:
        self.placed, self.which, self.field, self.light = placed, which, field, light
        self.index, self.plane_mm, self.code, self.base, self.factor = placed.samples(which, field)
        self.profiles = [placed.seen_profiles[k] for k in which]
        self.sigma_mm = placed.sigma_mm[which]
        self.start_presses = placed.poses_mm[which]
        self.presses = self.start_presses.copy()
        self.anchor = light.bars
        self.nearness_range = nearness_range
        self.linear = srgb_decode(self.code / 255)
        codes = np.stack([self.code, 255 * srgb_encode(self.base * self.factor)])
        self.usable = ((codes > DARK) & (codes < SATURATED)).all(axis=0).astype(float)
        self.flat, self.flat_light = SeenPoints.flat(self.plane_mm), self.base.copy()  # the latter modelled
        self.residual = np.zeros_like(self.base)

    @property
    def camera(self) -> Camera:
        return self.placed.camera

    @property
    def distance_mm(self) -> float:
        """The camera's, from the flat membrane."""
        return float(-self.camera.position_mm[2])

    @property
    def rms_code_values(self) -> float:
        return float(np.sqrt(np.mean(self.residual**2)))

    def press_errors(self) -> np.ndarray:
        """Return (presses,): the mean square of each press's residual, in code values²."""
        own = [self.residual[self.index == k] for k in range(len(self.presses))]
        return np.array([np.mean(residual**2) for residual in own])

    def run(self) -> None:
        """Fit bars alone first, so that scattered light does not take their place, then everything in turn."""
        if (order := self.light.order) > 0:
            self.light = replace(self.light, order=0)
            self._solve()
            self._search(("azimuth", "height"), 6)
            self._solve()
            self.refine_presses()
            self._search(("azimuth", "height", "distance"), 4)
            self.anchor, self.light = self.light.bars, replace(self.light, order=order)
        self._solve()
        self._search_distance(1.0)
        self._search_geometry()
        self._search_distance(0.4)
        self._search_blur()
        self._search_geometry()

    def _search_geometry(self) -> None:
        self._search(tuple(PRIOR), 5)
        self._solve()
        self.refine_presses()
        self._solve()

    def _seen(self, presses: np.ndarray) -> SeenPoints:
        """Return what the samples see of presses (k, 3)."""
        camera_mm = np.array(self.camera.position_mm)
        return SeenPoints.pressed(self.plane_mm, self.index, presses, self.profiles, camera_mm)

    def _ridge(self) -> np.ndarray:
        return RIDGE * len(self.index) * self.light.penalty() ** 2

    def _weights(self, channel: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return by what changes enter the picture's error in codes and flat light the reference's, and the targets.

        These are how much brighter the picture is than untouched gel, and that, in the order of `_weighted`.
        """
        columns = (self.base, self.linear, self.flat_light, self.factor, self.usable)
        base, linear, flat, factor, usable = (values[:, channel] for values in columns)
        picture = 255 * srgb_slope(linear) * factor * usable
        some = np.s_[::_REFERENCE_STEP]
        reference = 255 * REFERENCE_WEIGHT * _REFERENCE_STEP**0.5 * (srgb_slope(base) * usable)[some]
        target = np.concatenate([picture * (linear / factor - base), reference * base[some]])
        return picture * gain_of(base, flat), reference, target

    def _solve(self) -> None:
        """Solve for all intensities: a press's change shall be predicted, and flat light be near the reference.

        The gain is that of the flat light before, so that it is found as solves follow each other.
        """
        pressed, flat = self._seen(self.presses).columns(self.light), self.flat.columns(self.light)
        change, ridge, leds = pressed - flat, self._ridge(), self.light.bars.count
        solved = np.empty((pressed.shape[1], 3))
        for channel in range(3):
            of_change, of_flat, target = self._weights(channel)
            rows = _weighted(change, of_change, flat, of_flat)
            normal = rows.T @ rows
            normal[np.diag_indices_from(normal)] += ridge
            solved[:, channel] = nonnegative_least_squares(normal, rows.T @ target, leds)
            self.flat_light[:, channel] = flat @ solved[:, channel]
        self.light = replace(self.light, theta=solved)
        self.residual = self._error(pressed @ solved, self.flat_light)

    def _search(self, fields: tuple[str, ...], evaluations: int) -> None:
        """Search the bars' geometry; the gain is held, so most normal equations are formed once."""
        from scipy.optimize import least_squares

        light, ridge, leds = self.light, self._ridge(), self.light.bars.count
        pressed, flat = self._seen(self.presses), self.flat
        fixed_flat = light.fixed_columns(flat.positions, flat.normals)
        fixed_change = light.fixed_columns(pressed.positions, pressed.normals) - fixed_flat
        held = []
        for channel in range(3):
            of_change, of_flat, target = self._weights(channel)
            rows = _weighted(fixed_change, of_change, fixed_flat, of_flat)
            held.append((of_change, of_flat, target, rows, rows.T @ rows, rows.T @ target))
        prior = np.concatenate([np.full(leds, PRIOR[field]) for field in fields])
        anchor = self.anchor.packed(fields)
        kept_pressed: dict[bytes, np.ndarray] = {}
        kept_flat: dict[bytes, np.ndarray] = {}

        def moved(vector: np.ndarray) -> Light:
            return replace(light, bars=light.bars.unpacked(vector, fields))

        def unexplained(vector: np.ndarray) -> np.ndarray:
            unpressed = flat.bar_columns(moved(vector), kept_flat)
            change = pressed.bar_columns(moved(vector), kept_pressed) - unpressed
            errors = []
            for of_change, of_flat, target, rows, fixed, fixed_right in held:
                bars = _weighted(change, of_change, unpressed, of_flat)
                normal = np.empty((leds + len(fixed),) * 2)
                normal[:leds, :leds] = bars.T @ bars
                normal[:leds, leds:] = bars.T @ rows
                normal[leds:, :leds] = normal[:leds, leds:].T
                normal[leds:, leds:] = fixed
                normal[np.diag_indices_from(normal)] += ridge
                right = np.concatenate([bars.T @ target, fixed_right])
                theta = nonnegative_least_squares(normal, right, leds)
                errors += [bars @ theta[:leds] + rows @ theta[leds:] - target, np.sqrt(ridge) * theta]
            return np.concatenate([*errors, PRIOR_WEIGHT * (vector - anchor) / prior])

        start = light.bars.packed(fields)
        found = least_squares(unexplained, start, max_nfev=evaluations, diff_step=3e-3, x_scale=prior)
        self.light = moved(found.x)

    def _search_distance(self, share: float) -> None:
        """Search the camera's distance, evenly in its inverse, in a share of its range."""
        if self.nearness_range is not None:
            size_px, nearness = self.placed.size_px, 1 / self.distance_mm
            nearer = lambda value: self.camera.seen_from(1 / value, size_px)  # noqa: E731
            self._become(self._under_cameras(nearer, nearness, self.nearness_range, share))

    def _search_blur(self) -> None:
        """Search the camera's point spread; it stays unless another leaves less error by `_LEAST_GAIN`."""
        if self.nearness_range is not None:
            blurred = lambda value: self.camera.model_copy(update={"point_spread_px": float(value)})  # noqa: E731
            tried = self._under_cameras(blurred, self.camera.point_spread_px, (0.0, MOST_BLUR_PX), 1.0)
            same = [own for own in tried if own.camera == self.camera]
            kept = same[0] if same else self._seen_by(self.camera)
            below = (1 - _LEAST_GAIN) * kept.rms_code_values
            self._become([own for own in tried if own.rms_code_values < below] or [kept])

    def _under_cameras(
        self, camera_of: Callable[[float], Camera], start: float, bounds: tuple[float, float], share: float
    ) -> list["LightFit"]:
        """Return the fits under three cameras around a start, and at the least of a parabola through their errors."""
        low, high = bounds
        half = share * (high - low) / 2
        middle = np.clip(start, low + half, high - half)
        values = np.array([middle - half, middle, middle + half])
        tried = [self._seen_by(camera_of(value)) for value in values]
        curvature, slope, _ = np.polyfit(values - middle, [own.rms_code_values for own in tried], 2)
        if curvature > 0:
            least = np.clip(middle - slope / (2 * curvature), low, high)
            if np.abs(values - least).min() > 1e-9:
                tried.append(self._seen_by(camera_of(least)))
        return tried

    def _become(self, tried: list["LightFit"]) -> None:
        vars(self).update(vars(min(tried, key=lambda own: own.rms_code_values)))

    def _seen_by(self, camera: Camera) -> "LightFit":
        """Return the fit under another camera, with presses moved and light solved for anew."""
        other = copy(self)
        other.placed = self.placed.seen_by(camera)
        other.profiles = [other.placed.seen_profiles[k] for k in self.which]
        other.start_presses = other.placed.poses_mm[self.which]
        other.presses = other.start_presses + self.presses - self.start_presses
        deepest = [profiles.deepest_mm for profiles in self.profiles]
        other.presses[:, 2] = np.clip(other.presses[:, 2], LEAST_DEPTH_MM, deepest)
        other.flat_light = self.flat_light.copy()
        other._solve()
        other.refine_presses(1)
        other._solve()
        other._solve()  # the gain of the light as it is now: cameras are compared by what they leave
        return other

    def refine_presses(self, rounds: int = 2) -> None:
        """Move each press's centre and depth by Gauss-Newton under the light as it is, all presses at once."""
        flat_light = self.flat.light(self.light)
        for _ in range(rounds):
            now = self._errors(self.presses, flat_light)
            slopes = []
            for axis, step_mm in enumerate((0.015, 0.015, 0.01)):
                moved = self.presses.copy()
                moved[:, axis] += step_mm
                slopes.append((self._errors(moved, flat_light) - now) / step_mm)
            for k, profiles in enumerate(self.profiles):
                own = self.index == k
                jacobian, error = np.stack([s[own].ravel() for s in slopes], axis=1), now[own].ravel()
                weighted = (jacobian / np.sqrt(1 + (error / 10) ** 2)[:, None]).T
                stiffness = 100 / self.sigma_mm[k] ** 2
                off = self.presses[k] - self.start_presses[k]
                step = -np.linalg.solve(
                    weighted @ jacobian + np.diag(stiffness), weighted @ error + stiffness * off
                )
                self.presses[k] += np.clip(step, -_MOST_STEP_MM, _MOST_STEP_MM)
                self.presses[k, 2] = np.clip(self.presses[k, 2], LEAST_DEPTH_MM, profiles.deepest_mm)

    def marks_off(self) -> np.ndarray:
        """Return (4, 3): by 1, x, y and depth of a mark how far x, y and depth of the fitted presses are off, in mm."""
        off, middle = self.presses - self.start_presses, self.start_presses.mean(axis=0)
        at = self.start_presses - middle
        slopes = np.linalg.solve(at.T @ at + _HABIT_RIDGE_MM2 * np.eye(3), at.T @ off)
        return np.vstack([off.mean(axis=0) - middle @ slopes, slopes])

    def normal_table(self) -> NormalTable:
        """Return the table of normals of the fitted presses, where the fit sees them."""
        half_mm, untouched = self.placed.half_view_mm, 255 * srgb_encode(self.base * self.factor)
        columns = NormalTable.columns(self._seen(self.presses).normals, self.plane_mm, half_mm)
        normal = columns.T @ columns
        normal[np.diag_indices_from(normal)] += TABLE_RIDGE * np.trace(normal) / len(normal)
        change = (self.code - untouched) * self.usable
        return NormalTable(np.linalg.solve(normal, columns.T @ change), half_mm)

    def ball_residual(self, share: float) -> BallResidual | None:
        """Return what light and a share of the table leave around the fitted contacts; None if of several balls."""
        diameters_mm = {self.placed.presses[k].sphere_diameter_mm for k in self.which}
        if len(diameters_mm) > 1:
            return None
        half_mm, seen = self.placed.half_view_mm, self._seen(self.presses)
        change = NormalTable.columns(seen.normals, self.plane_mm, half_mm) @ self.normal_table().coefficients
        by_table = 255 * srgb_encode(self.base * self.factor) + change
        left = share * (self.code - by_table) - (1 - share) * self.residual
        own = zip(self.profiles, self.presses, strict=True)
        radii_mm = np.array([profiles.contact_radius_mm(pose[2]) for profiles, pose in own])
        contacts = np.column_stack([self.presses[:, :2] / half_mm, radii_mm])
        away = (seen.positions[:, :2] - self.presses[self.index, :2]) / radii_mm[self.index, None]
        return fitted_residual(diameters_mm.pop(), contacts, self.index, away, left, self.usable)

    def expected_mm(self, press: int) -> np.ndarray:
        """Return (3,) where a press is expected: as far off its mark as fitted ones are at such a place and depth."""
        marked = self.placed.poses_mm[press]
        return marked + np.r_[1.0, marked] @ self.marks_off()

    def refined(self, press: int) -> "LightFit":
        """Return the light with one press only, moved to where the light explains its picture best."""
        own = LightFit(self.placed, np.array([press]), self.field, self.light)
        own.refine_presses(4)
        return own

    def rms_against_picture(self) -> float:
        """Return the rms error in code values under the light as it is, which need not be fitted to these presses."""
        return float(np.sqrt(np.mean(self._errors(self.presses, self.flat.light(self.light)) ** 2)))

    def _errors(self, presses: np.ndarray, flat_light: np.ndarray) -> np.ndarray:
        return self._error(self._seen(presses).light(self.light), flat_light)

    def _error(self, pressed_light: np.ndarray, flat_light: np.ndarray) -> np.ndarray:
        """Return (n, 3): what is predicted less what the camera read, in codes; 0 where nothing can be read."""
        codes = 255 * srgb_encode(self.factor * predicted_light(self.base, pressed_light, flat_light))
        return (codes - self.code) * self.usable
