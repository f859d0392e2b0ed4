"""Sweeps: domains that differ from a base domain in chosen factors."""

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
from gelgap.data.formats.domain_folder import DomainName
from gelgap.domains.gap import domain_gap
from gelgap.domains.recipe import DomainRecipe, RisingInterval, make_recipes, read_with_path
from gelgap.render import Variation, vary_illumination, vary_sensor

Value = float | int | str | bool | None


@dataclass(frozen=True)
class Variant:
    """One domain of a sweep: its recipe, and the factors' values, by which it differs from the base."""

    recipe: DomainRecipe
    values: dict[str, Value]


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

    def variants(self, **settings: Any) -> tuple[Variant, ...]:
        """Return the base, first and without values, and every variant, named `<sweep>-001` and so on.

        Raises
        ------
        ValueError
            If a factor's field does not exist or its value is out of range.
        """
        (base,) = make_recipes([self.base], self.path, **settings)
        variants = [Variant(base, {})]
        for number, values in enumerate(self.points(), start=1):
            name = f"{self.name}-{number:03d}"
            configuration = base.configuration() | {"name": name}
            if base.inpainted_from:
                # The pictures with markers that are inpainted are this variant's own, with noise of their own.
                configuration["inpainted_from"] = f"{name}-with-markers"
            drawn_as: dict[str, Value] = {}
            if self.variation is not None:
                rng = np.random.default_rng([self.seed, number])
                drawn_as = {"draw": number}
                light = vary_illumination(base.illumination, self.variation, rng)
                configuration["illumination"] = light.model_dump(mode="json")
                configuration["sensor"] = vary_sensor(base.sensor, self.variation, rng).model_dump(
                    mode="json"
                )
            for factor in self.factors:
                if factor.field in values:
                    _change(configuration, factor.field.split("."), factor, values[factor.field])
            recipe = DomainRecipe(**configuration)
            if base.sensor.flat_field:
                # Of a flat field, a configuration does not say where its file lies.
                sensor = recipe.sensor.model_copy(update={"flat_field": base.sensor.flat_field})
                recipe = recipe.model_copy(update={"sensor": sensor})
            variants.append(Variant(recipe, drawn_as | values))
        return tuple(variants)

    @staticmethod
    def write_gaps(variants: Sequence[Variant], out_dir: Path | str) -> Path:
        """Write `sweep.json`: each domain's factors and its gap to the base."""
        base = variants[0].recipe
        table = {
            variant.recipe.name: {"factors": variant.values, "gap": asdict(domain_gap(base, variant.recipe))}
            for variant in variants
        }
        path = Path(out_dir) / "sweep.json"
        content = with_checksum({"base": base.name, "domains": table})
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
