"""`gelgap benchmark physics`: forces and surfaces against independent finite elements, and what they cost.

Processor seconds of single-threaded processes are the run time of the tables, since wall time depends on what
else the machine does; both are in the JSON.
"""

import math
import os
import tempfile
import time
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from gelgap.benchmarks.common.tables import Point, plot_frontier, print_table, write_json
from gelgap.benchmarks.fem import theory
from gelgap.benchmarks.physics import path
from gelgap.benchmarks.physics import savings as savings_study
from gelgap.benchmarks.physics.reference import (
    FORCE_UNCERTAINTY,
    NO_SLIP_FRICTION,
    PressReference,
    ShearReference,
    coulomb_references,
    press_references,
    shear_references,
)
from gelgap.benchmarks.physics.solve_jobs import Job, Outcome, solve_jobs
from gelgap.benchmarks.physics.surface_errors import SurfaceErrors, picture_psnr_db, surface_errors
from gelgap.sim import Elastomer, MembraneState, Pose, Sphere

QUICK_CASES = ("nh49_no_slip",)
FINE_CASES = ("nh49_no_slip",)
HELD_BACK = (  # (sphere radius, thickness, ν, friction): presses that no table and no calibration has
    (1.0, 2.0, 0.47, 0.3),
    (2.5, 4.0, 0.49, 0.8),
    (1.5, 5.0, 0.495, 0.1),
    (2.0, 3.0, 0.46, NO_SLIP_FRICTION),
)


@dataclass(frozen=True)
class PressErrors:
    """One case at one quality: errors over its depths, cost a pose."""

    case: str
    quality: str
    fz_percent: tuple[float, ...]
    radius_percent: tuple[float, ...]
    radius_uncertainty_percent: float
    surface: SurfaceErrors
    psnr_db: float | None
    processor_s_per_pose: float
    wall_s_per_pose: float
    peak_memory_mib: float
    unconverged: int

    @property
    def fz_rms_percent(self) -> float:
        return _rms(self.fz_percent)

    @property
    def fz_worst_percent(self) -> float:
        return max(map(abs, self.fz_percent))


@dataclass(frozen=True)
class ShearErrors:
    """One drag at one quality: errors over its travels, and the force ratio where it ends."""

    source: str
    friction: float
    depth_mm: float
    quality: str
    fx_percent: tuple[float, ...]
    fz_percent: tuple[float, ...]
    fx_uncertainty_percent: float
    force_ratio: float
    reference_force_ratio: float
    coulomb_excess: float
    processor_s_per_pose: float
    unconverged: int


def run(quick: bool, out_dir: Path) -> None:
    """Run the benchmark, print its tables, and write `physics.json` and `physics-frontier.png` to `out_dir`."""
    started = time.perf_counter()
    references = press_references()
    names = QUICK_CASES if quick else tuple(references)
    qualities = ("draft", "standard") if quick else ("draft", "standard", "fine")
    processes = max(1, (os.cpu_count() or 1) if not quick else 2)
    results: dict[str, object] = {"quick": quick, "processes": processes}

    if not quick:
        results["own_energy"] = own_energy(processes)
    presses = press_errors(
        {name: references[name] for name in names}, qualities, processes, pictures=True, keep=FINE_CASES
    )
    results["presses"] = presses
    if not quick:
        held = {reference.name: reference for reference in map(held_back_reference, HELD_BACK)}
        results["held_back"] = press_errors(held, ("standard",), processes, title="Held-back presses")
        results["partial_slip"] = partial_slip(processes)
    results["theory"] = closed_forms("draft" if quick else "standard", processes)
    results["convergence"] = convergence(presses)
    with tempfile.TemporaryDirectory() as folder:
        results["path"] = path.measure(quick, processes, Path(folder))
    savings = savings_study.measure(quick, processes)
    results["savings"] = savings
    drags = shear_references() if quick else (*shear_references(), *coulomb_references())
    shears = shear_errors(drags, ("draft",) if quick else ("draft", "standard"), processes)
    results["shears"] = shears
    targets(presses, shears)
    figure = out_dir / "physics-frontier.png"
    plot_frontier(
        figure,
        [*frontier(presses), *savings_study.points(savings)],
        title="Run time against error of the normal force",
        time_label="processor time a pose, s",
        error_label="Fz error, rms, %",
        uncertainty=100 * FORCE_UNCERTAINTY,
        targets=(2.0,),
        unjoined=(savings_study.SERIES,),
    )
    results["wall_s"] = time.perf_counter() - started
    write_json(out_dir / "physics.json", results)
    print(f"{results['wall_s']:.0f} s in all; results in {out_dir / 'physics.json'}, plot in {figure}")


