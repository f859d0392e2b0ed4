"""A closed-form dent, so that rendering is tested without physics, and renderers that tests share."""

from functools import cache

import pytest

from gelgap.benchmarks.render.scenes import sphere_dent
from gelgap.render.light.leds import Illumination
from gelgap.render.renderer import MembraneRenderer
from gelgap.render.sensor import Sensor


@cache
def paper_renderer(illumination="i0", size_px=(320, 240), quality="standard"):
    return MembraneRenderer(Sensor.preset("paper"), Illumination.preset(illumination), size_px, quality)


@pytest.fixture
def dent():
    return sphere_dent


@pytest.fixture
def renderer():
    return paper_renderer
