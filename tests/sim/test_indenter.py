"""Indenters: what the sphere answers, and that another shape, which only this file knows, is pressed as it should."""

from typing import ClassVar

import numpy as np
import pytest

from gelgap.sim.indenter import Floats, Projection, Sphere, Symmetry
from gelgap.sim.press import solve_pose, solve_poses
from gelgap.sim.problem import ContactProblem
from gelgap.sim.scene import Elastomer, Pose, Scene, Sharing, canonical_frame

GEL = Elastomer(young_modulus_mpa=0.3, poisson_ratio=0.47, friction=0.5)
ALONE = Sharing(cache=False)


class Capsule(Sphere):
    """A sphere drawn out along x: a cylinder with round ends."""

    shape: ClassVar[str] = "capsule"

    length_mm: float = 1.0

    @property
    def symmetry(self) -> Symmetry:
        return Symmetry.MIRROR

    @property
    def label(self) -> str:
        return f"capsule {self.diameter_mm:g} × {self.length_mm:g} mm"

    @property
    def mujoco_geom(self) -> str:
        half = self.length_mm / 2
        return f'type="capsule" size="{self.radius_mm:.12g}" fromto="{-half:.12g} 0 0 {half:.12g} 0 0"'

    def penetration_radius_mm(self, depth_mm: float) -> float:
        return self.length_mm / 2 + super().penetration_radius_mm(depth_mm)

    def cut_mm(self, depth_mm: float) -> Floats:
        along_mm, across_mm = self.penetration_radius_mm(depth_mm), super().penetration_radius_mm(depth_mm)
        return np.array([[-along_mm, along_mm], [-across_mm, across_mm]])

    def project(self, points_mm: Floats) -> Projection:
        axis = np.zeros_like(points_mm)
        axis[..., 0] = np.clip(points_mm[..., 0], -self.length_mm / 2, self.length_mm / 2)
        from_axis = super().project(points_mm - axis)
        return from_axis._replace(points_mm=axis + from_axis.points_mm)


def test_a_sphere_projects_points_onto_itself_along_its_radius() -> None:
    found = Sphere(diameter_mm=4.0).project(np.array([[0.0, 0.0, -1.0], [0.0, 3.0, 4.0]]))
    np.testing.assert_allclose(found.points_mm, [[0, 0, -2], [0, 1.2, 1.6]])
    np.testing.assert_allclose(found.outward_normal, [[0, 0, -1], [0, 0.6, 0.8]])
    np.testing.assert_allclose(found.distance_mm, [-1, 3])


def test_a_sphere_cuts_the_membrane_in_a_circle_that_grows_to_its_equator() -> None:
    sphere = Sphere(diameter_mm=4.0)
    radii = [sphere.penetration_radius_mm(depth) for depth in (0.0, 0.4, 2.0)]
    assert radii == pytest.approx([0.0, 1.2, 2.0])
    assert sphere.deepest_mm == 2.0


def test_a_spheres_json_is_its_diameter_alone() -> None:
    assert Sphere(diameter_mm=4.0).model_dump(mode="json") == {"diameter_mm": 4.0}


def test_problems_of_different_shapes_have_different_keys() -> None:
    keys = {
        ContactProblem.of(Scene(GEL, indenter, "draft", ALONE), None, ((0, 0, -0.2),), (-1,)).key
        for indenter in (Sphere(), Sphere(diameter_mm=3.1), Capsule(), Capsule(length_mm=1.1))
    }
    assert len(keys) == 4


@pytest.mark.parametrize(
    ("indenter", "to_sensor"), [(Sphere(), [[0, 1], [-1, 0]]), (Capsule(), [[1, 0], [0, -1]])]
)
def test_only_a_body_of_revolution_is_turned(indenter: Sphere, to_sensor: list[list[float]]) -> None:
    pose = Pose(depth_mm=0.2, shear_y_mm=-0.1, point_x_mm=0.5)
    frame = canonical_frame(Scene(GEL, indenter, "draft", ALONE), pose)
    assert frame.pad_mm is None
    np.testing.assert_allclose(frame.to_sensor, to_sensor, atol=1e-12)


@pytest.mark.usefixtures("coarse")
def test_another_shape_is_pressed_and_dragged_as_it_should() -> None:
    along, across = (
        solve_poses(GEL, Capsule(), (Pose(depth_mm=0.4), Pose(depth_mm=0.4, **travel)), "draft")
        for travel in ({"shear_x_mm": 0.1}, {"shear_y_mm": 0.1})
    )
    assert all(state.converged for state in (*along, *across))
    sphere = solve_pose(GEL, Sphere(), Pose(depth_mm=0.4), "draft")
    assert 1.2 < along[0].force_n[2] / sphere.force_n[2] < 2.5
    assert along[0].force_n[2] == pytest.approx(across[0].force_n[2], rel=0.03)
    assert along[1].force_n[0] > 0.02
    assert across[1].force_n[1] > 0.02
    assert np.ptp(along[0].x_mm[along[0].contact.any(axis=0)]) > 0.5 + np.ptp(
        along[0].y_mm[along[0].contact.any(axis=1)]
    )
