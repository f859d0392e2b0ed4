"""Few labels of a real session, from scratch and from what `gelgap pretrain` makes: does synthetic data pay?

`randomisation` asks what matters in it: pretrained with one factor at a time undrawn. Whole clips are tested, and no
picture of theirs is seen before. Learning rates are chosen for each start on the other session, whose clips are in no
table.
"""

import math
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from gelgap.adapt import ResultTable
from gelgap.adapt.result_table import cell
from gelgap.benchmarks.adaptation.study import grid, versions_line
from gelgap.benchmarks.common import RESAMPLES, Results, Setting, mean_of, result_table, write_json
from gelgap.benchmarks.real.sessions import (
    FOLDS,
    FZ_RANGE_N,
    PLAIN_METHODS,
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
from gelgap.domains import RANDOM_FACTORS

if TYPE_CHECKING:
    from gelgap.adapt import ForceModel, Profile
    from gelgap.domains import LabelledFrames

RUNS = "few-labels.jsonl"
TUNED_ON, COMPARED_ON = SESSIONS
SCRATCH, PRETRAINED, WITHOUT = "scratch", "pretrained", "without-"
"""What training starts from: nothing, a checkpoint of `gelgap pretrain`, or one for which a factor was not drawn."""
RATES = {SCRATCH: (0.006, 0.02, 0.06, 0.2), PRETRAINED: (0.001, 0.002, 0.004, 0.008)}
"""Candidates of the learning rates."""
STEPS, QUICK_STEPS = 200, 5
"""Of every training, whatever it starts from and however much is labelled."""
RATE = "adapt_learning_rate"
"""The field of the profile that holds the learning rate of either start."""
PLAIN = PLAIN_METHODS[:2]
_METHOD = "no-transfer"
_DOMAINS, _FRAMES = 60, 60
_QUICK_DOMAINS, _QUICK_FRAMES, _QUICK_EPOCHS = 2, 12, 1


@dataclass(frozen=True)
class Budget:
    """How much is labelled: whole clips, or single frames of any clips; with `other_objects` none of the tested one."""

    clips: int = 0
    frames: int = 0
    other_objects: bool = False

    @property
    def name(self) -> str:
        """What it is in words."""
        amount, what = (self.clips, "clip") if self.clips else (self.frames, "frame")
        plural, others = "s" * (amount > 1), " of other objects" * self.other_objects
        return f"{amount} {what}{plural}{others}"


ONE_CLIP, OTHER_OBJECTS = Budget(clips=1), Budget(clips=4, other_objects=True)
BUDGETS = (
    *(Budget(clips=clips) for clips in (1, 2, 4, 8)),
    *(Budget(frames=frames) for frames in (4, 8, 16, 64)),
    OTHER_OBJECTS,
)
TUNING_BUDGETS, TUNING_DRAWS = (ONE_CLIP, Budget(frames=16), OTHER_OBJECTS), range(2)
DRAWS = range(12)
FACTOR_BUDGETS, FACTOR_DRAWS = (Budget(frames=16), OTHER_OBJECTS), range(6)


def few_labels(session: Session, budget: Budget, draw: int) -> tuple[Session, Session, Session]:
    """Return the pictures that a draw labels, those that are known without labels, these among them, and the tested.

    A draw tests the clips of one fold, and three draws test each clip once; or all clips of one object, one after the
    other. A smaller budget of the same kind labels a part of a larger one's.
    """
    if budget.other_objects:
        objects = sorted(session["object"].unique())
        is_tested = session["object"] == objects[draw % len(objects)]
    else:
        fold = list(clip_folds(session, session, draw // FOLDS))[draw % FOLDS]
        is_tested = session["clip"].isin(fold.target_test["clip"])
    known, rng = session[~is_tested], np.random.default_rng((draw, budget.other_objects))
    if budget.frames:
        labelled = known.loc[np.sort(rng.permutation(known.index)[: budget.frames])]
    else:
        labelled = known[known["clip"].isin(rng.permutation(sorted(known["clip"].unique()))[: budget.clips])]
    return labelled, known, session[is_tested]


class FewLabelStudy(SessionStudy):
    """Trainings on a few labels of a session, from a start: the source of a run; its data are a budget."""

    def checkpoint_of(self, start: str) -> Path | None:
        """Return the checkpoint of a start, None for the one from scratch."""
        return None if start == SCRATCH else self.out / start / "pretrained.pt"

    def stated_of(self, run: Setting) -> Results:
        """Return what a record states of profile, range, steps, the session's forces, and of what a run starts from."""
        from gelgap.assets.checksums import file_sha256

        session, checkpoint = read_sessions(self.data)[run["target"]], self.checkpoint_of(run["source"])
        start = None if checkpoint is None else file_sha256(checkpoint)
        data = FZ_RANGE_N, STEPS, key_of_session(session), start
        return self.stated(self.profile_of(run), run["method"], *data)


def few_label_runs(
    session: str, budgets: Iterable[Budget], rates: Mapping[str, Sequence[float]], draws: Iterable[int]
) -> list[Setting]:
    """Return the trainings of each start with each of its learning rates, one draw after the other."""
    # The sensor has no markers that training could hide.
    common = (("batch_statistics", "joint"), ("marker_hiding", 0.0))
    return [
        run
        for draw in draws
        for budget in budgets
        for start, own in rates.items()
        for rate in own
        for run in grid([(budget.name, (start, session))], [_METHOD], [draw], (*common, (RATE, rate)))
    ]


def train_on_few_labels(study: FewLabelStudy, run: Setting) -> Results:
    """Train on what a draw labels, and return the errors on what it tests; one that stops predicts the labels' mean."""
    from gelgap.adapt import FeatureCollapse, TrainingDiverged

    budget = next(budget for budget in BUDGETS if budget.name == run["data"])
    drawn = few_labels(read_sessions(study.data)[run["target"]], budget, run["seed"])
    labelled, known, tested = (frames_of_session(study.data, part) for part in drawn)
    profile, checkpoint = profile_of(study, run, len(labelled)), study.checkpoint_of(run["source"])
    for part in (labelled, known, tested):
        part.images(profile.image_size_px)  # read before the clock starts
    start, problem = time.perf_counter(), None
    try:
        predicted = trained(checkpoint, labelled, known, profile, run["seed"]).predict(tested)
    except (FeatureCollapse, TrainingDiverged) as trouble:
        predicted, problem = labelled.label_values.mean(axis=0), str(trouble)
    return {
        "versions": versions_line(),
        "control": None,
        "problem": problem,
        "clip_mae_n": errors_by_clip(predicted, tested),
        "stage1_s": 0.0,
        "stage2_s": round(time.perf_counter() - start, 2),
    }


def trained(
    checkpoint: Path | None,
    labelled: "LabelledFrames",
    known: "LabelledFrames",
    profile: "Profile",
    seed: int,
) -> "ForceModel":
    """Train a new network, or fine-tune that of a checkpoint as `gelgap finetune` does.

    A new one's batches are normalised together with unlabelled pictures, in the end by all of these; a pretrained one
    is normalised by the unlabelled pictures, before and after.
    """
    from gelgap.adapt import ForceModel, Stage1, adapt, fine_tune, with_statistics_of
    from gelgap.adapt.data import steps_per_epoch
    from gelgap.adapt.few_labels import of_common_labels
    from gelgap.domains import with_labels

    if checkpoint is None:
        untrained = Stage1(labelled, profile, seed).untrained()
        return with_statistics_of(adapt(untrained, labelled, known, _METHOD, profile, seed), known)
    model = with_statistics_of(of_common_labels(ForceModel.load(checkpoint), known), known)
    few = with_labels(labelled, model.labels)
    steps = profile.adapt_epochs * steps_per_epoch(len(few), profile.batch_size)
    return fine_tune(model, few, steps=steps, learning_rate=profile.adapt_learning_rate, seed=seed)


def profile_of(study: FewLabelStudy, run: Setting, labelled: int) -> "Profile":
    """Return a run's profile with as many epochs as make the steps of every training."""
    from gelgap.adapt.data import steps_per_epoch

    profile = study.profile_of(run)
    steps = QUICK_STEPS if study.is_quick else STEPS
    return profile.replace(adapt_epochs=math.ceil(steps / steps_per_epoch(labelled, profile.batch_size)))


def pretrain_once(study: FewLabelStudy, start: str) -> None:
    """Generate the domains of a start and pretrain, unless the checkpoint is there."""
    checkpoint = study.checkpoint_of(start)
    if checkpoint.is_file():
        return
    from gelgap.adapt import Profile, console_progress, pretrain
    from gelgap.domains import PretrainingRanges, pretraining_recipes

    ranges, profile = PretrainingRanges.default(), Profile.preset(study.profile)
    domains, frames = _DOMAINS, _FRAMES
    if study.is_quick:
        ranges, profile = ranges.in_quick_form(), profile.replace(source_epochs=_QUICK_EPOCHS)
        domains, frames = _QUICK_DOMAINS, _QUICK_FRAMES
    undrawn = [start.removeprefix(WITHOUT)] if start.startswith(WITHOUT) else []
    recipes = pretraining_recipes(domains, frames, ranges, without=undrawn)
    replace(study, data=checkpoint.parent).generate(recipes, "domains")
    with console_progress() as progress:
        folders = [checkpoint.parent / "domains" / recipe.name for recipe in recipes]
        print(pretrain(folders, checkpoint.parent, profile, progress=progress), flush=True)


def tune(study: FewLabelStudy, starts: Iterable[str]) -> pd.DataFrame:
    """Train with every candidate of the learning rates, on the session that is in no table; return the records."""
    rates, budgets, draws = {start: RATES[start] for start in starts}, TUNING_BUDGETS, TUNING_DRAWS
    if study.is_quick:
        rates, budgets, draws = {start: own[1:3] for start, own in rates.items()}, budgets[:1], draws[:1]
    return study.run(train_on_few_labels, few_label_runs(TUNED_ON, budgets, rates, draws), RUNS)


def compare_starts(
    study: FewLabelStudy, budgets: Sequence[Budget], rates: Mapping[str, float], draws: Iterable[int]
) -> tuple[pd.DataFrame, dict[Budget, "Errors"]]:
    """Train each start with its learning rate, on the session that is compared; return records and errors."""
    runs = few_label_runs(COMPARED_ON, budgets, {start: (rate,) for start, rate in rates.items()}, draws)
    records, session = study.run(train_on_few_labels, runs, RUNS), read_sessions(study.data)[COMPARED_ON]
    return records, {budget: errors_of(session, budget, records) for budget in budgets}


def pretraining(quick: bool, out_dir: Path, data: Path) -> None:
    """Pretrain, do the runs that have no record yet, print the tables, and write `real-pretraining.json`."""
    study = FewLabelStudy.of(quick, out_dir, data, "pretraining-")
    budgets, draws = ((ONE_CLIP, OTHER_OBJECTS), DRAWS[:2]) if quick else (BUDGETS, DRAWS)
    pretrain_once(study, PRETRAINED)
    tried = tune(study, RATES)
    chosen = {start: mean_by_rate(tried)[start].idxmin() for start in RATES}
    records, errors = compare_starts(study, budgets, chosen, draws)
    tables = [comparison_table(errors, records), rate_table(tried)]
    for table in tables:
        table.show()
    write_json(out_dir / "real-pretraining.json", tables)


def randomisation(quick: bool, out_dir: Path, data: Path) -> None:
    """Pretrain once for each factor, do the runs that have no record yet, print the table, and write it as JSON.

    The learning rate is that which `pretraining` chooses for what is pretrained with all factors drawn.
    """
    study = FewLabelStudy.of(quick, out_dir, data, "pretraining-")
    factors, budgets, draws = RANDOM_FACTORS, FACTOR_BUDGETS, FACTOR_DRAWS
    if quick:
        factors, budgets, draws = factors[:1], budgets[:1], draws[:1]
    starts = [PRETRAINED, *(f"{WITHOUT}{factor}" for factor in factors)]
    for start in starts:
        pretrain_once(study, start)
    rate = mean_by_rate(tune(study, [PRETRAINED]))[PRETRAINED].idxmin()
    _, errors = compare_starts(study, budgets, dict.fromkeys(starts, rate), draws)
    table = factor_table(errors, starts)
    table.show()
    write_json(out_dir / "real-randomisation.json", table)


Errors = Mapping[str, np.ndarray]
"""Errors with one budget by start or plain method, (clips, draws) in N, NaN where a draw does not test a clip."""


def errors_of(session: Session, budget: Budget, records: pd.DataFrame) -> Errors:
    """Return the errors of networks and plain methods on the clips that each draw tests."""
    own = records[records["data"] == budget.name]
    clips, draws = sorted(session["clip"].unique()), sorted(own["seed"].unique())
    found = {
        start: clip_table(runs, "clip_mae_n", "seed") for start, runs in own.groupby("source", sort=False)
    }
    folds = {}
    for draw in draws:
        labelled, _, tested = few_labels(session, budget, draw)
        folds[draw] = [Fold(labelled, labelled, tested)]
    found |= {name: plain_errors(predict, folds)[0] for name, _, predict in PLAIN}
    return {name: table.reindex(index=clips, columns=draws).to_numpy() for name, table in found.items()}


def relative_difference(own: np.ndarray, control: np.ndarray) -> tuple[float, tuple[float, float]]:
    """Return by how much errors (clips, draws) differ from a control's, % of its mean, and the 95 % interval."""

    def percent(one: np.ndarray, other: np.ndarray) -> float:
        return float(100 * (mean_of(one) / mean_of(other) - 1))

    return compare(percent, own, control, is_paired=True, resamples=RESAMPLES)


def comparison_table(found: Mapping[Budget, Errors], records: pd.DataFrame) -> ResultTable:
    """Each budget's errors, and the difference between the two starts."""
    shown = (*(name for name, *_ in PLAIN), SCRATCH, PRETRAINED)
    relative = {budget: relative_difference(own[PRETRAINED], own[SCRATCH]) for budget, own in found.items()}
    rows = [
        {
            "labelled": budget.name,
            **{name: float(mean_of(own[name])) for name in shown},
            "difference": relative[budget][0],
            "95 % interval": relative[budget][1],
            "draws": own[SCRATCH].shape[1],
        }
        for budget, own in found.items()
    ]
    return result_table(
        f"Few labels on real grasps, {COMPARED_ON}: MAE of Fz on clips that were not seen, N",
        pd.DataFrame(rows),
        "Difference: the pretrained network's error over that from scratch; intervals: bootstrap "
        f"over clips and draws, paired. {FOLDS} draws test each clip once, or a draw tests all clips of one object. "
        f"Both networks take {STEPS} steps, and see the pictures of all clips but the tested ones without labels, to "
        "normalise by: from scratch in every batch, pretrained before the first one. A training took "
        f"{records['stage2_s'].median():.1f} s. {records['problem'].notna().sum()} of {len(records)} stopped and count "
        "with the constant's error.",
        {"": "{:.2f}", "difference": "{:+.0f} %", "95 % interval": "{:+.0f}", "draws": "{:d}"},
    )


def mean_by_rate(tried: pd.DataFrame) -> pd.Series:
    """Return the mean error over the runs of each start with each learning rate, N."""
    error_n = tried.filter(like="clip_mae_n.").mean(axis=1)
    return error_n.groupby(
        [tried["source"], tried["changes"].map(lambda changes: dict(changes)[RATE])]
    ).mean()


def rate_table(tried: pd.DataFrame) -> ResultTable:
    """The errors by which each start's learning rate was chosen."""
    errors_n, rows = mean_by_rate(tried), []
    for start in tried["source"].unique():
        tested = ", ".join(f"{rate:g}: {error_n:.2f}" for rate, error_n in errors_n[start].items())
        rows.append([start, tested, f"{errors_n[start].idxmin():g}"])
    return ResultTable(
        f"Learning rates, chosen on {TUNED_ON}: MAE of Fz, N",
        ["start", "error at each rate", "chosen"],
        rows,
        f"Mean over {', '.join(tried['data'].unique())}, {tried['seed'].nunique()} draw(s) of each.",
    )


def factor_table(found: Mapping[Budget, Errors], starts: Sequence[str]) -> ResultTable:
    """Each start's errors, and by how much they differ from those with all factors drawn."""
    rows = [[start] for start in starts]
    for errors_n in found.values():
        for row, start in zip(rows, starts, strict=True):
            row.append(cell(float(mean_of(errors_n[start])), "{:.2f}"))
            if start == PRETRAINED:
                row += [None, None]
            else:
                percent, interval = relative_difference(errors_n[start], errors_n[PRETRAINED])
                row += [cell(percent, "{:+.0f} %"), cell(interval, "{:+.0f}")]
    columns = [text for budget in found for text in (budget.name, "difference", "95 % interval")]
    draws = next(iter(found.values()))[PRETRAINED].shape[1]
    return ResultTable(
        f"What is drawn for pretraining, {COMPARED_ON}: MAE of Fz on clips that were not seen, N",
        ["pretrained", *columns],
        rows,
        "Differences: error over that with all factors drawn, above 0 where the factor helps; intervals: bootstrap "
        f"over clips and draws, paired; {draws} draws. One pretraining each: what another seed of it would change is "
        "not in them.",
    )
