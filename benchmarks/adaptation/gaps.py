"""Gap curves: each method's error against the size of one known gap at a time, and three gaps crossed."""

from dataclasses import dataclass
from itertools import product
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import pandas as pd

from gelgap.adapt import NamedFigure, ResultTable
from gelgap.benchmarks.adaptation.study import (
    RUNS,
    Part,
    Study,
    adapt_run,
    grid,
    read_results,
    with_errors,
    write_results,
)
from gelgap.benchmarks.common import result_table

if TYPE_CHECKING:
    from gelgap.domains import DomainRecipe

BASE = "mb0i0"
PATH = PROFILE = "smoke"
METHODS = ("source-only", "adabn", "no-transfer", "dsan", "daregram")
SEEDS = (0, 1, 2)
RESULTS = "gaps/gaps.json"
CROSSED = ("modulus", "light", "markers")
CROSSED_MODULUS, CROSSED_LIGHT = 0.7, "mb0i1"
CONSTANT, POSE = "constant mean", "pose oracle"
PANELS = {
    "modulus": "target's modulus over source's",
    "light": "colour difference of the references, CIEDE2000",
    "markers": "contrast that the markers have lost, %",
    "friction": "target's friction over source's",
    "noise": "target's read noise over source's",
}
"""The curves, by the one thing that differs from the base, and how large its gap is."""
RATIOS = {
    "modulus": "elastomer.young_modulus_mpa",
    "friction": "elastomer.friction",
    "noise": "sensor.camera.read_noise_electrons",
}
"""Fields whose ratio is the size of the gap, drawn on a logarithmic scale."""
SWEEPS = (
    ("modulus", "modulus", RATIOS["modulus"], "scale", (0.5, 0.7, 1.4)),
    ("light", "light", "illumination.leds.*.drive", "scale", (0.5,)),
    ("light", "one-lamp", "illumination.leds.0.drive", "scale", (0.4,)),
    ("markers", "markers", "sensor.markers.albedo.*", "set", (0.2, 0.35)),
    ("markers", "no-markers", "markers", "set", (False,)),
    ("friction", "friction", RATIOS["friction"], "set", (0.12, 0.5)),
    ("noise", "noise", RATIOS["noise"], "scale", (10.0, 30.0)),
)
"""The curve, and as in a sweep file: name, field of the one factor, its change and values."""
DOMAINS = (("light", "mb0i2"), ("light", CROSSED_LIGHT))
"""Domains that lie on a curve, too."""


def gap_size(panel: str, base: "DomainRecipe", target: "DomainRecipe") -> float:
    """Return how much a target differs from the base in the one thing of a curve."""
    from gelgap.domains import domain_gap

    if panel == "light":
        return domain_gap(base, target).colour_difference
    if panel == "markers":
        coat = np.mean(base.sensor.coating.albedo)
        own, left = (float(coat - np.mean(recipe.sensor.markers.albedo)) for recipe in (base, target))
        return round(100 * (1 - (left if target.markers else 0.0) / own), 3)
    value = attrgetter(RATIOS[panel])
    return round(value(target) / value(base), 6)


class Design(NamedTuple):
    """The domains to make, by name; the targets of the curves (panel, domain, size); the cells of the crossed design.

    A cell is a domain, and which of modulus, light and markers differ from the base.
    """

    recipes: "dict[str, DomainRecipe]"
    gaps: pd.DataFrame
    cells: pd.DataFrame


