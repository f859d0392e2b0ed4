"""One self-contained HTML page that shows what a data set holds."""

import base64
import io
import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gelgap.assets import html_page
from gelgap.domains.dataset import LabelledFrames
from gelgap.domains.generated import GeneratedDomain
from gelgap.domains.inspection import DomainSummary, gap_rows, inspect_domain
from gelgap.domains.labels import FORCE_COLUMNS
from gelgap.domains.opening import open_domain
from gelgap.domains.picture_codec import encode_png

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_COLOURS = ("#c1553b", "#3b7f54", "#35609f")
_FORCES = frozenset(FORCE_COLUMNS)


@dataclass(frozen=True)
class _Image:
    """A picture for the page: PNG in base64, and what is written below it."""

    png: str
    caption: str = ""


def write_overview(folder: Path | str, page: Path | str, other: Path | str | None = None) -> Path:
    """Write the page of one domain; with `other`, the gap from that domain to this one is on it.

    Raises
    ------
    FileNotFoundError, RuntimeError
        As `open_domain`.
    """
    frames, summary = open_domain(folder), inspect_domain(folder)
    base = None if other is None else open_domain(other)
    text = html_page(
        "overview.html",
        name=frames.name,
        counts=_counts(summary),
        notes=summary.notes,
        label_histograms=_plot(_label_histograms, frames),
        label_quantiles=_label_quantiles(frames),
        force_against_contact=_plot(_force_against_contact, frames),
        coverage=_plot(_coverage, frames),
        samples=_samples(frames),
        marker_flow=_marker_flow(frames),
        unconverged=frames.unconverged,
        gap=None if base is None else {"base": base.name, "rows": gap_rows(frames, base)},
        folder=frames.folder,
        **_provenance(frames),
    )
    page = Path(page)
    page.parent.mkdir(parents=True, exist_ok=True)
    page.write_text(text, encoding="utf-8")
    return page


def _counts(summary: DomainSummary) -> list[tuple[str, str]]:
    what = "forces" if summary.force_min_n else "labels"
    return [
        ("frames", str(summary.frames)),
        ("left out, not converged", str(summary.unconverged)),
        ("contact points", str(summary.points)),
        ("contact classes", str(summary.classes)),
        ("picture", f"{summary.size_px[0]}×{summary.size_px[1]} px"),
        ("on disk", f"{summary.bytes / 1e6:.1f} MB"),
        (f"{what} outside the declared range", str(summary.outside_range)),
    ]


def _label_quantiles(frames: LabelledFrames) -> list[tuple[str, ...]]:
    quantiles = np.quantile(frames.label_values, [0, 0.05, 0.5, 0.95, 1], axis=0).T
    rows = zip(frames.labels.quantities, quantiles, strict=True)
    return [(str(what), *(f"{value:.3f}" for value in row)) for what, row in rows]


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
    if not {"depth_mm", "radius_mm", *_FORCES} <= frames.columns.keys():
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
    known = {
        _draw_places: {"x_mm", "y_mm"} <= frames.columns.keys(),
        _draw_counts: frames.has_classes and bool((frames.point_id >= 0).all()),
    }
    drawn = [draw for draw, is_known in known.items() if is_known]
    if drawn:
        for draw, axes in zip(drawn, figure.subplots(1, len(drawn), squeeze=False)[0], strict=True):
            draw(axes, frames)


def _draw_places(axes: "Axes", frames: LabelledFrames) -> None:
    shear_x, shear_y = (frames.columns.get(name, 0.0) for name in ("shear_x_mm", "shear_y_mm"))
    axes.scatter(frames.columns["x_mm"] + shear_x, frames.columns["y_mm"] + shear_y, s=2, color=_COLOURS[2])
    axes.invert_yaxis()
    axes.set(xlabel="x, mm", ylabel="y, mm (down, as in the picture)", aspect="equal")


def _draw_counts(axes: "Axes", frames: LabelledFrames) -> None:
    points, point = np.unique(frames.point_id, return_inverse=True)
    classes, contact_class = np.unique(frames.contact_class, return_inverse=True)
    counts = np.zeros((len(points), len(classes)))
    np.add.at(counts, (point, contact_class), 1)
    grey = axes.imshow(counts, aspect="auto", cmap="Greys", interpolation="nearest", vmin=0)
    axes.set(xlabel="contact class (in order)", ylabel="contact point (in order)")
    axes.figure.colorbar(grey, ax=axes, label="frames")


def _samples(frames: LabelledFrames) -> list[_Image]:
    shown = [_Image(_base64(encode_png(frames.reference)), "reference")]
    for index in _sample_indices(frames):
        values = ", ".join(f"{value:.2f}" for value in frames.label_values[index])
        units = ", ".join(dict.fromkeys(what.unit for what in frames.labels.quantities))
        caption = f"({values}) {units}" if len(frames.labels) > 1 else f"{values} {units}"
        if frames.contact_class[index] >= 0:
            caption = f"class {frames.contact_class[index]}: {caption}"
        shown.append(_Image(_base64(encode_png(frames.picture(index))), caption))
    return shown


def _sample_indices(frames: LabelledFrames, count: int = 14) -> list[int]:
    """Return frames of evenly spread classes, each at another point; without classes, of an evenly spread label."""
    order = np.lexsort((frames.point_id, frames.contact_class))
    if not frames.has_classes:
        order = np.argsort(frames.label_values[:, -1])
    if not len(order):
        return []
    return [int(index) for index in order[np.unique(np.linspace(0, len(order) - 1, count).astype(int))]]


def _marker_flow(frames: LabelledFrames) -> _Image | None:
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
    return _Image(_plot(draw, frames), caption)


def _provenance(frames: LabelledFrames) -> dict[str, Any]:
    """Return what only a manifest tells; real data have none."""
    if not isinstance(frames, GeneratedDomain):
        return {"manifest": None, "left_out": []}
    manifest = frames.manifest
    return {
        "manifest": manifest,
        "configuration": json.dumps(manifest["configuration"], indent=1, ensure_ascii=False),
        "hashes": [(name, entry["sha256"]) for name, entry in manifest["files"].items()],
        "left_out": np.setdiff1d(np.arange(manifest["frames"]), frames.columns["frame_id"]).tolist(),
    }
