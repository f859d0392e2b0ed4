"""What the camera sees of a contact in a domain's light, with markers, without them, or with them inpainted."""

from collections.abc import Hashable, Sequence
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from gelgap.domains.columns import OPTIONAL, View, ViewColumn, picture_cell
from gelgap.domains.hidden_markers import without_markers
from gelgap.domains.picture_codec import encode_png
from gelgap.domains.random_streams import random_stream
from gelgap.domains.recipe import DomainRecipe
from gelgap.render import Illumination, Sensor

if TYPE_CHECKING:
    from gelgap.render import MembraneRenderer
    from gelgap.sim import MembraneState

# One holds the light of the undeformed membrane, some 0.2 MB for three LEDs.
KEPT_RENDERERS = 32


def led_to_camera(recipe: DomainRecipe) -> np.ndarray:
    """Return the (n_leds, 3) matrix of a recipe's light; imports colour-science, so call it once, not in workers."""
    return recipe.illumination.led_to_camera(recipe.sensor.camera)


def group_by_picture(recipes: Sequence[DomainRecipe]) -> list[list[int]]:
    """Return the indices of the recipes in groups whose pictures are one rendering, inpainted or not."""
    groups: dict[Hashable, list[int]] = {}
    for index, recipe in enumerate(recipes):
        light = (recipe.sensor, recipe.illumination, recipe.size_px, recipe.render_quality)
        rendering = (recipe.picture_name, recipe.seed, _shows_markers(recipe), *light)
        groups.setdefault(rendering, []).append(index)
    return list(groups.values())


def reference_png(recipe: DomainRecipe, matrix: np.ndarray) -> bytes:
    """Return a domain's picture without contact, given its LED-to-camera matrix."""
    rng = random_stream(recipe.seed, recipe.picture_name, "reference noise")
    picture = _renderer(recipe, matrix).reference(markers=_shows_markers(recipe), rng=rng)
    return encode_png(_as_shown(recipe, picture))


def picture_cells(
    recipes: Sequence[DomainRecipe], matrix: np.ndarray, frame: int, state: "MembraneState"
) -> list[dict[str, Any]]:
    """Return the picture columns of one contact for recipes that have the `group_by_picture`, rendered once.

    Raises
    ------
    ValueError
        If the membrane cannot be rendered.
    """
    first = recipes[0]
    renderer = _renderer(first, matrix)
    view = View(renderer, first.sensor, state)
    picture = renderer.picture(
        *view.membrane,
        markers=_shows_markers(first),
        rng=random_stream(first.seed, first.picture_name, "sensor noise", frame),
        frame_name=f"frame {frame} of {first.name}",
    )
    return [
        {"image": picture_cell(_as_shown(recipe, picture))}
        | {
            column.name: column.cell(view)
            for name in recipe.columns
            for column in OPTIONAL[name]
            if isinstance(column, ViewColumn)
        }
        for recipe in recipes
    ]


def _renderer(recipe: DomainRecipe, matrix: np.ndarray) -> "MembraneRenderer":
    rows = tuple(tuple(row) for row in np.asarray(matrix, float).tolist())
    return _kept_renderer(recipe.sensor, recipe.illumination, recipe.size_px, recipe.render_quality, rows)


@lru_cache(maxsize=KEPT_RENDERERS)
def _kept_renderer(
    sensor: Sensor, illumination: Illumination, size_px: tuple[int, int], quality: str, matrix: tuple
) -> "MembraneRenderer":
    from gelgap.render import MembraneRenderer

    return MembraneRenderer(sensor, illumination, size_px, quality, linear_by_led_to_camera=np.array(matrix))


def _shows_markers(recipe: DomainRecipe) -> bool:
    return recipe.markers or recipe.inpainted_from is not None


def _as_shown(recipe: DomainRecipe, picture: np.ndarray) -> np.ndarray:
    """Return the picture, without its markers if the recipe has them inpainted."""
    return picture if recipe.inpainted_from is None else without_markers(picture)
