"""Domains to pretrain on: gels, spheres, lights and cameras drawn from stated ranges; many domains share a solve.

A press is a gel and a sphere, solved at some depths, each with a travel. Every domain takes one press, and has a
modulus, a light, a camera and contacts of its own, none of which asks for another solve.
"""

import math
import tomllib
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any, NamedTuple, Self

import numpy as np
from pydantic import AfterValidator, Field, PositiveFloat

from gelgap.assets import asset_path
from gelgap.assets.settings import Settings
from gelgap.assets.toml_file import named_in_errors, read_toml
from gelgap.data.random_stream import word
from gelgap.domains.recipe import DomainRecipe, Interval, RisingInterval, rises
from gelgap.render import Camera, Illumination, Markers, Sensor, Variation, vary_illumination, vary_sensor
from gelgap.sim import Elastomer, Pose, PosePath, Sphere
from gelgap.sim.problem import QualityName

PositiveInterval = Annotated[tuple[PositiveFloat, PositiveFloat], AfterValidator(rises)]
# Contacts are interior wherever they lie in view, so that all of a press share its solves.
_PAD_MM = (80.0, 80.0)
# Contact points lie within this share of the view.
SHARE_OF_VIEW = 0.7
# Deeper than this share of its radius a sphere is not pressed.
_DEEPEST_BY_RADIUS = 0.6
_MARKER_BY_PITCH = 0.35
_LOGARITHMIC = {
    "young_modulus_mpa",
    "friction",
    "sphere_diameter_mm",
    "full_well_electrons",
    "read_noise_electrons",
}


class PretrainingRanges(Settings):
    """What is drawn for pretraining, each value evenly from its range, those of gels and noise evenly in the logarithm.

    `presses` gels × spheres are solved at `depths` depths each, down to `deepest_by_thickness`, spaced so that forces
    are about evenly spread; at each depth the indenter also travels by `travel_by_depth`. LEDs and coat are drawn by
    `variation` around a sensor's own light, or for a sensor without one around an illumination; the LEDs' colours
    change places. Frames with a force outside `force_range_n` are not trained on.
    """

    description: str = ""
    presses: int = Field(ge=1, le=10_000)
    depths: int = Field(ge=1, le=20)
    young_modulus_mpa: PositiveInterval
    poisson_ratio: RisingInterval
    friction: PositiveInterval
    thickness_mm: PositiveInterval
    sphere_diameter_mm: PositiveInterval
    deepest_by_thickness: PositiveInterval
    travel_by_depth: RisingInterval
    sensors: tuple[str, ...] = Field(min_length=1)
    illuminations: tuple[str, ...] = Field(min_length=1)
    variation: Variation
    brightness: PositiveInterval = Field(description="factor on the exposure")
    view_mm: PositiveInterval = Field(description="width that the picture shows")
    point_spread_px: RisingInterval
    full_well_electrons: PositiveInterval
    read_noise_electrons: PositiveInterval
    with_markers: float = Field(ge=0, le=1, description="share of the domains whose gel has markers")
    marker_pitch_mm: PositiveInterval
    force_range_n: tuple[Interval, Interval, Interval] = Field(description="declared by every domain")

    @classmethod
    def default(cls) -> Self:
        """Return the ranges that come with gelgap, `assets/pretraining.toml`."""
        return cls(**tomllib.loads(asset_path("pretraining.toml").read_text(encoding="utf-8")))

    @classmethod
    def load(cls, path: Path | str) -> Self:
        """Read ranges from a TOML file; what it does not give is as in `default`.

        Raises
        ------
        FileNotFoundError
            If there is no such file.
        ValueError
            If it is not valid TOML, a field is unknown, or a value is out of range.
        """
        with named_in_errors(path):
            default = cls.default().model_dump()
            given = read_toml(path)
            if isinstance(variation := given.get("variation"), dict):
                given["variation"] = default["variation"] | variation
            return cls(**(default | given))


