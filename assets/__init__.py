"""Presets and files: what ships with gelgap, and the functions by which every room reads and writes."""

import tomllib
from importlib.resources import files
from pathlib import Path
from typing import Any

from gelgap.assets.names import left, unknown_name

PRESET_KINDS = (
    "elastomers",
    "indenters",
    "paths",
    "illuminations",
    "sensors",
    "markers",
    "datasets",
    "profiles",
)
_RENAMED = {("profiles", "board"): "benchmark"}


def asset_path(*parts: str) -> Path:
    """Return the path of a file or folder inside the installed `gelgap.assets`.

    >>> asset_path("elastomers", "b0.toml").name
    'b0.toml'
    """
    return Path(str(files(__name__))).joinpath(*parts)


def list_presets(kind: str) -> tuple[str, ...]:
    """Return the names of all presets of one kind (see `PRESET_KINDS`), sorted.

    Raises
    ------
    ValueError
        If there is no such kind.
    """
    if kind not in PRESET_KINDS:
        raise ValueError(unknown_name("preset kind", kind, PRESET_KINDS, "known kinds"))
    return tuple(sorted(path.stem for path in asset_path(kind).glob("*.toml")))


def load_preset(kind: str, name: str) -> dict[str, Any]:
    """Return the parsed TOML of one preset. What its fields mean is the business of the room that asked.

    Raises
    ------
    ValueError
        If there is no such kind or preset; the message lists the known ones.
    """
    known = list_presets(kind)
    if name not in known:
        if (kind, name) in _RENAMED:
            raise ValueError(left(f"{kind[:-1]} preset", name, f"it is called {_RENAMED[kind, name]}"))
        raise ValueError(unknown_name(f"{kind[:-1]} preset", name, known, "known presets"))
    return tomllib.loads(asset_path(kind, f"{name}.toml").read_text(encoding="utf-8"))
