import pytest

from gelgap.domains.domain import Domain, known_domains
from gelgap.domains.recipe import make_recipes, own_recipe, preset_recipes
from gelgap.render import Sensor


def test_a_name_says_what_the_domain_is():
    assert Domain.parse("wmb1i2") == Domain("b1", "i2", markers=False)
    assert Domain.parse("mb0i0") == Domain("b0", "i0", markers=True)


def test_every_known_domain_is_found_by_its_name():
    assert all(Domain.parse(domain.name) == domain for domain in known_domains())


@pytest.mark.parametrize("name", ["", "mb9i0", "wmb0i0 "])
def test_an_unknown_name_lists_what_is_known(name: str):
    with pytest.raises(ValueError, match=r"unknown.*b0, b1, b2.*i0, i1, i2"):
        Domain.parse(name)


def test_the_papers_data_set_has_its_four_domains_and_frame_counts():
    frames = {recipe.name: len(recipe.path.poses) for recipe in preset_recipes("paper")}
    assert frames == {"mb0i0": 10830, "wmb0i0": 10830, "wmb1i1": 10830, "wmb2i2": 873}


def test_wmb0i0_is_inpainted_by_default_and_rendered_on_request():
    assert make_recipes(["wmb0i0"], "smoke")[0].inpainted_from == "mb0i0"
    assert make_recipes(["wmb0i0"], "smoke", inpainted=())[0].inpainted_from is None
    assert make_recipes(["wmb1i1"], "smoke")[0].inpainted_from is None


def test_own_is_the_light_of_the_sensors_own_file():
    (recipe,) = make_recipes(["wmb1own"], "smoke", sensor="digit-like")
    assert recipe.illumination == Sensor.preset("digit-like").illumination
    with pytest.raises(ValueError, match="'paper' has no LEDs of its own"):
        make_recipes(["mb0own"], "smoke")
    assert own_recipe("lit", "smoke", base="mb0own", illumination=recipe.illumination).markers


def test_a_preset_light_on_a_sensor_with_leds_of_its_own_is_noted(caplog: pytest.LogCaptureFixture):
    make_recipes(["wmb1own"], "smoke", sensor="digit-like")
    make_recipes(["wmb1i0"], "smoke")
    assert caplog.text == ""
    make_recipes(["wmb1own", "wmb1i0"], "smoke", sensor="digit-like")
    (said,) = caplog.messages
    assert said.startswith("wmb1i0: lit by the illumination preset")
    assert said.endswith("the LEDs of sensor digit-like itself: those light wmb1own")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"domains": [], "path": "smoke"}, "at least one"),
        ({"domains": ["mb0i0", "mb0i0"], "path": "smoke"}, "twice"),
        ({"domains": ["mb0i0"], "path": "no-such"}, "known presets"),
        ({"domains": ["mb0i0"], "path": "smoke", "seed": -1}, "seed = -1.*greater than or equal to 0"),
        ({"domains": ["mb0i0"], "path": "smoke", "columns": ["depth_map"]}, "columns.*height_map"),
        ({"domains": ["mb0i0"], "path": "smoke", "size_px": (8, 6)}, "size_px"),
    ],
)
def test_bad_input_is_refused_with_a_sentence(arguments: dict, message: str):
    with pytest.raises(ValueError, match=message):
        make_recipes(**arguments)
