"""`gelgap benchmark stability --what physics`: hundreds of scenes, each checked against physical invariants.

The scenes are the corners of a box of parameters, and others drawn from it by their number. Each is solved in a process
of its own with a time limit, and its verdict is a JSON line, so that a run that was stopped goes on where it was.
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
from pathlib import Path

import numpy as np
import pandas as pd

from gelgap.benchmarks.common import Results, Setting, run_missing, show, write_json
from gelgap.benchmarks.physics.cases import Case
from gelgap.sim import Elastomer, MembraneState, Pose, Sharing, Sphere, solve_poses
from gelgap.sim.estimate import LARGEST_ESTIMATE

MODULE = "gelgap.benchmarks.physics.stability"
SCENES = 300
QUICK_SCENES = (35, 37, 39)  # drawn ones that are solved soon
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
NOTHING_SHARED = Sharing(modulus=False, translation=False, reflection=False, path=False, cache=False)
PAPERS_REGIME, BEYOND = "the paper's regime", "beyond it"
STATUSES = ("converged", "flagged", "failed")
FORCE_TOLERANCE = 0.01  # by which the force of a press may fall, of the sphere's force


def numbered_case(number: int, quality: str) -> Case:
    """Return scene `number`, a corner of the box or one drawn at random: the last few steps of a press, then a drag."""
    rng = np.random.default_rng(np.random.SeedSequence([20240, number]))

    def uniform(low: float, high: float, digits: int = 6) -> float:
        return round(float(rng.uniform(low, high)), digits)

    def logarithmic(bounds: tuple[float, float]) -> float:
        return round(float(np.exp(rng.uniform(*np.log(bounds)))), 6)

    if number < CORNERS:
        corners = list(itertools.product(YOUNG_MPA, POISSON, FRICTION, RADIUS_MM, THICKNESS_MM))
        young, poisson, friction, radius, thickness = corners[number]
        share, direction_deg, point = 1.0, 0.0, (number // 4 % 2, 0.0)
        step_down, step_sideways = STEP_MM[number % 2], STEP_MM[number // 2 % 2]
    else:
        # The order of the draws is part of a scene's identity.
        radius, thickness = logarithmic(RADIUS_MM), uniform(*THICKNESS_MM)
        young, poisson, friction = logarithmic(YOUNG_MPA), uniform(*POISSON), uniform(*FRICTION)
        share = float(rng.uniform(0.05, 1.0))
        step_down, step_sideways = logarithmic(STEP_MM), logarithmic(STEP_MM)
        direction_deg = uniform(0, 360, 3)
        point = float(rng.uniform(-1, 1)), float(rng.uniform(-1, 1))
    gel = Elastomer(
        young_modulus_mpa=young,
        poisson_ratio=poisson,
        friction=friction,
        thickness_mm=thickness,
        pad_size_mm=PAD_SIZE_MM,
    )
    x_mm, y_mm = (round(at * size / 2, 4) for at, size in zip(point, PAD_SIZE_MM, strict=True))
    depth_mm = round(share * min(0.4 * thickness, 0.8 * radius), 6)
    angle = np.radians(direction_deg)
    direction = np.array([np.cos(angle), np.sin(angle)])
    depths_mm = [round(depth_mm - k * step_down, 9) for k in reversed(range(POSES_DOWN))]
    travels_mm = [k * step_sideways for k in range(1, POSES_SIDEWAYS + 1)]
    shears_mm = [np.round(t * direction, 9) for t in travels_mm if t <= min(thickness, radius)]
    poses = [Pose(depth, point_x_mm=x_mm, point_y_mm=y_mm) for depth in depths_mm if depth > 1e-6]
    poses += [Pose(depth_mm, *shear, point_x_mm=x_mm, point_y_mm=y_mm) for shear in shears_mm]
    small_steps = max(step_down, step_sideways) <= 0.2
    in_papers_regime = poisson <= 0.49 and depth_mm <= thickness / 3 and small_steps
    regime = PAPERS_REGIME if in_papers_regime else BEYOND
    ball = Sphere(diameter_mm=2 * radius)
    return Case(regime, f"scene {number}", gel, tuple(poses), quality, ball, NOTHING_SHARED)


def violations(case: Case, states: Sequence[MembraneState]) -> Iterator[str]:
    """Yield the invariants that the converged states violate.

    Balance, the friction limit and elements' volumes are the audit's, without which no state counts as converged.
    """
    solved = [
        (pose, state.force_n) for pose, state in zip(case.poses, states, strict=True) if state.converged
    ]
    deepest, pad_mm = case.poses[-1], case.elastomer.pad_size_mm
    # The gel between the rim and the circle where a paraboloid at that depth meets the undeformed membrane.
    to_rim_mm = min(pad_mm[0] / 2 - abs(deepest.point_x_mm), pad_mm[1] / 2 - abs(deepest.point_y_mm))
    to_rim_mm -= float(np.sqrt(case.indenter.diameter_mm * deepest.depth_mm))
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
    verdicts = run_missing(
        judge_apart,
        [{"scene": number, "quality": quality} for number in numbers],
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
    summarise(verdicts, out_dir / f"stability-physics-{quality}.json")


def summarise(verdicts: pd.DataFrame, file: Path) -> None:
    """Print and write how many scenes converged, were flagged, failed and violated an invariant, by regime."""
    by_regime = pd.concat([verdicts, verdicts.assign(regime="all")]).groupby("regime")
    counts = by_regime["status"].value_counts().unstack()
    table = counts.reindex([PAPERS_REGIME, BEYOND, "all"], columns=STATUSES).fillna(0).astype(int)
    table.insert(0, "number", table.sum(axis=1))
    table.insert(1, "converged %", 100 * table["converged"] / table["number"])
    table["violate an invariant"] = by_regime["violations"].agg(lambda own: (own.str.len() > 0).sum())
    minutes = verdicts["core_s"].sum() / 60
    targets = "targets: 99 % in the paper's regime, 90 % over all, no violation"
    show(
        "Stability of the physics",
        table.rename_axis("scenes"),
        f"{targets}; {minutes:.0f} core minutes in all",
    )
    kinds = Counter(found for own in verdicts["violations"] for found in own)
    show("Violated invariants", pd.DataFrame(kinds.most_common(), columns=["invariant", "scenes"]))
    write_json(
        file, {"scenes": table.reset_index(names="scenes"), "violations": kinds, "core_minutes": minutes}
    )


def main() -> None:
    """Judge one scene, or all at a quality."""
    parser = argparse.ArgumentParser(description="Stress the physics.")
    parser.add_argument("--only", type=int, help="judge this scene alone and print its verdict")
    parser.add_argument("--quality", default="standard")
    parser.add_argument("--out", type=Path, default=Path("benchmark-results"))
    chosen = parser.parse_args()
    if chosen.only is None:
        judge_scenes(range(CORNERS + SCENES), chosen.quality, chosen.out)
    else:
        print(numbered_case(chosen.only, chosen.quality))
        print(json.dumps(judge(chosen.only, chosen.quality)))


if __name__ == "__main__":
    main()
