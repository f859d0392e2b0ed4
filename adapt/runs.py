"""Runs of several methods on two domains: one stage 1, then each method; what is finished is not repeated."""

import logging
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from gelgap.adapt.adaptation import adapt
from gelgap.adapt.checkpoint import load_checkpoint
from gelgap.adapt.evaluation import evaluate_constant_mean, evaluate_frames
from gelgap.adapt.methods.names import method_names
from gelgap.adapt.methods.registry import find_method, method_settings, use_method
from gelgap.adapt.model import ForceModel
from gelgap.adapt.normalisation import as_judged_on_source
from gelgap.adapt.profile import Profile
from gelgap.adapt.progress import Progress, silent
from gelgap.adapt.run_key import run_key, stage1_key
from gelgap.adapt.run_record import Run, is_finished, load_run, run_folder, versions, write_run
from gelgap.adapt.source_training import train_source, untrained
from gelgap.adapt.splits import SplitFrames, check_classes, size_notes, split_for_training
from gelgap.assets.locks import sole_use
from gelgap.assets.whole_file import set_aside
from gelgap.domains import LabelledFrames, label_notes, open_domain, open_domains

LOG = logging.getLogger(__name__)
FEATURES_KEPT = 400


def adapt_folders(
    source: str | Path | Sequence[str | Path],
    target: str | Path,
    methods: Iterable[str],
    profile: str | Profile = "smoke",
    seed: int = 0,
    *,
    labels: Sequence[str] | None = None,
    ranges: Mapping[str, tuple[float, float]] | None = None,
    classes_from_force: int | None = None,
    weights: str | Path | None = None,
    out_dir: str | Path | None = None,
    progress: Progress = silent,
) -> list[Run]:
    """Train stage 1 on one domain, adapt to the other with each method, evaluate on the target's test frames.

    Parameters
    ----------
    source, target
        Folders of domains that `gelgap.domains.open_domain` reads; several sources are trained on together.
    methods
        Their names, or `module:Class` or `file.py:Class` of your own; the runs come in this order.
    labels, ranges, classes_from_force
        What is predicted, in which ranges, and contact classes: as for `split_for_training`.
    weights
        A gelgap checkpoint, or a torchvision ResNet state dictionary, to start stage 1 from.
    out_dir
        Gets `stage1/` with the shared checkpoint and a folder per run; a run that is there already is not
        repeated, a run that was interrupted goes on from its last epoch. None: nothing is written.

    Raises
    ------
    ValueError
        If a method, a label or the profile is unknown, pictures are smaller than training shows them, a method needs
        contact classes that the source has not, or a label is absent or outside its range.
    RuntimeError
        If another process is writing one of these runs.
    """
    profile = profile if isinstance(profile, Profile) else Profile.preset(profile)
    methods = _known(methods, profile)
    return adapt_frames(
        open_domains(source),
        open_domain(target),
        methods,
        profile,
        seed,
        labels=labels,
        ranges=ranges,
        classes_from_force=classes_from_force,
        weights=weights,
        out_dir=out_dir,
        progress=progress,
    )


def adapt_frames(
    source: LabelledFrames,
    target: LabelledFrames,
    methods: Iterable[str],
    profile: Profile,
    seed: int = 0,
    *,
    labels: Sequence[str] | None = None,
    ranges: Mapping[str, tuple[float, float]] | None = None,
    classes_from_force: int | None = None,
    weights: str | Path | None = None,
    out_dir: str | Path | None = None,
    progress: Progress = silent,
) -> list[Run]:
    """As `adapt_folders`, for domains that are open."""
    methods = _known(methods, profile)
    if weights is not None:
        load_checkpoint(Path(weights))  # refused before any picture is read
    notes = size_notes(source, target, profile)
    frames = split_for_training(
        source,
        target,
        profile,
        seed,
        labels=labels,
        ranges=ranges,
        classes_from_force=classes_from_force,
    )
    for note in (
        *notes,
        *frames.notes,
        *(f"{d.name}: {n}" for d in (source, target) for n in label_notes(d)),
    ):
        LOG.warning("%s", note)
    for method in methods:
        check_classes(method, find_method(method), frames.source_train)
        if find_method(method).uses_target_labels:
            frames.target_train.check_labels()
    out = None if out_dir is None else Path(out_dir)
    stage1 = Stage1(frames.source_train, profile, seed, weights, out, progress)
    return _Experiment(frames, stage1).runs(methods)


