"""`gelgap benchmark stability`: hundreds of scenes, each checked against physical invariants.

The scenes are the corners of a box of spheres, and others drawn by their number: bodies, gels, depths, slides to 2 mm.
Each is solved in a process of its own with a time limit, those first that are expected to end soon, and its verdict is
a JSON line, so that a run that was stopped goes on where it was.
`python -m gelgap.benchmarks.physics.stability --only 17` is such a process.
"""

import argparse
import itertools
import json
import resource
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd

from gelgap.adapt.result_table import ResultTable
from gelgap.benchmarks.common import Results, Setting, read_records, run_missing
from gelgap.benchmarks.physics.cases import Case
from gelgap.sim import Elastomer, MembraneState, Pose, Sharing, Sphere, load_indenter, solve_poses
from gelgap.sim.cost import expected_core_s
from gelgap.sim.estimate import LARGEST_ESTIMATE
from gelgap.sim.indenter import Indenter
from gelgap.sim.scene import deepest_mm

MODULE = "gelgap.benchmarks.physics.stability"
SCENES = 300
QUICK_SCENES = (59, 64, 40)  # drawn ones that are solved soon
# Of processor time; at `draft` the longest scene took 510 s on a busy machine.
TIME_LIMIT_S = {"draft": 600, "standard": 600, "fine": 1200}
YOUNG_MPA = (0.01, 10.0)
POISSON = (0.3, 0.495)
FRICTION = (0.0, 1.5)
RADIUS_MM = (0.5, 5.0)
THICKNESS_MM = (1.0, 6.0)
STEP_MM = (0.01, 0.5)
PAD_SIZE_MM = (24.0, 20.0)
CORNERS = 2**5
POSES_DOWN, POSES_SIDEWAYS = 4, 3
# Of the drawn scenes.
SHAPES = ("sphere", "cylinder", "cone", "edge", "box", "ellipsoid")
DRAWN_THICKNESS_MM, DRAWN_PAD_MM, BODY_MM = (1.0, 20.0), (10.0, 60.0), (0.8, 10.0)
SHALLOWEST_MM, DEEPEST_SHARE, LONGEST_TRAVEL_MM, STEEPEST_DEG = 0.01, 0.5, 2.0, 6.0
NOTHING_SHARED = Sharing(modulus=False, translation=False, reflection=False, path=False, cache=False)
PAPERS_REGIME, BEYOND = "the paper's regime", "beyond it"
STATUSES = ("converged", "flagged", "failed")
FORCE_TOLERANCE = 0.01  # by which the force of a press may fall, of the sphere's force


def numbered_case(number: int, quality: str) -> Case:
    """Return scene `number`: a corner of the box of spheres, or one drawn at random."""
    return corner_case(number, quality) if number < CORNERS else drawn_case(number, quality)


