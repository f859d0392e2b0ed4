"""What the demo finds, and its report: one HTML page with pictures, force curves, scatter plots and timings."""

import base64
import io
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from gelgap.assets import html_page

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

    from gelgap.adapt import Evaluation
    from gelgap.domains import GeneratedDomain

SOURCE = "mb0i0"
TARGET = "wmb1i1"
SAMPLE_DEPTH_MM = 0.6


@dataclass(frozen=True)
class DemoResult:
    """What the demo found.

    `errors` are on held-out frames by predictor and domain, `stages_s` wall times. Forces are (n, 3) in N, on the
    target's test frames. `curve` has Fz in N at depths in mm, of a 0.3 MPa gel, ν = 0.49, 3 mm thick, friction 0.8.
    """

    errors: "dict[tuple[str, str], Evaluation]"
    stages_s: dict[str, float]
    true_n: np.ndarray
    predicted_n: dict[str, np.ndarray]
    curve: "pd.DataFrame"
    seconds_per_pose: float

    @property
    def headline(self) -> str:
        """The report's first line: whether the networks learned and whether adaptation helped."""
        from gelgap.adapt.evaluation import worse_than_constant

        mae_n = {what: error.mean_mae_n for what, error in self.errors.items()}
        plain, adapted = mae_n["source-only", TARGET], mae_n["dsan", TARGET]
        verdict = "DSAN beats source-only" if adapted < plain else "DSAN does NOT beat source-only"
        change = (
            f"{adapted:.3f} N against {plain:.3f} N ({100 * (adapted / plain - 1):+.0f} %); AdaBN, the target's "
            f"normalisation statistics alone, has {mae_n['adabn', TARGET]:.3f} N"
        )
        worse = worse_than_constant(self.errors["dsan", TARGET])
        learned = mae_n["source-only", SOURCE] < 0.5 * mae_n["constant mean", SOURCE]
        warning = " Source-only did NOT learn: its error on the source is over half the mean's."
        told = f"{verdict} on the target: mean error {change}.{'' if learned else warning}"
        return f"{told} DSAN's {worse}." if worse else told


def write_page(result: DemoResult, out_dir: Path, page: Path) -> None:
    """Write the report of a demo whose domains are in `out_dir/data`."""
    from gelgap.domains import open_domain

    domains = [open_domain(out_dir / "data" / name) for name in (SOURCE, TARGET)]
    html = html_page(
        "demo.html",
        result=result,
        source=SOURCE,
        target=TARGET,
        sample_depth_mm=SAMPLE_DEPTH_MM,
        worst_percent=100 * (result.curve["force_n"] / result.curve["reference_n"] - 1).abs().max(),
        samples_png=_png_base64(_samples(domains)),
        scatter_png=_png_base64(_scatter(result)),
        force_curve_png=_png_base64(_force_curve(result)),
    )
    page.write_text(html, encoding="utf-8")


def _png_base64(figure: "Figure") -> str:
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=110, bbox_inches="tight")
    return base64.b64encode(buffer.getvalue()).decode()


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
    """Return the frame with the largest shear to the right and down of the tenth nearest to `SAMPLE_DEPTH_MM`."""
    sideways = data.columns["shear_x_mm"] + data.columns["shear_y_mm"]
    off_mm = np.abs(data.columns["depth_mm"] - SAMPLE_DEPTH_MM)
    near = off_mm <= np.quantile(off_mm, 0.1) + 1e-9
    return int(np.argmax(np.where(near, sideways, -np.inf)))


def _scatter(result: DemoResult) -> "Figure":
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


def _force_curve(result: DemoResult) -> "Figure":
    from matplotlib.figure import Figure

    curve = result.curve
    figure = Figure(figsize=(7, 4), layout="constrained")
    panel = figure.subplots()
    panel.plot(curve["hertz_n"], ":", label="Hertz (half-space)")
    panel.plot(curve["bonded_layer_n"], "--", label="bonded layer, small strain")
    panel.plot(curve["reference_n"], "k+", markersize=12, label="reference FEM")
    panel.plot(curve["force_n"], "o-", markersize=4, label="gelgap (MuJoCo)")
    most_n = 1.25 * float(curve["reference_n"].max())
    panel.set(xlabel="depth / mm", ylabel="normal force / N", ylim=(0, most_n))
    panel.legend()
    return figure
