"""The benchmark's protocol: groups, methods, what is shown, contacts that are not shared, lights, shifted labels.

Contact points lie on a lattice coloured like a chessboard. As a source a domain is pressed on one colour, as a target
on the other, so that no target point lies within 0.83 mm of a source point. Depths and travels are random in
intervals, those of sources and targets apart. One solve serves three of them at every point and in every direction, so
that a gel takes minutes of a core.
"""

import math
from collections.abc import Iterable
from dataclasses import replace
from typing import Any, Literal

import numpy as np

from gelgap.adapt.inputs import INPUTS
from gelgap.adapt.methods import registry as known
from gelgap.data import LabelledFrames
from gelgap.domains import DomainRecipe, in_drawn_lights, make_recipes, own_recipe
from gelgap.sim import Pose, PosePath

Group = tuple[str, str]
"""Source and target."""
Changes = tuple[tuple[str, Any], ...]
"""Fields of a profile, or settings of a method, that differ from the preset, with their values."""
BY_POINT: Changes = (("split_by", "point"),)
AXES = ("x", "y", "z")

DATA = "disjoint"
Role = Literal["source", "target"]
ROLES: tuple[Role, ...] = ("source", "target")
LATTICE = (10, 6)
"""Columns and rows of all contact points, half of them a source's, half a target's."""
HALF_EXTENT_MM = (3.75, 2.6)
LEVELS = 24
"""Pairs of a depth and a travel of each role: every point has all, each in a direction of its own."""
DEPTH_MM, TRAVEL_MM = (0.15, 1.0), (0.0, 0.6)
QUALITY = "draft"
"""Of the physics: the same for all domains of a group, and a gel takes a few minutes of a core."""

ANY_LIGHT, LIKE = "wmb0-any-light", "wmb0-light-like-"
"""Names of the sources of random light: any, or like that of the target whose name follows."""

SHALLOW_MM, DEEP_SHARE = 0.45, 0.1
"""The shifted target keeps every contact down to this depth, and this share of the deeper ones."""
RANDOM_LIGHTS = (ANY_LIGHT, LIKE)
"""How the names of sources in random light begin."""

GROUPS: tuple[Group, ...] = (
    ("mb0i0", "wmb0i0"),
    ("wmb0i0", "mb0i0"),
    ("wmb0i0", "wmb1i1"),
    ("wmb0i0", "wmb2i2"),
    ("wmb1i1", "wmb0i0"),
    ("wmb1i1", "wmb2i2"),
    ("mb0i0", "wmb1i1"),
    ("mb0i0", "wmb2i2"),
    ("wmb1i1", "mb0i0"),
)
"""The paper's adaptation groups (its table I)."""

PLAIN, UPPER_BOUND = "source-only", "supervised"
METHODS = tuple(name for name in known.METHODS if name != "constant-mean")
"""All methods of gelgap but the constant mean, which is a row of every table."""
MAIN_METHODS = (PLAIN, "adabn", "no-transfer", "classifier-only", "dann", "daregram", "dsan", UPPER_BOUND)
"""The paper's methods, their controls, and training on the labels of both domains."""

LIGHT_GROUPS: tuple[Group, ...] = (
    ("wmb0i0", "wmb0i1"),
    ("wmb0i1", "wmb0i0"),
    ("wmb0i0", "wmb0i2"),
    ("wmb0i2", "wmb0i0"),
    ("mb0i0", "mb0i1"),
)
"""Groups in which nothing but the light changes; in the last one there are markers, whose displacement can be shown."""
LABEL_SHIFT = "label-shift"
BY_ROLE = (DATA, LABEL_SHIFT)
"""Data sets whose domains are pressed at other points as sources than as targets; the second's targets rarely deep."""
PAIRED = "paired"
"""The quick form's data set, in which both domains have the same contacts."""
DATA_SETS = (*BY_ROLE, PAIRED)


KNOWN_GROUPS = {f"{source}:{target}": (source, target) for source, target in (*GROUPS, *LIGHT_GROUPS)}
"""Every group by what is typed for it."""
SHOWABLE = tuple(name for name, shown in INPUTS.items() if not shown.frozen)
"""Inputs that a network can be shown here: a pretrained backbone needs a file."""
DRAWN_LIGHTS = ("any-light", "like-target")
"""What stands in an input's place where the source is drawn in random lights, and pictures are shown."""
SHOWN = (*INPUTS, *DRAWN_LIGHTS)
"""In the order of tables."""


def drawn_source(name: str, target: str) -> str:
    """Return the name of the source that `DRAWN_LIGHTS` means for a target."""
    return ANY_LIGHT if name == "any-light" else LIKE + target


