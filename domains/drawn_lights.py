"""A domain in several drawn lights, like that of a picture without contact: to train for a light nobody measured."""

import logging
import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gelgap.data.formats.pictures import resized
from gelgap.domains.generation.plan import Contacts
from gelgap.domains.recipe import DomainRecipe
from gelgap.render import Illumination, MembraneRenderer, Variation, WhiteSpectrum, vary_illumination
from gelgap.sim import PosePath

LOG = logging.getLogger(__name__)
LIGHTS = 8
"""Domains that one becomes; together they have its frames."""
CANDIDATES = 1000
"""Lights that are drawn; those nearest to the picture are taken."""
KINDS = ("i0", "i1", "i2")
"""Presets around which lights are drawn."""
_HEIGHT_PX = 30
_SPREAD = Variation(led_position_mm=1.0, led_angle_deg=10, led_drive=0.3, led_peak_nm=10, led_cct=0.2)


def drawn_illumination(number: int, kinds: Sequence[Illumination]) -> Illumination:
    """Return a light far from those of `kinds`, the same for the same number.

    The LEDs of one of them are turned together about the gel's normal by any angle, exchange their spectra or are all
    white, and each is moved, tilted, dimmed and tinted.
    """
    rng = np.random.default_rng([number, LIGHTS])
    base = kinds[int(rng.integers(len(kinds)))]
    left = [led.spectrum for led in base.leds]
    spectra = []
    # Which permutation of them; 64 bits tell those of 20, so that of more the last 20 exchange theirs.
    order = int(rng.integers(math.factorial(min(len(left), 20))))
    while left:
        chosen, order = divmod(order, math.factorial(len(left) - 1))
        spectra.append(left.pop(chosen))
    turn = rng.uniform(0, 2 * math.pi)
    white = rng.random() < 1 / 3
    about_z = np.array([[math.cos(turn), -math.sin(turn), 0], [math.sin(turn), math.cos(turn), 0], [0, 0, 1]])
    leds = []
    for led, spectrum in zip(base.leds, spectra, strict=True):
        spectrum = WhiteSpectrum(cct_k=float(rng.uniform(3000, 7500))) if white else spectrum
        place = {name: tuple((about_z @ getattr(led, name)).tolist()) for name in ("position_mm", "facing")}
        leds.append(led.model_copy(update={**place, "spectrum": spectrum}))
    return vary_illumination(base.model_copy(update={"leds": tuple(leds)}), _SPREAD, rng)


def in_drawn_lights(
    recipe: DomainRecipe, like: NDArray[np.uint8] | None = None, kinds: Sequence[Illumination] | None = None
) -> tuple[DomainRecipe, ...]:
    """Return a domain as several, `name-1` and on, each in a drawn light and with its share of the contact points.

    Parameters
    ----------
    recipe
        The domain; its own light is not used.
    like
        Picture without contact (h, w, 3) of the sensor that is meant, of the same view as the recipe's. Of
        `CANDIDATES` lights those are taken whose own picture differs least from it, in the mean square over pixels.
        Without it the first `LIGHTS` are taken as they are drawn.
    kinds
        Lights around which is drawn; by default the presets of `KINDS`. Where the sensor's is of none of these kinds,
        no shear was read (docs/results/adapt-or-randomise.md).

    Raises
    ------
    ValueError
        If the picture has other proportions than the recipe's, or fewer pixels than the comparison takes.
    """
    kinds = kinds or [Illumination.preset(name) for name in KINDS]
    view_mm = max(recipe.sensor.camera.footprint_mm(recipe.size_px)) / 2
    lamp_mm = min(math.hypot(*led.position_mm[:2]) for kind in kinds for led in kind.leds)
    if lamp_mm < view_mm:
        text = "lamps %.1f mm off the middle are turned into a view that reaches %.1f mm: name other lamps"
        LOG.warning(text, lamp_mm, view_mm)
    numbers = range(LIGHTS) if like is None else _nearest(recipe, like, kinds).tolist()
    path = recipe.path
    recipes = []
    if recipe.interpolated:
        # Each serves its own contacts from the library of all: they are solved once.
        whole = recipe.elastomer, recipe.indenter, recipe.solved_path(), recipe.quality
        if library := Contacts.interpolated(*whole, recipe.library_reach_mm).library:
            ranges = library.ranges
            reach_mm = ranges.shallowest_mm, ranges.deepest_mm, ranges.travel_mm
            recipe = recipe.model_copy(update={"library_reach_mm": reach_mm})
    points = list(dict.fromkeys(pose.point_id for pose in path.poses if pose.depth_mm > 0))
    for place, number in enumerate(numbers[: len(points)]):
        shown_points = set(points[place::LIGHTS])
        poses = tuple(pose for pose in path.poses if pose.point_id in shown_points)
        if poses[0].depth_mm > 0:
            poses = (path.poses[0], *poses)  # the reference without contact
        parts = {
            "name": f"{recipe.name}-{place + 1}",
            "path": PosePath(f"{path.name}-{place + 1}", poses),
            "illumination": drawn_illumination(number, kinds),
            "inpainted_from": None,
        }
        recipes.append(recipe.model_copy(update=parts))
    return tuple(recipes)


def _nearest(
    recipe: DomainRecipe, like: NDArray[np.uint8], kinds: Sequence[Illumination]
) -> NDArray[np.intp]:
    """Return the numbers of the lights whose picture without contact is nearest to a picture, the nearest first."""
    width, height = recipe.size_px
    size_px = round(_HEIGHT_PX * width / height), _HEIGHT_PX
    seen_height, seen_width, _ = like.shape
    if abs(seen_width * height - width * seen_height) > 0.02 * width * seen_height or seen_width < size_px[0]:
        raise ValueError(
            f"the image without contact has {seen_width}×{seen_height} px: it must have the proportions of the "
            f"domain's {width}×{height} px (--size), and at least {size_px[0]}×{size_px[1]} px"
        )
    seen = resized(like, size_px).astype(float)

    def distance(number: int) -> float:
        renderer = MembraneRenderer(recipe.sensor, drawn_illumination(number, kinds), size_px, "draft")
        return float(np.square(renderer.reference(markers=recipe.markers) - seen).mean())

    return np.argsort([distance(number) for number in range(CANDIDATES)])[:LIGHTS]
