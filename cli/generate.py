"""`gelgap generate`: labelled domains on disk."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import tyro

from gelgap import domains, render, sim
from gelgap.assets import list_presets
from gelgap.assets.names import closest_name
from gelgap.cli import options as opt
from gelgap.cli.contact_keys import body_keys, gel_keys
from gelgap.cli.generation import LOCALLY, GenerationOptions
from gelgap.cli.keys import Meanings, Set, given
from gelgap.cli.label_ranges import label_ranges
from gelgap.data.formats.optional_columns import OptionalColumn

DATA_SETS = list_presets("datasets")


def force_ranges(texts: tuple[str, ...]) -> tuple[tuple[float, float], ...]:
    """Return the ranges of Fx, Fy and Fz of texts such as `fz_n=-40:0`; an axis that is not named has the paper's."""
    from gelgap.data.frames.labels import PAPER_RANGES

    given = label_ranges(texts)
    papers = PAPER_RANGES
    if others := sorted(given.keys() - papers.keys()):
        raise ValueError(f"{others[0]} is no axis of the force; known: {', '.join(papers)}")
    return tuple((papers | given).values())


def check_what(words: tuple[str, ...]) -> None:
    """Check names of domains, of which there may be several, or of a data set or a TOML file, which stands alone."""
    for word in words:
        if word in DATA_SETS or word.endswith(".toml"):
            if len(words) > 1:
                raise ValueError(f"{word} stands for several domains; name it alone")
            continue
        try:
            domains.Domain.parse(word)
        except ValueError as error:
            near = closest_name(word, DATA_SETS)
            raise ValueError(f"{error}; data sets: {', '.join(DATA_SETS)}{near}") from None


