"""The full configuration of one domain, everything on which its bytes depend: made by name, of one's own, from a file.

Acquisition errors, off by default, are those of a misplaced rig and an inaccurate force sensor.
"""

import itertools
import logging
import math
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import (
    AfterValidator,
    BeforeValidator,
    Field,
    NonNegativeFloat,
    PositiveFloat,
    TypeAdapter,
    model_validator,
)

from gelgap.assets import load_preset
from gelgap.assets.checksums import canonical_json, sha256
from gelgap.assets.names import comma_list, stays_inside
from gelgap.assets.pinhole import Pinhole
from gelgap.assets.settings import Settings
from gelgap.assets.toml_file import named_in_errors, read_toml
from gelgap.data.facts import DomainFacts
from gelgap.data.formats.domain_folder import DomainName
from gelgap.data.formats.optional_columns import OptionalColumn
from gelgap.data.frames.labels import PAPER_FORCE_RANGE_N
from gelgap.data.random_stream import random_stream
from gelgap.domains.domain import OWN_LIGHT, Domain, known_domains
from gelgap.render import Illumination, Markers, Sensor
from gelgap.render.surface import view_half_extent_mm
from gelgap.sim import ContactPath, Elastomer, ForcePath, Pose, PosePath, Sphere, load_indenter, load_path
from gelgap.sim.indenter import Symmetry
from gelgap.sim.path import DrawnPath
from gelgap.sim.plan import DEPTHS_PER_DESCENT
from gelgap.sim.press import path_on_gel
from gelgap.sim.problem import QualityName
from gelgap.sim.shapes import AnyIndenter

LOG = logging.getLogger(__name__)
Interval = tuple[float, float]


def rises(interval: Interval) -> Interval:
    """Return an interval; a ValueError if its ends are in the wrong order."""
    if interval[1] < interval[0]:
        raise ValueError("must be a lowest and a highest value, in this order")
    return interval


RisingInterval = Annotated[Interval, AfterValidator(rises)]
Side = Annotated[int, Field(ge=16, le=4096)]

INPAINTED_IN_THE_PAPER = ("wmb0i0",)
"""The domains that the paper made by inpainting the markers of the domain with markers."""
# Poses that agree share a solve; a micrometre is far below what a rig can tell.
_RESOLUTION_MM = 1e-3


class AcquisitionError(Settings):
    """Standard deviations of a rig's errors, each drawn once per domain (force noise: once per frame)."""

    point_offset_mm: float = Field(default=0.0, ge=0, le=1, description="of all points, along x and y")
    depth_zero_mm: float = Field(default=0.0, ge=0, le=0.5, description="where contact begins")
    tilt_deg: float = Field(default=0.0, ge=0, le=3, description="of the pad about x and y")
    force_noise_n: float = Field(default=0.0, ge=0, le=1, description="of the force sensor, along each axis")
    force_bias_n: float = Field(default=0.0, ge=0, le=1, description="of the force sensor, along each axis")


@dataclass(frozen=True)
class DrawnErrors:
    """The errors of one domain as drawn: which a real rig would not know."""

    point_offset_mm: tuple[float, float]
    depth_zero_mm: float
    tilt_deg: tuple[float, float]
    force_bias_n: tuple[float, float, float]

    def actual(self, pose: Pose) -> Pose:
        """Return the contact that happens when this pose is commanded."""
        if pose.depth_mm == 0:
            return pose
        slope_x, slope_y = (math.tan(math.radians(angle)) for angle in self.tilt_deg)
        depth = pose.depth_mm + self.depth_zero_mm + slope_x * pose.point_x_mm + slope_y * pose.point_y_mm
        return replace(
            pose,
            depth_mm=max(0.0, _rounded(depth)),
            point_x_mm=_rounded(pose.point_x_mm + self.point_offset_mm[0]),
            point_y_mm=_rounded(pose.point_y_mm + self.point_offset_mm[1]),
        )


def _moved_levels(levels_mm: Sequence[float], rng: np.random.Generator) -> dict[float, float]:
    """Return each level of depth or travel moved by up to a quarter of their spacing, by the level."""
    room = _spacing(levels_mm) / 4
    return {level: max(_RESOLUTION_MM, _rounded(level + rng.uniform(-room, room))) for level in levels_mm}


