"""Pictures as arrays and as bytes: lossless coding, decoding, and reduction to a smaller size."""

import struct

import numpy as np

from gelgap.domains.picture_header import check_picture


def encode_png(picture: np.ndarray) -> bytes:
    """Encode an 8-bit RGB or 8/16-bit grey picture losslessly (PNG, W3C Recommendation, 3rd edition).

    Sensor noise leaves nothing for string matching to find, so that Huffman coding alone, of rows less the average of
    their neighbours, is faster and smaller than a compression level (`gelgap benchmark throughput` prints the table).

    Raises
    ------
    ValueError
        If the picture has another shape or type.
    """
    from zlib_ng import zlib_ng

    from gelgap.domains.png_filter import less_average

    colour = picture.ndim == 3 and picture.shape[2] == 3
    if not (colour or picture.ndim == 2) or picture.dtype not in (np.uint8, np.uint16)[: 1 if colour else 2]:
        raise ValueError(f"no PNG is written of a picture of shape {picture.shape} and type {picture.dtype}")
    height, width = picture.shape[:2]
    depth_bits = 8 * picture.itemsize
    header = struct.pack(">IIBBBBB", width, height, depth_bits, 2 if colour else 0, 0, 0, 0)
    coder = zlib_ng.compressobj(1, strategy=zlib_ng.Z_HUFFMAN_ONLY)
    pixels = coder.compress(less_average(picture)) + coder.flush()
    chunks = ((b"IHDR", header), (b"IDAT", pixels), (b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib_ng.crc32(name + data))
        for name, data in chunks
    )


def encode_jpeg(picture: np.ndarray, quality: int = 95) -> bytes:
    """Encode an 8-bit RGB picture as JPEG; `quality` is 1 to 100."""
    import cv2

    pixels = np.ascontiguousarray(picture[..., ::-1])
    done, data = cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_QUALITY, quality])
    if not done:
        raise RuntimeError(
            f"OpenCV could not encode a picture of shape {pixels.shape} and type {pixels.dtype}"
        )
    return data.tobytes()


def decode_picture(data: bytes) -> np.ndarray:
    """Decode a PNG, JPEG or BMP to (h, w, 3) RGB uint8, or a grey picture to (h, w) in its own depth.

    Raises
    ------
    ValueError
        If the bytes are not a readable picture of at most 64 million pixels, or a PNG's checksums do not match.
    """
    import cv2

    check_picture(data)
    try:
        picture = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error:
        picture = None
    if picture is None:
        raise ValueError("image bytes are neither PNG nor JPEG, or are damaged; expected a readable picture")
    return np.ascontiguousarray(picture[..., 2::-1]) if picture.ndim == 3 else picture


def as_colour(picture: np.ndarray) -> np.ndarray:
    """Return a picture (h, w, 3); a grey one (h, w) is repeated."""
    return np.repeat(picture[..., None], 3, axis=2) if picture.ndim == 2 else picture


def resized(picture: np.ndarray, size_px: tuple[int, int]) -> np.ndarray:
    """Return the picture at (width, height) px: each pixel the mean of the area that it covers.

    A size of another aspect may be longer on one side, if it has no more pixels in all: the other side is reduced by
    area means first, then this one is interpolated linearly (320×240 to 256×256, say).

    Raises
    ------
    ValueError
        If the size has more pixels than the picture, or is longer on both sides: enlarging invents pixels.
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
