"""The flat field: what a real reference picture shows and no model of light does (seams, scratches, dust, vignetting).

A picture becomes `ratio` × rendered + `offset`: the first is what the gain of the camera does, the second light that
the model lacks; together they make the rendered reference the real one. A press changes real pictures far away from
itself too: `loaded` is the ratio of pressed to untouched light there, and `gain` how the whole picture's level depends
on where the gel is pressed. Both grow with the volume of the dent, so that the reference stays what it is. `dots` is
what dots of the gel leave of the light, where they are in the reference; they move with the gel.
"""

from dataclasses import dataclass
from pathlib import Path

import numba
import numpy as np
from pydantic import Field, field_serializer, model_validator

from gelgap.assets.array_file import read_arrays, write_arrays
from gelgap.assets.checksums import file_sha256, sha256
from gelgap.assets.settings import Settings
from gelgap.render.imaging import Camera
from gelgap.render.light.scattered import EVERYWHERE, PLACES, Scale, Span, places
from gelgap.render.surface import Surface

LOADED_BOUNDS = (0.25, 4.0)
BOUNDS = {"ratio": (0.0, 8.0), "loaded": LOADED_BOUNDS, "offset": (-8.0, 8.0), "dots": (0.0, 2.0)}
SIDES_PX = (8, 4096)
_MAPPED_COLUMNS = 1024
LARGEST_FILE_BYTES = 256 << 20
# A dent larger than the calibration's counts as this many times its volume at most.
LARGEST_VOLUME = 2.0


class FlatField(Settings):
    """Where a sensor's flat field is, and how much of it a press brings out."""

    file: str = Field(min_length=1, description=".npz with ratio, perhaps loaded, beside the sensor file")
    sha256: str = Field(default="", pattern="^([0-9a-f]{64})?$", description="of the file; checked if given")
    gain: tuple[tuple[float, ...], ...] = Field(
        default=((), (), ()),
        repr=False,
        description="by channel: relative level by 1, x, y, x², xy, y² of the dent's place",
    )
    volume_mm3: float = Field(default=1.0, gt=0, le=1e5, description="volume of the calibration's dents")
    span_mm: Span = EVERYWHERE
    scale_mm: Scale = 10.0

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
        whole = self.model_copy(update={"file": str(path)})
        load_maps(whole)
        return whole.model_copy(update={"sha256": self.sha256 or file_sha256(path)})


@dataclass(frozen=True)
class FlatFieldMaps:
    """The maps of a flat field, float32 (h, w, 3); all but `ratio` may be missing."""

    ratio: np.ndarray
    loaded: np.ndarray | None = None
    offset: np.ndarray | None = None
    dots: np.ndarray | None = None

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
        resized = {
            name: part if part is None else cv2.resize(part, size_px, interpolation=way)
            for name, part in vars(self).items()
        }
        return FlatFieldMaps(**resized)


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
    if not path.is_file():
        raise FileNotFoundError(
            f"the sensor's flat field {path} does not exist; calibrate writes it beside the sensor"
        )
    if path.stat().st_size > LARGEST_FILE_BYTES:
        raise ValueError(
            f"flat field {path} has {path.stat().st_size} bytes; at most {LARGEST_FILE_BYTES} are read"
        )
    data = path.read_bytes()
    if flat_field.sha256 and sha256(data) != flat_field.sha256:
        raise ValueError(
            f"flat field {path} is not the file that the sensor was made with: its SHA-256 differs"
        )
    try:
        maps = read_arrays(data)
    except ValueError as error:
        raise ValueError(f"flat field {path} cannot be read: {error}") from None
    if "ratio" not in maps or maps.keys() - BOUNDS.keys():
        raise ValueError(
            f"flat field {path} holds {', '.join(sorted(maps)) or 'nothing'}; it has ratio, perhaps "
            "loaded, offset and dots"
        )
    for name, values in maps.items():
        shape = values.shape
        least, most = SIDES_PX
        low, high = BOUNDS[name]
        if len(shape) != 3 or shape[2] != 3 or not all(least <= side <= most for side in shape[:2]):
            wrong = f"has shape {shape}; (h, w, 3) with sides of {least}…{most} is allowed"
        elif values.dtype not in (np.float16, np.float32):
            wrong = f"has type {values.dtype}; float16 or float32 is allowed"
        elif shape != maps["ratio"].shape:
            wrong = "has another shape than ratio"
        elif not np.isfinite(values).all() or values.min() < low or values.max() > high:
            wrong = f"must be finite and lie in [{low:g}, {high:g}]"
        else:
            continue
        raise ValueError(f"flat field {path}: {name} {wrong}")
    return FlatFieldMaps(**{name: np.ascontiguousarray(values, np.float32) for name, values in maps.items()})


