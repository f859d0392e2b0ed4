"""One run of a network on a fold of the real sessions: the job, its frames, and the record of its errors by clip."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gelgap.benchmarks.adaptation.jobs import Bench, Changes, TrainingJob, configuration_hash
from gelgap.benchmarks.adaptation.work import control_of, train_stages, versions_line
from gelgap.benchmarks.real.clip_folds import ClipFold, clip_folds
from gelgap.benchmarks.real.sessions import Session, session_named
from gelgap.domains.formats.convert import CONTACT_N

if TYPE_CHECKING:
    from gelgap.domains import LabelledFrames

RUNS = "runs.jsonl"
FZ_RANGE_N = (-30.0, 0.0)
"""By which both sessions' forces are normalised; stated beforehand, so that no label of the target moves it."""
CLASSES = 12
"""Contact classes of equal size by Fz, for methods that need them."""
_FOLD = "fold-"


@dataclass(frozen=True)
class FoldRecord:
    """One finished run: the MAE of Fz on each of the target's test clips, N.

    A run that stopped with `problem` counts with the errors of the source's mean force. `configuration` is a hash of
    profile and sessions, `control` the method that it must beat; `stage1_s` is 0 where another run had trained the
    checkpoint.
    """

    job: TrainingJob
    profile: str
    configuration: str
    versions: str
    settings: dict[str, Any]
    control: str | None
    problem: str | None
    clip_mae_n: dict[str, float]
    stage1_s: float
    stage2_s: float

    @property
    def mean_mae_n(self) -> float:
        """Mean over the clips, N."""
        return float(np.mean(list(self.clip_mae_n.values())))


@dataclass(frozen=True)
class FoldFrames:
    """The pictures in contact of a fold; the target's training labels are for the ceiling alone."""

    source_train: "LabelledFrames"
    target_train: "LabelledFrames"
    target_test: "LabelledFrames"


def fold_jobs(
    directions: Sequence[tuple[str, str]],
    methods: Sequence[str],
    seeds: Sequence[int],
    folds: Sequence[int],
    changes: Changes = (),
) -> list[TrainingJob]:
    """Return the runs of every fold with every seed, one seed after the other; a fold is the data of its runs."""
    return [
        TrainingJob(source, target, method, seed, f"{_FOLD}{fold}", changes)
        for seed in seeds
        for source, target in directions
        for fold in folds
        for method in methods
    ]


def fold_of(bench: Bench, job: TrainingJob) -> ClipFold:
    """Return which clips a job trains on and is tested on."""
    source, target = _sessions(bench, job)
    number = int(job.data.removeprefix(_FOLD))
    return next(fold for fold in clip_folds(source, target, job.seed) if fold.number == number)


def frames_of(bench: Bench, job: TrainingJob) -> FoldFrames:
    """Return the frames of a job, with Fz as their only label, and contact classes of the source's."""
    from gelgap.domains import force_classes

    fold = fold_of(bench, job)
    source, target = (bench.data / name for name in job.group)
    return FoldFrames(
        force_classes(frames_in_contact(source, fold.source), CLASSES),
        frames_in_contact(target, fold.target),
        frames_in_contact(target, fold.test),
    )


def frames_in_contact(folder: Path, session: Session) -> "LabelledFrames":
    """Return a session's pictures of some clips, in the order that `session` has them, with Fz as their only label."""
    frames = _in_contact(folder)
    return frames.take(np.flatnonzero(np.isin(frames.columns["clip"].astype(str), np.unique(session.clip))))


def adapt_fold(bench: Bench, job: TrainingJob) -> FoldRecord:
    """Do one run and return its record."""
    frames = frames_of(bench, job)
    model, problem, stage1_s, stage2_s = train_stages(bench, job, frames.source_train, frames.target_train)
    test = frames.target_test
    constant = frames.source_train.label_values.mean(axis=0)
    return FoldRecord(
        job=job,
        profile=bench.profile,
        configuration=fold_configuration(bench, job),
        versions=versions_line(),
        settings=job.method_settings(bench.profile),
        control=control_of(job.method),
        problem=problem,
        clip_mae_n=clip_mae_n(constant if model is None else model.predict(test), test),
        stage1_s=round(stage1_s, 2),
        stage2_s=round(stage2_s, 2),
    )


def clip_mae_n(predicted: np.ndarray, tested: "LabelledFrames") -> dict[str, float]:
    """Return the MAE on each clip, N, of predictions (n, 1) of Fz, or of one for all."""
    error_n, clips = np.abs(predicted - tested.label_values)[:, 0], tested.columns["clip"]
    return {str(clip): round(float(error_n[clips == clip].mean()), 5) for clip in dict.fromkeys(clips)}


def errors_by_clip(records: Sequence[FoldRecord], clips: Sequence[str], seeds: Sequence[int]) -> np.ndarray:
    """Return the MAE of Fz (clips, seeds) that records of one method have, N; NaN where there is none."""
    found = np.full((len(clips), len(seeds)), np.nan)
    for record in records:
        for clip, error_n in record.clip_mae_n.items():
            found[clips.index(clip), seeds.index(record.job.seed)] = error_n
    return found


def fold_configuration(bench: Bench, job: TrainingJob) -> str:
    """Return a hash of all that the methods have in common: profile, range, classes, and both sessions' forces."""
    forces = [session.key for session in _sessions(bench, job)]
    return configuration_hash(job.profile(bench.profile), FZ_RANGE_N, CLASSES, forces)


def _sessions(bench: Bench, job: TrainingJob) -> Iterator[Session]:
    return (session_named(bench.data, name) for name in job.group)


@cache
def _in_contact(folder: Path) -> "LabelledFrames":
    from gelgap.domains import Labels, open_domain, with_labels

    frames = open_domain(folder)
    pressed = frames.take(np.flatnonzero(-frames.columns["fz_n"] > CONTACT_N))
    return with_labels(pressed, Labels.of({"fz_n": FZ_RANGE_N}))
