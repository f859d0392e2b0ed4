"""From light on the membrane to the camera's picture: gathering, markers, lens, noise and 8-bit encoding."""

from functools import lru_cache

import numba
import numpy as np

from gelgap.render.camera import Camera

_LINEAR_LEVELS = 1 << 16


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
def gather(geometry, values, grid, out):
    """Interpolate (rows, columns, 3) values at each pixel's rest coordinates; 0 where no membrane is."""
    height, width, _ = geometry.shape
    rows, columns, _ = values.shape
    flat = values.ravel()
    zero, one = np.float32(0), np.float32(1)
    u_most, v_most = np.float32(columns - 1) - np.float32(1e-3), np.float32(rows - 1) - np.float32(1e-3)
    for j in range(height):
        for i in range(width):
            u = min(max((geometry[j, i, 0] - grid.x0_mm) * grid.cells_per_mm, zero), u_most)
            v = min(max((geometry[j, i, 1] - grid.y0_mm) * grid.cells_per_mm, zero), v_most)
            a, b = np.int64(u), np.int64(v)
            fu, fv = u - np.float32(a), v - np.float32(b)
            there = geometry[j, i, 3]
            w00, w10 = (one - fu) * (one - fv) * there, fu * (one - fv) * there
            w01, w11 = (one - fu) * fv * there, fu * fv * there
            upper = np.uint64(3 * (b * columns + a))
            lower = np.uint64(3 * ((b + 1) * columns + a))
            for k in range(3):
                at, below = upper + np.uint64(k), lower + np.uint64(k)
                out[j, i, k] = (
                    w00 * flat[at]
                    + w10 * flat[at + np.uint64(3)]
                    + w01 * flat[below]
                    + w11 * flat[below + np.uint64(3)]
                )


@numba.njit(cache=True, error_model="numpy", fastmath=True)
def paint_markers(geometry, rest_mm, pitch, radius, ratio, out):
    """Multiply the picture by the dots' relative reflectance, anti-aliased by the dots' size in pixels.

    A dot stays within its own cell of the pitch; a missing one is NaN.
    """
    height, width, _ = geometry.shape
    rows, columns, _ = rest_mm.shape
    half, zero, one = np.float32(0.5), np.float32(0), np.float32(1)
    first_x = half * np.float32(columns)
    first_y = half * np.float32(rows)
    inverse_pitch = one / pitch
    reach = radius + np.float32(0.2) * pitch
    reach2 = reach * reach
    for j in range(height):
        other_j = j + 1 if j + 1 < height else j - 1
        sign_j = np.float32(other_j - j)
        for i in range(width):
            x, y = geometry[j, i, 0], geometry[j, i, 1]
            u, v = x * inverse_pitch + first_x, y * inverse_pitch + first_y
            if not (u >= zero and v >= zero):
                continue
            a, b = np.int64(u), np.int64(v)
            if a >= columns or b >= rows:
                continue
            cx, cy = x - rest_mm[b, a, 0], y - rest_mm[b, a, 1]
            distance2 = cx * cx + cy * cy
            if not distance2 < reach2:
                continue
            distance = np.sqrt(distance2)
            other_i = i + 1 if i + 1 < width else i - 1
            sign_i = np.float32(other_i - i)
            inverse = one / max(distance, np.float32(1e-6))
            along_i = (
                (cx * (geometry[j, other_i, 0] - x) + cy * (geometry[j, other_i, 1] - y)) * sign_i * inverse
            )
            along_j = (
                (cx * (geometry[other_j, i, 0] - x) + cy * (geometry[other_j, i, 1] - y)) * sign_j * inverse
            )
            pixel = np.sqrt(along_i * along_i + along_j * along_j) + np.float32(1e-9)
            coverage = min(max(half + (radius - distance) / pixel, zero), one)
            for k in range(3):
                out[j, i, k] *= one + coverage * (ratio[k] - one)


@numba.njit(cache=True, error_model="numpy")
def _encode(linear, table, out):
    top = np.float32(len(table) - 1)
    for index in range(linear.size):
        level = linear[index] * top + np.float32(0.5)
        out[index] = table[int(min(max(level, np.float32(0)), top))]


def encode(linear: np.ndarray) -> np.ndarray:
    """Return the 8-bit sRGB picture of linear camera RGB (float32)."""
    out = np.empty(linear.shape, np.uint8)
    _encode(np.ascontiguousarray(linear, np.float32).reshape(-1), _SRGB_CODE, out.reshape(-1))
    return out


def point_spread(linear: np.ndarray, camera: Camera) -> np.ndarray:
    """Return the picture blurred by the camera's point spread."""
    import cv2

    sigma = camera.point_spread_px * linear.shape[1] / 320
    return cv2.GaussianBlur(linear, (0, 0), sigma, borderType=cv2.BORDER_REFLECT_101)


def vignetting_gain(camera: Camera, size_px: tuple[int, int]) -> np.ndarray:
    """Return (h, w, 1) float32: 1 in the centre, 1 − vignetting in the corner."""
    width, height = size_px
    x = (np.arange(width) + 0.5 - width / 2)[None, :]
    y = (np.arange(height) + 0.5 - height / 2)[:, None]
    r2 = (x**2 + y**2) / ((width / 2) ** 2 + (height / 2) ** 2)
    return (1 - camera.vignetting * r2).astype(np.float32)[..., None]


@lru_cache(maxsize=1)
def _normal_quantiles() -> np.ndarray:
    """Return 65,536 equally likely values of the standard normal distribution, with unit variance."""
    from scipy.special import ndtri

    quantiles = ndtri((np.arange(1 << 16) + 0.5) / (1 << 16))
    return (quantiles / quantiles.std()).astype(np.float32)


@numba.njit(cache=True, error_model="numpy", fastmath=True)
def _add_noise(linear, draws, quantiles, full_well, read_noise, out):
    read2, inverse = read_noise * read_noise, np.float32(1) / full_well
    for index in range(linear.size):
        value = linear[index]
        electrons = max(value, np.float32(0)) * full_well
        out[index] = value + np.sqrt(electrons + read2) * inverse * quantiles[draws[index]]


def sensor_noise(linear: np.ndarray, camera: Camera, rng: np.random.Generator) -> np.ndarray:
    """Return the linear picture with shot and read noise: Gaussian, variance = signal + read noise², in electrons.

    Each value takes 16 random bits as its place in the normal distribution: about five times faster than drawing normal
    numbers, and indistinguishable at 8 bits (largest draw 4.3 σ).
    """
    out = np.empty(linear.shape, np.float32)
    full_well, read_noise = np.float32(camera.full_well_electrons), np.float32(camera.read_noise_electrons)
    draws = rng.integers(0, 1 << 16, linear.size, dtype=np.uint16)
    flat = np.ascontiguousarray(linear, np.float32).reshape(-1)
    _add_noise(flat, draws, _normal_quantiles(), full_well, read_noise, out.reshape(-1))
    return out
