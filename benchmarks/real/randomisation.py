"""What matters in synthetic data: pretrained with one factor at a time undrawn, then a few labels of a real session."""

from collections.abc import Sequence
from pathlib import Path

from gelgap.adapt import ResultTable
from gelgap.benchmarks.adaptation.tables import interval, number
from gelgap.benchmarks.common.tables import write_json
from gelgap.benchmarks.real.few_label_draws import Budget
from gelgap.benchmarks.real.pretraining import (
    COMPARED_ON,
    BudgetResults,
    bench_and_plan,
    budget_results,
    chosen_rate,
    compared,
    relative_difference,
    tuning_records,
)
from gelgap.benchmarks.real.starts import PRETRAINED, pretrain_once, without
from gelgap.domains import RANDOM_FACTORS

BUDGETS = (Budget(frames=16), Budget(clips=4, other_objects=True))
DRAWS = range(6)


def run(quick: bool, out_dir: Path, data: Path) -> None:
    """Pretrain once for each factor, do the runs that have no record yet, print the table, and write it as JSON.

    The learning rate is that which `pretraining` chooses for what is pretrained with all factors drawn.
    """
    bench, plan = bench_and_plan(quick, out_dir, data)
    factors, budgets, draws = (RANDOM_FACTORS, BUDGETS, DRAWS)
    if quick:
        factors, budgets, draws = (RANDOM_FACTORS[:1], BUDGETS[:1], range(1))
    starts = [PRETRAINED, *map(without, factors)]
    for start in starts:
        pretrain_once(bench, start)
    rate = chosen_rate(tuning_records(bench, plan, [PRETRAINED]), PRETRAINED)
    records = compared(bench, budgets, dict.fromkeys(starts, rate), draws)
    table = factor_table([budget_results(bench, budget, records) for budget in budgets], starts)
    table.show()
    write_json(out_dir / "real-randomisation.json", table)


def factor_table(found: Sequence[BudgetResults], starts: Sequence[str]) -> ResultTable:
    """Each start's errors, and by how much they differ from those with all factors drawn."""
    rows = []
    for start in starts:
        row = [start]
        for one in found:
            relative, *ends = relative_difference(one.errors_n[start], one.errors_n[PRETRAINED])
            row.append(number(one.mean_n(start), ".2f"))
            row += (
                ["–", "–"]
                if start == PRETRAINED
                else [number(relative, "+.0f", " %"), interval(ends, "+.0f")]
            )
        rows.append(row)
    columns = [text for one in found for text in (one.budget.name, "difference", "95 % interval")]
    draws = found[0].errors_n[PRETRAINED].shape[1]
    return ResultTable(
        f"What is drawn for pretraining, {COMPARED_ON}: MAE of Fz on clips that were not seen, N",
        ["pretrained", *columns],
        rows,
        "Differences: error over that with all factors drawn, above 0 where the factor helps; intervals: bootstrap "
        f"over clips and draws, paired; {draws} draws. One pretraining each: what another seed of it would change is "
        "not in them.",
    )
