"""`gelgap report`: tables and figures of adaptation runs."""

import logging
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from gelgap import adapt
from gelgap.cli import options as opt

LOG = logging.getLogger(__name__)


def finished_runs(folder: Path) -> None:
    """Check a folder with finished runs of `gelgap adapt`, at any depth."""
    opt.input_folder("a folder with runs of gelgap adapt")(folder)
    if not any(folder.rglob("run.json")):
        raise ValueError(f"holds no finished adaptation run; `gelgap adapt … --out {folder}` writes one")


@dataclass(frozen=True)
class Report(opt.Command):
    """Write tables and figures of the runs that `gelgap adapt` left in a folder.

    For example:
      gelgap report runs
    """

    folder: Annotated[tyro.conf.Positional[Path], finished_runs]
    """Folder with finished runs, at any depth."""
    out: Annotated[Path | None, opt.optional("PATH", "the folder of the runs"), opt.output_folder] = None
    """Folder for the report."""

    def run(self, started: float) -> None:
        """Write the report and say where it is."""
        from gelgap.assets.locks import sole_use

        LOG.info("drawing the report of %s", self.folder)
        with sole_use(self.out or self.folder):
            print(f"wrote {adapt.write_report(self.folder, self.out)}")
