"""LEDs: where each is and what shines, those of a sensor as an illumination, and LEDs cut up for integration."""

from dataclasses import dataclass
from math import ceil
from typing import Annotated, ClassVar, Literal, NamedTuple

import numpy as np
from pydantic import Field, model_validator

from gelgap.assets.names import one_line
from gelgap.assets.settings import PresetSettings, Settings
from gelgap.render.imaging import Camera
from gelgap.render.light.scattered import Scattered
from gelgap.render.light.spectra import Spectrum, camera_rgb
from gelgap.render.surface import Lattice

Vector = tuple[float, float, float]
Length = Annotated[float, Field(gt=0, le=200)]
LedKind = Literal["bar", "disc", "point"]
# By the first, light of LEDs up to 60 mm long, also beside the gel, is off by 0.02 % in the mean and 1.2 % at worst;
# the second is the most along an axis.
_NODES, _MOST_NODES = 3.5, 40


def node_count(half_mm: float, distance_mm: float) -> int:
    """Return how many nodes of Gauss' rule the light of an LED takes along an axis, given the nearest gel.

    Seen from a distance d the light of an axis of half length h has poles at ± i d/h, and the error of n nodes falls as
    exp(−2 n asinh(d/h)) (Trefethen, Approximation Theory and Approximation Practice, theorem 19.3).
    """
    count = ceil(_NODES / np.arcsinh(distance_mm / max(half_mm, 1e-9)))
    return min(max(count, 2 if half_mm else 1), _MOST_NODES)


def _slices(kind: LedKind, count: int) -> np.ndarray:
    """Return (slices, 3): thin pieces of an LED's face, in units of its half axes.

    That is where each lies on the level axis, its width there, and how far it extends across.
    """
    match kind:
        case "bar":  # at the nodes of Gauss' rule
            nodes, weights = np.polynomial.legendre.leggauss(count)
            return np.column_stack([nodes, weights, np.ones(count)])
        case "disc":  # at Chebyshev's nodes, whose rule includes the chord √(1 − s²): the area is exact
            angles = np.arange(1, count + 1) * np.pi / (count + 1)
            chords = np.sin(angles)
            return np.column_stack([np.cos(angles), np.pi / (count + 1) * chords, chords])
    return np.zeros((1, 3))  # a point


@dataclass(frozen=True)
class Emitter:
    """One LED as a path tracer needs it. Lengths in mm, sensor frame; radiance in linear camera RGB.

    A `bar` is the rectangle center ± half_u ± half_v, a `disc` the ellipse with these half axes; both radiate
    uniformly (Lambertian) on the side of `normal` and are black on the other. A `point` radiates alike in all
    directions, and its `radiance_rgb` is its intensity in linear camera RGB × mm².
    """

    __repr__ = one_line

    kind: LedKind
    center_mm: np.ndarray
    normal: np.ndarray
    half_u_mm: np.ndarray
    half_v_mm: np.ndarray
    radiance_rgb: np.ndarray


