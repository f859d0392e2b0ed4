"""One finished run as a folder that a report can read: run.json, predictions.npz and model.pt."""

import hashlib
import json
import math
import platform
from dataclasses import asdict, dataclass, field
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import TypeAdapter, ValidationError

from gelgap.adapt.evaluation import Evaluation
from gelgap.adapt.model import ForceModel
from gelgap.assets.array_file import read_arrays
from gelgap.assets.checksums import checksum_problem, file_sha256, read_json, write_checksums
from gelgap.assets.names import is_plain_name
from gelgap.assets.settings import one_sentence
from gelgap.assets.whole_file import whole_file, write_whole
from gelgap.domains import FORCE_COLUMNS, QUANTITIES

_RECORD = "run.json"
_PREDICTIONS = "predictions.npz"
_MODEL = "model.pt"
_ARRAYS = ("target_true_n", "target_predicted_n", "target_features", "source_features")
_EVALUATIONS = ("target_test", "target_constant_mean", "source_held_out", "source_constant_mean")


@dataclass(frozen=True)
class Run:
    """What one run was and what came out.

    Attributes
    ----------
    target_test, target_constant_mean
        Errors of the model, and of the source's mean force, on the target's test frames.
    source_held_out, source_constant_mean
        The same on the source's held-out frames, under the source's own statistics where the profile normalises each
        domain by itself; None where it holds no frames out.
    wall_s
        Time by part: load, stage1 (0 if it was reused), stage2, evaluate.
    problem
        A sentence where the features collapsed.
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
    def labels(self) -> tuple[str, ...]:
        """Names of the labels that it predicts."""
        return self.target_test.labels

    @property
    def group(self) -> str:
        """The adaptation group's name, such as "mb0i0 → wmb1i1"."""
        return f"{self.source} → {self.target}"


def run_folder(out: Path, source: str, target: str, method: str, seed: int, key: str) -> Path:
    """Return where below `out` a run is kept."""
    return out / f"{source}-{target}-{method}-{seed}-{key[:8]}"


def is_finished(folder: Path) -> bool:
    """Return whether a folder holds a finished run."""
    return (folder / _RECORD).is_file()


def versions() -> dict[str, str]:
    """Return the versions that a result depends on."""
    packages = {name: version(name) for name in ("gelgap", "torch", "numpy", "scikit-learn")}
    return {"python": platform.python_version(), **packages}


