"""The body of a mesh file: its lower end, as far up as it is convex, in mm."""

import logging
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from gelgap.assets.toml_file import named_in_errors
from gelgap.sim.indenter import Floats
from gelgap.sim.rounded import from_triangles

if TYPE_CHECKING:
    from trimesh import Trimesh

LOG = logging.getLogger(__name__)

MeshUnit = Literal["mm", "cm", "m", "inch", "um"]
# By trimesh's names.
_UNITS = {"mm": "mm", "cm": "cm", "m": "m", "inch": "inch", "um": "microns"}
_GLTF_SUFFIXES = (".glb", ".gltf")
_PACKINGS = (b"KHR_mesh_quantization", b"KHR_draco_mesh_compression", b"EXT_meshopt_compression")
_CAD_SUFFIXES = (".step", ".stp", ".iges", ".igs", ".brep", ".sldprt", ".f3d", ".fcstd", ".ipt", ".blend")
_SMALLEST_MM, _LARGEST_MM = 0.5, 500.0
_MOST_CORNERS = 4000
# An edge is sharp if its two faces differ by more than those of a round body in 12 parts.
_SHARP_DEG = 31.0
# A body is convex if its hull's surface is nowhere further from its own, at this many places.
_CONVEX_WITHIN_MM = 0.05
# Surfaces that are nowhere further apart are taken as the same.
SAME_MM = 5e-3
_PLACES = 2000
# One that is convex over less of its height is not pressed.
_LEAST_CONVEX_MM = 0.1
_FLAT_SHARE = 1e-6
_JUST_BELOW_MM = 1e-4
_NUMBERS_AT_A_TIME = 10_000_000


class NotConvexError(ValueError):
    """A body is not convex where it touches the gel."""


def convex_part(
    path: Path, unit: MeshUnit | None, flip: bool, edge_radius_mm: float
) -> tuple[Floats, Floats]:
    """Return what can be pressed of a mesh file, by its bottom (−z) or if `flip` by its top, and what lies above.

    The first are the corners (n, 3) of the convex part less its rounding, lifted onto z = 0, the middle of its lowest
    face on the axis; the second corners (m, 3) of the rest, over the lowest point of the rounded body.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If it is no mesh, its size is not credible, or it is too small for the rounding; NotConvexError if its lower end
        is not convex.
    """
    from scipy.spatial import QhullError

    mesh = _standing(path, unit, flip)
    if path.suffix.lower() in _GLTF_SUFFIXES:
        LOG.warning("%s: its −y is its bottom, as glTF has y up; if yours has z up, export STL", path.name)
    try:
        # Trimesh divides by the volume, which a flat body has not.
        with np.errstate(divide="ignore", invalid="ignore"):
            return _part(mesh, path.name, edge_radius_mm)
    except QhullError:
        raise ValueError(f"indenter = {str(path)!r}: is flat where it touches the gel") from None
    except ValueError as error:
        raise type(error)(f"indenter = {str(path)!r}: {error}") from None


def lower_end(path: Path, unit: MeshUnit | None, flip: bool, most_mm: float) -> tuple[Floats, float]:
    """Return the triangles (n, 3, 3) of a mesh file up to its middle or `most_mm`, and the height of all of it.

    The lowest lies at z = 0, and the middle of what lies there on the axis. Errors are those of `convex_part`.
    """
    mesh = _standing(path, unit, flip)
    height_mm = float(mesh.extents[2])
    lowest = mesh.vertices[mesh.vertices[:, 2] < SAME_MM]
    mesh.vertices[:, :2] -= (lowest[:, :2].min(axis=0) + lowest[:, :2].max(axis=0)) / 2
    return np.array(_below(mesh, min(height_mm, most_mm)).triangles), height_mm


def has_sharp_edges(path: Path, unit: MeshUnit | None = None, flip: bool = False) -> bool:
    """Return whether a mesh file has sharp edges in its lower half. Errors are those of `convex_part`."""
    mesh = _standing(path, unit, flip)
    lowest_mm = mesh.vertices[mesh.face_adjacency_edges, 2].min(axis=1)
    is_sharp = mesh.face_adjacency_angles > np.radians(_SHARP_DEG)
    return bool((is_sharp & (lowest_mm < mesh.extents[2] / 2)).any())


def _standing(path: Path, unit: MeshUnit | None, flip: bool) -> "Trimesh":
    with named_in_errors(f"indenter = {str(path)!r}"):
        mesh = _read(path, unit)
    if flip:
        mesh.vertices *= [1, -1, -1]
    mesh.vertices[:, 2] -= mesh.bounds[0, 2]
    return mesh


