"""`gelgap export`: a data set in other people's formats."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from gelgap import domains
from gelgap.cli import options as opt


@dataclass(frozen=True)
class Export(opt.Command):
    """Write domains in another format: the paper's folders, WebDataset tars, Hugging Face, FEATS, LeRobot, ….

    For example:
      gelgap export data --format huggingface --split-by point --out upload
      gelgap export data --format lerobot-v3 --out episodes
    """

    folder: tyro.conf.Positional[Path]
    """Folder of one domain, or of several."""
    out: Annotated[Path, opt.output_folder]
    """New folder for the export."""
    format_name: Annotated[
        Literal["paper", "webdataset", "huggingface", "feats", "mini-pretrain", "lerobot-v3"],
        tyro.conf.arg(name="format"),
    ] = "paper"
    """The layout to write; mini-pretrain: the columns of the Hugging Face set yxma/gelsight-mini-pretrain."""
    split_by: Annotated[str | None, opt.optional("COLUMN", "as the data state")] = None
    """Draw train, validation and test anew: at random, by contact point (point), or by a column; whole groups."""

    def run(self, started: float) -> None:
        """Export, and name what was written."""
        for path in domains.export(self.folder, self.format_name, self.out, split_by=self.split_by):
            print(f"wrote {path}")
