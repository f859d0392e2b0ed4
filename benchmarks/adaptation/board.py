"""The board: which groups, methods and data sets are compared, and what the paper reports of them."""

from dataclasses import replace
from typing import TYPE_CHECKING, Any

from gelgap.adapt.methods import registry as known
from gelgap.benchmarks.adaptation.designs import DATA

if TYPE_CHECKING:
    from gelgap.domains import DomainRecipe

Group = tuple[str, str]
"""Source and target."""
Changes = tuple[tuple[str, Any], ...]
"""Fields of a profile, or settings of a method, that differ from the preset, with their values."""
BY_POINT: Changes = (("split_by", "point"),)
AXES = ("x", "y", "z")

GROUPS: tuple[Group, ...] = (
    ("mb0i0", "wmb0i0"),
    ("wmb0i0", "mb0i0"),
    ("wmb0i0", "wmb1i1"),
    ("wmb0i0", "wmb2i2"),
    ("wmb1i1", "wmb0i0"),
    ("wmb1i1", "wmb2i2"),
    ("mb0i0", "wmb1i1"),
    ("mb0i0", "wmb2i2"),
    ("wmb1i1", "mb0i0"),
)
"""The paper's adaptation groups (its table I)."""

PLAIN, CEILING = "source-only", "supervised"
METHODS = tuple(name for name in known.METHODS if name != "constant-mean")
"""All methods of gelgap but the constant mean, which is a row of every table."""
MAIN_METHODS = (PLAIN, "adabn", "no-transfer", "classifier-only", "dann", "daregram", "dsan", CEILING)
"""The paper's methods, their controls, and training on the labels of both domains."""

LIGHT_GROUPS: tuple[Group, ...] = (
    ("wmb0i0", "wmb0i1"),
    ("wmb0i1", "wmb0i0"),
    ("wmb0i0", "wmb0i2"),
    ("wmb0i2", "wmb0i0"),
    ("mb0i0", "mb0i1"),
)
"""Groups in which nothing but the light changes; in the last one there are dots, whose displacement can be shown."""
LABEL_SHIFT = "label-shift"
BY_ROLE = (DATA, LABEL_SHIFT)
"""Data sets whose domains are pressed at other points as sources than as targets; the second's targets rarely deep."""
PAIRED = "paired"
"""The quick form's data set, in which both domains have the same contacts."""
DATA_SETS = (*BY_ROLE, PAIRED)
TUNING_DOMAINS = ("mb3i3", "wmb3i3", "wmb4i4")
"""Gels and lights by which hyperparameters are chosen: no group that is compared has one of them."""
TUNING_CASES = (
    ("tune-paired", ("mb3i3", "wmb3i3")),
    ("tune-paired", ("wmb3i3", "wmb4i4")),
    ("tune-independent", ("wmb4i4", "mb3i3")),
    ("tune-independent", ("mb3i3", "wmb4i4")),
)
"""Data set and group of each case of a choice: markers, gel and light, all three; half of them with paired contacts."""


def tuning_recipes(data: str) -> "tuple[DomainRecipe, ...]":
    """Return the domains of the tuning groups in one of their data sets."""
    from gelgap.domains import make_recipes

    if data == "tune-paired":
        return make_recipes(TUNING_DOMAINS, "cpu", inpainted=("wmb3i3",), quality="standard", seed=0)
    # Inpainting a domain's pictures would keep its contacts.
    recipes = make_recipes(
        TUNING_DOMAINS, "cpu", contacts="independent", inpainted=(), quality="standard", seed=0
    )
    return tuple(map(_away_from_edges, recipes))


def _away_from_edges(recipe: "DomainRecipe") -> "DomainRecipe":
    """Return a recipe whose points lie nearer together along y.

    Points that are moved, each in its cell, would else come so near to the pad's edge that each needs its own solve.
    """
    path = replace(recipe.path, points_y_mm=tuple(0.8 * y for y in recipe.path.points_y_mm))
    return recipe.model_copy(update={"path": path})
