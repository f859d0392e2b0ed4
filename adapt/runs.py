"""One adaptation run as a folder that a report can read: run.json, predictions.npz, model.pt.

Stage 1 is shared: all runs with the same source, profile, seed and weights use one checkpoint.
"""

import hashlib
import json
import math
import os
import platform
import time
from collections.abc import Iterable
from dataclasses import asdict, dataclass, field
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from gelgap.adapt.evaluation import Evaluation, evaluate_constant_mean, evaluate_predictions
from gelgap.adapt.frames import Frames, check_same_size, load_frames, split_source, split_target
from gelgap.adapt.methods.registry import find_method
from gelgap.adapt.model import ForceModel
from gelgap.adapt.profile import Profile, parse_profile
from gelgap.adapt.progress import Progress, silent
from gelgap.adapt.training import adapt, train_source, with_statistics_of

RECORD = "run.json"
PREDICTIONS = "predictions.npz"
MODEL = "model.pt"
_FEATURES_KEPT = 400


@dataclass(frozen=True)
class Run:
    """What one run was and what came out.

    target_test, target_constant_mean (the source's mean force), source_held_out and source_constant_mean
    are errors on frames that no training used; the source's are None where the profile holds none out, and are
    measured under the source's own statistics where the profile normalises each domain by itself.
    wall_s is by part: load, stage1 (0 if it was reused), stage2, evaluate. problem is a sentence where the
    features collapsed.
    """

    key: str
    source: str
    target: str
    method: str
    seed: int
    profile: dict[str, Any]
    n_source: int
    n_target: int
    target_test: Evaluation
    target_constant_mean: Evaluation
    source_held_out: Evaluation | None
    source_constant_mean: Evaluation | None
    wall_s: dict[str, float]
    skipped_steps: int
    history: tuple[dict[str, Any], ...]
    versions: dict[str, str]
    problem: str | None = None
    folder: Path | None = field(default=None, compare=False)

    @property
    def group(self) -> str:
        """The adaptation group's name, such as "mb0i0 → wmb1i1"."""
        return f"{self.source} → {self.target}"


def adapt_folders(
    source: str | Path,
    target: str | Path,
    methods: Iterable[str],
    profile: str | Profile = "smoke",
    seed: int = 0,
    weights: str | Path | None = None,
    out_dir: str | Path | None = None,
    progress: Progress = silent,
) -> list[Run]:
    """Load two domains, train stage 1 once, adapt with each method and evaluate on the target's test frames.

    Parameters
    ----------
    source, target
        Folders of domains that `gelgap.domains.dataset.open_domain` reads.
    weights
        A gelgap checkpoint, or a torchvision ResNet state dictionary, to start stage 1 from.
    out_dir
        Gets `stage1/` with the shared checkpoint and a folder per run; a run that is there already is not
        repeated, a run that was interrupted goes on from its last epoch. None: nothing is written.

    Raises
    ------
    ValueError
        If the method or profile is unknown, picture sizes differ, a label is outside the declared range.
    """
    methods = tuple(methods)
    for method in methods:
        find_method(method)
    profile = parse_profile(profile)
    start = time.perf_counter()
    source_frames, target_frames = load_frames(source, profile), load_frames(target, profile)
    load_s = time.perf_counter() - start
    return adapt_frames(
        source_frames, target_frames, methods, profile, seed, weights, out_dir, progress, load_s=load_s
    )


