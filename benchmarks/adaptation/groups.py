"""All methods on the paper's groups of two sensors and on groups of light, on pictures.

    python -m gelgap.benchmarks.adaptation.groups --seeds 0 1 --methods dann

`gelgap benchmark adaptation` is the same with all methods and five seeds, in its quick form a few runs of the smoke
profile.

With `--table FILE` it prints the tables of a file of records in Markdown, and measures nothing.
"""

from collections.abc import Iterable, Sequence
from pathlib import Path

import pandas as pd

from gelgap.adapt.result_table import ResultTable
from gelgap.benchmarks.adaptation import protocol
from gelgap.benchmarks.adaptation.protocol import DATA_SETS, GROUPS, LIGHT_GROUPS, PLAIN, UPPER_BOUND
from gelgap.benchmarks.adaptation.study import (
    PROFILE,
    RUNS,
    Study,
    grid,
    load_runs,
    run_script,
    upper_bounds_of,
)
from gelgap.benchmarks.adaptation.tables import (
    control_table,
    group_table,
    method_table,
    of_data,
    upper_bound_table,
    upper_bounds,
    with_rules,
)
from gelgap.benchmarks.common import Setting
from gelgap.domains import make_recipes
from gelgap.sim import ContactPath

SEEDS = (0, 1, 2, 3, 4)
QUICK_GROUP = ("mb0i0", "wmb1i1")
QUICK_METHODS = (PLAIN, "adabn", "classifier-only", "dsan", UPPER_BOUND)


def run(quick: bool, out_dir: Path) -> None:
    """Compare all methods with the benchmark's profile, or quickly a few with the smoke profile."""
    folder = out_dir / "adaptation" / ("smoke" if quick else PROFILE)
    study = Study.at(folder, workers=1 if quick else None)
    measure(study)
    for table in tables(load_runs(study.out / RUNS)):
        table.show()


def measure(study: Study) -> None:
    """Do the missing runs: of a seed the upper bounds, then all methods; those on shifted labels come last."""
    chosen = study.known_methods()
    if study.profile == "smoke":  # the domains at their least: nine points of four poses at draft quality
        path = ContactPath("quick", (-2.25, 0.0, 2.25), (-1.3, 0.0, 1.3), (0.6,), (0.4,), (0, 90, 180, 270))
        recipes = make_recipes(
            QUICK_GROUP, path, quality="draft", render_quality="draft", size_px=(160, 120), seed=0
        )
        study.generate(recipes)
        runs = grid([(protocol.PAIRED, QUICK_GROUP)], chosen or QUICK_METHODS, study.seeds or SEEDS[:1])
    else:
        runs = headline_grid(chosen, study.seeds or SEEDS, study.groups)
        study.generate_for(runs)
    study.run(runs)


def headline_grid(
    methods: Sequence[str] = (), seeds: Iterable[int] = SEEDS, groups: Sequence[protocol.Group] | None = None
) -> list[Setting]:
    """Return all runs: a seed is complete, upper bounds first, before the next one begins; shifted labels are last."""
    seeds, groups = list(seeds), list(groups or (*GROUPS, *LIGHT_GROUPS))
    own = [method for method in methods or protocol.METHODS if method != UPPER_BOUND]
    main = [method for method in methods or protocol.MAIN_METHODS if method != UPPER_BOUND]
    found: list[Setting] = []
    for seed in seeds:
        runs = grid([(protocol.DATA, group) for group in groups], own, [seed])
        found += [*upper_bounds_of(runs), *runs]
    return found + grid([(protocol.LABEL_SHIFT, group) for group in groups], main, seeds)


def tables(runs: pd.DataFrame) -> list[ResultTable]:
    """Return all tables about the groups that the finished runs allow."""
    sets = {data: with_rules(own) for data in DATA_SETS if len(own := of_data(runs, data))}
    found = [
        table(own, f"{data} contacts", upper_bounds(runs, data))
        for table in (method_table, control_table, group_table)
        for data, own in sets.items()
    ]
    on_target = upper_bounds(runs)
    return [*found, upper_bound_table(on_target)] if len(on_target) else found


if __name__ == "__main__":
    run_script("groups", __doc__, measure, tables)
