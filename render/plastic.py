"""Rough plastic, the glossy part of a coating: a Lambertian base under a rough dielectric interface.

The model is that of Mitsuba 3's `roughplastic` (Beckmann distribution, interior 1.49, exterior 1.000277, linear):
microfacet reflection after Walter et al. (2007) with Smith's shadowing, and a base that receives and returns what the
interface transmits, so that a picture can be checked against a path tracer without a fitted gain.
"""

from functools import lru_cache
from typing import NamedTuple

import numba
import numpy as np

REFRACTIVE_INDEX = 1.49 / 1.000277
TABLE_SIZE = 64
TERMS = 7


class Plastic(NamedTuple):
    """Rough plastic of one roughness as kernels take it.

    The base reflects albedo/π × base_scale × (share transmitted in) × (share transmitted out). The transmitted share is
    a polynomial in the cosine to the normal (TERMS coefficients, from c⁰).
    """

    roughness: np.float32  # Beckmann α
    refractive_index: np.float32
    transmission: np.ndarray  # (TERMS,)
    base_scale: float


def _fresnel(cosine: np.ndarray, eta: float) -> np.ndarray:
    """Return the unpolarised Fresnel reflectance of a dielectric; `eta` is transmitted over incident index."""
    sine2 = (1 - cosine**2) / eta**2
    transmitted = np.sqrt(np.maximum(1 - sine2, 0))
    parallel = (cosine - eta * transmitted) / (cosine + eta * transmitted)
    perpendicular = (eta * cosine - transmitted) / (eta * cosine + transmitted)
    return np.where(sine2 >= 1, 1.0, 0.5 * (parallel**2 + perpendicular**2))


def _smith_g1(cosine: np.ndarray, roughness: float) -> np.ndarray:
    """Return Smith's shadowing for a Beckmann surface, in the rational form of Walter et al. (2007)."""
    tangent = np.sqrt(np.maximum(1 - cosine**2, 0)) / np.maximum(cosine, 1e-6)
    a = 1 / np.maximum(roughness * tangent, 1e-6)
    return np.where(a >= 1.6, 1.0, (3.535 * a + 2.181 * a**2) / (1 + 2.276 * a + 2.577 * a**2))


def _through_interface(cosine: float, roughness: float, eta: float) -> tuple[float, float]:
    """Return reflected and transmitted share of light that meets the rough interface at one angle."""
    tilt = (np.arange(64) + 0.5) / 64 * (np.pi / 2)
    turn = (np.arange(32) + 0.5) / 32 * 2 * np.pi
    tilt, turn = np.meshgrid(tilt, turn, indexing="ij")
    m = np.stack([np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), np.cos(tilt)])
    distribution = np.exp(-((np.tan(tilt) / roughness) ** 2)) / (np.pi * roughness**2 * np.cos(tilt) ** 4)
    incident = np.array([np.sqrt(1 - cosine**2), 0, cosine])[:, None, None]
    facing = (incident * m).sum(0)
    visible = np.where(facing > 0, _smith_g1(np.array(cosine), roughness) * facing * distribution / cosine, 0)
    visible *= np.sin(tilt)
    visible /= visible.sum()
    facing = np.maximum(facing, 1e-9)
    reflectance = _fresnel(facing, eta)
    reflected = 2 * facing * m - incident
    transmitted_cosine = np.sqrt(np.maximum(1 - (1 - facing**2) / eta**2, 0))
    transmitted = m * (facing / eta - transmitted_cosine) - incident / eta
    out_up = np.where(reflected[2] > 0, _smith_g1(np.clip(reflected[2], 1e-6, 1), roughness), 0)
    out_down = np.where(transmitted[2] < 0, _smith_g1(np.clip(-transmitted[2], 1e-6, 1), roughness), 0)
    return float((visible * reflectance * out_up).sum()), float(
        (visible * (1 - reflectance) * out_down).sum()
    )


