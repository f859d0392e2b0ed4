"""Gap curves: each method's error against the size of one known gap at a time, and three gaps crossed."""

import json
import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from gelgap.adapt import ResultTable
from gelgap.benchmarks.adaptation.jobs import Job, Line, run_missing, study_parser
from gelgap.benchmarks.common.tables import write_json

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from gelgap.domains import DomainRecipe

BASE = "mb0i0"
PATH = PROFILE = "smoke"
METHODS = ("source-only", "adabn", "no-transfer", "dsan", "daregram")
RESULTS = "gaps.json"

ONE_AT_A_TIME = {
    "modulus": ("elastomer.young_modulus_mpa", "scale", (0.5, 0.7, 1.4)),
    "light": ("illumination.leds.*.drive", "scale", (0.5,)),
    "one lamp": ("illumination.leds.0.drive", "scale", (0.4,)),
    "markers": ("sensor.markers.albedo.*", "set", (0.2, 0.35)),
    "no markers": ("markers", "set", (False,)),
    "friction": ("elastomer.friction", "set", (0.12, 0.5)),
    "noise": ("sensor.camera.read_noise_electrons", "scale", (10.0, 30.0)),
}
"""Factor: field, change and values, as in a sweep file."""

OTHER_LIGHTS = ("mb0i2", "mb0i1")
CROSSED_MODULUS, CROSSED_LIGHT = 0.7, "mb0i1"

PANELS = {
    "modulus": ("modulus", "target's modulus over source's"),
    "light": ("light", "colour difference of the references, CIEDE2000"),
    "markers": ("markers", "contrast that the markers have lost, %"),
    "friction": ("friction", "target's friction over source's"),
    "noise": ("noise", "target's read noise over source's"),
}


@dataclass(frozen=True)
class Gap:
    """One target domain: which panel it belongs to, and the size of its gap there."""

    panel: str
    domain: str
    size: float


@dataclass(frozen=True)
class Cell:
    """One cell of the crossed design: which of modulus, light and markers differ from the base."""

    domain: str
    modulus: bool
    light: bool
    markers: bool


@dataclass(frozen=True)
class Design:
    """The domains to make, the targets of the curves, and the cells of the crossed design."""

    recipes: "tuple[DomainRecipe, ...]"
    gaps: tuple[Gap, ...]
    cells: tuple[Cell, ...]


def design(quality: str = "draft") -> Design:
    """Return all domains; a cell that a curve has already is not made twice."""
    from gelgap.domains import Factor, Sweep, make_recipes, sweep_variants

    base, *lights = make_recipes([BASE, *OTHER_LIGHTS], PATH, quality=quality)
    recipes = {base.name: base} | {recipe.name: recipe for recipe in lights}
    for name, (field, change, values) in ONE_AT_A_TIME.items():
        sweep = Sweep(
            name=name.replace(" ", "-"),
            base=BASE,
            path=PATH,
            method="one-at-a-time",
            factors=(Factor(field=field, change=change, values=values),),
        )
        recipes |= {v.recipe.name: v.recipe for v in sweep_variants(sweep, quality=quality)[1:]}
    cells = []
    for modulus, light, markers in product((False, True), repeat=3):
        (start,) = make_recipes([CROSSED_LIGHT if light else BASE], PATH, quality=quality)
        young = start.elastomer.young_modulus_mpa * (CROSSED_MODULUS if modulus else 1.0)
        elastomer = start.elastomer.model_copy(update={"young_modulus_mpa": young})
        name = f"crossed-{modulus:d}{light:d}{markers:d}"
        cell = start.model_copy(update={"name": name, "elastomer": elastomer, "markers": not markers})
        same = next((r for r in recipes.values() if _same(r, cell)), None)
        if same is None:
            recipes[name] = same = cell
        cells.append(Cell(same.name, modulus, light, markers))
    return Design(tuple(recipes.values()), tuple(_gaps(base, recipes)), tuple(cells))


def _same(one: "DomainRecipe", other: "DomainRecipe") -> bool:
    return one.model_copy(update={"name": other.name}) == other


