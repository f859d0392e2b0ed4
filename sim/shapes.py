"""Indenters beside the sphere: cylinder, cone, edge, box, ellipsoid and convex meshes, by name or from files."""

import logging
import math
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any, ClassVar, Self, get_args

import numpy as np
from pydantic import Field, create_model

from gelgap.assets import list_presets, load_preset
from gelgap.assets.names import unknown_name
from gelgap.assets.settings import Settings, within
from gelgap.assets.toml_file import named_in_errors, read_toml
from gelgap.sim.indenter import Floats, Indenter, Sphere, Symmetry
from gelgap.sim.mesh_file import SAME_MM, MeshUnit, NotConvexError, convex_part, has_sharp_edges
from gelgap.sim.objects import OBJECTS, Place, object_surface, sum_surface
from gelgap.sim.rounded import RoundedHull, RoundedProfile, Shape
from gelgap.sim.surface import MAP_SUFFIXES, Surface

LOG = logging.getLogger(__name__)

# Files of sharp bodies seldom say how their edges are rounded; `draft` serves this radius on a gel of 3 mm.
_CAD_EDGE_MM = 0.25
# Bodies whose height no field says are as high as they are wide, and at least this high.
_SMALLEST_HEIGHT_MM = 10.0
# Beside a body the gel rises by up to a quarter of the depth (8 × 8 mm on 4 mm of gel: by 0.14 of it).
_STAYS_OFF = 0.8

# What follows from a file, and nobody gives.
_OF_THE_FILE = ("hull_mm", "above_mm", "heights", "columns", "height_mm")
# What only a file's surface is given.
_OF_A_FILE = ("spacing_mm", "step_mm", "flip")
# What a TOML file says of a body, one of these.
_KINDS = ("shape", "mesh", "map", "object", "parts")
_FURTHEST_PART_MM = 50.0

Size = Annotated[float, within(0.5, 50.0, "mm")]
Rounding = Annotated[float, within(0.01, 25.0, "mm")]
Corners = tuple[tuple[float, float, float], ...]


class Cylinder(RoundedProfile):
    """A flat-ended cylinder that stands on the gel; the edge of its face is rounded."""

    shape: ClassVar[str] = "cylinder"

    diameter_mm: Size = Field(default=3.0, description="Diameter, mm, 0.5 to 50.")
    edge_radius_mm: Rounding = Field(
        default=0.2, description="Radius of the face's edge, mm, 0.01 to half the diameter."
    )

    @property
    def _height_mm(self) -> float:
        return max(self.diameter_mm, _SMALLEST_HEIGHT_MM)

    @property
    def _core_mm(self) -> Floats:
        f, r, top = self.edge_radius_mm, self.diameter_mm / 2 - self.edge_radius_mm, self._height_mm
        return np.array([[0.0, f], [r, f], [r, top - f], [0.0, top - f]])

    @property
    def _face_mm(self) -> Floats:
        angle, r = np.linspace(0, 2 * np.pi, 33), self.diameter_mm / 2 - self.edge_radius_mm
        return np.stack([r * np.cos(angle), r * np.sin(angle), 0 * angle], 1)


class Cone(RoundedProfile):
    """A cone that stands on its rounded tip."""

    shape: ClassVar[str] = "cone"

    diameter_mm: Size = Field(default=6.0, description="Diameter where it is widest, mm, 0.5 to 50.")
    half_angle_deg: Annotated[float, within(20.0, 85.0, "°")] = Field(
        default=60.0, description="Angle between axis and flank, degrees, 20 to 85."
    )
    tip_radius_mm: Rounding = Field(
        default=0.3, description="Radius of the tip, mm, 0.01 to half the diameter."
    )

    @property
    def _flank_mm(self) -> float:
        """Height of the flank, without the rounding."""
        return (self.diameter_mm / 2 - self.tip_radius_mm) / math.tan(math.radians(self.half_angle_deg))

    @property
    def _height_mm(self) -> float:
        return max(2 * (self._flank_mm + self.tip_radius_mm), _SMALLEST_HEIGHT_MM)

    @property
    def deepest_mm(self) -> float:
        return self._flank_mm + self.tip_radius_mm

    @property
    def _rounding_mm(self) -> float:
        return self.tip_radius_mm

    @property
    def _core_mm(self) -> Floats:
        t, r = self.tip_radius_mm, self.diameter_mm / 2 - self.tip_radius_mm
        top = self._height_mm - t
        return np.array([[0.0, t], [r, t + self._flank_mm], [r, top], [0.0, top]])


