"""The full configuration of one domain: everything on which its bytes depend."""

import hashlib
from collections.abc import Iterable, Sequence
from typing import Annotated, Any, Literal

from pydantic import Field

from gelgap.assets import load_preset
from gelgap.assets.checksums import canonical_json
from gelgap.assets.settings import Settings
from gelgap.domains.acquisition import (
    AcquisitionError,
    ContactSampling,
    DrawnErrors,
    draw_errors,
    independent_poses,
)
from gelgap.domains.columns import OptionalColumn
from gelgap.domains.domain import OWN_LIGHT, Domain, known_domains
from gelgap.domains.labels import PAPER_FORCE_RANGE_N
from gelgap.render import Illumination, Sensor
from gelgap.sim import (
    AnyIndenter,
    ContactPath,
    DrawnPath,
    Elastomer,
    Pose,
    PosePath,
    QualityName,
    Sphere,
    load_path,
)

Interval = tuple[float, float]
Side = Annotated[int, Field(ge=16, le=4096)]

INPAINTED_IN_THE_PAPER = ("wmb0i0",)
"""The domains that the paper made by inpainting the markers of the domain with markers."""


class DomainRecipe(Settings):
    """One domain, completely: the same recipe and package versions give the same bytes."""

    name: str = Field(
        description="the domain's name, and its folder's",
        pattern=r"^[A-Za-z0-9][A-Za-z0-9._+-]*$",
        max_length=128,
    )
    elastomer: Elastomer
    indenter: AnyIndenter = Sphere()
    path: DrawnPath | ContactPath | PosePath
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
    contacts: ContactSampling = Field(
        default="paired", description="the same poses in every domain, or poses of its own"
    )
    acquisition: AcquisitionError = AcquisitionError()
    force_range_n: tuple[Interval, Interval, Interval] = Field(
        default=PAPER_FORCE_RANGE_N,
        description="declared range of Fx, Fy, Fz in N, by which labels are normalised",
    )

    def configuration(self) -> dict[str, Any]:
        """Return the recipe as plain JSON values."""
        return self.model_dump(mode="json")

    @property
    def key(self) -> str:
        """A hash of everything in the recipe."""
        return hashlib.sha256(canonical_json(self.configuration())).hexdigest()

    @property
    def picture_name(self) -> str:
        """The domain whose light falls on these frames: its name keys the sensor noise."""
        return self.inpainted_from or self.name

    def commanded_poses(self) -> tuple[Pose, ...]:
        """Return the poses as a rig would record them, one per frame."""
        if self.contacts == "paired":
            return self.path.poses
        if isinstance(self.path, PosePath):
            raise ValueError(
                f"contacts = 'independent': needs a path on a grid, and {self.path.name} lists its poses"
            )
        return independent_poses(self.path, self.seed, self.picture_name)

    def drawn_errors(self) -> DrawnErrors:
        return draw_errors(self.acquisition, self.seed, self.picture_name)

    def solved_path(self) -> ContactPath | PosePath:
        """Return the contacts that really happen, one per frame."""
        errors = self.drawn_errors()
        off = not any((*errors.point_offset_mm, errors.depth_zero_mm, *errors.tilt_deg))
        if off and self.contacts == "paired":
            return self.path
        commanded = self.commanded_poses()
        return PosePath(
            self.path.name, commanded if off else tuple(errors.actual(pose) for pose in commanded)
        )


def make_recipes(
    domains: Iterable[str | Domain],
    path: str | ContactPath | PosePath = "cpu",
    *,
    inpainted: Sequence[str] = INPAINTED_IN_THE_PAPER,
    sensor: str | Sensor = "paper",
    columns: Iterable[OptionalColumn] = (),
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
        A sensor preset's name, or a sensor.
    columns
        Optional columns.
    settings
        Further fields of `DomainRecipe`: seed, quality, size_px, contacts, acquisition, ….

    Raises
    ------
    ValueError
        For an unknown name (the message lists the known ones), a domain named twice, or a bad value.
    """
    parsed = [Domain.parse(str(domain)) for domain in domains]
    if not parsed:
        raise ValueError("no domain was named; name at least one, for example mb0i0")
    if len(set(parsed)) < len(parsed):
        raise ValueError(f"a domain is named twice in {', '.join(map(str, parsed))}; name each once")
    contact_path = load_path(path) if isinstance(path, str) else path
    seen_through = Sensor.preset(sensor) if isinstance(sensor, str) else sensor
    return tuple(
        DomainRecipe(
            name=domain.name,
            elastomer=Elastomer.preset(domain.elastomer),
            path=contact_path,
            sensor=seen_through,
            illumination=_light(domain, seen_through),
            markers=domain.markers,
            inpainted_from=domain.name.removeprefix("w") if domain.name in inpainted else None,
            columns=tuple(sorted(columns)),
            **settings,
        )
        for domain in parsed
    )


def _light(domain: Domain, sensor: Sensor) -> Illumination:
    if domain.illumination != OWN_LIGHT:
        return Illumination.preset(domain.illumination)
    if sensor.illumination is None:
        raise ValueError(
            f"domain {domain.name}: sensor {sensor.name!r} has no LEDs of its own; give it an [illumination], choose "
            "another sensor, or name an illumination preset"
        )
    return sensor.illumination


def own_recipe(
    name: str,
    path: str | ContactPath | PosePath = "cpu",
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
    meant = next((domain for domain in known_domains() if domain.name == name), None)
    if meant is not None and meant.illumination != OWN_LIGHT:
        raise ValueError(
            f"name = {name!r}: means a domain of presets; choose another, for example {name}-own"
        )
    (recipe,) = make_recipes([base], path, **settings)
    own = {"elastomer": elastomer, "illumination": illumination}
    given = {part: value for part, value in own.items() if value is not None}
    return DomainRecipe(**{**dict(recipe), "inpainted_from": None, **given, "name": name})


def preset_recipes(name: str, **settings: Any) -> tuple[DomainRecipe, ...]:
    """Return the recipes of a whole data set: `smoke`, `cpu` or `paper`; settings as for `make_recipes`.

    Raises
    ------
    ValueError
        If there is no such data set.
    """
    values = load_preset("datasets", name)
    return tuple(
        recipe
        for group in values["groups"]
        for recipe in make_recipes(group["domains"], group["path"], **settings)
    )