def changes_of(name: str) -> Changes:
    """Return the changes of the profile that show an input; drawn lights show pictures."""
    if name == "pictures" or name in DRAWN_LIGHTS:
        return BY_POINT
    changes: Changes = (*BY_POINT, ("input", name))
    if INPUTS[name].find:
        changes += (("marker_hiding", 0.0),)
    if INPUTS[name].from_touch:
        changes += (("shift_px", 0),)
    return changes


def shown_in(source: str, changes: Changes) -> str | None:
    """Return what a run shows: an input or one of `DRAWN_LIGHTS`; None if its changes are others."""
    if changes == BY_POINT and source.startswith(RANDOM_LIGHTS):
        return "any-light" if source == ANY_LIGHT else "like-target"
    return next((name for name in INPUTS if changes == changes_of(name)), None)


def contact_path(role: Role) -> PosePath:
    """Return the contacts of a role."""
    rng = np.random.default_rng([ROLES.index(role), LEVELS])
    depths, travels = (
        np.round(low + (high - low) * (rng.permutation(LEVELS) + rng.random(LEVELS)) / LEVELS, 3)
        for low, high in (DEPTH_MM, TRAVEL_MM)
    )
    columns, rows = LATTICE
    x_mm, y_mm = (np.linspace(-half, half, n) for half, n in zip(HALF_EXTENT_MM, LATTICE, strict=True))
    cells = [(i, j) for j in range(rows) for i in range(columns) if (i + j) % 2 == ROLES.index(role)]
    poses: list[Pose] = []
    for number, (i, j) in enumerate(cells):
        point_x_mm, point_y_mm = round(float(x_mm[i]), 4), round(float(y_mm[j]), 4)
        levels = rng.permutation(LEVELS)
        angles = 2 * math.pi * (np.arange(LEVELS) + rng.random(LEVELS)) / LEVELS
        if not poses:
            at_rest = Pose(
                depth_mm=0.0, contact_class=0, point_id=number, point_x_mm=point_x_mm, point_y_mm=point_y_mm
            )
            poses.append(at_rest)
        for level, angle in zip(levels, rng.permutation(angles), strict=True):
            shear = travels[level] * np.array([math.cos(angle), math.sin(angle)])
            poses.append(
                Pose(
                    depth_mm=float(depths[level]),
                    shear_x_mm=float(shear[0]),
                    shear_y_mm=float(shear[1]),
                    point_id=number,
                    contact_class=contact_class(depths[level], travels[level], angle),
                    point_x_mm=point_x_mm,
                    point_y_mm=point_y_mm,
                )
            )
    return PosePath(f"benchmark-{role}", tuple(poses))


def touch_path(contacts: PosePath) -> PosePath:
    """Return a straight touch, 0.1 mm deep, of each point of a path."""
    of_points = {pose.point_id: pose for pose in contacts.poses}.values()
    straight = (
        replace(pose, depth_mm=0.1, shear_x_mm=0.0, shear_y_mm=0.0, contact_class=1) for pose in of_points
    )
    return PosePath(f"{contacts.name}-touches", tuple(straight))


def contact_class(depth_mm: float, travel_mm: float, angle: float) -> int:
    """Return the class of the nearest contact on the paper's grid, for methods that align classes."""
    depth = min(4, max(0, round(depth_mm / 0.2) - 1))
    travel = min(5, max(0, round(travel_mm / 0.1) - 1))
    return 1 + 72 * depth + 12 * travel + round(math.degrees(angle) / 30) % 12


def role_recipes(names: Iterable[str], role: Role) -> tuple[DomainRecipe, ...]:
    """Return the recipes of domains as sources or as targets."""
    names = list(names)
    if not names:
        return ()
    return make_recipes(names, contact_path(role), inpainted=(), quality=QUALITY, seed=ROLES.index(role))


def random_light_recipes(target: LabelledFrames | None = None) -> tuple[DomainRecipe, ...]:
    """Return domains of the source's gel in random lights: any, or like the target's picture without contact."""
    name = ANY_LIGHT if target is None else LIKE + target.name
    recipe = own_recipe(name, contact_path("source"), base="wmb0i0", quality=QUALITY, seed=0)
    return in_drawn_lights(recipe, None if target is None else target.reference)


def with_shifted_labels(target: LabelledFrames) -> LabelledFrames:
    """Return a target of which few contacts are deep, as one that is handled more gently than the source."""
    deep = target.columns["depth_mm"] > SHALLOW_MM
    kept = np.random.default_rng(len(deep)).random(len(deep)) < DEEP_SHARE
    return target.take(np.flatnonzero(~deep | kept))
