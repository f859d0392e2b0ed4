"""`gelgap render`: the sensor's picture of a saved membrane."""

import logging
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from gelgap import render, sim
from gelgap.assets.whole_file import whole_file, write_whole
from gelgap.cli import options as opt

if TYPE_CHECKING:
    import numpy as np

LOG = logging.getLogger(__name__)
PICTURE_SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff")


@dataclass(frozen=True)
class Render(opt.Command):
    """Render what the camera inside the sensor sees of a membrane saved by `gelgap press --save`.

    For example:
      gelgap press --depth-mm 0.6 --save state.npz
      gelgap render state.npz --illumination i1 --no-markers -o picture.png
    """

    state: tyro.conf.Positional[Path]
    """An .npz with x_mm (nx,), y_mm (ny,) and displacement_mm (ny, nx, 3)."""
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"]), opt.OutputFile(*PICTURE_SUFFIXES)]
    """The picture to write: PNG, JPEG, BMP or TIFF, by its name."""
    illumination: opt.LightName = None
    """Illumination preset or TOML file (see: gelgap presets illuminations)."""
    sensor: str = "paper"
    """Sensor preset or TOML file (see: gelgap presets sensors)."""
    markers: Annotated[bool, tyro.conf.arg(help_behavior_hint="(default: drawn)")] = True
    """Draw the membrane's markers."""
    size: opt.PictureSize = (320, 240)
    linear: Annotated[Path | None, opt.optional("PATH"), opt.OutputFile(".npy")] = None
    """Also write float32 (h, w, 3) linear camera RGB, before noise and encoding, to this .npy."""
    height_map: Annotated[Path | None, opt.optional("PATH"), opt.OutputFile(".npy", ".png")] = None
    """Also write how far the membrane in each pixel stands towards the camera: mm in a .npy, codes in a 16-bit .png."""
    seed: Annotated[opt.Seed | None, opt.optional("N", "no noise")] = None
    """Add the camera's shot and read noise, drawn from this seed."""
    quality: opt.Quality = "standard"
    """How finely light and shadows are sampled."""

    def run(self, started: float) -> None:
        """Render and write the picture."""
        import cv2
        import numpy as np

        from gelgap.render.imaging import sensor_noise, warn_if_blind

        try:
            state = sim.MembraneState.load(self.state)
        except ValueError as error:
            raise ValueError(
                f"{error}; needed is an .npz with x_mm (nx,), y_mm (ny,) and displacement_mm (ny, nx, 3), as written "
                "by: gelgap press --save state.npz"
            ) from None
        if not state.converged:
            LOG.warning("%s: the contact did not converge, so do not rely on this picture", self.state)
        sensor = render.Sensor.named(self.sensor)
        light = sensor.lit_by(self.illumination)
        renderer = render.MembraneRenderer(sensor, light, self.size, self.quality)
        membrane = state.x_mm, state.y_mm, state.displacement_mm
        linear = renderer.linear(*membrane, markers=self.markers, frame_name=self.state.name)
        if self.height_map is not None:
            self._write_height_map(renderer.height_map_mm(*membrane, frame_name=self.state.name))
        if self.linear is not None:
            with whole_file(self.linear) as temporary, temporary.open("wb") as file:
                np.save(file, linear)
        if self.seed is not None:
            linear = sensor_noise(linear, sensor.camera, np.random.default_rng(self.seed))
        warn_if_blind(picture := render.encode(linear))
        write_whole(self.out, cv2.imencode(self.out.suffix, picture[..., ::-1])[1].tobytes())
        print(f"wrote {self.out}" + (f" and {self.linear}" if self.linear else ""))

    def _write_height_map(self, height_mm: "np.ndarray") -> None:
        import numpy as np

        from gelgap.data.formats.pictures import encode_png
        from gelgap.data.formats.shards import HEIGHT_MAP_SCALE, height_codes

        if self.height_map.suffix.lower() == ".npy":
            with whole_file(self.height_map) as temporary, temporary.open("wb") as file:
                np.save(file, height_mm)
            print(f"wrote {self.height_map}: height towards the camera in mm")
            return
        try:
            codes = height_codes(height_mm)
        except ValueError as error:
            raise ValueError(f"--height-map {self.height_map}: {error}: write a .npy") from None
        write_whole(self.height_map, encode_png(codes))
        print(f"wrote {self.height_map}: {HEIGHT_MAP_SCALE}")
