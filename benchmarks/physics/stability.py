"""`gelgap benchmark stability --what physics`: hundreds of scenes, each checked against physical invariants.

Each scene runs in a process of its own with a time limit, and its verdict is a JSON line, so that a run that was
stopped goes on where it was. `python -m gelgap.benchmarks.physics.stability --only 17` repeats one scene.
"""

import argparse
import os
import time
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gelgap.benchmarks.common.limited_process import run_limited
from gelgap.benchmarks.common.records import append_record, read_records
from gelgap.benchmarks.common.tables import print_table, write_json
from gelgap.benchmarks.physics.cases import single_threaded
from gelgap.benchmarks.physics.invariants import FORCE_ERROR, apart, solve_scene, violations
from gelgap.benchmarks.physics.scenes import CORNERS, Scene, numbered_scene

SCENES = 300
QUICK_SCENES = (35, 37, 39)  # drawn ones that are solved soon
TIME_LIMIT_S = 600.0  # of processor time; at `draft` the longest scene took 510 s on a busy machine
SOLVED_AT_FINE = 20


@dataclass(frozen=True)
class Verdict:
    """What a scene did. `status` is converged, flagged (the solver says so) or failed (crash, error or time limit).

    `seconds` are of processor time, `command` presses the scene's last pose alone.
    """

    number: int
    status: str
    violations: tuple[str, ...]
    in_papers_regime: bool
    seconds: float
    detail: str
    command: str


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
    rows = compare_with_fine(verdicts, quality)
    write_json(out_dir / f"stability-physics-{quality}-fine.json", rows)


def judge_scenes(numbers: Sequence[int], quality: str, out_dir: Path) -> list[Verdict]:
    """Judge the scenes that `out_dir` does not hold yet; write how to repeat those that failed."""
    record = out_dir / f"stability-physics-{quality}.jsonl"
    out_dir.mkdir(parents=True, exist_ok=True)
    verdicts = {v.number: v for v in read_records(record, Verdict) if v.number in numbers}
    missing = [numbered_scene(number, quality) for number in numbers if number not in verdicts]
    print(f"{len(verdicts)} scenes are in {record}, {len(missing)} to go")
    with single_threaded(), ThreadPoolExecutor(os.cpu_count() or 1) as threads:
        for verdict in threads.map(judge_limited, missing):
            verdicts[verdict.number] = verdict
            append_record(record, verdict)
            found = " ".join((verdict.status, *verdict.violations))
            print(f"  {verdict.number}: {found} {verdict.seconds:.0f} s", flush=True)
    failing = [v for v in verdicts.values() if v.violations or v.status != "converged"]
    commands = out_dir / f"stability-physics-{quality}-failing.txt"
    commands.write_text("".join(f"{_again(v, quality)}\n" for v in failing), encoding="utf-8")
    print(f"{len(failing)} scenes that did not converge or violate an invariant: {commands}")
    return list(verdicts.values())


def judge_limited(scene: Scene) -> Verdict:
    """Judge a scene in a process of its own; a crash, an error or a time-out is a verdict too."""
    attempt = run_limited(judge, scene, TIME_LIMIT_S)
    if attempt.failure is None:
        return attempt.value
    spent = TIME_LIMIT_S if "no end" in attempt.failure else 0.0
    return Verdict(
        scene.number, "failed", (), scene.in_papers_regime, spent, attempt.failure, scene.command()
    )


def judge(scene: Scene) -> Verdict:
    """Solve a scene and compare it with the invariants."""
    started = time.process_time()
    states = solve_scene(scene)
    flagged = [index for index, state in enumerate(states) if not state.converged]
    found = violations(scene, states)
    return Verdict(
        number=scene.number,
        status="flagged" if flagged else "converged",
        violations=found,
        in_papers_regime=scene.in_papers_regime,
        seconds=time.process_time() - started,
        detail=f"pose {flagged[0]} of {len(states)} did not converge" if flagged else "",
        command=scene.command(),
    )


def summarise(verdicts: Sequence[Verdict], quality: str, out_dir: Path) -> None:
    """Print and write how many scenes converged, were flagged, failed and violated an invariant, by regime."""
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
    summary = {"columns": columns, "rows": rows, "violations": kinds, "core_minutes": minutes}
    write_json(out_dir / f"stability-physics-{quality}.json", summary)


def compare_with_fine(verdicts: Sequence[Verdict], quality: str) -> list[list[object]]:
    """Solve converged scenes again at `fine`, and print how far their last force is from it."""
    usable = sorted(v.number for v in verdicts if v.status == "converged" and not v.violations)
    chosen = np.random.default_rng(0).permutation(usable)[:SOLVED_AT_FINE]
    with single_threaded(), ThreadPoolExecutor(os.cpu_count() or 1) as threads:
        rows = list(threads.map(lambda number: _beside_fine(number, quality), sorted(map(int, chosen))))
    print_table(f"The same scenes at fine ({quality} promises {100 * FORCE_ERROR[quality]:g} %)",
                ["scene", "force apart %", "verdict"], rows)  # fmt: skip
    return rows


def _beside_fine(number: int, quality: str) -> list[object]:
    own, fine = (
        run_limited(final_force_n, numbered_scene(number, q), 2 * TIME_LIMIT_S).value
        for q in (quality, "fine")
    )
    if own is None or fine is None:
        return [str(number), None, "not solved"]
    share = apart(fine, own)
    return [str(number), 100 * share, "agrees" if share <= FORCE_ERROR[quality] else "differs"]


def final_force_n(scene: Scene) -> np.ndarray | None:
    """Return the force of the scene's last pose, or None if it did not converge."""
    last = solve_scene(scene)[-1]
    return last.force_n if last.converged else None


def _again(verdict: Verdict, quality: str) -> str:
    """Return the line that judges a scene again, why, and the one that presses its last pose."""
    reason = "; ".join(filter(None, (verdict.status, verdict.detail, *verdict.violations)))
    command = f"python -m gelgap.benchmarks.physics.stability --only {verdict.number} --quality {quality}"
    return f"{command}  # {reason}; {verdict.command}"


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
        scene = numbered_scene(chosen.only, chosen.quality)
        print(scene, judge_limited(scene), sep="\n")


if __name__ == "__main__":
    main()
