"""Force from one session's light to another's: grasps of the same objects with a GelSight Wedge, both ways.

`run` measures rules that see one number of a picture, `networks` every method of adaptation beside them, with the
settings of the profile: nothing is tuned on real data. Errors are those of held-out clips of the target. Intervals
are the bootstrap's over clips and seeds; pictures of a clip are never drawn one by one, as neighbours are nearly equal.
"""

import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import cache, partial
from pathlib import Path
from typing import Any, NamedTuple, Self

import numpy as np
import pandas as pd

from gelgap.adapt import ResultTable
from gelgap.benchmarks.adaptation.board import METHODS, UPPER_BOUND, Changes, Group
from gelgap.benchmarks.adaptation.study import Study, control_of, grid, train_once, versions_line
from gelgap.benchmarks.common import Results, Setting, bootstrap, write_json
from gelgap.benchmarks.real.published_sets import converted_wedge
from gelgap.domains import LabelledFrames, Labels, open_domain, with_labels
from gelgap.domains.formats.convert import CONTACT_N
from gelgap.domains.frames.run_labels import force_classes

SESSIONS = ("2023-12-06", "2023-12-16")
"""The two sessions with objects in common."""
DIRECTIONS: tuple[Group, ...] = (SESSIONS, SESSIONS[::-1])
FZ_RANGE_N = (-30.0, 0.0)
"""By which both sessions' forces are normalised; stated beforehand, so that no label of the target moves it."""
FOLDS = 3
SEEDS = (0, 1, 2, 3, 4)
CLASSES = 12
"""Contact classes of equal size by Fz, for methods that need them."""
RUNS = "runs.jsonl"
QUICK_METHODS = ("source-only", "adabn", "no-transfer")
QUICK_CHANGES: Changes = (("source_epochs", 3), ("adapt_epochs", 2))
_SIZE_PX = (80, 60)
_FOLD = "fold-"

Session = pd.DataFrame
"""The pictures in contact of one session, which has one light, numbered from 0: `session`, `clip`, `object`, `fz_n`,
and `change`, the mean absolute difference of a picture from its clip's reference, in grey levels."""


class Fold(NamedTuple):
    """What a method may train on, and the target's clips that it is tested on: parts of sessions, or their frames.

    The target's training clips come without labels unless a method says that it uses them.
    """

    source_train: Any
    target_train: Any
    target_test: Any


@cache
def read_sessions(folder: Path) -> dict[str, Session]:
    """Return the two sessions that are compared, of the objects that both have.

    Raises
    ------
    FileNotFoundError
        If a session is missing.
    ValueError
        If they have no object in common.
    """
    both = {name: _read(folder / name) for name in SESSIONS}
    shared = set.intersection(*(set(session["object"]) for session in both.values()))
    if not shared:
        raise ValueError(f"the sessions {' and '.join(SESSIONS)} of {folder} have no object in common")
    return {name: session[session["object"].isin(shared)] for name, session in both.items()}


def _read(folder: Path) -> Session:
    frames = _in_contact(folder)
    references = frames.references_at(_SIZE_PX).astype(float)
    change = np.abs(frames.images(_SIZE_PX) - references[frames.reference_id]).mean(axis=(1, 2, 3))
    columns = {name: frames.columns[name] for name in ("clip", "object", "fz_n")}
    return pd.DataFrame({"session": folder.name, **columns, "change": change})


def frames_of_session(folder: Path, session: Session) -> LabelledFrames:
    """Return pictures of a session, whose folder of all sessions is given, with Fz as their only label."""
    return _in_contact(folder / session["session"].iloc[0]).take(session.index.to_numpy())


@cache
def _in_contact(folder: Path) -> LabelledFrames:
    frames = open_domain(folder)
    pressed = frames.take(np.flatnonzero(-frames.columns["fz_n"] > CONTACT_N))
    return with_labels(pressed, Labels.of({"fz_n": FZ_RANGE_N}))


def key_of_session(session: Session) -> list[Any]:
    """Return what a training on a session depends on: its name, and the clip and the force of each picture."""
    return [session["session"].iloc[0], session["clip"].tolist(), session["fz_n"].tolist()]


def clip_folds(source: Session, target: Session, seed: int) -> Iterator[Fold]:
    """Yield the folds of a seed, which deals the clips of each object anew; the source's are dealt too.

    Each clip is tested in one fold of a seed. Those of an object go round the folds, in random order from a random one.
    """
    dealt = []
    for place, session in enumerate((source, target)):
        rng, folds = np.random.default_rng((seed, place)), {}
        for _, own in session.groupby("object"):
            clips = rng.permutation(sorted(own["clip"].unique()))
            start = int(rng.integers(FOLDS))
            folds |= {str(clip): (start + turn) % FOLDS for turn, clip in enumerate(clips)}
        dealt.append(session["clip"].map(folds))
    for number in range(FOLDS):
        left_out, tested = (folds == number for folds in dealt)
        yield Fold(source[~left_out], target[~tested], target[tested])


