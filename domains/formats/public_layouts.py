"""Layouts of public tactile data and of robot learning: FEATS's, `yxma/gelsight-mini-pretrain`'s, LeRobot's v3.0.

FEATS (github.com/feats-ai/feats) names forces by its rig's axes: by its homography x points to the left in the picture
and y up, so that Fx and Fy have the other sign than gelgap's; `yxma/gelsight-mini-pretrain` has taken its forces over.
"""

import json
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa

from gelgap.domains.formats.pictures import encode_jpeg
from gelgap.domains.formats.shards import PICTURE
from gelgap.domains.frames.labels import FORCE_COLUMNS
from gelgap.domains.frames.splits import PARTS, indices_by_part
from gelgap.domains.frames.stored import GeneratedDomain
from gelgap.sim.traction import COARSE_SHAPE

if TYPE_CHECKING:
    import pandas as pd

_FEATS_SIGNS = (-1.0, -1.0, 1.0)
_FEATS_PARTS = dict(zip(PARTS, ("train", "val", "test"), strict=True))
_MINI_JPEG_QUALITY = 92
_TEXTS = ("image_format", "source", "capture", "split", "obj_name", "side", "indenter", "indenter_param")
_MINI_COLUMNS = (
    *("image", "image_format", "source", "markered", "capture", "split", "height", "width", "obj_name"),
    *("init_pose", "side", "x_mm", "y_mm", "z_mm", "quat_x", "quat_y", "quat_z", "quat_w", "indenter"),
    *("indenter_param", "f_x", "f_y", "f_z", "grid_z_max", "grid_z_mean", "episode", "frame_idx"),
    *("digit_class", "gel_variant", "domain"),
)
_MINI_TYPES = (
    {"image": pa.binary(), "markered": pa.bool_()}
    | dict.fromkeys((*_TEXTS, "episode", "gel_variant", "domain"), pa.string())
    | dict.fromkeys(("height", "width", "init_pose", "frame_idx", "digit_class"), pa.int32())
)
MINI_SCHEMA = pa.schema([(name, _MINI_TYPES.get(name, pa.float32())) for name in _MINI_COLUMNS])
"""The thirty columns of `yxma/gelsight-mini-pretrain` of August 2026."""

LEROBOT_VERSION = "v3.0"
FRAMES_PER_S = 10
"""Frames are equilibria without a time; this says how a policy's loader spaces them."""
_POSE = ("x_mm", "y_mm", "depth_mm", "shear_x_mm", "shear_y_mm")
_MOST_BYTES = 100 * 2**20
_CAMERA = "observation.images.tactile"
_DATA_PATH = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
_EPISODES_PATH = "meta/episodes/chunk-000/file-000.parquet"
_VECTORS = {"observation.force": FORCE_COLUMNS, "observation.state": _POSE, "action": _POSE}


def write_feats(frames: GeneratedDomain, folder: Path) -> None:
    """`{train,val,test}/<frame>.npy`, a dictionary a frame, and `normalization.npy`.

    A dictionary in an `.npy` is a pickle, which FEATS's own reader loads as such. `grid_x`, `grid_y` and `grid_z`, the
    force on each of 24×32 cells of the view, are there if the domain was generated with `--columns traction`.
    """
    forces_n, bounds = _feats_forces_n(frames), {}
    for part, indices in indices_by_part(frames).items():
        (folder / _FEATS_PARTS[part]).mkdir()
        for index in indices.tolist():
            label = {"gs_img": frames.picture(index)}
            if "traction" in frames.optional_columns:
                maps_n = frames.optional("traction", index).reshape(*COARSE_SHAPE, 3) * _FEATS_SIGNS + 0.0
                label |= {f"grid_{axis}": maps_n[..., k] for k, axis in enumerate("xyz")}
            label |= forces_n[index]
            np.save(folder / _FEATS_PARTS[part] / f"{int(frames.columns['frame_id'][index]):06d}.npy", label)
            if part == "train":
                for name, value in label.items():
                    known = bounds.setdefault(name, {"min": np.inf, "max": -np.inf})
                    known["min"] = min(known["min"], float(np.min(value)))
                    known["max"] = max(known["max"], float(np.max(value)))
    np.save(folder / "normalization.npy", bounds)


