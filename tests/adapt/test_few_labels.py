"""A few labelled target frames: how they are drawn, what a correction recovers, what fine-tuning changes."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from gelgap.adapt.evaluation import evaluate
from gelgap.adapt.few_labels import affine_correction, draw_labelled, fine_tune
from gelgap.adapt.model import AffineCorrection, ForceModel
from gelgap.adapt.trainer import adapt
from gelgap.data import ArrayFrames


@pytest.fixture(scope="module")
def halves(target):
    """The target's training and test frames."""
    return target.take(np.arange(48)), target.take(np.arange(48, 96))


def labelled(frames, force_n) -> ArrayFrames:
    """Return the frames with other forces."""
    return ArrayFrames(frames.name, frames.images(), frames.reference, force_n)


def test_drawn_frames_are_spread_over_the_depths(target):
    rng = np.random.default_rng(0)
    depth_mm = rng.permutation(np.repeat(np.linspace(0, 1, 12), 8))
    frames = ArrayFrames("t", target.images(), target.reference, target.force_n, depth_mm=depth_mm)
    for seed in range(5):
        drawn = draw_labelled(frames, 12, seed)
        np.testing.assert_allclose(np.sort(drawn.columns["depth_mm"]), np.linspace(0, 1, 12))
    first, again, other = (draw_labelled(frames, 5, seed).digest for seed in (0, 0, 1))
    assert first == again != other
    assert len({draw_labelled(frames, 1, seed).columns["depth_mm"][0] for seed in range(20)}) > 5
    np.testing.assert_array_equal(
        np.sort(draw_labelled(target, 96, 0).force_n, axis=0), np.sort(target.force_n, axis=0)
    )


@pytest.mark.parametrize("k", [0, 97])
def test_no_more_frames_are_drawn_than_there_are(target, k):
    with pytest.raises(ValueError, match=f"k = {k} labelled frames of wmb1i1: must be 1 to 96"):
        draw_labelled(target, k, 0)


def test_a_gain_is_recovered_by_five_labels(stage1, halves):
    gain, (train, test) = 0.6, halves
    weak = replace(stage1, correction=AffineCorrection(3 * (1 / gain,), 3 * (0.0,)))
    corrected = affine_correction(weak, draw_labelled(labelled(train, stage1.predict_n(train)), 5, 0))
    np.testing.assert_allclose(corrected.predict_n(test), stage1.predict_n(test), atol=2e-3)
    np.testing.assert_allclose(corrected.correction.gain, 1, atol=2e-3)


def test_one_label_moves_each_axis_by_half_its_error(stage1, target):
    one = target.take(np.array([7]))
    moved = affine_correction(stage1, one).predict_n(target) - stage1.predict_n(target)
    half = (one.force_n - stage1.predict_n(one)) / 2
    np.testing.assert_allclose(moved, np.broadcast_to(half, moved.shape), atol=1e-6)


def test_corrections_follow_one_another_and_are_kept(stage1, target, tmp_path):
    first, second = (
        AffineCorrection((1.3, 0.8, 1.0), (0.1, 0.0, -0.2)),
        AffineCorrection((0.5,) * 3, (0.3,) * 3),
    )
    forces_n = target.force_n
    np.testing.assert_allclose(second.after(first)(forces_n), second(first(forces_n)), atol=1e-6)
    corrected = replace(stage1, correction=first)
    corrected.save(tmp_path / "model.pt")
    loaded = ForceModel.load(tmp_path / "model.pt")
    assert loaded.correction == first
    np.testing.assert_array_equal(loaded.predict_n(target), first(stage1.predict_n(target)))


@pytest.mark.parametrize("improve", [fine_tune, affine_correction])
def test_labels_lower_the_error_of_an_adapted_model(stage1, source, halves, improve):
    """The target's gel is softer: at the same pictures its forces are 0.6 of the source's."""
    train, test = (labelled(half, 0.6 * half.force_n) for half in halves)
    adapted = adapt(stage1, source, train, "dsan")
    before = {name: value.clone() for name, value in adapted.network.state_dict().items()}
    better = improve(adapted, draw_labelled(train, 10, 0))
    assert evaluate(better, test).mean_mae_n < 0.8 * evaluate(adapted, test).mean_mae_n
    for name, value in adapted.network.state_dict().items():
        assert torch.equal(value, before[name]), "the model that was given has changed"
        if "running" in name:
            assert torch.equal(value, better.network.state_dict()[name])


def test_labels_that_do_not_agree_change_little(stage1, halves):
    train, test = halves
    noise_n = np.random.default_rng(0).normal(0, 0.1, train.force_n.shape)
    noisy_n = (stage1.predict_n(train) + noise_n).clip(*np.array(train.force_range_n).T)
    corrected = affine_correction(stage1, draw_labelled(labelled(train, noisy_n), 5, 0))
    change_n = np.abs(corrected.predict_n(test) - stage1.predict_n(test)).mean()
    assert change_n < 0.4 * np.abs(noise_n).mean() / np.sqrt(5)


def test_fine_tuning_is_deterministic(stage1, target):
    first, second = (
        fine_tune(stage1, target.take(np.arange(5)), steps=5).predict_n(target) for _ in range(2)
    )
    np.testing.assert_array_equal(first, second)


def test_bad_frames_are_refused(stage1, target):
    for improve in (fine_tune, affine_correction):
        with pytest.raises(ValueError, match="no labelled frames of wmb1i1; at least 1"):
            improve(stage1, target.take(np.arange(0)))
        wide = ArrayFrames(
            "w", target.images(), target.reference, target.force_n, force_range_n=[[-1, 1], [-1, 1], [-5, 0]]
        )
        with pytest.raises(ValueError, match="must have one range"):
            improve(stage1, wide)
    with pytest.raises(ValueError, match="fine-tune, then correct"):
        fine_tune(affine_correction(stage1, target.take(np.arange(3))), target)
