"""The body of a mesh file: its lower end, as far up as it is convex, in mm."""

import logging
import math
from pathlib import Path
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gelgap.sim.indenter import Floats
from gelgap.sim.rounded import LARGEST_TILT_DEG, from_triangles

if TYPE_CHECKING:
    from trimesh import Trimesh

LOG = logging.getLogger(__name__)

MeshUnit = Literal["mm", "cm", "m", "inch", "um"]
_MM = {"mm": 1.0, "cm": 10.0, "m": 1e3, "inch": 25.4, "um": 1e-3}
_CAD_SUFFIXES = (".step", ".stp", ".iges", ".igs", ".brep", ".sldprt", ".f3d", ".fcstd", ".ipt", ".blend")
_SMALLEST_MM, _LARGEST_MM = 0.1, 500.0
MOST_HULL_POINTS = 4000
# A body is convex if its hull's surface is nowhere further from its own, at this many places.
_CONVEX_WITHIN_MM = 0.05
_PLACES = 2000
# One that is convex over less of its height is not pressed.
_LEAST_CONVEX_MM = 0.1
_JUST_BELOW_MM = 1e-4
_NUMBERS_AT_A_TIME = 10_000_000


class ConvexPart(NamedTuple):
    """The lowest point is at z = 0, and the middle of the lowest face on the axis.

    `core_mm` (n, 3) are the corners of the convex part less its rounding, lifted onto z = 0; `above_mm` (m, 3) is what
    of the rest comes lowest as the body is tilted.
    """

    core_mm: Floats
    above_mm: Floats


def convex_part(path: Path, unit: MeshUnit | None, flip: bool, edge_radius_mm: float) -> ConvexPart:
    """Return what can be pressed of a mesh file: of its bottom (−z), or if `flip` of its top.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If it is no mesh, its size is not credible, or its lower end is not convex or too small for the rounding.
    """
    try:
        mesh = _read(path, unit)
        if flip:
            mesh.vertices *= [1, -1, -1]
        return _part(mesh, path.name, edge_radius_mm)
    except ValueError as error:
        raise ValueError(f"indenter = {str(path)!r}: {error}") from None


def _read(path: Path, unit: MeshUnit | None) -> "Trimesh":
    import trimesh

    if not path.is_file():
        raise FileNotFoundError(f"mesh {path} does not exist")
    suffix = path.suffix.lower()
    if suffix in _CAD_SUFFIXES:
        raise ValueError("is no mesh but a CAD file; export STL, OBJ or GLB from the CAD program")
    try:
        scene = trimesh.load_scene(path)
        mesh = scene.to_mesh()
        mesh.merge_vertices(merge_tex=True, merge_norm=True)
    except Exception as error:  # readers of other people's formats raise whatever they like
        raise ValueError(f"is not a mesh that can be read ({error}); export STL, OBJ or GLB") from None
    if not len(mesh.faces):
        raise ValueError("has no triangles; export a surface")
    if not np.isfinite(mesh.vertices).all():
        raise ValueError("has corners that are not finite numbers; export it anew")
    unit = unit or mesh.units or ("m" if suffix in (".glb", ".gltf") else "mm")
    mesh.vertices *= _MM[unit] if unit in _MM else trimesh.units.unit_conversion(unit, "mm")
    size_mm = mesh.extents.max()
    if not _SMALLEST_MM <= size_mm <= _LARGEST_MM:
        likely = {"m", "mm"} - {unit}
        raise ValueError(
            f"is {size_mm:.3g} mm large if its numbers are in {unit}, must be {_SMALLEST_MM:g} to {_LARGEST_MM:g} mm; "
            f"are they in {' or '.join(sorted(likely))}? give --mesh-unit (in a TOML file: unit)"
        )
    if len(bodies := scene.graph.nodes_geometry) > 1:
        LOG.warning("%s: its %d bodies are pressed as one", path.name, len(bodies))
    faces = len(mesh.faces)
    mesh.fill_holes()
    if len(mesh.faces) > faces:
        LOG.warning("%s: holes of three or four corners in its surface are closed", path.name)
    return mesh


