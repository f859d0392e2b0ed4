"""What a picture file says of itself before it is decoded: its size, and whether its checksums match."""

import struct
import zlib

MOST_PIXELS = 2**26
_PNG = b"\x89PNG\r\n\x1a\n"
_JPEG = b"\xff\xd8\xff"
_JPEG_END = b"\xff\xd9"
_BMP = b"BM"
# The markers that begin a JPEG frame, which states the size; C4, C8 and CC are other things.
_JPEG_FRAMES = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}


def check_picture(data: bytes) -> tuple[int, int]:
    """Return the width and height that a PNG, JPEG or BMP states.

    Raises
    ------
    ValueError
        If it is none of these, has more than 64 million pixels, its end is missing, or a checksum of a PNG differs.
    """
    try:
        width, height = _stated_size(data)
    except (struct.error, IndexError):
        raise ValueError("the picture's header is cut off") from None
    if not 0 < width * height <= MOST_PIXELS:
        raise ValueError(f"the picture states {width}×{height} px: allowed are 1 to {MOST_PIXELS} pixels")
    return width, height


def _stated_size(data: bytes) -> tuple[int, int]:
    if data.startswith(_PNG):
        _check_png(data)
        return struct.unpack_from(">II", data, 16)
    if data.startswith(_JPEG):
        if _JPEG_END not in data[-64:]:
            raise ValueError("the end of the JPEG is missing")
        return _jpeg_size(data)
    if data.startswith(_BMP):
        (stated,) = struct.unpack_from("<I", data, 2)
        if stated > len(data):
            raise ValueError("the end of the BMP is missing")
        width, height = struct.unpack_from("<ii", data, 18)
        return width, abs(height)
    raise ValueError("image bytes are neither PNG nor JPEG, or are damaged; expected a readable picture")


def _check_png(data: bytes) -> None:
    """Compare the CRC-32 of every chunk up to the end."""
    place = len(_PNG)
    while True:
        if place + 12 > len(data):
            raise ValueError("the end of the PNG is missing: it is damaged")
        (length,) = struct.unpack_from(">I", data, place)
        kind, end = data[place + 4 : place + 8], place + 12 + length
        if place == len(_PNG) and (kind, length) != (b"IHDR", 13):
            raise ValueError("the PNG does not begin with its size: it is damaged")
        if end > len(data) or zlib.crc32(data[place + 4 : end - 4]) != int.from_bytes(data[end - 4 : end]):
            raise ValueError("a checksum in the PNG does not match: it is damaged")
        if kind == b"IEND":
            return
        place = end


def _jpeg_size(data: bytes) -> tuple[int, int]:
    place = 2
    while True:
        if data[place] != 0xFF:
            raise ValueError("the JPEG is damaged: a marker is missing")
        marker = data[place + 1]
        if marker == 0xFF:
            place += 1
            continue
        (length,) = struct.unpack_from(">H", data, place + 2)
        if marker in _JPEG_FRAMES:
            height, width = struct.unpack_from(">HH", data, place + 5)
            return width, height
        place += 2 + length