def independent_poses(path: ContactPath, seed: int, domain: str) -> tuple[Pose, ...]:
    """Return the path's poses moved within their cells, so that no contact has an exact partner in another domain.

    Uniformly, a point moves by up to a quarter of the spacing of points, a direction by up to half the spacing of
    angles, and each level of depth and travel by up to a quarter of its spacing. A level moves as a whole: real runs
    repeat their levels too, and poses at one level share their solves.
    """
    rng = random_stream(seed, domain, "contacts")
    depths, radii = _moved_levels(path.depths_mm, rng), _moved_levels(path.radii_mm, rng)
    half_angle = 180.0 / max(len(path.angles_deg), 1)
    point_room = [_spacing(values) / 4 for values in (path.points_x_mm, path.points_y_mm)]
    points: dict[int, tuple[float, float]] = {}
    moved = []
    for pose in path.poses:
        if pose.point_id not in points:
            dx, dy = (_rounded(rng.uniform(-room, room)) for room in point_room)
            points[pose.point_id] = (pose.point_x_mm + dx, pose.point_y_mm + dy)
        angle = math.radians(pose.angle_deg + rng.uniform(-half_angle, half_angle))
        radius = radii.get(pose.radius_mm, pose.radius_mm)
        moved.append(
            replace(
                pose,
                depth_mm=depths.get(pose.depth_mm, pose.depth_mm),
                shear_x_mm=radius * math.cos(angle),
                shear_y_mm=radius * math.sin(angle),
                point_x_mm=points[pose.point_id][0],
                point_y_mm=points[pose.point_id][1],
            )
        )
    return tuple(moved)


def _spacing(values: Sequence[float]) -> float:
    ordered = sorted(set(values))
    return min((b - a for a, b in itertools.pairwise(ordered)), default=0.0)


def _rounded(value_mm: float) -> float:
    return round(round(value_mm / _RESOLUTION_MM) * _RESOLUTION_MM, 9)


# A manifest has tables for them, of which a strict model makes no dataclasses by itself.
_Path = Annotated[
    DrawnPath | ContactPath | PosePath,
    BeforeValidator(TypeAdapter(DrawnPath | ContactPath | PosePath).validate_python),
]
_Indenter = Annotated[AnyIndenter, BeforeValidator(TypeAdapter(AnyIndenter).validate_python)]


