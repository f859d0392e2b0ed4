"""What spectra look like to a camera, kept on disk by content, so that only its first use imports colour-science."""

import contextlib
import hashlib
import json
import math
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from gelgap.assets.checksums import read_json, with_checksum, without_checksum
from gelgap.assets.locks import cache_folder, key_lock
from gelgap.assets.whole_file import DAMAGED_SUFFIX, set_aside, write_whole
from gelgap.render.spectrum import RgbSpectrum, Spectrum, camera_rgb

Rgb = tuple[float, float, float]


def cached_camera_rgb(
    spectra: tuple[Spectrum, ...], sensitivity: str, white_balance_cct_k: float | None
) -> tuple[Rgb, ...]:
    """Return `camera_rgb` of these spectra from the user's cache folder, or compute and keep it.

    A damaged file is named and set aside; one that cannot be written costs the time to compute and nothing else.
    """
    if all(isinstance(spectrum, RgbSpectrum) for spectrum in spectra):
        return camera_rgb(spectra, sensitivity, white_balance_cct_k)
    key = _key(spectra, sensitivity, white_balance_cct_k)
    path = cache_folder() / f"{key}.led"
    found = _kept(path, len(spectra))
    if found is None:
        with key_lock(cache_folder(), key):
            found = _kept(path, len(spectra))
            if found is None:
                found = camera_rgb(spectra, sensitivity, white_balance_cct_k)
                with contextlib.suppress(RuntimeError):
                    write_whole(path, json.dumps(with_checksum({"rgb": found})).encode())
    return found


def clear_led_cache() -> None:
    """Delete what `cached_camera_rgb` has kept."""
    for pattern in ("*.led", f"*.led{DAMAGED_SUFFIX}"):
        for path in cache_folder().glob(pattern):
            path.unlink(missing_ok=True)


def _kept(path: Path, count: int) -> tuple[Rgb, ...] | None:
    """Return the colours of a file; None if there is none, or it was damaged and is now set aside."""
    if not path.is_file():
        return None
    try:
        return _read(path, count)
    except (OSError, ValueError, TypeError) as error:
        set_aside(path, f"is damaged ({error})")
        return None


def _read(path: Path, count: int) -> tuple[Rgb, ...]:
    """Return the rows of a file, or raise ValueError or TypeError with the reason."""
    rows = without_checksum(read_json(path)).get("rgb")
    found = tuple((float(red), float(green), float(blue)) for red, green, blue in rows)
    if len(found) != count or not all(math.isfinite(value) for row in found for value in row):
        raise ValueError(f"it does not hold {count} colours")
    return found


def _key(spectra: tuple[Spectrum, ...], sensitivity: str, white_balance_cct_k: float | None) -> str:
    try:
        colour_version = version("colour-science")
    except PackageNotFoundError:
        colour_version = ""
    content = [[type(spectrum).__name__, spectrum.model_dump()] for spectrum in spectra]
    text = json.dumps([content, sensitivity, white_balance_cct_k, colour_version, _MODEL])
    return hashlib.sha256(text.encode()).hexdigest()


# Raise it when `camera_rgb` computes something else, or the file has another form.
_MODEL = 2
