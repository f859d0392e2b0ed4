"""One finished run as a folder that a report can read: run.json, predictions.npz and model.pt."""

import json
import math
import platform
from dataclasses import asdict, dataclass, field
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from gelgap.adapt.evaluation import Evaluation
from gelgap.adapt.model import ForceModel
from gelgap.assets.whole_file import whole_file, write_whole

_RECORD = "run.json"
_PREDICTIONS = "predictions.npz"
_MODEL = "model.pt"
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
    """Write a run's folder: what `load_predictions` will return, the model, and last the record of a finished run."""
    with whole_file(run.folder / _PREDICTIONS) as temporary, temporary.open("wb") as file:
        np.savez_compressed(file, **arrays)
    model.save(run.folder / _MODEL)
    content = {name: value for name, value in asdict(run).items() if name != "folder"}
    text = json.dumps(_without_nan(content), indent=1, ensure_ascii=False)
    write_whole(run.folder / _RECORD, f"{text}\n".encode())


def load_run(folder: str | Path) -> Run:
    """Read a run's folder.

    Raises
    ------
    FileNotFoundError
        If there is no finished run in the folder.
    """
    folder = Path(folder)
    if not is_finished(folder):
        raise FileNotFoundError(f"{folder} holds no finished run ({_RECORD} is missing)")
    content = json.loads((folder / _RECORD).read_text(encoding="utf-8"))
    for name in _EVALUATIONS:
        if content[name] is not None:
            content[name] = _evaluation(content[name])
    content["history"] = tuple(content["history"])
    return Run(**content, folder=folder)


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
    `target_features_force_n` (m, 3).
    """
    if run.folder is None:
        raise ValueError("this run was not written to a folder, so there are no predictions to read")
    with np.load(run.folder / _PREDICTIONS) as arrays:
        return dict(arrays)


def _without_nan(value: Any) -> Any:
    """Replace NaN, which JSON cannot say, by None."""
    if isinstance(value, dict):
        return {key: _without_nan(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_without_nan(item) for item in value]
    return None if isinstance(value, float) and math.isnan(value) else value


def _evaluation(content: dict[str, Any]) -> Evaluation:
    axes = {
        name: tuple(math.nan if value is None else value for value in content[name])
        for name in ("mae_n", "mae_percent", "r2")
    }
    return Evaluation(content["n"], **axes)
