"""Light of bars on the axially symmetric membrane around a sphere: what a calibration evaluates thousands of times.

The renderer's own kernels light a whole lattice; a fit needs some hundred points of each press, over and over.
"""

from dataclasses import dataclass, replace

import numba
import numpy as np

from gelgap.render.led import LED_SHAPES, Led

_CELLS_PER_MM = 50.0  # 1 / press_profiles.STEP_MM
LOGARITHMIC = ("distance", "height", "length", "tall")
STRIPS = 3


@dataclass(frozen=True)
class Bars:
    """Bars that face the sensor's axis, level; each field (leds,), lengths in mm, angles in radians.

    `height` is above the membrane, `length` across the azimuth, `tall` the extent along z.
    """

    azimuth: np.ndarray
    distance: np.ndarray
    height: np.ndarray
    length: np.ndarray
    tall: np.ndarray

    @classmethod
    def of(cls, leds: tuple[Led, ...], nearest_mm: float) -> "Bars":
        """Return bars in the place of LEDs, no nearer to the axis than `nearest_mm`."""
        x, y, z = np.array([led.position_mm for led in leds]).T
        sizes = np.array([LED_SHAPES[led.kind].size_mm(led) for led in leds])
        bars = cls(
            np.arctan2(y, x), np.hypot(x, y), -z, np.maximum(sizes[:, 0], 1.0), np.maximum(sizes[:, 1], 0.5)
        )
        return bars.bounded(nearest_mm)

    def bounded(self, nearest_mm: float) -> "Bars":
        """Return the bars within what a sensor can be: beyond the view, within 80 mm, above the membrane."""
        height = np.clip(self.height, 0.5, 60.0)
        return replace(
            self,
            distance=np.clip(self.distance, nearest_mm, 80.0),
            height=height,
            length=np.clip(self.length, 1.0, 120.0),
            tall=np.minimum(self.tall, 1.9 * height),
        )

    def packed(self, fields: tuple[str, ...]) -> np.ndarray:
        """Return some fields as a vector, lengths as logarithms."""
        return np.concatenate(
            [np.log(getattr(self, f)) if f in LOGARITHMIC else getattr(self, f) for f in fields]
        )

    def unpacked(self, vector: np.ndarray, fields: tuple[str, ...], nearest_mm: float) -> "Bars":
        """Return the bars with the fields of a vector."""
        parts = np.split(vector, len(fields))
        values = {f: np.exp(v) if f in LOGARITHMIC else v for f, v in zip(fields, parts, strict=True)}
        return replace(self, **values).bounded(nearest_mm)

    def strips(self) -> np.ndarray:
        """Return (leds, strips, 10): low end, high end, normal and weight of upright strips.

        Weights are such that a bar gives a flat point that faces it, as far away as the axis, the irradiance 1.
        """
        nodes, weights = np.polynomial.legendre.leggauss(STRIPS)
        out = np.zeros((len(self.azimuth), STRIPS, 10))
        for led, azimuth in enumerate(self.azimuth):
            outwards = np.array([np.cos(azimuth), np.sin(azimuth), 0])
            level = np.array([outwards[1], -outwards[0], 0])
            for k, node in enumerate(nodes):
                foot = outwards * self.distance[led] + level * (node * self.length[led] / 2)
                half = self.tall[led] / 2
                out[led, k, :3] = np.add(foot, [0, 0, -max(self.height[led] - half, 0.02)])
                out[led, k, 3:6] = np.add(foot, [0, 0, -(self.height[led] + half)])
                out[led, k, 6:9] = -outwards
                out[led, k, 9] = weights[k] / 2
        out[:, :, 9] *= (self.distance**2 + self.height**2)[:, None]
        return out

    def leds(self, names: tuple[str, ...], intensities: np.ndarray, albedo: np.ndarray, exposure: float):
        """Return the LEDs of intensities (leds, 3): linear light of a white flat point of irradiance 1."""
        per_radiance = self.length * self.tall / (self.distance**2 + self.height**2)
        radiance = intensities * np.pi / np.maximum(albedo, 1e-6) / per_radiance[:, None]
        leds = []
        for k, name in enumerate(names):
            brightest = max(radiance[k].max(), 1e-9)
            outwards = np.array([np.cos(self.azimuth[k]), np.sin(self.azimuth[k])])
            foot = (outwards * self.distance[k]).tolist()
            leds.append(
                Led(
                    name=name,
                    kind="bar",
                    position_mm=(*foot, -float(self.height[k])),
                    facing=(*(-outwards).tolist(), 0.0),
                    length_mm=float(self.length[k]),
                    height_mm=float(self.tall[k]),
                    spectrum={"rgb": tuple((radiance[k] / brightest).tolist())},
                    drive=float(brightest / exposure),
                )
            )
        return tuple(leds)


