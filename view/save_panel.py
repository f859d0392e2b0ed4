"""The tab that saves what is shown: gel, light and sensor as TOML, the membrane as a mesh."""

from collections.abc import Callable
from typing import TYPE_CHECKING

import viser

from gelgap.view.live import Shown
from gelgap.view.meshes import MESH_SUFFIXES, indenter_centre_mm, indenter_mesh, membrane_mesh, mesh_bytes
from gelgap.view.saving import elastomer_toml, illumination_toml, sensor_files

if TYPE_CHECKING:
    from gelgap.view.page import Page

Files = dict[str, bytes]


class SavePanel:
    """Buttons each of which downloads files."""

    def __init__(self, gui: viser.GuiApi, page: "Page") -> None:
        self._page = page
        gui.add_markdown("The files that `--elastomer`, `--illumination` and `--sensor` take:")
        savers: dict[str, Callable[[Shown], Files]] = {
            "Elastomer": lambda shown: {"elastomer.toml": elastomer_toml(shown.configuration.elastomer)},
            "Illumination": lambda shown: {
                "illumination.toml": illumination_toml(shown.configuration.illumination)
            },
            "Sensor": lambda shown: sensor_files(shown.configuration.sensor),
        }
        self._add(gui, savers)
        gui.add_markdown("The membrane with its picture, and the indenter:")
        self._add(gui, {f"Mesh{suffix}": _mesh_saver(suffix) for suffix in MESH_SUFFIXES})

    def _add(self, gui: viser.GuiApi, savers: dict[str, Callable[[Shown], Files]]) -> None:
        for label, files_of in savers.items():
            gui.add_button(label).on_click(
                lambda event, files_of=files_of: self._page.do(lambda: self._send(event.client, files_of))
            )

    def _send(self, client: viser.ClientHandle | None, files_of: Callable[[Shown], Files]) -> None:
        if client is not None and self._page.shown is not None:
            for name, content in files_of(self._page.shown).items():
                client.send_file_download(name, content, save_immediately=True)


def _mesh_saver(suffix: str) -> Callable[[Shown], Files]:
    def files(shown: Shown) -> Files:
        configuration = shown.configuration
        pose, indenter = configuration.pose, configuration.indenter
        centre = indenter_centre_mm(shown.solved, (pose.point_x_mm, pose.point_y_mm), indenter)
        membrane = membrane_mesh(shown.solved.state, configuration.sensor.camera, shown.picture)
        return {f"membrane{suffix}": mesh_bytes(membrane, indenter_mesh(indenter, tuple(centre)), suffix)}

    return files
