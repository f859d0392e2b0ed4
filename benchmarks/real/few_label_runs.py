"""One training on a few labels of a real session, from scratch or from a pretrained network: the job and its record."""

import math
import time
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from gelgap.benchmarks.adaptation.jobs import Bench, TrainingJob, configuration_hash
from gelgap.benchmarks.adaptation.work import versions_line
from gelgap.benchmarks.real.few_label_draws import Budget, few_labels
from gelgap.benchmarks.real.network_runs import FZ_RANGE_N, FoldRecord, clip_mae_n, frames_in_contact
from gelgap.benchmarks.real.sessions import session_named
from gelgap.benchmarks.real.starts import checkpoint_of

if TYPE_CHECKING:
    from gelgap.adapt import ForceModel, Profile
    from gelgap.domains import LabelledFrames

RUNS = "few-labels.jsonl"
STEPS, QUICK_STEPS = 200, 5
"""Of every training, whatever it starts from and however much is labelled."""
RATE = "adapt_learning_rate"
"""The field of the profile that holds the learning rate of either start."""
_METHOD = "no-transfer"


def few_label_jobs(
    session: str, budgets: Iterable[Budget], rates: Mapping[str, Sequence[float]], draws: Iterable[int]
) -> list[TrainingJob]:
    """Return the trainings of each start with each of its learning rates, one draw after the other."""
    # The sensor has no markers that training could hide.
    common = (("batch_statistics", "joint"), ("marker_hiding", 0.0))
    return [
        TrainingJob(
            start,
            session,
            _METHOD,
            draw,
            budget.name,
            (*common, (RATE, rate)),
        )
        for draw in draws
        for budget in budgets
        for start, own in rates.items()
        for rate in own
    ]


def train_on_few_labels(bench: Bench, job: TrainingJob) -> FoldRecord:
    """Train on what a draw labels, and return the errors on what it tests."""
    from gelgap.adapt import FeatureCollapse, TrainingDiverged

    session = session_named(bench.data, job.target)
    drawn = few_labels(session, Budget.of(job.data), job.seed)
    frames = frames_in_contact(bench.data / session.name, session)
    labelled, known, tested = (frames.take(rows) for rows in (drawn.labelled, drawn.known, drawn.tested))
    profile = profile_of(bench, job, len(labelled))
    checkpoint = checkpoint_of(bench, job.source)
    for part in (labelled, known, tested):
        part.images(profile.image_size_px)  # read before the clock starts
    start = time.perf_counter()
    try:
        if checkpoint is None:
            model = from_scratch(labelled, known, profile, job.seed)
        else:
            model = from_checkpoint(checkpoint, labelled, known, profile, job.seed)
        predicted, problem = model.predict(tested), None
    except (FeatureCollapse, TrainingDiverged) as trouble:
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
        stage1_s=0.0,
        stage2_s=round(time.perf_counter() - start, 2),
    )


def from_scratch(
    labelled: "LabelledFrames", known: "LabelledFrames", profile: "Profile", seed: int
) -> "ForceModel":
    """Train a new network; batches are normalised together with unlabelled pictures, in the end by all of these."""
    from gelgap.adapt import Stage1, adapt, with_statistics_of

    model = adapt(Stage1(labelled, profile, seed).untrained(), labelled, known, _METHOD, profile, seed)
    return with_statistics_of(model, known)


def from_checkpoint(
    checkpoint: Path, labelled: "LabelledFrames", known: "LabelledFrames", profile: "Profile", seed: int
) -> "ForceModel":
    """Fine-tune a network as `gelgap finetune` does: normalised by the unlabelled pictures, before and after."""
    from gelgap.adapt import ForceModel, fine_tune, with_statistics_of
    from gelgap.adapt.data import steps_per_epoch
    from gelgap.adapt.few_labels import of_common_labels
    from gelgap.domains import with_labels

    model = with_statistics_of(of_common_labels(ForceModel.load(checkpoint), known), known)
    few = with_labels(labelled, model.labels)
    steps = profile.adapt_epochs * steps_per_epoch(len(few), profile.batch_size)
    return fine_tune(model, few, steps=steps, learning_rate=profile.adapt_learning_rate, seed=seed)


def profile_of(bench: Bench, job: TrainingJob, labelled: int) -> "Profile":
    """Return a job's profile with as many epochs as make the steps of every training."""
    from gelgap.adapt.data import steps_per_epoch

    profile = job.profile(bench.profile)
    steps = QUICK_STEPS if bench.is_quick else STEPS
    return profile.replace(adapt_epochs=math.ceil(steps / steps_per_epoch(labelled, profile.batch_size)))


def few_label_configuration(bench: Bench, job: TrainingJob) -> str:
    """Return a hash of profile, range, steps, the session's forces, and of the network that a job starts from."""
    from gelgap.assets.checksums import file_sha256

    checkpoint = checkpoint_of(bench, job.source)
    return configuration_hash(
        job.profile(bench.profile),
        FZ_RANGE_N,
        STEPS,
        session_named(bench.data, job.target).key,
        None if checkpoint is None else file_sha256(checkpoint),
    )
