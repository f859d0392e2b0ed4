"""`gelgap render`: the sensor's picture of a saved membrane."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

import tyro

from gelgap.cli.arguments import SensorName, load_illumination, load_sensor, optional
from gelgap.cli.rules import PICTURE_SIDES, SEED, InputFile, OutputFile, Preset

if TYPE_CHECKING:
    from gelgap.sim import MembraneState

PICTURE_SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".tiff")


@dataclass(frozen=True)
class Render:
    """Render what the camera inside the sensor sees of a membrane saved by `gelgap press --save`.

    For example:
      gelgap press --depth-mm 0.6 --save state.npz
      gelgap render state.npz --illumination i1 --no-markers -o picture.png
    """

    when_stopped: ClassVar[str] = (
        "no finished picture is sure to be there; run the same command again to start over"
    )

    state: Annotated[
        tyro.conf.Positional[Path],
        InputFile("a membrane's .npz file", "; write one with: gelgap press --save {path}"),
    ]
    """An .npz with x_mm (nx,), y_mm (ny,) and displacement_mm (ny, nx, 3)."""
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"]), OutputFile(PICTURE_SUFFIXES)]
    """The PNG to write."""
    illumination: Annotated[
        str | None, optional("NAME", "the sensor's own, or i0"), Preset("illuminations")
    ] = None
    """Illumination preset or TOML file (see: gelgap presets illuminations)."""
    sensor: SensorName = "paper"
    """Sensor preset or TOML file (see: gelgap presets sensors)."""
    markers: Annotated[bool, tyro.conf.arg(help_behavior_hint="(default: drawn)")] = True
    """Draw the membrane's markers."""
    size: Annotated[tuple[int, int], PICTURE_SIDES] = (320, 240)
    """Width and height of the picture in pixels."""
    linear: Annotated[Path | None, optional("PATH"), OutputFile((".npy",))] = None
    """Also write float32 (h, w, 3) linear camera RGB, before noise and encoding, to this .npy."""
    noise_seed: Annotated[int | None, optional("N", "no noise"), SEED] = None
    """Add the camera's shot and read noise, drawn from this seed."""
    quality: Literal["draft", "standard", "fine"] = "standard"
    """How finely light and shadows are sampled."""

    def run(self, started: float) -> None:
        """Render and write the picture."""
        import cv2
        import numpy as np

        from gelgap.render import Illumination, MembraneRenderer, encode, sensor_noise

        state = load_membrane(self.state)
        sensor = load_sensor(self.sensor)
        if self.illumination is None:
            illumination = sensor.illumination or Illumination.preset("i0")
        else:
            illumination = load_illumination(self.illumination)
        renderer = MembraneRenderer(sensor, illumination, self.size, self.quality)
        membrane = state.x_mm, state.y_mm, state.displacement_mm
        linear = renderer.linear(*membrane, markers=self.markers, frame_name=self.state.name)
        if self.linear is not None:
            np.save(self.linear, linear)
        if self.noise_seed is not None:
            linear = sensor_noise(linear, sensor.camera, np.random.default_rng(self.noise_seed))
        if not cv2.imwrite(str(self.output), encode(linear)[..., ::-1]):
            raise RuntimeError(f"{self.output} could not be written")
        print(f"wrote {self.output}" + (f" and {self.linear}" if self.linear else ""))


def load_membrane(path: Path) -> "MembraneState":
    """Read a saved membrane; where that fails, say how to write one.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If it is not a membrane's .npz file.
    """
    from gelgap.sim import MembraneState

    try:
        return MembraneState.load(path)
    except (FileNotFoundError, ValueError) as error:
        raise type(error)(f"{error}; write one with: gelgap press --save {path}") from None
