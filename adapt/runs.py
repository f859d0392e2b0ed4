"""Doing runs: one stage 1 on a source, then each method on each target; what is finished is not repeated."""

import json
import logging
import platform
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from gelgap.adapt.data import check_classes
from gelgap.adapt.evaluation import (
    Evaluation,
    as_judged_on_source,
    evaluate_baselines,
    evaluate_constant_mean,
    evaluate_frames,
    oracles_on,
)
from gelgap.adapt.methods import registry
from gelgap.adapt.methods.base import FeatureCollapse, TrainingDiverged
from gelgap.adapt.model import ForceModel
from gelgap.adapt.network import load_checkpoint
from gelgap.adapt.profile import Profile
from gelgap.adapt.run_record import RECORD, Run, load_run, write_run
from gelgap.adapt.selection import Candidate, LabelFree, alarm, scores
from gelgap.adapt.split import FRAMES_SHOWN, SplitFrames, size_notes, split_for_training
from gelgap.adapt.trainer import adapt, train_source, untrained
from gelgap.assets.checksums import file_sha256, sha256
from gelgap.assets.locks import sole_use
from gelgap.assets.progress import Progress, hidden_progress
from gelgap.data import LabelledFrames, open_domain
from gelgap.data.facts import unseen_differences
from gelgap.data.frames.dataset import labelled_frames
from gelgap.data.frames.folders import open_domains
from gelgap.data.frames.stored import GeneratedDomain
from gelgap.data.inspection import log_notes

LOG = logging.getLogger(__name__)
_RESUME = "resume.pt"
METHODS_VERSION = 4
"""Raised whenever the same method, profile and seed give another result than before."""
_STAGE_2_FIELDS = frozenset(
    name
    for name in Profile.model_fields
    if name.startswith(("adapt_", "transfer_", "classification_"))
    or name in ("batch_statistics", "regression_weight", "settings")
)


def adapt_folders(
    source: str | Path | Sequence[str | Path] | LabelledFrames,
    target: str | Path | LabelledFrames | Sequence[str | Path | LabelledFrames],
    methods: Iterable[str],
    profile: str | Profile | Sequence[str | Profile] = "smoke",
    seed: int = 0,
    *,
    labels: Sequence[str] | None = None,
    ranges: Mapping[str, tuple[float, float]] | None = None,
    classes_from_force: int | None = None,
    weights: str | Path | None = None,
    out_dir: str | Path | None = None,
    progress: Progress = hidden_progress,
) -> list[Run]:
    """Train stage 1 on a source, adapt to each target with each method, evaluate on the targets' test frames.

    A target without labels is adapted to as a whole; its runs have no errors but `label_free`. A method that fails (its
    features collapse, its losses are not finite) gives a run with a `problem`; the others go on.

    Parameters
    ----------
    source, target
        Domains that are open, or folders that `gelgap.data.open_domain` reads; several source folders are trained on
        together, several targets are adapted to one by one.
    methods
        Their names, or `FILE.py:CLASS` of your own.
    profile
        One or several, by name, file or as settings. The runs come by target, profile and method, in the given order.
    labels, ranges, classes_from_force
        What is predicted, in which ranges, and contact classes: as for `split_for_training`.
    weights
        A gelgap checkpoint, or a torchvision ResNet state dictionary, to start stage 1 from.
    out_dir
        Gets `stage1/` with the shared checkpoint and a folder per run; a run that is there already is not
        repeated, a run that was interrupted is resumed from its last epoch. None: nothing is written.

    Raises
    ------
    ValueError
        If a method, a label or a profile is unknown, pictures are smaller than training shows them, a method needs
        contact classes that the source has not or labels that the target has not, a label is outside its range, or two
        targets or two profiles have one name.
    RuntimeError
        If another process is writing one of these runs.
    """
    profiles = [Profile.named(name) for name in _listed(profile)]
    methods = _known_methods(methods, profiles)
    if weights is not None:
        load_checkpoint(Path(weights))  # refused before any picture is read
    source = source if isinstance(source, LabelledFrames) else open_domains(source)
    targets = [_opened(domain) for domain in _listed(target)]
    for names in ([domain.name for domain in targets], [chosen.name for chosen in profiles]):
        if len(set(names)) < len(names):
            raise ValueError(f"{', '.join(names)}: results are filed by name, two have the same; rename one")
    divide = partial(
        split_for_training,
        source,
        seed=seed,
        labels=labels,
        ranges=ranges,
        classes_from_force=classes_from_force,
    )
    out = None if out_dir is None else Path(out_dir)
    first_stage = partial(Stage1, seed=seed, weights=weights, out=out, progress=progress)
    groups = _groups(source, targets, profiles, divide, first_stage)
    for _, group in groups:
        for method in methods:
            group.check(method)
    runs: list[Run] = []
    for domain, group in groups:
        runs += _runs_of(group, source, domain, methods)
    return runs


