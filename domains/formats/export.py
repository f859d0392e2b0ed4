"""A data set in other formats: the paper's folders, WebDataset tars, a folder for Hugging Face, arrays for skada.

And the layouts of public tactile data and of robot learning: FEATS's, `yxma/gelsight-mini-pretrain`'s, LeRobot's v3.0.
FEATS (github.com/feats-ai/feats) names forces by its rig's axes: by its homography x points to the left in the picture
and y up, so that Fx and Fy have the other sign than gelgap's; `yxma/gelsight-mini-pretrain` has taken its forces over.
"""

import io
import json
import logging
import os
import tarfile
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from gelgap.assets import html_page
from gelgap.assets.checksums import file_sha256
from gelgap.domains.formats.domain_folder import check_is_new, new_folder
from gelgap.domains.formats.pictures import encode_jpeg, encode_png
from gelgap.domains.formats.shards import COLUMNS, FORCES, KINDS, OPTIONAL, PICTURE, POINTS, SCHEMA_VERSION
from gelgap.domains.frames.dataset import LabelledFrames
from gelgap.domains.frames.folders import (
    PUBLISHED_FORCES,
    PUBLISHED_REFERENCE,
    UNSPLIT,
    domain_folders,
    open_domain,
)
from gelgap.domains.frames.labels import FORCE_COLUMNS
from gelgap.domains.frames.splits import PARTS, indices_by_part, split_frames, stated_split
from gelgap.domains.frames.stored import GeneratedDomain, StoredFrames

LOG = logging.getLogger(__name__)
_SAMPLES_PER_TAR = 1000
_ABOUT = {
    "title": "Synthetic GelSight pictures with force labels",
    "description": "Made with gelgap: MuJoCo presses a sphere into a soft pad, a photometric renderer makes the "
    "sensor's picture. Nothing here was measured on a real sensor.",
    "licence": "other",
}
_CROISSANT_FORMATS = {".parquet": "application/x-parquet", ".png": "image/png"}
Axis = Literal["x", "y", "z"]
# The numbers that skada itself gives a single source and a single target; their sign is what counts.
_SOURCE, _TARGET = 1, -2


def export(
    folder: Path | str, format_name: str, out_dir: Path | str, *, split_by: str | None = None
) -> tuple[Path, ...]:
    """Write the domains at a path in another format and return what was written, one path per domain.

    `paper` is the published layout (JPEG pictures), `webdataset` tars of PNG and JSON, `huggingface` one folder with a
    data card, Croissant metadata and one configuration per domain, `feats` FEATS's dictionaries, `mini-pretrain`
    Parquet in the columns of the Hugging Face set yxma/gelsight-mini-pretrain, `lerobot-v3` LeRobot's format v3.0.
    Frames that did not converge are left out. Parts are those that the data set states, or drawn anew as `split_frames`
    draws them by `split_by`: `point` keeps each contact point in one part.

    Raises
    ------
    ValueError
        If the format is unknown, the output exists, the format is only for generated domains, or the split cannot be
        made.
    """
    if format_name not in FORMATS:
        raise ValueError(f"format {format_name!r} is unknown; known formats: {', '.join(FORMATS)}")
    out_dir = Path(out_dir)
    check_is_new(out_dir)
    domains = [open_domain(path) for path in domain_folders(folder)]
    others = [frames.name for frames in domains if not isinstance(frames, GeneratedDomain)]
    if others and format_name in _OF_GENERATED:
        raise ValueError(
            f"data set {others[0]} is not in gelgap's format; only generated domains are exported so"
        )
    if split_by is not None:
        for frames in domains:
            split = np.empty(len(frames), dtype=object)
            for part, indices in zip(PARTS, split_frames(frames, split_by), strict=True):
                split[indices] = part
            frames.columns["split"] = split
    with new_folder(out_dir) as building:
        LOG.info("exporting %s to %s", ", ".join(frames.name for frames in domains), out_dir)
        for frames in domains:
            (building / frames.name).mkdir()
            FORMATS[format_name](frames, building / frames.name)
        if format_name == "huggingface":
            _describe(domains, building)
    return tuple(sorted(out_dir.iterdir()))