class Led(Settings):
    """One light source. A bar's length lies level (in a plane of constant z), its height across that."""

    name: str = ""
    kind: LedKind = "bar"
    position_mm: tuple[float, float, Annotated[float, Field(lt=0, ge=-300)]] = Field(
        description="centre in the sensor frame; z < 0, inside the sensor"
    )
    facing: Vector = Field(
        default=(0.0, 0.0, 1.0), description="direction that the emitting side faces, any length"
    )
    length_mm: Length = Field(default=1.0, description="length of a bar")
    height_mm: Length = Field(default=1.0, description="height of a bar")
    diameter_mm: Length = Field(default=1.0, description="diameter of a disc")
    spectrum: Spectrum
    drive: float = Field(
        default=1.0, ge=0, le=1e5, description="radiance at unit spectrum; a point's intensity in mm²"
    )

    @model_validator(mode="after")
    def _check(self) -> "Led":
        if np.linalg.norm(self.facing) == 0:
            raise ValueError("facing must not be the zero vector")
        highest_z_mm = self.highest_z_mm()
        if highest_z_mm >= 0:
            raise ValueError(
                f"LED {self.name!r} at position_mm = {self.position_mm} reaches z = {highest_z_mm:.2f} mm, "
                "through the undeformed membrane; keep all of it at z < 0"
            )
        return self

    @property
    def face(self) -> tuple:
        """What its light's distribution depends on: all but spectrum and drive."""
        return self.kind, self.position_mm, self.facing, self.length_mm, self.height_mm, self.diameter_mm

    @property
    def size_mm(self) -> tuple[float, float]:
        """The face's length along its level axis and its height across; a point has none."""
        match self.kind:
            case "bar":
                return self.length_mm, self.height_mm
            case "disc":
                return self.diameter_mm, self.diameter_mm
        return 0.0, 0.0

    @property
    def normal(self) -> np.ndarray:
        return np.asarray(self.facing) / np.linalg.norm(self.facing)

    def half_axes_mm(self) -> np.ndarray:
        """Return (2, 3): half the level axis and half the axis across it (towards −z, into the sensor)."""
        normal = self.normal
        level = np.cross((0.0, 0.0, 1.0), normal)
        if np.linalg.norm(level) < 1e-9:
            # It faces straight down: the axis across is radial, so that shadows are sampled along it.
            radial = np.array([*self.position_mm[:2], 0.0])
            distance = np.linalg.norm(radial)
            level = np.cross(radial / distance if distance > 1e-9 else (1.0, 0.0, 0.0), normal)
        level /= np.linalg.norm(level)
        across = np.cross(normal, level)
        if across[2] > 0:
            across = -across
        length_mm, height_mm = self.size_mm
        return np.stack([level * length_mm / 2, across * height_mm / 2])

    def highest_z_mm(self) -> float:
        """Return the z of the face's edge that is nearest to the membrane."""
        return self.position_mm[2] + np.abs(self.half_axes_mm()[:, 2]).sum()


class Illumination(PresetSettings):
    """All LEDs of a sensor."""

    preset_kind: ClassVar[str] = "illuminations"

    name: str = ""
    description: str = ""
    known: str = Field(default="", description="what public data say of the sensor that this is like")
    assumed: str = Field(default="", description="what is assumed")
    leds: tuple[Led, ...] = Field(min_length=1, max_length=64)
    # Left out where there is none, so that recipes without it keep their hashes.
    scattered: Scattered | None = Field(
        default=None,
        exclude_if=lambda value: value is None,
        description="light that comes from no LED directly; none: none",
    )

    def led_to_camera(self, camera: Camera) -> np.ndarray:
        """Return (n_leds, 3): the linear camera RGB of each LED's radiance, with drive, white balance and exposure."""
        spectra = [led.spectrum for led in self.leds]
        rgb = camera_rgb(spectra, camera.sensitivity, camera.white_balance_cct_k)
        return camera.exposure * np.array([led.drive for led in self.leds])[:, None] * np.array(rgb)

    def emitters(self, camera: Camera) -> tuple[Emitter, ...]:
        """Return every LED as the emitter that a path tracer needs, in linear camera RGB of `camera`."""
        return tuple(
            Emitter(led.kind, np.array(led.position_mm), led.normal, *led.half_axes_mm(), radiance_rgb=rgb)
            for led, rgb in zip(self.leds, self.led_to_camera(camera), strict=True)
        )


@dataclass(frozen=True)
class ShadowDetail:
    """How finely partly hidden LEDs are sampled."""

    strip_width_mm: float
    fewest_strips: int
    march_step_mm: float


# A strip of an LED: its ends in mm (low is nearer to the membrane), its normal and its area in mm². A point is one
# strip of 1 mm² without length.
STRIP = np.dtype(
    [
        *((f"{part}_{axis}", np.float32) for part in ("low", "high", "normal") for axis in "xyz"),
        ("area", np.float32),
        ("is_point", np.bool_),
    ],
    align=True,
)


class Nodes(NamedTuple):
    """The points that stand for LEDs in full view, float32; LED k owns those from first[k] up to first[k + 1]."""

    points: np.ndarray  # (4, nodes): x, y, z in mm and area in mm²
    first: np.ndarray  # (leds + 1,) int32
    normal: np.ndarray  # (leds, 3)


