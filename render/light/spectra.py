"""LED spectra, and what a camera makes of them: linear camera RGB.

Planck's law, Gaussian lines and the cameras' sensitivities are those of colour-science, whose import takes 2.7 s.
`assets/led_colours.csv` keeps the answers for what data sheets state (scripts/led_colours.py makes it), so that presets
are drawn without it; it is imported for any other spectrum, as for lights that are drawn.
"""

from collections.abc import Sequence
from functools import cache, lru_cache
from typing import Annotated

import numpy as np
from pydantic import Field, model_validator

from gelgap.assets import asset_path
from gelgap.assets.names import unknown_name
from gelgap.assets.settings import Settings

FIRST_NM, LAST_NM = 380, 780
VISIBLE_NM = (400.0, 700.0)
TABLE = "led_colours.csv"
_WAVELENGTH_NM = np.arange(FIRST_NM, LAST_NM + 1.0)
Channel = Annotated[float, Field(ge=0, le=100)]
Rgb = tuple[float, float, float]


class PeakSpectrum(Settings):
    """A Gaussian line, as a coloured LED's data sheet gives it."""

    peak_nm: float = Field(ge=FIRST_NM, le=LAST_NM, description="wavelength of the peak, nm")
    width_nm: float = Field(gt=1, le=200, description="full width at half maximum, nm")


class TableSpectrum(Settings):
    """A measured spectrum; between its wavelengths it is interpolated linearly, outside it is 0."""

    wavelength_nm: tuple[float, ...] = Field(min_length=2, repr=False, description="nm, increasing")
    power: tuple[Annotated[float, Field(ge=0)], ...] = Field(
        repr=False, min_length=2, description="relative spectral power"
    )

    @model_validator(mode="after")
    def _check(self) -> "TableSpectrum":
        if len(self.wavelength_nm) != len(self.power):
            raise ValueError(
                f"wavelength_nm has {len(self.wavelength_nm)} values and power has {len(self.power)}; they must match"
            )
        if np.any(np.diff(self.wavelength_nm) <= 0):
            raise ValueError("wavelength_nm must increase")
        if sum(self.power) <= 0:
            raise ValueError("power must not be 0 everywhere")
        return self


class RgbSpectrum(Settings):
    """A colour given directly as linear camera RGB at drive 1; no spectrum is computed."""

    rgb: tuple[Channel, Channel, Channel] = Field(description="linear camera RGB")


class WhiteSpectrum(Settings):
    """White light of a correlated colour temperature: a Planckian radiator within the visible range."""

    cct_k: float = Field(ge=1500, le=20000, description="correlated colour temperature, kelvin")


Emitted = PeakSpectrum | TableSpectrum | WhiteSpectrum
Spectrum = Emitted | RgbSpectrum
EQUAL_ENERGY = TableSpectrum(wavelength_nm=VISIBLE_NM, power=(1.0, 1.0))


def camera_rgb(
    spectra: Sequence[Spectrum], sensitivity: str, white_balance_cct_k: float | None
) -> tuple[Rgb, ...]:
    """Return the linear camera RGB of each spectrum at unit power.

    The camera's channels are scaled so that white light (equal energy over 400–700 nm, or a Planckian radiator of
    `white_balance_cct_k`) of unit power gives (1, 1, 1). An `RgbSpectrum` is returned as it stands.

    Raises
    ------
    ValueError
        If the camera is unknown or a spectrum has no power in the visible range.
    """
    white = WhiteSpectrum(cct_k=white_balance_cct_k) if white_balance_cct_k else EQUAL_ENERGY

    def rgb(spectrum: Spectrum) -> Rgb:
        if isinstance(spectrum, RgbSpectrum):
            return spectrum.rgb
        red, green, blue = raw_rgb(spectrum, sensitivity) / raw_rgb(white, sensitivity)
        return float(red), float(green), float(blue)

    return tuple(rgb(spectrum) for spectrum in spectra)


def raw_rgb(spectrum: Emitted, sensitivity: str) -> np.ndarray:
    """Return (3,): what a camera's channels respond to a spectrum of unit power."""
    known = _table().get(table_key(spectrum, sensitivity))
    return computed_rgb(spectrum, sensitivity) if known is None else known


def table_key(spectrum: Emitted, sensitivity: str) -> tuple[str, ...] | None:
    """Return the first columns of a spectrum's row in the table, as text; None if the table has no such rows."""
    match spectrum:
        case PeakSpectrum():
            return sensitivity, "peak", f"{spectrum.peak_nm!r}", f"{spectrum.width_nm!r}"
        case WhiteSpectrum():
            return sensitivity, "white", f"{spectrum.cct_k!r}", ""
    return (sensitivity, "equal energy", "", "") if spectrum == EQUAL_ENERGY else None


@cache
def _table() -> dict[tuple[str, ...] | None, np.ndarray]:
    rows = asset_path(TABLE).read_text(encoding="utf-8").splitlines()[1:]
    cells = [row.split(",") for row in rows]
    return {tuple(row[:4]): np.array(row[4:], float) for row in cells}


# Each picture under a drawn light asks for the same ones again.
@lru_cache(maxsize=1024)
def computed_rgb(spectrum: Emitted, sensitivity: str) -> np.ndarray:
    """Return `raw_rgb` by colour-science."""
    import colour

    cameras = colour.MSDS_CAMERA_SENSITIVITIES
    if sensitivity not in cameras:
        raise ValueError(unknown_name("camera sensitivity", sensitivity, sorted(cameras)))
    table = cameras[sensitivity]
    channels = [
        np.interp(_WAVELENGTH_NM, table.wavelengths, table.values[:, k], left=0, right=0) for k in range(3)
    ]
    return _power(spectrum) @ np.stack(channels, axis=1)


def _power(spectrum: Emitted) -> np.ndarray:
    """Return the spectral power at `_WAVELENGTH_NM`, scaled to unit total power."""
    from colour.colorimetry import SpectralShape, planck_law, sd_gaussian_fwhm

    match spectrum:
        case PeakSpectrum():
            shape = SpectralShape(FIRST_NM, LAST_NM, 1)
            power = sd_gaussian_fwhm(spectrum.peak_nm, spectrum.width_nm, shape).values
        case TableSpectrum():
            power = np.interp(_WAVELENGTH_NM, spectrum.wavelength_nm, spectrum.power, left=0, right=0)
        case WhiteSpectrum():
            visible = (VISIBLE_NM[0] <= _WAVELENGTH_NM) & (VISIBLE_NM[1] >= _WAVELENGTH_NM)
            power = np.where(visible, planck_law(_WAVELENGTH_NM * 1e-9, spectrum.cct_k), 0)
    total = power.sum()
    if total <= 0:
        raise ValueError(f"the spectrum {spectrum!r} has no power between {FIRST_NM} and {LAST_NM} nm")
    return power / total