# --- presses --------------------------------------------------------------------------------------------------


def elastomer_of(reference: PressReference) -> Elastomer:
    """Return the reference's gel as a pad of gelgap."""
    return Elastomer(
        young_modulus_mpa=reference.young_modulus_mpa,
        poisson_ratio=reference.poisson_ratio,
        friction=reference.friction,
        thickness_mm=reference.thickness_mm,
        strain_energy=reference.strain_energy,
    )


def press_job(reference: PressReference, quality: str) -> Job:
    """Return one descent through the reference's depths."""
    return Job(
        name=reference.name,
        elastomer=elastomer_of(reference),
        poses=tuple(Pose(depth_mm=depth) for depth in reference.depths_mm),
        quality=quality,
        indenter=Sphere(diameter_mm=2 * reference.indenter_radius_mm),
    )


def press_errors(
    references: dict[str, PressReference],
    qualities: Iterable[str],
    processes: int,
    *,
    title: str = "Presses against independent finite elements",
    pictures: bool = False,
    keep: tuple[str, ...] = (),
) -> list[PressErrors]:
    """Solve and judge each case at each quality (`fine` only those of `keep`), and print the table."""
    jobs = [
        press_job(reference, quality)
        for quality in qualities
        for name, reference in references.items()
        if quality != "fine" or name in keep
    ]
    picture = _picture_maker() if pictures else None
    rows = []
    for outcome in solve_jobs(jobs, processes):
        rows.append(judge_press(outcome, references[outcome.job.name], picture))
        print(f"  {outcome.job.name} {outcome.job.quality}: {outcome.processor_s:.1f} s", flush=True)
    print_table(
        f"{title}: force, contact radius, cost",
        [
            "case",
            "quality",
            "Fz rms %",
            "Fz by depth %",
            "radius worst %",
            "ref ± %",
            "core s/pose",
            "MiB",
            "unconverged",
        ],
        (
            [
                r.case,
                r.quality,
                r.fz_rms_percent,
                " ".join(f"{e:+.1f}" for e in r.fz_percent),
                max(map(abs, r.radius_percent)),
                r.radius_uncertainty_percent,
                r.processor_s_per_pose,
                r.peak_memory_mib,
                r.unconverged,
            ]
            for r in rows
        ),
    )
    print_table(
        f"{title}: membrane",
        ["case", "quality", "u_z rms µm", "in-plane rms µm", "peak µm", "normals rms °", "worst °", "PSNR dB"],
        (
            [r.case, r.quality, r.surface.uz_rms_um, r.surface.in_plane_rms_um, r.surface.peak_um,
             r.surface.normal_rms_deg, r.surface.normal_worst_deg, r.psnr_db]
            for r in rows
        ),
        note="displacement within 5 mm of the contact point, normals within 3 mm of the contact; PSNR: worst depth",
    )  # fmt: skip
    return rows


def judge_press(outcome: Outcome, reference: PressReference, picture=None) -> PressErrors:
    """Hold the states of a descent against the reference; with a `picture` maker their pictures too."""
    surfaces, quality_db = [], []
    for index, state in enumerate(outcome.states):
        expected = reference.displacement_mm(index, state.x_mm, state.y_mm)
        radius = float(reference.contact_radius_mm[index])
        surfaces.append(surface_errors(state.x_mm, state.y_mm, state.displacement_mm, expected, radius))
        if picture is not None:
            pair = (picture(state, shape) for shape in (state.displacement_mm, expected))
            quality_db.append(picture_psnr_db(*pair))
    force = np.array([state.force_n[2] for state in outcome.states])
    radius = np.array([state.contact_radius_mm for state in outcome.states])
    uncertainty = reference.contact_radius_uncertainty_mm / reference.contact_radius_mm
    return PressErrors(
        case=outcome.job.name,
        quality=outcome.job.quality,
        fz_percent=tuple(100 * (force / reference.force_n - 1)),
        radius_percent=tuple(100 * (radius / reference.contact_radius_mm - 1)),
        radius_uncertainty_percent=float(100 * uncertainty.max()),
        surface=_over_depths(surfaces),
        psnr_db=min(quality_db) if quality_db else None,
        processor_s_per_pose=outcome.processor_s / len(outcome.states),
        wall_s_per_pose=outcome.wall_s / len(outcome.states),
        peak_memory_mib=outcome.peak_memory_mib,
        unconverged=outcome.unconverged,
    )


