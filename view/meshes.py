"""The deformed membrane and the indenter as triangles with a picture on them, for the page and for files."""

from pathlib import Path
from typing import Literal

import numpy as np
import trimesh
from numpy.typing import NDArray
from PIL import Image
from trimesh.parent import Geometry

from gelgap.assets.whole_file import write_whole
from gelgap.render import Camera
from gelgap.sim import MembraneState
from gelgap.sim.library import PoseState
from gelgap.sim.objects import surface_mesh_mm
from gelgap.sim.shapes import AnyIndenter

MESH_SUFFIXES = (".glb", ".ply")
Colouring = Literal["picture", "displacement", "pressure"]
COLOURINGS: tuple[Colouring, ...] = ("picture", "displacement", "pressure")
_INDENTER_RGBA = (176, 184, 196, 255)
# glTF counts in metres and has y up; PLY has no unit and gets millimetres.
_GLTF_FROM_MM = 1e-3 * np.array([[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1e3]])
_ROUNDING = 1e-3
# Of the page's membrane the first share shines by itself, in the very colours of its texture; the second is shaded. The
# page's lights are bright, so that both together are less than 1.
_SHINING_SHARE, _SHADED_SHARE = 0.55, 0.25


def membrane_mesh(
    state: MembraneState, camera: Camera, picture: NDArray[np.uint8], every: int = 1
) -> trimesh.Trimesh:
    """Return the part of a membrane that the camera sees, in mm, with the picture (h, w, 3) as its texture.

    `every` keeps each `every`-th point of the grid along both axes.
    """
    points = state.places_mm[::every, ::every]
    height, width = picture.shape[:2]
    place = np.clip(camera.project_px(points, (width, height)) / (width, height), 0, 1)
    at_rest = camera.project_px(state.rest_mm[::every, ::every], (width, height)) / (width, height)
    seen = np.all((at_rest > -_ROUNDING) & (at_rest < 1 + _ROUNDING), axis=-1)
    return _textured(points, np.stack([place[..., 0], 1 - place[..., 1]], axis=-1), seen, picture)


def coloured_mesh(
    state: MembraneState, values: NDArray[np.floating], most: float, every: int
) -> trimesh.Trimesh:
    """Return the whole membrane, in mm, coloured by values (ny, nx) from 0 to `most`."""
    import matplotlib

    points = state.places_mm[::every, ::every]
    rows, columns = points.shape[:2]
    u, v = np.meshgrid((np.arange(columns) + 0.5) / columns, 1 - (np.arange(rows) + 0.5) / rows)
    shares = np.clip(values[::every, ::every] / max(most, 1e-9), 0, 1)
    texture = (255 * matplotlib.colormaps["viridis"](shares)[..., :3]).astype(np.uint8)
    return _textured(points, np.stack([u, v], axis=-1), np.ones((rows, columns), bool), texture)


def indenter_centre_mm(solved: PoseState, point_mm: tuple[float, float], indenter: AnyIndenter) -> NDArray:
    """Return where the origin (3,) of the indenter is, a sphere's centre."""
    return np.array([*point_mm, indenter.origin_height_mm]) + solved.indenter_mm


def indenter_mesh(indenter: AnyIndenter) -> trimesh.Trimesh:
    """Return the surface of the indenter around its origin; of a body that is not convex, the underside."""
    subdivisions = 3 if indenter.shape == "sphere" else 5
    return trimesh.Trimesh(*surface_mesh_mm(indenter, subdivisions), process=False)


def mesh_bytes(
    solved: PoseState,
    point_mm: tuple[float, float],
    indenter: AnyIndenter,
    camera: Camera,
    picture: NDArray[np.uint8],
    suffix: str,
) -> bytes:
    """Return membrane and indenter as a file: `.glb`, textured, in metres, y up, or `.ply`, coloured, in mm."""
    membrane = membrane_mesh(solved, camera, picture)
    body = indenter_mesh(indenter)
    body.apply_translation(indenter_centre_mm(solved, point_mm, indenter))
    colours = np.tile(np.array(_INDENTER_RGBA, np.uint8), (len(body.vertices), 1))
    body.visual = trimesh.visual.ColorVisuals(body, vertex_colors=colours)
    if suffix == ".glb":
        parts: dict[str, Geometry] = {"membrane": membrane, "indenter": body}
        return trimesh.Scene(parts).apply_transform(_GLTF_FROM_MM).export(None, file_type="glb")
    membrane.visual = _texture(membrane).to_color()
    return trimesh.util.concatenate([membrane, body]).export(None, file_type="ply")


def save_mesh(
    path: str | Path,
    solved: PoseState,
    point_mm: tuple[float, float],
    indenter: AnyIndenter,
    camera: Camera,
    picture: NDArray[np.uint8],
) -> None:
    """Write the deformed membrane, with the camera's picture (h, w, 3) on it, and the indenter to a GLB or PLY file.

    Raises
    ------
    ValueError
        If the name ends in neither .glb nor .ply.
    RuntimeError
        If the file cannot be written.
    """
    suffix = Path(path).suffix.lower()
    if suffix not in MESH_SUFFIXES:
        raise ValueError(f"path = {str(path)!r}: the name must end in {' or '.join(MESH_SUFFIXES)}")
    write_whole(Path(path), mesh_bytes(solved, point_mm, indenter, camera, picture, suffix))


def glb(mesh: trimesh.Trimesh) -> bytes:
    """Return one mesh as GLB in mm, as the page shows it."""
    shown = mesh.copy()
    material = _texture(shown).material
    material.baseColorFactor = [*[round(255 * _SHADED_SHARE)] * 3, 255]
    material.emissiveTexture, material.emissiveFactor = material.baseColorTexture, [_SHINING_SHARE] * 3
    return trimesh.Scene(shown).export(None, file_type="glb", include_normals=True)


def _texture(membrane: trimesh.Trimesh) -> trimesh.visual.TextureVisuals:
    """Return what `_textured` has given a membrane."""
    visual = membrane.visual
    if not isinstance(visual, trimesh.visual.TextureVisuals):
        raise TypeError("a mesh without a texture")
    return visual


def _textured(
    points: NDArray, uv: NDArray, kept: NDArray[np.bool_], texture: NDArray[np.uint8]
) -> trimesh.Trimesh:
    """Return the triangles whose corners are all kept, seen from above (+z)."""
    index = np.arange(kept.size).reshape(kept.shape)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]
    faces = np.stack([a, b, c, a, c, d], axis=-1).reshape(-1, 3)
    faces = faces[kept.ravel()[faces].all(axis=1)]
    material = trimesh.visual.material.PBRMaterial(
        baseColorTexture=Image.fromarray(texture), metallicFactor=0.0, roughnessFactor=0.9, doubleSided=True
    )
    visual = trimesh.visual.TextureVisuals(uv=uv.reshape(-1, 2), material=material)
    mesh = trimesh.Trimesh(points.reshape(-1, 3), faces, visual=visual, process=False)
    mesh.remove_unreferenced_vertices()
    return mesh