def adapt_frames(
    source: Frames,
    target: Frames,
    methods: Iterable[str],
    profile: Profile,
    seed: int = 0,
    weights: str | Path | None = None,
    out_dir: str | Path | None = None,
    progress: Progress = silent,
    load_s: float = 0.0,
) -> list[Run]:
    """As `adapt_folders`, for frames in memory."""
    check_same_size(source, target)
    source_train, source_held_out = split_source(source, profile, seed)
    target_train, _, target_test = split_target(target, profile, seed)
    out = None if out_dir is None else Path(out_dir)
    runs = []
    for method in methods:
        key = run_key(source, target, method, profile, seed, weights)
        folder = None if out is None else run_folder(out, source.name, target.name, method, seed, key)
        if folder is not None and (folder / RECORD).is_file():
            runs.append(load_run(folder))
            continue
        stage1, stage1_s = shared_stage1(source, source_train, profile, seed, weights, out, progress)
        if folder is not None:
            folder.mkdir(parents=True, exist_ok=True)
        start = time.perf_counter()
        resume_file = None if folder is None else folder / "resume.pt"
        model = adapt(stage1, source_train, target_train, method, profile, seed, resume_file, progress)
        stage2_s = time.perf_counter() - start
        start = time.perf_counter()
        own_statistics = profile.batch_statistics == "per_domain" and find_method(method).uses_target
        on_source = with_statistics_of(model, source_train) if own_statistics else model
        predicted = {"target": (target_test, model.predict_n(target_test))}
        if len(source_held_out):
            predicted["source"] = (source_held_out, on_source.predict_n(source_held_out))
        errors = {
            domain: evaluate_predictions(frames.force_n, force_n, frames.force_range_n)
            for domain, (frames, force_n) in predicted.items()
        }
        run = Run(
            key=key,
            source=source.name,
            target=target.name,
            method=method,
            seed=seed,
            profile=profile.model_dump(mode="json"),
            n_source=len(source_train),
            n_target=len(target_train),
            target_test=errors["target"],
            target_constant_mean=evaluate_constant_mean(source_train, target_test),
            source_held_out=errors.get("source"),
            source_constant_mean=(
                evaluate_constant_mean(source_train, source_held_out) if len(source_held_out) else None
            ),
            wall_s={
                "load": load_s,
                "stage1": stage1_s,
                "stage2": stage2_s,
                "evaluate": time.perf_counter() - start,
            },
            skipped_steps=sum(record["skipped_steps"] for record in model.history),
            history=model.history,
            versions=versions(),
            folder=folder,
        )
        if folder is not None:
            shown = source_held_out if len(source_held_out) else source_train
            _write(run, folder, model, on_source, predicted, shown)
            (folder / "resume.pt").unlink(missing_ok=True)
        runs.append(run)
    return runs


def prepare_stage1(
    source: str | Path,
    profile: Profile,
    seed: int,
    out_dir: str | Path,
    weights: str | Path | None = None,
    progress: Progress = silent,
) -> float:
    """Train the stage-1 checkpoint that all runs of this source, profile and seed share, and return its wall time in s
    (0 if it was there). Runs started in parallel afterwards find it."""
    frames = load_frames(source, profile)
    train, _ = split_source(frames, profile, seed)
    return shared_stage1(frames, train, profile, seed, weights, Path(out_dir), progress)[1]


def run_key(
    source: Frames,
    target: Frames | None,
    method: str,
    profile: Profile,
    seed: int,
    weights: str | Path | None,
) -> str:
    """Return the hash of everything that decides a run's result: data, method, hyperparameters, seed,
    weights. Settings of other methods are left out, and so are fields at their default: a field that a later version
    adds does not change the key."""
    own = {name: values for name, values in profile.settings.items() if name == method}
    hyperparameters = profile.replace(settings=own).model_dump(
        mode="json", exclude={"name"}, exclude_defaults=True
    )
    content = {
        "source": [source.name, source.digest, len(source)],
        "target": None if target is None else [target.name, target.digest, len(target)],
        "method": method,
        "profile": hyperparameters,
        "seed": seed,
        "weights": None if weights is None else hashlib.sha256(Path(weights).read_bytes()).hexdigest(),
    }
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def run_folder(out: Path, source: str, target: str, method: str, seed: int, key: str) -> Path:
    """Return where below `out` a run is kept."""
    return out / f"{source}-{target}-{method}-{seed}-{key[:8]}"


def stage1_profile(profile: Profile) -> Profile:
    """Return the profile with all that stage 1 does not depend on at its default: equal ones share a checkpoint."""
    stage2_only = {name for name in Profile.model_fields if name.startswith(("adapt_", "transfer_"))}
    stage2_only |= {"batch_statistics", "classification_weight", "classification_feedback"}
    stage2_only |= {"regression_weight", "settings"}
    return profile.replace(
        **{name: Profile.model_fields[name].get_default(call_default_factory=True) for name in stage2_only}
    )


def versions() -> dict[str, str]:
    """Return the versions that a result depends on."""
    packages = {name: version(name) for name in ("gelgap", "torch", "numpy", "scikit-learn")}
    return {"python": platform.python_version(), **packages}


