"""What the camera sees of a membrane, with all that does not change between two pictures kept."""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from gelgap.render import Illumination, MembraneRenderer, Sensor
from gelgap.sim import MembraneState, QualityName
from gelgap.view.configuration import Configuration
from gelgap.view.led_colours import led_to_camera

SIZE_PX = (320, 240)
NOISE_SEED = 0
# Renderers that are kept: two configurations compared, each at two qualities.
_KEPT_RENDERERS = 4
_KEPT_REFERENCES = 8

Picture = NDArray[np.uint8]


class PictureMaker:
    """Makes pictures of configurations; call it from one thread only.

    A renderer holds the light on the undeformed membrane, and so belongs to one illumination. Surface and raster of the
    membrane seen last are kept by `gelgap.render`, so that another light or markers do not need them again.
    """

    def __init__(self) -> None:
        self._renderers: dict[tuple[Sensor, Illumination, QualityName], MembraneRenderer] = {}
        self._references = lru_cache(_KEPT_REFERENCES)(self._drawn_reference)

    def light(self, configuration: Configuration) -> MembraneRenderer:
        """Return the renderer of a configuration's light."""
        return self._renderer(configuration.sensor, configuration.illumination, configuration.quality)

    def _renderer(self, sensor: Sensor, illumination: Illumination, quality: QualityName) -> MembraneRenderer:
        key = sensor, illumination, quality
        if key in self._renderers:
            return self._renderers[key]
        alike = [old for old in self._renderers if (old[0], old[2]) == (sensor, quality)]
        colours = led_to_camera(illumination, sensor.camera)
        if alike:
            renderer = self._renderers[alike[-1]].relit(illumination, colours)
        else:
            renderer = MembraneRenderer(sensor, illumination, SIZE_PX, quality, colours)
        if len(self._renderers) >= _KEPT_RENDERERS:
            del self._renderers[next(iter(self._renderers))]
        self._renderers[key] = renderer
        return renderer

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

    def reference(self, configuration: Configuration, markers: bool | None = None) -> Picture:
        """Return the picture of the undeformed membrane without noise; by default with the markers that are shown."""
        shown = configuration.markers if markers is None else markers
        return self._references(
            configuration.sensor, configuration.illumination, configuration.quality, shown
        )

    def _drawn_reference(
        self, sensor: Sensor, illumination: Illumination, quality: QualityName, markers: bool
    ) -> Picture:
        return self._renderer(sensor, illumination, quality).reference(markers)


def difference(picture: Picture, reference: Picture, gain: int = 2) -> Picture:
    """Return how a picture differs from the reference, around mid grey."""
    return np.clip(128 + gain * (picture.astype(np.int16) - reference), 0, 255).astype(np.uint8)
