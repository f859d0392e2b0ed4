"""`gelgap generate`: labelled domains on disk."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar, Literal

import tyro

from gelgap.cli.arguments import Flag, load_sensor, optional

OptionalColumn = Literal["height_map", "contact_mask", "marker_rest_mm", "marker_px", "diagnostics"]


@dataclass(frozen=True)
class Generate:
    """Generate domains: press, render, label and write them; run it again to resume or to check that all is there.

    A domain is elastomer × illumination × markers: mb0i0 has markers, elastomer b0, illumination i0; wmb1i1 is without
    markers. Each becomes a folder of Parquet shards under --out. Physics is solved once for each distinct gel.

    For example:
      gelgap generate mb0i0 wmb1i1 --path cpu --out data
      gelgap generate --preset paper --out paper-data
      gelgap generate --preset paper --out paper-data --dry-run
    """

    when_stopped: ClassVar[str] = "finished shards and solves are kept, run the same command again to go on"

    domains: Annotated[tyro.conf.Positional[tuple[str, ...]], optional("[DOMAIN ...]")] = ()
    """Names of domains; or leave them out and give --preset or --sweep."""
    out: Annotated[Path | None, tyro.conf.arg(metavar="PATH", help_behavior_hint="(required)")] = None
    """Folder that gets one folder per domain."""
    preset: Annotated[str | None, optional("NAME")] = None
    """A whole data set (see: gelgap presets datasets)."""
    sweep: Annotated[Path | None, optional("TOML")] = None
    """A TOML file that crosses factors around a base domain; each domain's gap to the base goes to sweep.json."""
    path: str = "cpu"
    """Contact path of the named domains: a preset (see: gelgap presets paths) or a TOML file."""
    quality: Literal["draft", "standard", "fine"] = "standard"
    """Quality of the physics."""
    seed: int = 0
    """Seed of sensor noise and acquisition errors."""
    sensor: str = "paper"
    """Sensor preset or TOML file."""
    size: tuple[int, int] = (320, 240)
    """Width and height of the pictures in pixels."""
    columns: Annotated[tuple[OptionalColumn, ...], tyro.conf.arg(help_behavior_hint="(default: none)")] = ()
    """Optional columns to write as well; `diagnostics`: how each pose was solved."""
    contacts: Literal["paired", "independent"] = "paired"
    """The same poses in every domain, or a draw of its own for each domain."""
    rendered_without_markers: Flag = False
    """Render wmb0i0 without markers instead of inpainting the markers of mb0i0 (the paper's way)."""
    scheduler: Annotated[str | None, optional("ADDRESS", "a local cluster")] = None
    """Address of a Dask scheduler, such as tcp://host:8786; `synchronous` runs in this process."""
    workers: Annotated[int | None, optional("N", "one per core")] = None
    """Processes of the local cluster."""
    dry_run: Flag = False
    """Only say what would be done: solves, frames, estimated time and disk."""
    overwrite: Flag = False
    """Replace domains under --out that hold another configuration."""

    def run(self, started: float) -> None:
        """Plan and run the generation."""
        if self.out is None:
            raise ValueError(
                "--out is missing: name the folder that gets the domains, for example --out data"
            )
        if sum(map(bool, (self.domains, self.preset, self.sweep))) != 1:
            raise ValueError(
                "name one of: domains (for example mb0i0 wmb1i1), a --preset (smoke, cpu, paper), a --sweep file"
            )

        from gelgap.domains import (
            Sweep,
            estimate,
            generate_recipes,
            make_recipes,
            preset_recipes,
            shown_progress,
            sweep_variants,
            write_sweep,
        )

        settings = {
            "sensor": load_sensor(self.sensor),
            "columns": self.columns,
            "quality": self.quality,
            "seed": self.seed,
            "size_px": self.size,
            "contacts": self.contacts,
        }
        if self.rendered_without_markers:
            settings["inpainted"] = ()
        variants = ()
        if self.sweep:
            variants = sweep_variants(Sweep.load(self.sweep), **settings)
            recipes = tuple(variant.recipe for variant in variants)
        elif self.preset:
            recipes = preset_recipes(self.preset, **settings)
        else:
            recipes = make_recipes(self.domains, self.path, **settings)
        if self.dry_run:
            print(estimate(recipes, self.workers))
            return
        with shown_progress() as progress:
            report = generate_recipes(
                recipes,
                self.out,
                scheduler=self.scheduler,
                workers=self.workers,
                overwrite=self.overwrite,
                progress=progress,
            )
        print(report)
        if variants:
            print(f"gaps to the base: {write_sweep(variants, self.out)}")
