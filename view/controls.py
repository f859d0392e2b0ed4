"""The knobs of the page, and the configuration that they stand for."""

import threading
from collections.abc import Callable, Iterator
from dataclasses import replace
from math import cos, radians, sin
from typing import Any

import viser

from gelgap.assets import list_presets
from gelgap.render import Illumination, Led, Sensor
from gelgap.sim import Elastomer, Pose
from gelgap.view.configuration import DEEPEST_MM, FARTHEST_MM, Configuration
from gelgap.view.led_colours import recoloured, swatch
from gelgap.view.meshes import COLOURINGS

OWN = "own"
"""What a dropdown says of a gel or light that is no preset; of a light also where it is the sensor's own."""
MODULI_MPA = (0.05, 3.0)
FRICTIONS = (0.0, 2.0)
# Where contacts lie that the paper's camera sees.
POINTS_MM = (5.0, 3.5)
# A value beyond a knob's range makes the range this many times as large as the value.
_ROOM = 2.0


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
        self._gui, self._on_change, self._on_problem = gui, on_change, on_problem
        self._lock = threading.RLock()
        self._filling_thread: int | None = None
        with gui.add_folder("Contact"):
            self._add_contact()
        with gui.add_folder("Gel"):
            self._add_gel()
        with gui.add_folder("Light"):
            self._add_light()
        with gui.add_folder("Camera"):
            self._add_camera()
        self._fill()

    def _add_contact(self) -> None:
        gui = self._gui
        self.depth = gui.add_slider("depth, mm", 0.0, DEEPEST_MM, 0.01, 0.6)
        self.travel = gui.add_slider("travel, mm", 0.0, FARTHEST_MM, 0.01, 0.0)
        self.direction = gui.add_slider("direction, °", 0, 359, 1, 0)
        self.point_x = gui.add_slider("point x, mm", -POINTS_MM[0], POINTS_MM[0], 0.05, 0.0)
        self.point_y = gui.add_slider("point y, mm", -POINTS_MM[1], POINTS_MM[1], 0.05, 0.0)
        self.solve = gui.add_button(
            "Solve this very pose", hint="Solves it by itself, at the quality chosen under Camera"
        )
        for knob in (self.depth, self.travel, self.direction, self.point_x, self.point_y):
            knob.on_update(self._changes(self._with_pose))

    def _add_gel(self) -> None:
        gui = self._gui
        self.elastomer = gui.add_dropdown("elastomer", (*list_presets("elastomers"), OWN))
        self.modulus = gui.add_slider("Young's modulus, MPa", *MODULI_MPA, 0.01, 0.4)
        self.friction = gui.add_slider("friction", *FRICTIONS, 0.01, 0.5)
        self.elastomer.on_update(self._changes(self._with_elastomer_preset))
        for knob in (self.modulus, self.friction):
            knob.on_update(self._changes(self._with_gel))

    def _add_light(self) -> None:
        gui = self._gui
        self.illumination = gui.add_dropdown("illumination", (*list_presets("illuminations"), OWN))
        self.led = gui.add_dropdown("LED", ("1",), hint="This one can be dragged in the scene")
        self.drive = gui.add_slider("drive", 0.0, 40.0, 0.1, 1.0)
        self.colour = gui.add_rgb("colour", (255, 255, 255))
        self.place = gui.add_vector3("place, mm", (0.0, 0.0, -3.0), step=0.1)
        self.illumination.on_update(self._changes(self._with_illumination_preset))
        self.led.on_update(self._changes(self._with_other_led))
        self.drive.on_update(self._changes(lambda: self._with_led({"drive": self.drive.value})))
        self.place.on_update(self._changes(lambda: self._with_led({"position_mm": self.place.value})))
        self.colour.on_update(self._changes(self._with_colour))

    def _add_camera(self) -> None:
        gui = self._gui
        self.sensor = gui.add_dropdown("sensor", (*list_presets("sensors"), OWN))
        self.markers = gui.add_checkbox("markers", True)
        self.noise = gui.add_checkbox("noise", False)
        self.quality = gui.add_dropdown("quality", ("draft", "standard", "fine"), initial_value="standard")
        self.colouring = gui.add_dropdown("membrane's colour", COLOURINGS)
        self.sensor.on_update(self._changes(self._with_sensor_preset))
        for knob in (self.markers, self.noise, self.quality):
            knob.on_update(self._changes(self._with_camera))
        self.colouring.on_update(self._changes(lambda: self.wanted))

    def set_configuration(self, configuration: Configuration) -> None:
        """Turn all knobs to a configuration."""
        with self._lock:
            self.wanted = configuration
            self.chosen_led = min(self.chosen_led, len(configuration.illumination.leds) - 1)
            self._fill()
        self._on_change(configuration)

    def move_led(self, number: int, position_mm: tuple[float, float, float]) -> None:
        """Move an LED, as by dragging it, and choose it."""
        self.chosen_led = number
        self._apply(lambda: self._with_led({"position_mm": position_mm}))

    def _changes(self, changed: Callable[[], Configuration]) -> Callable[[viser.GuiEvent], None]:
        """Return a callback that takes over what a knob changes."""

        def callback(event: viser.GuiEvent) -> None:
            # Knobs that this class turns itself call back in the same thread.
            if self._filling_thread != threading.get_ident():
                self._apply(changed, event.target)

        return callback

    def _apply(self, changed: Callable[[], Configuration], turned: Any = None) -> None:
        with self._lock:
            try:
                wanted = changed()
                wanted.path_keys()
            except ValueError as error:
                self._on_problem(str(error))
                return
            self.wanted = wanted
            self._fill(turned)
        self._on_problem("")
        self._on_change(wanted)

    def _with_pose(self) -> Configuration:
        angle = radians(self.direction.value)
        pose = Pose(
            depth_mm=self.depth.value,
            shear_x_mm=round(self.travel.value * cos(angle), 9),
            shear_y_mm=round(self.travel.value * sin(angle), 9),
            point_x_mm=self.point_x.value,
            point_y_mm=self.point_y.value,
        )
        return replace(self.wanted, pose=pose)

    def _with_gel(self) -> Configuration:
        own = {"young_modulus_mpa": self.modulus.value, "friction": self.friction.value}
        return replace(self.wanted, elastomer=Elastomer(**{**dict(self.wanted.elastomer), **own}))

    def _with_elastomer_preset(self) -> Configuration:
        name = self.elastomer.value
        return self.wanted if name == OWN else replace(self.wanted, elastomer=Elastomer.preset(name))

    def _with_illumination_preset(self) -> Configuration:
        name, own = self.illumination.value, self.wanted.sensor.illumination
        if name == OWN:
            return replace(self.wanted, illumination=own) if own is not None else self.wanted
        self.chosen_led = 0
        return replace(self.wanted, illumination=Illumination.preset(name))

    def _with_other_led(self) -> Configuration:
        self.chosen_led = self.led.options.index(self.led.value)
        return self.wanted

    def _with_led(self, values: dict[str, Any]) -> Configuration:
        leds = list(self.wanted.illumination.leds)
        leds[self.chosen_led] = Led(**{**dict(leds[self.chosen_led]), **values})
        light = self.wanted.illumination.model_copy(update={"leds": tuple(leds)})
        return replace(self.wanted, illumination=light)

    def _with_colour(self) -> Configuration:
        led = self.wanted.illumination.leds[self.chosen_led]
        return self._with_led(
            {"spectrum": recoloured(led, self.colour.value, self.wanted.sensor.camera).spectrum}
        )

    def _with_sensor_preset(self) -> Configuration:
        if self.sensor.value == OWN:
            return self.wanted
        sensor = Sensor.preset(self.sensor.value)
        light = sensor.illumination or self.wanted.illumination
        self.chosen_led = min(self.chosen_led, len(light.leds) - 1)
        return replace(self.wanted, sensor=sensor, illumination=light)

    def _with_camera(self) -> Configuration:
        return replace(
            self.wanted,
            markers=self.markers.value,
            noise=self.noise.value,
            quality=self.quality.value,
        )

    def _fill(self, turned: Any = None) -> None:
        """Set all knobs to what is wanted, except the one that the user may still be turning."""
        self._filling_thread = threading.get_ident()
        try:
            for knob, value in self._values():
                if knob is not turned:
                    knob.value = value
        finally:
            self._filling_thread = None

    def _values(self) -> Iterator[tuple[Any, Any]]:
        """Yield every knob with the value that is wanted; knobs whose range depends on it get their range."""
        wanted = self.wanted
        gel, light, pose = wanted.elastomer, wanted.illumination, wanted.pose
        self.chosen_led = min(self.chosen_led, len(light.leds) - 1)
        led = light.leds[self.chosen_led]
        names = tuple(
            f"{number}: {each.name or each.kind}" for number, each in enumerate(light.leds, start=1)
        )
        if self.led.options != names:
            self.led.options = names
        ranged = (
            (self.modulus, gel.young_modulus_mpa),
            (self.friction, gel.friction),
            (self.drive, led.drive),
        )
        for knob, value in ranged:
            if value > knob.max:
                knob.max = _ROOM * value
            knob.min = min(knob.min, value)
        yield from (
            (self.depth, pose.depth_mm),
            (self.travel, round(pose.radius_mm, 6)),
            (self.point_x, pose.point_x_mm),
            (self.point_y, pose.point_y_mm),
            (self.elastomer, _preset_of("elastomers", gel, Elastomer.preset)),
            (self.modulus, gel.young_modulus_mpa),
            (self.friction, gel.friction),
            (self.illumination, _preset_of("illuminations", light, Illumination.preset)),
            (self.led, names[self.chosen_led]),
            (self.drive, led.drive),
            (self.place, led.position_mm),
            (self.sensor, _preset_of("sensors", wanted.sensor, Sensor.preset)),
            (self.markers, wanted.markers),
            (self.noise, wanted.noise),
            (self.quality, wanted.quality),
        )
        if pose.radius_mm:
            yield self.direction, round(pose.angle_deg) % 360
        if led.drive > 0 and _differ(self.colour.value, swatch(led)):
            yield self.colour, swatch(led)


def _preset_of(kind: str, values: Any, preset: Callable[[str], Any]) -> str:
    """Return the name of the preset that has these values."""
    named = getattr(values, "name", "")
    names = [named] if named else list_presets(kind)
    known = list_presets(kind)
    return next((name for name in names if name in known and preset(name) == values), OWN)


def _differ(one: tuple[int, ...], other: tuple[int, ...]) -> bool:
    """Return whether two colours differ by more than rounding."""
    return max(abs(a - b) for a, b in zip(one, other, strict=True)) > 3
