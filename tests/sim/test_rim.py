"""Where a contact ends: its radius from the gap beside it, and the torque of a twist, beside closed forms."""

import math
from dataclasses import replace

import numpy as np
import pytest

from gelgap.sim import Elastomer, Pose, Sharing, Sphere
from gelgap.sim.plan import plan_visit
from gelgap.sim.rim import contact_radius_mm, sticking_share, twist_factor
from gelgap.sim.solution import Record, Solution, SolveDiagnostics

GEL = Elastomer(young_modulus_mpa=0.3, poisson_ratio=0.49, friction=10.0)
POSE = Pose(depth_mm=0.2)
RADIUS_MM = math.sqrt(1.5 * 0.2)


def _hertz(
    end_mm: float = RADIUS_MM, sticking: float = 1.0, twist_deg: float = 1.0
) -> tuple[Solution, Record]:
    """Return a sphere's contact by Hertz on a half-space, twisted as Reissner & Sagoci's on a radius `end_mm`."""
    problem = (
        plan_visit(
            GEL, Sphere(), (POSE, replace(POSE, twist_deg=twist_deg)), "standard", Sharing(cache=False)
        )
        .solves[0]
        .problem
    )
    axis = np.arange(-1.2, 1.2, 0.02) + 0.007
    rest = np.stack(np.meshgrid(axis, axis), -1).reshape(-1, 2)
    ratio = np.hypot(*rest.T) / RADIUS_MM
    outside = np.maximum(ratio, 1.0)
    profile = rest**2 @ [1, 1] / (2 * 1.5)
    lift = (
        ((2 - outside**2) * np.arcsin(1 / outside) + np.sqrt(outside**2 - 1)) * RADIUS_MM**2 / (1.5 * np.pi)
    )
    height = np.where(ratio < 1, profile - 0.2, -lift)
    # The gap is to the sphere itself, not to its parabola.
    height += (1.5 - np.sqrt(np.maximum(1.5**2 - rest**2 @ [1, 1], 0.0))) - profile
    pressure = np.sqrt(np.maximum(1 - ratio**2, 0.0))
    square = rest**2 @ [1, 1]
    within = square < end_mm**2
    shear = np.where(within, 1 / np.sqrt(np.where(within, end_mm**2 - square, 1.0)), 0.0)
    force = np.column_stack([-rest[:, 1] * shear, rest[:, 0] * shear, -pressure])
    record = Record(
        displacement_mm=np.column_stack([np.zeros_like(rest), height]).astype(np.float32),
        normal_force_n=pressure.astype(np.float32),
        contact_force_n=force.astype(np.float32),
        indenter_mm=np.array([0.0, 0.0, -0.2]),
        force_n=np.array([0.0, 0.0, -pressure.sum()]),
        torque_n_mm=np.array([0.0, 0.0, 1.0]),
        converged=True,
        diagnostics=SolveDiagnostics(sticking_fraction=sticking),
    )
    return Solution(problem, (rest,), (record,)), record


def test_the_gap_says_where_a_contact_ends() -> None:
    solution, record = _hertz()
    assert contact_radius_mm(solution, record) == pytest.approx(RADIUS_MM, rel=0.015)


def test_a_long_contact_ends_within_a_cell_of_its_last_vertices() -> None:
    solution, record = _hertz()
    long = replace(solution, rest_mm=(10 * solution.rest_mm[0],))
    x_mm, y_mm = np.abs(long.rest_mm[0]).T
    # The ends of a lying cylinder press the hardest.
    line = ((x_mm < 10.0) & (y_mm < 0.2)) * (1 + x_mm / 4).astype(np.float32)
    moved = replace(record, normal_force_n=line, indenter_mm=np.array([0.1, 0.0, -0.2]))
    assert 9.9 < contact_radius_mm(long, moved) < 10.0 + solution.problem.cell_mm


def test_a_mesh_that_turns_with_too_wide_a_contact_has_its_torque_reduced() -> None:
    right, wide = (twist_factor(*_hertz(end_mm)) for end_mm in (RADIUS_MM, 1.05 * RADIUS_MM))
    assert right == pytest.approx(1.0, abs=0.06)
    assert wide / right == pytest.approx(1.05**-3, rel=0.02)


def test_where_the_contact_slides_torque_is_frictions() -> None:
    wide_mm = 1.05 * RADIUS_MM
    factors = [twist_factor(*_hertz(wide_mm, sticking)) for sticking in (1.0, 0.75, 0.5, 0.0)]
    assert factors[0] < factors[1] < factors[2] == factors[3] == 1.0


@pytest.mark.parametrize("share", [0.2, 0.5, 0.8])
def test_what_sticks_is_cattaneos_part_of_the_load(share: float) -> None:
    # Friction that is its bound less what a contact of radius c would bear; vertices say 1 % too little or too much.
    solution, record = _hertz(sticking=0.5)
    square = solution.rest_mm[0] ** 2 @ [1, 1] / RADIUS_MM**2
    within = 1 - (1 - share) ** (2 / 3)
    pressure = record.normal_force_n.astype(float)
    lacking = np.sqrt(np.maximum(within - square, 0.0))
    sideways = GEL.friction * (pressure - lacking)
    force_n = np.column_stack([sideways, 0 * pressure, -pressure])
    assert sticking_share(solution, replace(record, contact_force_n=force_n)) == pytest.approx(
        share, abs=0.01
    )


def test_a_contact_that_was_dragged_is_not_taken_to_be_round() -> None:
    solution, record = _hertz(1.05 * RADIUS_MM)
    dragged = replace(record, force_n=np.array([0.1, 0.0, 1.0]) * record.force_n[2])
    assert twist_factor(solution, dragged) == 1.0
    assert contact_radius_mm(solution, dragged) == pytest.approx(RADIUS_MM, rel=0.01)
