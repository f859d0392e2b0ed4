"""The sensor in a loop: friction's memory as far as it is honoured, flags, and Gymnasium's own checks."""

from pathlib import Path

import numpy as np
import pytest
from loaded_file import load_file

from gelgap.domains import TactileSensor
from gelgap.sim import Elastomer

HOLD_FORCE = Path(__file__).parents[2] / "examples" / "hold_force.py"
GEL = Elastomer(young_modulus_mpa=0.3, poisson_ratio=0.49, friction=0.3)


@pytest.fixture(scope="module")
def shared(few_solves: None, solve_cache: None) -> TactileSensor:
    return TactileSensor(GEL, deepest_mm=0.1, farthest_mm=0.15, size_px=(48, 36))


@pytest.fixture
def sensor(shared: TactileSensor) -> TactileSensor:
    shared.reset()
    return shared


def test_a_depth_below_0_is_refused() -> None:
    with pytest.raises(ValueError, match="deepest_mm = -1: must be above 0"):
        TactileSensor(GEL, deepest_mm=-1)


def test_a_press_gives_picture_force_and_error(sensor: TactileSensor) -> None:
    nothing, pressed = sensor.step(0.0), sensor.step(0.08)
    assert not nothing.force_n.any()
    assert pressed.force_n[2] < 0 < pressed.force_error_n[2]
    assert pressed.state.contact.any()
    assert np.abs(pressed.picture.astype(int) - nothing.picture).max() > 3


def test_sliding_drags_the_anchor_along_and_a_way_back_is_another_way(sensor: TactileSensor) -> None:
    forces = [sensor.step(0.08, (x, 0.0)) for x in (0.0, 0.02, 0.06, 0.1, 0.14, 0.1, 0.06)]
    out, back = forces[2].force_n[0], forces[-1].force_n[0]
    assert forces[1].force_n[0] > 0
    assert "slides" in forces[4].flags
    assert forces[4].force_n[0] <= 1.1 * GEL.friction * -forces[4].force_n[2]
    assert back < 0.9 * out
    sensor.step(0.0, (0.08, 0.0))
    assert abs(sensor.step(0.08, (0.0, 0.0), (0.08, 0.0)).force_n[0]) < 1e-4


def test_a_direction_turned_turns_the_force(sensor: TactileSensor) -> None:
    sensor.step(0.08)
    along_x = sensor.step(0.08, (0.02, 0.0)).force_n
    sensor.reset()
    sensor.step(0.08)
    along_y = sensor.step(0.08, (0.0, 0.02)).force_n
    np.testing.assert_allclose(along_y, along_x[[1, 0, 2]], atol=1e-6)


def test_a_place_that_is_not_reached_leaves_the_sensor_as_it_was(sensor: TactileSensor) -> None:
    before = sensor.step(0.08, (0.02, 0.0)).force_n
    with pytest.raises(ValueError, match=r"depth_mm = 0\.3: the library ends at 0\.1 mm"):
        sensor.step(0.3, (0.02, 0.0))
    with pytest.raises(
        ValueError, match=r"shear_mm = 0\.02, point_mm = \(0\.0, 0\.0\): each must be \(x, y\)"
    ):
        sensor.step(0.08, 0.02)
    np.testing.assert_array_equal(sensor.step(0.08, (0.02, 0.0)).force_n, before)


def test_shallower_than_the_library_is_said(sensor: TactileSensor) -> None:
    assert "extrapolated" in sensor.step(0.005).flags
    assert "extrapolated" not in sensor.step(0.05).flags


@pytest.mark.parametrize("task", ["hold", "slide"])
def test_gymnasium_accepts_the_environment(sensor: TactileSensor, task: str) -> None:
    pytest.importorskip("gymnasium")
    from gymnasium.utils.env_checker import check_env

    check_env(load_file(HOLD_FORCE).PressEnv(sensor, task))


def test_each_task_rewards_what_it_is_for(sensor: TactileSensor) -> None:
    pytest.importorskip("gymnasium")
    PressEnv = load_file(HOLD_FORCE).PressEnv
    hold = PressEnv(sensor, "hold")
    hold.reset(seed=1)
    rewards = [hold.step(np.array([1.0, 0, 0]))[1] for _ in range(2)]
    assert rewards[0] < 0
    hold.reset(seed=1)
    hold.step(np.array([0.0, 1.0, 0]))  # through the air
    assert abs(hold.step(np.array([1.0, 0, 0]))[-1]["force_n"][0]) < 1e-4
    slide = PressEnv(sensor, "slide", targets=(0.5, 0.5))
    slide.reset(seed=1)
    assert slide.step(np.full(3, np.nan))[-1]["refused"]
    flown = [slide.step(np.array([depth, 1.0, 0]))[1:3] for depth in [0.0] * 11 + [1.0]]
    assert flown[-1] == (0.0, False)
    slide.reset(seed=1)
    slide.step(np.array([1.0, 0, 0]))
    steps = [slide.step(np.array([0.0, 1.0, 0])) for _ in range(4)]
    assert steps[-1][1] == -1.0
    assert steps[-1][2]
    with pytest.raises(ValueError, match="task = 'win'"):
        PressEnv(sensor, "win")
