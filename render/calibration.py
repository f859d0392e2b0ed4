"""Fitting a sensor file to a real sensor: LED colours, levels and positions, and the coat's gloss.

What is known of a real picture is the shape where a sphere touches: the sphere's own. So the fit uses the reference
picture, where the membrane is flat, and of each press the inside of the contact. There nothing casts a shadow but the
point's own tangent plane. LED colours enter linearly and are solved for exactly at every step; only positions, the
weight of the gloss and presses' centres are searched, by least squares on errors in code values.
"""

from dataclasses import dataclass
from pathlib import Path

import numba
import numpy as np

from gelgap.render.camera import Camera
from gelgap.render.illumination import Illumination, Led
from gelgap.render.imaging import srgb_decode, srgb_slope
from gelgap.render.plastic import REFRACTIVE_INDEX, highlight, interface_shares, shadowing, transmitted_share
from gelgap.render.sensor import Sensor
from gelgap.render.shading import ShadowDetail, led_samples
from gelgap.render.spectrum import RgbSpectrum

REFERENCE_POINTS = (28, 21)
PRESS_POINTS = 250
# Share of the estimated contact radius within which the membrane surely touches the sphere.
SURE_CONTACT = 0.8
SATURATED = 250
DARK = 4


@dataclass(frozen=True)
class PressPicture:
    """A picture of a pressed sphere. Depth is that of the sphere's lowest point below the undeformed membrane.

    `point_mm` is where the sphere was pressed; without it, it is found in the picture and refined by the fit.
    """

    picture: np.ndarray  # uint8 (h, w, 3)
    sphere_diameter_mm: float
    depth_mm: float
    point_mm: tuple[float, float] | None = None


@dataclass(frozen=True)
class Calibration:
    """The fitted sensor, with its LEDs, and how well it explains the pictures."""

    sensor: Sensor
    rms_code_values: float
    press_points_mm: tuple[tuple[float, float], ...]
    evaluations: int


@dataclass(frozen=True)
class _Samples:
    """Pixels with known geometry: positions and normals of the membrane, and what the camera read there."""

    positions_mm: np.ndarray
    normals: np.ndarray
    linear: np.ndarray
    weight: np.ndarray


@numba.njit(cache=True)
def _point_terms(positions, normals, nodes, camera, roughness, eta, shares, scale, out):
    """Fill out[point, led] = (Lambert, plastic base, plastic highlight) per unit radiance; each / π but the last."""
    for p in range(len(positions)):
        px, py, pz = positions[p]
        nx, ny, nz = normals[p]
        vx, vy, vz = camera[0] - px, camera[1] - py, camera[2] - pz
        inverse = 1 / np.sqrt(vx * vx + vy * vy + vz * vz)
        vx, vy, vz = vx * inverse, vy * inverse, vz * inverse
        # A guess may look along the sphere's flank; nothing is seen there.
        cosine_out = max(nx * vx + ny * vy + nz * vz, 1e-3)
        share_out = scale * transmitted_share(cosine_out, shares)
        shadowing_out = shadowing(cosine_out, roughness) / (4 * cosine_out)
        for led in range(len(nodes)):
            lambert, base, glossy = 0.0, 0.0, 0.0
            for k in range(nodes.shape[2]):
                if nodes[led, 6, k] < 0:
                    break
                x, y, z = nodes[led, 0, k] - px, nodes[led, 1, k] - py, nodes[led, 2, k] - pz
                r2 = x * x + y * y + z * z
                inverse = 1 / np.sqrt(r2)
                cosine_in = (nx * x + ny * y + nz * z) * inverse
                solid_angle = 1 / r2
                if nodes[led, 6, k] > 0:
                    away = nodes[led, 3, k] * x + nodes[led, 4, k] * y + nodes[led, 5, k] * z
                    solid_angle *= -away * inverse * nodes[led, 6, k]
                if cosine_in <= 0 or solid_angle <= 0:
                    continue
                lambert += solid_angle * cosine_in
                base += solid_angle * cosine_in * transmitted_share(cosine_in, shares) * share_out
                in_dot_out = (x * vx + y * vy + z * vz) * inverse
                glossy += solid_angle * highlight(
                    cosine_in, cosine_out, in_dot_out, shadowing_out, roughness, eta
                )
            out[p, led, 0] = lambert / np.pi
            out[p, led, 1] = base / np.pi
            out[p, led, 2] = glossy


