"""Sequences of frames: windows stay in their trajectory, and what cannot be shown as one is refused."""

from pathlib import Path

import numpy as np
import pytest
import torch

from gelgap.adapt import Profile, split_for_training
from gelgap.adapt.data import network_inputs, windows_of
from gelgap.adapt.few_labels import fine_tune
from gelgap.adapt.model import ForceModel
from gelgap.adapt.onnx_file import export_onnx
from gelgap.adapt.prediction import predict_each
from gelgap.adapt.trainer import adapt, train_source, untrained
from gelgap.data import ArrayFrames

SEQUENCE = Profile.preset("smoke").replace(
    sequence_length=3, width=0.125, feature_dim=8, image_size_px=(32, 32), source_epochs=1, adapt_epochs=1
)


def trajectories_of(n: int = 6, steps: int = 5, **left_out: bool) -> ArrayFrames:
    rng = np.random.default_rng(0)
    images = rng.integers(0, 256, (n * steps, 32, 32, 3), np.uint8)
    columns = {"trajectory_id": np.repeat(np.arange(n), steps), "step": np.tile(np.arange(steps), n)}
    columns = {name: values for name, values in columns.items() if name not in left_out}
    force_n = rng.uniform(-0.4, -0.1, (n * steps, 3))
    return ArrayFrames("clips", images, images[0], force_n, **columns)


def test_a_window_stays_in_its_trajectory_whatever_the_order_of_frames() -> None:
    frames = trajectories_of(2, 3)
    expected = [[0, 0, 0], [0, 0, 1], [0, 1, 2], [3, 3, 3], [3, 3, 4], [3, 4, 5]]
    assert windows_of(frames, 3).tolist() == expected
    shuffled = np.array([4, 0, 3, 2, 5, 1])
    assert shuffled[windows_of(frames.take(shuffled), 3)].tolist() == np.array(expected)[shuffled].tolist()


def test_a_network_of_sequences_depends_on_what_came_before_and_is_saved(tmp_path: Path) -> None:
    frames = trajectories_of()
    split = split_for_training(frames, frames, SEQUENCE.replace(split_by="trajectory_id"), 0)
    model = train_source(split.source_train, SEQUENCE)
    assert network_inputs(frames, SEQUENCE, torch.device("cpu")).inputs(np.arange(2)).shape == (2, 9, 32, 32)
    model = adapt(model, split.source_train, split.target_train, "dan")
    model.save(tmp_path / "model.pt")
    loaded = ForceModel.load(tmp_path / "model.pt")
    clip = [(f"{k}.png", frames.picture(k)) for k in range(5)]
    rows = list(predict_each(loaded, clip, frames.reference))
    expected = model.predict_frames(frames)
    assert np.allclose([row["fz_n"] for row in rows], expected[:5, 2], atol=1e-5)
    alone = loaded.predict(frames.picture(4)[None], frames.reference)
    assert np.abs(alone[0] - expected[4]).max() > 1e-6


def test_what_is_no_sequence_is_refused(tmp_path: Path) -> None:
    frames, by = trajectories_of(), SEQUENCE.replace(split_by="trajectory_id")
    with pytest.raises(ValueError, match="longest trajectory of clips has 5 frames; it must be 1 to 5"):
        split_for_training(frames, frames, by.replace(sequence_length=6), 0)
    with pytest.raises(ValueError, match="split_by = 'random' divides trajectory"):
        split_for_training(frames, frames, by.replace(split_by="random"), 0)
    frames.columns["fz_n"][7] = np.nan
    with pytest.raises(ValueError, match="clips has trajectories labelled in part: label all"):
        split_for_training(trajectories_of(), frames, by, 0)
    frames, without = trajectories_of(), trajectories_of(step=True)
    with pytest.raises(ValueError, match="clips has no column step"):
        split_for_training(without, without, by, 0)
    model = untrained(frames, SEQUENCE)
    with pytest.raises(ValueError, match="sequences of 3 pictures\\), not a single picture"):
        model.predict(frames.picture(0), frames.reference)
    with pytest.raises(ValueError, match="cannot be fine-tuned"):
        fine_tune(model, frames)
    pytest.importorskip("onnxruntime")
    with pytest.raises(ValueError, match="networks of single pictures"):
        export_onnx(model, tmp_path / "model.onnx")
