"""`gelgap demo`: generate, adapt, report and inspect, one after the other at their smallest."""

import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Annotated

from gelgap import adapt, domains
from gelgap.assets.progress import shown_progress
from gelgap.cli import options as opt

SOURCE, TARGET = "mb0i0", "wmb1i1"
METHODS = ("source-only", "adabn", "dsan")
PATH, PROFILE, SEED = "smoke-random", "smoke", 0
# Of the source's frames, by Fz, for DSAN: contacts at random are on no grid that would class them.
CLASSES = 10


@dataclass(frozen=True)
class Demo(opt.Command):
    """Generate two small domains, learn force on one, adapt to the other, and write a report; minutes on 2 cores.

    Everything is real: solved contacts, rendered pictures, trained networks. Run again, it reuses finished domains.

    For example:
      gelgap demo
    """

    former = MappingProxyType(
        {
            "--workers": opt.Former("0.3.0", "there is one process a core"),
        }
    )

    when_stopped = "finished shards, solves, runs and epochs are kept, run the same command again to go on"
    fills_cache = True

    out: Annotated[Path, opt.output_folder] = Path("demo")
    """Folder for domains, models, report.html and a page of the target's pictures."""

    def run(self, started: float) -> None:
        """Generate source and target, train, adapt, write both pages and print the outcome; finished parts are kept."""
        from gelgap.adapt.report import axis_table, error_table
        from gelgap.data import open_domain
        from gelgap.data.inspection import write_overview
        from gelgap.domains.measured_gap import gap_rows

        print(f"1/3  generating {SOURCE} and {TARGET} on the path {PATH}")
        data, runs_dir = self.out / "data", self.out / "runs"
        print(domains.generate((SOURCE, TARGET), PATH, data, quality="draft", seed=SEED))

        print(f"2/3  training on {SOURCE}, adapting to {TARGET} without its labels (profile {PROFILE!r})")
        with shown_progress() as progress:
            runs = adapt.adapt_folders(
                data / SOURCE,
                data / TARGET,
                METHODS,
                profile=adapt.Profile.preset(PROFILE),
                seed=SEED,
                classes_from_force=CLASSES,
                out_dir=runs_dir,
                progress=progress,
            )

        print("3/3  writing the report")
        page = adapt.write_report(runs_dir, self.out)
        rows = gap_rows(open_domain(data / TARGET), open_domain(data / SOURCE))
        gap = {"base": SOURCE, "rows": rows}
        pictures = write_overview(data / TARGET, self.out / f"{TARGET}.html", gap)
        error_table(runs).show()
        axis_table(runs).show()
        print(f"{headline(runs)}\n\n{time.perf_counter() - started:.0f} s in all: {page}, {pictures}")


def headline(runs: "Sequence[adapt.Run]") -> str:
    """Return the outcome: whether adaptation helped and the network learned at all."""
    plain, normalised, adapted = (run.target_test.mean_mae_n for run in runs)
    told = (
        f"DSAN {'beats' if adapted < plain else 'does NOT beat'} source-only on the target: mean error "
        f"{adapted:.3f} N against {plain:.3f} N ({100 * (adapted / plain - 1):+.0f} %); AdaBN, the target's "
        f"normalisation statistics alone, has {normalised:.3f} N"
    )
    if runs[0].source_held_out.mean_mae_n >= 0.5 * runs[0].source_constant_mean.mean_mae_n:
        told += "; source-only did NOT learn: its error on the source is over half the mean's"
    return told
