"""A table without physics: how pixels change, looked up by where they lie around the ball's imprint.

Inside the contact this place is the ball's normal, so it is the table of gradients that GelSights are calibrated with;
outside it holds what this ball's dent looks like. With `degree` 2 each entry is a quadratic of the press's place.
"""

from collections.abc import Sequence

import numpy as np

from gelgap.render import PressPicture
from gelgap.render.light.scattered import monomials

REACH = 4.0  # contact radii
RADII, DIRECTIONS = 80, 72
RIDGE = 0.003


class PlainTable:
    """Mean change in code values of (h, w, 3) pictures by distance and direction from the press."""

    def __init__(self, reference: np.ndarray, presses: Sequence[PressPicture], degree: int) -> None:
        self.reference, self.degree = reference.astype(float), degree
        self.reach_px = REACH * float(np.median([press.radius_px for press in presses]))
        normal, right = 0.0, 0.0
        for press in presses:
            bins, terms = self._bins(press).ravel(), self._terms(press)
            change = (press.picture - self.reference).reshape(-1, 3).T
            count, *sums = (
                np.bincount(bins, weights, RADII * DIRECTIONS + 1)[:-1] for weights in (None, *change)
            )
            mean = np.column_stack(sums) / np.maximum(count, 1)[:, None]
            normal = normal + (count > 0)[:, None, None] * np.outer(terms, terms)
            right = right + terms[:, None] * mean[:, None]
        penalty = len(presses) * np.diag([1e-6] + [RIDGE] * (len(terms) - 1))
        self.coefficients = np.linalg.solve(normal + penalty, right)

    def picture(self, press: PressPicture) -> np.ndarray:
        """Return the uint8 picture of a press, of which its marked centre is used."""
        change = np.einsum("t,btc->bc", self._terms(press), self.coefficients)
        bins = self._bins(press)
        return np.clip(np.round(self.reference + np.vstack([change, np.zeros(3)])[bins]), 0, 255).astype(
            np.uint8
        )

    def _bins(self, press: PressPicture) -> np.ndarray:
        """Return (h, w) the entry of each pixel; the last one is beyond the table's reach."""
        rows, columns = np.indices(self.reference.shape[:2])
        x, y = columns - press.center_px[0], rows - press.center_px[1]
        ring = (np.hypot(x, y) / self.reach_px * RADII).astype(int)
        turn = ((np.arctan2(y, x) / (2 * np.pi) % 1) * DIRECTIONS).astype(int) % DIRECTIONS
        return np.where(ring < RADII, ring * DIRECTIONS + turn, RADII * DIRECTIONS)

    def _terms(self, press: PressPicture) -> np.ndarray:
        height, width, _ = self.reference.shape
        x, y = press.center_px
        return np.array(monomials(2 * x / width - 1, 2 * y / height - 1, self.degree))