def _paper(frames: LabelledFrames, folder: Path) -> None:
    """`ref.jpg`, and `{train,test,ori}/images/i.jpg` with `forcePosition/force.csv`; ori holds all frames in order."""
    (folder / PUBLISHED_REFERENCE).write_bytes(encode_jpeg(frames.reference))
    table = pd.DataFrame(frames.force_n, columns=PUBLISHED_FORCES)
    if frames.has_classes:
        table["label"] = frames.contact_class
    is_test = stated_split(frames) == "test"
    for part, rows in {UNSPLIT: is_test | ~is_test, "train": ~is_test, "test": is_test}.items():
        if not rows.any():
            continue
        images, forces = folder / part / "images", folder / part / "forcePosition"
        images.mkdir(parents=True)
        forces.mkdir()
        # Every digit, also where another package has set how NumPy writes its numbers.
        digits = {"float_format": float.__repr__, "na_rep": "nan", "lineterminator": "\r\n"}
        table[rows].to_csv(forces / "force.csv", index=False, **digits)
        for number, index in enumerate(np.flatnonzero(rows).tolist()):
            if part == UNSPLIT:
                (images / f"{number}.jpg").write_bytes(encode_jpeg(frames.picture(index)))
            else:
                # The same picture in two places takes its bytes once.
                os.link(folder / UNSPLIT / "images" / f"{index}.jpg", images / f"{number}.jpg")


def _webdataset(frames: StoredFrames, folder: Path) -> None:
    """`<split>-000000.tar` of `<frame>.png` and `<frame>.json`, and `reference.png` beside them."""
    (folder / "reference.png").write_bytes(encode_png(frames.reference))
    columns = {name: values.tolist() for name, values in frames.columns.items()}
    for split, indices in indices_by_part(frames).items():
        for start in range(0, len(indices), _SAMPLES_PER_TAR):
            path = folder / f"{split}-{start // _SAMPLES_PER_TAR:06d}.tar"
            with tarfile.open(path, "w", format=tarfile.USTAR_FORMAT) as tar:
                for index in indices[start : start + _SAMPLES_PER_TAR].tolist():
                    values = ((name, of_frames[index]) for name, of_frames in columns.items())
                    # JSON has no NaN, which alone differs from itself.
                    labels = {name: value if value == value else None for name, value in values}
                    picture = frames.encoded_picture(index)
                    suffix = "png" if picture.startswith(b"\x89PNG") else "jpg"
                    for ending, data in ((suffix, picture), ("json", json.dumps(labels).encode())):
                        entry = tarfile.TarInfo(f"{int(labels['frame_id']):06d}.{ending}")
                        entry.size = len(data)
                        tar.addfile(entry, io.BytesIO(data))


def _huggingface(frames: GeneratedDomain, folder: Path) -> None:
    """`<split>-00000.parquet` and `reference.png`, of which `_describe` tells `datasets`."""
    (folder / "reference.png").write_bytes(encode_png(frames.reference))
    schema, split, start = frames.shards[0].schema, pa.array(stated_split(frames), pa.string()), 0
    writers = {
        part: pq.ParquetWriter(folder / f"{part}-00000.parquet", schema, compression="zstd")
        for part in indices_by_part(frames)
    }
    for shard in frames.shards:
        table = shard.table()
        table = table.filter(table["converged"])
        own, start = split.slice(start, len(table)), start + len(table)
        table = table.set_column(schema.get_field_index("split"), schema.field("split"), own)
        for part, writer in writers.items():
            writer.write_table(table.filter(pa.compute.equal(own, part)), row_group_size=100)
    for writer in writers.values():
        writer.close()


