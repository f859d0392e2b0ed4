"""Networks from one real session to the other: every method of the adaptation benchmark, beside the plain methods.

The methods' settings are those of the profile, which were chosen on generated domains without target labels: nothing is
tuned on real data.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from gelgap.adapt import ResultTable
from gelgap.benchmarks.adaptation.board import CEILING, DESIGNS, GROUPS, METHODS
from gelgap.benchmarks.adaptation.jobs import Bench
from gelgap.benchmarks.adaptation.leaderboard import Entry, read_entries
from gelgap.benchmarks.adaptation.running import run_missing
from gelgap.benchmarks.adaptation.tables import interval, number
from gelgap.benchmarks.common import bootstrap as bootstrap_interval
from gelgap.benchmarks.common import mean_of
from gelgap.benchmarks.common.tables import write_json
from gelgap.benchmarks.real.clip_folds import FOLDS, SEEDS
from gelgap.benchmarks.real.network_runs import (
    RUNS,
    FoldRecord,
    adapt_fold,
    errors_by_clip,
    fold_configuration,
    fold_jobs,
)
from gelgap.benchmarks.real.orders import order_agreement
from gelgap.benchmarks.real.plain_methods import PLAIN_METHODS
from gelgap.benchmarks.real.session_transfer import measure
from gelgap.benchmarks.real.sessions import SESSIONS, Session, converted_sessions, session_named

DIRECTIONS = (SESSIONS, SESSIONS[::-1])
QUICK_METHODS = ("source-only", "adabn", "no-transfer")
QUICK_CHANGES = (("source_epochs", 3), ("adapt_epochs", 2))
SYNTHETIC_RECORDS = Path("docs", "results", "records")
"""The leaderboard's records: errors of the methods on the nine synthetic groups."""
ALIKE = tuple(group for group in GROUPS if all(domain.startswith("wmb") for domain in group))
"""The synthetic groups that are most like the real one: other light, other gain, no markers."""
_START = "source-only"


@dataclass(frozen=True)
class DirectionResults:
    """Errors of the networks from one session to the other, on the clips that were tested."""

    source: Session
    target: Session
    records: Sequence[FoldRecord]

    @property
    def name(self) -> str:
        """Source and target."""
        return f"{self.source.name} → {self.target.name}"

    @cached_property
    def methods(self) -> list[str]:
        """The methods that were run, in the order of the benchmark."""
        return list(dict.fromkeys(record.job.method for record in sorted(self.records, key=_place)))

    @cached_property
    def clips(self) -> list[str]:
        """The tested clips of the target."""
        return sorted({clip for record in self.records for clip in record.clip_mae_n})

    @cached_property
    def seeds(self) -> list[int]:
        """The seeds of the runs."""
        return sorted({record.job.seed for record in self.records})

    @cached_property
    def errors_n(self) -> np.ndarray:
        """The MAE of Fz (methods, clips, seeds), N; NaN where a run is missing."""
        return np.array(
            [errors_by_clip(self.runs_of(method), self.clips, self.seeds) for method in self.methods]
        )

    def of(self, method: str) -> np.ndarray:
        """Return the errors (clips, seeds) of one method, N."""
        return self.errors_n[self.methods.index(method)]

    def runs_of(self, method: str) -> list[FoldRecord]:
        """Return the records of one method."""
        return [record for record in self.records if record.job.method == method]


def run(quick: bool, out_dir: Path, data: Path) -> None:
    """Do the runs that have no record yet, print the tables, and write `real-networks.json` to `out_dir`."""
    folder = converted_sessions(data, out_dir)
    profile = "smoke" if quick else "cpu"
    bench = Bench(folder, out_dir / "real" / profile, profile, workers=1 if quick else None)
    directions = DIRECTIONS[:1] if quick else DIRECTIONS
    if quick:
        jobs = fold_jobs(directions, QUICK_METHODS, SEEDS[:1], (0,), QUICK_CHANGES)
    else:
        jobs = fold_jobs(directions, METHODS, SEEDS, range(FOLDS))
    records = run_missing(bench, jobs, RUNS, adapt_fold, FoldRecord, fold_configuration)
    found = [
        DirectionResults(
            *(session_named(folder, name) for name in group),
            [record for record in records if record.job.group == group],
        )
        for group in directions
    ]
    tables = [direction_table(direction) for direction in found]
    if not quick:
        entries = read_entries(SYNTHETIC_RECORDS) if SYNTHETIC_RECORDS.is_dir() else []
        tables.append(order_table(found, entries))
    for table in tables:
        table.show()
    write_json(out_dir / "real-networks.json", tables)


