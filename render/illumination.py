"""The LEDs of a sensor, and the light that they give in its camera's colours; one readable TOML file each."""

from pathlib import Path

import numpy as np
from pydantic import Field

from gelgap.assets import load_preset
from gelgap.assets.settings import Settings
from gelgap.assets.toml_file import named_in_errors, read_toml
from gelgap.render.camera import Camera
from gelgap.render.led import Emitter, Led
from gelgap.render.led_cache import cached_camera_rgb


class Illumination(Settings):
    """All LEDs of a sensor."""

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
        with named_in_errors(path):
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
        return tuple(led.emitter(rgb) for led, rgb in zip(self.leds, radiance, strict=True))
