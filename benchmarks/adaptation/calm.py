"""How calm training is: two runs that differ in rounding alone, and how far their errors on the target come apart.

The second run starts from weights that are a ten-millionth apart, as another processor's arithmetic would make them. A
comparison of methods means little below the difference that this makes.
"""

import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import torch

from gelgap.adapt import ResultTable
from gelgap.benchmarks.adaptation import board, designs
from gelgap.benchmarks.adaptation.board import PLAIN
from gelgap.benchmarks.adaptation.study import Part, Study, grid, load_runs, short
from gelgap.benchmarks.common import Results, Setting, result_table

FILE = "calm.jsonl"
ROUNDING = 1e-7
METHODS = (PLAIN, "adabn")
GROUPS = (("wmb0i0", "wmb0i1"), ("wmb0i1", "wmb0i0"))
SEEDS = (0, 1, 2)
CALIBRATED = ("input", "calibrated")
_FORMER = (("source_epochs", 60), ("source_learning_rate", 0.2), ("rate_decay", 3e-4), ("averaging", 0.0))
VARIANTS: dict[str, board.Changes] = {
    "as cpu": (*board.BY_POINT, *_FORMER),
    "as cpu, averaged": (*board.BY_POINT, *_FORMER[:3]),
    "board": board.BY_POINT,
    "board, calibrated": (*board.BY_POINT, CALIBRATED),
}
"""Training as the profile cpu has it, with the average of the weights, and as the board has it."""


def measure(study: Study) -> None:
    """Do the missing runs."""
    cases = [(designs.DATA, group) for group in study.groups or GROUPS]
    seeds, methods = study.seeds or SEEDS, study.known_methods() or METHODS
    runs = [
        run | {"rounding": rounding}
        for seed in seeds
        for changes in VARIANTS.values()
        for rounding in (0, 1)
        for run in grid(cases, methods, [seed], changes)
    ]
    study.generate_for(runs)
    study.run(calm_run, runs, FILE)


def calm_run(study: Study, run: Setting) -> Results:
    """Do one run whose first weights are rounded otherwise, if it says so."""
    from gelgap.adapt.runs import Stage1, run_method

    frames = study.frames_of(run)
    stage1 = Stage1(frames.source_train, study.profile_of(run), run["seed"], out=study.out / "calm")
    with tempfile.TemporaryDirectory() as folder:
        if run["rounding"]:
            start = stage1.untrained()
            rng = torch.Generator().manual_seed(run["seed"])
            with torch.no_grad():
                for weights in start.network.parameters():
                    weights.mul_(1 + ROUNDING * torch.randn(weights.shape, generator=rng))
            file = Path(folder) / "start.pt"
            # The file's bytes are the same in every call, and with them the name of the checkpoint.
            start.save(file)
            stage1 = replace(stage1, weights=file)
        done, _ = run_method(frames, stage1, run["method"])
    return {"problem": done.problem, "mae_n": short(done.target_test.mae_n), "r2": short(done.target_test.r2)}


def tables(folder: Path) -> list[ResultTable]:
    """Return by variant and method the mean error, and how far two runs of a group and seed come apart."""
    runs = load_runs(folder / FILE)
    if runs.empty:
        return []
    names = {changes: name for name, changes in VARIANTS.items()}
    runs = runs.assign(variant=runs["changes"].map(names))
    pairs = runs.pivot_table(
        values="error_n", index=["variant", "method", "group", "seed"], columns="rounding"
    ).dropna()
    if not len(pairs):
        return []
    apart = pairs.diff(axis=1).iloc[:, -1].abs()
    of_both = ["variant", "method"]
    frame = pd.DataFrame(
        {
            "mean MAE, N": pairs.mean(axis=1).groupby(of_both).mean(),
            "apart, mean N": apart.groupby(of_both).mean(),
            "apart, most N": apart.groupby(of_both).max(),
            "pairs": apart.groupby(of_both).size(),
        }
    )
    order = [name for name in VARIANTS if name in frame.index.get_level_values(0)]
    return [
        result_table(
            "Two runs that differ in rounding",
            frame.reindex(order, level=0),
            f"First weights {ROUNDING:g} apart; {runs['group'].nunique()} group(s), {runs['seed'].nunique()} seed(s). "
            f"Largest difference of all: {np.max(apart):.3f} N.",
            {"": "{:.3f}", "pairs": "{:d}"},
        )
    ]


PART = Part(measure, tables)
