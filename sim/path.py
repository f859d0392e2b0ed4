"""Contact paths: the poses that the indenter visits, on the paper's grid, along trajectories, or at random."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import product
from pathlib import Path
from typing import Any, Self

import numpy as np

from gelgap.assets import load_preset
from gelgap.assets.names import one_line
from gelgap.assets.toml_file import named_in_errors, read_toml
from gelgap.sim.scene import NO_CLASS, Pose

# The paper's grid of contacts; any path that visits one of them gives it the paper's number.
CLASS_DEPTHS_MM = (0.2, 0.4, 0.6, 0.8, 1.0)
CLASS_RADII_MM = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6)
CLASS_ANGLES_DEG = tuple(30.0 * k for k in range(12))
CLASS_POINTS_X_MM = (-3.75, -2.25, -0.75, 0.75, 2.25, 3.75)
CLASS_POINTS_Y_MM = (-2.6, -1.3, 0.0, 1.3, 2.6)
MOST_POSES = 1_000_000


@dataclass(frozen=True)
class ContactPath:
    """Every combination of points, depths, radii and angles, and one reference without contact per point.

    The order is the paper's: point by point, the reference first, then depth by depth, and at one depth the circle of
    all angles before the next radius.
    """

    name: str
    points_x_mm: tuple[float, ...]
    points_y_mm: tuple[float, ...]
    depths_mm: tuple[float, ...]
    radii_mm: tuple[float, ...]
    angles_deg: tuple[float, ...]

    @classmethod
    def preset(cls, name: str) -> Self:
        """Return the path preset of that name.

        Raises
        ------
        ValueError
            If there is no such preset; the message lists the known ones.
        """
        path = load_path(name)
        if not isinstance(path, cls):
            raise ValueError(f"path preset {name!r} is not a grid but a list of poses: use load_path")
        return path

    @cached_property
    def poses(self) -> tuple[Pose, ...]:
        points = [(x, y) for y in self.points_y_mm for x in self.points_x_mm]
        return tuple(pose for index, point in enumerate(points) for pose in self._poses_at(index, *point))

    def _poses_at(self, index: int, x_mm: float, y_mm: float) -> list[Pose]:
        at_point = partial(Pose, point_x_mm=x_mm, point_y_mm=y_mm, point_id=_point_id(x_mm, y_mm, index))
        contacts = product(self.depths_mm, self.radii_mm, self.angles_deg)
        return [at_point(depth_mm=0.0, contact_class=0)] + [
            at_point(
                depth_mm=depth,
                shear_x_mm=radius * _cosine(angle),
                shear_y_mm=radius * _cosine(angle - 90.0),
                contact_class=_contact_class(depth, radius, angle),
            )
            for depth, radius, angle in contacts
        ]


@dataclass(frozen=True)
class DrawnPath(ContactPath):
    """A grid of which each point has only some contacts: as many points as the grid, in fewer frames.

    At each point `contacts_per_point` of the grid's contacts are drawn, always the same ones, and kept in the grid's
    order; the reference comes before them. They share the solves of the whole grid.
    """

    contacts_per_point: int

    def __post_init__(self) -> None:
        contacts = len(self.depths_mm) * len(self.radii_mm) * len(self.angles_deg)
        if not 1 <= self.contacts_per_point <= contacts:
            raise ValueError(
                f"contacts_per_point = {self.contacts_per_point} of path {self.name}: must be 1 to {contacts}, "
                "the contacts of the grid"
            )

    def _poses_at(self, index: int, x_mm: float, y_mm: float) -> list[Pose]:
        reference, *contacts = super()._poses_at(index, x_mm, y_mm)
        order = np.random.default_rng(np.random.SeedSequence([index])).permutation(len(contacts))
        return [reference, *(contacts[k] for k in sorted(order[: self.contacts_per_point]))]


@dataclass(frozen=True)
class PosePath:
    """Any poses under a name, in the order of their frames."""

    __repr__ = one_line

    name: str
    poses: tuple[Pose, ...]

    @classmethod
    def from_trajectories(cls, name: str, trajectories: Sequence[Mapping[str, Any]]) -> Self:
        """Return a path of trajectories {"point_mm": (x, y), "waypoints_mm": ((shear x, shear y, depth), …)}.

        A reference without contact comes before each. The first waypoint is reached straight down and then sideways.
        How far the indenter is turned at each waypoint may be in lists as long, "twist_deg" and "roll_deg" (x, y).

        Raises
        ------
        ValueError
            If a trajectory lacks waypoints, or one of its lists does not hold that many numbers.
        """
        points: dict[tuple[float, ...], int] = {}
        poses = []
        for number, trajectory in enumerate(trajectories):
            where = f"trajectory {number} of path {name}"
            if not isinstance(trajectory, Mapping):
                raise ValueError(f"{where} = {trajectory!r}: must be a table of point_mm and waypoints_mm")
            known = ("point_mm", "waypoints_mm", "twist_deg", "roll_deg")
            if unknown := trajectory.keys() - set(known):
                raise ValueError(f"{where}: unknown field {sorted(unknown)[0]}; known: {', '.join(known)}")
            x, y = point = _numbers(trajectory.get("point_mm", (0.0, 0.0)), 2, f"point_mm of {where}")
            waypoints = trajectory.get("waypoints_mm")
            if not waypoints or not isinstance(waypoints, Sequence):
                raise ValueError(f"waypoints_mm of {where} = {waypoints!r}: must list at least one waypoint")
            index = points.setdefault(point, len(points))
            at_point = partial(Pose, point_x_mm=x, point_y_mm=y, point_id=_point_id(x, y, index))
            poses.append(at_point(depth_mm=0.0, contact_class=0))
            count = len(waypoints)
            twists = _numbers(trajectory.get("twist_deg", [0.0] * count), count, f"twist_deg of {where}")
            rolls = trajectory.get("roll_deg", [(0.0, 0.0)] * count)
            if not isinstance(rolls, Sequence) or len(rolls) != count:
                raise ValueError(f"roll_deg of {where} = {rolls!r}: must be {count} pairs of numbers")
            for waypoint, twist, roll in zip(waypoints, twists, rolls, strict=True):
                shear_x, shear_y, depth = _numbers(waypoint, 3, f"a waypoint of {where}")
                roll_x, roll_y = _numbers(roll, 2, f"a roll_deg of {where}")
                turned = at_point(depth, shear_x, shear_y, twist_deg=twist, roll_deg=(roll_x, roll_y))
                poses.append(replace(turned, trajectory=number))
        return cls(name, tuple(poses))

    @classmethod
    def random(
        cls,
        name: str,
        *,
        number: int,
        seed: int = 0,
        point_x_mm: Sequence[float] = (0.0, 0.0),
        point_y_mm: Sequence[float] = (0.0, 0.0),
        depth_mm: Sequence[float] = (0.05, 1.0),
        radius_mm: Sequence[float] = (0.0, 0.6),
    ) -> Self:
        """Return a reference without contact and `number` poses drawn evenly from ranges, in any direction.

        The same seed always gives the same poses. Every pose has its own depth, and so its own solve.

        Raises
        ------
        ValueError
            If the number is below 1, the seed below 0, or a range is not a pair of rising numbers.
        """
        for field, value, least in (("number", number, 1), ("seed", seed, 0)):
            if not isinstance(value, int) or isinstance(value, bool) or value < least:
                raise ValueError(f"{field} = {value!r} of path {name}: must be a whole number from {least}")
        _check_number(number, name)
        ranges = {
            "point_x_mm": point_x_mm,
            "point_y_mm": point_y_mm,
            "depth_mm": depth_mm,
            "radius_mm": radius_mm,
        }
        ends = [_numbers(values, 2, f"{field} of path {name}") for field, values in ranges.items()]
        for (start, stop), (field, values) in zip(ends, ranges.items(), strict=True):
            if stop < start:
                raise ValueError(f"{field} = {list(values)!r} of path {name}: must rise from its first value")
        low, high = zip(*ends, (0.0, 360.0), strict=True)
        rng = np.random.default_rng(np.random.SeedSequence([seed, number]))
        drawn = np.round(rng.uniform(low, high, (number, 5)), 6)
        poses = [Pose(depth_mm=0.0, contact_class=0, point_id=_point_id(math.nan, math.nan, 0))]
        for index, (x, y, depth, radius, angle) in enumerate(map(tuple, drawn.tolist())):
            poses.append(
                Pose(
                    depth_mm=depth,
                    shear_x_mm=round(radius * _cosine(angle), 9),
                    shear_y_mm=round(radius * _cosine(angle - 90.0), 9),
                    point_x_mm=x,
                    point_y_mm=y,
                    point_id=_point_id(x, y, index + 1),
                )
            )
        return cls(name, tuple(poses))


@dataclass(frozen=True)
class ForcePath:
    """Contacts that are pressed to normal forces: `path_on_gel` finds the depths, which are another gel's own.

    `in_newtons` is the path with a force (positive, N) where each depth would stand.
    """

    __repr__ = one_line

    in_newtons: ContactPath | PosePath

    @property
    def forces_n(self) -> tuple[float, ...]:
        """The different forces, rising, without 0."""
        return tuple(sorted({pose.depth_mm for pose in self.in_newtons.poses} - {0.0}))

    def at_depths(self, depths_mm: Sequence[float]) -> ContactPath | PosePath:
        """Return the path with each of `forces_n` replaced by its depth."""
        depth_of = dict(zip(self.forces_n, depths_mm, strict=True)) | {0.0: 0.0}
        path = self.in_newtons
        if isinstance(path, ContactPath):
            return replace(path, depths_mm=tuple(depth_of[force] for force in path.depths_mm))
        return replace(
            path, poses=tuple(replace(pose, depth_mm=depth_of[pose.depth_mm]) for pose in path.poses)
        )


def load_path(name: str) -> ContactPath | PosePath | ForcePath:
    """Return the path of a TOML file (a name that ends in .toml) or of a preset.

    The TOML holds the lists of a `ContactPath`, with `contacts_per_point` those of a `DrawnPath`, or `[[trajectories]]`
    as `PosePath.from_trajectories` takes them, or `[random]` with the arguments of `PosePath.random`. A grid with
    `forces_n` instead of `depths_mm`, or `[random]` with `force_n` instead of `depth_mm`, is a `ForcePath`.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If there is no such preset (the message lists the known ones), or the file does not describe a path.
    """
    if not name.endswith(".toml"):
        return _path(name, load_preset("paths", name))
    with named_in_errors(name):
        return _path(Path(name).stem, read_toml(name))


def _path(name: str, values: dict[str, Any]) -> ContactPath | PosePath | ForcePath:
    values.pop("description", None)
    random = values.get("random")
    if "forces_n" in values or (isinstance(random, dict) and "force_n" in random):
        return _force_path(name, values)
    if values.keys() == {"trajectories"}:
        if not isinstance(values["trajectories"], list):
            raise ValueError(f"trajectories of path {name}: must be tables [[trajectories]]")
        return PosePath.from_trajectories(name, values["trajectories"])
    if values.keys() == {"random"}:
        try:
            return PosePath.random(name, **values["random"])
        except (TypeError, OverflowError) as error:
            raise ValueError(f"[random] of path {name}: {error}") from None
    fields = ("points_x_mm", "points_y_mm", "depths_mm", "radii_mm", "angles_deg")
    if values.keys() - {"contacts_per_point"} != set(fields):
        raise ValueError(
            f"{', '.join(values) or 'nothing'} in path {name!r}: must be {', '.join(fields)} (and contacts_per_point), "
            "or [[trajectories]], or [random]"
        )
    numbers = {field: _numbers(values[field], None, f"{field} of path {name}") for field in fields}
    _check_number(math.prod(map(len, numbers.values())), name)
    if min(numbers["depths_mm"]) < 0:
        raise ValueError(f"depths_mm of path {name} = {values['depths_mm']!r}: must be 0 or more")
    if "contacts_per_point" not in values:
        return ContactPath(name, **numbers)
    number = values["contacts_per_point"]
    if not isinstance(number, int) or isinstance(number, bool):
        raise ValueError(f"contacts_per_point of path {name} = {number!r}: must be a whole number")
    return DrawnPath(name, **numbers, contacts_per_point=number)


def _force_path(name: str, values: dict[str, Any]) -> ForcePath:
    """Return the path whose depths are forces; messages call them so."""
    is_grid = "forces_n" in values
    force, depth = ("forces_n", "depths_mm") if is_grid else ("force_n", "depth_mm")
    of_forces = values if is_grid else values["random"]
    if depth in of_forces:
        raise ValueError(f"path {name} has forces and depths: give one of them")
    of_depths = {depth if field == force else field: value for field, value in of_forces.items()}
    try:
        path = _path(name, of_depths if is_grid else {"random": of_depths})
    except ValueError as error:
        message = str(error).replace("depths_mm", "forces_n").replace("depth_mm", "force_n")
        raise ValueError(message) from None
    if isinstance(path, ForcePath):
        raise ValueError(f"path {name} has forces_n and [random] with force_n: give one of them")
    return ForcePath(path)


def _check_number(poses: int, name: str) -> None:
    if poses > MOST_POSES:
        raise ValueError(f"path {name} has {poses} poses: allowed are up to {MOST_POSES}")


def _numbers(values: Any, length: int | None, what: str) -> tuple[float, ...]:
    """Return the values as floats, or raise ValueError if they are not `length` numbers (None: at least one)."""
    numeric = isinstance(values, (list, tuple)) and all(
        isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)
        for value in values
    )
    if not numeric or (len(values) != length if length is not None else not values):
        raise ValueError(f"{what} = {values!r}: must be {'a list of' if length is None else length} numbers")
    return tuple(map(float, values))


def _cosine(angle_deg: float) -> float:
    return round(math.cos(math.radians(angle_deg)), 15)


def _contact_class(depth_mm: float, radius_mm: float, angle_deg: float) -> int:
    """Return the number of a contact on the grid, from 1 on, or `NO_CLASS` for one off it."""
    depth = _index(depth_mm, CLASS_DEPTHS_MM)
    radius = _index(radius_mm, CLASS_RADII_MM)
    angle = _index(angle_deg % 360.0, CLASS_ANGLES_DEG)
    if depth is None or radius is None or angle is None:
        return NO_CLASS
    directions = len(CLASS_ANGLES_DEG)
    return 1 + directions * len(CLASS_RADII_MM) * depth + directions * radius + angle


def _point_id(x_mm: float, y_mm: float, index: int) -> int:
    """Return the number of a contact point on the grid; others, in the order `index` of their path, come after it."""
    column, row = _index(x_mm, CLASS_POINTS_X_MM), _index(y_mm, CLASS_POINTS_Y_MM)
    if column is None or row is None:
        return len(CLASS_POINTS_X_MM) * len(CLASS_POINTS_Y_MM) + index
    return len(CLASS_POINTS_X_MM) * row + column


def _index(value: float, values: Sequence[float]) -> int | None:
    return next((k for k, known in enumerate(values) if math.isclose(value, known, abs_tol=1e-9)), None)
