"""`gelgap generate`: labelled domains on disk."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from gelgap import domains, render, sim
from gelgap.cli import options as opt
from gelgap.cli.adapt import label_ranges

if TYPE_CHECKING:
    from gelgap.domains.sweep import Variant

OptionalColumn = Literal[
    "height_map",
    "contact_mask",
    "marker_rest_mm",
    "marker_px",
    "diagnostics",
    "indenter",
    "torque",
    "traction",
    "turn",
]


def force_ranges(texts: tuple[str, ...]) -> tuple[tuple[float, float], ...]:
    """Return the ranges of Fx, Fy and Fz of texts such as `fz_n=-40:0`; an axis that is not named has the paper's."""
    from gelgap.domains.frames.labels import PAPER_RANGES

    given, papers = label_ranges(texts), PAPER_RANGES
    if others := sorted(given.keys() - papers.keys()):
        raise ValueError(f"{others[0]} is no axis of the force; known: {', '.join(papers)}")
    return tuple((papers | given).values())


@dataclass(frozen=True)
class Generate(opt.Command):
    """Generate domains: press, render, label and write them; run it again to resume or to check that all is there.

    A domain is elastomer × illumination × markers: mb0i0 has markers, elastomer b0, illumination i0; wmb1i1 is without
    markers. Each becomes a folder of Parquet shards under --out. Physics is solved once for each distinct gel.

    For example:
      gelgap generate mb0i0 wmb1i1 --path cpu --out data
      gelgap generate --preset paper --out paper-data
      gelgap generate --preset paper --out paper-data --dry-run
      gelgap generate mb0i0 --indenter sphere-4 --further-indenters cone-60 cylinder-3 --out data --dry-run
      gelgap generate mb0i0 --elastomer b1 --illumination i2 --name soft --out data --dry-run
      gelgap generate wmb0i0 --lights-like reference.png --name like-mine --out data
    """

    when_stopped = "finished shards and solves are kept, run the same command again to go on"
    fills_cache = True

    out: Annotated[Path, opt.output_folder]
    """Folder that gets one folder per domain."""
    domains: Annotated[tyro.conf.Positional[tuple[str, ...]], opt.optional("[DOMAIN ...]")] = ()
    """Names of domains; or leave them out and give --preset or --sweep."""
    preset: Annotated[str | None, opt.optional("NAME")] = None
    """A whole data set (see: gelgap presets datasets)."""
    sweep: Annotated[Path | None, opt.optional("TOML")] = None
    """A TOML file that crosses factors around a base domain; each domain's gap to the base goes to sweep.json."""
    recipe: Annotated[Path | None, opt.optional("TOML")] = None
    """A TOML file of whole domains, with path, gels, lights and sensors, as `gelgap view` saves it."""
    elastomer: Annotated[str | None, opt.optional("NAME", "the domain's")] = None
    """Another elastomer than the named domain's: a preset or a TOML file; needs --name."""
    illumination: Annotated[str | None, opt.optional("NAME", "the domain's")] = None
    """Another illumination than the named domain's: a preset or a TOML file; needs --name."""
    lights_like: Annotated[Path | None, opt.optional("PICTURE")] = None
    """A sensor's picture without contact: make the domain in 8 drawn lights like its, or like --illumination turned
    and recoloured to suit it, as NAME-1 to NAME-8 with the frames of one; needs --name."""
    name: Annotated[str | None, opt.optional("NAME")] = None
    """What the domain with parts of your own is called; without a named domain the rest is from mb0i0."""
    body: Annotated[opt.IndenterOptions, tyro.conf.OmitArgPrefixes] = opt.SPHERE
    further_indenters: Annotated[tuple[str, ...] | None, opt.optional("NAME [NAME ...]", "none")] = None
    """Indenters that go the whole path after the first: shapes, presets, TOML or mesh files; column `indenter`."""
    path: str = "cpu"
    """Contact path of the named domains: a preset (see: gelgap presets paths) or a TOML file."""
    quality: opt.Quality = "standard"
    """Quality of the physics."""
    seed: opt.Seed = 0
    """Seed of sensor noise and acquisition errors."""
    sensor: str = "paper"
    """Sensor preset or TOML file."""
    size: opt.PictureSize = (320, 240)
    columns: Annotated[tuple[OptionalColumn, ...], tyro.conf.arg(help_behavior_hint="(default: none)")] = ()
    """Optional columns to write as well: pictures of the contact, how it was solved, six axes, force by cell."""
    force_range: Annotated[
        tuple[str, ...] | None, opt.optional("NAME=LOW:HIGH ...", "the paper's"), force_ranges
    ] = None
    """Declared ranges of forces in N, as fz_n=-40:0, by which training normalises; it refuses forces outside."""
    contacts: Literal["paired", "independent"] = "paired"
    """The same poses in every domain, or a draw of its own for each domain."""
    exact: opt.Flag = False
    """Solve every pose of a random path, instead of interpolating it from a library of a few solves."""
    rendered_without_markers: opt.Flag = False
    """Render wmb0i0 without markers instead of inpainting the markers of mb0i0 (the paper's way)."""
    generation: Annotated[opt.GenerationOptions, tyro.conf.OmitArgPrefixes] = opt.LOCALLY

    def run(self, started: float) -> None:
        """Plan and run the generation."""
        from gelgap.domains.sweep import write_sweep

        self.generation.check()
        self._check_choices()
        recipes, variants = self._recipes()
        if self.generation.dry_run:
            print(domains.estimate(recipes, self.generation.workers))
            return
        self.generation.generate(recipes, self.out)
        if variants:
            print(f"gaps to the base: {write_sweep(variants, self.out)}")

    def _check_choices(self) -> None:
        """Refuse options that lack or exclude each other."""
        sources = [bool(source) for source in (self.domains, self.preset, self.sweep, self.recipe)]
        if sum(sources) > 1 or not (any(sources) or self.name):
            raise ValueError(
                "name one of: domains (for example mb0i0 wmb1i1), a --preset (smoke, cpu, paper), a --sweep file, "
                "a --recipe file"
            )
        if self.name is None and (self.elastomer or self.illumination or self.lights_like):
            raise ValueError(
                "--name is missing: a domain with an --elastomer, an --illumination or --lights-like of your own needs "
                "a name, for example --name my-gel"
            )
        if self.name is not None and (any(sources[1:]) or len(self.domains) > 1):
            raise ValueError(
                f"--name = {self.name!r}: names one domain; give it with one domain or none, "
                "not with --preset, --sweep or --recipe"
            )

    def _recipes(self) -> "tuple[tuple[domains.DomainRecipe, ...], tuple[Variant, ...]]":
        """Return the domains to make and, of a sweep, its variants."""
        from gelgap.assets.image_file import read_image
        from gelgap.assets.toml_file import named_in_errors
        from gelgap.domains.sweep import sweep_variants

        settings = {
            "indenter": self.body.make(),
            "further_indenters": tuple(map(sim.load_indenter, self.further_indenters or ())),
            "sensor": opt.named(render.Sensor, self.sensor),
            "columns": tuple(dict.fromkeys((*self.columns, *["indenter"] * bool(self.further_indenters)))),
            "quality": self.quality,
            "seed": self.seed,
            "size_px": self.size,
            "contacts": self.contacts,
            "exact": self.exact,
        }
        if self.force_range is not None:
            settings["force_range_n"] = force_ranges(self.force_range)
        if self.rendered_without_markers:
            settings["inpainted"] = ()
        if self.sweep:
            variants = sweep_variants(domains.Sweep.load(self.sweep), **settings)
            return tuple(variant.recipe for variant in variants), variants
        if self.recipe:
            return domains.load_recipes(self.recipe, **settings), ()
        if self.preset:
            return domains.preset_recipes(self.preset, **settings), ()
        if self.name is None:
            return domains.make_recipes(self.domains, self.path, **settings), ()
        recipe = domains.own_recipe(
            self.name,
            self.path,
            base=self.domains[0] if self.domains else "mb0i0",
            elastomer=self.elastomer and opt.named(sim.Elastomer, self.elastomer),
            illumination=self.illumination and opt.named(render.Illumination, self.illumination),
            **settings,
        )
        if self.lights_like is None:
            return (recipe,), ()
        like, kinds = read_image(self.lights_like), self.illumination and [recipe.illumination]
        with named_in_errors(self.lights_like):
            return domains.in_drawn_lights(recipe, like, kinds), ()
