"""A set of presses that gelgap itself rendered, in place of a published one, on membranes that need no solve."""

import numpy as np
import pytest

from gelgap.benchmarks.render.scenes import sphere_dent
from gelgap.domains import PressSet
from gelgap.domains.calibration_presses import start_sensor
from gelgap.render import MembraneRenderer, PressPicture, PressProfiles, Sensor, SolvedPress

RADIUS_MM, DEPTH_MM, SIZE_PX, EXTENT_MM = 2.0, 1.0, (160, 120), (10.5, 8.2)


@pytest.fixture(scope="session")
def profiles():
    """What `sphere_profiles` would solve, by diameter."""
    solves = []
    for depth in (0.2, 0.5, 0.8, 1.1, 1.4):
        x, y, displacement = sphere_dent(depth, half_extent_mm=EXTENT_MM, radius_mm=RADIUS_MM)
        along = displacement[len(y) // 2, len(x) // 2 :, 2]
        solves.append(SolvedPress(depth, x[len(x) // 2 :], along, min((depth * RADIUS_MM) ** 0.5, 1.8)))
    ball = PressProfiles.from_solves(RADIUS_MM, solves)
    return lambda diameters, deepest=None: {d: ball.scaled(d / 2 / RADIUS_MM) for d in diameters}


@pytest.fixture(scope="session")
def rendered_set(profiles):
    """Fourteen presses of one ball."""
    sensor = Sensor.preset("gelsight-r1-fitted")
    renderer = MembraneRenderer(sensor, sensor.illumination, SIZE_PX)
    own, mm_per_px = profiles({2 * RADIUS_MM})[2 * RADIUS_MM], 18.88 / SIZE_PX[0]
    rng = np.random.default_rng(0)
    presses = []
    for number, point in enumerate(rng.uniform((-5, -3), (5, 3), (14, 2))):
        picture = renderer.picture(*own.membrane(tuple(point), DEPTH_MM, EXTENT_MM))
        center = sensor.camera.project_px((*point, 0.0), SIZE_PX) - 0.5
        radius = own.contact_radius_mm(DEPTH_MM) / mm_per_px
        mark = {"center_px": tuple(center), "radius_px": radius, "name": f"press {number}"}
        presses.append(PressPicture(picture, 2 * RADIUS_MM, **mark))
    start = start_sensor(640, np.radians([0.0, -120.0, 120.0]))
    return PressSet(renderer.reference(), tuple(presses), start)
