"""Gap curves: each method's error against the size of one known gap at a time, and three gaps crossed."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import product
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from gelgap.adapt import NamedFigure, ResultTable
from gelgap.benchmarks.adaptation.jobs import RUNS, Bench, RunRecord, TrainingJob
from gelgap.benchmarks.adaptation.parts import Part
from gelgap.benchmarks.adaptation.running import run_missing
from gelgap.benchmarks.adaptation.tables import by_column, numbers
from gelgap.benchmarks.adaptation.work import adapt_job
from gelgap.benchmarks.common.records import read_results, write_results

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from gelgap.domains import DomainRecipe

BASE = "mb0i0"
PATH = PROFILE = "smoke"
METHODS = ("source-only", "adabn", "no-transfer", "dsan", "daregram")
SEEDS = (0, 1, 2)
RESULTS = "gaps/gaps.json"
CROSSED_MODULUS, CROSSED_LIGHT = 0.7, "mb0i1"
CROSSED = ("modulus", "light", "markers")


MODULUS, FRICTION = "elastomer.young_modulus_mpa", "elastomer.friction"
NOISE = "sensor.camera.read_noise_electrons"
SWEEPS = {
    "modulus": (MODULUS, "scale", (0.5, 0.7, 1.4)),
    "light": ("illumination.leds.*.drive", "scale", (0.5,)),
    "one-lamp": ("illumination.leds.0.drive", "scale", (0.4,)),
    "markers": ("sensor.markers.albedo.*", "set", (0.2, 0.35)),
    "no-markers": ("markers", "set", (False,)),
    "friction": (FRICTION, "set", (0.12, 0.5)),
    "noise": (NOISE, "scale", (10.0, 30.0)),
}
"""By name: the field of the one factor, its change and its values, as in a sweep file."""


@dataclass(frozen=True)
class Panel:
    """One curve: how the size of its gap is measured on base and target, and the sweeps and domains that lie on it."""

    name: str
    label: str
    size: "Callable[[DomainRecipe, DomainRecipe], float]"
    sweeps: tuple[str, ...]
    domains: tuple[str, ...] = ()
    logarithmic: bool = False

    def recipes(self, quality: str) -> "list[DomainRecipe]":
        """Return the curve's domains, without the base."""
        from gelgap.domains import Factor, Sweep, make_recipes, sweep_variants

        found = list(make_recipes(self.domains, PATH, quality=quality)) if self.domains else []
        for name in self.sweeps:
            field, change, values = SWEEPS[name]
            factor = Factor(field=field, change=change, values=values)
            sweep = Sweep(name=name, base=BASE, path=PATH, method="one-at-a-time", factors=(factor,))
            found += [variant.recipe for variant in sweep_variants(sweep, quality=quality)[1:]]
        return found


def _ratio(name: str) -> "Callable[[DomainRecipe, DomainRecipe], float]":
    value = attrgetter(name)
    return lambda base, target: round(value(target) / value(base), 6)


def _colour_difference(base: "DomainRecipe", target: "DomainRecipe") -> float:
    from gelgap.domains import domain_gap

    return domain_gap(base, target).colour_difference


def _lost_contrast(base: "DomainRecipe", target: "DomainRecipe") -> float:
    coat = float(np.mean(base.sensor.coating.albedo))
    own, left = (coat - float(np.mean(recipe.sensor.markers.albedo)) for recipe in (base, target))
    return round(100 * (1 - (left if target.markers else 0.0) / own), 3)


PANELS = (
    Panel("modulus", "target's modulus over source's", _ratio(MODULUS), ("modulus",), logarithmic=True),
    Panel(
        "light",
        "colour difference of the references, CIEDE2000",
        _colour_difference,
        ("light", "one-lamp"),
        ("mb0i2", CROSSED_LIGHT),
    ),
    Panel("markers", "contrast that the markers have lost, %", _lost_contrast, ("markers", "no-markers")),
    Panel("friction", "target's friction over source's", _ratio(FRICTION), ("friction",), logarithmic=True),
    Panel("noise", "target's read noise over source's", _ratio(NOISE), ("noise",), logarithmic=True),
)


@dataclass(frozen=True)
class Gap:
    """One target domain: which panel it belongs to, and the size of its gap there."""

    panel: str
    domain: str
    size: float


@dataclass(frozen=True)
class CrossedCell:
    """One cell of the crossed design: which of modulus, light and markers differ from the base."""

    domain: str
    modulus: bool
    light: bool
    markers: bool

    @property
    def levels(self) -> tuple[bool, bool, bool]:
        """Which gaps are there, in the order of `CROSSED`."""
        return self.modulus, self.light, self.markers