def _known(methods: Iterable[str], profile: Profile) -> tuple[str, ...]:
    """Return the methods' names; raise ValueError if there is none, one is unknown, or has a wrong setting."""
    methods = tuple(use_method(method) for method in methods)
    if not methods:
        raise ValueError(f"no method was named; known methods: {', '.join(method_names())}")
    for method in methods:
        method_settings(method, profile)
    return methods


@dataclass(frozen=True)
class Stage1:
    """The stage 1 that all runs of the same training frames, profile, seed and starting weights share.

    Its checkpoint is kept below `out`; without `out` nothing is kept.
    """

    source_train: LabelledFrames
    profile: Profile
    seed: int = 0
    weights: str | Path | None = None
    out: Path | None = None
    progress: Progress = silent

    @cached_property
    def checkpoint(self) -> Path | None:
        """The file of the trained model."""
        if self.out is None:
            return None
        key = stage1_key(self.source_train, self.profile, self.seed, self.weights)
        return self.out / "stage1" / f"{self.source_train.name}-{self.seed}-{key[:8]}.pt"

    def model(self) -> tuple[ForceModel, float]:
        """Return the model, and the time that training it took now, s (0 if there was a checkpoint).

        Raises
        ------
        RuntimeError
            If another process is training it.
        """
        if self.checkpoint is None:
            return self._train(None)
        if self.checkpoint.is_file():
            try:
                return ForceModel.load(self.checkpoint), 0.0
            except ValueError as error:
                set_aside(self.checkpoint, f"cannot be used ({error})")
        folder = self.checkpoint.with_suffix("")
        with sole_use(folder):
            model, wall_s = self._train(folder / "resume.pt")
            model.save(self.checkpoint)
            (folder / "resume.pt").unlink(missing_ok=True)
        return model, wall_s

    def untrained(self) -> ForceModel:
        """Return the model with which stage 1 begins."""
        return untrained(self.source_train, self.profile, self.seed)

    def _train(self, resume_file: Path | None) -> tuple[ForceModel, float]:
        self.source_train.images(self.profile.image_size_px)
        start = time.perf_counter()
        model = train_source(
            self.source_train,
            self.profile,
            self.seed,
            weights=self.weights,
            resume_file=resume_file,
            progress=self.progress,
        )
        return model, time.perf_counter() - start


@dataclass(frozen=True)
class _PlannedRun:
    """A run of one method, and where it is kept (None: nowhere)."""

    method: str
    key: str
    folder: Path | None

    @property
    def is_finished(self) -> bool:
        return self.folder is not None and is_finished(self.folder)


