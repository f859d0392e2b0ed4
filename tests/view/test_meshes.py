"""Meshes that are saved hold membrane, picture and indenter, in the units that their formats ask for."""

from pathlib import Path

import numpy as np
import pytest
import trimesh

from gelgap.render import Camera
from gelgap.sim import Elastomer, Pose, PoseLibrary, Sphere
from gelgap.sim.library import LibraryPose
from gelgap.view import save_mesh
from gelgap.view.meshes import coloured_mesh, membrane_mesh


@pytest.fixture(scope="module")
def solved(dents: PoseLibrary) -> LibraryPose:
    return dents.pose(Elastomer.preset("e04"), Pose(depth_mm=0.6, shear_x_mm=0.2))


PICTURE = np.zeros((240, 320, 3), np.uint8)
PICTURE[:, :160, 0] = 255


@pytest.mark.parametrize("suffix", [".glb", ".ply"])
def test_a_saved_mesh_reads_back(suffix: str, solved: LibraryPose, tmp_path: Path) -> None:
    path = tmp_path / f"out{suffix}"
    save_mesh(path, solved, (1.0, 0.0), Sphere(diameter_mm=3.0), Camera(), PICTURE)
    corners = trimesh.load_scene(path).to_mesh().vertices
    if suffix == ".glb":  # in metres, y up
        corners = corners[:, [0, 2, 1]] * [1e3, -1e3, 1e3]
    low, high = corners.min(axis=0), corners.max(axis=0)
    # The camera sees 12 × 9 mm; the sphere's top is 3 mm above where it touches.
    assert high[0] - low[0] == pytest.approx(12.0, abs=0.3)
    assert high[1] - low[1] == pytest.approx(9.0, abs=0.3)
    assert low[2] == pytest.approx(solved.displacement_mm[..., 2].min(), abs=0.01)
    assert high[2] == pytest.approx(3.0 - 0.6, abs=1e-3)


def test_the_picture_lies_where_the_camera_sees_it(solved: LibraryPose) -> None:
    mesh = membrane_mesh(solved, Camera(), PICTURE)
    colours = mesh.visual.to_color().vertex_colors[:, 0]
    left = mesh.vertices[:, 0]
    assert (colours[left < -1.0] > 250).all()
    assert (colours[left > 1.0] < 5).all()
    assert (mesh.face_normals[:, 2] > 0).all()


def test_colours_show_values(solved: LibraryPose) -> None:
    depth = -solved.displacement_mm[..., 2]
    mesh = coloured_mesh(solved, depth, float(depth.max()), every=2)
    brightness = mesh.visual.to_color().vertex_colors[:, :3].sum(axis=1)
    assert np.argmax(brightness) == pytest.approx(np.argmin(mesh.vertices[:, 2]), abs=2 * 71)


def test_another_format_is_refused(solved: LibraryPose, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"must end in \.glb or \.ply"):
        save_mesh(tmp_path / "out.stl", solved, (0.0, 0.0), Sphere(), Camera(), PICTURE)
