"""`gelgap render`: the sensor's picture of a saved membrane."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from gelgap import render, sim
from gelgap.cli import options as opt

PICTURE_SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".tiff")


@dataclass(frozen=True)
class Render(opt.Command):
    """Render what the camera inside the sensor sees of a membrane saved by `gelgap press --save`.

    For example:
      gelgap press --depth-mm 0.6 --save state.npz
      gelgap render state.npz --illumination i1 --no-markers -o picture.png
    """

    state: tyro.conf.Positional[Path]
    """An .npz with x_mm (nx,), y_mm (ny,) and displacement_mm (ny, nx, 3)."""
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"]), opt.output_file(*PICTURE_SUFFIXES)]
    """The PNG to write."""
    illumination: opt.LightName = None
    """Illumination preset or TOML file (see: gelgap presets illuminations)."""
    sensor: str = "paper"
    """Sensor preset or TOML file (see: gelgap presets sensors)."""
    markers: Annotated[bool, tyro.conf.arg(help_behavior_hint="(default: drawn)")] = True
    """Draw the membrane's markers."""
    size: opt.PictureSize = (320, 240)
    linear: Annotated[Path | None, opt.optional("PATH"), opt.output_file(".npy")] = None
    """Also write float32 (h, w, 3) linear camera RGB, before noise and encoding, to this .npy."""
    noise_seed: Annotated[opt.Seed | None, opt.optional("N", "no noise")] = None
    """Add the camera's shot and read noise, drawn from this seed."""
    quality: opt.Quality = "standard"
    """How finely light and shadows are sampled."""

    def run(self, started: float) -> None:
        """Render and write the picture."""
        import cv2
        import numpy as np

        try:
            state = sim.MembraneState.load(self.state)
        except ValueError as error:
            raise ValueError(f"{error}; write one with: gelgap press --save {self.state}") from None
        sensor = opt.named(render.Sensor, self.sensor)
        light = opt.light_in(sensor, self.illumination)
        renderer = render.MembraneRenderer(sensor, light, self.size, self.quality)
        membrane = state.x_mm, state.y_mm, state.displacement_mm
        linear = renderer.linear(*membrane, markers=self.markers, frame_name=self.state.name)
        if self.linear is not None:
            np.save(self.linear, linear)
        if self.noise_seed is not None:
            linear = render.sensor_noise(linear, sensor.camera, np.random.default_rng(self.noise_seed))
        if not cv2.imwrite(str(self.output), render.encode(linear)[..., ::-1]):
            raise RuntimeError(f"{self.output} could not be written")
        print(f"wrote {self.output}" + (f" and {self.linear}" if self.linear else ""))