def _read(path: Path, unit: MeshUnit | None) -> "Trimesh":
    import trimesh

    if unit is not None and unit not in _UNITS:
        raise ValueError(f"unit = {unit!r}: must be {', '.join(_UNITS)}")
    if not path.is_file():
        raise FileNotFoundError(f"mesh {path} {'is a folder' if path.exists() else 'does not exist'}")
    suffix = path.suffix.lower()
    if suffix in _CAD_SUFFIXES:
        raise ValueError("is no mesh but a CAD file; export STL, OBJ or GLB from the CAD program")
    if suffix in _GLTF_SUFFIXES and any(packing in path.read_bytes() for packing in _PACKINGS):
        raise ValueError("has compressed or quantised corners, which are not read; export it without")
    if suffix == ".3mf" and find_spec("lxml") is None:
        raise ValueError("needs the package lxml; install with: pip install 'gelgap[3mf]'")
    try:
        scene = trimesh.load_scene(path, process=False)
        mesh = scene.to_mesh()
    except Exception as error:  # readers of other people's formats raise whatever they like
        raise ValueError(f"is no readable mesh ({error}); export STL, OBJ or GLB, heights as .npy") from None
    if not len(mesh.faces):
        raise ValueError("holds no triangles; export a surface as STL, OBJ or GLB")
    if not np.isfinite(mesh.vertices).all():
        raise ValueError("has corners that are not finite numbers; export it anew")
    stated = unit or mesh.units or ("m" if suffix in _GLTF_SUFFIXES else None)
    unit = stated or "mm"
    size = mesh.extents.max()
    size_mm = size * trimesh.units.unit_conversion(_UNITS.get(unit, unit), "mm")
    if not _SMALLEST_MM <= size_mm <= _LARGEST_MM:
        would_be_mm = {name: size * trimesh.units.unit_conversion(_UNITS[name], "mm") for name in _UNITS}
        served = [
            f"{other} makes it {other_mm:.3g} mm"
            for other, other_mm in would_be_mm.items()
            if _SMALLEST_MM <= other_mm <= _LARGEST_MM
        ]
        raise ValueError(
            f"is {size_mm:.6g} mm large if its numbers are in {unit}, must be {_SMALLEST_MM:g} to {_LARGEST_MM:g} mm; "
            f"set unit: {', '.join(served) or 'no unit makes it so'}"
        )
    if (rounded_mm := size_mm / size * np.spacing(np.float32(abs(mesh.bounds).max()))) > SAME_MM:
        raise ValueError(
            f"is so far from its origin that its file's numbers round it to {rounded_mm:.2g} mm: move it there"
        )
    mesh.vertices *= size_mm / size
    if suffix in _GLTF_SUFFIXES:  # y is up (glTF 2.0, 3.4)
        mesh.vertices = mesh.vertices[:, [0, 2, 1]] * [1, -1, 1]
    if stated is None:
        LOG.warning("%s: states no unit, mm are taken: %.3g mm large; set unit if wrong", path.name, size_mm)
    if len(bodies := scene.graph.nodes_geometry) > 1:
        deeper = "where that allows too little depth, export each as a file, for [[parts]] of a TOML file"
        LOG.warning("%s: its %d bodies are pressed as one; %s", path.name, len(bodies), deeper)
    mesh.merge_vertices(merge_tex=True, merge_norm=True)
    faces = len(mesh.faces)
    mesh.fill_holes()
    if len(mesh.faces) > faces:
        LOG.warning("%s: holes of three or four corners in its surface are closed", path.name)
    return mesh


def _part(mesh: "Trimesh", name: str, edge_radius_mm: float) -> tuple[Floats, Floats]:
    convex_mm, part, above = _convex_mm(mesh), mesh, np.zeros((0, 3))
    if convex_mm < mesh.extents[2]:
        part = _below(mesh, convex_mm)
        above = _extreme(mesh.vertices[mesh.vertices[:, 2] > convex_mm - _JUST_BELOW_MM])
    if part.convex_hull.volume < _FLAT_SHARE * convex_mm**3:
        raise ValueError("is flat where it touches the gel")
    corners = np.array(part.convex_hull.vertices)
    is_top = corners[:, 2] > convex_mm - 2 * _JUST_BELOW_MM
    # A body that ends below the level has no corners there.
    has_lid = len(above) > 0 and is_top.any()
    if has_lid and np.all(np.ptp(corners[is_top, :2], axis=0) > np.ptp(corners[:, :2], axis=0) - 1e-6):
        # Else the rounding would reach down from the cut.
        corners = np.concatenate([corners, corners[is_top] + [0.0, 0.0, convex_mm]])
    corners, moved_mm = _fewer(corners)
    if edge_radius_mm:
        corners, moved_again_mm = _fewer(_eroded(corners, edge_radius_mm))
        moved_mm += moved_again_mm
    if moved_mm:
        LOG.warning(
            "%s: is reduced to %d corners, which moves its surface by up to %.2g mm",
            name,
            len(corners),
            moved_mm,
        )
    lowest = corners[corners[:, 2] < corners[:, 2].min() + SAME_MM]
    middle = (lowest.min(axis=0) + lowest.max(axis=0)) / 2
    origin = np.array([*middle[:2], corners[:, 2].min()])
    return corners - origin, above - origin + [0.0, 0.0, edge_radius_mm]


