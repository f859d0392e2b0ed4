"""What inputs and random lights are worth: methods on every input, and networks trained in random lights instead.

python -m gelgap.benchmarks.adaptation.inputs --inputs pictures calibrated like-target --methods dann

With `--table FILE` it prints the tables of a file of records in Markdown, and measures nothing.
"""

from collections.abc import Sequence

import pandas as pd

from gelgap.adapt.result_table import ResultTable
from gelgap.benchmarks.adaptation import protocol
from gelgap.benchmarks.adaptation.protocol import DRAWN_LIGHTS, PLAIN, SHOWABLE, changes_of
from gelgap.benchmarks.adaptation.study import Study, grid, run_script, upper_bounds_of
from gelgap.benchmarks.adaptation.tables import (
    control_table,
    in_order,
    target_table,
    upper_bounds,
    worth_table,
)
from gelgap.benchmarks.common import Setting
from gelgap.domains.drawn_lights import CANDIDATES, LIGHTS

SEEDS = (0, 1, 2, 3, 4)
METHODS = (PLAIN, "adabn", "dann", "dsan", "daregram")
GROUPS = (*protocol.LIGHT_GROUPS, ("wmb0i0", "wmb1i1"), ("wmb1i1", "wmb2i2"), ("mb0i0", "wmb0i0"))
"""Light alone, light and gel, markers."""
DRAWN = (
    f" Drawn: {LIGHTS} lights on the source's gel, together as many frames as one source; those like the target's are "
    f"the nearest of {CANDIDATES} by its picture without contact."
)


def input_grid(
    groups: Sequence[protocol.Group],
    methods: Sequence[str],
    seeds: Sequence[int],
    shown: Sequence[str] = (),
    data: str = protocol.DATA,
) -> list[Setting]:
    """Return the runs of some inputs and drawn lights, or of every one that a group can show."""
    with_markers = [group for group in groups if not any("wm" in domain for domain in group)]
    bare = dict.fromkeys(target for _, target in groups if target.startswith("wm"))
    runs: list[Setting] = []
    for seed in seeds:
        for name in shown or (*SHOWABLE, *DRAWN_LIGHTS):
            own = list(groups)
            if name == "markers":
                own = with_markers
            elif name in DRAWN_LIGHTS:
                own = [(protocol.drawn_source(name, target), target) for target in bare]
            runs += grid([(data, group) for group in own], methods, [seed], changes_of(name))
    return runs


def measure(study: Study) -> None:
    """Do the missing runs of every input and drawn light, or of those chosen, and of their upper bounds.

    Raises
    ------
    ValueError
        If no group can show what was chosen.
    """
    methods = study.known_methods() or METHODS
    runs = input_grid(study.groups or GROUPS, methods, study.seeds or SEEDS, study.inputs)
    if not runs:
        raise ValueError(
            f"--inputs {' '.join(study.inputs)}: no chosen group has markers on both sides, as in mb0i0:mb0i1"
        )
    bounds = upper_bounds_of(runs)
    study.generate_for([*bounds, *runs])
    study.run([*runs, *bounds])


def tables(runs: pd.DataFrame) -> list[ResultTable]:
    """Return what each method closes on what it is shown, and its errors by target; then what losses bring, by input.

    A run in drawn lights stands beside the groups of its target.
    """
    runs = runs[(runs["data"] == protocol.DATA) & runs["shown"].notna() & (runs["settings"].map(len) == 0)]
    on_pictures, bounds = upper_bounds(runs), {}
    for name in ("pictures", *runs["shown"].unique()):
        own = upper_bounds(runs, changes=changes_of(name))
        bounds[name] = own if len(own) else on_pictures
    runs = runs[runs["source"] != runs["target"]]
    drawn = runs["shown"].isin(DRAWN_LIGHTS)
    group_of = dict(zip(runs[~drawn]["target"], runs[~drawn]["group"], strict=True))
    runs = runs.assign(group=runs["group"].mask(drawn, runs["target"].map(group_of))).dropna(subset="group")
    runs = in_order(runs)
    if runs.empty:
        return []
    found = [target_table("Inputs and drawn lights, target by target", runs)]
    if (runs["shown"] == "pictures").any():  # where every gap begins
        note = DRAWN if runs["shown"].isin(DRAWN_LIGHTS).any() else ""
        found.append(worth_table("What inputs and drawn lights are worth", runs, bounds, note))
    found += [
        control_table(of_input, str(name), bounds[name])
        for name, of_input in runs.groupby("shown", sort=False)
        if "no-transfer" in set(of_input["method"])
    ]
    return found


if __name__ == "__main__":
    run_script("inputs", __doc__, measure, tables, ("seeds", "methods", "groups", "inputs"))
