"""Optimal transport, style transfer, PSC, label shift and online adaptation, and rules without a network."""

from itertools import permutations

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from gelgap.adapt import Profile, adapt, make_method, train_source
from gelgap.adapt.data import SplitFrames
from gelgap.adapt.evaluation import BASELINES, CONSTANT, evaluate_baselines
from gelgap.adapt.methods.base import Adaptation
from gelgap.adapt.methods.deep_jdot import joint_transport, transport_plan
from gelgap.adapt.methods.fourier_style import in_the_style_of
from gelgap.adapt.methods.label_shift import LabelShift, shift_weights
from gelgap.adapt.methods.ssa import Subspace, slack_loss
from gelgap.domains import ArrayFrames

SMALL = {"width": 0.125, "feature_dim": 16, "source_epochs": 3, "adapt_epochs": 2, "batch_size": 8}


def presses(name: str, depth: np.ndarray, tint=(1.0, 0.8, 0.6), seed: int = 0) -> ArrayFrames:
    """Pictures of dents whose area and contrast grow with the depth, which is the force."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:32, :40].astype(float)
    images = np.full((len(depth), 32, 40, 3), 128, np.uint8)
    for image, own in zip(images, depth, strict=True):
        dent = own * np.exp(-((x - 20) ** 2 + (y - 16) ** 2) / (2 * (2 + 4 * own) ** 2))
        image[:] = 128 + 80 * dent[..., None] * np.array(tint) + rng.normal(0, 1, image.shape)
    force_n = np.stack([0 * depth, 0 * depth, -2.5 * depth], axis=1)
    return ArrayFrames(name, images, np.full((32, 40, 3), 128, np.uint8), force_n)


@pytest.fixture(scope="module")
def domains():
    rng = np.random.default_rng(0)
    return presses("one", rng.uniform(0.1, 1, 48)), presses(
        "other", rng.uniform(0.1, 1, 48), (0.6, 0.8, 1.0), 1
    )


@pytest.fixture(scope="module")
def profile() -> Profile:
    return Profile.preset("smoke").replace(image_size_px=(40, 32), colour_mixing=0.0, **SMALL)


@given(st.integers(0, 1000))
@settings(max_examples=20, deadline=None)
def test_the_plan_is_the_cheapest_one(seed):
    cost = np.random.default_rng(seed).random((4, 4))
    plan = transport_plan(cost)
    least = min(sum(cost[i, j] for i, j in enumerate(order)) for order in permutations(range(4))) / 4
    assert (plan * cost).sum() == pytest.approx(least)
    np.testing.assert_allclose(plan.sum(axis=0), 0.25)


def test_batches_of_two_sizes_are_carried_whole():
    plan = transport_plan(np.random.default_rng(0).random((4, 6)))
    np.testing.assert_allclose(plan.sum(axis=1), 1 / 4)
    np.testing.assert_allclose(plan.sum(axis=0), 1 / 6)


def test_transport_of_equal_frames_in_another_order_costs_nothing():
    rng = torch.Generator().manual_seed(0)
    features, force = torch.randn(8, 5, generator=rng), torch.rand(8, 3, generator=rng)
    order = torch.randperm(8, generator=rng)
    assert float(joint_transport(features, features[order], force, force[order], 0.1)) == pytest.approx(
        0, abs=1e-6
    )
    assert float(joint_transport(features, features[order], force, force, 0.0)) == pytest.approx(0, abs=1e-6)


def test_style_is_the_low_frequencies_amplitude():
    rng = torch.Generator().manual_seed(0)
    source, target = torch.randn(2, 3, 12, 16, generator=rng), torch.randn(2, 3, 12, 16, generator=rng)
    torch.testing.assert_close(in_the_style_of(source, source, 0.5), source, atol=1e-5, rtol=1e-4)
    styled = torch.fft.fft2(in_the_style_of(source, 3 * target, 0.1))
    torch.testing.assert_close(styled.abs()[..., 0, 0], 3 * torch.fft.fft2(target).abs()[..., 0, 0])
    torch.testing.assert_close(styled.abs()[..., 5, 7], torch.fft.fft2(source).abs()[..., 5, 7])


def test_weights_of_shifted_labels_are_found():
    """A target that has twice the share of the first bin, seen through a network that errs."""
    rng = np.random.default_rng(0)
    confusion = np.array([[0.8, 0.1, 0.0], [0.2, 0.8, 0.1], [0.0, 0.1, 0.9]])

    def predicted(true: np.ndarray) -> np.ndarray:
        return np.array([rng.choice(3, p=confusion[:, k]) for k in true])

    source, target = rng.integers(3, size=6000), rng.choice(3, 6000, p=[0.6, 0.2, 0.2])
    weights = shift_weights(source, predicted(source), predicted(target), 3, pull=0.01)
    np.testing.assert_allclose(weights, [1.8, 0.6, 0.6], atol=0.1)
    equal = shift_weights(source, source, source, 3, pull=0.1)
    np.testing.assert_allclose(equal, 1, atol=1e-6)
    strong = shift_weights(source, predicted(source), predicted(target), 3, pull=100.0)
    np.testing.assert_allclose(strong, 1, atol=0.05)


def test_slack_is_none_where_the_rest_varies_as_in_the_source():
    rng = torch.Generator().manual_seed(0)
    features = torch.randn(64, 6, generator=rng).double()
    directions = torch.eye(6).double()[:, :2]
    left = (features - features.mean(dim=0))[:, 2:]
    slack = left.square().sum(dim=1).mean()
    subspace = Subspace(features.mean(dim=0), directions, torch.ones(2), torch.ones(2), slack)
    assert float(slack_loss(features, subspace)) == pytest.approx(0, abs=1e-9)
    doubled = subspace._replace(slack=slack / 2)
    assert float(slack_loss(features, doubled)) == pytest.approx((2 + 0.5 - 2) / 2)


def test_online_adaptation_sees_each_picture_once(domains, profile, monkeypatch):
    source, target = domains
    stage1, passes = train_source(source, profile), []
    shown = Adaptation.target_batches
    monkeypatch.setattr(
        Adaptation, "target_batches", lambda self, epoch: passes.append(epoch) or shown(self, epoch)
    )
    monkeypatch.setattr(Adaptation, "estimate_target_statistics", lambda self: pytest.fail("estimated anew"))
    adapt(stage1, source, target, "online-ssa", profile)
    assert passes == [0]


def test_what_a_method_owns_begins_by_the_runs_seed(profile):
    first, same, other = (
        make_method("dann", profile, 10, 3, seed).discriminator[1].weight for seed in (0, 0, 1)
    )
    assert torch.equal(first, same)
    assert not torch.equal(first, other)


def test_a_shift_that_is_none_weighs_nothing(domains, profile):
    source, _ = domains
    method = make_method("label-shift", profile, 10)
    assert isinstance(method, LabelShift)
    adapted = adapt(train_source(source, profile), source, source, "label-shift", profile)
    assert 0.2 < adapted.history[-1]["diagnostics"]["largest_weight"] < 3


def test_rules_beat_the_constant_where_area_tells_the_force(domains):
    source, target = domains
    bright = presses("bright", np.random.default_rng(2).uniform(0.1, 1, 40), (1.0, 0.8, 0.6), 3)
    found = evaluate_baselines(SplitFrames(source, source.take(np.arange(0)), target, target, bright))
    assert tuple(found) == BASELINES
    assert found[CONSTANT].mae[2] > 3 * found["quadratic in mean difference"].mae[2]
    assert found[CONSTANT].mae[2] > 3 * found["ridge on area and depth"].mae[2]
    assert found["ridge on area and depth"].r2[2] > 0.9
