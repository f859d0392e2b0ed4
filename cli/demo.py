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
PATH = "smoke-random"
PROFILE = "smoke"
SEED = 0
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
        data = self.out / "data"
        runs_dir = self.out / "runs"
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
    """Return the outcome: what normalisation statistics alone bring, what DSAN adds, whether the network learned."""
    by_method = {run.method: run for run in runs}
    if problems := [f"{run.method} failed: {run.problem}" for run in runs if run.problem]:
        return "; ".join(problems)
    plain, statistics, aligned = (_error_n(by_method[name]) for name in METHODS)
    outcome = (
        f"mean error on the target: source-only {plain:.3f} N; AdaBN, the target's normalisation statistics alone, "
        f"{statistics:.3f} N ({_change(statistics, plain)}); DSAN {aligned:.3f} N ({_change(aligned, plain)}), so its "
        f"alignment {'adds to' if aligned < statistics else 'adds NOTHING to'} what AdaBN has "
        f"({_change(aligned, statistics)})"
    )
    source_only = by_method["source-only"]
    learnt = source_only.source_held_out
    constant = source_only.source_constant_mean
    if learnt is not None and constant is not None and learnt.mean_mae_n >= 0.5 * constant.mean_mae_n:
        outcome += "; source-only did NOT learn: its error on the source is over half the mean's"
    return outcome


def _error_n(run: "adapt.Run") -> float:
    """Return the mean error on the target, which the demo has labelled."""
    assert run.target_test is not None
    return run.target_test.mean_mae_n


def _change(error_n: float, before_n: float) -> str:
    return f"{100 * (error_n / before_n - 1):+.0f} %"
