"""`gelgap render`: the sensor's picture of a saved membrane."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

if TYPE_CHECKING:
    import numpy as np

    from gelgap.render import Sensor

ARRAYS = ("x_mm", "y_mm", "displacement_mm")
PICTURE_SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".tiff")


@dataclass(frozen=True)
class Render:
    """Render what the camera inside the sensor sees of a membrane saved by `gelgap press --save`.

    Example: gelgap render state.npz --illumination i1 --no-markers -o picture.png
    """

    state: tyro.conf.Positional[Path]
    """An .npz with x_mm (nx,), y_mm (ny,) and displacement_mm (ny, nx, 3)."""
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """The PNG to write."""
    illumination: str | None = None
    """Illumination preset or TOML file (see: gelgap presets illuminations). Default: the sensor's own, or i0."""
    sensor: str = "paper"
    """Sensor preset or TOML file (see: gelgap presets sensors)."""
    markers: bool = True
    """Draw the membrane's markers."""
    size: tuple[int, int] = (320, 240)
    """Width and height of the picture in pixels."""
    linear: Path | None = None
    """Also write float32 (h, w, 3) linear camera RGB, before noise and encoding, to this .npy."""
    noise_seed: int | None = None
    """Add the camera's shot and read noise, drawn from this seed. Default: no noise."""
    quality: str = "standard"
    """draft, standard or fine."""

    def run(self, started: float) -> None:
        """Render and write the picture."""
        import cv2
        import numpy as np

        from gelgap.render import Illumination, MembraneRenderer, encode, sensor_noise

        self._check_outputs()
        membrane = load_membrane(self.state)
        sensor = load_sensor(self.sensor)
        if self.illumination is None:
            illumination = sensor.illumination or Illumination.preset("i0")
        elif self.illumination.endswith(".toml"):
            illumination = Illumination.load(self.illumination)
        else:
            illumination = Illumination.preset(self.illumination)
        renderer = MembraneRenderer(sensor, illumination, self.size, self.quality)
        linear = renderer.linear(*membrane, markers=self.markers, frame_name=self.state.name)
        if self.linear is not None:
            np.save(self.linear, linear)
        if self.noise_seed is not None:
            linear = sensor_noise(linear, sensor.camera, np.random.default_rng(self.noise_seed))
        if not cv2.imwrite(str(self.output), encode(linear)[..., ::-1]):
            raise RuntimeError(f"{self.output} could not be written")
        print(f"wrote {self.output}" + (f" and {self.linear}" if self.linear else ""))

    def _check_outputs(self) -> None:
        """Refuse what could not be written before anything is computed."""
        if self.output.suffix.lower() not in PICTURE_SUFFIXES:
            raise ValueError(
                f"output is {self.output}; a picture's name must end in {', '.join(PICTURE_SUFFIXES)}"
            )
        if self.noise_seed is not None and self.noise_seed < 0:
            raise ValueError(f"noise_seed is {self.noise_seed}; it must be 0 or more")
        for path in (self.output, self.linear):
            if path is not None and not path.parent.is_dir():
                raise FileNotFoundError(f"the folder of {path} does not exist; create it first")


def load_sensor(name: str) -> "Sensor":
    """Return the sensor of a TOML file or of a preset's name."""
    from gelgap.render import Sensor

    return Sensor.load(name) if name.endswith(".toml") else Sensor.preset(name)


def load_membrane(path: Path) -> "tuple[np.ndarray, np.ndarray, np.ndarray]":
    """Read x_mm, y_mm and displacement_mm from an .npz.

    Raises
    ------
    ValueError
        If the file is no .npz or lacks an array.
    """
    import zipfile

    import numpy as np

    try:
        with np.load(path) as arrays:
            missing = [name for name in ARRAYS if name not in arrays]
            if missing:
                raise ValueError(
                    f"{path} lacks {', '.join(missing)}; write it with: gelgap press --save {path}"
                )
            return tuple(arrays[name] for name in ARRAYS)
    except (zipfile.BadZipFile, EOFError, OSError) as error:
        if isinstance(error, FileNotFoundError):
            raise FileNotFoundError(
                f"{path} does not exist; write it with: gelgap press --save {path}"
            ) from None
        raise ValueError(f"{path} is not an .npz file; write one with: gelgap press --save {path}") from None
