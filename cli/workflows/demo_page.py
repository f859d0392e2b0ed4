"""The demo's report: one self-contained HTML page with pictures, force curves, scatter plots and timings."""

import base64
import io
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from gelgap.cli.workflows.demo import DemoResult
    from gelgap.domains import GeneratedDomain

STYLE = """
body { font: 16px/1.5 system-ui, sans-serif; max-width: 60rem; margin: 2rem auto; padding: 0 1rem; color: #222 }
h1 { font-size: 1.6rem } h2 { font-size: 1.2rem; margin-top: 2.5rem }
p.headline { font-size: 1.15rem; font-weight: 600; border-left: 4px solid #1f77b4; padding-left: .8rem }
table { border-collapse: collapse; font-variant-numeric: tabular-nums }
td, th { padding: .25rem .8rem; text-align: right }
th { border-bottom: 2px solid #888 }
td:first-child, th:first-child, td:nth-child(2), th:nth-child(2) { text-align: left }
tr:nth-child(even) td { background: #f4f6f8 } img { max-width: 100%; height: auto } figure { margin: 1rem 0 }
figcaption { color: #555; font-size: .9rem }
"""
SAMPLE_DEPTH_MM = 0.6


def write_page(result: "DemoResult", out_dir: Path, page: Path) -> None:
    """Write the report of a demo whose domains are in `out_dir/data`."""
    from gelgap.cli.workflows.demo import SOURCE, TARGET
    from gelgap.domains import open_domain

    domains = [open_domain(out_dir / "data" / name) for name in (SOURCE, TARGET)]
    body = [
        "<h1>gelgap demo</h1>",
        f'<p class="headline">{escape(result.headline)}</p>',
        "<p>A 3 mm sphere is pressed into two gels and dragged sideways. A network learns force from the pictures of "
        f"<b>{SOURCE}</b> (markers, gel b0, light i0) and is adapted to <b>{TARGET}</b> (no markers, gel b1, light i1) "
        "from that domain's pictures alone.</p>",
        "<h2>Error on held-out frames</h2>",
        _error_table(result),
        "<h2>What the camera sees</h2>",
        _figure(
            _samples(domains),
            f"The same commanded contact in both domains, {SAMPLE_DEPTH_MM} mm deep and sheared: reference, contact, "
            "difference (×2, around grey), height of the membrane towards the camera.",
        ),
        "<h2>Predicted against true force</h2>",
        _figure(_scatter(result), f"Test frames of {TARGET}; the line is perfect prediction."),
        "<h2>Force against depth</h2>",
        _figure(
            _force_curve(result),
            "0.3 MPa, ν = 0.49, 3 mm pad, friction 0.8. The bonded layer (Dimitriadis 2002) is a small-strain theory "
            "for small depths, Hertz ignores the backing; the reference is converged FEM of the isochoric neo-Hookean "
            f"gel. Worst difference from the reference: {_worst_percent(result):.1f} %; "
            f"{result.curve.seconds_a_pose:.2f} s a pose.",
        ),
        "<h2>Time and memory by stage</h2>",
        _stage_table(result),
    ]
    page.write_text(
        "<!doctype html><html lang='en'><meta charset='utf-8'><title>gelgap demo</title>"
        f"<style>{STYLE}</style><body>{''.join(body)}</body></html>",
        encoding="utf-8",
    )


def _worst_percent(result: "DemoResult") -> float:
    curve = result.curve
    return float(100 * np.max(np.abs(curve.force_n / curve.reference_n - 1)))


def _table(head: tuple[str, ...], rows: list[tuple[str, ...]]) -> str:
    cells = "".join(f"<th>{escape(text)}</th>" for text in head)
    lines = "".join("<tr>" + "".join(f"<td>{escape(text)}</td>" for text in row) + "</tr>" for row in rows)
    return f"<table><tr>{cells}</tr>{lines}</table>"