def corner_case(number: int, quality: str) -> Case:
    """Return a corner of the box of spheres: the last few steps of a press, then a drag; nothing is shared."""
    corners = list(itertools.product(YOUNG_MPA, POISSON, FRICTION, RADIUS_MM, THICKNESS_MM))
    young, poisson, friction, radius, thickness = corners[number]
    step_down, step_sideways = STEP_MM[number % 2], STEP_MM[number // 2 % 2]
    x_mm = number // 4 % 2 * PAD_SIZE_MM[0] / 2
    gel = Elastomer(
        young_modulus_mpa=young,
        poisson_ratio=poisson,
        friction=friction,
        thickness_mm=thickness,
        pad_size_mm=PAD_SIZE_MM,
    )
    depth_mm = round(min(0.4 * thickness, 0.8 * radius), 6)
    depths_mm = [round(depth_mm - k * step_down, 9) for k in reversed(range(POSES_DOWN))]
    travels_mm = [round(k * step_sideways, 9) for k in range(1, POSES_SIDEWAYS + 1)]
    poses = [Pose(depth, point_x_mm=x_mm) for depth in depths_mm if depth > 1e-6]
    poses += [Pose(depth_mm, t, 0.0, point_x_mm=x_mm) for t in travels_mm if t <= min(thickness, radius)]
    small_steps = max(step_down, step_sideways) <= 0.2
    in_papers_regime = poisson <= 0.49 and depth_mm <= thickness / 3 and small_steps
    regime = PAPERS_REGIME if in_papers_regime else BEYOND
    ball = Sphere(diameter_mm=2 * radius)
    return Case(regime, f"scene {number}", gel, tuple(poses), quality, ball, NOTHING_SHARED)


def drawn_case(number: int, quality: str) -> Case:
    """Return a scene drawn at random, of the first draw that can be solved: a press and a slide, by halves."""
    rng = np.random.default_rng(np.random.SeedSequence([20260, number]))
    while True:
        case = _draw(rng, number)
        try:
            case.plan  # noqa: B018 - refuses an edge that is too sharp, or a slide over the pad's rim.
        except ValueError:
            continue
        return replace(case, quality=quality)


def _draw(rng: np.random.Generator, number: int) -> Case:
    def uniform(low: float, high: float) -> float:
        return round(float(rng.uniform(low, high)), 3)

    def logarithmic(bounds: tuple[float, float]) -> float:
        return round(float(np.exp(rng.uniform(*np.log(bounds)))), 4)

    # The order of the draws is part of a scene's identity.
    thickness, pad_mm = (
        logarithmic(DRAWN_THICKNESS_MM),
        (logarithmic(DRAWN_PAD_MM), logarithmic(DRAWN_PAD_MM)),
    )
    gel = Elastomer(
        young_modulus_mpa=logarithmic(YOUNG_MPA),
        poisson_ratio=uniform(*POISSON),
        friction=uniform(*FRICTION),
        thickness_mm=thickness,
        pad_size_mm=pad_mm,
    )
    shape, (a, b, c) = str(rng.choice(SHAPES)), (logarithmic(BODY_MM) for _ in range(3))
    edge_mm, half_angle_deg = max(0.05, uniform(0.08, 0.3) * min(a, b)), uniform(40, 75)
    yaw_deg, is_tilted = uniform(-90, 90), rng.random() < 0.4
    tilt_deg = [uniform(-STEEPEST_DEG, STEEPEST_DEG) * is_tilted for _ in range(2)]
    turned: Results = {"yaw_deg": yaw_deg, "tilt_deg": tilt_deg}
    sizes: dict[str, Results] = {
        "sphere": {"diameter_mm": a},
        "cylinder": {"diameter_mm": a, "edge_radius_mm": edge_mm, **turned},
        "cone": {"diameter_mm": a, "half_angle_deg": half_angle_deg, "tip_radius_mm": edge_mm, **turned},
        "edge": {"diameter_mm": a, "length_mm": b, "edge_radius_mm": edge_mm, **turned},
        "box": {"size_mm": (a, b), "edge_radius_mm": edge_mm, **turned},
        "ellipsoid": {"diameters_mm": (a, b, c), **turned},
    }
    body: Indenter = load_indenter(shape, **sizes[shape])
    deepest = min(DEEPEST_SHARE * thickness, deepest_mm(gel, body))
    depth_mm = min(logarithmic((SHALLOWEST_MM, DEEPEST_SHARE * thickness)), deepest)
    travel_mm = uniform(0, min(LONGEST_TRAVEL_MM, thickness)) * (rng.random() < 0.7)
    angle, (x_mm, y_mm) = rng.uniform(0, 2 * np.pi), (uniform(-0.35, 0.35) * size for size in pad_mm)
    shear_mm = travel_mm * np.array([np.cos(angle), np.sin(angle)])
    commands = [(depth_mm / 2, 0 * shear_mm), (depth_mm, 0 * shear_mm)]
    commands += [(depth_mm, 0.5 * shear_mm), (depth_mm, shear_mm)] if travel_mm else []
    poses = [
        Pose(depth, *shear.round(9).tolist(), point_x_mm=x_mm, point_y_mm=y_mm) for depth, shear in commands
    ]
    return Case(shape, f"scene {number}", gel, tuple(poses), "draft", body)


def violations(case: Case, states: Sequence[MembraneState]) -> Iterator[str]:
    """Yield the invariants that the converged states violate.

    Balance, the friction limit and elements' volumes are the audit's, without which no state counts as converged.
    """
    solved = [
        (pose, state.force_n) for pose, state in zip(case.poses, states, strict=True) if state.converged
    ]
    deepest, pad_mm = case.poses[-1], case.elastomer.pad_size_mm
    # The gel between the rim and the circle around where the body at that depth cuts the undeformed membrane.
    to_rim_mm = min(pad_mm[0] / 2 - abs(deepest.point_x_mm), pad_mm[1] / 2 - abs(deepest.point_y_mm))
    to_rim_mm -= case.indenter.penetration_radius_mm(deepest.depth_mm)
    if not all(
        np.isfinite(state.force_n).all() and np.isfinite(state.displacement_mm).all() for state in states
    ):
        yield "not a number"
    if any(force[2] > 0 for _, force in solved):
        yield "pulls"
    fz = [force[2] for pose, force in solved if pose.radius_mm == 0]
    if fz and to_rim_mm > 0 and np.any(np.diff(fz) > FORCE_TOLERANCE * abs(fz[-1])):
        yield "force falls in a press"
    # In a straight drag at one depth, far from the rim, friction builds up to its limit and stays there. It may fall by
    # what the quality promises, since in slip it changes as the sphere passes the membrane's vertices.
    drags = [(pose, force) for pose, force in solved if pose.radius_mm > 0]
    if drags and to_rim_mm > deepest.radius_mm + case.elastomer.thickness_mm:
        along = [(p.shear_x_mm * f[0] + p.shear_y_mm * f[1]) / p.radius_mm for p, f in drags]
        if np.any(np.diff(along) < -2 * LARGEST_ESTIMATE[case.quality] * abs(drags[0][1][2])):
            yield "friction falls in a drag"


def judge(number: int, quality: str) -> Results:
    """Solve a scene and compare it with the invariants; `flagged` is one of which the solver says that it failed."""
    started, case = time.process_time(), numbered_case(number, quality)
    states = solve_poses(case.elastomer, case.indenter, case.poses, quality, case.sharing)
    flagged = [index for index, state in enumerate(states) if not state.converged]
    return {
        "regime": case.study,
        "status": "flagged" if flagged else "converged",
        "violations": list(violations(case, states)),
        "core_s": time.process_time() - started,
        "expected_s": expected_core_s(case.solve.problem),
        "detail": f"pose {flagged[0]} of {len(states)} did not converge" if flagged else "",
    }


def judge_apart(setting: Setting) -> Results:
    """Judge a scene in a process of its own; a crash, an error or a time-out is a verdict too."""
    number, quality = setting["scene"], setting["quality"]
    limit_s = TIME_LIMIT_S[quality]
    done = subprocess.run(
        [sys.executable, "-m", MODULE, "--only", str(number), "--quality", quality],
        capture_output=True,
        text=True,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_CPU, (limit_s, limit_s + 5)),
    )
    if done.returncode == 0:
        return json.loads(done.stdout.splitlines()[-1])
    failure, spent_s = f"process ended with code {done.returncode}", 0
    if done.returncode == -signal.SIGXCPU:
        failure, spent_s = f"no end within {limit_s} s of processor time", limit_s
    elif done.returncode == 1:
        failure = done.stderr.strip().splitlines()[-1]
    return {
        "regime": numbered_case(number, quality).study,
        "status": "failed",
        "violations": [],
        "core_s": spent_s,
        "expected_s": float("nan"),
        "detail": failure,
    }