def _over_depths(surfaces: list[SurfaceErrors]) -> SurfaceErrors:
    """Root mean square of the rms errors, largest of the peaks."""
    return SurfaceErrors(
        uz_rms_um=_rms(s.uz_rms_um for s in surfaces),
        in_plane_rms_um=_rms(s.in_plane_rms_um for s in surfaces),
        peak_um=max(s.peak_um for s in surfaces),
        normal_rms_deg=_rms(s.normal_rms_deg for s in surfaces),
        normal_worst_deg=max(s.normal_worst_deg for s in surfaces),
    )


def _picture_maker():
    """Return a function that renders a displacement on a state's grid, with the paper's sensor under i0."""
    from gelgap.render import Illumination, MembraneRenderer, Sensor

    renderer = MembraneRenderer(Sensor.preset("paper"), Illumination.preset("i0"))

    def picture(state: MembraneState, displacement_mm):
        return renderer.picture(state.x_mm, state.y_mm, np.asarray(displacement_mm, np.float32))

    return picture


def own_energy(processes: int) -> dict[str, object]:
    """Print Fz at friction 0.8 of MuJoCo's own energy at ν = 0.45 and of the isochoric gel at ν = 0.49."""
    references = press_references()
    rows = []
    chosen = [references["snh45_no_slip"], references["nh49_no_slip"]]
    jobs = [press_job(replace(reference, friction=0.8), "standard") for reference in chosen]
    results = {}
    for reference, outcome in zip(chosen, solve_jobs(jobs, processes), strict=True):
        force = np.array([state.force_n[2] for state in outcome.states])
        error = 100 * (force / reference.force_n - 1)
        label = f"ν {reference.poisson_ratio} {reference.strain_energy}"
        rows += [
            [label, f"{depth:g}", f, r, f"{e:+.2f}"]
            for depth, f, r, e in zip(reference.depths_mm, force, reference.force_n, error, strict=True)
        ]
        cost = outcome.wall_s / len(force), outcome.processor_s / len(force)
        rows.append([label, "a pose", None, None, f"{cost[0]:.2f} s wall, {cost[1]:.2f} s core"])
        results[label] = {"fz_n": force, "error_percent": error, "wall_s": cost[0], "processor_s": cost[1]}
    print_table(
        "Fz at E 0.3 MPa, 3 mm pad, R 1.5 mm, friction 0.8, standard, against the no-slip tables",
        ["gel", "depth mm", "Fz N", "reference N", "error %"],
        rows,
        note="the reference's own uncertainty is 0.3 %; with friction 0.5 or more nothing slips in a press",
    )
    return results


def held_back_reference(scene: tuple[float, float, float, float]) -> PressReference:
    """Press a scene that no table has with the project's own axisymmetric solver."""
    from gelgap.benchmarks.fem.axisymmetric import Press, solve_press

    radius, thickness, poisson_ratio, friction = scene
    deepest = min(thickness / 3, 2 * radius / 3)
    depths = tuple(round(deepest * share, 3) for share in (0.25, 0.5, 0.75, 1.0))
    press = Press(
        poisson_ratio=poisson_ratio,
        friction=math.inf if friction == NO_SLIP_FRICTION else friction,
        indenter_radius_mm=radius,
        thickness_mm=thickness,
        pad_radius_mm=max(10.0, 3.5 * thickness),
        element_mm=0.05 * radius,
    )
    states = solve_press(press, depths)
    return PressReference(
        name=f"R{radius:g} h{thickness:g} ν{poisson_ratio:g} μ{friction:g}",
        strain_energy="isochoric",
        poisson_ratio=poisson_ratio,
        young_modulus_mpa=press.young_modulus_mpa,
        friction=friction,
        indenter_radius_mm=radius,
        thickness_mm=thickness,
        depths_mm=depths,
        force_n=np.array([state.force_n for state in states]),
        contact_radius_mm=np.array([state.contact_radius_mm for state in states]),
        contact_radius_uncertainty_mm=np.full(len(states), press.element_mm / 4),
        profiles=tuple(np.stack([state.r_mm, state.u_r_mm, state.u_z_mm]) for state in states),
    )


# --- shear ----------------------------------------------------------------------------------------------------


