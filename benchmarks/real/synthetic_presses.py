"""Synthetic presses for the ball sensor: contact points all over its view, in lights that are drawn or in its own."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from gelgap.benchmarks.real.ball_sensor import DOTS, FAR_MM, VIEW_MM
from gelgap.domains import (
    DomainRecipe,
    LabelledFrames,
    Labels,
    PretrainingRanges,
    generate_recipes,
    join_domains,
    open_domain,
    pretraining_recipes,
    with_labels,
)
from gelgap.render import Camera, Illumination, Led, Sensor
from gelgap.sim import Pose, PosePath

LABELS = Labels.of({"x_mm": (-VIEW_MM[0] / 2, VIEW_MM[0] / 2), "y_mm": (-VIEW_MM[1] / 2, VIEW_MM[1] / 2)})
SIZE_PX = (120, 160)
DRAWN, CALIBRATED = "drawn", "calibrated"
_RANGES = {
    "description": "Balls of 4 to 8 mm pressed straight into gels with dots",
    "depths": 3,
    "thickness_mm": (3.0, 5.0),
    "sphere_diameter_mm": (3.9, 8.0),
    "deepest_by_thickness": (0.3, 0.5),
    "travel_by_depth": (0.0, 0.0),
    "view_mm": (VIEW_MM[0], VIEW_MM[0]),
    # A pixel of these small pictures is the mean of four of the sensor's.
    "full_well_electrons": (6e3, 8e4),
    "with_markers": 1.0,
}
# `pretraining_recipes` draws points within 0.7 of the view, and balls were pressed nearer to its edge.
_FARTHER_OUT = 0.95 / 0.7
_OF_A_CAMERA = ("point_spread_px", "full_well_electrons", "read_noise_electrons")


@dataclass(frozen=True)
class Amount:
    """How many domains of how many frames, from how many gels × balls that are solved."""

    domains: int
    frames: int
    presses: int


def synthetic_presses(folder: Path, amount: Amount, fitted: Sensor | None) -> LabelledFrames:
    """Return the frames, generated once, with the contact point as their label; in the light of `fitted` if given."""
    recipes = press_recipes(amount, fitted)
    generate_recipes(recipes, folder, scheduler="synchronous")
    return contact_points([folder / recipe.name for recipe in recipes])


def contact_points(folders: Sequence[Path]) -> LabelledFrames:
    """Return the frames of data sets, with the contact point as their label."""
    return with_labels(join_domains([open_domain(folder) for folder in folders]), LABELS)


def press_recipes(amount: Amount, fitted: Sensor | None) -> tuple[DomainRecipe, ...]:
    """Return the recipes; they differ in nothing but the light from those in another light."""
    default = PretrainingRanges.default().model_dump()
    ranges = PretrainingRanges(**{**default, **_RANGES, "presses": amount.presses})
    recipes = pretraining_recipes(amount.domains, amount.frames, ranges, size_px=SIZE_PX)
    return tuple(_on_the_ball_sensor(recipe, fitted) for recipe in recipes)


def _on_the_ball_sensor(recipe: DomainRecipe, fitted: Sensor | None) -> DomainRecipe:
    drawn = recipe.sensor
    if fitted is None:
        native_mm = Sensor.preset(drawn.name).camera.footprint_mm((4, 3))[0]
        light = _scaled(recipe.illumination, VIEW_MM[1] / native_mm)
        sensor = drawn.model_copy(update={"camera": drawn.camera.seen_from(FAR_MM, SIZE_PX)})
    else:
        own = {name: getattr(drawn.camera, name) for name in _OF_A_CAMERA}
        light = fitted.illumination
        camera = Camera(**{**fitted.camera.model_dump(), **own})
        sensor = fitted.model_copy(update={"camera": camera, "illumination": None})
    return recipe.model_copy(
        update={
            "sensor": sensor.model_copy(
                update={"markers": DOTS.model_copy(update={"seed": _number(recipe)})}
            ),
            "illumination": light,
            "path": PosePath(recipe.path.name, tuple(_farther_out(pose) for pose in recipe.path.poses)),
        }
    )


def _number(recipe: DomainRecipe) -> int:
    return int(recipe.name.rpartition("-")[2])


def _scaled(light: Illumination, factor: float) -> Illumination:
    """Return a light whose LEDs are as far out of a larger view as they were of their own sensor's."""
    return light.model_copy(update={"leds": tuple(_scaled_led(led, factor) for led in light.leds)})


def _scaled_led(led: Led, factor: float) -> Led:
    lengths = {name: getattr(led, name) for name in ("length_mm", "height_mm", "diameter_mm")}
    larger = {name: factor * value for name, value in lengths.items() if value is not None}
    x, y, z = led.position_mm
    return led.model_copy(update={**larger, "position_mm": (factor * x, factor * y, factor * z)})


def _farther_out(pose: Pose) -> Pose:
    if not pose.depth_mm:
        return pose
    x, y = (round(_FARTHER_OUT * value, 4) for value in (pose.point_x_mm, pose.point_y_mm))
    return replace(pose, point_x_mm=x, point_y_mm=y)
