"""`gelgap export`: a data set in other people's formats."""

from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Literal

import tyro

from gelgap import data
from gelgap.cli import options as opt


@dataclass(frozen=True)
class Export(opt.Command):
    """Write domains in another format: the paper's folders, or a folder for Hugging Face.

    For example:
      gelgap export data --format huggingface --split-by point --license cc-by-4.0 --out upload
    """

    former = MappingProxyType(
        {
            "--format webdataset": opt.Former("0.3.0", "--format huggingface is read frame by frame, too"),
        }
    )

    folder: tyro.conf.Positional[Path]
    """Folder of one domain, or of several."""
    out: Annotated[Path, opt.output_folder]
    """New folder for the export."""
    format_name: Annotated[
        Literal["paper", "huggingface"],
        tyro.conf.arg(name="format"),
    ] = "paper"
    """The layout to write."""
    split_by: Annotated[str | None, opt.optional("COLUMN", "as the data state")] = None
    """Draw train, validation and test anew: at random, by contact point (point), or by a column; whole groups."""

    license: Annotated[str | None, opt.optional("ID", "apache-2.0")] = None
    """The licence that the card of a huggingface export states, as Hugging Face names it."""

    def run(self, started: float) -> None:
        """Export, and name what was written."""
        written = data.export(
            self.folder, self.format_name, self.out, split_by=self.split_by, license=self.license
        )
        for path in written:
            print(f"wrote {path}")
