"""One self-contained HTML page that shows what a data set holds."""

import base64
import html
import io
import json
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from gelgap.domains.dataset import LabelledFrames
from gelgap.domains.generated import GeneratedDomain
from gelgap.domains.inspection import gap_rows, inspect_domain
from gelgap.domains.opening import open_domain
from gelgap.domains.picture_codec import encode_png

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; color: #1c2330; background: #fff; max-width: 1080px; margin: 2em auto;
  padding: 0 1em }
h1 { font-size: 1.5em }
h2 { font-size: 1.15em; margin: 2em 0 .4em; border-bottom: 1px solid #d5dae3 }
table { border-collapse: collapse }
td, th { padding: .15em 1em .15em 0; text-align: left; vertical-align: top }
td:first-child { white-space: nowrap }
td.number { text-align: right; font-variant-numeric: tabular-nums }
figure { display: inline-block; margin: 0 .6em .8em 0 }
figcaption { font-size: .82em; color: #566 }
img { max-width: 100% }
.sample img { width: 200px }
pre { background: #f5f6f8; padding: .8em; overflow-x: auto; font-size: .8em }
.warning { color: #a33 }
"""
_AXES = ("Fx", "Fy", "Fz")
_COLOURS = ("#c1553b", "#3b7f54", "#35609f")


def write_overview(folder: Path | str, page: Path | str, other: Path | str | None = None) -> Path:
    """Write the page of one domain; with `other`, the gap from that domain to this one is on it.

    Raises
    ------
    FileNotFoundError, RuntimeError
        As `open_domain`.
    """
    frames = open_domain(folder)
    parts = [
        _section("Counts", _counts(frames, folder)),
        _section("Forces", _figure(_force_histograms, frames) + _force_table(frames)),
        _section("Force against the contact", _figure(_force_against_contact, frames)),
        _section("Coverage of the path", _figure(_coverage, frames)),
        _section("Samples", _samples(frames)),
        _section("Marker flow", _marker_flow(frames)),
        _section("Frames left out", _left_out(frames)),
    ]
    if other is not None:
        parts.append(_section("Gap", _gap(frames, open_domain(other))))
    parts.append(_section("Provenance", _provenance(frames)))
    title = html.escape(f"Domain {frames.name}")
    text = (
        f"<!DOCTYPE html><html lang='en'><head><meta charset='utf-8'><title>{title}</title>"
        f"<meta name='viewport' content='width=device-width, initial-scale=1'><style>{_STYLE}</style></head>"
        f"<body><h1>{title}</h1>{''.join(parts)}</body></html>"
    )
    page = Path(page)
    page.parent.mkdir(parents=True, exist_ok=True)
    page.write_text(text, encoding="utf-8")
    return page


def _section(title: str, content: str) -> str:
    return f"<h2>{html.escape(title)}</h2>{content}"


def _table(rows: list[tuple[str, ...]], header: tuple[str, ...] = ()) -> str:
    head = "".join(f"<th>{html.escape(cell)}</th>" for cell in header)
    body = "".join(
        "<tr>" + "".join(f"<td{_number_class(cell)}>{html.escape(cell)}</td>" for cell in row) + "</tr>"
        for row in rows
    )
    return f"<table>{f'<tr>{head}</tr>' if head else ''}{body}</table>"


def _number_class(cell: str) -> str:
    return " class='number'" if cell.replace("−", "-").replace(".", "").lstrip("-").isdigit() else ""


def _image(data: bytes, kind: str, caption: str = "", style: str = "") -> str:
    source = base64.b64encode(data).decode()
    text = html.escape(caption)
    return (
        f"<figure class='{style}'><img alt='{text or 'plot'}' src='data:image/{kind};base64,{source}'>"
        f"{f'<figcaption>{text}</figcaption>' if caption else ''}</figure>"
    )


def _figure(draw: "Callable[[Figure, LabelledFrames], None]", frames: LabelledFrames) -> str:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10.5, 3.2), layout="constrained")
    draw(figure, frames)
    for axes in figure.axes:
        axes.spines[["top", "right"]].set_visible(False)
    out = io.BytesIO()
    figure.savefig(out, format="png", dpi=110)
    return _image(out.getvalue(), "png")


def _counts(frames: LabelledFrames, folder: Path | str) -> str:
    facts = inspect_domain(folder)
    rows = [
        ("frames", str(facts.frames)),
        ("left out, not converged", str(facts.unconverged)),
        ("contact points", str(facts.points)),
        ("contact classes", str(facts.classes)),
        ("picture", f"{facts.size_px[0]}×{facts.size_px[1]} px"),
        ("on disk", f"{facts.bytes / 1e6:.1f} MB"),
        ("forces outside the declared range", str(facts.outside_range)),
    ]
    warnings = "".join(f"<p class='warning'>{html.escape(note)}</p>" for note in facts.notes)
    return _table(rows) + warnings


def _force_histograms(figure: "Figure", frames: LabelledFrames) -> None:
    for axis, axes in enumerate(figure.subplots(1, 3)):
        low, high = frames.force_range_n[axis]
        axes.hist(frames.force_n[:, axis], bins=50, color=_COLOURS[axis])
        axes.axvspan(low, high, color="#000", alpha=0.05, zorder=0)
        axes.set_xlabel(f"{_AXES[axis]} in N (grey: declared range)")
        axes.set_ylabel("frames")


def _force_table(frames: LabelledFrames) -> str:
    quantiles = np.quantile(frames.force_n, [0, 0.05, 0.5, 0.95, 1], axis=0).T
    rows = [(name, *(f"{value:.3f}" for value in row)) for name, row in zip(_AXES, quantiles, strict=True)]
    return _table(rows, ("N", "smallest", "5 %", "median", "95 %", "largest"))


def _force_against_contact(figure: "Figure", frames: LabelledFrames) -> None:
    if not {"depth_mm", "radius_mm"} <= frames.columns.keys():
        figure.text(0.5, 0.5, "the data set does not say depth and radius", ha="center")
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
    place, poses = figure.subplots(1, 2)
    if {"x_mm", "y_mm"} <= frames.columns.keys():
        shear_x, shear_y = (frames.columns.get(name, 0.0) for name in ("shear_x_mm", "shear_y_mm"))
        place.scatter(
            frames.columns["x_mm"] + shear_x, frames.columns["y_mm"] + shear_y, s=2, color=_COLOURS[2]
        )
        place.invert_yaxis()
        place.set(xlabel="x, mm", ylabel="y, mm (down, as in the picture)", aspect="equal")
    if frames.has_classes and (frames.point_id >= 0).all():
        points, classes = np.unique(frames.point_id), np.unique(frames.contact_class)
        counts = np.zeros((len(points), len(classes)))
        np.add.at(
            counts,
            (np.searchsorted(points, frames.point_id), np.searchsorted(classes, frames.contact_class)),
            1,
        )
        grey = poses.imshow(counts, aspect="auto", cmap="Greys", interpolation="nearest", vmin=0)
        poses.set(xlabel="contact class (in order)", ylabel="contact point (in order)")
        figure.colorbar(grey, ax=poses, label="frames")


def _samples(frames: LabelledFrames) -> str:
    shown = [_image(encode_png(frames.reference), "png", "reference", "sample")]
    for index in _sample_indices(frames):
        force = ", ".join(f"{value:.2f}" for value in frames.force_n[index])
        shown.append(
            _image(
                encode_png(frames.picture(index)),
                "png",
                f"class {frames.contact_class[index]}: ({force}) N",
                "sample",
            )
        )
    return "".join(shown)


def _sample_indices(frames: LabelledFrames, count: int = 14) -> list[int]:
    """Return frames of evenly spread classes, each at another point; without classes, of evenly spread force."""
    order = np.lexsort((frames.point_id, frames.contact_class))
    if not frames.has_classes:
        order = np.argsort(frames.force_n[:, 2])
    if not len(order):
        return []
    return [int(index) for index in order[np.unique(np.linspace(0, len(order) - 1, count).astype(int))]]


def _marker_flow(frames: LabelledFrames) -> str:
    if not isinstance(frames, GeneratedDomain) or "marker_px" not in frames.optional_columns:
        return "<p>Not in this data set; generate with the column marker_px to have it.</p>"
    hardest = int(np.linalg.norm(frames.force_n[:, :2], axis=1).argmax())
    rest = frames.marker_px(int(np.linalg.norm(frames.force_n, axis=1).argmin()))

    def draw(figure: "Figure", frames: LabelledFrames) -> None:
        axes = figure.subplots()
        moved = frames.marker_px(hardest) - rest
        axes.imshow(frames.picture(hardest))
        axes.quiver(*rest.T, *moved.T, angles="xy", scale_units="xy", scale=0.25, color="white", width=0.002)
        axes.set_axis_off()

    return (
        _figure(draw, frames)
        + f"<p>The frame with the largest shear force (row {hardest}); arrows four times as long.</p>"
    )


def _left_out(frames: LabelledFrames) -> str:
    if not frames.unconverged:
        return "<p>None.</p>"
    numbers = []
    if isinstance(frames, GeneratedDomain):
        everything = np.arange(frames.manifest["frames"])
        numbers = np.setdiff1d(everything, frames.columns["frame_id"]).tolist()
    more = " …" if len(numbers) > 60 else ""
    return f"<p>{frames.unconverged} frames: {', '.join(map(str, numbers[:60]))}{more}</p>"


def _gap(frames: LabelledFrames, other: LabelledFrames) -> str:
    return f"<p>From {html.escape(other.name)} to {html.escape(frames.name)}:</p>" + _table(
        gap_rows(frames, other)
    )


def _provenance(frames: LabelledFrames) -> str:
    if not isinstance(frames, GeneratedDomain):
        return f"<p>Read from {html.escape(str(frames.folder))}.</p>"
    manifest = frames.manifest
    versions = _table([(name, number) for name, number in manifest["versions"].items()])
    files = _table([(name, entry["sha256"]) for name, entry in manifest["files"].items()])
    configuration = html.escape(json.dumps(manifest["configuration"], indent=1, ensure_ascii=False))
    return (
        f"<p>Seed {manifest['seed']}, schema version {manifest['schema_version']}.</p>{versions}"
        f"<details><summary>Configuration</summary><pre>{configuration}</pre></details>"
        f"<details><summary>Files and their SHA-256</summary>{files}</details>"
    )