def _describe(generated: Sequence[GeneratedDomain], out_dir: Path) -> None:
    """Write the data card that `datasets` reads, and `croissant.json`."""
    used = {name for frames in generated for name in frames.optional_columns}
    card = html_page(
        "data-card.md",
        **_ABOUT,
        domains=[(frames, list(indices_by_part(frames))) for frames in generated],
        # The height map's scale is in no other file of the export.
        optional=[columns for name, columns in OPTIONAL.items() if name in used],
        points_apart=all(
            pd.Series(stated_split(frames)).groupby(frames.point_id).nunique().max() == 1
            for frames in generated
        ),
        versions=generated[0].manifest["versions"],
    )
    (out_dir / "README.md").write_text(f"{card}\n", encoding="utf-8")
    (out_dir / "croissant.json").write_text(_croissant(out_dir), encoding="utf-8")


def _croissant(folder: Path) -> str:
    """Return JSON-LD by which other tools find the export's files, columns, types and units.

    Format: https://docs.mlcommons.org/croissant/docs/croissant-spec.html, version 1.0.
    """
    files = [
        {
            "name": path.relative_to(folder).as_posix(),
            "domain": path.parent.name,
            "part": path.stem.partition("-")[0],
            "bytes": path.stat().st_size,
            "format": _CROISSANT_FORMATS[path.suffix],
            "sha256": file_sha256(path),
            "columns": [COLUMNS[column] for column in pq.read_schema(path).names]
            if path.suffix == ".parquet"
            else [],
        }
        for path in sorted(folder.glob("*/*"))
        if path.suffix in _CROISSANT_FORMATS
    ]
    text = html_page(
        "croissant.json",
        **_ABOUT,
        schema_version=SCHEMA_VERSION,
        files=files,
        kinds=KINDS,
        picture=PICTURE,
        lists=(POINTS, FORCES),
    )
    return json.dumps(json.loads(text), indent=1, ensure_ascii=False) + "\n"


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
_CAMERA = "observation.images.tactile"
_MOST_BYTES = 100 * 2**20
_DATA_PATH = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
_VECTORS = {"observation.force": FORCE_COLUMNS, "observation.state": _POSE, "action": _POSE}


def _feats(frames: GeneratedDomain, folder: Path) -> None:
    """`{train,val,test}/<frame>.npy`, a dictionary a frame, and `normalization.npy`.

    A dictionary in an `.npy` is a pickle, which FEATS's own reader loads as such. `grid_x`, `grid_y` and `grid_z`, the
    force on each of 24×32 cells of the view and a margin, are there if the domain has the column `traction`.
    """
    forces_n, bounds = _feats_forces_n(frames), dict[str, dict[str, float]]()
    for part, indices in indices_by_part(frames).items():
        (folder / _FEATS_PARTS[part]).mkdir()
        for index in indices.tolist():
            label = {"gs_img": frames.picture(index)}
            if "traction" in frames.optional_columns:
                maps_n = frames.traction_map_n(index) * _FEATS_SIGNS + 0.0
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


def _mini_pretrain(frames: GeneratedDomain, folder: Path) -> None:
    """`<split>-00000-of-00001.parquet` in `MINI_SCHEMA`, with JPEG pictures; what is not known is null."""
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