def _gaps(base: "DomainRecipe", recipes: "dict[str, DomainRecipe]") -> list[Gap]:
    """Return every curve's points, the base without a gap among them."""
    from gelgap.domains import domain_gap

    coat = float(np.mean(base.sensor.coating.albedo))
    own = coat - float(np.mean(base.sensor.markers.albedo))
    found = [
        Gap(panel, base.name, size)
        for panel, size in (("modulus", 1), ("light", 0), ("markers", 0), ("friction", 1), ("noise", 1))
    ]
    for name, recipe in recipes.items():
        kind = name.rsplit("-", 1)[0]
        if kind == "modulus":
            ratio = recipe.elastomer.young_modulus_mpa / base.elastomer.young_modulus_mpa
            found.append(Gap("modulus", name, round(ratio, 6)))
        elif kind in ("light", "one-lamp") or name in OTHER_LIGHTS:
            found.append(Gap("light", name, domain_gap(base, recipe).colour_difference))
        elif kind in ("markers", "no-markers"):
            left = coat - float(np.mean(recipe.sensor.markers.albedo)) if recipe.markers else 0.0
            found.append(Gap("markers", name, round(100 * (1 - left / own), 3)))
        elif kind == "friction":
            found.append(Gap("friction", name, round(recipe.elastomer.friction / base.elastomer.friction, 6)))
        elif kind == "noise":
            camera, mine = recipe.sensor.camera, base.sensor.camera
            ratio = camera.read_noise_electrons / mine.read_noise_electrons
            found.append(Gap("noise", name, round(ratio, 6)))
    return sorted(found, key=lambda gap: (gap.panel, gap.size))


@dataclass(frozen=True)
class GapResults:
    """Errors (N) by target and method, with each target's constant mean and pose oracle."""

    methods: tuple[str, ...]
    seeds: int
    gaps: tuple[Gap, ...]
    cells: tuple[Cell, ...]
    errors_n: dict[str, dict[str, float]]
    pose_n: dict[str, float]

    @classmethod
    def load(cls, path: Path) -> "GapResults":
        """Read what `run` wrote."""
        content = json.loads(path.read_text(encoding="utf-8"))
        return cls(
            tuple(content["methods"]),
            content["seeds"],
            tuple(Gap(**gap) for gap in content["gaps"]),
            tuple(Cell(**cell) for cell in content["cells"]),
            content["errors_n"],
            content["pose_n"],
        )


def collect(found: Design, lines: Sequence[Line], data: Path, methods: Sequence[str]) -> GapResults:
    """Return the errors of the finished runs (mean over seeds) beside what needs no learning."""
    from gelgap.adapt import pose_oracle
    from gelgap.domains import open_domain

    base = open_domain(data / BASE)
    errors: dict[str, dict[str, float]] = {}
    for target in dict.fromkeys(line.job.target for line in lines):
        own = [line for line in lines if line.job.target == target]
        errors[target] = {"constant mean": float(np.mean([line.constant_mean_n for line in own]))}
        for method in dict.fromkeys(line.job.method for line in own):
            found_n = [line.mean_mae_n for line in own if line.job.method == method]
            errors[target][method] = float(np.mean(found_n))
    pose = {name: pose_oracle(base, open_domain(data / name)).mean_mae_n for name in errors}
    seeds = len({line.job.seed for line in lines})
    return GapResults(tuple(methods), seeds, found.gaps, found.cells, errors, pose)


def gap_table(results: GapResults) -> ResultTable:
    """Error of each method against the size of each gap."""
    rows = [
        [gap.panel, f"{gap.size:g}", *_cells(results, gap.domain)]
        for gap in results.gaps
        if gap.domain in results.errors_n
    ]
    return ResultTable(
        f"Gap curves from {BASE}, profile {PROFILE}: target MAE, N",
        ["gap", "size", "constant mean", *results.methods, "pose oracle"],
        rows,
        f"Mean over {results.seeds} seed(s). Size: "
        + "; ".join(f"{panel}: {label}" for panel, (_, label) in PANELS.items())
        + ". Contacts are paired; "
        "without a gap the target is the source itself, most of whose frames were trained on.",
    )


def _cells(results: GapResults, domain: str) -> list[str]:
    own = results.errors_n[domain]
    values = [own.get(m, math.nan) for m in ("constant mean", *results.methods)]
    return ["–" if math.isnan(x) else f"{x:.3f}" for x in (*values, results.pose_n[domain])]


def effects(results: GapResults, method: str) -> dict[str, float]:
    """Return the 2³ design's effects on one method's error, N: half-differences doubled, as in a factorial design.

    A main effect is the mean error with the factor less that without; an interaction is half the change of one
    factor's effect by the other.
    """
    error = {(c.modulus, c.light, c.markers): results.errors_n[c.domain][method] for c in results.cells}
    signs = {key: [1 if on else -1 for on in key] for key in error}
    names = ("modulus", "light", "markers")
    found = {}
    for chosen in product((False, True), repeat=3):
        own = [i for i in range(3) if chosen[i]]
        contrast = sum(math.prod([signs[key][i] for i in own]) * value for key, value in error.items())
        name = " × ".join(names[i] for i in own) if own else "mean"
        found[name] = contrast / (4 if own else 8)
    return dict(sorted(found.items(), key=lambda item: item[0].count("×") + (item[0] != "mean")))


