"""Choosing transfer weight and epoch without target labels: an equal grid for every method, and what choices cost."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path

import numpy as np

from gelgap.adapt import ResultTable
from gelgap.benchmarks.adaptation.jobs import Job, run_missing, study_parser

WEIGHTS = (0.0003, 0.003, 0.03, 0.3, 3.0)
"""The grid of transfer weights, the same for every method."""

RECORD = "search.jsonl"
EVERY = 2
"""Candidates are taken after every second epoch."""

SEARCH_METHODS = ("dann", "daregram", "dsan")
"""The methods of the main table that have a weight."""
SEARCH_GROUPS = (("mb0i0", "wmb1i1"),)


@dataclass(frozen=True)
class SearchLine:
    """One run of the grid: per candidate epoch its test error on the target (N), each selector's score, its alarm."""

    job: Job
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


def search_jobs(groups: Sequence[tuple[str, str]], methods: Sequence[str], seeds: Sequence[int]) -> list[Job]:
    """Return the grid's runs."""
    return [
        Job(source, target, method, seed, (("transfer_weight", weight),))
        for seed in seeds
        for source, target in groups
        for method in methods
        for weight in WEIGHTS
    ]


def search_job(data: Path, out: Path, profile: str, job: Job) -> SearchLine:
    """Adapt once and score the model after every second epoch; selectors see no target label."""
    from gelgap.adapt import FeatureCollapse, Stage1, TrainingDiverged, adapt, evaluate, split_for_training
    from gelgap.adapt.selection import alarm, scores
    from gelgap.domains import open_domain

    settings = job.profile(profile)
    source, target = (open_domain(data / name) for name in (job.source, job.target))
    frames = split_for_training(source, target, settings, job.seed)
    stage1, _ = Stage1(frames.source_train, settings, job.seed, out=out).model()
    epochs, errors, found, alarms, problem = [], [], [], [], None

    def watch(epoch: int, model) -> None:
        if epoch % EVERY == 0 or epoch == settings.adapt_epochs:
            candidate = candidate_of(model, frames)
            epochs.append(epoch)
            errors.append(evaluate(model, frames.target_test).mean_mae_n)
            found.append(scores(candidate))
            alarms.append(alarm(candidate))

    try:
        pair = frames.source_train, frames.target_train
        adapt(stage1, *pair, job.method, settings, job.seed, watch=watch)
    except (FeatureCollapse, TrainingDiverged) as trouble:
        problem = str(trouble)
    by_selector = {name: tuple(values[name] for values in found) for name in (found[0] if found else ())}
    return SearchLine(job, profile, tuple(epochs), tuple(errors), by_selector, tuple(alarms), problem)


def candidate_of(model, frames):
    """Return what selectors may see of a model: source frames under the source's normalisation, if it has its own."""
    from gelgap.adapt import Candidate, with_statistics_of

    per_domain = model.profile.batch_statistics == "per_domain"
    on_source = with_statistics_of(model, frames.source_train) if per_domain else model
    return Candidate(
        source_features=on_source.features(frames.source_held_out),
        source_force_n=frames.source_held_out.force_n,
        source_prediction_n=on_source.predict_n(frames.source_held_out),
        target_features=model.features(frames.target_validation),
        target_prediction_n=model.predict_n(frames.target_validation),
    )


@dataclass(frozen=True)
class Choice:
    """What one way of choosing took from a grid: weight, epoch, its test error and its regret, N."""

    rule: str
    weight: float
    epoch: int
    error_n: float
    regret_n: float


def choices(lines: Sequence[SearchLine]) -> list[Choice]:
    """Return what each rule chooses among all weights and epochs of one group, method and seed.

    Rules: the target's labels (the oracle), the last epoch of the profile's weight, the last epoch of the weight that
    reverse validation likes best there (how the profiles' weights were found), and each selector among all candidates.
    A run that collapsed counts with the epochs before.
    """
    from gelgap.adapt import SELECTORS, Profile, transfer_weight
    from gelgap.adapt.selection import best_of

    pool = [
        (_weight(line), epoch, line.error_n[i], {n: s[i] for n, s in line.scores.items()}, line.alarms[i])
        for line in lines
        if line.epochs
        for i, epoch in enumerate(line.epochs)
    ]
    error = np.array([candidate[2] for candidate in pool])

    def choice(rule: str, index: int) -> Choice:
        weight, epoch, own, _, _ = pool[index]
        return Choice(rule, weight, epoch, own, own - float(error.min()))

    last = max(candidate[1] for candidate in pool)
    found = [choice("target labels (oracle)", int(error.argmin()))]
    own_weight = transfer_weight(lines[0].job.method, Profile.preset(lines[0].profile))
    default = [i for i, c in enumerate(pool) if c[0] == own_weight and c[1] == last]
    found += [choice("last epoch, profile's weight", default[0])] if default else []
    ended = [i for i, c in enumerate(pool) if c[1] == last]
    rule = "reverse validation"
    found.append(
        choice(
            f"last epoch, weight by {rule}",
            ended[best_of([pool[i][3][rule] for i in ended], [pool[i][4] for i in ended])],
        )
    )
    for name in SELECTORS:
        chosen = best_of([c[3][name] for c in pool], [c[4] for c in pool])
        found.append(choice(name, chosen))
    return found