class DomainRecipe(Settings):
    """One domain, completely: the same recipe and package versions give the same bytes."""

    name: DomainName = Field(description="the domain's name, and its folder's")
    elastomer: Elastomer
    indenter: _Indenter = Sphere()
    further_indenters: tuple[_Indenter, ...] = Field(
        default=(), description="indenters that go the whole path one after another, after the first"
    )
    path: _Path
    quality: QualityName = Field(default="standard", description="quality of the physics")
    sensor: Sensor
    illumination: Illumination
    markers: bool = Field(description="whether the markers are seen")
    inpainted_from: str | None = Field(
        default=None,
        description="the domain with markers whose pictures these are, its markers inpainted; none: rendered",
    )
    size_px: tuple[Side, Side] = Field(default=(320, 240), description="width and height of the pictures")
    render_quality: Literal["draft", "standard", "fine"] = "standard"
    columns: tuple[OptionalColumn, ...] = Field(default=(), description="optional columns")
    seed: int = Field(default=0, ge=0, description="seed of sensor noise, splits and acquisition errors")
    contacts: Literal["paired", "independent"] = Field(
        default="paired", description="the same poses in every domain, or poses of its own"
    )
    acquisition: AcquisitionError = AcquisitionError()
    interpolated: bool = Field(
        default=False,
        description="poses from a library of few solves, where it reaches, not each from its own",
    )
    library_reach_mm: tuple[PositiveFloat, PositiveFloat, NonNegativeFloat] | None = Field(
        default=None,
        description="shallowest and deepest press and farthest drag of the library at least; none: those of the path",
    )
    force_range_n: tuple[Interval, Interval, Interval] = Field(
        default=PAPER_FORCE_RANGE_N,
        description="declared range of Fx, Fy, Fz in N, by which labels are normalised",
    )

    @model_validator(mode="after")
    def _check(self) -> "DomainRecipe":
        if self.interpolated and not self._has_what_a_library_serves:
            raise ValueError(
                "interpolated = true: a library of poses serves one indenter whose directions are alike, and has no "
                "tractions; solve each pose"
            )
        self.sensor.markers.check_on_pad(self.elastomer.pad_size_mm)
        self.sensor.camera.farthest_slope(self.size_px)  # or a ValueError
        return self

    @property
    def _has_what_a_library_serves(self) -> bool:
        """One indenter whose directions are alike; and membranes, forces and torques, but no tractions."""
        is_round = self.indenter.symmetry is Symmetry.REVOLUTION
        return is_round and not self.further_indenters and "traction" not in self.columns

    def configuration(self) -> dict[str, Any]:
        """Return the recipe as plain JSON values; what only some domains have, only for these."""
        optional = ("further_indenters", "interpolated", "library_reach_mm")
        absent = {name: True for name in optional if not getattr(self, name)}
        # What a sensor's fit keeps for predicting marked presses is nothing that a domain depends on.
        unused = {"marks_off", "ball_residual"} | (set() if self.sensor.table_share > 0 else {"normal_table"})
        return self.model_dump(mode="json", exclude=absent | {"sensor": unused})

    @property
    def key(self) -> str:
        """A hash of everything in the recipe."""
        return sha256(canonical_json(self.configuration()))

    @property
    def picture_name(self) -> str:
        """The domain whose light falls on these frames: its name keys the sensor noise."""
        return self.inpainted_from or self.name

    @property
    def indenters(self) -> tuple[AnyIndenter, ...]:
        """All indenters: each goes the whole path, and has as many frames."""
        return self.indenter, *self.further_indenters

    @property
    def frames(self) -> int:
        """The number of frames."""
        return len(self.path.poses) * len(self.indenters)

    def commanded_poses(self) -> tuple[Pose, ...]:
        """Return the poses of each indenter as a rig would record them."""
        if self.contacts == "paired":
            return self.path.poses
        if isinstance(self.path, PosePath):
            raise ValueError(f"contacts = 'independent': needs poses on a grid; {self.path.name} lists them")
        return independent_poses(self.path, self.seed, self.picture_name)

    def drawn_errors(self) -> DrawnErrors:
        """Draw the domain's errors: the same seed and domain always give the same."""
        error = self.acquisition
        unit = random_stream(self.seed, self.picture_name, "acquisition").standard_normal(8).tolist()
        return DrawnErrors(
            point_offset_mm=(error.point_offset_mm * unit[0], error.point_offset_mm * unit[1]),
            depth_zero_mm=error.depth_zero_mm * unit[2],
            tilt_deg=(error.tilt_deg * unit[3], error.tilt_deg * unit[4]),
            force_bias_n=tuple(error.force_bias_n * value for value in unit[5:]),
        )

    def solved_path(self) -> ContactPath | PosePath:
        """Return the contacts of each indenter that really happen."""
        errors = self.drawn_errors()
        poses = self.commanded_poses()
        if any((*errors.point_offset_mm, errors.depth_zero_mm, *errors.tilt_deg)):
            poses = tuple(errors.actual(pose) for pose in poses)
        return self.path if poses is self.path.poses else PosePath(self.path.name, poses)

    def suits_a_library(self) -> bool:
        """Return whether a library of poses serves the path, and takes fewer solves than its depths do."""
        from gelgap.sim.library import MOST_SOLVES

        if not self._has_what_a_library_serves:
            return False
        depths = {pose.depth_mm for pose in self.path.poses if pose.depth_mm > 0 and pose.trajectory is None}
        return len(depths) > DEPTHS_PER_DESCENT * MOST_SOLVES


def shown_markers(sensor: Sensor, wanted: bool) -> Markers | None:
    """Return the markers that pictures show where they are wanted; a flat field may have them where none are listed."""
    has_markers = sensor.markers.layout != "none" or sensor.flat_field is not None
    return sensor.markers if wanted and has_markers else None


