"""Alignment losses: closed forms, slow references, gradients in float64 and invariances."""

import math

import numpy as np
import pytest
import scipy.linalg
import torch

from gelgap.adapt.methods.cod import (
    conditional_mmd,
    conditional_operator_discrepancy,
    covariance_part,
    mean_part,
)
from gelgap.adapt.methods.coral import coral
from gelgap.adapt.methods.dan import bandwidth, joint_mmd, mk_mmd, multi_gaussian, squared_distances
from gelgap.adapt.methods.dann import domain_loss, reverse_gradient
from gelgap.adapt.methods.daregram import daregram, daregram_published, daregram_tikhonov
from gelgap.adapt.methods.dsan import coarse_classes, lmmd
from gelgap.adapt.methods.rsd import projection_distance
from gelgap.adapt.methods.ssa import Subspace, subspace_loss


def features(n=9, d=12, seed=0, shift=0.0):
    rng = np.random.default_rng(seed)
    return torch.from_numpy(rng.standard_normal((n, d)) + shift)


def one_class_lmmd(s, t):
    return lmmd(s, t, torch.ones(len(s), 1, dtype=s.dtype), torch.ones(len(t), 1, dtype=t.dtype))


def class_lmmd(s, t):
    weights = torch.from_numpy(np.random.default_rng(5).random((len(s) + len(t), 4)))
    return lmmd(s, t, weights[: len(s)], weights[len(s) :])


def kernel_and_forces(s, t):
    force = torch.from_numpy(np.random.default_rng(3).random((len(s) + len(t), 3)))
    distances = squared_distances(torch.cat([s, t]))
    return multi_gaussian(distances, bandwidth(distances, False)), force[: len(s)], force[len(s) :]


LOSSES = {
    "coral": coral,
    "dan": mk_mmd,
    "jan": lambda s, t: joint_mmd((s, s[:, :3]), (t, t[:, :3])),
    "lmmd": class_lmmd,
    "cod": lambda s, t: conditional_operator_discrepancy(*kernel_and_forces(s, t), 0.05),
    "conditional-mmd": lambda s, t: conditional_mmd(*kernel_and_forces(s, t), 0.2, 0.01),
    "rsd": projection_distance,
    "daregram": lambda s, t: daregram(s, t, 0.5, 0.003, 0.9),
    "daregram-tikhonov": lambda s, t: daregram_tikhonov(s, t, 0.5, 0.003, 0.1),
}
KERNEL_LOSSES = ("dan", "jan", "lmmd", "cod", "conditional-mmd")
SHIFT_INVARIANT = ("coral", "dan", "lmmd")


# The bandwidth of a kernel carries no gradient by definition: those losses are checked with a fixed one below.
@pytest.mark.parametrize("name", [name for name in LOSSES if name not in KERNEL_LOSSES])
def test_gradient_against_finite_differences(name):
    loss = LOSSES[name]
    s, t = features(5, 7), features(5, 7, seed=1, shift=0.3)
    s.requires_grad_(True)
    assert torch.autograd.gradcheck(lambda s: loss(s, t), (s,), eps=1e-6, atol=1e-7, rtol=1e-4)


def test_kernel_gradient_against_finite_differences():
    s = features(4, 3).requires_grad_(True)
    t = features(5, 3, seed=1)
    weights = torch.from_numpy(np.random.default_rng(2).standard_normal((9, 9)))

    def value(s):
        return (weights * multi_gaussian(squared_distances(torch.cat([s, t])), torch.tensor(2.0))).sum()

    assert torch.autograd.gradcheck(value, (s,), eps=1e-6, atol=1e-7)


@pytest.mark.parametrize("name", [name for name in LOSSES if name not in ("lmmd", "cod", "conditional-mmd")])
@pytest.mark.parametrize("case", ["identical", "permuted"])
def test_same_sample_has_no_discrepancy(name, case):
    s = features().requires_grad_(True)
    t = s.detach().clone() if case == "identical" else s.detach()[torch.randperm(9)]
    loss = LOSSES[name](s, t)
    loss.backward()
    assert abs(loss.item()) < 1e-9
    assert torch.isfinite(s.grad).all()


@pytest.mark.parametrize("name", SHIFT_INVARIANT)
def test_common_offset_changes_nothing(name):
    s, t = features(), features(seed=1, shift=0.5)
    torch.testing.assert_close(LOSSES[name](s + 1e4, t + 1e4), LOSSES[name](s, t), rtol=1e-6, atol=1e-12)


