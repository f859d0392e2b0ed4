"""The renderers of domains, kept for others of the same light and camera."""

from functools import lru_cache

from gelgap.domains.recipe import DomainRecipe
from gelgap.render import MembraneRenderer

KEPT_RENDERERS = 32
"""One holds the light of the undeformed membrane, half a megabyte and more; a sweep has hundreds of lights."""
kept_renderer = lru_cache(maxsize=KEPT_RENDERERS)(MembraneRenderer)


def renderer_of(recipe: DomainRecipe) -> MembraneRenderer:
    """Return what renders the pictures of a domain."""
    return kept_renderer(recipe.sensor, recipe.illumination, recipe.size_px, recipe.render_quality)
