"""What inputs and random lights are worth: methods on every input, and networks trained in random lights instead."""

from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from gelgap.adapt.inputs import INPUTS
from gelgap.adapt.result_table import ResultTable
from gelgap.benchmarks.adaptation import board
from gelgap.benchmarks.adaptation.board import BY_POINT, PLAIN
from gelgap.benchmarks.adaptation.groups import (
    R2,
    SEEDS,
    SUMMARY_FORMATS,
    control_table,
    counted,
    draws_of,
    halves,
    intervals_of,
    load_headline,
    load_upper_bounds,
    summary,
    upper_bounds_of,
    with_rules,
)
from gelgap.benchmarks.adaptation.study import RUNS, Part, Study, adapt_run, grid, load_runs
from gelgap.benchmarks.common import Setting
from gelgap.domains.drawn_lights import CANDIDATES, LIGHTS

METHODS = (PLAIN, "adabn", "dann", "dsan", "daregram")
INPUT_RUNS, LIGHT_RUNS = "inputs.jsonl", "lights.jsonl"
GROUPS = (*board.LIGHT_GROUPS, ("wmb0i0", "wmb1i1"), ("wmb1i1", "wmb2i2"), ("mb0i0", "wmb0i0"))
"""Light alone, light and gel, markers."""
LIGHT_METHODS = (PLAIN, "adabn")
BOARD_INPUTS = tuple(name for name, shown in INPUTS.items() if not shown.frozen)
"""What the board can show: a pretrained backbone needs a file."""
_SHOWN = ["closed", "closed Fz", "closed shear", "mean, N", "95 %, N", "Fz, N", "shear, N", *R2, "runs"]


def changes_of(name: str) -> board.Changes:
    """Return the changes of the profile that show an input."""
    hiding = (("marker_hiding", 0.0),) if INPUTS[name].find else ()
    unmoved = (("shift_px", 0),) if INPUTS[name].from_touch else ()
    return BY_POINT if name == "pictures" else (*BY_POINT, ("input", name), *hiding, *unmoved)


def input_grid(
    groups: Sequence[board.Group], methods: Sequence[str], seeds: Sequence[int], inputs: Sequence[str] = ()
) -> list[Setting]:
    """Return the runs of some inputs, or of every one that a group can show."""
    with_markers = [group for group in groups if not any("wm" in domain for domain in group)]
    runs: list[Setting] = []
    for seed in seeds:
        for name in inputs or BOARD_INPUTS:
            own = with_markers if name == "markers" else groups
            runs += grid([(board.DATA, group) for group in own], methods, [seed], changes_of(name))
    return runs


def measure_inputs(study: Study) -> None:
    """Do the missing runs of every input, or of those chosen.

    Raises
    ------
    ValueError
        If no group can show what was chosen.
    """
    if lights := [name for name in study.inputs if name not in INPUTS]:
        raise ValueError(f"--inputs {' '.join(lights)}: random lights are for the part `leaderboard` alone")
    methods = study.known_methods() or METHODS
    runs = input_grid(study.groups or GROUPS, methods, study.seeds or SEEDS, study.inputs)
    if not runs:
        raise ValueError(
            f"--inputs {' '.join(study.inputs)}: no chosen group has markers on both sides, as in mb0i0:mb0i1"
        )
    _measure(study, runs, INPUT_RUNS)


def lit_groups(groups: Sequence[board.Group]) -> list[board.Group]:
    """Return for every target without markers the group whose source is in lights like its."""
    targets = dict.fromkeys(target for _, target in groups if target.startswith("wm"))
    return [(board.LIKE + target, target) for target in targets]


def measure_lights(study: Study) -> None:
    """Do the missing runs of sources in random lights, for every target without markers, its labels shifted or not."""
    like = lit_groups(study.groups or GROUPS)
    sources = [*((board.ANY_LIGHT, target) for _, target in like), *like]
    cases = [(data, group) for data in board.BY_ROLE for group in sources]
    runs = grid(cases, study.known_methods() or LIGHT_METHODS, study.seeds or SEEDS)
    _measure(study, runs, LIGHT_RUNS)


