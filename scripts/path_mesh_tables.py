"""A draft mesh beside the present one: force, surface and run time of presses, touches, long drags and directions.

python scripts/path_mesh_tables.py --what press drag touch direction --quality draft standard --mesh present path

Meshes act with the gel's own moduli, without `mesh_moduli`, in MuJoCo's energy: what a table shows is the mesh's own error.
Presses are compared with the axisymmetric solver in the same energy.
"""

import argparse
import math
import time
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from threadpoolctl import threadpool_limits

from gelgap.benchmarks.fem.spheres import Press, solve_press
from gelgap.sim import Elastomer, Pose, Sharing, Sphere, mujoco_model, newton
from gelgap.sim.membrane import contact_radius_mm
from gelgap.sim.plan import plan_visit
from gelgap.sim.stadium import PathMeshSize, stadium_mesh, touchable

PRESENT = (newton.mesh_for, mujoco_model.touchable)
SIZES = {
    "draft": PathMeshSize(3.5, 8, 2.0, first_layer=0.6, largest_layer=0.25, base_layer=0.12),
    "standard": PathMeshSize(5.6, 12, 2.2, first_layer=0.5, largest_layer=0.25, base_layer=0.12),
}
PRESSES = ((1.5, 3.0, 0.0, (0.2, 0.6, 1.0)), (1.5, 3.0, 10.0, (0.2, 0.6, 1.0)), (6.0, 4.0, 0.0, (0.67, 1.33)))
TOUCHES = tuple(
    (r, h, 0.0, (d,)) for r, h in ((1.5, 3.0), (3.0, 6.0), (5.0, 6.0), (5.0, 20.0)) for d in (0.01, 0.1)
)
DRAGS = ((1.5, 3.0, 0.6, (0.0, 1.5, 2.5, 3.0)), (0.5, 6.0, 0.3, (0.0, 1.0, 2.0)))
DIRECTIONS_DEG = (0, 17, 45, 63, 90)


def solved(
    gel: Elastomer, radius: float, poses: Sequence[Pose], quality: str, size: PathMeshSize | None, **sharing
):
    """Solve poses on a mesh of that size, or the present one; return the solution and what it cost."""
    plan = plan_visit(
        gel, Sphere(diameter_mm=2 * radius), poses, quality, Sharing(cache=False, modulus=False, **sharing)
    )
    problem = plan.solves[0].problem
    own = problem.quality
    disc, pad = (replace(mesh, stiffness=(0.0, 0.0)) for mesh in (own.disc, own.pad))
    problem = replace(problem, quality=replace(own, disc=disc, pad=pad))
    newton.mesh_for, mujoco_model.touchable = PRESENT
    if size is not None:
        newton.mesh_for = lambda problem: stadium_mesh(problem, size)
        mujoco_model.touchable = lambda mesh, *_: touchable(mesh, problem)
    started = time.process_time()
    with threadpool_limits(limits=1, user_api="blas"):
        solver = newton.StaticNewton(problem)
        solution = solver.follow_waypoints()
    cost = {
        "vertices": len(solver.gel.mesh.vertices_mm),
        "iterations": sum(record.diagnostics.iterations for record in solution.records),
        "core_s": round(time.process_time() - started, 1),
        "converged": [record.converged for record in solution.records],
    }
    return solution, cost