class FoldStudy(Study):
    """Runs from one session to the other: the data are the folder of all converted sessions, a run's a fold of them."""

    @classmethod
    def of(cls, quick: bool, out_dir: Path, data: Path) -> Self:
        """Return the study of the cpu profile, or quickly of the smoke profile in this process."""
        profile = "smoke" if quick else "cpu"
        folder = converted_wedge(data, out_dir)
        return cls(folder, out_dir / "real" / profile, profile, workers=1 if quick else None)

    @staticmethod
    def describe(record: Results) -> str:
        """Return why a run stopped, or else its mean error over the tested clips."""
        return record["problem"] or f"{np.mean(list(record['clip_mae_n'].values())):.3f} N"

    def fold_of(self, run: Setting) -> Fold:
        """Return which pictures a run trains on and is tested on."""
        sessions = read_sessions(self.data)
        folds = clip_folds(sessions[run["source"]], sessions[run["target"]], run["seed"])
        return list(folds)[int(run["data"].removeprefix(_FOLD))]

    def frames_of(self, run: Setting) -> Fold:
        """Return the frames of a run, with Fz as their only label, and contact classes of the source's.

        The target's training labels are for the upper bound alone.
        """
        source, *target = (frames_of_session(self.data, own) for own in self.fold_of(run))
        return Fold(force_classes(source, CLASSES), *target)

    def stated_of(self, run: Setting) -> Results:
        """Return what the record of a run states of its profile, the range, the classes, and both sessions' forces."""
        forces = [key_of_session(read_sessions(self.data)[run[name]]) for name in ("source", "target")]
        return self.stated(self.profile_of(run), run["method"], FZ_RANGE_N, CLASSES, forces)


def fold_runs(
    directions: Iterable[Group],
    methods: Iterable[str],
    seeds: Iterable[int],
    folds: Sequence[int] = range(FOLDS),
    changes: Changes = (),
) -> list[Setting]:
    """Return the runs of every fold with every seed, one seed after the other."""
    cases = [(f"{_FOLD}{fold}", direction) for direction in directions for fold in folds]
    return grid(cases, methods, seeds, changes)


def fitted_fz_n(
    fold: Fold, labels_of: str = "source", degree: int = 2, standardise: bool = False
) -> np.ndarray:
    """Return Fz (n,) in N of a fold's test pictures, by a polynomial in how much a picture differs from rest.

    Standardised, each domain's change has the mean 0 and the deviation 1 of its own training pictures.
    """
    labelled = fold.source_train if labels_of == "source" else fold.target_train
    change, tested = labelled["change"], fold.target_test["change"]
    if standardise:
        of_domains = (change, labelled["change"]), (tested, fold.target_train["change"])
        change, tested = ((values - own.mean()) / own.std(ddof=0) for values, own in of_domains)
    fitted = np.polynomial.Polynomial.fit(change.to_numpy(), labelled["fz_n"].to_numpy(), degree)
    return fitted(tested.to_numpy())


CONSTANT, QUADRATIC = "constant mean", "quadratic in the mean difference"
RULES: dict[str, Callable[[Fold], np.ndarray]] = {
    CONSTANT: partial(fitted_fz_n, degree=0),
    QUADRATIC: fitted_fz_n,
    "the same, standardised per domain": partial(fitted_fz_n, standardise=True),
    "the same, of the target's labels": partial(fitted_fz_n, labels_of="target"),
}
"""Methods without a network."""


def rule_records(runs: Iterable[Setting], fold_of: Callable[[Setting], Fold]) -> pd.DataFrame:
    """Return what rules find in their runs, in the form of the records of networks."""
    rows = []
    for run in runs:
        fold, start = fold_of(run), time.process_time()
        error_n = RULES[run["method"]](fold) - fold.target_test["fz_n"]
        results = {
            "clip_mae_n": clip_means(error_n, fold.target_test["clip"]),
            "control": None,
            "problem": None,
            "stage2_s": time.process_time() - start,
        }
        rows.append(run | results)
    return pd.json_normalize(rows)


def adapt_fold(study: FoldStudy, run: Setting) -> Results:
    """Do one run and return the MAE of Fz on each of the target's test clips, N, and what else its record needs.

    A run that stopped with a problem counts with the errors of the source's mean force. `stage1_s` is 0 where another
    run had trained the checkpoint.
    """
    frames = study.frames_of(run)
    stage1 = study.stage1(run, frames.source_train)
    stage1_s = train_once(stage1, run["method"])
    adapted = stage1.adapt(frames.target_train, run["method"])
    test, constant = frames.target_test, frames.source_train.label_values.mean(axis=0)
    return {
        "versions": versions_line(),
        "control": control_of(run["method"]),
        "problem": adapted.problem,
        "clip_mae_n": errors_by_clip(
            constant if adapted.problem else adapted.model.predict_frames(test), test
        ),
        "stage1_s": round(stage1_s, 2),
        "stage2_s": round(adapted.wall_s["stage2"], 2),
    }


