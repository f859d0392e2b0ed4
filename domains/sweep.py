"""Sweeps: domains that differ from a base domain in chosen factors, and how far any two domains are apart."""

import json
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass
from itertools import product
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from gelgap.assets.checksums import with_checksum
from gelgap.assets.settings import Settings
from gelgap.assets.toml_file import named_in_errors
from gelgap.assets.whole_file import write_whole
from gelgap.domains.formats.domain_folder import DomainName
from gelgap.domains.generation.shard import renderer_of
from gelgap.domains.pretraining import RisingInterval
from gelgap.domains.recipe import DomainRecipe, differences, make_recipes, read_with_path
from gelgap.render import Markers, Sensor, Variation, vary_illumination, vary_sensor
from gelgap.render.renderer import reference_gap

Value = float | int | str | bool | None


class Factor(Settings):
    """One field of a domain's configuration and what it may become.

    `field` is its dotted name, such as `elastomer.young_modulus_mpa`, `illumination.leds.*.drive` (`*`: all of a list),
    `sensor.markers.pitch_mm`, `markers`, or `acquisition.tilt_deg`. `change` says whether a value replaces the base's
    (`set`), multiplies it (`scale`) or is added to it (`shift`).
    """

    field: str
    change: Literal["set", "scale", "shift"] = "set"
    values: tuple[Value, ...] = Field(default=(), description="values for grid and one-at-a-time")
    range: RisingInterval | None = Field(default=None, description="bounds for a Latin hypercube")


class Sweep(Settings):
    """Which domains to make: the base, and its variants."""

    name: DomainName
    base: str = Field(description="a domain by its name, such as mb0i0")
    path: str = "smoke"
    method: Literal["grid", "one-at-a-time", "latin-hypercube"] = "grid"
    samples: Annotated[int, Field(ge=1, le=10_000)] = Field(
        default=8, description="number of variants of a Latin hypercube, and of draws without factors"
    )
    seed: Annotated[int, Field(ge=0)] = Field(default=0, description="seed of Latin hypercube and draws")
    factors: tuple[Factor, ...] = ()
    variation: Variation | None = Field(
        default=None,
        description="how much LEDs and coat of every variant are drawn around the base's, before its factors",
    )

    @classmethod
    def load(cls, file: Path | str) -> Self:
        """Read a sweep from a TOML file.

        Raises
        ------
        FileNotFoundError
            If there is no such file.
        ValueError
            If it is not valid TOML or a value is out of range.
        """
        file = Path(file)
        with named_in_errors(file):
            return cls(**{"name": file.stem} | read_with_path(file))

    @model_validator(mode="after")
    def _check(self) -> Self:
        if not self.factors and self.variation is None:
            raise ValueError("a sweep needs factors, a variation, or both")
        hypercube = self.method == "latin-hypercube"
        needed, other = ("range", "values") if hypercube else ("values", "range")
        for factor in self.factors:
            if not getattr(factor, needed) or getattr(factor, other):
                raise ValueError(
                    f"factor {factor.field}: method = {self.method!r} needs its {needed}, and no {other}"
                )
        return self

    def points(self) -> Iterator[dict[str, Value]]:
        """Yield the factors' values of each variant, by field; the base itself is not among them."""
        if not self.factors:
            yield from ({} for _ in range(self.samples))
            return
        if self.method == "one-at-a-time":
            yield from ({factor.field: value} for factor in self.factors for value in factor.values)
            return
        rows: Iterable[Sequence[Value]]
        if self.method == "grid":
            rows = product(*(factor.values for factor in self.factors))
        else:
            from scipy.stats.qmc import LatinHypercube, scale

            unit = LatinHypercube(len(self.factors), rng=self.seed).random(self.samples)
            table = scale(unit, *zip(*(factor.range for factor in self.factors), strict=True))
            rows = [[round(value, 9) for value in row] for row in table.tolist()]
        for row in rows:
            yield dict(zip((factor.field for factor in self.factors), row, strict=True))


@dataclass(frozen=True)
class Variant:
    """One domain of a sweep: its recipe, and the values by which it differs from the base."""

    recipe: DomainRecipe
    values: dict[str, Value]


def sweep_variants(sweep: Sweep, **settings: Any) -> tuple[Variant, ...]:
    """Return the base, first and without values, and every variant, named `<sweep>-001` and so on.

    Raises
    ------
    ValueError
        If a factor's field does not exist or its value is out of range.
    """
    (base,) = make_recipes([sweep.base], sweep.path, **settings)
    variants = [Variant(base, {})]
    for number, values in enumerate(sweep.points(), start=1):
        name = f"{sweep.name}-{number:03d}"
        configuration = base.configuration() | {"name": name}
        if base.inpainted_from:
            # The pictures with markers that are inpainted are this variant's own, with noise of their own.
            configuration["inpainted_from"] = f"{name}-with-markers"
        drawn_as: dict[str, Value] = {}
        if sweep.variation is not None:
            rng, drawn_as = np.random.default_rng([sweep.seed, number]), {"draw": number}
            light = vary_illumination(base.illumination, sweep.variation, rng)
            configuration["illumination"] = light.model_dump(mode="json")
            configuration["sensor"] = vary_sensor(base.sensor, sweep.variation, rng).model_dump(mode="json")
        for factor in sweep.factors:
            if factor.field in values:
                _change(configuration, factor.field.split("."), factor, values[factor.field])
        recipe = DomainRecipe(**configuration)
        if base.sensor.flat_field:
            # Of a flat field, a configuration does not say where its file lies.
            sensor = recipe.sensor.model_copy(update={"flat_field": base.sensor.flat_field})
            recipe = recipe.model_copy(update={"sensor": sensor})
        variants.append(Variant(recipe, drawn_as | values))
    return tuple(variants)


