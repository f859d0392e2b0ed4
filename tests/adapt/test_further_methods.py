"""Mean teacher, conditional adversary, evidential alignment, source-free pseudo-labels, importance weights."""

import numpy as np
import pytest
import torch

from gelgap.adapt.methods.dann import density_ratio, multilinear_map
from gelgap.adapt.methods.tasfar import Calibration, block_masses, calibrate, pseudo_labels
from gelgap.adapt.methods.uga import Evidence, evidential_loss, similar
from gelgap.adapt.trainer import adapt


def weights(model) -> np.ndarray:
    return torch.cat([value.flatten() for value in model.network.parameters()]).detach().numpy()


def test_an_interrupted_mean_teacher_goes_on_from_its_teacher(stage1, source, target, tmp_path):
    profile = stage1.profile.replace(adapt_epochs=3)
    whole = adapt(stage1, source, target, "mean-teacher", profile)

    def stop(epoch, model):
        if epoch == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        adapt(stage1, source, target, "mean-teacher", profile, resume_file=tmp_path / "resume.pt", watch=stop)
    resumed = adapt(stage1, source, target, "mean-teacher", profile, resume_file=tmp_path / "resume.pt")
    np.testing.assert_array_equal(weights(whole), weights(resumed))


def test_the_teacher_is_the_average_of_the_networks(stage1, source, target):
    """With a decay of 0 the teacher is the network, so that the result is that of no teacher's lag."""
    results = {
        decay: adapt(
            stage1,
            source,
            target,
            "mean-teacher",
            stage1.profile.replace(settings={"mean-teacher": {"decay": decay, "transfer_weight": 0.0}}),
        )
        for decay in (0.0, 0.999)
    }
    plain = adapt(stage1, source, target, "no-transfer")
    moved = {decay: np.abs(weights(model) - weights(stage1)).mean() for decay, model in results.items()}
    assert moved[0.0] == pytest.approx(np.abs(weights(plain) - weights(stage1)).mean(), rel=0.2)
    assert moved[0.999] < 0.1 * moved[0.0]


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


def test_density_ratios_are_the_odds_of_the_target():
    """A discriminator of logit ln(p_s/p_t) gives w = p_t/p_s: over source frames the mean of w is 1 by itself."""
    rng = np.random.default_rng(0)
    x = rng.normal(0, 1, 20000)
    logits = torch.from_numpy((x - 0.5) ** 2 / 2 - x**2 / 2)
    ratio = density_ratio(logits, largest=1e9)
    expected = np.exp(-((x - 0.5) ** 2) / 2 + x**2 / 2)
    np.testing.assert_allclose(ratio.numpy(), expected, rtol=0.05)
    assert float(density_ratio(torch.tensor([-50.0, 0.0]), largest=10.0).max()) < 2


def test_the_calibration_finds_the_line_of_the_errors():
    rng = np.random.default_rng(0)
    spread = rng.uniform(0.01, 0.1, (4000, 3))
    error = (0.02 + 2 * spread) * rng.standard_normal((4000, 3))
    found = calibrate(spread, error, 0.85)
    np.testing.assert_allclose(found.intercept, 0.02, atol=0.008)
    np.testing.assert_allclose(found.slope, 2, rtol=0.15)
    np.testing.assert_allclose(found.confident, np.quantile(spread, 0.85, axis=0), rtol=1e-5)


def test_a_spread_that_says_nothing_gives_a_constant_error():
    rng = np.random.default_rng(0)
    spread = rng.uniform(0.01, 0.1, (2000, 3))
    found = calibrate(spread, (0.11 - spread) * rng.standard_normal((2000, 3)), 0.85)
    assert (found.slope == 0).all()
    assert (found.intercept > 0).all()


def test_pseudo_labels_go_to_where_the_density_is():
    edges = torch.linspace(0, 1, 21)
    calibration = Calibration(torch.full((3,), 0.1), torch.zeros(3), torch.full((3,), 0.05))
    density = torch.zeros(3, 20)
    density[:, 10] = 1.0
    prediction, spread = torch.full((1, 3), 0.45), torch.full((1, 3), 0.2)
    uncertain = pseudo_labels(prediction, spread, density, edges, calibration)
    torch.testing.assert_close(uncertain.force, torch.full((1, 3), 0.525))
    confident = pseudo_labels(prediction, spread / 10, density, edges, calibration)
    torch.testing.assert_close(confident.force, prediction)
    assert (uncertain.weight > confident.weight).all()
    nowhere = pseudo_labels(torch.zeros(1, 3), spread, density, edges, calibration)
    torch.testing.assert_close(nowhere.force, torch.zeros(1, 3))


def test_masses_are_those_of_the_gaussian():
    edges = torch.linspace(0, 1, 11)
    masses = block_masses(torch.full((2, 3), 0.5), torch.full((2, 3), 0.1), edges)
    assert masses.shape == (2, 3, 10)
    torch.testing.assert_close(masses.sum(dim=2), torch.ones(2, 3))
    torch.testing.assert_close(masses[..., 5], torch.full((2, 3), 0.3413 / 0.9973), atol=1e-3, rtol=0)
