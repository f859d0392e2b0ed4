"""Drags against three-dimensional finite elements: forces by travel, and how near Coulomb's limit they end."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from gelgap.benchmarks.common.tables import print_table
from gelgap.benchmarks.physics.cases import Case, SolvedCase, Workers
from gelgap.benchmarks.physics.presses import signed
from gelgap.benchmarks.physics.reference import NO_SLIP_FRICTION, DragReference
from gelgap.benchmarks.physics.surface_errors import rms
from gelgap.sim import Elastomer, Pose


@dataclass(frozen=True)
class DragErrors:
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


def drag_case(reference: DragReference, quality: str) -> Case:
    """Return a drag through the reference's travels."""
    elastomer = Elastomer(
        young_modulus_mpa=reference.young_modulus_mpa,
        poisson_ratio=reference.poisson_ratio,
        friction=reference.friction,
        pad_size_mm=(20.0, 20.0),
    )
    poses = tuple(
        Pose(depth_mm=reference.depth_mm, shear_x_mm=float(travel)) for travel in reference.travel_mm
    )
    name = f"drag at {reference.depth_mm:g} mm, friction {reference.friction:g}"
    return Case(name, elastomer, poses, quality)


def judge_drag(solved: SolvedCase, reference: DragReference) -> DragErrors:
    """Compare the states of a drag with the reference."""
    force = np.array([state.force_n for state in solved.states])
    return DragErrors(
        source=reference.source,
        friction=reference.friction,
        depth_mm=reference.depth_mm,
        quality=solved.case.quality,
        fx_percent=tuple(100 * (force[1:, 0] / reference.fx_n[1:] - 1)),
        fz_percent=tuple(100 * (force[:, 2] / reference.fz_n - 1)),
        fx_uncertainty_percent=100 * reference.fx_uncertainty,
        force_ratio=float(-force[-1, 0] / force[-1, 2]),
        reference_force_ratio=float(-reference.fx_n[-1] / reference.fz_n[-1]),
        coulomb_excess=max(state.diagnostics.coulomb_excess for state in solved.states),
        processor_s_per_pose=solved.processor_s_per_pose,
        unconverged=solved.unconverged,
    )


def compare_drags(references: Mapping[Case, DragReference], workers: Workers) -> list[DragErrors]:
    """Solve each drag, compare it with its reference, and print both's forces."""
    rows = [judge_drag(solved, references[solved.case]) for solved in workers.solve(references)]
    print_table(
        "Drags to 0.6 mm, ν 0.48, against 3-D finite elements",
        ["reference", "friction", "depth mm", "quality", "Fx rms %", "Fx by travel %", "ref ± %", "Fz rms %",
         "Fz by travel %", "Fx/|Fz|", "reference's", "|f_t|/μf_n − 1", "core s/pose", "unconverged"],
        (
            [r.source, f"{r.friction:g}", f"{r.depth_mm:g}", r.quality, rms(r.fx_percent), signed(r.fx_percent),
             r.fx_uncertainty_percent, rms(r.fz_percent), signed(r.fz_percent), r.force_ratio,
             r.reference_force_ratio, r.coulomb_excess, r.processor_s_per_pose, r.unconverged]
            for r in rows
        ),
        note=f"friction {NO_SLIP_FRICTION:g} does not slip; ratios at the end of the drag; the contact points' own "
        "friction stays within μ of their normal force, the ratio of the whole contact need not",
    )  # fmt: skip
    return rows