@dataclass(frozen=True)
class Design:
    """The targets of the curves, the cells of the crossed design, and the domains to make."""

    gaps: tuple[Gap, ...]
    cells: tuple[CrossedCell, ...]
    recipes: "tuple[DomainRecipe, ...]" = ()


def design(quality: str = "draft") -> Design:
    """Return all domains; a cell that a curve has already is not made twice."""
    from gelgap.domains import make_recipes

    base, other_light = make_recipes([BASE, CROSSED_LIGHT], PATH, quality=quality)
    members = [(panel, recipe) for panel in PANELS for recipe in (base, *panel.recipes(quality))]
    gaps = [Gap(panel.name, recipe.name, panel.size(base, recipe)) for panel, recipe in members]
    recipes = {recipe.name: recipe for _, recipe in members}
    cells = []
    for modulus, light, markers in product((False, True), repeat=3):
        start = other_light if light else base
        young = start.elastomer.young_modulus_mpa * (CROSSED_MODULUS if modulus else 1.0)
        changes = {
            "name": f"crossed-{modulus:d}{light:d}{markers:d}",
            "elastomer": start.elastomer.model_copy(update={"young_modulus_mpa": young}),
            "markers": not markers,
        }
        cell = start.model_copy(update=changes)
        same = [r for r in recipes.values() if r == cell.model_copy(update={"name": r.name})]
        domain = same[0] if same else recipes.setdefault(cell.name, cell)
        cells.append(CrossedCell(domain.name, modulus, light, markers))
    in_order = sorted(gaps, key=attrgetter("panel", "size"))
    return Design(tuple(in_order), tuple(cells), tuple(recipes.values()))


@dataclass(frozen=True)
class GapResults:
    """Errors (N) by target and method, with each target's constant mean and pose oracle."""

    methods: tuple[str, ...]
    seeds: int
    gaps: tuple[Gap, ...]
    cells: tuple[CrossedCell, ...]
    errors_n: dict[str, dict[str, float]]
    pose_n: dict[str, float]

    def curve(self, panel: str) -> list[Gap]:
        """Return the measured targets of one panel."""
        return [gap for gap in self.gaps if gap.panel == panel and gap.domain in self.errors_n]

    def of(self, method: str, domains: Sequence[str]) -> list[float]:
        """Return a method's errors on some domains, NaN where it was not run."""
        if method == "pose oracle":
            return [self.pose_n[domain] for domain in domains]
        return [self.errors_n.get(domain, {}).get(method, math.nan) for domain in domains]

    def columns(self, domains: Sequence[str]) -> dict[str, list[str]]:
        """Return the columns of a table of some domains."""
        names = ("constant mean", *self.methods, "pose oracle")
        return {name: numbers(self.of(name, domains)) for name in names}


def measure(bench: Bench) -> None:
    """Generate the domains gel by gel, do the missing runs and write `gaps.json`."""
    found, own = design(), bench.within("gaps", PROFILE)
    targets: list[str] = []
    for gel in dict.fromkeys(recipe.elastomer for recipe in found.recipes):
        if not own.is_over():
            members = [recipe for recipe in found.recipes if recipe.elastomer == gel]
            own.generate(members)
            targets += [recipe.name for recipe in members]
    seeds = bench.seeds or SEEDS
    jobs = [TrainingJob(BASE, t, method, seed) for seed in seeds for method in METHODS for t in targets]
    records = run_missing(own, jobs, RUNS, adapt_job)
    if records:
        write_results(bench.out / RESULTS, collect(found, records, own.data / "paired"))


def collect(found: Design, records: Sequence[RunRecord], data: Path) -> GapResults:
    """Return the errors of the finished runs (mean over seeds) beside errors that need no learning."""
    from gelgap.adapt import pose_oracle
    from gelgap.domains import open_domain

    base = open_domain(data / BASE)
    by_target: dict[str, dict[str, list[float]]] = {}
    for record in records:
        target = by_target.setdefault(record.job.target, {"constant mean": []})
        target["constant mean"].append(float(np.mean(record.constant_mean_n)))
        target.setdefault(record.job.method, []).append(record.mean_mae_n)
    return GapResults(
        methods=tuple(m for m in METHODS if any(m in errors for errors in by_target.values())),
        seeds=len({record.job.seed for record in records}),
        gaps=found.gaps,
        cells=found.cells,
        errors_n={t: {m: float(np.mean(n)) for m, n in errors.items()} for t, errors in by_target.items()},
        pose_n={t: pose_oracle(base, open_domain(data / t)).mean_mae_n for t in by_target},
    )


