"""The model of a light: bars, ambient and scattered light around pressed spheres, and what a camera reads of it.

The renderer's own kernels light a whole lattice; a fit needs some hundred points of each press, thousands of times.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numba
import numpy as np

from gelgap.calibrate.profiles import STEP_MM, PressProfiles
from gelgap.render.light.irradiance import GAUSS_NODES, GAUSS_WEIGHTS
from gelgap.render.light.leds import Led, node_count
from gelgap.render.light.scattered import HARMONICS, PLACES, harmonics, places

LOGARITHMIC = ("distance", "height", "length", "tall")
LEAST_SHARE = 0.5
_DARKEST = 1e-6  # linear
_KEPT_COLUMNS = 60
_CELLS_PER_MM = 1 / STEP_MM
_ORDERS = np.array([1] * 3 + [2] * 5 + [3] * 7)
_DEGREES = np.array([0, 1, 1, 2, 2, 2])


@dataclass(frozen=True)
class Bars:
    """Bars that face the sensor's axis, level, each beyond `nearest` of it; lengths in mm, angles in radians.

    `height` is above the membrane, `length` across the azimuth, `tall` the extent along z; each field is (leds,).
    """

    nearest: float
    azimuth: np.ndarray
    distance: np.ndarray
    height: np.ndarray
    length: np.ndarray
    tall: np.ndarray

    @property
    def count(self) -> int:
        return len(self.azimuth)

    @classmethod
    def of(cls, leds: tuple[Led, ...], nearest_mm: float) -> "Bars":
        """Return bars in the place of LEDs, no nearer to the axis than `nearest_mm`."""
        x, y, z = np.array([led.position_mm for led in leds]).T
        sizes = np.array([led.size_mm for led in leds])
        length, tall = np.maximum(sizes, (1.0, 0.5)).T
        return cls(nearest_mm, np.arctan2(y, x), np.hypot(x, y), -z, length, tall)._bounded()

    def _bounded(self) -> "Bars":
        """Return the bars within what a sensor can be, above the membrane."""
        values = {field: np.clip(getattr(self, field), *limits) for field, limits in self.limits.items()}
        return replace(self, **values, tall=np.minimum(self.tall, 1.9 * values["height"]))

    @property
    def limits(self) -> dict[str, tuple[float, float]]:
        """The least and most of distance, which is beyond the view, height and length."""
        return {"distance": (self.nearest, 80.0), "height": (0.5, 60.0), "length": (1.0, 120.0)}

    def packed(self, fields: tuple[str, ...]) -> np.ndarray:
        """Return some fields as a vector, lengths as logarithms."""
        return np.concatenate(
            [np.log(getattr(self, f)) if f in LOGARITHMIC else getattr(self, f) for f in fields]
        )

    def unpacked(self, vector: np.ndarray, fields: tuple[str, ...]) -> "Bars":
        """Return the bars with the fields of a vector."""
        parts = np.split(vector, len(fields))
        values = {f: np.exp(v) if f in LOGARITHMIC else v for f, v in zip(fields, parts, strict=True)}
        return replace(self, **values)._bounded()

    def strips(self) -> list[np.ndarray]:
        """Return (strips, 10) of each bar: low end, high end, normal and weight of as many as the renderer has.

        Weights are such that a bar gives a flat point that faces it, as far away as the axis, the irradiance 1.
        """
        out = []
        for led, azimuth in enumerate(self.azimuth):
            outwards = np.array([np.cos(azimuth), np.sin(azimuth), 0])
            level = np.array([outwards[1], -outwards[0], 0])
            low = max(self.height[led] - self.tall[led] / 2, 0.02)
            count = node_count(self.length[led] / 2, np.hypot(self.distance[led] - self.nearest, low))
            places, weights = np.polynomial.legendre.leggauss(count)
            feet = outwards * self.distance[led] + level * (places * self.length[led] / 2)[:, None]
            high = self.height[led] + self.tall[led] / 2
            weights = weights / 2 * (self.distance[led] ** 2 + self.height[led] ** 2)
            ends = feet - [0, 0, low], feet - [0, 0, high]
            out.append(np.column_stack([*ends, np.tile(-outwards, (count, 1)), weights]))
        return out

    def leds(self, names: Sequence[str], intensities: np.ndarray, albedo: np.ndarray, exposure: float):
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


@dataclass(frozen=True)
class Light:
    """Bars, ambient and scattered light; each is columns of a linear problem, in this order.

    Places are in units of `scale_mm` and held at the edges of `span_mm`.
    """

    order: int
    degree: int
    scale_mm: float
    span_mm: tuple[float, float, float, float]
    bars: Bars
    theta: np.ndarray  # (columns, 3): what multiplies each

    def penalty(self) -> np.ndarray:
        """Return the square roots of the ridge's weights by column."""
        parts = [np.full(self.bars.count, 1e-3), np.full(self.ambient_columns, 0.3)]
        if self.order:
            orders, degrees = _ORDERS[: HARMONICS[self.order]], _DEGREES[: PLACES[self.degree]]
            parts.append((orders[:, None] * (1.0 + degrees)).ravel())
        return np.concatenate(parts)

    @property
    def ambient_columns(self) -> int:
        return PLACES[1] if self.order else 1

    def _places(self, positions: np.ndarray) -> np.ndarray:
        return places(positions[:, 0], positions[:, 1], self.span_mm, self.scale_mm, 2)

    def fixed_columns(self, positions: np.ndarray, normals: np.ndarray) -> np.ndarray:
        """Return (n, columns) of ambient and scattered light."""
        place = self._places(positions)
        parts = [place[:, : self.ambient_columns]]
        if self.order:
            by_normal = harmonics(normals, self.order)[:, :, None]
            parts.append((by_normal * place[:, None, : PLACES[self.degree]]).reshape(len(positions), -1))
        return np.concatenate(parts, axis=1)

    def fixed_light(self, positions: np.ndarray, normals: np.ndarray | None) -> np.ndarray:
        """Return (n, 3): what `fixed_columns` make together; without normals that of the flat membrane."""
        place, count, many = self._places(positions), HARMONICS[self.order], PLACES[self.degree]
        ambient, scattered = np.split(self.theta[self.bars.count :], [self.ambient_columns])
        light = place[:, : self.ambient_columns] @ ambient
        if normals is not None and self.order:
            by_place = scattered.reshape(count, many, 3).transpose(1, 0, 2)
            by_harmonic = place[:, :many] @ by_place.reshape(many, 3 * count)
            light += np.einsum(
                "nl,nlc->nc", harmonics(normals, self.order), by_harmonic.reshape(-1, count, 3)
            )
        return light


