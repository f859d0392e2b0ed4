"""The camera inside the sensor: what its pixels see and do to light (lens, noise, sRGB); and pictures compared."""

import logging
from dataclasses import dataclass
from functools import lru_cache

import numba
import numpy as np
from pydantic import Field

from gelgap.assets.pinhole import Pinhole

LOG = logging.getLogger(__name__)
_LINEAR_LEVELS = 1 << 16
_DARKEST, _BRIGHTEST = 8, 247


class Camera(Pinhole):
    """A camera that looks along +z at the membrane; its optical axis meets the picture's centre."""

    vignetting: float = Field(
        default=0.0,
        ge=0,
        le=0.9,
        description="relative loss of light in the picture's corner, growing with r²",
    )
    point_spread_px: float = Field(
        default=0.0,
        ge=0,
        le=5,
        description="standard deviation of the point spread, in pixels of a 320 px wide picture",
    )
    full_well_electrons: float = Field(
        default=10_000.0, ge=100, le=1e6, description="electrons at linear value 1: sets the shot noise"
    )
    read_noise_electrons: float = Field(
        default=10.0, ge=0, le=1e4, description="standard deviation of the read noise, electrons"
    )
    exposure: float = Field(
        default=1.0, gt=0, le=1000, description="linear value per unit of camera radiance"
    )
    sensitivity: str = Field(
        default="Nikon 5100 (NPL)",
        description="spectral sensitivities, a name of colour.MSDS_CAMERA_SENSITIVITIES",
    )
    white_balance_cct_k: float | None = Field(
        default=None,
        ge=1000,
        le=25000,
        description="light that looks neutral, kelvin; none: equal-energy white",
    )


def srgb_encode(linear: np.ndarray) -> np.ndarray:
    """Return the sRGB code (0…1) of linear values (IEC 61966-2-1), clipped to 0…1."""
    linear = np.clip(linear, 0, 1)
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)


def srgb_decode(code: np.ndarray) -> np.ndarray:
    """Return the linear value of sRGB codes 0…1."""
    return np.where(code <= 0.04045, code / 12.92, ((code + 0.055) / 1.055) ** 2.4)


def srgb_slope(linear: np.ndarray) -> np.ndarray:
    """Return how fast the sRGB code (0…1) grows with the linear value."""
    safe = np.maximum(linear, 0.0031308)
    return np.where(linear <= 0.0031308, 12.92, 1.055 / 2.4 * safe ** (1 / 2.4 - 1))


_SRGB_CODE = np.round(255 * srgb_encode(np.arange(_LINEAR_LEVELS) / (_LINEAR_LEVELS - 1))).astype(np.uint8)


@numba.njit(cache=True, error_model="numpy", fastmath=True)
def gather(geometry, values, grid, most_mm, out):
    """Interpolate (rows, columns, 3) values at each pixel's rest coordinates; 0 where no membrane is.

    There `geometry` (h, w, 2) holds coordinates beyond `most_mm`.
    """
    height, width, _ = geometry.shape
    rows, columns, _ = values.shape
    flat = values.ravel()
    zero, one = np.float32(0), np.float32(1)
    u_most, v_most = np.float32(columns - 1) - np.float32(1e-3), np.float32(rows - 1) - np.float32(1e-3)
    for j in range(height):
        for i in range(width):
            u = min(max((geometry[j, i, 0] - grid.x0_mm) * grid.cells_per_mm, zero), u_most)
            v = min(max((geometry[j, i, 1] - grid.y0_mm) * grid.cells_per_mm, zero), v_most)
            a, b = np.int32(u), np.int32(v)
            fu, fv = u - np.float32(a), v - np.float32(b)
            there = one if geometry[j, i, 0] < most_mm else zero
            w00, w10 = (one - fu) * (one - fv) * there, fu * (one - fv) * there
            w01, w11 = (one - fu) * fv * there, fu * fv * there
            upper = np.uint64(3 * (np.int64(b) * columns + np.int64(a)))
            lower = upper + np.uint64(3 * columns)
            for k in range(3):
                at, below = upper + np.uint64(k), lower + np.uint64(k)
                out[j, i, k] = (
                    w00 * flat[at]
                    + w10 * flat[at + np.uint64(3)]
                    + w01 * flat[below]
                    + w11 * flat[below + np.uint64(3)]
                )


@numba.njit(cache=True, error_model="numpy")
def _encode(linear, table, out):
    top = np.float32(len(table) - 1)
    for index in range(linear.size):
        level = min(max(linear[index] * top + np.float32(0.5), np.float32(0)), top)
        out[index] = table[np.uint32(level)]


def encode(linear: np.ndarray) -> np.ndarray:
    """Return the 8-bit sRGB picture of linear camera RGB (float32)."""
    out = np.empty(linear.shape, np.uint8)
    _encode(np.ascontiguousarray(linear, np.float32).reshape(-1), _SRGB_CODE, out.reshape(-1))
    return out


def warn_if_blind(picture: np.ndarray) -> None:
    """Warn of an 8-bit picture in which nothing is seen."""
    if not _DARKEST < (level := picture.mean()) < _BRIGHTEST:
        what = "sees hardly any light" if level < 128 else "is saturated"
        LOG.warning("the camera %s: check its exposure, and places (mm), facing and drive of the LEDs", what)


