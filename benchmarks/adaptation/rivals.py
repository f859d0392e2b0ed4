"""What inputs, drawn lights, losses and training are each worth, and which gaps they close.

Four questions, each a grid: methods on every input; networks that were trained in drawn lights instead of adapted;
methods on gaps of gel, friction, markers and light that are crossed; and one method trained longer, with more weight
and on more pixels.
"""

from collections.abc import Sequence
from itertools import product
from pathlib import Path

import pandas as pd

from gelgap.adapt import ResultTable
from gelgap.adapt.inputs import INPUTS
from gelgap.benchmarks.adaptation import board, designs
from gelgap.benchmarks.adaptation.board import BY_POINT, PLAIN
from gelgap.benchmarks.adaptation.groups import (
    R2,
    SEEDS,
    SUMMARY_FORMATS,
    ceilings_of,
    control_table,
    counted,
    draws_of,
    halves,
    intervals_of,
    load_ceilings,
    load_headline,
    summary,
    with_rules,
)
from gelgap.benchmarks.adaptation.study import RUNS, Part, Study, adapt_run, grid, load_runs
from gelgap.benchmarks.common import Setting, result_table

METHODS = (PLAIN, "adabn", "dann", "dsan", "daregram")
INPUT_RUNS, LIGHT_RUNS = "inputs.jsonl", "lights.jsonl"
CROSSED_RUNS, TRAINING_RUNS = "crossed.jsonl", "training.jsonl"
GROUPS = (*board.LIGHT_GROUPS, ("wmb0i0", "wmb1i1"), ("wmb1i1", "wmb2i2"), ("mb0i0", "wmb0i0"))
"""Light alone, light and gel, markers."""
BASE = "mb0i0"
LIGHT_METHODS = (PLAIN, "adabn")
TRAINED = ("dann", "calibrated")
"""Method and input that are trained otherwise."""
EPOCHS, WEIGHTS, SIZES_PX = (28, 112, 448), (0.0003, 0.003, 0.03), ((64, 48), (128, 96), (256, 192))
"""Of the second stage (18 steps an epoch), of the loss, and of the network's pictures; the board has 112, 0.003, 64."""
_SHOWN = ["closed", "closed Fz", "closed shear", "mean, N", "95 %, N", "Fz, N", "shear, N", *R2, "runs"]


def changes_of(name: str) -> board.Changes:
    """Return the changes of the profile that show an input."""
    hiding = (("marker_hiding", 0.0),) if INPUTS[name].shows_displacement else ()
    return BY_POINT if name == "pictures" else (*BY_POINT, ("input", name), *hiding)


def input_grid(
    groups: Sequence[board.Group], methods: Sequence[str], seeds: Sequence[int], inputs: Sequence[str] = ()
) -> list[Setting]:
    """Return the runs of some inputs, or of every one that a group can show.

    A pretrained backbone needs a file and is left out.
    """
    cases = {
        name: [
            (designs.DATA, group)
            for group in groups
            if not (shown.shows_displacement and any("wm" in domain for domain in group))
        ]
        for name, shown in INPUTS.items()
        if not shown.frozen and (name in inputs or not inputs)
    }
    return [
        run
        for seed in seeds
        for name, own in cases.items()
        for run in grid(own, methods, [seed], changes_of(name))
    ]


def measure_inputs(study: Study) -> None:
    """Do the missing runs of every input, or of those chosen.

    Raises
    ------
    ValueError
        If no group can show what was chosen.
    """
    methods = study.known_methods() or METHODS
    runs = input_grid(study.groups or GROUPS, methods, study.seeds or SEEDS, study.inputs)
    if not runs:
        raise ValueError(
            f"--inputs {' '.join(study.inputs)}: no chosen group has dots on both sides, as in mb0i0:mb0i1"
        )
    _measure(study, runs, INPUT_RUNS)


def lit_groups(groups: Sequence[board.Group]) -> list[board.Group]:
    """Return for every target without markers the group whose source is in lights like its."""
    targets = dict.fromkeys(target for _, target in groups if target.startswith("wm"))
    return [(designs.LIKE + target, target) for target in targets]


