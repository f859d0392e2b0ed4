"""Tables and figures of results as Markdown, LaTeX and one self-contained HTML page."""

import base64
import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import quote

from gelgap.adapt.result_table import ResultTable, markdown_text
from gelgap.assets import html_page
from gelgap.assets.whole_file import write_whole

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_DPI = 80


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
    embedded = [(figure.caption, base64.b64encode(png).decode()) for figure, png in pictures]
    html = html_page("results.html", title=title, tables=tables, figures=embedded)
    for ending, text in (("md", "\n".join(parts)), ("tex", "\n".join(latex)), ("html", html)):
        write_whole(folder / f"{name}.{ending}", text.encode())
    return folder / f"{name}.html"
