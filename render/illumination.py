"""The LEDs: where they are, how large, which way they face, and the light that they give."""

import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_validator

from gelgap.assets import load_preset
from gelgap.render.camera import Camera
from gelgap.render.led_cache import cached_camera_rgb
from gelgap.render.spectrum import Spectrum

Vector = tuple[float, float, float]
Length = Annotated[float, Field(gt=0, le=200)]


@dataclass(frozen=True)
class Emitter:
    """One LED as a path tracer needs it. Lengths in mm, sensor frame; radiance in linear camera RGB.

    A `bar` is the rectangle center ± half_u ± half_v, a `disc` the ellipse with these half axes; both radiate
    uniformly (Lambertian) on the side of `normal` and are black on the other. A `point` radiates alike in all
    directions, and its `radiance_rgb` is its intensity in linear camera RGB × mm².
    """

    kind: Literal["bar", "disc", "point"]
    center_mm: np.ndarray
    normal: np.ndarray
    half_u_mm: np.ndarray
    half_v_mm: np.ndarray
    radiance_rgb: np.ndarray


class Led(BaseModel):
    """One light source. A bar's length lies level (in a plane of constant z), its height across that."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    name: str = ""
    kind: Literal["bar", "disc", "point"] = "bar"
    position_mm: tuple[float, float, Annotated[float, Field(lt=0, ge=-300)]] = Field(
        description="centre in the sensor frame; z < 0, inside the sensor"
    )
    facing: Vector = Field((0.0, 0.0, 1.0), description="direction that the emitting side faces, any length")
    length_mm: Length = Field(1.0, description="length of a bar")
    height_mm: Length = Field(1.0, description="height of a bar")
    diameter_mm: Length = Field(1.0, description="diameter of a disc")
    spectrum: Spectrum
    drive: float = Field(
        1.0, ge=0, le=1e5, description="radiance at unit spectrum; a point's intensity in mm²"
    )

    @model_validator(mode="after")
    def _check(self) -> "Led":
        if np.linalg.norm(self.facing) == 0:
            raise ValueError("facing must not be the zero vector")
        lowest_mm = self.position_mm[2] + (
            np.abs(self.half_axes_mm()[:, 2]).sum() if self.kind != "point" else 0
        )
        if lowest_mm >= 0:
            raise ValueError(
                f"LED {self.name!r} at position_mm = {self.position_mm} reaches z = {lowest_mm:.2f} mm, "
                "through the undeformed membrane; keep all of it at z < 0"
            )
        return self

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
        length, height = {
            "bar": (self.length_mm, self.height_mm),
            "disc": (self.diameter_mm, self.diameter_mm),
            "point": (0.0, 0.0),
        }[self.kind]
        return np.stack([level * length / 2, across * height / 2])


def read_toml(path: str | Path) -> dict[str, Any]:
    """Return a TOML file's values.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If it is no TOML; the message names the file and the line.
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"{path} does not exist; expected a TOML file")
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise ValueError(f"{path} is no TOML: {error}") from None


class Illumination(BaseModel):
    """All LEDs of a sensor."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    name: str = ""
    description: str = ""
    known: str = Field("", description="what public data say of the sensor that this is like")
    assumed: str = Field("", description="what is assumed")
    leds: tuple[Led, ...] = Field(min_length=1, max_length=64)

    @classmethod
    def preset(cls, name: str) -> "Illumination":
        """Return a preset of `assets/illuminations`; ValueError lists the known ones."""
        return cls(**{"name": name, **load_preset("illuminations", name)})

    @classmethod
    def load(cls, path: str | Path) -> "Illumination":
        """Read an illumination TOML file."""
        return cls(**{"name": Path(path).stem, **read_toml(path)})

    def led_to_camera(self, camera: Camera) -> np.ndarray:
        """Return (n_leds, 3): the linear camera RGB of each LED's radiance, with drive, white balance and exposure."""
        rgb = cached_camera_rgb(
            tuple(led.spectrum for led in self.leds), camera.sensitivity, camera.white_balance_cct_k
        )
        return camera.exposure * np.array([led.drive for led in self.leds])[:, None] * np.array(rgb)

    def emitters(self, camera: Camera, led_to_camera: np.ndarray | None = None) -> tuple[Emitter, ...]:
        """Return every LED as the emitter that a path tracer needs, in linear camera RGB of `camera`."""
        radiance = self.led_to_camera(camera) if led_to_camera is None else led_to_camera
        return tuple(
            Emitter(led.kind, np.array(led.position_mm), led.normal, *led.half_axes_mm(), radiance[index])
            for index, led in enumerate(self.leds)
        )
