"""LED spectra, and what a camera makes of them: linear camera RGB.

Only the first use of a camera imports colour-science; its response is kept on disk.
"""

import contextlib
import json
from collections.abc import Sequence
from functools import lru_cache
from importlib.metadata import version
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field, model_validator

from gelgap.assets.checksums import parse_json, sha256
from gelgap.assets.locks import cache_folder, key_lock
from gelgap.assets.names import unknown_name
from gelgap.assets.settings import Settings
from gelgap.assets.whole_file import write_whole

FIRST_NM, LAST_NM = 380, 780
VISIBLE_NM = (400.0, 700.0)
_WAVELENGTH_NM = np.arange(FIRST_NM, LAST_NM + 1.0)
# Planck's constants, W m² and m K, as colorimetry takes them (ITS-90; CIE 15:2004).
_C1, _C2 = 3.741771e-16, 1.4388e-2
# Raise it when the file in the cache has another form.
_MODEL = 3
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


Spectrum = PeakSpectrum | TableSpectrum | RgbSpectrum | WhiteSpectrum


def _power(spectrum: PeakSpectrum | TableSpectrum | WhiteSpectrum) -> np.ndarray:
    """Return the spectral power at `_WAVELENGTH_NM`, scaled to unit total power."""
    match spectrum:
        case PeakSpectrum():
            sigma_nm = spectrum.width_nm / (2 * np.sqrt(2 * np.log(2)))
            power = np.exp(-0.5 * ((_WAVELENGTH_NM - spectrum.peak_nm) / sigma_nm) ** 2)
        case TableSpectrum():
            power = np.interp(_WAVELENGTH_NM, spectrum.wavelength_nm, spectrum.power, left=0, right=0)
        case WhiteSpectrum():
            wavelength_m = _WAVELENGTH_NM * 1e-9
            power = _C1 * wavelength_m**-5 / np.pi * (1 / np.expm1(_C2 / (wavelength_m * spectrum.cct_k)))
            first, last = np.searchsorted(_WAVELENGTH_NM, VISIBLE_NM)
            power[:first] = power[last + 1 :] = 0
    total = power.sum()
    if total <= 0:
        raise ValueError(f"the spectrum {spectrum!r} has no power between {FIRST_NM} and {LAST_NM} nm")
    return power / total


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
    if all(isinstance(spectrum, RgbSpectrum) for spectrum in spectra):
        return tuple(spectrum.rgb for spectrum in spectra)
    response = camera_response(sensitivity)
    equal_energy = TableSpectrum(wavelength_nm=VISIBLE_NM, power=(1.0, 1.0))
    white = WhiteSpectrum(cct_k=white_balance_cct_k) if white_balance_cct_k else equal_energy
    gain = 1 / (_power(white) @ response)

    def rgb(spectrum: Spectrum) -> Rgb:
        if isinstance(spectrum, RgbSpectrum):
            return spectrum.rgb
        return tuple((_power(spectrum) @ response * gain).tolist())

    return tuple(rgb(spectrum) for spectrum in spectra)


def camera_response(sensitivity: str) -> np.ndarray:
    """Return (401, 3): how a camera's channels respond to light of 380 to 780 nm, kept in the user's cache folder.

    A file that cannot be read or written costs an import of colour-science and nothing else.
    """
    text = json.dumps([sensitivity, version("colour-science"), _MODEL])
    key = sha256(text.encode())
    path = cache_folder() / f"{key}.led"
    if (found := _kept(path)) is None:
        with key_lock(cache_folder(), key):
            if (found := _kept(path)) is None:
                found = _tabulated_response(sensitivity)
                with contextlib.suppress(RuntimeError):
                    write_whole(path, json.dumps(found.tolist()).encode())
    return found


def _tabulated_response(sensitivity: str) -> np.ndarray:
    import colour

    cameras = colour.MSDS_CAMERA_SENSITIVITIES
    if sensitivity not in cameras:
        raise ValueError(unknown_name("camera sensitivity", sensitivity, sorted(cameras)))
    table = cameras[sensitivity]
    channels = (
        np.interp(_WAVELENGTH_NM, table.wavelengths, table.values[:, k], left=0, right=0) for k in range(3)
    )
    return np.stack(list(channels), axis=1)


def clear_led_cache() -> None:
    """Delete the responses of cameras, and what earlier versions kept for each light."""
    for path in cache_folder().glob("*.led"):
        path.unlink(missing_ok=True)


def _kept(path: Path) -> np.ndarray | None:
    """Return the response in a file; None if there is none that can be read."""
    return _read(path, path.stat().st_mtime_ns) if path.is_file() else None


# Each light that is drawn asks for it.
@lru_cache(maxsize=8)
def _read(path: Path, modified_ns: int) -> np.ndarray | None:
    try:
        found = np.array(parse_json(path.read_bytes()), dtype=float)
    except (OSError, ValueError, TypeError):
        return None
    return found if found.shape == (len(_WAVELENGTH_NM), 3) else None
