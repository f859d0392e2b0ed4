"""A data set in other people's formats: the paper's folders, WebDataset tars, a folder ready for Hugging Face."""

import csv
import io
import json
import logging
import os
import tarfile
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gelgap.domains import published
from gelgap.domains.columns import OPTIONAL, Column
from gelgap.domains.croissant import write_croissant
from gelgap.domains.dataset import LabelledFrames
from gelgap.domains.generated import GeneratedDomain
from gelgap.domains.inspection import domain_folders, inspect_domain
from gelgap.domains.new_folder import check_is_new, new_folder
from gelgap.domains.opening import open_domain
from gelgap.domains.picture_codec import encode_jpeg, encode_png
from gelgap.domains.shard_file import ShardFile
from gelgap.domains.splits import PARTS
from gelgap.domains.stored import StoredFrames

LOG = logging.getLogger(__name__)
_SAMPLES_PER_TAR = 1000
_TITLE = "Synthetic GelSight pictures with force labels"
_WHAT_IT_IS = (
    "Made with gelgap: MuJoCo presses a sphere into a soft pad, a photometric renderer makes the sensor's picture. "
    "Nothing here was measured on a real sensor."
)
_LICENCE = "other"


def export(folder: Path | str, format_name: str, out_dir: Path | str) -> tuple[Path, ...]:
    """Write the domains at a path in another format and return what was written, one path per domain.

    `paper` is the published layout (JPEG pictures), `webdataset` tars of PNG and JSON, `huggingface` one folder with a
    data card, Croissant metadata and one configuration per domain. Frames that did not converge are left out.

    Raises
    ------
    ValueError
        If the format is unknown, or the output exists.
    """
    if format_name not in FORMATS:
        raise ValueError(f"format {format_name!r} is unknown; known formats: {', '.join(FORMATS)}")
    out_dir = Path(out_dir)
    check_is_new(out_dir)
    domains = [open_domain(path) for path in domain_folders(folder)]
    with new_folder(out_dir) as building:
        LOG.info("exporting %s to %s", ", ".join(frames.name for frames in domains), out_dir)
        FORMATS[format_name](domains, building)
    return tuple(out_dir / name for name in sorted(path.name for path in out_dir.iterdir()))


def _paper(domains: Iterable[LabelledFrames], out_dir: Path) -> None:
    """`ref.jpg`, and `{train,test,ori}/images/i.jpg` with `forcePosition/force.csv`; ori holds all frames in order."""
    for frames in domains:
        folder = out_dir / frames.name
        folder.mkdir()
        (folder / published.REFERENCE).write_bytes(encode_jpeg(frames.reference))
        unsplit = folder / published.UNSPLIT
        _paper_table(frames, unsplit, np.arange(len(frames)))
        for index in range(len(frames)):
            (unsplit / "images" / f"{index}.jpg").write_bytes(encode_jpeg(frames.picture(index)))
        is_test = _stated_split(frames) == "test"
        for part, members in {"train": ~is_test, "test": is_test}.items():
            indices = np.flatnonzero(members)
            if len(indices):
                _paper_table(frames, folder / part, indices)
                for number, frame in enumerate(indices):
                    # The same picture in two places takes its bytes once.
                    os.link(unsplit / "images" / f"{frame}.jpg", folder / part / "images" / f"{number}.jpg")


def _paper_table(frames: LabelledFrames, folder: Path, indices: np.ndarray) -> None:
    (folder / "images").mkdir(parents=True)
    (folder / "forcePosition").mkdir()
    with (folder / "forcePosition" / "force.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(
            [*published.PUBLISHED_FORCES, *([published.LABEL_COLUMN] if frames.has_classes else [])]
        )
        for index in indices:
            label = [int(frames.contact_class[index])] if frames.has_classes else []
            writer.writerow([*frames.force_n[index].tolist(), *label])


def _webdataset(domains: Iterable[StoredFrames], out_dir: Path) -> None:
    """`<domain>/<split>-000000.tar` of `<frame>.png` and `<frame>.json`, and `<domain>/reference.png` beside them."""
    for frames in domains:
        folder = out_dir / frames.name
        folder.mkdir()
        (folder / "reference.png").write_bytes(encode_png(frames.reference))
        for split, indices in _by_split(frames).items():
            for start in range(0, len(indices), _SAMPLES_PER_TAR):
                path = folder / f"{split}-{start // _SAMPLES_PER_TAR:06d}.tar"
                with tarfile.open(path, "w", format=tarfile.USTAR_FORMAT) as tar:
                    for index in indices[start : start + _SAMPLES_PER_TAR]:
                        name = f"{int(frames.columns['frame_id'][index]):06d}"
                        picture = frames.encoded_picture(int(index))
                        suffix = "png" if picture.startswith(b"\x89PNG") else "jpg"
                        labels = {column: _plain(values[index]) for column, values in frames.columns.items()}
                        _add(tar, f"{name}.{suffix}", picture)
                        _add(tar, f"{name}.json", json.dumps(labels).encode())