def facts_of(recipe: DomainRecipe) -> DomainFacts:
    """Return what readers of the domain need to know of its gel, camera and gauge."""
    gel = recipe.elastomer
    camera = recipe.sensor.camera
    return DomainFacts(
        young_modulus_mpa=gel.young_modulus_mpa,
        poisson_ratio=gel.poisson_ratio,
        thickness_mm=gel.thickness_mm,
        friction=gel.friction,
        static_friction=gel.static_friction,
        mount_stiffness_n_per_mm=gel.mount_stiffness_n_per_mm,
        shows_markers=shown_markers(recipe.sensor, recipe.markers) is not None,
        force_bias_n=recipe.drawn_errors().force_bias_n if recipe.acquisition.force_bias_n else None,
        camera=Pinhole(**{name: getattr(camera, name) for name in Pinhole.model_fields}),
        traction_half_extent_mm=view_half_extent_mm(camera, recipe.size_px),
    )


def differences(one: Any, other: Any, field: str = "") -> Iterator[tuple[str, Any, Any]]:
    """Yield each field in which two configurations differ: its dotted name and both values, None where it is absent."""
    if isinstance(one, list) and isinstance(other, list) and len(one) == len(other):
        one, other = dict(enumerate(one)), dict(enumerate(other))
    if isinstance(one, dict) and isinstance(other, dict):
        for key in one | other:
            yield from differences(one.get(key), other.get(key), f"{field}.{key}" if field else str(key))
    elif one != other:
        yield field, one, other


def make_recipes(
    domains: Iterable[str | Domain],
    path: str | ContactPath | PosePath | ForcePath = "cpu",
    *,
    inpainted: Sequence[str] = INPAINTED_IN_THE_PAPER,
    sensor: str | Sensor = "paper",
    columns: Iterable[OptionalColumn] = (),
    exact: bool = False,
    **settings: Any,
) -> tuple[DomainRecipe, ...]:
    """Return the recipes of domains by their names, on one contact path.

    Parameters
    ----------
    domains
        Names like `mb0i0`; `mb0own` is lit by the sensor's own LEDs.
    path
        A path preset's name, a TOML file's, or a path.
    inpainted
        Domains without markers that are made, as in the paper, by inpainting the domain with markers; pass `()` to
        have every domain rendered.
    sensor
        A sensor, or the name of a preset or TOML file.
    columns
        Optional columns.
    exact
        Solve each pose; by default a path of more depths than a library takes, as a random one, is interpolated
        (`gelgap.sim.PoseLibrary`).
    settings
        Fields of `DomainRecipe`: seed, quality, size_px, contacts, acquisition, …; also in place of what names say.

    Raises
    ------
    ValueError
        For an unknown name (the message lists the known ones), a domain named twice, or a bad value.
    """
    parsed = [Domain.parse(str(domain)) for domain in domains]
    if not parsed:
        raise ValueError("no domain was named; name at least one, for example mb0i0")
    check_named_once(domain.name for domain in parsed)
    path = load_path(path) if isinstance(path, str) else path
    sensor = Sensor.named(sensor)
    others = [domain for domain in parsed if domain.illumination != OWN_LIGHT]
    if sensor.illumination is not None and "illumination" not in settings and others:
        LOG.warning(
            "%s: lit by the illumination preset in the name, not by the LEDs of sensor %s itself: those light %s",
            comma_list([domain.name for domain in others]),
            sensor.name,
            replace(others[0], illumination=OWN_LIGHT),
        )
    recipes = []
    for domain in parsed:
        fields: dict[str, Any] = {
            "name": domain.name,
            "markers": domain.markers,
            "inpainted_from": domain.name.removeprefix("w") if domain.name in inpainted else None,
            "columns": tuple(sorted(columns)),
            **settings,
        }
        fields.setdefault("elastomer", Elastomer.preset(domain.elastomer))
        if "illumination" not in fields:
            fields["illumination"] = _illumination(domain, sensor)
        contacts = path
        if isinstance(path, ForcePath):
            # Depths that give a force are each gel's and indenter's own.
            LOG.info("solving the descent that gives the depths of the path's forces")
            pressed = fields["elastomer"], fields.get("indenter", Sphere()), fields.get("quality", "standard")
            contacts = path_on_gel(path, *pressed)
        recipe = DomainRecipe(path=contacts, sensor=sensor, **fields)
        if not exact and "interpolated" not in fields:
            recipe = recipe.model_copy(update={"interpolated": recipe.suits_a_library()})
        recipes.append(recipe)
    return tuple(recipes)


