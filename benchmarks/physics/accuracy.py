"""`gelgap benchmark physics`: forces and surfaces against independent finite elements, and what they cost.

Every case is a record, of which each study's table has columns: `run` measures spheres, `run_shapes` other indenters,
and `python -m gelgap.benchmarks.physics.accuracy --table FILE` prints the tables of a file of records again. Processor
seconds of single-threaded processes are the run time, since wall time depends on what else the machine does.
"""

import shutil
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd

from gelgap.adapt.result_table import ResultTable
from gelgap.benchmarks.common import print_tables, read_records, rms, write_records
from gelgap.benchmarks.physics.cases import Case
from gelgap.benchmarks.physics.errors import SURFACE, combined, measured
from gelgap.benchmarks.physics.references import (
    FORCE_UNCERTAINTY_PERCENT,
    NO_SLIP_FRICTION,
    across_cases,
    drag_cases,
    held_back_cases,
    press_cases,
    shape_cases,
    solid_cases,
    surface_cases,
    tabled_sphere,
)
from gelgap.domains.generation.shard import paper_picture

QUICK_CASE = FINE_CASE = "nh49_no_slip"
QUICK_DEPTH_MM = 0.4
QUICK_DEPTHS = 2  # of each shape
CASE, COST = ("case", "quality"), ("core s/pose", "unconverged")
FX, FZ = ("Fx rms %", "Fx by pose %"), ("Fz rms %", "Fz by pose %")
OVER_THE_LIMIT = "|f_t|/μf_n − 1"
PRESS = (*CASE, *FZ, "radius worst %", "ref ± %", "MiB", *COST)
MEMBRANE = (*CASE, *SURFACE, "PSNR dB")
MEMBRANE_NOTE = (
    "displacement within 5 mm of the contact point, normals within 3 mm of the contact; PSNR: worst depth"
)
DRAG = ("reference", *CASE, *FX, "ref ± %", *FZ, "Fx/|Fz|", "reference's", OVER_THE_LIMIT, *COST)
DRAG_NOTE = (
    f"friction {NO_SLIP_FRICTION:g} does not slip; ratios at the end of the drag; the contact points' own friction "
    "stays within μ of their normal force, the ratio of the whole contact need not"
)
SHAPE = (*CASE, *FZ, "Fz worst %", "ref ± %", *SURFACE[:2], "vertices", *COST)
ACROSS = (*CASE, *FZ, *FX, *SURFACE[:2], OVER_THE_LIMIT, *COST)
SHAPE_NOTE = (
    "displacement within 5 mm; ref ±: the references' own; targets at standard: round bodies 3 % rms, 6 % worst, 8 µm; "
    "lying cylinder and box 4 % rms, 10 µm, Fx 6 % rms"
)
TABLES = (  # study, title, columns, note
    ("presses", "Presses against independent finite elements: force, contact radius, cost", PRESS, ""),
    ("presses", "The same presses: membrane", MEMBRANE, MEMBRANE_NOTE),
    ("held back", "Held-back presses against the project's own solver", PRESS, ""),
    ("held back", "The same presses: membrane", MEMBRANE, MEMBRANE_NOTE),
    ("drags", "Drags to 0.6 mm, ν 0.48, against 3-D finite elements", DRAG, DRAG_NOTE),
    ("shapes", "Indenters against independent finite elements", SHAPE, SHAPE_NOTE),
    ("across", "A long box in its middle, pressed and dragged across: per mm of length", ACROSS, SHAPE_NOTE),
    ("solids", "A short box, pressed, and a cylinder, pressed and dragged", ACROSS, SHAPE_NOTE),
    ("surfaces", "A torus and a ring-shaped punch by their surface", SHAPE, SHAPE_NOTE),
)
SETTINGS = ("study", "case", "quality", "reference")
FZ_TARGET = 2.0  # %, rms


def run(quick: bool, out_dir: Path) -> None:
    """Run the benchmark, print its tables, and write `physics.jsonl` and `physics-frontier.png` to `out_dir`.

    The quick form is a press down to 0.4 mm and a drag; the full one adds all others whose solution is known. Until the
    end, what is solved is kept in `out_dir`/physics-solves: a benchmark that was stopped goes on from there.
    """
    solves = out_dir / "physics-solves"
    results = measured(quick_cases() if quick else full_cases(), solves, paper_picture)
    file, plot = out_dir / "physics.jsonl", out_dir / "physics-frontier.png"
    write_records(file, results, SETTINGS)
    for table in tables(read_records(file)):
        table.show()
    plot_frontier(plot, frontier(results[results["study"] == "presses"]))
    shutil.rmtree(solves, ignore_errors=True)
    print(f"results in {file}, plot in {plot}")


