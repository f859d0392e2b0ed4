"""Networks from one real session to the other: every method of the adaptation benchmark, beside the plain methods.

The methods' settings are those of the profile, which were chosen on generated domains without target labels: nothing is
tuned on real data.
"""

from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.stats import kendalltau

from gelgap.adapt import ResultTable
from gelgap.adapt.result_table import cell
from gelgap.assets.checksums import read_json
from gelgap.benchmarks.adaptation.board import CEILING, DESIGNS, GROUPS, METHODS, Changes
from gelgap.benchmarks.adaptation.groups import methods_of
from gelgap.benchmarks.adaptation.study import control_of, grid, versions_line
from gelgap.benchmarks.common import Results, Setting, bootstrap, mean_of, write_json
from gelgap.benchmarks.real.sessions import (
    FOLDS,
    FZ_RANGE_N,
    PLAIN_METHODS,
    SEEDS,
    SESSIONS,
    Fold,
    Session,
    SessionStudy,
    clip_folds,
    clip_table,
    compare,
    errors_by_clip,
    frames_of_session,
    key_of_session,
    plain_errors,
    read_sessions,
)

RUNS = "runs.jsonl"
DIRECTIONS = (SESSIONS, SESSIONS[::-1])
CLASSES = 12
"""Contact classes of equal size by Fz, for methods that need them."""
QUICK_METHODS = ("source-only", "adabn", "no-transfer")
QUICK_CHANGES = (("source_epochs", 3), ("adapt_epochs", 2))
SYNTHETIC_RECORDS = Path("docs", "results", "records")
"""The leaderboard's records: errors of the methods on the nine synthetic groups."""
ALIKE = tuple(group for group in GROUPS if all(domain.startswith("wmb") for domain in group))
"""The synthetic groups that are most like the real one: other light, other gain, no markers."""
_RESAMPLES = 1000
_FOLD = "fold-"


class FoldStudy(SessionStudy):
    """Runs from one session to the other; a fold is the data of a run."""

    def fold_of(self, run: Setting) -> Fold:
        """Return which pictures a run trains on and is tested on."""
        sessions = read_sessions(self.data)
        folds = clip_folds(sessions[run["source"]], sessions[run["target"]], run["seed"])
        return list(folds)[int(run["data"].removeprefix(_FOLD))]

    def frames_of(self, run: Setting) -> Fold:
        """Return the frames of a run, with Fz as their only label, and contact classes of the source's.

        The target's training labels are for the ceiling alone.
        """
        from gelgap.domains import force_classes

        source, *target = (frames_of_session(self.data, own) for own in self.fold_of(run))
        return Fold(force_classes(source, CLASSES), *target)

    def stated_of(self, run: Setting) -> Results:
        """Return what the record of a run states of its profile, the range, the classes, and both sessions' forces."""
        forces = [key_of_session(read_sessions(self.data)[run[name]]) for name in ("source", "target")]
        return self.stated(self.profile_of(run), run["method"], FZ_RANGE_N, CLASSES, forces)


def fold_runs(
    directions: Iterable[tuple[str, str]],
    methods: Sequence[str],
    seeds: Iterable[int],
    folds: Sequence[int],
    changes: Changes = (),
) -> list[Setting]:
    """Return the runs of every fold with every seed, one seed after the other."""
    cases = [(f"{_FOLD}{fold}", direction) for direction in directions for fold in folds]
    return grid(cases, methods, seeds, changes)


def adapt_fold(study: FoldStudy, run: Setting) -> Results:
    """Do one run and return the MAE of Fz on each of the target's test clips, N, and what else its record needs.

    A run that stopped with a problem counts with the errors of the source's mean force. `stage1_s` is 0 where another
    run had trained the checkpoint.
    """
    frames = study.frames_of(run)
    adapted = study.stage1(run, frames.source_train).adapt(frames.target_train, run["method"])
    test, constant = frames.target_test, frames.source_train.label_values.mean(axis=0)
    return {
        "versions": versions_line(),
        "control": control_of(run["method"]),
        "problem": adapted.problem,
        "clip_mae_n": errors_by_clip(constant if adapted.problem else adapted.model.predict(test), test),
        "stage1_s": round(adapted.wall_s["stage1"], 2),
        "stage2_s": round(adapted.wall_s["stage2"], 2),
    }


def run(quick: bool, out_dir: Path, data: Path) -> None:
    """Do the runs that have no record yet, print the tables, and write `real-networks.json` to `out_dir`."""
    study = FoldStudy.of(quick, out_dir, data)
    directions = DIRECTIONS[:1] if quick else DIRECTIONS
    if quick:
        runs = fold_runs(directions, QUICK_METHODS, SEEDS[:1], (0,), QUICK_CHANGES)
    else:
        runs = fold_runs(directions, METHODS, SEEDS, range(FOLDS))
    records, sessions = study.run(adapt_fold, runs, RUNS), read_sessions(study.data)
    both = [
        records[(records["source"] == source) & (records["target"] == target)]
        for source, target in directions
    ]
    tables = [
        direction_table(own, sessions[source], sessions[target])
        for own, (source, target) in zip(both, directions, strict=True)
    ]
    if not quick:
        tables.append(order_table(both, former_errors(SYNTHETIC_RECORDS)))
    for table in tables:
        table.show()
    write_json(out_dir / "real-networks.json", tables)


