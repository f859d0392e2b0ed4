"""Choosing transfer weight and epoch without target labels: one grid for all methods, and the regret of each rule."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from gelgap.adapt import ResultTable
from gelgap.benchmarks.adaptation.jobs import Bench, TrainingJob, run_missing
from gelgap.benchmarks.adaptation.parts import Part
from gelgap.benchmarks.adaptation.tables import group_name
from gelgap.benchmarks.common.records import read_records

WEIGHTS = (0.0003, 0.003, 0.03, 0.3, 3.0)
"""The grid of transfer weights, the same for every method."""

RECORD = "search.jsonl"
EPOCHS_BETWEEN = 2
"""Candidates are taken after every second epoch."""

SEARCH_METHODS = ("dann", "daregram", "dsan")
"""The methods of the main table that have a weight."""
SEARCH_GROUPS = (("mb0i0", "wmb1i1"),)


@dataclass(frozen=True)
class SearchRecord:
    """One run of the grid: per candidate epoch its test error on the target (N), each selector's score, its alarm."""

    job: TrainingJob
    profile: str
    epochs: tuple[int, ...] = ()
    error_n: tuple[float, ...] = ()
    scores: dict[str, tuple[float, ...]] | None = None
    alarms: tuple[bool, ...] = ()
    problem: str | None = None

    @property
    def mean_mae_n(self) -> float:
        """Error after the last epoch, N."""
        return self.error_n[-1] if self.error_n else math.nan

    @property
    def weight(self) -> float:
        """The transfer weight of the run."""
        return dict(self.job.changes)["transfer_weight"]


def search_jobs(
    groups: Sequence[tuple[str, str]], methods: Sequence[str], seeds: Sequence[int]
) -> list[TrainingJob]:
    """Return the grid's runs."""
    return [
        TrainingJob(source, target, method, seed, (("transfer_weight", weight),))
        for seed in seeds
        for source, target in groups
        for method in methods
        for weight in WEIGHTS
    ]


def measure(bench: Bench) -> None:
    """Do the grid's missing runs, by default of one seed."""
    bench.generate_preset()
    jobs = search_jobs(SEARCH_GROUPS, SEARCH_METHODS, bench.seeds or (0,))
    run_missing(bench, jobs, RECORD, search_job, SearchRecord)


def search_job(bench: Bench, job: TrainingJob) -> SearchRecord:
    """Adapt once and score the model after every second epoch; selectors see no target label."""
    from gelgap.adapt import FeatureCollapse, Stage1, TrainingDiverged, adapt, evaluate, split_for_training
    from gelgap.adapt.selection import alarm, scores
    from gelgap.domains import open_domain

    profile = job.profile(bench.profile)
    source, target = (open_domain(bench.data / name) for name in job.group)
    frames = split_for_training(source, target, profile, job.seed)
    stage1, _ = Stage1(frames.source_train, profile, job.seed, out=bench.out).model()
    epochs, errors, found, alarms, problem = [], [], [], [], None

    def watch(epoch: int, model) -> None:
        if epoch % EPOCHS_BETWEEN == 0 or epoch == profile.adapt_epochs:
            candidate = candidate_of(model, frames)
            epochs.append(epoch)
            errors.append(evaluate(model, frames.target_test).mean_mae_n)
            found.append(scores(candidate))
            alarms.append(alarm(candidate))

    pair = frames.source_train, frames.target_train
    try:
        adapt(stage1, *pair, job.method, profile, job.seed, watch=watch)
    except (FeatureCollapse, TrainingDiverged) as trouble:
        problem = str(trouble)
    by_selector = {name: tuple(values[name] for values in found) for name in (found[0] if found else ())}
    return SearchRecord(job, bench.profile, tuple(epochs), tuple(errors), by_selector, tuple(alarms), problem)


def candidate_of(model, frames):
    """Return what selectors may see of a model: source frames as the model is judged on them."""
    from gelgap.adapt import Candidate, as_judged_on_source

    on_source = as_judged_on_source(model, frames.source_train)
    return Candidate(
        source_features=on_source.features(frames.source_held_out),
        source_force_n=frames.source_held_out.force_n,
        source_prediction_n=on_source.predict_n(frames.source_held_out),
        target_features=model.features(frames.target_validation),
        target_prediction_n=model.predict_n(frames.target_validation),
    )


class Choice(NamedTuple):
    """What one selection rule chose from a grid: weight, epoch, its test error and its regret, N."""

    rule: str
    weight: float
    epoch: int
    error_n: float
    regret_n: float


