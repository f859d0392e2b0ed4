"""Solve one scene: a pose, several poses in a row, or a press to a given force; and what force to expect unsolved."""

import math
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import ArrayLike

from gelgap.sim.indenter import Floats, Indenter
from gelgap.sim.path import ContactPath, ForcePath, PosePath
from gelgap.sim.plan import plan_visit
from gelgap.sim.scene import Elastomer, Pose, Sharing, deepest_mm
from gelgap.sim.solved import NoContact, SolvedPose

# Load control ends within this share of its force, or gives up after this many corrections of the depth.
_FORCE_TOLERANCE = 0.01
_DEPTH_CORRECTIONS = 4
_MOST_OF_EXPECTED = 2


def solve_pose(
    elastomer: Elastomer,
    indenter: Indenter,
    pose: Pose,
    quality: str = "standard",
    sharing: Sharing | None = None,
) -> SolvedPose | NoContact:
    """Solve one pose: straight down, then sideways.

    Raises
    ------
    ValueError
        If the pose lies off the pad or deeper than it allows, or there is no such quality.
    """
    return solve_poses(elastomer, indenter, (pose,), quality, sharing)[0]


def solve_poses(
    elastomer: Elastomer,
    indenter: Indenter,
    poses: Sequence[Pose],
    quality: str = "standard",
    sharing: Sharing | None = None,
) -> tuple[SolvedPose | NoContact, ...]:
    """Solve poses that the indenter visits one after the other at one point, as the depths of one descent.

    The first is reached straight down and then sideways, each further one in a straight line from the one before.

    Raises
    ------
    ValueError
        If the poses do not share their point, lie off the pad or deeper than it allows, or there is no such quality.
    """
    plan = plan_visit(elastomer, indenter, poses, quality, sharing)
    solutions = {solve.key: solve.run() for solve in plan.solves}
    return tuple(plan.state(index, solutions) for index in range(len(poses)))


def pose_for_force(
    elastomer: Elastomer,
    indenter: Indenter,
    normal_force_n: float,
    point_mm: tuple[float, float] = (0.0, 0.0),
    quality: str = "standard",
) -> Pose:
    """Return the pose whose depth gives a normal force (load control): `normal_force_n` is positive, as −Fz.

    A descent in ten steps is solved and inverted by a monotone cubic: down to a third of the thickness or 0.8 of the
    indenter's largest depth, and if that does not reach the force, to the largest depth that the gel allows. The depth
    found is solved by itself, on the mesh that it needs, and corrected until its force is within 1 % of the target.

    Raises
    ------
    ValueError
        If the force is not positive or larger than the deepest press gives.
    RuntimeError
        If the descent does not converge, or no depth comes within 1 %.
    """
    if not normal_force_n > 0:
        raise ValueError(f"normal_force_n = {normal_force_n!r}: must be more than 0 N")
    named = f"normal_force_n = {normal_force_n:g}"
    depth_of = _depths_by_force(named, normal_force_n, elastomer, indenter, point_mm, quality)
    point_x_mm, point_y_mm = point_mm
    sought = normal_force_n
    for _ in range(_DEPTH_CORRECTIONS + 1):
        pose = Pose(depth_of(sought), point_x_mm=point_x_mm, point_y_mm=point_y_mm)
        reached = -solve_pose(elastomer, indenter, pose, quality).force_n[2]
        if abs(reached / normal_force_n - 1) <= _FORCE_TOLERANCE:
            return pose
        sought *= normal_force_n / max(reached, normal_force_n / 2)  # a press of nanometres may reach 0 N
    raise RuntimeError(f"load control did not reach {normal_force_n:g} N within {100 * _FORCE_TOLERANCE:g} %")


def path_on_gel(
    path: ForcePath, elastomer: Elastomer, indenter: Indenter, quality: str = "standard"
) -> ContactPath | PosePath:
    """Return a path of forces as the depths that give them on a gel, straight down in the middle of its pad.

    One descent is solved and inverted by a monotone cubic; depths are not corrected one by one as those of
    `pose_for_force`, and travel sideways changes Fz a little, so that a frame's label, not its command, is its force.
    ValueError if a force is larger than the deepest press gives, RuntimeError if the descent does not converge.
    """
    most_n = path.forces_n[-1]
    named = f"force_n = {most_n:g} of path {path.in_newtons.name}"
    depth_of = _depths_by_force(named, most_n, elastomer, indenter, (0.0, 0.0), quality)
    return path.at_depths([depth_of(force) for force in path.forces_n])