@dataclass(frozen=True)
class Generate(opt.Command):
    """Generate domains: press, render, label and write them; run it again to resume or to check that all is there.

    A domain is elastomer × illumination × markers: mb0i0 has markers, elastomer b0, illumination i0; wmb1i1 is without
    markers. Each becomes a folder of Parquet shards under --out. Physics is solved once for each distinct gel.

    For example:
      gelgap generate mb0i0 wmb1i1 --path cpu --out data
      gelgap generate paper --out paper-data
      gelgap generate paper --out paper-data --dry-run
      gelgap generate mb0i0 --indenter sphere-4 cone-60 cylinder-3 --out data --dry-run
      gelgap generate mb0i0 --set young_modulus_mpa=0.4 --name stiff --out data --dry-run
      gelgap generate mb0i0 --elastomer b1 --illumination i2 --name soft --out data --dry-run
      gelgap generate wmb0i0 --lights-like reference.png --name like-mine --out data
    """

    when_stopped = "finished shards and solves are kept, run the same command again to go on"
    fills_cache = True

    out: Annotated[Path, opt.output_folder]
    """Folder that gets one folder per domain."""
    what: Annotated[tyro.conf.Positional[tuple[str, ...]], opt.optional("[WHAT ...]"), check_what] = ()
    """Names of domains; or one data set (see: gelgap presets datasets); or one TOML file, of a sweep that crosses
    factors around a base domain, or of whole domains as `gelgap view` saves it."""
    elastomer: Annotated[str | None, opt.optional("NAME", "the domain's")] = None
    """Another elastomer than the named domain's: a preset or a TOML file; needs --name."""
    illumination: Annotated[str | None, opt.optional("NAME", "the domain's")] = None
    """Another illumination than the named domain's: a preset or a TOML file; needs --name."""
    lights_like: Annotated[Path | None, opt.optional("PICTURE")] = None
    """A sensor's picture without contact: make the domain in 8 drawn lights like its, or like --illumination turned
    and recoloured to suit it, as NAME-1 to NAME-8 with the frames of one; needs --name."""
    name: Annotated[str | None, opt.optional("NAME")] = None
    """What the domain with parts of your own is called; without a named domain the rest is from mb0i0."""
    indenter: tuple[str, ...] = ("sphere",)
    """Shapes, presets (gelgap presets indenters), TOML, mesh or map files; each goes the whole path, and of several the
    column `indenter` says which."""
    set: Set = ()
    """Values of the gel (needs --name), sizes of the body, and how the domains are made; all keys are listed above."""
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
    range: Annotated[
        tuple[str, ...] | None, opt.optional("NAME=LOW:HIGH ...", "the paper's"), force_ranges
    ] = None
    """Declared ranges of forces in N, as fz_n=-40:0, by which training normalises; it refuses forces outside."""
    generation: Annotated[GenerationOptions, tyro.conf.OmitArgPrefixes] = LOCALLY

    @classmethod
    def keys(cls) -> dict[str, Meanings]:
        fields = domains.DomainRecipe.model_fields
        making = {name: fields[name].description or "" for name in ("contacts", "interpolated")}
        return {"gel": gel_keys(), "body": body_keys(), "making of the domains": making}

    def run(self, started: float) -> None:
        """Plan and run the generation."""
        recipes, variants = self.recipes()
        if self.generation.dry_run:
            self.generation.estimate(recipes)
            return
        self.generation.generate(recipes, self.out)
        if variants:
            print(f"gaps to the base: {domains.Sweep.write_gaps(variants, self.out)}")

    def recipes(self) -> "tuple[tuple[domains.DomainRecipe, ...], tuple[Any, ...]]":
        """Return the domains to make and, of a sweep, what `Sweep.variants` returns."""
        from gelgap.assets.toml_file import read_toml

        gel, body, making = given(self.set, self.keys()).values()
        if not self.what and self.name is None:
            raise ValueError(
                "name what to make: domains (for example mb0i0 wmb1i1), a data set "
                f"({', '.join(DATA_SETS)}), or a TOML file"
            )
        if self.name is None and (self.elastomer or self.illumination or self.lights_like or gel):
            raise ValueError(
                "--name is missing: a domain with a gel, an --illumination or --lights-like of your own needs a name, "
                "for example --name my-gel"
            )
        settings = making | {
            "sensor": render.Sensor.named(self.sensor),
            "quality": self.quality,
            "seed": self.seed,
            "size_px": self.size,
        }
        settings |= self._pressed(body)
        if self.range is not None:
            settings["force_range_n"] = force_ranges(self.range)
        first = self.what[0] if len(self.what) == 1 else ""
        if self.name is not None:
            return self._own_domain(gel, settings), ()
        if first in DATA_SETS:
            return domains.preset_recipes(first, **settings), ()
        if not first.endswith(".toml"):
            return domains.make_recipes(self.what, self.path, **settings), ()
        if "domains" in read_toml(first):
            return domains.load_recipes(first, **settings), ()
        variants = domains.Sweep.load(first).variants(**settings)
        return tuple(variant.recipe for variant in variants), variants

    def _pressed(self, body: dict[str, Any]) -> dict[str, Any]:
        """Return the settings of the indenters, with sizes of the only one, and the columns."""
        if body and len(self.indenter) > 1:
            raise ValueError(
                f"--set {next(iter(body))}: is a size of which of the {len(self.indenter)} indenters? "
                "Give sizes of several in TOML files"
            )
        first, *further = (sim.load_indenter(name, **body) for name in self.indenter)
        columns = dict.fromkeys((*self.columns, "indenter") if further else self.columns)
        return {"indenter": first, "further_indenters": tuple(further), "columns": tuple(columns)}

    def _own_domain(
        self, gel: dict[str, Any], settings: dict[str, Any]
    ) -> "tuple[domains.DomainRecipe, ...]":
        """Return the domain with parts of one's own: one, or the same in several drawn lights."""
        from gelgap.assets.image_file import read_image
        from gelgap.assets.toml_file import named_in_errors

        base = self.what[0] if self.what else "mb0i0"
        if len(self.what) > 1 or base in DATA_SETS or base.endswith(".toml"):
            raise ValueError(
                f"--name = {self.name!r}: names one domain; give it with the name of one domain or none, "
                "not with a data set or a file"
            )
        elastomer = sim.Elastomer.named(self.elastomer or domains.Domain.parse(base).elastomer)
        recipe = domains.own_recipe(
            self.name,
            self.path,
            base=base,
            elastomer=sim.Elastomer(**elastomer.model_dump() | gel),
            illumination=self.illumination and render.Illumination.named(self.illumination),
            **settings,
        )
        if self.lights_like is None:
            return (recipe,)
        like = read_image(self.lights_like)
        kinds = self.illumination and [recipe.illumination]
        with named_in_errors(self.lights_like):
            return domains.in_drawn_lights(recipe, like, kinds)