def errors_by_clip(predicted: np.ndarray, tested: LabelledFrames) -> dict[str, float]:
    """Return the MAE on each clip, N, of predictions (n, 1) of Fz, or of one for all."""
    return clip_means((predicted - tested.label_values)[:, 0], tested.columns["clip"].astype(str))


def clip_means(errors: np.ndarray, clips: Sequence[str]) -> dict[str, float]:
    """Return the mean absolute error of pictures on each of their clips, to five digits after the point."""
    return pd.Series(np.abs(errors)).groupby(np.asarray(clips), sort=False).mean().round(5).to_dict()


def clip_table(records: pd.DataFrame) -> pd.DataFrame:
    """Return the errors of runs, N, by tested clip (rows) and seed or draw; NaN: not tested."""
    found = records.filter(regex="^clip_mae_n[.]").rename(columns=lambda name: name.partition(".")[2])
    return found.groupby(records["seed"]).first().T.sort_index().dropna(how="all")


def error_rows(
    records: pd.DataFrame, named_by: str, controls: Mapping[str, str | None]
) -> list[dict[str, Any]]:
    """Return a row of a table for each method, or what else names records: its error, and how its control's differs.

    The difference is left out where the control has no records.
    """
    found = {name: clip_table(own) for name, own in records.groupby(named_by, sort=False)}
    median_s, rows = records.groupby(named_by)["stage2_s"].median(), []
    for name, errors_n in found.items():
        mae_n = float(np.nanmean(errors_n))
        row = {named_by: name, "MAE, N": mae_n, "95 % interval": bootstrap(errors_n.to_numpy())}
        control = controls.get(name)
        if control in found and control != name:
            less_n = (errors_n - found[control]).to_numpy()
            difference_n = float(np.nanmean(less_n))
            row |= {"control": control, "difference, N": difference_n, "of difference": bootstrap(less_n)}
            row["difference, %"] = 100 * difference_n / (mae_n - difference_n)
        rows.append(row | {"time, s": median_s[name]})
    return rows


FORMATS = {"": "{:.2f}", "difference, N": "{:+.2f}", "of difference": "{:+.2f}"}
FORMATS |= {"difference, %": "{:+.0f}", "time, s": "{:.2g}"}
NOTE = (
    "Differences: error less that of the control on the same clips, negative where the method is better; % of the "
    "control's. Time: median of a training, or a fit."
)


def direction_table(records: pd.DataFrame, note: str) -> ResultTable:
    """Each method's error on the way from one session to the other, and what it brings against its own control."""
    controls = dict(zip(records["method"], records["control"], strict=True))
    way, clips = records.iloc[0], len(clip_table(records))
    return ResultTable.of(
        f"Real grasps, {way['source']} → {way['target']}: MAE of Fz on held-out target clips",
        pd.DataFrame(error_rows(records, "method", controls)),
        f"{clips} clips, {records['data'].nunique()} fold(s) by clip, {records['seed'].nunique()} seed(s), all "
        f"crossed. Intervals: bootstrap over clips and seeds. {note}",
        FORMATS,
    )


def run(quick: bool, out_dir: Path, data: Path) -> None:
    """Measure the rules both ways, print the tables, and write `real-sessions.json` to `out_dir`."""
    study = FoldStudy.of(quick, out_dir, data)
    runs = fold_runs(DIRECTIONS, RULES, SEEDS[:1] if quick else SEEDS)
    _show(rule_records(runs, study.fold_of), "Time: median of a fit.", out_dir / "real-sessions.json")


def networks(quick: bool, out_dir: Path, data: Path) -> None:
    """Do the runs that have no record yet, print the tables, and write `real-networks.json` to `out_dir`."""
    study = FoldStudy.of(quick, out_dir, data)
    directions, methods, seeds, folds, changes = DIRECTIONS, METHODS, SEEDS, range(FOLDS), ()
    if quick:
        directions, methods, seeds, folds = DIRECTIONS[:1], QUICK_METHODS, SEEDS[:1], range(1)
        changes = QUICK_CHANGES
    records = study.run(adapt_fold, fold_runs(directions, methods, seeds, folds, changes), RUNS)
    beside = rule_records(fold_runs(directions, RULES, seeds, folds), study.fold_of)
    stopped = f"{records['problem'].notna().sum()} of {len(records)} runs stopped and count with the constant's error."
    note = f"{UPPER_BOUND} has the labels of both. {NOTE} {stopped}"
    _show(pd.concat([beside, records]), note, out_dir / "real-networks.json")


def _show(records: pd.DataFrame, note: str, path: Path) -> None:
    tables = [direction_table(own, note) for _, own in records.groupby(["source", "target"], sort=False)]
    for table in tables:
        table.show()
    write_json(path, tables)