def _depths_by_force(
    named: str,
    most_n: float,
    elastomer: Elastomer,
    indenter: Indenter,
    point_mm: tuple[float, float],
    quality: str,
) -> Callable[[float], float]:
    """Return the depth as a function of normal forces up to about `most_n`, which a message calls `named`."""
    from scipy.interpolate import PchipInterpolator

    shallowest, deepest = indenter.shallowest_mm, deepest_mm(elastomer, indenter)
    if deepest <= shallowest:
        raise ValueError(f"{named}: no depth on this gel lets all of the indenter ({indenter.label}) touch")
    usual = min(elastomer.thickness_mm / 3, 0.8 * indenter.deepest_mm, deepest)
    reaches = most_n < _MOST_OF_EXPECTED * expected_force_n(elastomer, indenter, usual)
    for end in (usual, deepest) if shallowest < usual < deepest and reaches else (deepest,):
        depths, force = _descent(end, elastomer, indenter, point_mm, quality)
        if force[-1] >= most_n:
            # Force grows about as a power of the depth, a line in logarithms, which goes on far below the first step.
            logs = np.log([force[1:], depths[1:]])
            far_below = logs[:, 0] - 100 * (logs[:, 1] - logs[:, 0])
            by_power = PchipInterpolator(*np.insert(logs, 0, far_below, axis=1))
            return lambda force_n: round(min(math.exp(by_power(math.log(force_n))), deepest), 6)
    raise ValueError(
        f"{named}: must be at most {force[-1]:.4g} N, at {depths[-1]:.4g} mm, the largest depth that can be solved on "
        "this gel"
    )


def _descent(
    end_mm: float, elastomer: Elastomer, indenter: Indenter, point_mm: tuple[float, float], quality: str
) -> tuple[Floats, Floats]:
    """Return depths in ten steps, as far as they converge, and normal forces there, both from 0."""
    depths = np.append(0.0, np.round(np.linspace(indenter.shallowest_mm, end_mm, 11)[1:], 9))
    point_x_mm, point_y_mm = point_mm
    poses = tuple(Pose(depth, point_x_mm=point_x_mm, point_y_mm=point_y_mm) for depth in depths[1:].tolist())
    states = solve_poses(elastomer, indenter, poses, quality)
    force = np.array([0.0, *(-state.force_n[2] for state in states)])
    holds = [True, *(state.converged for state in states)] & (np.diff(force, prepend=-1.0) > 0)
    number = len(holds) if holds.all() else int(holds.argmin())
    if number < 3:
        raise RuntimeError("the descent that load control inverts did not converge; try another quality")
    return depths[:number], force[:number]


def bonded_layer_force_n(
    young_modulus_mpa: ArrayLike, indenter_radius_mm: ArrayLike, thickness_mm: ArrayLike, depth_mm: ArrayLike
) -> Floats:
    """Return the force (positive) on an incompressible layer bonded to a rigid backing, N; arguments broadcast.

    F = 16/9 · E · √R · d^1.5 · (1 + 1.133χ + 1.283χ² + 0.769χ³ + 0.0975χ⁴) with χ = √(R d)/h
    (Dimitriadis et al. 2002, Biophys. J. 82:2798). Small strain, no friction, paraboloid; 3 % below the exact layer at
    χ = 0.32, 16 % at 1. Against converged finite elements of R = 1.5 mm on 3 mm it is within 0.7 % at d ≤ 0.2 mm.
    """
    radius_mm, depth_mm = np.asarray(indenter_radius_mm, float), np.asarray(depth_mm, float)
    chi = np.sqrt(radius_mm * depth_mm) / np.asarray(thickness_mm)
    correction = 1 + 1.133 * chi + 1.283 * chi**2 + 0.769 * chi**3 + 0.0975 * chi**4
    return 16 / 9 * np.asarray(young_modulus_mpa) * np.sqrt(radius_mm) * depth_mm**1.5 * correction


def expected_force_n(elastomer: Elastomer, indenter: Indenter, depth_mm: float) -> float:
    """Return about what normal force (positive, N) a press takes, without solving it.

    It is the bonded layer's, under the paraboloid that cuts the membrane where the indenter does, in series with the
    mount. Solved presses have up to a quarter more, from large strain and friction.
    """
    depths = np.linspace(0.0, depth_mm, 101)[1:]
    cut_mm = np.array([indenter.penetration_radius_mm(depth) for depth in depths.tolist()])
    modulus_mpa, thickness_mm = elastomer.young_modulus_mpa, elastomer.thickness_mm
    force = bonded_layer_force_n(modulus_mpa, cut_mm**2 / (2 * depths), thickness_mm, depths)
    if elastomer.mount_stiffness_n_per_mm is None:
        return float(force[-1])
    return float(np.interp(depth_mm, depths + force / elastomer.mount_stiffness_n_per_mm, force))