@lru_cache(maxsize=16)
def rough_plastic(roughness: float) -> Plastic:
    """Return the rough plastic of a roughness (Beckmann α).

    The transmission is fitted to share × cosine, as it is used: within 5e-4 for a roughness of 0.1, 1e-4 from 0.2 on.
    """
    cosines = np.maximum(np.linspace(0, 1, TABLE_SIZE), 1e-3)
    transmitted = np.array([_through_interface(c, roughness, REFRACTIVE_INDEX)[1] for c in cosines])
    powers = cosines[:, None] ** np.arange(TERMS)
    coefficients = np.linalg.lstsq(cosines[:, None] * powers, cosines * transmitted, rcond=None)[0]
    # The mean over the table is how the path tracer integrates; a finer rule would make the base 1–2 % brighter.
    inside = np.array([_through_interface(c, roughness, 1 / REFRACTIVE_INDEX)[0] for c in cosines])
    internal = 2 * float((inside * cosines).mean())
    return Plastic(
        roughness=np.float32(roughness),
        refractive_index=np.float32(REFRACTIVE_INDEX),
        transmission=coefficients.astype(np.float32),
        base_scale=1 / ((1 - internal) * REFRACTIVE_INDEX**2),
    )


@numba.njit(cache=True, error_model="numpy", fastmath=True, inline="always")
def transmitted_share(cosine, coat):
    """Return the share of light that the interface transmits at a cosine to the normal."""
    share = coat.transmission[TERMS - 1]
    for k in range(TERMS - 2, -1, -1):
        share = share * cosine + coat.transmission[k]
    return share


@numba.njit(cache=True, error_model="numpy", fastmath=True, inline="always")
def shadowing(cosine, coat):
    """Return `_smith_g1` without a branch, so that loops over it run in vector registers."""
    one = np.float32(1)
    positive = cosine if cosine > np.float32(1e-6) else np.float32(1e-6)
    sine2 = one - positive * positive
    sine2 = sine2 if sine2 > np.float32(1e-12) else np.float32(1e-12)
    a = positive / (coat.roughness * np.sqrt(sine2))
    a = a if a < np.float32(1.6) else np.float32(1.6)
    share = (np.float32(3.535) * a + np.float32(2.181) * a * a) / (
        one + np.float32(2.276) * a + np.float32(2.577) * a * a
    )
    return share if share < one else one


@numba.njit(cache=True, error_model="numpy", fastmath=True, inline="always")
def _exp_minus(t):
    """Return e^−t for t ≥ 0, within 2e-4 of what matters (t ≤ 5), by (1 + t/32 + …)³²: no call within a loop."""
    one = np.float32(1)
    x = (t if t < np.float32(60) else np.float32(60)) * np.float32(1 / 32)
    p = one + x * (one + x * (np.float32(1 / 2) + x * np.float32(1 / 6)))
    p *= p
    p *= p
    p *= p
    p *= p
    p *= p
    return one / p


@numba.njit(cache=True, error_model="numpy", fastmath=True, inline="always")
def highlight(cosine_in, cosine_out, in_dot_out, shadowing_out, coat):
    """Return the interface's microfacet BRDF × cosine_in × 4 cosine_out; both cosines must be positive.

    Angles are those of both directions to the normal and to each other.
    """
    eta = coat.refractive_index
    one, half, zero = np.float32(1), np.float32(0.5), np.float32(0)
    # |in + out|² = 2 (1 + in·out)
    length2 = np.float32(2) * (one + in_dot_out)
    length2 = length2 if length2 > np.float32(1e-6) else np.float32(1e-6)
    both = cosine_in + cosine_out
    tilt2 = both * both / length2
    tilt2 = tilt2 if tilt2 < one else one
    facing2 = np.float32(0.25) * length2
    facing2 = facing2 if facing2 < one else one
    facing = np.sqrt(facing2)
    rough2 = coat.roughness * coat.roughness
    inverse = one / (tilt2 * rough2)
    distribution = _exp_minus((one - tilt2) * inverse) * inverse / (np.float32(np.pi) * tilt2)
    inside2 = one - (one - facing2) / (eta * eta)
    inside = np.sqrt(inside2 if inside2 > zero else zero)
    parallel = (facing - eta * inside) / (facing + eta * inside)
    perpendicular = (eta * facing - inside) / (eta * facing + inside)
    fresnel = half * (parallel * parallel + perpendicular * perpendicular)
    return fresnel * distribution * shadowing(cosine_in, coat) * shadowing_out
