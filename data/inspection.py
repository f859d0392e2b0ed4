"""What a data set holds: counts, ranges, what is unusual, whether its files are intact, and one page that shows it."""

import contextlib
import io
import json
import logging
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gelgap.assets.image_file import decode_image, stated_size_px
from gelgap.assets.pages import html_page
from gelgap.assets.whole_file import write_whole
from gelgap.data.formats.domain_folder import MANIFEST, Damage, DomainFolder
from gelgap.data.formats.pictures import encode_png, mismatch
from gelgap.data.frames.dataset import LabelledFrames
from gelgap.data.frames.folders import PictureFiles, open_domain
from gelgap.data.frames.labels import QUANTITIES, Range, known_labels, usual_labels
from gelgap.data.frames.run_labels import outside
from gelgap.data.frames.stored import GeneratedDomain, StoredFrames
from gelgap.data.frames.tables import GROUPS

LOG = logging.getLogger(__name__)
_MOST_SAMPLES, _COMPARED = 14, 5
_SHARES = (0, 0.05, 0.5, 0.95, 1)
_COLOURS = ("#c1553b", "#3b7f54", "#35609f")


@dataclass(frozen=True)
class DomainSummary:
    """The facts of one domain: `frames` that can be read, and the least and the greatest value of each label.

    Both are 0 where no frame has a number. A generated domain's labels are its forces; `outside_range` counts frames
    with a label outside its range. `rows` are (what, value), as the command and the page show them.
    """

    folder: str
    name: str
    frames: int
    unconverged: int
    points: int
    classes: int
    labels: dict[str, Range]
    outside_range: int
    notes: tuple[str, ...]
    rows: tuple[tuple[str, str], ...]

    def __str__(self) -> str:
        rows = (f"  {what:8} {value}" for what, value in self.rows)
        return "\n".join([f"{self.name} ({self.folder})", *rows])


def inspect_domain(folder: Path | str) -> DomainSummary:
    """Return the facts of one domain.

    Raises
    ------
    FileNotFoundError, RuntimeError
        As `open_domain`.
    """
    frames = open_domain(folder)
    is_generated = isinstance(frames, GeneratedDomain)
    labels, told = {}, []
    for name in usual_labels(frames.columns) if is_generated else known_labels(frames.columns):
        values, (symbol, unit) = frames.columns[name], QUANTITIES[name]
        values = values[np.isfinite(values)] + 0.0 if np.isfinite(values).any() else np.zeros(1)
        low, high = labels[name] = float(values.min()), float(values.max())
        told.append(f"{symbol} {low:.3f}…{high:.3f} {unit}")
    notes = [*frames.notes, *frame_notes(frames)]
    # Generated pictures were compared with their manifest.
    if not is_generated and (damages := picture_damages(frames)):
        notes.append(f"{len(damages)} pictures cannot be used, see --verify; first: {damages[0]}")
    files = (path for path in Path(folder).rglob("*") if path.is_file() and ".cache" not in path.parts)
    (width, height), size_mb = frames.size_px, sum(path.stat().st_size for path in files) / 1e6
    points, classes = (len(np.unique(own[own >= 0])) for own in (frames.point_id, frames.contact_class))
    outside_range = int(outside(frames, frames.labels).sum()) if told else 0
    groups = [f"{len(set(frames.columns[name]))} of {name}" for name in GROUPS if name in frames.columns]
    columns = frames.optional_columns if isinstance(frames, GeneratedDomain) else ()
    rows = (
        (
            "frames",
            f"{len(frames)} of {width}×{height} px, {size_mb:.1f} MB; "
            f"{frames.unconverged} left out (not converged)",
        ),
        ("contacts", f"{points} points, {classes} classes"),
        (
            "labels",
            f"{', '.join(told)}; {outside_range} frames outside the declared range" if told else "none",
        ),
        *([("groups", ", ".join(groups))] if groups else []),
        ("columns", ", ".join(columns) or "none beyond the standard ones"),
        *(("note", note) for note in notes),
    )
    return DomainSummary(
        folder=str(folder),
        name=frames.name,
        frames=len(frames),
        unconverged=frames.unconverged,
        points=points,
        classes=classes,
        labels=labels,
        outside_range=outside_range,
        notes=tuple(notes),
        rows=rows,
    )


def verify_domain(folder: Path | str) -> tuple[Damage, ...]:
    """Return what is wrong with the files of a data set; empty if all is intact.

    Every byte of a generated domain is compared with its manifest, and what every picture states of itself with the
    reference. Of a folder of pictures every picture is decoded; its table was checked when it was opened.

    Raises
    ------
    FileNotFoundError
        If it is not a data set of a known layout.
    """
    files = DomainFolder(folder)
    if files.exists() or not files.path.is_dir():
        if damages := files.damages():
            return tuple(damages)
        # A manifest may vouch for bytes that no reader takes.
        try:
            problems = [str(damage) for damage in picture_damages(GeneratedDomain(folder))]
        except (RuntimeError, ValueError) as error:
            problems = [str(error).partition(": run the same")[0]]
        return tuple(Damage(MANIFEST, f"vouches for what cannot be used: {problem}") for problem in problems)
    frames = open_domain(folder)
    assert isinstance(frames, PictureFiles)
    found = []
    for path in frames.reference_paths:
        try:
            frames.rest_picture(path)
        except ValueError as error:
            problem = str(error).partition("; `gelgap")[0]
            found.append(Damage(str(path.relative_to(frames.folder)), problem))
    return (*picture_damages(frames, decode=True), *found)