def design(quality: str = "draft") -> Design:
    """Return all domains; a cell that a curve has already is not made twice."""
    from gelgap.domains import Factor, Sweep, make_recipes, sweep_variants

    base, *others = make_recipes([BASE, *(name for _, name in DOMAINS)], PATH, quality=quality)
    members = [(panel, base) for panel in PANELS]
    members += [(panel, recipe) for (panel, _), recipe in zip(DOMAINS, others, strict=True)]
    for panel, name, field, change, values in SWEEPS:
        factors = (Factor(field=field, change=change, values=values),)
        sweep = Sweep(name=name, base=BASE, path=PATH, method="one-at-a-time", factors=factors)
        members += [(panel, variant.recipe) for variant in sweep_variants(sweep, quality=quality)[1:]]
    gaps = [(panel, recipe.name, gap_size(panel, base, recipe)) for panel, recipe in members]
    recipes, cells = {recipe.name: recipe for _, recipe in members}, []
    for modulus, light, markers in product((False, True), repeat=3):
        start = recipes[CROSSED_LIGHT if light else BASE]
        young = start.elastomer.young_modulus_mpa * (CROSSED_MODULUS if modulus else 1.0)
        elastomer = start.elastomer.model_copy(update={"young_modulus_mpa": young})
        changes = {"name": f"crossed-{modulus:d}{light:d}{markers:d}", "elastomer": elastomer}
        cell = start.model_copy(update=changes | {"markers": not markers})
        same = [r for r in recipes.values() if r == cell.model_copy(update={"name": r.name})]
        domain = same[0] if same else recipes.setdefault(cell.name, cell)
        cells.append((domain.name, modulus, light, markers))
    curves = pd.DataFrame(gaps, columns=["panel", "domain", "size"])
    by_size = curves.sort_values(["panel", "size"], kind="stable")
    return Design(recipes, by_size, pd.DataFrame(cells, columns=["domain", *CROSSED]))


def measure(study: Study) -> None:
    """Generate the domains gel by gel, do the missing runs and write `gaps.json`."""
    found, own = design(), study.within("gaps", PROFILE)
    targets: list[str] = []
    for gel in dict.fromkeys(recipe.elastomer for recipe in found.recipes.values()):
        if not own.is_over:
            of_gel = [name for name, recipe in found.recipes.items() if recipe.elastomer == gel]
            own.generate([found.recipes[name] for name in of_gel])
            targets += of_gel
    cases = [("paired", (BASE, target)) for target in targets]
    runs = own.run(adapt_run, grid(cases, METHODS, study.seeds or SEEDS, ()), RUNS)
    if len(runs):
        write_results(study.out / RESULTS, collect(found, with_errors(runs), own.data / "paired"))


@dataclass(frozen=True)
class GapResults:
    """Errors (N) by target and method, means over the seeds, with each target's constant mean and pose oracle."""

    methods: list[str]
    seeds: int
    gaps: list[dict[str, str | float]]
    cells: list[dict[str, str | bool]]
    errors_n: dict[str, dict[str, float]]
    pose_n: dict[str, float]


def collect(found: Design, runs: pd.DataFrame, data: Path) -> GapResults:
    """Return the errors of the finished runs beside errors that need no learning."""
    from gelgap.adapt import pose_oracle
    from gelgap.domains import open_domain

    errors_n = runs.pivot_table(index="target", columns="method", values="error_n")
    errors_n[CONSTANT] = runs["constant_mean_n"].map(np.mean).groupby(runs["target"]).mean()
    base = open_domain(data / BASE)
    return GapResults(
        methods=[method for method in METHODS if method in errors_n],
        seeds=runs["seed"].nunique(),
        gaps=found.gaps.to_dict("records"),
        cells=found.cells.to_dict("records"),
        errors_n={target: row.dropna().to_dict() for target, row in errors_n.iterrows()},
        pose_n={name: pose_oracle(base, open_domain(data / name)).mean_mae_n for name in errors_n.index},
    )


def load(folder: Path) -> GapResults | None:
    """Return the results of a folder, None if there are none."""
    path = folder / RESULTS
    return read_results(path, GapResults) if path.is_file() else None


def tables(folder: Path) -> list[ResultTable]:
    """Return the tables of the curves and of the crossed design, if they were measured."""
    results = load(folder)
    return [gap_table(results), *crossed_tables(results)] if results else []


def errors_of(results: GapResults, places: list[dict]) -> pd.DataFrame:
    """Return the errors at measured gaps or cells, beside what these are; NaN for what was not run."""
    errors = pd.DataFrame(results.errors_n).T.reindex(columns=[CONSTANT, *results.methods])
    errors[POSE] = pd.Series(results.pose_n)
    return pd.DataFrame(places).join(errors, on="domain")


