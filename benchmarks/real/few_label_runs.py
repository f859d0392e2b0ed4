"""One training on a few labels of a real session, from scratch or from a pretrained network: the job and its record."""

import math
import time
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING

from gelgap.benchmarks.adaptation.jobs import Bench, TrainingJob, configuration_hash
from gelgap.benchmarks.adaptation.work import versions_line
from gelgap.benchmarks.real.few_label_draws import Budget, few_labels
from gelgap.benchmarks.real.network_runs import FZ_RANGE_N, FoldRecord, clip_mae_n, frames_in_contact
from gelgap.benchmarks.real.sessions import Session, read_sessions
from gelgap.benchmarks.real.starts import checkpoint_of

if TYPE_CHECKING:
    from gelgap.adapt import Profile

RUNS = "few-labels.jsonl"
STEPS, QUICK_STEPS = 200, 5
"""Of every training, whatever it starts from and however much is labelled."""
_METHOD = "source-only"


def few_label_jobs(
    session: str, budgets: Iterable[Budget], rates: Mapping[str, Sequence[float]], draws: Iterable[int]
) -> list[TrainingJob]:
    """Return the trainings of each start with each of its learning rates, one draw after the other."""
    # The sensor has no markers that training could hide.
    return [
        TrainingJob(
            start,
            session,
            _METHOD,
            draw,
            budget.name,
            (("marker_hiding", 0.0), ("source_learning_rate", rate)),
        )
        for draw in draws
        for budget in budgets
        for start, own in rates.items()
        for rate in own
    ]


def train_on_few_labels(bench: Bench, job: TrainingJob) -> FoldRecord:
    """Train on what a draw labels, normalise by all pictures that it knows, and return the errors on what it tests."""
    from gelgap.adapt import TrainingDiverged, train_source, with_statistics_of

    session = session_of(bench, job)
    drawn = few_labels(session, Budget.of(job.data), job.seed)
    frames = frames_in_contact(bench.data / session.name, session)
    labelled, tested = frames.take(drawn.labelled), frames.take(drawn.tested)
    profile = profile_of(bench, job, len(labelled))
    for part in (labelled, tested):
        part.images(profile.image_size_px)  # read before the clock starts
    start = time.perf_counter()
    try:
        model = train_source(labelled, profile, job.seed, weights=checkpoint_of(bench, job.source))
        predicted = with_statistics_of(model, frames.take(drawn.known)).predict(tested)
        problem = None
    except TrainingDiverged as trouble:
        predicted, problem = labelled.label_values.mean(axis=0), str(trouble)
    return FoldRecord(
        job=job,
        profile=bench.profile,
        configuration=few_label_configuration(bench, job),
        versions=versions_line(),
        settings={},
        control=None,
        problem=problem,
        clip_mae_n=clip_mae_n(predicted, tested),
        stage1_s=round(time.perf_counter() - start, 2),
        stage2_s=0.0,
    )


def profile_of(bench: Bench, job: TrainingJob, labelled: int) -> "Profile":
    """Return a job's profile with as many epochs as make the steps of every training."""
    from gelgap.adapt.batches import steps_per_epoch

    profile = job.profile(bench.profile)
    steps = QUICK_STEPS if bench.is_quick else STEPS
    return profile.replace(source_epochs=math.ceil(steps / steps_per_epoch(labelled, profile.batch_size)))


def session_of(bench: Bench, job: TrainingJob) -> Session:
    """Return the session that a job labels a part of."""
    return next(session for session in read_sessions(bench.data) if session.name == job.target)


def few_label_configuration(bench: Bench, job: TrainingJob) -> str:
    """Return a hash of profile, range, steps, the session's forces, and of the network that a job starts from."""
    from gelgap.assets.checksums import file_sha256

    session, checkpoint = session_of(bench, job), checkpoint_of(bench, job.source)
    return configuration_hash(
        job.profile(bench.profile),
        FZ_RANGE_N,
        STEPS,
        [session.name, session.clip.tolist(), session.fz_n.tolist()],
        None if checkpoint is None else file_sha256(checkpoint),
    )