def test_lmmd_with_one_class_is_mmd():
    s, t = features(), features(7, seed=1, shift=0.5)
    torch.testing.assert_close(one_class_lmmd(s, t), mk_mmd(s, t))


def test_lmmd_against_the_double_sum():
    s, t = features(6), features(5, seed=1)
    weights = np.random.default_rng(5).random((11, 4))
    distances = squared_distances(torch.cat([s, t]))
    kernel = multi_gaussian(distances, bandwidth(distances, False)).numpy()
    w_s, w_t = weights[:6] / weights[:6].sum(axis=0), weights[6:] / weights[6:].sum(axis=0)
    expected = 0.0
    for c in range(4):
        expected += w_s[:, c] @ kernel[:6, :6] @ w_s[:, c] + w_t[:, c] @ kernel[6:, 6:] @ w_t[:, c]
        expected -= 2 * w_s[:, c] @ kernel[:6, 6:] @ w_t[:, c]
    assert float(class_lmmd(s, t)) == pytest.approx(expected / 4, rel=1e-12)


def test_lmmd_without_a_common_class_is_exactly_zero():
    s = features().requires_grad_(True)
    t = features(seed=1)
    w_s, w_t = torch.zeros(9, 2), torch.zeros(9, 2)
    w_s[:, 0], w_t[:, 1] = 1, 1
    loss = lmmd(s, t, w_s, w_t)
    loss.backward()
    assert loss.item() == 0
    assert torch.equal(s.grad, torch.zeros_like(s))


def linear_kernels(n, m, d):
    """Features, forces and their pooled linear kernels: the operators are then small matrices."""
    rng = np.random.default_rng(4)
    x, y = rng.standard_normal((n + m, d)), rng.random((n + m, 3))
    return x, y, torch.from_numpy(x @ x.T), torch.from_numpy(y @ y.T)


def test_the_covariance_part_is_the_bures_distance_of_conditional_covariances():
    n, m, d, ridge = 30, 20, 4, 0.05
    x, y, kernel, force_kernel = linear_kernels(n, m, d)
    covariances = []
    for part in (slice(0, n), slice(n, n + m)):
        f, g = (a[part] - a[part].mean(axis=0) for a in (x, y))
        residual = np.eye(len(f)) - g @ np.linalg.solve(g.T @ g + ridge * len(f) * np.eye(3), g.T)
        covariances.append(f.T @ residual @ f / len(f))
    c_s, c_t = covariances
    root = scipy.linalg.sqrtm(c_s)
    expected = np.trace(c_s + c_t - 2 * scipy.linalg.sqrtm(root @ c_t @ root)).real
    assert float(covariance_part(kernel, force_kernel, n, ridge)) == pytest.approx(expected, rel=5e-3)


def test_the_mean_part_is_the_norm_of_the_operators_sum():
    n, m, ridge = 9, 7, 0.05
    x, y, kernel, force_kernel = linear_kernels(n, m, 4)
    total = 0
    for part in (slice(0, n), slice(n, n + m)):
        g = y[part] @ y[part].T
        total = total + x[part].T @ np.linalg.solve(g @ g + ridge * np.eye(len(g)), g) @ y[part]
    assert float(mean_part(kernel, force_kernel, n, ridge)) == pytest.approx(-np.linalg.norm(total), rel=1e-9)


def test_single_kernel_mmd_against_its_closed_form():
    # N(0, s²I) against N(μ, s²I), k = exp(−d²/b): 2 (1 + 4s²/b)^(−D/2) (1 − exp(−‖μ‖²/(b + 4s²))).
    d, s, b, n = 4, 0.7, 3.0, 3000
    rng = np.random.default_rng(0)
    shift = np.array([0.8, 0, 0, 0])
    x, y = (
        torch.from_numpy(s * rng.standard_normal((n, d))),
        torch.from_numpy(s * rng.standard_normal((n, d)) + shift),
    )
    kernel = multi_gaussian(squared_distances(torch.cat([x, y])), torch.tensor(b), count=1)
    k_ss, k_tt, k_st = kernel[:n, :n], kernel[n:, n:], kernel[:n, n:]
    unbiased = (k_ss.sum() - n) / (n * (n - 1)) + (k_tt.sum() - n) / (n * (n - 1)) - 2 * k_st.mean()
    expected = 2 * (1 + 4 * s**2 / b) ** (-d / 2) * (1 - math.exp(-(shift @ shift) / (b + 4 * s**2)))
    assert float(unbiased) == pytest.approx(expected, abs=0.004)
    assert expected > 0.05


