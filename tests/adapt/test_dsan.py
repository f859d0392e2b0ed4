"""DSAN aligns the classes that the published mask keeps, no others, and reports how many."""

import numpy as np
import pytest
import torch

from gelgap.adapt.methods.base import Step
from gelgap.adapt.methods.mmd import DSAN, bandwidth, multi_gaussian, squared_distances
from gelgap.adapt.network import Activations
from gelgap.adapt.trainer import adapt, train_source

pytestmark = pytest.mark.numerical

STEP = Step(number=0, weight=0.5, rng=np.random.default_rng(0))


def brute_force_lmmd(s, t, source_group, target_probability):
    """LMMD by loops over classes and frames; a class counts that both batches have, by label and by argmax."""
    distances = squared_distances(torch.cat([s, t]))
    kernel = multi_gaussian(distances, bandwidth(distances, False)).tolist()
    of_source, of_target = source_group.tolist(), target_probability.tolist()
    guessed = [row.index(max(row)) for row in of_target]
    common, n = sorted(set(of_source) & set(guessed)), len(of_source)
    total = 0.0
    for c in common:
        w_s = [float(group == c) / of_source.count(c) for group in of_source]
        mass = sum(row[c] for row in of_target)
        signed = w_s + [-row[c] / mass for row in of_target]
        total += sum(signed[i] * signed[j] * kernel[i][j] for i in range(2 * n) for j in range(2 * n))
    return total / max(len(common), 1), common


def dsan_batches(n_classes, classes, seed=0):
    """Activations of 8 frames each, source frames of the classes given, targets with softmax labels."""
    rng = np.random.default_rng(seed)
    s, t = (torch.from_numpy(rng.standard_normal((8, 12)) + shift).float() for shift in (0.0, 0.3))
    logits = torch.from_numpy(2 * rng.standard_normal((8, n_classes))).float()
    prediction = torch.full((8, 3), 0.5)
    source = Activations(s, prediction, contact_class=torch.tensor(classes))
    return source, Activations(t, prediction, logits=logits)


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_dsan_aligns_the_classes_of_the_source_that_are_argmax_in_the_target(seed):
    rng = np.random.default_rng(seed)
    source, target = dsan_batches(12, rng.integers(0, 12, 8).tolist(), seed)
    dsan = make_dsan(12)
    expected, common = brute_force_lmmd(
        source.features, target.features, source.contact_class, target.logits.softmax(dim=1)
    )
    present = len(set(source.contact_class.tolist()))
    assert 0 < len(common) < present
    found = dsan.loss(source, target, STEP)
    assert found.weight == STEP.weight
    assert float(found.value) == pytest.approx(expected, rel=1e-4)
    assert found.diagnostics == {"common_classes": len(common), "no_common_class": 0}


def make_dsan(n_classes):
    return DSAN(DSAN.Settings(), 12, n_classes)


def test_dsan_without_a_common_class_has_no_loss_and_says_so():
    source, target = dsan_batches(6, 8 * [5])
    target.logits[:, 5] = -9.0
    source.features.requires_grad_(True)
    dsan = make_dsan(6)
    found = dsan.loss(source, target, STEP)
    found.value.backward()
    assert found.value.item() == 0
    assert not source.features.grad.any()
    assert found.diagnostics == {"common_classes": 0, "no_common_class": 1}


def test_source_frames_of_one_class_are_too_few(source, target, profile):
    one_class = source.take(np.flatnonzero(source.contact_class == source.contact_class[0]))
    model = train_source(source, profile.replace(source_epochs=1))
    with pytest.raises(
        ValueError, match=r"dsan needs source frames of at least 2 contact classes, and the \d+ of"
    ):
        adapt(model, one_class, target, "dsan")
