"""What spectra look like to a camera, kept on disk by content, so that only its first use imports colour-science."""

import contextlib
import hashlib
import json
import os
import tempfile
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

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
    path = _folder() / f"{_key(spectra, sensitivity, white_balance_cct_k)}.led"
    with contextlib.suppress(OSError, ValueError, TypeError):
        rows = json.loads(path.read_text(encoding="utf-8"))
        found = tuple((float(red), float(green), float(blue)) for red, green, blue in rows)
        if len(found) == len(spectra):
            return found
    found = camera_rgb(spectra, sensitivity, white_balance_cct_k)
    with contextlib.suppress(OSError):
        _write_whole(path, json.dumps(found))
    return found


def clear_led_cache() -> None:
    """Delete what `cached_camera_rgb` has kept."""
    for path in _folder().glob("*.led"):
        path.unlink(missing_ok=True)


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


def _folder() -> Path:
    """Return $GELGAP_CACHE, or `gelgap` in the user's cache folder: where solved physics is kept, too."""
    chosen = os.environ.get("GELGAP_CACHE")
    if chosen:
        return Path(chosen)
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "gelgap"


def _write_whole(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    descriptor, temporary = tempfile.mkstemp(dir=path.parent, suffix=".tmp")
    try:
        with os.fdopen(descriptor, "w", encoding="utf-8") as file:
            file.write(text)
        os.replace(temporary, path)
    except BaseException:
        Path(temporary).unlink(missing_ok=True)
        raise