class Edge(RoundedProfile):
    """A cylinder that lies on the gel, along x as long as it is not turned; the edges of its ends are rounded."""

    shape: ClassVar[str] = "edge"

    diameter_mm: Size = Field(default=3.0, description="Diameter, mm, 0.5 to 50.")
    length_mm: Size = Field(default=6.0, description="Length, mm, 0.5 to 50.")
    edge_radius_mm: Rounding = Field(
        default=0.3, description="Radius of the ends' edges, mm, 0.01 to half of diameter and length."
    )

    @property
    def _upright_symmetry(self) -> Symmetry:
        return Symmetry.MIRROR

    @property
    def _height_mm(self) -> float:
        return self.diameter_mm

    @property
    def _core_mm(self) -> Floats:
        r, end = self.diameter_mm / 2 - self.edge_radius_mm, self.length_mm / 2 - self.edge_radius_mm
        return np.array([[0.0, -end], [r, -end], [r, end], [0.0, end]])

    @property
    def _face_mm(self) -> Floats:
        end = self.length_mm / 2 - self.edge_radius_mm
        return np.array([[-end, 0.0, 0.0], [end, 0.0, 0.0]])

    def _nearest(self, points_mm: Floats) -> tuple[Floats, Floats]:
        """Have the axis lie along x, a radius above the gel."""
        from_axis = points_mm - [0.0, 0.0, self.diameter_mm / 2]
        distance_mm, normal = super()._nearest(from_axis[:, [1, 2, 0]])
        return distance_mm, normal[:, [2, 0, 1]]

    def _support_mm(self, directions: Floats) -> Floats:
        return super()._support_mm(directions[:, [1, 2, 0]]) + self.diameter_mm / 2 * directions[:, 2]


class Ellipsoid(Shape):
    """An ellipsoid whose axes are x, y and z as long as it is not turned."""

    shape: ClassVar[str] = "ellipsoid"

    diameters_mm: tuple[Size, Size, Size] = Field(
        default=(4.0, 3.0, 3.0), description="Diameters along x, y and z, mm, 0.5 to 50 each."
    )

    @property
    def _half_mm(self) -> Floats:
        return np.array(self.diameters_mm) / 2

    @property
    def _upright_symmetry(self) -> Symmetry:
        x, y, _ = self.diameters_mm
        return Symmetry.REVOLUTION if x == y else Symmetry.MIRROR

    @property
    def _height_mm(self) -> float:
        return self.diameters_mm[2]

    @property
    def _rounding_mm(self) -> float:
        half = self._half_mm
        return float(half.min() ** 2 / half.max())

    def _nearest(self, points_mm: Floats) -> tuple[Floats, Floats]:
        """Newton's method on Eberly's equation, Σ (a p / (t + a²))² = 1, from its left, where it is convex."""
        square = self._half_mm**2
        point = points_mm - [0.0, 0.0, self._half_mm[2]]
        # In a plane of symmetry a point inside can be as near to both sides; it is to belong to one.
        point = np.copysign(np.maximum(np.abs(point), 1e-9), point)
        scaled = self._half_mm * np.abs(point)
        t = (scaled - square).max(axis=1)
        for _ in range(60):
            term = (scaled / (t[:, None] + square)) ** 2
            step = (term.sum(axis=1) - 1) / (2 * (term / (t[:, None] + square)).sum(axis=1))
            t = t + step
            if np.abs(step).max(initial=0.0) < 1e-13:
                break
        nearest = square * point / (t[:, None] + square)
        normal = nearest / square
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        return ((point - nearest) * normal).sum(axis=1), normal

    def _support_mm(self, directions: Floats) -> Floats:
        return np.linalg.norm(directions * self._half_mm, axis=1) + self._half_mm[2] * directions[:, 2]


