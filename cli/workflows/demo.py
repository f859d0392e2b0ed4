"""The main job end to end at its smallest: two domains, source-only against adaptation, and a report."""

import csv
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from gelgap.cli.workflows.demo_result import SOURCE, TARGET, DemoResult, ForceCurve, Row
from gelgap.cli.workflows.stages import StageClock

if TYPE_CHECKING:
    from gelgap.domains import GenerationProgress
    from gelgap.sim import ContactPath

ADAPTED = ("adabn", "dsan")
SEED = 0
# The contact whose force is compared with theory and the reference tables (assets/reference).
CURVE_DEPTHS_MM = (0.2, 0.4, 0.6, 0.8, 1.0)


def run_demo(
    out_dir: Path,
    *,
    path: "str | ContactPath" = "smoke",
    profile_name: str = "smoke",
    quality: str = "standard",
    size_px: tuple[int, int] = (320, 240),
    scheduler: str | None = None,
    progress: "GenerationProgress | None" = None,
    say: Callable[[str], None] = print,
) -> DemoResult:
    """Generate source and target, train, adapt, evaluate on held-out frames, and write `report.html`.

    Generation resumes: domains that are finished in `out_dir` are kept.
    """
    clock = StageClock()
    say(f"1/4  force against depth, compared with theory and reference ({quality})")
    with clock.stage("force curve"):
        curve = force_curve(quality)
    say(f"2/4  generating {SOURCE} and {TARGET} on the path {path if isinstance(path, str) else path.name!r}")
    with clock.stage("generate"):
        from gelgap.domains import generate

        report = generate(
            (SOURCE, TARGET),
            path,
            out_dir / "data",
            quality=quality,
            seed=SEED,
            scheduler=scheduler,
            size_px=size_px,
            columns=("height_map",),
            progress=progress,
        )
    say(str(report))
    say(f"3/4  training on {SOURCE}, adapting to {TARGET} without its labels (profile {profile_name!r})")
    rows, true_n, predicted_n = _train_and_evaluate(out_dir, profile_name, clock)
    result = DemoResult(rows, tuple(clock.stages), true_n, predicted_n, curve)
    say("4/4  writing the report")
    from gelgap.cli.workflows.demo_page import write_page

    write_page(result, out_dir, out_dir / "report.html")
    return result


def force_curve(quality: str) -> ForceCurve:
    """Press at `CURVE_DEPTHS_MM` and compare with Hertz, the bonded layer and the FEM table."""
    from gelgap.assets import asset_path
    from gelgap.benchmarks.fem.theory import bonded_layer_force_n, hertz_force_n
    from gelgap.sim import Elastomer, Pose, Sphere, solve_poses

    gel = Elastomer(young_modulus_mpa=0.3, poisson_ratio=0.49, friction=0.8)
    sphere = Sphere()
    depth_mm = np.array(CURVE_DEPTHS_MM)
    started = time.perf_counter()
    states = solve_poses(gel, sphere, tuple(Pose(depth_mm=float(depth)) for depth in depth_mm), quality)
    seconds = (time.perf_counter() - started) / len(depth_mm)
    with asset_path("reference", "force_depth.csv").open(newline="", encoding="utf-8") as file:
        table = {
            float(line["depth_mm"]): float(line["fz_n"])
            for line in csv.DictReader(file)
            if line["case"] == "nh49_no_slip"
        }
    return ForceCurve(
        depth_mm=depth_mm,
        force_n=np.array([-state.force_n[2] for state in states]),
        hertz_n=hertz_force_n(gel.young_modulus_mpa, gel.poisson_ratio, sphere.radius_mm, depth_mm),
        bonded_layer_n=bonded_layer_force_n(
            gel.young_modulus_mpa, sphere.radius_mm, gel.thickness_mm, depth_mm
        ),
        reference_n=np.array([-table[depth] for depth in CURVE_DEPTHS_MM]),
        seconds_per_pose=seconds,
    )


def _train_and_evaluate(
    out_dir: Path, profile_name: str, clock: StageClock
) -> tuple[tuple[Row, ...], np.ndarray, dict[str, np.ndarray]]:
    from gelgap.adapt import adapt_folders, console_progress, load_predictions

    folders = (out_dir / "data" / SOURCE, out_dir / "data" / TARGET)
    runs = {}
    with console_progress() as progress:
        for method in ("source-only", *ADAPTED):
            with clock.stage(f"train {method}"):
                runs[method] = adapt_folders(
                    *folders,
                    (method,),
                    profile=profile_name,
                    seed=SEED,
                    out_dir=out_dir / "runs",
                    progress=progress,
                )[0]
    plain = runs["source-only"]
    rows = (
        Row("constant mean", SOURCE, plain.source_constant_mean),
        Row("source-only", SOURCE, plain.source_held_out),
        Row("constant mean", TARGET, plain.target_constant_mean),
        *(Row(method, TARGET, run.target_test) for method, run in runs.items()),
    )
    predictions = {method: load_predictions(run) for method, run in runs.items()}
    predicted_n = {method: arrays["target_predicted_n"] for method, arrays in predictions.items()}
    return rows, predictions["source-only"]["target_true_n"], predicted_n
