"""Layouts of public tactile data and of robot learning: FEATS's, `yxma/gelsight-mini-pretrain`'s, LeRobot's v3.0.

FEATS (github.com/feats-ai/feats) names forces by its rig's axes: by its homography x points to the left in the picture
and y up, so that Fx and Fy have the other sign than gelgap's; `yxma/gelsight-mini-pretrain` has taken its forces over.
"""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from gelgap.domains.formats.pictures import encode_jpeg
from gelgap.domains.formats.shards import PICTURE
from gelgap.domains.frames.splits import PARTS, indices_by_part
from gelgap.domains.frames.stored import GeneratedDomain

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
_FORCE = ("fx_n", "fy_n", "fz_n")
_MOST_BYTES = 100 * 2**20
_CAMERA = "observation.images.tactile"
_DATA_PATH = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
_EPISODES_PATH = "meta/episodes/chunk-000/file-000.parquet"
_VECTORS = {"observation.force": _FORCE, "observation.state": _POSE, "action": _POSE}


def write_feats(domains: Sequence[GeneratedDomain], out_dir: Path) -> None:
    """`<domain>/{train,val,test}/<frame>.npy`, a dictionary a frame, and `<domain>/normalization.npy`.

    A dictionary in an `.npy` is a pickle, which FEATS's own reader loads as such. `grid_x`, `grid_y` and `grid_z`, the
    force on each of 24×32 cells of the view, are there if the domain was generated with `--columns traction`.
    """
    for frames in domains:
        bounds: dict[str, dict[str, float]] = {}
        for part, indices in indices_by_part(frames).items():
            folder = out_dir / frames.name / _FEATS_PARTS[part]
            folder.mkdir(parents=True)
            for index in indices:
                forces = (frames.force_n[index] * _FEATS_SIGNS + 0.0).tolist()
                label = {"gs_img": frames.picture(index)} | _feats_maps(frames, index)
                label |= dict(zip(("f_x", "f_y", "f_z"), forces, strict=True))
                np.save(folder / f"{int(frames.columns['frame_id'][index]):06d}.npy", label)
                if part == "train":
                    for name, value in label.items():
                        known = bounds.setdefault(name, {"min": np.inf, "max": -np.inf})
                        known["min"] = min(known["min"], float(np.min(value)))
                        known["max"] = max(known["max"], float(np.max(value)))
        np.save(out_dir / frames.name / "normalization.npy", bounds)


def _feats_maps(frames: GeneratedDomain, index: int) -> dict[str, np.ndarray]:
    from gelgap.sim.traction import COARSE_SHAPE

    if "traction" not in frames.optional_columns:
        return {}
    maps_n = frames.optional("traction", index).reshape(*COARSE_SHAPE, 3) * _FEATS_SIGNS + 0.0
    return {f"grid_{axis}": maps_n[..., k] for k, axis in enumerate("xyz")}


def write_mini_pretrain(domains: Sequence[GeneratedDomain], out_dir: Path) -> None:
    """`<domain>/<split>-00000-of-00001.parquet` in `MINI_SCHEMA`, with JPEG pictures; what is not known is null."""
    import pyarrow.parquet as pq

    for frames in domains:
        folder = out_dir / frames.name
        folder.mkdir()
        for part, indices in indices_by_part(frames).items():
            path = folder / f"{_FEATS_PARTS[part]}-00000-of-00001.parquet"
            with pq.ParquetWriter(path, MINI_SCHEMA, compression="snappy") as writer:
                for start in range(0, len(indices), 100):
                    rows = [_mini_row(frames, index, part) for index in indices[start : start + 100]]
                    writer.write_table(pa.Table.from_pylist(rows, MINI_SCHEMA))


def _mini_row(frames: GeneratedDomain, index: int, part: str) -> dict[str, Any]:
    columns, recipe = frames.columns, frames.recipe
    shape = recipe.indenter.shape
    force_n = frames.force_n[index] * _FEATS_SIGNS + 0.0
    width, height = frames.size_px
    return {
        "image": encode_jpeg(frames.picture(index), _MINI_JPEG_QUALITY),
        "image_format": "jpeg",
        "source": "gelgap",
        "markered": recipe.markers,
        "capture": f"{frames.name}_{int(columns['frame_id'][index]):06d}",
        "split": _FEATS_PARTS[part],
        "height": height,
        "width": width,
        "x_mm": columns["x_mm"][index],
        "y_mm": columns["y_mm"][index],
        "z_mm": columns["commanded_z_mm"][index],
        "indenter": shape,
        "indenter_param": recipe.indenter.label.removeprefix(shape).removesuffix("mm").strip(),
        **dict(zip(("f_x", "f_y", "f_z"), force_n.tolist(), strict=True)),
        "episode": str(int(columns["trajectory_id"][index])),
        "frame_idx": int(columns["step"][index]),
        "gel_variant": "markered" if recipe.markers else "markerless",
        "domain": "sim",
    }


def write_lerobot(domains: Sequence[GeneratedDomain], out_dir: Path) -> None:
    """`<domain>/{meta,data}` in LeRobot's format v3.0, pictures as PNG inside the Parquet files.

    An episode is a trajectory: a travel at one point, depth and direction. `action` is the next commanded pose, of the
    last frame its own. Episodes whose frames are of several parts of the split, as those of a random one, count as
    training.
    """
    for frames in domains:
        _write_lerobot_set(frames, out_dir / frames.name)