def _convex_mm(mesh: "Trimesh") -> float:
    """Return the height up to which a mesh that stands on z = 0 is convex, which ends where there are corners."""
    levels = np.append(np.unique(mesh.vertices[:, 2].round(4))[:-1], mesh.extents[2])
    levels = levels[levels > _LEAST_CONVEX_MM]
    if not len(levels):
        raise ValueError(f"is only {mesh.extents[2]:.3g} mm high, must be more than {_LEAST_CONVEX_MM:g} mm")
    # What is convex up to a level is so up to every one below.
    convex, not_convex = -1, len(levels)
    level = len(levels) - 1
    while not_convex - convex > 1:
        off_mm, place = _off_hull(mesh, levels[level])
        if off_mm <= _CONVEX_WITHIN_MM:
            convex = level
        else:
            not_convex = level
        level = (convex + not_convex) // 2
    if convex < 0:
        raise NotConvexError(
            f"must be convex where it touches the gel: its surface lies {off_mm:.2g} mm inside its convex hull, of "
            f"{_CONVEX_WITHIN_MM:g} mm at most, at x, y = {place[0]:.2f}, {place[1]:.2f} mm, {place[2]:.2f} mm above "
            "the lowest point; press its other side, with flip = true or without"
        )
    return float(levels[convex])


def _off_hull(mesh: "Trimesh", level_mm: float) -> tuple[float, Floats]:
    """Return how far the surface below a level is from that of its convex hull, at most, and where (3,)."""
    from trimesh.sample import sample_surface

    part = _below(mesh, level_mm)
    hull = part.convex_hull
    is_lid = hull.triangles[:, :, 2].min(axis=1) > level_mm - 2 * _JUST_BELOW_MM
    places, _ = sample_surface(hull, _PLACES, face_weight=hull.area_faces * ~is_lid, seed=0)
    apart = [from_triangles(some, part.triangles) for some in _in_parts(places, len(part.faces))]
    off_mm = np.linalg.norm(np.concatenate(apart), axis=1)
    return float(off_mm.max()), places[off_mm.argmax()]


def _below(mesh: "Trimesh", level_mm: float) -> "Trimesh":
    """Return the surface below a level, without what lies in it."""
    from trimesh import Trimesh
    from trimesh.intersections import slice_faces_plane

    origin = [0.0, 0.0, level_mm - _JUST_BELOW_MM]
    vertices, faces, _ = slice_faces_plane(mesh.vertices, mesh.faces, [0.0, 0.0, -1.0], origin)
    return Trimesh(vertices, faces)


def _fewer(corners: Floats) -> tuple[Floats, float]:
    """Return the corners (n, 3) of a convex hull, or of too many the extreme ones, and by how much that moves it."""
    from scipy.spatial import ConvexHull

    if len(corners) <= _MOST_CORNERS:
        return corners, 0.0
    kept = _extreme(corners)
    planes = ConvexHull(kept).equations
    beyond_mm = max(
        float((some @ planes[:, :3].T + planes[:, 3]).max()) for some in _in_parts(corners, len(planes))
    )
    return kept, beyond_mm


def _eroded(corners: Floats, radius_mm: float) -> Floats:
    """Return the corners (n, 3) of what is further than a radius inside a convex hull."""
    from scipy.optimize import linprog
    from scipy.spatial import ConvexHull, HalfspaceIntersection

    planes = np.unique(ConvexHull(corners).equations.round(9), axis=0)
    normals_and_one = np.column_stack([planes[:, :3], np.ones(len(planes))])
    *middle, most_mm = linprog([0, 0, 0, -1], normals_and_one, -planes[:, 3], bounds=[(None, None)] * 4).x
    if radius_mm > 0.999 * most_mm:
        raise ValueError(
            f"edge_radius_mm = {radius_mm:g}: must be less than {0.999 * most_mm:.3g} mm, the radius of the largest "
            "ball in its convex part"
        )
    planes[:, 3] += radius_mm
    inside = HalfspaceIntersection(planes, np.array(middle)).intersections
    return np.unique(inside.round(6) + 0.0, axis=0)


def _extreme(points: Floats) -> Floats:
    """Return those of the points (n, 3) that are furthest in some of 2562 directions."""
    from trimesh.creation import icosphere

    directions = _in_parts(icosphere(subdivisions=4).vertices, len(points))
    return points[np.unique(np.concatenate([(some @ points.T).argmax(axis=1) for some in directions]))]


def _in_parts(points: Floats, others: int) -> list[Floats]:
    """Return points in parts, each small enough to be compared with all of the others at once."""
    return np.array_split(points, 1 + len(points) * others // _NUMBERS_AT_A_TIME)
