"""The benchmark's data: paired and independent contacts, of the compared domains and of those for tuning."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from gelgap.domains import DomainRecipe

DESIGNS = ("paired", "independent")
"""Whether both domains of a group have the same contacts, or each its own."""

TUNING_DOMAINS = ("mb3i3", "wmb3i3", "wmb4i4")
TUNING_GROUPS = (("mb3i3", "wmb3i3"), ("wmb3i3", "wmb4i4"), ("wmb4i4", "mb3i3"), ("mb3i3", "wmb4i4"))
"""Gels and lights by which hyperparameters are chosen: no group that is compared has one of them."""

_TUNING = "tune-"
TUNING_SETS = tuple(_TUNING + design for design in DESIGNS)
"""The data sets of the tuning groups; those of the compared groups are named after their design."""


def design_of(data: str) -> str:
    """Return the design of a data set."""
    return data.removeprefix(_TUNING)


def recipes_of(data: str, path: str) -> "tuple[DomainRecipe, ...]":
    """Return the domains of a data set on the contact path `cpu`, or on `smoke` at draft quality."""
    from gelgap.domains import make_recipes, preset_recipes

    design = design_of(data)
    settings = {"contacts": design, "quality": "draft" if path == "smoke" else "standard", "seed": 0}
    if design == "independent":
        settings["inpainted"] = ()  # inpainting a domain's pictures would keep its contacts
    if data == design:
        return preset_recipes(path, **settings)
    return make_recipes(TUNING_DOMAINS, path, **{"inpainted": ("wmb3i3",), **settings})