def shear_errors(
    references: Iterable[ShearReference], qualities: Iterable[str], processes: int
) -> list[ShearErrors]:
    """Drag as the references do, and print forces against theirs."""
    references = tuple(references)
    scenes = [(reference, quality) for quality in qualities for reference in references]
    jobs = [_shear_job(reference, quality) for reference, quality in scenes]
    rows = []
    for (reference, _), outcome in zip(scenes, solve_jobs(jobs, processes), strict=True):
        rows.append(_judge_drag(outcome, reference))
        print(f"  {outcome.job.name} {outcome.job.quality}: {outcome.processor_s:.1f} s", flush=True)
    print_table(
        "Drags to 0.6 mm, ν 0.48, against 3-D finite elements",
        ["reference", "friction", "depth mm", "quality", "Fx rms %", "Fx by travel %", "ref ± %", "Fz rms %",
         "Fz by travel %", "Fx/|Fz|", "reference's", "|f_t|/μf_n − 1", "core s a pose", "unconverged"],
        (
            [r.source, f"{r.friction:g}", f"{r.depth_mm:g}", r.quality, _rms(r.fx_percent),
             " ".join(f"{e:+.1f}" for e in r.fx_percent), r.fx_uncertainty_percent, _rms(r.fz_percent),
             " ".join(f"{e:+.1f}" for e in r.fz_percent), r.force_ratio, r.reference_force_ratio, r.coulomb_excess,
             r.processor_s_per_pose, r.unconverged]
            for r in rows
        ),
        note=f"friction {NO_SLIP_FRICTION:g} does not slip; ratios at the end of the drag; the contact points' own "
        "friction stays within μ of their normal force, the ratio of the whole contact need not",
    )  # fmt: skip
    return rows


def _judge_drag(outcome: Outcome, reference: ShearReference) -> ShearErrors:
    force = np.array([state.force_n for state in outcome.states])
    return ShearErrors(
        source=reference.source,
        friction=reference.friction,
        depth_mm=reference.depth_mm,
        quality=outcome.job.quality,
        fx_percent=tuple(100 * (force[1:, 0] / reference.fx_n[1:] - 1)),
        fz_percent=tuple(100 * (force[:, 2] / reference.fz_n - 1)),
        fx_uncertainty_percent=100 * reference.fx_uncertainty,
        force_ratio=float(-force[-1, 0] / force[-1, 2]),
        reference_force_ratio=float(-reference.fx_n[-1] / reference.fz_n[-1]),
        coulomb_excess=max(state.diagnostics.coulomb_excess for state in outcome.states),
        processor_s_per_pose=outcome.processor_s / len(force),
        unconverged=outcome.unconverged,
    )


def _shear_job(reference: ShearReference, quality: str) -> Job:
    elastomer = Elastomer(
        young_modulus_mpa=reference.young_modulus_mpa,
        poisson_ratio=reference.poisson_ratio,
        friction=reference.friction,
        pad_size_mm=(20.0, 20.0),
    )
    poses = tuple(
        Pose(depth_mm=reference.depth_mm, shear_x_mm=float(travel)) for travel in reference.shear_mm
    )
    return Job(
        f"drag at {reference.depth_mm:g} mm, friction {reference.friction:g}", elastomer, poses, quality
    )


def partial_slip(processes: int) -> list[list[object]]:
    """Print a shallow drag beside Cattaneo and Mindlin's partial slip: the only closed form with Coulomb friction."""
    friction, depth, shear_modulus, poisson_ratio = 0.3, 0.1, 0.1, 0.495
    elastomer = Elastomer(
        young_modulus_mpa=2 * shear_modulus * (1 + poisson_ratio),
        poisson_ratio=poisson_ratio,
        friction=friction,
        thickness_mm=10.0,
        pad_size_mm=(60.0, 60.0),
    )
    travels = (0.0, 0.01, 0.02, 0.03, 0.05, 0.08)
    poses = tuple(Pose(depth_mm=depth, shear_x_mm=travel) for travel in travels)
    (outcome,) = solve_jobs(
        [Job("partial slip", elastomer, poses, indenter=Sphere(diameter_mm=6.0))], processes
    )
    normal = -outcome.states[0].force_n[2]
    radius = outcome.states[0].contact_radius_mm
    full_slip_mm = 3 * friction * normal * (2 - poisson_ratio) / (16 * radius * shear_modulus)
    rows: list[list[object]] = []
    for travel, state in zip(travels[1:], outcome.states[1:], strict=True):
        share = min(travel / full_slip_mm, 1.0)
        expected = 1 - (1 - share) ** 1.5
        measured = float(state.force_n[0] / (friction * normal))
        rows.append([f"{travel:g}", share, measured, expected, measured - expected])
    print_table(
        f"Partial slip: R 3 mm, {depth:g} mm deep in 10 mm, friction {friction:g}, against Cattaneo–Mindlin",
        ["travel mm", "share of full slip", "Fx/(μ Fz)", "theory", "difference"],
        rows,
        note="the theory is that of a half-space, with the measured normal force and contact radius",
    )
    return rows


# --- summaries ------------------------------------------------------------------------------------------------


