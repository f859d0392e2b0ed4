"""What single methods do: conditional adversary, evidential alignment, style; and baselines without a network."""

import numpy as np
import torch

from gelgap.adapt import Profile
from gelgap.adapt.data import SplitFrames
from gelgap.adapt.evaluation import BASELINES, CONSTANT, evaluate_baselines
from gelgap.adapt.methods.dann import multilinear_map
from gelgap.adapt.methods.fourier_style import in_the_style_of
from gelgap.adapt.methods.registry import make_method
from gelgap.adapt.methods.uga import Evidence, evidential_loss, similar
from gelgap.domains import ArrayFrames


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


def test_the_conditional_map_is_the_outer_product():
    features, condition = torch.rand(4, 3), torch.rand(4, 2)
    mapped = multilinear_map(features, condition)
    assert mapped.shape == (4, 6)
    for row, f, c in zip(mapped, features, condition, strict=True):
        torch.testing.assert_close(row, torch.outer(c, f).flatten())


def test_the_evidential_loss_is_least_near_the_force_and_honest_evidence():
    force = torch.full((1, 3), 0.5)

    def loss(prediction: float, beta: float) -> float:
        evidence = Evidence(*(torch.full((1, 3), value) for value in (1.0, 2.0, beta)))
        return float(evidential_loss(force, torch.full((1, 3), prediction), evidence))

    assert loss(0.5, 0.01) < loss(0.7, 0.01)
    assert loss(0.7, 0.04) < loss(0.7, 1e-4), "a wrong force with little spread costs more"


def test_frames_are_mixed_with_those_of_similar_force():
    pool = torch.tensor([[0.1, 0.5, 0.5], [0.9, 0.5, 0.5]])
    queries = torch.tensor([[0.1, 0.5, 0.5], [0.9, 0.5, 0.5]]).repeat(50, 1)
    uniform = torch.rand(100, generator=torch.Generator().manual_seed(0))
    partners = similar(queries, pool, 0.1, uniform)
    assert partners.tolist() == [0, 1] * 50
    assert set(similar(queries, pool, 100.0, uniform).tolist()) == {0, 1}


def test_style_is_the_low_frequencies_amplitude():
    rng = torch.Generator().manual_seed(0)
    source, target = torch.randn(2, 3, 12, 16, generator=rng), torch.randn(2, 3, 12, 16, generator=rng)
    torch.testing.assert_close(in_the_style_of(source, source, 0.5), source, atol=1e-5, rtol=1e-4)
    styled = torch.fft.fft2(in_the_style_of(source, 3 * target, 0.1))
    torch.testing.assert_close(styled.abs()[..., 0, 0], 3 * torch.fft.fft2(target).abs()[..., 0, 0])
    torch.testing.assert_close(styled.abs()[..., 5, 7], torch.fft.fft2(source).abs()[..., 5, 7])


def test_what_a_method_owns_begins_by_the_runs_seed():
    first, same, other = (
        make_method("dann", Profile.preset("smoke"), 10, 3, seed).discriminator[1].weight
        for seed in (0, 0, 1)
    )
    assert torch.equal(first, same)
    assert not torch.equal(first, other)


def test_rules_beat_the_constant_where_area_tells_the_force() -> None:
    rng = np.random.default_rng(0)
    source = presses("one", rng.uniform(0.1, 1, 48))
    target = presses("other", rng.uniform(0.1, 1, 48), (0.6, 0.8, 1.0), 1)
    bright = presses("bright", np.random.default_rng(2).uniform(0.1, 1, 40), (1.0, 0.8, 0.6), 3)
    found = evaluate_baselines(SplitFrames(source, source.take(np.arange(0)), target, target, bright))
    assert tuple(found) == BASELINES
    assert found[CONSTANT].mae[2] > 3 * found["quadratic in mean difference"].mae[2]
    assert found[CONSTANT].mae[2] > 3 * found["ridge on area and depth"].mae[2]
    assert found["ridge on area and depth"].r2[2] > 0.9
