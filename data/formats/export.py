"""A data set in other formats: the paper's folders, a folder for Hugging Face, arrays for skada.

Tests read each back with its own loader: `open_domain`, `datasets`, skada.
"""

import logging
import os
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Literal

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from gelgap.assets.names import quoted
from gelgap.assets.pages import html_page
from gelgap.data.formats.domain_folder import check_is_new, new_folder
from gelgap.data.formats.pictures import encode_jpeg, encode_png
from gelgap.data.formats.shards import OPTIONAL
from gelgap.data.frames.dataset import LabelledFrames
from gelgap.data.frames.folders import (
    PUBLISHED_FORCES,
    PUBLISHED_REFERENCE,
    UNSPLIT,
    domain_folders,
    open_domain,
)
from gelgap.data.frames.splits import PARTS, indices_by_part, split_frames, stated_split
from gelgap.data.frames.stored import GeneratedDomain

LOG = logging.getLogger(__name__)
_WITH_CARD = "huggingface"
_ABOUT = {
    "title": "Synthetic GelSight pictures with force labels",
    "description": "Made with gelgap: MuJoCo presses an indenter into a soft pad, a photometric renderer makes the "
    "sensor's picture. Nothing here was measured on a real sensor.",
}
LICENSE = "apache-2.0"
"""What an export's card states where nothing else is given: gelgap's own."""
Axis = Literal["x", "y", "z"]
# The numbers that skada itself gives a single source and a single target; their sign is what counts.
_SOURCE, _TARGET = 1, -2


def export(
    folder: Path | str,
    format_name: str,
    out_dir: Path | str,
    *,
    split_by: str | None = None,
    license: str | None = None,
) -> tuple[Path, ...]:
    """Write the domains at a path in another format and return what was written, one path per domain.

    `paper` is the published layout (JPEG pictures), `huggingface` one folder with a data card and one configuration per
    domain. Frames that did not converge are left out. Parts are
    those that the data set states, or drawn anew as `split_frames` draws them by `split_by`: `point` keeps each contact
    point in one part. `license` is what the card states, as Hugging Face names licences, by default `LICENSE`.

    Raises
    ------
    ValueError
        If the format is unknown or has no card for a licence, the licence is no identifier, the output exists, the
        format is only for generated domains or for one reference, or the split cannot be made.
    """
    if format_name == "webdataset":
        raise ValueError(
            "gelgap 0.3.0 was the last with format webdataset: huggingface is read frame by frame, too"
        )
    if format_name not in FORMATS:
        raise ValueError(f"format {quoted(format_name)} is unknown; known formats: {', '.join(FORMATS)}")
    if license is not None and format_name != _WITH_CARD:
        raise ValueError(f"license {quoted(license)} has no place in {format_name}; {_WITH_CARD} has one")
    if license is not None and not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9.+-]{1,63}", license):
        raise ValueError(f"license {quoted(license)} must be an identifier such as apache-2.0 or cc-by-4.0")
    out_dir = Path(out_dir)
    check_is_new(out_dir)
    domains = [open_domain(path) for path in domain_folders(folder)]
    others = [frames.name for frames in domains if not isinstance(frames, GeneratedDomain)]
    if others and format_name == _WITH_CARD:
        raise ValueError(f"data set {others[0]} is not in gelgap's format, which this export needs")
    if format_name == "paper" and (several := [own.name for own in domains if len(own.rest_pictures) > 1]):
        raise ValueError(f"data set {several[0]} has several references, paper one: make a data set of each")
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
        if format_name == _WITH_CARD:
            _describe(domains, license or LICENSE, building)
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
        table[rows].to_csv(
            forces / "force.csv",
            index=False,
            float_format=float.__repr__,
            na_rep="nan",
            lineterminator="\r\n",
        )
        for number, index in enumerate(np.flatnonzero(rows).tolist()):
            if part == UNSPLIT:
                (images / f"{number}.jpg").write_bytes(encode_jpeg(frames.picture(index)))
            else:
                # The same picture in two places takes its bytes once.
                os.link(folder / UNSPLIT / "images" / f"{index}.jpg", images / f"{number}.jpg")


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


def _describe(generated: Sequence[GeneratedDomain], license: str, out_dir: Path) -> None:
    """Write the data card that `datasets` reads."""
    used = {name for frames in generated for name in frames.optional_columns}
    card = html_page(
        "data-card.md",
        **_ABOUT,
        license=license,
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


FORMATS: dict[str, Callable[..., None]] = {
    "paper": _paper,
    "huggingface": _huggingface,
}
"""Export formats by name."""


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
