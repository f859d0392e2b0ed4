"""What a data set holds: counts, ranges, what is unusual, whether its files are intact, and one page that shows it."""

import base64
import io
import json
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from gelgap.assets import html_page
from gelgap.domains.formats.domain_folder import MANIFEST, Damage, DomainFolder
from gelgap.domains.formats.pictures import decode_picture, encode_png, stated_size_px
from gelgap.domains.frames.dataset import LabelledFrames, outside
from gelgap.domains.frames.folders import GROUPS, PictureFiles, open_domain
from gelgap.domains.frames.labels import (
    FORCE_COLUMNS,
    QUANTITIES,
    Labels,
    Range,
    known_labels,
    usual_labels,
)
from gelgap.domains.frames.splits import paired_contacts
from gelgap.domains.frames.stored import GeneratedDomain, StoredFrames
from gelgap.domains.sweep import domain_gap, unseen_differences

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_COLOURS = ("#c1553b", "#3b7f54", "#35609f")


@dataclass(frozen=True)
class LabelFacts:
    """A label's name, its range, and the extremes found (0 where no frame has a number)."""

    name: str
    range: Range
    smallest: float
    largest: float

    def __str__(self) -> str:
        return f"{QUANTITIES[self.name].symbol} {self.smallest:.3f}…{self.largest:.3f}"


@dataclass(frozen=True)
class DomainSummary:
    """The facts of one domain: `frames` that can be read, and its labels with their ranges and extremes.

    A generated domain's labels are its forces; `outside_range` counts frames with a label outside its range.
    """

    folder: str
    name: str
    frames: int
    unconverged: int
    size_px: tuple[int, int]
    points: int
    classes: int
    groups: tuple[tuple[str, int], ...]
    labels: tuple[LabelFacts, ...]
    outside_range: int
    optional_columns: tuple[str, ...]
    bytes: int
    notes: tuple[str, ...]

    @property
    def force_min_n(self) -> tuple[float, ...]:
        """The lowest force along each axis that there is, N."""
        return tuple(facts.smallest for facts in self.labels if facts.name in FORCE_COLUMNS)

    @property
    def force_max_n(self) -> tuple[float, ...]:
        """The highest force along each axis that there is, N."""
        return tuple(facts.largest for facts in self.labels if facts.name in FORCE_COLUMNS)

    def __str__(self) -> str:
        forces = [str(facts) for facts in self.labels if facts.name in FORCE_COLUMNS]
        others = [
            f"{facts} {QUANTITIES[facts.name].unit}"
            for facts in self.labels
            if facts.name not in FORCE_COLUMNS
        ]
        outside_range = f"; {self.outside_range} frames outside the declared range"
        lines = [
            f"{self.name} ({self.folder})",
            f"  frames   {self.frames} of {self.size_px[0]}×{self.size_px[1]} px, {self.bytes / 1e6:.1f} MB; "
            f"{self.unconverged} left out (not converged)",
            f"  contacts {self.points} points, {self.classes} classes",
        ]
        if forces:
            lines.append(f"  forces   {', '.join(forces)} N{outside_range}")
        if others:
            lines.append(f"  labels   {', '.join(others)}{'' if forces else outside_range}")
        if self.groups:
            lines.append(f"  groups   {', '.join(f'{count} of {name}' for name, count in self.groups)}")
        lines.append(f"  columns  {', '.join(self.optional_columns) or 'none beyond the standard ones'}")
        return "\n".join([*lines, *(f"  note     {note}" for note in self.notes)])


def domain_folders(folder: Path | str) -> tuple[Path, ...]:
    """Return the domain folders at a path: itself, or those directly inside.

    Raises
    ------
    FileNotFoundError
        If the path does not exist.
    """
    folder = Path(folder)
    if not folder.exists():
        raise FileNotFoundError(f"{folder} does not exist; expected the folder of one or several domains")
    inside = sorted(path.parent for path in folder.glob(f"*/{MANIFEST}"))
    return tuple(inside) or (folder,)