def save_maps(maps: FlatFieldMaps, path: Path) -> str:
    """Write the maps; return the file's SHA-256.

    Factors are in half precision, which is finer than a picture's 8 bits; the offset is a small difference.
    """
    parts = {
        name: part if name == "offset" else part.astype(np.float16)
        for name, part in vars(maps).items()
        if part is not None
    }
    write_arrays(path, parts)
    return file_sha256(path)


def map_dots(dots: np.ndarray, at_px: np.ndarray) -> np.ndarray:
    """Return (…, 3): dots (h, w, 3) where the points seen are in the reference, (…, 2)."""
    import cv2

    # OpenCV maps at most 32,766 rows, so that a list of points is folded to rows.
    rows = at_px.size // (2 * _MAPPED_COLUMNS) + 1
    points = np.resize(at_px.astype(np.float32), (rows, _MAPPED_COLUMNS, 2))
    seen = cv2.remap(dots, points[..., 0], points[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return seen.reshape(-1, 3)[: at_px.size // 2].reshape(*at_px.shape[:-1], 3)


@numba.njit(cache=True)
def _dent(positions, changed):
    """Return the volume in cells × mm of what stands above the flat membrane, and its centre (x, y) in mm."""
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


class FlatFieldFilter:
    """A flat field prepared for one size of picture."""

    def __init__(self, flat_field: FlatField, camera: Camera, size_px: tuple[int, int]) -> None:
        self._settings = flat_field
        maps = load_maps(flat_field).resized(size_px)
        self._ratio = np.ascontiguousarray(maps.ratio)
        loaded = np.ones_like(maps.ratio) if maps.loaded is None else maps.loaded
        self._excess = np.ascontiguousarray(maps.ratio * (loaded - 1))
        offset = np.zeros_like(maps.ratio) if maps.offset is None else maps.offset
        self._offset = np.ascontiguousarray(offset)
        self._offset_excess = offset * (loaded - 1)
        self._dots = maps.dots
        self._camera = camera
        self._size_px = size_px

    def apply(self, linear: np.ndarray, surface: Surface, dotted: np.ndarray | None) -> None:
        """Make a (h, w, 3) float32 picture the real sensor's under the surface's dent, in place.

        `dotted` (h, w, 2) are the rest coordinates of the gel in each pixel; None: it shall have no dots.
        """
        volume, x_mm, y_mm = _dent(surface.positions_mm, surface.changed)
        volume_mm3 = volume * float(surface.grid.spacing_mm) ** 2
        volume = min(volume_mm3 / self._settings.volume_mm3, LARGEST_VOLUME)
        terms = places(x_mm, y_mm, self._settings.span_mm, self._settings.scale_mm, 2)
        levels = [1 + volume * (terms @ np.array(row) if row else 0.0) for row in self._settings.gain]
        gain = np.clip(levels, 0.25, 4.0).astype(np.float32)
        share = np.float32(min(volume, 1.0))
        _multiply(linear, self._ratio, self._excess, self._offset, self._offset_excess, share, gain)
        if self._dots is not None and dotted is not None:
            rest = np.pad(dotted, ((0, 0), (0, 0), (0, 1)))
            linear *= map_dots(self._dots, self._camera.project_px(rest, self._size_px) - 0.5)


@numba.njit(cache=True, fastmath=True)
def _multiply(linear, ratio, excess, offset, offset_excess, share, gain):
    height, width, _ = linear.shape
    for j in range(height):
        for i in range(width):
            for channel in range(3):
                factor = ratio[j, i, channel] + share * excess[j, i, channel]
                added = offset[j, i, channel] + share * offset_excess[j, i, channel]
                light = linear[j, i, channel] * factor + added
                linear[j, i, channel] = max(light, np.float32(0)) * gain[channel]