@dataclass(frozen=True)
class SeenPoints:
    """Points of the membrane that pixels see."""

    index: np.ndarray  # (n,): which press
    presses: np.ndarray  # (presses, 3): x, y, depth
    z: np.ndarray  # (presses, radii): height of the membrane by distance from the press
    positions: np.ndarray  # (n, 3)
    normals: np.ndarray  # (n, 3)
    is_flat: bool = False

    @classmethod
    def pressed(
        cls,
        plane_mm: np.ndarray,
        index: np.ndarray,
        presses: np.ndarray,
        profiles: list[PressProfiles],
        camera_mm: np.ndarray,
    ) -> "SeenPoints":
        """Return what pixels that see `plane_mm` (n, 2) of the flat membrane see of the membranes around presses."""
        tables = [own.at(press[2]) for own, press in zip(profiles, presses, strict=True)]
        width = max(len(z) for z, _ in tables)
        z = np.array([np.pad(own, (0, width - len(own))) for own, _ in tables])
        slopes = np.array([np.pad(own, (0, width - len(own))) for _, own in tables])
        positions, normals = np.empty((2, len(index), 3))
        presses = np.ascontiguousarray(presses, float)
        _see(plane_mm, index, presses, z, slopes, camera_mm, positions, normals)
        return cls(index, presses, z, positions, normals)

    @classmethod
    def flat(cls, plane_mm: np.ndarray) -> "SeenPoints":
        """Return what the same pixels see of the flat membrane."""
        count = len(plane_mm)
        positions = np.column_stack([plane_mm, np.zeros(count)])
        normals = np.tile([0.0, 0.0, -1.0], (count, 1))
        return cls(np.zeros(count, int), np.zeros((1, 3)), np.zeros((1, 4)), positions, normals, is_flat=True)

    def bar_columns(self, light: Light, kept: dict[bytes, np.ndarray] | None = None) -> np.ndarray:
        """Return (n, bars) irradiance; `kept` holds the columns of bars already seen."""
        kept, columns = {} if kept is None else kept, []
        for strips in light.bars.strips():
            key = strips.tobytes()
            if key not in kept:
                column, place = np.empty(len(self.index)), (self.positions, self.normals, self.index)
                _bar_light(*place, self.presses, self.z, strips, not self.is_flat, column)
                if len(kept) > _KEPT_COLUMNS:
                    kept.clear()
                kept[key] = column
            columns.append(kept[key])
        return np.stack(columns, axis=1)

    def columns(self, light: Light) -> np.ndarray:
        """Return (n, columns) of the light."""
        fixed = light.fixed_columns(self.positions, self.normals)
        return np.concatenate([self.bar_columns(light), fixed], axis=1)

    def light(self, light: Light) -> np.ndarray:
        """Return (n, 3): what the columns make together."""
        fixed = light.fixed_light(self.positions, None if self.is_flat else self.normals)
        return self.bar_columns(light) @ light.theta[: light.bars.count] + fixed


# The form of the prediction: a picture is the untouched gel's light and, times a gain, what the modelled dent changes.
# Untouched gel is thus shown as it is, whatever the model of its light lacks.


def gain_of(base: np.ndarray, flat_light: np.ndarray) -> np.ndarray:
    """Return the gain: real over modelled light of the untouched gel, at most 1 / LEAST_SHARE.

    Where the model explains the light, a press changes it in proportion, so that vignetting and seams scale it too.
    Where gel guides light to places that no LED reaches directly, the ratio says nothing, and the bound holds.
    """
    return base / np.maximum(flat_light, np.maximum(LEAST_SHARE * base, _DARKEST))


def predicted_light(base: np.ndarray, pressed_light: np.ndarray, flat_light: np.ndarray) -> np.ndarray:
    """Return the linear light of a press where the untouched gel has `base`."""
    change = np.maximum(pressed_light, 0) - flat_light
    return np.maximum(base + gain_of(base, flat_light) * change, 0)


@numba.njit(cache=True, fastmath=True, inline="always")
def _at(table, press, r):
    cell = r * _CELLS_PER_MM
    if cell >= table.shape[1] - 2:
        return 0.0
    i = int(cell)
    return table[press, i] + (table[press, i + 1] - table[press, i]) * (cell - i)


@numba.njit(cache=True, fastmath=True)
def _see(plane_mm, index, presses, z, slopes, camera_mm, positions, normals):
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
def _bar_light(positions, normals, index, presses, z, strips, shadows, out):
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
            for g in range(3):
                dz = az + (s0 + (s1 - s0) * GAUSS_NODES[g]) * (bz - az)
                r2 = ax * ax + ay * ay + dz * dz
                weight = GAUSS_WEIGHTS[g] * (s1 - s0) * strips[j, 9]
                total += weight * max(level + nz * dz, 0.0) * away / (r2 * r2)
        out[i] = total