def measure_lights(study: Study) -> None:
    """Do the missing runs of sources in drawn lights, for every target without markers, its labels shifted or not."""
    like = lit_groups(study.groups or GROUPS)
    sources = [*((designs.ANY_LIGHT, target) for _, target in like), *like]
    cases = [(data, group) for data in board.BY_ROLE for group in sources]
    runs = grid(cases, study.known_methods() or LIGHT_METHODS, study.seeds or SEEDS)
    _measure(study, runs, LIGHT_RUNS)


def measure_crossed(study: Study) -> None:
    """Do the missing runs of the crossed gaps."""
    cases = [(designs.DATA, (BASE, name)) for name, _ in designs.factorial_cells()]
    _measure(study, grid(cases, study.known_methods() or METHODS, study.seeds or SEEDS[:3]), CROSSED_RUNS)


def training_grid(groups: Sequence[board.Group], seeds: Sequence[int]) -> list[Setting]:
    """Return the runs of `TRAINED` at every length and weight, the smallest pictures first."""
    method, shown = TRAINED
    cases = [(designs.DATA, group) for group in groups]
    weights = [(("transfer_weight", weight),) for weight in WEIGHTS]
    runs = []
    for (width, height), epochs in product(SIZES_PX, EPOCHS):
        own = {"image_size_px": (width, height), "shift_px": 3 * width // 64, "adapt_epochs": epochs}
        changes = (*changes_of(shown), *own.items())
        runs += grid(cases, [method], seeds, changes, lambda _: weights)
    return runs


def measure_training(study: Study) -> None:
    """Do the missing runs of one method that is trained otherwise."""
    runs = training_grid(study.groups or board.LIGHT_GROUPS[:3], study.seeds or SEEDS[:1])
    study.generate_for(runs)
    study.run(adapt_run, runs, TRAINING_RUNS)


def _measure(study: Study, runs: list[Setting], file: str) -> None:
    ceilings = ceilings_of(runs)
    study.generate_for([*ceilings, *runs])
    study.run(adapt_run, runs, file)
    study.run(adapt_run, ceilings, RUNS)


def input_tables(folder: Path) -> list[ResultTable]:
    """Return what each method closes on each input, by kind of gap; where controls were run, what its loss brings."""
    runs, ceilings, tables = load_runs(folder / INPUT_RUNS), load_ceilings(folder), []
    light = runs["group"].isin([" → ".join(group) for group in board.LIGHT_GROUPS])
    for kind, own in (("only the light", runs[light]), ("other gaps", runs[~light])):
        if len(own):
            shown = _by_input(own)
            tables.append(_worth(f"What inputs are worth: {kind}", shown, own, ceilings))
            tables += [
                control_table(with_input, f"{name}, {kind}", ceilings)
                for name, with_input in shown.items()
                if "no-transfer" in set(with_input["method"])
            ]
    return tables


def light_tables(folder: Path) -> list[ResultTable]:
    """Return what training in drawn lights closes, beside adaptation from one light to the same targets."""
    from gelgap.domains.drawn_lights import CANDIDATES, LIGHTS

    note = (
        f" Drawn: {LIGHTS} lights on the source's gel, together as many frames as one source; those like the target's "
        f"are the nearest of {CANDIDATES} by its picture without contact."
    )
    lit, by_input, tables = load_runs(folder / LIGHT_RUNS), load_runs(folder / INPUT_RUNS), []
    for data in board.BY_ROLE:
        adapted = by_input[by_input["data"] == data]
        adapted = load_headline(folder, data) if adapted.empty else adapted
        group_of = dict(zip(adapted["target"], adapted["group"], strict=True))
        drawn = lit.assign(group=lit["target"].map(group_of))[lit["data"] == data].dropna(subset="group")
        adapted = adapted[adapted["group"].isin(drawn["group"])]
        if len(drawn):
            anyone = drawn["source"] == designs.ANY_LIGHT
            shown = _by_input(adapted) | {"any light": drawn[anyone], "like the target's": drawn[~anyone]}
            title = f"Adapt or randomise? {data} contacts"
            tables.append(_worth(title, shown, adapted, load_ceilings(folder, data), note))
    return tables


def _by_input(runs: pd.DataFrame) -> dict[str, pd.DataFrame]:
    return {name: runs[runs["changes"].isin([changes_of(name)])] for name in INPUTS}


def _worth(
    title: str, shown: dict[str, pd.DataFrame], runs: pd.DataFrame, ceilings: pd.DataFrame, note: str = ""
) -> ResultTable:
    """Return what methods close on whatever they are shown; start and rules are those of pictures in `runs`."""
    plain = with_rules(runs[runs["changes"].isin([BY_POINT])])
    found, entries = [], []
    for name, own in shown.items():
        if len(own):
            start = plain[plain["group"].isin(own["group"])]
            if not found:
                found.append(_summary(start, ceilings).drop(own["method"].unique(), errors="ignore"))
            renamed = own.assign(method=own["method"] + f" / {name}")
            entries.append(renamed)
            rows = _summary(pd.concat([start, renamed]), ceilings)
            found.append(rows[rows.index.isin(renamed["method"])])
    frame = pd.concat(found).reindex(columns=_SHOWN).dropna(axis=1, how="all").rename_axis("method / input")
    groups = ", ".join(sorted(runs["group"].unique()))
    return result_table(
        title,
        frame,
        f"{groups}; split by contact point. 95 %: bootstrap over pairs of sensors and seeds. Runs: pairs of group and "
        f"seed that all methods have. {halves(counted(pd.concat(entries)))}{note}",
        SUMMARY_FORMATS | {"runs": "{:.0f}", "95 %, N": "{:.3f}"},
    )


def _summary(runs: pd.DataFrame, ceilings: pd.DataFrame) -> pd.DataFrame:
    """Return `groups.summary` with a bootstrap interval of the mean error, over pairs of sensors and seeds."""
    errors = counted(runs)
    shown = {"95 %, N": intervals_of(draws_of(errors), errors.columns), "runs": len(errors)}
    return summary(runs, ceilings).assign(**shown)


def crossed_tables(folder: Path) -> list[ResultTable]:
    """Return the main effects of the crossed gaps on each method's error, and the mean."""
    runs = load_runs(folder / CROSSED_RUNS)
    cells = pd.DataFrame(dict(designs.factorial_cells())).T.astype(bool)
    errors = runs.pivot_table(values="error_n", index="target", columns="method").reindex(cells.index)
    errors = errors.dropna(axis=1)
    if errors.empty or not len(errors.columns):
        return []
    signs = cells.map(lambda differs: 1 if differs else -1)
    found = {"mean of all cells": errors.mean()}
    found |= {factor: errors.mul(signs[factor], axis=0).sum() / (len(cells) / 2) for factor in cells}
    return [
        result_table(
            f"Crossed gaps from {BASE}: main effects on the mean MAE, N",
            pd.DataFrame(found).T.rename_axis("gap"),
            f"{len(cells)} targets, {runs['seed'].nunique()} seed(s). An effect is the mean error with the gap less "
            "that without. No main effect is confounded with an interaction of two gaps.",
            {"": "{:+.3f}"},
        )
    ]


def training_tables(folder: Path) -> list[ResultTable]:
    """Return the mean error by width of the pictures and length of stage 2 (rows), and weight of the loss."""
    runs = load_runs(folder / TRAINING_RUNS)
    if runs.empty:
        return []
    own = pd.DataFrame((runs["changes"] + runs["settings"]).map(dict).tolist(), runs.index)
    rows = [own["image_size_px"].str[0].rename("px"), own["adapt_epochs"].rename("epochs")]
    means = runs["error_n"].groupby([*rows, own["transfer_weight"]]).mean().unstack()
    groups = ", ".join(sorted(runs["group"].unique()))
    return [
        result_table(
            f"Longer, heavier, sharper: {' on '.join(TRAINED)}, mean MAE, N",
            means.rename(columns="weight {:g}".format),
            f"{groups}; {runs['seed'].nunique()} seed(s), split by contact point. Px: width of the network's pictures; "
            "epochs of stage 2, of 18 steps each.",
            {"": "{:.3f}", "px": "{:d}", "epochs": "{:d}"},
        )
    ]


INPUT_PART = Part(measure_inputs, input_tables, chosen=("seeds", "methods", "groups", "inputs"))
LIGHT_PART = Part(measure_lights, light_tables)
CROSSED_PART = Part(measure_crossed, crossed_tables, chosen=("seeds", "methods"))
TRAINING_PART = Part(measure_training, training_tables, chosen=("seeds", "groups"))