@numba.njit(cache=True, fastmath=True, inline="always")
def _at(table, press, r):
    cell = r * _CELLS_PER_MM
    if cell >= table.shape[1] - 2:
        return 0.0
    i = int(cell)
    return table[press, i] + (table[press, i + 1] - table[press, i]) * (cell - i)


@numba.njit(cache=True, fastmath=True)
def points_seen(plane_mm, index, presses, z, slopes, camera_mm, positions, normals):
    """Fill where the rays through plane_mm (n, 2) on z = 0 meet their presses' membranes, and the normals there."""
    camera_x, camera_y, distance = camera_mm[0], camera_mm[1], -camera_mm[2]
    for i in range(len(plane_mm)):
        k = index[i]
        px, py = plane_mm[i]
        ax, ay = (px - camera_x) / distance, (py - camera_y) / distance
        height = 0.0
        for _ in range(12):
            dx, dy = px + ax * height - presses[k, 0], py + ay * height - presses[k, 1]
            r = np.sqrt(dx * dx + dy * dy) + 1e-9
            error = _at(z, k, r) - height
            step = error / min(_at(slopes, k, r) * (dx * ax + dy * ay) / r - 1.0, -0.25)
            height -= step
            if abs(step) < 1e-5:
                break
        x, y = px + ax * height, py + ay * height
        positions[i, 0], positions[i, 1], positions[i, 2] = x, y, height
        dx, dy = x - presses[k, 0], y - presses[k, 1]
        r = np.sqrt(dx * dx + dy * dy) + 1e-9
        slope = _at(slopes, k, r)
        scale = 1 / np.sqrt(1 + slope * slope)
        normals[i, 0], normals[i, 1], normals[i, 2] = slope * dx / r * scale, slope * dy / r * scale, -scale


@numba.njit(cache=True, fastmath=True)
def _horizon(x, y, height, ux, uy, reach, press, z, k):
    """Return the steepest rise of the membrane from a point towards (ux, uy), up to a distance."""
    steps = min(int(reach / 0.12) + 3, 60)
    h = reach / steps
    steepest, where = -1e9, 0.0
    for m in range(steps):
        t = (m + 0.5) * h
        r = np.sqrt((x - press[0] + t * ux) ** 2 + (y - press[1] + t * uy) ** 2)
        rise = (height - _at(z, k, r)) / t
        if rise > steepest:
            steepest, where = rise, t
    for _ in range(3):
        h *= 0.5
        for side in range(2):
            t = where + (h if side else -h)
            if t < 0.01:
                continue
            r = np.sqrt((x - press[0] + t * ux) ** 2 + (y - press[1] + t * uy) ** 2)
            rise = (height - _at(z, k, r)) / t
            if rise > steepest:
                steepest, where = rise, t
    return steepest


@numba.njit(cache=True, fastmath=True, inline="always")
def _clipped(low, high, s0, s1):
    """Return the part s0…s1 of a strip where a quantity, linear from low to high, is positive."""
    if low <= 0 and high <= 0:
        return 1.0, 0.0
    if low < 0:
        s0 = max(s0, low / (low - high))
    elif high < 0:
        s1 = min(s1, low / (low - high))
    return s0, s1


@numba.njit(cache=True, fastmath=True)
def bar_light(positions, normals, index, presses, z, strips, shadows, out):
    """Fill out (n,) with one bar's irradiance; with `shadows`, the press hides what lies behind its horizon."""
    for i in range(len(positions)):
        k = index[i]
        x, y, height = positions[i]
        nx, ny, nz = normals[i]
        total = 0.0
        for j in range(len(strips)):
            ax, ay, az = strips[j, 0] - x, strips[j, 1] - y, strips[j, 2] - height
            bz = strips[j, 5] - height
            away = -(strips[j, 6] * ax + strips[j, 7] * ay)
            level = nx * ax + ny * ay
            s0, s1 = _clipped(level + nz * az, level + nz * bz, 0.0, 1.0)
            if away <= 0 or s1 <= s0:
                continue
            distance = np.sqrt(ax * ax + ay * ay)
            ux, uy = ax / distance, ay / distance
            reach = (presses[k, 0] - x) * ux + (presses[k, 1] - y) * uy
            if shadows and reach > 0.02:
                rise = _horizon(x, y, height, ux, uy, reach, presses[k], z, k)
                s0, s1 = _clipped(-az - rise * distance, -bz - rise * distance, s0, s1)
                if s1 <= s0:
                    continue
            for g in range(2):
                w = s0 + (s1 - s0) * (0.2113248654 if g == 0 else 0.7886751346)
                dz = az + w * (bz - az)
                r2 = ax * ax + ay * ay + dz * dz
                total += 0.5 * (s1 - s0) * strips[j, 9] * max(level + nz * dz, 0.0) * away / (r2 * r2)
        out[i] = total
