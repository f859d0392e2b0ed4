"""What a network is shown: maps that undo another light, dots that have moved, and what is refused."""

import numpy as np
import pytest
import torch

from gelgap.adapt import ForceModel, Profile, adapt, train_source
from gelgap.adapt.data import network_inputs
from gelgap.adapt.few_labels import affine_correction, pretrain_on_stream
from gelgap.adapt.inputs import INPUTS, Found
from gelgap.adapt.model import input_map
from gelgap.adapt.onnx_file import export_onnx
from gelgap.adapt.split import size_notes
from gelgap.data import ArrayFrames, LabelledFrames, join_domains, with_labels
from gelgap.render import Camera

SIZE_PX = (64, 48)


def dents(light: np.ndarray, name: str = "dents", count: int = 40, seed: int = 0) -> ArrayFrames:
    """Pictures of round dents whose walls are shaded by a light (3 colours × slopes along x and y)."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[: SIZE_PX[1], : SIZE_PX[0]].astype(float)
    images = np.empty((count, SIZE_PX[1], SIZE_PX[0], 3), np.uint8)
    depth = rng.uniform(0.5, 1.0, count)
    for image, own, (cx, cy) in zip(images, depth, rng.uniform((20, 16), (44, 32), (count, 2)), strict=True):
        dx, dy = (x - cx) / 6, (y - cy) / 6
        wall = own * np.exp(-(dx**2 + dy**2) / 2)
        image[:] = np.clip(128 + 60 * np.stack([dx * wall, dy * wall], axis=2) @ light.T, 0, 255)
    reference = np.full((SIZE_PX[1], SIZE_PX[0], 3), 128, np.uint8)
    force_n = np.stack([0 * depth, 0 * depth, -depth], axis=1)
    return ArrayFrames(name, images, reference, force_n)


def shown(frames: LabelledFrames, name: str, length: int = 1) -> np.ndarray:
    profile = Profile.preset("smoke").replace(input=name, colour_mixing=0.0, sequence_length=length)
    return network_inputs(frames, profile, torch.device("cpu")).inputs(np.arange(len(frames))).numpy()


def test_a_calibrated_input_is_the_same_under_permuted_and_turned_colours():
    """Red from the left or from the right, green from above or from below: after calibration the same pictures."""
    light = np.array([[1.0, 0.0], [-0.5, 0.8], [-0.5, -0.8]])
    other = light[[1, 2, 0]] @ np.array([[0.8, 0.6], [-0.6, 0.8]]).T
    raw = [shown(dents(one), "pictures") for one in (light, other)]
    calibrated = [shown(dents(one), "calibrated")[:, :2] for one in (light, other)]
    before, after = (np.corrcoef(a.ravel(), b.ravel())[0, 1] for a, b in (raw, calibrated))
    assert before < 0.6
    assert after > 0.98
    np.testing.assert_allclose(calibrated[0].std(axis=(0, 2, 3)), 1, rtol=0.05)


def test_the_calibrated_channels_are_the_slopes():
    pictures = shown(dents(np.array([[0.9, 0.2], [-0.3, 0.7], [-0.4, -0.6]])), "calibrated")
    y, x = np.mgrid[: SIZE_PX[1], : SIZE_PX[0]]
    strength = np.abs(pictures[0, :2]).sum(axis=0)
    right, below = (strength * (axis > np.average(axis, weights=strength)) for axis in (x, y))
    # The wall that faces +x is positive in the first channel, whatever its colour is; so is +y in the second.
    assert (pictures[0, 0] * right).sum() > 5 * abs((pictures[0, 1] * right).sum())
    assert (pictures[0, 1] * below).sum() > 5 * abs((pictures[0, 0] * below).sum())


def test_a_small_part_of_the_view_is_noted_where_markers_are_shown(monkeypatch):
    monkeypatch.setattr("gelgap.adapt.split.rest_markers", lambda *args: iter(()))
    near, far = (
        ArrayFrames(
            name, np.zeros((2, 48, 64, 3), np.uint8), np.zeros((48, 64, 3), np.uint8), None, camera=camera
        )
        for name, camera in (("near", Camera()), ("far", Camera.showing(40.0)))
    )
    profile = Profile.preset("smoke").replace(image_size_px=(64, 48))
    assert size_notes(near, far, profile) == ()
    markers = profile.replace(input="markers", colour_mixing=0.0)
    (note,) = size_notes(near, far, markers)
    assert "12×9 mm of far (marker_span_mm), whose pictures show 40.0×30.0 mm" in note
    assert size_notes(near, far, markers.replace(marker_span_mm=(36.0, 27.0))) == ()


def test_channels_of_each_input():
    frames = dents(np.array([[1.0, 0.0], [-0.5, 0.8], [-0.5, -0.8]]))
    assert shown(frames, "grey").shape == (40, 1, 48, 64)
    standardised = shown(frames, "standardised")
    np.testing.assert_allclose(standardised.mean(axis=(0, 2, 3)), 0, atol=1e-3)
    np.testing.assert_allclose(standardised.std(axis=(0, 2, 3)), 1, atol=1e-3)
    np.testing.assert_allclose(shown(frames, "grey")[:, 0], shown(frames, "pictures").mean(axis=1), atol=1e-5)
    grey = Profile.preset("smoke").replace(input="grey", colour_mixing=0.0)
    assert input_map(join_domains([frames, frames]), grey, torch.device("cpu"))  # one for all
    assert all(entry.about for entry in INPUTS.values())


def test_pictures_without_a_dent_cannot_be_calibrated():
    flat = np.full((4, 48, 64, 3), 128, np.uint8)
    frames = ArrayFrames("flat", flat, flat[0], np.zeros((4, 3)))
    for shows_none in (frames, join_domains([dents(np.eye(3)[:, :2]), frames])):
        with pytest.raises(ValueError, match="input calibrated: flat: no picture shows a dent"):
            shown(shows_none, "calibrated")


@pytest.mark.parametrize("name", ["calibrated", "grey"])
def test_a_network_is_trained_on_it_adapted_and_kept(tmp_path, name):
    light = np.array([[1.0, 0.0], [-0.5, 0.8], [-0.5, -0.8]])
    source, target = dents(light, "one"), dents(light[::-1], "other", seed=1)
    changes = {"width": 0.125, "feature_dim": 16, "source_epochs": 2, "adapt_epochs": 1, "colour_mixing": 0.0}
    profile = Profile.preset("smoke").replace(input=name, **changes)
    stage1 = train_source(source, profile)
    adapted = adapt(stage1, source, target, "adabn")
    assert (adapted.input_map != stage1.input_map) == (name == "calibrated")
    adapted.save(tmp_path / "model.pt")
    loaded = ForceModel.load(tmp_path / "model.pt")
    assert loaded.input_map == adapted.input_map
    np.testing.assert_array_equal(loaded.predict_n(target), adapted.predict_n(target))


def dotted(shifts_px: list[float], pitch_px: int = 20) -> np.ndarray:
    """Return pictures (n, 120, 160, 3) of dark dots that have all moved along x, under a light that changes."""
    y, x = np.mgrid[:120, :160]
    pictures = []
    for number, shift in enumerate(shifts_px):
        dots = np.cos(2 * np.pi * (x - shift) / pitch_px) + np.cos(2 * np.pi * y / pitch_px)
        shade = (1.2 - dots).clip(-0.2, 0.2) * 2.5 + 0.5
        pictures.append((30 + (120 + 15 * number) * shade)[..., None].repeat(3, axis=2))
    return np.stack(pictures).astype(np.uint8)


def displacements(frames: ArrayFrames) -> Found:
    return Found(INPUTS["markers"].find, frames, SIZE_PX, (12.0, 9.0), "cpu")


def test_displacement_is_how_far_the_dots_have_moved_in_mm_whatever_their_pitch(caplog):
    camera = Camera.showing(12.0)  # 0.075 mm per pixel
    for pitch_px in (16, 20):
        images = dotted([0, 3, -3], pitch_px)
        frames = ArrayFrames("dots", images, images[0], np.zeros((3, 3)), camera=camera)
        moved = displacements(frames).inputs(np.arange(3)).numpy()
        middle = moved[:, :, 12:-12, 15:-15]
        np.testing.assert_allclose(middle[:, 0].mean(axis=(1, 2)), [0, 0.225, -0.225], atol=0.005)
        np.testing.assert_allclose(middle[:, 1], 0, atol=0.01)
    assert "input markers" not in caplog.text
    images[1] = 150
    displacements(ArrayFrames("bare", images, images[0], np.zeros((3, 3)), camera=camera))
    assert "of bare" not in caplog.text
    assert "bare: in 1 of 3 pictures most markers of the reference are not found again" in caplog.text


@pytest.mark.parametrize(
    ("camera", "changes", "message"),
    [
        (None, {}, "mm per pixel of dots are not known; put a sensor.toml beside its pictures"),
        (Camera(), {0: 150}, "dots: the reference shows 0 markers; .* choose another input"),
        (Camera(), {1: 150, 2: 150}, "dots: in 2 of 3 pictures most .* first: frame 1; is it a reference"),
    ],
)
def test_displacement_that_cannot_be_known_is_refused(camera, changes, message):
    images = dotted([0, 3, -3])
    for number, level in changes.items():
        images[number] = level
    frames = ArrayFrames("dots", images, images[0], np.zeros((3, 3)), camera=camera)
    with pytest.raises(ValueError, match=f"input markers: .*{message}"):
        displacements(frames)
    if "first: frame" not in message:  # else before anything is trained
        marked = Profile.preset("smoke").replace(
            input="markers", colour_mixing=0.0, image_size_px=frames.size_px
        )
        with pytest.raises(ValueError, match=f"input markers: .*{message}"):
            size_notes(frames, frames, marked)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"input": "colour"}, "input 'colour' is unknown"),
        ({"input": "calibrated", "pairing": "stack"}, "needs pairing 'difference'"),
        ({"input": "grey", "colour_mixing": 0.5}, "has no colours to mix"),
        ({"input": "markers", "marker_hiding": 0.5}, "marker_hiding must be 0"),
        ({"marker_hiding": 1.5}, "marker_hiding"),
        (
            {"input": "touch", "shift_px": 3},
            "input touch: shows how far a dent is off its place; shift_px must be 0",
        ),
    ],
)
def test_what_cannot_be_shown_is_refused(changes, message):
    with pytest.raises(ValueError, match=message):
        Profile(**{"pairing": "difference", **changes})


def test_a_pretrained_backbone_needs_its_weights_and_stays(tmp_path):
    frames = dents(np.array([[1.0, 0.0], [-0.5, 0.8], [-0.5, -0.8]]))
    changes = {"width": 0.125, "feature_dim": 16, "source_epochs": 1, "colour_mixing": 0.0}
    profile = Profile.preset("smoke").replace(**changes)
    train_source(frames, profile).save(tmp_path / "start.pt")
    frozen = profile.replace(input="pretrained")
    with pytest.raises(ValueError, match="needs the weights of a pretrained network"):
        train_source(frames, frozen)
    with pytest.raises(
        ValueError, match=r"\(resnet18, width 0\.125, difference, input pictures, sequence_length 1\)"
    ):
        train_source(frames, frozen.replace(pairing="stack"), weights=tmp_path / "start.pt")
    start = ForceModel.load(tmp_path / "start.pt").network
    trained = train_source(frames, frozen, weights=tmp_path / "start.pt").network
    for own, other in zip(trained.backbone.parameters(), start.backbone.parameters(), strict=True):
        torch.testing.assert_close(own, other)
    assert not torch.equal(trained.bottleneck[0].weight, start.bottleneck[0].weight)


@pytest.mark.parametrize("name", ["calibrated", "standardised"])
def test_each_of_several_sources_is_shown_by_a_map_of_its_own(name):
    light = np.array([[1.0, 0.0], [-0.5, 0.8], [-0.5, -0.8]])
    one, other = dents(light, "one"), dents(light[[1, 0, 2]], "other", seed=1)
    own, several = np.concatenate([shown(one, name), shown(other, name)]), join_domains([one, other])
    rows = np.array([45, 1, 70])
    np.testing.assert_allclose(shown(several.take(rows), name), own[rows], atol=1e-5)
    for frames in (one, other):
        frames.columns |= {"trajectory_id": np.zeros(40, int), "step": np.arange(40)}
    nested = join_domains([join_domains([one, other]), one])
    pairs = np.concatenate([own[np.r_[0, 0:39, 40, 40:79]], own], axis=1)
    np.testing.assert_allclose(shown(nested, name, length=2)[:80], pairs, atol=1e-5)
    changes = {"width": 0.125, "feature_dim": 16, "source_epochs": 1, "colour_mixing": 0.0, "input": name}
    stage1 = train_source(several.take(np.arange(0, 80, 2)), Profile.preset("smoke").replace(**changes))
    np.testing.assert_allclose(stage1.predict_n(several)[40:], stage1.predict_n(other), atol=1e-5)
    with pytest.raises(ValueError, match=rf"one\+other have a map each \(input {name}\), your"):
        stage1.predict(one.picture(0), one.reference)
    with pytest.raises(ValueError, match="have a map each"):
        affine_correction(stage1, with_labels(one.take(rows[1:2]), stage1.labels))
    assert adapt(stage1, several, other, "adabn").predict(one.picture(0), one.reference).shape == (3,)


def test_maps_that_may_not_fit_are_noted(source, target, profile):
    calibrated = profile.replace(input="calibrated")
    few = join_domains([source, dents(np.eye(3)[:, :2], "few", count=7)])
    assert "a map by 7 pictures of few hardly fits" in size_notes(few, target, calibrated)[-1]
    (note,) = size_notes(source, target, calibrated.replace(colour_mixing=0.5))
    assert "colour_mixing turns slopes as if they were colours" in note
    assert size_notes(source, target, calibrated) == ()
    with pytest.raises(ValueError, match="input calibrated: a stream has few pictures of each light"):
        pretrain_on_stream(None, "nowhere", calibrated)


def test_averaged_weights_are_the_result_and_repeat():
    frames = dents(np.array([[1.0, 0.0], [-0.5, 0.8], [-0.5, -0.8]]))
    changes = {"width": 0.125, "feature_dim": 16, "source_epochs": 6, "colour_mixing": 0.0, "batch_size": 4}
    last = Profile.preset("smoke").replace(**changes)
    averaged = last.replace(averaging=0.9)
    one, two, plain = (
        train_source(frames, profile).predict_n(frames) for profile in (averaged, averaged, last)
    )
    np.testing.assert_array_equal(one, two)
    assert np.abs(one - plain).max() > 1e-4


@pytest.mark.parametrize("name", ["pictures", "grey"])
def test_a_levelled_network_reads_the_same_in_another_light(tmp_path, name, source, profile):
    """By its checkpoint, too; a network that was not levelled reads something else."""
    few = profile.replace(input=name, source_epochs=2, colour_mixing=0.0)
    picture = source.picture(3)
    dimmed = np.rint(picture * [0.85, 0.9, 0.88]).astype(np.uint8)
    apart = {}
    for levelling in (False, True):
        train_source(source, few.replace(levelling=levelling)).save(tmp_path / "model.pt")
        model = ForceModel.load(tmp_path / "model.pt")
        assert model.profile.levelling == levelling
        read = [model.predict(seen, source.reference) for seen in (picture, dimmed)]
        apart[levelling] = np.abs(read[0] - read[1]).max()
    assert apart[True] < 0.02
    assert apart[True] < 0.5 * apart[False]
    with pytest.raises(ValueError, match="levelling: pictures are brought"):
        export_onnx(model, tmp_path / "model.onnx")