def inspect_domain(folder: Path | str) -> DomainSummary:
    """Return the facts of one domain.

    Raises
    ------
    FileNotFoundError, RuntimeError
        As `open_domain`.
    """
    frames = open_domain(folder)
    known = (
        usual_labels(frames.columns) if isinstance(frames, GeneratedDomain) else known_labels(frames.columns)
    )
    facts = []
    for name in known:
        values = frames.columns[name][np.isfinite(frames.columns[name])]
        extremes = (float(values.min()) + 0.0, float(values.max()) + 0.0) if len(values) else (0.0, 0.0)
        facts.append(LabelFacts(name, frames.label_range(name), *extremes))
    # Generated pictures were compared with their manifest.
    damages = picture_damages(frames) if isinstance(frames, PictureFiles) else []
    pictures = (
        (f"{len(damages)} pictures cannot be used, see --verify; first: {damages[0]}",) if damages else ()
    )
    return DomainSummary(
        folder=str(folder),
        name=frames.name,
        frames=len(frames),
        unconverged=frames.unconverged,
        size_px=frames.size_px,
        points=_distinct(frames.point_id),
        classes=_distinct(frames.contact_class),
        groups=tuple((name, len(set(frames.columns[name]))) for name in GROUPS if name in frames.columns),
        labels=tuple(facts),
        outside_range=int(outside(frames, Labels.of({label.name: label.range for label in facts})).sum()),
        optional_columns=frames.optional_columns if isinstance(frames, GeneratedDomain) else (),
        bytes=sum(
            path.stat().st_size
            for path in Path(folder).rglob("*")
            if path.is_file() and ".cache" not in path.parts
        ),
        notes=(*frames.notes, *label_notes(frames), *pictures),
    )


def verify_domain(folder: Path | str) -> tuple[Damage, ...]:
    """Return what is wrong with the files of a data set; empty if all is intact.

    Every byte of a generated domain is compared with its manifest, and what every picture states of itself with the
    reference. Of pictures with a table every picture is decoded, and every force must be a number.

    Raises
    ------
    FileNotFoundError
        If it is not a data set of a known layout.
    """
    files = DomainFolder(folder)
    if not files.exists() and files.path.is_dir():
        frames = open_domain(folder)
        assert isinstance(frames, PictureFiles)
        found = picture_damages(frames, decode=True)
        for path in frames.reference_paths:
            try:
                frames.reference_picture(path)
            except ValueError as error:
                found.append(Damage(str(path.relative_to(frames.folder)), str(error)))
        for name in known_labels(frames.columns):
            for index in np.flatnonzero(~np.isfinite(frames.columns[name])).tolist():
                problem = f"has {QUANTITIES[name].symbol} = {frames.columns[name][index]} in the table"
                found.append(Damage(frames.place_of(index), f"frame {index} {problem}"))
        return tuple(found)
    if damages := files.damages():
        return tuple(damages)
    # A manifest may vouch for bytes that no reader takes.
    try:
        problems = [str(damage) for damage in picture_damages(GeneratedDomain(folder))]
    except (RuntimeError, ValueError) as error:
        problems = [str(error).partition(": run the same")[0]]
    return tuple(Damage(MANIFEST, f"vouches for what cannot be used: {problem}") for problem in problems)


def gap_rows(frames: LabelledFrames, base: LabelledFrames) -> list[tuple[str, str]]:
    """Return (what, value) of the gap from `base`: colours, and, where known, modulus, markers and forces.

    Raises
    ------
    ValueError
        If their pictures have different sizes.
    """
    from gelgap.render import picture_gap

    seen = picture_gap(base.reference, frames.reference)
    rows = [("reference pictures, CIEDE2000", _colours(seen.mean, seen.percentile_95))]
    if isinstance(frames, GeneratedDomain) and isinstance(base, GeneratedDomain):
        gap = domain_gap(base.recipe, frames.recipe)
        colours = _colours(gap.colour_difference, gap.colour_difference_p95)
        counts = Counter(field.split(".")[0] for field in gap.fields)
        fields = [f"{name} ({count})" if count > 1 else name for name, count in counts.items()]
        rows += [
            ("the same without markers and noise", colours),
            ("modulus", f"× {gap.modulus_ratio:.4g}"),
            ("markers", gap.markers),
            ("fields that differ", ", ".join(fields) or "none"),
        ]
        mine, theirs = paired_contacts(frames, base)
        if len(mine):
            change = np.abs(frames.force_n[mine] - base.force_n[theirs]).mean(axis=0)
            text = ", ".join(f"F{axis} {value:.4f}" for axis, value in zip("xyz", change, strict=True))
            rows.append((f"mean force difference of {len(mine)} paired contacts, N", text))
        rows += [("no picture shows", note) for note in unseen_differences(base.recipe, frames.recipe)]
    return rows


def _colours(mean: float, percentile_95: float) -> str:
    return f"mean {mean:.2f}, 95th percentile {percentile_95:.2f}"