def _groups(
    source: LabelledFrames,
    targets: Sequence[LabelledFrames],
    profiles: Sequence[Profile],
    divide: Callable[[LabelledFrames, Profile], SplitFrames],
    first_stage: "Callable[[LabelledFrames, Profile], Stage1]",
) -> "list[tuple[LabelledFrames, Group]]":
    """Return each target with its group of each profile; groups of the same source frames share a stage 1."""
    groups: list[tuple[LabelledFrames, Group]] = []
    stages: dict[tuple[str, str], Stage1] = {}
    notes: list[str] = []
    for target in targets:
        for profile in profiles:
            notes += size_notes(source, target, profile)
            frames = divide(target, profile)
            notes += frames.notes
            stage1 = first_stage(frames.source_train, profile)
            stage1 = stages.setdefault((profile.name, stage1.key), stage1)
            # The source's pictures are in memory once for all targets.
            groups.append((target, Group(replace(frames, source_train=stage1.source_train), stage1)))
    log_notes((source, *targets), notes)
    return groups


def _known_methods(names: Iterable[str], profiles: Sequence[Profile]) -> tuple[str, ...]:
    """Return the names of methods, those of one's own loaded; the profiles' settings of them are checked.

    Raises
    ------
    ValueError
        If none is named, one is unknown, or a profile has a wrong setting of it or of an unknown one.
    """
    methods = tuple(registry.use_method(name) for name in names)
    if not methods:
        raise ValueError(f"no method was named; known methods: {', '.join(registry.method_names())}")
    for profile in profiles:
        for method in (*methods, *(name for name in profile.settings if "." not in name)):
            registry.method_settings(method, profile)
    return methods


def _opened(domain: str | Path | LabelledFrames) -> LabelledFrames:
    return domain if isinstance(domain, LabelledFrames) else open_domain(domain)


def _listed(value: Any) -> list[Any]:
    """Return what was given alone or as a sequence as a list."""
    return [value] if isinstance(value, str | Path | LabelledFrames | Profile) else list(value)


def _runs_of(
    group: "Group", source: LabelledFrames, target: LabelledFrames, methods: Sequence[str]
) -> list[Run]:
    """Do what is missing and return the runs of all methods."""
    out = group.stage1.out
    if out is None:
        group = _with_oracles(group, source, target)
        return [group.run(method)[0] for method in methods]
    stem = f"{source.name}-{target.name}"
    seed = group.stage1.seed
    folders = {method: out / f"{stem}-{method}-{seed}-{group.key(method)[:8]}" for method in methods}
    missing = [method for method, folder in folders.items() if not (folder / RECORD).is_file()]
    done: dict[str, Run] = {}
    with ExitStack() as held:
        for method in missing:
            held.enter_context(sole_use(folders[method]))
        if missing:
            group = _with_oracles(group, source, target)
        for method in missing:
            done[method], _ = group.run(method, folders[method])
    return [done[method] if method in done else load_run(folders[method]) for method in methods]


