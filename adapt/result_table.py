"""Tables and figures of results: as text, as Markdown, and as one self-contained HTML page."""

import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from gelgap.assets.pages import html_page
from gelgap.assets.whole_file import write_whole

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_DPI = 80


@dataclass(frozen=True)
class ResultTable:
    """A titled table: a frame whose cells are text, with a note below."""

    title: str
    frame: pd.DataFrame
    note: str = ""

    @classmethod
    def of(
        cls, title: str, frame: pd.DataFrame, note: str = "", formats: Mapping[str, str] | None = None
    ) -> "ResultTable":
        """Return the table of a frame, the named levels of its index as first columns.

        A float has four significant digits, NaN is a dash, and a tuple a range such as 1…2. `formats` has patterns for
        numbers, such as "{:.1f} %", by column; that of "" is for all other columns.
        """
        frame = frame.reset_index(level=[name for name in frame.index.names if name is not None])
        patterns = formats or {}
        text = {
            str(name): [cell(value, patterns.get(str(name), patterns.get(""))) for value in values]
            for name, values in frame.items()
        }
        return cls(title, pd.DataFrame(text, dtype=object), note)

    @property
    def columns(self) -> list[str]:
        """Names of the columns."""
        return list(self.frame.columns)

    @property
    def cells(self) -> list[list[str]]:
        """The text of every cell, row by row."""
        return self.frame.to_numpy().tolist()

    def markdown(self) -> str:
        """Return the table in Markdown, with its title as a heading of the second level."""
        rule = ["---", *("---:" for _ in self.columns[1:])]
        head, *rows = [[_markdown_text(text) for text in row] for row in (self.columns, *self.cells)]
        table = "\n".join("| " + " | ".join(line) + " |" for line in (head, rule, *rows))
        title, note = _markdown_text(self.title), _markdown_text(self.note)
        return f"## {title}\n\n{table}\n" + (f"\n{note}\n" if note else "")

    def html(self) -> str:
        """Return an HTML heading, table and note, with every text escaped."""
        return html_page("table.html", table=self)

    def show(self) -> None:
        """Print the table, its first column aligned left."""
        first = self.columns[0]
        width = max(map(len, [first, *self.frame[first]]))
        shown = self.frame.rename(columns={first: first.ljust(width)})
        shown[first.ljust(width)] = self.frame[first].str.ljust(width)
        print(f"\n{self.title}\n\n{shown.to_string(index=False)}\n{self.note}")


def cell(value: object, pattern: str | None = None) -> str:
    """Return the text of a cell: a number by a pattern, yes or no for a truth value, a dash for None and NaN."""
    if isinstance(value, tuple):
        ends = [cell(end, pattern) for end in value]
        return "–" if "–" in ends else "…".join(ends)
    if value is None or value is pd.NaT or (isinstance(value, float | np.floating) and np.isnan(value)):
        return "–"
    if isinstance(value, bool | np.bool_):
        return "yes" if value else "no"
    if isinstance(value, str):
        return value
    if pattern is not None:
        return pattern.format(value)
    return f"{value:.4g}" if isinstance(value, float | np.floating) else str(value)


def _markdown_text(text: str) -> str:
    """Return a text so that Markdown shows it in one line: no HTML, no border of a cell."""
    escaped = text.replace("&", "&amp;").replace("<", "&lt;").replace("|", "\\|")
    return " ".join(escaped.splitlines())


@dataclass(frozen=True)
class NamedFigure:
    """A figure, and what it shows."""

    caption: str
    figure: "Figure"

    @property
    def png(self) -> bytes:
        """The figure as a PNG file's bytes."""
        buffer = io.BytesIO()
        self.figure.savefig(buffer, format="png", dpi=_DPI)
        return buffer.getvalue()


def write_page(
    path: Path, title: str, tables: Sequence[ResultTable], figures: Sequence[NamedFigure] = ()
) -> Path:
    """Write one HTML page that holds all it shows; return its path."""
    captioned = [(figure.caption, figure.png) for figure in figures]
    html = html_page("results.html", title=title, tables=tables, figures=captioned)
    write_whole(path, html.encode())
    return path