def _feats_forces_n(frames: GeneratedDomain) -> list[dict[str, float]]:
    """Return the force of each frame by FEATS's names and signs."""
    forces_n = (frames.force_n * _FEATS_SIGNS + 0.0).tolist()  # adding zero turns −0.0 into 0.0
    return [dict(zip(("f_x", "f_y", "f_z"), own, strict=True)) for own in forces_n]


def write_mini_pretrain(frames: GeneratedDomain, folder: Path) -> None:
    """`<split>-00000-of-00001.parquet` in `MINI_SCHEMA`, with JPEG pictures; what is not known is null."""
    import pyarrow.parquet as pq

    columns, recipe, forces_n = frames.columns, frames.recipe, _feats_forces_n(frames)
    shape = recipe.indenter.shape
    width, height = frames.size_px
    of_all = {
        "image_format": "jpeg",
        "source": "gelgap",
        "markered": recipe.markers,
        "height": height,
        "width": width,
        "indenter": shape,
        "indenter_param": recipe.indenter.label.removeprefix(shape).removesuffix("mm").strip(),
        "gel_variant": "markered" if recipe.markers else "markerless",
        "domain": "sim",
    }

    def row(index: int, part: str) -> dict[str, Any]:
        return {
            **of_all,
            "image": encode_jpeg(frames.picture(index), _MINI_JPEG_QUALITY),
            "capture": f"{frames.name}_{int(columns['frame_id'][index]):06d}",
            "split": part,
            "x_mm": columns["x_mm"][index],
            "y_mm": columns["y_mm"][index],
            "z_mm": columns["commanded_z_mm"][index],
            **forces_n[index],
            "episode": str(int(columns["trajectory_id"][index])),
            "frame_idx": int(columns["step"][index]),
        }

    for split, indices in indices_by_part(frames).items():
        part = _FEATS_PARTS[split]
        with pq.ParquetWriter(folder / f"{part}-00000-of-00001.parquet", MINI_SCHEMA) as writer:
            for start in range(0, len(indices), 100):
                rows = [row(index, part) for index in indices[start : start + 100].tolist()]
                writer.write_table(pa.Table.from_pylist(rows, MINI_SCHEMA))


def write_lerobot(frames: GeneratedDomain, folder: Path) -> None:
    """`{meta,data}` in LeRobot's format v3.0, pictures as PNG inside the Parquet files.

    An episode is a trajectory: a travel at one point, depth and direction. `action` is the next commanded pose, of the
    last frame its own. Episodes whose frames are of several parts of the split, as those of a random one, count as
    training.
    """
    import pandas as pd
    import pyarrow.parquet as pq

    parts, table = _episodes(frames)
    values = _lerobot_values(frames, table)
    dtypes = {name: "float32" if own.dtype.kind == "f" else "int64" for name, own in values.items()}
    types = {name: pa.list_(pa.float32(), len(labels)) for name, labels in _VECTORS.items()}
    schema = pa.schema([(_CAMERA, PICTURE), *(dtypes | types).items()])
    (folder / "meta/episodes/chunk-000").mkdir(parents=True)
    (folder / "data/chunk-000").mkdir(parents=True)
    lengths = table.groupby("episode").size().to_numpy()
    ends = np.cumsum(lengths)
    starts, n = ends - lengths, len(ends)
    with pq.ParquetWriter(folder / _DATA_PATH.format(chunk_index=0, file_index=0), schema) as writer:
        for start, end in zip(starts.tolist(), ends.tolist(), strict=True):
            pictures = (frames.encoded_picture(index) for index in table.index[start:end])
            cells = {_CAMERA: [{"bytes": picture, "path": None} for picture in pictures]}
            cells |= {name: own[start:end].tolist() for name, own in values.items()}
            writer.write_table(pa.Table.from_pydict(cells, schema))
    task = f"press and drag: {frames.recipe.indenter.label} on gel {frames.name}"
    listed = {
        "episode_index": range(n),
        "tasks": [[task]] * n,
        "length": lengths,
        "data/chunk_index": [0] * n,
        "data/file_index": [0] * n,
        "dataset_from_index": starts,
        "dataset_to_index": ends,
        "meta/episodes/chunk_index": [0] * n,
        "meta/episodes/file_index": [0] * n,
    }
    pq.write_table(pa.table({name: list(own) for name, own in listed.items()}), folder / _EPISODES_PATH)
    pd.DataFrame({"task_index": [0]}, index=[task]).to_parquet(folder / "meta/tasks.parquet")
    width, height = frames.size_px
    picture = {"dtype": "image", "shape": [height, width, 3], "names": ["height", "width", "channels"]}
    features = {_CAMERA: picture} | {
        name: {"dtype": dtype, "shape": [values[name][0].size], "names": _VECTORS.get(name)}
        for name, dtype in dtypes.items()
    }
    info = {
        "codebase_version": LEROBOT_VERSION,
        "robot_type": "gelgap",
        "total_episodes": n,
        "total_frames": len(table),
        "total_tasks": 1,
        "chunks_size": 1000,
        "data_files_size_in_mb": _MOST_BYTES // 2**20,
        "video_files_size_in_mb": 200,
        "fps": FRAMES_PER_S,
        "splits": parts,
        "data_path": _DATA_PATH,
        "video_path": None,
        "features": features,
    }
    for name, content in (("info", info), ("stats", _lerobot_statistics(frames, table.index, values))):
        (folder / f"meta/{name}.json").write_text(json.dumps(content, indent=4), encoding="utf-8")


