"""How far two equal runs come apart: the second trains with a rate that differs by a ten-millionth, as by rounding.

    python -m gelgap.benchmarks.adaptation.equal_runs

Errors that are nearer than this have no order: `tables.NOISE_N` has the largest distances of adapted networks.

With `--table FILE` it prints the tables of a file of records in Markdown, and measures nothing.
"""

import pandas as pd

from gelgap.adapt import Profile
from gelgap.adapt.result_table import ResultTable
from gelgap.benchmarks.adaptation.protocol import BY_POINT, DATA, PLAIN, Changes
from gelgap.benchmarks.adaptation.study import PROFILE, Study, grid, run_script

GROUPS = (("wmb0i0", "wmb0i1"), ("wmb0i0", "wmb0i2"), ("wmb0i0", "wmb1i1"), ("wmb0i0", "wmb2i2"))
METHODS = (PLAIN, "adabn", "dann", "dsan")
SEEDS = (0,)
NUDGE = 1 + 1e-7


def nudged() -> Changes:
    """Return the changes of the second run of a pair."""
    rate = Profile.preset(PROFILE).source_learning_rate
    return (*BY_POINT, ("source_learning_rate", rate * NUDGE))


def measure(study: Study) -> None:
    """Do the missing runs of both kinds."""
    cases = [(DATA, group) for group in study.groups or GROUPS]
    methods, seeds = study.known_methods() or METHODS, study.seeds or SEEDS
    runs = [run for changes in (BY_POINT, nudged()) for run in grid(cases, methods, seeds, changes)]
    study.generate_for(runs)
    study.run(runs)


def tables(runs: pd.DataFrame) -> list[ResultTable]:
    """Return for each method how far pairs are apart: the largest distance over groups and seeds, and their mean."""
    columns = {"mean": "error_n", "Fz": "MAE z, N", "shear": "shear_n"}
    keys = ["data", "group", "seed", "method"]
    first = runs[runs["changes"] == BY_POINT].set_index(keys)
    second = runs[runs["changes"] == nudged()].set_index(keys)
    pairs = first.index.intersection(second.index, sort=False)
    first, second = first.loc[pairs], second.loc[pairs]
    distance = (first[list(columns.values())] - second[list(columns.values())]).abs()
    by_method = distance.groupby(level="method", sort=False)
    frame = pd.DataFrame(
        {"pairs": by_method.size(), "MAE, N": first["error_n"].groupby(level="method").mean()}
    )
    for name, column in columns.items():
        frame[f"{name} apart, mean, N"] = by_method[column].mean()
        frame[f"{name} apart, most, N"] = by_method[column].max()
    note = "Errors on the target's test frames. A pair is one group and seed, trained twice."
    return [ResultTable.of("How far two equal runs come apart", frame, note, {"": "{:.3f}", "pairs": "{:d}"})]


if __name__ == "__main__":
    run_script("equal_runs", __doc__, measure, tables)
