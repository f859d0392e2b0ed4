"""A sensor: camera, coating and markers, and, where it has its own, the LEDs; one readable TOML file each."""

import json
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Self

import numpy as np
import tomli_w
from pydantic import Field

from gelgap.assets.settings import PresetSettings, Settings
from gelgap.assets.whole_file import write_whole
from gelgap.render.camera import Camera
from gelgap.render.flat_field import FlatField
from gelgap.render.light.leds import Illumination

Reflectance = Annotated[float, Field(ge=0, le=1)]
Rgb = tuple[Reflectance, Reflectance, Reflectance]


class Coating(Settings):
    """The reflecting coat on the membrane: (1 − specular) Lambertian + specular × rough plastic, of equal albedo."""

    albedo: Rgb = Field(default=(0.5, 0.5, 0.5), description="diffuse reflectance, camera RGB")
    specular: Reflectance = Field(default=0.0, description="weight of the rough-plastic part")
    roughness: float = Field(default=0.3, ge=0.1, le=0.8, description="Beckmann α of the rough-plastic part")


class Markers(Settings):
    """Printed dots, given in rest coordinates, so that they move and stretch with the membrane."""

    layout: Literal["grid", "none"] = "grid"
    columns: int = Field(default=11, ge=1, le=200)
    rows: int = Field(default=8, ge=1, le=200)
    pitch_mm: float = Field(default=1.1, gt=0.05, le=20, description="distance between neighbours")
    diameter_mm: float = Field(default=0.4, gt=0.01, le=10)
    albedo: Rgb = Field(default=(0.04, 0.04, 0.04), description="reflectance of the dots' paint")
    jitter_mm: float = Field(default=0.0, ge=0, le=5, description="largest random offset along x and along y")
    missing_fraction: float = Field(default=0.0, ge=0, le=1, description="share of dots that are not there")
    seed: int = Field(default=0, ge=0, description="of jitter and missing dots")


def marker_rest_mm(markers: Markers) -> np.ndarray:
    """Return (rows, columns, 2) rest positions of the dots; a missing dot is NaN. Layout `none` gives (0, 0, 2).

    Raises
    ------
    ValueError
        If jitter could make dots overlap.
    """
    if markers.layout == "none":
        return np.zeros((0, 0, 2))
    room_mm = (markers.pitch_mm - markers.diameter_mm) / 2
    if markers.jitter_mm > room_mm:
        raise ValueError(
            f"markers.jitter_mm is {markers.jitter_mm}; dots of {markers.diameter_mm} mm at a pitch of "
            f"{markers.pitch_mm} mm leave at most {max(room_mm, 0):.3f} mm"
        )
    column = (np.arange(markers.columns) - (markers.columns - 1) / 2) * markers.pitch_mm
    row = (np.arange(markers.rows) - (markers.rows - 1) / 2) * markers.pitch_mm
    positions = np.stack(np.meshgrid(column, row), axis=-1)
    rng = np.random.default_rng(markers.seed)
    positions += rng.uniform(-1, 1, positions.shape) * markers.jitter_mm
    positions[rng.random(positions.shape[:2]) < markers.missing_fraction] = np.nan
    return positions


class Sensor(PresetSettings):
    """Everything about a sensor except its gel."""

    preset_kind: ClassVar[str] = "sensors"

    name: str = ""
    description: str = ""
    known: str = Field(default="", description="what public data say of the sensor that this is like")
    assumed: str = Field(default="", description="what is assumed")
    camera: Camera = Camera()
    coating: Coating = Coating()
    markers: Markers = Markers()
    illumination: Illumination | None = Field(default=None, description="the sensor's own LEDs")
    # Left out where there is none, so that recipes without it keep their hashes.
    flat_field: FlatField | None = Field(
        default=None,
        exclude_if=lambda value: value is None,
        description="what the real reference shows beyond the model",
    )

    @classmethod
    def _of_table(cls, values: dict[str, Any], name: str, folder: Path) -> Self:
        """Return the sensor with the full path of the flat field that lies beside its file."""
        sensor = super()._of_table(values, name, folder)
        if sensor.flat_field is None:
            return sensor
        return sensor.model_copy(update={"flat_field": sensor.flat_field.found_in(folder)})


def save_sensor(sensor: Sensor, path: str | Path) -> None:
    """Write a sensor TOML that `Sensor.load` reads back, numbers to 9 decimals; its flat field comes to lie beside it.

    Raises
    ------
    RuntimeError
        If the file cannot be written.
    """
    dumped = json.dumps(sensor.model_dump(exclude_none=True))
    values = json.loads(dumped, parse_float=lambda number: round(float(number), 9))
    if sensor.flat_field is not None:
        source = Path(sensor.flat_field.file)
        beside = Path(path).resolve().parent / source.name
        if source.resolve() != beside:
            write_whole(beside, source.read_bytes())
        values["flat_field"]["file"] = source.name
    write_whole(Path(path), tomli_w.dumps(values).encode())