def _distinct(numbers: np.ndarray) -> int:
    return len(np.unique(numbers[numbers >= 0]))


def label_notes(frames: LabelledFrames) -> list[str]:
    """Return what is unusual about labels, in sentences: NaN, and forces that pull the sensor."""
    notes = []
    not_finite = {name: ~np.isfinite(frames.columns[name]) for name in known_labels(frames.columns)}
    for is_force, what in ((True, "a force"), (False, "a label other than force")):
        wrong = [values for name, values in not_finite.items() if (name in FORCE_COLUMNS) == is_force]
        if count := int(np.any(wrong, axis=0).sum()):
            notes.append(f"{count} frames have {what} that is not a number")
    pulling = int((frames.columns.get("fz_n", np.zeros(0)) > 0).sum())
    if pulling:
        notes.append(f"{pulling} frames have Fz > 0: the sensor is pulled, or the sign is another one")
    return notes


def picture_damages(frames: StoredFrames, *, decode: bool = False) -> list[Damage]:
    """Return the pictures whose size differs from the reference's, or that cannot be decoded."""
    found, (width, height) = [], frames.size_px
    for index in range(len(frames)):
        try:
            data = frames.encoded_picture(index)
            size_px = stated_size_px(data)
            if size_px != (width, height):
                raise ValueError(f"{size_px[0]}×{size_px[1]} px, the reference has {width}×{height} px")
            if decode:
                decode_picture(data)
        except (OSError, ValueError) as error:
            found.append(Damage(frames.place_of(index), f"frame {index}: {error}"))
    return found


def write_overview(folder: Path | str, page: Path | str, other: Path | str | None = None) -> Path:
    """Write the page of one domain; with `other`, the gap from that domain to this one is on it.

    Raises
    ------
    FileNotFoundError, RuntimeError
        As `open_domain`.
    """
    frames, summary = open_domain(folder), inspect_domain(folder)
    base = None if other is None else open_domain(other)
    quantiles = np.quantile(frames.label_values, [0, 0.05, 0.5, 0.95, 1], axis=0).T
    manifest = frames.manifest if isinstance(frames, GeneratedDomain) else None
    text = html_page(
        "overview.html",
        name=frames.name,
        summary=summary,
        label_histograms=_plot(_label_histograms, frames),
        label_quantiles=[
            (str(what), *(f"{value:.3f}" for value in row))
            for what, row in zip(frames.labels.quantities, quantiles, strict=True)
        ],
        force_against_contact=_plot(_force_against_contact, frames),
        coverage=_plot(_coverage, frames),
        samples=_samples(frames),
        marker_flow=_marker_flow(frames),
        gap=None if base is None else {"base": base.name, "rows": gap_rows(frames, base)},
        folder=frames.folder,
        manifest=manifest,
        configuration=manifest and json.dumps(manifest["configuration"], indent=1, ensure_ascii=False),
        left_out=np.setdiff1d(np.arange(manifest["frames"]), frames.columns["frame_id"]).tolist()
        if manifest
        else [],
    )
    page = Path(page)
    page.parent.mkdir(parents=True, exist_ok=True)
    page.write_text(text, encoding="utf-8")
    return page


