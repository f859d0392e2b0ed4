"""The report of a folder of adaptation runs: Markdown, LaTeX, and one self-contained HTML page with figures."""

import base64
import html
import io
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from gelgap.adapt.figures import error_rows, feature_tsne, force_scatter, latex_table, markdown_table
from gelgap.adapt.runs import Run, load_predictions, load_runs

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_STYLE = (
    "body{font:15px/1.5 sans-serif;max-width:70em;margin:2em auto;padding:0 1em;color:#222}"
    "table{border-collapse:collapse;margin:1em 0}td,th{padding:.25em .8em;text-align:right}"
    "td:first-child,th:first-child{text-align:left}img{max-width:100%}"
)


def write_report(runs_dir: str | Path, out_dir: str | Path | None = None) -> Path:
    """Write report.md, report.tex and report.html about all finished runs below a folder; return the HTML's path.

    Raises
    ------
    FileNotFoundError
        If there is no finished run.
    """
    runs = load_runs(runs_dir)
    out = Path(runs_dir if out_dir is None else out_dir)
    out.mkdir(parents=True, exist_ok=True)
    tables = report_tables(runs)
    markdown = "\n".join(f"## {title}\n\n{markdown_table(header, rows)}" for title, header, rows in tables)
    (out / "report.md").write_text(f"# Adaptation runs\n\n{markdown}", encoding="utf-8")
    latex = "\n".join(f"% {title}\n{latex_table(header, rows)}" for title, header, rows in tables)
    (out / "report.tex").write_text(latex, encoding="utf-8")
    path = out / "report.html"
    content = [(title, header, rows, "") for title, header, rows in tables]
    path.write_text(html_page("Adaptation runs", content, _figures(runs)), encoding="utf-8")
    return path


def html_page(
    title: str,
    tables: Sequence[tuple[str, Sequence[str], Sequence[Sequence[str]], str]],
    figures: Sequence[tuple[str, "Figure"]],
) -> str:
    """Return one self-contained page: tables as (title, header, rows, note), figures as (caption, figure)."""
    style = f"<style>{_STYLE}</style>"
    page = [f"<!doctype html><meta charset='utf-8'><title>{html.escape(title)}</title>{style}"]
    page.append(f"<h1>{html.escape(title)}</h1>")
    for name, header, rows, note in tables:
        page.append(f"<h2>{html.escape(name)}</h2>{_html_table(header, rows)}<p>{html.escape(note)}</p>")
    for caption, figure in figures:
        page += [f"<h2>{html.escape(caption)}</h2>", _image(figure)]
    return "\n".join(page)


def report_tables(runs: Sequence[Run]) -> list[tuple[str, list[str], list[list[str]]]]:
    """Return title, header and rows of: mean error, error per axis, and what the source and the training say."""
    per_axis = [
        [
            run.group,
            run.method,
            str(run.seed),
            *(
                f"{n:.3f} ({p:.1f} %)"
                for n, p in zip(run.target_test.mae_n, run.target_test.mae_percent, strict=True)
            ),
            *(f"{value:.2f}" for value in run.target_test.r2),
            f"{run.target_constant_mean.mean_mae_n:.3f}",
        ]
        for run in runs
    ]
    training = [
        [
            run.group,
            run.method,
            str(run.seed),
            str(run.profile["name"]),
            "–" if run.source_held_out is None else f"{run.source_held_out.mean_mae_n:.3f}",
            "–" if run.source_constant_mean is None else f"{run.source_constant_mean.mean_mae_n:.3f}",
            str(run.skipped_steps),
            f"{run.wall_s['stage1']:.1f}",
            f"{run.wall_s['stage2']:.1f}",
        ]
        for run in runs
    ]
    axes = ["Fx, N", "Fy, N", "Fz, N", "R² x", "R² y", "R² z"]
    stages = ["skipped steps", "stage 1, s", "stage 2, s"]
    return [
        ("Mean error on the target's test frames, N", *error_rows(runs)),
        ("Error per axis on the target", ["group", "method", "seed", *axes, "constant mean, N"], per_axis),
        (
            "Training",
            ["group", "method", "seed", "profile", "source held out, N", "its constant mean, N", *stages],
            training,
        ),
    ]


def _html_table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    head = "".join(f"<th>{html.escape(cell)}</th>" for cell in header)
    body = "".join(
        "<tr>" + "".join(f"<td>{html.escape(cell)}</td>" for cell in row) + "</tr>" for row in rows
    )
    return f"<table><tr>{head}</tr>{body}</table>"


def _figures(runs: Sequence[Run]) -> list[tuple[str, "Figure"]]:
    """Return, for each group's first seed, the scatter and the t-SNE of its methods."""
    figures = []
    for group in dict.fromkeys(run.group for run in runs):
        of_group = [run for run in runs if run.group == group]
        seed = min(run.seed for run in of_group)
        arrays = {run.method: load_predictions(run) for run in of_group if run.seed == seed}
        truth = next(iter(arrays.values()))["target_true_n"]
        scatter = force_scatter(truth, {method: a["target_predicted_n"] for method, a in arrays.items()})
        plane = feature_tsne({m: (a["source_features"], a["target_features"]) for m, a in arrays.items()})
        figures += [
            (f"{group}, seed {seed}: predicted against true force", scatter),
            (f"{group}, seed {seed}: features of both domains", plane),
        ]
    return figures


def _image(figure: "Figure") -> str:
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=80)
    return f'<img alt="" src="data:image/png;base64,{base64.b64encode(buffer.getvalue()).decode()}">'
