"""Relief that is finer than the mesh: the gel is solved under what bridges it, and fills it by half-space theory."""

import numpy as np
import pytest

from gelgap.sim import Elastomer, MembraneState, Pose, Surface, solve_pose
from gelgap.sim.plan import plan_visit
from gelgap.sim.relief import filled_share, recesses_of, unbridged

SPACING_MM, HALF_MM, RIM_MM = 0.04, 2.4, 0.6
LENGTH_MM = 0.4
GEL = Elastomer(young_modulus_mpa=0.3, poisson_ratio=0.48, thickness_mm=3.0, friction=0.1)


def punch(amplitude_mm: float, length_mm: float = LENGTH_MM) -> Surface:
    """A square punch with a round rim, and waves along x cut into its face."""
    count = round(HALF_MM / SPACING_MM)
    place = np.arange(-count, count + 1) * SPACING_MM
    x, y = np.meshgrid(place, place)
    face = HALF_MM - RIM_MM
    heights = amplitude_mm * (1 - np.cos(2 * np.pi * x / length_mm)) * (np.abs(x) < face)
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


def test_the_gel_sinks_into_a_sinusoid_by_the_mean_of_what_fills_it() -> None:
    height = (1 - np.cos(np.linspace(0, np.pi, 20_001))) / 2
    for load in (0.03, 0.2, 0.7, 1.0):
        mean = filled_share(height, np.full(len(height), load)).mean()
        assert mean == pytest.approx(load * (1 - np.log(load)) / 2, abs=2e-4)


def test_waves_finer_than_the_mesh_are_pressed_into_the_membrane(waves: MembraneState) -> None:
    row = waves.places_mm[len(waves.y_mm) // 2]
    middle = np.abs(row[:, 0]) < 1.0
    # Half-space theory at the mean pressure there, 0.025 MPa: 0.34 of the height; felupe, plane strain: 0.35.
    assert np.ptp(row[middle, 2]) / 0.1 == pytest.approx(0.35, abs=0.05)
    assert waves.contact[len(waves.y_mm) // 2][middle].all()


def test_waves_make_a_punch_lighter_as_finite_elements_do(waves: MembraneState) -> None:
    # felupe, plane strain, of a punch of this section: 0.855 of the force of one without waves.
    share = waves.force_n[2] / press(0.0).force_n[2]
    assert share == pytest.approx(0.855, abs=0.03)
    assert not waves.diagnostics.coarse
    assert 0.01 < waves.error.force_n[2] / abs(waves.force_n[2]) < 0.03


def test_a_press_settles_where_a_vertex_stands_on_the_rim_of_recesses() -> None:
    assert solve_pose(GEL, punch(0.1, 1.2), Pose(depth_mm=0.15), quality="draft").converged


@pytest.mark.parametrize(("length_mm", "shown"), [(0.16, 0.0), (0.4, 1.0)])
def test_waves_too_short_for_the_grid_are_put_in_by_their_mean(length_mm: float, shown: float) -> None:
    # Sampled every 0.1 mm, waves of 0.16 mm would be waves of 0.27.
    problem = plan_visit(GEL, punch(0.02, length_mm), (Pose(depth_mm=0.15),), "draft").solves[0].problem
    found = recesses_of(problem)
    assert np.median(found.shown[found.depth_mm > 0]) == shown
    x = np.arange(0.0, 1.2, 0.1)
    points = np.stack([x, 0 * x, np.full_like(x, -problem.indenter.origin_height_mm)], axis=-1)
    filled_mm = found.fill(points, problem.indenter, np.full(len(x), 0.02))[:, 2]
    assert np.ptp(filled_mm) / filled_mm.mean() < 0.1 or shown


def test_waves_that_the_mesh_serves_are_bridged_all_the_same() -> None:
    plan = plan_visit(GEL, punch(0.02), (Pose(depth_mm=0.15),), "draft")
    problem = plan.solves[0].problem
    assert problem.relief == punch(0.02)
    assert unbridged(problem).indenter == punch(0.02)
    smooth = plan_visit(GEL, punch(0.0), (Pose(depth_mm=0.15),), "draft")
    assert smooth.solves[0].problem.relief is None
