"""What a fit leaves around a pressed ball: code values by the place around its contact, and where in the view that is.

The rim of a real dent is a thinner line than solved membranes have. Presses held out in three parts of eight sets gain
by it 0.4 to 2.8 dB inside their contacts and 0.6 to 4.3 around (results/sensors.md). It is of one sensor and one ball,
pressed straight: another body has another dent, so it is drawn without.
"""

from typing import Annotated, Self

import numpy as np
from pydantic import Field

from gelgap.assets.settings import Settings
from gelgap.render.light.scattered import monomials

# In radii of the contact: between them it is linear, and 0 from the last on.
KNOTS = (0.0, 0.25, 0.5, 0.65, 0.75, 0.83, 0.9, 0.96, 1.02, 1.08, 1.15, 1.25, 1.38, 1.55, 1.8, 2.15, 2.6)
_ORDERS = 4  # of waves around the contact
_WAVES = 2 * _ORDERS + 1
_SHAPES = (len(KNOTS) - 1) * _WAVES
# By so much of a press it is drawn to 0, and to the same everywhere.
_RIDGE, _LEAST_RIDGE = 0.15, 1e-3
# By so much of a press its bends over the radius are drawn to 0: without, small contacts show rings.
_BEND = 3.0
_BY_RADIUS = np.diff(np.eye(len(KNOTS))[:, :-1], 2, axis=0)
_BENDS = np.kron(_BY_RADIUS.T @ _BY_RADIUS, np.eye(_WAVES))
_MOST_POINTS = 40_000  # more take memory
# By what share a ball's diameter and contact may differ from the fitted ones.
_MOST_OTHER = 0.1
_Code = Annotated[float, Field(ge=-255, le=255)]
_Length = Annotated[float, Field(gt=0, le=100)]


class BallResidual(Settings):
    """Real less predicted code values around the contacts of one ball, linear in the contact's place in the view."""

    diameter_mm: _Length
    contact_radii_mm: tuple[_Length, _Length] = Field(description="of the fitted contacts, least and largest")
    coefficients: tuple[tuple[_Code, _Code, _Code], ...] = Field(
        min_length=3 * _SHAPES, max_length=3 * _SHAPES, repr=False
    )

    @classmethod
    def fitted(
        cls,
        diameter_mm: float,
        radii_mm: np.ndarray,
        points: np.ndarray,
        left: np.ndarray,
        usable: np.ndarray,
    ) -> Self:
        """Fit the residual of presses whose contacts have `radii_mm` to what is left (n, 3), where that is usable.

        `points` (n, 4) are by how many radii a point is off its press, and where that is in the view, in half views.
        """
        some = np.s_[:: 1 + len(points) // _MOST_POINTS]
        points, left, usable = points[some], left[some], usable[some]
        places = monomials(points[:, 2], points[:, 3], 1)
        columns = (places[:, :, None] * _shapes(points[:, :2])[:, None]).reshape(len(points), -1)
        coefficients = np.empty((3 * _SHAPES, 3))
        for channel in range(3):
            weighted = (columns * usable[:, channel, None]).T
            normal = weighted @ columns
            by_shape = normal.diagonal()[:_SHAPES] / len(radii_mm)
            ridge = np.diag(_RIDGE * by_shape + _LEAST_RIDGE * by_shape.mean())
            normal += np.kron(np.eye(3), ridge + _BEND * by_shape.mean() * _BENDS)
            coefficients[:, channel] = np.linalg.solve(normal, weighted @ left[:, channel])
        radii = float(radii_mm.min()), float(radii_mm.max())
        rounded = coefficients.clip(-255, 255).round(2).tolist()
        return cls(diameter_mm=diameter_mm, contact_radii_mm=radii, coefficients=rounded)

    def holds_for(self, diameter_mm: float, contact_radius_mm: float) -> bool:
        """Return whether a ball is the fitted one, and pressed about as deep."""
        least_mm, largest_mm = self.contact_radii_mm
        is_ball = abs(diameter_mm / self.diameter_mm - 1) <= _MOST_OTHER
        return is_ball and (1 - _MOST_OTHER) * least_mm <= contact_radius_mm <= (1 + _MOST_OTHER) * largest_mm

    def around(self, away: np.ndarray, place: np.ndarray) -> np.ndarray:
        """Return (n, 3): the residual in code values at points `away` (n, 2) from a press at `place` (2,), as above."""
        near, left = np.hypot(*away.T) < KNOTS[-1], np.zeros((len(away), 3))
        by_place = np.array(self.coefficients).reshape(3, _SHAPES, 3)
        left[near] = _shapes(away[near]) @ np.tensordot(monomials(place[0], place[1], 1), by_place, 1)
        return left


def _shapes(away: np.ndarray) -> np.ndarray:
    """Return (n, shapes): each hat of the radius times each wave of the angle."""
    radius, angle = np.hypot(*away.T), np.arctan2(away[:, 1], away[:, 0])
    hats = [np.interp(radius, KNOTS, hat) for hat in np.eye(len(KNOTS))[:-1]]
    waves = [np.ones_like(angle)]
    for order in range(1, _ORDERS + 1):
        waves += [np.cos(order * angle), np.sin(order * angle)]
    shapes = np.stack(hats, axis=1)[:, :, None] * np.stack(waves, axis=1)[:, None]
    shapes[:, 0, 1:] = 0.0  # a wave has no value at the centre
    return shapes.reshape(len(away), _SHAPES)