def _part(mesh: "Trimesh", name: str, edge_radius_mm: float) -> ConvexPart:
    mesh.vertices[:, 2] -= mesh.bounds[0, 2]
    convex_mm, part, above = _convex_mm(mesh), mesh, np.zeros((0, 3))
    if convex_mm < mesh.extents[2]:
        part = _below(mesh, convex_mm)
        above = mesh.vertices[mesh.vertices[:, 2] > convex_mm - _JUST_BELOW_MM]
        above = above[_extreme(above, _directions(math.radians(LARGEST_TILT_DEG + 5)))]
        size = " × ".join(f"{side:.3g}" for side in mesh.extents)
        LOG.warning(
            "%s: %s mm, is pressed by the lowest %.3g mm, which are convex; what is above has to stay off the gel",
            name,
            size,
            convex_mm,
        )
    corners = np.array(part.convex_hull.vertices)
    is_top = corners[:, 2] > convex_mm - 2 * _JUST_BELOW_MM
    if len(above) and np.all(np.ptp(corners[is_top, :2], axis=0) > np.ptp(corners[:, :2], axis=0) - 1e-6):
        # Else the rounding would reach down from the cut.
        corners = np.concatenate([corners, corners[is_top] + [0.0, 0.0, convex_mm]])
    corners = _fewer(corners, name)
    if edge_radius_mm:
        corners = _fewer(_eroded(corners, edge_radius_mm), name)
    lowest = corners[corners[:, 2] < corners[:, 2].min() + 1e-6]
    origin = np.array([*lowest[:, :2].mean(axis=0), corners[:, 2].min()])
    return ConvexPart(corners - origin, above - origin + [0.0, 0.0, edge_radius_mm])


def _convex_mm(mesh: "Trimesh") -> float:
    """Return the height up to which a mesh that stands on z = 0 is convex, which ends where there are corners."""
    levels = np.unique(mesh.vertices[:, 2].round(4))
    levels = levels[levels > _LEAST_CONVEX_MM]
    # What is convex up to a level is so up to every one below.
    convex, not_convex = -1, len(levels)
    level = not_convex - 1
    while not_convex - convex > 1:
        off_mm, place = _off_hull(mesh, levels[level])
        if off_mm <= _CONVEX_WITHIN_MM:
            convex = level
        else:
            not_convex = level
        level = (convex + not_convex) // 2
    if convex < 0:
        raise ValueError(
            f"must be convex where it touches the gel: at x, y = {place[0]:.3g}, {place[1]:.3g} mm, {place[2]:.3g} mm "
            f"above the lowest point, its surface lies {off_mm:.2g} mm inside its convex hull, of {_CONVEX_WITHIN_MM:g} "
            "mm at most; press another side (--flip, in a TOML file flip, turns it over)"
        )
    return float(levels[convex])


def _off_hull(mesh: "Trimesh", level_mm: float) -> tuple[float, Floats]:
    """Return how far the surface below a level is from that of its convex hull, at most, and where (3,)."""
    from trimesh.sample import sample_surface

    part = _below(mesh, level_mm)
    hull = part.convex_hull
    is_lid = hull.triangles[:, :, 2].min(axis=1) > level_mm - 2 * _JUST_BELOW_MM
    places, _ = sample_surface(hull, _PLACES, face_weight=hull.area_faces * ~is_lid, seed=0)
    off_mm = np.concatenate(
        [
            np.linalg.norm(from_triangles(some, part.triangles), axis=1)
            for some in _in_parts(places, len(part.faces))
        ]
    )
    return float(off_mm.max()), places[off_mm.argmax()]


def _below(mesh: "Trimesh", level_mm: float) -> "Trimesh":
    """Return the surface below a level, without what lies in it."""
    from trimesh import Trimesh
    from trimesh.intersections import slice_faces_plane

    origin = [0.0, 0.0, level_mm - _JUST_BELOW_MM]
    vertices, faces, _ = slice_faces_plane(mesh.vertices, mesh.faces, [0.0, 0.0, -1.0], origin)
    return Trimesh(vertices, faces)


def _fewer(corners: Floats, name: str) -> Floats:
    """Return corners (n, 3) of a convex hull, of too many those that are extreme in evenly spread directions."""
    from scipy.spatial import ConvexHull

    if len(corners) <= MOST_HULL_POINTS:
        return corners
    kept = corners[_extreme(corners, _directions(math.pi))]
    planes = ConvexHull(kept).equations
    beyond_mm = max(
        float((some @ planes[:, :3].T + planes[:, 3]).max()) for some in _in_parts(corners, len(planes))
    )
    LOG.warning(
        "%s: its %d corners are reduced to %d, which moves its surface by at most %.2g mm",
        name,
        len(corners),
        len(kept),
        max(beyond_mm, 0.0),
    )
    return kept


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


def _directions(from_down_rad: float) -> Floats:
    """Return unit vectors (n, 3), evenly spread, at most so far from −z."""
    from trimesh.creation import icosphere

    around = np.array(icosphere(subdivisions=4).vertices)
    return around[around[:, 2] <= -math.cos(from_down_rad)]


def _extreme(points: Floats, directions: Floats) -> NDArray[np.intp]:
    """Return the indices of the points (n, 3) that are furthest in any direction (m, 3)."""
    return np.unique(
        np.concatenate([(some @ points.T).argmax(axis=1) for some in _in_parts(directions, len(points))])
    )


def _in_parts(points: Floats, others: int) -> list[Floats]:
    """Return points in parts small enough to be taken with each of so many others at once."""
    return np.array_split(points, 1 + len(points) * others // _NUMBERS_AT_A_TIME)
