"""What spectra look like to a camera, kept on disk by content, so that only its first use imports colour-science."""

import contextlib
import hashlib
import json
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from gelgap.assets.key_lock import key_lock
from gelgap.assets.user_cache import cache_folder
from gelgap.assets.whole_file import write_whole
from gelgap.render.spectrum import RgbSpectrum, Spectrum, camera_rgb

Rgb = tuple[float, float, float]


def cached_camera_rgb(
    spectra: tuple[Spectrum, ...], sensitivity: str, white_balance_cct_k: float | None
) -> tuple[Rgb, ...]:
    """Return `camera_rgb` of these spectra from the user's cache folder, or compute and keep it.

    A file that is damaged, or that cannot be written, costs the time to compute and nothing else.
    """
    if all(isinstance(spectrum, RgbSpectrum) for spectrum in spectra):
        return camera_rgb(spectra, sensitivity, white_balance_cct_k)
    key = _key(spectra, sensitivity, white_balance_cct_k)
    path = cache_folder() / f"{key}.led"
    found = _read(path, len(spectra))
    if found is None:
        with key_lock(cache_folder(), key):
            found = _read(path, len(spectra))
            if found is None:
                found = camera_rgb(spectra, sensitivity, white_balance_cct_k)
                with contextlib.suppress(RuntimeError):
                    write_whole(path, json.dumps(found).encode())
    return found


def clear_led_cache() -> None:
    """Delete what `cached_camera_rgb` has kept."""
    for path in cache_folder().glob("*.led"):
        path.unlink(missing_ok=True)


def _read(path: Path, count: int) -> tuple[Rgb, ...] | None:
    """Return so many colours of a file; None if it is missing or damaged."""
    with contextlib.suppress(OSError, ValueError, TypeError):
        rows = json.loads(path.read_text(encoding="utf-8"))
        found = tuple((float(red), float(green), float(blue)) for red, green, blue in rows)
        if len(found) == count:
            return found
    return None


def _key(spectra: tuple[Spectrum, ...], sensitivity: str, white_balance_cct_k: float | None) -> str:
    try:
        colour_version = version("colour-science")
    except PackageNotFoundError:
        colour_version = ""
    content = [[type(spectrum).__name__, spectrum.model_dump()] for spectrum in spectra]
    text = json.dumps([content, sensitivity, white_balance_cct_k, colour_version, _MODEL])
    return hashlib.sha256(text.encode()).hexdigest()


# Raise it when `camera_rgb` computes something else.
_MODEL = 1
