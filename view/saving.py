"""What was found by turning knobs, as the files that the other commands take, and the buttons that download them."""

import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import tomli_w
import viser

from gelgap.assets import list_presets
from gelgap.render import Illumination, Sensor, save_sensor
from gelgap.sim import Elastomer
from gelgap.view.meshes import MESH_SUFFIXES, mesh_bytes
from gelgap.view.state import Configuration, Shown

Files = dict[str, bytes]
FilesOf = Callable[[Shown], Files]
Save = Callable[[viser.ClientHandle | None, FilesOf], None]


def add_savers(gui: viser.GuiApi, save: Save) -> None:
    """Add buttons; `save` sends what a button's function makes of what is shown to the browser that asked for it."""
    parts: dict[str, FilesOf] = {
        "Elastomer": lambda shown: {"elastomer.toml": settings_toml(shown.configuration.elastomer)},
        "Illumination": lambda shown: {"illumination.toml": settings_toml(shown.configuration.illumination)},
        "Sensor": lambda shown: sensor_files(shown.configuration.sensor),
    }
    meshes: dict[str, FilesOf] = {f"Mesh{suffix}": partial(_mesh_files, suffix) for suffix in MESH_SUFFIXES}
    for heading, savers in (
        ("The files that `--elastomer`, `--illumination` and `--sensor` take:", parts),
        ("The membrane with its picture, and the indenter:", meshes),
    ):
        gui.add_markdown(heading)
        for label, files_of in savers.items():
            gui.add_button(label).on_click(partial(_clicked, save, files_of))


def _clicked(save: Save, files_of: FilesOf, event: viser.GuiEvent) -> None:
    save(event.client, files_of)


def _mesh_files(suffix: str, shown: Shown) -> Files:
    seen = shown.configuration
    point_mm = seen.pose.point_x_mm, seen.pose.point_y_mm
    content = mesh_bytes(shown.solved, point_mm, seen.indenter, seen.sensor.camera, shown.picture, suffix)
    return {f"membrane{suffix}": content}


def settings_toml(settings: Elastomer | Illumination) -> bytes:
    """Return the file that `--elastomer` or `--illumination` takes."""
    return tomli_w.dumps(settings.model_dump(exclude_none=True)).encode()


def sensor_files(sensor: Sensor) -> dict[str, bytes]:
    """Return the file that `--sensor` takes, and its flat field, by their names."""
    with tempfile.TemporaryDirectory() as folder:
        save_sensor(sensor, Path(folder) / "sensor.toml")
        return {file.name: file.read_bytes() for file in sorted(Path(folder).iterdir())}


def recipe_toml(source: Configuration, target: Configuration) -> bytes:
    """Return the file of a source and a target that `gelgap generate` takes.

    Raises
    ------
    ValueError
        If a sensor is no preset and has a flat field, which is a file of its own, or the indenters differ.
    """
    if source.indenter != target.indenter:
        raise ValueError(
            f"source and target have two indenters, {source.indenter.label} and {target.indenter.label}, which a "
            "recipe cannot hold: press both with one"
        )
    domains = [_entry("source", source), _entry("target", target)]
    return tomli_w.dumps({"path": "cpu", "domains": domains}).encode()


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
