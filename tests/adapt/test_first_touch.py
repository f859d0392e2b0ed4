"""Dents around the place of first touch: as far from the middle as dragged, turned with forces, or refused."""

import numpy as np
import pytest
import torch

from gelgap.adapt import ForceModel, Profile, adapt, split_for_training, train_source
from gelgap.adapt.data import Batch, turn_dents
from gelgap.adapt.few_labels import affine_correction
from gelgap.adapt.prediction import predict_each
from gelgap.adapt.trainer import untrained
from gelgap.data import ArrayFrames, Labels
from gelgap.data.frames.first_touch import dents_from_touch

SIZE_PX = (48, 36)
TOUCH = Profile.preset("smoke").replace(
    input="touch",
    colour_mixing=0.0,
    width=0.125,
    feature_dim=8,
    image_size_px=SIZE_PX,
    source_epochs=1,
    adapt_epochs=1,
    split_by="trajectory_id",
)
LIGHT = np.array([[1.0, 0.0], [-0.5, 0.8], [-0.5, -0.8]])


def trajectories(light: np.ndarray = LIGHT, n: int = 8, **left_out: bool) -> ArrayFrames:
    """At rest, touched, pressed and dragged three times, let go, touched elsewhere: noisy pictures of 96×72 px."""
    rng = np.random.default_rng(0)
    y, x = np.mgrid[:72, :96].astype(float)
    images, force_n = [], []
    for place_px in rng.uniform((38, 28), (58, 44), (n, 2)):
        drags_px = [
            np.zeros(2),
            np.zeros(2),
            *rng.uniform(-6, 6, (3, 2)),
            np.zeros(2),
            np.array([20.0, 10.0]),
        ]
        for depth, drag_px in zip((0, 0.3, 1, 1, 1, 0, 0.3), drags_px, strict=True):
            dx, dy = (x - place_px[0] - drag_px[0]) / 7, (y - place_px[1] - drag_px[1]) / 7
            wall = depth * np.exp(-(dx**2 + dy**2) / 2)
            image = 128 + 60 * np.stack([dx * wall, dy * wall], axis=2) @ light.T
            images.append(np.rint(image + rng.normal(0, 1, image.shape)).astype(np.uint8))
            force_n.append([*(0.05 * depth * drag_px * (depth == 1)), -depth])
    columns = {"trajectory_id": np.repeat(np.arange(n), 7), "step": np.tile(np.arange(7), n)}
    columns = {name: values for name, values in columns.items() if name not in left_out}
    return ArrayFrames(
        "drags", np.stack(images), np.full((72, 96, 3), 128, np.uint8), np.array(force_n), **columns
    )


def centres(shown: np.ndarray) -> np.ndarray:
    """Return where the first channel (n, h, w) is from the middle, (n, 2) px along x and y."""
    weight = np.where(shown > 0.5 * shown.max(axis=(1, 2), keepdims=True), shown, 0)
    y, x = np.mgrid[: shown.shape[1], : shown.shape[2]]
    y, x = y - (shown.shape[1] - 1) / 2, x - (shown.shape[2] - 1) / 2
    return np.stack([(weight * axis).sum(axis=(1, 2)) / weight.sum(axis=(1, 2)) for axis in (x, y)], axis=1)


@pytest.mark.parametrize("light", [LIGHT, LIGHT[[2, 0, 1]] * [[1.0], [0.4], [0.6]]], ids=["one", "other"])
def test_a_dent_is_shown_as_far_from_the_middle_as_it_was_dragged_in_any_light(light):
    frames = trajectories(light)
    shown = dents_from_touch(frames, SIZE_PX).astype(float)
    assert shown.shape == (56, 36, 48, 2)
    step = frames.columns["step"]
    assert not shown[np.isin(step, (0, 5))].any()
    dragged = np.isin(step, (2, 3, 4))
    # 0.05 N a px of 96; two thirds of them are shown on 48.
    expected_px = frames.force_n[dragged, :2] / 0.05 * 0.75
    np.testing.assert_allclose(centres(shown[dragged, ..., 0]), expected_px, atol=0.5)
    # Touched elsewhere after it was let go: around its own place.
    np.testing.assert_allclose(centres(shown[step == 6, ..., 0]), 0, atol=0.6)
    order = np.random.default_rng(1).permutation(len(frames))
    np.testing.assert_array_equal(
        dents_from_touch(frames.take(order), SIZE_PX), shown[order].astype(np.float16)
    )


