"""`gelgap inspect`: what a data set holds, checked."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import tyro

from gelgap import data
from gelgap.cli import options as opt


@dataclass(frozen=True)
class Inspect(opt.Command):
    """Say what a domain holds: frames, forces, contacts, what did not converge; check its files; draw a page.

    For example:
      gelgap inspect data/mb0i0 --verify --html mb0i0.html
      gelgap inspect data/wmb1i1 --gap-to data/mb0i0
    """

    folder: tyro.conf.Positional[Path]
    """Folder of one domain, or of several."""
    verify: opt.Flag = False
    """Compare every byte with the manifest, or decode every picture of real data; exit code 1 if one is damaged."""
    html: Annotated[Path | None, opt.optional("PATH"), opt.OutputFile()] = None
    """Write one self-contained page of pictures and plots (of one domain)."""
    gap_to: Annotated[Path | None, opt.optional("PATH")] = None
    """Folder of another domain: say how far this one is from it (colours, modulus, markers, forces)."""

    def run(self, started: float) -> None:
        """Print the facts, and write the page."""
        from gelgap.data.frames.folders import domain_folders
        from gelgap.data.inspection import inspect_domain, write_overview

        folders = domain_folders(self.folder)
        if self.html is not None and len(folders) > 1:
            names = ", ".join(folder.name for folder in folders)
            raise ValueError(f"--html shows one domain; {self.folder} holds {names}: name one of them")
        base = data.open_domain(self.gap_to) if self.gap_to is not None else None
        gap: dict[str, Any] | None = None
        intact = _verified(folders) if self.verify else ""
        for folder in folders:
            print(inspect_domain(folder))
            if base is not None:
                from gelgap.domains.measured_gap import gap_rows

                gap = {"base": base.name, "rows": gap_rows(data.open_domain(folder), base)}
                print(f"  gap from {self.gap_to}:")
                for what, value in gap["rows"]:
                    print(f"    {what}: {value}")
        if intact:
            print(intact)
        if self.html is not None:
            print(f"wrote {write_overview(folders[0], self.html, gap)}")


def _verified(folders: tuple[Path, ...]) -> str:
    """Return what is sure of files without damage; a RuntimeError says what to do about damage.

    What gelgap generated it makes again, real data it cannot.
    """
    from gelgap.data.formats.domain_folder import MANIFEST

    generated = all((folder / MANIFEST).exists() for folder in folders)
    damages = [(folder.name, damage) for folder in folders for damage in data.verify_domain(folder)]
    if not damages:
        return "every file is what its manifest says" if generated else "every picture and force is readable"
    advice = (
        "The same gelgap generate command repairs it, with --overwrite if the manifest is damaged"
        if generated
        else "Take these rows out of the table, or replace the files by whole ones"
    )
    raise RuntimeError(f"damaged: {'; '.join(f'{name}/{damage}' for name, damage in damages)}. {advice}")
