"""`gelgap benchmark stability --what physics`: hundreds of random scenes, each held against what physics demands.

Scenes are numbered: the first are the corners of the box of parameters, the others are drawn with the scene's
number as the seed. Each runs in a process of its own with a time limit, and its verdict is a JSON line, so that
a run that was stopped goes on where it was. `python -m gelgap.benchmarks.physics.stability --only 17` repeats one.
"""

import argparse
import itertools
import json
import os
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from gelgap.benchmarks.common.limited_process import run_limited
from gelgap.benchmarks.common.tables import print_table, write_json
from gelgap.benchmarks.physics.solve_jobs import single_threaded
from gelgap.sim import Elastomer, MembraneState, Pose, Sharing, Sphere

YOUNG_MPA = (0.01, 10.0)
POISSON = (0.3, 0.495)
FRICTION = (0.0, 1.5)
RADIUS_MM = (0.5, 5.0)
THICKNESS_MM = (1.0, 6.0)
STEP_MM = (0.01, 0.5)
PAD_SIZE_MM = (24.0, 20.0)
CORNERS = 2**5
SCENES = 300
QUICK_SCENES = 8
POSES_DOWN, POSES_SIDEWAYS = 4, 3
TIME_LIMIT_S = 600.0  # of processor time; at `draft` the longest scene took 510 s on a busy machine
NOTHING_SHARED = Sharing(modulus=False, translation=False, reflection=False, path=False, cache=False)

FORCE_TOLERANCE = 0.01  # of the sphere's force: balance, monotony, scaling, symmetry
RESIDUAL_TOLERANCE = 0.01
COULOMB_TOLERANCE = 1e-3
TENSION_TOLERANCE = 0.01
DIAGNOSTIC_LIMITS = {
    "residual": RESIDUAL_TOLERANCE,
    "imbalance": FORCE_TOLERANCE,
    "coulomb_excess": COULOMB_TOLERANCE,
    "tension": TENSION_TOLERANCE,
}
FORCE_ERROR = {"draft": 0.06, "standard": 0.04, "fine": 0.02}  # what a quality promises
RESOLVED_AT_FINE = 20


@dataclass(frozen=True)
class Scene:
    """A press in steps, then a drag in steps, of which the last few are recorded."""

    number: int
    young_modulus_mpa: float
    poisson_ratio: float
    friction: float
    indenter_radius_mm: float
    thickness_mm: float
    depth_mm: float
    step_down_mm: float
    step_sideways_mm: float
    direction_deg: float
    point_x_mm: float
    point_y_mm: float
    quality: str

    @property
    def elastomer(self) -> Elastomer:
        return Elastomer(
            young_modulus_mpa=self.young_modulus_mpa,
            poisson_ratio=self.poisson_ratio,
            friction=self.friction,
            thickness_mm=self.thickness_mm,
            pad_size_mm=PAD_SIZE_MM,
        )

    @property
    def poses(self) -> tuple[Pose, ...]:
        place = {"point_x_mm": self.point_x_mm, "point_y_mm": self.point_y_mm}
        down = [self.depth_mm - k * self.step_down_mm for k in reversed(range(POSES_DOWN))]
        way = np.array([np.cos(np.radians(self.direction_deg)), np.sin(np.radians(self.direction_deg))])
        travels = [k * self.step_sideways_mm for k in range(1, POSES_SIDEWAYS + 1)]
        drags = [
            np.round(t * way, 9) for t in travels if t <= min(self.thickness_mm, self.indenter_radius_mm)
        ]
        return (
            *(Pose(depth_mm=round(depth, 9), **place) for depth in down if depth > 1e-6),
            *(Pose(depth_mm=self.depth_mm, shear_x_mm=x, shear_y_mm=y, **place) for x, y in drags),
        )

    @property
    def in_papers_regime(self) -> bool:
        return (
            self.poisson_ratio <= 0.49
            and self.depth_mm <= self.thickness_mm / 3
            and max(self.step_down_mm, self.step_sideways_mm) <= 0.2
        )

    @property
    def to_rim_mm(self) -> float:
        return min(PAD_SIZE_MM[0] / 2 - abs(self.point_x_mm), PAD_SIZE_MM[1] / 2 - abs(self.point_y_mm))

    def command(self) -> str:
        """Return a line that presses the scene's last pose by itself."""
        last = self.poses[-1]
        values = {
            "young-modulus-mpa": self.young_modulus_mpa,
            "poisson-ratio": self.poisson_ratio,
            "friction": self.friction,
            "thickness-mm": self.thickness_mm,
            "indenter-diameter-mm": 2 * self.indenter_radius_mm,
            "depth-mm": last.depth_mm,
            "shear-x-mm": last.shear_x_mm,
            "shear-y-mm": last.shear_y_mm,
            "point-x-mm": last.point_x_mm,
            "point-y-mm": last.point_y_mm,
        }
        options = " ".join(f"--{name} {value:.9g}" for name, value in values.items())
        return f"gelgap press {options} --quality {self.quality} --json"


