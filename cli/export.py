"""`gelgap export`: a data set in other people's formats."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from gelgap.cli.rules import InputFolder, OutputFolder

DOMAINS = InputFolder("the folder of one domain, or of several,")


@dataclass(frozen=True)
class Export:
    """Write domains in another format: the paper's folder layout, WebDataset tars, or a Hugging Face folder.

    For example:
      gelgap export data --format huggingface --out upload
    """

    folder: Annotated[tyro.conf.Positional[Path], DOMAINS]
    """Folder of one domain, or of several."""
    out: Annotated[Path, OutputFolder()]
    """New folder for the export."""
    format_name: Annotated[str, tyro.conf.arg(name="format")] = "paper"
    """paper, webdataset or huggingface."""

    def run(self, started: float) -> None:
        """Export, and name what was written."""
        from gelgap.domains import export

        for path in export(self.folder, self.format_name, self.out):
            print(f"wrote {path}")
