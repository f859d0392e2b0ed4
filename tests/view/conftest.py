"""A library in closed form, so that the live model is tested without a solver."""

import numpy as np
import pytest

from gelgap.render import Illumination, Sensor
from gelgap.sim import Elastomer, PoseLibrary, Sphere
from gelgap.sim.library import _GROWTH, _LARGEST_OF
from gelgap.sim.membrane import _SECTORS, table_radius_mm
from gelgap.view.state import Configuration, LibraryRequest, LiveModel

RADIUS_MM = table_radius_mm(np.arange(90.0))


def _dent(depth_mm: float, travel_mm: float) -> np.ndarray:
    """Return the polar table of a smooth dent that is dragged along x."""
    bell = np.exp(-((RADIUS_MM / 1.2) ** 2))[:, None] * np.ones(_SECTORS + 1)
    return np.stack([0.5 * travel_mm * bell, 0 * bell, -depth_mm * bell], axis=-1).astype(np.float32)


@pytest.fixture(scope="session")
def dents() -> PoseLibrary:
    """Forces are −10 d^1.5 N along z per MPa, and half of that along x at the farthest travel."""
    plan = LibraryRequest(Elastomer.preset("e04"), Sphere()).plan
    depths = np.array(plan.depths_mm)
    travels = np.array([plan.travels_mm(depth) for depth in depths])
    displacement = np.array(
        [[_dent(depth, travel) for travel in row] for depth, row in zip(depths, travels, strict=True)]
    )
    share, press = travels / travels[0, -1], np.ones_like(travels)
    numbers = {
        "force_n": np.stack([5 * share, 0 * share, -10 * press], axis=-1),
        "torque_n_mm": np.zeros((*travels.shape, 3)),
        "contact_radius_mm": press,
        "mount_mm": np.zeros((*travels.shape, 3)),
        "errors": np.zeros((*travels.shape, 4)),
        "converged": np.ones(travels.shape, bool),
        "coarse": np.zeros(travels.shape, bool),
    }
    numbers = dict.fromkeys((*_GROWTH, *_LARGEST_OF), 0 * press) | numbers
    return PoseLibrary(plan, depths, displacement, -displacement[..., 2:], numbers)


@pytest.fixture(scope="session")
def start() -> Configuration:
    return Configuration(Elastomer.preset("e04"), Sensor.preset("paper"), Illumination.preset("i0"))


@pytest.fixture
def model(dents: PoseLibrary, start: Configuration) -> LiveModel:
    model = LiveModel()
    model.add_library(start.library, dents)
    return model
