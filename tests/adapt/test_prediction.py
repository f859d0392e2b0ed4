"""Single pictures: predicted as frames of a data set are, also by an ONNX file, and refused or noted."""

import copy
import json
from dataclasses import replace

import cv2
import numpy as np
import onnxruntime
import pytest
import torch

from gelgap.adapt import (
    ForceModel,
    affine_correction,
    camera_pictures,
    evaluate,
    export_onnx,
    predict_each,
    train_source,
)
from gelgap.adapt.evaluation import evaluate_predictions
from gelgap.adapt.model import AffineCorrection
from gelgap.adapt.network import load_checkpoint
from gelgap.adapt.prediction import range_note, read_pictures
from gelgap.data import ArrayFrames, Labels
from gelgap.render import Illumination, MembraneRenderer, Sensor

INPUTS = [
    *({"pairing": pairing} for pairing in ("difference", "stack")),
    *({"input": name} for name in ("calibrated", "grey", "pretrained")),
    {"pairing": "channels", "input": "standardised"},
]


def enlarged(frames: ArrayFrames) -> ArrayFrames:
    """Return the frames at three times their size, with noise, so that reducing them matters."""
    rng = np.random.default_rng(0)
    size_px = 3 * frames.size_px[0], 3 * frames.size_px[1]
    images = np.stack([cv2.resize(image, size_px) for image in frames.images()])
    images = (images + rng.normal(0, 3, images.shape)).clip(0, 255).astype(np.uint8)
    return ArrayFrames(frames.name, images, cv2.resize(frames.reference, size_px), frames.force_n)


@pytest.mark.parametrize("changes", INPUTS, ids=str)
def test_a_picture_is_predicted_as_a_frame_and_by_onnx(changes, source, target, profile, stage1, tmp_path):
    stage1.save(tmp_path / "start.pt")
    weights = tmp_path / "start.pt" if changes.get("input") == "pretrained" else None
    chosen = profile.replace(source_epochs=1, **changes)
    frames = enlarged(target).take(np.arange(24))
    train_source(enlarged(source), chosen, weights=weights).save(tmp_path / "model.pt")
    model = affine_correction(ForceModel.load(tmp_path / "model.pt"), frames.take(np.arange(4)))
    wanted = model.predict_frames(frames)
    together = model.predict(frames.images(), frames.reference)
    alone = np.stack([model.predict(picture, frames.reference) for picture in frames.images()])
    np.testing.assert_array_equal(together, wanted)
    np.testing.assert_allclose(alone, wanted, atol=1e-6)
    assert evaluate_predictions(frames.force_n, together, model.force_range_n) == evaluate(model, frames)

    assert export_onnx(model, tmp_path / "model.onnx") < 1e-5
    session = onnxruntime.InferenceSession(str(tmp_path / "model.onnx"))
    size_px = chosen.image_size_px
    given = {"picture": frames.images(size_px), "reference": frames.references_at(size_px)}
    one_each = given | {"reference": given["reference"].repeat(len(frames), axis=0)}
    for inputs in (given, one_each):
        np.testing.assert_allclose(np.stack(session.run(None, inputs), axis=1), wanted, atol=1e-5)
    assert [output.name for output in session.get_outputs()] == ["fx_n", "fy_n", "fz_n"]
    facts = session.get_modelmeta().custom_metadata_map
    assert json.loads(facts["ranges"])[2] == [-3.0, 0.0]
    assert (facts["units"], facts["method"], facts["width_px"]) == ('["N", "N", "N"]', "source-only", "40")


def test_dots_are_found_and_followed_or_the_picture_is_refused(profile, tmp_path):
    """A model keeps the camera that it is for, whose pictures may come in another size."""
    rng, sensor = np.random.default_rng(0), Sensor(markers="array-1")
    render = MembraneRenderer(sensor, Illumination.preset("i0"), (160, 120), "draft")
    x_mm, y_mm = np.linspace(-7, 7, 29), np.linspace(-5.5, 5.5, 23)
    moved = np.zeros((8, 23, 29, 3))
    moved[..., 0] = rng.uniform(-0.3, 0.3, (8, 1, 1))
    images = np.stack([render.picture(x_mm, y_mm, one) for one in moved])
    force_n = np.pad(moved[:, 0, 0, :1], ((0, 0), (0, 2)))
    frames = ArrayFrames("dots", images, render.reference(), force_n, camera=sensor.camera)
    model = train_source(frames, profile.replace(source_epochs=1, input="markers"))
    model.save(tmp_path / "model.pt")
    model = ForceModel.load(tmp_path / "model.pt")
    np.testing.assert_allclose(
        model.predict(images[5], frames.reference), model.predict_frames(frames)[5], atol=1e-6
    )
    with pytest.raises(ValueError, match="input markers: what it shows is found outside the network"):
        export_onnx(model, tmp_path / "model.onnx")
    with pytest.raises(ValueError, match="input markers: these pictures: the reference shows 0 markers"):
        model.predict(images[5], render.reference(markers=False))
    with pytest.raises(ValueError, match="in 1 of 1 pictures most markers of the reference are not found"):
        model.predict(render.reference(markers=False), frames.reference)
    former = load_checkpoint(tmp_path / "model.pt")
    del former["camera"]
    torch.save(former, tmp_path / "former.pt")
    with pytest.raises(ValueError, match=r"markers in pixels, .* train it again"):
        ForceModel.load(tmp_path / "former.pt")