class Box(RoundedHull):
    """A box that stands on the gel; all of its edges are rounded."""

    shape: ClassVar[str] = "box"

    size_mm: tuple[Size, Size] = Field(
        default=(4.0, 3.0), description="Size along x and y, mm, 0.5 to 50 each."
    )
    edge_radius_mm: Rounding = Field(
        default=0.3, description="Radius of the edges, mm, 0.01 to half the size."
    )

    @property
    def _height_mm(self) -> float:
        return max(*self.size_mm, _SMALLEST_HEIGHT_MM)

    @property
    def _corners_mm(self) -> Floats:
        f, (x, y) = self.edge_radius_mm, self.size_mm
        # A core without width has no facets.
        half = np.maximum([x / 2 - f, y / 2 - f], 1e-6)
        ends = [(-half[0], half[0]), (-half[1], half[1]), (f, self._height_mm - f)]
        return np.array(np.meshgrid(*ends)).reshape(3, -1).T


class ConvexMesh(RoundedHull):
    """A convex body of any shape, by its corners, which stands on the gel as it is in its file.

    What lies above may be of any shape, as long as it stays off the gel.
    """

    shape: ClassVar[str] = "mesh"

    hull_mm: Corners = Field(
        description="Corners of the convex hull less its rounding, mm; the lowest is moved to z = 0."
    )
    edge_radius_mm: Annotated[float, within(0.0, 25.0, "mm")] = Field(
        default=0.0, description="Radius of the ball that rolls around these corners, mm, 0 to 25."
    )
    above_mm: Corners = Field(
        default=(),
        description="Corners of what lies above the convex part and stays off the gel, mm.",
        exclude_if=lambda value: not value,
    )
    flip: bool = Field(
        default=False,
        strict=True,
        description="Whether it is the file's top that touches, and not its bottom, −z.",
        exclude_if=lambda value: not value,
    )

    @classmethod
    def load(cls, path: str | Path, unit: MeshUnit | None = None, **fields: Any) -> Self:
        """Read a mesh file (STL, PLY, OBJ, GLB, 3MF, OFF), centred over its lowest point's face.

        Its size stays when its edges are rounded. `unit` is by default what the file states, or mm. Of a body that is
        convex only at its lower end, that end is pressed.

        Raises
        ------
        FileNotFoundError
            If there is no such file.
        ValueError
            If it is no mesh, its size is not credible, its lower end is not convex, or too small for the rounding.
        """
        body = cls(hull_mm=(), **fields)
        core_mm, above_mm = convex_part(Path(path), unit, body.flip, body.edge_radius_mm)
        corners = {"hull_mm": core_mm, "above_mm": above_mm}
        return body.model_copy(
            update={name: tuple(map(tuple, np.round(of, 6).tolist())) for name, of in corners.items()}
        )

    @property
    def label(self) -> str:
        size_mm, whole = np.ptp(self._corners_mm, axis=0) + 2 * self.edge_radius_mm, ""
        if self.above_mm:
            above_mm = _points_mm(self.above_mm)
            size_mm[2] = min(size_mm[2], above_mm[:, 2].min())
            whole_mm = np.maximum(size_mm, [*np.ptp(above_mm[:, :2], axis=0), above_mm[:, 2].max()])
            whole = f", the convex end of a body of {_by(whole_mm)} mm whose rest stays off the gel"
        side = "top (+z, of glTF +y)" if self.flip else "bottom (−z, of glTF −y)"
        own = f"mesh of {len(self.hull_mm)} corners, {_by(size_mm)} mm{whole}, touches by its {side}"
        return super().label.replace(self.shape, own, 1)

    @property
    def deepest_mm(self) -> float:
        if not self.above_mm:
            return super().deepest_mm
        lowest_mm = float((_points_mm(self.above_mm) @ self.axes[2]).min()) + self.origin_height_mm
        return min(super().deepest_mm, max(_STAYS_OFF * lowest_mm, 0.0))

    @property
    def _upright_symmetry(self) -> Symmetry:
        return _hull_symmetry(self.hull_mm)

    @property
    def _height_mm(self) -> float:
        return float(np.ptp(self._corners_mm[:, 2])) + 2 * self.edge_radius_mm

    @property
    def _corners_mm(self) -> Floats:
        return _points_mm(self.hull_mm) + np.array([0.0, 0.0, self.edge_radius_mm])