def write_sweep(variants: Sequence[Variant], out_dir: Path | str) -> Path:
    """Write `sweep.json`: each domain's factors and its gap to the base."""
    base = variants[0].recipe
    table = {
        variant.recipe.name: {"factors": variant.values, "gap": asdict(domain_gap(base, variant.recipe))}
        for variant in variants
    }
    path, content = Path(out_dir) / "sweep.json", with_checksum({"base": base.name, "domains": table})
    write_whole(path, json.dumps(content, indent=1, ensure_ascii=False).encode())
    return path


def _change(node: Any, steps: Sequence[str], factor: Factor, value: Value) -> None:
    """Change the value at `steps` inside a configuration; `*` goes to all of a list or table."""
    head, *rest = steps
    parts = node if isinstance(node, dict) else dict(enumerate(node if isinstance(node, list) else ()))
    chosen = [key for key in parts if head in ("*", str(key))]
    if not chosen:
        known = ", ".join(parts) if isinstance(node, dict) else f"*, 0…{len(parts) - 1}"
        raise ValueError(
            f"factor {factor.field}: {head!r} does not exist; there is {known if parts else 'nothing inside it'}"
        )
    for key in chosen:
        old = node[key]
        if rest:
            _change(old, rest, factor, value)
        elif factor.change == "set":
            node[key] = value
        elif any(isinstance(n, bool) or not isinstance(n, int | float) for n in (old, value)):
            raise ValueError(
                f"factor {factor.field}: cannot {factor.change} {old!r} by {value!r}; both must be numbers"
            )
        else:
            node[key] = old * value if factor.change == "scale" else old + value


@dataclass(frozen=True)
class DomainGap:
    """The gap from a base domain to another.

    `modulus_ratio` is E over the base's E; `colour_difference` the mean CIEDE2000 between the two reference pictures
    without markers and noise, `colour_difference_p95` its 95th percentile over the pixels; `markers` says whether they
    are `equal`, `added`, `removed` or `changed`, `fields` which fields of the configuration differ.
    """

    modulus_ratio: float
    colour_difference: float
    colour_difference_p95: float
    markers: str
    fields: tuple[str, ...]


def domain_gap(base: DomainRecipe, other: DomainRecipe) -> DomainGap:
    """Return the gap from `base` to `other`, from their recipes alone."""
    colours = reference_gap(renderer_of(base), renderer_of(other))
    return DomainGap(
        modulus_ratio=round(other.elastomer.young_modulus_mpa / base.elastomer.young_modulus_mpa, 6),
        colour_difference=round(colours.mean, 3),
        colour_difference_p95=round(colours.percentile_95, 3),
        markers=markers_gap(*(shown_markers(own.sensor, own.markers) for own in (base, other))),
        fields=tuple(name for name, _, _ in differences(base.configuration(), other.configuration())),
    )


def shown_markers(sensor: Sensor, wanted: bool) -> Markers | None:
    """Return the markers that pictures show where they are wanted; a flat field may have them where none are listed."""
    has_markers = sensor.markers.layout != "none" or sensor.flat_field is not None
    return sensor.markers if wanted and has_markers else None


def markers_gap(before: Markers | None, after: Markers | None) -> str:
    """Return whether markers are `equal`, `added`, `removed` or `changed`."""
    if before == after:
        return "equal"
    return "added" if before is None else "removed" if after is None else "changed"


def unseen_differences(source: DomainRecipe, target: DomainRecipe) -> list[str]:
    """Return what of a gap no picture shows, in sentences; from the recipes alone.

    A camera sees the membrane. Two gels with the same membrane and other forces cannot be told apart by it, whatever
    the network and however it is adapted: only labels of the target can.
    """
    one, other, notes = source.elastomer, target.elastomer, []
    if one.young_modulus_mpa != other.young_modulus_mpa:
        ratio = other.young_modulus_mpa / one.young_modulus_mpa
        note = (
            f"modulus {one.young_modulus_mpa:g} and {other.young_modulus_mpa:g} MPa: the same dent takes × {ratio:.3g} "
            f"the force on {target.name}"
        )
        if {one.mount_stiffness_n_per_mm, other.mount_stiffness_n_per_mm} != {None}:
            note += "; how far the rig yields only makes its dents shallower or deeper"
        notes.append(note)
    if (one.thickness_mm, one.poisson_ratio) != (other.thickness_mm, other.poisson_ratio):
        notes.append(
            f"thickness {one.thickness_mm:g} and {other.thickness_mm:g} mm, Poisson's ratio {one.poisson_ratio:g} and "
            f"{other.poisson_ratio:g}: the same dent takes another force, and only the bulge around it looks different"
        )
    frictions = [
        f"{gel.friction:g}" + (f" (static {gel.static_friction:g})" if gel.static_friction else "")
        for gel in (one, other)
    ]
    if frictions[0] != frictions[1]:
        notes.append(
            f"friction {' and '.join(frictions)}: as long as a contact sticks, no picture shows how much "
            "shear it would bear; where one gel slips and the other sticks, shear differs"
        )
    bare = [own.name for own in (source, target) if shown_markers(own.sensor, own.markers) is None]
    if bare:
        notes.append(
            f"no markers on {' and '.join(bare)}: a single picture shows shear only in how the dent and its shading "
            "lean; how far the dent has moved is seen from first touch on (input touch, needs trajectories)"
        )
    if target.acquisition.force_bias_n:
        bias = ", ".join(f"{value:.2g}" for value in target.drawn_errors().force_bias_n)
        notes.append(f"the force gauge of {target.name} is off by ({bias}) N, which no picture shows")
    return notes
