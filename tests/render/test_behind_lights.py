"""A view that reaches behind the LEDs: where no light arrives, none can be shared."""

import numpy as np
import pytest

from gelgap.benchmarks.render.scenes import sphere_dent
from gelgap.render import Illumination, MembraneRenderer, Sensor

pytestmark = pytest.mark.numerical


def test_a_large_sphere_is_rendered_where_the_view_reaches_behind_the_lights():
    sensor = Sensor.preset("gelsight-2014-like")
    wide = sensor.camera.model_copy(update={"horizontal_field_of_view_deg": 78.0})
    light = Illumination.preset("i0")
    renderer = MembraneRenderer(sensor.model_copy(update={"camera": wide}), light, (64, 48), "draft")
    beyond_mm = max(abs(led.position_mm[0]) for led in light.leds)
    assert renderer.lattice.x_mm[-1] > beyond_mm
    for point_mm in ((-14.0, 0.0), (14.0, 0.0)):
        dent = sphere_dent(1.6, point_mm=point_mm, half_extent_mm=(22.0, 17.0), radius_mm=10.5)
        assert np.isfinite(renderer.linear(*dent)).all()