def pretraining_recipes(
    domains: int,
    frames_per_domain: int,
    ranges: PretrainingRanges | None = None,
    *,
    seed: int = 0,
    size_px: tuple[int, int] = (160, 120),
    quality: QualityName = "draft",
) -> tuple[DomainRecipe, ...]:
    """Return the recipes of domains drawn from ranges, named `pretraining-0000` and so on.

    The quality is that of physics and pictures.

    Raises
    ------
    ValueError
        If there are no domains, or a domain's frames are too few for a reference and every contact of its press.
    """
    ranges = ranges or PretrainingRanges.default()
    draws = Draws(ranges, seed)
    if domains < 1:
        raise ValueError(f"domains = {domains}: must be 1 or more")
    # Pressed straight and dragged.
    contacts = 2 * ranges.depths
    if frames_per_domain <= contacts:
        raise ValueError(
            f"frames_per_domain = {frames_per_domain}: must be {contacts + 1} or more, a reference and {contacts} "
            f"contacts at {ranges.depths} depths"
        )
    recipes = []
    for number in range(domains):
        name = f"pretraining-{number:04d}"
        press = draws.press(number % ranges.presses)
        sensor, illumination, markers = draws.seen_by(number)
        (modulus_mpa,) = draws.values("modulus", number, "young_modulus_mpa")
        poses = draws.poses(number, press, frames_per_domain, sensor.camera.footprint_mm(size_px))
        recipe = DomainRecipe(
            name=name,
            elastomer=Elastomer(young_modulus_mpa=round(modulus_mpa, 5), **press.gel),
            indenter=press.indenter,
            path=PosePath(name, poses),
            quality=quality,
            sensor=sensor,
            illumination=illumination,
            markers=markers,
            size_px=size_px,
            render_quality=quality,
            seed=seed,
            force_range_n=ranges.force_range_n,
        )
        recipes.append(recipe)
    return tuple(recipes)


class Press(NamedTuple):
    """A gel, whose modulus is open, a sphere, and how it is pressed: (depth, travel) in mm."""

    gel: dict[str, Any]
    indenter: Sphere
    contacts_mm: tuple[tuple[float, float], ...]


_sensor = lru_cache(Sensor.preset)


