"""How calm training is: two runs that differ in rounding alone, and how far their errors on the target come apart.

The second run starts from weights that are a ten-millionth apart, as another processor's arithmetic would make them. A
comparison of methods means little below the difference that this makes.
"""

from pathlib import Path

import pandas as pd

from gelgap.adapt import ResultTable
from gelgap.benchmarks.adaptation import board, designs, rivals
from gelgap.benchmarks.adaptation.board import PLAIN
from gelgap.benchmarks.adaptation.study import Part, Study, grid, load_runs, trained
from gelgap.benchmarks.common import Results, Setting, key_of, result_table

FILE = "calm.jsonl"
ROUNDING = 1e-7
METHODS = (PLAIN, "adabn")
GROUPS = (("wmb0i0", "wmb0i1"), ("wmb0i1", "wmb0i0"))
SEEDS = (0, 1, 2)
_FORMER = (("source_epochs", 60), ("source_learning_rate", 0.2), ("rate_decay", 3e-4), ("averaging", 0.0))
VARIANTS: dict[str, board.Changes] = {
    "as cpu": (*board.BY_POINT, *_FORMER),
    "as cpu, averaged": (*board.BY_POINT, *_FORMER[:3]),
    "board": board.BY_POINT,
    "board, calibrated": rivals.changes_of("calibrated"),
}
"""Training as the profile cpu has it, with the average of the weights, and as the board has it."""
LIT = "board, lights like the target's"


def measure(study: Study) -> None:
    """Do the missing runs."""
    groups = study.groups or GROUPS
    cases = [(designs.DATA, group) for group in groups]
    lit = [(designs.DATA, group) for group in rivals.lit_groups(groups)]
    methods = study.known_methods() or METHODS
    grids = [
        *((cases, methods, changes) for changes in VARIANTS.values()),
        (lit, rivals.LIGHT_METHODS, board.BY_POINT),
    ]
    runs = [
        run | {"rounding": rounding}
        for seed in study.seeds or SEEDS
        for own, by, changes in grids
        for rounding in (0, 1)
        for run in grid(own, by, [seed], changes)
    ]
    study.generate_for(runs)
    study.run(calm_run, runs, FILE)


def calm_run(study: Study, run: Setting) -> Results:
    """Do one run whose first weights are rounded otherwise, if it says so."""
    import torch

    weights = None
    if run["rounding"]:
        start = study.stage1(run, study.frames_of(run).source_train).untrained()
        rng = torch.Generator().manual_seed(run["seed"])
        with torch.no_grad():
            for values in start.network.parameters():
                values.mul_(1 + ROUNDING * torch.randn(values.shape, generator=rng))
        # The bytes are the same for all methods, and with them the first stage that they share.
        weights = study.out / "calm" / f"{key_of(run)}.pt"
        start.save(weights)
    return trained(study, run, weights)[2]


def tables(folder: Path) -> list[ResultTable]:
    """Return by variant and method the mean error, and how far two runs of a group and seed come apart."""
    runs = load_runs(folder / FILE)
    if runs.empty:
        return []
    names = {changes: name for name, changes in VARIANTS.items()}
    variant = runs["changes"].map(names).mask(runs["source"].str.startswith(designs.LIKE), LIT)
    runs = runs.assign(variant=pd.Categorical(variant, [*VARIANTS, LIT]))
    pairs = runs.pivot_table(
        values="error_n", index=["variant", "method", "group", "seed"], columns="rounding", observed=True
    ).dropna()
    if not len(pairs):
        return []
    found = pairs.assign(mean=pairs.mean(axis=1), apart=pairs.diff(axis=1).iloc[:, -1].abs())
    columns = {
        "mean MAE, N": ("mean", "mean"),
        "apart, mean N": ("apart", "mean"),
        "apart, most N": ("apart", "max"),
        "pairs": ("apart", "size"),
    }
    return [
        result_table(
            "Two runs that differ in rounding",
            found.groupby(["variant", "method"], observed=True).agg(**columns),
            f"First weights {ROUNDING:g} apart; {runs['group'].nunique()} group(s), {runs['seed'].nunique()} seed(s). "
            f"Largest difference of all: {found['apart'].max():.3f} N.",
            {"": "{:.3f}", "pairs": "{:d}"},
        )
    ]


PART = Part(measure, tables)
