"""A renderer that is relit gives the pictures of one made anew."""

from collections.abc import Callable

import numpy as np
import pytest

from gelgap.benchmarks.render.scenes import sphere_dent
from gelgap.render import Illumination, MembraneRenderer, Sensor
from gelgap.render import renderer as module

pytestmark = pytest.mark.numerical

SIZE_PX = (64, 48)
FITTED = Sensor.preset("gelsight-mini-fitted")


def first_led(light: Illumination, **values: object) -> Illumination:
    first, *others = light.leds
    return light.model_copy(update={"leds": (first.model_copy(update=values), *others)})


CHANGES: dict[str, Callable[[Illumination], Illumination]] = {
    "drive": lambda light: first_led(light, drive=3 * light.leds[0].drive),
    "place": lambda light: first_led(light, position_mm=(-9.0, 1.0, -5.0)),
    "fewer LEDs": lambda light: light.model_copy(update={"leds": light.leds[1:]}),
    "no scattered light": lambda light: light.model_copy(update={"scattered": None}),
}


@pytest.mark.parametrize("change", CHANGES)
def test_it_is_like_one_made_anew(change: str) -> None:
    sensor, light = FITTED, FITTED.illumination
    membrane, other = sphere_dent(0.6), CHANGES[change](light)
    before = MembraneRenderer(sensor, light, SIZE_PX, "draft")
    picture = before.picture(*membrane)
    relit = before.relit(other).picture(*membrane)
    np.testing.assert_array_equal(relit, MembraneRenderer(sensor, other, SIZE_PX, "draft").picture(*membrane))
    np.testing.assert_array_equal(before.picture(*membrane), picture)


@pytest.mark.parametrize(("drive", "said"), [(0.0, "hardly any light"), (1e5, "is saturated")])
def test_that_nothing_is_seen_is_said(drive: float, said: str, caplog: pytest.LogCaptureFixture) -> None:
    light = Illumination.preset("i0").model_copy(update={"leds": Illumination.preset("i0").leds[:1]})
    renderer = MembraneRenderer(Sensor.preset("paper"), light, SIZE_PX, "draft")
    renderer.reference()
    assert not caplog.messages
    renderer.relit(first_led(light, drive=drive)).reference()
    assert said in caplog.text


def test_colours_alone_need_no_light_on_the_undeformed_membrane(monkeypatch: pytest.MonkeyPatch) -> None:
    before = MembraneRenderer(Sensor.preset("paper"), Illumination.preset("i0"), SIZE_PX, "draft")
    monkeypatch.setattr(module, "direct_light", None)
    assert before.relit(CHANGES["drive"](before.illumination)).illumination != before.illumination