def choices(records: Sequence[SearchRecord]) -> list[Choice]:
    """Return what each rule chooses among all weights and epochs of one group, method and seed.

    Rules: the target's labels (the oracle), the last epoch of the profile's weight, the last epoch of the weight that
    reverse validation prefers there (how the profiles' weights were found), and each selector among all candidates.
    A run that collapsed counts with the epochs before.
    """
    from gelgap.adapt import SELECTORS, Profile, transfer_weight
    from gelgap.adapt.selection import best_of

    pool = [(record, i) for record in records for i in range(len(record.epochs))]
    error = np.array([record.error_n[i] for record, i in pool])
    last = max(record.epochs[i] for record, i in pool)
    ended = [k for k, (record, i) in enumerate(pool) if record.epochs[i] == last]

    def best(selector: str, among: Sequence[int]) -> int:
        candidates = [pool[k] for k in among]
        scores = [record.scores[selector][i] for record, i in candidates]
        return among[best_of(scores, [record.alarms[i] for record, i in candidates])]

    own_weight = transfer_weight(records[0].job.method, Profile.preset(records[0].profile))
    chosen = {"target labels (oracle)": int(error.argmin())}
    own = [k for k in ended if pool[k][0].weight == own_weight]
    chosen |= {"last epoch, profile's weight": own[0]} if own else {}
    chosen["last epoch, weight by reverse validation"] = best("reverse validation", ended)
    chosen |= {name: best(name, range(len(pool))) for name in SELECTORS}
    return [
        Choice(rule, pool[k][0].weight, pool[k][0].epochs[pool[k][1]], error[k], error[k] - error.min())
        for rule, k in chosen.items()
    ]


def tables(folder: Path) -> list[ResultTable]:
    """Return errors by weight and the regret of every rule, if the search was run."""
    records = read_records(folder / RECORD, SearchRecord)
    return [weight_table(records), regret_table(records)] if records else []


def weight_table(records: Sequence[SearchRecord]) -> ResultTable:
    """Return the last epoch's error by method and weight, mean over groups and seeds."""

    def cell(method: str, weight: float) -> str:
        own = [r for r in records if (r.job.method, r.weight) == (method, weight)]
        good = [record.mean_mae_n for record in own if record.problem is None]
        mean = [f"{np.mean(good):.3f}"] if good else []
        lost = [f"({len(own) - len(good)} of {len(own)} collapsed)"] if len(good) < len(own) else []
        return " ".join(mean + lost) or "–"

    return ResultTable(
        "Target MAE after the last epoch by transfer weight, N",
        ["method", *(f"λ_t = {weight:g}" for weight in WEIGHTS)],
        [[method, *(cell(method, weight) for weight in WEIGHTS)] for method in _methods(records)],
        f"Mean over {_where(records)}",
    )


def regret_table(records: Sequence[SearchRecord]) -> ResultTable:
    """Return each rule's mean regret by method over groups and seeds, its mean and its worst."""
    grids: dict[tuple, list[SearchRecord]] = {}
    for record in records:
        grids.setdefault((record.job.group, record.job.method, record.job.seed), []).append(record)
    regrets: dict[str, dict[str, list[float]]] = {}
    for (_, method, _), grid in grids.items():
        for choice in choices(grid) if any(record.epochs for record in grid) else ():
            regrets.setdefault(choice.rule, {}).setdefault(method, []).append(choice.regret_n)
    methods = _methods(records)
    rows = []
    for rule, by_method in regrets.items():
        means = [f"{np.mean(by_method[m]):.3f}" if m in by_method else "–" for m in methods]
        everything = np.concatenate(list(by_method.values()))
        rows.append([rule, *means, f"{everything.mean():.3f}", f"{everything.max():.3f}"])
    return ResultTable(
        "Regret of choosing weight and epoch without target labels, N",
        ["chosen by", *methods, "mean", "worst"],
        rows,
        f"Error of the choice less that of the best among {len(WEIGHTS)} weights and all epochs; "
        f"mean over {_where(records)}",
    )


def _methods(records: Sequence[SearchRecord]) -> list[str]:
    return list(dict.fromkeys(record.job.method for record in records))


def _where(records: Sequence[SearchRecord]) -> str:
    groups = ", ".join(dict.fromkeys(group_name(record.job.group) for record in records))
    return f"{groups}; {len({record.job.seed for record in records})} seed(s)."


PART = Part(measure, tables)
run = PART.run