@dataclass(frozen=True)
class Draws:
    """What is drawn, by its number."""

    ranges: PretrainingRanges
    seed: int

    def stream(self, what: str, number: int) -> np.random.Generator:
        return np.random.default_rng(np.random.SeedSequence([self.seed, word(what), number]))

    def values(self, what: str, number: int, *fields: str) -> list[float]:
        """Return a value of each of these ranges."""
        shares = self.stream(what, number).random(len(fields)).tolist()
        return [self.at(field, share) for field, share in zip(fields, shares, strict=True)]

    def at(self, field: str, share: float) -> float:
        """Return the value at a share of a range, 0 to 1."""
        low, high = getattr(self.ranges, field)
        return low * (high / low) ** share if field in _LOGARITHMIC else low + share * (high - low)

    def press(self, number: int) -> Press:
        ratio, friction, thickness_mm = self.values(
            "gel of a press", number, "poisson_ratio", "friction", "thickness_mm"
        )
        (diameter_mm,) = self.values("sphere of a press", number, "sphere_diameter_mm")
        deepest, travel = self.stream("depths of a press", number).random(2).tolist()
        sphere = Sphere(diameter_mm=round(diameter_mm, 2))
        thickness_mm = round(thickness_mm, 2)
        gel = {
            "poisson_ratio": round(ratio, 4),
            "friction": round(friction, 3),
            "thickness_mm": thickness_mm,
            "pad_size_mm": _PAD_MM,
        }
        wanted_mm = thickness_mm * self.at("deepest_by_thickness", deepest)
        deepest_mm = min(wanted_mm, _DEEPEST_BY_RADIUS * sphere.radius_mm)
        # Force grows about as the square of the depth: then it is spread evenly.
        shares = np.sqrt(np.arange(1, self.ranges.depths + 1) / self.ranges.depths)
        parts = (0.0, self.at("travel_by_depth", travel))
        depths_mm = np.round(deepest_mm * shares, 3).tolist()
        return Press(
            gel, sphere, tuple((depth, round(part * depth, 3)) for depth in depths_mm for part in parts)
        )

    def seen_by(self, number: int) -> tuple[Sensor, Illumination, bool]:
        """Return a sensor with drawn camera and markers, its light, and whether it has markers."""
        sensor, illumination = self.light(number)
        markers = self.markers(number)
        parts = {"camera": self.camera(number, sensor.camera)} | ({"markers": markers} if markers else {})
        return sensor.model_copy(update=parts), illumination, markers is not None

    def light(self, number: int) -> tuple[Sensor, Illumination]:
        """Return a sensor without light of its own, and its light: varied, and its colours change places."""
        rng = self.stream("light", number)
        ranges = self.ranges
        sensor = _sensor(str(rng.choice(ranges.sensors)))
        other = str(rng.choice(ranges.illuminations))
        illumination = sensor.illumination or Illumination.preset(other)
        sensor = sensor.model_copy(update={"illumination": None})
        sensor = vary_sensor(sensor, ranges.variation, rng)
        illumination = vary_illumination(illumination, ranges.variation, rng)
        leds = illumination.leds
        exposure = sensor.camera.exposure * self.at("brightness", rng.random())
        camera = Camera(**(sensor.camera.model_dump() | {"exposure": exposure}))
        order = rng.permutation(len(leds))
        swapped = [
            led.model_copy(update={"spectrum": leds[k].spectrum, "drive": leds[k].drive})
            for led, k in zip(leds, order, strict=True)
        ]
        return (
            sensor.model_copy(update={"camera": camera}),
            illumination.model_copy(update={"leds": tuple(swapped)}),
        )

    def camera(self, number: int, camera: Camera) -> Camera:
        (view_mm,) = self.values("view", number, "view_mm")
        (blur_px,) = self.values("blur", number, "point_spread_px")
        well, read = self.values("noise", number, "full_well_electrons", "read_noise_electrons")
        half_angle = math.atan2(view_mm / 2, -camera.position_mm[2])
        drawn = {
            "horizontal_field_of_view_deg": round(2 * math.degrees(half_angle), 6),
            "point_spread_px": round(blur_px, 6),
            "full_well_electrons": round(well, 6),
            "read_noise_electrons": round(read, 6),
        }
        return Camera(**(camera.model_dump() | drawn))

    def markers(self, number: int) -> Markers | None:
        """Return markers over the whole view, or None."""
        has_markers, pitch = self.stream("markers", number).random(2).tolist()
        if has_markers >= self.ranges.with_markers:
            return None
        pitch_mm = round(self.at("marker_pitch_mm", pitch), 3)
        across = math.ceil(self.ranges.view_mm[1] / pitch_mm)
        diameter_mm = round(_MARKER_BY_PITCH * pitch_mm, 3)
        return Markers(columns=across, rows=across, pitch_mm=pitch_mm, diameter_mm=diameter_mm)

    def poses(self, number: int, press: Press, frames: int, view_mm: tuple[float, float]) -> tuple[Pose, ...]:
        """Return a reference and contacts at drawn places in drawn directions: each contact of the press, and again."""
        rng = self.stream("contacts", number)
        contacts = len(press.contacts_mm)
        rounds = -(-(frames - 1) // contacts)
        order = np.concatenate([rng.permutation(contacts) for _ in range(rounds)])[: frames - 1]
        poses = [Pose(depth_mm=0.0, contact_class=0)]
        for point, contact in enumerate(order.tolist(), start=1):
            depth_mm, travel_mm = press.contacts_mm[contact]
            x, y, angle = np.round(rng.uniform((-1, -1, 0), (1, 1, 2 * math.pi)), 4).tolist()
            pose = Pose(
                depth_mm=depth_mm,
                shear_x_mm=round(travel_mm * math.cos(angle), 12) + 0.0,
                shear_y_mm=round(travel_mm * math.sin(angle), 12) + 0.0,
                point_x_mm=round(x * SHARE_OF_VIEW * view_mm[0] / 2, 4),
                point_y_mm=round(y * SHARE_OF_VIEW * view_mm[1] / 2, 4),
                point_id=point,
            )
            poses.append(pose)
        return tuple(poses)
