"""The record of a run: a folder with run.json, predictions.npz and model.pt, written once and read back.

The folder's name ends with the hash of all that decides the result (`runs.run_key`).
"""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field, TypeAdapter, ValidationError

from gelgap.adapt.evaluation import Evaluation
from gelgap.adapt.model import ForceModel
from gelgap.adapt.selection import LabelFree
from gelgap.assets.array_file import read_arrays, write_arrays
from gelgap.assets.checksums import checksum_problem, file_sha256, parse_json, sha256, write_checksums
from gelgap.assets.names import is_plain_name
from gelgap.assets.settings import one_sentence
from gelgap.assets.whole_file import write_whole

RECORD = "run.json"
_PREDICTIONS, _MODEL = "predictions.npz", "model.pt"
_ARRAYS = ("target_predicted_n", "target_features", "source_true_n", "source_predicted_n", "source_features")


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
    core_s
        Processor time by part, s: load (0 if another run had read the pictures), stage1 (0 if it was reused), stage2,
        evaluate; empty in a record of former versions.
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
    skipped_steps: int
    history: tuple[dict[str, Any], ...]
    versions: dict[str, str]
    core_s: dict[str, float] = field(default_factory=dict)
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


def write_run(run: Run, folder: Path, model: ForceModel | None, arrays: dict[str, np.ndarray]) -> None:
    """Write a run's folder: what `load_predictions` will return, the model, checksums, and last the record.

    A run that failed has the record alone.
    """
    record = _RUN.dump_json(run, indent=1) + b"\n"
    sums = {RECORD: sha256(record)}
    if model is not None:
        kept = {
            name: values.astype(np.float16 if name.endswith("_features") else np.float32)
            for name, values in arrays.items()
        }
        write_arrays(folder / _PREDICTIONS, kept)
        model.save(folder / _MODEL)
        sums |= {name: file_sha256(folder / name) for name in (_PREDICTIONS, _MODEL)}
    write_checksums(folder, sums)
    write_whole(folder / RECORD, record)


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
    path = folder / RECORD
    if not path.is_file():
        raise FileNotFoundError(f"{folder} holds no finished run ({RECORD} is missing)")
    if problem := checksum_problem(path):
        raise _damaged(path, problem)
    try:
        run = _RUN.validate_python({**parse_json(path.read_bytes()), "folder": folder})
        if not all(map(is_plain_name, (run.source, run.target, run.method))):
            raise ValueError("source, target and method must be plain names")
        if not isinstance(run.profile.get("name"), str):
            raise ValueError("the profile must have a name")
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
    records = sorted(Path(folder).rglob(RECORD))
    if not records:
        raise FileNotFoundError(
            f"{folder} holds no finished adaptation run; `gelgap adapt … --out {folder}` writes one"
        )
    return [load_run(path.parent) for path in records]


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
