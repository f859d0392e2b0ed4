"""Opening an image that somebody brings: every command reads PNG, JPEG, BMP and TIFF here, as 8-bit RGB.

What cannot become 8-bit RGB without a guess is refused: fewer than 16 bits in 16, transparency, floats, CMYK, several
pages. Rotation that the file's EXIF states is applied, as viewers do.
"""

import io
import logging
import re
import struct
from pathlib import Path

import numpy as np
from PIL import Image, UnidentifiedImageError

from gelgap.assets.names import comma_list

LOG = logging.getLogger(__name__)
SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff")
# `gelgap calibrate` draws this sheet into a folder of presses, where it must not be read as one of them.
SHEET = "presses-sheet.png"
_UNREAD = re.compile(r"\.(heic|heif|avif|webp|gif|jp2|dng|raw|cr2|nef|arw)", re.IGNORECASE)
FORMATS = ("PNG", "JPEG", "BMP", "TIFF")
MOST_PIXELS = 2**26
MOST_BYTES = 2**29
# A 16-bit image that ends below a quarter of its range is that of a camera of 10, 12 or 14 bits, stored as it is.
_LEAST_16_BIT_PEAK = 2**14
_LFS_POINTER = b"version https://git-lfs"
_MODES = ("1", "L", "LA", "P", "PA", "RGB", "RGBA", "I;16", "I;16B", "I;16L")
_EXIF_ORIENTATION = 0x0112
_QUARTER_TURNS = (5, 6, 7, 8)


def visible_files(*folders: Path) -> list[Path]:
    """Return what lies in folders, frame_2 before frame_10, without hidden files and locks (`~$…`)."""
    paths = [path for folder in folders for path in folder.glob("[!.~]*")]
    return sorted(paths, key=lambda path: re.sub("[0-9]+", lambda number: number[0].zfill(20), str(path)))


def picture_files(files: list[Path]) -> list[Path]:
    """Return the files whose names end as an image's, without `SHEET`; warn of formats that are not read, as HEIC."""
    if unread := [path.name for path in files if _UNREAD.fullmatch(path.suffix)]:
        LOG.warning("pictures that are not read, unless you save them as PNG: %s", comma_list(unread))
    return [path for path in files if path.suffix.lower() in SUFFIXES and path.name != SHEET]


def read_image(path: Path | str) -> np.ndarray:
    """Return the image of a file as (h, w, 3) uint8 RGB.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If it is no image that `decode_image` decodes; the message names the file and says why.
    """
    data = _read_bytes(Path(path))
    try:
        return decode_image(data)
    except ValueError as error:
        raise ValueError(f"{path} is not readable: {error}") from None


def _read_bytes(path: Path) -> bytes:
    if not path.is_file():
        raise FileNotFoundError(f"{path} does not exist or is not a file; an image is needed")
    if path.stat().st_size > MOST_BYTES:
        raise ValueError(f"{path} has {path.stat().st_size >> 20} MiB, an image at most {MOST_BYTES >> 20}")
    return path.read_bytes()


def decode_image(data: bytes) -> np.ndarray:
    """Decode an image to (h, w, 3) uint8 RGB: grey is repeated, and 16 bits become 8, white staying white.

    Raises
    ------
    ValueError
        If it is none of `FORMATS`, is damaged, or cannot become 8-bit RGB without a guess.
    """
    import cv2

    stated_size_px(data)
    _check_opaque(data)
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR | cv2.IMREAD_ANYDEPTH)
    except cv2.error:
        image = None
    if image is None:
        raise ValueError("it cannot be decoded, so it is damaged")
    if image.dtype == np.uint16:
        image = _from_16_bits(image)
    if image.dtype != np.uint8:
        raise ValueError(f"its pixels are {image.dtype}: save it with 8 or 16 bits")
    return np.ascontiguousarray(image[..., ::-1])