def _illumination(domain: Domain, sensor: Sensor) -> Illumination:
    if domain.illumination != OWN_LIGHT:
        return Illumination.preset(domain.illumination)
    if sensor.illumination is None:
        raise ValueError(
            f"domain {domain.name}: sensor {sensor.name!r} has no LEDs of its own; give it an [illumination], choose "
            "another sensor, or name an illumination preset"
        )
    return sensor.illumination


def check_named_once(names: Iterable[str]) -> None:
    """Raise ValueError if two domains have one name."""
    if twice := [name for name, times in Counter(names).items() if times > 1]:
        raise ValueError(f"a domain is named twice: {twice[0]}; name each once")


def own_recipe(
    name: str,
    path: str | ContactPath | PosePath | ForcePath = "cpu",
    *,
    base: str | Domain = "mb0i0",
    elastomer: Elastomer | None = None,
    illumination: Illumination | None = None,
    **settings: Any,
) -> DomainRecipe:
    """Return the recipe of a domain with parts of one's own; what is not given is the base's, markers included.

    Settings are those of `make_recipes`. Without markers it is rendered, not inpainted.

    Raises
    ------
    ValueError
        If the name is not one for a folder or means a domain of presets, or for a bad value.
    """
    if any(domain.name == name and domain.illumination != OWN_LIGHT for domain in known_domains()):
        raise ValueError(f"name = {name!r}: means a domain of presets; choose another, as {name}-own")
    parts = {"name": name, "elastomer": elastomer, "illumination": illumination}
    settings |= {field: value for field, value in parts.items() if value is not None}
    (recipe,) = make_recipes([base], path, **settings | {"inpainted": ()})
    return recipe


def preset_recipes(name: str, **settings: Any) -> tuple[DomainRecipe, ...]:
    """Return the recipes of a whole data set: `smoke`, `cpu` or `paper`; settings as for `make_recipes`.

    Raises
    ------
    ValueError
        If there is no such data set, or it has indenters of its own and others are given.
    """
    given = settings.get("indenter", Sphere()), *settings.get("further_indenters", ())
    recipes: list[DomainRecipe] = []
    for group in load_preset("datasets", name)["groups"]:
        pressed: dict[str, Any] = {}
        if "indenters" in group:
            if given != (Sphere(),):
                raise ValueError(
                    f"indenter = {given[-1].label}: data set {name!r} has indenters of its own, "
                    f"{comma_list(group['indenters'])}; for others name its domains and its path: "
                    f"{' '.join(group['domains'])} --path {group['path']}"
                )
            first, *further = map(load_indenter, group["indenters"])
            columns = tuple(dict.fromkeys((*settings.get("columns", ()), "indenter")))
            pressed = {"indenter": first, "further_indenters": tuple(further), "columns": columns}
        recipes += make_recipes(group["domains"], group["path"], **settings | pressed)
    return tuple(recipes)


class RecipeEntry(Settings):
    """One domain of the file; a sensor is a preset's name or a table."""

    name: str
    elastomer: Elastomer
    illumination: Illumination
    sensor: str | Sensor = "paper"
    markers: bool = True


class RecipeFile(Settings):
    """The domains of a file and the contact path that they share."""

    path: str = Field("cpu", description="a path preset, or a TOML file below the working folder")
    domains: Annotated[tuple[RecipeEntry, ...], Field(min_length=1)]


def read_with_path(file: Path | str) -> dict[str, Any]:
    """Return the tables of a TOML file that names a contact path, which may not lead out of the working folder."""
    values = read_toml(file)
    if isinstance(path := values.get("path"), str) and not stays_inside(path):
        raise ValueError(f"path = {path!r} must be a preset or a TOML file below the working folder")
    return values


def load_recipes(file: str | Path, **settings: object) -> tuple[DomainRecipe, ...]:
    """Read the recipes of a TOML file; settings are further fields of `DomainRecipe`.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If it is not valid TOML, a field is unknown or missing, a value is out of range, or two domains share a name.
    """
    with named_in_errors(file):
        content = RecipeFile(**read_with_path(file))
        check_named_once(entry.name for entry in content.domains)
        return tuple(own_recipe(path=content.path, **settings | dict(entry)) for entry in content.domains)