def closed_forms(quality: str, processes: int) -> list[list[object]]:
    """Print shallow presses beside Hertz and the bonded layer: sanity, not truth."""
    depths = (0.05, 0.1, 0.2)
    elastomer = Elastomer(young_modulus_mpa=0.3, poisson_ratio=0.495, friction=0.0)
    job = Job("shallow", elastomer, tuple(Pose(depth_mm=depth) for depth in depths), quality)
    (outcome,) = solve_jobs([job], processes)
    rows: list[list[object]] = []
    for depth, state in zip(depths, outcome.states, strict=True):
        hertz = float(theory.hertz_force_n(0.3, 0.495, 1.5, depth))
        layer = float(theory.bonded_layer_force_n(0.3, 1.5, 3.0, depth))
        force = -state.force_n[2]
        rows.append([f"{depth:g}", force, hertz, layer, 100 * (force / layer - 1)])
    print_table(
        "Closed forms: frictionless, ν 0.495",
        ["depth mm", "|Fz| N", "Hertz half-space N", "bonded layer N", "to the layer %"],
        rows,
        note="finite strain and the exact sphere put converged finite elements 1.6 % below the layer at 0.05 mm, "
        "2.4 % at 0.1 mm and 3.7 % at 0.2 mm",
    )
    return rows


def convergence(presses: list[PressErrors]) -> list[list[object]]:
    """Print by which power of the surface elements' size the error of Fz falls between qualities."""
    from gelgap.sim.quality import QUALITIES

    rows: list[list[object]] = []
    for case in dict.fromkeys(press.case for press in presses):
        found = [press for press in presses if press.case == case]
        size = np.log([QUALITIES[press.quality].disc.surface_mm for press in found])
        if len(found) < 2:
            continue
        error = [press.fz_rms_percent for press in found]
        rows.append(
            [case, " ".join(f"{p.quality} {e:.2f}" for p, e in zip(found, error, strict=True)),
             float(np.polyfit(size, np.log(error), 1)[0])]
        )  # fmt: skip
    print_table("Mesh convergence", ["case", "Fz rms % by quality", "order"], rows)
    return rows


def targets(presses: list[PressErrors], shears: list[ShearErrors]) -> None:
    """Print the accuracy that `standard` promises for the isochoric gel beside what was measured."""
    found = [p for p in presses if p.quality == "standard" and p.case.startswith("nh")]
    drags = [s for s in shears if s.quality == "standard"] or shears
    surfaces = [press.surface for press in found]
    lines = [
        ("Fz rms, %", _rms(e for p in found for e in p.fz_percent), 2.0),
        ("Fz worst, %", max(p.fz_worst_percent for p in found), 4.0),
        (f"Fx rms ({drags[0].quality}), %", _rms(e for s in drags for e in s.fx_percent), 5.0),
        ("u_z rms, µm", _rms(s.uz_rms_um for s in surfaces), 5.0),
        ("in-plane rms, µm", _rms(s.in_plane_rms_um for s in surfaces), 5.0),
        ("surface peak, µm", max(s.peak_um for s in surfaces), 15.0),
        ("normals rms, °", _rms(s.normal_rms_deg for s in surfaces), 1.0),
        ("normals worst, °", max(s.normal_worst_deg for s in surfaces), 4.0),
        ("contact radius worst, %", max(abs(e) for p in found for e in p.radius_percent), 3.0),
        ("peak memory, MiB", max(p.peak_memory_mib for p in found), 2048.0),
    ]
    rows = [[name, value, f"≤ {limit:g}", value <= limit] for name, value, limit in lines]
    psnr = min(p.psnr_db for p in found if p.psnr_db is not None)
    rows.append(["picture PSNR, dB", psnr, "≥ 40", psnr >= 40])
    print_table(
        f"Targets at standard over {len(found)} cases", ["quantity", "measured", "target", "met"], rows
    )


def frontier(presses: list[PressErrors]) -> list[Point]:
    """Return the qualities as points: mean cost and error over the cases that all of them solved."""
    qualities = list(dict.fromkeys(press.quality for press in presses))
    shared = set.intersection(*({p.case for p in presses if p.quality == q} for q in qualities))
    points = []
    for quality in qualities:
        found = [p for p in presses if p.quality == quality and p.case in shared]
        seconds = float(np.mean([p.processor_s_per_pose for p in found]))
        points.append(
            Point(
                "one descent, 5 depths: against finite elements",
                quality,
                seconds,
                _rms(p.fz_rms_percent for p in found),
            )
        )
    return points


def _rms(values: Iterable[float]) -> float:
    return float(np.sqrt(np.mean(np.square(list(values)))))
