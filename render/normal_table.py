"""What pictures say beyond the modelled light: a table of normals, for any body, and a residual by place, for a ball.

The table is the change in code values by the membrane's normal and place, as GelSights are calibrated. It knows no LEDs
and no shadows, and holds under the light that it was measured in. A fitted sensor may predict with a share of it: its
errors are others than those of a modelled light, so that both together often have less than either.

The residual is what both leave around a ball, as the rim, a thinner line than a solved membrane's. Presses held out in
three parts of seven sets gain 0.4 to 6.7 dB inside their contacts by it, and 1.8 to 6.4 around (results/sensors.md).
"""

from dataclasses import dataclass
from typing import Annotated, Self

import numba
import numpy as np
from pydantic import Field

from gelgap.assets.settings import Settings
from gelgap.render.camera import Camera
from gelgap.render.imaging import srgb_decode, srgb_encode
from gelgap.render.light.scattered import monomials

_LEAST_TILT, _LEAST_LIGHT = np.float32(1e-3), 1e-4
_DECODED = srgb_decode(np.linspace(0, 1, 4096)).astype(np.float32)

# In radii of the contact: between them it is linear, and 0 from the last on, as far as a fit sees. Where it ended at
# 2.6, predicted pictures had a disc around the dent, and 4 to 5 dB less there (FOTS).
_NEAR = (0.0, 0.25, 0.5, 0.65, 0.75, 0.83, 0.9, 0.96, 1.02, 1.08, 1.15, 1.25, 1.38)
_KNOTS = (*_NEAR, 1.55, 1.8, 2.15, 2.7, 3.5, 4.5)
_ORDERS = 4  # of waves around the contact
_WAVES = 2 * _ORDERS + 1
_SHAPES = (len(_KNOTS) - 1) * _WAVES
# The regularisation, in units of one press: `_RIDGE` draws each coefficient to 0 by its own weight, `_LEAST_RIDGE` all
# by the same; `_BEND` smooths over the radius, without which small contacts show rings. Slopes over the contacts' place
# and radius are regularised `_SLOPES` times as much.
_RIDGE, _LEAST_RIDGE, _BEND, _SLOPES = 0.15, 1e-3, 1.0, 3.0
_BY_RADIUS = np.diff(np.eye(len(_KNOTS))[:, :-1], 2, axis=0)
_BENDS = np.kron(_BY_RADIUS.T @ _BY_RADIUS, np.eye(_WAVES))
_FEWEST_BY_RADIUS = 8  # fewer than two for each term have no slope over the radius
_LEAST_HALF_RANGE = 0.01  # half views, mm: what varies less is noise
# By what share a ball's diameter and contact may differ from the fitted ones.
_MOST_OTHER = 0.1
_Code = Annotated[float, Field(ge=-255, le=255)]
_Length = Annotated[float, Field(gt=0, le=100)]


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
        place = camera.plane_of_picture_mm(flat.shape[1::-1]).reshape(*flat.shape[:2], 2) / table.half_view_mm
        untouched = np.maximum(untouched, _LEAST_LIGHT)
        arrays = place, table.coefficients.reshape(9, 3, 3), 255 * srgb_encode(untouched), flat / untouched
        self._arrays = tuple(values.astype(np.float32) for values in arrays)
        self._share = np.float32(share)

    def mix_into(self, linear: np.ndarray, normals: np.ndarray) -> None:
        """Mix the table's light into modelled light (h, w, 3) float32 of a membrane with such normals, in place."""
        _mix(normals, *self._arrays, _DECODED, self._share, linear)


@numba.njit(cache=True, error_model="numpy", fastmath=True)
def _mix(normals, place, coefficients, code, gain, decoded, share, linear):
    rows, columns, _ = linear.shape
    terms, steps = np.zeros(9, np.float32), np.float32(len(decoded) - 1)
    for j in range(rows):
        for i in range(columns):
            x, y = normals[j, i, 0], normals[j, i, 1]
            if max(abs(x), abs(y)) < _LEAST_TILT:
                continue
            terms[0], terms[1], terms[2], terms[3], terms[4] = x, y, x * x, x * y, y * y
            terms[5], terms[6], terms[7], terms[8] = x * x * x, x * x * y, x * y * y, y * y * y
            for channel in range(3):
                read = code[j, i, channel]
                for k in range(9):
                    own = coefficients[k, :, channel]
                    read += terms[k] * (own[0] + own[1] * place[j, i, 0] + own[2] * place[j, i, 1])
                level = decoded[np.uint32(min(max(read / 255, 0), 1) * steps)]
                linear[j, i, channel] += share * (gain[j, i, channel] * level - linear[j, i, channel])


