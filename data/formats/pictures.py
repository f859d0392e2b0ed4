"""Pictures as arrays and as bytes: lossless coding, reduction, and markers filled in."""

import struct

import numpy as np
from zlib_ng import zlib_ng

from gelgap.assets.image_file import stated_size_px

REFERENCE_STEMS = ("reference", "ref", "rest", "background", "bg", "blank", "untouched", "nocontact")
"""What pictures without contact are called."""
_AVERAGE = 3  # the number of this filter (PNG, W3C Recommendation, 3rd edition, 9.2)
_NEARER, _ALIKE, _MOST_OFF, _ROWS = 0.85, 8, 25, 60


def encode_png(picture: np.ndarray) -> bytes:
    """Encode an 8-bit RGB or 8/16-bit grey picture losslessly (PNG, W3C Recommendation, 3rd edition).

    Sensor noise leaves nothing for string matching to find, so that Huffman coding alone, of rows less the average of
    their neighbours, is faster and smaller than a compression level (docs/results/generation.md).
    A ValueError if the picture has another shape or type.
    """
    colour = picture.ndim == 3 and picture.shape[2] == 3
    if not (colour or picture.ndim == 2) or picture.dtype not in (np.uint8, np.uint16)[: 1 if colour else 2]:
        raise ValueError(f"no PNG is written of a picture of shape {picture.shape} and type {picture.dtype}")
    height, width = picture.shape[:2]
    depth_bits = 8 * picture.itemsize
    header = struct.pack(">IIBBBBB", width, height, depth_bits, 2 if colour else 0, 0, 0, 0)
    coder = zlib_ng.compressobj(1, strategy=zlib_ng.Z_HUFFMAN_ONLY)
    pixels = coder.compress(_less_average(picture)) + coder.flush()
    chunks = ((b"IHDR", header), (b"IDAT", pixels), (b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib_ng.crc32(name + data))
        for name, data in chunks
    )


def _less_average(picture: np.ndarray) -> np.ndarray:
    """Return the filtered bytes (h, 1 + bytes per row): each less the average of those to its left and above it."""
    big_endian = np.ascontiguousarray(picture, picture.dtype.newbyteorder(">"))
    rows = big_endian.reshape(len(picture), -1).view(np.uint8)
    step = rows.shape[1] // picture.shape[1]
    left, above = np.zeros_like(rows), np.zeros_like(rows)
    left[:, step:], above[1:] = rows[:, :-step], rows[:-1]
    filtered = np.full((len(rows), 1 + rows.shape[1]), _AVERAGE, np.uint8)
    # The average of two bytes, rounded down, without a wider type.
    np.subtract(rows, (left & above) + ((left ^ above) >> 1), out=filtered[:, 1:])
    return filtered


def encode_jpeg(picture: np.ndarray, quality: int = 95) -> bytes:
    """Encode an 8-bit RGB picture as JPEG; `quality` is 1 to 100."""
    import cv2

    pixels = np.ascontiguousarray(picture[..., ::-1])
    _, data = cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_QUALITY, quality])
    return data.tobytes()


def decode_column(data: bytes) -> np.ndarray:
    """Decode what `encode_png` made of a grey column of gelgap's own, (h, w) in its own depth."""
    import cv2

    stated_size_px(data)
    pixels = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    if pixels is None:
        raise ValueError("it cannot be decoded, so it is damaged")
    return pixels


def resized(picture: np.ndarray, size_px: tuple[int, int]) -> np.ndarray:
    """Return the picture at (width, height) px: each pixel the mean of the area that it covers.

    A size of another aspect may be longer on one side, if it has no more pixels in all: the other side is reduced by
    area means first, then this one is interpolated linearly (320×240 to 256×256, say). A ValueError if the size has
    more pixels than the picture, or is longer on both sides: enlarging invents pixels.
    """
    import cv2

    height, width = picture.shape[:2]
    if size_px == (width, height):
        return picture
    if not (min(size_px) >= 1 and size_px[0] * size_px[1] <= width * height):
        raise ValueError(
            f"image size {size_px[0]}×{size_px[1]} px is not possible: pictures are {width}×{height} px and are only "
            f"down-sampled; allowed are 1…{width} × 1…{height}, or another aspect with no more pixels in all"
        )
    reduced_px = min(size_px[0], width), min(size_px[1], height)
    reduced = cv2.resize(picture, reduced_px, interpolation=cv2.INTER_AREA)
    return reduced if reduced_px == size_px else cv2.resize(reduced, size_px, interpolation=cv2.INTER_LINEAR)


def mismatch(picture: np.ndarray, reference: np.ndarray) -> str:
    """Return in what a picture (h, w, 3) cannot be of the reference's sensor and light; empty if nothing tells.

    Of 220 pressed pictures of five real sensors, half of the pixels are within 7 of 255 of the reference, and each
    picture is 1.26 times nearer to it than mirrored or with red and blue exchanged (docs/results/real.md). A deep dent
    that fills the view can turn the shading round; it is not alike either way.
    """
    if picture.max() <= 1:
        return "the picture is black: no value is above 1 of 255"
    step = max(1, len(picture) // _ROWS)
    shown, rest = (image[::step, ::step].astype(np.int16) for image in (picture, reference))
    if not np.ptp(shown, axis=2).any() and np.ptp(rest, axis=2).any():
        return "the picture is grey, and the reference is not"
    off = np.abs(shown - rest)
    turned = {
        "red and blue exchanged": shown[..., ::-1],
        "left and right exchanged": shown[:, ::-1],
        "top and bottom exchanged": shown[::-1],
        "half a turn": shown[::-1, ::-1],
    }
    found = [(how, np.abs(other - rest)) for how, other in turned.items()]
    how, least = min(found, key=lambda one: one[1].mean())
    if least.mean() < _NEARER * off.mean() and np.median(least) <= _ALIKE:
        return f"the picture is nearer to the reference with {how}"
    if np.median(off) > _MOST_OFF:
        return f"half of the picture is more than {_MOST_OFF} of 255 off the reference: another light?"
    return ""


def without_markers(picture: np.ndarray) -> np.ndarray:
    """Return the uint8 (h, w, 3) picture with its markers found and filled in, as one must with a real sensor's.

    One in which none are found stays as it is.
    """
    from gelgap.data.inpainting import detect_markers, inpaint_telea

    mask = detect_markers(picture)
    return inpaint_telea(picture, mask) if mask.any() else picture