def gap_table(results: GapResults) -> ResultTable:
    """Error of each method against the size of each gap."""
    frame = errors_of(results, results.gaps).dropna(subset=CONSTANT)
    sizes = "; ".join(f"{name}: {label}" for name, label in PANELS.items())
    return result_table(
        f"Gap curves from {BASE}, profile {PROFILE}: target MAE, N",
        frame.drop(columns="domain").rename(columns={"panel": "gap"}),
        f"Mean over {results.seeds} seed(s). Size: {sizes}. Contacts are paired, frames split at random; without a gap "
        "the target is the source itself.",
        {"": "{:.3f}", "size": "{:g}"},
    )


def effects(cells: pd.DataFrame) -> pd.DataFrame:
    """Return the 2³ design's effects (rows) on errors, N: half-differences doubled, as in a factorial design.

    A main effect is the mean error with the factor less that without; an interaction is half the change of one
    factor's effect by the other.
    """
    errors, found = cells.drop(columns=["domain", *CROSSED]), {}
    for chosen in sorted(product((False, True), repeat=3), key=sum):
        factors = [factor for factor, own in zip(CROSSED, chosen, strict=True) if own]
        signs = cells[factors].map(lambda there: 1 if there else -1).prod(axis=1)
        found[" × ".join(factors) or "mean"] = errors.mul(signs, axis=0).sum() / (4 if factors else 8)
    return pd.DataFrame(found).T.rename_axis("effect")


def crossed_tables(results: GapResults) -> list[ResultTable]:
    """The crossed design's cells and effects, of the methods that have all cells; none if no method has."""
    cells = errors_of(results, results.cells)
    methods = [method for method in results.methods if cells[method].notna().all()]
    if not methods:
        return []
    shown = cells.replace({factor: {True: "differs", False: "equal"} for factor in CROSSED})
    return [
        result_table(
            "Crossed gaps: target MAE, N",
            shown[[*CROSSED, CONSTANT, *methods, POSE]],
            f"Modulus × {CROSSED_MODULUS:g}; light of {CROSSED_LIGHT}; markers not there.",
            {"": "{:.3f}"},
        ),
        result_table(
            "Effects and interactions of the crossed gaps on the target MAE, N",
            effects(cells)[methods],
            "Main effect: mean error with the gap less that without. Interaction: half the change of one gap's effect "
            "by the other; negative where two gaps together cost less than their sum.",
            {"": "{:+.3f}"},
        ),
    ]


def figures(folder: Path) -> list[NamedFigure]:
    """Return the figure of the curves, one panel per factor, if they were measured."""
    from matplotlib.figure import Figure

    if not (results := load(folder)):
        return []
    figure = Figure(figsize=(15, 3.6), layout="constrained")
    panels = figure.subplots(1, len(PANELS), sharey=True)
    curves = errors_of(results, results.gaps).dropna(subset=CONSTANT)
    styles = {**dict.fromkeys(results.methods, "o-"), CONSTANT: "k:", POSE: "k--"}
    for axes, (name, label) in zip(panels, PANELS.items(), strict=True):
        curve = curves[curves["panel"] == name]
        for method, style in styles.items():
            axes.plot(curve["size"], curve[method], style, label=method)
        if name in RATIOS:
            axes.set_xscale("log")
            axes.set_xticks(curve["size"], [f"{size:.2g}" for size in curve["size"]])
            axes.minorticks_off()
        axes.set_xlabel(label, fontsize=8)
        axes.set_ylim(bottom=0)
    panels[0].set_ylabel("target MAE, N")
    lines = panels[0].get_legend_handles_labels()
    figure.legend(*lines, loc="outside upper center", fontsize=8, ncols=len(styles))
    return [NamedFigure("gap-curves", "Target MAE against the size of each gap", figure)]


PART = Part(measure, tables, figures)