AnyIndenter = Sphere | Cylinder | Cone | Edge | Box | Ellipsoid | ConvexMesh | Surface
"""Type of a field that holds any shape; pydantic tells shapes apart by the names of their fields."""
BODIES: tuple[type[Indenter], ...] = get_args(AnyIndenter)
SHAPES = {body.shape: body for body in BODIES if body not in (ConvexMesh, Surface)}


def fields_of(body: type[Indenter]) -> dict[str, str]:
    """Return the fields that a TOML file may give of a kind of body, and what they mean."""
    described = ((name, field.description or "") for name, field in body.model_fields.items())
    fields = {name: meaning for name, meaning in described if name not in _OF_THE_FILE}
    if body is ConvexMesh:
        fields["unit"] = "Unit of a mesh file that does not state it: mm, cm, m, inch or um."
    return fields


def load_indenter(name: str, **fields: Any) -> AnyIndenter:
    """Return the indenter of a shape's name, a preset, a TOML, mesh or map file, with some fields given anew.

    A TOML file has `shape`, or `mesh` or `map` as a path beside it, and the shape's fields; or `[[parts]]`, each such a
    table with its place `at_mm`, x, y and how high its lowest point is (0). A mesh that is not convex where the gel
    reaches, a height map, and parts become a `Surface`.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If there is no such shape or preset, it has no such field, a value is out of range, or a mesh is not served.
    """
    if name in SHAPES:
        return _made(SHAPES[name], fields)
    if name.endswith(".toml"):
        with named_in_errors(name):
            return _from_table(read_toml(name), Path(name).parent, fields)
    if "." in name:
        return _of_file(Path(name), fields)
    known = (*SHAPES, *list_presets("indenters"))
    if name not in known:
        hint = "known ones, or name a .toml or a mesh file"
        raise ValueError(unknown_name("indenter", name, known, hint))
    return _from_table(load_preset("indenters", name), Path(), fields)


def _from_table(values: dict[str, Any], folder: Path, fields: dict[str, Any]) -> AnyIndenter:
    values.pop("description", None)
    kinds = [kind for kind in _KINDS if kind in values]
    if len(kinds) != 1:
        raise ValueError(f"{', '.join(kinds) or 'nothing'}: an indenter has one of {', '.join(_KINDS)}")
    kind, what = kinds[0], values.pop(kinds[0])
    if kind != "parts" and not isinstance(what, str):
        raise ValueError(f"{kind} = {what!r}: must be a name in quotes")
    fields = values | fields
    if kind in ("mesh", "map"):
        return _of_file(folder / what, fields)
    if kind == "shape":
        if what not in SHAPES:
            raise ValueError(unknown_name("shape", what, tuple(SHAPES), "known shapes"))
        return _made(SHAPES[what], fields)
    _check_fields(Surface, fields, without=_OF_A_FILE)
    if kind == "parts":
        return sum_surface(_parts(what, folder), **fields)
    if what not in OBJECTS:
        raise ValueError(unknown_name("object", what, tuple(OBJECTS), "known objects"))
    return object_surface(what, **fields)