def _lerobot(frames: GeneratedDomain, folder: Path) -> None:
    """`{meta,data}` in LeRobot's format v3.0, pictures as PNG inside the Parquet files.

    An episode is a trajectory: a travel at one point, depth and direction. `action` is the next commanded pose, of the
    last frame its own. Episodes whose frames are of several parts of the split, as those of a random one, count as
    training.
    """
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
    # An episode is in the file that its first frame falls into; frames take about as much as each other.
    shard_bytes = sum(entry["bytes"] for entry in frames.manifest["files"].values())
    _, files = np.unique(starts * shard_bytes // len(table) // _MOST_BYTES, return_inverse=True)
    for number in range(files[-1] + 1):
        path, own = folder / _DATA_PATH.format(chunk_index=0, file_index=number), files == number
        with pq.ParquetWriter(path, schema) as writer:
            for start, end in zip(starts[own].tolist(), ends[own].tolist(), strict=True):
                pictures = (frames.encoded_picture(index) for index in table.index[start:end])
                cells = {_CAMERA: [{"bytes": picture, "path": None} for picture in pictures]}
                cells |= {name: of_frames[start:end].tolist() for name, of_frames in values.items()}
                writer.write_table(pa.Table.from_pydict(cells, schema))
    task = f"press and drag: {frames.recipe.indenter.label} on gel {frames.name}"
    listed = {
        "episode_index": range(n),
        "tasks": [[task]] * n,
        "length": lengths,
        "data/chunk_index": [0] * n,
        "data/file_index": files,
        "dataset_from_index": starts,
        "dataset_to_index": ends,
        "meta/episodes/chunk_index": [0] * n,
        "meta/episodes/file_index": [0] * n,
    }
    episodes = pa.table({name: list(own) for name, own in listed.items()})
    pq.write_table(episodes, folder / "meta/episodes/chunk-000/file-000.parquet")
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


def _episodes(frames: GeneratedDomain) -> tuple[dict[str, str], pd.DataFrame]:
    """Return the range of episodes of each part, as `0:12`, and trajectory, step and episode of all frames in order."""
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
    ranges = zip(counts.index, ends - counts, ends, strict=True)
    return {str(part): f"{start}:{end}" for part, start, end in ranges}, table


def _lerobot_values(frames: GeneratedDomain, table: pd.DataFrame) -> dict[str, np.ndarray]:
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


FORMATS: dict[str, Callable[..., None]] = {
    "paper": _paper,
    "webdataset": _webdataset,
    "huggingface": _huggingface,
    "feats": _feats,
    "mini-pretrain": _mini_pretrain,
    "lerobot-v3": _lerobot,
}
"""Export formats by name."""
_OF_GENERATED = ("huggingface", "feats", "mini-pretrain", "lerobot-v3")


def to_skada(
    source: LabelledFrames,
    target: LabelledFrames,
    axis: Axis,
    size_px: int | tuple[int, int] = 16,
    mask_target_labels: bool = True,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return X, y and sample_domain of a source's frames, followed by a target's, for one axis of the force.

    These are the arrays of skada, the library for domain adaptation in scikit-learn's manner.

    Parameters
    ----------
    source, target
        The domains, or some of their frames.
    axis
        Whose force is the label: skada takes labels of one dimension only.
    size_px
        Size of the reduced pictures: the longer side, or width and height.
    mask_target_labels
        Whether the target's labels are hidden, as training without them needs; to evaluate, they are given.

    Returns
    -------
    X
        (n, height·width·3) float32: each picture less its reference picture, in [−1, 1], pixels row by row.
    y
        (n,) float64, force in N; NaN where masked, by which skada tells regression from classification.
    sample_domain
        (n,) integers, positive for the source and negative for the target.

    Raises
    ------
    ValueError
        If a domain has no such force, or the pictures of the domains are reduced to different sizes.
    """
    sizes = [frames.image_size_px(size_px) for frames in (source, target)]
    if sizes[0] != sizes[1]:
        (w0, h0), (w1, h1) = sizes
        raise ValueError(
            f"pictures of {source.name} and {target.name} become {w0}×{h0} and {w1}×{h1} px with size_px = {size_px}; "
            f"give size_px as width and height"
        )
    differences, forces_n = [], []
    for frames in (source, target):
        rest = frames.references_at(sizes[0])[frames.reference_id]
        difference = np.subtract(frames.images(sizes[0]), rest, dtype=np.float32)
        differences.append(difference.reshape(len(frames), -1) / 255)
        forces_n.append(frames.values_of((f"f{axis}_n",))[:, 0])
    if mask_target_labels:
        forces_n[1] = np.full(len(target), np.nan)
    return (
        np.concatenate(differences),
        np.concatenate(forces_n).astype(np.float64),
        np.repeat([_SOURCE, _TARGET], [len(source), len(target)]),
    )