def _episodes(frames: GeneratedDomain) -> tuple[dict[str, str], "pd.DataFrame"]:
    """Return the range of episodes of each part, as `0:12`, and trajectory, step and episode of all frames in order."""
    import pandas as pd

    names = ("trajectory_id", "step", "split")
    table = pd.DataFrame({name: frames.columns[name] for name in names})
    split = table.groupby("trajectory_id")["split"]
    is_whole = split.transform("nunique") == 1
    table["split"] = pd.Categorical(table["split"].where(is_whole, PARTS[0]), PARTS)
    table = table.sort_values(["split", "trajectory_id", "step"])
    table["episode"] = table.groupby("trajectory_id", sort=False).ngroup()
    counts = table.groupby("split", observed=True)["episode"].nunique()
    if not is_whole.all():
        counts = pd.Series({PARTS[0]: counts.sum()})
    ends = counts.cumsum()
    return {part: f"{ends[part] - count}:{ends[part]}" for part, count in counts.items()}, table


def _lerobot_values(frames: GeneratedDomain, table: "pd.DataFrame") -> dict[str, np.ndarray]:
    """Return the features other than pictures, (n,) or (n, k) each, of the frames episode by episode."""
    order, n = table.index, len(table)
    state = frames.values_of(_POSE)[order]
    is_last = table["episode"].diff(-1).to_numpy() != 0
    action = np.where(is_last[:, None], state, np.roll(state, -1, axis=0))
    step = table.groupby("episode").cumcount().to_numpy()
    return {
        "observation.force": frames.force_n[order],
        "observation.state": state,
        "action": action,
        "timestamp": step / FRAMES_PER_S,
        "frame_index": step,
        "episode_index": table["episode"].to_numpy(),
        "index": np.arange(n),
        "task_index": np.zeros(n, np.int64),
    }


def _lerobot_statistics(
    frames: GeneratedDomain, order: Iterable[int], values: dict[str, np.ndarray]
) -> dict[str, Any]:
    """Return least, greatest, mean and standard deviation of each feature, pictures by channel in [0, 1]."""
    pixels = (frames.picture(index).reshape(-1, 3) / 255 for index in order)
    of_pictures = [
        (own.min(axis=0), own.max(axis=0), own.mean(axis=0), (own**2).mean(axis=0)) for own in pixels
    ]
    low, high, mean, square = map(np.stack, zip(*of_pictures, strict=True))
    average = mean.mean(axis=0)
    deviation = np.sqrt(np.maximum(square.mean(axis=0) - average**2, 0))
    by_channel = {"min": low.min(axis=0), "max": high.max(axis=0), "mean": average, "std": deviation}
    found = {_CAMERA: {name: value.reshape(3, 1, 1).tolist() for name, value in by_channel.items()}}
    for name, own in values.items():
        rows = np.ascontiguousarray(own.reshape(len(own), -1), float)
        found[name] = {what: getattr(rows, what)(axis=0).tolist() for what in ("min", "max", "mean", "std")}
    return {name: {**of, "count": [len(mean)]} for name, of in found.items()}