def _plot(draw: "Callable[[Figure, LabelledFrames], None]", frames: LabelledFrames) -> str:
    """Return a plot as PNG in base64; an empty text if nothing was drawn."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10.5, 3.2), layout="constrained")
    draw(figure, frames)
    if not figure.axes:
        return ""
    for axes in figure.axes:
        axes.spines[["top", "right"]].set_visible(False)
    out = io.BytesIO()
    figure.savefig(out, format="png", dpi=110)
    return _base64(out.getvalue())


def _base64(png: bytes) -> str:
    return base64.b64encode(png).decode()


def _label_histograms(figure: "Figure", frames: LabelledFrames) -> None:
    labels = frames.labels
    for number, axes in enumerate(figure.subplots(1, len(labels), squeeze=False)[0]):
        axes.hist(frames.label_values[:, number], bins=50, color=_COLOURS[number % len(_COLOURS)])
        axes.axvspan(*labels.ranges[number], color="#000", alpha=0.05, zorder=0)
        symbol, unit = labels.quantities[number]
        axes.set_xlabel(f"{symbol} in {unit} (grey: declared range)")
        axes.set_ylabel("frames")


def _force_against_contact(figure: "Figure", frames: LabelledFrames) -> None:
    if not {"depth_mm", "radius_mm", *FORCE_COLUMNS} <= frames.columns.keys():
        return
    depth, radius = frames.columns["depth_mm"], frames.columns["radius_mm"]
    shear_n = np.hypot(frames.force_n[:, 0], frames.force_n[:, 1])
    press, drag, ratio = figure.subplots(1, 3)
    points = press.scatter(depth, -frames.force_n[:, 2], c=radius, s=6, cmap="viridis")
    figure.colorbar(points, ax=press, label="radius, mm")
    press.set(xlabel="commanded depth, mm", ylabel="−Fz, N")
    points = drag.scatter(radius, shear_n, c=depth, s=6, cmap="viridis")
    figure.colorbar(points, ax=drag, label="depth, mm")
    drag.set(xlabel="commanded radius, mm", ylabel="shear force, N")
    pressed = frames.force_n[:, 2] < -1e-3
    ratio.scatter(
        radius[pressed], shear_n[pressed] / -frames.force_n[pressed, 2], c=depth[pressed], s=6, cmap="viridis"
    )
    ratio.set(xlabel="commanded radius, mm", ylabel="shear / normal force")


def _coverage(figure: "Figure", frames: LabelledFrames) -> None:
    """Draw where contacts are, and how many of each class are at each point, as far as that is known."""
    has_places = {"x_mm", "y_mm"} <= frames.columns.keys()
    has_counts = frames.has_classes and bool((frames.point_id >= 0).all())
    panels = has_places + has_counts
    if has_places:
        x_mm, y_mm = (
            frames.columns[f"{axis}_mm"] + frames.columns.get(f"shear_{axis}_mm", 0.0) for axis in "xy"
        )
        axes = figure.add_subplot(1, panels, 1)
        axes.scatter(x_mm, y_mm, s=2, color=_COLOURS[2])
        axes.invert_yaxis()
        axes.set(xlabel="x, mm", ylabel="y, mm (down, as in the picture)", aspect="equal")
    if has_counts:
        points, point = np.unique(frames.point_id, return_inverse=True)
        classes, contact_class = np.unique(frames.contact_class, return_inverse=True)
        counts = np.zeros((len(points), len(classes)))
        np.add.at(counts, (point, contact_class), 1)
        axes = figure.add_subplot(1, panels, panels)
        grey = axes.imshow(counts, aspect="auto", cmap="Greys", interpolation="nearest", vmin=0)
        axes.set(xlabel="contact class (in order)", ylabel="contact point (in order)")
        figure.colorbar(grey, ax=axes, label="frames")


def _samples(frames: LabelledFrames, count: int = 14) -> list[dict[str, str]]:
    """Return the reference and frames of evenly spread classes, or without classes of an evenly spread label."""
    order = np.argsort(frames.label_values[:, -1])
    if frames.has_classes:
        order = np.lexsort((frames.point_id, frames.contact_class))
    chosen = order[np.unique(np.linspace(0, len(order) - 1, count).astype(int))] if len(order) else order
    shown = [{"png": _base64(encode_png(frames.reference)), "caption": "reference"}]
    for index in chosen.tolist():
        values = ", ".join(f"{value:.2f}" for value in frames.label_values[index])
        units = ", ".join(dict.fromkeys(what.unit for what in frames.labels.quantities))
        caption = f"({values}) {units}" if len(frames.labels) > 1 else f"{values} {units}"
        if frames.contact_class[index] >= 0:
            caption = f"class {frames.contact_class[index]}: {caption}"
        shown.append({"png": _base64(encode_png(frames.picture(index))), "caption": caption})
    return shown


def _marker_flow(frames: LabelledFrames) -> dict[str, str] | None:
    """Return the frame with the largest shear force with its markers' motion, where the data set has it."""
    if not isinstance(frames, GeneratedDomain) or "marker_px" not in frames.optional_columns:
        return None
    sheared = int(np.linalg.norm(frames.force_n[:, :2], axis=1).argmax())
    rest = frames.marker_px(int(np.linalg.norm(frames.force_n, axis=1).argmin()))
    moved = frames.marker_px(sheared) - rest

    def draw(figure: "Figure", frames: LabelledFrames) -> None:
        axes = figure.subplots()
        axes.imshow(frames.picture(sheared))
        axes.quiver(*rest.T, *moved.T, angles="xy", scale_units="xy", scale=0.25, color="white", width=0.002)
        axes.set_axis_off()

    caption = f"The frame with the largest shear force (row {sheared}); arrows four times as long."
    return {"png": _plot(draw, frames), "caption": caption}
