"""Oracles from paired contacts, against gels whose forces are known in closed form."""

import numpy as np
import pytest

from gelgap.adapt.evaluation import (
    Presses,
    evaluate_predictions,
    geometry_oracle,
    pose_oracle,
    worse_than_constant,
)
from gelgap.data import ArrayFrames
from gelgap.data.facts import unseen_differences
from gelgap.domains import make_recipes
from gelgap.domains.recipe import DomainRecipe, facts_of


def labelled(force_n: np.ndarray, contact_class: np.ndarray, point_id: np.ndarray) -> ArrayFrames:
    """Return frames of which only the labels matter."""
    images = np.zeros((len(force_n), 1, 1, 3), np.uint8)
    return ArrayFrames("labels", images, images[0], force_n, contact_class, point_id)


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
    return Presses(labelled(force, np.array(classes), np.array(points)), command, mount)


@pytest.mark.parametrize("mount", [None, 2.0])
def test_geometry_oracle_is_the_sources_force_at_the_targets_contact(mount):
    soft, hard = linear_gel(1.0, mount), linear_gel(1.5, mount)
    np.testing.assert_allclose(hard.actual_mm, hard.frames.force_n / 1.5, atol=1e-12)
    expected = np.abs(hard.frames.force_n - 1.0 * hard.actual_mm).mean(axis=0)
    np.testing.assert_allclose(geometry_oracle(soft, hard).mae_n, expected, atol=1e-9)


def test_a_rigid_rig_makes_both_oracles_one_and_a_compliant_one_does_not():
    soft, hard = linear_gel(1.0, None), linear_gel(1.5, None)
    np.testing.assert_allclose(
        geometry_oracle(soft, hard).mae_n, pose_oracle(soft.frames, hard.frames).mae_n, atol=1e-9
    )
    soft, hard = linear_gel(1.0, 2.0), linear_gel(1.5, 2.0)
    assert geometry_oracle(soft, hard).mean_mae_n > 1.1 * pose_oracle(soft.frames, hard.frames).mean_mae_n


def test_the_same_gel_has_no_gap_and_order_does_not_matter():
    gel = linear_gel(1.0, 5.0)
    turned = np.random.default_rng(0).permutation(len(gel.frames))
    shuffled = Presses(gel.frames.take(turned), gel.command_mm[turned], gel.mount_n_per_mm)
    assert geometry_oracle(gel, shuffled).mean_mae_n < 1e-9
    assert pose_oracle(gel.frames, shuffled.frames).mean_mae_n < 1e-12


def test_presses_straight_down_are_interpolated_over_depth():
    def straight(stiffness: float) -> Presses:
        depth = np.array([0.2, 0.4, 0.6])
        command = np.stack([0 * depth, 0 * depth, -depth], axis=1)
        force = stiffness * command / (1 + stiffness / 10)
        return Presses(labelled(force, np.arange(3), np.zeros(3, int)), command, 10.0)

    soft, hard = straight(1.0), straight(1.5)
    expected = np.abs(hard.frames.force_n - hard.actual_mm).mean(axis=0)
    np.testing.assert_allclose(geometry_oracle(soft, hard).mae_n, expected, atol=1e-9)


def test_pose_oracle_of_frames_is_the_force_scale(source):
    harder = labelled(source.force_n * 1.1, source.contact_class, source.point_id)
    shuffled = harder.take(np.random.default_rng(0).permutation(len(harder)))
    result = pose_oracle(source, shuffled)
    assert result.mae_n[2] == pytest.approx(0.1 / 1.1 * np.abs(shuffled.force_n[:, 2]).mean(), rel=1e-3)
    with pytest.raises(ValueError, match="share no contact"):
        pose_oracle(source, labelled(source.force_n, source.contact_class, source.point_id + 100))


def unseen(one: DomainRecipe, other: DomainRecipe) -> list[str]:
    return unseen_differences(one.name, facts_of(one), other.name, facts_of(other))


def test_adaptation_says_what_no_picture_of_its_gap_shows():
    """Own gel, own friction, no markers on the target: a sentence each, and none for a gap of light alone."""
    (source,) = make_recipes(["mb0i0"], "smoke")
    assert unseen(source, source) == []
    (light,) = make_recipes(["mb0i2"], "smoke")
    assert unseen(source, light) == []
    gel = source.elastomer.model_copy(update={"young_modulus_mpa": 0.15, "friction": 0.5})
    other = source.model_copy(update={"name": "own", "elastomer": gel, "markers": False})
    modulus, friction, markers = unseen(source, other)
    assert "modulus 0.7 and 0.15 MPa: the same dent takes × 0.214 the force on own" in modulus
    assert "friction 0.24 and 0.5" in friction
    assert "no markers on own: a single picture shows" in markers
    assert "from first touch on" in markers
    thick = gel.model_copy(update={"thickness_mm": 4.0})
    assert any(
        "thickness 3 and 4 mm" in n for n in unseen(other, other.model_copy(update={"elastomer": thick}))
    )


def test_worse_than_a_constant_is_said_of_the_labels_concerned():
    truth = np.array([[0.0, 0.0, -1.0], [0.1, 0.2, -2.0], [0.2, 0.4, -3.0]])
    ranges = np.array([[-1.0, 1.0], [-1.0, 1.0], [-3.0, 0.0]])
    bad = truth * [1, -1, 1]
    assert worse_than_constant(evaluate_predictions(truth, truth, ranges)) == ""
    assert worse_than_constant(evaluate_predictions(truth, bad, ranges)).startswith(
        "Fy: worse than a constant"
    )