def log_notes(data_sets: Iterable[LabelledFrames], further: Iterable[str] = ()) -> None:
    """Say once what is unusual about data sets, each by its name, and further sentences."""
    notes = [f"{own.name}: {note}" for own in data_sets for note in (*own.notes, *frame_notes(own))]
    for note in dict.fromkeys((*notes, *further)):
        LOG.warning("%s", note)


def frame_notes(frames: LabelledFrames) -> list[str]:
    """Return what is unusual about frames, in sentences: forces that pull, pictures that their reference is not of."""
    notes = []
    if pulling := int((frames.columns.get("fz_n", np.zeros(0)) > 0).sum()):
        notes.append(f"{pulling} frames have Fz > 0: the sensor is pulled, or the sign is another one")
    for index in np.linspace(0, len(frames) - 1, min(len(frames), _COMPARED)).astype(int):
        with contextlib.suppress(OSError, RuntimeError, ValueError):  # of damage others tell
            reference = frames.rest_pictures[frames.reference_id[index]]()
            if problem := mismatch(frames.picture(index), reference):
                return [*notes, f"{problem} (frame {index})"]
    return notes


def picture_damages(frames: StoredFrames, *, decode: bool = False) -> list[Damage]:
    """Return the pictures whose size differs from the reference's, or that cannot be decoded."""
    found = []
    try:
        width, height = frames.size_px
    except ValueError:  # The reference is unreadable, and sizes are not compared.
        width = height = 0
    for index in range(len(frames)):
        try:
            data = frames.encoded_picture(index)
            size_px = stated_size_px(data)
            if width and size_px != (width, height):
                raise ValueError(f"{size_px[0]}×{size_px[1]} px, the reference has {width}×{height} px")
            if decode:
                decode_image(data)
        except (OSError, ValueError) as error:
            found.append(Damage(frames.place_of(index), f"frame {index}: {error}"))
    return found


def write_overview(folder: Path | str, page: Path | str, gap: Mapping[str, Any] | None = None) -> Path:
    """Write the page of one domain; with the gap from another, `base` by name and `rows` of (what, value), that too.

    Raises
    ------
    FileNotFoundError, RuntimeError
        As `open_domain`.
    """
    frames = open_domain(folder)
    manifest = frames.manifest if isinstance(frames, GeneratedDomain) else None
    text = html_page(
        "overview.html",
        name=frames.name,
        summary=inspect_domain(folder),
        plots=_plots(frames) if known_labels(frames.columns) else None,
        label_quantiles=[
            (
                str(QUANTITIES[name]),
                *(f"{value:.3f}" for value in np.nanquantile(frames.columns[name], _SHARES)),
            )
            for name in usual_labels(frames.columns)
        ],
        samples=_samples(frames),
        gap=gap,
        folder=frames.folder,
        manifest=manifest,
        configuration=manifest and json.dumps(manifest["configuration"], indent=1, ensure_ascii=False),
        left_out=manifest and np.setdiff1d(np.arange(manifest["frames"]), frames.columns["frame_id"]),
    )
    page = Path(page)
    write_whole(page, text.encode())
    return page


def _plots(frames: LabelledFrames) -> bytes:
    """Return a histogram of each label and, where they are known, the places of the contacts, as PNG."""
    from matplotlib.figure import Figure

    labels, has_places = frames.labels, {"x_mm", "y_mm"} <= frames.columns.keys()
    figure = Figure(figsize=(10.5, 3.2), layout="constrained")
    panels = figure.subplots(1, len(labels) + has_places, squeeze=False)[0]
    for number, axes in enumerate(panels[: len(labels)]):
        axes.hist(frames.label_values[:, number], bins=50, color=_COLOURS[number % len(_COLOURS)])
        axes.axvspan(*labels.ranges[number], color="#000", alpha=0.05, zorder=0)
        symbol, unit = labels.quantities[number]
        axes.set(xlabel=f"{symbol} in {unit} (grey: declared range)", ylabel="frames")
    if has_places:
        x_mm, y_mm = (
            frames.columns[f"{axis}_mm"] + frames.columns.get(f"shear_{axis}_mm", 0.0) for axis in "xy"
        )
        panels[-1].scatter(x_mm, y_mm, s=2, color=_COLOURS[2])
        panels[-1].invert_yaxis()
        panels[-1].set(xlabel="x, mm", ylabel="y, mm (down)", aspect="equal")
    for axes in panels:
        axes.spines[["top", "right"]].set_visible(False)
    out = io.BytesIO()
    figure.savefig(out, format="png", dpi=110)
    return out.getvalue()


def _samples(frames: LabelledFrames) -> list[dict[str, bytes | str]]:
    """Return the reference and frames of evenly spread classes, or without classes of an evenly spread label."""
    names = usual_labels(frames.columns)
    order = np.argsort(frames.columns[names[-1]]) if names else np.arange(len(frames))
    if frames.has_classes:
        order = np.lexsort((frames.point_id, frames.contact_class))
    chosen = order[np.linspace(0, len(order) - 1, min(len(order), _MOST_SAMPLES)).astype(int)]
    shown: list[dict[str, bytes | str]] = [{"png": encode_png(frames.reference), "caption": "reference"}]
    for index in chosen.tolist():
        values = ", ".join(f"{frames.columns[name][index]:.2f}" for name in names) or f"frame {index}"
        units = ", ".join(dict.fromkeys(QUANTITIES[name].unit for name in names))
        caption = f"({values}) {units}" if len(names) > 1 else f"{values} {units}"
        if frames.contact_class[index] >= 0:
            caption = f"class {frames.contact_class[index]}: {caption}"
        shown.append({"png": encode_png(frames.picture(index)), "caption": caption})
    return shown
