"""`gelgap export`: a data set in other people's formats."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar, Literal

import tyro

from gelgap.cli import options as opt


@dataclass(frozen=True)
class Export(opt.Command):
    """Write domains in another format: the paper's folder layout, WebDataset tars, or a Hugging Face folder.

    For example:
      gelgap export data --format huggingface --out upload
    """

    when_stopped: ClassVar[str] = "nothing was written; run the same command again to start over"

    folder: Annotated[tyro.conf.Positional[Path], opt.domains_inside]
    """Folder of one domain, or of several."""
    out: Annotated[Path, opt.output_folder]
    """New folder for the export."""
    format_name: Annotated[Literal["paper", "webdataset", "huggingface"], tyro.conf.arg(name="format")] = (
        "paper"
    )
    """The layout to write."""

    def run(self, started: float) -> None:
        """Export, and name what was written."""
        from gelgap.domains import export

        for path in export(self.folder, self.format_name, self.out):
            print(f"wrote {path}")