def run(quick: bool, out_dir: Path) -> None:
    """Judge three drawn scenes at `draft`, or the corners and 300 drawn ones at `standard`, and print the summary."""
    if quick:
        judge_scenes(QUICK_SCENES, "draft", out_dir)
    else:
        judge_scenes(range(CORNERS + SCENES), "standard", out_dir)


def judge_scenes(numbers: Sequence[int], quality: str, out_dir: Path) -> None:
    """Judge the scenes that `out_dir` does not hold yet; write how to repeat those that failed, and the summary."""
    expected_s = {number: expected_core_s(numbered_case(number, quality).solve.problem) for number in numbers}
    verdicts = run_missing(
        judge_apart,
        [{"scene": number, "quality": quality} for number in sorted(numbers, key=expected_s.__getitem__)],
        out_dir / f"stability-physics-{quality}.jsonl",
        describe=lambda record: " ".join([record["status"], *record["violations"]]),
    )
    failing = verdicts[(verdicts["status"] != "converged") | (verdicts["violations"].str.len() > 0)]
    commands = out_dir / f"stability-physics-{quality}-failing.txt"
    with commands.open("w", encoding="utf-8") as file:
        for one in failing.itertuples():
            reason = "; ".join(filter(None, (one.status, one.detail, *one.violations)))
            print(f"python -m {MODULE} --only {one.scene} --quality {quality}  # {reason}", file=file)
    print(f"{len(failing)} scenes that did not converge or violate an invariant: {commands}")
    for table in tables(verdicts):
        table.show()


