"""The picture columns of contacts: what the camera sees of them in one light, markers inpainted where asked for."""

from collections.abc import Hashable, Sequence
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from gelgap.domains.picture_codec import encode_png
from gelgap.domains.random_streams import random_stream
from gelgap.domains.recipe import DomainRecipe
from gelgap.domains.schema import HEIGHT_MAP_OFFSET_MM, HEIGHT_MAP_STEP_MM, picture_cell
from gelgap.render import Illumination, Sensor

if TYPE_CHECKING:
    from gelgap.render import MembraneRenderer
    from gelgap.sim import MembraneState

# One holds the light of the undeformed membrane, some 0.2 MB for three LEDs.
KEPT_RENDERERS = 32


def led_to_camera(recipe: DomainRecipe) -> np.ndarray:
    """Return the (n_leds, 3) matrix of a recipe's light; imports colour-science, so call it once, not in workers."""
    return recipe.illumination.led_to_camera(recipe.sensor.camera)


def renderer_of(recipe: DomainRecipe, matrix: np.ndarray) -> "MembraneRenderer":
    """Return the renderer of a recipe's light, whose LED-to-camera matrix is known."""
    rows = tuple(tuple(row) for row in np.asarray(matrix, float).tolist())
    return _renderer(recipe.sensor, recipe.illumination, recipe.size_px, recipe.render_quality, rows)


@lru_cache(maxsize=KEPT_RENDERERS)
def _renderer(
    sensor: Sensor, illumination: Illumination, size_px: tuple[int, int], quality: str, matrix: tuple
) -> "MembraneRenderer":
    from gelgap.render import MembraneRenderer

    return MembraneRenderer(sensor, illumination, size_px, quality, linear_by_led_to_camera=np.array(matrix))


def same_picture(recipe: DomainRecipe) -> Hashable:
    """Return what two recipes have in common whose pictures differ by inpainting alone."""
    light = (recipe.sensor, recipe.illumination, recipe.size_px, recipe.render_quality)
    return (recipe.picture_name, recipe.seed, _shows_markers(recipe), *light)


def reference_png(recipe: DomainRecipe, matrix: np.ndarray) -> bytes:
    """Return the picture without contact of a domain."""
    rng = random_stream(recipe.seed, recipe.picture_name, "reference noise")
    picture = renderer_of(recipe, matrix).reference(markers=_shows_markers(recipe), rng=rng)
    return encode_png(_without_markers(picture) if recipe.inpainted_from else picture)


def picture_cells(
    recipes: Sequence[DomainRecipe], matrix: np.ndarray, frame: int, state: "MembraneState"
) -> list[dict[str, Any]]:
    """Return the picture columns of one contact for recipes that are the `same_picture`, rendered once.

    Raises
    ------
    ValueError
        If the membrane cannot be rendered.
    """
    first = recipes[0]
    rng = random_stream(first.seed, first.picture_name, "sensor noise", frame)
    renderer = renderer_of(first, matrix)
    picture = renderer.picture(
        *_membrane(state), markers=_shows_markers(first), rng=rng, frame_name=f"frame {frame} of {first.name}"
    )
    return [
        {"image": picture_cell(encode_png(_without_markers(picture) if recipe.inpainted_from else picture))}
        | {
            column: _optional_cell(column, recipe, renderer, state)
            for column in recipe.columns
            if column != "diagnostics"
        }
        for recipe in recipes
    ]


def _optional_cell(
    column: str, recipe: DomainRecipe, renderer: "MembraneRenderer", state: "MembraneState"
) -> Any:
    match column:
        case "height_map":
            height_mm = renderer.height_map_mm(*_membrane(state))
            codes = np.clip(np.rint((height_mm - HEIGHT_MAP_OFFSET_MM) / HEIGHT_MAP_STEP_MM), 0, 65535)
            return picture_cell(encode_png(codes.astype(np.uint16)))
        case "contact_mask":
            mask = renderer.contact_mask(*_membrane(state), state.contact)
            return picture_cell(encode_png(mask.astype(np.uint8) * 255))
        case "marker_px":
            return renderer.marker_px(*_membrane(state)).reshape(-1, 2).astype(np.float32).tolist()
        case "marker_rest_mm":
            from gelgap.render import marker_rest_mm

            return marker_rest_mm(recipe.sensor.markers).reshape(-1, 2).astype(np.float32).tolist()


def _membrane(state: "MembraneState") -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return state.x_mm, state.y_mm, state.displacement_mm


def _shows_markers(recipe: DomainRecipe) -> bool:
    return recipe.markers or recipe.inpainted_from is not None


def _without_markers(picture: np.ndarray) -> np.ndarray:
    from gelgap.render import detect_markers, inpaint_telea

    return inpaint_telea(picture, detect_markers(picture))
