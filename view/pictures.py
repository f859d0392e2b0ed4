"""What the camera sees of a membrane, with all that does not change between two pictures kept; and colours of LEDs."""

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gelgap.render import Camera, Illumination, Led, MembraneRenderer, RgbSpectrum, Sensor, encode
from gelgap.render.imaging import srgb_decode
from gelgap.render.renderer import reference_gap
from gelgap.sim import MembraneState
from gelgap.sim.problem import QualityName

SIZE_PX = (320, 240)
NOISE_SEED = 0
# Renderers that are kept: two configurations compared, each at two qualities.
_KEPT_RENDERERS = 4
_KEPT_REFERENCES = 8
_SWITCHED_OFF = (70, 70, 70)

Picture = NDArray[np.uint8]
Rgb = tuple[int, int, int]


class Light(NamedTuple):
    """What a renderer belongs to."""

    sensor: Sensor
    illumination: Illumination
    quality: QualityName


class PictureMaker:
    """Makes pictures of membranes; call it from one thread only.

    A renderer holds the light on the undeformed membrane, and so belongs to one illumination. Surface and raster of the
    membrane seen last are kept by `gelgap.render`, so that another light or markers do not need them again.
    """

    def __init__(self) -> None:
        self._renderers: dict[Light, MembraneRenderer] = {}
        self.reference = lru_cache(_KEPT_REFERENCES)(
            lambda light, markers: self.renderer(light).reference(markers)
        )
        """The picture of the undeformed membrane under a light, with markers or without, and without noise."""
        self.colour_gap = lru_cache(_KEPT_REFERENCES)(
            lambda one, other: reference_gap(self.renderer(one), self.renderer(other))
        )
        """The gap between the pictures of the undeformed membrane under two lights, without markers and noise."""

    def picture(self, light: Light, state: MembraneState, markers: bool, noise: bool) -> Picture:
        """Return the picture (240, 320, 3) of a membrane.

        Raises
        ------
        ValueError
            If the membrane is folded.
        """
        rng = np.random.default_rng(NOISE_SEED) if noise else None
        return self.renderer(light).picture(state.x_mm, state.y_mm, state.displacement_mm, markers, rng)

    def renderer(self, light: Light) -> MembraneRenderer:
        """Return the renderer of a light, made from one of another light on the same sensor if there is one."""
        if light in self._renderers:
            return self._renderers[light]
        alike = [old for old in self._renderers if (old.sensor, old.quality) == (light.sensor, light.quality)]
        if alike:
            renderer = self._renderers[alike[-1]].relit(light.illumination)
        else:
            renderer = MembraneRenderer(light.sensor, light.illumination, SIZE_PX, light.quality)
        keep(self._renderers, light, renderer, _KEPT_RENDERERS)
        return renderer


def keep(kept: dict, key: object, value: object, most: int) -> None:
    """Keep one more; the oldest goes where there are too many."""
    kept.pop(key, None)
    if len(kept) >= most:
        del kept[next(iter(kept))]
    kept[key] = value


def colour_of_spectrum(spectrum, camera: Camera) -> tuple[float, float, float]:
    """Return the linear camera RGB of a spectrum at drive 1 and exposure 1."""
    lone = Led(position_mm=(0.0, 0.0, -10.0), spectrum=spectrum)
    return tuple((Illumination(leds=(lone,)).led_to_camera(camera)[0] / camera.exposure).tolist())


def swatch(led: Led) -> Rgb:
    """Return the 8-bit colour in which an LED is shown, at full brightness; grey where it is switched off."""
    if led.drive == 0:
        return _SWITCHED_OFF
    linear = np.maximum(colour_of_spectrum(led.spectrum, Camera()), 0)
    shown = np.maximum(linear / max(linear.max(), 1e-9), 0.02)
    return tuple(int(value) for value in encode(shown[None, None].astype(np.float32))[0, 0])


def recoloured(led: Led, picked: Rgb, camera: Camera) -> Led:
    """Return an LED of a picked colour that is as bright in its strongest channel as before."""
    linear = srgb_decode(np.array(picked) / 255)
    brightest = max(colour_of_spectrum(led.spectrum, camera))
    scaled = linear / max(linear.max(), 1e-3) * brightest
    return led.model_copy(update={"spectrum": RgbSpectrum(rgb=tuple(float(value) for value in scaled))})