def tables(folder: Path) -> list[ResultTable]:
    """Return the tables of the curves and of the crossed design, if they were measured."""
    return [table for results in _load(folder) for table in (gap_table(results), *crossed_tables(results))]


def figures(folder: Path) -> list[NamedFigure]:
    """Return the figure of the curves, if they were measured."""
    caption = "Target MAE against the size of each gap"
    return [NamedFigure("gap-curves", caption, plot_gaps(results)) for results in _load(folder)]


def _load(folder: Path) -> list[GapResults]:
    path = folder / RESULTS
    return [read_results(path, GapResults)] if path.is_file() else []


def gap_table(results: GapResults) -> ResultTable:
    """Error of each method against the size of each gap."""
    gaps = [gap for gap in results.gaps if gap.domain in results.errors_n]
    sizes = {"size": [f"{gap.size:g}" for gap in gaps]}
    return by_column(
        f"Gap curves from {BASE}, profile {PROFILE}: target MAE, N",
        "gap",
        [gap.panel for gap in gaps],
        sizes | results.columns([gap.domain for gap in gaps]),
        f"Mean over {results.seeds} seed(s). Size: "
        + "; ".join(f"{panel.name}: {panel.label}" for panel in PANELS)
        + ". Contacts are paired, frames split at random; without a gap the target is the source itself.",
    )


def effects(results: GapResults, method: str) -> dict[str, float]:
    """Return the 2³ design's effects on one method's error, N: half-differences doubled, as in a factorial design.

    A main effect is the mean error with the factor less that without; an interaction is half the change of one
    factor's effect by the other.
    """
    errors = np.array(results.of(method, [cell.domain for cell in results.cells]))
    signs = np.array([[1 if there else -1 for there in cell.levels] for cell in results.cells])
    found = {}
    for chosen in sorted(product((False, True), repeat=3), key=sum):
        name = " × ".join(factor for factor, own in zip(CROSSED, chosen, strict=True) if own)
        contrast = float((signs[:, list(chosen)].prod(axis=1) * errors).sum())
        found[name or "mean"] = contrast / (4 if name else 8)
    return found


def crossed_tables(results: GapResults) -> list[ResultTable]:
    """The crossed design's cells and effects, of the methods that have all cells; none if no method has."""
    domains = [cell.domain for cell in results.cells]
    methods = tuple(m for m in results.methods if not np.isnan(results.of(m, domains)).any())
    if not methods:
        return []
    levels = [["differs" if there else "equal" for there in cell.levels] for cell in results.cells]
    modulus, light, markers = zip(*levels, strict=True)
    by_method = {method: effects(results, method) for method in methods}
    return [
        by_column(
            "Crossed gaps: target MAE, N",
            "modulus",
            modulus,
            {"light": light, "markers": markers} | replace(results, methods=methods).columns(domains),
            f"Modulus × {CROSSED_MODULUS:g}; light of {CROSSED_LIGHT}; markers not there.",
        ),
        by_column(
            "Effects and interactions of the crossed gaps on the target MAE, N",
            "effect",
            by_method[methods[0]],
            {method: numbers(found.values(), "+.3f") for method, found in by_method.items()},
            "Main effect: mean error with the gap less that without. Interaction: half the change of one gap's effect "
            "by the other; negative where two gaps together cost less than their sum.",
        ),
    ]


def plot_gaps(results: GapResults) -> "Figure":
    """Draw one panel per factor: error against the size of the gap."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(15, 3.6), layout="constrained")
    styles = dict.fromkeys(results.methods, "o-") | {"constant mean": "k:", "pose oracle": "k--"}
    for axes, panel in zip(figure.subplots(1, len(PANELS), sharey=True), PANELS, strict=True):
        curve = results.curve(panel.name)
        sizes, domains = [gap.size for gap in curve], [gap.domain for gap in curve]
        for name, style in styles.items():
            axes.plot(sizes, results.of(name, domains), style, label=name)
        if panel.logarithmic:
            axes.set_xscale("log")
            axes.set_xticks(sizes, [f"{size:.2g}" for size in sizes])
            axes.minorticks_off()
        axes.set_xlabel(panel.label, fontsize=8)
        axes.set_ylim(bottom=0)
    figure.axes[0].set_ylabel("target MAE, N")
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", fontsize=8, ncols=len(labels))
    return figure


PART = Part(measure, tables, figures)
run = PART.run
