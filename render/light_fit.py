"""The fit of a real sensor's light: variable projection over bars, scattered light and where each press is.

The intensities of bars, ambient and scattered light enter linearly and are solved for exactly; the bars' geometry is
searched, with the linear part solved inside every step, and each press's centre and depth follow by Gauss-Newton. The
camera's distance is found by parabolas, each point of them with its own light and presses.
"""

from collections.abc import Callable
from copy import copy
from dataclasses import dataclass, replace

import numpy as np

from gelgap.render.imaging import srgb_decode, srgb_encode, srgb_slope
from gelgap.render.light_options import LightOptions
from gelgap.render.press_light import Bars, bar_light, points_seen
from gelgap.render.press_profiles import PressProfiles

DARK, SATURATED = 4, 250
REFERENCE_WEIGHT = 0.3
RIDGE = 0.3
PRIOR = {"azimuth": 0.35, "distance": 0.25, "height": 0.6, "length": 0.4, "tall": 0.6}
PRIOR_WEIGHT = 30.0
ALL_FIELDS = tuple(PRIOR)
_MOST_STEP_MM = 0.06
_LEAST_SHARE = 0.2  # of the reference that the modelled reference may be
_DARKEST = 1e-6  # linear


@dataclass(frozen=True)
class Samples:
    """Pixels of press pictures: which press, where on the plane of the flat membrane, and what the camera read."""

    index: np.ndarray  # (n,)
    rows: np.ndarray
    columns: np.ndarray
    plane_mm: np.ndarray  # (n, 2)
    code: np.ndarray  # (n, 3)
    base: np.ndarray  # (n, 3) linear: the untouched gel's light there while the press lasts

    @property
    def usable(self) -> np.ndarray:
        base_code = 255 * srgb_encode(self.base)
        return (
            (self.code > DARK) & (self.code < SATURATED) & (base_code > DARK) & (base_code < SATURATED)
        ).astype(float)


@dataclass(frozen=True)
class Light:
    """A fitted light: bars, and by column and channel what multiplies each, bars first."""

    options: LightOptions
    bars: Bars
    theta: np.ndarray  # (columns, 3)


class Geometry:
    """Points that pixels see, for presses (k, 3) at (x, y, depth), each with its sphere's profiles."""

    def __init__(
        self, samples: Samples, presses: np.ndarray, profiles: list[PressProfiles], camera_mm: np.ndarray
    ):
        tables = [own.at(press[2]) for own, press in zip(profiles, presses, strict=True)]
        width = max(len(z) for z, _ in tables)
        self.z = np.array([np.pad(z, (0, width - len(z))) for z, _ in tables])
        slopes = np.array([np.pad(slope, (0, width - len(slope))) for _, slope in tables])
        self.index, self.presses = samples.index, np.ascontiguousarray(presses, float)
        self.positions = np.empty((len(samples.index), 3))
        self.normals = np.empty_like(self.positions)
        points_seen(
            samples.plane_mm,
            self.index,
            self.presses,
            self.z,
            slopes,
            camera_mm,
            self.positions,
            self.normals,
        )

    def bar_columns(
        self, bars: Bars, shadows: bool, kept: dict[bytes, np.ndarray] | None = None
    ) -> np.ndarray:
        """Return (n, bars) irradiance; `kept` holds the columns of bars already seen."""
        out = np.empty((len(self.index), len(bars.azimuth)))
        for k, strips in enumerate(bars.strips()):
            key = strips.tobytes()
            if kept is None or key not in kept:
                column = np.empty(len(self.index))
                bar_light(
                    self.positions, self.normals, self.index, self.presses, self.z, strips, shadows, column
                )
                if kept is None:
                    out[:, k] = column
                    continue
                if len(kept) > 60:
                    kept.clear()
                kept[key] = column
            out[:, k] = kept[key]
        return out

    def columns(self, options: LightOptions, bars: Bars) -> np.ndarray:
        """Return all columns of the light."""
        fixed = options.fixed_columns(self.positions, self.normals)
        return np.concatenate([self.bar_columns(bars, options.shadows), fixed], axis=1)

    def light(self, light: Light) -> np.ndarray:
        """Return (n, 3): what the columns make together."""
        leds, flat = len(light.bars.azimuth), not self.presses.any()
        fixed = light.options.fixed_light(self.positions, None if flat else self.normals, light.theta[leds:])
        return self.bar_columns(light.bars, light.options.shadows and not flat) @ light.theta[:leds] + fixed


