"""Few labels of a real session, from scratch and from what `gelgap pretrain` makes: does synthetic data pay?

`randomisation` asks what matters in it: pretrained with one factor at a time undrawn. Whole clips are tested, and no
picture of theirs is seen before.
"""

import math
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd

from gelgap.adapt import (
    FeatureCollapse,
    ForceModel,
    Profile,
    Stage1,
    TrainingDiverged,
    adapt,
    console_progress,
    fine_tune,
    pretrain,
    pretrain_on_stream,
    with_statistics_of,
)
from gelgap.adapt.data import steps_per_epoch
from gelgap.adapt.few_labels import of_common_labels
from gelgap.assets.checksums import file_sha256
from gelgap.benchmarks.adaptation.study import grid, versions_line
from gelgap.benchmarks.common import Results, Setting, result_table, write_json
from gelgap.benchmarks.real.sessions import (
    CONSTANT,
    FOLDS,
    FORMATS,
    FZ_RANGE_N,
    NOTE,
    QUADRATIC,
    SESSIONS,
    Fold,
    Session,
    SessionStudy,
    clip_folds,
    error_rows,
    errors_by_clip,
    frames_of_session,
    key_of_session,
    read_sessions,
    rule_records,
)
from gelgap.domains import (
    RANDOM_FACTORS,
    LabelledFrames,
    PressStream,
    PretrainingRanges,
    pretraining_recipes,
    with_labels,
)

RUNS = "few-labels.jsonl"
SESSION = SESSIONS[1]
SCRATCH, PRETRAINED, STREAMED, WITHOUT = "scratch", "pretrained", "streamed", "without-"
"""What training starts from: nothing, a checkpoint of `gelgap pretrain`, one of `--stream`, which takes as many steps,
or one for which a factor was not drawn.
"""
SCRATCH_RATE, PRETRAINED_RATE = 0.06, 0.004
"""Learning rates, the best of four each on the other session, whose clips are in no table (commit 3683a5b)."""
STEPS, QUICK_STEPS = 200, 5
"""Of every training, whatever it starts from and however much is labelled."""
DRAWS = range(12)
FACTOR_DRAWS = range(6)
_METHOD = "no-transfer"
_DOMAINS, _FRAMES, _SIZE_PX = 60, 60, (160, 120)
_QUICK_DOMAINS, _QUICK_FRAMES, _QUICK_EPOCHS = 2, 12, 1


@dataclass(frozen=True)
class Budget:
    """How much is labelled: whole clips, or single frames of any clips; with `other_objects` none of the tested one."""

    clips: int = 0
    frames: int = 0
    other_objects: bool = False


ONE_CLIP, SOME_FRAMES, OTHER_OBJECTS = "1 clip", "16 frames", "4 clips of other objects"
BUDGETS = {
    ONE_CLIP: Budget(clips=1),
    **{f"{clips} clips": Budget(clips=clips) for clips in (2, 4, 8)},
    **{f"{frames} frames": Budget(frames=frames) for frames in (4, 8, 16, 64)},
    OTHER_OBJECTS: Budget(clips=4, other_objects=True),
}


def few_labels(session: Session, budget: Budget, draw: int) -> Fold:
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
    return Fold(labelled, known, session[is_tested])


class FewLabelStudy(SessionStudy):
    """Trainings on a few labels of a session, from a start: the source of a run; its data are a budget."""

    def fold_of(self, run: Setting) -> Fold:
        """Return what a run's draw labels, knows and tests; see `few_labels`."""
        return few_labels(read_sessions(self.data)[run["target"]], BUDGETS[run["data"]], run["seed"])

    def checkpoint_of(self, start: str) -> Path | None:
        """Return the checkpoint of a start, None for the one from scratch."""
        return None if start == SCRATCH else self.out / start / "pretrained.pt"

    def stated_of(self, run: Setting) -> Results:
        """Return what a record states of profile, range, steps, the session's forces, and of what a run starts from."""
        session, checkpoint = read_sessions(self.data)[run["target"]], self.checkpoint_of(run["source"])
        start = None if checkpoint is None else file_sha256(checkpoint)
        data = FZ_RANGE_N, STEPS, key_of_session(session), start
        return self.stated(self.profile_of(run), run["method"], *data)


def few_label_runs(budgets: Iterable[str], starts: Iterable[str], draws: Iterable[int]) -> list[Setting]:
    """Return the trainings from each start, one draw after the other."""
    return [
        run
        for draw in draws
        for budget in budgets
        for start in starts
        for run in grid([(budget, (start, SESSION))], [_METHOD], [draw], _changes(start))
    ]


def _changes(start: str) -> tuple[tuple[str, str | float], ...]:
    rate = SCRATCH_RATE if start == SCRATCH else PRETRAINED_RATE
    # The sensor has no markers that training could hide.
    return ("batch_statistics", "joint"), ("marker_hiding", 0.0), ("adapt_learning_rate", rate)


def train_on_few_labels(study: FewLabelStudy, run: Setting) -> Results:
    """Train on what a draw labels, and return the errors on what it tests; one that stops predicts the labels' mean."""
    labelled, known, tested = (frames_of_session(study.data, part) for part in study.fold_of(run))
    profile, checkpoint = profile_of(study, run, len(labelled)), study.checkpoint_of(run["source"])
    for part in (labelled, known, tested):
        part.images(profile.image_size_px)  # read before the clock starts
    start, problem = time.perf_counter(), None
    try:
        predicted = trained(checkpoint, labelled, known, profile, run["seed"]).predict_frames(tested)
    except (FeatureCollapse, TrainingDiverged) as trouble:
        predicted, problem = labelled.label_values.mean(axis=0), str(trouble)
    return {
        "versions": versions_line(),
        "problem": problem,
        "clip_mae_n": errors_by_clip(predicted, tested),
        "stage2_s": round(time.perf_counter() - start, 2),
    }