def errors_of(runs: pd.DataFrame) -> dict[str, pd.DataFrame]:
    """Return each method's MAE of Fz by tested clip and seed, N, in the board's order; NaN where a run is missing."""
    of_all = clip_table(runs, "clip_mae_n", "seed").dropna(how="all")
    return {
        method: clip_table(runs[runs["method"] == method], "clip_mae_n", "seed").reindex_like(of_all)
        for method in methods_of(runs)
    }


def direction_table(runs: pd.DataFrame, source: Session, target: Session) -> ResultTable:
    """Each method's error beside that of the plain ones, and what it brings against its own control."""
    errors_n, rows = errors_of(runs), []
    tested = next(iter(errors_n.values()))
    folds = {seed: list(clip_folds(source, target, seed)) for seed in tested.columns}
    for method, labels, predict in PLAIN_METHODS:
        own, ms = plain_errors(predict, folds)
        rows.append([method, labels, *_error(own.loc[tested.index]), None, None, None, f"{ms / 1e3:.4f}"])
    for method, own in errors_n.items():
        of_method = runs[runs["method"] == method]
        control, difference = of_method["control"].iloc[0], [None, None, None]
        if control in errors_n:
            difference = [control, *_error(own - errors_n[control], "{:+.2f}")]
        seconds = cell(float(of_method["stage2_s"].median()), "{:.1f}")
        rows.append([method, "both" if method == CEILING else "source", *_error(own), *difference, seconds])
    stage1_s, stopped = runs["stage1_s"][runs["stage1_s"] > 0].median(), runs["problem"].notna().sum()
    columns = ["method", "labels of", "MAE, N", "95 % interval"]
    return ResultTable(
        f"Networks on real grasps, {_name(runs)}: MAE of Fz on held-out target clips",
        [*columns, "control", "difference, N", "95 % interval", "time, s"],
        rows,
        f"{len(tested)} clips, {runs['data'].nunique()} fold(s) by clip, {tested.shape[1]} seed(s), all crossed. "
        "Intervals: bootstrap over clips and seeds. Differences: error less that of the control on the same clips, "
        "negative where the method is better. Time: median of stage 2, or of a fit; stage 1 took "
        f"{cell(float(stage1_s), '{:.1f}') or '–'} s. "
        f"{stopped} of {len(runs)} runs stopped and count with the constant mean's error.",
    )


def _name(runs: pd.DataFrame) -> str:
    return f"{runs['source'].iloc[0]} → {runs['target'].iloc[0]}"


def _error(errors_n: pd.DataFrame, form: str = "{:.2f}") -> tuple[str | None, str | None]:
    values = errors_n.to_numpy()
    return cell(float(mean_of(mean_of(values, axis=1))), form), cell(bootstrap(values), form)


def former_errors(folder: Path) -> pd.DataFrame:
    """Return the former board's errors, N, by design, method and group (rows) and seed; empty without its records."""
    records = [read_json(path) for path in sorted(folder.glob("*.json"))]
    if not records:
        return pd.DataFrame()
    runs = pd.json_normalize(records, "runs", ["design", "method"])
    runs["error_n"] = runs["mae_n"].map(np.mean)
    return runs.pivot(index=["design", "method", "source", "target"], columns="seed", values="error_n")


def order_table(both: Sequence[pd.DataFrame], former: pd.DataFrame) -> ResultTable:
    """Kendall's τ between the orders of methods, both ways here, and with those of the leaderboard's records."""
    here = {_name(runs): {method: own.to_numpy() for method, own in errors_of(runs).items()} for runs in both}
    (first, ours), (_, back) = here.items()
    compared, notes = [(f"{first} and back", ours, back)], []
    for design in DESIGNS:
        if design not in former.index:
            notes.append(f"No records of the nine groups with {design} contacts are in {SYNTHETIC_RECORDS}.")
            continue
        for name, groups in (("nine groups", GROUPS), (f"{len(ALIKE)} groups without markers", ALIKE)):
            of_methods = former.loc[design].groupby(level="method")
            theirs = {method: own.loc[method].loc[list(groups)].to_numpy() for method, own in of_methods}
            compared += [(f"{way} and {name}, {design}", errors_n, theirs) for way, errors_n in here.items()]
    rows = []
    for name, ours, theirs in compared:
        common = [method for method in ours if method in theirs and method != CEILING]
        tau, interval = order_agreement(*(np.array([errors[m] for m in common]) for errors in (ours, theirs)))
        rows.append([name, str(len(common)), cell(tau, "{:+.2f}"), cell(interval, "{:+.2f}")])
    return ResultTable(
        "Do methods come in the same order? Kendall's τ",
        ["orders", "methods", "τ", "95 % interval"],
        rows,
        " ".join([f"Without {CEILING}. Intervals: bootstrap over clips or groups, and seeds.", *notes]),
    )


def order_agreement(first: np.ndarray, second: np.ndarray) -> tuple[float, tuple[float, float]]:
    """Return Kendall's τ between the orders of methods by errors (methods, cases, seeds), and its 95 % interval.

    1 is the same order, −1 the reverse. NaN is a run that is not there.
    """

    def tau(one: np.ndarray, other: np.ndarray) -> float:
        means = (mean_of(mean_of(errors, axis=2), axis=1) for errors in (one, other))
        return float(kendalltau(*means, method="asymptotic").statistic)  # its exact p-value would take longer

    return compare(tau, first, second, is_paired=False, resamples=_RESAMPLES)
