"""Scenes whose answer is known without a finer solve: slides without friction, touches, partial slip.

The bounds are what the guide says of the errors (docs/physics.md, Accuracy), and a little.
"""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
import pytest

from gelgap.assets import asset_path
from gelgap.sim import Elastomer, MembraneState, Pose, Sharing, Sphere, solve_poses

pytestmark = pytest.mark.numerical

QUALITIES = pytest.mark.parametrize("quality", ["draft", pytest.param("standard", marks=pytest.mark.slow)])


def solved(radius_mm: float, quality: str, *poses: Pose, **gel: Any) -> tuple[MembraneState, ...]:
    """Press a wide pad, without friction unless `gel` has one."""
    given = {"young_modulus_mpa": 0.3, "poisson_ratio": 0.49, "friction": 0.0} | gel
    pad = Elastomer(**{"strain_energy": "stable-neo-hookean"} | given, pad_size_mm=(100.0, 100.0))
    return solve_poses(pad, Sphere(diameter_mm=2 * radius_mm), poses, quality, Sharing(cache=False))


@pytest.mark.slow
@QUALITIES
@pytest.mark.parametrize(
    ("radius_mm", "thickness_mm", "depth_mm", "travel_mm"), [(1.5, 3, 0.6, 3), (0.5, 6, 0.3, 2)]
)
def test_a_slide_without_friction_changes_no_force(
    quality: str, radius_mm: float, thickness_mm: float, depth_mm: float, travel_mm: float
) -> None:
    poses = (Pose(depth_mm=depth_mm, shear_x_mm=share * travel_mm) for share in (0.0, 0.25, 0.5, 0.75, 1.0))
    still, *slid = solved(radius_mm, quality, *poses, thickness_mm=thickness_mm)
    for state in slid:
        assert state.force_n[2] == pytest.approx(still.force_n[2], rel=0.015)
        assert abs(state.force_n[0]) < 0.01 * abs(state.force_n[2])


@QUALITIES
@pytest.mark.parametrize(
    ("radius_mm", "thickness_mm"),
    [(1.5, 3.0), *(pytest.param(*scene, marks=pytest.mark.slow) for scene in ((3, 6), (5, 6), (5, 20)))],
)
@pytest.mark.parametrize(
    "depth_mm", [0.02, *(pytest.param(mm, marks=pytest.mark.slow) for mm in (0.01, 0.05, 0.1))]
)
def test_a_touch_has_force_membrane_and_contact_of_axisymmetric_elements(
    quality: str, radius_mm: float, thickness_mm: float, depth_mm: float
) -> None:
    (state,) = solved(radius_mm, quality, Pose(depth_mm=depth_mm), thickness_mm=thickness_mm)
    touches = pd.read_csv(asset_path("reference", "spheres", "touches.csv"))
    truth = touches.query(
        "radius_mm == @radius_mm and thickness_mm == @thickness_mm and depth_mm == @depth_mm"
    )
    assert state.force_n[2] == pytest.approx(truth["fz_n"].iloc[0], rel=0.016)
    r_mm = np.hypot(*np.meshgrid(state.x_mm, state.y_mm))
    off_mm = state.displacement_mm[..., 2] - np.interp(r_mm, truth["r_mm"], truth["u_z_mm"])
    assert np.abs(off_mm).max() < 0.03 * depth_mm
    assert r_mm[state.contact].max() < 1.05 * truth["contact_radius_mm"].iloc[0]


