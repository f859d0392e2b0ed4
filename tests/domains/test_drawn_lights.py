"""Lights that are drawn, and those taken that are like a picture."""

import numpy as np
import pytest

from gelgap.domains import drawn_lights, in_drawn_lights, make_recipes
from gelgap.domains.drawn_lights import drawn_illumination
from gelgap.domains.generation.plan import plan_generation
from gelgap.render import Illumination, MembraneRenderer, RgbSpectrum
from gelgap.sim import Pose, PosePath

KINDS = [Illumination.preset(name) for name in ("i0", "i1")]


@pytest.fixture(scope="module")
def recipe():
    return make_recipes(["wmb0i0"], "cpu", size_px=(64, 48))[0]


def test_a_number_is_a_light_of_one_of_the_kinds():
    lights = [drawn_illumination(number, KINDS) for number in range(40)]
    assert lights[3] == drawn_illumination(3, KINDS)
    assert len({str(light.leds) for light in lights}) == 40
    assert {light.leds[0].kind for light in lights} == {kind.leds[0].kind for kind in KINDS}
    # Turned by any angle: the first LED of a kind is found all around.
    x, y = np.array([light.leds[0].position_mm[:2] for light in lights]).T
    assert np.histogram(np.arctan2(y, x), bins=4)[0].min() > 3


def test_the_leds_of_a_ring_exchange_their_spectra():
    led = KINDS[0].leds[0]
    ring = [
        led.model_copy(update={"name": str(k), "spectrum": RgbSpectrum(rgb=(k, 1, 1))}) for k in range(24)
    ]
    light = drawn_illumination(1, [Illumination(leds=ring)])
    reds = [own.spectrum.rgb[0] for own in light.leds]
    assert sorted(reds) == list(range(24)) != reds


def test_every_contact_is_in_one_light(recipe):
    found = in_drawn_lights(recipe)
    assert [one.name for one in found] == [f"wmb0i0-{place}" for place in range(1, len(found) + 1)]
    contacts = [pose for one in found for pose in one.path.poses if pose.depth_mm > 0]
    assert sorted(contacts, key=str) == sorted((p for p in recipe.path.poses if p.depth_mm > 0), key=str)
    assert all(one.path.poses[0].depth_mm == 0 for one in found)
    points = [{pose.point_id for pose in one.path.poses} for one in found]
    assert not any(one & other for i, one in enumerate(points) for other in points[:i])


def test_lamps_that_would_stand_in_view_are_named(recipe, caplog):
    wide = recipe.sensor.model_copy(update={"camera": recipe.sensor.camera.showing(35.0)})
    for sensor in (recipe.sensor, wide):
        in_drawn_lights(recipe.model_copy(update={"sensor": sensor}))
    (warned,) = caplog.messages
    assert warned.startswith("lamps 9.5 mm off the middle are turned into a view that reaches 17.5 mm")


def test_a_random_path_is_solved_once_for_all_lights():
    (whole,) = make_recipes(["wmb0i0"], "cpu-random", quality="draft", size_px=(64, 48))
    in_lights = in_drawn_lights(whole)
    assert whole.interpolated
    assert plan_generation(in_lights).solves.keys() == plan_generation((whole,)).solves.keys()
    assert plan_generation(in_lights[2:3]).solves.keys() == plan_generation((whole,)).solves.keys()
    assert "library_reach_mm" not in whole.configuration()


def test_a_library_reaches_as_far_as_the_poses_that_it_serves(recipe):
    poses = (Pose(depth_mm=0.2), Pose(depth_mm=0.4, point_id=1), Pose(depth_mm=0.9, twist_deg=5, point_id=2))
    whole = recipe.model_copy(update={"path": PosePath("turned", poses), "interpolated": True})
    assert in_drawn_lights(whole)[0].library_reach_mm == (0.2, 0.4, 0.0)


def test_lights_like_a_picture_are_nearer_to_it(recipe, monkeypatch):
    monkeypatch.setattr(drawn_lights, "CANDIDATES", 100)
    like = picture_in(recipe, Illumination.preset("i1"))

    def mean_distance(found):
        return np.mean([np.square(picture_in(recipe, one.illumination) - like).mean() for one in found])

    assert mean_distance(in_drawn_lights(recipe, like.astype(np.uint8), KINDS)) < 0.6 * mean_distance(
        in_drawn_lights(recipe, None, KINDS)
    )


def picture_in(recipe, light):
    renderer = MembraneRenderer(recipe.sensor, light, recipe.size_px, "draft")
    return renderer.reference(markers=False).astype(float)


@pytest.mark.parametrize("size_px", [(20, 15), (80, 45)])
def test_a_picture_that_is_too_small_or_of_other_proportions_is_refused(recipe, size_px):
    width, height = size_px
    with pytest.raises(ValueError, match=f"has {width}×{height} px: it must have the prop.* 64×48 px"):
        in_drawn_lights(recipe, np.zeros((height, width, 3), np.uint8))