def point_spread(linear: np.ndarray, camera: Camera) -> np.ndarray:
    """Return the picture blurred by the camera's point spread."""
    import cv2

    sigma = camera.point_spread_px * linear.shape[1] / 320
    # A Gaussian's samples have half its variance at 0.4 px and none at 0.2; three taps have it all.
    if sigma < 0.7:
        taps = np.array([sigma**2 / 2, 1 - sigma**2, sigma**2 / 2])
        return cv2.sepFilter2D(linear, -1, taps, taps, borderType=cv2.BORDER_REFLECT_101)
    return cv2.GaussianBlur(linear, (0, 0), sigma, borderType=cv2.BORDER_REFLECT_101)


def vignetting_gain(camera: Camera, size_px: tuple[int, int]) -> np.ndarray:
    """Return (h, w, 3) float32: 1 in the centre, 1 − vignetting in the corner; whole, as a product takes it soonest."""
    width, height = size_px
    x = (np.arange(width) + 0.5 - width / 2)[None, :]
    y = (np.arange(height) + 0.5 - height / 2)[:, None]
    r2 = (x**2 + y**2) / ((width / 2) ** 2 + (height / 2) ** 2)
    return np.repeat((1 - camera.vignetting * r2).astype(np.float32)[..., None], 3, axis=2)


@lru_cache(maxsize=1)
def _normal_quantiles() -> np.ndarray:
    """Return 65,536 equally likely values of the standard normal distribution, with unit variance."""
    from scipy.special import ndtri

    quantiles = ndtri((np.arange(1 << 16) + 0.5) / (1 << 16))
    return (quantiles / quantiles.std()).astype(np.float32)


@numba.njit(cache=True, error_model="numpy", fastmath=True)
def _noise_deviation(linear, full_well, read_noise, out):
    """Fill the standard deviation of each value; a loop of its own runs in vector registers."""
    read2, inverse, zero = read_noise * read_noise, np.float32(1) / full_well, np.float32(0)
    for index in range(linear.size):
        electrons = linear[index] * full_well
        out[index] = np.sqrt((electrons if electrons > zero else zero) + read2) * inverse


@numba.njit(cache=True, error_model="numpy", fastmath=True)
def _add_noise(linear, draws, quantiles, full_well, read_noise, out):
    _noise_deviation(linear, full_well, read_noise, out)
    for index in range(linear.size):
        out[index] = linear[index] + out[index] * quantiles[draws[index]]


def sensor_noise(linear: np.ndarray, camera: Camera, rng: np.random.Generator) -> np.ndarray:
    """Return the linear picture with shot and read noise: Gaussian, variance = signal + read noise², in electrons.

    Each value takes 16 random bits as its place in the normal distribution: about five times faster than drawing normal
    numbers, and indistinguishable at 8 bits (largest draw 4.3 σ).
    """
    out = np.empty(linear.shape, np.float32)
    full_well, read_noise = np.float32(camera.full_well_electrons), np.float32(camera.read_noise_electrons)
    # 64 bits at a time give the same numbers sooner.
    bits = rng.integers(0, 1 << 64, -(-linear.size // 4), dtype=np.uint64)
    draws = bits.astype("<u8", copy=False).view("<u2")
    flat = np.ascontiguousarray(linear, np.float32).reshape(-1)
    _add_noise(flat, draws, _normal_quantiles(), full_well, read_noise, out.reshape(-1))
    return out


def psnr_db(
    picture: np.ndarray, expected: np.ndarray, where: np.ndarray | None = None, peak: float = 255.0
) -> float:
    """Return the peak signal-to-noise ratio of a picture, dB, over all pixels or those of a mask."""
    square = (np.asarray(picture, float) - np.asarray(expected, float)) ** 2
    mean = float(np.mean(square if where is None else square[where]))
    return float(10 * np.log10(peak**2 / max(mean, 1e-14 * peak**2)))


def difference_picture(one: np.ndarray, other: np.ndarray, contrast: float) -> np.ndarray:
    """Return 128 + contrast × (one − other) of two uint8 pictures, as one."""
    return np.clip(128 + contrast * (one.astype(float) - other), 0, 255).astype(np.uint8)


@dataclass(frozen=True)
class ColourGap:
    """Colour difference of two pictures over their pixels, CIEDE2000 (Sharma, Wu, Dalal 2005); about 1 is just seen."""

    mean: float
    median: float
    percentile_95: float


def picture_gap(one: np.ndarray, other: np.ndarray) -> ColourGap:
    """Return the colour gap of two uint8 (h, w, 3) sRGB pictures.

    Raises
    ------
    ValueError
        If their shapes differ.
    """
    from skimage.color import deltaE_ciede2000, rgb2lab

    if one.shape != other.shape:
        raise ValueError(f"pictures have shapes {one.shape} and {other.shape}; a gap needs equal ones")
    difference = deltaE_ciede2000(rgb2lab(one), rgb2lab(other))
    median, percentile_95 = np.percentile(difference, (50, 95))
    return ColourGap(float(difference.mean()), float(median), float(percentile_95))