def tables(verdicts: pd.DataFrame) -> list[ResultTable]:
    """Return by regime how many scenes converged, were flagged, failed and violated an invariant, and their cost."""
    by_regime = pd.concat([verdicts, verdicts.assign(regime="all")]).groupby("regime")
    counts = by_regime["status"].value_counts().unstack()
    regimes = [name for name in (PAPERS_REGIME, BEYOND, *SHAPES, "all") if name in counts.index]
    table = counts.reindex(regimes, columns=STATUSES).fillna(0).astype(int)
    table.insert(0, "number", table.sum(axis=1))
    table.insert(1, "converged %", 100 * table["converged"] / table["number"])
    table["violate an invariant"] = by_regime["violations"].agg(lambda own: (own.str.len() > 0).sum())
    for name, share in (("median", 0.5), ("90 %", 0.9), ("worst", 1.0)):
        table[f"core s {name}"] = by_regime["core_s"].quantile(share)
    forecast = (verdicts["expected_s"] / verdicts["core_s"]).quantile([0.0, 0.1, 0.5, 0.9, 1.0])
    minutes = verdicts["core_s"].sum() / 60
    targets = "targets: 99 % in the paper's regime, 90 % over all, no violation"
    kinds = Counter(found for own in verdicts["violations"] for found in own)
    return [
        ResultTable.of(
            "Stability of the physics",
            table.rename_axis("scenes"),
            f"{targets}; {minutes:.0f} core minutes in all",
        ),
        ResultTable.of(
            "Expected over real core seconds", forecast.rename("ratio").to_frame(), "aim: 0.67 to 1.5"
        ),
        ResultTable.of(
            "Violated invariants", pd.DataFrame(kinds.most_common(), columns=["invariant", "scenes"])
        ),
    ]


def main() -> None:
    """Judge one scene and print its verdict, or print the tables of a file of verdicts."""
    parser = argparse.ArgumentParser(description="Stress the physics by one scene.")
    parser.add_argument("--only", type=int, help="number of the scene")
    parser.add_argument("--quality", default="standard")
    parser.add_argument(
        "--table", type=Path, metavar="FILE", help="print the tables of a file of records instead"
    )
    chosen = parser.parse_args()
    if chosen.table is not None:
        print("\n".join(table.markdown() for table in tables(read_records(chosen.table))))
        return
    if chosen.only is None:
        parser.error("name a scene by --only, or a file of records by --table")
    print(numbered_case(chosen.only, chosen.quality))
    print(json.dumps(judge(chosen.only, chosen.quality)))


if __name__ == "__main__":
    main()
