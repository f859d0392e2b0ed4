"""A sensor: camera, coating and markers, and, where it has its own, the LEDs; one readable TOML file each."""

import json
import math
from functools import partial
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Self

import numpy as np
import tomli_w
from numpy.typing import ArrayLike
from pydantic import (
    BeforeValidator,
    Field,
    SerializerFunctionWrapHandler,
    ValidationError,
    ValidatorFunctionWrapHandler,
    WrapValidator,
    model_serializer,
    model_validator,
)

from gelgap.assets.settings import PresetSettings, Settings
from gelgap.assets.whole_file import write_whole
from gelgap.render.flat_field import FlatField
from gelgap.render.imaging import Camera
from gelgap.render.light.leds import Illumination

Reflectance = Annotated[float, Field(ge=0, le=1)]
Rgb = tuple[Reflectance, Reflectance, Reflectance]
_Share = Annotated[float, Field(ge=-10, le=10)]
_Code = Annotated[float, Field(ge=-1e6, le=1e6)]
_Row = tuple[_Share, _Share, _Share]
_Residual = Annotated[float, Field(ge=-255, le=255)]
_Length = Annotated[float, Field(gt=0, le=100)]
# Of a `BallResidual`: 1, x, y and radius, times 18 hats of the distance, times 9 waves of the angle.
RESIDUAL_TERMS = 4 * 18 * 9


class Coating(Settings):
    """The reflecting coat on the membrane: (1 − specular) Lambertian + specular × rough plastic, of equal albedo."""

    albedo: Rgb = Field(default=(0.5, 0.5, 0.5), description="diffuse reflectance, camera RGB")
    specular: Reflectance = Field(default=0.0, description="weight of the rough-plastic part")
    roughness: float = Field(default=0.3, ge=0.1, le=0.8, description="Beckmann α of the rough-plastic part")


def _one_or_two(value: Any, handler: ValidatorFunctionWrapHandler) -> Any:
    """Replace pydantic's report on both kinds of a pitch by one sentence."""
    try:
        return handler(value)
    except ValidationError:
        raise ValueError("must be one number in (0.05, 20] mm, or two, along x and along y") from None


LARGEST_PITCH_MM = 20.0
Pitch = Annotated[float, Field(gt=0.05, le=LARGEST_PITCH_MM)]
Place = Annotated[float, Field(ge=-50, le=50)]
_GRID = ("columns", "rows", "pitch_mm", "offset_mm", "missing")


