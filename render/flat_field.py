"""The flat field: what a real reference picture shows and no model of light does (seams, scratches, dust, vignetting).

The picture is multiplied by `ratio`, the real reference over the rendered one. A press changes real pictures far away
from itself too: `loaded` is the ratio of pressed to untouched light there, and `gain` how the whole picture's level
depends on where the gel is pressed. Both grow with the volume of the dent, so that the reference stays what it is.
"""

import hashlib
import zipfile
import zlib
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path

import numba
import numpy as np
from pydantic import Field, field_serializer, model_validator

from gelgap.assets.settings import Settings
from gelgap.assets.whole_file import write_whole
from gelgap.render.scattered import PLACES, monomials
from gelgap.render.shaded_surface import Surface

RATIO_BOUNDS = (0.0, 8.0)
LOADED_BOUNDS = (0.25, 4.0)
SIDES_PX = (8, 4096)
LARGEST_FILE_BYTES = 256 << 20
# A dent larger than the calibration's counts as this many times its volume at most.
LARGEST_VOLUME = 2.0


class FlatField(Settings):
    """Where a sensor's flat field is, and how much of it a press brings out."""

    file: str = Field(min_length=1, description=".npz with ratio, perhaps loaded, beside the sensor file")
    sha256: str = Field(default="", pattern="^([0-9a-f]{64})?$", description="of the file; checked if given")
    gain: tuple[tuple[float, ...], ...] = Field(
        default=((), (), ()),
        description="by channel: relative level by 1, x, y, x², xy, y² of the dent's place",
    )
    volume_mm3: float = Field(default=1.0, gt=0, le=1e5, description="volume of the calibration's dents")
    span_mm: tuple[float, float, float, float] = Field(
        default=(-100.0, 100.0, -100.0, 100.0),
        description="x from, to, y from, to: the place is held at its edges",
    )
    scale_mm: float = Field(default=10.0, gt=0.1, le=1000, description="length that x and y are divided by")

    @field_serializer("file", when_used="json")
    def _name(self, file: str) -> str:
        """Leave out the folder: a recipe depends on the file's content, wherever it lies."""
        return Path(file).name

    @model_validator(mode="after")
    def _check(self) -> "FlatField":
        if len(self.gain) != 3 or any(len(row) not in (0, PLACES[2]) for row in self.gain):
            raise ValueError(f"gain must have 3 rows of 0 or {PLACES[2]} numbers")
        if any(abs(value) > 1 for row in self.gain for value in row):
            raise ValueError("gain must lie in [-1, 1]")
        return self

    def found_in(self, folder: Path) -> "FlatField":
        """Return the same with the file's full path and digest.

        Raises
        ------
        FileNotFoundError
            If there is no such file.
        ValueError
            If the file lies outside of the folder, or is not what `sha256` or the bounds say.
        """
        folder = folder.resolve()
        path = (folder / self.file).resolve()
        if Path(self.file).is_absolute() or not path.is_relative_to(folder):
            raise ValueError(
                f"flat_field.file = {self.file!r} must lie in the folder of the sensor file, {folder}"
            )
        found = self.model_copy(update={"file": str(path)})
        digest = self.sha256 or hashlib.sha256(_checked_bytes(path)).hexdigest()
        found = found.model_copy(update={"sha256": digest})
        load_maps(found)
        return found


@dataclass(frozen=True)
class FlatFieldMaps:
    """The maps of a flat field, float32 (h, w, 3); `loaded` may be missing."""

    ratio: np.ndarray
    loaded: np.ndarray | None = None

    def resized(self, size_px: tuple[int, int]) -> "FlatFieldMaps":
        """Return the maps for another size of picture.

        Raises
        ------
        ValueError
            If the picture has other proportions.
        """
        import cv2

        height, width, _ = self.ratio.shape
        if (width, height) == size_px:
            return self
        if abs(size_px[0] * height - size_px[1] * width) > 0.02 * size_px[0] * height:
            raise ValueError(
                f"the sensor's flat field was measured at {width}×{height} px; size_px = {size_px[0]}×{size_px[1]} "
                "has other proportions"
            )
        way = cv2.INTER_AREA if size_px[0] < width else cv2.INTER_LINEAR
        loaded = None if self.loaded is None else cv2.resize(self.loaded, size_px, interpolation=way)
        return FlatFieldMaps(cv2.resize(self.ratio, size_px, interpolation=way), loaded)


def _checked_bytes(path: Path) -> bytes:
    if not path.is_file():
        raise FileNotFoundError(
            f"the sensor's flat field {path} does not exist; calibrate writes it beside the sensor"
        )
    if path.stat().st_size > LARGEST_FILE_BYTES:
        raise ValueError(
            f"flat field {path} has {path.stat().st_size} bytes; at most {LARGEST_FILE_BYTES} are read"
        )
    return path.read_bytes()