class BallResidual(Settings):
    """Real less predicted code values around one ball's contacts, linear in x and y in half views and radius in mm."""

    diameter_mm: _Length
    least: tuple[float, float, _Length] = Field(description="x, y and radius, each of some fitted contact")
    largest: tuple[float, float, _Length]
    coefficients: tuple[tuple[_Code, _Code, _Code], ...] = Field(
        min_length=4 * _SHAPES, max_length=4 * _SHAPES, repr=False
    )

    @classmethod
    def fitted(
        cls,
        diameter_mm: float,
        contacts: np.ndarray,
        index: np.ndarray,
        away: np.ndarray,
        left: np.ndarray,
        usable: np.ndarray,
    ) -> Self:
        """Fit the residual of `contacts` (k, 3) to what is left (n, 3), where that is usable (n, 3).

        Each point is of the contact `index` (n,), and off it by `away` (n, 2) of its radii.
        """
        least, largest = contacts.min(axis=0), contacts.max(axis=0)
        terms = _terms(contacts, least, largest)
        terms[:, 3] *= len(contacts) >= _FEWEST_BY_RADIUS
        normal, right = np.zeros((3, 4 * _SHAPES, 4 * _SHAPES)), np.zeros((3, 4 * _SHAPES, 1))
        for contact, own in enumerate(terms):
            of_it = index == contact
            shapes = _shapes(away[of_it])
            weighted = usable[of_it].T[:, None] * shapes.T  # (3, shapes, n)
            normal += np.kron(np.outer(own, own), weighted @ shapes)
            right += np.kron(own[:, None], weighted @ left[of_it].T[:, :, None])
        by_shape = normal.diagonal(axis1=1, axis2=2)[:, :_SHAPES, None] / len(contacts)
        level = by_shape.mean()  # of all channels, since a dark one shows nothing
        ridge = (_RIDGE * by_shape + _LEAST_RIDGE * level) * np.eye(_SHAPES) + _BEND * level * _BENDS
        solved = np.linalg.solve(normal + np.kron(np.diag([1, _SLOPES, _SLOPES, _SLOPES]), ridge), right)
        rounded = solved[..., 0].T.clip(-255, 255).round(2).tolist()
        return cls(diameter_mm=diameter_mm, least=tuple(least), largest=tuple(largest), coefficients=rounded)

    def holds_for(self, diameter_mm: float, contact_radius_mm: float) -> bool:
        """Return whether a ball is the fitted one, and pressed about as deep."""
        is_ball = abs(diameter_mm / self.diameter_mm - 1) <= _MOST_OTHER
        least_mm, largest_mm = (1 - _MOST_OTHER) * self.least[2], (1 + _MOST_OTHER) * self.largest[2]
        return is_ball and least_mm <= contact_radius_mm <= largest_mm

    def around(self, away: np.ndarray, contact: np.ndarray) -> np.ndarray:
        """Return (n, 3) code values at points `away` (n, 2) from a contact (3,), beyond fitted ones as at their end."""
        near, left = np.hypot(*away.T) < _KNOTS[-1], np.zeros((len(away), 3))
        (terms,) = _terms(contact[None], np.array(self.least), np.array(self.largest))
        by_term = np.reshape(self.coefficients, (4, _SHAPES, 3))
        left[near] = _shapes(away[near]) @ np.tensordot(terms, by_term, 1)
        return left


def _terms(contacts: np.ndarray, least: np.ndarray, largest: np.ndarray) -> np.ndarray:
    """Return (k, 4): 1, and where contacts (k, 3) are between the least, −1, and the largest, 1."""
    half = np.maximum((largest - least) / 2, _LEAST_HALF_RANGE)
    return np.column_stack([np.ones(len(contacts)), ((contacts - (least + largest) / 2) / half).clip(-1, 1)])


def _shapes(away: np.ndarray) -> np.ndarray:
    """Return (n, shapes): each hat of the radius times each wave of the angle."""
    radius, angle = np.hypot(*away.T), np.arctan2(away[:, 1], away[:, 0])
    hats = [np.interp(radius, _KNOTS, hat) for hat in np.eye(len(_KNOTS))[:-1]]
    waves = [np.ones_like(angle)]
    for order in range(1, _ORDERS + 1):
        waves += [np.cos(order * angle), np.sin(order * angle)]
    shapes = np.stack(hats, axis=1)[:, :, None] * np.stack(waves, axis=1)[:, None]
    shapes[:, 0, 1:] = 0.0  # a wave has no value at the centre
    return shapes.reshape(len(away), _SHAPES)
