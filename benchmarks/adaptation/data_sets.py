"""The benchmark's data: paired and independent contacts, of the compared domains and of those for tuning."""

from dataclasses import replace
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from gelgap.domains import DomainRecipe

DESIGNS = ("paired", "independent")
"""Whether both domains of a group have the same contacts, or each its own."""

TUNING_DOMAINS = ("mb3i3", "wmb3i3", "wmb4i4")
"""Gels and lights by which hyperparameters are chosen: no group that is compared has one of them."""

TUNING_SETS = ("tune-paired", "tune-independent")
"""The data sets of the tuning domains; those of the compared groups are named after their design."""

TUNING_CASES = (
    ("tune-paired", ("mb3i3", "wmb3i3")),
    ("tune-paired", ("wmb3i3", "wmb4i4")),
    ("tune-independent", ("wmb4i4", "mb3i3")),
    ("tune-independent", ("mb3i3", "wmb4i4")),
)
"""Data set and group of each case of a choice: markers, gel and light, all three; half of them with paired contacts."""


_NEARER = 0.8


def design_of(data: str) -> str:
    """Return the design of a data set."""
    return data.removeprefix("tune-")


def recipes_of(data: str) -> "tuple[DomainRecipe, ...]":
    """Return the domains of a data set."""
    from gelgap.domains import make_recipes, preset_recipes

    design = design_of(data)
    settings = {"contacts": design, "quality": "standard", "seed": 0}
    if design == "independent":
        settings["inpainted"] = ()  # inpainting a domain's pictures would keep its contacts
    if data == design:
        recipes = preset_recipes("cpu", **settings)
    else:
        recipes = make_recipes(TUNING_DOMAINS, "cpu", **{"inpainted": ("wmb3i3",), **settings})
    return tuple(map(_away_from_edges, recipes)) if design == "independent" else recipes


def _away_from_edges(recipe: "DomainRecipe") -> "DomainRecipe":
    """Return a recipe whose points lie nearer together along y.

    Points that are moved, each in its cell, would else come so near to the pad's edge that each needs its own solve.
    """
    path = replace(recipe.path, points_y_mm=tuple(_NEARER * y for y in recipe.path.points_y_mm))
    return recipe.model_copy(update={"path": path})


def quick_recipes(group: tuple[str, str]) -> "tuple[DomainRecipe, ...]":
    """Return a group's domains at their least: nine points of five poses at draft quality, to see everything run."""
    from gelgap.domains import make_recipes
    from gelgap.sim import ContactPath

    path = ContactPath(
        name="quick",
        points_x_mm=(-2.25, 0.0, 2.25),
        points_y_mm=(-1.3, 0.0, 1.3),
        depths_mm=(0.6,),
        radii_mm=(0.4,),
        angles_deg=(0, 90, 180, 270),
    )
    return make_recipes(group, path, quality="draft", render_quality="draft", size_px=(160, 120), seed=0)
