"""`gelgap inspect`: what a data set holds, checked."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar

import tyro

from gelgap.cli.arguments import Flag, optional


@dataclass(frozen=True)
class Inspect:
    """Say what a domain holds: frames, forces, contacts, what did not converge; check its files; draw a page.

    For example:
      gelgap inspect data/mb0i0 --verify --html mb0i0.html
      gelgap inspect data/wmb1i1 --gap-to data/mb0i0
    """

    when_stopped: ClassVar[str] = "nothing was changed; run the same command again to start over"

    folder: tyro.conf.Positional[Path]
    """Folder of one domain, or of several."""
    verify: Flag = False
    """Read every byte and compare it with the manifest; exit code 1 if anything is damaged."""
    html: Annotated[Path | None, optional("PATH")] = None
    """Write one self-contained page of pictures and plots (of one domain)."""
    gap_to: Annotated[Path | None, optional("PATH")] = None
    """Folder of another domain: say how far this one is from it (colours, modulus, markers, forces)."""

    def run(self, started: float) -> None:
        """Print the facts, and write the page."""
        from gelgap.domains import (
            domain_folders,
            gap_rows,
            inspect_domain,
            open_domain,
            verify_domain,
            write_overview,
        )

        folders = domain_folders(self.folder)
        if self.html is not None and len(folders) > 1:
            names = ", ".join(folder.name for folder in folders)
            raise ValueError(f"--html shows one domain; {self.folder} holds {names}: name one of them")
        base = open_domain(self.gap_to) if self.gap_to is not None else None
        damages = {folder: verify_domain(folder) for folder in folders} if self.verify else {}
        if any(damages.values()):
            listed = "; ".join(f"{folder.name}/{damage}" for folder in folders for damage in damages[folder])
            raise RuntimeError(f"damaged: {listed}. The same gelgap generate command repairs it")
        for folder in folders:
            print(inspect_domain(folder))
            if base is not None:
                print(f"  gap from {self.gap_to}:")
                for what, value in gap_rows(open_domain(folder), base):
                    print(f"    {what}: {value}")
        if self.verify:
            print("every file is what its manifest says")
        if self.html is not None:
            print(f"wrote {write_overview(folders[0], self.html, self.gap_to)}")
