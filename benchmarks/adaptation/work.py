"""Doing one run of the benchmark: train, judge on the target's test frames, and score for the selectors."""

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from gelgap.benchmarks.adaptation.board import SOURCE_FREE
from gelgap.benchmarks.adaptation.jobs import Axes, Bench, RunRecord, TrainingJob, configuration_of, open_pair

if TYPE_CHECKING:
    from gelgap.adapt import Candidate, ForceModel, SplitFrames
    from gelgap.domains import LabelledFrames

_CONTROLS = {"adabn": "source-only", "no-transfer": "adabn", "classifier-only": "no-transfer"}


@dataclass(frozen=True)
class TrainedJob:
    """A job's frames and model (none where training stopped with a problem), and the stages' times, s."""

    frames: "SplitFrames"
    model: "ForceModel | None"
    problem: str | None
    stage1_s: float
    stage2_s: float


def train_job(bench: Bench, job: TrainingJob) -> TrainedJob:
    """Split a job's domains and train both stages."""
    from gelgap.adapt import split_for_training

    frames = split_for_training(*open_pair(bench, job), job.profile(bench.profile), job.seed)
    return TrainedJob(frames, *train_stages(bench, job, frames.source_train, frames.target_train))


def train_stages(
    bench: Bench, job: TrainingJob, source: "LabelledFrames", target: "LabelledFrames"
) -> "tuple[ForceModel | None, str | None, float, float]":
    """Train both stages of a job on given frames; return the model, or else the problem, and the stages' times, s.

    A collapse, or a loss that is not finite, is a result, not a failure.
    """
    from gelgap.adapt import FeatureCollapse, Stage1, TrainingDiverged, adapt, find_method

    profile = job.profile(bench.profile)
    shared = Stage1(source, profile, job.seed, out=bench.out)
    trained, stage1_s = shared.model() if find_method(job.method).needs_stage_1 else (shared.untrained(), 0.0)
    for part in (source, target):
        part.images(profile.image_size_px)  # read before the clock starts
    start = time.perf_counter()
    try:
        model, problem = adapt(trained, source, target, job.method, profile, job.seed), None
    except (FeatureCollapse, TrainingDiverged) as trouble:
        model, problem = None, str(trouble)
    return model, problem, stage1_s, time.perf_counter() - start


def adapt_job(bench: Bench, job: TrainingJob) -> RunRecord:
    """Do one run and return its record."""
    return _record(bench, job, train_job(bench, job))


def scored_job(bench: Bench, job: TrainingJob) -> RunRecord:
    """Do one run and return its record with the selectors' scores; selectors see no target label."""
    from gelgap.adapt.selection import alarm, scores

    trained = train_job(bench, job)
    record = _record(bench, job, trained)
    if trained.model is None:
        return record
    candidate = candidate_of(trained.model, trained.frames)
    return replace(record, scores=_rounded(scores(candidate)), alarm=alarm(candidate))


def candidate_of(model: "ForceModel", frames: "SplitFrames") -> "Candidate":
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


def control_of(method: str) -> str | None:
    """Return the method that a method must beat for its loss to be of use; None for source-only and the ceiling.

    Class-aware methods are compared with the classifier without a loss, source-free ones with AdaBN, others with stage
    2 without a loss.
    """
    from gelgap.adapt import find_method

    found = find_method(method)
    if method in _CONTROLS:
        return _CONTROLS[method]
    if method in SOURCE_FREE:
        return "adabn"
    if not found.uses_target or found.uses_target_labels:
        return None
    return "classifier-only" if found.uses_classifier else "no-transfer"


def versions_line() -> str:
    """Return the versions that a record names."""
    from gelgap.adapt.runs import versions

    used = versions()
    return f"gelgap {used['gelgap']}, torch {used['torch']}"


def _record(bench: Bench, job: TrainingJob, trained: TrainedJob) -> RunRecord:
    from gelgap.adapt import as_judged_on_source, evaluate, evaluate_constant_mean

    frames, model = trained.frames, trained.model
    constant = evaluate_constant_mean(frames.source_train, frames.target_test)
    on_target = constant if model is None else evaluate(model, frames.target_test)
    on_source = None
    if model is not None:
        on_source = evaluate(as_judged_on_source(model, frames.source_train), frames.source_held_out)
    last = model.history[-1] if model is not None and model.history else {}
    return RunRecord(
        job=job,
        profile=bench.profile,
        configuration=configuration_of(bench, job),
        versions=versions_line(),
        settings=job.method_settings(bench.profile),
        control=control_of(job.method),
        problem=trained.problem,
        mae_n=_axes(on_target.mae_n),
        r2=_axes(on_target.r2),
        constant_mean_n=_axes(constant.mae_n),
        source_held_out_r2=None if on_source is None else _axes(on_source.r2),
        stage1_s=round(trained.stage1_s, 2),
        stage2_s=round(trained.stage2_s, 2),
        skipped_steps=sum(epoch["skipped_steps"] for epoch in model.history) if model is not None else 0,
        diagnostics=_rounded(last.get("diagnostics", {})),
    )


def _axes(values: Sequence[float]) -> Axes:
    x, y, z = (_short(value) for value in values)
    return x, y, z


def _rounded(values: Mapping[str, float]) -> dict[str, float]:
    return {name: _short(value) for name, value in values.items()}


def _short(value: float) -> float:
    """Round to five digits, so that records stay small."""
    return float(f"{value:.5g}") if math.isfinite(value) else value