def _with_oracles(group: "Group", source: LabelledFrames, target: LabelledFrames) -> "Group":
    """Return the group with what its generated domains tell: their oracles, and what no picture shows."""
    unseen: tuple[str, ...] = ()
    if isinstance(source, GeneratedDomain) and isinstance(target, GeneratedDomain):
        unseen = tuple(unseen_differences(source.name, source.facts, target.name, target.facts))
    return replace(group, oracles=oracles_on(source, target, group.frames.target_test), unseen=unseen)


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
    progress: Progress = hidden_progress

    @cached_property
    def key(self) -> str:
        """Hash of all that decides the result."""
        return stage1_key(self.source_train, self.profile, self.seed, self.weights)

    @cached_property
    def checkpoint(self) -> Path | None:
        """The file of the trained model."""
        if self.out is None:
            return None
        return self.out / "stage1" / f"{self.source_train.name}-{self.seed}-{self.key[:8]}.pt"

    def model(self) -> tuple[ForceModel, float]:
        """Return the model, and the processor time that training it took now, s (0 if it was trained before).

        Raises
        ------
        RuntimeError
            If another process is training it.
        """
        known = "_trained" in vars(self)
        model, core_s = self._trained
        return model, 0.0 if known else core_s

    @cached_property
    def _trained(self) -> tuple[ForceModel, float]:
        if self.checkpoint is not None and self.checkpoint.is_file():
            try:
                return ForceModel.load(self.checkpoint), 0.0
            except ValueError as error:
                LOG.warning("%s: stage 1 is trained again", error)
        if self.checkpoint is None:
            return self._train_now(None)
        folder = self.checkpoint.with_suffix("")
        with sole_use(folder):
            model, core_s = self._train_now(folder / _RESUME)
            model.save(self.checkpoint)
            (folder / _RESUME).unlink(missing_ok=True)
        return model, core_s

    def _train_now(self, resume_file: Path | None) -> tuple[ForceModel, float]:
        self.source_train.images(self.profile.image_size_px)  # read before the clock starts
        begun = time.process_time()
        model = train_source(
            self.source_train,
            self.profile,
            self.seed,
            weights=self.weights,
            resume_file=resume_file,
            progress=self.progress,
        )
        return model, time.process_time() - begun

    def adapt(self, target_train: LabelledFrames, method: str, resume_file: Path | None = None) -> "Adapted":
        """Train both stages of a method; that its features collapse or its losses are not finite is a result, too."""
        kind = registry.find_method(method)
        if kind.uses_target_labels:
            target_train = labelled_frames(target_train)
        if kind.needs_stage_1:
            start, stage1_s = self.model()
        else:
            start = untrained(self.source_train, self.profile, self.seed)
            stage1_s = 0.0
        for part in (self.source_train, target_train):
            part.images(self.profile.image_size_px)  # read before the clock starts
        begun = time.process_time()
        model = None
        problem = None
        try:
            model = adapt(
                start,
                self.source_train,
                target_train,
                method,
                self.profile,
                self.seed,
                resume_file=resume_file,
                progress=self.progress,
            )
        except (FeatureCollapse, TrainingDiverged) as error:
            problem = str(error)
        history = (model or start).history
        return Adapted(model, problem, history, {"stage1": stage1_s, "stage2": time.process_time() - begun})


class Adapted(NamedTuple):
    """What training gave: a model, or else the problem, the epochs, and the processor time of both stages, s."""

    model: ForceModel | None
    problem: str | None
    history: tuple[dict[str, Any], ...]
    core_s: dict[str, float]


@dataclass(frozen=True)
class Group:
    """Two domains under one profile, divided, and the stage 1 with which all methods begin.

    `oracles` and `unseen` are the fields of a run that do not depend on the method.
    """

    frames: SplitFrames
    stage1: Stage1
    oracles: Mapping[str, Evaluation] = field(default_factory=dict)
    unseen: tuple[str, ...] = ()

    def check(self, method: str) -> None:
        """Raise a ValueError unless both domains have what a method needs."""
        kind = registry.find_method(method)
        if kind.uses_classifier:
            check_classes(self.frames.source_train, method)
        if kind.uses_target_labels:
            labelled = labelled_frames(self.frames.target_train)
            if len(labelled) < 2:
                raise ValueError(
                    f"method {method} learns from labels of the target, and {len(labelled)} training frames of "
                    f"{self.frames.target_train.name} have them: leave it out, or label more"
                )
            labelled.check_labels()

    def key(self, method: str) -> str:
        """Return the key of a method's run."""
        return run_key(self.frames, method, self.stage1.profile, self.stage1.seed, self.stage1.weights)

    def run(self, method: str, folder: Path | None = None) -> tuple[Run, ForceModel | None]:
        """Adapt by one method, judge the result and, if there is a folder, write it there; no model if that failed."""
        frames = self.frames
        profile = self.stage1.profile
        begun = time.process_time()
        for name, part in frames.parts.items():
            if name != "target_validation":
                part.images(profile.image_size_px)
        load_s = time.process_time() - begun
        adapted = self.stage1.adapt(frames.target_train, method, folder and folder / _RESUME)
        begun = time.process_time()
        arrays = {} if adapted.model is None else _shown_to(adapted.model, frames)
        constant, errors = {}, {}
        for name, part in (("target", frames.target_test), ("source", frames.source_held_out)):
            if len(part):
                constant[name] = evaluate_constant_mean(frames.source_train, part)
                if arrays:
                    errors[name] = evaluate_frames(part, arrays[f"{name}_predicted_n"])
        unlabelled = arrays and not len(frames.target_test)
        run = Run(
            key=self.key(method),
            source=frames.source_train.name,
            target=frames.target_train.name,
            method=method,
            seed=self.stage1.seed,
            labels=frames.source_train.labels.names,
            profile=profile.model_dump(mode="json"),
            n_source=len(frames.source_train),
            n_target=len(frames.target_train),
            target_test=errors.get("target", constant.get("target")),
            target_constant_mean=constant.get("target"),
            source_held_out=errors.get("source"),
            source_constant_mean=constant.get("source"),
            baselines=evaluate_baselines(frames) if len(frames.target_test) else {},
            core_s={"load": load_s} | adapted.core_s | {"evaluate": time.process_time() - begun},
            skipped_steps=sum(epoch["skipped_steps"] for epoch in adapted.history),
            history=adapted.history,
            versions=versions(),
            problem=adapted.problem,
            oracles=dict(self.oracles),
            unseen=self.unseen,
            label_free=self._label_free(method, arrays) if unlabelled else None,
            folder=folder,
        )
        if folder is not None:
            write_run(run, folder, adapted.model, arrays)
            (folder / _RESUME).unlink(missing_ok=True)
        return run, adapted.model

    def _label_free(self, method: str, arrays: Mapping[str, np.ndarray]) -> LabelFree:
        candidate = Candidate.of(arrays)
        quantiles = np.quantile(arrays["target_predicted_n"], (0.05, 0.5, 0.95), axis=0).T.tolist()
        names = self.frames.source_train.labels.names
        return LabelFree(
            scores=scores(candidate),
            scores_before=self._scores_before if registry.find_method(method).needs_stage_1 else {},
            quantiles=dict(zip(names, map(tuple, quantiles), strict=True)),
            alarm=alarm(candidate),
        )

    @cached_property
    def _scores_before(self) -> dict[str, float]:
        """The selectors' scores of stage 1 on this target."""
        return scores(Candidate.of(_shown_to(self.stage1.model()[0], self.frames)))