@dataclass(frozen=True)
class Verdict:
    """What a scene did. `status` is converged, flagged (the solver says so) or failed (crash, error, no end).

    `seconds` are of processor time, `command` presses the scene's last pose alone.
    """

    number: int
    status: str
    violations: tuple[str, ...]
    in_papers_regime: bool
    seconds: float
    detail: str
    command: str


def scene(number: int, quality: str) -> Scene:
    """Return scene `number`: a corner of the box, or one drawn at random."""
    return _corner(number, quality) if number < CORNERS else _drawn(number, quality)


def _corner(number: int, quality: str) -> Scene:
    corners = list(itertools.product(YOUNG_MPA, POISSON, FRICTION, RADIUS_MM, THICKNESS_MM))
    young, poisson, friction, radius, thickness = corners[number]
    return Scene(
        number=number,
        young_modulus_mpa=young,
        poisson_ratio=poisson,
        friction=friction,
        indenter_radius_mm=radius,
        thickness_mm=thickness,
        depth_mm=round(min(0.4 * thickness, 0.8 * radius), 6),
        step_down_mm=STEP_MM[number % 2],
        step_sideways_mm=STEP_MM[number // 2 % 2],
        direction_deg=0.0,
        point_x_mm=PAD_SIZE_MM[0] / 2 if number // 4 % 2 else 0.0,
        point_y_mm=0.0,
        quality=quality,
    )


def _drawn(number: int, quality: str) -> Scene:
    rng = np.random.default_rng(np.random.SeedSequence([20240, number]))

    def logarithmic(bounds: tuple[float, float]) -> float:
        return round(float(np.exp(rng.uniform(*np.log(bounds)))), 6)

    radius, thickness = logarithmic(RADIUS_MM), round(float(rng.uniform(*THICKNESS_MM)), 6)
    deepest = min(0.4 * thickness, 0.8 * radius)
    return Scene(
        number=number,
        young_modulus_mpa=logarithmic(YOUNG_MPA),
        poisson_ratio=round(float(rng.uniform(*POISSON)), 6),
        friction=round(float(rng.uniform(*FRICTION)), 6),
        indenter_radius_mm=radius,
        thickness_mm=thickness,
        depth_mm=round(float(rng.uniform(0.05, 1.0)) * deepest, 6),
        step_down_mm=logarithmic(STEP_MM),
        step_sideways_mm=logarithmic(STEP_MM),
        direction_deg=round(float(rng.uniform(0, 360)), 3),
        point_x_mm=round(float(rng.uniform(-1, 1)) * PAD_SIZE_MM[0] / 2, 4),
        point_y_mm=round(float(rng.uniform(-1, 1)) * PAD_SIZE_MM[1] / 2, 4),
        quality=quality,
    )


# --- one scene ------------------------------------------------------------------------------------------------


def judge(what: Scene) -> Verdict:
    """Solve a scene and hold it against the invariants; every tenth again at another modulus, or mirrored."""
    started = time.process_time()
    states = _solve(what)
    flagged = [index for index, state in enumerate(states) if not state.converged]
    violations = [*_not_finite(states)]
    if not violations:
        for pose, state in zip(what.poses, states, strict=True):
            if state.converged:
                violations += _pose_violations(what, pose, state)
        violations += _press_violations(what, states)
        violations += _drag_violations(what, states)
        if not flagged and what.number % 10 == 1:
            violations += _scaling_violations(what, states)
        if not flagged and what.number % 10 == 2:
            violations += _mirror_violations(what, states)
    return Verdict(
        number=what.number,
        status="flagged" if flagged else "converged",
        violations=tuple(dict.fromkeys(violations)),
        in_papers_regime=what.in_papers_regime,
        seconds=time.process_time() - started,
        detail=f"pose {flagged[0]} of {len(states)} did not converge" if flagged else "",
        command=what.command(),
    )


def _solve(what: Scene) -> tuple[MembraneState, ...]:
    from gelgap.sim import solve_poses

    indenter = Sphere(diameter_mm=2 * what.indenter_radius_mm)
    return solve_poses(what.elastomer, indenter, what.poses, what.quality, NOTHING_SHARED)


def _not_finite(states: Sequence[MembraneState]) -> Iterator[str]:
    for state in states:
        if state.converged and not (
            np.isfinite(state.force_n).all() and np.isfinite(state.displacement_mm).all()
        ):
            yield "not finite"


def _pose_violations(what: Scene, pose: Pose, state: MembraneState) -> Iterator[str]:
    found = state.diagnostics
    for name, limit in DIAGNOSTIC_LIMITS.items():
        if (value := getattr(found, name)) > limit:
            yield f"{name} {value:.2g}"
    if state.force_n[2] > 0:
        yield "pulls"
    if found.min_volume_ratio <= 0:
        yield "inverted element"


def _press_violations(what: Scene, states: Sequence[MembraneState]) -> Iterator[str]:
    contact = np.sqrt(2 * what.indenter_radius_mm * what.depth_mm)
    press = [
        s.force_n[2] for p, s in zip(what.poses, states, strict=True) if p.radius_mm == 0 and s.converged
    ]
    if what.to_rim_mm > contact and np.any(np.diff(press) > FORCE_TOLERANCE * abs(press[-1])):
        yield "force falls in a press"


def _drag_violations(what: Scene, states: Sequence[MembraneState]) -> Iterator[str]:
    """In a straight drag at one depth, far from the rim, friction builds up to its limit and stays there.

    It may fall by the quality's force error, since in slip it changes as the sphere passes the membrane's vertices.
    """
    contact = np.sqrt(2 * what.indenter_radius_mm * what.depth_mm)
    way = np.array([np.cos(np.radians(what.direction_deg)), np.sin(np.radians(what.direction_deg))])
    drag = [s for p, s in zip(what.poses, states, strict=True) if p.radius_mm > 0 and s.converged]
    along = [float(way @ state.force_n[:2]) for state in drag]
    travel = max(pose.radius_mm for pose in what.poses)
    if what.to_rim_mm > contact + travel + what.thickness_mm and drag:
        largest = FORCE_ERROR[what.quality] * abs(drag[0].force_n[2])
        if np.any(np.diff(along) < -largest):
            yield "friction falls in a drag"


def _scaling_violations(what: Scene, states: Sequence[MembraneState]) -> Iterator[str]:
    factor = 7.0 if what.young_modulus_mpa < 0.3 else 1 / 7
    others = _solve(replace(what, young_modulus_mpa=factor * what.young_modulus_mpa))
    for state, other in zip(states, others, strict=True):
        if other.converged and _apart(state.force_n, other.force_n / factor) > FORCE_TOLERANCE:
            yield "force does not scale with the modulus"


def _mirror_violations(what: Scene, states: Sequence[MembraneState]) -> Iterator[str]:
    mirrored = replace(what, point_x_mm=-what.point_x_mm, direction_deg=180 - what.direction_deg)
    for state, other in zip(states, _solve(mirrored), strict=True):
        if other.converged and _apart(state.force_n, other.force_n * [-1, 1, 1]) > FORCE_TOLERANCE:
            yield "mirrored scene has another force"


def _apart(force: np.ndarray, other: np.ndarray) -> float:
    return float(np.linalg.norm(force - other) / max(np.linalg.norm(force), 1e-12))


def final_force_n(what: Scene) -> np.ndarray | None:
    """Return the force of the scene's last pose, or None if it did not converge."""
    last = _solve(what)[-1]
    return last.force_n if last.converged else None


# --- all scenes -----------------------------------------------------------------------------------------------


def run(quick: bool, out_dir: Path, scenes: int | None = None, quality: str | None = None) -> None:
    """Judge all scenes that `out_dir` does not hold yet, and print the summary."""
    count = scenes if scenes is not None else (QUICK_SCENES if quick else CORNERS + SCENES)
    quality = quality or ("draft" if quick else "standard")
    numbers = range(CORNERS, CORNERS + count) if quick else range(count)
    record = out_dir / f"stability-physics-{quality}.jsonl"
    out_dir.mkdir(parents=True, exist_ok=True)
    verdicts = {v.number: v for v in _read(record) if v.number in numbers}
    missing = [scene(number, quality) for number in numbers if number not in verdicts]
    print(f"{len(verdicts)} scenes are in {record}, {len(missing)} to go")
    with single_threaded(), ThreadPoolExecutor(os.cpu_count() or 1) as threads, record.open("a") as file:
        for verdict in threads.map(judge_limited, missing):
            verdicts[verdict.number] = verdict
            file.write(json.dumps(asdict(verdict)) + "\n")
            file.flush()
            print(
                f"  {verdict.number}: {verdict.status} {' '.join(verdict.violations)} {verdict.seconds:.0f} s"
            )
    summary = summarise(list(verdicts.values()))
    if not quick:
        summary["fine"] = compare_with_fine(list(verdicts.values()), quality)
    write_json(out_dir / f"stability-physics-{quality}.json", summary)
    failing = [v for v in verdicts.values() if v.violations or v.status != "converged"]
    commands = out_dir / f"stability-physics-{quality}-failing.txt"
    commands.write_text(
        "".join(f"{_again(v.number, quality)}  # {_reason(v)}; {v.command}\n" for v in failing)
    )
    print(f"{len(failing)} scenes that did not converge or violate an invariant: {commands}")


def judge_limited(what: Scene) -> Verdict:
    """Judge a scene in a process of its own; a crash, an error or no end is a verdict too."""
    attempt = run_limited(judge, what, TIME_LIMIT_S)
    if attempt.failure is None:
        return attempt.value
    spent = TIME_LIMIT_S if "no end" in attempt.failure else 0.0
    return Verdict(what.number, "failed", (), what.in_papers_regime, spent, attempt.failure, what.command())


def summarise(verdicts: Sequence[Verdict]) -> dict[str, object]:
    """Print how many scenes converged, were flagged, failed and violated an invariant, by regime."""
    rows = []
    regimes = {
        "the paper's regime": [v for v in verdicts if v.in_papers_regime],
        "beyond it": [v for v in verdicts if not v.in_papers_regime],
        "all": list(verdicts),
    }
    for name, found in regimes.items():
        states = Counter(verdict.status for verdict in found)
        share = 100 * states["converged"] / len(found) if found else None
        violated = sum(bool(verdict.violations) for verdict in found)
        rows.append(
            [name, len(found), share, states["converged"], states["flagged"], states["failed"], violated]
        )
    columns = ["scenes", "number", "converged %", "converged", "flagged", "failed", "violate an invariant"]
    minutes = sum(verdict.seconds for verdict in verdicts) / 60
    print_table(
        "Stability of the physics",
        columns,
        rows,
        note=f"targets: 99 % in the paper's regime, 90 % over all, no violation; {minutes:.0f} core minutes in all",
    )
    kinds = Counter(violation.rstrip("0123456789.e+-∞inf ") for v in verdicts for violation in v.violations)
    print_table(
        "Violated invariants", ["invariant", "scenes"], [[kind, n] for kind, n in kinds.most_common()]
    )
    return {"columns": columns, "rows": rows, "violations": kinds, "core_minutes": minutes}


def compare_with_fine(verdicts: Sequence[Verdict], quality: str) -> list[list[object]]:
    """Solve converged scenes again at `fine`, and print how far their last force is from it."""
    sound = sorted(v.number for v in verdicts if v.status == "converged" and not v.violations)
    chosen = np.random.default_rng(0).permutation(sound)[:RESOLVED_AT_FINE]
    with single_threaded(), ThreadPoolExecutor(os.cpu_count() or 1) as threads:
        rows = list(threads.map(lambda number: _beside_fine(number, quality), sorted(map(int, chosen))))
    print_table(f"The same scenes at fine ({quality} promises {100 * FORCE_ERROR[quality]:g} %)",
                ["scene", "force apart %", "verdict"], rows)  # fmt: skip
    return rows


def _beside_fine(number: int, quality: str) -> list[object]:
    own, fine = (
        run_limited(final_force_n, scene(number, q), 2 * TIME_LIMIT_S).value for q in (quality, "fine")
    )
    if own is None or fine is None:
        return [str(number), None, "not solved"]
    apart = _apart(fine, own)
    return [str(number), 100 * apart, "agrees" if apart <= FORCE_ERROR[quality] else "differs"]


def _read(record: Path) -> Iterator[Verdict]:
    if record.is_file():
        for line in record.read_text().splitlines():
            values = json.loads(line)
            yield Verdict(**values | {"violations": tuple(values["violations"])})


def _again(number: int, quality: str) -> str:
    return f"python -m gelgap.benchmarks.physics.stability --only {number} --quality {quality}"


def _reason(verdict: Verdict) -> str:
    return "; ".join(filter(None, (verdict.status, verdict.detail, *verdict.violations)))


def main() -> None:
    """Judge one scene, or a chosen number of them."""
    parser = argparse.ArgumentParser(description="Stress the physics.")
    parser.add_argument("--scenes", type=int, default=CORNERS + SCENES)
    parser.add_argument("--only", type=int, help="judge this scene alone and print its verdict")
    parser.add_argument("--quality", default="standard")
    parser.add_argument("--out", type=Path, default=Path("benchmark-results"))
    chosen = parser.parse_args()
    if chosen.only is None:
        run(quick=False, out_dir=chosen.out, scenes=chosen.scenes, quality=chosen.quality)
    else:
        what = scene(chosen.only, chosen.quality)
        print(what)
        print(judge_limited(what))


if __name__ == "__main__":
    main()
