"""Presses against independent finite elements: force, contact radius, membrane, picture and cost."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from gelgap.benchmarks.common.tables import print_table
from gelgap.benchmarks.fem.axisymmetric import Press, solve_press
from gelgap.benchmarks.physics.cases import Case, SolvedCase, Workers
from gelgap.benchmarks.physics.reference import NO_SLIP_FRICTION, PressReference, press_references
from gelgap.benchmarks.physics.surface_errors import (
    SurfaceErrors,
    combined,
    picture_psnr_db,
    rms,
    surface_errors,
)
from gelgap.sim import Elastomer, MembraneState, Pose, Sphere

HELD_BACK = tuple(  # presses that no table and no calibration has
    replace(Press.scaled(radius, thickness, poisson_ratio, friction), element_mm=0.05 * radius)
    for radius, thickness, poisson_ratio, friction in (
        (1.0, 2.0, 0.47, 0.3),
        (2.5, 4.0, 0.49, 0.8),
        (1.5, 5.0, 0.495, 0.1),
        (2.0, 3.0, 0.46, math.inf),
    )
)
OWN_ENERGY_FRICTION = 0.8

Picture = Callable[[MembraneState, np.ndarray], np.ndarray]


@dataclass(frozen=True)
class PressErrors:
    """One case at one quality: errors over its depths, cost per pose."""

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
        return rms(self.fz_percent)

    @property
    def fz_worst_percent(self) -> float:
        return max(map(abs, self.fz_percent))

    @property
    def radius_worst_percent(self) -> float:
        return max(map(abs, self.radius_percent))


def press_case(reference: PressReference, quality: str) -> Case:
    """Return one descent through the reference's depths."""
    elastomer = Elastomer(
        young_modulus_mpa=reference.young_modulus_mpa,
        poisson_ratio=reference.poisson_ratio,
        friction=reference.friction,
        thickness_mm=reference.thickness_mm,
        strain_energy=reference.strain_energy,
    )
    poses = tuple(Pose(depth_mm=depth) for depth in reference.depths_mm)
    return Case(
        reference.name, elastomer, poses, quality, Sphere(diameter_mm=2 * reference.indenter_radius_mm)
    )


def judge_press(solved: SolvedCase, reference: PressReference, picture: Picture | None = None) -> PressErrors:
    """Compare the states of a descent with the reference; with a `picture` maker their pictures too."""
    surfaces, psnr_db = [], []
    for index, state in enumerate(solved.states):
        expected = reference.displacement_mm(index, state.x_mm, state.y_mm)
        radius = float(reference.contact_radius_mm[index])
        surfaces.append(surface_errors(state.x_mm, state.y_mm, state.displacement_mm, expected, radius))
        if picture is not None:
            psnr_db.append(picture_psnr_db(picture(state, state.displacement_mm), picture(state, expected)))
    force = np.array([state.force_n[2] for state in solved.states])
    radius = np.array([state.contact_radius_mm for state in solved.states])
    uncertainty = reference.contact_radius_uncertainty_mm / reference.contact_radius_mm
    return PressErrors(
        case=solved.case.name,
        quality=solved.case.quality,
        fz_percent=tuple(100 * (force / reference.force_n - 1)),
        radius_percent=tuple(100 * (radius / reference.contact_radius_mm - 1)),
        radius_uncertainty_percent=float(100 * uncertainty.max()),
        surface=combined(surfaces),
        psnr_db=min(psnr_db, default=None),
        processor_s_per_pose=solved.processor_s_per_pose,
        wall_s_per_pose=solved.wall_s_per_pose,
        peak_memory_mib=solved.peak_memory_mib,
        unconverged=solved.unconverged,
    )


def picture_maker() -> Picture:
    """Return a function that renders a displacement on a state's grid, with the paper's sensor under i0."""
    from gelgap.render import Illumination, MembraneRenderer, Sensor

    renderer = MembraneRenderer(Sensor.preset("paper"), Illumination.preset("i0"))
    return lambda state, displacement_mm: renderer.picture(
        state.x_mm, state.y_mm, np.asarray(displacement_mm, np.float32)
    )