def _shown_to(model: ForceModel, frames: SplitFrames) -> dict[str, np.ndarray]:
    """Return what `load_predictions` returns of a model."""
    arrays = {}
    for name, part in frames.shown.items():
        judge = model if name == "target" else as_judged_on_source(model, frames.source_train)
        arrays[f"{name}_predicted_n"] = judge.predict_frames(part)
        some = part.take(np.arange(len(part))[:FRAMES_SHOWN])
        arrays[f"{name}_features"] = judge.features(some)
        if part.is_labelled.all():
            arrays[f"{name}_true_n"] = part.label_values
    return arrays


def run_key(
    frames: SplitFrames, method: str, profile: Profile, seed: int, weights: str | Path | None = None
) -> str:
    """Return the key of a run: frames, method, hyperparameters, seed and starting weights.

    Settings of other methods do not change it, nor fields at their default: a profile may gain a field.
    """
    parts = (frames.source_train, frames.source_held_out, frames.target_train, frames.target_test)
    settings_used = profile.replace(
        settings={name: s for name, s in profile.settings.items() if name == method}
    )
    code = registry.method_code(method)
    return _key(parts, method if code is None else f"{method} {code}", settings_used, seed, weights)


def stage1_key(
    source_train: LabelledFrames, profile: Profile, seed: int, weights: str | Path | None = None
) -> str:
    """Return the key of a stage 1; runs that only differ in stage 2 share it."""
    return _key((source_train,), "stage1", stage1_profile(profile), seed, weights)


def stage1_profile(profile: Profile) -> Profile:
    """Return the profile with all that stage 1 does not depend on at its default."""
    return Profile(**profile.model_dump(exclude=set(_STAGE_2_FIELDS)))


def _key(
    parts: tuple[LabelledFrames, ...], method: str, profile: Profile, seed: int, weights: str | Path | None
) -> str:
    if weights is not None and not Path(weights).is_file():
        raise FileNotFoundError(f"weights file {weights} does not exist")
    content = {
        "frames": [[frames.name, frames.digest, len(frames)] for frames in parts],
        "method": method,
        "methods_version": METHODS_VERSION,
        "profile": profile.model_dump(mode="json", exclude={"name"}, exclude_defaults=True),
        "seed": seed,
        "weights": None if weights is None else file_sha256(Path(weights)),
    }
    return sha256(json.dumps(content, sort_keys=True).encode())


def versions() -> dict[str, str]:
    """Return the versions that a result depends on."""
    packages = {name: version(name) for name in ("gelgap", "torch", "numpy", "scikit-learn")}
    return {"python": platform.python_version()} | packages
