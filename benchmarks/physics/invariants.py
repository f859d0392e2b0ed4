"""Invariants of a solved scene: balance, friction limit, monotonic forces, scaling and symmetry."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from gelgap.benchmarks.physics.scenes import Scene
from gelgap.sim import MembraneState, Pose, Sharing, solve_poses

NOTHING_SHARED = Sharing(modulus=False, translation=False, reflection=False, path=False, cache=False)
FORCE_TOLERANCE = 0.01  # of the sphere's force: balance, monotony, scaling, symmetry
DIAGNOSTIC_LIMITS = {"residual": 0.01, "imbalance": FORCE_TOLERANCE, "coulomb_excess": 1e-3, "tension": 0.01}
FORCE_ERROR = {"draft": 0.06, "standard": 0.04, "fine": 0.02}  # what a quality promises


def solve_scene(scene: Scene) -> tuple[MembraneState, ...]:
    """Solve a scene for itself, with nothing shared."""
    return solve_poses(scene.elastomer, scene.indenter, scene.poses, scene.quality, NOTHING_SHARED)


def violations(scene: Scene, states: Sequence[MembraneState]) -> tuple[str, ...]:
    """Return the invariants that the converged states violate.

    Every tenth scene that converged is solved again at another modulus, every tenth mirrored.
    """
    solved = [(pose, state) for pose, state in zip(scene.poses, states, strict=True) if state.converged]
    for _, state in solved:
        if not (np.isfinite(state.force_n).all() and np.isfinite(state.displacement_mm).all()):
            return ("not finite",)
    found = [
        *(violation for _, state in solved for violation in _of_state(state)),
        *_of_press(scene, [state for pose, state in solved if pose.radius_mm == 0]),
        *_of_drag(scene, [(pose, state) for pose, state in solved if pose.radius_mm > 0]),
    ]
    if len(solved) == len(states) and scene.number % 10 == 1:
        found += _of_scaling(scene, states)
    if len(solved) == len(states) and scene.number % 10 == 2:
        found += _of_mirror(scene, states)
    return tuple(dict.fromkeys(found))


def apart(force_n: np.ndarray, other_n: np.ndarray) -> float:
    """Return how far a force is from another, as a share of the first."""
    return float(np.linalg.norm(force_n - other_n) / max(np.linalg.norm(force_n), 1e-12))


def _of_state(state: MembraneState) -> Iterator[str]:
    for name, limit in DIAGNOSTIC_LIMITS.items():
        if (value := getattr(state.diagnostics, name)) > limit:
            yield f"{name} {value:.2g}"
    if state.force_n[2] > 0:
        yield "pulls"
    if state.diagnostics.min_volume_ratio <= 0:
        yield "inverted element"


def _of_press(scene: Scene, presses: Sequence[MembraneState]) -> Iterator[str]:
    force = [state.force_n[2] for state in presses]
    if (
        force
        and scene.to_rim_mm > scene.contact_mm
        and np.any(np.diff(force) > FORCE_TOLERANCE * abs(force[-1]))
    ):
        yield "force falls in a press"


def _of_drag(scene: Scene, drags: Sequence[tuple[Pose, MembraneState]]) -> Iterator[str]:
    """In a straight drag at one depth, far from the rim, friction builds up to its limit and stays there.

    It may fall by the quality's force error, since in slip it changes as the sphere passes the membrane's vertices.
    """
    travel = max(pose.radius_mm for pose in scene.poses)
    if drags and scene.to_rim_mm > scene.contact_mm + travel + scene.elastomer.thickness_mm:
        along = [float(scene.direction @ state.force_n[:2]) for _, state in drags]
        if np.any(np.diff(along) < -FORCE_ERROR[scene.quality] * abs(drags[0][1].force_n[2])):
            yield "friction falls in a drag"


def _of_scaling(scene: Scene, states: Sequence[MembraneState]) -> Iterator[str]:
    young = scene.elastomer.young_modulus_mpa
    factor = 7.0 if young < 0.3 else 1 / 7
    other_gel = scene.elastomer.model_copy(update={"young_modulus_mpa": factor * young})
    others = solve_scene(replace(scene, elastomer=other_gel))
    for state, other in zip(states, others, strict=True):
        if other.converged and apart(state.force_n, other.force_n / factor) > FORCE_TOLERANCE:
            yield "force does not scale with the modulus"


def _of_mirror(scene: Scene, states: Sequence[MembraneState]) -> Iterator[str]:
    mirrored = replace(scene, point_x_mm=-scene.point_x_mm, direction_deg=180 - scene.direction_deg)
    for state, other in zip(states, solve_scene(mirrored), strict=True):
        if other.converged and apart(state.force_n, other.force_n * [-1, 1, 1]) > FORCE_TOLERANCE:
            yield "mirrored scene has another force"