def _parts(tables: Any, folder: Path) -> list[tuple[Indenter, Place]]:
    """Return the bodies of tables [[parts]], and where each is."""
    if not isinstance(tables, list) or not all(isinstance(table, dict) for table in tables):
        raise ValueError("parts: must be tables [[parts]], each of a body and its at_mm")
    placed: list[tuple[Indenter, Place]] = []
    for number, table in enumerate(tables, 1):
        own = dict(table)
        place = own.pop("at_mm", [0.0, 0.0])
        try:
            x, y, z = (float(place_mm) for place_mm in ([*place, 0.0] if len(place) == 2 else place))
        except (TypeError, ValueError):
            raise ValueError(f"at_mm = {place!r} of part {number}: must be two or three numbers") from None
        if not max(abs(x), abs(y), abs(z)) <= _FURTHEST_PART_MM:
            raise ValueError(f"at_mm = {place!r} of part {number}: must be within ±{_FURTHEST_PART_MM:g} mm")
        with named_in_errors(f"part {number}"):
            placed.append((_from_table(own, folder, {}), (x, y, z)))
    return placed


def _of_file(path: Path, fields: dict[str, Any]) -> Any:
    """Return the body of a mesh file, convex if it is where the gel reaches, or of a height map."""
    if path.suffix.lower() in MAP_SUFFIXES:
        _check_fields(Surface, fields, without=("flip",))
        LOG.warning("%s: larger values reach deeper, or less deep if step_mm is negative", path.name)
        return Surface.load(path, **fields)
    if {"spacing_mm", "step_mm"} & fields.keys():
        raise ValueError(f"indenter = {str(path)!r}: a height map's name ends in {', '.join(MAP_SUFFIXES)}")
    _check_fields(ConvexMesh, fields)
    is_rounded = "edge_radius_mm" not in fields and has_sharp_edges(
        path, fields.get("unit"), fields.get("flip", False)
    )
    if is_rounded:
        fields = fields | {"edge_radius_mm": _CAD_EDGE_MM}
    body: ConvexMesh | Surface
    try:
        body = ConvexMesh.load(path, **fields)
    except NotConvexError:
        body = Surface.load(path, **fields)
    if is_rounded:
        LOG.warning(
            "%s: its sharp edges are rounded by %g mm, unless edge_radius_mm is given", path, _CAD_EDGE_MM
        )
    return body


def _made(shape: type[Any], fields: dict[str, Any]) -> Any:
    _check_fields(shape, fields)
    return shape(**fields)


def _check_fields(body: type[Any], fields: dict[str, Any], without: tuple[str, ...] = ()) -> None:
    known = [name for name in fields_of(body) if name not in without]
    for name in fields:
        if name not in known:
            raise ValueError(f"{name}: a {body.shape} has none; it has {', '.join(known)}")
    # Their values are checked before anything is worked out with them.
    kinds: dict[str, Any] = {
        name: (field.annotation, field)
        for name, field in body.model_fields.items()
        if name in fields and name not in _OF_A_FILE
    }
    create_model("Given", __base__=Settings, **kinds)(**{name: fields[name] for name in kinds})


def _by(size_mm: Floats) -> str:
    return " × ".join(f"{side:.3g}" for side in size_mm)


@lru_cache(maxsize=8)
def _points_mm(points: tuple[tuple[float, float, float], ...]) -> Floats:
    return np.array(points)


@lru_cache(maxsize=8)
def _hull_symmetry(points: tuple[tuple[float, float, float], ...]) -> Symmetry:
    """Return whether the hull reaches as far in directions as in their mirror images, whatever its corners are."""
    from trimesh.creation import icosphere

    directions, corners = icosphere(subdivisions=3).vertices, _points_mm(points)
    reach_mm = (directions @ corners.T).max(axis=1)
    found = Symmetry.NONE
    for sign, mirror in (([-1, 1, 1], Symmetry.MIRROR_X), ([1, -1, 1], Symmetry.MIRROR_Y)):
        if np.abs(reach_mm - ((directions * sign) @ corners.T).max(axis=1)).max() < SAME_MM:
            found |= mirror
    return found