@QUALITIES
@pytest.mark.parametrize(
    ("depth_mm", "travels_mm", "fx_n", "fz_n"),
    [
        (0.1, (0.005, 0.02, 0.05), (0.001609, 0.006436, 0.016086), (-0.030615, -0.030636, -0.030757)),
        pytest.param(
            *(0.3, (0.005, 0.02, 0.06), (0.002922, 0.011687, 0.035060), (-0.164392, -0.164413, -0.164591)),
            marks=pytest.mark.slow,
        ),
    ],
)
def test_a_sticking_drag_of_a_narrow_contact_is_felupes(
    quality: str, depth_mm: float, travels_mm: Sequence[float], fx_n: Sequence[float], fz_n: Sequence[float]
) -> None:
    """R 3 on 10 mm without slip beside felupe 11.3, whose energy is the isochoric one.

    Its hexahedra of mean dilatation are a tenth of the contact's radius wide, in half a disc of 20 sectors; with a
    seventh Fx is 2 % larger. Mindlin's half-space is 5 and 7 % softer: in so deep presses strains
    are not small. The script that made the numbers is not part of the project.
    """
    poses = (Pose(depth_mm=depth_mm, shear_x_mm=travel) for travel in (0.0, *travels_mm))
    gel = {"poisson_ratio": 0.495, "friction": 10.0, "thickness_mm": 10.0, "strain_energy": "isochoric"}
    _, *dragged = solved(3.0, quality, *poses, **gel)
    force_n = np.array([state.force_n for state in dragged])
    assert force_n[:, 0] == pytest.approx(np.array(fx_n), rel=0.065 if quality == "draft" else 0.03)
    assert force_n[:, 2] == pytest.approx(np.array(fz_n), rel=0.02)


@pytest.mark.slow
@QUALITIES
@pytest.mark.parametrize("depth_mm", [0.1, 0.3])
def test_partial_slip_is_cattaneo_and_mindlins(quality: str, depth_mm: float) -> None:
    """Stiffness and sticking share of a drag, R 3 on 10 mm, are nearly those of a half-space with its Fz and radius.

    G = E / (2 (1 + ν)), the first stiffness is 8 a G / (2 − ν), and (c/a)³ = 1 − Q / μP for the radius c within which
    vertices stick; from a travel of 3 μP (2 − ν) / (16 a G) on nothing does (Johnson 1985, eq. 7.42). They carry the
    share 1 − (1 − c²/a²)^1.5 of the load. A half-space's sphere would travel further by what the backing holds back:
    (3 ln 2 / 8π) Q / (G h), to first order in a / h, for an incompressible gel.
    """
    young_mpa, poisson, friction, thickness_mm = 0.3, 0.495, 0.3, 10.0
    shear_mpa = young_mpa / (2 * (1 + poisson))
    # By Hertz a press is μ d (2 − ν) / (2 (1 − ν)) short of slipping as a whole.
    full_mm = friction * depth_mm * (2 - poisson) / (2 * (1 - poisson))
    travels_mm = [round(share * full_mm, 6) for share in (0.05, 0.4, 0.7)]
    poses = (Pose(depth_mm=depth_mm, shear_x_mm=travel) for travel in (0.0, *travels_mm))
    gel = {"poisson_ratio": poisson, "friction": friction, "thickness_mm": thickness_mm}
    still, *dragged = solved(3.0, quality, *poses, **gel)
    limit_n = -friction * still.force_n[2]
    slips_at_mm = 3 * limit_n * (2 - poisson) / (16 * still.contact_radius_mm * shear_mpa)
    expected_n = []
    for travel_mm, state in zip(travels_mm, dragged, strict=True):
        held_back_mm = 3 * math.log(2) / (8 * math.pi) * state.force_n[0] / (shear_mpa * thickness_mm)
        travelled = min((travel_mm + held_back_mm) / slips_at_mm, 1)
        expected_n.append(limit_n * (1 - (1 - travelled) ** 1.5))
    begun, *slipping = dragged
    assert begun.force_n[0] == pytest.approx(expected_n[0], rel=0.07)
    for state, force_n in zip(slipping, expected_n[1:], strict=True):
        assert state.force_n[0] == pytest.approx(force_n, rel=0.11)
        sticks = 1 - (1 - (1 - force_n / limit_n) ** (2 / 3)) ** 1.5
        assert state.diagnostics.sticking_fraction == pytest.approx(sticks, abs=0.11)
