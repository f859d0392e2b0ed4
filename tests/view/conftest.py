"""A path in closed form, so that the live model is tested without a solver."""

import numpy as np
import pytest

from gelgap.render import Illumination, Sensor
from gelgap.sim import PATH_DEPTHS_MM, PATH_TRAVELS_MM, Elastomer, SolvedPath, Sphere
from gelgap.sim.membrane import _SECTORS, table_radius_mm
from gelgap.view import Configuration, LiveModel
from gelgap.view.state import PathRequest

ROWS = 90


def _dent(depth_mm: float, travel_mm: float) -> np.ndarray:
    """Return the polar table of a smooth dent that is dragged along x."""
    radius = table_radius_mm(np.arange(ROWS))
    bell = np.exp(-((radius / 1.2) ** 2))[:, None] * np.ones(_SECTORS + 1)
    return np.stack([0.5 * travel_mm * bell, 0 * bell, -depth_mm * bell], axis=-1).astype(np.float32)


@pytest.fixture(scope="session")
def dent_path() -> SolvedPath:
    """Forces are −10 d^1.5 N along z per MPa and half the travel along x."""
    depths, travels = np.array([0.0, *PATH_DEPTHS_MM]), np.array(PATH_TRAVELS_MM)
    shape = (len(depths), len(travels))
    force = np.zeros((*shape, 3))
    force[..., 0] = 0.5 * travels * (depths > 0)[:, None]
    force[..., 2] = -10 * depths[:, None] ** 1.5
    indenter = np.zeros((*shape, 3))
    indenter[..., 0], indenter[..., 2] = travels, -depths[:, None]
    displacement = np.stack([[_dent(depth, travel) for travel in travels] for depth in depths])
    return SolvedPath(
        Sphere(),
        depths,
        travels,
        displacement,
        -displacement[..., 2:],
        indenter,
        force,
        np.zeros_like(force),
        np.sqrt(depths)[:, None] * np.ones(shape),
        np.ones(shape, bool),
        np.zeros(shape, bool),
        np.zeros((*shape, 4)),
    )


@pytest.fixture(scope="session")
def start() -> Configuration:
    return Configuration(Elastomer.preset("e04"), Sensor.preset("paper"), Illumination.preset("i0"))


@pytest.fixture
def model(dent_path: SolvedPath, start: Configuration) -> LiveModel:
    model = LiveModel()
    model.add_path(PathRequest(start.elastomer, start.indenter), dent_path)
    return model
