"""The scene in three dimensions: membrane, indenter, and the LEDs, of which the chosen one can be dragged."""

import contextlib
import threading
from collections.abc import Callable
from itertools import count

import numpy as np
import trimesh
import viser
from viser import transforms

from gelgap.render import Illumination, Led
from gelgap.sim.shapes import AnyIndenter
from gelgap.view.meshes import Colouring, coloured_mesh, glb, indenter_centre_mm, indenter_mesh, membrane_mesh
from gelgap.view.pictures import swatch
from gelgap.view.state import Shown

# The page shows every second point of the rest grid: a mesh that a browser takes in at once.
_EVERY = 2
_LED_THICKNESS_MM = 0.4
_POINT_LED_RADIUS_MM = 0.5
_GIZMO_MM = 3.0
# A new membrane needs this long to appear; the one before stays until then.
_OVERLAP_S = 0.15
_INDENTER_COLOUR = (150, 165, 185)
_NEAREST_LED_MM = -0.3
_FLOOR_MM = 6.0


class Scene3d:
    """What stands in the middle of the page; `moved_led` hears of an LED's number and new place while it is dragged."""

    def __init__(self, server: viser.ViserServer, moved_led: Callable[[int, tuple], None]) -> None:
        self._scene = server.scene
        self._moved_led = moved_led
        self._numbers = count()
        self._membrane: viser.GlbHandle | None = None
        self._indenter: viser.MeshHandle | None = None
        self._body: AnyIndenter | None = None
        self._leds: list[viser.TransformControlsHandle] = []
        self._illumination: Illumination | None = None
        self._chosen = 0
        self._held: int | None = None
        server.scene.set_up_direction("+z")
        server.scene.configure_default_lights(cast_shadow=False)
        server.initial_camera.position = (0.0, -40.0, 37.0)
        server.initial_camera.look_at = (0.0, -1.0, -1.0)
        server.initial_camera.fov = float(np.radians(31))
        self._scene.add_grid(
            "/floor",
            60.0,
            60.0,
            cell_size=2.0,
            cell_color=(232, 232, 232),
            section_size=10.0,
            section_color=(205, 205, 205),
            shadow_opacity=0.0,
            position=(0.0, 0.0, -_FLOOR_MM),
        )

    def show(self, shown: Shown, colouring: Colouring, chosen_led: int) -> str:
        """Show membrane, indenter, and the LEDs, the chosen one with handles; return what the colours mean."""
        pose, indenter = shown.configuration.pose, shown.configuration.indenter
        membrane, meaning = _coloured(shown, colouring)
        self._swap_membrane(glb(membrane))
        centre = indenter_centre_mm(shown.solved, (pose.point_x_mm, pose.point_y_mm), indenter)
        if self._indenter is None or indenter != self._body:
            mesh, self._body = indenter_mesh(indenter), indenter
            self._indenter = self._scene.add_mesh_simple(
                "/indenter", mesh.vertices, mesh.faces, color=_INDENTER_COLOUR, opacity=0.3, side="double"
            )
        self._indenter.position = tuple(centre)
        self._show_leds(shown.configuration.illumination, chosen_led)
        return meaning

    def _show_leds(self, illumination: Illumination, chosen: int) -> None:
        if illumination == self._illumination and chosen == self._chosen:
            return
        before = self._illumination
        if before is None or [_form(led) for led in before.leds] != [_form(led) for led in illumination.leds]:
            self._build_leds(illumination)
        for number, (led, control) in enumerate(zip(illumination.leds, self._leds, strict=True)):
            # An LED that is being dragged is ahead of what is shown.
            if number != self._held:
                control.position = led.position_mm
            control.scale = _GIZMO_MM if number == chosen else 0.01
        self._illumination, self._chosen = illumination, chosen

    def _build_leds(self, illumination: Illumination) -> None:
        for control in self._leds:
            control.remove()
        self._leds = []
        for number, led in enumerate(illumination.leds):
            control = self._scene.add_transform_controls(
                f"/led{number}",
                _GIZMO_MM,
                disable_rotations=True,
                disable_sliders=True,
                depth_test=False,
                translation_limits=((-50.0, 50.0), (-50.0, 50.0), (-50.0, _NEAREST_LED_MM)),
                position=led.position_mm,
            )
            self._add_face(f"/led{number}/face", led)
            control.on_update(self._dragged(number))
            self._leds.append(control)

    def _add_face(self, name: str, led: Led) -> None:
        """Show an LED as a bar, a disc or a small ball, in its colour."""
        level, across = led.half_axes_mm()
        colour = swatch(led)
        if led.kind == "point":
            self._scene.add_icosphere(name, _POINT_LED_RADIUS_MM, colour)
            return
        axes = [half / np.linalg.norm(half) for half in (level, across)]
        turn = transforms.SO3.from_matrix(np.stack([*axes, np.cross(*axes)], axis=1)).wxyz
        if led.kind == "disc":
            self._scene.add_cylinder(name, led.diameter_mm / 2, _LED_THICKNESS_MM, colour, wxyz=turn)
        else:
            size = (led.length_mm, led.height_mm, _LED_THICKNESS_MM)
            self._scene.add_box(name, colour, size, wxyz=turn)

    def _dragged(self, number: int) -> Callable[[viser.TransformControlsEvent], None]:
        def moved(event: viser.TransformControlsEvent) -> None:
            self._held = None if event.phase == "end" else number
            self._moved_led(number, tuple(round(float(value), 2) for value in event.target.position))

        return moved

    def _swap_membrane(self, data: bytes) -> None:
        """Put a new membrane in the place of the old one, which stays until a browser has taken the new one in."""
        old = self._membrane
        self._membrane = self._scene.add_glb(f"/membrane{next(self._numbers)}", data)
        if old is not None:
            timer = threading.Timer(_OVERLAP_S, _remove, [old])
            timer.daemon = True
            timer.start()


def _remove(membrane: viser.GlbHandle) -> None:
    """Take a membrane away, unless the page is closed by now."""
    with contextlib.suppress(RuntimeError):
        membrane.remove()


def _form(led: Led) -> tuple:
    """Return what an LED's shape and colour on the page depend on."""
    return led.kind, led.length_mm, led.height_mm, led.diameter_mm, led.facing, led.spectrum, led.drive > 0


def _coloured(shown: Shown, colouring: Colouring) -> tuple[trimesh.Trimesh, str]:
    """Return the membrane, and what its colours mean; nothing where it wears the picture."""
    state = shown.solved
    if colouring == "picture":
        return membrane_mesh(state, shown.configuration.sensor.camera, shown.picture, _EVERY), ""
    if colouring == "displacement":
        values, unit = np.linalg.norm(state.displacement_mm, axis=-1), "mm"
    else:
        values, unit = shown.pressure_mpa, "MPa"
    most = float(values.max())
    meaning = f"{colouring}: 0 (violet) to {most:.3g} {unit} (yellow)"
    return coloured_mesh(state, values, most, _EVERY), meaning