@dataclass(frozen=True)
class _Experiment:
    """Two domains, divided, and the stage 1 from which every method starts."""

    frames: SplitFrames
    stage1: Stage1

    def runs(self, methods: Sequence[str]) -> list[Run]:
        """Return the methods' runs; those that are not finished are done now."""
        planned = {method: self._planned(method) for method in methods}
        with ExitStack() as held:
            for run in planned.values():
                if run.folder is not None and not run.is_finished:
                    held.enter_context(sole_use(run.folder))
            missing = [run for run in planned.values() if not run.is_finished]
            done = {run.method: run for run in self._do(missing)} if missing else {}
        return [done[m] if m in done else load_run(planned[m].folder) for m in methods]

    def _planned(self, method: str) -> _PlannedRun:
        stage1, frames = self.stage1, self.frames
        key = run_key(frames, method, stage1.profile, stage1.seed, stage1.weights)
        names = frames.source_train.name, frames.target_train.name
        folder = None if stage1.out is None else run_folder(stage1.out, *names, method, stage1.seed, key)
        return _PlannedRun(method, key, folder)

    def _do(self, planned: Sequence[_PlannedRun]) -> Iterator[Run]:
        frames, start = self.frames, time.perf_counter()
        # Methods that need no trained network do not wait for one.
        needing = {run.method for run in planned if find_method(run.method).needs_stage_1}
        trained, stage1_s = self.stage1.model() if needing else (None, 0.0)
        plain = None if needing == {run.method for run in planned} else self.stage1.untrained()
        for part in (frames.source_train, frames.source_held_out, frames.target_train, frames.target_test):
            part.images(self.stage1.profile.image_size_px)
        load_s = time.perf_counter() - start - stage1_s
        for run in planned:
            needs = run.method in needing
            yield self._run(
                run, trained if needs else plain, {"load": load_s, "stage1": stage1_s if needs else 0.0}
            )
            stage1_s = 0.0 if needs else stage1_s

    def _run(self, planned: _PlannedRun, model: ForceModel, wall_s: dict[str, float]) -> Run:
        """Adapt, evaluate and, if it has a folder, write one run."""
        frames, stage1, start = self.frames, self.stage1, time.perf_counter()
        resume_file = None if planned.folder is None else planned.folder / "resume.pt"
        adapted = adapt(
            model,
            frames.source_train,
            frames.target_train,
            planned.method,
            stage1.profile,
            stage1.seed,
            resume_file=resume_file,
            progress=stage1.progress,
        )
        wall_s = wall_s | {"stage2": time.perf_counter() - start}
        on_source = as_judged_on_source(adapted, frames.source_train)
        run, arrays = self._evaluated(planned, adapted, on_source, wall_s)
        if planned.folder is not None:
            kept = frames.source_held_out if len(frames.source_held_out) else frames.source_train
            arrays |= _features("source", on_source, kept) | _features("target", adapted, frames.target_test)
            write_run(run, adapted, arrays)
            resume_file.unlink(missing_ok=True)
        return run

    def _evaluated(
        self, planned: _PlannedRun, adapted: ForceModel, on_source: ForceModel, wall_s: dict[str, float]
    ) -> tuple[Run, dict[str, np.ndarray]]:
        """Return the record of a run, and its predictions."""
        frames, start = self.frames, time.perf_counter()
        held_out, test = frames.source_held_out, frames.target_test
        predicted = adapted.predict(test)
        run = Run(
            key=planned.key,
            source=held_out.name,
            target=test.name,
            method=planned.method,
            seed=adapted.seed,
            profile=adapted.profile.model_dump(mode="json"),
            n_source=len(frames.source_train),
            n_target=len(frames.target_train),
            target_test=evaluate_frames(test, predicted),
            target_constant_mean=evaluate_constant_mean(frames.source_train, test),
            source_held_out=None,
            source_constant_mean=None,
            wall_s=wall_s,
            skipped_steps=sum(record["skipped_steps"] for record in adapted.history),
            history=adapted.history,
            versions=versions(),
            folder=planned.folder,
        )
        arrays = _predictions("target", test, predicted)
        if len(held_out):
            of_source = on_source.predict(held_out)
            arrays |= _predictions("source", held_out, of_source)
            run = replace(
                run,
                source_held_out=evaluate_frames(held_out, of_source),
                source_constant_mean=evaluate_constant_mean(frames.source_train, held_out),
            )
        return replace(run, wall_s=wall_s | {"evaluate": time.perf_counter() - start}), arrays


def _predictions(domain: str, frames: LabelledFrames, predicted: np.ndarray) -> dict[str, np.ndarray]:
    return {
        f"{domain}_true_n": frames.label_values.astype(np.float32),
        f"{domain}_predicted_n": predicted.astype(np.float32),
    }


def _features(domain: str, model: ForceModel, frames: LabelledFrames) -> dict[str, np.ndarray]:
    """Return the features of the first frames, and their labels."""
    some = frames.take(np.arange(min(len(frames), FEATURES_KEPT)))
    return {
        f"{domain}_features": model.features(some).astype(np.float16),
        f"{domain}_features_force_n": some.label_values.astype(np.float32),
    }