def _add(tar: tarfile.TarFile, name: str, data: bytes) -> None:
    entry = tarfile.TarInfo(name)
    entry.size = len(data)
    tar.addfile(entry, io.BytesIO(data))


def _plain(value: Any) -> Any:
    value = value.item() if isinstance(value, np.generic) else value
    return None if isinstance(value, float) and np.isnan(value) else value


def _stated_split(frames: LabelledFrames) -> np.ndarray:
    """Return the part (n,) of each frame; without a stated split all are for training."""
    return frames.columns.get("split", np.full(len(frames), "train", dtype=object))


def _by_split(frames: LabelledFrames) -> dict[str, np.ndarray]:
    split = _stated_split(frames)
    return {part: np.flatnonzero(split == part) for part in PARTS if (split == part).any()}


def _huggingface(domains: Iterable[LabelledFrames], out_dir: Path) -> None:
    """`<domain>/<split>-00000.parquet`, references, a data card that `datasets` reads, and `croissant.json`."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    domains = list(domains)
    for frames in domains:
        if not isinstance(frames, GeneratedDomain):
            raise ValueError(
                f"data set {frames.name} is not in gelgap's format; only generated domains are exported so"
            )
        folder = out_dir / frames.name
        folder.mkdir()
        (folder / "reference.png").write_bytes(encode_png(frames.reference))
        shards = [ShardFile(path) for path in frames.shard_paths]
        schema = shards[0].schema
        writers = {
            part: pq.ParquetWriter(folder / f"{part}-00000.parquet", schema, compression="zstd")
            for part in _by_split(frames)
        }
        for shard in shards:
            table = shard.table()
            for part, writer in writers.items():
                rows = table.filter(
                    pa.compute.and_(table["converged"], pa.compute.equal(table["split"], part))
                )
                writer.write_table(rows, row_group_size=100)
        for writer in writers.values():
            writer.close()
    (out_dir / "README.md").write_text(_data_card(domains), encoding="utf-8")
    write_croissant(out_dir, _TITLE, _WHAT_IT_IS, _LICENCE)


def _data_card(domains: list[GeneratedDomain]) -> str:
    front = [
        "---",
        f"license: {_LICENCE}",
        "tags: [tactile, gelsight, simulation, force-estimation, domain-adaptation]",
    ]
    front += ["task_categories: [robotics]", "configs:"]
    for frames in domains:
        front += [f"- config_name: {frames.name}", "  data_files:"]
        for part in _by_split(frames):
            front += [f"  - split: {part}", f"    path: {frames.name}/{part}-*.parquet"]
    front += ["---", ""]
    rows = []
    for frames in domains:
        facts, recipe = inspect_domain(frames.folder), frames.recipe
        span = " / ".join(
            f"{low:.2f}…{high:.2f}" for low, high in zip(facts.force_min_n, facts.force_max_n, strict=True)
        )
        rows.append(
            f"| {frames.name} | {facts.frames} | {facts.unconverged} | {recipe.elastomer.young_modulus_mpa:g} MPa | "
            f"{recipe.illumination.name} | {'yes' if recipe.markers else 'no'} | {span} |"
        )
    versions = ", ".join(f"{name} {number}" for name, number in domains[0].manifest["versions"].items())
    text = [
        f"# {_TITLE}",
        "",
        _WHAT_IT_IS,
        "",
        "| domain | frames | left out (not converged) | Young's modulus | illumination | markers | Fx / Fy / Fz in N |",
        "|---|---|---|---|---|---|---|",
        *rows,
        "",
        "Columns: `image`, forces `fx_n, fy_n, fz_n` in N (of the indenter on the sensor; pressing gives Fz < 0), the "
        "commanded contact `x_mm, y_mm, depth_mm, radius_mm, angle_deg, shear_x_mm, shear_y_mm`, `contact_class` (0 is "
        "without contact), `point_id`, `trajectory_id`, `step`. x points right and y down in the picture. "
        "`reference.png` in each folder is the picture without contact.",
        *_optional_columns(domains),
        "",
        "The split is random by seed; neighbouring poses look alike, so split by `point_id` for an honest test.",
        "",
        f"Versions: {versions}.",
        "",
    ]
    return "\n".join([*front, *text])


def _optional_columns(domains: list[GeneratedDomain]) -> list[str]:
    """Return what the card says of optional columns: the height map's scale is in no other file of the export."""
    used = {name for frames in domains for name in frames.optional_columns}
    told = [_described(columns) for name, columns in OPTIONAL.items() if name in used]
    return ["", f"Optional columns, where a domain has them: {'; '.join(told)}."] if told else []


def _described(columns: Sequence[Column]) -> str:
    unit = f" ({columns[0].unit})" if columns[0].unit else ""
    return f"{', '.join(f'`{column.name}`' for column in columns)}{unit}: {columns[0].meaning}"


FORMATS: dict[str, Callable[[Iterable[StoredFrames], Path], None]] = {
    "paper": _paper,
    "webdataset": _webdataset,
    "huggingface": _huggingface,
}
"""Export formats by name."""
