"""What the camera sees of a membrane, with all that does not change between two pictures kept; and colours of LEDs."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gelgap.render import Camera, Illumination, Led, MembraneRenderer, RgbSpectrum, Sensor, encode
from gelgap.render.imaging import ColourGap, srgb_decode
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


class LitSensor(NamedTuple):
    """A sensor under one illumination, and how finely it is drawn: what a renderer belongs to."""

    sensor: Sensor
    illumination: Illumination
    quality: QualityName


class PictureMaker:
    """Makes pictures of membranes; call it from one thread only.

    A renderer holds the light on the undeformed membrane, and so belongs to one illumination. Surface and raster of the
    membrane seen last are kept by `gelgap.render`, so that another light or markers do not need them again.
    """

    def __init__(self) -> None:
        self._renderers: dict[LitSensor, MembraneRenderer] = {}
        self._references: dict[tuple[LitSensor, bool], Picture] = {}
        self._gaps: dict[tuple[LitSensor, LitSensor], ColourGap] = {}

    def reference(self, lit: LitSensor, markers: bool) -> Picture:
        """Return the picture of the undeformed membrane, with markers or without, and without noise."""
        if (lit, markers) not in self._references:
            keep(self._references, (lit, markers), self.renderer(lit).reference(markers), _KEPT_REFERENCES)
        return self._references[lit, markers]

    def colour_gap(self, one: LitSensor, other: LitSensor) -> ColourGap:
        """Return the gap between two pictures of the undeformed membrane, without markers and noise."""
        if (one, other) not in self._gaps:
            gap = reference_gap(self.renderer(one), self.renderer(other))
            keep(self._gaps, (one, other), gap, _KEPT_REFERENCES)
        return self._gaps[one, other]

    def picture(self, lit: LitSensor, state: MembraneState, markers: bool, noise: bool) -> Picture:
        """Return the picture (240, 320, 3) of a membrane.

        Raises
        ------
        ValueError
            If the membrane is folded.
        """
        rng = np.random.default_rng(NOISE_SEED) if noise else None
        return self.renderer(lit).picture(state.x_mm, state.y_mm, state.displacement_mm, markers, rng)

    def renderer(self, lit: LitSensor) -> MembraneRenderer:
        """Return the renderer of a lit sensor, made from one of the same sensor in another light if there is one."""
        if lit in self._renderers:
            return self._renderers[lit]
        alike = [old for old in self._renderers if (old.sensor, old.quality) == (lit.sensor, lit.quality)]
        if alike:
            renderer = self._renderers[alike[-1]].relit(lit.illumination)
        else:
            renderer = MembraneRenderer(lit.sensor, lit.illumination, SIZE_PX, lit.quality)
        keep(self._renderers, lit, renderer, _KEPT_RENDERERS)
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
    red, green, blue = (Illumination(leds=(lone,)).led_to_camera(camera)[0] / camera.exposure).tolist()
    return red, green, blue


def swatch(led: Led) -> Rgb:
    """Return the 8-bit colour in which an LED is shown, at full brightness; grey where it is switched off."""
    if led.drive == 0:
        return _SWITCHED_OFF
    linear = np.maximum(colour_of_spectrum(led.spectrum, Camera()), 0)
    shown = np.maximum(linear / max(linear.max(), 1e-9), 0.02)
    red, green, blue = encode(shown[None, None].astype(np.float32))[0, 0].tolist()
    return red, green, blue


def recoloured(led: Led, picked: Rgb, camera: Camera) -> Led:
    """Return an LED of a picked colour that is as bright in its strongest channel as before."""
    linear = srgb_decode(np.array(picked) / 255)
    brightest = max(colour_of_spectrum(led.spectrum, camera))
    red, green, blue = (linear / max(linear.max(), 1e-3) * brightest).tolist()
    return led.model_copy(update={"spectrum": RgbSpectrum(rgb=(red, green, blue))})