@pytest.mark.parametrize(
    ("picture", "reference", "message"),
    [
        ((64, 80), (32, 40), r"the picture is 80×64 px and the reference 40×32 px; both must be of one size"),
        ((64, 64), (64, 64), r"the picture is 64×64 px; the model is for pictures of 40×32 px"),
        ((24, 30), (24, 30), r"pictures are 30×24 px and are only down-sampled"),
        ((64,), (64, 80), r"the picture is uint8 \(64, 3\), not uint8 RGB"),
        ((64, 80), (2, 64, 80), r"the reference is uint8 \(2, 64, 80, 3\), not uint8"),
    ],
)
def test_what_the_model_cannot_be_shown_is_refused(picture, reference, message, stage1):
    images = [np.zeros((*shape, 3), np.uint8) for shape in (picture, reference)]
    with pytest.raises(ValueError, match=message):
        stage1.predict(*images)
    with pytest.raises(ValueError, match="the picture is float32"):
        stage1.predict(np.zeros((64, 80, 3), np.float32), np.zeros((64, 80, 3), np.uint8))


@pytest.mark.parametrize(
    ("fz_n", "words"),
    [
        (-0.001, ""),
        (-2.98, "Fz is at the end of the trained range, -3 to 0 N, or beyond"),
        (np.nan, "Fz is not a number"),
    ],
)
def test_a_prediction_at_the_end_of_its_range_is_noted(fz_n, words):
    note = range_note(Labels(), np.array([0.1, 0.1, fz_n]))
    assert words in note
    assert bool(note) == bool(words)


def test_a_network_whose_weights_are_broken_is_noted_and_a_wrong_picture_named(stage1, tmp_path):
    broken = replace(stage1, correction=AffineCorrection((np.nan,) * 3, (0.0,) * 3))
    rest = np.full((32, 40, 3), 9, np.uint8)
    (row,) = predict_each(broken, [("a.png", rest)], rest)
    assert row["note"].startswith("Fx is not a number; ")
    assert "the picture is black" in next(predict_each(stage1, [("a.png", rest // 9)], rest))["note"]
    colour = rest + np.uint8([0, 0, 9])
    noted = [
        "the reference is not" in row["note"]
        for row in predict_each(stage1, [("a", rest), ("b", colour)], colour)
    ]
    assert noted == [True, False]
    (tmp_path / "manifest.json").touch()
    with pytest.raises(ValueError, match="is a generated domain; gelgap export writes"):
        list(read_pictures([tmp_path]))
    with pytest.raises(ValueError, match=r"^b\.png: the picture is 40×64 px"):
        list(predict_each(stage1, [("b.png", np.zeros((64, 40, 3), np.uint8))], rest))


def test_a_camera_gives_pictures_in_rgb_or_is_an_error(monkeypatch, tmp_path):
    path = str(tmp_path / "clip.avi")
    writer = cv2.VideoWriter(path, cv2.VideoWriter_fourcc(*"MJPG"), 30.0, (64, 48))
    for _ in range(3):
        writer.write(np.full((48, 64, 3), (200, 100, 0), np.uint8))
    writer.release()
    real = cv2.VideoCapture
    monkeypatch.setattr(cv2, "VideoCapture", lambda index: real(path if index == 0 else str(tmp_path / "no")))
    pictures = dict(camera_pictures(0))
    assert list(pictures) == ["0", "1", "2"]
    np.testing.assert_allclose(pictures["1"][24, 32], (0, 100, 200), atol=6)
    with pytest.raises(ValueError, match="camera 1 gives no picture"):
        list(camera_pictures(1))


def test_a_missing_package_is_named_with_what_installs_it(monkeypatch, stage1, tmp_path):
    monkeypatch.setattr("gelgap.assets.extras.find_spec", lambda name: None if name == "onnx" else name)
    with pytest.raises(ValueError, match=r"needs the package onnx; install with: .* 'gelgap\[onnx"):
        export_onnx(stage1, tmp_path / "model.onnx")


def test_a_file_that_computes_something_else_is_refused_and_not_left(stage1, tmp_path):
    class Turns(torch.nn.Module):
        """A network whose course depends on the picture, of which a trace keeps one."""

        def __init__(self) -> None:
            super().__init__()
            self.backbone = stage1.network.backbone

        def forward(self, shown):
            return self.backbone(-shown if shown[-1].mean() > 0 else shown)

    network = copy.deepcopy(stage1.network)
    network.backbone = Turns()
    with pytest.raises(ValueError, match=r"the ONNX file computes labels that differ by .* of their range"):
        export_onnx(replace(stage1, network=network), tmp_path / "model.onnx")
    assert list(tmp_path.iterdir()) == []
