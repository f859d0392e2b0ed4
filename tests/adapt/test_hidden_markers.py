"""Training with hidden markers and with standardised inputs: what is shown, drawn, kept, and left alone."""

import numpy as np
import pytest
import torch

from gelgap.adapt.data import Draw, TrainingDomain, hidden_batches, network_inputs
from gelgap.adapt.evaluation import as_judged_on_source
from gelgap.adapt.model import ForceModel
from gelgap.adapt.runs import stage1_profile
from gelgap.adapt.trainer import adapt, batches_of, train_source
from gelgap.data import ArrayFrames

DOT = (slice(14, 17), slice(18, 21))


@pytest.fixture
def easy_markers(monkeypatch):
    """Pictures of 40×32 px are too small for the detection: here a marker is what is black."""
    monkeypatch.setattr("gelgap.data.frames.dataset.without_markers", lambda picture: picture.clip(100, 255))


def dotted(frames: ArrayFrames) -> ArrayFrames:
    """Return the frames, brighter, with a black dot in all pictures."""
    images, reference = frames.images().clip(90, 255), frames.reference.copy()
    images[(slice(None), *DOT)] = reference[DOT] = 0
    return ArrayFrames(frames.name, images, reference, frames.force_n, frames.contact_class, frames.point_id)


def test_hidden_batches_are_a_share_and_depend_on_the_key_alone():
    hidden = hidden_batches(1000, 0.25, 0, Draw.STAGE_1, 3)
    assert 0.2 < hidden.mean() < 0.3
    np.testing.assert_array_equal(hidden, hidden_batches(1000, 0.25, 0, Draw.STAGE_1, 3))
    assert (hidden != hidden_batches(1000, 0.25, 0, Draw.STAGE_2, 3)).any()
    assert not hidden_batches(1000, 0.0, 0).any()
    assert hidden_batches(1000, 1.0, 0).all()


def test_hidden_frames_lose_their_markers_in_picture_and_reference(source, profile, easy_markers):
    hiding = profile.replace(marker_hiding=0.5, pairing="channels")
    domain = TrainingDomain(dotted(source), hiding, "cpu", labelled=False)
    rows = np.array([4, 9, 2])
    shown, hidden = (domain.batch(rows, is_hidden).inputs for is_hidden in (False, True))
    assert domain.batch(rows, False).force is None
    torch.testing.assert_close(shown, domain.pictures.inputs(rows))
    brightness = [inputs[(slice(None), slice(None), *DOT)].mean(dim=(2, 3)) for inputs in (shown, hidden)]
    assert (brightness[1] > brightness[0] + 0.5).all()


@pytest.mark.parametrize("share", [0.0, 0.5])
def test_stage_2_hides_markers_in_both_domains_independently(source, target, profile, share, easy_markers):
    hiding = profile.replace(marker_hiding=share)
    domains = [TrainingDomain(dotted(own), hiding, "cpu", labelled=False) for own in (source, target)]
    with_markers = [
        {picture.numpy().tobytes() for picture in domain.pictures.inputs(np.arange(len(domain)))}
        for domain in domains
    ]
    shown = []
    for pair in (pair for epoch in range(8) for pair in batches_of(epoch, *domains, hiding, 0)):
        for batch, known in zip(pair, with_markers, strict=True):
            shown.append(all(picture.numpy().tobytes() in known for picture in batch.inputs))
    of_source, of_target = np.array(shown).reshape(-1, 2).T
    if share == 0:
        assert of_source.all()
        assert of_target.all()
    else:
        assert 0.3 < of_source.mean() < 0.7
        assert 0.3 < of_target.mean() < 0.7
        assert (of_source != of_target).any()


def test_without_hiding_nothing_is_inpainted(source, target, profile, monkeypatch):
    monkeypatch.setattr("gelgap.data.frames.dataset.without_markers", pytest.fail)
    short = profile.replace(source_epochs=1, adapt_epochs=1)
    adapt(train_source(source, short), source, target, "dan")


def test_hiding_changes_training_and_the_key_of_stage_1(source, profile, easy_markers):
    marked, short = dotted(source), profile.replace(source_epochs=2)
    hiding = short.replace(marker_hiding=0.5)
    one, two, plain = (train_source(marked, p).predict_n(marked) for p in (hiding, hiding, short))
    np.testing.assert_array_equal(one, two)
    assert np.abs(one - plain).max() > 1e-3
    assert stage1_profile(hiding) != stage1_profile(short)
    standardised = short.replace(input="standardised")
    assert stage1_profile(standardised) != stage1_profile(short)


def test_a_model_keeps_the_target_statistics_of_its_input(source, target, profile, tmp_path):
    domain = profile.replace(source_epochs=2, adapt_epochs=1, input="standardised")
    stage1 = train_source(source, domain)
    own = [network_inputs(frames, domain, "cpu").map for frames in (source, target)]
    assert own[0] != own[1]
    adapted = adapt(stage1, source, target, "no-transfer")
    assert (stage1.input_map, adapted.input_map) == (own[0], own[1])
    assert adapt(stage1, source, target, "source-only").input_map == own[1]
    assert as_judged_on_source(adapted, source).input_map == own[0]
    # Few frames are standardised by the statistics of all.
    some = target.take(np.arange(3))
    np.testing.assert_allclose(adapted.predict_n(some), adapted.predict_n(target)[:3], atol=1e-4)
    adapted.save(tmp_path / "model.pt")
    loaded = ForceModel.load(tmp_path / "model.pt")
    assert loaded.input_map == adapted.input_map
    np.testing.assert_array_equal(loaded.predict_n(some), adapted.predict_n(some))


def test_a_constant_change_of_light_is_standardised_away(source, profile):
    """A target whose difference pictures are those of the source at half the contrast gives the same forces."""
    standardised = profile.replace(source_epochs=3, input="standardised")
    middle = source.reference.astype(float)
    weak = (middle + (source.images() - middle) / 2).round().clip(0, 255).astype(np.uint8)
    faint = ArrayFrames("faint", weak, source.reference, source.force_n)
    errors = []
    for p in (standardised, standardised.replace(input="pictures")):
        stage1 = train_source(source, p)
        change = adapt(stage1, source, faint, "source-only").predict_n(faint) - stage1.predict_n(source)
        errors.append(np.abs(change).mean())
    assert errors[0] < 0.4 * errors[1]
