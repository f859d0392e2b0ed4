"""Oracles from paired contacts, against gels whose forces are known in closed form."""

from dataclasses import replace

import numpy as np
import pytest

from gelgap.adapt.oracles import Presses, gap_closed, geometry_oracle, pose_oracle

RANGE = np.array([[-0.75, 0.75], [-0.75, 0.75], [-3, 0]])


def linear_gel(stiffness: float, mount: float | None) -> Presses:
    """Return presses of a gel whose force is stiffness × displacement, behind a spring: F = K c/(1 + K/k)."""
    command, points, classes = [], [], []
    for point in range(2):
        command.append((0.0, 0.0, 0.0))
        for depth in (0.2, 0.6, 1.0):
            for radius in (0.1, 0.4):
                for angle in np.radians([0, 90, 210]):
                    command.append((radius * np.cos(angle), radius * np.sin(angle), -depth))
        points += [point] * (len(command) - len(points))
        classes += range(len(command) - len(classes))
    command = np.array(command)
    force = stiffness * command / (1 if mount is None else 1 + stiffness / mount)
    return Presses(force, np.array(points), np.array(classes), RANGE, command, mount)


@pytest.mark.parametrize("mount", [None, 20.0, 2.0])
def test_geometry_oracle_is_the_sources_force_at_the_targets_contact(mount):
    soft, hard = linear_gel(1.0, mount), linear_gel(1.5, mount)
    np.testing.assert_allclose(hard.actual_mm, hard.force_n / 1.5, atol=1e-12)
    expected = np.abs(hard.force_n - 1.0 * hard.actual_mm).mean(axis=0)
    np.testing.assert_allclose(geometry_oracle(soft, hard).mae_n, expected, atol=1e-9)


def test_a_rigid_rig_makes_both_oracles_one_and_a_compliant_one_does_not():
    soft, hard = linear_gel(1.0, None), linear_gel(1.5, None)
    np.testing.assert_allclose(geometry_oracle(soft, hard).mae_n, pose_oracle(soft, hard).mae_n, atol=1e-9)
    soft, hard = linear_gel(1.0, 2.0), linear_gel(1.5, 2.0)
    assert geometry_oracle(soft, hard).mean_mae_n > 1.1 * pose_oracle(soft, hard).mean_mae_n


def test_the_same_gel_has_no_gap_and_order_does_not_matter():
    gel = linear_gel(1.0, 5.0)
    turned = np.random.default_rng(0).permutation(len(gel.force_n))
    names = ("force_n", "point_id", "contact_class", "command_mm")
    shuffled = replace(gel, **{name: getattr(gel, name)[turned] for name in names})
    assert geometry_oracle(gel, shuffled).mean_mae_n < 1e-9
    assert pose_oracle(gel, shuffled).mean_mae_n < 1e-12


def test_presses_straight_down_are_interpolated_over_depth():
    def straight(stiffness: float) -> Presses:
        depth = np.array([0.2, 0.4, 0.6])
        command = np.stack([0 * depth, 0 * depth, -depth], axis=1)
        force = stiffness * command / (1 + stiffness / 10)
        return Presses(force, np.zeros(3, int), np.arange(3), RANGE, command, 10.0)

    soft, hard = straight(1.0), straight(1.5)
    expected = np.abs(hard.force_n - hard.actual_mm).mean(axis=0)
    np.testing.assert_allclose(geometry_oracle(soft, hard).mae_n, expected, atol=1e-9)


def test_pose_oracle_of_frames_is_the_force_scale(source):
    harder = replace(source, force_n=source.force_n * 1.1)
    shuffled = harder.take(np.random.default_rng(0).permutation(len(harder)))
    result = pose_oracle(source, shuffled)
    assert result.mae_n[2] == pytest.approx(0.1 / 1.1 * np.abs(shuffled.force_n[:, 2]).mean(), rel=1e-3)
    with pytest.raises(ValueError, match="share no contact"):
        pose_oracle(source, replace(source, point_id=source.point_id + 100))


def test_gap_closed_is_not_capped():
    assert gap_closed(0.4, 0.2, 0.1) == pytest.approx(2 / 3)
    assert gap_closed(0.4, 0.05, 0.1) > 1
    assert np.isnan(gap_closed(0.1, 0.2, 0.2))
