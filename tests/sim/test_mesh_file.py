"""Bodies from files: what the gel reaches is pressed, at its size in mm; what is not served is refused."""

import re
from pathlib import Path

import numpy as np
import pytest
import trimesh
from trimesh.intersections import slice_faces_plane

from gelgap.sim import Box, ConvexMesh, Cylinder, load_indenter
from gelgap.sim.indenter import Symmetry


def moved(mesh: trimesh.Trimesh, z: float, scale: float = 1.0) -> trimesh.Trimesh:
    mesh = mesh.copy()
    mesh.apply_scale(scale)
    mesh.apply_translation([0, 0, z])
    return mesh


def overturned(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    return trimesh.Trimesh(mesh.vertices * [1, -1, -1], mesh.faces)


def y_up(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """Return a body in metres with y up, as Blender writes glTF."""
    return trimesh.Trimesh(1e-3 * mesh.vertices[:, [0, 2, 1]] * [1, 1, -1], mesh.faces)


def some(mesh: trimesh.Trimesh, faces: np.ndarray) -> trimesh.Trimesh:
    return trimesh.Trimesh(mesh.vertices, mesh.faces[faces])


BALL = trimesh.creation.icosphere(subdivisions=3, radius=2)
BOX = moved(trimesh.creation.box((4, 3, 10)), 5)
STEM = moved(trimesh.creation.cylinder(radius=1.5, height=6, sections=96), 3)
PLATE = moved(trimesh.creation.box((16, 16, 4)), 8)
TIP = trimesh.util.concatenate([STEM, PLATE])
HALF = trimesh.Trimesh(*slice_faces_plane(BALL.vertices, BALL.faces, [0, 0, -1], [0, 0, 0])[:2])
SEAMS = trimesh.Trimesh(
    BOX.triangles.reshape(-1, 3),
    np.arange(36).reshape(-1, 3),
    vertex_normals=np.repeat(BOX.face_normals, 3, axis=0),
    process=False,
)
SHELL = trimesh.util.concatenate([BALL, trimesh.creation.icosphere(subdivisions=1, radius=1)])
# Quads with texture and normals of their own at each corner, as Blender writes them.
CUBE_OBJ = "\n".join(
    [
        *(f"v {x} {y} {z}" for x in (-2, 2) for y in (-2, 2) for z in (0, 4)),
        *(f"vt {u} {v}" for u in (0, 0.3, 0.7) for v in (0, 1)),
        *("vn -1 0 0", "vn 1 0 0", "vn 0 -1 0", "vn 0 1 0", "vn 0 0 -1", "vn 0 0 1"),
        *("f 1/1/1 2/2/1 4/3/1 3/4/1", "f 5/2/2 7/3/2 8/4/2 6/5/2", "f 1/1/3 5/2/3 6/3/3 2/6/3"),
        *("f 3/5/4 4/6/4 8/1/4 7/2/4", "f 1/2/5 3/4/5 7/6/5 5/1/5", "f 2/1/6 6/5/6 8/3/6 4/2/6"),
    ]
)


@pytest.mark.parametrize(
    ("name", "body", "fields", "size_mm"),
    [
        ("box.stl", BOX, {}, (4, 3, 10)),
        ("rounded.stl", BOX, {"edge_radius_mm": 0.4}, (4, 3, 10)),
        ("metres.stl", moved(BOX, 0, 1e-3), {"unit": "m"}, (4, 3, 10)),
        ("metres.glb", y_up(BOX), {}, (4, 3, 10)),
        ("inch.stl", moved(BOX, 0, 1 / 25.4), {"unit": "inch"}, (4, 3, 10)),
        ("seams.ply", SEAMS, {}, (4, 3, 10)),
        ("blender.obj", CUBE_OBJ, {}, (4, 4, 4)),
        ("inside-out.stl", trimesh.Trimesh(BOX.vertices, BOX.faces[:, ::-1]), {}, (4, 3, 10)),
        ("bodies.glb", trimesh.Scene([y_up(STEM), y_up(PLATE)]), {}, (3, 3, 6)),
        ("tip.stl", TIP, {}, (3, 3, 6)),
        ("tip-up.stl", overturned(TIP), {"flip": True}, (3, 3, 6)),
        ("shell.stl", SHELL, {}, (4, 4, 4)),
        ("open-above.stl", HALF, {}, (4, 4, 2)),
        ("above-one-another.stl", trimesh.util.concatenate([BALL, moved(BALL, 8)]), {}, (4, 4, 4)),
        ("a-face-lacks.stl", some(BALL, np.arange(1, len(BALL.faces))), {}, (4, 4, 4)),
    ],
)
def test_a_body_is_pressed_at_its_size(
    tmp_path: Path, name: str, body: trimesh.Trimesh | str, fields: dict, size_mm: tuple[float, ...]
) -> None:
    pressed = ConvexMesh.load(written(tmp_path / name, body), **fields)
    size = " × ".join(f"{side:g}" for side in size_mm)
    assert f"{size} mm" in pressed.label
    assert ("top (+z" if fields.get("flip") else "bottom (−z") in pressed.label
    assert pressed.reach_mm(np.array([[0, 0, -1.0]]))[0] == pytest.approx(0, abs=1e-6)


def test_that_gltf_has_y_up_is_said(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    load_indenter(str(written(tmp_path / "box.glb", y_up(BOX))))
    assert "its −y is its bottom, as glTF has y up; if yours has z up, export STL" in caplog.text


def written(path: Path, body: trimesh.Trimesh | trimesh.Scene | str) -> Path:
    if isinstance(body, str):
        path.write_text(body)
    else:
        body.export(path)
    return path


@pytest.mark.parametrize(
    ("name", "body", "fields", "message"),
    [
        ("metres.stl", moved(BOX, 0, 1e-3), {}, "0.01 mm large .* set unit: .*m makes it 10 mm"),
        ("mm.glb", BOX, {}, "10000 mm large .*: mm makes it 10 mm"),
        ("far.stl", moved(BOX, 1e6), {}, "from its origin that its file's numbers round it to 0.062 mm"),
        ("box.stl", BOX, {"unit": "furlong"}, "unit = 'furlong': must be mm, cm, m"),
        ("box.stl", BOX, {"edge_radius_mm": 1.6}, r"edge_radius_mm = 1.6: must be less than 1.5 mm"),
        ("bowl.stl", overturned(HALF), {}, "lies 2 mm inside its convex hull, of 0.05 mm .*flip = true"),
        ("torus.stl", trimesh.creation.torus(3, 1), {}, "must be convex where it touches"),
        ("flat.stl", some(BOX, BOX.triangles[:, :, 2].max(axis=1) < 1), {}, "only 0 mm high"),
        ("sheet.stl", some(BOX, BOX.triangles[:, :, 0].max(axis=1) < 0), {}, "is flat where it touches"),
        ("points.ply", trimesh.PointCloud(BOX.vertices), {}, "holds no triangles"),
        ("empty.obj", "", {}, "is no readable mesh|holds no triangles"),
        ("nan.obj", CUBE_OBJ.replace("v -2 -2 0", "v nan -2 0"), {}, "not finite"),
        ("part.step", "ISO-10303-21;", {}, "is no mesh but a CAD file; export STL, OBJ or GLB"),
        ("packed.glb", "glTF KHR_draco_mesh_compression", {}, "compressed or quantised corners, .* without"),
        ("part.blob", "…", {}, "is no readable mesh .*, heights as .npy"),
    ],
)
def test_what_cannot_be_pressed_is_refused_in_a_sentence(
    tmp_path: Path, name: str, body: trimesh.Trimesh | str, fields: dict, message: str
) -> None:
    with pytest.raises(ValueError, match=message) as refused:
        ConvexMesh.load(written(tmp_path / name, body), **fields)
    assert name in str(refused.value)


def test_3mf_without_lxml_says_how_to_install_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("gelgap.sim.mesh_file.find_spec", lambda name: None)
    with pytest.raises(ValueError, match=r"body.3mf.*needs the package lxml; .*pip install 'gelgap\[3mf\]'"):
        ConvexMesh.load(written(tmp_path / "body.3mf", BOX))


def test_rounding_leaves_a_meshs_size_and_makes_it_the_shape_of_that_name(tmp_path: Path) -> None:
    box = ConvexMesh.load(written(tmp_path / "box.stl", BOX), edge_radius_mm=0.5)
    tip = ConvexMesh.load(written(tmp_path / "tip.stl", TIP), edge_radius_mm=0.3)
    points = np.random.default_rng(0).uniform([-3, -3, -1], [3, 3, 3], (300, 3))
    for mesh, shape, within_mm in (
        (box, Box(size_mm=(4, 3), edge_radius_mm=0.5), 1e-6),
        (tip, Cylinder(diameter_mm=3, edge_radius_mm=0.3), 2e-3),
    ):
        np.testing.assert_allclose(
            mesh.project(points).distance_mm, shape.project(points).distance_mm, atol=within_mm
        )


def test_what_lies_above_the_convex_end_stays_off_the_gel(tmp_path: Path) -> None:
    tip = ConvexMesh.load(written(tmp_path / "tip.stl", TIP))
    assert tip.deepest_mm == pytest.approx(0.8 * 6)
    # The plate's rim comes down by 8 · sin 10°, the stem's by 1.5 · sin 10°.
    tilted = tip.model_copy(update={"tilt_deg": (10.0, 0.0)})
    rim_mm = 6 * np.cos(np.radians(10)) - (8 - 1.5) * np.sin(np.radians(10))
    assert tilted.deepest_mm == pytest.approx(0.8 * rim_mm, abs=1e-3)
    assert type(tip).model_validate_json(tip.model_dump_json()) == tip


def test_too_many_corners_are_reduced_and_said(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("gelgap.sim.mesh_file._PLACES", 200)
    fine = trimesh.creation.uv_sphere(radius=3, count=[45, 45])
    # Far from the origin its corners are not quite where their mirror images are.
    fine.apply_translation([40, -30, 12])
    ball = ConvexMesh.load(written(tmp_path / "fine.stl", fine), edge_radius_mm=0.2)
    said = r"is reduced to 25\d\d corners, which moves its surface by up to 0\.00"
    assert len(re.findall(said, caplog.text)) == 1
    assert caplog.text.count("fine.stl: states no unit, mm are taken: 6 mm large; set unit if wrong") == 1
    assert ball.cut_mm(3.0)[0, 1] == pytest.approx(3.0, abs=0.01)
    assert ball.symmetry is Symmetry.MIRROR


def test_a_toml_file_may_turn_a_mesh_over_and_state_its_unit(tmp_path: Path) -> None:
    written(tmp_path / "tip.stl", moved(overturned(TIP), 0, 0.1))
    (tmp_path / "tip.toml").write_text('mesh = "tip.stl"\nflip = true\nunit = "cm"\n')
    assert "3 × 3 × 6 mm" in load_indenter(str(tmp_path / "tip.toml")).label
    (tmp_path / "tip.toml").write_text('mesh = "tip.stl"\nhull_mm = [[0, 0, 0]]\n')
    with pytest.raises(ValueError, match=r"tip\.toml: hull_mm: a mesh has none; it has .*, flip, unit"):
        load_indenter(str(tmp_path / "tip.toml"))
