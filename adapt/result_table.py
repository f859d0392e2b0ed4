"""A table of results, shown as a text table, Markdown, LaTeX or HTML."""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from numbers import Real

import numpy as np

from gelgap.assets import html_page

_LATEX = {
    "\\": r"\textbackslash{}",
    "{": r"\{",
    "}": r"\}",
    "$": r"\$",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "λ_t": r"$\lambda_t$",
    "_": r"\_",
    "%": r"\%",
    "&": r"\&",
    "#": r"\#",
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
"""LaTeX for what tables use beyond plain letters; where two keys fit, the first is taken."""
_LATEX_KEY = re.compile("|".join(map(re.escape, _LATEX)))


@dataclass(frozen=True)
class ResultTable:
    """A titled table. Cells are text, numbers, truth values or None; the note stands below the table."""

    title: str
    columns: Sequence[str]
    rows: Sequence[Sequence[object]]
    note: str = ""

    @property
    def cells(self) -> list[list[str]]:
        """The text of every cell, row by row."""
        return [[cell_text(value) for value in row] for row in self.rows]

    def markdown(self) -> str:
        """Return the table in Markdown, with its title as a heading of the second level."""
        rule = ["---", *("---:" for _ in self.columns[1:])]
        rows = [[markdown_text(cell) for cell in row] for row in (self.columns, *self.cells)]
        table = "\n".join("| " + " | ".join(line) + " |" for line in (rows[0], rule, *rows[1:]))
        title, note = markdown_text(self.title), markdown_text(self.note)
        return f"## {title}\n\n{table}\n" + (f"\n{note}\n" if note else "")

    def latex(self) -> str:
        """Return a LaTeX tabular in booktabs' style, with its title as a comment."""
        return "\n".join([f"% {' '.join(self.title.split())}", *self._latex_lines()]) + "\n"

    def _latex_lines(self) -> Iterator[str]:
        yield r"\begin{tabular}{l" + "r" * (len(self.columns) - 1) + "}"
        yield r"\toprule"
        yield _latex_row(self.columns)
        yield r"\midrule"
        yield from map(_latex_row, self.cells)
        yield r"\bottomrule"
        yield r"\end{tabular}"

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


def _latex_row(cells: Sequence[str]) -> str:
    return " & ".join(_LATEX_KEY.sub(lambda key: _LATEX[key[0]], cell) for cell in cells) + r" \\"
