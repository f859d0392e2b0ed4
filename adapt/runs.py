"""Runs of several methods on two domains: one stage 1, then each method; what is finished is not repeated.

A finished run is a folder with run.json, predictions.npz and model.pt. Its name ends with the hash of all that decides
the result.
"""

import hashlib
import json
import platform
import time
from collections.abc import Iterable, Mapping, Sequence
from contextlib import ExitStack, nullcontext
from dataclasses import dataclass, field, replace
from functools import cached_property
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
from pydantic import Field, TypeAdapter, ValidationError

from gelgap.adapt.data import FRAMES_SHOWN, SplitFrames, size_notes, split_for_training
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
from gelgap.adapt.selection import Candidate, LabelFree, alarm, scores
from gelgap.adapt.trainer import adapt, train_source, untrained
from gelgap.assets.array_file import read_arrays
from gelgap.assets.checksums import checksum_problem, file_sha256, read_json, write_checksums
from gelgap.assets.locks import sole_use
from gelgap.assets.names import is_plain_name
from gelgap.assets.progress import Progress, silent
from gelgap.assets.settings import one_sentence
from gelgap.assets.whole_file import warn, whole_file, write_whole
from gelgap.domains import GeneratedDomain, LabelledFrames, open_domain
from gelgap.domains.frames.dataset import labelled_frames
from gelgap.domains.frames.folders import open_domains
from gelgap.domains.inspection import log_notes
from gelgap.domains.sweep import unseen_differences

_RECORD, _PREDICTIONS, _MODEL, _RESUME = "run.json", "predictions.npz", "model.pt", "resume.pt"
_ARRAYS = ("target_predicted_n", "target_features", "source_true_n", "source_predicted_n", "source_features")
_METHODS_VERSION = 3
"""Raised whenever the same method, profile and seed give another result than before."""
_STAGE_2_FIELDS = frozenset(
    name
    for name in Profile.model_fields
    if name.startswith(("adapt_", "transfer_", "classification_"))
    or name in ("batch_statistics", "regression_weight", "settings")
)


@dataclass(frozen=True)
class Run:
    """What one run was and what came out.

    Attributes
    ----------
    labels
        Names of the labels that it predicts.
    target_test, target_constant_mean
        Errors of the model, and of the source's mean force, on the target's test frames; None where it has no labels.
    source_held_out, source_constant_mean
        The same on the source's held-out frames, under the source's own statistics where the profile normalises each
        domain by itself; None where it holds no frames out.
    wall_s
        Time by part: load (0 if another run had read the pictures), stage1 (0 if it was reused), stage2, evaluate.
    problem
        Why stage 2 failed: the features collapsed, or losses were not finite. Such a run has no model and counts with
        the errors of the source's mean force.
    oracles, unseen
        Of generated domains: the errors of both oracles on the same frames, by name, and what of the gap no picture
        shows.
    baselines
        Errors of rules without a network on the target's test frames; empty without labels.
    label_free
        What is known of a model where the target has no labels.
    """

    key: str
    source: str
    target: str
    method: str
    seed: int
    labels: tuple[str, ...]
    profile: dict[str, Any]
    n_source: int
    n_target: int
    target_test: Evaluation | None
    target_constant_mean: Evaluation | None
    source_held_out: Evaluation | None
    source_constant_mean: Evaluation | None
    wall_s: dict[str, float]
    skipped_steps: int
    history: tuple[dict[str, Any], ...]
    versions: dict[str, str]
    problem: str | None = None
    oracles: dict[str, Evaluation] = field(default_factory=dict)
    unseen: tuple[str, ...] = ()
    baselines: dict[str, Evaluation] = field(default_factory=dict)
    label_free: LabelFree | None = None
    folder: Annotated[Path | None, Field(exclude=True)] = field(default=None, compare=False)

    @property
    def group(self) -> str:
        """The adaptation group's name, such as "mb0i0 → wmb1i1"."""
        return f"{self.source} → {self.target}"