def _measure(study: Study, runs: list[Setting], file: str) -> None:
    upper_bounds = upper_bounds_of(runs)
    study.generate_for([*upper_bounds, *runs])
    study.run(adapt_run, runs, file)
    study.run(adapt_run, upper_bounds, RUNS)


def input_tables(folder: Path) -> list[ResultTable]:
    """Return what each method closes on each input, by kind of gap; where controls were run, what its loss brings."""
    runs, upper_bounds, tables = load_runs(folder / INPUT_RUNS), load_upper_bounds(folder), []
    bounds = {name: load_upper_bounds(folder, changes=changes_of(name)) for name in INPUTS}
    bounds = {name: own if len(own) else upper_bounds for name, own in bounds.items()}
    light = runs["group"].isin([" → ".join(group) for group in board.LIGHT_GROUPS])
    for kind, own in (("only the light", runs[light]), ("other gaps", runs[~light])):
        if len(own):
            shown = _by_input(own)
            tables.append(_worth(f"What inputs are worth: {kind}", shown, own, bounds))
            tables += [
                control_table(with_input, f"{name}, {kind}", upper_bounds)
                for name, with_input in shown.items()
                if "no-transfer" in set(with_input["method"])
            ]
    return tables


def light_tables(folder: Path) -> list[ResultTable]:
    """Return what training in random lights closes, beside adaptation from one light to the same targets."""
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
            anyone = drawn["source"] == board.ANY_LIGHT
            shown = _by_input(adapted) | {"any light": drawn[anyone], "like the target's": drawn[~anyone]}
            title = f"Adapt or randomise? {data} contacts"
            bounds = dict.fromkeys(shown, load_upper_bounds(folder, data))
            tables.append(_worth(title, shown, adapted, bounds, note))
    return tables


def _by_input(runs: pd.DataFrame) -> dict[str, pd.DataFrame]:
    return {name: runs[runs["changes"].isin([changes_of(name)])] for name in INPUTS}


def _worth(
    title: str,
    shown: dict[str, pd.DataFrame],
    runs: pd.DataFrame,
    upper_bounds: dict[str, pd.DataFrame],
    note: str = "",
) -> ResultTable:
    """Return what methods close on whatever they are shown; start and rules are those of pictures in `runs`.

    An upper bound is on the same input, or on pictures where none was trained on it.
    """
    plain = with_rules(runs[runs["changes"].isin([BY_POINT])])
    found, orders = [], []
    for name, own in shown.items():
        if len(own):
            start = plain[plain["group"].isin(own["group"])]
            if not found:
                found.append(
                    _summary(start, upper_bounds["pictures"]).drop(own["method"].unique(), errors="ignore")
                )
            renamed = own.assign(method=own["method"] + f" / {name}")
            if order := halves(counted(own)):
                orders.append(f"On {name}: {order}")
            rows = _summary(pd.concat([start, renamed]), upper_bounds[name])
            found.append(rows[rows.index.isin(renamed["method"])])
    frame = pd.concat(found).reindex(columns=_SHOWN).dropna(axis=1, how="all").rename_axis("method / input")
    groups = ", ".join(sorted(runs["group"].unique()))
    return ResultTable.of(
        title,
        frame,
        f"{groups}; split by contact point. 95 %: bootstrap over pairs of sensors and seeds. Runs: pairs of group and "
        f"seed that all methods have. {' '.join(orders)}{note}",
        SUMMARY_FORMATS | {"runs": "{:.0f}", "95 %, N": "{:.3f}"},
    )


def _summary(runs: pd.DataFrame, upper_bounds: pd.DataFrame) -> pd.DataFrame:
    """Return `groups.summary` with a bootstrap interval of the mean error, over pairs of sensors and seeds."""
    errors = counted(runs)
    frame = summary(runs, upper_bounds)
    frame["95 %, N"], frame["runs"] = intervals_of(draws_of(errors), errors.columns), len(errors)
    return frame


INPUT_PART = Part(measure_inputs, input_tables, chosen=("seeds", "methods", "groups", "inputs"))
LIGHT_PART = Part(measure_lights, light_tables)
