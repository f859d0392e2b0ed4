"""A table of normals: what pictures say beyond the modelled light, for any body.

It is the change in code values by the membrane's normal and place, as GelSights are calibrated. It knows no LEDs and no
shadows, and holds under the light that it was measured in. A fitted sensor may predict with a share of it: its errors
are others than those of a modelled light, so that both together often have less than either.
"""

from dataclasses import dataclass

import numba
import numpy as np

from gelgap.render.imaging import Camera, srgb_decode, srgb_encode
from gelgap.render.light.scattered import monomials

_LEAST_TILT, _LEAST_LIGHT = np.float32(1e-3), 1e-4
_DECODED = srgb_decode(np.linspace(0, 1, 4096)).astype(np.float32)


def cubic_of_normal(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return (…, 9): the monomials, from degree 1 to 3, of a normal's x and y."""
    return np.stack([x, y, x * x, x * y, y * y, x**3, x * x * y, x * y * y, y**3], axis=-1)


@dataclass(frozen=True)
class NormalTable:
    """A cubic of the normal that is linear in the place; it holds for any body."""

    coefficients: np.ndarray  # (27, 3)
    half_view_mm: float

    @staticmethod
    def columns(normals: np.ndarray, plane_mm: np.ndarray, half_view_mm: float) -> np.ndarray:
        """Return (n, 27) of normals (n, 3) at places of the flat membrane (n, 2)."""
        x, y = (plane_mm / half_view_mm).T
        by_normal = cubic_of_normal(*normals[:, :2].T)
        return (by_normal[:, :, None] * monomials(x, y, 1)[:, None]).reshape(len(normals), 27)

    def picture(self, reference: np.ndarray, normals: np.ndarray, camera: Camera) -> np.ndarray:
        """Return code values (h, w, 3) of a membrane whose pixels have such normals (h, w, 3)."""
        plane_mm = camera.plane_of_picture_mm(reference.shape[1::-1])
        change = self.columns(normals.reshape(-1, 3), plane_mm, self.half_view_mm) @ self.coefficients
        return np.clip(reference + change.reshape(reference.shape), 0, 255)


class TableShare:
    """A share of a picture that a table of normals predicts, prepared for one camera and light.

    `flat` is the modelled light of the flat membrane, and `untouched` what the camera reads of it, float32 (h, w, 3)
    linear: the table says by how much that changes.
    """

    def __init__(
        self, table: NormalTable, share: float, camera: Camera, flat: np.ndarray, untouched: np.ndarray
    ) -> None:
        height, width, _ = flat.shape
        place = camera.plane_of_picture_mm((width, height)).reshape(height, width, 2) / table.half_view_mm
        untouched = np.maximum(untouched, _LEAST_LIGHT)
        self._place = place.astype(np.float32)
        self._coefficients = table.coefficients.reshape(9, 3, 3).astype(np.float32)
        self._code = (255 * srgb_encode(untouched)).astype(np.float32)
        self._gain = (flat / untouched).astype(np.float32)
        self._share = np.float32(share)

    def mix_into(self, linear: np.ndarray, normals: np.ndarray) -> None:
        """Mix the table's light into modelled light (h, w, 3) float32 of a membrane with such normals, in place."""
        _mix(normals, self._place, self._coefficients, self._code, self._gain, _DECODED, self._share, linear)


@numba.njit(cache=True, error_model="numpy", fastmath=True)
def _mix(normals, place, coefficients, code, gain, decoded, share, linear):
    rows, columns, _ = linear.shape
    terms = np.zeros(9, np.float32)
    steps = np.float32(len(decoded) - 1)
    for j in range(rows):
        for i in range(columns):
            x, y = normals[j, i, 0], normals[j, i, 1]
            if max(abs(x), abs(y)) < _LEAST_TILT:
                continue
            terms[0] = x
            terms[1] = y
            terms[2] = x * x
            terms[3] = x * y
            terms[4] = y * y
            terms[5] = x * x * x
            terms[6] = x * x * y
            terms[7] = x * y * y
            terms[8] = y * y * y
            for channel in range(3):
                read = code[j, i, channel]
                for k in range(9):
                    by_place = coefficients[k, :, channel]
                    read += terms[k] * (
                        by_place[0] + by_place[1] * place[j, i, 0] + by_place[2] * place[j, i, 1]
                    )
                level = decoded[np.uint32(min(max(read / 255, 0), 1) * steps)]
                linear[j, i, channel] += share * (gain[j, i, channel] * level - linear[j, i, channel])