_RUN = TypeAdapter(Run)


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
    progress: Progress = silent,
) -> list[Run]:
    """Train stage 1 on a source, adapt to each target with each method, evaluate on the targets' test frames.

    A target without labels is adapted to as a whole; its runs have no errors but `label_free`. A method that fails (its
    features collapse, its losses are not finite) gives a run with a `problem`; the others go on.

    Parameters
    ----------
    source, target
        Domains that are open, or folders that `gelgap.domains.open_domain` reads; several source folders are trained on
        together, several targets are adapted to one by one.
    methods
        Their names, or `module:Class` or `file.py:Class` of your own.
    profile
        One or several. The runs come by target, profile and method, in the given order.
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
    profiles = [own if isinstance(own, Profile) else Profile.preset(own) for own in _listed(profile)]
    methods = tuple(registry.use_method(method) for method in methods)
    if not methods:
        raise ValueError(f"no method was named; known methods: {', '.join(registry.method_names())}")
    for own in profiles:
        for method in methods:
            registry.method_settings(method, own)
    if weights is not None:
        load_checkpoint(Path(weights))  # refused before any picture is read
    source = source if isinstance(source, LabelledFrames) else open_domains(source)
    targets = [own if isinstance(own, LabelledFrames) else open_domain(own) for own in _listed(target)]
    for names in ([own.name for own in targets], [own.name for own in profiles]):
        if len(set(names)) < len(names):
            raise ValueError(
                f"{', '.join(names)}: results are filed by name, and two have the same; rename one"
            )
    out = None if out_dir is None else Path(out_dir)
    groups, stages = [], dict[tuple[str, str], Stage1]()
    notes: list[str] = []
    for domain in targets:
        for own in profiles:
            notes += size_notes(source, domain, own)
            frames = split_for_training(
                source, domain, own, seed, labels=labels, ranges=ranges, classes_from_force=classes_from_force
            )
            notes += frames.notes
            key = own.name, stage1_key(frames.source_train, own, seed, weights)
            stage1 = stages.setdefault(key, Stage1(frames.source_train, own, seed, weights, out, progress))
            # The source's pictures are in memory once for all targets.
            groups.append(_Group(source, domain, replace(frames, source_train=stage1.source_train), stage1))
    log_notes((source, *targets), notes)
    for group in groups:
        group.check(methods)
    return [run for group in groups for run in group.runs(methods)]


def _listed(value: Any) -> list[Any]:
    """Return what was given alone or as a sequence as a list."""
    return [value] if isinstance(value, str | Path | LabelledFrames | Profile) else list(value)


@dataclass(frozen=True)
class _Group:
    """A source and a target under one profile, divided, and the stage 1 that all methods begin with."""

    source: LabelledFrames
    target: LabelledFrames
    frames: SplitFrames
    stage1: "Stage1"

    def check(self, methods: Sequence[str]) -> None:
        """Check that both domains have what the methods need."""
        for method in methods:
            found = registry.find_method(method)
            found.check_classes(method, self.frames.source_train)
            if found.uses_target_labels:
                labelled = labelled_frames(self.frames.target_train)
                if len(labelled) < 2:
                    raise ValueError(
                        f"method {method} learns from labels of the target, and {len(labelled)} training frames of "
                        f"{self.target.name} have them: leave it out, or label more"
                    )
                labelled.check_labels()

    def runs(self, methods: Sequence[str]) -> list[Run]:
        """Do what is missing and return the runs of all methods."""
        source, target, frames, stage1 = self.source, self.target, self.frames, self.stage1
        folders: dict[str, Path | None] = dict.fromkeys(methods)
        if stage1.out is not None:
            for method in methods:
                key = run_key(frames, method, stage1.profile, stage1.seed, stage1.weights)
                folders[method] = stage1.out / f"{source.name}-{target.name}-{method}-{stage1.seed}-{key[:8]}"
        missing = [name for name, own in folders.items() if own is None or not (own / _RECORD).is_file()]
        done = {}
        with ExitStack() as held:
            for method in missing:
                if folders[method] is not None:
                    held.enter_context(sole_use(folders[method]))
            oracles = oracles_on(source, target, frames.target_test) if missing else {}
            unseen: tuple[str, ...] = ()
            if isinstance(source, GeneratedDomain) and isinstance(target, GeneratedDomain):
                unseen = tuple(unseen_differences(source.recipe, target.recipe))
            for method in missing:
                done[method], _ = run_method(frames, stage1, method, folders[method], oracles, unseen)
        return [done[method] if method in done else load_run(folders[method]) for method in methods]


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
        """Return the model, and the time that training it took now, s (0 if it was trained before).

        Raises
        ------
        RuntimeError
            If another process is training it.
        """
        known = "_trained" in vars(self)
        model, wall_s = self._trained
        return model, 0.0 if known else wall_s

    @cached_property
    def _trained(self) -> tuple[ForceModel, float]:
        if self.checkpoint is not None and self.checkpoint.is_file():
            try:
                return ForceModel.load(self.checkpoint), 0.0
            except ValueError as error:
                warn(f"{error}: stage 1 is trained again")
        folder = self.checkpoint and self.checkpoint.with_suffix("")
        resume_file = folder and folder / _RESUME
        with sole_use(folder) if folder else nullcontext():
            self.source_train.images(self.profile.image_size_px)  # read before the clock starts
            start = time.perf_counter()
            model = train_source(
                self.source_train,
                self.profile,
                self.seed,
                weights=self.weights,
                resume_file=resume_file,
                progress=self.progress,
            )
            wall_s = time.perf_counter() - start
            if folder:
                model.save(self.checkpoint)
                resume_file.unlink(missing_ok=True)
        return model, wall_s

    def untrained(self) -> ForceModel:
        """Return the model with which stage 1 begins."""
        return untrained(self.source_train, self.profile, self.seed)

    def adapt(self, target_train: LabelledFrames, method: str, resume_file: Path | None = None) -> "Adapted":
        """Train both stages of a method; that its features collapse or its losses are not finite is a result, too."""
        found = registry.find_method(method)
        if found.uses_target_labels:
            target_train = labelled_frames(target_train)
        start, stage1_s = self.model() if found.needs_stage_1 else (self.untrained(), 0.0)
        for part in (self.source_train, target_train):
            part.images(self.profile.image_size_px)  # read before the clock starts
        begun, model, problem = time.perf_counter(), None, None
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
        return Adapted(model, problem, history, {"stage1": stage1_s, "stage2": time.perf_counter() - begun})


class Adapted(NamedTuple):
    """What training gave: a model, or else the problem, the epochs, and the time of both stages, s."""

    model: ForceModel | None
    problem: str | None
    history: tuple[dict[str, Any], ...]
    wall_s: dict[str, float]


def run_method(
    frames: SplitFrames,
    stage1: Stage1,
    method: str,
    folder: Path | None = None,
    oracles: Mapping[str, Evaluation] | None = None,
    unseen: tuple[str, ...] = (),
) -> tuple[Run, ForceModel | None]:
    """Adapt by one method, judge the result and, if there is a folder, write it there; no model if that failed.

    `oracles` and `unseen` are the fields of the run that do not depend on the method.
    """
    train, profile, begun = frames.source_train, stage1.profile, time.perf_counter()
    for name, part in frames.parts.items():
        if name != "target_validation":
            part.images(profile.image_size_px)
    load_s = time.perf_counter() - begun
    adapted = stage1.adapt(frames.target_train, method, folder and folder / _RESUME)
    model, begun = adapted.model, time.perf_counter()
    tested = {"target": frames.target_test, "source": frames.source_held_out}
    constant = {name: evaluate_constant_mean(train, part) for name, part in tested.items() if len(part)}
    arrays = {} if model is None else _seen(model, frames)
    judged = constant if arrays else {}
    errors = {name: evaluate_frames(tested[name], arrays[f"{name}_predicted_n"]) for name in judged}
    label_free = None
    if model is not None and not len(frames.target_test):
        candidate, starts = Candidate.of(arrays), registry.find_method(method).needs_stage_1
        quantiles = np.quantile(arrays["target_predicted_n"], (0.05, 0.5, 0.95), axis=0).T.tolist()
        label_free = LabelFree(
            scores=scores(candidate),
            scores_before=scores(Candidate.of(_seen(stage1.model()[0], frames))) if starts else {},
            quantiles=dict(zip(train.labels.names, map(tuple, quantiles), strict=True)),
            alarm=alarm(candidate),
        )
    run = Run(
        key=run_key(frames, method, profile, stage1.seed, stage1.weights),
        source=train.name,
        target=frames.target_train.name,
        method=method,
        seed=stage1.seed,
        labels=train.labels.names,
        profile=profile.model_dump(mode="json"),
        n_source=len(train),
        n_target=len(frames.target_train),
        target_test=errors.get("target", constant.get("target")),
        target_constant_mean=constant.get("target"),
        source_held_out=errors.get("source"),
        source_constant_mean=constant.get("source"),
        baselines=evaluate_baselines(frames) if len(frames.target_test) else {},
        wall_s={"load": load_s, **adapted.wall_s, "evaluate": time.perf_counter() - begun},
        skipped_steps=sum(epoch["skipped_steps"] for epoch in adapted.history),
        history=adapted.history,
        versions=versions(),
        problem=adapted.problem,
        oracles=dict(oracles or {}),
        unseen=unseen,
        label_free=label_free,
        folder=folder,
    )
    if folder is not None:
        _write(run, model, arrays)
        (folder / _RESUME).unlink(missing_ok=True)
    return run, model


def _seen(model: ForceModel, frames: SplitFrames) -> dict[str, np.ndarray]:
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
    own = profile.replace(settings={name: s for name, s in profile.settings.items() if name == method})
    code = registry.method_code(method)
    return _key(parts, method if code is None else f"{method} {code}", own, seed, weights)


def stage1_key(
    source_train: LabelledFrames, profile: Profile, seed: int, weights: str | Path | None = None
) -> str:
    """Return the key of a stage 1; runs that only differ in stage 2 share it."""
    return _key((source_train,), "stage1", stage1_profile(profile), seed, weights)


def stage1_profile(profile: Profile) -> Profile:
    """Return the profile with all that stage 1 does not depend on at its default."""
    return Profile(**profile.model_dump(exclude=_STAGE_2_FIELDS))


def _key(
    parts: tuple[LabelledFrames, ...], method: str, profile: Profile, seed: int, weights: str | Path | None
) -> str:
    if weights is not None and not Path(weights).is_file():
        raise FileNotFoundError(f"weights file {weights} does not exist")
    content = {
        "frames": [[frames.name, frames.digest, len(frames)] for frames in parts],
        "method": method,
        "methods_version": _METHODS_VERSION,
        "profile": profile.model_dump(mode="json", exclude={"name"}, exclude_defaults=True),
        "seed": seed,
        "weights": None if weights is None else file_sha256(Path(weights)),
    }
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def versions() -> dict[str, str]:
    """Return the versions that a result depends on."""
    packages = {name: version(name) for name in ("gelgap", "torch", "numpy", "scikit-learn")}
    return {"python": platform.python_version(), **packages}


def _write(run: Run, model: ForceModel, arrays: dict[str, np.ndarray]) -> None:
    """Write a run's folder: what `load_predictions` will return, the model, checksums, and last the record.

    A run that failed has the record alone.
    """
    record = _RUN.dump_json(run, indent=1) + b"\n"
    sums = {_RECORD: hashlib.sha256(record).hexdigest()}
    if run.problem is None:
        kept = {
            name: values.astype(np.float16 if name.endswith("_features") else np.float32)
            for name, values in arrays.items()
        }
        with whole_file(run.folder / _PREDICTIONS) as temporary, temporary.open("wb") as file:
            np.savez_compressed(file, **kept)
        model.save(run.folder / _MODEL)
        sums |= {name: file_sha256(run.folder / name) for name in (_PREDICTIONS, _MODEL)}
    write_checksums(run.folder, sums)
    write_whole(run.folder / _RECORD, record)


def load_run(folder: str | Path) -> Run:
    """Read a run's folder.

    Raises
    ------
    FileNotFoundError
        If there is no finished run in the folder.
    RuntimeError
        If its record is damaged.
    """
    folder = Path(folder)
    path = folder / _RECORD
    if not path.is_file():
        raise FileNotFoundError(f"{folder} holds no finished run ({_RECORD} is missing)")
    if problem := checksum_problem(path):
        raise _damaged(path, problem)
    try:
        run = _RUN.validate_python({**read_json(path), "folder": folder})
        if not all(map(is_plain_name, (run.source, run.target, run.method))):
            raise ValueError("source, target and method must be plain names")
        if not isinstance(run.profile.get("name"), str) or not {"stage1", "stage2"} <= run.wall_s.keys():
            raise ValueError("the profile must have a name, and wall_s both stages")
        if run.target_test is None and run.label_free is None and run.problem is None:
            raise ValueError("it has neither errors nor what is known without labels")
    except (ValueError, TypeError) as error:
        reason = one_sentence(error) if isinstance(error, ValidationError) else str(error)
        raise _damaged(path, f"is not the record of a run: {reason}") from None
    return run


def load_runs(folder: str | Path) -> list[Run]:
    """Read all finished runs below a folder, sorted by path.

    Raises
    ------
    FileNotFoundError
        If there are none.
    """
    found = sorted(Path(folder).rglob(_RECORD))
    if not found:
        raise FileNotFoundError(
            f"{folder} holds no finished adaptation run; `gelgap adapt … --out {folder}` writes one"
        )
    return [load_run(path.parent) for path in found]


def load_predictions(run: Run) -> dict[str, np.ndarray]:
    """Return a run's arrays.

    For the target's test frames and, as `source_…`, the source's held-out frames: `target_true_n` and
    `target_predicted_n` (n, 3) in N, and of the first 400 frames `target_features` (m, D). A run with other labels has
    these in the same places, each in its unit. A target without labels has those of all its frames, and no
    `target_true_n`; a source of which no frames are held out those of 400 training frames.

    Raises
    ------
    RuntimeError
        If the file is missing or damaged, or the run failed.
    """
    if run.folder is None:
        raise ValueError("this run was not written to a folder, so there are no predictions to read")
    if run.problem is not None:
        raise RuntimeError(f"{run.group}, {run.method} has no predictions: {run.problem}")
    path = run.folder / _PREDICTIONS
    if problem := checksum_problem(path):
        raise _damaged(path, problem)
    try:
        arrays = read_arrays(path)
        needed = _ARRAYS if run.target_test is None else ("target_true_n", *_ARRAYS)
        if missing := [name for name in needed if name not in arrays]:
            raise ValueError(f"it lacks {', '.join(missing)}")
    except ValueError as error:
        raise _damaged(path, f"cannot be used: {error}") from None
    return arrays


def _damaged(path: Path, problem: str) -> RuntimeError:
    return RuntimeError(
        f"{path} {problem}; delete the folder {path.parent} and run the same `gelgap adapt` again"
    )
