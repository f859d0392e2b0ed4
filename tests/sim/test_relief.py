"""Relief that is finer than the mesh: the gel is solved under what bridges it, and fills it by half-space theory."""

import numpy as np
import pytest

from gelgap.sim import Elastomer, MembraneState, Pose, Surface, solve_pose
from gelgap.sim.relief import filled_share

SPACING_MM, HALF_MM, RIM_MM = 0.04, 2.4, 0.6
LENGTH_MM = 0.4
GEL = Elastomer(young_modulus_mpa=0.3, poisson_ratio=0.48, thickness_mm=3.0, friction=0.1)


def punch(amplitude_mm: float) -> Surface:
    """A square punch with a round rim, and waves along x cut into its face."""
    count = round(HALF_MM / SPACING_MM)
    place = np.arange(-count, count + 1) * SPACING_MM
    x, y = np.meshgrid(place, place)
    face = HALF_MM - RIM_MM
    heights = amplitude_mm * (1 - np.cos(2 * np.pi * x / LENGTH_MM)) * (np.abs(x) < face)
    beyond = np.hypot(*(np.maximum(np.abs(along) - face, 0.0) for along in (x, y)))
    rise = RIM_MM - np.sqrt(np.maximum(RIM_MM**2 - beyond**2, 0.0))
    return Surface.of(np.where(beyond < RIM_MM, heights + rise, np.inf), SPACING_MM, height_mm=2.0)


def press(amplitude_mm: float) -> MembraneState:
    return solve_pose(GEL, punch(amplitude_mm), Pose(depth_mm=0.15), quality="draft")


@pytest.fixture(scope="module")
def waves(tmp_path_factory: pytest.TempPathFactory) -> MembraneState:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.mktemp("cache")))
        return press(0.05)


@pytest.mark.parametrize(
    ("load", "filled"), [(0.163, 0.337), (0.261, 0.467), (0.490, 0.713), (0.653, 0.842), (1.5, 0.999)]
)
def test_a_sinusoid_is_filled_as_by_finite_elements(load: float, filled: float) -> None:
    # felupe, plane strain: half a period of a rigid sinusoid on a bonded layer of 3 mm, ν = 0.48.
    assert filled_share(np.ones(1), np.array([load]))[0] == pytest.approx(filled, abs=0.015)


def test_the_gel_touches_a_sinusoid_where_it_carries() -> None:
    half = 0.5
    height = np.linspace(0.0, 1.0, 101)
    filled = filled_share(height, np.full(101, half))
    np.testing.assert_allclose(filled[height <= half], height[height <= half])
    assert (np.diff(filled) >= -1e-12).all()
    assert filled[-1] < height[-1]


def test_waves_finer_than_the_mesh_are_pressed_into_the_membrane(waves: MembraneState) -> None:
    row = waves.places_mm[len(waves.y_mm) // 2]
    middle = np.abs(row[:, 0]) < 1.0
    # Half-space theory at the mean pressure there, 0.036 MPa: 0.45 of the height; finite elements 0.436.
    assert np.ptp(row[middle, 2]) / 0.1 == pytest.approx(0.436, abs=0.15)
    assert waves.contact[len(waves.y_mm) // 2][middle].all()


def test_the_force_says_how_far_it_is_off_for_waves(waves: MembraneState) -> None:
    # In the mean the gel fills 0.026 of 0.05 mm: a press so much less deep is truly lighter, by a sixth.
    assert waves.diagnostics.coarse
    assert abs(waves.force_n[2]) == pytest.approx(0.6, abs=0.2)
    assert 0.1 < waves.error.force_n[2] / abs(waves.force_n[2]) < 0.3