def shared_stage1(
    source: Frames,
    source_train: Frames,
    profile: Profile,
    seed: int,
    weights: str | Path | None,
    out: Path | None,
    progress: Progress = silent,
) -> tuple[ForceModel, float]:
    """Return the stage-1 model of a source and the time it took now (0 if its checkpoint was there).

    `source_train` are the frames of `source` that it may learn from; without `out` nothing is kept.
    """
    start = time.perf_counter()
    if out is None:
        return train_source(
            source_train, profile, seed, weights, progress=progress
        ), time.perf_counter() - start
    key = run_key(source, None, "stage1", stage1_profile(profile), seed, weights)
    path = out / "stage1" / f"{source.name}-{seed}-{key[:8]}.pt"
    if path.is_file():
        return ForceModel.load(path), 0.0
    path.parent.mkdir(parents=True, exist_ok=True)
    resume_file = path.with_suffix(".resume")
    model = train_source(source_train, profile, seed, weights, resume_file, progress)
    model.save(path.with_suffix(".new"))
    os.replace(path.with_suffix(".new"), path)
    resume_file.unlink(missing_ok=True)
    return model, time.perf_counter() - start


def _write(
    run: Run,
    folder: Path,
    model: ForceModel,
    on_source: ForceModel,
    predicted: dict[str, tuple[Frames, np.ndarray]],
    source: Frames,
) -> None:
    arrays = {}
    for domain, (frames, force_n) in predicted.items():
        arrays[f"{domain}_true_n"] = frames.force_n
        arrays[f"{domain}_predicted_n"] = force_n.astype(np.float32)
    for domain, frames, seen_by in (("source", source, on_source), ("target", predicted["target"][0], model)):
        some = frames.take(np.arange(min(len(frames), _FEATURES_KEPT)))
        arrays[f"{domain}_features"] = seen_by.features(some).astype(np.float16)
        arrays[f"{domain}_features_force_n"] = some.force_n
    np.savez_compressed(folder / PREDICTIONS, **arrays)
    model.save(folder / MODEL)
    temporary = folder / (RECORD + ".part")
    content = {key: value for key, value in asdict(run).items() if key != "folder"}
    temporary.write_text(
        json.dumps(_without_nan(content), indent=1, ensure_ascii=False) + "\n", encoding="utf-8"
    )
    os.replace(temporary, folder / RECORD)


def _without_nan(value: Any) -> Any:
    """Replace NaN by None, which JSON can say."""
    if isinstance(value, dict):
        return {key: _without_nan(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_without_nan(item) for item in value]
    return None if isinstance(value, float) and math.isnan(value) else value


def load_run(folder: str | Path) -> Run:
    """Read a run's folder.

    Raises
    ------
    FileNotFoundError
        If there is no finished run in the folder.
    """
    folder = Path(folder)
    if not (folder / RECORD).is_file():
        raise FileNotFoundError(f"{folder} holds no finished run ({RECORD} is missing)")
    content = json.loads((folder / RECORD).read_text(encoding="utf-8"))
    for name in ("target_test", "target_constant_mean", "source_held_out", "source_constant_mean"):
        if content[name] is not None:
            content[name] = _evaluation(content[name])
    content["history"] = tuple(content["history"])
    return Run(**content, folder=folder)


def load_runs(folder: str | Path) -> list[Run]:
    """Read all finished runs below a folder, sorted by path.

    Raises
    ------
    FileNotFoundError
        If there is none.
    """
    found = sorted(Path(folder).rglob(RECORD))
    if not found:
        raise FileNotFoundError(
            f"{folder} holds no finished adaptation run; `gelgap adapt … --out {folder}` writes one"
        )
    return [load_run(path.parent) for path in found]


def load_predictions(run: Run) -> dict[str, np.ndarray]:
    """Return the arrays of a run's predictions.npz: target_true_n, target_predicted_n (n, 3), the source's,
    features."""
    if run.folder is None:
        raise ValueError("this run was not written to a folder, so that there are no predictions to read")
    with np.load(run.folder / PREDICTIONS) as arrays:
        return dict(arrays)


def _evaluation(content: dict[str, Any]) -> Evaluation:
    values = {
        key: tuple(math.nan if x is None else x for x in content[key])
        for key in ("mae_n", "mae_percent", "r2")
    }
    return Evaluation(content["n"], **values)