def flat_geometry(samples: Samples) -> Geometry:
    """Return the geometry of the same pixels on the flat membrane."""
    flat = Geometry.__new__(Geometry)
    flat.index, flat.presses, flat.z = np.zeros(len(samples.index), int), np.zeros((1, 3)), np.zeros((1, 4))
    flat.positions = np.column_stack([samples.plane_mm, np.zeros(len(samples.index))])
    flat.normals = np.broadcast_to([0.0, 0.0, -1.0], flat.positions.shape).copy()
    return flat


def predicted_codes(light: Light, samples: Samples, pressed: Geometry, flat_light: np.ndarray) -> np.ndarray:
    """Return (n, 3) unrounded codes: the untouched gel's light times modelled pressed over modelled flat light."""
    least = np.maximum(_LEAST_SHARE * samples.base, _DARKEST)
    ratio = np.maximum(pressed.light(light), 0) / np.maximum(flat_light, least)
    return 255 * srgb_encode(samples.base * ratio)


def nonnegative_least_squares(normal: np.ndarray, right: np.ndarray, count: int) -> np.ndarray:
    """Solve normal equations with the first `count` unknowns at 0 or above, by dropping negative ones."""
    free = np.ones(len(right), bool)
    while True:
        theta = np.zeros(len(right))
        theta[free] = np.linalg.solve(normal[np.ix_(free, free)], right[free])
        if (theta[:count] >= 0).all():
            return theta
        free[np.argmin(theta[:count])] = False


@dataclass(frozen=True)
class CameraRange:
    """Where the camera may stand: bounds of 1 / distance, and where presses (k, 3) start for a distance in mm."""

    nearness: tuple[float, float]
    starts: Callable[[float], np.ndarray]