def press(
    radius: float, thickness: float, friction: float, depths: tuple[float, ...], quality: str, size
) -> str:
    """Return the errors of a press: force, u_z and u_r at the vertices within 5 mm, contact radius."""
    element = math.sqrt(radius * max(depths)) / 12
    truth = Press(
        poisson_ratio=0.49,
        energy="stable",
        friction=friction,
        indenter_radius_mm=radius,
        thickness_mm=thickness,
        pad_radius_mm=radius + 3.5 * thickness,
        element_mm=element,
    )
    gel = _gel(thickness, friction, 0.49)
    solution, cost = solved(gel, radius, [Pose(depth_mm=depth) for depth in depths], quality, size)
    rows = []
    for record, state in zip(solution.records, solve_press(truth, depths), strict=True):
        rest = solution.rest_mm[np.hypot(*solution.rest_mm.T) < 5]
        moved = record.displacement_mm[np.hypot(*solution.rest_mm.T) < 5]
        r = np.hypot(*rest.T)
        u_r, u_z = state.surface_mm(r)
        outward = (moved[:, :2] * rest).sum(axis=1) / np.maximum(r, 1e-9)
        rms_z, rms_r = (1e3 * np.sqrt((e**2).mean()) for e in (moved[:, 2] - u_z, outward - u_r))
        force = 100 * (record.force_n[2] / state.force_n - 1)
        wide = 100 * (contact_radius_mm(solution, record) / state.contact_radius_mm - 1)
        rows.append(f"Fz {force:+.1f} %, u_z {rms_z:.1f}, u_r {rms_r:.1f} µm, radius {wide:+.1f} %")
    return f"R {radius:g} on {thickness:g}, friction {friction:g}, to {depths[-1]:g} mm: {'; '.join(rows)}; {cost}"


def drag(radius: float, thickness: float, depth: float, travels: Sequence[float], quality: str, size) -> str:
    """Return how Fz changes and what Fx is in a slide without friction, where neither should be anything."""
    poses = [Pose(depth_mm=depth, shear_x_mm=travel) for travel in travels]
    solution, cost = solved(_gel(thickness, 0.0, 0.49), radius, poses, quality, size)
    force = np.array([record.force_n for record in solution.records])[-len(travels) :]
    change, sideways = 100 * (force[:, 2] / force[0, 2] - 1), 100 * force[:, 0] / force[:, 2]
    return f"R {radius:g} on {thickness:g}, {depth:g} mm deep, {travels}: Fz {change.round(2)} %, Fx {sideways.round(2)} %; {cost}"


def direction(angle_deg: float, quality: str, size) -> str:
    """Return the force along and across a drag to full slip on a whole pad."""
    along = np.array([math.cos(math.radians(angle_deg)), math.sin(math.radians(angle_deg))]).round(12)
    gel = _gel(3.0, 0.9, 0.48).model_copy(update={"pad_size_mm": (24.0, 20.0)})
    poses = [Pose(depth_mm=0.8, shear_x_mm=s * along[0], shear_y_mm=s * along[1]) for s in (0.0, 0.4, 0.8)]
    solution, cost = solved(gel, 1.5, poses, quality, size, translation=False)
    force = np.array([record.force_n for record in solution.records])[-2:]
    across = force[:, :2] @ np.array([-along[1], along[0]])
    ahead = force[:, :2] @ along
    return f"{angle_deg}°: along {ahead.round(4)} N, across {(100 * across / ahead).round(2)} %, Fz {force[:, 2].round(4)} N; {cost}"


def _gel(thickness: float, friction: float, poisson: float) -> Elastomer:
    return Elastomer(
        young_modulus_mpa=0.3,
        poisson_ratio=poisson,
        friction=friction,
        thickness_mm=thickness,
        pad_size_mm=(100.0, 100.0),
        strain_energy="stable-neo-hookean",
    )


def main() -> None:
    """Print the tables asked for, row by row."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--what", nargs="+", default=["press", "drag", "touch", "direction"])
    parser.add_argument("--quality", nargs="+", default=["draft", "standard"])
    parser.add_argument("--mesh", nargs="+", default=["present", "path"])
    chosen = parser.parse_args()
    rows = {
        "press": [(press, scene) for scene in PRESSES],
        "touch": [(press, scene) for scene in TOUCHES],
        "drag": [(drag, scene) for scene in DRAGS],
        "direction": [(direction, (angle,)) for angle in DIRECTIONS_DEG],
    }
    for what in chosen.what:
        for function, scene in rows[what]:
            for quality in chosen.quality:
                for mesh in chosen.mesh:
                    size = SIZES[quality] if mesh == "path" else None
                    print(quality, mesh, function(*scene, quality, size), flush=True)


if __name__ == "__main__":
    main()
