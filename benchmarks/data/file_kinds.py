"""The kinds of files that gelgap reads, each with the function that its command reads it with."""

import hashlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gelgap.benchmarks.data.sound_files import DOMAIN, kept_array, small_profile


@dataclass(frozen=True)
class FileKind:
    """A kind of file.

    Attributes
    ----------
    part
        The folder of the sound files that reading it takes.
    file
        The file, as a pattern below that folder.
    read
        Returns what the part holds; the same for the same content.
    has_checksum
        Whether gelgap writes it, so that no damage may pass unseen. Other people's tables, pictures and settings have
        no checksum: there a changed digit is another number.
    """

    part: str
    file: str
    read: Callable[[Path], Any]
    has_checksum: bool = True


def content_digest(value: Any) -> str:
    """Return a hash of arrays, numbers, texts, and lists, tuples and dictionaries of them."""
    found = hashlib.sha256()
    _add(found, value)
    return found.hexdigest()


def _add(found: "hashlib._Hash", value: Any) -> None:
    if isinstance(value, dict):
        value = list(value.items())
    if isinstance(value, list | tuple):
        found.update(b"(%d" % len(value))
        for item in value:
            _add(found, item)
    elif isinstance(value, np.ndarray) and value.dtype != object:
        found.update(f"{value.dtype.newbyteorder('=')}{value.shape}".encode())
        found.update(np.ascontiguousarray(value).data)
    else:
        found.update(repr(value.tolist() if isinstance(value, np.ndarray) else value).encode())


def _membrane(part: Path) -> Any:
    from gelgap.sim import MembraneState

    state = MembraneState.load(part / "state.npz")
    arrays = state.x_mm, state.y_mm, state.displacement_mm, state.contact, state.force_n
    return *arrays, state.contact_radius_mm, state.converged


def _solution(part: Path) -> Any:
    """Return the bytes of the cached solution; a file that is not taken is solved again, here from a copy."""
    from gelgap.sim.solution import load_solution, solution_bytes

    (copy,) = (part / "copy").glob("*.solution")
    found = load_solution(copy.stem)
    return solution_bytes(found) if found is not None else copy.read_bytes()


def _colours(part: Path) -> Any:
    from gelgap.render import Illumination, Sensor

    return Illumination.preset("i0").led_to_camera(Sensor.preset("paper").camera)


def _data_set(folder: Path) -> Any:
    from gelgap.domains import open_domain

    frames = open_domain(folder)
    return frames.columns, frames.reference, [frames.picture(index) for index in range(len(frames))]


def _kept_pictures(part: Path) -> Any:
    from gelgap.domains import open_domain

    return np.array(open_domain(part).images())


def _run(part: Path) -> Any:
    from gelgap.adapt import load_predictions, load_runs

    return [(repr(run), load_predictions(run)) for run in load_runs(part)]


def _model(path: Path) -> Any:
    from gelgap.adapt import ForceModel

    model = ForceModel.load(path)
    state = {name: tensor.numpy() for name, tensor in model.network.state_dict().items()}
    described = model.profile, model.n_classes, model.seed, model.source, model.target, model.method
    return state, model.force_range_n, repr(described), repr(model.history)


def _resumed(part: Path) -> Any:
    """Return the network that training which goes on from a checkpoint has; it may train again from the start."""
    from gelgap.adapt import train_source
    from gelgap.domains import open_domain

    source = open_domain(part / "pictures")
    model = train_source(source, small_profile(), resume_file=part / "resume.pt")
    return {name: tensor.numpy() for name, tensor in model.network.state_dict().items()}


def _weights(part: Path) -> Any:
    from gelgap.adapt import make_network
    from gelgap.adapt.network import load_imagenet_weights

    network = make_network(small_profile(), 2, seed=1)
    load_imagenet_weights(network.backbone, part / "weights.pt")
    return {name: tensor.numpy() for name, tensor in network.backbone.state_dict().items()}


def _sensor(part: Path) -> Any:
    from gelgap.render import Sensor

    return repr(Sensor.load(part / "sensors.toml"))


def _illumination(part: Path) -> Any:
    from gelgap.render import Illumination

    return repr(Illumination.load(part / "illuminations.toml"))


def _path(part: Path) -> Any:
    from gelgap.sim import load_path

    return repr(load_path(str(part / "paths.toml")).poses)


def _sweep(part: Path) -> Any:
    from gelgap.domains import Sweep

    return repr(Sweep.load(part / "sweep.toml"))


def _records(part: Path) -> Any:
    """Return whether all records are ones that were written; those that are left out are measured again."""
    from gelgap.benchmarks.common import read_records

    written, found = (read_records(folder / "runs.jsonl") for folder in (part / "copy", part))
    return found.equals(written.loc[found.index])


def _oracles(part: Path) -> Any:
    from gelgap.benchmarks.adaptation.groups import load_oracles

    return repr(load_oracles(part).to_dict())


def _kept_result(part: Path) -> Any:
    from gelgap.benchmarks.common.kept_results import kept_result

    return kept_result(part / "solved.result", kept_array)


KINDS: dict[str, FileKind] = {
    "membrane (npz)": FileKind("membrane", "state.npz", _membrane),
    "solution in the cache": FileKind("cache", "*.solution", _solution),
    "colours in the cache": FileKind("cache", "*.led", _colours),
    "manifest": FileKind("data", f"{DOMAIN}/manifest.json", lambda part: _data_set(part / DOMAIN)),
    "shard (Parquet)": FileKind("data", f"{DOMAIN}/frames-*.parquet", lambda part: _data_set(part / DOMAIN)),
    "reference.png": FileKind("data", f"{DOMAIN}/reference.png", lambda part: _data_set(part / DOMAIN)),
    "picture cache": FileKind("pictures", ".cache/*.npy", _kept_pictures),
    "run.json": FileKind("runs", "run/run.json", _run),
    "predictions.npz": FileKind("runs", "run/predictions.npz", _run),
    "model.pt": FileKind("runs", "run/model.pt", lambda part: _model(part / "run" / "model.pt")),
    "SHA256SUMS": FileKind("runs", "run/SHA256SUMS", _run),
    "stage 1 (checkpoint)": FileKind("runs", "stage1.pt", lambda part: _model(part / "stage1.pt")),
    "resume.pt": FileKind("runs", "resume.pt", _resumed),
    "records (JSON lines)": FileKind("records", "runs.jsonl", _records),
    "results (JSON)": FileKind("records", "oracles.json", _oracles),
    "kept result": FileKind("records", "solved.result", _kept_result),
    "weights file": FileKind("runs", "weights.pt", _weights),
    "real picture (PNG)": FileKind("pictures", "3.png", _data_set),
    "real picture (JPEG)": FileKind("published", "train/images/3.jpg", _data_set, has_checksum=False),
    "picture table (CSV)": FileKind("pictures", "table.csv", _data_set, has_checksum=False),
    "force.csv": FileKind("published", "train/forcePosition/force.csv", _data_set, has_checksum=False),
    "sensor (TOML)": FileKind("settings", "sensors.toml", _sensor, has_checksum=False),
    "illumination (TOML)": FileKind("settings", "illuminations.toml", _illumination, has_checksum=False),
    "path (TOML)": FileKind("settings", "paths.toml", _path, has_checksum=False),
    "sweep (TOML)": FileKind("settings", "sweep.toml", _sweep, has_checksum=False),
}