class Markers(PresetSettings):
    """Printed markers, given in rest coordinates, so that they move and stretch with the membrane: a pattern or a list.

    Patterns have one marker for each square of a pitch, and fill the same field, so that a layout may be changed alone:
    a `grid`; a grid turned by 45°, `diamond`; rings a pitch apart around the middle, of 6, 12, 18 … markers, `circles`.
    """

    preset_kind: ClassVar[str] = "markers"

    layout: Literal["grid", "diamond", "circles", "none"] = "grid"
    columns: int = Field(default=11, ge=1, le=200)
    rows: int = Field(default=8, ge=1, le=200)
    pitch_mm: Annotated[Pitch | tuple[Pitch, Pitch], WrapValidator(_one_or_two)] = Field(
        default=1.1, description="distance between neighbours: one number, or two, along x and along y"
    )
    diameter_mm: float = Field(default=0.4, gt=0.01, le=10, description="of a square marker its side")
    albedo: Rgb = Field(default=(0.04, 0.04, 0.04), description="reflectance of the markers' paint")
    jitter_mm: float = Field(default=0.0, ge=0, le=5, description="largest random offset along x and along y")
    missing_fraction: float = Field(
        default=0.0, ge=0, le=1, description="share of markers that are not there"
    )
    seed: int = Field(default=0, ge=0, description="of jitter and missing markers")
    offset_mm: tuple[Place, Place] = Field(default=(0.0, 0.0), description="centre of the grid (x, y)")
    missing: tuple[tuple[int, int], ...] = Field(
        default=(),
        description="(row, column) of markers that are not there, counted from 0 at the upper left",
    )
    positions_mm: tuple[tuple[Place, Place], ...] = Field(
        default=(), max_length=40_000, description="(x, y) of each marker, instead of a grid"
    )
    shape: Literal["round", "square"] = Field(default="round", description="squares lie along x and y")

    @model_validator(mode="after")
    def _check(self) -> Self:
        given = [name for name in _GRID if name in self.model_fields_set]
        if self.positions_mm and (given or self.layout == "none"):
            other = given[0] if given else "layout = 'none'"
            raise ValueError(f"positions_mm lists each marker: leave it out, or leave out {other}")
        for row, column in self.missing:
            if not (0 <= row < self.rows and 0 <= column < self.columns):
                raise ValueError(
                    f"missing = ({row}, {column}): must be a row in 0…{self.rows - 1} and a column in "
                    f"0…{self.columns - 1}"
                )
        if self.missing and self.layout != "grid":
            raise ValueError(f"layout = {self.layout!r}: has no rows and columns; leave out missing")
        if self.layout != "none" and self.jitter_mm > (self.spacing_mm - self.diameter_mm) / 2:
            least_mm, which = self.diameter_mm + 2 * self.jitter_mm, f"pitch_mm = {self.pitch_mm}"
            if self.positions_mm:
                which = " and ".join(
                    f"positions_mm.{k} = {self.positions_mm[k]}"
                    for k in _closest_pair(self.positions_mm, self.norm)[1:]
                )
            raise ValueError(
                f"{which}: markers are {self.spacing_mm:.3g} mm apart; diameter_mm + 2 jitter_mm, {least_mm:.3g} mm, "
                "is the least at which they do not overlap"
            )
        return self

    @model_serializer(mode="wrap")
    def _as_table(self, dump: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Leave out what a list or a plain grid does not have, so that recipes without it keep their hashes."""
        later = ("offset_mm", "missing", "positions_mm", "shape")
        absent = {name for name in later if getattr(self, name) == type(self).model_fields[name].default}
        if self.positions_mm:
            absent.update(_GRID)
        return {name: value for name, value in dump(self).items() if name not in absent}

    @property
    def spacing_mm(self) -> float:
        """The least distance between the centres of two markers, before any jitter; infinite for a list of one."""
        if self.layout == "grid" and not self.positions_mm:
            return float(np.min(self.pitch_mm))
        return _closest_pair(_regular_mm(self)[0], self.norm)[0]

    @property
    def norm(self) -> float:
        """In which norm a marker is a ball: 2 for round ones, infinite for squares."""
        return np.inf if self.shape == "square" else 2.0

    def check_on_pad(self, pad_size_mm: tuple[float, float]) -> None:
        """Raise ValueError for a listed marker whose centre is not on a pad (x, y)."""
        for number, place_mm in enumerate(self.positions_mm):
            if (np.abs(place_mm) > np.array(pad_size_mm) / 2).any():
                raise ValueError(
                    f"markers.positions_mm.{number} = {place_mm}: must lie on the pad around (0, 0), which is "
                    f"{pad_size_mm[0]:g} × {pad_size_mm[1]:g} mm"
                )


def _closest_pair(positions_mm: ArrayLike, norm: float) -> tuple[float, int, int]:
    """Return the least distance between two markers (n, 2), and their indices; infinite for one marker."""
    from scipy.spatial import cKDTree

    distances, neighbours = cKDTree(positions_mm).query(positions_mm, k=2, p=norm)
    one = int(distances[:, 1].argmin())
    other = neighbours[one, 0] if neighbours[one, 1] == one else neighbours[one, 1]
    return float(distances[one, 1]), one, int(other)


def _regular_mm(markers: Markers) -> np.ndarray:
    """Return (rows, columns, 2) places of a grid, (1, n, 2) of another pattern or a list, before jitter and gaps."""
    if markers.positions_mm:
        return np.array([markers.positions_mm])
    sides = np.array([markers.columns, markers.rows])
    column, row = (np.arange(n) - (n - 1) / 2 for n in sides)
    places = np.stack(np.meshgrid(column, row), axis=-1)
    if markers.layout != "grid":
        reach = math.ceil(np.hypot(*sides))
        steps = np.arange(-reach, reach + 1)
        if markers.layout == "diamond":
            i, j = map(np.ravel, np.meshgrid(steps, steps))
            wide = np.stack([i - j, i + j], axis=1) / math.sqrt(2)
        else:
            rings = [np.arange(6 * k) * np.pi / (3 * k) for k in range(1, reach + 1)]
            radii = np.repeat(np.arange(1, reach + 1), 6 * np.arange(1, reach + 1))
            angles = np.concatenate(rings)
            wide = np.vstack([(0, 0), np.stack([np.cos(angles), np.sin(angles)], axis=1) * radii[:, None]])
        places = wide[(np.abs(wide) <= (sides - 0.5) / 2).all(axis=1)][None]
    return places * np.broadcast_to(markers.pitch_mm, 2) + markers.offset_mm


def marker_rest_mm(markers: Markers) -> np.ndarray:
    """Return (rows, columns, 2) rest positions of the markers; a missing marker is NaN.

    Those of a list, or of another pattern than a grid, are one row. Layout `none` gives (0, 0, 2).
    """
    if markers.layout == "none":
        return np.zeros((0, 0, 2))
    positions = _regular_mm(markers)
    rng = np.random.default_rng(markers.seed)
    positions += rng.uniform(-1, 1, positions.shape) * markers.jitter_mm
    positions[rng.random(positions.shape[:2]) < markers.missing_fraction] = np.nan
    for row, column in markers.missing:
        positions[row, column] = np.nan
    return positions


class BallResidual(Settings):
    """What a calibration leaves around one ball's contacts, in code values (see `calibrate/residual.py`).

    It is linear in the contact's x and y, in half views, and in its radius, in mm. No renderer draws it.
    """

    diameter_mm: _Length
    least: tuple[float, float, _Length] = Field(description="x, y and radius, each of some fitted contact")
    largest: tuple[float, float, _Length]
    coefficients: tuple[tuple[_Residual, _Residual, _Residual], ...] = Field(
        min_length=RESIDUAL_TERMS, max_length=RESIDUAL_TERMS, repr=False
    )


# What a fit leaves in a sensor: absent from files and hashes where there is none.
_of_fit = partial(Field, default=None, exclude_if=lambda value: value is None, repr=False)


def _preset_or_own(value: Any) -> Any:
    """Return the markers of a preset's name, so that a sensor's file and a factor of a sweep may name one."""
    return Markers.preset(value) if isinstance(value, str) else value


class Sensor(PresetSettings):
    """Everything about a sensor except its gel."""

    preset_kind: ClassVar[str] = "sensors"

    name: str = ""
    description: str = ""
    known: str = Field(default="", description="what public data say of the sensor that this is like")
    assumed: str = Field(default="", description="what is assumed")
    camera: Camera = Camera()
    coating: Coating = Coating()
    markers: Annotated[Markers, BeforeValidator(_preset_or_own)] = Markers()
    illumination: Illumination | None = Field(default=None, description="the sensor's own LEDs")
    # Left out where there is none, so that recipes without it keep their hashes.
    flat_field: FlatField | None = Field(
        default=None,
        exclude_if=lambda value: value is None,
        description="what the real reference shows beyond the model",
    )
    marks_off: tuple[_Row, _Row, _Row, _Row] | None = _of_fit(
        description="how far balls are off their marks: by 1, x, y (mm) and depth (radii), in x, y (mm), depth (radii)",
    )
    ball_residual: BallResidual | None = _of_fit(description="what the fit leaves around one ball's contacts")
    normal_table: tuple[tuple[_Code, _Code, _Code], ...] | None = _of_fit(
        min_length=27,
        max_length=27,
        description="change in code values by the membrane's normal and place, as measured on the untouched sensor",
    )
    table_share: float = Field(
        default=0.0,
        ge=0,
        le=1,
        exclude_if=lambda value: value == 0,
        description="how much of a picture under the sensor's own light the table of normals says, the rest the light",
    )

    @model_validator(mode="after")
    def _check_share(self) -> Self:
        if self.table_share > 0 and (self.normal_table is None or self.flat_field is None):
            raise ValueError(
                f"table_share = {self.table_share:g} must be 0 without normal_table and flat_field"
            )
        return self

    def lit_by(self, light: str | Path | Illumination | None) -> Illumination:
        """Return a light by its name, by its file or as it is; by default the sensor's own, or i0."""
        return Illumination.named(light or self.illumination or "i0")

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