def _write_lerobot_set(frames: GeneratedDomain, folder: Path) -> None:
    import pandas as pd
    import pyarrow.parquet as pq

    parts, episodes = _episodes(frames)
    values = _lerobot_values(frames, episodes)
    dtypes = {name: "float32" if own.dtype.kind == "f" else "int64" for name, own in values.items()}
    types = {name: pa.list_(pa.float32(), len(labels)) for name, labels in _VECTORS.items()}
    schema = pa.schema([(_CAMERA, PICTURE), *(dtypes | types).items()])
    (folder / "meta/episodes/chunk-000").mkdir(parents=True)
    (folder / "data/chunk-000").mkdir(parents=True)
    task = f"press and drag: {frames.recipe.indenter.label} on gel {frames.name}"
    lengths = [len(own) for own in episodes]
    ends = np.cumsum(lengths).tolist()
    starts, n = [0, *ends[:-1]], len(episodes)
    files, writer, size = [], None, 0
    for indices, start, end in zip(episodes, starts, ends, strict=True):
        if writer is None or size > _MOST_BYTES:
            if writer is not None:
                writer.close()
            number, size = files[-1] + 1 if files else 0, 0
            path = folder / _DATA_PATH.format(chunk_index=0, file_index=number)
            writer = pq.ParquetWriter(path, schema)
        pictures = [frames.encoded_picture(index) for index in indices.tolist()]
        cells = {_CAMERA: [{"bytes": picture, "path": None} for picture in pictures]}
        cells |= {name: own[start:end].tolist() for name, own in values.items()}
        writer.write_table(pa.Table.from_pydict(cells, schema))
        size += sum(map(len, pictures))
        files.append(number)
    writer.close()
    listed = {
        "episode_index": list(range(n)),
        "tasks": [[task]] * n,
        "length": lengths,
        "data/chunk_index": [0] * n,
        "data/file_index": files,
        "dataset_from_index": starts,
        "dataset_to_index": ends,
        "meta/episodes/chunk_index": [0] * n,
        "meta/episodes/file_index": [0] * n,
    }
    pq.write_table(pa.table(listed), folder / _EPISODES_PATH)
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
        "total_frames": ends[-1],
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
    statistics = _lerobot_statistics(frames, np.concatenate(episodes), values)
    for name, content in (("info", info), ("stats", statistics)):
        (folder / f"meta/{name}.json").write_text(json.dumps(content, indent=4), encoding="utf-8")


def _episodes(frames: GeneratedDomain) -> tuple[dict[str, str], list[np.ndarray]]:
    """Return the range of episodes of each part, as `0:12`, and the indices of each episode's frames, part by part."""
    trajectory, step = frames.columns["trajectory_id"], frames.columns["step"]
    split = frames.columns["split"]
    of_part: dict[str, list[np.ndarray]] = {part: [] for part in PARTS}
    for number in np.unique(trajectory):
        indices = np.flatnonzero(trajectory == number)
        parts = set(split[indices].tolist())
        of_part[parts.pop() if len(parts) == 1 else PARTS[0]].append(indices[np.argsort(step[indices])])
    if any(len(set(split[own].tolist())) > 1 for own in of_part[PARTS[0]]):
        of_part = {PARTS[0]: [own for part in PARTS for own in of_part[part]]}
    ranges, start = {}, 0
    for part, own in of_part.items():
        if own:
            ranges[part] = f"{start}:{start + len(own)}"
            start += len(own)
    return ranges, [own for part in of_part.values() for own in part]


def _lerobot_values(frames: GeneratedDomain, episodes: Sequence[np.ndarray]) -> dict[str, np.ndarray]:
    """Return the features other than pictures, (n,) or (n, k) each, of the frames episode by episode."""
    order, lengths = np.concatenate(episodes), [len(own) for own in episodes]
    ends = np.cumsum(lengths)
    state = np.stack([frames.columns[name][order] for name in _POSE], axis=1)
    action = np.roll(state, -1, axis=0)
    action[ends - 1] = state[ends - 1]
    step = np.arange(len(order)) - np.repeat(ends - lengths, lengths)
    return {
        "observation.force": frames.force_n[order],
        "observation.state": state,
        "action": action,
        "timestamp": step / FRAMES_PER_S,
        "frame_index": step,
        "episode_index": np.repeat(np.arange(len(episodes)), lengths),
        "index": np.arange(len(order)),
        "task_index": np.zeros_like(order),
    }


def _lerobot_statistics(
    frames: GeneratedDomain, order: np.ndarray, values: dict[str, np.ndarray]
) -> dict[str, Any]:
    """Return least, greatest, mean and standard deviation of each feature, pictures by channel in [0, 1]."""
    pictures = []
    for index in order.tolist():
        pixels = frames.picture(index).reshape(-1, 3) / 255
        pictures.append(
            (pixels.min(axis=0), pixels.max(axis=0), pixels.mean(axis=0), (pixels**2).mean(axis=0))
        )
    low, high, mean, square = map(np.stack, zip(*pictures, strict=True))
    average = mean.mean(axis=0)
    deviation = np.sqrt(np.maximum(square.mean(axis=0) - average**2, 0))
    by_channel = {"min": low.min(axis=0), "max": high.max(axis=0), "mean": average, "std": deviation}
    found = {_CAMERA: {name: value.reshape(3, 1, 1).tolist() for name, value in by_channel.items()}}
    for name, own in values.items():
        rows = np.ascontiguousarray(own.reshape(len(own), -1), float)
        found[name] = {what: getattr(rows, what)(axis=0).tolist() for what in ("min", "max", "mean", "std")}
    return {name: {**of, "count": [len(order)]} for name, of in found.items()}