def read_levels(path: Path | str) -> np.ndarray:
    """Return the levels (h, w) of a grey image of 8 or 16 bits, uint8 or uint16, turned as its EXIF says.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If it is no image, has colours, or pixels of another kind.
    """
    import cv2

    data = _read_bytes(Path(path))
    try:
        stated_size_px(data)
        _check_opaque(data)
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_ANYCOLOR | cv2.IMREAD_ANYDEPTH)
        if image is None or image.dtype not in (np.uint8, np.uint16):
            raise ValueError("its pixels are not of 8 or 16 bits")
        if image.ndim == 3 and (image[..., :3] != image[..., :1]).any():
            raise ValueError("it has colours: save it as grey")
    except (ValueError, cv2.error) as error:
        raise ValueError(f"{path} is not readable: {error}") from None
    return image if image.ndim == 2 else image[..., 0]


def _from_16_bits(image: np.ndarray) -> np.ndarray:
    peak = int(image.max())
    if 0 < peak < _LEAST_16_BIT_PEAK:
        raise ValueError(
            f"its 16-bit values end at {peak} of 65535, as those of cameras of {max(8, peak.bit_length())} bits do: "
            "scale them to the whole range, or save 8 bits"
        )
    return ((image.astype(np.uint32) * 255 + 32767) // 65535).astype(np.uint8)


def _check_opaque(data: bytes) -> None:
    with Image.open(io.BytesIO(data), formats=FORMATS) as image:
        if image.has_transparency_data and image.convert("RGBA").getchannel("A").getextrema()[0] < 255:
            raise ValueError("some of its pixels are transparent: save it without an alpha channel")


def _kind_problem(image: Image.Image) -> str | None:
    """Return why an open image cannot become 8-bit RGB without a guess; None if it can."""
    if image.mode not in _MODES:
        return f"its pixels are of the kind {image.mode}: save it as RGB or grey with 8 or 16 bits"
    pages = getattr(image, "n_frames", 1)
    return f"it holds {pages} images: save one of them alone" if pages > 1 else None


def stated_size_px(data: bytes) -> tuple[int, int]:
    """Return the width and height that an image states, turned as its EXIF says, without decoding it.

    Raises
    ------
    ValueError
        If it is none of `FORMATS`, has more than 64 million pixels, its end is missing, a checksum of a PNG differs, or
        its kind (transparent, CMYK, floats, several pages) cannot become 8-bit RGB.
    """
    try:
        with Image.open(io.BytesIO(data), formats=FORMATS) as image:
            # Pillow gives the size of a TIFF as turned already.
            turned = image.format != "TIFF" and image.getexif().get(_EXIF_ORIENTATION) in _QUARTER_TURNS
            size = image.size
            problem = _kind_problem(image)
        # `verify` must be the first use of an open image, and compares the checksums of a PNG alone.
        with Image.open(io.BytesIO(data), formats=FORMATS) as image:
            image.verify()
    except UnidentifiedImageError:
        if data.startswith(_LFS_POINTER):
            raise ValueError("it is a pointer of Git LFS, not the file itself: run `git lfs pull`") from None
        raise ValueError("it is neither PNG, JPEG, BMP nor TIFF of 8 or 16 bits, or is damaged") from None
    except Image.DecompressionBombError:
        raise ValueError(f"it has more than {MOST_PIXELS} pixels") from None
    except (OSError, SyntaxError, ValueError, struct.error) as error:
        raise ValueError(f"it is not a readable image: {error}") from None
    if size[0] * size[1] > MOST_PIXELS:
        problem = f"it states {size[0]}×{size[1]} px: allowed are {MOST_PIXELS} pixels"
    if (data.startswith(b"\xff\xd8") and b"\xff\xd9" not in data[-64:]) or (
        data.startswith(b"BM") and int.from_bytes(data[2:6], "little") > len(data)
    ):
        problem = "its end is missing"
    if problem:
        raise ValueError(problem)
    return size[::-1] if turned else size
