"""`gelgap benchmark stability --what physics`: hundreds of scenes, each checked against physical invariants.

The scenes are the corners of a box of parameters, and others drawn from it by their number. Each is solved in a process
of its own with a time limit, and its verdict is a JSON line, so that a run that was stopped goes on where it was.
`python -m gelgap.benchmarks.physics.stability --only 17` repeats one scene.
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
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd

from gelgap.benchmarks.common import Results, Setting, run_missing, show, write_json
from gelgap.sim import Elastomer, MembraneState, Pose, Sharing, Sphere, solve_poses
from gelgap.sim.estimate import LARGEST_ESTIMATE

MODULE = "gelgap.benchmarks.physics.stability"
SCENES = 300
QUICK_SCENES = (35, 37, 39)  # drawn ones that are solved soon
# Of processor time; at `draft` the longest scene took 510 s on a busy machine.
TIME_LIMIT_S = {"draft": 600, "standard": 600, "fine": 1200}
WALL_PER_PROCESSOR = 10  # a process that sleeps, or starves on a busy machine, ends after this many limits
SOLVED_AT_FINE = 20
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
FORCE_TOLERANCE = 0.01  # of the sphere's force: monotony, scaling, symmetry
# What a quality promises.
FORCE_ERROR = {quality: 2 * largest for quality, largest in LARGEST_ESTIMATE.items()}


@dataclass(frozen=True)
class Scene:
    """A press in steps, then a drag in steps, of which the last few are recorded."""

    number: int
    quality: str
    elastomer: Elastomer
    indenter: Sphere
    depth_mm: float
    step_down_mm: float
    step_sideways_mm: float
    direction_deg: float
    point_mm: tuple[float, float]

    @property
    def poses(self) -> tuple[Pose, ...]:
        place = dict(zip(("point_x_mm", "point_y_mm"), self.point_mm, strict=True))
        down = [self.depth_mm - k * self.step_down_mm for k in reversed(range(POSES_DOWN))]
        furthest = min(self.elastomer.thickness_mm, self.indenter.radius_mm)
        travels = [k * self.step_sideways_mm for k in range(1, POSES_SIDEWAYS + 1)]
        drags = [np.round(travel * self.direction, 9) for travel in travels if travel <= furthest]
        return (
            *(Pose(depth_mm=round(depth, 9), **place) for depth in down if depth > 1e-6),
            *(Pose(depth_mm=self.depth_mm, shear_x_mm=x, shear_y_mm=y, **place) for x, y in drags),
        )

    @property
    def direction(self) -> np.ndarray:
        """The unit vector (2,) of the drag."""
        angle = np.radians(self.direction_deg)
        return np.array([np.cos(angle), np.sin(angle)])

    @property
    def in_papers_regime(self) -> bool:
        shallow = self.depth_mm <= self.elastomer.thickness_mm / 3
        small_steps = max(self.step_down_mm, self.step_sideways_mm) <= 0.2
        return self.elastomer.poisson_ratio <= 0.49 and shallow and small_steps

    @property
    def clear_of_rim_mm(self) -> float:
        """The gel between the rim and the circle where a paraboloid at that depth meets the undeformed membrane."""
        to_rim = min(size / 2 - abs(at) for size, at in zip(PAD_SIZE_MM, self.point_mm, strict=True))
        return to_rim - float(np.sqrt(self.indenter.diameter_mm * self.depth_mm))

    def solve(self) -> tuple[MembraneState, ...]:
        """Solve the scene for itself, with nothing shared."""
        return solve_poses(self.elastomer, self.indenter, self.poses, self.quality, NOTHING_SHARED)


def numbered_scene(number: int, quality: str) -> Scene:
    """Return scene `number`: a corner of the box, or one drawn at random."""
    rng = np.random.default_rng(np.random.SeedSequence([20240, number]))

    def uniform(low: float, high: float, digits: int = 6) -> float:
        return round(float(rng.uniform(low, high)), digits)

    def logarithmic(bounds: tuple[float, float]) -> float:
        return round(float(np.exp(rng.uniform(*np.log(bounds)))), 6)

    if number < CORNERS:
        corners = list(itertools.product(YOUNG_MPA, POISSON, FRICTION, RADIUS_MM, THICKNESS_MM))
        young, poisson, friction, radius, thickness = corners[number]
        share, direction_deg, point = 1.0, 0.0, (number // 4 % 2, 0.0)
        steps = STEP_MM[number % 2], STEP_MM[number // 2 % 2]
    else:
        # The order of the draws is part of a scene's identity.
        radius, thickness = logarithmic(RADIUS_MM), uniform(*THICKNESS_MM)
        young, poisson, friction = logarithmic(YOUNG_MPA), uniform(*POISSON), uniform(*FRICTION)
        share = float(rng.uniform(0.05, 1.0))
        steps = logarithmic(STEP_MM), logarithmic(STEP_MM)
        direction_deg = uniform(0, 360, 3)
        point = float(rng.uniform(-1, 1)), float(rng.uniform(-1, 1))
    gel = Elastomer(
        young_modulus_mpa=young,
        poisson_ratio=poisson,
        friction=friction,
        thickness_mm=thickness,
        pad_size_mm=PAD_SIZE_MM,
    )
    depth_mm = round(share * min(0.4 * thickness, 0.8 * radius), 6)
    point_mm = tuple(round(at * size / 2, 4) for at, size in zip(point, PAD_SIZE_MM, strict=True))
    return Scene(
        number, quality, gel, Sphere(diameter_mm=2 * radius), depth_mm, *steps, direction_deg, point_mm
    )


def violations(scene: Scene, states: Sequence[MembraneState]) -> Iterator[str]:
    """Yield the invariants that the converged states violate: monotonic forces, scaling, symmetry.

    Balance, the friction limit and elements' volumes are the audit's, without which no state counts as converged.
    Every tenth scene that converged is solved again at another modulus, every tenth mirrored; not at `fine`.
    """
    solved = [(pose, state) for pose, state in zip(scene.poses, states, strict=True) if state.converged]
    if any(state.force_n[2] > 0 for _, state in solved):
        yield "pulls"
    fz = [state.force_n[2] for pose, state in solved if pose.radius_mm == 0]
    if fz and scene.clear_of_rim_mm > 0 and np.any(np.diff(fz) > FORCE_TOLERANCE * abs(fz[-1])):
        yield "force falls in a press"
    # In a straight drag at one depth, far from the rim, friction builds up to its limit and stays there. It may fall by
    # the quality's force error, since in slip it changes as the sphere passes the membrane's vertices.
    drags = [state.force_n for pose, state in solved if pose.radius_mm > 0]
    travel = max(pose.radius_mm for pose in scene.poses)
    if drags and scene.clear_of_rim_mm > travel + scene.elastomer.thickness_mm:
        along = [float(scene.direction @ force[:2]) for force in drags]
        if np.any(np.diff(along) < -FORCE_ERROR[scene.quality] * abs(drags[0][2])):
            yield "friction falls in a drag"
    if len(solved) == len(states) and scene.quality != "fine":
        young = scene.elastomer.young_modulus_mpa
        factor = 7.0 if young < 0.3 else 1 / 7
        stiffer = scene.elastomer.model_copy(update={"young_modulus_mpa": factor * young})
        x_mm, y_mm = scene.point_mm
        mirrored = replace(scene, point_mm=(-x_mm, y_mm), direction_deg=180 - scene.direction_deg)
        if scene.number % 10 == 1 and _differ(states, replace(scene, elastomer=stiffer), 1 / factor):
            yield "force does not scale with the modulus"
        if scene.number % 10 == 2 and _differ(states, mirrored, np.array([-1, 1, 1])):
            yield "mirrored scene has another force"


def _differ(states: Sequence[MembraneState], other: Scene, factor: float | np.ndarray) -> bool:
    pairs = [
        (a.force_n, b.force_n * factor) for a, b in zip(states, other.solve(), strict=True) if b.converged
    ]
    return any(apart(force, expected) > FORCE_TOLERANCE for force, expected in pairs)


def apart(force_n: np.ndarray, other_n: np.ndarray) -> float:
    """Return how far a force is from another, as a share of the first."""
    return float(np.linalg.norm(np.subtract(force_n, other_n)) / max(np.linalg.norm(force_n), 1e-12))


def judge(scene: Scene) -> Results:
    """Solve a scene and compare it with the invariants; `flagged` is one of which the solver says that it failed."""
    started = time.process_time()
    states = scene.solve()
    flagged = [index for index, state in enumerate(states) if not state.converged]
    return {
        "status": "flagged" if flagged else "converged",
        "violations": list(dict.fromkeys(violations(scene, states))),
        "core_s": time.process_time() - started,
        "detail": f"pose {flagged[0]} of {len(states)} did not converge" if flagged else "",
        "force_n": states[-1].force_n.tolist() if states[-1].converged else None,
    }


def judge_apart(setting: Setting) -> Results:
    """Judge a scene in a process of its own; a crash, an error or a time-out is a verdict too."""
    number, quality = setting["scene"], setting["quality"]
    code = f"from {MODULE} import *; print(json.dumps(judge(numbered_scene({number}, {quality!r}))))"
    said, failure = run_limited(["-c", code], limit_s := TIME_LIMIT_S[quality])
    spent = limit_s if failure and "no end" in failure else 0.0
    failed = {"status": "failed", "violations": [], "core_s": spent, "detail": failure, "force_n": None}
    verdict = failed if failure else json.loads(said.splitlines()[-1])
    return verdict | {"in_papers_regime": numbered_scene(number, quality).in_papers_regime}


def run_limited(words: Sequence[str], limit_s: float) -> tuple[str, str | None]:
    """Run Python with a limit on its processor time; return what it prints, and in a few words why it failed."""
    no_end, seconds = f"no end within {limit_s:g} s of processor time", max(1, round(limit_s))
    limits = (seconds, seconds + 5)
    try:
        done = subprocess.run(
            [sys.executable, *words],
            capture_output=True,
            text=True,
            timeout=WALL_PER_PROCESSOR * limit_s,
            preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_CPU, limits),
        )
    except subprocess.TimeoutExpired:
        return "", no_end
    if done.returncode == -signal.SIGXCPU:
        return "", no_end
    ended = f"process ended with code {done.returncode}"
    failure = (done.stderr.strip().splitlines() or [ended])[-1] if done.returncode == 1 else ended
    return done.stdout, failure if done.returncode else None


def run(quick: bool, out_dir: Path) -> None:
    """Judge three drawn scenes at `draft`, or the corners and 300 drawn ones at `standard`, and print the summary."""
    if quick:
        summarise(judge_scenes(QUICK_SCENES, "draft", out_dir), "draft", out_dir)
    else:
        judge_all("standard", out_dir)


def judge_all(quality: str, out_dir: Path) -> None:
    """Judge the corners and the drawn scenes, and compare some of them with `fine`."""
    verdicts = judge_scenes(range(CORNERS + SCENES), quality, out_dir)
    summarise(verdicts, quality, out_dir)
    usable = verdicts[(verdicts["status"] == "converged") & (verdicts["violations"].str.len() == 0)]
    chosen = sorted(np.random.default_rng(0).permutation(sorted(usable["scene"]))[:SOLVED_AT_FINE].tolist())
    fine = judge_scenes(chosen, "fine", out_dir).set_index("scene")["force_n"]
    own, rows = verdicts.set_index("scene")["force_n"], []
    for number in chosen:
        share = None if own[number] is None or fine[number] is None else apart(fine[number], own[number])
        verdict = "not solved" if share is None else "agrees" if share <= FORCE_ERROR[quality] else "differs"
        rows.append((str(number), None if share is None else 100 * share, verdict))
    table = pd.DataFrame(rows, columns=["scene", "force apart %", "verdict"])
    show(f"The same scenes at fine ({quality} promises {100 * FORCE_ERROR[quality]:g} %)", table)
    write_json(out_dir / f"stability-physics-{quality}-fine.json", table)


def judge_scenes(numbers: Sequence[int], quality: str, out_dir: Path) -> pd.DataFrame:
    """Judge the scenes that `out_dir` does not hold yet; write how to repeat those that failed."""
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
    return verdicts


def summarise(verdicts: pd.DataFrame, quality: str, out_dir: Path) -> None:
    """Print and write how many scenes converged, were flagged, failed and violated an invariant, by regime."""
    regime = verdicts["in_papers_regime"].astype(bool)
    groups = {"the paper's regime": verdicts[regime], "beyond it": verdicts[~regime], "all": verdicts}
    table = pd.DataFrame({"scenes": list(groups), "number": map(len, groups.values())})
    table["converged %"] = [100 * (found["status"] == "converged").mean() for found in groups.values()]
    for status in ("converged", "flagged", "failed"):
        table[status] = [(found["status"] == status).sum() for found in groups.values()]
    table["violate an invariant"] = [(own["violations"].str.len() > 0).sum() for own in groups.values()]
    minutes = verdicts["core_s"].sum() / 60
    targets = "targets: 99 % in the paper's regime, 90 % over all, no violation"
    show("Stability of the physics", table, f"{targets}; {minutes:.0f} core minutes in all")
    kinds = Counter(found for own in verdicts["violations"] for found in own)
    show("Violated invariants", pd.DataFrame(kinds.most_common(), columns=["invariant", "scenes"]))
    summary = {"scenes": table, "violations": kinds, "core_minutes": minutes}
    write_json(out_dir / f"stability-physics-{quality}.json", summary)


def main() -> None:
    """Judge one scene, or all at a quality."""
    parser = argparse.ArgumentParser(description="Stress the physics.")
    parser.add_argument("--only", type=int, help="judge this scene alone and print its verdict")
    parser.add_argument("--quality", default="standard")
    parser.add_argument("--out", type=Path, default=Path("benchmark-results"))
    chosen = parser.parse_args()
    if chosen.only is None:
        judge_all(chosen.quality, chosen.out)
    else:
        setting = {"scene": chosen.only, "quality": chosen.quality}
        print(numbered_scene(chosen.only, chosen.quality), judge_apart(setting), sep="\n")


if __name__ == "__main__":
    main()
