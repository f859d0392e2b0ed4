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
_SHAPES = (2 * _ORDERS + 1) * (len(KNOTS) - 1)
# By so much of a press it is drawn to 0, and to the same everywhere.
_RIDGE, _LEAST_RIDGE = 0.3, 3e-4
# By what shares a ball, and its contact, may differ from the fitted ones.
_OTHER_BALL, _OTHER_CONTACT = 0.1, 0.25
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
        away: np.ndarray,
        place: np.ndarray,
        left: np.ndarray,
        weights: np.ndarray,
    ) -> Self:
        """Fit the residual to what is left, with weights (n, 3) both, at points `away` (n, 2) from their presses.

        `radii_mm` are those of all presses' contacts. `away` is in radii of the point's contact; `place` (n, 2), where
        in the view its press is, in half views.
        """
        columns = (monomials(*place.T, 1)[:, :, None] * _shapes(away)[:, None]).reshape(len(away), -1)
        coefficients = np.empty((3 * _SHAPES, 3))
        for channel in range(3):
            weighted = (columns * weights[:, channel, None]).T
            normal = weighted @ columns
            by_shape = normal.diagonal()[:_SHAPES]
            ridge = (_RIDGE * by_shape + _LEAST_RIDGE * by_shape.max() + 1e-9) / len(radii_mm)
            normal[np.diag_indices_from(normal)] += np.tile(ridge, 3)
            coefficients[:, channel] = np.linalg.solve(normal, weighted @ left[:, channel])
        radii = float(radii_mm.min()), float(radii_mm.max())
        rounded = coefficients.clip(-255, 255).round(2).tolist()
        return cls(diameter_mm=diameter_mm, contact_radii_mm=radii, coefficients=rounded)

    def holds_for(self, diameter_mm: float, contact_radius_mm: float) -> bool:
        """Return whether a ball is the fitted one, and pressed about as deep."""
        least_mm, largest_mm = self.contact_radii_mm
        low, high = (1 - _OTHER_CONTACT) * least_mm, (1 + _OTHER_CONTACT) * largest_mm
        is_ball = abs(diameter_mm / self.diameter_mm - 1) <= _OTHER_BALL
        return is_ball and low <= contact_radius_mm <= high

    def added_to(self, picture: np.ndarray, away: np.ndarray, place: np.ndarray) -> np.ndarray:
        """Return a picture (h, w, 3) in code values with the residual of one press at `place` (2,), in half views.

        `away` (h w, 2) says how far from the press each pixel sees the membrane, in radii of the contact.
        """
        near = np.hypot(*away.T) < KNOTS[-1]
        by_place = np.array(self.coefficients).reshape(3, _SHAPES, 3)
        added = np.zeros((len(away), 3))
        added[near] = _shapes(away[near]) @ np.tensordot(monomials(*place, 1), by_place, 1)
        return picture + added.reshape(picture.shape)


def _shapes(away: np.ndarray) -> np.ndarray:
    """Return (n, shapes): each hat of the radius times each wave of the angle."""
    radius, angle = np.hypot(*away.T), np.arctan2(away[:, 1], away[:, 0])
    hats = [np.interp(radius, KNOTS, hat) for hat in np.eye(len(KNOTS))[:-1]]
    waves = [np.ones_like(angle)]
    for order in range(1, _ORDERS + 1):
        waves += [np.cos(order * angle), np.sin(order * angle)]
    return (np.stack(hats, axis=1)[:, :, None] * np.stack(waves, axis=1)[:, None]).reshape(len(away), _SHAPES)
