"""One LED: where it is, which way it faces, and the shape of the face that shines."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Literal, NamedTuple

import numpy as np
from pydantic import Field, model_validator

from gelgap.assets.settings import Settings
from gelgap.render.spectrum import Spectrum

Vector = tuple[float, float, float]
Length = Annotated[float, Field(gt=0, le=200)]
LedKind = Literal["bar", "disc", "point"]


class Slice(NamedTuple):
    """A thin piece of an LED's face, in units of the face's half axes.

    `place` is where it lies on the level axis, `weight` its width there, `chord` how far it extends across.
    """

    place: float
    weight: float
    chord: float


@dataclass(frozen=True)
class LedShape:
    """What distinguishes one kind of LED from another; a new kind is one more `LedKind` with its `LED_SHAPES`.

    `size_mm` gives the face's length along its level axis and its height across. `slices` cuts the face along the level
    axis into a given number of slices. A face radiates as Lambert's law says, a point (`is_point`) alike in all
    directions.
    """

    size_mm: Callable[["Led"], tuple[float, float]]
    slices: Callable[[int], list[Slice]]
    is_point: bool = False


def _rectangle_slices(count: int) -> list[Slice]:
    """Return slices at the nodes of Gauss' rule."""
    nodes, weights = np.polynomial.legendre.leggauss(count)
    return [Slice(float(node), float(weight), 1.0) for node, weight in zip(nodes, weights, strict=True)]


def _ellipse_slices(count: int) -> list[Slice]:
    """Return slices at Chebyshev's nodes, whose rule includes the chord √(1 − s²): the area comes out exactly."""
    angles = np.arange(1, count + 1) * np.pi / (count + 1)
    return [
        Slice(float(np.cos(angle)), float(np.pi / (count + 1) * np.sin(angle)), float(np.sin(angle)))
        for angle in angles
    ]


LED_SHAPES: dict[LedKind, LedShape] = {
    "bar": LedShape(lambda led: (led.length_mm, led.height_mm), _rectangle_slices),
    "disc": LedShape(lambda led: (led.diameter_mm, led.diameter_mm), _ellipse_slices),
    "point": LedShape(lambda led: (0.0, 0.0), lambda count: [Slice(0.0, 0.0, 0.0)], is_point=True),
}


@dataclass(frozen=True)
class Emitter:
    """One LED as a path tracer needs it. Lengths in mm, sensor frame; radiance in linear camera RGB.

    A `bar` is the rectangle center ± half_u ± half_v, a `disc` the ellipse with these half axes; both radiate
    uniformly (Lambertian) on the side of `normal` and are black on the other. A `point` radiates alike in all
    directions, and its `radiance_rgb` is its intensity in linear camera RGB × mm².
    """

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
    def normal(self) -> np.ndarray:
        return np.asarray(self.facing) / np.linalg.norm(self.facing)

    def half_axes_mm(self) -> np.ndarray:
        """Return (2, 3): half the level axis and half the axis across it (towards −z, into the sensor)."""
        normal = self.normal
        level = np.cross((0.0, 0.0, 1.0), normal)
        if np.linalg.norm(level) < 1e-9:
            # It faces straight down: the axis across is radial, so that shadows are sampled along it.
            radial = np.array([*self.position_mm[:2], 0.0])
            radial = (
                radial / np.linalg.norm(radial) if np.linalg.norm(radial) > 1e-9 else np.array([1.0, 0, 0])
            )
            level = np.cross(radial, normal)
        level /= np.linalg.norm(level)
        across = np.cross(normal, level)
        if across[2] > 0:
            across = -across
        length_mm, height_mm = LED_SHAPES[self.kind].size_mm(self)
        return np.stack([level * length_mm / 2, across * height_mm / 2])

    def half_extent_z_mm(self) -> float:
        """Return how far the face reaches above and below its centre."""
        return np.abs(self.half_axes_mm()[:, 2]).sum()

    def highest_z_mm(self) -> float:
        """Return the z of the face's edge that is nearest to the membrane."""
        return self.position_mm[2] + self.half_extent_z_mm()

    def emitter(self, radiance_rgb: np.ndarray) -> Emitter:
        """Return the LED as an emitter of a radiance, (3,) in linear camera RGB."""
        half_u_mm, half_v_mm = self.half_axes_mm()
        return Emitter(self.kind, np.array(self.position_mm), self.normal, half_u_mm, half_v_mm, radiance_rgb)