def test_forces_are_turned_with_their_dents():
    frames = trajectories()
    frames = frames.take(np.isin(frames.columns["step"], (2, 3, 4)))
    inputs = torch.from_numpy(dents_from_touch(trajectories(), SIZE_PX)).float().permute(0, 3, 1, 2)
    inputs = inputs[np.isin(trajectories().columns["step"], (2, 3, 4))]
    labels = Labels.of({"fz_n": (-3, 0), "fy_n": (-1, 0.5), "fx_n": (-0.75, 0.75)})
    low, high = labels.low, labels.high
    given = Batch(
        inputs, torch.from_numpy((frames.values_of(labels.names) - low) / (high - low)).float(), None
    )
    turned = turn_dents(given, labels, np.random.default_rng(0))
    force_n = turned.force.numpy() * (high - low) + low
    assert np.abs(force_n[:, 2] - frames.force_n[:, 0]).max() > 0.1
    np.testing.assert_allclose(force_n[:, 0], frames.force_n[:, 2], atol=1e-5)
    np.testing.assert_allclose(
        centres(turned.inputs[:, 0].numpy()), force_n[:, [2, 1]] / 0.05 * 0.75, atol=0.6
    )


@pytest.mark.parametrize("length", [1, 3])
def test_a_network_is_trained_on_dents_and_reads_pictures_one_by_one_as_frames(length, tmp_path, caplog):
    frames, profile = trajectories(), TOUCH.replace(sequence_length=length)
    split = split_for_training(frames, frames, profile, 0)
    model = adapt(train_source(split.source_train, profile), split.source_train, split.target_train, "dan")
    assert "without contact" not in caplog.text
    model.save(tmp_path / "model.pt")
    model = ForceModel.load(tmp_path / "model.pt")
    rows = list(predict_each(model, [(f"{k}.png", frames.picture(k)) for k in range(7)], frames.reference))
    expected = model.predict_frames(frames)[:7]
    np.testing.assert_allclose(
        [[row[name] for name in ("fx_n", "fy_n", "fz_n")] for row in rows], expected, atol=1e-5
    )
    assert np.abs(expected[3] - model.predict(frames.picture(3)[None], frames.reference)[0]).max() > 1e-6
    with pytest.raises(ValueError, match="not a single picture: give the pictures of one trajectory"):
        model.predict(frames.picture(3), frames.reference)


def test_what_has_no_first_touch_is_refused_or_said(caplog):
    frames = trajectories()
    with pytest.raises(ValueError, match="few labelled frames lack their first touch"):
        affine_correction(untrained(frames, TOUCH), frames)
    dents_from_touch(frames.take(np.array([2, 3])), SIZE_PX)  # of one contact
    assert "input touch" not in caplog.text
    train_source(frames.take(np.isin(frames.columns["step"], (1, 2, 3, 4))), TOUCH)
    assert "input touch: drags: no training frame is without contact" in caplog.text
    dents_from_touch(frames.take(np.isin(frames.columns["step"], (2, 3, 4))), SIZE_PX)
    assert "drags: 8 of 8 contacts begin with a dent that is hardly smaller than it becomes" in caplog.text
    for without, message in (
        (trajectories(step=True), "drags has no column step: the input touch"),
        (
            frames.take(np.arange(56) // 2),
            "drags has 2 rows of trajectory_id 0 and step 0: number",
        ),
        (frames.take(frames.columns["step"] == 3), "input touch: each trajectory of drags has one frame"),
    ):
        with pytest.raises(ValueError, match=message):
            split_for_training(without, frames, TOUCH, 0)
    with pytest.raises(ValueError, match="input touch cannot show fx_n: training turns dents"):
        split_for_training(frames, frames, TOUCH, 0, labels=["fx_n", "fz_n"])
