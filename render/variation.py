"""Seeded draws around a sensor and its LEDs: what differs between two copies of one design, and as a gel ages."""

import numpy as np
from pydantic import Field

from gelgap.assets.settings import Settings
from gelgap.render.light.leds import Illumination, Led
from gelgap.render.light.spectra import PeakSpectrum, Spectrum, WhiteSpectrum
from gelgap.render.sensor import Sensor


class Variation(Settings):
    """How much to vary. Spreads are standard deviations of normal draws cut at two; 0 leaves a property alone.

    `yellowing` is what can be said of an ageing gel without inventing scratches: silicone loses blue, then green, on
    the way to the coat and back. The share of blue that is lost is drawn evenly between 0 and this value; green loses
    a third of it.
    """

    led_position_mm: float = Field(default=0.3, ge=0, le=5, description="along each axis")
    led_angle_deg: float = Field(default=3.0, ge=0, le=45, description="tilt of the facing about each axis")
    led_drive: float = Field(default=0.1, ge=0, le=1, description="relative")
    led_peak_nm: float = Field(default=3.0, ge=0, le=30, description="peak wavelength of coloured LEDs")
    led_cct: float = Field(
        default=0.05, ge=0, le=0.5, description="colour temperature of white LEDs, relative"
    )
    albedo: float = Field(default=0.05, ge=0, le=0.5, description="of the coat, relative, all channels alike")
    yellowing: float = Field(
        default=0.0, ge=0, le=0.9, description="greatest share of blue lost in an aged gel"
    )


def _normal(rng: np.random.Generator, spread: float, size: int | None = None) -> np.ndarray:
    return spread * np.clip(rng.standard_normal(size), -2, 2)


def _varied_spectrum(spectrum: Spectrum, variation: Variation, rng: np.random.Generator) -> Spectrum:
    shift = float(_normal(rng, 1.0))
    match spectrum:
        case PeakSpectrum():
            peak_nm = np.clip(spectrum.peak_nm + variation.led_peak_nm * shift, 400, 700)
            return PeakSpectrum(peak_nm=float(peak_nm), width_nm=spectrum.width_nm)
        case WhiteSpectrum():
            return WhiteSpectrum(
                cct_k=float(np.clip(spectrum.cct_k * (1 + variation.led_cct * shift), 1500, 20000))
            )
    return spectrum


def _varied_led(led: Led, variation: Variation, rng: np.random.Generator) -> Led:
    from scipy.spatial.transform import Rotation

    turn = Rotation.from_euler("xyz", _normal(rng, variation.led_angle_deg, 3), degrees=True)
    position_mm = np.asarray(led.position_mm) + _normal(rng, variation.led_position_mm, 3)
    facing = turn.apply(led.normal)
    drive = led.drive * max(1 + float(_normal(rng, variation.led_drive)), 0.05)
    spectrum = _varied_spectrum(led.spectrum, variation, rng)
    changed = led.model_copy(update={"facing": tuple(facing.tolist()), "position_mm": tuple(position_mm)})
    # A draw must not push an LED through the membrane.
    position_mm[2] -= max(changed.highest_z_mm() + 0.05, 0)
    update = {"position_mm": position_mm.tolist(), "drive": drive, "spectrum": spectrum.model_dump()}
    return Led(**changed.model_dump() | update)


def vary_illumination(
    illumination: Illumination, variation: Variation, rng: np.random.Generator
) -> Illumination:
    """Return an illumination drawn around another; the same generator state gives the same draw."""
    leds = tuple(_varied_led(led, variation, rng) for led in illumination.leds)
    return illumination.model_copy(update={"leds": leds})


def vary_sensor(sensor: Sensor, variation: Variation, rng: np.random.Generator) -> Sensor:
    """Return a sensor drawn around another: its coat, its gel's age and, where it has its own, its LEDs."""
    level = 1 + float(_normal(rng, variation.albedo))
    lost_blue = variation.yellowing * float(rng.random())
    keeps = np.array([1.0, 1 - lost_blue / 3, 1 - lost_blue])
    albedo = np.clip(np.asarray(sensor.coating.albedo) * level * keeps, 0, 1)
    coating = sensor.coating.model_copy(update={"albedo": tuple(albedo.tolist())})
    illumination = sensor.illumination
    if illumination is not None:
        illumination = vary_illumination(illumination, variation, rng)
    # A table of normals holds for the light in which it was measured alone.
    return sensor.model_copy(update={"coating": coating, "illumination": illumination, "table_share": 0.0})