def write_run(run: Run, model: ForceModel, arrays: dict[str, np.ndarray]) -> None:
    """Write a run's folder: what `load_predictions` will return, the model, checksums, and last the record."""
    with whole_file(run.folder / _PREDICTIONS) as temporary, temporary.open("wb") as file:
        np.savez_compressed(file, **arrays)
    model.save(run.folder / _MODEL)
    content = {name: value for name, value in asdict(run).items() if name != "folder"}
    content |= {name: _evaluation_content(getattr(run, name)) for name in _EVALUATIONS}
    record = f"{json.dumps(_without_nan(content), indent=1, ensure_ascii=False)}\n".encode()
    sums = {name: file_sha256(run.folder / name) for name in (_PREDICTIONS, _MODEL)}
    write_checksums(run.folder, sums | {_RECORD: hashlib.sha256(record).hexdigest()})
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
    if not is_finished(folder):
        raise FileNotFoundError(f"{folder} holds no finished run ({_RECORD} is missing)")
    path = folder / _RECORD
    if problem := checksum_problem(path):
        raise _damaged(path, problem)
    try:
        return _run(read_json(path), folder)
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise _damaged(path, f"is not the record of a run: {_reason(error)}") from None


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
    `target_predicted_n` (n, 3) in N, and of the first 400 frames `target_features` (m, D) and
    `target_features_force_n` (m, 3). A run with other labels has these in the same places, each in its unit.

    Raises
    ------
    RuntimeError
        If the file is missing or damaged.
    """
    if run.folder is None:
        raise ValueError("this run was not written to a folder, so there are no predictions to read")
    path = run.folder / _PREDICTIONS
    if not path.is_file():
        raise _damaged(path, "is missing")
    if problem := checksum_problem(path):
        raise _damaged(path, problem)
    try:
        arrays = read_arrays(path)
        _check_predictions(arrays, len(run.target_test.labels))
    except ValueError as error:
        raise _damaged(path, f"is damaged: {error}") from None
    return arrays


def _check_predictions(arrays: dict[str, np.ndarray], n_labels: int) -> None:
    """Raise ValueError if an array is missing, has another shape, or holds what is not a finite number."""
    missing = [name for name in _ARRAYS if name not in arrays]
    if missing:
        raise ValueError(f"it lacks {', '.join(missing)}")
    for name, values in arrays.items():
        columns = values.shape[1] if name.endswith("_features") and values.ndim == 2 else n_labels
        if values.dtype.kind != "f" or values.shape[1:] != (columns,):
            raise ValueError(f"{name} is {values.dtype} {values.shape}, expected numbers (n, {columns})")
        if not np.isfinite(values).all():
            raise ValueError(f"{name} holds values that are not finite")
        other = name.replace("_true_n", "_predicted_n")
        if other in arrays and len(arrays[other]) != len(values):
            raise ValueError(f"{name} and {other} have {len(values)} and {len(arrays[other])} rows")


def _run(content: dict[str, Any], folder: Path) -> Run:
    """Return the run of a record, or raise what says which of its fields is not one."""
    for name in _EVALUATIONS:
        if content[name] is not None:
            content[name] = _evaluation(content[name])
    run = TypeAdapter(Run).validate_python({**content, "folder": folder})
    for field_name in ("source", "target", "method"):
        if not is_plain_name(getattr(run, field_name)):
            raise ValueError(f"{field_name} = {getattr(run, field_name)!r} is no name")
    if not isinstance(run.profile.get("name"), str) or not {"stage1", "stage2"} <= run.wall_s.keys():
        raise ValueError("it lacks the profile's name or the times of the stages")
    return run


def _reason(error: Exception) -> str:
    """Return why a record could not be read, in one line."""
    if isinstance(error, ValidationError):
        return one_sentence(error)
    return f"it lacks {error}" if isinstance(error, KeyError) else str(error)


def _damaged(path: Path, problem: str) -> RuntimeError:
    return RuntimeError(
        f"{path} {problem}; delete the folder {path.parent} and run the same `gelgap adapt` again"
    )


def _without_nan(value: Any) -> Any:
    """Replace NaN, which JSON cannot say, by None."""
    if isinstance(value, dict):
        return {key: _without_nan(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_without_nan(item) for item in value]
    return None if isinstance(value, float) and math.isnan(value) else value


def _evaluation_content(evaluation: Evaluation | None) -> dict[str, Any] | None:
    """Return what a record holds of an evaluation; that of the force's three axes has no names of labels."""
    if evaluation is None:
        return None
    content = asdict(evaluation)
    if evaluation.labels != FORCE_COLUMNS:
        return content
    mae, _ = content.pop("mae"), content.pop("labels")
    return {"n": content.pop("n"), "mae_n": mae, **content}


def _evaluation(content: dict[str, Any]) -> Evaluation:
    labels = tuple(content.get("labels", FORCE_COLUMNS))
    if unknown := [name for name in labels if name not in QUANTITIES]:
        raise ValueError(f"label {unknown[0]!r} is unknown")
    mae, mae_percent, r2 = (
        tuple(math.nan if value is None else value for value in content[name])
        for name in ("mae" if "labels" in content else "mae_n", "mae_percent", "r2")
    )
    if {len(mae), len(mae_percent), len(r2)} != {len(labels)}:
        raise ValueError(
            f"an evaluation has other than {len(labels)} numbers for the labels {', '.join(labels)}"
        )
    return Evaluation(content["n"], mae, mae_percent, r2, labels)