def direction_table(results: DirectionResults) -> ResultTable:
    """Each method's error beside that of the plain ones, and what it brings against its own control."""
    shown = [*_plain_rows(results), *(_network_row(results, method) for method in results.methods)]
    collapsed = sum(record.problem is not None for record in results.records)
    folds = len({record.job.data for record in results.records})
    return ResultTable(
        f"Networks on real grasps, {results.name}: MAE of Fz on held-out target clips",
        [
            "method",
            "labels of",
            "MAE, N",
            "95 % interval",
            "control",
            "difference, N",
            "95 % interval",
            "time, s",
        ],
        shown,
        f"{len(results.clips)} clips, {folds} fold(s) by clip, {len(results.seeds)} seed(s), all crossed. "
        "Intervals: bootstrap over clips and seeds. Differences: error less that of the control on the same clips, "
        "negative where the method is better. Time: median of stage 2, or of a fit; stage 1 took "
        f"{number(_median([record.stage1_s for record in results.records if record.stage1_s]), '.1f')} s. "
        f"{collapsed} of {len(results.records)} runs stopped and count with the constant mean's error."
        f"{_closed(results)}",
    )


def order_table(directions: Sequence[DirectionResults], entries: Sequence[Entry]) -> ResultTable:
    """Kendall's τ between the orders of methods, both ways here, and with those of the leaderboard's records."""
    first, second = directions
    rows, notes = [_order_row(f"{first.name} and back", first, second.methods, second.errors_n)], []
    for design in DESIGNS:
        own = [entry for entry in entries if entry.design == design]
        if not own:
            notes.append(f"No records of the nine groups with {design} contacts are in {SYNTHETIC_RECORDS}.")
            continue
        methods, errors_n = [entry.method for entry in own], np.array([entry.errors_n for entry in own])
        for name, groups in (("nine groups", GROUPS), (f"{len(ALIKE)} groups without markers", ALIKE)):
            chosen_n = errors_n[:, [GROUPS.index(group) for group in groups]]
            rows += [
                _order_row(f"{here.name} and {name}, {design}", here, methods, chosen_n)
                for here in directions
            ]
    return ResultTable(
        "Do methods come in the same order? Kendall's τ",
        ["orders", "methods", "τ", "95 % interval"],
        rows,
        " ".join([f"Without {CEILING}. Intervals: bootstrap over clips or groups, and seeds.", *notes]),
    )


def _place(record: FoldRecord) -> int:
    return METHODS.index(record.job.method)


def _median(values: Sequence[float]) -> float:
    return float(np.median(values)) if len(values) else np.nan


def _plain_rows(results: DirectionResults) -> list[list[str]]:
    rows = []
    for method in PLAIN_METHODS:
        found = measure(results.source, results.target, method, tuple(results.seeds))
        errors_n = found.mae_n[[found.clips.index(clip) for clip in results.clips]]
        rows.append(
            [
                *(method.name, method.labels, *_error(errors_n)),
                *("–", "–", "–", f"{found.ms_per_fold / 1e3:.4f}"),
            ]
        )
    return rows


def _network_row(results: DirectionResults, method: str) -> list[str]:
    runs, own = results.runs_of(method), results.of(method)
    control, difference = runs[0].control, ["–", "–", "–"]
    if control in results.methods:
        less = own - results.of(control)
        difference = [control, number(_mean(less), "+.2f"), interval(bootstrap_interval(less), "+.2f")]
    labels = "both" if method == CEILING else "source"
    return [method, labels, *_error(own), *difference, number(_median([r.stage2_s for r in runs]), ".1f")]


def _error(errors_n: np.ndarray) -> tuple[str, str]:
    return number(_mean(errors_n), ".2f"), interval(bootstrap_interval(errors_n), ".2f")


def _mean(values: np.ndarray) -> float:
    """Return the mean over clips of the means over seeds."""
    return float(mean_of(mean_of(values, axis=1)))


def _closed(results: DirectionResults) -> str:
    """Say how far the best method without target labels comes; it is found by its errors, so that this is a bound."""
    if not {_START, CEILING} <= set(results.methods):
        return ""
    errors_n = {method: _mean(results.of(method)) for method in results.methods}
    start, end = errors_n[_START], errors_n.pop(CEILING)
    best = min(errors_n, key=errors_n.get)
    if not start > end:
        return f" {_START} is not worse than {CEILING}."
    share = (start - errors_n[best]) / (start - end)
    return (
        f" {best}, the best in hindsight, closes {100 * share:.0f} % of the way from {_START} to {CEILING}."
    )


def _order_row(name: str, here: DirectionResults, methods: Sequence[str], errors: np.ndarray) -> list[str]:
    common = [method for method in here.methods if method in methods and method != CEILING]
    own = here.errors_n[[here.methods.index(method) for method in common]]
    others = errors[[list(methods).index(method) for method in common]]
    found = order_agreement(own, others)
    return [name, str(len(common)), number(found.tau, "+.2f"), interval(found.interval, "+.2f")]