def _error_table(result: "DemoResult") -> str:
    rows = []
    for row in result.rows:
        error = row.evaluation
        rows.append(
            (
                row.predictor,
                row.domain,
                *(f"{value:.3f}" for value in (*error.mae_n, error.mean_mae_n)),
                f"{error.mean_mae_percent:.1f}",
                *(f"{value:.2f}" for value in error.r2),
            )
        )
    head = ("predictor", "domain", "MAE Fx / N", "Fy", "Fz", "mean", "% of range", "R² Fx", "Fy", "Fz")
    return _table(head, rows)


def _stage_table(result: "DemoResult") -> str:
    rows = [
        (stage.name, "", f"{stage.wall_s:.1f}", f"{stage.peak_memory_mib:.0f}") for stage in result.stages
    ]
    rows.append(("total", "", f"{sum(stage.wall_s for stage in result.stages):.1f}", ""))
    return _table(("stage", "", "wall time / s", "peak memory / MiB, all processes"), rows)


def _figure(figure: "Figure", caption: str) -> str:
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=110, bbox_inches="tight")
    data = base64.b64encode(buffer.getvalue()).decode()
    return (
        f'<figure><img alt="{escape(caption)}" src="data:image/png;base64,{data}">'
        f"<figcaption>{escape(caption)}</figcaption></figure>"
    )


def _samples(domains: "list[GeneratedDomain]") -> "Figure":
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 2.2 * len(domains) + 0.4), layout="constrained")
    axes = figure.subplots(len(domains), 4, squeeze=False)
    for row, data in zip(axes, domains, strict=True):
        index = _sample_index(data)
        picture, height_mm = data.picture(index), data.height_map_mm(index)
        difference = np.clip(127 + 2 * (picture.astype(int) - data.reference), 0, 255).astype(np.uint8)
        for panel, image in zip(row, (data.reference, picture, difference), strict=False):
            panel.imshow(image)
        drawn = row[3].imshow(height_mm, cmap="viridis")
        figure.colorbar(drawn, ax=row[3], label="mm", shrink=0.8)
        row[0].set_ylabel(data.name)
    for panel, title in zip(axes[0], ("reference", "contact", "difference", "height"), strict=True):
        panel.set_title(title)
    for panel in axes.flat:
        panel.set(xticks=[], yticks=[])
    return figure


def _sample_index(data: "GeneratedDomain") -> int:
    """Return the frame at `SAMPLE_DEPTH_MM` with the largest shear to the right and down."""
    sideways = data.columns["shear_x_mm"] + data.columns["shear_y_mm"]
    at_depth = np.isclose(data.columns["depth_mm"], SAMPLE_DEPTH_MM)
    return int(np.argmax(np.where(at_depth, sideways, -np.inf)))


def _scatter(result: "DemoResult") -> "Figure":
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 3.8), layout="constrained")
    for axis, panel in enumerate(figure.subplots(1, 3)):
        true = result.true_n[:, axis]
        for name, predicted in result.predicted_n.items():
            panel.plot(true, predicted[:, axis], ".", markersize=5, alpha=0.7, label=name)
        panel.plot([true.min(), true.max()], [true.min(), true.max()], color="0.3", linewidth=1)
        panel.set(title=f"F{'xyz'[axis]}", xlabel="true / N", ylabel="predicted / N")
    panel.legend()
    return figure


def _force_curve(result: "DemoResult") -> "Figure":
    from matplotlib.figure import Figure

    curve = result.curve
    figure = Figure(figsize=(7, 4), layout="constrained")
    panel = figure.subplots()
    panel.plot(curve.depth_mm, curve.hertz_n, ":", label="Hertz (half-space)")
    panel.plot(curve.depth_mm, curve.bonded_layer_n, "--", label="bonded layer, small strain")
    panel.plot(curve.depth_mm, curve.reference_n, "k+", markersize=12, label="reference FEM")
    panel.plot(curve.depth_mm, curve.force_n, "o-", markersize=4, label="gelgap (MuJoCo)")
    panel.set(xlabel="depth / mm", ylabel="normal force / N", ylim=(0, 1.25 * float(curve.reference_n.max())))
    panel.legend()
    return figure
