"""What a fitted light consists of besides its bars: ambient and scattered light, as columns of a linear problem."""

from dataclasses import dataclass

import numpy as np

from gelgap.render.scattered import HARMONICS, PLACES, harmonics, monomials

_ORDERS = np.array([1] * 3 + [2] * 5 + [3] * 7)
_DEGREES = np.array([0, 1, 1, 2, 2, 2])


@dataclass(frozen=True)
class LightOptions:
    """What the light consists of, and where its place is measured."""

    order: int
    degree: int
    ambient: bool
    shadows: bool
    scale_mm: float
    span_mm: tuple[float, float, float, float]
    nearest_mm: float

    def penalty(self, leds: int) -> np.ndarray:
        """Return the square roots of the ridge's weights by column."""
        parts = [np.full(leds, 1e-3), np.full(self.ambient_columns, 0.3)]
        if self.order:
            orders, degrees = _ORDERS[: HARMONICS[self.order]], _DEGREES[: PLACES[self.degree]]
            parts.append((orders[:, None] * (1.0 + degrees)).ravel())
        return np.concatenate(parts)

    @property
    def ambient_columns(self) -> int:
        if not self.ambient:
            return 0
        return PLACES[1] if self.order else 1

    def _places(self, positions: np.ndarray) -> np.ndarray:
        x0, x1, y0, y1 = self.span_mm
        x, y = np.clip(positions[:, 0], x0, x1), np.clip(positions[:, 1], y0, y1)
        return monomials(x / self.scale_mm, y / self.scale_mm, 2)

    def fixed_light(self, positions: np.ndarray, normals: np.ndarray | None, theta: np.ndarray) -> np.ndarray:
        """Return (n, 3): `fixed_columns` @ theta; without normals that of the flat membrane."""
        place = self._places(positions)
        count, places = HARMONICS[self.order], PLACES[self.degree]
        light = place[:, : self.ambient_columns] @ theta[: self.ambient_columns]
        if normals is not None and self.order:
            by_place = theta[self.ambient_columns :].reshape(count, places, 3).transpose(1, 0, 2)
            by_harmonic = place[:, :places] @ by_place.reshape(places, 3 * count)
            light += np.einsum(
                "nl,nlc->nc", harmonics(normals, self.order), by_harmonic.reshape(-1, count, 3)
            )
        return light

    def fixed_columns(self, positions: np.ndarray, normals: np.ndarray) -> np.ndarray:
        """Return (n, columns) of ambient and scattered light."""
        place = self._places(positions)
        parts = [place[:, : self.ambient_columns]]
        if self.order:
            by_normal = harmonics(normals, self.order)[:, :, None]
            parts.append((by_normal * place[:, None, : PLACES[self.degree]]).reshape(len(positions), -1))
        return np.concatenate(parts, axis=1)