def load_maps(flat_field: FlatField) -> FlatFieldMaps:
    """Read the maps of a flat field, whose file is a full path.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If its digest, names, shapes or values are not right; nothing in it is executed.
    """
    path = Path(flat_field.file)
    data = _checked_bytes(path)
    if flat_field.sha256 and hashlib.sha256(data).hexdigest() != flat_field.sha256:
        raise ValueError(
            f"flat field {path} is not the file that the sensor was made with: its SHA-256 differs"
        )
    try:
        with zipfile.ZipFile(BytesIO(data)) as archive:
            maps = {name.removesuffix(".npy"): _read_map(archive, name) for name in archive.namelist()}
    except (
        zipfile.BadZipFile,
        zlib.error,
        OSError,
        EOFError,
        NotImplementedError,
        RuntimeError,
        ValueError,
    ) as error:
        raise ValueError(f"flat field {path} cannot be read: {error}") from None
    if "ratio" not in maps or maps.keys() - {"ratio", "loaded"}:
        raise ValueError(
            f"flat field {path} holds {', '.join(sorted(maps)) or 'nothing'}; it has ratio, perhaps loaded"
        )
    for name, (low, high) in (("ratio", RATIO_BOUNDS), ("loaded", LOADED_BOUNDS)):
        values = maps.get(name)
        if values is None:
            continue
        if values.shape != maps["ratio"].shape:
            raise ValueError(f"flat field {path}: loaded has another shape than ratio")
        if not np.isfinite(values).all() or values.min() < low or values.max() > high:
            raise ValueError(f"flat field {path}: {name} must be finite and lie in [{low:g}, {high:g}]")
    return FlatFieldMaps(maps["ratio"], maps.get("loaded"))


def _read_map(archive: zipfile.ZipFile, name: str) -> np.ndarray:
    """Return one array, its shape and type checked before any of it is read."""
    with archive.open(name) as member:
        version = np.lib.format.read_magic(member)
        if version != (1, 0):
            raise ValueError(f"{name} has NumPy's format {version}")
        shape, fortran, dtype = np.lib.format.read_array_header_1_0(member)
        low, high = SIDES_PX
        if len(shape) != 3 or shape[2] != 3 or not all(low <= side <= high for side in shape[:2]):
            raise ValueError(f"{name} has shape {shape}; (h, w, 3) with sides of {low}…{high} is allowed")
        if fortran or dtype not in (np.float16, np.float32):
            raise ValueError(f"{name} has type {dtype}; float16 or float32 in C order is allowed")
        size = int(np.prod(shape)) * dtype.itemsize
        data = member.read(size)
    if len(data) != size:
        raise ValueError(f"{name} ends early")
    return np.frombuffer(data, dtype).reshape(shape).astype(np.float32)


def save_maps(maps: FlatFieldMaps, path: Path) -> str:
    """Write the maps in half precision, which is finer than a picture's 8 bits; return the file's SHA-256."""
    parts = {"ratio": np.clip(maps.ratio, *RATIO_BOUNDS)}
    if maps.loaded is not None:
        parts["loaded"] = np.clip(maps.loaded, *LOADED_BOUNDS)
    buffer = BytesIO()
    np.savez_compressed(buffer, **{name: part.astype(np.float16) for name, part in parts.items()})
    write_whole(path, buffer.getvalue())
    return hashlib.sha256(buffer.getvalue()).hexdigest()


def dent_of(surface: Surface) -> tuple[float, float, float]:
    """Return the volume in mm³ of what stands above the flat membrane, and its centre (x, y) in mm."""
    volume, x, y = _dent(surface.positions_mm, surface.changed)
    cell = float(surface.grid.spacing_mm) ** 2
    return volume * cell, x, y


@numba.njit(cache=True)
def _dent(positions, changed):
    volume, x, y = 0.0, 0.0, 0.0
    rows, columns = changed.shape
    for j in range(rows):
        for i in range(columns):
            if changed[j, i] and positions[j, i, 2] < 0:
                height = -positions[j, i, 2]
                volume += height
                x += height * positions[j, i, 0]
                y += height * positions[j, i, 1]
    if volume <= 0:
        return 0.0, 0.0, 0.0
    return volume, x / volume, y / volume


def press_gain(flat_field: FlatField, volume: float, x_mm: float, y_mm: float) -> np.ndarray:
    """Return (3,): the picture's level for a dent at a place, `volume` times as large as the calibration's."""
    x0, x1, y0, y1 = flat_field.span_mm
    place = np.array([np.clip(x_mm, x0, x1), np.clip(y_mm, y0, y1)]) / flat_field.scale_mm
    terms = monomials(place[0], place[1], 2)
    levels = [1 + volume * (terms @ np.array(row) if row else 0.0) for row in flat_field.gain]
    return np.clip(levels, 0.25, 4.0)


class FlatFieldFilter:
    """A flat field prepared for one size of picture."""

    def __init__(self, flat_field: FlatField, size_px: tuple[int, int]) -> None:
        self._settings = flat_field
        maps = load_maps(flat_field).resized(size_px)
        self._ratio = np.ascontiguousarray(maps.ratio)
        loaded = np.ones_like(maps.ratio) if maps.loaded is None else maps.loaded
        self._excess = np.ascontiguousarray(maps.ratio * (loaded - 1))
        self._has_loaded = maps.loaded is not None

    def apply(self, linear: np.ndarray, surface: Surface) -> None:
        """Multiply a (h, w, 3) float32 picture by the flat field under the surface's dent, in place."""
        volume_mm3, x_mm, y_mm = dent_of(surface)
        volume = min(volume_mm3 / self._settings.volume_mm3, LARGEST_VOLUME)
        gain = press_gain(self._settings, volume, x_mm, y_mm).astype(np.float32)
        share = np.float32(min(volume, 1.0) if self._has_loaded else 0.0)
        _multiply(linear, self._ratio, self._excess, share, gain)


@numba.njit(cache=True, fastmath=True)
def _multiply(linear, ratio, excess, share, gain):
    height, width, _ = linear.shape
    for j in range(height):
        for i in range(width):
            for channel in range(3):
                factor = ratio[j, i, channel] + share * excess[j, i, channel]
                linear[j, i, channel] *= factor * gain[channel]
