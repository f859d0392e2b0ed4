"""What was found by turning knobs, as the TOML files that the other commands take."""

import tempfile
from pathlib import Path
from typing import Any

from gelgap.assets import list_presets
from gelgap.assets.toml_file import toml_text
from gelgap.render import Illumination, Sensor, save_sensor
from gelgap.sim import Elastomer
from gelgap.view.configuration import Configuration


def elastomer_toml(elastomer: Elastomer) -> bytes:
    """Return the file that `--elastomer` takes."""
    return toml_text(elastomer.model_dump(exclude_none=True)).encode()


def illumination_toml(illumination: Illumination) -> bytes:
    """Return the file that `--illumination` takes."""
    return toml_text(illumination.model_dump(exclude_none=True)).encode()


def sensor_files(sensor: Sensor, name: str = "sensor") -> dict[str, bytes]:
    """Return the file that `--sensor` takes, and its flat field, by their names."""
    with tempfile.TemporaryDirectory() as folder:
        save_sensor(sensor, Path(folder) / f"{name}.toml")
        return {file.name: file.read_bytes() for file in sorted(Path(folder).iterdir())}


def recipe_toml(source: Configuration, target: Configuration, path: str = "cpu") -> bytes:
    """Return the file of a source and a target that `gelgap generate --recipe` takes.

    Raises
    ------
    ValueError
        If a sensor is no preset and has a flat field, which is a file of its own.
    """
    domains = [_entry("source", source), _entry("target", target)]
    return toml_text({"path": path, "domains": domains}).encode()


def _entry(name: str, configuration: Configuration) -> dict[str, Any]:
    return {
        "name": name,
        "markers": configuration.markers,
        "sensor": _named_sensor(configuration.sensor),
        "elastomer": configuration.elastomer.model_dump(exclude_none=True),
        "illumination": configuration.illumination.model_dump(exclude_none=True),
    }


def _named_sensor(sensor: Sensor) -> str | dict[str, Any]:
    """Return the name of a sensor's preset, or a table where it has none."""
    if sensor.name in list_presets("sensors") and Sensor.preset(sensor.name) == sensor:
        return sensor.name
    if sensor.flat_field is not None:
        raise ValueError(
            f"sensor {sensor.name!r} has a flat field, which a recipe cannot hold: choose a sensor preset"
        )
    return sensor.model_dump(exclude_none=True)
