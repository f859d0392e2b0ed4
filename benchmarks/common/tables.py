"""How benchmarks show what they measured: tables, JSON, and run time against error as a plot."""

import dataclasses
import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gelgap.adapt import ResultTable
from gelgap.assets.whole_file import write_whole


def print_table(title: str, columns: Sequence[str], rows: Iterable[Sequence[object]], note: str = "") -> None:
    """Print a table of values; see `ResultTable`."""
    ResultTable(title, columns, [list(row) for row in rows], note).show()


def write_json(path: Path, results: Any) -> None:
    """Write results (dataclasses, arrays and numbers included) as indented JSON, making the folder."""
    write_whole(path, (json.dumps(results, indent=1, default=plain) + "\n").encode())


def plain(value: Any) -> Any:
    """Return what JSON can hold in place of a dataclass, an array or a NumPy number: `json.dumps`' default."""
    if dataclasses.is_dataclass(value):
        return dataclasses.asdict(value)
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, np.generic):
        return value.item()
    return str(value)


@dataclass(frozen=True)
class Point:
    """One way of doing the job: what it is called, how long it took and how wrong it was.

    Points of one `series` are joined by a line.
    """

    series: str
    name: str
    seconds: float
    error: float


def plot_frontier(
    path: Path,
    points: Sequence[Point],
    *,
    title: str,
    error_label: str,
    time_label: str = "run time, s",
    uncertainty: float | None = None,
    targets: Sequence[float] = (),
    unjoined: Sequence[str] = (),
) -> None:
    """Draw error against run time, log-log; `uncertainty` of the reference is shaded, targets are dashed.

    The points of a series are joined in the order of their run time, except in the series `unjoined`.
    """
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(8, 5), constrained_layout=True)
    for series in dict.fromkeys(point.series for point in points):
        members = sorted((p for p in points if p.series == series), key=lambda p: p.seconds)
        style = "o" if series in unjoined else "o-"
        axes.loglog([p.seconds for p in members], [p.error for p in members], style, label=series)
        for number, point in enumerate(members):
            axes.annotate(
                point.name,
                (point.seconds, point.error),
                xytext=(5, (4, -11, 15)[number % 3]),
                textcoords="offset points",
                fontsize=8,
            )
    if uncertainty is not None:
        axes.axhspan(
            min(axes.get_ylim()[0], uncertainty / 3),
            uncertainty,
            color="0.85",
            label="the reference's uncertainty",
        )
    for target in targets:
        axes.axhline(target, color="0.4", linestyle="--", linewidth=1)
    axes.set(title=title, xlabel=time_label, ylabel=error_label)
    axes.grid(visible=True, which="both", linewidth=0.3)
    figure.legend(fontsize=8, loc="outside lower center", ncols=2)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=150)
    plt.close(figure)