def crossed_tables(results: GapResults) -> list[ResultTable]:
    """The crossed design's cells and effects, of the methods that have all cells; none if no method has."""
    cells = [results.errors_n.get(cell.domain, {}) for cell in results.cells]
    methods = tuple(m for m in results.methods if all(m in cell for cell in cells))
    if not methods:
        return []
    results = replace(results, methods=methods)
    rows = [
        [
            *("differs" if on else "equal" for on in (c.modulus, c.light, c.markers)),
            *_cells(results, c.domain),
        ]
        for c in results.cells
    ]
    by_method = {method: effects(results, method) for method in results.methods}
    effect_rows = [
        [name, *(f"{by_method[m][name]:+.3f}" for m in results.methods)]
        for name in by_method[results.methods[0]]
    ]
    return [
        ResultTable(
            "Crossed gaps: target MAE, N",
            ["modulus", "light", "markers", "constant mean", *results.methods, "pose oracle"],
            rows,
            f"Modulus × {CROSSED_MODULUS:g}; light of {CROSSED_LIGHT}; markers not there.",
        ),
        ResultTable(
            "Effects and interactions of the crossed gaps on the target MAE, N",
            ["effect", *results.methods],
            effect_rows,
            "Main effect: mean error with the gap less that without. Interaction: half the change of one gap's effect "
            "by the other; negative where two gaps together cost less than their sum.",
        ),
    ]


def plot_gaps(results: GapResults) -> "Figure":
    """Draw one panel a factor: error against the size of the gap."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(15, 3.6), layout="constrained")
    for axes, (panel, (_, label)) in zip(
        figure.subplots(1, len(PANELS), sharey=True), PANELS.items(), strict=True
    ):
        own = [gap for gap in results.gaps if gap.panel == panel and gap.domain in results.errors_n]
        sizes = [gap.size for gap in own]
        for method in results.methods:
            axes.plot(
                sizes, [results.errors_n[g.domain].get(method, math.nan) for g in own], "o-", label=method
            )
        axes.plot(
            sizes, [results.errors_n[g.domain]["constant mean"] for g in own], "k:", label="constant mean"
        )
        axes.plot(sizes, [results.pose_n[g.domain] for g in own], "k--", label="pose oracle")
        if panel in ("modulus", "friction", "noise"):
            axes.set_xscale("log")
            axes.set_xticks(sizes, [f"{size:.2g}" for size in sizes])
            axes.minorticks_off()
        axes.set_xlabel(label, fontsize=8)
        axes.set_ylim(bottom=0)
    figure.axes[0].set_ylabel("target MAE, N")
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", fontsize=8, ncols=len(labels))
    return figure


def run(
    out_dir: Path, seeds: Sequence[int] = (0, 1, 2), workers: int | None = None, minutes: float = math.inf
) -> None:
    """Generate the domains gel by gel, do the missing runs, write `gaps.json` and print the tables.

    After so many `minutes` no gel and no run is begun; the next call goes on.
    """
    from gelgap.domains import generate_recipes

    found, start = design(), time.perf_counter()
    data, out = out_dir / "data", out_dir / "runs"
    targets: list[str] = []
    for gel in dict.fromkeys(recipe.elastomer for recipe in found.recipes):
        if time.perf_counter() - start < 60 * minutes:
            members = [recipe for recipe in found.recipes if recipe.elastomer == gel]
            scheduler = "synchronous" if workers == 1 else None
            print(generate_recipes(members, data, scheduler=scheduler, workers=workers), flush=True)
            targets += [recipe.name for recipe in members]
    jobs = [Job(BASE, target, method, seed) for seed in seeds for method in METHODS for target in targets]
    left = minutes - (time.perf_counter() - start) / 60
    lines = run_missing(data, out, PROFILE, jobs, workers=workers, minutes=left)
    if not lines:
        return
    done = [m for m in METHODS if any(line.job.method == m for line in lines)]
    results = collect(found, lines, data, done)
    write_json(out_dir / RESULTS, results)
    for table in [gap_table(results), *crossed_tables(results)]:
        table.show()


if __name__ == "__main__":
    parser = study_parser(__doc__, seeds=(0, 1, 2))
    parser.add_argument("--out", type=Path, default=Path("benchmark-results/gaps"))
    chosen = parser.parse_args()
    run(chosen.out, chosen.seeds, chosen.workers, chosen.minutes)
