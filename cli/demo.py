"""`gelgap demo`: the whole chain on two small domains."""

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar, Literal

from gelgap.cli.arguments import optional
from gelgap.cli.rules import PICTURE_SIDES, OutputFolder, Preset, Scheduler


@dataclass(frozen=True)
class Demo:
    """Generate two small domains, learn force on one, adapt to the other, and write a report; minutes on 2 cores.

    Everything is real: MuJoCo's contacts, rendered pictures, trained networks. Run again, it reuses finished domains.

    For example:
      gelgap demo
    """

    when_stopped: ClassVar[str] = (
        "finished shards, solves, runs and epochs are kept, run the same command again to go on"
    )

    out: Annotated[Path, OutputFolder()] = Path("demo")
    """Folder for domains, models and report.html."""
    path: Annotated[str, Preset("paths")] = "smoke"
    """Contact path of both domains (see: gelgap presets paths)."""
    profile: Annotated[str, Preset("profiles", or_file=False)] = "smoke"
    """Training profile (see: gelgap presets profiles)."""
    quality: Literal["draft", "standard", "fine"] = "draft"
    """Quality of the physics; draft is within a few per cent in force and the quickest."""
    size: Annotated[tuple[int, int], PICTURE_SIDES] = (320, 240)
    """Width and height of the pictures in pixels."""
    scheduler: Annotated[str | None, optional("ADDRESS", "a local cluster on all cores"), Scheduler()] = None
    """Address of a Dask scheduler; `synchronous` runs in this process."""

    def run(self, started: float) -> None:
        """Run the demo and print its table."""
        from gelgap.cli.workflows.demo import run_demo
        from gelgap.domains import shown_progress

        with shown_progress() as progress:
            result = run_demo(
                self.out,
                path=self.path,
                profile_name=self.profile,
                quality=self.quality,
                size_px=self.size,
                scheduler=self.scheduler,
                progress=progress,
            )
        print(f"\n{result.headline}\n")
        print(f"{'predictor':<14} {'domain':<8} {'Fx':>7} {'Fy':>7} {'Fz':>7} {'mean':>7}  MAE in N")
        for row in result.rows:
            errors = (*row.evaluation.mae_n, row.evaluation.mean_mae_n)
            print(f"{row.predictor:<14} {row.domain:<8} " + " ".join(f"{error:7.3f}" for error in errors))
        print(f"\n{'stage':<20} {'s':>7} {'MiB':>7}")
        for stage in result.stages:
            print(f"{stage.name:<20} {stage.wall_s:7.1f} {stage.peak_memory_mib:7.0f}")
        print(f"\n{time.perf_counter() - started:.0f} s in all; report: {self.out / 'report.html'}")
