"""Images as real tools write them: depth, channels, kinds and sizes."""

import io
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from gelgap.assets.image_file import decode_image, picture_files, read_image, read_levels, stated_size_px

PIXELS = np.random.default_rng(0).integers(0, 256, (12, 16, 3), dtype=np.uint8)
PIXELS[0, 0] = 255


def encoded(pixels: np.ndarray, suffix: str = ".png") -> bytes:
    """Return what OpenCV writes of RGB or grey pixels."""
    if pixels.ndim == 3:
        pixels = pixels[..., [2, 1, 0, *range(3, pixels.shape[2])]]
    return cv2.imencode(suffix, np.ascontiguousarray(pixels))[1].tobytes()


def pillow_file(image: Image.Image, format: str, **options: object) -> bytes:
    buffer = io.BytesIO()
    image.save(buffer, format, **options)
    return buffer.getvalue()


@pytest.mark.parametrize("suffix", [".png", ".tiff"])
def test_16_bits_are_the_8_bits_that_they_were_made_of(suffix: str) -> None:
    assert np.array_equal(decode_image(encoded(PIXELS.astype(np.uint16) * 257, suffix)), PIXELS)
    grey = PIXELS[..., 0]
    assert np.array_equal(decode_image(encoded(grey.astype(np.uint16) * 257, suffix)), np.dstack([grey] * 3))


@pytest.mark.parametrize("suffix", [".png", ".bmp", ".tiff"])
def test_8_bits_grey_and_opaque_alpha_are_read(suffix: str) -> None:
    assert np.array_equal(decode_image(encoded(PIXELS, suffix)), PIXELS)
    assert np.array_equal(decode_image(encoded(PIXELS[..., 0], suffix)), np.dstack([PIXELS[..., 0]] * 3))
    opaque = np.dstack([PIXELS, np.full(PIXELS.shape[:2], 255, np.uint8)])
    assert np.array_equal(decode_image(encoded(opaque, suffix)), PIXELS)


@pytest.mark.parametrize("bits", [8, 12])
def test_fewer_bits_in_16_are_refused(bits: int) -> None:
    with pytest.raises(ValueError, match=f"cameras of {bits} bits"):
        decode_image(encoded((PIXELS.astype(np.uint32) * (2**bits - 1) // 255).astype(np.uint16)))


TRANSPARENT = Image.fromarray(np.dstack([PIXELS, np.full(PIXELS.shape[:2], 100, np.uint8)]))
COLOUR = Image.fromarray(PIXELS)


@pytest.mark.parametrize(
    ("data", "problem"),
    [
        (pillow_file(TRANSPARENT, "PNG"), "transparent"),
        (pillow_file(COLOUR.convert("CMYK"), "JPEG"), "kind CMYK"),
        (pillow_file(COLOUR.convert("I"), "TIFF"), "kind I"),
        (pillow_file(COLOUR, "TIFF", save_all=True, append_images=[COLOUR]), "2 images"),
        (pillow_file(COLOUR, "PNG", save_all=True, append_images=[TRANSPARENT]), "2 images"),
        (pillow_file(COLOUR, "GIF"), "neither PNG, JPEG, BMP nor TIFF"),
        (b"version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 9\n", "pointer of Git LFS"),
        (pillow_file(Image.new("1", (60000, 60000)), "PNG"), "more than 67108864 pixels"),
        (encoded(PIXELS)[:-40], "not a readable image"),
        (encoded(PIXELS, ".jpg")[:-80], "its end is missing"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_other_kinds_are_refused(data: bytes, problem: str) -> None:
    with pytest.raises(ValueError, match=problem):
        decode_image(data)


@pytest.mark.parametrize("kind", ["JPEG", "PNG", "TIFF"])
def test_a_file_that_is_turned_by_its_exif_is_read_as_viewers_show_it(kind: str, tmp_path: Path) -> None:
    exif = Image.Exif()
    exif[0x0112] = 6  # a quarter turn clockwise
    data = pillow_file(COLOUR, kind, exif=exif)
    assert decode_image(data).shape == (16, 12, 3)
    assert stated_size_px(data) == (12, 16)
    (tmp_path / "levels").write_bytes(pillow_file(COLOUR.convert("L"), kind, exif=exif))
    assert read_levels(tmp_path / "levels").shape == (16, 12)


def test_pictures_of_a_kind_that_is_not_read_are_named(caplog: pytest.LogCaptureFixture) -> None:
    assert picture_files([Path("0.png"), Path("1.HEIC"), Path("notes.txt")]) == [Path("0.png")]
    assert caplog.messages == ["pictures that are not read, unless you save them as PNG: 1.HEIC"]


def test_messages_name_the_file(tmp_path) -> None:
    path = tmp_path / "frame.png"
    path.write_bytes(encoded(PIXELS.astype(np.uint16)))
    with pytest.raises(
        ValueError, match=r"frame\.png is not readable: its 16-bit values end at 255 of 65535"
    ):
        read_image(path)
    with pytest.raises(FileNotFoundError, match=r"absent\.png does not exist"):
        read_image(tmp_path / "absent.png")
