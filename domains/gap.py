"""How far two domains are apart by their recipes: in colour, modulus and markers."""

from dataclasses import dataclass

from gelgap.domains.recipe import DomainRecipe, differences, shown_markers
from gelgap.domains.renderers import renderer_of
from gelgap.render import Markers
from gelgap.render.renderer import reference_gap


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
        markers=markers_gap(*(shown_markers(recipe.sensor, recipe.markers) for recipe in (base, other))),
        fields=tuple(name for name, _, _ in differences(base.configuration(), other.configuration())),
    )


def markers_gap(before: Markers | None, after: Markers | None) -> str:
    """Return whether markers are `equal`, `added`, `removed` or `changed`."""
    if before == after:
        return "equal"
    return "added" if before is None else "removed" if after is None else "changed"