class _Problem:
    """The pictures, and what a guess of positions, gloss and press centres leaves unexplained."""

    def __init__(
        self, sensor: Sensor, reference: np.ndarray, presses: tuple[PressPicture, ...], fit_gloss: bool
    ):
        self.sensor = sensor
        self.leds = sensor.illumination.leds
        self.presses = presses
        self.fit_gloss = fit_gloss
        self.reference = _flat_samples(sensor.camera, reference)
        self.start_points_mm = [
            press.point_mm or find_contact_mm(press.picture, reference, sensor.camera) for press in presses
        ]
        self.unknown_points = [index for index, press in enumerate(presses) if press.point_mm is None]
        self.choose_pixels(self.start_points_mm)

    def choose_pixels(self, points_mm: list[tuple[float, float]]) -> None:
        """Take from each press the pixels that surely see its contact if the sphere stands at that point."""
        self.pixels = [
            _contact_pixels(self.sensor.camera, press, point)
            for press, point in zip(self.presses, points_mm, strict=True)
        ]

    def start(self) -> np.ndarray:
        positions = np.array([led.position_mm for led in self.leds]).ravel()
        gloss = [self.sensor.coating.specular] if self.fit_gloss else []
        points = [value for index in self.unknown_points for value in self.start_points_mm[index]]
        return np.concatenate([positions, gloss, points])

    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        count = len(self.leds)
        start = self.start()
        low, high = start - 1.0, start + 1.0
        low[: 3 * count], high[: 3 * count] = start[: 3 * count] - 6, start[: 3 * count] + 6
        heights_mm = np.array([np.abs(led.half_axes_mm()[:, 2]).sum() for led in self.leds])
        high[2 : 3 * count : 3] = np.minimum(high[2 : 3 * count : 3], -heights_mm - 0.05)
        if self.fit_gloss:
            low[3 * count], high[3 * count] = -1e-9, 1
        return low, high

    def points_mm(self, guess: np.ndarray) -> list[tuple[float, float]]:
        points = list(self.start_points_mm)
        tail = guess[3 * len(self.leds) + self.fit_gloss :].reshape(-1, 2)
        for index, point in zip(self.unknown_points, tail, strict=True):
            points[index] = (float(point[0]), float(point[1]))
        return points

    def moved_leds(self, guess: np.ndarray) -> tuple[Led, ...]:
        positions = guess[: 3 * len(self.leds)].reshape(-1, 3)
        return tuple(
            led.model_copy(update={"position_mm": tuple(position.tolist())})
            for led, position in zip(self.leds, positions, strict=True)
        )

    def specular(self, guess: np.ndarray) -> float:
        return float(guess[3 * len(self.leds)]) if self.fit_gloss else self.sensor.coating.specular

    def samples(self, guess: np.ndarray) -> list[_Samples]:
        return [self.reference] + [
            _contact_samples(self.sensor.camera, press, point, pixels)
            for press, point, pixels in zip(self.presses, self.points_mm(guess), self.pixels, strict=True)
        ]

    def solve_levels(self, guess: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return (leds, 3) levels and the residuals in code values that remain with them."""
        from scipy.optimize import nnls

        samples = self.samples(guess)
        positions = np.concatenate([part.positions_mm for part in samples])
        normals = np.concatenate([part.normals for part in samples])
        linear = np.concatenate([part.linear for part in samples])
        weight = np.concatenate([part.weight for part in samples])
        terms = point_terms(self.sensor, self.moved_leds(guess), positions, normals)
        gloss = self.specular(guess)
        levels, residuals = np.empty((len(self.leds), 3)), []
        for channel, albedo in enumerate(self.sensor.coating.albedo):
            design = (1 - gloss) * albedo * terms[..., 0] + gloss * (albedo * terms[..., 1] + terms[..., 2])
            weighted = weight[:, channel, None] * design
            target = weight[:, channel] * linear[:, channel]
            levels[:, channel], _ = nnls(weighted, target)
            residuals.append(weighted @ levels[:, channel] - target)
        return levels, np.concatenate(residuals)


def point_terms(
    sensor: Sensor, leds: tuple[Led, ...], positions_mm: np.ndarray, normals: np.ndarray
) -> np.ndarray:
    """Return (n, leds, 3): Lambert, plastic base and highlight of unshadowed points, per unit LED radiance."""
    light = Illumination.model_construct(leds=leds)
    emitters = light.emitters(sensor.camera, np.ones((len(leds), 3)))
    samples = led_samples(emitters, ShadowDetail(strip_width_mm=2.0, fewest_strips=3, march_step_mm=1.0))
    shares, scale = interface_shares(sensor.coating.roughness)
    out = np.empty((len(positions_mm), len(leds), 3))
    _point_terms(
        positions_mm,
        normals,
        samples.nodes.astype(float),
        np.asarray(sensor.camera.position_mm),
        np.float32(sensor.coating.roughness),
        np.float32(REFRACTIVE_INDEX),
        shares,
        scale,
        out,
    )
    return out


def _rays(camera: Camera, columns: np.ndarray, rows: np.ndarray, size_px: tuple[int, int]) -> np.ndarray:
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
    from gelgap.render.inpainting import detect_markers

    return ~detect_markers(picture)[rows, columns]


def _flat_samples(camera: Camera, reference: np.ndarray) -> _Samples:
    height, width, _ = reference.shape
    columns, rows = np.meshgrid(
        np.linspace(2, width - 3, REFERENCE_POINTS[0]).round().astype(int),
        np.linspace(2, height - 3, REFERENCE_POINTS[1]).round().astype(int),
    )
    columns, rows = columns.ravel(), rows.ravel()
    clear = _without_dots(reference, columns, rows)
    columns, rows = columns[clear], rows[clear]
    rays = _rays(camera, columns + 0.5, rows + 0.5, (width, height))
    positions = np.asarray(camera.position_mm) - camera.position_mm[2] * rays
    normals = np.broadcast_to([0.0, 0.0, -1.0], positions.shape).copy()
    return _Samples(positions, normals, *_read(camera, reference, columns, rows))


def _contact_pixels(camera: Camera, press: PressPicture, point_mm: tuple[float, float]):
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


def _contact_samples(camera: Camera, press: PressPicture, point_mm: tuple[float, float], pixels) -> _Samples:
    columns, rows = pixels
    height, width, _ = press.picture.shape
    rays = _rays(camera, columns + 0.5, rows + 0.5, (width, height))
    radius_mm = press.sphere_diameter_mm / 2
    center = np.array([*point_mm, radius_mm - press.depth_mm])
    offset = np.asarray(camera.position_mm) - center
    a, b = (rays**2).sum(1), rays @ offset
    root = np.sqrt(np.maximum(b**2 - a * (offset @ offset - radius_mm**2), 0))
    positions = np.asarray(camera.position_mm) + ((-b - root) / a)[:, None] * rays
    return _Samples(positions, (positions - center) / radius_mm, *_read(camera, press.picture, columns, rows))


def find_contact_mm(picture: np.ndarray, reference: np.ndarray, camera: Camera) -> tuple[float, float]:
    """Return where a press changed the picture most: the centre of mass of the strong differences.

    Raises
    ------
    ValueError
        If the picture hardly differs from the reference.
    """
    import cv2

    difference = np.abs(picture.astype(np.float32) - reference).max(axis=2)
    difference = cv2.GaussianBlur(difference, (0, 0), picture.shape[1] / 80)
    if difference.max() < 5:
        raise ValueError("a press picture hardly differs from the reference; no contact was found in it")
    strong = np.where(difference > 0.5 * difference.max(), difference, 0)
    rows, columns = np.indices(strong.shape)
    column, row = (strong * columns).sum() / strong.sum(), (strong * rows).sum() / strong.sum()
    height, width = strong.shape
    ray = _rays(camera, np.array([column + 0.5]), np.array([row + 0.5]), (width, height))[0]
    return tuple((np.asarray(camera.position_mm[:2]) - camera.position_mm[2] * ray[:2]).tolist())


def calibrate(
    sensor: Sensor, reference: np.ndarray, presses: tuple[PressPicture, ...], fit_gloss: bool = False
) -> Calibration:
    """Fit the LEDs of a sensor, and on wish the weight of its gloss, to pictures of a real one.

    Parameters
    ----------
    sensor
        The start: camera, coat, and its own LEDs roughly where they are (within 6 mm); their sizes and directions are
        kept. Colours and levels need no start.
    reference
        uint8 (h, w, 3) without contact.
    presses
        Pictures of pressed spheres; three or more at different places hold the positions.

    Raises
    ------
    ValueError
        If the sensor has no LEDs of its own, there is no press, or sizes differ.
    """
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
        if not 0 < press.depth_mm < press.sphere_diameter_mm / 2:
            raise ValueError(
                f"depth_mm is {press.depth_mm}; it must lie between 0 and the sphere's radius, "
                f"{press.sphere_diameter_mm / 2}"
            )
    problem = _Problem(sensor, reference, tuple(presses), fit_gloss)
    fit = _search(problem, problem.start())
    if problem.unknown_points:
        # Pixels were chosen around points that were found roughly; choose them anew around the fitted ones.
        problem.choose_pixels(problem.points_mm(fit.x))
        fit = _search(problem, fit.x)
    levels, residuals = problem.solve_levels(fit.x)
    exposure = sensor.camera.exposure
    leds = tuple(
        Led(**{**led.model_dump(), "drive": max(level.max(), 1e-9) / exposure,
               "spectrum": RgbSpectrum(rgb=tuple((level / max(level.max(), 1e-9)).tolist())).model_dump()})
        for led, level in zip(problem.moved_leds(fit.x), levels, strict=True)
    )  # fmt: skip
    fitted = sensor.model_copy(
        update={
            "illumination": sensor.illumination.model_copy(update={"leds": leds}),
            "coating": sensor.coating.model_copy(
                update={"specular": float(np.clip(problem.specular(fit.x), 0, 1))}
            ),
        }
    )
    points = tuple(problem.points_mm(fit.x))
    return Calibration(fitted, float(np.sqrt(np.mean(residuals**2))), points, int(fit.nfev))


def _search(problem: _Problem, start: np.ndarray):
    from scipy.optimize import least_squares

    return least_squares(
        lambda guess: problem.solve_levels(guess)[1],
        start,
        bounds=problem.bounds(),
        loss="soft_l1",
        f_scale=3.0,
        diff_step=1e-4,
        xtol=1e-6,
        ftol=1e-6,
        max_nfev=40,
    )


def save_sensor(sensor: Sensor, path: str | Path) -> None:
    """Write a sensor TOML that `Sensor.load` reads back."""
    Path(path).write_text(
        "\n".join(_toml_lines(sensor.model_dump(exclude_none=True), "")) + "\n", encoding="utf-8"
    )


def _toml_lines(table: dict, prefix: str) -> list[str]:
    lines, nested = [], []
    for key, value in table.items():
        name = f"{prefix}{key}"
        if isinstance(value, dict) and key != "spectrum":
            nested += ["", f"[{name}]", *_toml_lines(value, f"{name}.")]
        elif isinstance(value, tuple) and value and isinstance(value[0], dict):
            for item in value:
                nested += ["", f"[[{name}]]", *_toml_lines(item, f"{name}.")]
        else:
            lines.append(f"{key} = {_toml_value(value)}")
    return lines + nested


def _toml_value(value: object) -> str:
    match value:
        case bool():
            return str(value).lower()
        case float():
            return repr(round(value, 9))
        case str():
            escaped = value.replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\n")
            return f'"{escaped}"'
        case tuple() | list():
            return "[" + ", ".join(_toml_value(item) for item in value) + "]"
        case dict():
            return "{ " + ", ".join(f"{key} = {_toml_value(item)}" for key, item in value.items()) + " }"
    return repr(value)
