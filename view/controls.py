"""The knobs of the page, and the configuration that they stand for."""

import tempfile
import threading
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from math import cos, radians, sin
from operator import attrgetter
from pathlib import Path
from typing import Any

import viser
from pydantic import BaseModel

from gelgap.assets import list_presets
from gelgap.assets.settings import PresetSettings
from gelgap.render import Illumination, Led, Sensor
from gelgap.sim import Elastomer, load_indenter
from gelgap.sim.shapes import AnyIndenter
from gelgap.view.meshes import COLOURINGS
from gelgap.view.pictures import recoloured, swatch
from gelgap.view.state import DEEPEST_MM, FARTHEST_MM, Configuration

OWN = "own"
"""What a dropdown says of a gel or light that is no preset; of a light also where it is the sensor's own."""
# A value beyond a knob's range makes the range this many times as large as the value.
_ROOM = 2.0
_TYPING_S = 1.0
_BODY_SUFFIXES = (".stl", ".obj", ".ply", ".glb", ".3mf", ".off", ".toml")


class Controls:
    """Builds the knobs; `wanted` is what they stand for, and `on_change` hears of each new configuration.

    A value that is out of range leaves the configuration as it was, and `on_problem` gets a sentence; an empty one says
    that all is well again.
    """

    def __init__(
        self,
        gui: viser.GuiApi,
        start: Configuration,
        on_change: Callable[[Configuration], None],
        on_problem: Callable[[str], None],
    ) -> None:
        self.wanted = start
        self.chosen_led = 0
        self._on_change, self._on_problem = on_change, on_problem
        self._lock = threading.RLock()
        self._filling_thread: int | None = None
        # Each knob with the value that it should have; None leaves it as it is.
        self._knobs: list[tuple[Any, Callable[[], Any]]] = []
        with gui.add_folder("Contact"):
            self._add_contact(gui)
        with gui.add_folder("Gel"):
            self._add_gel(gui)
        with gui.add_folder("Light"):
            self._add_light(gui)
        with gui.add_folder("Camera"):
            self._add_camera(gui)
        # These widen their range where a value lies beyond it.
        self._ranged = (self.modulus, self.friction, self.drive)
        self._fill()

    def _add_contact(self, gui: viser.GuiApi) -> None:
        self.indenter = self._body(gui)
        x_mm, y_mm = 5.0, 3.5  # contacts that the paper's camera sees
        self.depth = self._field("pose.depth_mm", gui.add_slider("depth, mm", 0.0, DEEPEST_MM, 0.01, 0.6))
        self.travel = gui.add_slider("travel, mm", 0.0, FARTHEST_MM, 0.01, 0.0)
        self.direction = gui.add_slider("direction, °", 0, 359, 1, 0)
        self._bind(self.travel, lambda: round(self.wanted.pose.radius_mm, 6), self._with_shear)
        self._bind(self.direction, self._direction, self._with_shear)
        self.point_x = self._field("pose.point_x_mm", gui.add_slider("point x, mm", -x_mm, x_mm, 0.05, 0.0))
        self.point_y = self._field("pose.point_y_mm", gui.add_slider("point y, mm", -y_mm, y_mm, 0.05, 0.0))
        self.solve = gui.add_button(
            "Solve this very pose", hint="Solves it by itself, at the quality chosen under Camera"
        )

    def _add_gel(self, gui: viser.GuiApi) -> None:
        self.elastomer = self._preset(gui, "elastomer", Elastomer, lambda gel: self._with(elastomer=gel))
        slider = gui.add_slider("Young's modulus, MPa", 0.05, 3.0, 0.01, 0.4)
        self.modulus = self._field("elastomer.young_modulus_mpa", slider)
        self.friction = self._field("elastomer.friction", gui.add_slider("friction", 0.0, 2.0, 0.01, 0.5))

    def _add_light(self, gui: viser.GuiApi) -> None:
        self.illumination = self._preset(gui, "illumination", Illumination, self._with_illumination)
        self.led = gui.add_dropdown("LED", ("1",), hint="This one can be dragged in the scene")
        self.drive = gui.add_slider("drive", 0.0, 40.0, 0.1, 1.0)
        self.colour = gui.add_rgb("colour", (255, 255, 255))
        self.place = gui.add_vector3("place, mm", (0.0, 0.0, -3.0), step=0.1)
        self._bind(self.led, self._led_name, self._with_other_led)
        self._bind(self.drive, lambda: self._led.drive, lambda: self._with_led(drive=self.drive.value))
        self._bind(self.colour, self._colour, self._with_colour)
        self._bind(
            self.place, lambda: self._led.position_mm, lambda: self._with_led(position_mm=self.place.value)
        )

    def _add_camera(self, gui: viser.GuiApi) -> None:
        self.sensor = self._preset(gui, "sensor", Sensor, self._with_sensor)
        self.markers = self._field("markers", gui.add_checkbox("markers", True))
        self.noise = self._field("noise", gui.add_checkbox("noise", False))
        qualities = gui.add_dropdown("quality", ("draft", "standard", "fine"), initial_value="standard")
        self.quality = self._field("quality", qualities)
        self.colouring = gui.add_dropdown("membrane's colour", COLOURINGS)
        self._bind(self.colouring, lambda: None, lambda: self.wanted)

    def set_configuration(self, configuration: Configuration) -> None:
        """Turn all knobs to a configuration."""
        with self._lock:
            self.wanted = configuration
            self._fill()
        self._on_change(configuration)

    def move_led(self, number: int, position_mm: tuple[float, float, float]) -> None:
        """Move an LED, as by dragging it, and choose it."""
        self.chosen_led = number
        self._apply(lambda: self._with_led(position_mm=position_mm))

    def _field(self, path: str, knob: Any) -> Any:
        """Bind a knob to a field of the configuration, such as `pose.depth_mm`."""
        self._bind(
            knob, lambda: attrgetter(path)(self.wanted), lambda: _replaced(self.wanted, path, knob.value)
        )
        return knob

    def _preset(
        self, gui: viser.GuiApi, field: str, kind: type[PresetSettings], taken: Callable[[Any], Configuration]
    ) -> Any:
        """Add a dropdown of the presets of a field; `taken` makes the configuration with the one that is chosen.

        It shows the preset that has the field's values. The own illumination is the sensor's, where it has one.
        """
        known = list_presets(f"{field}s")
        dropdown = gui.add_dropdown(field, (*known, OWN))

        def shown() -> str:
            values = getattr(self.wanted, field)
            names = [values.name] if getattr(values, "name", "") else known
            return next((name for name in names if name in known and kind.preset(name) == values), OWN)

        def changed() -> Configuration:
            if dropdown.value != OWN:
                return taken(kind.preset(dropdown.value))
            own = self.wanted.sensor.illumination if field == "illumination" else None
            return self.wanted if own is None else self._with(illumination=own)

        self._bind(dropdown, shown, changed)
        return dropdown

    def _body(self, gui: viser.GuiApi) -> Any:
        """Add a dropdown of the bodies, and a button that takes the file of one."""
        known = ("sphere", *list_presets("indenters"))
        dropdown = gui.add_dropdown("indenter", (*known, OWN))
        upload = gui.add_upload_button(
            "Body from a file …",
            mime_type=",".join(_BODY_SUFFIXES),
            hint="A mesh, or a TOML file that names no other file; a height map is for `gelgap press`",
        )

        def shown() -> str:
            return next((name for name in known if _body_named(name) == self.wanted.indenter), OWN)

        def changed() -> Configuration:
            if dropdown.value == OWN:
                return self.wanted
            return self._with(indenter=_body_named(dropdown.value))

        self._bind(dropdown, shown, changed)
        upload.on_upload(lambda _: self._apply(lambda: self._with(indenter=_sent_body(upload.value))))
        return dropdown

    def _bind(self, knob: Any, value: Callable[[], Any], changed: Callable[[], Configuration]) -> None:
        """Keep a knob at a value, and take over what it changes."""

        def callback(event: viser.GuiEvent) -> None:
            # Knobs that this class turns itself call back in the same thread.
            if self._filling_thread == threading.get_ident():
                return
            if _lies_beyond(event.target):
                # A number may be half typed.
                threading.Timer(_TYPING_S, self._put_back, (event.target,)).start()
            else:
                self._apply(changed, event.target)

        self._knobs.append((knob, value))
        knob.on_update(callback)

    def _put_back(self, knob: Any) -> None:
        """Move a slider to the nearer end if the value that was typed for it still lies beyond its range."""
        if _lies_beyond(knob):
            typed, knob.value = knob.value, min(max(knob.value, knob.min), knob.max)
            self._on_problem(
                f"{knob.label} = {typed:g} lies outside {knob.min:g} to {knob.max:g}: {knob.value:g} is shown"
            )

    def _apply(self, changed: Callable[[], Configuration], turned: Any = None) -> None:
        with self._lock:
            try:
                wanted = changed()
                wanted.library_keys()
            except ValueError as error:
                self._on_problem(str(error))
                return
            self.wanted = wanted
            self._fill(turned)
        self._on_problem("")
        self._on_change(wanted)

    def _fill(self, turned: Any = None) -> None:
        """Set all knobs to what is wanted, except the one that the user may still be turning."""
        self.chosen_led = min(self.chosen_led, len(self.wanted.illumination.leds) - 1)
        self._filling_thread = threading.get_ident()
        try:
            for knob, value_of in self._knobs:
                value = value_of()
                if any(knob is ranged for ranged in self._ranged):
                    knob.max = _ROOM * value if value > knob.max else knob.max
                    knob.min = min(knob.min, value)
                if knob is not turned and value is not None:
                    knob.value = value
        finally:
            self._filling_thread = None

    @property
    def _led(self) -> Led:
        return self.wanted.illumination.leds[self.chosen_led]

    def _with_shear(self) -> Configuration:
        angle, pose = radians(self.direction.value), self.wanted.pose
        x_mm, y_mm = (round(self.travel.value * part, 15) for part in (cos(angle), sin(angle)))
        return self._with(pose=replace(pose, shear_x_mm=x_mm, shear_y_mm=y_mm))

    def _direction(self) -> int | None:
        pose = self.wanted.pose
        return round(pose.angle_deg) % 360 if pose.radius_mm else None

    def _with(self, **values: Any) -> Configuration:
        return replace(self.wanted, **values)

    def _with_illumination(self, illumination: Illumination) -> Configuration:
        self.chosen_led = 0
        return self._with(illumination=illumination)

    def _with_sensor(self, sensor: Sensor) -> Configuration:
        return self._with(sensor=sensor, illumination=sensor.illumination or self.wanted.illumination)

    def _led_name(self) -> str:
        leds = enumerate(self.wanted.illumination.leds, start=1)
        names = tuple(f"{number}: {led.name or led.kind}" for number, led in leds)
        if self.led.options != names:
            self.led.options = names
        return names[self.chosen_led]

    def _with_other_led(self) -> Configuration:
        self.chosen_led = self.led.options.index(self.led.value)
        return self.wanted

    def _with_led(self, **values: Any) -> Configuration:
        leds = list(self.wanted.illumination.leds)
        leds[self.chosen_led] = Led(**(dict(self._led) | values))
        light = self.wanted.illumination.model_copy(update={"leds": tuple(leds)})
        return self._with(illumination=light)

    def _colour(self) -> tuple[int, int, int] | None:
        """Return the chosen LED's colour, unless it is switched off or differs by no more than rounding."""
        colour = swatch(self._led)
        differs = max(abs(a - b) for a, b in zip(self.colour.value, colour, strict=True)) > 3
        return colour if self._led.drive > 0 and differs else None

    def _with_colour(self) -> Configuration:
        picked = recoloured(self._led, self.colour.value, self.wanted.sensor.camera)
        return self._with_led(spectrum=picked.spectrum)


@cache
def _body_named(name: str) -> AnyIndenter:
    return load_indenter(name)


def _sent_body(file: viser.UploadedFile) -> AnyIndenter:
    """Return the body of a file that the browser sent; another file that it names is not there."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / Path(file.name).name
        path.write_bytes(file.content)
        try:
            return load_indenter(str(path))
        except (ValueError, FileNotFoundError) as error:
            raise ValueError(str(error).replace(f"{folder}/", "")) from None


def _lies_beyond(knob: Any) -> bool:
    """Return whether a knob has a range and its value is none of it."""
    return getattr(knob, "min", None) is not None and not knob.min <= knob.value <= knob.max


def _replaced(thing: Any, path: str, value: Any) -> Any:
    """Return a copy of nested settings and dataclasses with another value at a path such as `pose.depth_mm`."""
    first, _, rest = path.partition(".")
    inner = _replaced(getattr(thing, first), rest, value) if rest else value
    if isinstance(thing, BaseModel):
        return type(thing)(**(dict(thing) | {first: inner}))
    return replace(thing, **{first: inner})
