"""Tables and figures of results: as text, Markdown, LaTeX, and one self-contained HTML page."""

import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from numbers import Real
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import quote

import numpy as np

from gelgap.assets import html_page
from gelgap.assets.whole_file import write_whole

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from pandas import DataFrame

_DPI = 80
_LATEX = {
    r"λ\_t": r"$\lambda_t$",
    "→": r"$\to$",
    "±": r"$\pm$",
    "×": r"$\times$",
    "≥": r"$\ge$",
    "<": "$<$",
    ">": "$>$",
    "²": "$^2$",
    "…": "--",
    "–": "--",
    "−": "$-$",
}
"""LaTeX for what tables use beyond the characters that pandas escapes."""


@dataclass(frozen=True)
class ResultTable:
    """A titled table. Cells are text, numbers, truth values or None; the note stands below the table."""

    title: str
    columns: Sequence[str]
    rows: Sequence[Sequence[object]]
    note: str = ""

    @classmethod
    def of(
        cls, title: str, frame: "DataFrame", note: str = "", formats: Mapping[str, str] | None = None
    ) -> "ResultTable":
        """Return the table of a DataFrame, the named levels of its index as first columns.

        NaN is a dash, and a tuple a range such as 1…2. `formats` has patterns for numbers, such as "{:.1f} %", by
        column; that of "" is for all other columns.
        """
        frame = frame.reset_index(level=[name for name in frame.index.names if name is not None])
        patterns = [(formats or {}).get(column, (formats or {}).get("")) for column in frame.columns]
        rows = [list(map(cell, row, patterns)) for row in frame.itertuples(index=False, name=None)]
        return cls(title, list(map(str, frame.columns)), rows, note)

    @property
    def cells(self) -> list[list[str]]:
        """The text of every cell, row by row."""
        return [[cell_text(value) for value in row] for row in self.rows]

    def markdown(self) -> str:
        """Return the table in Markdown, with its title as a heading of the second level."""
        rule = ["---", *("---:" for _ in self.columns[1:])]
        head, *rows = [[markdown_text(cell) for cell in row] for row in (self.columns, *self.cells)]
        table = "\n".join("| " + " | ".join(line) + " |" for line in (head, rule, *rows))
        title, note = markdown_text(self.title), markdown_text(self.note)
        return f"## {title}\n\n{table}\n" + (f"\n{note}\n" if note else "")

    def latex(self) -> str:
        """Return a LaTeX tabular in booktabs' style, with its title as a comment."""
        from pandas import DataFrame

        style = DataFrame(self.cells, columns=list(self.columns)).style.hide(axis="index")
        style = style.format(escape="latex").format_index(escape="latex", axis="columns")
        text = style.to_latex(column_format="l" + "r" * (len(self.columns) - 1), hrules=True)
        for symbol, latex in _LATEX.items():
            text = text.replace(symbol, latex)
        return f"% {' '.join(self.title.split())}\n{text}"

    def html(self) -> str:
        """Return an HTML heading, table and note, with every text escaped."""
        return html_page("table.html", table=self)

    def show(self) -> None:
        """Print the table, columns of numbers aligned right; 150 characters wide where there is no terminal."""
        from rich.box import SIMPLE
        from rich.console import Console
        from rich.table import Table

        table = Table(
            title=self.title,
            caption=self.note or None,
            box=SIMPLE,
            title_justify="left",
            caption_justify="left",
        )
        for index, column in enumerate(self.columns):
            numeric = all(isinstance(row[index], Real | None) for row in self.rows)
            table.add_column(column, justify="right" if numeric else "left", no_wrap=index == 0)
        for row in self.cells:
            table.add_row(*row)
        width = None if Console().is_terminal else 150
        Console(width=width, highlight=False, markup=False, emoji=False).print(table)


def cell(value: object, pattern: str | None = None) -> object:
    """Return a value as a cell of a table: a number by a pattern, None for NaN, a tuple as a range such as 1…2."""
    if isinstance(value, tuple):
        ends = [cell(end, pattern) for end in value]
        return None if None in ends else "…".join(map(str, ends))
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return None
    return value if pattern is None or isinstance(value, str | bool) else pattern.format(value)


def cell_text(value: object) -> str:
    """Return a cell's text: four significant digits for a float, yes or no for a truth value, a dash for None."""
    if value is None:
        return "–"
    if isinstance(value, bool | np.bool_):
        return "yes" if value else "no"
    if isinstance(value, float | np.floating):
        return f"{value:.4g}"
    return str(value)


def markdown_text(text: str) -> str:
    """Return a text so that Markdown shows it in one line: no HTML, no border of a cell."""
    escaped = text.replace("&", "&amp;").replace("<", "&lt;").replace("|", "\\|")
    return " ".join(escaped.splitlines())


@dataclass(frozen=True)
class NamedFigure:
    """A figure, the name of its file (without ending) and what it shows."""

    name: str
    caption: str
    figure: "Figure"

    @property
    def png(self) -> bytes:
        """The figure as a PNG file's bytes."""
        buffer = io.BytesIO()
        self.figure.savefig(buffer, format="png", dpi=_DPI)
        return buffer.getvalue()


def write_pages(
    folder: Path, name: str, title: str, tables: Sequence[ResultTable], figures: Sequence[NamedFigure]
) -> Path:
    """Write `<name>.md`, `<name>.tex`, `<name>.html` and each figure as PNG; return the HTML's path."""
    pictures = [(figure, figure.png) for figure in figures]
    for figure, png in pictures:
        write_whole(folder / f"{figure.name}.png", png)
    parts = [f"# {markdown_text(title)}\n", *(table.markdown() for table in tables)]
    for figure in figures:
        caption = markdown_text(figure.caption)
        parts.append(f"## {caption}\n\n![{caption}]({quote(figure.name)}.png)\n")
    latex = [table.latex() for table in tables]
    captioned = [(figure.caption, png) for figure, png in pictures]
    html = html_page("results.html", title=title, tables=tables, figures=captioned)
    for ending, text in (("md", "\n".join(parts)), ("tex", "\n".join(latex)), ("html", html)):
        write_whole(folder / f"{name}.{ending}", text.encode())
    return folder / f"{name}.html"
