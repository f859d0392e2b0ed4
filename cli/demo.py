"""`gelgap demo`: the whole chain at its smallest, on two domains, from presses to a report."""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar

from gelgap.assets import asset_path, load_preset
from gelgap.cli import options as opt

if TYPE_CHECKING:
    import pandas as pd

    from gelgap.cli.demo_page import DemoResult

METHODS = ("source-only", "adabn", "dsan")
SEED = 0
# Of the source's frames, by Fz, for DSAN: contacts at random are on no grid that would class them.
CLASSES = 10
# The contact whose force is compared with theory and the reference tables (assets/reference).
CURVE_DEPTHS_MM = (0.2, 0.4, 0.6, 0.8, 1.0)


@dataclass(frozen=True)
class Demo(opt.Command):
    """Generate two small domains, learn force on one, adapt to the other, and write a report; minutes on 2 cores.

    Everything is real: MuJoCo's contacts, rendered pictures, trained networks. Run again, it reuses finished domains.

    For example:
      gelgap demo
    """

    when_stopped: ClassVar[str] = (
        "finished shards, solves, runs and epochs are kept, run the same command again to go on"
    )
    fills_cache: ClassVar[bool] = True

    out: Annotated[Path, opt.output_folder] = Path("demo")
    """Folder for domains, models and report.html."""
    path: Annotated[str, opt.preset_or_file("paths")] = "smoke-random"
    """Contact path of both domains (see: gelgap presets paths)."""
    profile: Annotated[str, lambda name: load_preset("profiles", name)] = "smoke"
    """Training profile (see: gelgap presets profiles)."""
    quality: opt.Quality = "draft"
    """Quality of the physics; draft is within a few per cent in force and the quickest."""
    size: opt.PictureSize = (320, 240)
    """Width and height of the pictures in pixels."""
    scheduler: Annotated[
        str | None, opt.optional("ADDRESS", "a local cluster on all cores"), opt.scheduler_address
    ] = None
    """Address of a Dask scheduler; `synchronous` runs in this process."""

    def run(self, started: float) -> None:
        """Run the demo and print its tables."""
        result = self.result()
        from gelgap.adapt.evaluation import errors_text

        print(f"\n{result.headline}\n")
        print(errors_text({", ".join(what): error for what, error in result.errors.items()}))
        print(f"\n{'stage':<20} {'s':>7}")
        for stage, wall_s in result.stages_s.items():
            print(f"{stage:<20} {wall_s:7.1f}")
        print(f"\n{time.perf_counter() - started:.0f} s in all; report: {self.out / 'report.html'}")

    def result(self) -> "DemoResult":
        """Generate source and target, train, adapt, evaluate on held-out frames, and write `report.html`.

        Generation resumes: domains that are finished are kept.
        """
        from gelgap.cli.demo_page import SOURCE, TARGET, DemoResult, write_page
        from gelgap.domains import generate, shown_progress

        stages_s: dict[str, float] = {}
        print(f"1/4  force against depth, compared with theory and reference ({self.quality})")
        with timed("force curve", stages_s):
            curve, seconds_per_pose = force_curve(self.quality)

        print(f"2/4  generating {SOURCE} and {TARGET} on the path {self.path}")
        with timed("generate", stages_s), shown_progress() as progress:
            report = generate(
                (SOURCE, TARGET),
                self.path,
                self.out / "data",
                quality=self.quality,
                seed=SEED,
                scheduler=self.scheduler,
                size_px=self.size,
                columns=("height_map",),
                progress=progress,
            )
        print(str(report))

        print(
            f"3/4  training on {SOURCE}, adapting to {TARGET} without its labels (profile {self.profile!r})"
        )
        from gelgap.adapt import adapt_folders, console_progress, load_predictions

        runs = {}
        with console_progress() as progress:
            for method in METHODS:
                with timed(f"train {method}", stages_s):
                    (runs[method],) = adapt_folders(
                        self.out / "data" / SOURCE,
                        self.out / "data" / TARGET,
                        (method,),
                        profile=self.profile,
                        seed=SEED,
                        classes_from_force=CLASSES,
                        out_dir=self.out / "runs",
                        progress=progress,
                    )
        plain = runs["source-only"]
        predictions = {method: load_predictions(run) for method, run in runs.items()}
        result = DemoResult(
            errors={
                ("constant mean", SOURCE): plain.source_constant_mean,
                ("source-only", SOURCE): plain.source_held_out,
                ("constant mean", TARGET): plain.target_constant_mean,
                **{(method, TARGET): run.target_test for method, run in runs.items()},
            },
            stages_s=stages_s,
            true_n=predictions["source-only"]["target_true_n"],
            predicted_n={method: arrays["target_predicted_n"] for method, arrays in predictions.items()},
            curve=curve,
            seconds_per_pose=seconds_per_pose,
        )
        print("4/4  writing the report")
        write_page(result, self.out, self.out / "report.html")
        return result


def force_curve(quality: str) -> "tuple[pd.DataFrame, float]":
    """Press at `CURVE_DEPTHS_MM` and compare with Hertz, the bonded layer and the FEM table; tell seconds per pose."""
    import numpy as np
    import pandas as pd

    from gelgap.benchmarks.fem.theory import hertz_force_n
    from gelgap.sim import Elastomer, Pose, Sphere, bonded_layer_force_n, solve_poses

    gel = Elastomer(young_modulus_mpa=0.3, poisson_ratio=0.49, friction=0.8)
    modulus_mpa, radius_mm, depth_mm = gel.young_modulus_mpa, Sphere().radius_mm, np.array(CURVE_DEPTHS_MM)
    started = time.perf_counter()
    states = solve_poses(gel, Sphere(), tuple(Pose(depth_mm=depth) for depth in CURVE_DEPTHS_MM), quality)
    seconds = (time.perf_counter() - started) / len(depth_mm)
    table = pd.read_csv(asset_path("reference", "force_depth.csv"))
    forces_n = {
        "force_n": [-state.force_n[2] for state in states],
        "hertz_n": hertz_force_n(modulus_mpa, gel.poisson_ratio, radius_mm, depth_mm),
        "bonded_layer_n": bonded_layer_force_n(modulus_mpa, radius_mm, gel.thickness_mm, depth_mm),
        "reference_n": -table[table["case"] == "nh49_no_slip"].set_index("depth_mm")["fz_n"][depth_mm],
    }
    return pd.DataFrame(forces_n, index=depth_mm), seconds


@contextmanager
def timed(name: str, stages_s: dict[str, float]) -> Iterator[None]:
    """Enter the wall time of what happens inside among the stages."""
    started = time.perf_counter()
    yield
    stages_s[name] = time.perf_counter() - started
