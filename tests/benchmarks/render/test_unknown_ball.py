"""The benchmark of a set with an unknown ball, in parts, on membranes that need no solve."""

from dataclasses import replace

import numpy as np

from gelgap.benchmarks.render.sensors import scores
from gelgap.benchmarks.render.unknown_ball import sharp
from gelgap.domains import PressSet
from gelgap.domains.calibration_presses import start_sensor
from gelgap.render import PressPicture


def test_contacts_are_scored_by_what_lies_inside() -> None:
    real = np.zeros((40, 60, 3), np.uint8)
    predicted = real.copy()
    predicted[20, 30] = 10
    predicted[2, 2] = 200
    marked = PressPicture(real, 1.4, radius_px=10.0, center_px=(30.0, 20.0))
    levels = scores(predicted, marked, replace(marked, radius_px=4.0))
    pixels = (np.hypot(*(np.indices((9, 9)) - 4)) < 4).sum()
    assert np.isclose(levels["contact"], 10 * np.log10(255**2 * pixels / 10**2))


def test_a_sharp_camera_differs_in_nothing_else() -> None:
    start = start_sensor(60, np.zeros(3))
    blurred = start.camera.model_copy(update={"point_spread_px": 1.7})
    found = PressSet(np.zeros((40, 60, 3), np.uint8), (), start.model_copy(update={"camera": blurred}))
    assert sharp(found).start == start
