"""What the camera sees of a membrane, with all that does not change between two pictures kept."""

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gelgap.render import Illumination, MembraneRenderer, Sensor, picture_gap
from gelgap.sim import MembraneState, QualityName
from gelgap.view.configuration import Configuration
from gelgap.view.led_colours import led_to_camera

SIZE_PX = (320, 240)
NOISE_SEED = 0
# Renderers that are kept: two configurations compared, each at two qualities.
_KEPT_RENDERERS = 4
_KEPT_REFERENCES = 8

Picture = NDArray[np.uint8]


class Lit(NamedTuple):
    """What a renderer belongs to."""

    sensor: Sensor
    illumination: Illumination
    quality: QualityName

    @classmethod
    def of(cls, configuration: Configuration) -> "Lit":
        """Return sensor, light and quality of a configuration."""
        return cls(configuration.sensor, configuration.illumination, configuration.quality)


class PictureMaker:
    """Makes pictures of configurations; call it from one thread only.

    A renderer holds the light on the undeformed membrane, and so belongs to one illumination. Surface and raster of the
    membrane seen last are kept by `gelgap.render`, so that another light or markers do not need them again.
    """

    def __init__(self) -> None:
        self._renderers: dict[Lit, MembraneRenderer] = {}
        self._reference = lru_cache(_KEPT_REFERENCES)(self._drawn_reference)
        self._gap = lru_cache(_KEPT_REFERENCES)(self._measured_gap)

    def light(self, configuration: Configuration) -> MembraneRenderer:
        """Return the renderer of a configuration's light."""
        return self._renderer(Lit.of(configuration))

    def picture(self, configuration: Configuration, state: MembraneState) -> Picture:
        """Return the picture (240, 320, 3) of a membrane.

        Raises
        ------
        ValueError
            If the membrane is folded.
        """
        rng = np.random.default_rng(NOISE_SEED) if configuration.noise else None
        membrane = state.x_mm, state.y_mm, state.displacement_mm
        return self.light(configuration).picture(*membrane, configuration.markers, rng)

    def reference(self, configuration: Configuration) -> Picture:
        """Return the picture of the undeformed membrane without noise."""
        return self._reference(Lit.of(configuration), configuration.markers)

    def colour_difference(self, one: Configuration, other: Configuration) -> tuple[float, float]:
        """Return CIEDE2000 between two pictures of the undeformed membrane: mean, and 95th percentile of the pixels.

        They are without markers and noise.
        """
        return self._gap(Lit.of(one), Lit.of(other))

    def _renderer(self, lit: Lit) -> MembraneRenderer:
        if lit in self._renderers:
            return self._renderers[lit]
        colours = led_to_camera(lit.illumination, lit.sensor.camera)
        alike = [old for old in self._renderers if (old.sensor, old.quality) == (lit.sensor, lit.quality)]
        if alike:
            renderer = self._renderers[alike[-1]].relit(lit.illumination, colours)
        else:
            renderer = MembraneRenderer(lit.sensor, lit.illumination, SIZE_PX, lit.quality, colours)
        if len(self._renderers) >= _KEPT_RENDERERS:
            del self._renderers[next(iter(self._renderers))]
        self._renderers[lit] = renderer
        return renderer

    def _drawn_reference(self, lit: Lit, markers: bool) -> Picture:
        return self._renderer(lit).reference(markers)

    def _measured_gap(self, one: Lit, other: Lit) -> tuple[float, float]:
        gap = picture_gap(self._reference(one, False), self._reference(other, False))
        return gap.mean, gap.percentile_95


def difference(picture: Picture, reference: Picture, gain: int = 2) -> Picture:
    """Return how a picture differs from the reference, around mid grey."""
    return np.clip(128 + gain * (picture.astype(np.int16) - reference), 0, 255).astype(np.uint8)
