"""`gelgap generate`: labelled domains on disk."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

import tyro

from gelgap.cli.arguments import (
    Flag,
    SensorName,
    load_elastomer,
    load_illumination,
    load_sensor,
    optional,
)
from gelgap.cli.rules import (
    PICTURE_SIDES,
    SEED,
    WORKERS,
    Between,
    InputFile,
    OutputFolder,
    Preset,
    Scheduler,
)

if TYPE_CHECKING:
    from gelgap.domains import DomainRecipe
    from gelgap.domains.sweep import Variant

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
      gelgap generate mb0i0 --elastomer b1 --illumination i2 --name soft --out data --dry-run
    """

    when_stopped: ClassVar[str] = "finished shards and solves are kept, run the same command again to go on"

    domains: Annotated[tyro.conf.Positional[tuple[str, ...]], optional("[DOMAIN ...]")] = ()
    """Names of domains; or leave them out and give --preset or --sweep."""
    out: Annotated[
        Path | None, tyro.conf.arg(metavar="PATH", help_behavior_hint="(required)"), OutputFolder()
    ] = None
    """Folder that gets one folder per domain."""
    preset: Annotated[str | None, optional("NAME"), Preset("datasets", or_file=False)] = None
    """A whole data set (see: gelgap presets datasets)."""
    sweep: Annotated[Path | None, optional("TOML"), InputFile("a TOML file")] = None
    """A TOML file that crosses factors around a base domain; each domain's gap to the base goes to sweep.json."""
    recipe: Annotated[Path | None, optional("TOML"), InputFile("a TOML file")] = None
    """A TOML file of whole domains, with path, gels, lights and sensors, as `gelgap view` saves it."""
    elastomer: Annotated[str | None, optional("NAME", "the domain's"), Preset("elastomers")] = None
    """Another elastomer than the named domain's: a preset or a TOML file; needs --name."""
    illumination: Annotated[str | None, optional("NAME", "the domain's"), Preset("illuminations")] = None
    """Another illumination than the named domain's: a preset or a TOML file; needs --name."""
    name: Annotated[str | None, optional("NAME")] = None
    """What the domain with parts of your own is called; without a named domain the rest is from mb0i0."""
    indenter_diameter_mm: Annotated[float, Between(0.5, 50, "mm")] = 3.0
    """Diameter of the sphere that is pressed, in mm; large ones may need a wider declared range of forces."""
    path: Annotated[str, Preset("paths")] = "cpu"
    """Contact path of the named domains: a preset (see: gelgap presets paths) or a TOML file."""
    quality: Literal["draft", "standard", "fine"] = "standard"
    """Quality of the physics."""
    seed: Annotated[int, SEED] = 0
    """Seed of sensor noise and acquisition errors."""
    sensor: SensorName = "paper"
    """Sensor preset or TOML file."""
    size: Annotated[tuple[int, int], PICTURE_SIDES] = (320, 240)
    """Width and height of the pictures in pixels."""
    columns: Annotated[tuple[OptionalColumn, ...], tyro.conf.arg(help_behavior_hint="(default: none)")] = ()
    """Optional columns to write as well; `diagnostics`: how each pose was solved."""
    contacts: Literal["paired", "independent"] = "paired"
    """The same poses in every domain, or a draw of its own for each domain."""
    rendered_without_markers: Flag = False
    """Render wmb0i0 without markers instead of inpainting the markers of mb0i0 (the paper's way)."""
    scheduler: Annotated[str | None, optional("ADDRESS", "a local cluster"), Scheduler()] = None
    """Address of a Dask scheduler, such as tcp://host:8786; `synchronous` runs in this process."""
    workers: Annotated[int | None, optional("N", "one per core"), WORKERS] = None
    """Processes of the local cluster."""
    dry_run: Flag = False
    """Only say what would be done: solves, frames, estimated time and disk."""
    overwrite: Flag = False
    """Replace domains under --out that hold another configuration."""

    def run(self, started: float) -> None:
        """Plan and run the generation."""
        self._check_choices()
        from gelgap.domains import estimate, generate_recipes, shown_progress, write_sweep

        recipes, variants = self._recipes()
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

    def _check_choices(self) -> None:
        """Refuse options that lack or exclude each other."""
        if self.out is None:
            raise ValueError(
                "--out is missing: name the folder that gets the domains, for example --out data"
            )
        chosen = sum(map(bool, (self.domains, self.preset, self.sweep, self.recipe)))
        if chosen > 1 or (chosen == 0 and self.name is None):
            raise ValueError(
                "name one of: domains (for example mb0i0 wmb1i1), a --preset (smoke, cpu, paper), a --sweep file, "
                "a --recipe file"
            )
        own = [f"--{part}" for part in ("elastomer", "illumination") if getattr(self, part) is not None]
        if own and self.name is None:
            raise ValueError(
                f"--name is missing: a domain with {' and '.join(own)} of your own needs a name, "
                "for example --name my-gel"
            )
        if self.name is not None and (self.preset or self.sweep or self.recipe or len(self.domains) > 1):
            raise ValueError(
                f"--name = {self.name!r}: names one domain; give it with one domain or none, "
                "not with --preset, --sweep or --recipe"
            )
        if self.workers is not None and self.scheduler is not None:
            raise ValueError(
                f"--workers = {self.workers}: is for the local cluster; leave it out with --scheduler {self.scheduler}"
            )

    def _recipes(self) -> "tuple[tuple[DomainRecipe, ...], tuple[Variant, ...]]":
        """Return the domains to make and, of a sweep, its variants."""
        from gelgap.domains import (
            Sweep,
            load_recipes,
            make_recipes,
            own_recipe,
            preset_recipes,
            sweep_variants,
        )
        from gelgap.sim import Sphere

        settings = {
            "indenter": Sphere(diameter_mm=self.indenter_diameter_mm),
            "sensor": load_sensor(self.sensor),
            "columns": self.columns,
            "quality": self.quality,
            "seed": self.seed,
            "size_px": self.size,
            "contacts": self.contacts,
        }
        if self.rendered_without_markers:
            settings["inpainted"] = ()
        if self.sweep:
            variants = sweep_variants(Sweep.load(self.sweep), **settings)
            return tuple(variant.recipe for variant in variants), variants
        if self.recipe:
            return load_recipes(self.recipe, **settings), ()
        if self.preset:
            return preset_recipes(self.preset, **settings), ()
        if self.name is not None:
            parts = {
                "elastomer": load_elastomer(self.elastomer) if self.elastomer else None,
                "illumination": load_illumination(self.illumination) if self.illumination else None,
            }
            base = self.domains[0] if self.domains else "mb0i0"
            return (own_recipe(self.name, self.path, base=base, **parts, **settings),), ()
        return make_recipes(self.domains, self.path, **settings), ()
