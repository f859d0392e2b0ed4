"""Colours of LEDs between a colour picker and the renderer's linear camera RGB."""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from gelgap.render import Camera, Illumination, Led, RgbSpectrum, encode

Rgb = tuple[int, int, int]
_SWITCHED_OFF = (70, 70, 70)


@lru_cache(maxsize=256)
def colour_of_spectrum(spectrum, camera: Camera) -> tuple[float, float, float]:
    """Return the linear camera RGB of a spectrum at drive 1 and exposure 1."""
    lone = Led(position_mm=(0.0, 0.0, -10.0), spectrum=spectrum)
    red, green, blue = Illumination(leds=(lone,)).led_to_camera(camera)[0] / camera.exposure
    return float(red), float(green), float(blue)


def led_to_camera(illumination: Illumination, camera: Camera) -> NDArray[np.float64]:
    """Return `Illumination.led_to_camera`, (n_leds, 3), with each spectrum's colour computed once per camera."""
    colours = [np.array(colour_of_spectrum(led.spectrum, camera)) * led.drive for led in illumination.leds]
    return camera.exposure * np.array(colours)


def swatch(led: Led) -> Rgb:
    """Return the 8-bit colour in which an LED is shown, at full brightness; grey where it is switched off."""
    if led.drive == 0:
        return _SWITCHED_OFF
    linear = np.maximum(colour_of_spectrum(led.spectrum, Camera()), 0)
    shown = np.maximum(linear / max(linear.max(), 1e-9), 0.02)
    return tuple(int(value) for value in encode(shown[None, None].astype(np.float32))[0, 0])


def recoloured(led: Led, picked: Rgb, camera: Camera) -> Led:
    """Return an LED of a picked colour that is as bright in its strongest channel as before."""
    code = np.array(picked) / 255
    linear = np.where(code <= 0.04045, code / 12.92, ((code + 0.055) / 1.055) ** 2.4)
    brightest = max(colour_of_spectrum(led.spectrum, camera))
    scaled = linear / max(linear.max(), 1e-3) * brightest
    return led.model_copy(update={"spectrum": RgbSpectrum(rgb=tuple(float(value) for value in scaled))})