def _weight(line: SearchLine) -> float:
    return dict(line.job.changes)["transfer_weight"]


def grids(lines: Sequence[SearchLine]) -> dict[tuple[str, str, str, int], list[SearchLine]]:
    """Return the lines of each grid by source, target, method and seed."""
    found: dict[tuple[str, str, str, int], list[SearchLine]] = {}
    for line in lines:
        job = line.job
        found.setdefault((job.source, job.target, job.method, job.seed), []).append(line)
    return found


def weight_rows(lines: Sequence[SearchLine]) -> tuple[list[str], list[list[object]]]:
    """Return header and rows of the last epoch's error by method and weight, mean over groups and seeds."""
    methods = list(dict.fromkeys(line.job.method for line in lines))

    def cell(method: str, weight: float) -> str:
        own = [line for line in lines if line.job.method == method and _weight(line) == weight]
        if not own:
            return "–"
        lost = sum(line.problem is not None for line in own)
        good = [line.mean_mae_n for line in own if line.problem is None]
        mean = f"{np.mean(good):.3f}" if good else ""
        return " ".join(filter(None, [mean, f"({lost} of {len(own)} collapsed)" if lost else ""]))

    rows = [[method, *(cell(method, weight) for weight in WEIGHTS)] for method in methods]
    return ["method", *(f"λ_t = {weight:g}" for weight in WEIGHTS)], rows


def regret_rows(lines: Sequence[SearchLine]) -> tuple[list[str], list[list[object]]]:
    """Return header and rows: each rule's mean regret by method over groups and seeds, its mean and its worst."""
    by_rule: dict[str, dict[str, list[float]]] = {}
    methods = list(dict.fromkeys(line.job.method for line in lines))
    for (_, _, method, _), own in grids(lines).items():
        if any(line.epochs for line in own):
            for found in choices(own):
                by_rule.setdefault(found.rule, {}).setdefault(method, []).append(found.regret_n)

    def row(rule: str) -> list[object]:
        values = by_rule[rule]
        everything = np.concatenate([values.get(method, []) for method in methods])
        cells = [f"{np.mean(values[m]):.3f}" if m in values else "–" for m in methods]
        return [rule, *cells, f"{everything.mean():.3f}", f"{everything.max():.3f}"]

    return ["chosen by", *methods, "mean", "worst"], [row(rule) for rule in by_rule]


def search_tables(lines: Sequence[SearchLine]) -> list[ResultTable]:
    """Return errors by weight and the regret of every rule."""
    groups = dict.fromkeys(f"{line.job.source} → {line.job.target}" for line in lines)
    where = f"{', '.join(groups)}; {len({line.job.seed for line in lines})} seed(s)."
    return [
        ResultTable(
            "Target MAE after the last epoch by transfer weight, N", *weight_rows(lines), f"Mean over {where}"
        ),
        ResultTable(
            "Regret of choosing weight and epoch without target labels, N",
            *regret_rows(lines),
            f"Error of the choice less that of the best among {len(WEIGHTS)} weights and all epochs; mean over {where}",
        ),
    ]


def run(
    data: Path,
    out: Path,
    methods: Sequence[str] = SEARCH_METHODS,
    seeds: Sequence[int] = (0,),
    groups: Sequence[tuple[str, str]] = SEARCH_GROUPS,
    workers: int | None = None,
    minutes: float = math.inf,
) -> list[SearchLine]:
    """Do the grid's missing runs and print the tables."""
    jobs = search_jobs(groups, methods, seeds)
    lines = run_missing(
        data, out, out.name, jobs, search_job, SearchLine, RECORD, workers=workers, minutes=minutes
    )
    if lines:
        for table in search_tables(lines):
            table.show()
    return lines


if __name__ == "__main__":
    parser = study_parser(__doc__, seeds=(0,))
    parser.add_argument("--data", type=Path, required=True, help="folder of the four domains")
    parser.add_argument(
        "--out", type=Path, required=True, help="records; named after the profile, such as …/cpu"
    )
    parser.add_argument("--methods", nargs="+", default=list(SEARCH_METHODS))
    chosen = parser.parse_args()
    # Workers must find the job and its line by the module's own name.
    import_module("gelgap.benchmarks.adaptation.search").run(
        chosen.data, chosen.out, chosen.methods, chosen.seeds, workers=chosen.workers, minutes=chosen.minutes
    )