class Outlines(NamedTuple):
    """The bounds of each LED as seen from the membrane, float32."""

    left_mm: np.ndarray  # (leds, 2): x and y of one end of the level axis
    right_mm: np.ndarray  # (leds, 2): of the other end
    lowest_mm: np.ndarray  # (leds,): the least height above the undeformed membrane


class LedSamples(NamedTuple):
    """All LEDs of an illumination as the kernels take them."""

    is_point: np.ndarray  # (leds,) bool: an intensity of 1 mm² in all directions, not a Lambertian face
    strips: np.ndarray  # (strips,) of STRIP; LED k owns those from first_strip[k] up to first_strip[k + 1]
    first_strip: np.ndarray  # (leds + 1,) int32
    nodes: Nodes
    outlines: Outlines

    @property
    def most_strips(self) -> int:
        """How many strips the LED with most of them has."""
        return int(np.diff(self.first_strip).max())


def led_samples(emitters: tuple[Emitter, ...], detail: ShadowDetail, lattice: Lattice) -> LedSamples:
    """Return the strips, nodes and outlines of emitters over a membrane."""
    strips = [_strips(emitter, detail) for emitter in emitters]
    nodes = [_nodes(emitter, lattice) for emitter in emitters]
    first = np.cumsum([0] + [led_nodes.shape[1] for led_nodes in nodes]).astype(np.int32)
    normal = np.array([emitter.normal for emitter in emitters], np.float32)
    left = [(led.center_mm - led.half_u_mm)[:2] for led in emitters]
    right = [(led.center_mm + led.half_u_mm)[:2] for led in emitters]
    lowest = [-led.center_mm[2] - abs(led.half_u_mm[2]) - abs(led.half_v_mm[2]) for led in emitters]
    return LedSamples(
        is_point=np.array([emitter.kind == "point" for emitter in emitters]),
        strips=np.concatenate(strips),
        first_strip=np.cumsum([0] + [len(led_strips) for led_strips in strips]).astype(np.int32),
        nodes=Nodes(np.concatenate(nodes, axis=1, dtype=np.float32), first, normal),
        outlines=Outlines(*(np.array(values, np.float32) for values in (left, right, lowest))),
    )


def _strips(emitter: Emitter, detail: ShadowDetail) -> np.ndarray:
    length_mm = 2 * np.linalg.norm(emitter.half_u_mm)
    is_point = emitter.kind == "point"
    strips = []
    count = max(ceil(length_mm / detail.strip_width_mm), detail.fewest_strips)
    for place, weight, chord in _slices(emitter.kind, count):
        center = emitter.center_mm + place * emitter.half_u_mm
        half = chord * emitter.half_v_mm
        area = 1.0 if is_point else weight * length_mm / 2 * 2 * np.linalg.norm(half)
        strips.append((*(center - half), *(center + half), *emitter.normal, area, is_point))
    return np.array(strips, STRIP)


def _nodes(emitter: Emitter, lattice: Lattice) -> np.ndarray:
    """Return (4, nodes): x, y, z and area of what stands for an LED in full view of an undeformed membrane."""
    half_u, half_v = emitter.half_u_mm, emitter.half_v_mm
    places = np.linspace(-1, 1, 9)[:, None]
    face = emitter.center_mm + places[:, None] * half_u + places * half_v
    beside = np.maximum(np.abs(face[..., :2]) + np.array([lattice.x0_mm, lattice.y0_mm]), 0)
    distance_mm = np.sqrt((beside**2).sum(axis=-1) + face[..., 2] ** 2).min()
    length, height = np.linalg.norm(half_u), np.linalg.norm(half_v)
    places, weights, chords = _slices(emitter.kind, node_count(length, distance_mm)).T[..., None]
    across, across_weights = np.polynomial.legendre.leggauss(node_count(height, distance_mm))
    positions = emitter.center_mm[:, None, None] + np.multiply.outer(half_u, places)
    positions = positions + np.multiply.outer(half_v, chords * across)
    areas = length * height * weights * chords * across_weights
    return np.vstack([positions.reshape(3, -1), areas.ravel()])
