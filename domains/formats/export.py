"""A data set in other formats: the paper's folders, WebDataset tars, a folder for Hugging Face, arrays for skada.

Those of other tactile data sets and of robot learning are in `public_layouts`.
"""

import csv
import io
import json
import logging
import os
import tarfile
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
import pyarrow as pa

from gelgap.assets import html_page
from gelgap.assets.checksums import file_sha256
from gelgap.domains.formats.domain_folder import check_is_new, new_folder
from gelgap.domains.formats.pictures import encode_jpeg, encode_png
from gelgap.domains.formats.public_layouts import write_feats, write_lerobot, write_mini_pretrain
from gelgap.domains.formats.shards import COLUMNS, FORCES, OPTIONAL, PICTURE, POINTS, SCHEMA_VERSION
from gelgap.domains.frames.dataset import LabelledFrames
from gelgap.domains.frames.folders import (
    PUBLISHED_FORCES,
    PUBLISHED_LABEL,
    PUBLISHED_REFERENCE,
    UNSPLIT,
    open_domain,
)
from gelgap.domains.frames.splits import PARTS, indices_by_part, split_frames, stated_split
from gelgap.domains.frames.stored import GeneratedDomain, StoredFrames
from gelgap.domains.inspection import domain_folders, inspect_domain

LOG = logging.getLogger(__name__)
_SAMPLES_PER_TAR = 1000
_ABOUT = {
    "title": "Synthetic GelSight pictures with force labels",
    "description": "Made with gelgap: MuJoCo presses a sphere into a soft pad, a photometric renderer makes the "
    "sensor's picture. Nothing here was measured on a real sensor.",
    "licence": "other",
}
_CROISSANT_TYPES = {
    pa.int32(): "sc:Integer",
    pa.float64(): "sc:Float",
    pa.bool_(): "sc:Boolean",
    pa.string(): "sc:Text",
    PICTURE: "sc:ImageObject",
    POINTS: "sc:Float",
    FORCES: "sc:Float",
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
            frames.columns["split"] = _drawn_split(frames, split_by)
    with new_folder(out_dir) as building:
        LOG.info("exporting %s to %s", ", ".join(frames.name for frames in domains), out_dir)
        FORMATS[format_name](domains, building)
    return tuple(out_dir / name for name in sorted(path.name for path in out_dir.iterdir()))


def _paper(domains: Iterable[LabelledFrames], out_dir: Path) -> None:
    """`ref.jpg`, and `{train,test,ori}/images/i.jpg` with `forcePosition/force.csv`; ori holds all frames in order."""
    for frames in domains:
        folder = out_dir / frames.name
        folder.mkdir()
        (folder / PUBLISHED_REFERENCE).write_bytes(encode_jpeg(frames.reference))
        header, values = [*PUBLISHED_FORCES], frames.force_n.tolist()
        if frames.has_classes:
            header.append(PUBLISHED_LABEL)
            values = [[*own, int(label)] for own, label in zip(values, frames.contact_class, strict=True)]
        is_test = stated_split(frames) == "test"
        parts = {
            UNSPLIT: np.arange(len(frames)),
            "train": np.flatnonzero(~is_test),
            "test": np.flatnonzero(is_test),
        }
        for part, indices in parts.items():
            if part != UNSPLIT and not len(indices):
                continue
            for inside in ("images", "forcePosition"):
                (folder / part / inside).mkdir(parents=True)
            with (folder / part / "forcePosition" / "force.csv").open(
                "w", newline="", encoding="utf-8"
            ) as file:
                csv.writer(file).writerows([header, *(values[index] for index in indices)])
            for number, index in enumerate(indices):
                picture = folder / part / "images" / f"{number}.jpg"
                if part == UNSPLIT:
                    picture.write_bytes(encode_jpeg(frames.picture(int(index))))
                else:
                    # The same picture in two places takes its bytes once.
                    os.link(folder / UNSPLIT / "images" / f"{index}.jpg", picture)


def _webdataset(domains: Iterable[StoredFrames], out_dir: Path) -> None:
    """`<domain>/<split>-000000.tar` of `<frame>.png` and `<frame>.json`, and `<domain>/reference.png` beside them."""
    for frames in domains:
        folder = out_dir / frames.name
        folder.mkdir()
        (folder / "reference.png").write_bytes(encode_png(frames.reference))
        for split, indices in indices_by_part(frames).items():
            for start in range(0, len(indices), _SAMPLES_PER_TAR):
                path = folder / f"{split}-{start // _SAMPLES_PER_TAR:06d}.tar"
                with tarfile.open(path, "w", format=tarfile.USTAR_FORMAT) as tar:
                    for index in indices[start : start + _SAMPLES_PER_TAR]:
                        name = f"{int(frames.columns['frame_id'][index]):06d}"
                        picture = frames.encoded_picture(int(index))
                        suffix = "png" if picture.startswith(b"\x89PNG") else "jpg"
                        labels = {
                            column: _plain_json(values[index]) for column, values in frames.columns.items()
                        }
                        _add(tar, f"{name}.{suffix}", picture)
                        _add(tar, f"{name}.json", json.dumps(labels).encode())


def _add(tar: tarfile.TarFile, name: str, data: bytes) -> None:
    entry = tarfile.TarInfo(name)
    entry.size = len(data)
    tar.addfile(entry, io.BytesIO(data))


def _plain_json(value: Any) -> Any:
    value = value.item() if isinstance(value, np.generic) else value
    return None if isinstance(value, float) and np.isnan(value) else value


def _drawn_split(frames: LabelledFrames, by: str) -> np.ndarray:
    split = np.empty(len(frames), dtype=object)
    for part, indices in zip(PARTS, split_frames(frames, by), strict=True):
        split[indices] = part
    return split


def _huggingface(generated: Sequence[GeneratedDomain], out_dir: Path) -> None:
    """`<domain>/<split>-00000.parquet`, references, a data card that `datasets` reads, and `croissant.json`."""
    import pyarrow.parquet as pq

    for frames in generated:
        folder = out_dir / frames.name
        folder.mkdir()
        (folder / "reference.png").write_bytes(encode_png(frames.reference))
        writers = {
            part: pq.ParquetWriter(
                folder / f"{part}-00000.parquet", frames.shards[0].schema, compression="zstd"
            )
            for part in indices_by_part(frames)
        }
        part_of = dict(zip(frames.columns["frame_id"].tolist(), stated_split(frames).tolist(), strict=True))
        for table in (shard.table() for shard in frames.shards):
            table = table.filter(table["converged"])
            split = pa.array([part_of[frame] for frame in table["frame_id"].to_pylist()], pa.string())
            table = table.set_column(
                table.schema.get_field_index("split"), table.schema.field("split"), split
            )
            for part, writer in writers.items():
                writer.write_table(table.filter(pa.compute.equal(table["split"], part)), row_group_size=100)
        for writer in writers.values():
            writer.close()
    used = {name for frames in generated for name in frames.optional_columns}
    card = html_page(
        "data-card.md",
        **_ABOUT,
        domains=[
            (frames, inspect_domain(frames.folder), list(indices_by_part(frames))) for frames in generated
        ],
        # The height map's scale is in no other file of the export.
        optional=[columns for name, columns in OPTIONAL.items() if name in used],
        points_apart=all(map(_keeps_points_apart, generated)),
        versions=generated[0].manifest["versions"],
    )
    (out_dir / "README.md").write_text(f"{card}\n", encoding="utf-8")
    (out_dir / "croissant.json").write_text(_croissant(out_dir), encoding="utf-8")


def _keeps_points_apart(frames: GeneratedDomain) -> bool:
    """Return whether every contact point is in one part of the split."""
    pairs = set(zip(frames.point_id.tolist(), stated_split(frames).tolist(), strict=True))
    return len(pairs) == len(np.unique(frames.point_id))


def _croissant(folder: Path) -> str:
    """Return JSON-LD by which other tools find the export's files, columns, types and units.

    Format: https://docs.mlcommons.org/croissant/docs/croissant-spec.html, version 1.0.
    """
    import pyarrow.parquet as pq

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
        types=_CROISSANT_TYPES,
        picture=PICTURE,
        lists=(POINTS, FORCES),
    )
    return json.dumps(json.loads(text), indent=1, ensure_ascii=False) + "\n"


FORMATS: dict[str, Callable[..., None]] = {
    "paper": _paper,
    "webdataset": _webdataset,
    "huggingface": _huggingface,
    "feats": write_feats,
    "mini-pretrain": write_mini_pretrain,
    "lerobot-v3": write_lerobot,
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
        If the axis is unknown, or the pictures of the domains are reduced to different sizes.
    """
    if axis not in get_args(Axis):
        raise ValueError(f"axis {axis!r} is unknown; known: {', '.join(get_args(Axis))}")
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