def test_one_outlier_moves_the_mean_bandwidth_not_the_median():
    s = features(16)
    t = features(16, seed=1)
    far = t.clone()
    far[0] = 1e4
    plain, spoiled = (squared_distances(torch.cat([s, x])) for x in (t, far))
    assert bandwidth(spoiled, robust=False) > 1e4 * bandwidth(plain, robust=False)
    assert bandwidth(spoiled, robust=True) < 1.5 * bandwidth(plain, robust=True)


def test_jan_with_one_layer_is_dan():
    s, t = features(), features(seed=1)
    torch.testing.assert_close(joint_mmd((s,), (t,)), mk_mmd(s, t))


def test_coral_is_blind_to_the_mean_and_needs_two_frames():
    s = features()
    assert float(coral(s, s + 5)) == pytest.approx(0, abs=1e-12)
    scaled = 2 * s
    expected = float(((4 - 1) * torch.cov(s.T)).square().sum() / (4 * 12**2))
    assert float(coral(scaled, s)) == pytest.approx(expected, rel=1e-9)
    with pytest.raises(ValueError, match="at least 2 frames"):
        coral(s[:1], s)


def test_domain_loss_is_ln_2_when_domains_cannot_be_told_apart():
    assert float(domain_loss(torch.zeros(5), torch.zeros(5))) == pytest.approx(math.log(2))


def test_gradient_reversal():
    x = features().requires_grad_(True)
    reverse_gradient(x, 0.25).sum().backward()
    torch.testing.assert_close(x.grad, -0.25 * torch.ones_like(x))


def test_rsd_is_the_sum_of_squared_sines():
    s, t = features(4, 10), features(4, 10, seed=1)
    q_s, q_t = torch.linalg.qr(s.T)[0], torch.linalg.qr(t.T)[0]
    cosines = torch.linalg.svdvals(q_s.T @ q_t)
    expected = float((1 - cosines.square()).sum())
    assert float(projection_distance(s, t, ridge=1e-10)) == pytest.approx(expected, rel=1e-5)
    assert float(projection_distance(3 * s, t)) == pytest.approx(float(projection_distance(s, t)), rel=1e-9)


def test_rsd_refuses_a_batch_that_spans_everything():
    with pytest.raises(ValueError, match="spans all 12 feature dimensions"):
        projection_distance(features(12), features(12))


def test_stable_daregram_is_the_definition_at_a_gap():
    # Four strong directions, a constant and weak noise: the rank is 5, and pinv can cut in the gap.
    rng = np.random.default_rng(0)

    def batch():
        strong = rng.standard_normal((10, 4)) @ (5 * rng.standard_normal((4, 15)))
        return torch.from_numpy(strong + 1e-3 * rng.standard_normal((10, 15)))

    def gram(x):
        a = torch.cat([torch.ones(10, 1), x], dim=1)
        return a.T @ a

    s, t = batch(), batch()
    inverse_s, inverse_t = (torch.linalg.pinv(gram(x), rtol=1e-6, hermitian=True) for x in (s, t))
    angle = (1 - torch.cosine_similarity(inverse_s, inverse_t, dim=0, eps=1e-30)).abs().mean()
    values_s, values_t = (torch.linalg.eigvalsh(gram(x)).flip(0)[:5] for x in (s, t))
    expected = 0.5 * angle + 0.003 * torch.dist(values_s, values_t) / 5
    assert float(daregram(s, t, 0.5, 0.003, 0.9999)) == pytest.approx(float(expected), rel=1e-6)


def test_published_daregram_is_not_zero_for_equal_features_with_a_dead_unit():
    s = features(16, 10).float()
    s[:, 3] = 0
    assert float(daregram_published(s, s, 0.5, 0.003, 0.9)) > 0.01
    assert float(daregram(s, s, 0.5, 0.003, 0.9)) == pytest.approx(0, abs=1e-9)


def test_subspace_loss_vanishes_at_the_sources_statistics():
    x = features(200, 6)
    mean = x.mean(dim=0)
    values, directions = torch.linalg.eigh(torch.cov(x.T))
    subspace = Subspace(mean, directions, values, torch.ones(6), torch.zeros(()))
    assert abs(float(subspace_loss(x, subspace))) < 1e-9
    assert float(subspace_loss(x + 1, subspace)) > 0.1


def test_coarse_classes():
    group = coarse_classes(361, 1, 4)
    assert group[0] == 0
    assert len(np.unique(group)) == 1 + 5 * 4
    first_depth = group[1:13]
    assert first_depth[0] == first_depth[1] == first_depth[11]
    assert len(set(first_depth.tolist())) == 4
    assert np.bincount(group)[1:].tolist() == [18] * 20