def run_shapes(quick: bool, out_dir: Path) -> None:
    """Print errors and run time of other indenters, and write `shapes.jsonl` to `out_dir`.

    The quick form has two depths of each round body at `draft`; the full one all depths at `draft` and `standard`, the
    lying cylinder, a long box that is pressed and dragged across, a short box and a dragged cylinder in space, and two
    rings by their surface.
    """
    solves = out_dir / "shape-solves"
    cases = at_both([*shape_cases(), *across_cases(), *solid_cases(), *surface_cases()])
    if quick:
        *round_bodies, _ = shape_cases()
        shallow = [case.down_to(case.poses[QUICK_DEPTHS - 1].depth_mm) for case in round_bodies]
        cases = [replace(case, quality="draft") for case in shallow]
    file = out_dir / "shapes.jsonl"
    write_records(file, measured(cases, solves), SETTINGS)
    for table in tables(read_records(file)):
        table.show()
    shutil.rmtree(solves, ignore_errors=True)
    print(f"results in {file}")


def quick_cases() -> list[Case]:
    """Return one press at two qualities, and one drag."""
    return [
        *at_both([press_cases()[QUICK_CASE].down_to(QUICK_DEPTH_MM)]),
        replace(drag_cases()[0], quality="draft"),
    ]


def full_cases() -> list[Case]:
    """Return all presses and drags of spheres whose solution is known."""
    tables = press_cases()
    return [
        *at_both([*tables.values(), tabled_sphere()]),
        replace(tables[FINE_CASE], quality="fine"),
        *at_both(held_back_cases().values()),
        *at_both(drag_cases()),
    ]


def at_both(cases: Iterable[Case]) -> list[Case]:
    """Return cases at `draft` and at `standard`."""
    cases = list(cases)
    return [replace(case, quality=quality) for quality in ("draft", "standard") for case in cases]


def tables(records: pd.DataFrame) -> list[ResultTable]:
    """Return the tables of the studies that were measured, and what `standard` promises beside what it has."""
    found = []
    for study, title, columns, note in TABLES:
        own = records[records["study"] == study]
        if len(own):
            found.append(
                ResultTable.of(
                    title, own[[name for name in columns if name in own]].reset_index(drop=True), note
                )
            )
    studies = set(records["study"])
    if {"presses", "drags"} <= studies and "standard" in set(records["quality"]):
        found.append(targets(records[records["study"] == "presses"], records[records["study"] == "drags"]))
    return found


def targets(presses: pd.DataFrame, drags: pd.DataFrame) -> ResultTable:
    """Return the accuracy that `standard` promises for the isochoric gel beside what was measured."""
    found = presses[(presses["quality"] == "standard") & presses["case"].str.startswith("nh")]
    drags = drags[drags["quality"] == max(drags["quality"])]  # "standard" if it is there
    fz = np.concatenate(found["fz_percent"].to_list())
    surface, worst = combined(found[list(SURFACE)].to_dict("records")), found.max(numeric_only=True)
    limits = [
        ("Fz rms, %", rms(fz), FZ_TARGET),
        ("Fz worst, %", np.abs(fz).max(), 4.0),
        ("Fx rms, %", rms(np.concatenate(drags["fx_percent"].to_list())), 5.0),
        *zip(SURFACE, surface.values(), (5.0, 5.0, 15.0, 1.0, 4.0), strict=True),
        ("contact radius worst, %", worst["radius worst %"], 3.0),
        ("peak memory, MiB", worst["MiB"], 2048.0),
    ]
    psnr = found["PSNR dB"].min()
    rows = [(name, value, f"≤ {limit:g}", value <= limit) for name, value, limit in limits]
    rows.append(("picture PSNR, dB", psnr, "≥ 40", psnr >= 40))
    table = pd.DataFrame(rows, columns=["quantity", "measured", "target", "met"])
    note = f"Fx: drags at {drags['quality'].iloc[0]}"
    return ResultTable.of(f"Targets at standard over {len(found)} cases", table, note)


def frontier(presses: pd.DataFrame) -> pd.DataFrame:
    """Return the qualities by cost: mean processor time and error over the cases that all of them solved."""
    shared = presses[presses.groupby("case")["quality"].transform("nunique") == presses["quality"].nunique()]
    of_quality = shared.groupby("quality")
    points = of_quality["core s/pose"].mean().rename("seconds").to_frame()
    return points.assign(error=of_quality["Fz rms %"].agg(rms)).sort_values("seconds")


def plot_frontier(path: Path, points: pd.DataFrame) -> None:
    """Draw error against run time, log-log, with the reference's uncertainty and the target."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8, 5), layout="constrained")
    axes = figure.subplots()
    axes.loglog(points["seconds"], points["error"], "o-")
    for quality, seconds, error in points.itertuples():
        axes.annotate(quality, (seconds, error), xytext=(5, 4), textcoords="offset points", fontsize=8)
    axes.axhline(FORCE_UNCERTAINTY_PERCENT, color="0.8", label="the reference's uncertainty")
    axes.axhline(FZ_TARGET, color="0.4", linestyle="--", linewidth=1, label="target at standard")
    axes.set(xlabel="processor time per pose, s", ylabel="error of the normal force, rms, %")
    for axis in (axes.xaxis, axes.yaxis):
        for ticks in (axis.set_major_formatter, axis.set_minor_formatter):
            ticks("{x:g}")
    axes.grid(visible=True, which="both", linewidth=0.3)
    figure.legend(fontsize=8, loc="outside lower center", ncols=2)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=150)


if __name__ == "__main__":
    print_tables(__doc__, tables)
