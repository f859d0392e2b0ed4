"""The LEDs of a sensor, and the light that they give in its camera's colours; one readable TOML file each."""

from pathlib import Path

import numpy as np
from pydantic import Field, SerializerFunctionWrapHandler, model_serializer

from gelgap.assets import load_preset
from gelgap.assets.settings import Settings
from gelgap.assets.toml_file import named_in_errors, read_toml
from gelgap.render.camera import Camera
from gelgap.render.led import Emitter, Led
from gelgap.render.led_cache import cached_camera_rgb
from gelgap.render.scattered import Scattered


class Illumination(Settings):
    """All LEDs of a sensor."""

    name: str = ""
    description: str = ""
    known: str = Field(default="", description="what public data say of the sensor that this is like")
    assumed: str = Field(default="", description="what is assumed")
    leds: tuple[Led, ...] = Field(min_length=1, max_length=64)
    scattered: Scattered | None = Field(
        default=None, description="light that comes from no LED directly; none: none"
    )

    @model_serializer(mode="wrap")
    def _without_what_is_off(self, as_dict: SerializerFunctionWrapHandler) -> dict:
        """Leave out scattered light that is not there, so that recipes without it keep their hashes."""
        return {key: value for key, value in as_dict(self).items() if key != "scattered" or value is not None}

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
