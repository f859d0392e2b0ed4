"""How far two domains are apart, in what a simulator knows exactly: modulus, light, markers."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from gelgap.domains.recipe import DomainRecipe

if TYPE_CHECKING:
    from gelgap.render import MembraneRenderer


@dataclass(frozen=True)
class DomainGap:
    """The gap from a base domain to another.

    `modulus_ratio` is E over the base's E; `colour_difference` the mean CIEDE2000 between the two reference pictures
    without markers and noise, `colour_difference_p95` its 95th percentile over the pixels; `markers` says whether they
    are `equal`, `added` or `removed`, `fields` which fields of the configuration differ.
    """

    modulus_ratio: float
    colour_difference: float
    colour_difference_p95: float
    markers: str
    fields: tuple[str, ...]


def domain_gap(base: DomainRecipe, other: DomainRecipe) -> DomainGap:
    """Return the gap from `base` to `other`, from their recipes alone."""
    from gelgap.render import reference_gap

    colours = reference_gap(_renderer(base), _renderer(other))
    changed = (other.markers, base.markers)
    return DomainGap(
        modulus_ratio=round(other.elastomer.young_modulus_mpa / base.elastomer.young_modulus_mpa, 6),
        colour_difference=round(colours.mean, 3),
        colour_difference_p95=round(colours.percentile_95, 3),
        markers={(True, False): "added", (False, True): "removed"}.get(changed, "equal"),
        fields=tuple(differing_fields(base.configuration(), other.configuration())),
    )


def _renderer(recipe: DomainRecipe) -> "MembraneRenderer":
    from gelgap.render import MembraneRenderer

    return MembraneRenderer(recipe.sensor, recipe.illumination, recipe.size_px, recipe.render_quality)


def differing_fields(one: Any, other: Any, field: str = "") -> list[str]:
    """Return the dotted names of the fields in which two configurations differ."""
    if isinstance(one, dict) and isinstance(other, dict) and one.keys() == other.keys():
        return [
            name
            for key in one
            for name in differing_fields(one[key], other[key], f"{field}.{key}" if field else key)
        ]
    if isinstance(one, list) and isinstance(other, list) and len(one) == len(other):
        return [
            name
            for index in range(len(one))
            for name in differing_fields(one[index], other[index], f"{field}.{index}")
        ]
    return [] if one == other else [field]
