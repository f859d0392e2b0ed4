"""Traction maps: their integrals are force and torque, and they are where the indenter presses and drags."""

from pathlib import Path

import numpy as np
import pytest

from gelgap.sim import Elastomer, Pose, Sphere
from gelgap.sim.plan import plan_visit
from gelgap.sim.solution import solution_bytes, solution_from_bytes
from gelgap.sim.traction import Traction

pytestmark = pytest.mark.numerical

GEL = Elastomer(young_modulus_mpa=0.6, poisson_ratio=0.47, friction=0.4)
POSES = (Pose(depth_mm=0.3), Pose(depth_mm=0.3, shear_x_mm=-0.05, shear_y_mm=0.2))


@pytest.fixture(scope="module")
def maps() -> tuple[Traction, ...]:
    plan = plan_visit(GEL, Sphere(), POSES, "draft")
    solution = solution_from_bytes(solution_bytes(plan.solves[0].run()))
    solutions = {plan.solves[0].key: solution}
    return tuple(plan.state(index, solutions).traction() for index in range(len(POSES)))


def test_a_maps_integrals_are_force_and_torque(maps: tuple[Traction, ...]) -> None:
    for found in maps:
        np.testing.assert_allclose(found.force_n, found.state.force_n, atol=1e-9)
        np.testing.assert_allclose(found.torque_n_mm, found.state.torque_n_mm, atol=1e-9)
        np.testing.assert_allclose(found.coarse_n().sum(axis=(0, 1)), found.state.force_n, atol=1e-9)
        assert found.correction < 0.03


def test_a_press_has_no_torque_and_a_drag_has_that_of_its_force(maps: tuple[Traction, ...]) -> None:
    press, drag = (found.state for found in maps)
    np.testing.assert_allclose(press.torque_n_mm, 0.0, atol=1e-3 * abs(press.force_n[2]))
    # The indenter, and with it the pressure, has gone sideways by the travel, or a little less.
    travel = np.array([-0.05, 0.2])
    arm = drag.torque_n_mm[:2] @ [travel[1], -travel[0]] / (drag.force_n[2] * (travel @ travel))
    assert 0.3 < arm < 1.1


def test_friction_is_within_coulombs_bound_where_the_pressure_is(maps: tuple[Traction, ...]) -> None:
    found = maps[1]
    pressed = found.normal_mpa > 0.2 * found.normal_mpa.max()
    assert found.state.contact[pressed].mean() > 0.95
    ratio = found.tangential_mpa[pressed] / found.normal_mpa[pressed]
    assert ratio.max() < 1.3 * GEL.friction
    assert np.median(ratio) > 0.5 * GEL.friction


def test_a_map_can_be_saved(maps: tuple[Traction, ...], tmp_path: Path) -> None:
    maps[1].save(tmp_path / "map.npz")
    with np.load(tmp_path / "map.npz") as arrays:
        assert arrays["coarse_n"].shape == (24, 32, 3)
        force = (arrays["traction_mpa"] * arrays["area_mm2"][..., None]).sum(axis=(0, 1))
    np.testing.assert_allclose(force, maps[1].state.force_n, atol=1e-9)