def compare_presses(
    title: str, references: Mapping[Case, PressReference], workers: Workers, picture: Picture | None = None
) -> list[PressErrors]:
    """Solve each case and compare it with its reference; print force, contact radius and cost, then the membrane."""
    rows = [judge_press(solved, references[solved.case], picture) for solved in workers.solve(references)]
    print_table(
        f"{title}: force, contact radius, cost",
        ["case", "quality", "Fz rms %", "Fz by depth %", "radius worst %", "ref ± %", "core s/pose", "MiB",
         "unconverged"],
        (
            [r.case, r.quality, r.fz_rms_percent, signed(r.fz_percent), r.radius_worst_percent,
             r.radius_uncertainty_percent, r.processor_s_per_pose, r.peak_memory_mib, r.unconverged]
            for r in rows
        ),
    )  # fmt: skip
    print_table(
        f"{title}: membrane",
        [
            "case",
            "quality",
            "u_z rms µm",
            "in-plane rms µm",
            "peak µm",
            "normals rms °",
            "worst °",
            "PSNR dB",
        ],
        ([r.case, r.quality, *r.surface.values, r.psnr_db] for r in rows),
        note="displacement within 5 mm of the contact point, normals within 3 mm of the contact; PSNR: worst depth",
    )
    return rows


def own_energy_cases() -> dict[Case, PressReference]:
    """Return a gel of MuJoCo's own energy at ν = 0.45 and an isochoric one at ν = 0.49, both with friction."""
    chosen = (press_references()[name] for name in ("snh45_no_slip", "nh49_no_slip"))
    return {press_case(replace(r, friction=OWN_ENERGY_FRICTION), "standard"): r for r in chosen}


def own_energy(workers: Workers) -> dict[str, object]:
    """Print Fz of gels with friction, of MuJoCo's own energy and isochoric, beside that of the tables without slip."""
    rows, results = [], {}
    cases = own_energy_cases()
    for reference, solved in zip(cases.values(), workers.solve(cases), strict=True):
        force = np.array([state.force_n[2] for state in solved.states])
        error = 100 * (force / reference.force_n - 1)
        label = f"ν {reference.poisson_ratio} {reference.strain_energy}"
        for values in zip(reference.depths_mm, force, reference.force_n, error, strict=True):
            rows.append([label, f"{values[0]:g}", *values[1:3], f"{values[3]:+.2f}"])
        core_s, wall_s = solved.processor_s_per_pose, solved.wall_s_per_pose
        rows.append([label, "per pose", None, None, f"{wall_s:.2f} s wall, {core_s:.2f} s core"])
        results[label] = {"fz_n": force, "error_percent": error, "wall_s": wall_s, "processor_s": core_s}
    print_table(
        f"Fz at E 0.3 MPa, 3 mm pad, R 1.5 mm, friction {OWN_ENERGY_FRICTION:g}, standard, against the no-slip tables",
        ["gel", "depth mm", "Fz N", "reference N", "error %"],
        rows,
        note="the reference's own uncertainty is 0.3 %; with friction 0.5 or more nothing slips in a press",
    )
    return results


def held_back_reference(press: Press) -> PressReference:
    """Solve a press that no table has, at four depths."""
    return solved_reference(
        press, tuple(round(press.deepest_mm * share, 3) for share in (0.25, 0.5, 0.75, 1.0))
    )


def solved_reference(press: Press, depths_mm: tuple[float, ...]) -> PressReference:
    """Return what the project's own axisymmetric solver finds at rising depths."""
    states = solve_press(press, depths_mm)
    return PressReference(
        name=str(press),
        strain_energy="isochoric",
        poisson_ratio=press.poisson_ratio,
        young_modulus_mpa=press.young_modulus_mpa,
        friction=min(press.friction, NO_SLIP_FRICTION),
        indenter_radius_mm=press.indenter_radius_mm,
        thickness_mm=press.thickness_mm,
        depths_mm=depths_mm,
        force_n=np.array([state.force_n for state in states]),
        contact_radius_mm=np.array([state.contact_radius_mm for state in states]),
        contact_radius_uncertainty_mm=np.full(len(states), press.element_mm / 4),
        profiles=tuple(np.stack([state.r_mm, state.u_r_mm, state.u_z_mm]) for state in states),
    )


def signed(values: Sequence[float]) -> str:
    """Return numbers with one decimal and their signs."""
    return " ".join(f"{value:+.1f}" for value in values)