class LightFit:
    """Fits a light to samples of presses; start with `run`. Without a `camera_range` the camera stays."""

    def __init__(
        self,
        options: LightOptions,
        samples: Samples,
        presses: np.ndarray,
        profiles: list[PressProfiles],
        sigma_mm: np.ndarray,
        bars: Bars,
        camera_mm: np.ndarray,
        camera_range: CameraRange | None = None,
    ) -> None:
        self.camera_range = camera_range
        self.options, self.samples, self.profiles, self.sigma_mm = options, samples, profiles, sigma_mm
        self.start_presses, self.presses = presses, presses.copy()
        self.bars = self.anchor = bars
        self.camera_mm = np.asarray(camera_mm, float)
        self.linear, self.usable = srgb_decode(samples.code / 255), samples.usable
        self.flat = flat_geometry(samples)
        self.modelled = np.maximum(samples.base, _DARKEST)
        self.theta = np.zeros((0, 3))
        self.residual = np.zeros_like(samples.base)
        self._pressed: Geometry | None = None

    @property
    def light(self) -> Light:
        return Light(self.options, self.bars, self.theta)

    @property
    def distance_mm(self) -> float:
        """The camera's, from the flat membrane."""
        return float(-self.camera_mm[2])

    @property
    def rms_code_values(self) -> float:
        return float(np.sqrt(np.mean(self.residual**2)))

    def press_errors(self) -> np.ndarray:
        """Return (presses,): the mean square of each press's residual, in code values²."""
        index = self.samples.index
        return np.array([np.mean(self.residual[index == k] ** 2) for k in range(len(self.presses))])

    def run(self, rounds: int = 3) -> None:
        """Fit bars alone first, so that scattered light does not take their place, then everything in turn."""
        if self.options.order > 0:
            whole = self.options
            self.options = replace(whole, order=0, ambient=True)
            self._solve()
            self._search(("azimuth", "height"), 6)
            self._solve()
            self.refine_presses()
            self._search(("azimuth", "height", "distance"), 4)
            self.anchor, self.options = self.bars, whole
        self._solve()
        self._search_camera(1.0)
        for k in range(rounds):
            self._search(ALL_FIELDS, 5)
            self._solve()
            self.refine_presses()
            self._solve()
            if k == 0:
                self._search_camera(0.4)

    def pressed(self) -> Geometry:
        """Return the geometry of the presses where they now are."""
        if self._pressed is None:
            self._pressed = Geometry(self.samples, self.presses, self.profiles, self.camera_mm)
        return self._pressed

    def _ridge(self) -> np.ndarray:
        return RIDGE * len(self.samples.index) * self.options.penalty(len(self.bars.azimuth)) ** 2

    def _weights(self, channel: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return weights of pressed and flat columns in the picture's error, and of flat ones in the reference's."""
        base, linear = self.samples.base[:, channel], self.linear[:, channel]
        usable, modelled = self.usable[:, channel], self.modelled[:, channel]
        picture = 255 * usable * srgb_slope(linear) / modelled
        return picture * base, picture * linear, 255 * REFERENCE_WEIGHT * usable * srgb_slope(base)

    def _solve(self) -> None:
        """Solve for all intensities: base × (A θ)/(B θ) shall be the picture, and B θ near the reference."""
        pressed = self.pressed().columns(self.options, self.bars)
        flat = self.flat.columns(replace(self.options, shadows=False), self.bars)
        base, ridge = self.samples.base, self._ridge()
        self.theta = np.empty((pressed.shape[1], 3))
        for channel in range(3):
            for _ in range(2):
                of_pressed, of_flat, of_reference = self._weights(channel)
                rows = pressed * of_pressed[:, None] - flat * of_flat[:, None]
                reference = flat * of_reference[:, None]
                normal = rows.T @ rows + reference.T @ reference
                normal[np.diag_indices_from(normal)] += ridge
                right = reference.T @ (of_reference * base[:, channel])
                theta = nonnegative_least_squares(normal, right, len(self.bars.azimuth))
                least = np.maximum(_LEAST_SHARE * base[:, channel], _DARKEST)
                self.modelled[:, channel] = np.maximum(flat @ theta, least)
            self.theta[:, channel] = theta
        codes = 255 * srgb_encode(base * np.maximum(pressed @ self.theta, 0) / self.modelled)
        self.residual = (codes - self.samples.code) * self.usable

    def _search(self, fields: tuple[str, ...], evaluations: int) -> None:
        """Search the bars' geometry; the modelled reference is held, so most normal equations are formed once."""
        from scipy.optimize import least_squares

        leds, ridge = len(self.bars.azimuth), self._ridge()
        pressed, flat, options = self.pressed(), self.flat, self.options
        of_pressed_fixed = options.fixed_columns(pressed.positions, pressed.normals)
        of_flat_fixed = options.fixed_columns(flat.positions, flat.normals)
        held = []
        for channel in range(3):
            a, b, r = self._weights(channel)
            rows = of_pressed_fixed * a[:, None] - of_flat_fixed * b[:, None]
            reference = of_flat_fixed * r[:, None]
            target = r * self.samples.base[:, channel]
            held.append((a, b, r, rows, reference, rows.T @ rows + reference.T @ reference, target))
        prior = np.concatenate([np.full(leds, PRIOR[field]) for field in fields])
        anchor, nearest = self.anchor.packed(fields), options.nearest_mm
        kept_pressed: dict[bytes, np.ndarray] = {}
        kept_flat: dict[bytes, np.ndarray] = {}

        def unexplained(vector: np.ndarray) -> np.ndarray:
            bars = self.bars.unpacked(vector, fields, nearest)
            lit = pressed.bar_columns(bars, options.shadows, kept_pressed)
            unpressed = flat.bar_columns(bars, False, kept_flat)
            errors = []
            for a, b, r, rows, reference, fixed, target in held:
                of_bars, bars_reference = lit * a[:, None] - unpressed * b[:, None], unpressed * r[:, None]
                normal = np.empty((leds + len(fixed),) * 2)
                normal[:leds, :leds] = of_bars.T @ of_bars + bars_reference.T @ bars_reference
                normal[:leds, leds:] = of_bars.T @ rows + bars_reference.T @ reference
                normal[leds:, :leds] = normal[:leds, leds:].T
                normal[leds:, leds:] = fixed
                normal[np.diag_indices_from(normal)] += ridge
                right = np.concatenate([bars_reference.T @ target, reference.T @ target])
                theta = nonnegative_least_squares(normal, right, leds)
                errors += [
                    of_bars @ theta[:leds] + rows @ theta[leds:],
                    bars_reference @ theta[:leds] + reference @ theta[leds:] - target,
                    np.sqrt(ridge) * theta,
                ]
            return np.concatenate([*errors, PRIOR_WEIGHT * (vector - anchor) / prior])

        start = self.bars.packed(fields)
        found = least_squares(unexplained, start, max_nfev=evaluations, diff_step=3e-3, x_scale=prior)
        self.bars = self.bars.unpacked(found.x, fields, nearest)

    def _search_camera(self, share: float) -> None:
        """Move the camera to the least of a parabola over 1 / distance, through three in a share of its range."""
        if self.camera_range is None:
            return
        low, high = self.camera_range.nearness
        half = share * (high - low) / 2
        middle = np.clip(1 / self.distance_mm, low + half, high - half)
        nearness = np.array([middle - half, middle, middle + half])
        tried = [self._seen_from(1 / value) for value in nearness]
        curvature, slope, _ = np.polyfit(nearness - middle, [own.rms_code_values for own in tried], 2)
        if curvature > 0:
            least = np.clip(middle - slope / (2 * curvature), low, high)
            if np.abs(nearness - least).min() > 1e-9:
                tried.append(self._seen_from(1 / least))
        best = min(tried, key=lambda own: own.rms_code_values)
        self.camera_mm, self.start_presses, self.presses = best.camera_mm, best.start_presses, best.presses
        self.theta, self.modelled, self.residual = best.theta, best.modelled, best.residual
        self._pressed = None

    def _seen_from(self, distance_mm: float) -> "LightFit":
        """Return the fit under a camera at another distance, with presses moved and light solved for anew."""
        other = copy(self)
        other.camera_mm = np.array([*self.camera_mm[:2], -distance_mm])
        other.start_presses = self.camera_range.starts(distance_mm)
        other.presses = other.start_presses + self.presses - self.start_presses
        deepest = [profiles.deepest_mm for profiles in self.profiles]
        other.presses[:, 2] = np.clip(other.presses[:, 2], 0.02, deepest)
        other.modelled, other._pressed = self.modelled.copy(), None
        other._solve()
        other.refine_presses(1)
        other._solve()
        return other

    def refine_presses(self, rounds: int = 2) -> None:
        """Move each press's centre and depth by Gauss-Newton under the light as it is, all presses at once."""
        index, flat_light = self.samples.index, self.flat.light(self.light)

        def errors(presses: np.ndarray) -> np.ndarray:
            return self._errors(presses, flat_light)

        for _ in range(rounds):
            now = errors(self.presses)
            slopes = []
            for axis, step_mm in enumerate((0.015, 0.015, 0.01)):
                moved = self.presses.copy()
                moved[:, axis] += step_mm
                slopes.append((errors(moved) - now) / step_mm)
            for k, profiles in enumerate(self.profiles):
                own = index == k
                jacobian, error = np.stack([s[own].ravel() for s in slopes], axis=1), now[own].ravel()
                weighted = (jacobian / np.sqrt(1 + (error / 10) ** 2)[:, None]).T
                stiffness = 100 / self.sigma_mm[k] ** 2
                off = self.presses[k] - self.start_presses[k]
                step = -np.linalg.solve(
                    weighted @ jacobian + np.diag(stiffness), weighted @ error + stiffness * off
                )
                self.presses[k] += np.clip(step, -_MOST_STEP_MM, _MOST_STEP_MM)
                self.presses[k, 2] = np.clip(self.presses[k, 2], 0.02, profiles.deepest_mm)
        self._pressed = None

    def rms_against_picture(self) -> float:
        """Return the rms error in code values under the light as it is, which need not be fitted to these presses."""
        return float(np.sqrt(np.mean(self._errors(self.presses, self.flat.light(self.light)) ** 2)))

    def _errors(self, presses: np.ndarray, flat_light: np.ndarray) -> np.ndarray:
        geometry = Geometry(self.samples, presses, self.profiles, self.camera_mm)
        return (
            predicted_codes(self.light, self.samples, geometry, flat_light) - self.samples.code
        ) * self.usable
