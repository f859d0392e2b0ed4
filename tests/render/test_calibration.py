"""Contacts are found in pictures."""

import numpy as np
import pytest

from gelgap.render.calibration.pictures import find_contact_mm


@pytest.mark.parametrize("light", ["i0", "i1"])
def test_a_contact_is_found_in_the_picture(renderer, dent, light):
    render = renderer(light)
    found = find_contact_mm(
        render.picture(*dent(0.7, point_mm=(2.0, -1.0))), render.reference(), render.sensor.camera
    )
    assert np.hypot(found[0] - 2, found[1] + 1) < 0.15