def trained(
    checkpoint: Path | None,
    labelled: LabelledFrames,
    known: LabelledFrames,
    profile: Profile,
    seed: int,
) -> ForceModel:
    """Train a new network, or fine-tune that of a checkpoint as `gelgap finetune` does.

    A new one's batches are normalised together with unlabelled pictures, in the end by all of these; a pretrained one
    is normalised by the unlabelled pictures, before and after.
    """
    if checkpoint is None:
        untrained = Stage1(labelled, profile, seed).untrained()
        return with_statistics_of(adapt(untrained, labelled, known, _METHOD, profile, seed), known)
    model = with_statistics_of(of_common_labels(ForceModel.load(checkpoint), known), known)
    few = with_labels(labelled, model.labels)
    steps = profile.adapt_epochs * steps_per_epoch(len(few), profile.batch_size)
    return fine_tune(model, few, steps=steps, learning_rate=profile.adapt_learning_rate, seed=seed)


def profile_of(study: FewLabelStudy, run: Setting, labelled: int) -> Profile:
    """Return a run's profile with as many epochs as make the steps of every training."""
    profile = study.profile_of(run)
    steps = QUICK_STEPS if study.is_quick else STEPS
    return profile.replace(adapt_epochs=math.ceil(steps / steps_per_epoch(labelled, profile.batch_size)))


def pretrain_once(study: FewLabelStudy, start: str) -> None:
    """Generate the domains of a start and pretrain, unless it needs no checkpoint or that is there."""
    checkpoint = study.checkpoint_of(start)
    if checkpoint is None or checkpoint.is_file():
        return
    ranges, profile = PretrainingRanges.default(), Profile.preset(study.profile)
    domains, frames = _DOMAINS, _FRAMES
    if study.is_quick:
        ranges, profile = ranges.in_quick_form(), profile.replace(source_epochs=_QUICK_EPOCHS)
        domains, frames = _QUICK_DOMAINS, _QUICK_FRAMES
    if start == STREAMED:
        stream = PressStream(ranges, size_px=_SIZE_PX)
        with console_progress() as progress:
            every = {"frames_per_epoch": domains * frames, "progress": progress}
            print(pretrain_on_stream(stream, checkpoint.parent, profile, **every), flush=True)
        return
    undrawn = [start.removeprefix(WITHOUT)] if start.startswith(WITHOUT) else []
    recipes = pretraining_recipes(domains, frames, ranges, without=undrawn, size_px=_SIZE_PX)
    replace(study, data=checkpoint.parent).generate(recipes, "domains")
    with console_progress() as progress:
        folders = [checkpoint.parent / "domains" / recipe.name for recipe in recipes]
        print(pretrain(folders, checkpoint.parent, profile, progress=progress), flush=True)


def pretraining(quick: bool, out_dir: Path, data: Path) -> None:
    """Pretrain, do the runs that have no record yet, print the table, and write `real-pretraining.json`."""
    budgets, draws = ((ONE_CLIP, OTHER_OBJECTS), DRAWS[:2]) if quick else (BUDGETS, DRAWS)
    study = FewLabelStudy.of(quick, out_dir, data, "pretraining-")
    compare_starts(study, [SCRATCH, PRETRAINED, STREAMED], budgets, draws, out_dir / "real-pretraining.json")


def randomisation(quick: bool, out_dir: Path, data: Path) -> None:
    """Pretrain once for each factor, do the runs that have no record yet, print the table, and write it as JSON."""
    factors, budgets, draws = RANDOM_FACTORS, (SOME_FRAMES, OTHER_OBJECTS), FACTOR_DRAWS
    if quick:
        factors, budgets, draws = factors[:1], budgets[:1], draws[:1]
    starts = [PRETRAINED, *(f"{WITHOUT}{factor}" for factor in factors)]
    study = FewLabelStudy.of(quick, out_dir, data, "pretraining-")
    compare_starts(study, starts, budgets, draws, out_dir / "real-randomisation.json")


def compare_starts(
    study: FewLabelStudy, starts: Sequence[str], budgets: Iterable[str], draws: Sequence[int], path: Path
) -> None:
    """Train from each start with each budget, print errors beside those from the first start, and write the table."""
    for start in starts:
        pretrain_once(study, start)
    records = study.run(train_on_few_labels, few_label_runs(budgets, starts, draws), RUNS)
    runs = few_label_runs(budgets, (CONSTANT, QUADRATIC), draws)
    rules = rule_records(({**run, "method": run["source"]} for run in runs), study.fold_of)
    rows = []
    for budget, own in pd.concat([rules, records]).groupby("data", sort=False):
        found = error_rows(own, "source", dict.fromkeys(starts, starts[0]))
        rows += [{"labelled": budget, **row} for row in found]
    table = result_table(
        f"Few labels on real grasps, {SESSION}: MAE of Fz on clips that were not seen",
        pd.DataFrame(rows).rename(columns={"source": "start"}),
        f"{len(draws)} draw(s): {FOLDS} test each clip once, or one tests all clips of an object. Networks take "
        f"{STEPS} steps, and see the pictures of all clips but the tested ones without labels, to normalise by: from "
        "scratch in every batch, pretrained before the first one. Intervals: bootstrap over clips and draws; each "
        f"start is one pretraining, and what another seed of it would change is not in them. {NOTE} "
        f"{records['problem'].notna().sum()} of {len(records)} stopped and count with the constant's error.",
        FORMATS,
    )
    table.show()
    write_json(path, table)
